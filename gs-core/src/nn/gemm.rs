//! Matrix product on slices: a checked, serial interface to the `gemm` crate.
//!
//! `dst = a · b` or `dst += a · b` for `a: [m, k]`, `b: [k, n]`, `dst: [m, n]`, single precision, on strided views.
//! The call is serial on purpose: rows are parallelised by the caller, which keeps the summation order fixed.
//!
//! ```
//! use gs_core::nn::gemm::{Mat, MatMut, Write, gemm};
//!
//! let (a, b, mut y) = ([1.0, 2.0, 3.0, 4.0], [5.0, 6.0], [100.0; 2]);
//! gemm(MatMut::new(&mut y, 2, 1), Mat::new(&a, 2, 2), Mat::new(&b, 2, 1), Write::Add);
//! assert_eq!(y, [117.0, 139.0]); // [[1, 2], [3, 4]] [5, 6]ᵀ = [17, 39]ᵀ
//! ```

use crate::Rng;
use crate::speed::{BenchRow, median_seconds};
use ::gemm::Parallelism;
use rayon::prelude::*;

/// Side of the square matrices of [`roof`].
const ROOF_SIDE: usize = 1024;
const ROOF_RUNS: usize = 15;

/// A read-only matrix view: element `(r, c)` is `data[r · row_stride + c · col_stride]`.
#[derive(Clone, Copy, Debug)]
pub struct Mat<'a> {
    data: &'a [f32],
    rows: usize,
    cols: usize,
    row_stride: usize,
    col_stride: usize,
}

impl<'a> Mat<'a> {
    /// Row-major `[rows, cols]` without gaps between rows.
    pub fn new(data: &'a [f32], rows: usize, cols: usize) -> Self {
        Self::strided(data, rows, cols, cols)
    }

    /// Row-major `[rows, cols]` whose rows begin `row_stride` values apart.
    ///
    /// # Panics
    /// If the view reaches beyond `data`.
    pub fn strided(data: &'a [f32], rows: usize, cols: usize, row_stride: usize) -> Self {
        assert!(extent(rows, cols, row_stride) <= data.len(), "matrix view {rows}×{cols} reaches beyond its slice");
        Self { data, rows, cols, row_stride, col_stride: 1 }
    }

    /// The transpose, without moving data.
    pub fn transposed(self) -> Self {
        let Self { data, rows, cols, row_stride, col_stride } = self;
        Self { data, rows: cols, cols: rows, row_stride: col_stride, col_stride: row_stride }
    }
}

/// A row-major matrix view to write to: rows of `cols` values, `row_stride ≥ cols` apart.
#[derive(Debug)]
pub struct MatMut<'a> {
    data: &'a mut [f32],
    rows: usize,
    cols: usize,
    row_stride: usize,
}

impl<'a> MatMut<'a> {
    /// Row-major `[rows, cols]` without gaps between rows.
    pub fn new(data: &'a mut [f32], rows: usize, cols: usize) -> Self {
        Self::strided(data, rows, cols, cols)
    }

    /// Row-major `[rows, cols]` whose rows begin `row_stride` values apart.
    ///
    /// # Panics
    /// If rows overlap or the view reaches beyond `data`.
    pub fn strided(data: &'a mut [f32], rows: usize, cols: usize, row_stride: usize) -> Self {
        assert!(row_stride >= cols, "rows of {cols} values overlap at stride {row_stride}");
        assert!(extent(rows, cols, row_stride) <= data.len(), "matrix view {rows}×{cols} reaches beyond its slice");
        Self { data, rows, cols, row_stride }
    }
}

/// Length a slice must have to hold the view; `usize::MAX` on overflow.
fn extent(rows: usize, cols: usize, row_stride: usize) -> usize {
    if rows == 0 || cols == 0 {
        return 0;
    }
    (rows - 1).checked_mul(row_stride).and_then(|v| v.checked_add(cols)).unwrap_or(usize::MAX)
}

/// What happens to the previous content of a destination.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Write {
    /// The result replaces the content.
    Set,
    /// The result is added to the content.
    Add,
}

/// `dst = a · b` ([`Write::Set`]) or `dst += a · b` ([`Write::Add`]). With no inner dimension the product is zero.
///
/// # Panics
/// If the shapes do not fit.
#[allow(unsafe_code, reason = "the `gemm` crate takes pointers; the views hold its preconditions")]
pub fn gemm(dst: MatMut<'_>, a: Mat<'_>, b: Mat<'_>, write: Write) {
    assert!(
        a.cols == b.rows && dst.rows == a.rows && dst.cols == b.cols,
        "gemm: [{}, {}] · [{}, {}] into [{}, {}]",
        a.rows,
        a.cols,
        b.rows,
        b.cols,
        dst.rows,
        dst.cols
    );
    if dst.rows == 0 || dst.cols == 0 {
        return;
    }
    if a.cols == 0 {
        if write == Write::Set {
            dst.data.chunks_mut(dst.row_stride).take(dst.rows).for_each(|row| row[..dst.cols].fill(0.0));
        }
        return;
    }
    // SAFETY: the three views were checked against their slices when they were made (`extent`; transposing permutes the
    // same elements) and lengths of slices fit `isize`; shapes agree by the assertion above; `dst` is a unique borrow
    // whose rows do not overlap (`row_stride ≥ cols`), so it aliases neither itself nor `a` nor `b`; every element is
    // initialised.
    unsafe {
        ::gemm::gemm(
            dst.rows,
            dst.cols,
            a.cols,
            dst.data.as_mut_ptr(),
            1,
            dst.row_stride as isize,
            write == Write::Add,
            a.data.as_ptr(),
            a.col_stride as isize,
            a.row_stride as isize,
            b.data.as_ptr(),
            b.col_stride as isize,
            b.row_stride as isize,
            1.0,
            1.0,
            false,
            false,
            false,
            Parallelism::None,
        );
    }
}

/// Time of a product of 1024³, one serial call per thread of the current rayon pool: the rate that layers are held against. `work`
/// counts floating-point operations, two per multiply-add; the error is that of an entry, over the root of its terms.
///
/// ```
/// let roof = gs_core::nn::gemm::roof();
/// assert!(roof.rate() > 0.0 && roof.error.is_some_and(|e| e < 1e-5));
/// ```
pub fn roof() -> BenchRow {
    let (side, threads) = (ROOF_SIDE, rayon::current_num_threads());
    let random = |name: &str| -> Vec<f32> {
        let mut rng = Rng::new(1, name, 0, 0);
        (0..side * side).map(|_| rng.normal()).collect()
    };
    let (a, b) = (random("a"), random("b"));
    let mut out = vec![vec![0.0; side * side]; threads];
    let product = |out: &mut Vec<f32>| {
        gemm(MatMut::new(out, side, side), Mat::new(&a, side, side), Mat::new(&b, side, side), Write::Set);
    };
    let ms = 1e3 * median_seconds(ROOF_RUNS, || out.par_iter_mut().for_each(product));
    let want: f64 = a.iter().zip(b.iter().step_by(side)).take(side).map(|(a, b)| f64::from(*a) * f64::from(*b)).sum();
    let got = out.first().and_then(|out| out.first()).copied().map(f64::from);
    BenchRow {
        krate: "gs-core",
        case: "gemm".into(),
        variant: "roof 1024^3".into(),
        n: side,
        threads,
        ms,
        work: 2.0 * (side * side * side * threads) as f64,
        error: got.map(|got| (got - want).abs() / (side as f64).sqrt()),
        error_kind: "entry against f64",
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn random(n: usize, row: u64) -> Vec<f32> {
        let mut rng = Rng::new(5, "gemm", 0, row);
        (0..n).map(|_| rng.normal()).collect()
    }

    /// Every shape class the kernels treat differently, both write modes, all transpositions, and gaps left alone.
    #[test]
    fn agrees_with_three_loops() {
        for (case, &(m, n, k)) in
            [(0, 3, 2), (3, 4, 0), (1, 1, 1), (1, 7, 5), (5, 1, 9), (16, 16, 2), (17, 33, 65), (256, 3, 64)]
                .iter()
                .enumerate()
        {
            let (a, b) = (random(m * k, case as u64), random(k * n, 100 + case as u64));
            let transpose = |v: &[f32], rows: usize, cols: usize| -> Vec<f32> {
                (0..rows * cols).map(|i| v[(i % rows) * cols + i / rows]).collect()
            };
            let (at, bt) = (transpose(&a, m, k), transpose(&b, k, n));
            for write in [Write::Set, Write::Add] {
                for (a_view, b_view) in [
                    (Mat::new(&a, m, k), Mat::new(&b, k, n)),
                    (Mat::new(&at, k, m).transposed(), Mat::new(&b, k, n)),
                    (Mat::new(&a, m, k), Mat::new(&bt, n, k).transposed()),
                    (Mat::new(&at, k, m).transposed(), Mat::new(&bt, n, k).transposed()),
                ] {
                    let stride = n + 2;
                    let mut dst = vec![0.5; m * stride];
                    gemm(MatMut::strided(&mut dst, m, n, stride), a_view, b_view, write);
                    for r in 0..m {
                        for c in 0..n {
                            let want: f64 =
                                (0..k).map(|i| f64::from(a[r * k + i]) * f64::from(b[i * n + c])).sum::<f64>()
                                    + if write == Write::Add { 0.5 } else { 0.0 };
                            let got = f64::from(dst[r * stride + c]);
                            assert!((got - want).abs() < 2e-5 * (1.0 + want.abs()), "{m}×{n}×{k}: {got} {want}");
                        }
                        assert_eq!(dst[r * stride + n..][..2], [0.5; 2], "the gap between rows was written");
                    }
                }
            }
        }
    }

    #[test]
    #[should_panic(expected = "reaches beyond its slice")]
    fn a_view_beyond_its_slice_is_refused() {
        let _ = Mat::strided(&[0.0; 10], 3, 3, 4);
    }

    #[test]
    #[should_panic(expected = "gemm: [2, 3] · [2, 3]")]
    fn shapes_must_fit() {
        let v = [0.0; 6];
        gemm(MatMut::new(&mut [0.0; 6], 2, 3), Mat::new(&v, 2, 3), Mat::new(&v, 2, 3), Write::Set);
    }
}
