//! The normal equations of every pixel, and their solution over a box.

use fearless_simd::{Level, Simd, dispatch};
use gs_core::cast;
use rayon::prelude::*;

use super::Flow;
use super::expand::TERMS;

/// Weights of equations near the border, by distance from it in pixels: fits there contain repeated pixels.
const BORDER: [f32; 5] = [0.14, 0.14, 0.4472, 0.4472, 0.4472];
/// Half width of the box, pixels.
const RADIUS: usize = 7;
/// Width of the box, pixels.
const BOX: usize = 2 * RADIUS + 1;
/// Added to the determinant; grey values to the fourth power.
const DETERMINANT_EPSILON: f64 = 1e-3;
/// Rows of one parallel task.
const BAND: usize = 32;

/// Normal equations `[H, TERMS, W]` of every pixel, from the coefficients of both frames (`[H, TERMS, W]`) around `flow`:
/// `A_yy² + A_xy²`, `(A_yy + A_xx) A_xy`, `A_xx² + A_xy²`, and the right-hand sides for v and for u.
pub(super) fn equations(first: &[f32], second: &[f32], flow: &Flow, out: &mut Vec<f32>) {
    let (w, h) = (flow.width, flow.height);
    out.resize(w * h * TERMS, 0.0);
    let border = |at: usize, n: usize| BORDER.get(at).unwrap_or(&1.0) * BORDER.get(n - 1 - at).unwrap_or(&1.0);
    let columns: Vec<f32> = (0..w).map(|x| border(x, w)).collect();
    out.par_chunks_mut(TERMS * w).enumerate().for_each_init(
        || vec![0.0f32; TERMS * w],
        |moved, (y, out)| {
            let (u, v) = (&flow.u[y * w..(y + 1) * w], &flow.v[y * w..(y + 1) * w]);
            let row = &first[y * TERMS * w..(y + 1) * TERMS * w];
            read_moved(second, row, u, v, y, h, moved);
            dispatch!(Level::new(), simd => combine(simd, row, moved, [u, v], border(y, h), &columns, out));
        },
    );
}

/// The coefficients of the second frame at the ends of the flow of row `y`, bilinear, `[TERMS, W]`. Where the end is outside:
/// slope 0 and the curvature of the first frame.
#[inline(always)]
fn read_moved(second: &[f32], first: &[f32], u: &[f32], v: &[f32], y: usize, h: usize, out: &mut [f32]) {
    let w = u.len();
    let row = TERMS * w;
    for x in 0..w {
        let (px, py) = (x as f32 + u[x], y as f32 + v[x]);
        let (fx, fy) = (px.floor(), py.floor());
        let inside = fx >= 0.0 && fy >= 0.0 && fx < (w - 1) as f32 && fy < (h - 1) as f32;
        if !inside {
            (0..2).for_each(|t| out[t * w + x] = 0.0);
            (2..4).for_each(|t| out[t * w + x] = first[t * w + x]);
            out[4 * w + x] = first[4 * w + x];
            continue;
        }
        let (ax, ay) = (px - fx, py - fy);
        let weights = [(1.0 - ax) * (1.0 - ay), ax * (1.0 - ay), (1.0 - ax) * ay, ax * ay];
        #[expect(clippy::cast_possible_truncation, reason = "inside the frame")]
        let at = fy as usize * row + fx as usize;
        let (top, low) = (&second[at..at + row - w + 2], &second[at + row..at + 2 * row - w + 2]);
        for t in 0..TERMS {
            let k = t * w;
            out[k + x] = weights[0] * top[k] + weights[1] * top[k + 1] + weights[2] * low[k] + weights[3] * low[k + 1];
        }
    }
}

/// The equations of a row whose border weights are `row_weight · columns`.
#[inline(always)]
fn combine<S: Simd>(
    _: S,
    first: &[f32],
    moved: &[f32],
    [u, v]: [&[f32]; 2],
    row_weight: f32,
    columns: &[f32],
    out: &mut [f32],
) {
    let w = columns.len();
    let [by0, bx0, yy0, xx0, xy0] = planes(first, w);
    let [by1, bx1, yy1, xx1, xy1] = planes(moved, w);
    let (u, v) = (&u[..w], &v[..w]);
    let (m0, out) = out.split_at_mut(w);
    let (m1, out) = out.split_at_mut(w);
    let (m2, out) = out.split_at_mut(w);
    let (m3, m4) = out.split_at_mut(w);
    let m4 = &mut m4[..w];
    for x in 0..w {
        let weight = row_weight * columns[x];
        let (yy, xx, xy) = (0.5 * (yy0[x] + yy1[x]), 0.5 * (xx0[x] + xx1[x]), 0.25 * (xy0[x] + xy1[x]));
        let p = weight * (0.5 * (by0[x] - by1[x]) + yy * v[x] + xy * u[x]);
        let q = weight * (0.5 * (bx0[x] - bx1[x]) + xy * v[x] + xx * u[x]);
        let (yy, xx, xy) = (weight * yy, weight * xx, weight * xy);
        m0[x] = yy * yy + xy * xy;
        m1[x] = (yy + xx) * xy;
        m2[x] = xx * xx + xy * xy;
        m3[x] = yy * p + xy * q;
        m4[x] = xy * p + xx * q;
    }
}

/// The planes of one row `[TERMS, W]`.
#[inline(always)]
fn planes(row: &[f32], w: usize) -> [&[f32]; TERMS] {
    std::array::from_fn(|t| &row[t * w..(t + 1) * w])
}

/// Sums of one band.
#[derive(Default)]
struct Sums {
    /// Over the rows of the box, `[TERMS, W + 2·RADIUS]`, with repeated ends.
    columns: Vec<f64>,
    /// Over runs of 2, 4 and 8 columns, of one term.
    runs: [Vec<f64>; 3],
    /// Over the box, `[TERMS, W]`.
    boxes: Vec<f64>,
}

/// The least-squares solution of the equations `[H, TERMS, W]` in a box around every pixel, with the nearest equations outside.
pub(super) fn solve(equations: &[f32], flow: &mut Flow) {
    let (w, h) = (flow.width, flow.height);
    let work = flow.u.par_chunks_mut(BAND * w).zip(flow.v.par_chunks_mut(BAND * w)).enumerate();
    work.for_each_init(Sums::default, |sums, (band, (u, v))| {
        dispatch!(Level::new(), simd => solve_band(simd, equations, w, h, band * BAND, sums, u, v));
    });
}

#[allow(clippy::too_many_arguments, reason = "one call site; a struct would only repeat the names")]
#[inline(always)]
fn solve_band<S: Simd>(
    _: S,
    equations: &[f32],
    w: usize,
    h: usize,
    first: usize,
    sums: &mut Sums,
    u: &mut [f32],
    v: &mut [f32],
) {
    sums.reset(w);
    let row = |y: isize| {
        let at = y.clamp(0, h as isize - 1) as usize * TERMS * w;
        &equations[at..at + TERMS * w]
    };
    let reach = RADIUS as isize;
    (first as isize - reach..=first as isize + reach).for_each(|y| sums.add(row(y), w));
    for (i, (u, v)) in u.chunks_exact_mut(w).zip(v.chunks_exact_mut(w)).enumerate() {
        let y = (first + i) as isize;
        if i > 0 {
            sums.move_down(row(y - reach - 1), row(y + reach), w);
        }
        sums.over_columns(w);
        solve_row(&sums.boxes, u, v);
    }
}

impl Sums {
    #[inline(always)]
    fn reset(&mut self, w: usize) {
        self.columns.clear();
        self.columns.resize(TERMS * (w + 2 * RADIUS), 0.0);
        self.runs.iter_mut().for_each(|r| r.resize(w + 2 * RADIUS, 0.0));
        self.boxes.resize(TERMS * w, 0.0);
    }

    /// Adds a row of equations to the sums over rows.
    #[inline(always)]
    fn add(&mut self, row: &[f32], w: usize) {
        for t in 0..TERMS {
            let (sums, row) = (self.middle(t, w), &row[t * w..(t + 1) * w]);
            for x in 0..w {
                sums[x] += f64::from(row[x]);
            }
        }
    }

    /// Moves the box down by one row.
    #[inline(always)]
    fn move_down(&mut self, leaving: &[f32], entering: &[f32], w: usize) {
        for t in 0..TERMS {
            let sums = self.middle(t, w);
            let (old, new) = (&leaving[t * w..(t + 1) * w], &entering[t * w..(t + 1) * w]);
            for x in 0..w {
                sums[x] += f64::from(new[x]) - f64::from(old[x]);
            }
        }
    }

    /// Sums over rows of term `t` without the repeated ends.
    #[inline(always)]
    fn middle(&mut self, t: usize, w: usize) -> &mut [f64] {
        let at = t * (w + 2 * RADIUS) + RADIUS;
        &mut self.columns[at..at + w]
    }

    /// Sums over columns: runs of 8, 4, 2 and 1 make the 15 of the box.
    #[inline(always)]
    fn over_columns(&mut self, w: usize) {
        let n = w + 2 * RADIUS;
        let [twos, fours, eights] = &mut self.runs;
        let (twos, fours, eights) = (&mut twos[..n], &mut fours[..n], &mut eights[..n]);
        for t in 0..TERMS {
            let line = &mut self.columns[t * n..(t + 1) * n];
            let (low, high) = (line[RADIUS], line[RADIUS + w - 1]);
            line[..RADIUS].fill(low);
            line[RADIUS + w..].fill(high);
            for x in 0..n - 1 {
                twos[x] = line[x] + line[x + 1];
            }
            for x in 0..n - 3 {
                fours[x] = twos[x] + twos[x + 2];
            }
            for x in 0..n - 7 {
                eights[x] = fours[x] + fours[x + 4];
            }
            let out = &mut self.boxes[t * w..(t + 1) * w];
            for x in 0..w {
                out[x] = (eights[x] + fours[x + 8]) + (twos[x + 12] + line[x + 14]);
            }
        }
    }
}

/// Cramer's rule for a row of means.
#[inline(always)]
fn solve_row(boxes: &[f64], u: &mut [f32], v: &mut [f32]) {
    let w = u.len();
    let v = &mut v[..w];
    let [m0, m1, m2, m3, m4]: [&[f64]; TERMS] = std::array::from_fn(|t| &boxes[t * w..(t + 1) * w]);
    let mean = 1.0 / (BOX * BOX) as f64;
    for x in 0..w {
        let [a, b, c, p, q] = [m0[x] * mean, m1[x] * mean, m2[x] * mean, m3[x] * mean, m4[x] * mean];
        let d = 1.0 / (a * c - b * b + DETERMINANT_EPSILON);
        u[x] = cast::to_f32((a * q - b * p) * d);
        v[x] = cast::to_f32((c * p - b * q) * d);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use gs_core::Rng;

    /// The mean over the box by plain loops.
    fn mean_at(m: &[f32], w: usize, h: usize, t: usize, x: usize, y: usize) -> f64 {
        let clamp = |i: usize, d: usize, n: usize| (i + d).saturating_sub(RADIUS).min(n - 1);
        let mut sum = 0.0;
        for dy in 0..BOX {
            for dx in 0..BOX {
                sum += f64::from(m[(clamp(y, dy, h) * TERMS + t) * w + clamp(x, dx, w)]);
            }
        }
        sum / (BOX * BOX) as f64
    }

    #[test]
    fn boxes_agree_with_plain_loops_at_every_size() {
        for (w, h) in [(1, 1), (2, 40), (9, 3), (40, 70)] {
            let mut rng = Rng::new(5, "box", 0, 0);
            let m: Vec<f32> = (0..w * h * TERMS).map(|_| rng.uniform()).collect();
            let mut flow = Flow::zeros(w, h);
            solve(&m, &mut flow);
            for y in 0..h {
                for x in 0..w {
                    let [a, b, c, p, q] = std::array::from_fn(|t| mean_at(&m, w, h, t, x, y));
                    let d = 1.0 / (a * c - b * b + DETERMINANT_EPSILON);
                    let want = [(a * q - b * p) * d, (c * p - b * q) * d];
                    for (g, w) in flow.at(x, y).iter().zip(want) {
                        assert!((f64::from(*g) - w).abs() < 1e-5 * w.abs().max(1.0), "({x}, {y}): {g} {w}");
                    }
                }
            }
        }
    }

    #[test]
    fn displacements_outside_contribute_no_slope() {
        let w = 12;
        let mut rng = Rng::new(6, "outside", 0, 0);
        let r: Vec<f32> = (0..w * w * TERMS).map(|_| rng.uniform()).collect();
        let far = Flow { u: vec![1e9; w * w], ..Flow::zeros(w, w) };
        let mut out = Vec::new();
        equations(&r, &r, &far, &mut out);
        let (x, y) = (6, 6);
        let at = |t: usize| r[(y * TERMS + t) * w + x];
        let (yy, xx, xy) = (at(2), at(3), 0.5 * at(4));
        assert_eq!(out[y * TERMS * w + x], yy * yy + xy * xy);
        assert_eq!(out[(y * TERMS + 2) * w + x], xx * xx + xy * xy);
        assert!(out.iter().all(|v| v.is_finite()));
    }
}
