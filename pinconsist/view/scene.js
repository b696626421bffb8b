const replay = JSON.parse(document.getElementById("replay").textContent);
const element = id => document.getElementById(id);
const added = (parent, kind, properties) => Object.assign(parent.appendChild(document.createElement(kind)), properties);
const unpacked = text => new Float32Array(Uint8Array.from(atob(text), letter => letter.charCodeAt(0)).buffer);
const css = color => "#" + color.toString(16).padStart(6, "0");
function prefixed(size, unit) {  // factor and prefix of large forces
  if (!["N", "N·m", "J"].includes(unit) || size < 1e4) return [1, ""];
  return size < 1e7 ? [1e3, "k"] : [1e6, "M"];
}
function short(number, unit) {
  const [scale, prefix] = prefixed(Math.abs(number), unit), value = +(number / scale).toPrecision(3);
  return (value && Math.abs(value) < 1e-3 ? value.toExponential() : value) + " " + prefix + unit;
}

// The scene
const {Vector2, Vector3, Raycaster, PerspectiveCamera, OrthographicCamera} = MeshCat.THREE;
const pane = element("meshcat-pane"), viewer = new MeshCat.Viewer(pane);
for (const command of replay.commands) viewer.handle_command(command);
viewer.set_3d_pane_size = () =>  // by default that of the window
  MeshCat.Viewer.prototype.set_3d_pane_size.call(viewer, wide, high);
const object = path => viewer.scene_tree.find(path.split("/").filter(Boolean)).object;
const parts = {force: [], "joint force": [], loop: [], contact: [], trace: [], ground: [object("/Axes")], body: []};
viewer.scene.traverse(thing => parts[thing.userData.part]?.push(thing));

// The camera shows all points of the outline; margins are relative to the pane
const VIEW = 40, MARGIN = 1.12;  // degrees
const {planar, size} = replay.view, points = replay.view.points.map(place => new Vector3(...place));
const [right, up, back] = replay.view.axes.map(axis => new Vector3(...axis));
viewer.controls.dispose();
viewer.set_camera(planar ? new OrthographicCamera() : new PerspectiveCamera(VIEW));
const camera = viewer.camera, target = viewer.controls.target;
let moved = false, wide, high;  // size of the pane, pixels
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
let before = null;  // the view when a finger touched it; restored if the gesture scrolls the page
pane.addEventListener("pointerdown", () => before = camera.position.clone());
pane.addEventListener("pointercancel", () => {
  camera.position.copy(before);
  viewer.controls.update();
  viewer.set_dirty();
});
const pixels = () => high / 2 * (planar  // pixels per metre
  ? camera.zoom / camera.top : 1 / (Math.tan(VIEW / 360 * Math.PI) * camera.position.distanceTo(target)));
function measure() {
  [wide, high] = [pane.clientWidth, pane.clientHeight];
  if (moved) viewer.set_3d_pane_size(); else fit();
}
new ResizeObserver(measure).observe(pane);

function tint(thing, color) {
  if (!thing.material || thing.material.color.getHex() == color) return;
  thing.material.color.setHex(color);
  viewer.set_dirty();  // the frame may be drawn already
}

// Labels over the scene
const labels = [];
function label(text, kind, place, shown = () => true) {
  labels.push({word: added(pane, "div", {className: "label " + kind, textContent: text}), kind, place, shown});
}
for (const {text, at} of replay.titles) label(text, "title", () => new Vector3(...at));
for (const cut of replay.cuts) {
  const head = object(cut.path), values = unpacked(cut.values), tip = parts[cut.part].filter(part => within(part, head.parent));
  const own = tip[0].material.color.getHex(), value = () => values[Math.round(now / duration * (values.length - 1)) || 0];
  const shown = () => {
    const large = value() > cut.most * (1 + 1e-6);
    for (const part of tip) tint(part, large ? 0xF57C00 : own);
    labels[number].word.textContent = short(value(), cut.unit);
    return large && switches[cut.part + "s"].checked;
  };
  const number = labels.length;
  label("", "size", () => head.getWorldPosition(new Vector3()), shown);
}
const named = new Map();  // the shapes of each loop and body that has a name
const lights = replay.lights.map(({path, states}) => ({thing: object(path), states: unpacked(states)}));
function light() {  // contacts in the colours of what they do
  for (const {thing, states} of lights) {
    const color = replay.lit[states[Math.round(now / duration * (states.length - 1)) || 0]];
    thing.traverse(each => tint(each, color));
  }
}
for (const thing of [...parts.loop, ...parts.contact, ...parts.body]) {
  const {part, name, run, bare} = thing.userData, key = JSON.stringify([part, run, name]);
  if (bare || named.get(key)?.push(thing)) continue;
  const its = [thing];
  named.set(key, its);
  label(name, "name", () => middle(part == "body" ? its : [thing]), () => switches.names.checked);
}
function middle(things) {
  const sum = new Vector3();
  for (const thing of things) {
    if (!thing.geometry.boundingSphere) thing.geometry.computeBoundingSphere();
    thing.updateWorldMatrix(true, false);
    sum.add(thing.geometry.boundingSphere.center.clone().applyMatrix4(thing.matrixWorld));
  }
  return sum.divideScalar(things.length);
}
function within(thing, parent) {
  while (thing && thing != parent) thing = thing.parent;
  return thing;
}

// Switches, only for existing parts
const switches = {};
for (const [name, part] of Object.entries({forces: "force", "joint forces": "joint force", names: "", loops: "loop", contacts: "contact", traces: "trace", ground: "ground"})) {
  if (part && !parts[part].length) continue;
  const choice = added(element("switches"), "label", {});
  const checked = Boolean(part) && !(name == "joint forces" && parts.force.length);  // not too many arrows at first
  switches[name] = added(choice, "input", {type: "checkbox", id: name, checked});
  choice.append(name);
  const show = () => {
    for (const thing of parts[part] ?? []) thing.visible = switches[name].checked;
    viewer.set_dirty();
  };
  switches[name].addEventListener("change", show);
  show();
}
for (const {color, text, bar} of replay.legend) {
  const entry = added(element("legend"), "div", {});
  added(entry, bar ? "b" : "i", {}).style.background = css(color);
  if (bar) bar.line = entry.firstChild;
  entry.append(bar ? bar.text + ": " + text : text);
}

// Time
const animator = viewer.animator, [start, rate, duration, frames] = replay.clock, {first} = replay;
const length = Math.abs(rate) * duration, times = (replay.panel?.times ?? []).map(unpacked);  // s
const rows = [...new Set(times.flatMap(each => [...each]))].sort((a, b) => a - b);
const few = replay.panel?.whole && 2 * rows.length <= frames;  // states between the rows were not computed
const [play, scrub, speed, again] = ["play", "scrub", "speed", "again"].map(element);
const frame = duration / (frames - 1) || 1, digits = decimals(Math.abs(rate) * frame);
function decimals(step) {  // enough to tell successive steps apart: two digits of the step, or up to four if it is then round
  const first = -Math.floor(Math.log10(step)), round = places => Math.abs(step * 10 ** places % 1 - 0.5) > 0.4999;
  const enough = [0, 1, 2, 3].map(more => first + more).find(round) ?? first + 1;
  return Math.max(0, Math.min(9, enough));
}
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
function step(way) {  // by a frame, or to the next computed row
  running = false;
  const next = rows.map(time => time / Math.abs(rate)).filter(time => way * (time - now) > frame / 10);
  seek(few ? next.at(way > 0 ? 0 : -1) ?? now : now + way * frame);
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
