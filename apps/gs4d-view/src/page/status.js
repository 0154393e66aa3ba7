"use strict";
// Status line, legend, picked and chosen splats of an image; lines over it.
const LONGEST = 0.25; // longest arrow, in radii of the scene
let paths = [], arrows = null, arrowsOf = null;
const SVG = "http://www.w3.org/2000/svg";
function svgElement(name, attributes) {
  const e = document.createElementNS(SVG, name);
  for (const [a, v] of Object.entries(attributes)) e.setAttribute(a, v);
  return e;
}
const number = (v) => (v === null ? "–" : Math.abs(v) >= 1000 || (v !== 0 && Math.abs(v) < 0.01) ? v.toExponential(2) : v.toPrecision(4));
function showStatus(header, spent) {
  const parts = [`${header.width}×${header.height}`, `rendered in ${header.ms.toFixed(0)} ms, here after ${spent.toFixed(0)} ms`];
  if (header.splats !== undefined) parts.unshift(`${header.splats.toLocaleString("en")} splats`);
  if (header.psnr) parts.push(state.compare === "difference" ? `PSNR between the two ${header.psnr.toFixed(2)} dB` : `PSNR of this view ${header.psnr.toFixed(2)} dB`);
  if (state.compare === "difference") parts.push(`grey is equal, ×${state.gain}`);
  if (header.note) parts.push(header.note);
  if (header.arrows) { [arrows, arrowsOf] = [header.arrows, state.t]; }
  if (arrows && state.arrows) parts.push(`arrows: the longest is ${number(arrows.longest)} ${arrows.unit}`);
  $("status").textContent = parts.join(" · ");
  notice(header.blank ? header.blank + ". Press F to frame the scene." : "");
  $("legend").replaceChildren(...(header.legend ? legend(header.legend) : []));
  if (header.picked) picked(header.picked);
  if (header.chosen) describe(header.chosen);
  if (header.inputs) inputs(header.inputs);
}
function notice(text) { $("notice").textContent = text; $("notice").hidden = !text; }
function legend(l) {
  const most = Math.max(1, ...l.bars), svg = svgElement("svg", { width: 8 * l.bars.length, height: l.colors ? 34 : 25, role: "img" });
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
function picked(p) {
  const table = document.createElement("table"), row = (cells, tag) => { const r = table.insertRow(); for (const c of cells) { const d = document.createElement(tag); d.textContent = c; r.append(d); } };
  const names = p.splats.length ? Object.keys(p.splats[0].quantities) : [];
  row(["splat", "weight", "opacity", "centre", "scales", ...names], "th");
  for (const s of p.splats) row([s.splat, s.weight.toFixed(3), s.opacity.toFixed(3), s.mean.map(number).join(" "), s.scale.map(number).join(" "), ...names.map((n) => number(s.quantities[n]))], "td");
  const words = document.createElement("p");
  words.textContent = p.splats.length ? `pixel ${p.pixel.join(", ")}: coverage ${p.alpha.toFixed(3)}; the heaviest splats and, in yellow, their paths` : `pixel ${p.pixel.join(", ")}: no splat`;
  $("picked").replaceChildren(words, table);
  paths = p.splats.map((s) => s.path);
  lines();
}
function describe(c) {
  $("count").textContent = `${c.count.toLocaleString("en")} of ${c.of.toLocaleString("en")} splats have their centre in the box, however deep`;
  for (const b of ["hide", "save-chosen"]) $(b).disabled = !c.count;
  $("spread").replaceChildren(...c.spread.map((l) => { const d = document.createElement("div"); d.append(...legend(l)); return d; }));
}
function inputs(i) {
  const turned = Object.entries(state.pose.turns).filter(([, a]) => a.some(Boolean)).map(([j]) => about().joints[j]);
  const changes = [...(state.pose.from !== null ? [`the pose is that of ${ownTime(state.pose.from) || state.pose.from.toFixed(3)}`] : []), ...(turned.length ? [`turned by you: ${turned.join(", ")}`] : [])];
  $("inputs").textContent = `Colours come from the images of frame ${i.frame} (${i.images.join(", ")}); ${changes.join("; ") || "in the pose it was filmed in"}.`;
}
// Paths of picked splats, arrows, and cameras of the data.
function lines() {
  const svg = $("lines"), all = [];
  const points = (list) => list.map(project).filter(Boolean).map((p) => p.map((v) => v.toFixed(1)).join(",")).join(" ");
  if (!shows.length) return;
  if (state.cameras) about().views.forEach((v, k) => {
    if (k % Math.ceil(about().views.length / 60) || k === state.view) return;
    const c = frustum(v, 0.12 * about().radius);
    if ([v.eye, ...c].every(project)) all.push(svgElement("polyline", { class: "camera", points: points([v.eye, c[0], c[1], v.eye, c[2], c[3], v.eye, c[0], c[3], c[2], c[1]]) }));
  });
  for (const path of paths) all.push(svgElement("polyline", { class: "path", points: points(path) }));
  if (state.arrows && arrows && arrowsOf === state.t && arrows.longest > 0) for (const [at, v] of arrows.lines) {
    const from = project(at), to = project(add(at, v, (LONGEST * about().radius) / arrows.longest));
    if (from && to) all.push(arrow(from, to));
  }
  svg.replaceChildren(...all);
}
function arrow(from, to) {
  const d = add(to, from, -1), n = Math.hypot(...d), head = Math.min(6, 0.4 * n), u = d.map((v) => v / Math.max(n, 1e-6)), back = add(to, u, -head);
  const wing = (k) => add(back, [-u[1], u[0]], 0.5 * k * head).map((v) => v.toFixed(1)).join(",");
  const at = (p) => p.map((v) => v.toFixed(1)).join(",");
  return svgElement("polyline", { class: "arrow", points: [at(from), at(to), wing(1), at(to), wing(-1)].join(" ") });
}
