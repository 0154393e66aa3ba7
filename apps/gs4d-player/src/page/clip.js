"use strict";
// The scene of the page: read from its bytes, and turned into the words of the renderer frame by frame.
class ByteReader {
  constructor(bytes) { this.all = bytes; this.at = 0; }
  bytes(n) { this.at += n; if (this.at > this.all.length) throw new RangeError("the scene of this page is cut short"); return this.all.subarray(this.at - n, this.at); }
  unsigned() { let v = 0, shift = 0, byte; do { byte = this.bytes(1)[0]; v |= (byte & 127) << shift; shift += 7; } while (byte > 127); return v >>> 0; }
  signed() { const v = this.unsigned(); return (v >>> 1) ^ -(v & 1); }
}
// Values of one attribute at key frames of each splat's own, in multiples of a step, linear in between.
function readTrack(from, width, count) {
  const steps = Float32Array.from(new Int8Array(from.bytes(count)), (e) => 2 ** e), starts = new Uint32Array(count + 1);
  for (let i = 0; i < count; i++) starts[i + 1] = starts[i] + from.unsigned();
  const frames = new Uint16Array(starts[count]), values = new Int32Array(starts[count] * width);
  for (let i = 0; i < count; i++) for (let k = starts[i] + 1; k < starts[i + 1]; k++) frames[k] = frames[k - 1] + from.unsigned();
  for (let c = 0; c < width; c++) for (let i = 0; i < count; i++) for (let k = starts[i], last = 0; k < starts[i + 1]; k++) values[k * width + c] = last += from.signed();
  return { width, steps, starts, frames, values };
}
function trackAt({ width, steps, starts, frames, values }, splat, frame, out) {
  let k = starts[splat];
  const end = starts[splat + 1] - 1;
  while (k < end && frames[k + 1] <= frame) k++;
  const next = Math.min(k + 1, end), span = frames[next] - frames[k], share = span > 0 ? (frame - frames[k]) / span : 0;
  for (let c = 0; c < width; c++) { const a = values[k * width + c]; out[c] = steps[splat] * (a + share * (values[next * width + c] - a)); }
}
// The bits of a number in half precision, for magnitudes below 65504; tiny ones are 0.
const halfFloat = new Float32Array(1), halfBits = new Uint32Array(halfFloat.buffer);
function half(v) {
  halfFloat[0] = v;
  const b = halfBits[0] + 0x1000, e = ((b >>> 23) & 255) - 112;
  return e <= 0 ? 0 : ((b >>> 16) & 0x8000) | (Math.min(e, 30) << 10) | ((b >>> 13) & 1023);
}
const byteOf = (v) => Math.min(255, Math.max(0, Math.round(255 * v)));
const snorm = (v) => Math.round(32767 * v) & 0xffff;

class Clip {
  constructor(bytes) {
    const from = new ByteReader(bytes), head = JSON.parse(new TextDecoder().decode(from.bytes(from.unsigned()))), { count, degree } = head;
    if (head.version !== 1) throw new RangeError(`this page holds a scene of version ${head.version}`);
    const planes = (width) => { const all = from.bytes(count * width); return (i, c) => all[c * count + i]; };
    Object.assign(this, { count, times: head.times, kernel: head.kernel, renderSettings: head.render_settings });
    this.tracks = [3, 4, 3, 1, 3].map((width) => readTrack(from, width, count));
    this.sh = null;
    if (degree !== null) {
      const width = 3 * (degree + 1) ** 2, at = planes(width), bytes = new Uint8Array(48 * count);
      for (let i = 0; i < count; i++) for (let k = 0; k < width; k++) bytes[48 * i + k] = at(i, k);
      this.sh = { degree, words: new Uint32Array(bytes.buffer) };
    }
    this.knots = head.kernel ? planes(2) : null;
    this.layers = head.layers.map(([name, meaning]) => ({ name, meaning, color: planes(3) }));
  }
  // The key of a frame, in the scene's colours or those of a layer.
  key(frame, layer) {
    const { count, tracks, knots } = this, [means, quats, scales, opacities, colors] = tracks;
    const words = new Uint32Array(8 * count), floats = new Float32Array(words.buffer), v = [0, 0, 0, 0];
    for (let i = 0; i < count; i++) {
      const w = 8 * i;
      trackAt(means, i, frame, v);
      for (let c = 0; c < 3; c++) floats[w + c] = v[c];
      if (layer) for (let c = 0; c < 3; c++) v[c] = layer.color(i, c) / 255; else trackAt(colors, i, frame, v);
      const rgb = byteOf(v[0]) | (byteOf(v[1]) << 8) | (byteOf(v[2]) << 16);
      trackAt(opacities, i, frame, v);
      words[w + 3] = rgb | (byteOf(v[0]) << 24);
      trackAt(quats, i, frame, v);
      const n = 1 / (Math.hypot(v[0], v[1], v[2], v[3]) || 1);
      words[w + 4] = snorm(v[0] * n) | (snorm(v[1] * n) << 16);
      words[w + 5] = snorm(v[2] * n) | (snorm(v[3] * n) << 16);
      trackAt(scales, i, frame, v);
      words[w + 6] = half(v[0]) | (half(v[1]) << 16);
      words[w + 7] = half(v[2]) | ((knots ? knots(i, 0) : 128) << 16) | ((knots ? knots(i, 1) : 128) << 24);
    }
    return { time: this.times[frame], words };
  }
}
// The bytes that a page holds as text.
async function unpacked(text) {
  const packed = Uint8Array.from(atob(text.trim()), (c) => c.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate-raw"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}
