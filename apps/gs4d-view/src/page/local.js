"use strict";
// Images drawn in the browser while something moves, each side of a comparison by itself. At rest the server's image, which is exact, takes their place.
const WORDS = 32, MEMORY = 192 << 20, MAX_KEYS = 90; // bytes of a splat, bytes of all keys, keys
const SLOW = 2000; // bytes a millisecond
const PACE = 36; // milliseconds until the next image, at most
const AGAIN = 2000; // milliseconds until the splats of a run under training are fetched again, at least
const PLAIN = ["truth", "depth", "alpha", "count"]; // layers that are no colours of splats
let localShrink = 1, due = false, trained = 0; // trained: the step of the newest copy of a run under training

// What one side draws: splats at some times (a clip) of its show and layer.
class Local {
  constructor(side) { Object.assign(this, { side, canvas: $("local-" + side), renderer: null, clip: null, broken: false, drawn: false }); }
  get show() { return shows[state[this.side][0]]; }
  // A run under training has splats of the present time alone, fetched again from each copy.
  get live() { return live && state[this.side][0] === 0 && state[this.side][2] < 0; }
  // What the splats of the clip depend on besides time and camera.
  get name() { return JSON.stringify([target(this.side), state.hidden, state.pose, state.style, state.back, this.live && state.t]); }
  get can() { return !this.broken && !arriving && wanted().includes(this.side) && state.compare !== "difference" && state.style !== "points" && !PLAIN.includes(state[this.side][1]); }
  get memory() { return this.side === "a" ? MEMORY : MEMORY / 2; }
  // Times of the keys: as many as training timestamps, at most those that fit into the memory.
  times(count) {
    const s = this.show;
    if (this.live) return [state.t];
    if (!s.moving) return [0];
    const most = Math.min(MAX_KEYS, Math.floor(this.memory / (WORDS * Math.max(count, 1)))), n = Math.max(2, Math.min(most, Math.ceil(1.25 * s.times.length)));
    return Array.from({ length: n }, (_, k) => (FIRST() + ((LAST() - FIRST()) * k) / (n - 1)));
  }
  // Indices of the keys on both sides of the present time.
  around() {
    const { times } = this.clip, k = times.findIndex((t) => t >= state.t - 1e-6);
    if (k < 0) return [times.length - 1];
    return k === 0 || Math.abs(times[k] - state.t) < 1e-6 ? [k] : [k - 1, k];
  }
  // The time of the key that is fetched next; null if there is none. Those around the present time come first, or alone.
  wanted(nearOnly) {
    if (!this.can || (!this.live && sides[this.side].is < REST)) return null;
    if (this.show.splats * WORDS * (this.show.moving ? 2 : 1) > this.memory) return null;
    if (!this.clip || this.clip.name !== this.name) this.clip = { name: this.name, times: this.times(this.show.splats), count: null, have: new Set() };
    const { clip } = this;
    if (clip.failed || clip.after > performance.now()) return null;
    if (this.live && clip.ready) return clip.step !== trained && performance.now() - clip.since > AGAIN ? clip.times[0] : null;
    const open = clip.times.map((t, k) => k).filter((k) => !clip.have.has(k));
    if (!open.length) return null;
    const next = this.around().find((k) => !clip.have.has(k));
    if (next === undefined && nearOnly) return null;
    const near = next ?? open.reduce((a, b) => (Math.abs(clip.times[b] - state.t) < Math.abs(clip.times[a] - state.t) ? b : a));
    return clip.times[near];
  }
  fail() { if (this.clip) this.clip.failed = true; }
  // The viewer has no room for splats: they are asked for again.
  later() { if (this.clip) { this.clip.pause = Math.min(60000, 2 * (this.clip.pause || 1000)); this.clip.after = performance.now() + this.clip.pause; } }
  // An answer, which was so many milliseconds on the line; `step` is that of the copy when it was asked for.
  got({ time, name, step }, buffer, header, onLine) {
    const { clip } = this;
    if (!clip || clip.name !== name) return;
    const words = new Uint32Array(buffer), count = words.length / 8;
    if (clip.count === null || (this.live && count !== clip.count)) {
      Object.assign(clip, { count, background: header.background, raster: header.raster, ready: false });
      if (!count) return this.fail();
      if (!this.begin()) return;
    }
    if (count !== clip.count) return this.fail();
    // Over a slow line keys would be in the way of images.
    if (buffer.byteLength / onLine < SLOW && onLine > 500) this.fail();
    const k = clip.times.findIndex((t) => Math.abs(t - time) < 1e-4);
    if (k < 0 || (clip.have.has(k) && !this.live)) return;
    clip.have.add(k);
    Object.assign(clip, { step, since: performance.now(), pause: 0 });
    const one = { time: clip.times[k], words };
    try {
      if (clip.ready) return this.renderer.addKey(one);
      this.renderer.setClip({ count, keys: [one], background: clip.background, ...clip.raster });
      clip.ready = true;
    } catch { this.broken = true; } // more splats than a texture of this device holds
  }
  // A renderer; false where there can be none.
  begin() {
    if (this.renderer) return true;
    try {
      this.renderer = new SplatRenderer(this.canvas, () => new Worker("sort.js"));
      this.renderer.onchange = () => { if (sides[this.side].is < REST || this.drawn) this.draw(); };
    } catch { this.broken = true; }
    return !this.broken;
  }
  // The splats of a side that is not compared any more are given back.
  end() {
    if (this.renderer) this.renderer.dispose();
    Object.assign(this, { renderer: null, clip: null });
    this.hide();
  }
  get holdsAll() { const { clip, renderer } = this; return renderer && renderer.state === "ready" && clip && clip.ready && this.can && clip.name === this.name && this.around().every((k) => clip.have.has(k)); }
  // Draws the present view from the clip with the next picture of the page; false where it does not hold what is needed.
  draw() {
    if (!this.holdsAll) { if ($(this.side).width > 0) this.hide(); return false; }
    if (!due) { due = true; requestAnimationFrame(paintLocal); }
    return true;
  }
  paint(camera) {
    if (!this.holdsAll || sides[this.side].is >= REST) return false;
    try { this.renderer.draw(camera, state.t); } catch { this.broken = true; this.hide(); again(); return false; }
    fit(this.canvas, camera);
    if (!this.renderer.order) return false;
    this.drawn = true;
    return true;
  }
  hide() { this.drawn = false; placeLocal(); }
}
const locals = { a: new Local("a"), b: new Local("b") };
// What is drawn here covers the server's image of its side, as far as that is seen.
function placeLocal() {
  for (const { side, canvas, drawn } of Object.values(locals)) {
    canvas.hidden = !drawn || (side === "b" && $("b").hidden);
    canvas.style.clipPath = side === "b" ? $("b").style.clipPath : "";
  }
}
function drawLocals() {
  if (!wanted().includes("b") && locals.b.renderer) locals.b.end();
  return { a: locals.a.draw(), b: locals.b.draw() };
}
// The key that is fetched next, and of which side.
function wantedKey(nearOnly) {
  for (const local of wanted().map((side) => locals[side])) {
    const time = local.wanted(nearOnly);
    if (time !== null) return { local, time, name: local.name, step: trained };
  }
  return null;
}
function paintLocal(begun) {
  due = false;
  const factor = Math.min(devicePixelRatio || 1, 2) / localShrink, side = (v) => Math.max(16, Math.round(v * factor)), camera = cameraOf(side(stage.clientWidth), side(stage.clientHeight));
  const painted = Object.values(locals).filter((local) => local.paint(camera)).length;
  placeLocal();
  if (!painted) return;
  frames.push(begun);
  // Drawing is done elsewhere: the next picture of the page comes late where it takes long.
  requestAnimationFrame((now) => { const spent = now - begun; localShrink = Math.min(4, Math.max(1, localShrink * (spent > PACE ? 1.15 : spent < 0.7 * PACE ? 0.95 : 1))); });
}
// Begin of the last local images, for the pace.
const frames = { times: [], push(t) { this.times.push(t); if (this.times.length > 60) this.times.shift(); }, rate() { const t = this.times; return t.length > 1 ? (1000 * (t.length - 1)) / (t[t.length - 1] - t[0]) : 0; } };
