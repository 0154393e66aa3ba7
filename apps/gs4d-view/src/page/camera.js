"use strict";
// The camera and its motion: orbit, pan, fly, views of the dataset.
const $ = (id) => document.getElementById(id);
const stage = $("stage");
let shows = [];
const state = {
  eye: [0, 0, -4], target: [0, 0, 0], up: [0, -1, 0], fov: 0.8, t: 0, view: -1, a: [0, "color", -1], b: [0, "truth", -1], compare: "", cut: 0.5, gain: 4,
  cameras: false, arrows: false, axes: false, grid: false, style: "splats", size: 4, back: null, hidden: [], pose: { from: null, turns: {} },
};
const about = () => shows[state.a[0]];

const forward = () => unit(add(state.target, state.eye, -1));
const right = () => unit(cross(forward(), state.up));
const distance = () => Math.hypot(...add(state.eye, state.target, -1));

function orbit(dx, dy) {
  leaveView();
  let away = add(state.eye, state.target, -1);
  away = turn(away, unit(state.up), -dx);
  const tilted = turn(away, right(), -dy);
  if (Math.abs(dot(unit(tilted), unit(state.up))) < 0.995) away = tilted;
  state.eye = add(state.target, away);
  changed();
}
function shift(by) { leaveView(); state.eye = add(state.eye, by); state.target = add(state.target, by); changed(); }
function pan(dx, dy) {
  const far = distance() * Math.tan(state.fov / 2) * 2;
  shift(add(right().map((v) => -v * dx * far), cross(right(), forward()).map((v) => v * dy * far)));
}
function dolly(factor) { leaveView(); state.eye = add(state.target, add(state.eye, state.target, -1), factor); changed(); }
function walk(ahead, aside) { const far = 0.05 * distance(); shift(add(forward().map((v) => v * ahead * far), right(), aside * far)); }
function frameScene() {
  leaveView();
  const back = unit(add(state.eye, state.target, -1));
  state.target = about().centre;
  state.eye = add(state.target, back, (2.2 * about().radius) / Math.tan(state.fov / 2));
  changed();
}
// The next of y, z and x, towards either side, becomes up.
function nextUp() {
  leaveView();
  const all = [[0, -1, 0], [0, 1, 0], [0, 0, 1], [0, 0, -1], [1, 0, 0], [-1, 0, 0]], now = unit(state.up);
  const nearest = all.reduce((best, v, k) => (dot(v, now) > dot(all[best], now) ? k : best), 0);
  const next = (k) => all[k % all.length];
  // An axis along the line of sight cannot be up.
  let k = nearest + 1;
  while (Math.abs(dot(next(k), forward())) > 0.98) k += 1;
  state.up = next(k);
  changed();
}
// The field of view of the whole stage: wider than that of a view, whose image may be narrower.
function stageFov() {
  if (state.view < 0) return state.fov;
  const v = about().views[state.view], shown = v.width * Math.min(stage.clientWidth / v.width, stage.clientHeight / v.height);
  return Math.min(2.5, 2 * Math.atan((Math.tan(state.fov / 2) * stage.clientWidth) / Math.max(shown, 1)));
}
// A free camera fills the stage; what is seen keeps the size it had in the narrower image of a view.
function leaveView() {
  if (state.view < 0) return;
  state.fov = stageFov();
  state.view = -1; $("view").value = "-1";
  layers(); showFov();
}
function snap(number) {
  const v = about().views[number];
  state.view = v ? number : -1;
  $("view").value = state.view;
  if (v) {
    const far = Math.max(Math.abs(dot(add(about().centre, v.eye, -1), v.forward)), 1e-3);
    Object.assign(state, { eye: v.eye, target: add(v.eye, v.forward, far), up: v.up, fov: v.fov, t: v.time });
    $("t").value = state.t; showTime();
  }
  layers(); showFov(); changed();
}
const look = () => (state.view >= 0 ? { view: [state.a[0], state.view] } : { free: [state.eye, state.target, state.up, state.fov] });

// The camera of an image of at most that size: rows of the world-to-camera matrix, OpenCV axes, and the intrinsics in pixels.
function cameraOf(width, height) {
  const f = forward(), r = right(), d = cross(f, r), row = (v) => [...v, -dot(v, state.eye)], viewmat = [...row(r), ...row(d), ...row(f)];
  const v = state.view >= 0 ? about().views[state.view] : null;
  if (!v) { const focal = width / 2 / Math.tan(state.fov / 2); return { viewmat, fx: focal, fy: focal, cx: width / 2, cy: height / 2, width, height }; }
  const s = Math.min(width / v.width, height / v.height), w = Math.max(1, Math.round(s * v.width)), h = Math.max(1, Math.round(s * v.height)), x = w / v.width, y = h / v.height;
  return { viewmat, fx: v.fx * x, fy: v.fy * y, cx: v.cx * x, cy: v.cy * y, width: w, height: h };
}
// A point of the world on the stage; null behind the camera.
function project(p) {
  const s = [stage.clientWidth, stage.clientHeight], c = cameraOf(...s), m = c.viewmat, at = (k) => m[4 * k] * p[0] + m[4 * k + 1] * p[1] + m[4 * k + 2] * p[2] + m[4 * k + 3], z = at(2);
  if (z <= 1e-6) return null;
  return [(s[0] - c.width) / 2 + c.cx + (c.fx * at(0)) / z, (s[1] - c.height) / 2 + c.cy + (c.fy * at(1)) / z];
}
// Corners of what a view of the data sees at a distance, from its eye.
function frustum(v, far) {
  const r = unit(cross(v.forward, v.up)), w = Math.tan(v.fov / 2) * far, h = (w * v.height) / v.width, ahead = add(v.eye, v.forward, far);
  return [[-1, -1], [1, -1], [1, 1], [-1, 1]].map(([x, y]) => add(add(ahead, r, x * w), v.up, y * h));
}
