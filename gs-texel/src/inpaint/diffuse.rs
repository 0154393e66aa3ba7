//! Push-pull and harmonic in-painting of the unknown texels (holes) of a chart.

use crate::texels::TexelTable;

/// Conjugate gradients stop when the residual falls below this share of the first one.
const TOLERANCE: f64 = 1e-6;
/// Steps of conjugate gradients; a hole of `n` texels needs about `√n`.
const MAX_STEPS: usize = 2000;

/// The texels of one chart in their bounding box.
struct Patch<'a, const C: usize> {
    table: &'a TexelTable,
    known: &'a [bool],
    chart: u16,
    low: [usize; 2],
    side: [usize; 2],
    rows: &'a [[f32; C]],
}

/// Bounding box of every chart in texels: lowest corner, and highest corner exclusive.
pub(super) fn boxes(table: &TexelTable) -> Vec<[[usize; 2]; 2]> {
    let mut boxes = Vec::new();
    for (&t, &chart) in table.valid.iter().zip(&table.chart) {
        let chart = usize::from(chart);
        if boxes.len() <= chart {
            boxes.resize(chart + 1, [[usize::MAX; 2], [0; 2]]);
        }
        let p = [t as usize % table.size, t as usize / table.size];
        let [low, high] = &mut boxes[chart];
        (0..2).for_each(|i| (low[i], high[i]) = (low[i].min(p[i]), high[i].max(p[i] + 1)));
    }
    boxes
}

/// Unknown texels of a chart, and its bounding box.
#[derive(Clone, Copy)]
pub(super) struct Holes<'a> {
    /// Rows of the table, all in one chart.
    pub(super) rows: &'a [u32],
    /// Bounding box of the chart, see [`boxes`].
    pub(super) window: [[usize; 2]; 2],
}

impl<'a, const C: usize> Patch<'a, C> {
    /// The patch of the chart of `holes`.
    fn new(table: &'a TexelTable, rows: &'a [[f32; C]], known: &'a [bool], holes: Holes<'_>) -> Option<Self> {
        let chart = table.chart[*holes.rows.first()? as usize];
        let [low, high] = holes.window;
        Some(Self { table, known, chart, low, side: [high[0] - low[0], high[1] - low[1]], rows })
    }

    /// The row of the chart's texel at a position of the box.
    fn row(&self, x: usize, y: usize) -> Option<usize> {
        let row = self.table.row[(self.low[1] + y) * self.table.size + self.low[0] + x] as usize;
        (self.table.chart.get(row) == Some(&self.chart)).then_some(row)
    }

    /// Position of a row in the box.
    fn place(&self, row: u32) -> [usize; 2] {
        let t = self.table.valid[row as usize] as usize;
        [t % self.table.size - self.low[0], t / self.table.size - self.low[1]]
    }
}

/// A level of the pyramid: means and their weights.
struct Level<const C: usize> {
    side: [usize; 2],
    mean: Vec<[f64; C]>,
    weight: Vec<f64>,
}

impl<const C: usize> Level<C> {
    fn finest(patch: &Patch<'_, C>) -> Self {
        let [w, h] = patch.side;
        let mut level = Self { side: [w, h], mean: vec![[0.0; C]; w * h], weight: vec![0.0; w * h] };
        for (i, (x, y)) in (0..h).flat_map(|y| (0..w).map(move |x| (x, y))).enumerate() {
            if let Some(row) = patch.row(x, y).filter(|r| patch.known[*r]) {
                (level.mean[i], level.weight[i]) = (patch.rows[row].map(f64::from), 1.0);
            }
        }
        level
    }

    /// Half the size: weighted means of four.
    fn coarser(&self) -> Self {
        let [w, h] = self.side.map(|s| s.div_ceil(2));
        let mut out = Self { side: [w, h], mean: vec![[0.0; C]; w * h], weight: vec![0.0; w * h] };
        for (x, y) in (0..self.side[1]).flat_map(|y| (0..self.side[0]).map(move |x| (x, y))) {
            let (from, to) = (y * self.side[0] + x, y / 2 * w + x / 2);
            (0..C).for_each(|c| out.mean[to][c] += self.weight[from] * self.mean[from][c]);
            out.weight[to] += self.weight[from];
        }
        for (mean, weight) in out.mean.iter_mut().zip(&mut out.weight) {
            if *weight > 0.0 {
                mean.iter_mut().for_each(|m| *m /= *weight);
                *weight = weight.min(1.0);
            }
        }
        out
    }

    /// Fills texels of weight 0 bilinearly from the coarser level, which has none.
    fn fill(&mut self, coarse: &Self) {
        let near = |x: usize, side: usize| {
            let (own, part) = (x / 2, if x.is_multiple_of(2) { -1 } else { 1 });
            let other = own.saturating_add_signed(part).min(side - 1);
            [(own, 0.75), (other, 0.25)]
        };
        let [w, h] = self.side;
        for (i, (x, y)) in (0..h).flat_map(|y| (0..w).map(move |x| (x, y))).enumerate() {
            if self.weight[i] > 0.0 {
                continue;
            }
            let mut sum = [0.0; C];
            for (cy, wy) in near(y, coarse.side[1]) {
                for (cx, wx) in near(x, coarse.side[0]) {
                    let mean = &coarse.mean[cy * coarse.side[0] + cx];
                    sum.iter_mut().zip(mean).for_each(|(s, m)| *s += wx * wy * m);
                }
            }
            (self.mean[i], self.weight[i]) = (sum, 1.0);
        }
    }
}

/// Push-pull: weighted means of known texels on a pyramid, then bilinear upsampling. Empty if the chart has no known texel.
pub(super) fn push_pull<const C: usize>(
    table: &TexelTable,
    rows: &[[f32; C]],
    known: &[bool],
    holes: Holes<'_>,
) -> Vec<(u32, [f32; C])> {
    let Some(patch) = Patch::new(table, rows, known, holes) else { return Vec::new() };
    let mut levels = vec![Level::finest(&patch)];
    while let Some(last) = levels.last().filter(|l| l.side != [1, 1]) {
        let next = last.coarser();
        levels.push(next);
    }
    if levels.last().is_none_or(|l| l.weight[0] == 0.0) {
        return Vec::new();
    }
    for k in (1..levels.len()).rev() {
        let (fine, coarse) = levels.split_at_mut(k);
        fine[k - 1].fill(&coarse[0]);
    }
    let at = |&hole: &u32| {
        let [x, y] = patch.place(hole);
        (hole, levels[0].mean[y * patch.side[0] + x].map(|v| v as f32))
    };
    holes.rows.iter().map(at).collect()
}

/// The harmonic fill: each hole is the mean of its neighbours in the chart (`Δ = 0`, known texels fixed, no flow over the
/// chart's border), by conjugate gradients from [`push_pull`].
pub(super) fn harmonic<const C: usize>(
    table: &TexelTable,
    rows: &[[f32; C]],
    known: &[bool],
    holes: Holes<'_>,
) -> Vec<(u32, [f32; C])> {
    let first = push_pull(table, rows, known, holes);
    let Some(patch) = Patch::new(table, rows, known, holes).filter(|_| !first.is_empty()) else { return first };
    let around = neighbours(&patch, holes.rows);
    let mut out = first;
    for c in 0..C {
        let mut x: Vec<f64> = out.iter().map(|(_, v)| f64::from(v[c])).collect();
        // A x = b: the sum over neighbours of x_i − x_j, with known x_j on the right.
        let apply = |x: &[f64]| -> Vec<f64> {
            let term = |i: usize, near: &Neighbour| match near {
                Neighbour::Outside => 0.0,
                Neighbour::Known(_) => x[i],
                Neighbour::Hole(j) => x[i] - x[*j],
            };
            around.iter().enumerate().map(|(i, near)| near.iter().map(|n| term(i, n)).sum()).collect()
        };
        let known = |near: &Neighbour| if let Neighbour::Known(row) = near { f64::from(rows[*row][c]) } else { 0.0 };
        let b: Vec<f64> = around.iter().map(|near| near.iter().map(known).sum()).collect();
        conjugate_gradients(apply, &b, &mut x);
        out.iter_mut().zip(&x).for_each(|((_, v), x)| v[c] = *x as f32);
    }
    out
}

/// A neighbour of a hole.
#[derive(Clone, Copy)]
enum Neighbour {
    /// Outside the chart.
    Outside,
    /// A known texel: row of the table.
    Known(usize),
    /// Another hole: its index.
    Hole(usize),
}

/// The four neighbours of every hole.
fn neighbours<const C: usize>(patch: &Patch<'_, C>, holes: &[u32]) -> Vec<[Neighbour; 4]> {
    let [w, h] = patch.side;
    let mut number = vec![0; w * h];
    for (i, &hole) in holes.iter().enumerate() {
        let [x, y] = patch.place(hole);
        number[y * w + x] = i;
    }
    let beside = |[x, y]: [usize; 2], [dx, dy]: [isize; 2]| {
        let (x, y) = (x.checked_add_signed(dx)?, y.checked_add_signed(dy)?);
        let row = if x < w && y < h { patch.row(x, y)? } else { return None };
        Some(if patch.known[row] { Neighbour::Known(row) } else { Neighbour::Hole(number[y * w + x]) })
    };
    let four = |&hole: &u32| {
        let at = patch.place(hole);
        [[-1, 0], [1, 0], [0, -1], [0, 1]].map(|d| beside(at, d).unwrap_or(Neighbour::Outside))
    };
    holes.iter().map(four).collect()
}

/// Solves `A x = b` for symmetric positive semi-definite `A`, from the `x` given.
fn conjugate_gradients(apply: impl Fn(&[f64]) -> Vec<f64>, b: &[f64], x: &mut [f64]) {
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let mut r: Vec<f64> = b.iter().zip(apply(x)).map(|(b, a)| b - a).collect();
    let mut p = r.clone();
    let mut square = dot(&r, &r);
    let end = square * TOLERANCE * TOLERANCE;
    for _ in 0..MAX_STEPS {
        let ap = apply(&p);
        let step = square / dot(&p, &ap);
        if square <= end || !step.is_finite() {
            return;
        }
        x.iter_mut().zip(&p).for_each(|(x, p)| *x += step * p);
        r.iter_mut().zip(&ap).for_each(|(r, a)| *r -= step * a);
        let next = dot(&r, &r);
        p.iter_mut().zip(&r).for_each(|(p, r)| *p = r + next / square * *p);
        square = next;
    }
}
