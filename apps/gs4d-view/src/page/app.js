"use strict";
// The panel, time, the address, and input.
const LAST = 1.25; // end of the slider, in training spans
let lastTick = 0, drag = null, thumbs = [], front = "a";

function options(select, items, value) {
  select.replaceChildren(...items.map(([v, text]) => { const o = document.createElement("option"); o.value = v; o.textContent = text; return o; }));
  select.value = value;
}
const steps = (show) => [[-1, training && show === 0 ? "now" : "the end"], ...shows[show].checkpoints.map((s) => [s, `step ${s}`])];
function layers() {
  for (const side of ["a", "b"]) {
    const [show, , step] = state[side], all = shows[show].layers.filter((l) => l !== "truth" || state.view >= 0);
    if (!all.includes(state[side][1])) state[side][1] = "color";
    if (!steps(show).some(([s]) => s === step)) state[side][2] = -1;
    options($("layer-" + side), all.map((l) => [l, l]), state[side][1]);
    options($("step-" + side), steps(show), state[side][2]);
    $("step-" + side).parentElement.hidden = !shows[show].checkpoints.length;
  }
}
function views() {
  if (!about().views[state.view]) state.view = -1;
  options($("view"), [[-1, "free"], ...about().views.map((v, k) => [k, v.name])], state.view);
  strip();
}
// Up to two dozen views as thumbnails, fetched while nothing else is to do.
function strip() {
  $("thumbs").hidden = !(state.cameras && about().views.length);
  const n = about().views.length, count = $("thumbs").hidden || !about().layers.includes("truth") ? 0 : Math.min(24, n);
  thumbs = Array.from({ length: count }, (_, k) => ({ number: Math.floor((k * n) / count), canvas: document.createElement("canvas"), asked: false }));
  $("thumbs").replaceChildren(...thumbs.map((t) => {
    const b = document.createElement("button");
    b.title = about().views[t.number].name; b.setAttribute("aria-label", "camera " + b.title);
    b.append(t.canvas);
    b.addEventListener("click", () => snap(t.number));
    return b;
  }));
}
function place() {
  if (!shows.length) return;
  const c = $("a").getBoundingClientRect(), s = stage.getBoundingClientRect(), wipe = state.compare === "wipe", flicker = state.compare === "flicker";
  $("b").hidden = !(wipe || (flicker && front === "b"));
  $("wipe").hidden = $("wiping").hidden = !wipe;
  $("gaining").hidden = state.compare !== "difference";
  $("swap").hidden = !flicker;
  $("second").hidden = !state.compare;
  $("label-b").hidden = !wipe;
  $("b").style.clipPath = wipe ? `inset(0 0 0 ${100 * state.cut}%)` : "";
  $("wipe").style.left = c.left - s.left + c.width * state.cut + "px";
  const label = (side) => `${shows[state[side][0]].name} · ${state[side][2] >= 0 ? `step ${state[side][2]} · ` : ""}${state[side][1]}`;
  $("label-a").textContent = state.compare === "difference" ? `${label("a")} − ${label("b")}` : label(flicker ? front : "a");
  $("label-b").textContent = label("b");
  $("unhide").hidden = !state.hidden.length;
  lines();
}
function swap() {
  if (state.compare !== "flicker") { $("compare").value = state.compare = "flicker"; changed(); }
  front = front === "a" ? "b" : "a";
  place();
}

// Time.
// The data's own time, seconds unless it lies in 0..1, where files have no unit; else the normalised time alone.
function ownTime(t) {
  const clock = about().clock;
  if (!clock) return "";
  return `${(clock[0] + t * (clock[1] - clock[0])).toFixed(2)}${clock[0] >= 0 && clock[1] <= 1 ? "" : " s"}`;
}
function showTime() {
  const last = about().times[about().times.length - 1], own = ownTime(state.t);
  $("seconds").textContent = `${own ? `${own}  (${state.t.toFixed(3)})` : state.t.toFixed(3)}${state.t > last + 1e-6 ? " future" : ""}`;
}
function timeline() {
  const s = about(), last = s.times[s.times.length - 1];
  $("time").hidden = !s.moving;
  for (const e of document.querySelectorAll(".moving")) e.hidden = !s.moving;
  $("future").style.width = 100 * Math.max(0, 1 - last / LAST) + "%";
  $("marks").replaceChildren(...s.times.map((t) => { const i = document.createElement("i"); i.style.left = (100 * t) / LAST + "%"; return i; }));
  showTime();
}
function setTime(t) { state.t = t; $("t").value = t; showTime(); changed(); }
function play(on) { playing = on; $("play").textContent = on ? "Pause" : "Play"; lastTick = performance.now(); if (!on) changed(); }
function tick() {
  const now = performance.now();
  if (playing && !busy && sides.a.want === null) {
    let t = state.t + ((now - lastTick) / 1000 / Math.max(about().seconds, 0.5)) * Number($("speed").value);
    lastTick = now;
    if (t > LAST) { if (!$("loop").checked) play(false); t = $("loop").checked ? 0 : LAST; }
    setTime(t);
  }
  settle();
  setTimeout(tick, 15);
}

// A person's pose.
function figure() {
  const joints = about().joints;
  $("figure").hidden = !joints;
  if (!joints) return;
  options($("joint"), joints.map((n, k) => [k, n || `joint ${k}`]), $("joint").value || 0);
  const angles = state.pose.turns[$("joint").value] || [0, 0, 0];
  angles.forEach((a, k) => { $("turn-" + k).value = a; });
  $("borrow").checked = state.pose.from !== null;
  $("from").value = state.pose.from ?? state.t;
}
function posed() {
  state.pose.turns[$("joint").value] = [0, 1, 2].map((k) => Number($("turn-" + k).value));
  state.pose.from = $("borrow").checked ? Number($("from").value) : null;
  changed();
}

// A box of splats.
function choose(at) {
  const { width, height } = $("a");
  chosen = { show: state.a[0], look: look(), time: state.t, width, height, at };
  $("choice").hidden = false;
  boxing(false);
  again();
}
function unchoose() { chosen = null; $("choice").hidden = true; boxing(false); }
function boxing(on) { $("boxing").setAttribute("aria-pressed", on); stage.classList.toggle("boxing", on); if (!on) $("box").hidden = true; }
const isBoxing = () => $("boxing").getAttribute("aria-pressed") === "true";
// Shares of the image at a place of the window.
function shareAt(x, y) { const c = $("a").getBoundingClientRect(); return [(x - c.left) / c.width, (y - c.top) / c.height]; }
function dragBox(e) {
  const s = stage.getBoundingClientRect(), b = $("box").style;
  const [x, y] = [Math.min(e.clientX, drag.x0), Math.min(e.clientY, drag.y0)];
  b.left = x - s.left + "px"; b.top = y - s.top + "px"; b.width = Math.abs(e.clientX - drag.x0) + "px"; b.height = Math.abs(e.clientY - drag.y0) + "px";
  $("box").hidden = false;
}
function endBox(e) {
  const clamp = (v) => Math.min(1, Math.max(0, v)), [p, q] = [shareAt(drag.x0, drag.y0), shareAt(e.clientX, e.clientY)].map((s) => s.map(clamp));
  choose([Math.min(p[0], q[0]), Math.min(p[1], q[1]), Math.max(p[0], q[0]), Math.max(p[1], q[1])]);
}

// The address keeps the view; browsers slow pages down that change it too often.
let saving = null;
function save() { saving ??= setTimeout(() => { saving = null; keep(); }, 300); }
function keep() {
  const short = (list) => list.map((v) => +v.toFixed(5));
  const now = { e: short(state.eye), g: short(state.target), u: short(state.up), f: +state.fov.toFixed(4), t: +state.t.toFixed(4), v: state.view, a: state.a, b: state.b, c: state.compare, w: state.cut, n: state.gain, s: state.cameras, r: state.arrows, h: state.hidden, p: state.pose };
  history.replaceState(null, "", location.search + "#" + encodeURIComponent(JSON.stringify(now)));
}
function restore() {
  try {
    const k = JSON.parse(decodeURIComponent(location.hash.slice(1)));
    const known = (p) => Array.isArray(p) && shows[p[0]] && typeof p[1] === "string" && Number.isInteger(p[2]);
    if (![k.e, k.g, k.u].every((v) => Array.isArray(v) && v.length === 3 && v.every(Number.isFinite)) || ![k.f, k.t].every(Number.isFinite) || !known(k.a)) return false;
    Object.assign(state, { eye: k.e, target: k.g, up: k.u, fov: k.f, t: k.t, view: shows[k.a[0]].views[k.v] ? k.v : -1, a: k.a, b: known(k.b) ? k.b : state.b, compare: ["wipe", "difference", "flicker"].includes(k.c) ? k.c : "", cut: Number(k.w), gain: Number(k.n) || 4, cameras: !!k.s, arrows: !!k.r });
    if (Array.isArray(k.h)) state.hidden = k.h;
    if (k.p && typeof k.p.turns === "object") state.pose = { from: Number.isFinite(k.p.from) ? k.p.from : null, turns: k.p.turns };
    return true;
  } catch { return false; }
}
function begin(message) {
  const first = !shows.length;
  shows = message.shows;
  notice("");
  if (!first) { layers(); again(); return; }
  document.title = `gs4d · ${shows.map((s) => s.name).join(", ")}`;
  state.b = [shows.length > 1 ? 1 : 0, shows[0].layers.includes("truth") && shows.length === 1 ? "truth" : "color", -1];
  const known = restore();
  for (const side of ["a", "b"]) options($("show-" + side), shows.map((s, k) => [k, s.name]), state[side][0]);
  for (const name of ["compare", "cut", "gain"]) $(name).value = state[name];
  for (const name of ["cameras", "arrows"]) $(name).checked = state[name];
  views(); layers(); figure(); timeline(); $("t").value = state.t; showTime(); place();
  if (known) changed(); else if (about().views.length) snap(0); else frameScene();
}

// Input.
stage.addEventListener("pointerdown", (e) => { drag = { x: e.clientX, y: e.clientY, x0: e.clientX, y0: e.clientY, far: 0, pan: e.shiftKey || e.button === 2, box: isBoxing() }; stage.setPointerCapture(e.pointerId); });
stage.addEventListener("pointermove", (e) => {
  if (!drag) return;
  const dx = e.clientX - drag.x, dy = e.clientY - drag.y;
  drag.x = e.clientX; drag.y = e.clientY; drag.far += Math.abs(dx) + Math.abs(dy);
  if (drag.box) return dragBox(e);
  if (drag.far < 4) return;
  if (drag.pan) pan(dx / stage.clientWidth, dy / stage.clientWidth); else orbit(dx * 0.008, dy * 0.008);
});
stage.addEventListener("pointerup", (e) => {
  if (drag && drag.box) endBox(e);
  else if (drag && drag.far < 4) {
    const at = shareAt(e.clientX, e.clientY);
    if (at.every((v) => v >= 0 && v < 1)) pickAt(at);
  }
  drag = null;
});
stage.addEventListener("pointercancel", () => { drag = null; $("box").hidden = true; });
function pickAt(at) { sides.a.pick = at; sides.a.is = Math.min(sides.a.is, COARSE); }
stage.addEventListener("contextmenu", (e) => e.preventDefault());
stage.addEventListener("wheel", (e) => { e.preventDefault(); dolly(Math.exp(e.deltaY * 0.001)); }, { passive: false });
stage.addEventListener("keydown", (e) => {
  const step = 0.06, keys = {
    ArrowLeft: () => (e.shiftKey ? pan(step, 0) : orbit(-step, 0)), ArrowRight: () => (e.shiftKey ? pan(-step, 0) : orbit(step, 0)),
    ArrowUp: () => (e.shiftKey ? pan(0, step) : orbit(0, -step)), ArrowDown: () => (e.shiftKey ? pan(0, -step) : orbit(0, step)),
    "+": () => dolly(0.9), "=": () => dolly(0.9), "-": () => dolly(1.1), w: () => fly(1, 0), s: () => fly(-1, 0), a: () => fly(0, -1), d: () => fly(0, 1),
    " ": () => play(!playing), f: frameScene, u: nextUp, x: swap, ",": () => setTime(Math.max(0, state.t - 0.01)), ".": () => setTime(Math.min(LAST, state.t + 0.01)),
    "[": () => snap(Math.max(0, state.view - 1)), "]": () => snap(Math.min(about().views.length - 1, state.view + 1)),
    Enter: () => pickAt([0.5, 0.5]), b: () => choose([0.3, 0.3, 0.7, 0.7]), v: () => $("arrows").click(), c: () => $("cameras").click(), Escape: () => { unchoose(); paths = []; lines(); },
  };
  const act = keys[e.key] || keys[e.key.toLowerCase()];
  if (act && shows.length && !e.ctrlKey && !e.metaKey && !e.altKey) { e.preventDefault(); act(); }
});
$("t").addEventListener("input", (e) => setTime(Number(e.target.value)));
$("play").addEventListener("click", () => play(!playing));
$("frame").addEventListener("click", frameScene);
$("flip").addEventListener("click", nextUp);
$("swap").addEventListener("click", swap);
$("view").addEventListener("change", (e) => snap(Number(e.target.value)));
$("compare").addEventListener("change", (e) => { state.compare = e.target.value; front = "a"; place(); changed(); });
$("cut").addEventListener("input", (e) => { state.cut = Number(e.target.value); place(); save(); });
$("gain").addEventListener("change", (e) => { state.gain = Number(e.target.value); changed(); });
$("cameras").addEventListener("change", (e) => { state.cameras = e.target.checked; strip(); lines(); save(); });
$("arrows").addEventListener("change", (e) => { state.arrows = e.target.checked; changed(); });
$("boxing").addEventListener("click", () => boxing(!isBoxing()));
$("hide").addEventListener("click", () => { if (chosen) state.hidden.push(chosen); unchoose(); changed(); place(); });
$("unhide").addEventListener("click", () => { state.hidden = []; changed(); place(); });
$("unchoose").addEventListener("click", unchoose);
for (const part of ["chosen", "rest"]) $("save-" + part).addEventListener("click", () => { file = { save: part, chosen }; pump(); });
$("joint").addEventListener("change", figure);
for (const id of ["turn-0", "turn-1", "turn-2", "borrow", "from"]) $(id).addEventListener("input", posed);
$("unpose").addEventListener("click", () => { state.pose = { from: null, turns: {} }; figure(); changed(); });
for (const side of ["a", "b"]) {
  $("show-" + side).addEventListener("change", (e) => { state[side][0] = Number(e.target.value); state[side][2] = -1; paths = []; unchoose(); views(); layers(); figure(); timeline(); changed(); });
  $("step-" + side).addEventListener("change", (e) => { state[side][2] = Number(e.target.value); place(); changed(); });
  $("layer-" + side).addEventListener("change", (e) => { state[side][1] = e.target.value; place(); changed(); });
}
new ResizeObserver(again).observe(stage);
open();
tick();
