"use strict";
// The panel: shows, checkpoints, views, layers and cameras as thumbnails, comparing, display.
let thumbs = [], front = "a";
function options(select, items, value) {
  select.replaceChildren(...items.map(([v, text]) => { const o = document.createElement("option"); o.value = v; o.textContent = text; return o; }));
  select.value = value;
}
const press = (group, value) => { for (const b of $(group).querySelectorAll("button")) b.setAttribute("aria-pressed", b.value === value); };
const steps = (show) => [[-1, live && show === 0 ? "now" : "the end"], ...shows[show].checkpoints.map((s) => [s, `step ${s}`])];
const layersOf = (show) => shows[show].layers.filter((l) => l !== "truth" || state.view >= 0);
function layers() {
  for (const side of ["a", "b"]) {
    const [show, , step] = state[side], all = layersOf(show);
    if (!all.includes(state[side][1])) state[side][1] = "color";
    if (!steps(show).some(([s]) => s === step)) state[side][2] = -1;
    options($("step-" + side), steps(show), state[side][2]);
    $("step-" + side).parentElement.hidden = !shows[show].checkpoints.length;
  }
  options($("layer-b"), layersOf(state.b[0]).map((l) => [l, l]), state.b[1]);
  pictures();
}
function views() {
  if (!about().views[state.view]) state.view = -1;
  options($("view"), [[-1, "free"]]);
  for (const held of [true, false]) {
    const group = document.createElement("optgroup");
    group.label = held ? "held-out views" : "training views";
    about().views.forEach((v, k) => { if (v.held_out === held) group.append(new Option(v.name, k)); });
    if (group.children.length) $("view").append(group);
  }
  $("view").value = state.view;
  for (const id of ["view", "before", "after"]) $(id).disabled = !about().views.length;
}
// Thumbnails of layers, and of up to two dozen views: fetched while nothing else is to do.
function thumb(group, name, value, question, act) {
  const button = document.createElement("button"), canvas = document.createElement("canvas"), known = thumbs.find((t) => t.group === group && t.name === name);
  if (known) { canvas.width = known.canvas.width; canvas.height = known.canvas.height; if (known.asked) canvas.getContext("2d").drawImage(known.canvas, 0, 0); }
  button.value = value; button.append(canvas); button.addEventListener("click", act);
  return { group, name, button, canvas, asked: false, question };
}
function pictures() {
  const small = { width: 128, height: 96 }, free = look(), all = [];
  for (const name of layersOf(state.a[0])) {
    const question = () => { const q = { ...scene("a", REST), ...small, look: free, what: { ...target("a"), layer: name } }; delete q.against; delete q.gain; return q; };
    const t = thumb("layers", name, name, question, () => { state.a[1] = name; layers(); place(); changed(); }), label = document.createElement("span");
    label.textContent = name; if (name === "segment") t.button.title = "found when chosen; takes a while with many splats"; t.button.append(label); t.button.setAttribute("aria-pressed", name === state.a[1]); t.button.dataset.layer = name;
    all.push(t);
  }
  const n = about().views.length, count = state.cameras && about().layers.includes("truth") ? Math.min(24, n) : 0;
  for (let k = 0; k < count; k++) {
    const number = Math.floor((k * n) / count), v = about().views[number];
    const t = thumb("thumbs", v.name, number, () => ({ what: { show: state.a[0], layer: "truth" }, time: v.time, look: { view: [state.a[0], number] }, ...small }), () => snap(number));
    t.button.title = v.name; t.button.setAttribute("aria-label", "camera " + v.name);
    all.push(t);
  }
  thumbs = all;
  $("thumbs").hidden = !count;
  for (const group of ["layers", "thumbs"]) $(group).replaceChildren(...all.filter((t) => t.group === group).map((t) => t.button));
}
// The next thumbnail to fetch: only where the panel shows it, and not of rigid parts, which take long to find.
function wantedThumb() {
  if (document.body.classList.contains("folded") || (!live && sides.a.is < finest())) return null;
  return thumbs.find((t) => !t.asked && t.button.offsetParent && (t.name !== "segment" || state.a[1] === "segment"));
}
function place() {
  if (!shows.length) return;
  const c = $("a").getBoundingClientRect(), s = stage.getBoundingClientRect(), wipe = state.compare === "wipe", flicker = state.compare === "flicker";
  $("b").hidden = !(wipe || (flicker && front === "b"));
  $("wipe").hidden = !wipe;
  $("gaining").hidden = state.compare !== "difference";
  $("swap").hidden = !flicker;
  $("second").hidden = !state.compare;
  $("label-b").hidden = !wipe;
  $("b").style.clipPath = wipe ? `inset(0 0 0 ${100 * state.cut}%)` : "";
  placeLocal();
  Object.assign($("wipe").style, { left: c.left - s.left + "px", width: c.width + "px" });
  $("wipe").lastElementChild.style.left = 100 * state.cut + "%";
  $("cut").value = state.cut;
  const label = (side) => `${shows[state[side][0]].name} · ${state[side][2] >= 0 ? `step ${state[side][2]} · ` : ""}${state[side][1]}`;
  $("label-a").textContent = state.compare === "difference" ? `${label("a")} − ${label("b")}` : label(flicker ? front : "a");
  $("label-b").textContent = label("b");
  $("unhide").hidden = !state.hidden.length;
  $("sizing").hidden = state.style !== "points";
  press("compare", state.compare); press("style", state.style);
  const hex = state.back && "#" + state.back.map((v) => Math.round(255 * v).toString(16).padStart(2, "0")).join("");
  press("back", hex ?? "own");
  if (hex) $("colour").value = hex;
  lines();
}
function compareBy(mode) { state.compare = mode; front = "a"; place(); changed(); }
function swap() {
  if (state.compare !== "flicker") compareBy("flicker");
  front = front === "a" ? "b" : "a";
  place();
}
function showFov() { const degrees = Math.round((180 * state.fov) / Math.PI); $("fov").value = degrees; $("fov-text").textContent = `${degrees}°`; }
// A narrow window begins with the panel folded.
function fold(on = !document.body.classList.contains("folded")) {
  document.body.classList.toggle("folded", on);
  $("fold").setAttribute("aria-expanded", !on);
}
function showAll() { views(); layers(); figure(); timeline(); showFov(); place(); }

$("fold").addEventListener("click", () => fold());
$("compare").addEventListener("click", (e) => { if (e.target.tagName === "BUTTON") compareBy(e.target.value); });
$("style").addEventListener("click", (e) => { if (e.target.tagName === "BUTTON") { state.style = e.target.value; place(); changed(); } });
$("size").addEventListener("input", (e) => { state.size = Number(e.target.value); changed(); });
const paint = (hex) => { state.back = hex === "own" ? null : [1, 3, 5].map((k) => parseInt(hex.slice(k, k + 2), 16) / 255); place(); changed(); };
$("back").addEventListener("click", (e) => { if (e.target.tagName === "BUTTON") paint(e.target.value); });
$("colour").addEventListener("input", (e) => paint(e.target.value));
$("fov").addEventListener("input", (e) => { leaveView(); state.fov = (Number(e.target.value) * Math.PI) / 180; showFov(); changed(); });
$("frame").addEventListener("click", frameScene);
$("flip").addEventListener("click", nextUp);
$("swap").addEventListener("click", swap);
$("view").addEventListener("change", (e) => snap(Number(e.target.value)));
const nextView = (by) => snap(Math.min(about().views.length - 1, Math.max(0, state.view + by)));
$("before").addEventListener("click", () => nextView(-1));
$("after").addEventListener("click", () => nextView(1));
$("cut").addEventListener("input", (e) => { state.cut = Number(e.target.value); place(); save(); });
$("gain").addEventListener("change", (e) => { state.gain = Number(e.target.value); changed(); });
for (const name of ["axes", "grid"]) $(name).addEventListener("change", (e) => { state[name] = e.target.checked; lines(); save(); });
$("cameras").addEventListener("change", (e) => { state.cameras = e.target.checked; pictures(); lines(); save(); });
$("arrows").addEventListener("change", (e) => { state.arrows = e.target.checked; changed(); });
for (const side of ["a", "b"]) {
  $("show-" + side).addEventListener("change", (e) => { state[side][0] = Number(e.target.value); state[side][2] = -1; paths = []; unchoose(); thumbs = []; showAll(); state.t = Math.min(LAST(), Math.max(FIRST(), state.t)); if (state.view >= 0) snap(state.view); else setTime(state.t); });
  $("step-" + side).addEventListener("change", (e) => { state[side][2] = Number(e.target.value); layers(); place(); changed(); });
}
$("layer-b").addEventListener("change", (e) => { state.b[1] = e.target.value; place(); changed(); });
