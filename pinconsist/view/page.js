const replay = JSON.parse(document.getElementById("replay").textContent);
const element = id => document.getElementById(id);
const added = (parent, kind, properties) => Object.assign(parent.appendChild(document.createElement(kind)), properties);
const unpacked = text => new Float32Array(Uint8Array.from(atob(text), letter => letter.charCodeAt(0)).buffer);
const css = color => "#" + color.toString(16).padStart(6, "0");
const short = (number, unit) => +number.toPrecision(3) + " " + unit;

// The scene
const {Vector2, Vector3, Raycaster, PerspectiveCamera, OrthographicCamera} = MeshCat.THREE;
const pane = element("meshcat-pane"), viewer = new MeshCat.Viewer(pane);
for (const command of replay.commands) viewer.handle_command(command);
viewer.set_3d_pane_size = () =>  // the window's by default
  MeshCat.Viewer.prototype.set_3d_pane_size.call(viewer, wide, high);
const object = path => viewer.scene_tree.find(path.split("/").filter(Boolean)).object;
const parts = {force: [], loop: [], trace: [], ground: [object("/Axes")], body: []};
viewer.scene.traverse(thing => parts[thing.userData.part]?.push(thing));

// The camera shows all points of the outline; margins in shares of the pane
const VIEW = 40, MARGIN = 1.12;  // degrees
const {planar, size} = replay.view, points = replay.view.points.map(place => new Vector3(...place));
const [right, up, back] = replay.view.axes.map(axis => new Vector3(...axis));
viewer.controls.dispose();
viewer.set_camera(planar ? new OrthographicCamera() : new PerspectiveCamera(VIEW));
const camera = viewer.camera, target = viewer.controls.target;
let moved = false, wide, high;  // of the pane, pixels
viewer.controls.addEventListener("start", () => moved = true);
function fit() {
  const aspect = wide / high;
  const slope = planar ? 0 : Math.tan(VIEW / 360 * Math.PI) / MARGIN;
  const ends = (axis, slope) => [1, -1].map(way =>
    Math.max(...points.map(point => way * point.dot(axis) + slope * (point.dot(back) - depth))));
  const depths = points.map(point => point.dot(back)), depth = (Math.max(...depths) + Math.min(...depths)) / 2;
  const [east, west] = ends(right, slope * aspect), [north, south] = ends(up, slope);
  const half = Math.max((east + west) / aspect, north + south, 0.05 * size) / 2;
  const away = planar ? 10 * size : half / slope;
  target.copy(right).multiplyScalar((east - west) / 2).addScaledVector(up, (north - south) / 2).addScaledVector(back, depth);
  camera.up.set(0, 1, 0);
  camera.position.copy(target).addScaledVector(back, away);
  Object.assign(camera, {near: away / 1000, far: away * 100, zoom: 1});
  if (planar) Object.assign(camera, {top: half * MARGIN, bottom: -half * MARGIN, left: -half * MARGIN * aspect});
  viewer.set_3d_pane_size();
  moved = false;
}
const pixels = () => high / 2 * (planar  // of a metre
  ? camera.zoom / camera.top : 1 / (Math.tan(VIEW / 360 * Math.PI) * camera.position.distanceTo(target)));
function measure() {
  [wide, high] = [pane.clientWidth, pane.clientHeight];
  if (moved) viewer.set_3d_pane_size(); else fit();
}
new ResizeObserver(measure).observe(pane);

// Words over the scene
const labels = [];
function label(text, kind, place, shown = () => true) {
  labels.push({word: added(pane, "div", {className: "label " + kind, textContent: text}), place, shown});
}
for (const {text, at} of replay.titles) label(text, "title", () => new Vector3(...at));
const named = new Set();
for (const part of [...parts.loop, ...parts.body]) {
  const {name, run} = part.userData;
  if (named.size == named.add(run + name).size) continue;
  label(name, "name", () => part.getWorldPosition(new Vector3()), () => switches.names.checked);
}
for (const cut of replay.cuts) {
  const head = object(cut.path), values = unpacked(cut.values), tip = parts.force.filter(part => within(part, head.parent));
  const own = tip[0].material.color.getHex(), value = () => values[Math.round(now / duration * (values.length - 1)) || 0];
  const shown = () => {
    const large = value() > cut.most * (1 + 1e-6);
    for (const part of tip) part.material.color.setHex(large ? 0xF57C00 : own);
    labels[number].word.textContent = short(value(), cut.unit);
    return large && switches.forces.checked;
  };
  const number = labels.length;
  label("", "size", () => head.getWorldPosition(new Vector3()), shown);
}
function within(thing, parent) {
  while (thing && thing != parent) thing = thing.parent;
  return thing;
}

// Switches, for what there is
const switches = {};
for (const [name, part] of Object.entries({forces: "force", names: "", loops: "loop", traces: "trace", ground: "ground"})) {
  if (part && !parts[part].length) continue;
  const choice = added(element("switches"), "label", {});
  switches[name] = added(choice, "input", {type: "checkbox", id: name, checked: Boolean(part)});
  choice.append(name);
  switches[name].addEventListener("change", () => {
    for (const thing of parts[part] ?? []) thing.visible = switches[name].checked;
    viewer.set_dirty();
  });
}
for (const {color, text, bar} of replay.legend) {
  const entry = added(element("legend"), "div", {});
  added(entry, bar ? "b" : "i", {}).style.background = css(color);
  if (bar) bar.line = entry.firstChild;
  entry.append(bar ? bar.text + ": " + text : text);
}

// Time
const animator = viewer.animator, [start, rate, duration, frames] = replay.clock;
const [play, scrub, speed, again] = ["play", "scrub", "speed", "again"].map(element);
const digits = Math.max(0, Math.min(9, 2 - Math.floor(Math.log10(Math.abs(rate) * Math.min(1, duration || 1)))));
let now = 0, running = duration > 0, drawnAt = performance.now();
for (const action of animator.actions) action.play();
for (const times of [0.1, 0.25, 0.5, 1, 2, 4])
  added(speed, "option", {value: times, textContent: "× " + +(times * Math.abs(rate)).toPrecision(3), selected: times == 1});
again.checked = replay.loop;
element("player").hidden = !duration;
scrub.max = duration;
function seek(time) {
  now = Math.max(0, Math.min(duration, time));
  animator.seek(now);
}
function toggle() {
  if (!running && now == duration) seek(0);
  running = !running;
}
function step(frame) {
  running = false;
  seek(now + frame * duration / (frames - 1));
}
let resume = false;  // after dragging
const hold = () => { resume ||= running; running = false; };
const release = () => { running ||= resume; resume = false; };
scrub.addEventListener("input", () => { hold(); seek(scrub.valueAsNumber); });
scrub.addEventListener("change", release);
play.addEventListener("click", toggle);
element("back").addEventListener("click", () => step(-1));
element("forth").addEventListener("click", () => step(1));
element("reset").addEventListener("click", fit);
document.addEventListener("keydown", event => {
  const act = {" ": toggle, ArrowLeft: () => step(-1), ArrowRight: () => step(1)}[event.key];
  if (!duration || !act || event.target.closest("select, label")) return;  // Enter presses buttons
  event.preventDefault();
  act();
});

// Curves: a group of them over the time, each with its value at the cursor
const COLORS = ["#0072b2", "#d55e00", "#009e73", "#222222", "#cc79a7", "#56b4e9", "#b8a800", "#7e57c2"], SHOWN = 4;
const panel = element("panel"), plot = element("plot"), cursor = element("cursor"), svg = plot.querySelector("svg");
const length = Math.abs(rate) * duration, times = (replay.panel?.times ?? []).map(unpacked);
const curves = [];
let group = null;
for (const each of replay.panel?.groups ?? []) {
  each.curves.forEach((curve, k) => {
    const values = unpacked(curve.y).map(each.name == "step" ? Math.log10 : x => x);
    const at = times[curve.run], finite = values.filter(Number.isFinite).sort();
    let left = 0.05 * length;  // but for a twentieth of the time the curve is within `usual` of zero
    const falling = [...values.keys()].sort((a, b) => Math.abs(values[b]) - Math.abs(values[a]));
    const usual = Math.abs(values[falling.find(row => (left -= (at[row + 1] ?? at[row]) - at[row]) <= 0)]);
    Object.assign(curve, {values, low: finite[0], usual, high: finite[finite.length - 1]});
    Object.assign(curve, {times: at, unit: each.unit, color: COLORS[k % COLORS.length]});
    curves.push(curve);
  });
  const widths = each.curves.map(curve => curve.high - curve.low), least = [...widths].sort((a, b) => b - a)[SHOWN - 1];
  each.curves.forEach((curve, k) => curve.shown = !(widths[k] < least));
  const tab = added(element("groups"), "button", {textContent: each.name, role: "tab"});
  tab.addEventListener("click", () => choose(each, tab));
}
panel.hidden = !replay.panel || !duration;
const header = document.querySelector("header"), {first} = replay;
header.hidden = !replay.panel;
document.body.classList.toggle("bare", !replay.panel);
function choose(chosen, tab) {
  group = chosen;
  for (const each of element("groups").children) each.setAttribute("aria-selected", each == tab);
  element("curves").replaceChildren();
  for (const curve of group.curves) {
    curve.chip = added(element("curves"), "button", {title: "show or hide"});
    added(curve.chip, "i", {}).style.background = curve.color;
    curve.text = curve.chip.appendChild(new Text(worded(curve, Math.abs(rate) * now)));
    curve.chip.addEventListener("click", () => { curve.shown = !curve.shown; draw(); });
  }
  draw();
}
function draw() {
  const shown = group.curves.filter(curve => curve.shown && curve.low <= curve.high), log = group.name == "step";
  let low = Math.min(...shown.map(curve => curve.low)), high = Math.max(...shown.map(curve => curve.high));
  const largest = Math.max(high, -low), usual = 1.5 * Math.max(...shown.map(curve => curve.usual));
  const cut = !log && usual > 0 && largest > 3 * usual;
  if (cut) [low, high] = [Math.max(low, -usual), Math.min(high, usual)];
  if (!(low < high)) [low, high] = shown.length ? [low - (Math.abs(low) || 1) / 2, high + (Math.abs(high) || 1) / 2] : [0, 1];
  const rough = (high - low) / 5, power = 10 ** Math.floor(Math.log10(rough));
  const gap = log ? Math.max(1, Math.round(rough)) : power * [1, 2, 5, 10].find(step => step * power >= rough * 0.999);
  const down = value => (high - value) / (high - low);
  svg.replaceChildren();
  for (const note of plot.querySelectorAll("span")) note.remove();
  const note = (className, textContent, side = "left", share = 0) =>
    added(plot, "span", {className, textContent}).style[side] = 100 * share + "%";
  const path = (lines, color) => {
    const drawn = svg.appendChild(document.createElementNS(svg.namespaceURI, "path"));
    drawn.setAttribute("d", lines);
    drawn.setAttribute(color ? "stroke" : "class", color || "grid");
  };
  for (let k = Math.ceil(low / gap - 1e-9); k * gap <= high + 1e-9 * gap; k++) {
    path(`M0 ${down(k * gap)}H1`);
    note("left", log ? "1e" + k * gap : +(k * gap).toPrecision(6), "top", down(k * gap));
  }
  for (const share of [0, 0.5, 1])
    note("below", +(start + Math.sign(rate) * share * length).toPrecision(6) + " s", "left", share);
  note("above", cut ? `${group.unit}   (peaks to ${short(largest, group.unit)} are cut)` : group.unit);
  for (const {values, times, color} of shown) {
    let lines = "", pen = "M";
    values.forEach((value, k) => {
      if (Number.isFinite(value)) lines += pen + (times[k] / length).toFixed(5) + " " + down(value).toFixed(5);
      pen = Number.isFinite(value) ? "L" : "M";
    });
    path(lines, color);
  }
  for (const curve of group.curves) curve.chip.setAttribute("aria-pressed", curve.shown);
}
function valueAt({values, times}, time) {
  let low = 0, high = times.length - 1;
  while (high - low > 1) {
    const middle = (low + high) >> 1;
    if (times[middle] <= time) low = middle; else high = middle;
  }
  const share = high > low ? Math.max(0, Math.min(1, (time - times[low]) / (times[high] - times[low] || 1))) : 0;
  return share ? values[low] + share * (values[high] - values[low]) : values[low];
}
const amount = (curve, time) => short(curve.unit == "s" ? 10 ** valueAt(curve, time) : valueAt(curve, time), curve.unit);
const worded = (curve, time) => `${curve.name}  ${amount(curve, time)}`;
plot.addEventListener("pointerdown", event => {
  const box = plot.getBoundingClientRect(), go = ({clientX}) => seek((clientX - box.left) / box.width * duration);
  hold();
  go(event);
  plot.setPointerCapture(event.pointerId);
  plot.onpointermove = go;
  plot.onpointerup = plot.onpointercancel = () => { plot.onpointermove = plot.onpointerup = plot.onpointercancel = null; release(); };
});
if (!panel.hidden && replay.panel.groups.length) element("groups").firstChild.click();

// The header: whether to believe it
for (const {text, ok} of replay.verdicts) added(header, "span", {textContent: text, className: ok ? "ok" : "look"});
if (first) {
  added(header, "strong", {textContent: first.wrong, className: "look"});
  added(header, "span", {textContent: first.verdict});
}

// What is under the pointer
const hint = element("hint"), ray = new Raycaster(), pointer = new Vector2();
let under = null;
pane.addEventListener("pointermove", event => {
  const box = pane.getBoundingClientRect();
  pointer.set(2 * (event.clientX - box.left) / box.width - 1, 1 - 2 * (event.clientY - box.top) / box.height);
  ray.setFromCamera(pointer, camera);
  const seen = part => part.visible && part.userData.name != "ground";
  const hit = ["loop", "force", "body"].map(part => ray.intersectObjects(parts[part].filter(seen), false)[0]).find(Boolean);
  under = hit?.object.userData;
  hint.style.transform = `translate(${event.clientX + 14}px, ${event.clientY + 14}px)`;
});
pane.addEventListener("pointerleave", () => under = null);
function described({name, run}, time) {
  const acting = curves.filter(curve => curve.run == run && (curve.of == name || curve.bodies?.includes(name)));
  return [name, ...acting.map(curve => worded(curve, time))].join("\n");
}

function follow(frame) {
  if (running) {
    let next = now + Math.min(0.5, (frame - drawnAt) / 1000) * speed.value;
    if (first && !first.seen && next >= first.stop) {
      first.seen = true;
      running = false;
      next = first.stop;
    }
    if (next >= duration) {
      running = again.checked;
      next = running ? next % duration : duration;
    }
    seek(next);
  }
  drawnAt = frame;
  cursor.style.transform = `translate(${100 * now / (duration || 1)}%, 0)`;
  for (const {word, place, shown} of labels) {
    if (word.hidden = !shown()) continue;
    const seen = place().project(camera);
    word.style.transform = `translate(${(1 + seen.x) / 2 * wide}px, ${(1 - seen.y) / 2 * high}px) translate(-50%, 0)`;
  }
  if (!running || frame > toldAt + TELLING) tell(frame);
  requestAnimationFrame(follow);
}
const TELLING = 100;  // ms; words cost more than the scene
let toldAt = 0, told = "";
function tell(frame) {
  const time = Math.abs(rate) * now, state = [now, running, under, pixels(), group, element("speed").value].join();
  if (state == told && !under) return;
  [toldAt, told] = [frame, state];
  element("time").textContent = "t = " + (start + Math.sign(rate) * time).toFixed(digits) + " s";
  scrub.value = now;
  scrub.setAttribute("aria-valuetext", element("time").textContent);
  play.textContent = running ? "❚❚" : "▶";
  for (const curve of group?.curves ?? []) curve.text.data = worded(curve, time);
  for (const {bar} of replay.legend) if (bar) bar.line.style.width = bar.metres * pixels() + "px";
  hint.hidden = !under;
  if (under) hint.textContent = described(under, time);
}
measure();
seek(0);
requestAnimationFrame(follow);
