"use strict";
// A run under training: its state, its curves, and its pause.
function news({ layers: names, checkpoints, training: at, history, frame }) {
  if (frame) return arrived(frame);
  const known = live && shows[0].checkpoints.join() === checkpoints.join() && shows[0].layers.join() === names.join();
  live = true;
  Object.assign(shows[0], { layers: names, checkpoints, splats: at.splats });
  const words = [`step ${at.step.toLocaleString("en")} of ${at.steps.toLocaleString("en")}`, `${at.splats.toLocaleString("en")} splats`];
  if (at.psnr !== null) words.push(`${at.psnr.toFixed(2)} dB of training batches`);
  $("progress").textContent = words.join(" · "); $("training").hidden = false;
  if (!known) layers();
  curves(history);
  trained = at.step;
  version++;
  for (const side of ["a", "b"]) if (state[side][0] === 0 && state[side][2] < 0) sides[side].is = Math.min(sides[side].is, COARSE);
}
// A frame of a live film.
function arrived({ splats }) {
  live = arriving = true;
  shows[0].splats = splats;
  version++;
  for (const side of ["a", "b"]) if (state[side][0] === 0) sides[side].is = Math.min(sides[side].is, COARSE);
}
function curves(history) {
  const curve = (name, k, log) => {
    const points = history.filter(([, v]) => v[k] !== null && (!log || v[k] > 0)).map(([step, v]) => [step, log ? Math.log10(v[k]) : v[k]]);
    if (points.length < 2) return null;
    const [w, h] = [250, 70], ys = points.map((p) => p[1]), [low, high] = [Math.min(...ys), Math.max(...ys)], end = points[points.length - 1];
    const x = (s) => 34 + ((w - 40) * (s - points[0][0])) / Math.max(1, end[0] - points[0][0]), y = (v) => 8 + (h - 22) * (1 - (v - low) / Math.max(1e-9, high - low));
    const svg = svgElement("svg", { viewBox: `0 0 ${w} ${h}`, role: "img", "aria-label": `${name} from step ${points[0][0]} to ${end[0]}: ${number(log ? 10 ** end[1] : end[1])}` });
    const text = (at, words, anchor) => { const t = svgElement("text", { x: at[0], y: at[1], "text-anchor": anchor }); t.textContent = words; svg.append(t); };
    svg.append(svgElement("line", { class: "axis", x1: 34, x2: w - 6, y1: h - 13, y2: h - 13 }), svgElement("polyline", { points: points.map(([s, v]) => `${x(s).toFixed(1)},${y(v).toFixed(1)}`).join(" ") }));
    for (const v of [low, high]) text([31, y(v) + 3], log ? String(+(10 ** v).toPrecision(2)) : v.toFixed(1), "end");
    text([34, h - 2], name, "start"); text([w - 6, h - 2], `step ${end[0]}`, "end");
    return svg;
  };
  $("curves").replaceChildren(...[curve("PSNR of training batches, dB", 1, false), curve("loss", 0, true)].filter(Boolean));
}
function showPaused(on) { $("pause").setAttribute("aria-pressed", on); $("pause").textContent = on ? "Go on" : "Pause"; }
$("pause").addEventListener("click", () => { if (socket && socket.readyState === 1) socket.send(JSON.stringify({ pause: $("pause").getAttribute("aria-pressed") !== "true" })); });
