"use strict";
// Status line and legend of an image; lines over it: axes, grid, cameras, arrows, paths.
const LONGEST = 0.25; // longest arrow, in radii of the scene
let paths = [], arrows = null, arrowsOf = "";
// What arrows are of: they follow the camera, and nothing else.
const moment = () => JSON.stringify([state.a[0], state.a[2], state.t, state.hidden, posing()]);
const arrowsShown = () => state.arrows && about().moving && arrows && arrowsOf === moment();
const SVG = "http://www.w3.org/2000/svg";
function svgElement(name, attributes) {
  const e = document.createElementNS(SVG, name);
  for (const [a, v] of Object.entries(attributes)) e.setAttribute(a, v);
  return e;
}
const number = (v) => (v === null ? "–" : Math.abs(v) >= 1000 || (v !== 0 && Math.abs(v) < 0.01) ? v.toExponential(2) : String(+v.toPrecision(4)));
function showStatus(header, spent, of) {
  const parts = [`${header.width}×${header.height}`, `rendered in ${header.ms.toFixed(0)} ms, here after ${spent.toFixed(0)} ms`];
  if (header.frame) parts.unshift(`frame ${header.frame.number}, ${header.frame.latency_ms.toFixed(0)} ms after its files`);
  if (header.splats !== undefined) parts.unshift(`${header.splats.toLocaleString("en")} splats`);
  const v = about().views[state.view], whose = state.compare === "difference" ? "between the two" : `of this ${v && v.held_out ? "held-out" : "training"} view`;
  if (header.psnr) parts.push(`PSNR ${whose} ${header.psnr.toFixed(2)} dB at ${header.scored.join("×")}`);
  if (state.compare === "difference") parts.push(`grey is equal, ×${state.gain}`);
  if (header.arrows) { [arrows, arrowsOf] = [header.arrows, of]; lines(); }
  if (arrowsShown()) parts.push(`arrows: the longest is ${number(arrows.longest)} ${arrows.unit}`);
  $("status").textContent = parts.join(" · ");
  notice(header.blank ? header.blank + ". Press F to frame the scene." : "");
  $("legend").replaceChildren(...(header.legend ? legend(header.legend) : []), header.note ?? "");
  if (header.picked) picked(header.picked);
  if (header.chosen) describe(header.chosen);
  if (header.inputs) inputs(header.inputs);
}
function notice(text) { if (!text && performance.now() < refusedUntil) return; $("notice").textContent = text; $("notice").hidden = !text; }
function legend(l) {
  const most = Math.max(1, ...l.bars), wide = 8 * l.bars.length, svg = svgElement("svg", { viewBox: `0 0 ${wide} ${l.colors ? 34 : 25}`, width: wide, role: "img" });
  l.bars.forEach((n, k) => {
    const bar = (y, height) => svg.append(svgElement("rect", { x: 8 * k, y, width: 8, height, fill: l.colors ? l.colors[k] : "#5a8fd0" }));
    bar(24 * (1 - n / most), 24 * (n / most));
    if (l.colors) bar(26, 8);
  });
  const words = document.createElement("span");
  words.textContent = l.words ?? `${l.name}: ${number(l.low)} to ${number(l.high)} ${l.unit}`;
  svg.setAttribute("aria-label", words.textContent);
  return [svg, words];
}
function lines() {
  if (!shows.length) return;
  const svg = $("lines"), all = [], s = about(), r = s.radius;
  const points = (list) => list.map(project).filter(Boolean).map((p) => p.map((v) => v.toFixed(1)).join(",")).join(" ");
  const line = (cls, list) => { if (list.every(project)) all.push(svgElement("polyline", { class: cls, points: points(list) })); };
  if (state.grid) for (const pair of gridLines()) line("grid", pair);
  if (state.axes) [["x", [1, 0, 0]], ["y", [0, 1, 0]], ["z", [0, 0, 1]]].forEach(([name, axis]) => {
    const end = axis.map((v) => v * r), at = project(end);
    line(name, [[0, 0, 0], end]);
    if (at) { const text = svgElement("text", { x: at[0] + 4, y: at[1] - 4 }); text.textContent = name; all.push(text); }
  });
  const frame = (cls, v) => { const c = frustum(v, 0.12 * r); line(cls, [v.eye, c[0], c[1], v.eye, c[2], c[3], v.eye, c[0], c[3], c[2], c[1]]); };
  if (state.cameras) s.views.forEach((v, k) => { if (k % Math.ceil(s.views.length / 60) === 0 && k !== state.view) frame("camera", v); });
  if (!flying) for (const k of flight) frame("key", k);
  for (const path of paths) all.push(svgElement("polyline", { class: "path", points: points(path) }));
  if (arrowsShown() && arrows.longest > 0) for (const [at, v] of arrows.lines) {
    const from = project(at), to = project(add(at, v, (LONGEST * r) / arrows.longest));
    if (from && to) all.push(arrow(from, to));
  }
  svg.replaceChildren(...all);
}
// Lines of the plane through the origin across the axis nearest to up, at a round spacing.
function gridLines() {
  const up = state.up.map(Math.abs), axis = up.indexOf(Math.max(...up)), [i, j] = [0, 1, 2].filter((k) => k !== axis), r = about().radius;
  const ten = 10 ** Math.floor(Math.log10(r)), step = [0.2, 0.5, 1, 2, 5].map((v) => v * ten).find((v) => v * 8 >= 2 * r) || r, n = 8, all = [];
  const at = (a, b) => { const p = [0, 0, 0]; p[i] = a * step; p[j] = b * step; return p; };
  for (let k = -n; k <= n; k++) for (let m = -n; m < n; m++) { all.push([at(k, m), at(k, m + 1)]); all.push([at(m, k), at(m + 1, k)]); }
  return all;
}
function arrow(from, to) {
  const d = add(to, from, -1), n = Math.hypot(...d), head = Math.min(6, 0.4 * n), u = d.map((v) => v / Math.max(n, 1e-6)), back = add(to, u, -head);
  const wing = (k) => add(back, [-u[1], u[0]], 0.5 * k * head).map((v) => v.toFixed(1)).join(",");
  const at = (p) => p.map((v) => v.toFixed(1)).join(",");
  return svgElement("polyline", { class: "arrow", points: [at(from), at(to), wing(1), at(to), wing(-1)].join(" ") });
}
