"use strict";
// Saved images, cameras for `gs4d render`, bookmarks, and a camera path.
let flight = [], flying = null, bookmarks = [];
function saveImage() {
  const choice = $("picture-size").value, [w, h] = choice.split("x").map(Number), now = size(REST);
  const factor = h ? 1 : Math.min(w, Math.sqrt(MOST / (now.width * now.height))), question = h ? { width: w, height: h } : { width: Math.floor(now.width * factor), height: Math.floor(now.height * factor) };
  if (state.style === "points") question.style = { points: pointSize(question, Infinity) };
  file = { save: "image", fine: true, ...question };
  pump();
}
// The camera shown, as an entry of a file for `gs4d render --camera`.
function cameraEntry(name = "view") {
  const v = about().views[state.view], s = size(REST), c = v ? cameraOf(v.width, v.height) : cameraOf(s.width, s.height), m = c.viewmat;
  return { name, width: c.width, height: c.height, fx: c.fx, fy: c.fy, cx: c.cx, cy: c.cy, time: +state.t.toFixed(5), world_to_camera: [m.slice(0, 4), m.slice(4, 8), m.slice(8, 12), [0, 0, 0, 1]] };
}
async function copyCamera() {
  const text = JSON.stringify(cameraEntry());
  try { await navigator.clipboard.writeText(text); $("status").textContent = "camera copied: paste it into a file for gs4d render --camera FILE"; } catch { download("camera.json", new TextEncoder().encode(text)); }
}
const shot = () => ({ eye: [...state.eye], target: [...state.target], up: [...state.up], fov: stageFov(), t: state.t, forward: forward(), width: stage.clientWidth, height: stage.clientHeight });
function goTo(s) { leaveView(); Object.assign(state, { eye: [...s.eye], target: [...s.target], up: [...s.up], fov: s.fov, t: s.t }); $("t").value = state.t; showTime(); showFov(); changed(); }
function list(id, items, drop) {
  $(id).replaceChildren(...items.map((item, k) => {
    const li = document.createElement("li"), go = document.createElement("button"), away = document.createElement("button");
    go.textContent = `${k + 1} · ${ownTime(item.t) || item.t.toFixed(3)}`; away.textContent = "×"; away.setAttribute("aria-label", `Remove ${k + 1}`);
    go.addEventListener("click", () => goTo(item)); away.addEventListener("click", () => drop(k));
    li.append(go, away);
    return li;
  }));
}
const store = () => `gs4d ${shows.map((s) => s.name).join("|")}`;
function showBookmarks() {
  list("marks", bookmarks, (k) => { bookmarks.splice(k, 1); showBookmarks(); });
  try { localStorage.setItem(store(), JSON.stringify(bookmarks)); } catch { /* a browser that keeps nothing */ }
}
function loadBookmarks() {
  try { bookmarks = JSON.parse(localStorage.getItem(store())) || []; } catch { bookmarks = []; }
  list("marks", bookmarks, (k) => { bookmarks.splice(k, 1); showBookmarks(); });
}
function addBookmark() { bookmarks.push(shot()); showBookmarks(); }
function showPath() {
  list("keys", flight, (k) => { flight.splice(k, 1); showPath(); });
  if (flight.length < 2) flying = null;
  for (const id of ["fly", "save-path", "clear-path"]) $(id).disabled = flight.length < (id === "clear-path" ? 1 : 2);
  $("path-help").hidden = flight.length < 2;
  lines();
}
function addKey() { flight.push({ ...shot(), entry: cameraEntry(`key-${flight.length}`) }); showPath(); }
// A preview of the path in four seconds, straight from key to key; `gs4d render` goes in a smooth curve.
function fly() { flying = flying ? null : { begun: performance.now() }; if (!flying) changed(); }
function flyOn(now) {
  if (!flying) return;
  const share = (now - flying.begun) / 4000, at = Math.min(share, 1) * (flight.length - 1), k = Math.min(flight.length - 2, Math.floor(at)), w = at - k, [p, q] = [flight[k], flight[k + 1]];
  const mix = (a, b) => (Array.isArray(a) ? a.map((v, i) => v + w * (b[i] - v)) : a + w * (b - a));
  goTo({ eye: mix(p.eye, q.eye), target: mix(p.target, q.target), up: unit(mix(p.up, q.up)), fov: mix(p.fov, q.fov), t: mix(p.t, q.t) });
  if (share >= 1) { flying = null; lines(); }
}
$("save-image").addEventListener("click", saveImage);
$("copy").addEventListener("click", copyCamera);
$("mark").addEventListener("click", addBookmark);
$("add-key").addEventListener("click", addKey);
$("fly").addEventListener("click", fly);
$("save-path").addEventListener("click", () => download("path.json", new TextEncoder().encode(JSON.stringify(flight.map((k) => k.entry), null, 1))));
$("clear-path").addEventListener("click", () => { flight = []; showPath(); });

// All shows there are, also those that another page added.
function listShows(all) {
  const added = all.slice(shows.length).map((s) => s.name);
  shows = all;
  if (added.length) $("status").textContent = `new under Show: ${added.join(", ")}`;
  for (const side of ["a", "b"]) options($("show-" + side), shows.map((s, k) => [k, s.name]), state[side][0]);
}

// Files that are dropped become shows. What is refused stays readable for a while.
let refusedUntil = 0;
async function dropped(files) {
  const refused = [];
  for (const one of files) {
    notice(`Reading ${one.name} …`);
    try {
      const answer = await fetch(`drop?k=${encodeURIComponent(key)}&name=${encodeURIComponent(one.name)}`, { method: "POST", body: one });
      if (!answer.ok) { refused.push(`${one.name}: ${await answer.text()}`); continue; }
      const { number, shows: all } = await answer.json();
      listShows(all);
      $("show-a").value = number; $("show-a").dispatchEvent(new Event("change"));
      frameScene();
    } catch (e) { refused.push(`${one.name} cannot be sent: ${e.message}`); }
  }
  if (refused.length) { notice(refused.join(" · ")); refusedUntil = performance.now() + 8000; } else notice("");
}
for (const kind of ["dragover", "dragleave", "drop"]) document.addEventListener(kind, (e) => {
  e.preventDefault();
  $("drop").hidden = kind !== "dragover";
  if (kind === "drop") dropped(e.dataTransfer.files);
});
