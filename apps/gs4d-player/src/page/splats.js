"use strict";
// Moving 3D Gaussian splats in WebGL2.
//   renderer = new SplatRenderer(canvas, () => new Worker("sort.js"))    throws where WebGL2 is missing
//   renderer.setClip({ count, keys: [{ time, words }], background, sh, near, dilation, antialias })  words: 8 u32 per splat, see splatProject
//   renderer.addKey({ time, words })                                     at any time, in any order of times
//   renderer.draw(camera, time)       at once, with the newest order of depths; true if that is for this camera and time
//   renderer.settled(camera, time)    a promise of a draw that is; the image can be read in its continuation
//   renderer.onchange                 called when another draw would show more: an order, a key, the context is back
//   renderer.state                    "ready", "lost" (the context), "failed" (then renderer.error), "disposed"
// A camera is { viewmat, fx, fy, cx, cy, width, height }, pixels; viewmat takes world to camera (+x right, +y down,
// +z forward), row by row. The canvas gets the camera's size.
//
// Per frame: a worker sorts (sort.js); one pass of fragments, one for each splat in order, decodes, interpolates and
// projects into two integer textures; then each splat is one triangle around its ellipse, blended over those behind.
const splatRow = 1024; // splats in a row of a texture
const splatPool = 256 << 20; // bytes of keys kept in textures; the longest unused go first
const splatHead = `#version 300 es
precision highp float; precision highp int; precision highp usampler2D;
ivec2 place(int i) { return ivec2(i % ${splatRow}, i / ${splatRow}); }
`;
const splatWhole = "void main() { gl_Position = vec4(gl_VertexID == 1 ? 3 : -1, gl_VertexID == 2 ? 3 : -1, 0, 1); }";
// Words of a splat: mean (3 f32); RGBA8, alpha the opacity; quaternion w x y z (4 snorm16); log scales (3 f16), and p, v of
// the kernel (2 unorm8 of 0 to 1/2). With sh, { degree, words }, colours depend on the direction: 12 u32 per splat, 48 snorm8
// in steps of 1/64, r g b of each coefficient; the first is added as it is. The covariance on the screen is L L', L = [h k; 0 l]; l = 0 marks what is not drawn.
const splatProject = `
uniform usampler2D uOrder, uFrom, uTo;
#ifdef HARMONICS
uniform usampler2D uSh;
uniform vec3 uEye;
uniform int uDegree;
uint shWords[12];
float shByte(int n) { return float(int(shWords[n >> 2] << uint(24 - 8 * (n & 3))) >> 24) / 64.0; }
vec3 sh(int k) { return vec3(shByte(3 * k), shByte(3 * k + 1), shByte(3 * k + 2)); }
vec3 harmonics(int i, vec3 d) {
  for (int k = 0; k < 3; k++) {
    uvec4 four = texelFetch(uSh, place(i) * ivec2(3, 1) + ivec2(k, 0), 0);
    shWords[4 * k] = four.x; shWords[4 * k + 1] = four.y; shWords[4 * k + 2] = four.z; shWords[4 * k + 3] = four.w;
  }
  float x = d.x, y = d.y, z = d.z, xx = x * x, yy = y * y, zz = z * z;
  vec3 sum = sh(0);
  if (uDegree > 0) sum += 0.48860251 * (-y * sh(1) + z * sh(2) - x * sh(3));
  if (uDegree > 1) sum += 1.09254843 * (x * y * sh(4) - y * z * sh(5) - x * z * sh(7)) + 0.31539157 * (2.0 * zz - xx - yy) * sh(6) + 0.54627422 * (xx - yy) * sh(8);
  if (uDegree > 2) sum += -0.59004359 * (y * (3.0 * xx - yy) * sh(9) + x * (xx - 3.0 * yy) * sh(15)) + 2.89061144 * x * y * z * sh(10)
    - 0.45704580 * (4.0 * zz - xx - yy) * (y * sh(11) + x * sh(13)) + 0.37317633 * z * (2.0 * zz - 3.0 * xx - 3.0 * yy) * sh(12) + 1.44530572 * z * (xx - yy) * sh(14);
  return sum;
}
#endif
uniform float uMix;
uniform mat4x3 uView;
uniform vec2 uFocal, uCentre;
uniform vec3 uRaster; // near plane; dilation, square pixels; 1 where opacities make up for it
uniform vec4 uLimit; // of the tangents in the Jacobian: least x and y, most x and y
layout(location = 0) out uvec4 oPlace;
layout(location = 1) out uvec4 oLook;
vec4 bytes(uint v) { return vec4(v & 255u, (v >> 8) & 255u, (v >> 16) & 255u, v >> 24) / 255.0; }
vec4 quaternion(uvec2 v) { return vec4(unpackSnorm2x16(v.x), unpackSnorm2x16(v.y)); }
vec3 logScale(uvec2 v) { return vec3(unpackHalf2x16(v.x), unpackHalf2x16(v.y).x); }
void main() {
  oPlace = oLook = uvec4(0);
  int row = int(texelFetch(uOrder, ivec2(gl_FragCoord.xy), 0).r);
  ivec2 at = place(row) * ivec2(2, 1), next = at + ivec2(1, 0);
  uvec4 a = texelFetch(uFrom, at, 0), c = texelFetch(uFrom, next, 0), b = texelFetch(uTo, at, 0), d = texelFetch(uTo, next, 0);
  vec3 mean = mix(uintBitsToFloat(a.xyz), uintBitsToFloat(b.xyz), uMix), t = uView * vec4(mean, 1);
  vec4 rgba = mix(bytes(a.w), bytes(b.w), uMix);
  if (!(t.z > uRaster.x) || rgba.a < 1.0 / 255.0) return;
#ifdef HARMONICS
  rgba.rgb = max(rgba.rgb + harmonics(row, normalize(mean - uEye)), 0.0);
#endif
  vec4 q = quaternion(c.xy), r = quaternion(d.xy);
  q = normalize(mix(q, dot(q, r) < 0.0 ? -r : r, uMix));
  vec3 s = exp(mix(logScale(c.zw), logScale(d.zw), uMix));
  float w = q.x, x = q.y, y = q.z, z = q.w, inverse = 1.0 / t.z;
  mat3 axes = transpose(mat3(uView) * mat3(
    1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y),
    2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x),
    2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)));
  vec2 tangent = clamp(t.xy * inverse, uLimit.xy, uLimit.zw), f = uFocal * inverse;
  // Rows of J R diag(s). The determinant is a sum of terms that cannot cancel, so needles keep their width.
  vec3 f0 = f.x * (axes[0] - tangent.x * axes[2]) * s, f1 = f.y * (axes[1] - tangent.y * axes[2]) * s, n = cross(f0, f1);
  float xx = dot(f0, f0), xy = dot(f0, f1), yy = dot(f1, f1), area = dot(n, n), det = area + uRaster.y * (xx + yy + uRaster.y), l = sqrt(yy + uRaster.y);
  if (!(det > 0.0 && det < 1e30)) return;
  if (uRaster.z > 0.0) rgba.a *= max(sqrt(area / det), 0.005);
  oPlace = floatBitsToUint(vec4(f * t.xy + uCentre, sqrt(det) / l, xy / l));
  oLook = uvec4(floatBitsToUint(l), packHalf2x16(rgba.rg), packHalf2x16(rgba.ba), packHalf2x16(mix(bytes(c.w).zw, bytes(d.w).zw, uMix) * 0.5));
}`;
// Three vertices per splat: the triangle around the circle at which alpha falls to 1/255, through L. One unit is
// sqrt(2 ln 2) standard deviations, so that the Gaussian is 2^-d of the squared distance d.
const splatVertex = `
uniform usampler2D uPlace, uLook;
uniform vec2 uPixel;
flat out vec4 vColor; // and the opacity, or its logarithm to base 2
flat out vec3 vKernel;
out vec2 vAt;
void main() {
  gl_Position = vec4(2, 2, 2, 1);
  int slot = gl_VertexID / 3, k = gl_VertexID - 3 * slot;
  uvec4 look = texelFetch(uLook, place(slot), 0);
  float l = uintBitsToFloat(look.x);
  if (l == 0.0) return;
  vec4 on = uintBitsToFloat(texelFetch(uPlace, place(slot), 0));
  vec2 rg = unpackHalf2x16(look.y), bo = unpackHalf2x16(look.z);
  float end = log2(bo.y * 255.0);
#ifdef KERNEL
  vColor = vec4(rg, bo);
  vKernel = vec3(0, 1, 100);
  float p = unpackHalf2x16(look.w).x, v = unpackHalf2x16(look.w).y;
  if (p != v) {
    // psi = g + u clamp(g - 1/2, -e, e), e = kappa min(g, 1 - g); it never decays at p = 0 and is cut at 3 standard deviations.
    float cut = p < 0.0019 ? 6.4921276 : 100.0, foot = max(p, 1e-6), run = max(1.0 - 2.0 * foot, 1e-6), rise = (1.0 - 2.0 * v) / run;
    float least = 1.0 / (255.0 * bo.y);
    float g = least <= v ? least * foot / v : least <= 1.0 - v ? 0.5 + (least - 0.5) / rise : 1.0 - (1.0 - least) * foot / v;
    end = min(cut, -log2(clamp(g, 1e-30, 1.0)));
    vKernel = vec3(rise - 1.0, run / (2.0 * foot), cut);
  }
#else
  vColor = vec4(rg, bo.x, log2(bo.y));
  vKernel = vec3(0);
#endif
  vAt = (k == 0 ? vec2(-1.7320509, -1) : k == 1 ? vec2(1.7320509, -1) : vec2(0, 2)) * sqrt(max(end, 0.0));
  vec2 d = 1.1774100 * vAt;
  gl_Position = vec4((on.xy + vec2(d.x * on.z + d.y * on.w, d.y * l)) * uPixel + vec2(-1, 1), 0, 1);
}`;
const splatFragment = `
flat in vec4 vColor;
flat in vec3 vKernel;
in vec2 vAt;
out vec4 oColor;
void main() {
  float d = dot(vAt, vAt);
#ifdef KERNEL
  float g = exp2(-d), e = vKernel.y * max(min(g, 1.0 - g), 1e-6), alpha = vColor.a * (g + vKernel.x * clamp(g - 0.5, -e, e));
  if (alpha < 1.0 / 255.0 || d > vKernel.z) discard;
#else
  float power = vColor.a - d;
  if (power < -7.9943534) discard;
  // 2^power as the eighth power of a cubic, within 6e-4 of itself; cheaper than exp2 on a CPU.
  float x = 0.125 * power, alpha = 0.9999252 + x * (0.6910206 + x * (0.2300701 + x * 0.0390121));
  alpha *= alpha; alpha *= alpha; alpha *= alpha;
#endif
  alpha = min(alpha, 0.99);
  oColor = vec4(vColor.rgb * alpha, alpha);
}`;

class SplatRenderer {
  constructor(canvas, newSorter) {
    Object.assign(this, { canvas, clip: null, state: "ready", error: "", onchange: null });
    // order: of the last sort; asked: what the worker sorts now; wanted: of the last draw; serial, version: of the clip and its keys.
    Object.assign(this, { order: null, asked: null, wanted: null, spare: null, waiting: [], serial: 0, version: 0 });
    this.gl = canvas.getContext("webgl2", { alpha: false, antialias: false, depth: false, stencil: false, powerPreference: "high-performance" });
    if (!this.gl) throw new Error("this browser has no WebGL2, or it is turned off");
    this.build();
    this.sorter = newSorter();
    this.sorter.onmessage = ({ data }) => this.sorted(data);
    this.sorter.onerror = (event) => this.become("failed", `the sorting worker failed: ${event.message || "it was not loaded"}`);
    this.lose = (event) => { event.preventDefault(); this.become("lost", ""); };
    this.restore = () => { if (this.state === "lost") { this.build(); this.become("ready", ""); } };
    canvas.addEventListener("webglcontextlost", this.lose);
    canvas.addEventListener("webglcontextrestored", this.restore);
  }
  become(state, error) {
    if (this.state === "disposed" || this.state === "failed") return;
    Object.assign(this, { state, error });
    this.wake();
  }
  wake() {
    for (const done of this.waiting.splice(0)) done();
    if (this.onchange) this.onchange();
  }

  // Programs and textures; again after a lost context.
  build() {
    this.project = { plain: null, sh: null };
    this.blend = { plain: null, bent: null };
    this.keys = new Map();
    this.frame = null;
    if (this.order) this.order.fresh = true;
  }
  program(vertex, fragment) {
    const gl = this.gl, program = gl.createProgram(), at = {};
    for (const [kind, text] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
      const shader = gl.createShader(kind);
      gl.shaderSource(shader, splatHead + text);
      gl.compileShader(shader); gl.attachShader(program, shader); gl.deleteShader(shader);
    }
    gl.linkProgram(program);
    if (!gl.getProgramParameter(program, gl.LINK_STATUS) && !gl.isContextLost()) {
      throw new Error(`a shader failed: ${gl.getProgramInfoLog(program)} ${gl.getAttachedShaders(program).map((s) => gl.getShaderInfoLog(s)).join(" ")}`);
    }
    for (let k = (gl.getProgramParameter(program, gl.ACTIVE_UNIFORMS) || 0) - 1; k >= 0; k--) {
      const { name } = gl.getActiveUniform(program, k);
      at[name] = gl.getUniformLocation(program, name);
    }
    return { program, at };
  }
  texture(format, width) {
    const gl = this.gl, texture = gl.createTexture();
    gl.activeTexture(gl.TEXTURE0);
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.texStorage2D(gl.TEXTURE_2D, 1, format, width, Math.ceil(this.clip.count / splatRow));
    for (const name of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, name, gl.NEAREST);
    return texture;
  }
  free() {
    const gl = this.gl, f = this.frame;
    for (const texture of [...this.keys.values(), ...(f ? [f.order, f.place, f.look, f.sh] : [])]) gl.deleteTexture(texture);
    if (f) gl.deleteFramebuffer(f.buffer);
    this.keys.clear(); this.frame = null;
  }

  setClip({ count, keys, background = [0, 0, 0], sh = null, near = 0.01, dilation = 0.3, antialias = false }) {
    const most = splatRow * (this.gl.getParameter(this.gl.MAX_TEXTURE_SIZE) || 2048);
    if (!(count <= most)) throw new RangeError(`${count} splats are too many for this graphics device: at most ${most}`);
    this.free();
    this.clip = { count, keys: [], background, sh, near, dilation, antialias, bent: false };
    Object.assign(this, { order: null, wanted: null, serial: this.serial + 1 });
    this.sorter.postMessage({ clip: this.serial, count, near, dilation });
    for (const key of keys) this.addKey(key);
  }
  // A key of the same time is replaced.
  addKey(key) {
    const clip = this.clip, { time, words } = key;
    if (words.length !== 8 * clip.count) throw new RangeError(`a key of ${clip.count} splats has ${8 * clip.count} words, not ${words.length}`);
    for (let w = 7; w < words.length && !clip.bent; w += 8) clip.bent = ((words[w] >>> 16) & 255) !== words[w] >>> 24;
    for (const old of clip.keys) if (old.time === time) this.release(old);
    clip.keys = clip.keys.filter((k) => k.time !== time).concat(key).sort((a, b) => a.time - b.time);
    this.version++;
    this.sorter.postMessage({ time, words });
    if (this.onchange) this.onchange();
  }

  // One sort runs at a time; the newest request follows it.
  ask() {
    const { wanted, order, spare } = this;
    if (!wanted || this.asked || (order && order.id === wanted.id)) return;
    this.asked = wanted; this.spare = null;
    this.sorter.postMessage({ ...wanted, order: spare }, spare ? [spare.buffer] : []);
  }
  sorted({ clip, id, order, count }) {
    this.asked = null;
    if (clip === this.serial) {
      this.spare = this.order && this.order.list;
      this.order = { id, count, list: order, fresh: true };
    }
    this.ask(); this.wake();
  }
  async settled(camera, time) {
    while (!this.draw(camera, time)) {
      if (this.state === "failed" || this.state === "disposed") throw new Error(this.error || "the renderer was disposed of");
      await new Promise((done) => this.waiting.push(done));
    }
  }

  // A texture of so many texels of four words for each splat.
  filled(words, texels) {
    const { gl } = this, { count } = this.clip, rows = Math.floor(count / splatRow), rest = count % splatRow, texture = this.texture(gl.RGBA32UI, texels * splatRow);
    if (rows) gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, 0, texels * splatRow, rows, gl.RGBA_INTEGER, gl.UNSIGNED_INT, words);
    if (rest) gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, rows, texels * rest, 1, gl.RGBA_INTEGER, gl.UNSIGNED_INT, words, 4 * texels * splatRow * rows);
    return texture;
  }
  // Frees the texture of a key.
  release(key) {
    const texture = this.keys.get(key);
    if (texture) this.gl.deleteTexture(texture);
    this.keys.delete(key);
  }
  // The texture of a key.
  uploaded(key) {
    const { gl, keys } = this, { count } = this.clip;
    let texture = keys.get(key);
    keys.delete(key);
    if (!texture) {
      for (const [old, texture] of keys) if ((keys.size + 1) * 32 * count > splatPool && keys.size > 1) { gl.deleteTexture(texture); keys.delete(old); }
      texture = this.filled(key.words, 2);
    }
    keys.set(key, texture);
    return texture;
  }
  targets() {
    const gl = this.gl, f = { order: this.texture(gl.R32UI, splatRow), place: this.texture(gl.RGBA32UI, splatRow), look: this.texture(gl.RGBA32UI, splatRow), sh: this.clip.sh && this.filled(this.clip.sh.words, 3), buffer: gl.createFramebuffer() };
    gl.bindFramebuffer(gl.FRAMEBUFFER, f.buffer);
    [f.place, f.look].forEach((t, k) => gl.framebufferTexture2D(gl.FRAMEBUFFER, gl.COLOR_ATTACHMENT0 + k, gl.TEXTURE_2D, t, 0));
    gl.drawBuffers([gl.COLOR_ATTACHMENT0, gl.COLOR_ATTACHMENT1]);
    return f;
  }
  draw(camera, time) {
    const { gl, canvas, clip } = this, { fx, fy, cx, cy, width, height } = camera, m = Array.from(camera.viewmat).slice(0, 12);
    if (this.state !== "ready" || !clip) return false;
    const id = [this.serial, this.version, time, ...m, fx, fy, cx, cy, width, height].join();
    this.wanted = { id, time, camera: { viewmat: m, fx, fy, cx, cy, width, height } };
    this.ask();
    if (canvas.width !== width || canvas.height !== height) { canvas.width = width; canvas.height = height; }
    gl.disable(gl.BLEND);
    const { count = 0, list, fresh, id: is } = this.order || {}, rows = Math.ceil(count / splatRow);
    if (count) {
      let k = 0;
      while (k < clip.keys.length - 2 && clip.keys[k + 1].time <= time) k++;
      const from = clip.keys[k], to = clip.keys[Math.min(k + 1, clip.keys.length - 1)], span = to.time - from.time;
      const textures = [this.uploaded(from), this.uploaded(to)], f = (this.frame ??= this.targets());
      const { program, at } = (this.project[clip.sh ? "sh" : "plain"] ??= this.program(splatWhole, (clip.sh ? "#define HARMONICS\n" : "") + splatProject));
      this.bind(f.order, ...textures, f.place, f.look, f.sh);
      if (fresh) { gl.activeTexture(gl.TEXTURE0); gl.texSubImage2D(gl.TEXTURE_2D, 0, 0, 0, splatRow, rows, gl.RED_INTEGER, gl.UNSIGNED_INT, list); this.order.fresh = false; }
      gl.bindFramebuffer(gl.FRAMEBUFFER, f.buffer);
      gl.viewport(0, 0, splatRow, rows);
      gl.useProgram(program);
      gl.uniform1i(at.uOrder, 0); gl.uniform1i(at.uFrom, 1); gl.uniform1i(at.uTo, 2);
      gl.uniform1f(at.uMix, span > 0 ? Math.min(1, Math.max(0, (time - from.time) / span)) : 0);
      gl.uniformMatrix4x3fv(at.uView, false, [0, 1, 2, 3].flatMap((c) => [m[c], m[c + 4], m[c + 8]]));
      gl.uniform2f(at.uFocal, fx, fy); gl.uniform2f(at.uCentre, cx, cy); gl.uniform3f(at.uRaster, clip.near, clip.dilation, clip.antialias ? 1 : 0);
      if (clip.sh) {
        const eye = [0, 1, 2].map((c) => -(m[c] * m[3] + m[c + 4] * m[7] + m[c + 8] * m[11]));
        gl.uniform1i(at.uSh, 5); gl.uniform3f(at.uEye, ...eye); gl.uniform1i(at.uDegree, clip.sh.degree);
      }
      const ex = (0.15 * width) / fx, ey = (0.15 * height) / fy;
      gl.uniform4f(at.uLimit, -cx / fx - ex, -cy / fy - ey, (width - cx) / fx + ex, (height - cy) / fy + ey);
      gl.drawArrays(gl.TRIANGLES, 0, 3);
    }
    gl.bindFramebuffer(gl.FRAMEBUFFER, null);
    gl.viewport(0, 0, gl.drawingBufferWidth, gl.drawingBufferHeight);
    gl.clearColor(...clip.background, 1);
    gl.clear(gl.COLOR_BUFFER_BIT);
    if (count) {
      const kind = clip.bent ? "bent" : "plain", define = clip.bent ? "#define KERNEL\n" : "";
      const { program, at } = (this.blend[kind] ??= this.program(define + splatVertex, define + splatFragment));
      gl.useProgram(program);
      gl.uniform1i(at.uPlace, 3); gl.uniform1i(at.uLook, 4);
      gl.uniform2f(at.uPixel, 2 / width, -2 / height);
      gl.enable(gl.BLEND);
      gl.blendFunc(gl.ONE, gl.ONE_MINUS_SRC_ALPHA);
      gl.drawArrays(gl.TRIANGLES, 0, 3 * count);
    }
    return is === id;
  }
  bind(...textures) { textures.forEach((t, k) => { this.gl.activeTexture(this.gl.TEXTURE0 + k); this.gl.bindTexture(this.gl.TEXTURE_2D, t); }); }

  dispose() {
    this.become("disposed", "");
    this.sorter.terminate();
    this.canvas.removeEventListener("webglcontextlost", this.lose);
    this.canvas.removeEventListener("webglcontextrestored", this.restore);
    this.free();
    for (const { program } of [...Object.values(this.project), ...Object.values(this.blend)].filter(Boolean)) this.gl.deleteProgram(program);
  }
}
