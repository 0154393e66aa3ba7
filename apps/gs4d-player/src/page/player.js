"use strict";
// The page: camera, time, layers, and what is drawn when.
const $ = (id) => document.getElementById(id);
const stage = $("stage"), page = JSON.parse($("page").textContent);
const PACE = 36; // milliseconds until the next image, at most
const SECONDS = 4; // of a loop where the scene has no clock
const state = { ...structuredClone(page.start), t: 0, playing: true, looping: true, speed: 1 };
let clip = null, renderer = null, due = false, shrink = 1, last = 0, work = 0;
const reduced = matchMedia("(prefers-reduced-motion: reduce)").matches;

const forward = () => unit(add(state.target, state.eye, -1));
const right = () => unit(cross(forward(), state.up));
const distance = () => Math.hypot(...add(state.eye, state.target, -1));
// The camera of an image: what the first view of the page shows fits into it.
function camera(width, height) {
  const f = forward(), r = right(), d = cross(f, r), row = (v) => [...v, -dot(v, state.eye)];
  const focal = Math.min(width, height * page.start.aspect) / 2 / Math.tan(state.fov / 2);
  return { viewmat: [...row(r), ...row(d), ...row(f)], fx: focal, fy: focal, cx: width / 2, cy: height / 2, width, height };
}
function orbit(dx, dy) {
  const away = turn(add(state.eye, state.target, -1), unit(state.up), -dx), tilted = turn(away, right(), -dy);
  state.eye = add(state.target, Math.abs(dot(unit(tilted), unit(state.up))) < 0.995 ? tilted : away);
  show();
}
function pan(dx, dy) {
  const far = distance() * Math.tan(state.fov / 2) * 2, by = add(right().map((v) => -v * dx * far), cross(right(), forward()).map((v) => v * dy * far));
  state.eye = add(state.eye, by); state.target = add(state.target, by);
  show();
}
function dolly(factor) { state.eye = add(state.target, add(state.eye, state.target, -1), factor); show(); }
function reset() { Object.assign(state, structuredClone(page.start)); show(); }

// Rendering, at most once per frame of the page; coarser where that takes long, and once more in full when all rests.
function show() { if (!due) { due = true; requestAnimationFrame(paint); } }
function paint(now) {
  due = false;
  if (!renderer || !clip) return;
  const first = clip.times[0], end = clip.times[clip.times.length - 1];
  if (state.playing && end > first) {
    state.t += (last ? Math.min(now - last, 200) : 0) / 1000 * pace(end - first) * state.speed;
    if (state.t > end) { if (state.looping) state.t = first + ((state.t - first) % (end - first)); else { state.t = end; play(false); } }
    last = now;
    showTime();
  }
  const factor = Math.min(devicePixelRatio || 1, 2) / shrink, size = (v) => Math.max(16, Math.round(v * factor));
  renderer.draw(camera(size(stage.clientWidth), size(stage.clientHeight)), state.t);
  rate.push(now);
  requestAnimationFrame((next) => { const spent = next - now; if (state.playing || pointers.size) shrink = Math.min(4, Math.max(1, shrink * (spent > PACE ? 1.15 : spent < 0.7 * PACE ? 0.95 : 1))); else if (shrink > 1) { shrink = 1; show(); } });
  if (state.playing) show();
}
const rate = { times: [], push(t) { this.times.push(t); if (this.times.length > 60) this.times.shift(); }, get() { const t = this.times; return t.length > 1 ? (1000 * (t.length - 1)) / (t[t.length - 1] - t[0]) : 0; } };

// Time.
// Normalised time a second, of a clip that spans so much of it; no loop is shorter than a fifth of a second.
const pace = (span) => (page.clock ? Math.min(1 / (page.clock[1] - page.clock[0]), span / 0.2) : span / SECONDS);
function showTime() {
  const s = page.clock ? `${(page.clock[0] + state.t * (page.clock[1] - page.clock[0])).toFixed(2)} s` : state.t.toFixed(2);
  $("t").value = state.t; $("now").textContent = s; $("t").setAttribute("aria-valuetext", s);
}
function play(on) {
  state.playing = on; last = 0;
  $("play").setAttribute("aria-label", on ? "Pause" : "Play"); document.body.classList.toggle("playing", on);
  if (on && state.t >= clip.times[clip.times.length - 1]) state.t = clip.times[0];
  show();
}
function setTime(t) { play(false); state.t = Math.min(clip.times[clip.times.length - 1], Math.max(clip.times[0], t)); showTime(); show(); }
const stepTime = (by) => setTime(state.t + (by * (clip.times[clip.times.length - 1] - clip.times[0])) / Math.max(1, clip.times.length - 1));

// Layers: the frames are made again in their colours, the nearest in time first, a few at a time.
async function layer(number) {
  const mine = ++work, chosen = clip.layers[number] || null, n = clip.times.length;
  $("ready").hidden = false;
  $("meaning").textContent = chosen ? chosen.meaning : "";
  const near = clip.times.map((t, k) => k).sort((a, b) => Math.abs(clip.times[a] - state.t) - Math.abs(clip.times[b] - state.t));
  const sh = chosen ? null : clip.sh;
  renderer.setClip({ count: clip.count, keys: [clip.key(near[0], chosen)], background: page.background, sh, ...clip.renderSettings });
  for (let k = 1; k < n; k++) {
    await new Promise((done) => setTimeout(done));
    if (mine !== work) return;
    renderer.addKey(clip.key(near[k], chosen));
    $("ready").style.width = `${(100 * (k + 1)) / n}%`;
  }
  $("ready").hidden = true;
  document.body.dataset.ready = number;
}

// Mouse, touch and keyboard.
const pointers = new Map();
stage.addEventListener("pointerdown", (e) => { pointers.set(e.pointerId, [e.clientX, e.clientY]); stage.setPointerCapture(e.pointerId); });
stage.addEventListener("pointermove", (e) => {
  const from = pointers.get(e.pointerId);
  if (!from) return;
  const before = [...pointers.values()], w = stage.clientWidth;
  pointers.set(e.pointerId, [e.clientX, e.clientY]);
  if (before.length > 1) {
    const now = [...pointers.values()], middle = (p) => [0, 1].map((k) => (p[0][k] + p[1][k]) / 2), apart = (p) => Math.hypot(p[0][0] - p[1][0], p[0][1] - p[1][1]), [m, n] = [middle(before), middle(now)];
    pan((n[0] - m[0]) / w, (n[1] - m[1]) / w);
    if (apart(now) > 10 && apart(before) > 10) dolly(apart(before) / apart(now));
  } else if (e.shiftKey || e.buttons & 2) pan((e.clientX - from[0]) / w, (e.clientY - from[1]) / w);
  else orbit((e.clientX - from[0]) * 0.008, (e.clientY - from[1]) * 0.008);
});
for (const name of ["pointerup", "pointercancel"]) stage.addEventListener(name, (e) => { pointers.delete(e.pointerId); show(); });
stage.addEventListener("contextmenu", (e) => e.preventDefault());
stage.addEventListener("dblclick", reset);
stage.addEventListener("wheel", (e) => { e.preventDefault(); dolly(Math.exp(e.deltaY * 0.001)); }, { passive: false });
const full = () => (document.fullscreenElement ? document.exitFullscreen() : document.documentElement.requestFullscreen());
const KEYS = { " ": () => play(!state.playing), "+": () => dolly(0.9), "=": () => dolly(0.9), "-": () => dolly(1.1), ",": () => stepTime(-1), ".": () => stepTime(1), f: full, r: reset };
document.addEventListener("keydown", (e) => {
  if (!clip || e.ctrlKey || e.metaKey || e.altKey || ["SELECT", "BUTTON"].includes(e.target.tagName)) return;
  const arrow = e.target.id === "t" ? null : { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[e.key], step = 0.06;
  const act = arrow ? () => (e.shiftKey ? pan(-step * arrow[0], -step * arrow[1]) : orbit(step * arrow[0], step * arrow[1])) : KEYS[e.key];
  if (act) { e.preventDefault(); act(); }
});
new ResizeObserver(show).observe(stage);

async function begin() {
  const source = URL.createObjectURL(new Blob([$("sorter").textContent], { type: "text/javascript" }));
  renderer = new SplatRenderer($("image"), () => new Worker(source));
  renderer.onchange = () => { if (renderer.state === "failed") notice(renderer.error); show(); };
  clip = new Clip(await unpacked($("clip").textContent));
  const moving = clip.times.length > 1;
  state.t = clip.times[0];
  Object.assign($("t"), { min: clip.times[0], max: clip.times[clip.times.length - 1], step: "any" });
  for (const node of document.querySelectorAll(".moving")) node.hidden = !moving;
  clip.layers.forEach(({ name }, k) => $("layer").add(new Option(name, k)));
  $("layers").hidden = !clip.layers.length;
  $("full").hidden = !document.fullscreenEnabled;
  document.body.classList.add("loaded");
  showTime(); play(moving && !reduced);
  await layer(-1);
}
function notice(text) { $("notice").textContent = text; $("notice").hidden = !text; }
$("play").addEventListener("click", () => play(!state.playing));
$("loop").addEventListener("click", () => { state.looping = !state.looping; $("loop").setAttribute("aria-pressed", state.looping); });
$("speed").addEventListener("change", (e) => { state.speed = Number(e.target.value); });
$("t").addEventListener("input", (e) => setTime(Number(e.target.value)));
$("layer").addEventListener("change", (e) => layer(Number(e.target.value)));
$("full").addEventListener("click", full);
$("reset").addEventListener("click", reset);
if (!("DecompressionStream" in window)) notice("This browser is too old for this page: it needs DecompressionStream (2023).");
else begin().catch((error) => notice(`This page cannot be shown: ${error.message}`));
