"use strict";
// Picked splats, a box of splats, and a person's pose.
// What is picked is what is seen: the scene stops for it.
function pickAt(at) { if (playing) play(false); $("selecting").open = true; version++; sides.a.pick = at; sides.a.is = Math.min(sides.a.is, COARSE); }
function picked(p) {
  const table = document.createElement("table"), row = (cells, tag) => { const r = table.insertRow(); for (const c of cells) { const d = document.createElement(tag); d.textContent = c; r.append(d); } };
  const names = p.splats.length ? Object.keys(p.splats[0].quantities) : [];
  row(["splat", "weight", "opacity", "mean", "scales", ...names], "th");
  for (const s of p.splats) row([s.splat, s.weight.toFixed(3), s.opacity.toFixed(3), s.mean.map(number).join(" "), s.scale.map(number).join(" "), ...names.map((n) => number(s.quantities[n]))], "td");
  const words = document.createElement("p");
  words.textContent = p.splats.length ? `pixel ${p.pixel.join(", ")}: alpha ${p.alpha.toFixed(3)}; the splats of largest weight and, in yellow, their paths` : `pixel ${p.pixel.join(", ")}: no splat`;
  $("picked").replaceChildren(words, ...(p.splats.length ? [table] : []));
  paths = p.splats.map((s) => s.path);
  lines();
}
function choose(at) {
  const { width, height } = $("a");
  const pose = posing();
  chosen = { show: state.a[0], look: look(), time: state.t, width, height, at, ...(pose && { pose }) };
  $("selecting").open = true; $("choice").hidden = false;
  boxing(false);
  again();
}
function unchoose() { chosen = null; $("choice").hidden = true; boxing(false); }
function boxing(on) { $("boxing").setAttribute("aria-pressed", on); stage.classList.toggle("boxing", on); if (!on) $("box").hidden = true; }
const isBoxing = () => $("boxing").getAttribute("aria-pressed") === "true";
function describe(c) {
  $("count").textContent = `${c.count.toLocaleString("en")} of ${c.of.toLocaleString("en")} splats have their centre in the box, at any depth`;
  for (const b of ["hide", "save-chosen"]) $(b).disabled = !c.count;
  $("spread").replaceChildren(...c.spread.map((l) => { const d = document.createElement("div"); d.append(...legend(l)); return d; }));
}
// Shares of the image at a place of the window.
function shareAt(x, y) { const c = $(locals.a.drawn ? "local-a" : "a").getBoundingClientRect(); return [(x - c.left) / c.width, (y - c.top) / c.height]; }
function dragBox(e, from) {
  const s = stage.getBoundingClientRect(), b = $("box").style, [x, y] = [Math.min(e.clientX, from.x0), Math.min(e.clientY, from.y0)];
  Object.assign(b, { left: x - s.left + "px", top: y - s.top + "px", width: Math.abs(e.clientX - from.x0) + "px", height: Math.abs(e.clientY - from.y0) + "px" });
  $("box").hidden = false;
}
function endBox(e, from) {
  const clamp = (v) => Math.min(1, Math.max(0, v)), [p, q] = [shareAt(from.x0, from.y0), shareAt(e.clientX, e.clientY)].map((s) => s.map(clamp));
  choose([Math.min(p[0], q[0]), Math.min(p[1], q[1]), Math.max(p[0], q[0]), Math.max(p[1], q[1])]);
}
function figure() {
  const joints = about().joints;
  $("figure").hidden = !joints;
  if (!joints) return;
  options($("joint"), joints.map((n, k) => [k, n || `joint ${k}`]), $("joint").value || 0);
  const angles = state.pose.turns[$("joint").value] || [0, 0, 0];
  angles.forEach((a, k) => { $("turn-" + k).value = a; });
  $("borrow").checked = state.pose.from !== null;
  $("from").value = state.pose.from ?? state.t;
}
function posed() {
  paths = [];
  state.pose.turns[$("joint").value] = [0, 1, 2].map((k) => Number($("turn-" + k).value));
  state.pose.from = $("borrow").checked ? Number($("from").value) : null;
  changed();
}
function inputs(i) {
  const { turns = [] } = posing() || {}, turned = turns.map(([j]) => about().joints[j]);
  const changes = [...(state.pose.from !== null ? [`the pose is that of ${ownTime(state.pose.from) || state.pose.from.toFixed(3)}`] : []), ...(turned.length ? [`turned by you: ${turned.join(", ")}`] : [])];
  $("inputs").textContent = `Colours come from the images of frame ${i.frame} (${i.images.join(", ")}); ${changes.join("; ") || "in the pose it was filmed in"}.`;
}
$("boxing").addEventListener("click", () => boxing(!isBoxing()));
// As many as the server takes.
const MOST_HIDDEN = 16;
$("hide").addEventListener("click", () => {
  if (chosen && state.hidden.length >= MOST_HIDDEN) return notice(`${MOST_HIDDEN} boxes are hidden, and no more can be: show them again first`);
  if (chosen) state.hidden.push(chosen);
  unchoose(); changed(); place();
});
$("unhide").addEventListener("click", () => { state.hidden = []; changed(); place(); });
$("unchoose").addEventListener("click", unchoose);
for (const part of ["chosen", "rest"]) $("save-" + part).addEventListener("click", () => { file = { save: part, chosen }; pump(); });
$("joint").addEventListener("change", figure);
for (const id of ["turn-0", "turn-1", "turn-2", "borrow", "from"]) $(id).addEventListener("input", posed);
$("unpose").addEventListener("click", () => { state.pose = { from: null, turns: {} }; paths = []; figure(); changed(); });
