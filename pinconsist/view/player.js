// Time
const animator = viewer.animator, [start, rate, duration, frames] = replay.clock, {first} = replay;
const length = Math.abs(rate) * duration, times = (replay.panel?.times ?? []).map(unpacked);  // s
const rows = [...new Set(times.flatMap(each => [...each]))].sort((a, b) => a - b);
const few = replay.panel?.whole && 2 * rows.length <= frames;  // what is between them was not computed
const [play, scrub, speed, again] = ["play", "scrub", "speed", "again"].map(element);
const frame = duration / (frames - 1) || 1, digits = decimals(Math.abs(rate) * frame);
function decimals(step) {  // that tell one step from the next: two of its digits, or up to four where it is round
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
