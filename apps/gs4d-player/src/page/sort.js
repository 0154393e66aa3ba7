"use strict";
// Sorts splats by depth, back to front, for a camera and a time. A worker.
//   in   { clip, count, near, dilation }        a new clip, without keys; splats nearer than `near` (world units) are not drawn
//        { time, words }                        one of its keys
//        { id, camera, time, order }            asks for an order; the array of an old one comes back to be filled again
//   out  { clip, id, order, count }             the first count entries are indices of splats, the farthest first
const sortMargin = 0.1; // widths of the image around it in which splats are kept: the camera turns while the sort runs
const sortRow = 1024; // orders have whole rows of the renderer's texture
const sortPlain = Math.sqrt(2 * Math.log(255)), sortBent = Math.sqrt(4 * Math.log(255)); // standard deviations at which an opaque splat ends: the Gaussian, the widest kernel
const sortLow = new Uint32Array(1 << 16), sortHigh = new Uint32Array(1 << 16); // histograms of the halves of a depth
let sortClip = 0, sortCount = 0, sortKeys = [], sortNear = 0.01, sortReach = 0; // sortReach: of the dilation alone, pixels
let sortDepths = null, sortBits = null, sortSeen = null, sortPass = null;

function sortStart({ clip, count, near, dilation }) {
  [sortClip, sortCount, sortKeys, sortNear, sortReach] = [clip, count, [], near, 1 + sortBent * Math.sqrt(dilation)];
  sortDepths = new Float32Array(count);
  sortBits = new Uint32Array(sortDepths.buffer);
  sortSeen = new Uint32Array(count);
  sortPass = new Uint32Array(count);
}
const sortHalf = (h) => {
  const e = (h >>> 10) & 31, m = h & 1023, v = e === 0 ? m * 2 ** -24 : e < 31 ? 2 ** (e - 15) * (1 + m / 1024) : m ? NaN : Infinity;
  return h & 0x8000 ? -v : v;
};
// A key keeps x, y, z and the radius, world units; 0 where nothing is seen.
function sortAdd(time, words) {
  const floats = new Float32Array(words.buffer, words.byteOffset, words.length), points = new Float32Array(4 * sortCount);
  for (let i = 0; i < sortCount; i++) {
    const w = 8 * i, s = words[w + 6], last = words[w + 7], bent = ((last >>> 16) & 255) !== last >>> 24;
    const scale = Math.exp(Math.max(sortHalf(s & 0xffff), sortHalf(s >>> 16), sortHalf(last & 0xffff)));
    for (let k = 0; k < 3; k++) points[4 * i + k] = floats[w + k];
    points[4 * i + 3] = words[w + 3] >>> 24 ? scale * (bent ? sortBent : sortPlain) : 0;
  }
  sortKeys = sortKeys.filter((k) => k.time !== time).concat({ time, points }).sort((a, b) => a.time - b.time);
}
// Writes what the camera sees into sortSeen and sortBits, and returns how many.
function sortCull({ viewmat: m, fx, fy, cx, cy, width, height }, time) {
  let k = 0;
  while (k < sortKeys.length - 2 && sortKeys[k + 1].time <= time) k++;
  const from = sortKeys[k], to = sortKeys[Math.min(k + 1, sortKeys.length - 1)], p = from.points, q = to.points;
  const t = from === to ? 0 : Math.min(1, Math.max(0, (time - from.time) / (to.time - from.time)));
  const focal = Math.max(fx, fy), beyond = sortReach + sortMargin * width, ex = (0.15 * width) / fx, ey = (0.15 * height) / fy;
  const left = -cx / fx - ex, right = (width - cx) / fx + ex, top = -cy / fy - ey, bottom = (height - cy) / fy + ey;
  let n = 0;
  // From the last to the first: of two at one depth the first is in front.
  for (let i = sortCount - 1; i >= 0; i--) {
    const j = 4 * i, radius = Math.max(p[j + 3], q[j + 3]);
    if (!(radius > 0)) continue;
    const x = p[j] + t * (q[j] - p[j]), y = p[j + 1] + t * (q[j + 1] - p[j + 1]), z = p[j + 2] + t * (q[j + 2] - p[j + 2]);
    const depth = m[8] * x + m[9] * y + m[10] * z + m[11];
    if (!(depth > sortNear)) continue;
    const u = (m[0] * x + m[1] * y + m[2] * z + m[3]) / depth, v = (m[4] * x + m[5] * y + m[6] * z + m[7]) / depth;
    const a = Math.min(Math.max(u, left), right), b = Math.min(Math.max(v, top), bottom);
    // The largest eigenvalue of the projected covariance is at most (f s / z)² (1 + a² + b²), and its dilation.
    const reach = ((radius * focal) / depth) * Math.sqrt(1 + a * a + b * b) + beyond, column = fx * u + cx, row = fy * v + cy;
    if (column + reach < 0 || column - reach > width || row + reach < 0 || row - reach > height) continue;
    sortDepths[n] = depth;
    sortSeen[n++] = i;
  }
  return n;
}
// Two stable passes of counting over the 32 bits of the depth, whose order is that of positive floats.
function sortOrder(order, n) {
  sortLow.fill(0); sortHigh.fill(0);
  for (let i = 0; i < n; i++) {
    const bits = (sortBits[i] = ~sortBits[i]);
    sortLow[bits & 0xffff]++; sortHigh[bits >>> 16]++;
  }
  for (let d = 0, low = 0, high = 0; d < 1 << 16; d++) {
    const l = sortLow[d], h = sortHigh[d];
    sortLow[d] = low; sortHigh[d] = high;
    low += l; high += h;
  }
  for (let i = 0; i < n; i++) sortPass[sortLow[sortBits[i] & 0xffff]++] = i;
  for (let i = 0; i < n; i++) { const k = sortPass[i]; order[sortHigh[sortBits[k] >>> 16]++] = sortSeen[k]; }
}
onmessage = ({ data }) => {
  if (data.words) return sortAdd(data.time, data.words);
  if (!data.camera) return sortStart(data);
  const room = sortRow * Math.ceil(sortCount / sortRow), old = data.order, order = old && old.length === room ? old : new Uint32Array(room);
  const count = sortKeys.length ? sortCull(data.camera, data.time) : 0;
  sortOrder(order, count);
  postMessage({ clip: sortClip, id: data.id, order, count }, [order.buffer]);
};
