//! Exact rasterisation of triangles: corners in fixed point, edge functions in integers, the top-left fill rule.
//!
//! Two triangles that share an edge (given by the same corners) cover every cell centre on it once. Depth maps and texel
//! tables are filled by the same spans.

use glam::DVec2;

/// Fixed-point steps per cell.
const STEPS: f64 = 256.0;
const CELL: i64 = 256;
const HALF: i64 = 128;
/// Largest magnitude of a corner, in cells, for which products of two fit into `i64`.
pub(crate) const MAX_COORDINATE: f64 = (1u64 << 20) as f64;

/// Cells `x0..x1` of rows `y0..y1`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Window {
    pub(crate) x0: usize,
    pub(crate) y0: usize,
    pub(crate) x1: usize,
    pub(crate) y1: usize,
}

impl Window {
    pub(crate) fn is_empty(&self) -> bool {
        self.x0 >= self.x1 || self.y0 >= self.y1
    }
}

/// A corner, in cells, as fixed point. Its magnitude must be at most [`MAX_COORDINATE`].
pub(crate) fn to_fixed(p: DVec2) -> [i64; 2] {
    [(p.x * STEPS).round() as i64, (p.y * STEPS).round() as i64]
}

/// One side of a triangle of positive area: a centre is inside where `offset + along·y ≥ across·x`.
struct Side {
    offset: i64,
    along: i64,
    across: i64,
}

impl Side {
    fn new(p: [i64; 2], q: [i64; 2]) -> Self {
        let (dx, dy) = (q[0] - p[0], q[1] - p[1]);
        // Centres on a side belong to one of its two triangles: sides run opposite ways in them.
        let owns = dy < 0 || (dy == 0 && dx > 0);
        let offset = dx * (HALF - p[1]) - dy * (HALF - p[0]) - i64::from(!owns);
        Self { offset, along: CELL * dx, across: CELL * dy }
    }

    /// Narrows `lo..=hi` to the part of row `y` inside.
    fn narrow(&self, y: i64, lo: &mut i64, hi: &mut i64) {
        let k = self.offset + self.along * y;
        match self.across {
            0 if k < 0 => *hi = i64::MIN,
            0 => {}
            d if d > 0 => *hi = (*hi).min(k.div_euclid(d)),
            d => *lo = (*lo).max(-k.div_euclid(-d)),
        }
    }
}

/// Calls `span(y, x0, x1)` for each row of `window` with cell centres inside the triangle, of either orientation. Triangles
/// without area cover nothing.
pub(crate) fn spans(corners: [[i64; 2]; 3], window: Window, mut span: impl FnMut(usize, usize, usize)) {
    let [a, mut b, mut c] = corners;
    let area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0]);
    if area == 0 || window.is_empty() {
        return;
    }
    if area < 0 {
        std::mem::swap(&mut b, &mut c);
    }
    let sides = [Side::new(a, b), Side::new(b, c), Side::new(c, a)];
    let first = |v: i64, low: usize| (-(HALF - v).div_euclid(CELL)).max(low as i64);
    let last = |v: i64, end: usize| (v - HALF).div_euclid(CELL).min(end as i64 - 1);
    let top = first(a[1].min(b[1]).min(c[1]), window.y0);
    let bottom = last(a[1].max(b[1]).max(c[1]), window.y1);
    let left = first(a[0].min(b[0]).min(c[0]), window.x0);
    let right = last(a[0].max(b[0]).max(c[0]), window.x1);
    if left > right {
        return;
    }
    for y in top..=bottom {
        let (mut lo, mut hi) = (left, right);
        sides.iter().for_each(|s| s.narrow(y, &mut lo, &mut hi));
        if lo <= hi {
            span(y as usize, lo as usize, hi as usize + 1);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use gs_core::Rng;

    fn count(corners: [[i64; 2]; 3], size: usize, grid: &mut [u32]) {
        let window = Window { x0: 0, y0: 0, x1: size, y1: size };
        spans(corners, window, |y, x0, x1| grid[y * size + x0..y * size + x1].iter_mut().for_each(|g| *g += 1));
    }

    #[test]
    fn a_fan_owns_every_centre_once() {
        // All corners on centres, so that every rule on ties is met.
        let at = |x: i64, y: i64| [CELL * x + HALF, CELL * y + HALF];
        let rim = [at(0, 0), at(5, -1), at(9, 0), at(9, 9), at(4, 10), at(0, 9)];
        let mut grid = vec![0; 100];
        for i in 0..6 {
            let (p, q) = (rim[i], rim[(i + 1) % 6]);
            count(if i % 2 == 0 { [at(4, 4), p, q] } else { [q, p, at(4, 4)] }, 10, &mut grid);
        }
        let inner = (1..9).flat_map(|y| (1..9).map(move |x| (x, y)));
        assert!(inner.into_iter().all(|(x, y)| grid[y * 10 + x] == 1), "{grid:?}");
        assert!(grid.iter().all(|&g| g <= 1));
    }

    #[test]
    fn spans_are_the_centres_inside() {
        let mut rng = Rng::new(3, "coverage", 0, 0);
        for _ in 0..300 {
            let mut corner = || [rng.below(20 * 256) as i64 - 512, rng.below(20 * 256) as i64 - 512];
            let t = [corner(), corner(), corner()];
            let mut grid = vec![0; 256];
            count(t, 16, &mut grid);
            let side =
                |p: [i64; 2], q: [i64; 2], c: [i64; 2]| (q[0] - p[0]) * (c[1] - p[1]) - (q[1] - p[1]) * (c[0] - p[0]);
            for (i, &got) in grid.iter().enumerate() {
                let c = [CELL * (i as i64 % 16) + HALF, CELL * (i as i64 / 16) + HALF];
                let e = [side(t[0], t[1], c), side(t[1], t[2], c), side(t[2], t[0], c)];
                if e.iter().all(|&e| e > 0) || e.iter().all(|&e| e < 0) {
                    assert_eq!(got, 1);
                } else if e.iter().any(|&e| e > 0) && e.iter().any(|&e| e < 0) {
                    assert_eq!(got, 0);
                }
            }
        }
    }
}
