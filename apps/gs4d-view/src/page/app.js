"use strict";
// The beginning, the address, and the clock of the page.
// The address keeps the view; browsers slow pages down that change it too often.
let saving = null;
function save() { saving ??= setTimeout(() => { saving = null; keep(); }, 300); }
function keep() {
  const short = (list) => list.map((v) => +v.toFixed(5));
  const now = { e: short(state.eye), g: short(state.target), u: short(state.up), f: +state.fov.toFixed(4), t: state.t, v: state.view, a: state.a, b: state.b, c: state.compare, w: state.cut, n: state.gain, s: state.cameras, r: state.arrows, x: state.axes, l: state.grid, d: state.style, z: state.size, k: state.back, h: state.hidden, p: state.pose };
  history.replaceState(null, "", location.search + "#" + encodeURIComponent(JSON.stringify(now)));
}
function restore() {
  try {
    const k = JSON.parse(decodeURIComponent(location.hash.slice(1)));
    const known = (p) => Array.isArray(p) && shows[p[0]] && typeof p[1] === "string" && Number.isInteger(p[2]);
    if (![k.e, k.g, k.u].every((v) => Array.isArray(v) && v.length === 3 && v.every(Number.isFinite)) || ![k.f, k.t].every(Number.isFinite) || !known(k.a)) return false;
    Object.assign(state, { eye: k.e, target: k.g, up: k.u, fov: k.f, t: k.t, view: shows[k.a[0]].views[k.v] ? k.v : -1, a: k.a, b: known(k.b) ? k.b : state.b, compare: ["wipe", "difference", "flicker"].includes(k.c) ? k.c : "", cut: Number(k.w), gain: Number(k.n) || 4, cameras: !!k.s, arrows: !!k.r, axes: !!k.x, grid: !!k.l });
    if (["ellipsoids", "points"].includes(k.d)) state.style = k.d;
    if (k.z >= 1 && k.z <= 16) state.size = Number(k.z);
    if (Array.isArray(k.k) && k.k.length === 3 && k.k.every((v) => v >= 0 && v <= 1)) state.back = k.k;
    if (Array.isArray(k.h)) state.hidden = k.h;
    if (k.p && k.p.turns && typeof k.p.turns === "object") state.pose = { from: Number.isFinite(k.p.from) ? k.p.from : null, turns: k.p.turns };
    return true;
  } catch { return false; }
}
function begin(message) {
  const first = !shows.length;
  shows = message.shows;
  notice("");
  if (message.news) news(message.news);
  if (message.paused !== undefined) showPaused(message.paused);
  if (!first) { layers(); again(); return; }
  document.title = `gs4d · ${shows.map((s) => s.name).join(", ")}`;
  state.b = [shows.length > 1 ? 1 : 0, shows[0].layers.includes("truth") && shows.length === 1 ? "truth" : "color", -1];
  const known = restore();
  for (const side of ["a", "b"]) options($("show-" + side), shows.map((s, k) => [k, s.name]), state[side][0]);
  for (const name of ["gain", "size"]) $(name).value = state[name];
  for (const name of ["cameras", "arrows", "axes", "grid"]) $(name).checked = state[name];
  if (innerWidth <= 720) fold(true);
  $("selecting").open = state.hidden.length > 0;
  showAll(); loadBookmarks(); showPath();
  // A view within the training span, if there is one: before and after it everything is extrapolated.
  const s = about(), within = s.views.findIndex((v) => v.time >= s.times[0] && v.time <= END());
  if (known) changed(); else if (s.views.length) snap(Math.max(0, within)); else frameScene();
}
function tick() {
  setTimeout(tick, 15);
  const now = performance.now();
  if (shows.length) { advance(now); flyOn(now); settle(); }
}
new ResizeObserver(() => { if (!shows.length) return; timeline(); again(); place(); }).observe(stage);
open();
tick();
