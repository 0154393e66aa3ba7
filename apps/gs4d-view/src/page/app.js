"use strict";
// The page asks for one picture at a time, the two sides in turn; a newer wish of a side replaces one not yet asked.
const $ = (id) => document.getElementById(id);
const key = new URLSearchParams(location.search).get("k") || "";
const stage = $("stage");
const LAST = 1.25; // end of the slider, in training spans
const FAST = 80; // milliseconds a picture may take while something moves
let shows = [], socket = null, next = 1, busy = null, playing = false, moving = 0, shrink = 1, lastTick = 0, paths = [];
const sides = { a: { want: null, rest: false }, b: { want: null, rest: false } };
const state = { eye: [0, 0, -4], target: [0, 0, 0], up: [0, -1, 0], fov: 0.8, t: 0, view: -1, a: [0, "color"], b: [0, "truth"], compare: false, cut: 0.5 };

// Vectors.
const add = (a, b, k = 1) => a.map((v, i) => v + k * b[i]);
const dot = (a, b) => a.reduce((s, v, i) => s + v * b[i], 0);
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const unit = (a) => { const n = Math.hypot(...a); return n > 0 ? a.map((v) => v / n) : [0, 0, 1]; };
function turn(v, axis, angle) {
  const c = Math.cos(angle), s = Math.sin(angle), along = dot(v, axis) * (1 - c), side = cross(axis, v);
  return v.map((x, i) => x * c + side[i] * s + axis[i] * along);
}
const forward = () => unit(add(state.target, state.eye, -1));
const right = () => unit(cross(forward(), state.up));

// Moves.
function orbit(dx, dy) {
  leaveView();
  let away = add(state.eye, state.target, -1);
  away = turn(away, unit(state.up), -dx);
  const tilted = turn(away, right(), -dy);
  if (Math.abs(dot(unit(tilted), unit(state.up))) < 0.995) away = tilted;
  state.eye = add(state.target, away);
  changed();
}
function pan(dx, dy) {
  leaveView();
  const far = Math.hypot(...add(state.eye, state.target, -1)) * Math.tan(state.fov / 2) * 2;
  const shift = add(right().map((v) => -v * dx * far), cross(right(), forward()).map((v) => v * dy * far));
  state.eye = add(state.eye, shift); state.target = add(state.target, shift); changed();
}
function dolly(factor) { leaveView(); state.eye = add(state.target, add(state.eye, state.target, -1), factor); changed(); }
function fly(ahead, aside) {
  leaveView();
  const far = 0.05 * Math.hypot(...add(state.eye, state.target, -1));
  const shift = add(forward().map((v) => v * ahead * far), right(), aside * far);
  state.eye = add(state.eye, shift); state.target = add(state.target, shift); changed();
}
function frameScene() {
  leaveView();
  const about = shows[state.a[0]];
  const back = unit(add(state.eye, state.target, -1));
  state.target = about.centre;
  state.eye = add(about.centre, back, (2.2 * about.radius) / Math.tan(state.fov / 2));
  changed();
}
function leaveView() { if (state.view >= 0) { state.view = -1; $("view").value = "-1"; layers(); } }
function snap(number) {
  state.view = number;
  const v = number >= 0 && shows[state.a[0]].views[number];
  if (v) {
    const far = Math.max(Math.abs(dot(add(shows[state.a[0]].centre, v.eye, -1), v.forward)), 1e-3);
    Object.assign(state, { eye: v.eye, target: add(v.eye, v.forward, far), up: v.up, fov: v.fov, t: v.time });
    $("t").value = state.t; showTime();
  }
  layers(); changed();
}

// Questions.
function ask(side, rest) { sides[side].want = { rest }; pump(); }
function pump() {
  if (busy || !socket || socket.readyState !== 1 || !shows.length) return;
  const side = (pump.last === "a" ? ["b", "a"] : ["a", "b"]).find((s) => sides[s].want && (s === "a" || state.compare));
  if (!side) return;
  const s = sides[side], [show, layer] = state[side], { rest } = s.want;
  const ratio = Math.min(devicePixelRatio || 1, 2), factor = rest ? ratio : ratio / shrink;
  const width = Math.max(16, Math.round(stage.clientWidth * factor)), height = Math.max(16, Math.round(stage.clientHeight * factor));
  const look = state.view >= 0 ? { view: state.view } : { free: [state.eye, state.target, state.up, state.fov] };
  const question = { id: next++, show, layer, time: state.t, look, width, height };
  if (rest && side === "a" && s.pick) { question.pick = s.pick; s.pick = null; }
  busy = { id: question.id, side, rest, sent: performance.now() };
  s.want = null; pump.last = side;
  socket.send(JSON.stringify(question));
}
function changed() { moving = performance.now(); save(); paths = []; again(); }
function again() { drawPaths(); for (const side of ["a", "b"]) { sides[side].rest = false; ask(side, false); } }
function settle() {
  for (const side of ["a", "b"]) {
    const s = sides[side], idle = !s.want && !(busy && busy.side === side);
    if (idle && !s.rest && !playing && performance.now() - moving > 180 && (side === "a" || state.compare)) ask(side, true);
  }
  if (busy && performance.now() - busy.sent > 20000) { busy = null; pump(); }
}
async function received(data) {
  const length = new DataView(data).getUint32(0, true);
  const header = JSON.parse(new TextDecoder().decode(new Uint8Array(data, 4, length)));
  if (!busy || header.id !== busy.id) return;
  const { side, rest, sent } = busy, spent = performance.now() - sent;
  sides[side].rest = rest;
  busy = null;
  pump();
  if (!rest) shrink = Math.min(8, Math.max(1, shrink * (spent > FAST ? 1.25 : spent < FAST / 2 ? 0.85 : 1)));
  const bitmap = await createImageBitmap(new Blob([new Uint8Array(data, 4 + length)]));
  const canvas = $(side);
  canvas.width = bitmap.width; canvas.height = bitmap.height;
  const fit = Math.min(stage.clientWidth / bitmap.width, stage.clientHeight / bitmap.height);
  canvas.style.width = bitmap.width * fit + "px"; canvas.style.height = bitmap.height * fit + "px";
  canvas.getContext("2d").drawImage(bitmap, 0, 0);
  document.body.dataset[side] = `${header.layer} ${header.width}x${header.height} ${rest ? "rest" : "moving"}`;
  if (side === "a") tell(header, spent);
  place();
}
function tell(header, spent) {
  const parts = [`${header.width}×${header.height}`, `drawn in ${header.ms.toFixed(0)} ms, here after ${spent.toFixed(0)} ms`];
  if (header.splats !== undefined) parts.unshift(`${header.splats.toLocaleString("en")} splats`);
  if (header.psnr) parts.push(`PSNR of this view ${header.psnr.toFixed(2)} dB`);
  $("status").textContent = parts.join(" · ");
  notice(header.blank ? header.blank + ". Press F to frame the scene." : "");
  legend(header.legend);
  if (header.picked) picked(header.picked);
}
function notice(text) { $("notice").textContent = text; $("notice").hidden = !text; }
function number(v) { return Math.abs(v) >= 1000 || (v !== 0 && Math.abs(v) < 0.01) ? v.toExponential(2) : v.toPrecision(4); }
function legend(l) {
  if (!l) { $("legend").textContent = ""; return; }
  const most = Math.max(1, ...l.bars), svg = document.createElementNS("http://www.w3.org/2000/svg", "svg");
  svg.setAttribute("width", 8 * l.bars.length); svg.setAttribute("height", 34); svg.setAttribute("role", "img");
  l.bars.forEach((n, k) => {
    const bar = (y, h) => { const r = document.createElementNS(svg.namespaceURI, "rect"); for (const [a, v] of Object.entries({ x: 8 * k, y, width: 8, height: h, fill: l.colors[k] })) r.setAttribute(a, v); svg.append(r); };
    bar(24 * (1 - n / most), 24 * (n / most)); bar(26, 8);
  });
  const words = document.createElement("span");
  words.textContent = `${l.name}: ${number(l.low)} to ${number(l.high)} ${l.unit}`;
  svg.setAttribute("aria-label", words.textContent);
  $("legend").replaceChildren(svg, words);
}

// Picking.
function picked(p) {
  const table = document.createElement("table"), row = (cells, tag) => { const r = table.insertRow(); for (const c of cells) { const d = document.createElement(tag); d.textContent = c; r.append(d); } };
  const names = p.splats.length ? Object.keys(p.splats[0].quantities) : [];
  row(["splat", "weight", "opacity", "centre", "scales", ...names], "th");
  for (const s of p.splats) row([s.splat, s.weight.toFixed(3), s.opacity.toFixed(3), s.mean.map(number).join(" "), s.scale.map(number).join(" "), ...names.map((n) => number(s.quantities[n]))], "td");
  const words = document.createElement("p");
  words.textContent = p.splats.length ? `pixel ${p.pixel.join(", ")}: coverage ${p.alpha.toFixed(3)}; the heaviest splats and, in yellow, their paths` : `pixel ${p.pixel.join(", ")}: no splat`;
  $("picked").replaceChildren(words, table);
  paths = p.splats.map((s) => s.path);
  drawPaths();
}
function project(p) {
  const f = forward(), r = right(), d = cross(f, r), v = add(p, state.eye, -1), z = dot(v, f);
  if (z <= 1e-6) return null;
  const c = $("a").getBoundingClientRect(), s = stage.getBoundingClientRect(), focal = c.width / 2 / Math.tan(state.fov / 2);
  return [c.left - s.left + c.width / 2 + (focal * dot(v, r)) / z, c.top - s.top + c.height / 2 + (focal * dot(v, d)) / z];
}
function drawPaths() {
  const svg = $("paths");
  svg.replaceChildren();
  for (const path of paths) {
    const line = document.createElementNS("http://www.w3.org/2000/svg", "polyline");
    line.setAttribute("points", path.map(project).filter(Boolean).map((p) => p.map((v) => v.toFixed(1)).join(",")).join(" "));
    svg.append(line);
  }
}

// The panel.
function options(select, names, chosen) {
  select.replaceChildren(...names.map((n, k) => { const o = document.createElement("option"); o.value = typeof n === "string" ? n : k; o.textContent = typeof n === "string" ? n : n.name; return o; }));
  select.value = chosen;
}
function layers() {
  for (const side of ["a", "b"]) {
    const all = shows[state[side][0]].layers.filter((l) => l !== "truth" || state.view >= 0);
    if (!all.includes(state[side][1])) state[side][1] = "color";
    options($("layer-" + side), all, state[side][1]);
  }
}
function place() {
  const c = $("a").getBoundingClientRect(), s = stage.getBoundingClientRect();
  $("b").hidden = $("wipe").hidden = $("label-b").hidden = $("second").hidden = !state.compare;
  $("b").style.clipPath = `inset(0 0 0 ${100 * state.cut}%)`;
  $("wipe").style.left = c.left - s.left + c.width * state.cut + "px";
  $("label-a").textContent = shows.length ? `${shows[state.a[0]].name} · ${state.a[1]}` : "";
  if (shows.length) $("label-b").textContent = `${shows[state.b[0]].name} · ${state.b[1]}`;
  drawPaths();
}
function showTime() {
  const s = shows[state.a[0]];
  const last = s.times[s.times.length - 1];
  $("seconds").textContent = `${(state.t * s.seconds).toFixed(2)} s  (${state.t.toFixed(3)})${state.t > last + 1e-6 ? " future" : ""}`;
}
function timeline() {
  const s = shows[state.a[0]], last = s.times[s.times.length - 1];
  $("time").hidden = !s.moving;
  $("future").style.width = 100 * Math.max(0, 1 - last / LAST) + "%";
  $("marks").replaceChildren(...s.times.map((t) => { const i = document.createElement("i"); i.style.left = (100 * t) / LAST + "%"; return i; }));
  showTime();
}
function setTime(t) { state.t = t; $("t").value = t; showTime(); changed(); }
function play(on) { playing = on; $("play").textContent = on ? "Pause" : "Play"; lastTick = performance.now(); if (!on) changed(); }
function tick() {
  const now = performance.now();
  if (playing && !busy && !sides.a.want) {
    let t = state.t + ((now - lastTick) / 1000 / Math.max(shows[state.a[0]].seconds, 0.5)) * Number($("speed").value);
    lastTick = now;
    if (t > LAST) { if (!$("loop").checked) play(false); t = $("loop").checked ? 0 : LAST; }
    setTime(t);
  }
  settle();
  setTimeout(tick, 15);
}
function save() {
  const keep = { e: state.eye.map((v) => +v.toFixed(5)), g: state.target.map((v) => +v.toFixed(5)), u: state.up.map((v) => +v.toFixed(5)), f: +state.fov.toFixed(4), t: +state.t.toFixed(4), v: state.view, a: state.a, b: state.b, c: state.compare, w: state.cut };
  history.replaceState(null, "", location.search + "#" + encodeURIComponent(JSON.stringify(keep)));
}
function restore() {
  try {
    const k = JSON.parse(decodeURIComponent(location.hash.slice(1)));
    const known = (p) => Array.isArray(p) && shows[p[0]] && shows[p[0]].layers.includes(p[1]);
    if (![k.e, k.g, k.u].every((v) => Array.isArray(v) && v.length === 3 && v.every(Number.isFinite)) || !known(k.a)) return false;
    Object.assign(state, { eye: k.e, target: k.g, up: k.u, fov: k.f, t: k.t, view: shows[k.a[0]].views[k.v] ? k.v : -1, a: k.a, b: known(k.b) ? k.b : state.b, compare: !!k.c, cut: k.w });
    return true;
  } catch { return false; }
}
function begin(about) {
  shows = about.shows;
  state.b = [shows.length > 1 ? 1 : 0, shows[0].layers.includes("truth") && shows.length === 1 ? "truth" : "color"];
  const known = restore();
  for (const side of ["a", "b"]) options($("show-" + side), shows, state[side][0]);
  options($("view"), shows[0].views, "");
  const free = document.createElement("option"); free.value = "-1"; free.textContent = "free"; $("view").prepend(free);
  $("view").value = state.view; $("compare").checked = state.compare; $("cut").value = state.cut;
  layers(); timeline(); $("t").value = state.t; showTime(); place();
  if (known) changed(); else if (shows[0].views.length) { $("view").value = "0"; snap(0); } else frameScene();
}
function open() {
  socket = new WebSocket(`ws://${location.host}/ws?k=${encodeURIComponent(key)}`);
  socket.binaryType = "arraybuffer";
  socket.onmessage = (m) => {
    if (typeof m.data !== "string") return void received(m.data);
    const about = JSON.parse(m.data);
    if (about.shows) return begin(about);
    notice(about.error);
    if (busy) { sides[busy.side].rest = true; busy = null; pump(); }
  };
  socket.onclose = () => { notice("The viewer has stopped or the line is cut; trying again."); busy = null; setTimeout(open, 2000); };
}

// Input.
let drag = null;
stage.addEventListener("pointerdown", (e) => { drag = { x: e.clientX, y: e.clientY, far: 0, pan: e.shiftKey || e.button === 2 }; stage.setPointerCapture(e.pointerId); });
stage.addEventListener("pointermove", (e) => {
  if (!drag) return;
  const dx = e.clientX - drag.x, dy = e.clientY - drag.y;
  drag.x = e.clientX; drag.y = e.clientY; drag.far += Math.abs(dx) + Math.abs(dy);
  if (drag.far < 4) return;
  if (drag.pan) pan(dx / stage.clientWidth, dy / stage.clientWidth); else orbit(dx * 0.008, dy * 0.008);
});
stage.addEventListener("pointerup", (e) => {
  if (drag && drag.far < 4) {
    const c = $("a").getBoundingClientRect(), at = [(e.clientX - c.left) / c.width, (e.clientY - c.top) / c.height];
    if (at.every((v) => v >= 0 && v < 1)) { sides.a.pick = at; sides.a.rest = false; }
  }
  drag = null;
});
stage.addEventListener("contextmenu", (e) => e.preventDefault());
stage.addEventListener("wheel", (e) => { e.preventDefault(); dolly(Math.exp(e.deltaY * 0.001)); }, { passive: false });
stage.addEventListener("keydown", (e) => {
  const step = 0.06, keys = {
    ArrowLeft: () => (e.shiftKey ? pan(step, 0) : orbit(-step, 0)), ArrowRight: () => (e.shiftKey ? pan(-step, 0) : orbit(step, 0)),
    ArrowUp: () => (e.shiftKey ? pan(0, step) : orbit(0, -step)), ArrowDown: () => (e.shiftKey ? pan(0, -step) : orbit(0, step)),
    "+": () => dolly(0.9), "=": () => dolly(0.9), "-": () => dolly(1.1), w: () => fly(1, 0), s: () => fly(-1, 0), a: () => fly(0, -1), d: () => fly(0, 1),
    " ": () => play(!playing), f: frameScene, u: () => $("flip").click(), ",": () => setTime(Math.max(0, state.t - 0.01)), ".": () => setTime(Math.min(LAST, state.t + 0.01)),
    Enter: () => { sides.a.pick = [0.5, 0.5]; sides.a.rest = false; },
  };
  const act = keys[e.key] || keys[e.key.toLowerCase()];
  if (act && !e.ctrlKey && !e.metaKey) { e.preventDefault(); act(); }
});
$("t").addEventListener("input", (e) => setTime(Number(e.target.value)));
$("play").addEventListener("click", () => play(!playing));
$("frame").addEventListener("click", frameScene);
$("flip").addEventListener("click", () => { leaveView(); const u = unit(state.up.map(Math.abs)), k = u.indexOf(Math.max(...u)), sign = Math.sign(state.up[k]) || 1; state.up = [0, 0, 0]; if (sign > 0) state.up[k] = -1; else state.up[(k + 1) % 3] = 1; changed(); });
$("view").addEventListener("change", (e) => snap(Number(e.target.value)));
$("compare").addEventListener("change", (e) => { state.compare = e.target.checked; place(); changed(); });
$("cut").addEventListener("input", (e) => { state.cut = Number(e.target.value); place(); save(); });
for (const side of ["a", "b"]) {
  $("show-" + side).addEventListener("change", (e) => { state[side][0] = Number(e.target.value); layers(); timeline(); changed(); });
  $("layer-" + side).addEventListener("change", (e) => { state[side][1] = e.target.value; place(); changed(); });
}
new ResizeObserver(again).observe(stage);
open();
tick();
