"use strict";
// Images drawn in the browser while something moves. At rest the server's image, which is exact, takes their place.
const WORDS = 32, MEMORY = 192 << 20, MAX_KEYS = 90; // bytes of a splat, bytes of all keys, keys
const SLOW = 2000; // bytes a millisecond
const PACE = 36; // milliseconds until the next image, at most
let renderer = null, clip = null, localShrink = 1, broken = false;

// What the splats of the clip depend on besides time and camera.
const clipName = () => JSON.stringify([target("a"), state.hidden, state.pose, state.style, state.back]);
const canDraw = () => !broken && !live && !state.compare && state.style !== "points" && !["truth", "depth", "alpha", "count"].includes(state.a[1]);
// Times of the keys: as many as training timestamps, at most those that fit into the memory.
function keyTimes(count) {
  const s = about();
  if (!s.moving) return [0];
  const most = Math.min(MAX_KEYS, Math.floor(MEMORY / (WORDS * Math.max(count, 1)))), n = Math.max(2, Math.min(most, Math.ceil(1.25 * s.times.length)));
  return Array.from({ length: n }, (_, k) => (FIRST() + ((LAST() - FIRST()) * k) / (n - 1)));
}
// Indices of the keys on both sides of the present time.
function around() {
  const times = clip.times, k = times.findIndex((t) => t >= state.t - 1e-6);
  if (k < 0) return [times.length - 1];
  return k === 0 || Math.abs(times[k] - state.t) < 1e-6 ? [k] : [k - 1, k];
}
// The time of the key that is fetched next; null if there is none. Those around the present time come first, or alone.
function wantedKey(nearOnly) {
  if (!canDraw() || sides.a.is < REST) return null;
  if (about().splats * WORDS * (about().moving ? 2 : 1) > MEMORY) return null;
  if (!clip || clip.name !== clipName()) clip = { name: clipName(), times: keyTimes(about().splats), count: null, have: new Set() };
  const open = clip.times.map((t, k) => k).filter((k) => !clip.have.has(k));
  if (!open.length || clip.failed) return null;
  const next = around().find((k) => !clip.have.has(k));
  if (next === undefined && nearOnly) return null;
  const near = next ?? open.reduce((a, b) => (Math.abs(clip.times[b] - state.t) < Math.abs(clip.times[a] - state.t) ? b : a));
  return clip.times[near];
}
function noKeys() { if (clip) clip.failed = true; }
function gotKey(time, buffer, header, spent) {
  if (!clip || clip.name !== clipName()) return;
  const words = new Uint32Array(buffer), count = words.length / 8;
  if (clip.count === null) {
    clip.count = count;
    clip.background = header.background;
    if (!count) return noKeys();
    if (!renderer) try { renderer = new SplatRenderer($("local"), () => new Worker("sort.js")); renderer.onchange = () => { if (sides.a.is < REST || !$("local").hidden) drawLocal(); }; } catch { broken = true; return; }
    clip.ready = false;
  }
  if (count !== clip.count) return noKeys();
  // Over a slow line keys would be in the way of images.
  if (buffer.byteLength / spent < SLOW && spent > 500) noKeys();
  const k = clip.times.findIndex((t) => Math.abs(t - time) < 1e-4);
  if (k < 0 || clip.have.has(k)) return;
  clip.have.add(k);
  const one = { time: clip.times[k], words };
  if (!clip.ready) { renderer.setClip({ count, keys: [one], background: clip.background }); clip.ready = true; } else renderer.addKey(one);
}
const holdsAll = () => renderer && renderer.state === "ready" && clip && clip.ready && canDraw() && clip.name === clipName() && around().every((k) => clip.have.has(k));
// Draws the present view from the clip with the next picture of the page; false where it does not hold what is needed.
let due = false;
function drawLocal() {
  if (!holdsAll()) { if ($("a").width > 0) $("local").hidden = true; return false; }
  if (!due) { due = true; requestAnimationFrame(paintLocal); }
  return true;
}
function paintLocal(begun) {
  due = false;
  if (!holdsAll()) return;
  const factor = Math.min(devicePixelRatio || 1, 2) / localShrink, side = (v) => Math.max(16, Math.round(v * factor)), camera = cameraOf(side(stage.clientWidth), side(stage.clientHeight));
  renderer.draw(camera, state.t);
  fit($("local"), camera);
  if (!renderer.order) return;
  $("local").hidden = false;
  frames.push(begun);
  // Drawing is done elsewhere: the next picture of the page comes late where it takes long.
  requestAnimationFrame((now) => { const spent = now - begun; localShrink = Math.min(4, Math.max(1, localShrink * (spent > PACE ? 1.15 : spent < 0.7 * PACE ? 0.95 : 1))); });
}
// Begin of the last local images, for the pace.
const frames = { times: [], push(t) { this.times.push(t); if (this.times.length > 60) this.times.shift(); }, rate() { const t = this.times; return t.length > 1 ? (1000 * (t.length - 1)) / (t[t.length - 1] - t[0]) : 0; } };
