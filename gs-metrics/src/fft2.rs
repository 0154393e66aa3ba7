//! The two-dimensional discrete Fourier transform of one channel of an image, and the real part of its inverse.
//!
//! Rows are real, so only the columns `kx = 0 … ⌊W/2⌋` of the spectrum are kept: `F(−kx, −ky)` is the conjugate of
//! `F(kx, ky)`. Every row and column is transformed as a whole by one task, so the result does not depend on the number of threads.

use std::sync::Arc;

use gs_core::Image;
use gs_fft::num_complex::Complex32;
use gs_fft::{ComplexToReal, Fft, RealToComplex};
use rayon::prelude::*;

/// Rows or columns of one parallel task: eight complex values fill a cache line while a matrix is transposed.
const BLOCK: usize = 8;

/// Plans and buffers for images of one size.
pub(crate) struct Fft2 {
    width: usize,
    height: usize,
    row: Arc<dyn RealToComplex<f32>>,
    row_inverse: Arc<dyn ComplexToReal<f32>>,
    column: Arc<dyn Fft<f32>>,
    column_inverse: Arc<dyn Fft<f32>>,
    /// Spectra of the rows, `[H, W/2 + 1]`.
    rows: Vec<Complex32>,
    /// The spectrum, `[W/2 + 1, H]`.
    columns: Vec<Complex32>,
}

impl std::fmt::Debug for Fft2 {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "Fft2({}x{})", self.width, self.height)
    }
}

impl Fft2 {
    /// Plans for images of `width` times `height` pixels, both at least 1, of any factors.
    pub(crate) fn new(width: usize, height: usize) -> Self {
        let zeros = vec![Complex32::default(); height * (width / 2 + 1)];
        Self {
            width,
            height,
            row: gs_fft::real_forward(width),
            row_inverse: gs_fft::real_inverse(width),
            column: gs_fft::complex_forward(height),
            column_inverse: gs_fft::complex_inverse(height),
            columns: zeros.clone(),
            rows: zeros,
        }
    }

    /// Whether the plans are for images of this size.
    pub(crate) fn fits(&self, image: &Image) -> bool {
        (self.width, self.height) == (image.width, image.height)
    }

    /// Number of columns of the half spectrum, `⌊W/2⌋ + 1`.
    pub(crate) fn half(&self) -> usize {
        self.width / 2 + 1
    }

    /// How often a column of the half spectrum occurs in the whole one: twice, except for `kx = 0` and, at even widths,
    /// `kx = W/2`.
    pub(crate) fn multiplicity(&self, kx: usize) -> f64 {
        if kx == 0 || 2 * kx == self.width { 1.0 } else { 2.0 }
    }

    /// The spectrum `Σ f e^{−2πi(kx x/W + ky y/H)}` of a channel. `visit` is called for every column with `kx`, the column `[H]`
    /// and its row of `extra`, `[W/2 + 1, H]`; its results are returned in order. With `invert`, the columns as `visit` left
    /// them are transformed back, for [`Fft2::real_inverse`].
    pub(crate) fn spectrum<T: Send, R: Send>(
        &mut self,
        image: &Image,
        channel: usize,
        extra: &mut [T],
        invert: bool,
        visit: impl Fn(usize, &mut [Complex32], &mut [T]) -> R + Sync,
    ) -> Vec<R> {
        let (width, height, half) = (self.width, self.height, self.half());
        let row = &self.row;
        self.rows.par_chunks_mut(half * BLOCK).enumerate().for_each_init(
            || (row.make_input_vec(), row.make_scratch_vec()),
            |(line, scratch), (block, spectra)| {
                for (k, spectrum) in spectra.chunks_exact_mut(half).enumerate() {
                    let pixels = &image.data[(block * BLOCK + k) * width * image.channels..];
                    let values = pixels.iter().skip(channel).step_by(image.channels);
                    line.iter_mut().zip(values).for_each(|(l, v)| *l = *v);
                    row.process_with_scratch(line, spectrum, scratch).expect("lengths are those of the plan");
                }
            },
        );
        let (rows, forward, inverse) = (&self.rows, &self.column, &self.column_inverse);
        let scratch =
            || vec![Complex32::default(); forward.get_inplace_scratch_len().max(inverse.get_inplace_scratch_len())];
        let blocks = self.columns.par_chunks_mut(height * BLOCK).zip(extra.par_chunks_mut(height * BLOCK)).enumerate();
        let results = blocks.map_init(scratch, |scratch, (block, (columns, extra))| {
            transpose(rows, half, block * BLOCK, columns, height);
            let pairs = columns.chunks_exact_mut(height).zip(extra.chunks_exact_mut(height)).enumerate();
            let transform = |(k, (column, extra)): (usize, (&mut [Complex32], &mut [T]))| {
                forward.process_with_scratch(column, scratch);
                let result = visit(block * BLOCK + k, column, extra);
                if invert {
                    inverse.process_with_scratch(column, scratch);
                }
                result
            };
            pairs.map(transform).collect::<Vec<R>>()
        });
        results.collect::<Vec<_>>().into_iter().flatten().collect()
    }

    /// `scale` times the real part of the unnormalised inverse transform of the columns left by `visit`, into a channel of `out`.
    pub(crate) fn real_inverse(&mut self, scale: f32, channel: usize, out: &mut Image) {
        let (width, height, half, channels) = (self.width, self.height, self.half(), out.channels);
        let (columns, row) = (&self.columns, &self.row_inverse);
        let buffers = || {
            let line = row.make_output_vec();
            (vec![Complex32::default(); BLOCK * half], line, row.make_scratch_vec())
        };
        out.data.par_chunks_mut(width * channels * BLOCK).enumerate().for_each_init(
            buffers,
            |(spectra, line, scratch), (block, out)| {
                let spectra = &mut spectra[..out.len() / (width * channels) * half];
                transpose(columns, height, block * BLOCK, spectra, half);
                for (spectrum, out) in spectra.chunks_exact_mut(half).zip(out.chunks_exact_mut(width * channels)) {
                    // Both bins of a real image are real.
                    spectrum[0].im = 0.0;
                    if width.is_multiple_of(2) {
                        spectrum[half - 1].im = 0.0;
                    }
                    row.process_with_scratch(spectrum, line, scratch).expect("lengths are those of the plan");
                    out.iter_mut().skip(channel).step_by(channels).zip(&*line).for_each(|(o, v)| *o = scale * v);
                }
            },
        );
    }
}

/// Columns `first …` of a matrix with rows of `width` values, as rows of `height` values of `out`.
fn transpose(matrix: &[Complex32], width: usize, first: usize, out: &mut [Complex32], height: usize) {
    let columns = out.len() / height;
    for (y, row) in matrix.chunks_exact(width).enumerate() {
        for (k, v) in row[first..first + columns].iter().enumerate() {
            out[k * height + y] = *v;
        }
    }
}
