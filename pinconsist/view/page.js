// Curves: a group of them over time, each with its value at the cursor
const COLORS = ["#0072b2", "#d55e00", "#009e73", "#222222", "#cc79a7", "#56b4e9", "#b8a800", "#7e57c2"], SHOWN = 4;
const FORCES = ["N", "N·m"];  // units whose curves tell their peaks
const panel = element("panel"), plot = element("plot"), cursor = element("cursor"), svg = plot.querySelector("svg");
const curves = [];
let group = null;
for (const each of replay.panel?.groups ?? []) {
  if (first) each.curves.sort((a, b) => (b.of == first.of) - (a.of == first.of));  // those of the compared loop first
  each.curves.forEach((curve, k) => {
    const values = unpacked(curve.y).map(each.name == "step" ? Math.log10 : x => x);
    const at = times[curve.run], finite = values.filter(Number.isFinite).sort();
    let left = 0.05 * length;  // in all but 5 % of the time, the curve is within `usual` of zero
    const falling = [...values.keys()].sort((a, b) => Math.abs(values[b]) - Math.abs(values[a]));
    const usual = Math.abs(values[falling.find(row => (left -= (at[row + 1] ?? at[row]) - at[row]) <= 0)]);
    Object.assign(curve, {values, low: finite[0], usual, high: finite[finite.length - 1]});
    Object.assign(curve, {times: at, unit: each.unit, true: "color" in curve});
    const own = curve.color ?? (first && curve.of == first.of ? first.colors[curve.run] : null);
    curve.color = own == null ? COLORS[k] ?? `hsl(${Math.round(137.5 * k) % 360}, 60%, ${[38, 52][k % 2]}%)` : css(own);
    const largest = values.reduce((best, value, row) => Math.abs(value) > Math.abs(values[best]) ? row : best, 0);
    curve.peak = FORCES.includes(each.unit) ? [values[largest], at[largest]] : null;
    curves.push(curve);
  });
  const widths = each.curves.map(curve => curve.high - curve.low), least = [...widths].sort((a, b) => b - a)[SHOWN - 1];
  const compared = each.curves.some(curve => curve.true);
  each.curves.forEach((curve, k) => curve.shown = compared ? curve.of == first.of : !(widths[k] < least));
  const tab = added(element("groups"), "button", {textContent: each.name, role: "tab"});
  tab.addEventListener("click", () => choose(each, tab));
}
panel.hidden = !replay.panel || !duration;
document.body.classList.toggle("bare", !replay.panel);
function choose(chosen, tab) {
  group = chosen;
  for (const each of element("groups").children) each.setAttribute("aria-selected", each == tab);
  element("curves").replaceChildren();
  for (const curve of group.curves) {
    curve.chip = added(element("curves"), "button", {title: "show or hide"});
    added(curve.chip, "i", {}).style.background = curve.color;
    curve.text = curve.chip.appendChild(new Text(worded(curve, Math.abs(rate) * now)));
    curve.chip.append(" ");
    if (curve.peak) added(curve.chip, "small", {textContent: peak(curve)});
    curve.chip.addEventListener("click", () => { curve.shown = !curve.shown; draw(); });
  }
  element("shared").hidden = !group.curves.some(curve => curve.shared);
  draw();
}
function draw() {
  const shown = group.curves.filter(curve => curve.shown && curve.low <= curve.high), log = group.name == "step";
  let low = Math.min(...shown.map(curve => curve.low)), high = Math.max(...shown.map(curve => curve.high));
  const largest = Math.max(high, -low), usual = 1.5 * Math.max(...shown.map(curve => curve.usual));
  const cut = !log && usual > 0 && largest > 3 * usual;
  if (cut) [low, high] = [Math.max(low, -usual), Math.min(high, usual)];
  if (log) [low, high] = [Math.floor(low), Math.ceil(high)];  // whole decades, at least one
  if (!(low < high)) [low, high] = shown.length ? [low - (Math.abs(low) || 1) / 2, high + (Math.abs(high) || 1) / 2] : [0, 1];
  const spare = log ? 0 : 0.04 * (high - low);
  [low, high] = [low - spare, high + spare];
  const rough = (high - low) / 5, power = 10 ** Math.floor(Math.log10(rough));
  const gap = log ? Math.max(1, Math.round(rough)) : power * [1, 2, 5, 10].find(step => step * power >= rough * 0.999);
  const [scale, prefix] = prefixed(Math.max(Math.abs(low), Math.abs(high)), group.unit);
  const down = value => (high - value) / (high - low);
  svg.replaceChildren();
  svg.style.overflow = cut ? "hidden" : "visible";
  for (const note of plot.querySelectorAll("span")) note.remove();
  const note = (className, textContent, side = "left", share = 0) =>
    added(plot, "span", {className, textContent}).style[side] = 100 * share + "%";
  const path = (lines, name, color = "") => {
    const drawn = svg.appendChild(document.createElementNS(svg.namespaceURI, "path"));
    for (const [key, value] of Object.entries({d: lines, class: name, stroke: color})) drawn.setAttribute(key, value);
  };
  for (let k = Math.ceil(low / gap - 1e-9); k * gap <= high + 1e-9 * gap; k++) {
    path(`M0 ${down(k * gap)}H1`, "grid");
    note("left", log ? "1e" + k * gap : +(k * gap / scale).toPrecision(6), "top", down(k * gap));
  }
  for (const share of [0, 0.5, 1])
    note("below", +(start + Math.sign(rate) * share * length).toPrecision(6) + " s", "left", share);
  note("above", cut ? `${prefix}${group.unit}   (peaks to ${short(largest, group.unit)} are cut)` : prefix + group.unit);
  for (const {values, times, color} of shown) {
    let lines = "", dots = "", pen = "M";
    values.forEach((value, k) => {
      const here = (times[k] / length).toFixed(5) + " " + down(value).toFixed(5), there = Number.isFinite(value);
      if (there) [lines, dots] = [lines + pen + here, dots + `M${here}h0`];
      pen = there ? "L" : "M";
    });
    path(lines, "curve", color);
    if (few) path(dots, "dots", color);
  }
  for (const curve of group.curves) curve.chip.setAttribute("aria-pressed", curve.shown);
  element("more").hidden = group.curves.every(curve => curve.shown);
}
function valueAt({values, times}, time) {
  const high = times.findIndex(each => each > time), low = (high < 0 ? times.length : high || 1) - 1;
  const share = high > low ? Math.max(0, (time - times[low]) / (times[high] - times[low])) : 0;
  return share ? values[low] + share * (values[high] - values[low]) : values[low];
}
const amount = (curve, time) => short(curve.unit == "s" ? 10 ** valueAt(curve, time) : valueAt(curve, time), curve.unit);
const worded = (curve, time) => `${curve.name}: ${amount(curve, time)}`;
const peak = ({peak, unit}) => `peak ${short(peak[0], unit)} at ${+(start + Math.sign(rate) * peak[1]).toPrecision(4)} s`;
plot.addEventListener("pointerdown", event => {
  const box = plot.getBoundingClientRect(), go = ({clientX}) => seek((clientX - box.left) / box.width * duration);
  hold();
  go(event);
  plot.setPointerCapture(event.pointerId);
  plot.onpointermove = go;
  plot.onpointerup = plot.onpointercancel = () => { plot.onpointermove = plot.onpointerup = plot.onpointercancel = null; release(); };
});
if (!panel.hidden && replay.panel.groups.length) element("groups").firstChild.click();

// The header: the verdict
const header = document.querySelector("header");
header.hidden = !replay.panel;
for (const {text, ok} of replay.verdicts) added(header, "span", {textContent: text, className: ok ? "ok" : "look"});
if (first) {
  added(header, "strong", {textContent: first.wrong, className: first.ok ? "ok" : "look"});
  added(header, "span", {textContent: first.verdict});
}
for (const textContent of replay.panel?.notes ?? []) added(element("panel"), "div", {className: "aside look", textContent});

// What is under the pointer
const hint = element("hint"), ray = new Raycaster(), pointer = new Vector2();
let under = null, place = [0, 0];
function look(event) {
  const box = pane.getBoundingClientRect();
  pointer.set(2 * (event.clientX - box.left) / box.width - 1, 1 - 2 * (event.clientY - box.top) / box.height);
  ray.setFromCamera(pointer, camera);
  const seen = part => part.visible && part.userData.name != "ground";
  const hit = ["loop", "contact", "force", "joint force", "body"].map(part => ray.intersectObjects(parts[part].filter(seen), false)[0]).find(Boolean);
  under = hit?.object.userData;
  place = [event.clientX - box.left, event.clientY - box.top];
}
pane.append(hint);
for (const kind of ["pointermove", "pointerdown"]) pane.addEventListener(kind, look);  // a finger can only tap
pane.addEventListener("pointerleave", event => { if (event.pointerType != "touch") under = null; });
function described({name, run, part}, time) {
  const here = curves.filter(curve => curve.run == run || curve.true);
  const acting = here.filter(curve => curve.of == name || curve.bodies?.includes(name));
  return [...(part == "body" || !acting.length ? [name] : []), ...acting.map(curve => worded(curve, time))].join("\n");
}
function show(words) {  // next to the pointer, within the pane
  hint.textContent = words;
  const [x, y] = place, [across, down] = [hint.offsetWidth, hint.offsetHeight];
  const left = Math.max(0, Math.min(x + 14, wide - across)), below = y + 14 + down <= high;
  hint.style.transform = `translate(${left}px, ${Math.max(0, below ? y + 14 : y - 14 - down)}px)`;
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
  light();
  arrange();
  if (!running || frame > toldAt + TELLING) tell(frame);
  requestAnimationFrame(follow);
}
const AWAY = 3;  // a name that has no room within so many heights of its thing is left out
function arrange() {  // no label covers another
  const taken = [];
  for (const {word, kind, place, shown} of labels) {
    word.hidden = !shown();
    if (word.hidden) continue;
    const seen = place().project(camera), across = word.offsetWidth, tall = word.offsetHeight;
    const x = Math.max(across / 2, Math.min(wide - across / 2, (1 + seen.x) / 2 * wide));
    const home = Math.max(0, Math.min(high - tall, (1 - seen.y) / 2 * high));
    const beside = taken.filter(box => Math.abs(box.x - x) < (box.across + across) / 2);
    const free = y => y >= 0 && y <= high - tall && !beside.some(box => y < box.y + box.tall && box.y < y + tall);
    const rooms = [home, ...beside.flatMap(box => [box.y + box.tall, box.y - tall])].filter(free);
    rooms.sort((a, b) => Math.abs(a - home) - Math.abs(b - home));
    const y = rooms[0] ?? home;
    word.hidden = kind == "name" && (!rooms.length || Math.abs(y - home) > AWAY * tall);
    if (word.hidden) continue;
    taken.push({x, y, across, tall});
    word.style.transform = `translate(${x}px, ${y}px) translate(-50%, 0)`;
  }
}
const TELLING = 100;  // ms; updates of texts cost more than the scene
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
  if (under) show(described(under, time));
}
measure();
seek(0);
requestAnimationFrame(follow);
