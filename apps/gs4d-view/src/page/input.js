"use strict";
// Mouse, touch and keyboard.
const pointers = new Map();
let drag = null;
stage.addEventListener("pointerdown", (e) => {
  if (e.target.id === "cut") return;
  flying = null;
  pointers.set(e.pointerId, [e.clientX, e.clientY]);
  drag = { x: e.clientX, y: e.clientY, x0: e.clientX, y0: e.clientY, far: pointers.size > 1 ? 100 : 0, pan: e.shiftKey || e.button === 2, box: isBoxing() && pointers.size === 1 };
  stage.setPointerCapture(e.pointerId);
});
// Two fingers: their middle pans, their distance zooms.
function pinch(e) {
  const before = [...pointers.values()];
  pointers.set(e.pointerId, [e.clientX, e.clientY]);
  const now = [...pointers.values()], middle = (p) => [0, 1].map((k) => (p[0][k] + p[1][k]) / 2), apart = (p) => Math.hypot(p[0][0] - p[1][0], p[0][1] - p[1][1]), [m, n] = [middle(before), middle(now)];
  pan((n[0] - m[0]) / stage.clientWidth, (n[1] - m[1]) / stage.clientWidth);
  if (apart(now) > 10 && apart(before) > 10) dolly(apart(before) / apart(now));
}
stage.addEventListener("pointermove", (e) => {
  if (!drag || !pointers.has(e.pointerId)) return;
  if (pointers.size > 1) return pinch(e);
  const dx = e.clientX - drag.x, dy = e.clientY - drag.y;
  drag.x = e.clientX; drag.y = e.clientY; drag.far += Math.abs(dx) + Math.abs(dy);
  pointers.set(e.pointerId, [e.clientX, e.clientY]);
  if (drag.box) return dragBox(e, drag);
  if (drag.far < 4) return;
  if (drag.pan) pan(dx / stage.clientWidth, dy / stage.clientWidth); else orbit(dx * 0.008, dy * 0.008);
});
stage.addEventListener("pointerup", (e) => {
  if (!pointers.delete(e.pointerId) || !drag) return;
  if (drag.box) endBox(e, drag);
  else if (drag.far < 4) {
    const at = shareAt(e.clientX, e.clientY);
    if (at.every((v) => v >= 0 && v < 1)) pickAt(at);
  }
  // The finger that stays goes on from where it is.
  const [rest] = pointers.values();
  drag = rest ? { ...drag, x: rest[0], y: rest[1], far: 100 } : null;
});
stage.addEventListener("pointercancel", (e) => { pointers.delete(e.pointerId); drag = null; $("box").hidden = true; });
stage.addEventListener("contextmenu", (e) => e.preventDefault());
stage.addEventListener("wheel", (e) => { e.preventDefault(); flying = null; dolly(Math.exp(e.deltaY * 0.001)); }, { passive: false });
const KEYS = {
  "+": () => dolly(0.9), "=": () => dolly(0.9), "-": () => dolly(1.1), w: () => walk(1, 0), s: () => walk(-1, 0), a: () => walk(0, -1), d: () => walk(0, 1),
  " ": () => play(!playing), f: frameScene, u: nextUp, x: swap, ",": () => stepTime(-1), ".": () => stepTime(1), "[": () => nextView(-1), "]": () => nextView(1),
  Enter: () => pickAt([0.5, 0.5]), b: () => choose([0.3, 0.3, 0.7, 0.7]), v: () => $("arrows").click(), c: () => $("cameras").click(), g: () => $("grid").click(), m: addBookmark, k: addKey, p: () => fold(),
  Escape: () => { unchoose(); paths = []; flying = null; lines(); },
};
stage.addEventListener("keydown", (e) => {
  const step = 0.06, arrow = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[e.key];
  if (!shows.length || e.ctrlKey || e.metaKey || e.altKey || e.target.id === "cut") return;
  const act = arrow ? () => (e.shiftKey ? pan(-step * arrow[0], -step * arrow[1]) : orbit(step * arrow[0], step * arrow[1])) : KEYS[e.key] || KEYS[e.key.toLowerCase()];
  if (act) { e.preventDefault(); act(); }
});
$("t").addEventListener("input", (e) => setTime(Number(e.target.value)));
$("t").addEventListener("keydown", (e) => { if (e.key === " ") { e.preventDefault(); play(!playing); } });
$("play").addEventListener("click", () => play(!playing));
$("loop").addEventListener("click", () => { looping = !looping; $("loop").setAttribute("aria-pressed", looping); });
