"use strict";
// The page requests one image at a time, the two sides in turn; a newer request of a side replaces one not yet sent.
const key = new URLSearchParams(location.search).get("k") || "";
const FAST = 80; // milliseconds an image may take while something moves
const COARSE = 0, REST = 1, FINE = 2, MOST = 3840 * 2160; // levels of images; pixels of the largest
let version = 0, moves = 0; // raised whenever the present image is no longer what is wanted; the second where it is of another camera, time or layer
let socket = null, next = 1, busy = null, playing = false, moving = 0, shrink = 1, live = false, arriving = false, file = null, chosen = null, parts = [], missing = 0, came = 0; // came: when the first part of the present answer did
const sides = { a: { want: null, is: -1, shown: 0 }, b: { want: null, is: -1, shown: 0 } };
const wanted = () => (state.compare === "wipe" || state.compare === "flicker" ? ["a", "b"] : ["a"]);
const finest = () => (live ? REST : FINE); // a run under training gets no supersampled images
function target(side) {
  const [show, layer, checkpoint] = state[side];
  return checkpoint >= 0 ? { show, layer, checkpoint } : { show, layer };
}
function ask(side, level) { sides[side].want = level; pump(); }
function size(level) {
  const pixels = Math.min(devicePixelRatio || 1, 2, Math.sqrt(MOST / (stage.clientWidth * stage.clientHeight || 1)));
  const factor = pixels / (level === COARSE ? shrink : 1), side = (v) => Math.max(16, Math.floor(v * factor));
  return { width: side(stage.clientWidth), height: side(stage.clientHeight) };
}
function pump() {
  if (busy || !socket || socket.readyState !== 1 || !shows.length) return;
  if (file) return send({ side: "file", file }, { ...scene("a", REST), ...file });
  const still = !playing && performance.now() - moving > 400, bring = (what) => send({ side: "key", fetching: what }, { ...scene(what.local.side, COARSE), time: what.time, save: "splats" });
  const paint = (thumb) => { thumb.asked = true; send({ side: "thumb", thumb }, thumb.question()); };
  if (live && still && sides.a.shown) {
    // A run under training is never at rest for long: splats and thumbnails do not wait for that.
    const newer = wantedKey(true), small = newer ? null : wantedThumb();
    if (newer) return bring(newer);
    if (small) return paint(small);
  }
  const order = pump.last === "a" ? ["b", "a"] : ["a", "b"], side = order.find((s) => sides[s].want !== null && wanted().includes(s));
  if (side) {
    const s = sides[side], level = s.want, question = scene(side, level);
    if (level === FINE) question.fine = true;
    if (side === "a" && level >= REST) {
      question.score = level >= finest();
      if (state.arrows) question.arrows = true;
      if (chosen) question.chosen = chosen;
      if (s.pick) { question.pick = s.pick; s.pick = null; }
    }
    s.want = null; pump.last = side;
    return send({ side, level }, question);
  }
  if (!still || !wanted().every((s) => sides[s].is >= REST)) return;
  // What the next drag needs, then thumbnails, then what playing needs.
  const near = wantedKey(true), thumb = near === null ? wantedThumb() : null, fetching = thumb ? null : near ?? wantedKey(false);
  if (thumb) return paint(thumb);
  if (fetching) bring(fetching);
}
function scene(side, level) {
  const question = { what: target(side), time: state.t, look: look(), ...size(level) };
  if (state.compare === "difference" && side === "a") Object.assign(question, { against: target("b"), gain: state.gain });
  if (state.hidden.length) question.hidden = state.hidden;
  const view = about().views[state.view], enlarge = !state.compare && level > COARSE;
  if (view && enlarge && state[side][1] !== "truth") question.enlarge = true;
  if (state.style === "points") question.style = { points: pointSize(question, question.enlarge ? Infinity : view ? view.width : Infinity) };
  else if (state.style !== "splats") question.style = state.style;
  if (state.back) question.background = state.back;
  const pose = posing();
  if (pose) question.pose = pose;
  return question;
}
// The pose that was chosen for a person; null for the one at the time of the image.
function posing() {
  const { joints } = about(), turned = Object.entries(state.pose.turns).filter(([j, a]) => joints && j < joints.length && a.some(Boolean));
  const turns = turned.map(([j, a]) => [Number(j), a.map((d) => (d * Math.PI) / 180)]);
  return joints && (turns.length || state.pose.from !== null) ? { from: state.pose.from, turns } : null;
}
// Points keep their size in the window, whatever the size of the image.
function pointSize({ width, height }, most) {
  const image = Math.min(most, cameraOf(width, height).width), shown = cameraOf(stage.clientWidth, stage.clientHeight).width;
  return Math.min(32, Math.max(0.5, (state.size * image) / shown));
}
function send(what, question) {
  busy = { id: next++, sent: performance.now(), heard: performance.now(), version, moves, of: moment(), picking: question.pick, ...what };
  socket.send(JSON.stringify({ id: busy.id, ...question }));
}
function changed() { moving = performance.now(); sides.a.pick = null; if (busy) busy.picking = null; save(); again(); }
function again() {
  version++; moves++;
  lines();
  const here = drawLocals();
  for (const side of ["a", "b"]) {
    sides[side].is = here[side] ? COARSE : -1;
    document.body.dataset[side] = here[side] ? `${state[side][1]} here moving` : "waiting";
    if (sides[side].is < COARSE) ask(side, COARSE); else sides[side].want = null;
  }
}
// Asks for what is finer than what is shown once nothing has moved for a while.
function settle() {
  const still = performance.now() - moving, best = still < 600 ? REST : finest();
  for (const side of wanted()) {
    const s = sides[side], idle = s.want === null && !(busy && busy.side === side);
    if (idle && s.is < best && !playing && still > 180) ask(side, Math.max(s.is + 1, REST));
  }
  if (busy && performance.now() - busy.heard > 60000) giveUp();
  pump();
}
// What was asked for will not be answered; a pick is asked for again.
function giveUp() {
  if (busy && busy.picking && !sides.a.pick) { sides.a.pick = busy.picking; sides.a.is = Math.min(sides.a.is, COARSE); }
  if (busy && busy.file && busy.file === file) { file = null; notice("The viewer has not answered for a minute: nothing was saved."); }
  busy = null;
}
// An answer comes in parts: lengths of header and body (u32 each, little-endian), header (JSON), body.
function collect(part) {
  if (!missing) { const view = new DataView(part); parts = []; came = performance.now(); missing = 8 + view.getUint32(0, true) + view.getUint32(4, true); }
  parts.push(part); missing -= part.byteLength;
  if (busy) busy.heard = performance.now();
  if (!missing) { received(parts); parts = []; }
}
async function received(parts) {
  const data = await new Blob(parts).arrayBuffer(), length = new DataView(data).getUint32(0, true);
  const header = JSON.parse(new TextDecoder().decode(new Uint8Array(data, 8, length))), rest = new Uint8Array(data, 8 + length);
  if (!busy || header.id !== busy.id) return;
  const { side, level, sent, thumb, fetching, moves: at, of, file: saved } = busy, now = performance.now(), spent = now - sent, onLine = now - came, stale = busy.version !== version;
  // An answer for what is no longer wanted is shown at most; what is wanted is asked for all the same.
  if (sides[side] && !stale) sides[side].is = level;
  busy = null;
  if (side === "file") { if (file === saved) file = null; pump(); return download(header.file, rest); }
  if (side === "key") { fetching.local.got(fetching, rest.slice().buffer, header, onLine); return pump(); }
  pump();
  if (level === COARSE) shrink = Math.min(8, Math.max(1, shrink * (spent > FAST ? 1.25 : spent < FAST / 2 ? 0.85 : 1)));
  const bitmap = await createImageBitmap(new Blob([rest])), canvas = thumb ? thumb.canvas : $(side);
  // What has moved on meanwhile is drawn in the browser; an older image does not follow a newer one.
  if (!thumb && (header.id < sides[side].shown || (locals[side].drawn && at !== moves))) return;
  if (!thumb) sides[side].shown = header.id;
  canvas.width = bitmap.width; canvas.height = bitmap.height;
  canvas.getContext("2d").drawImage(bitmap, 0, 0);
  if (thumb) return;
  fit(canvas, bitmap);
  locals[side].hide();
  document.body.dataset[side] = `${header.layer} ${header.width}x${header.height} ${["moving", "rest", "fine"][level]}`;
  if (side === "a") showStatus(header, spent, of);
  place();
}
// Shows a canvas as large as its aspect ratio allows.
function fit(canvas, { width, height }) {
  const scale = Math.min(stage.clientWidth / width, stage.clientHeight / height);
  canvas.style.width = width * scale + "px"; canvas.style.height = height * scale + "px";
}
function download(name, bytes) {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(new Blob([bytes])); link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10000);
  const what = name.endsWith(".ply") ? ": plain Gaussians, colours as this camera sees them" : "";
  $("status").textContent = `saved ${name}, ${bytes.length.toLocaleString("en")} bytes${what}`;
}
function open() {
  missing = 0;
  socket = new WebSocket(`ws://${location.host}/ws?k=${encodeURIComponent(key)}`);
  socket.binaryType = "arraybuffer";
  socket.onmessage = (m) => {
    if (typeof m.data !== "string") return collect(m.data);
    const message = JSON.parse(m.data);
    if (message.shows) return begin(message);
    if (message.listed) return listShows(message.listed);
    if (message.paused !== undefined) showPaused(message.paused);
    if (message.news) return news(message.news);
    if (message.later) { if (busy && message.id === busy.id) { busy.fetching.local.later(); busy = null; pump(); } return; }
    if (!message.error) return;
    const ours = busy && message.id === busy.id;
    if (ours && busy.side === "key") busy.fetching.local.fail(); else if (!ours || busy.side !== "thumb") notice(message.error);
    if (ours) { if (sides[busy.side]) sides[busy.side].is = FINE; if (busy.file && file === busy.file) file = null; busy = null; pump(); }
  };
  socket.onclose = () => { notice(live && !arriving ? "Training has ended, or the connection is lost; trying again." : "The viewer has stopped or the connection is lost; trying again."); if (busy && busy.file) busy = null; else giveUp(); setTimeout(open, 2000); };
}
