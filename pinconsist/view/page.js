const replay = JSON.parse(document.getElementById("replay").textContent);
const [notes, time, play, scrub] = ["notes", "time", "play", "scrub"].map(id => document.getElementById(id));
for (const note of replay.legend) {
  const entry = notes.appendChild(document.createElement("div"));
  entry.appendChild(document.createElement("i")).style.background = "#" + note.color.toString(16).padStart(6, "0");
  entry.append(note.text);
}
var viewer = new MeshCat.Viewer(document.getElementById("meshcat-pane"));
for (const command of replay.commands) viewer.handle_command(command);
const pane = viewer.dom_element, target = viewer.controls.target.set(...replay.target);
viewer.set_3d_pane_size = () =>  // the window's by default
  MeshCat.Viewer.prototype.set_3d_pane_size.call(viewer, pane.offsetWidth, pane.offsetHeight);
let back = 1;
function fit() {
  viewer.set_3d_pane_size();
  const before = back;
  back = Math.max(1, replay.aspect * pane.offsetHeight / pane.offsetWidth);
  viewer.camera.position.sub(target).multiplyScalar(back / before).add(target);
}
fit();
window.addEventListener("resize", fit);
viewer.gui.__folders["Scene"].close();

const animator = viewer.animator, toggle = () => animator.playing ? animator.pause() : animator.play();
const [start, rate, duration] = replay.clock;
const digits = Math.max(0, Math.min(9, 2 - Math.floor(Math.log10(Math.abs(rate) * Math.min(1, duration || 1)))));
const pace = Math.abs(rate) == 1 ? "" : "  (speed × " + Math.abs(rate) + ")";
const titles = replay.titles.map(title => {
  const element = document.body.appendChild(document.createElement("div"));
  element.className = "run";
  element.textContent = title.text;
  return {at: title.at, element};
});
play.hidden = scrub.hidden = !duration;
scrub.max = duration;
scrub.addEventListener("input", () => { animator.pause(); animator.seek(scrub.valueAsNumber); });
play.addEventListener("click", toggle);
document.addEventListener("keydown", event => {
  if (!duration || event.key != " " || event.target.closest("button, .dg")) return;
  event.preventDefault();
  toggle();
});
const place = target.clone(), canvas = viewer.renderer.domElement;
function follow() {
  const played = animator.actions.reduce((latest, action) => Math.max(latest, action.time), 0);
  time.textContent = "t = " + (start + rate * Math.min(played, duration)).toFixed(digits) + " s" + pace;
  scrub.value = played;
  scrub.setAttribute("aria-valuetext", time.textContent);
  play.textContent = animator.playing ? "❚❚" : "▶";
  for (const title of titles) {
    place.set(...title.at).project(viewer.camera);
    const x = (1 + place.x) / 2 * canvas.clientWidth, y = (1 - place.y) / 2 * canvas.clientHeight;
    title.element.style.transform = `translate(${x}px, ${y}px) translate(-50%, 0)`;
  }
  requestAnimationFrame(follow);
}
follow();
