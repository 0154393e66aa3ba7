"use strict";
// The ruler of time: training span and timestamps, held-out views, intervals, what is extrapolated; and playing.
let lastTick = 0, looping = true;
const FIRST = () => Math.min(0, about().times[0]);
const END = () => Math.max(...about().times);
const LAST = () => Math.max(1.25 * (END() - Math.max(FIRST(), 0)) + Math.max(FIRST(), 0), ...about().views.map((v) => v.time));
// The data's own time, seconds unless it lies in 0..1, where files have no unit; else the normalised time alone.
function ownTime(t, digits = 2) {
  const clock = about().clock;
  if (!clock) return "";
  return `${(clock[0] + t * (clock[1] - clock[0])).toFixed(digits)}${about().has_seconds ? " s" : ""}`;
}
function showTime() {
  const own = ownTime(state.t), s = about(), beyond = state.t > END() + 1e-6 ? " future" : state.t < s.times[0] - 1e-6 ? " past" : "";
  $("seconds").textContent = `${own ? `${own}  (${state.t.toFixed(3)})` : state.t.toFixed(3)}${beyond}`;
  $("t").setAttribute("aria-valuetext", $("seconds").textContent);
  const head = $("ruler").querySelector(".now");
  if (head) head.setAttribute("transform", `translate(${xOf(state.t)} 0)`);
}
const xOf = (t) => 1 + ((t - FIRST()) / (LAST() - FIRST() || 1)) * Math.max(1, $("track").clientWidth - 2);
function timeline() {
  const s = about(), ruler = $("ruler"), [first, last] = [s.times[0], END()];
  $("time").hidden = !s.moving;
  for (const e of document.querySelectorAll(".moving")) e.hidden = !s.moving;
  for (const e of document.querySelectorAll(".data")) e.hidden = !s.views.length;
  if (!s.moving) { if (playing) play(false); return; }
  Object.assign($("t"), { min: FIRST(), max: LAST(), value: state.t });
  const all = [], put = (name, attributes) => { const e = svgElement(name, attributes); all.push(e); return e; };
  const hatch = svgElement("pattern", { id: "hatch", width: 6, height: 6, patternUnits: "userSpaceOnUse", patternTransform: "rotate(45)" });
  hatch.append(svgElement("path", { d: "M0 0V6", "stroke-width": 3 })); all.push(hatch);
  const band = (cls, from, to) => to > from && put("rect", { class: cls, x: xOf(from), y: 16, width: xOf(to) - xOf(from), height: 16, rx: 2 });
  band("none", FIRST(), first); band("span", first, last); band("none", last, LAST());
  const wide = $("track").clientWidth, ticks = s.times.filter((_, k) => k % Math.ceil((3 * s.times.length) / Math.max(wide, 1)) === 0);
  for (const t of ticks) put("line", { class: "tick", x1: xOf(t), x2: xOf(t), y1: 27, y2: 32 });
  for (const t of new Set(s.views.filter((v) => v.held_out).map((v) => v.time))) put("circle", { class: "held", cx: xOf(t), cy: 20, r: 1.7 });
  for (const t of s.borders) put("line", { class: "border", x1: xOf(t), x2: xOf(t), y1: 13, y2: 35 });
  for (const t of labels(wide)) put("text", { x: xOf(t), y: 43, "text-anchor": t <= FIRST() + 1e-6 ? "start" : t >= LAST() - 1e-6 ? "end" : "middle" }).textContent = about().clock ? +Number.parseFloat(ownTime(t, 3)) : +t.toFixed(2);
  if (xOf(LAST()) - xOf(last) > 75) put("text", { x: xOf(last) + 4, y: 11 }).textContent = "extrapolated";
  const now = put("g", { class: "now" });
  now.append(svgElement("line", { class: "head", x1: 0, x2: 0, y1: 10, y2: 36 }), svgElement("path", { class: "grip", d: "M-5 4h10v5l-5 5-5-5z" }));
  ruler.replaceChildren(...all);
  showTime();
}
// Times with a label, at round steps, at least 60 pixels apart.
function labels(wide) {
  const [from, to] = about().clock ?? [0, 1], own = (t) => from + t * (to - from), [low, high] = [own(FIRST()), own(LAST())], ten = 10 ** Math.floor(Math.log10(high - low) - 1);
  const step = [1, 2, 5, 10, 20, 50, 100].map((v) => v * ten).find((v) => (v / (high - low)) * wide > 60) || high - low, first = Math.ceil(low / step - 1e-6);
  return Array.from({ length: Math.max(0, Math.floor(high / step + 1e-6) - first + 1) }, (_, k) => ((first + k) * step - from) / (to - from));
}
function setTime(t) { state.t = Math.min(LAST(), Math.max(FIRST(), t)); $("t").value = state.t; showTime(); changed(); }
// To the next training timestamp, or back.
function stepTime(by) {
  const times = about().times, next = by > 0 ? times.find((t) => t > state.t + 1e-6) : times.findLast((t) => t < state.t - 1e-6);
  setTime(next ?? state.t + 0.01 * by);
}
function play(asked) {
  const on = asked && about().moving;
  playing = on; lastTick = performance.now();
  $("time").classList.toggle("playing", on); $("play").setAttribute("aria-label", on ? "Pause" : "Play");
  if (!on) changed();
}
function advance(now) {
  const ready = !busy && sides.a.want === null;
  if (!playing || !(ready || locals.a.drawn)) return;
  const unit = about().has_seconds ? about().seconds : 3; // a sequence without seconds is played in three
  let t = state.t + ((now - lastTick) / 1000 / Math.max(unit, 0.5)) * Number($("speed").value);
  lastTick = now;
  if (t > LAST()) { if (!looping) play(false); t = looping ? FIRST() : LAST(); }
  setTime(t);
}
