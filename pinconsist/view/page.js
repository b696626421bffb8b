// The header: the verdict
const header = document.querySelector("header");
header.hidden = !replay.panel;
for (const {text, ok} of replay.verdicts) added(header, "span", {textContent: text, className: ok ? "ok" : "look"});
if (first) {
  added(header, "strong", {textContent: first.wrong, className: first.ok ? "ok" : "look"});
  added(header, "span", {textContent: first.verdict});
}

// What is under the pointer
const hint = element("hint"), ray = new Raycaster(), pointer = new Vector2();
let under = null, place = [0, 0];
function look(event) {
  const box = pane.getBoundingClientRect();
  pointer.set(2 * (event.clientX - box.left) / box.width - 1, 1 - 2 * (event.clientY - box.top) / box.height);
  ray.setFromCamera(pointer, camera);
  const seen = part => part.visible && part.userData.name != "ground";
  const hit = ["loop", "force", "body"].map(part => ray.intersectObjects(parts[part].filter(seen), false)[0]).find(Boolean);
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
  for (const {word, place, shown} of labels) {
    if (word.hidden = !shown()) continue;
    const seen = place().project(camera);
    word.style.transform = `translate(${(1 + seen.x) / 2 * wide}px, ${(1 - seen.y) / 2 * high}px) translate(-50%, 0)`;
  }
  if (!running || frame > toldAt + TELLING) tell(frame);
  requestAnimationFrame(follow);
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
