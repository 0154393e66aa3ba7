"use strict";
// Vectors of three numbers.
const add = (a, b, k = 1) => a.map((v, i) => v + k * b[i]);
const dot = (a, b) => a.reduce((s, v, i) => s + v * b[i], 0);
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
const unit = (a) => { const n = Math.hypot(...a); return n > 0 ? a.map((v) => v / n) : [0, 0, 1]; };
// A vector turned about a unit axis, radians.
function turn(v, axis, angle) {
  const c = Math.cos(angle), s = Math.sin(angle), along = dot(v, axis) * (1 - c), side = cross(axis, v);
  return v.map((x, i) => x * c + side[i] * s + axis[i] * along);
}
