//! Fourier transforms of lines of any length: plans of [`rustfft`] and [`realfft`] as trait objects.
//!
//! Both crates are generic, so whoever plans a transform compiles all of them, for every instruction set, which takes most of a
//! minute. Here they are compiled once, for `f32` and `f64`; what stands on this crate uses the plans.
//!
//! Transforms are not normalised: forward `F(k) = Σ f(x) e^{−2πi k x/n}`, inverse with the other sign. Of a real line the
//! frequencies `0 … ⌊n/2⌋` are kept.
//!
//! ```
//! let fft = gs_fft::real_forward_f64(4);
//! let (mut line, mut spectrum) = (vec![1.0, 0.0, -1.0, 0.0], fft.make_output_vec());
//! fft.process(&mut line, &mut spectrum)?; // one period
//! assert_eq!(spectrum.iter().map(|v| v.re).collect::<Vec<_>>(), [0.0, 2.0, 0.0]);
//! # Ok::<(), realfft::FftError>(())
//! ```

use std::sync::Arc;

pub use realfft::{ComplexToReal, RealToComplex};
pub use rustfft::{Fft, num_complex};

use realfft::RealFftPlanner;
use rustfft::FftPlanner;

/// The transform of a real line of `length ≥ 1` values.
pub fn real_forward(length: usize) -> Arc<dyn RealToComplex<f32>> {
    RealFftPlanner::new().plan_fft_forward(length)
}

/// The inverse of [`real_forward`], `length` times the line.
pub fn real_inverse(length: usize) -> Arc<dyn ComplexToReal<f32>> {
    RealFftPlanner::new().plan_fft_inverse(length)
}

/// The transform of a complex line of `length ≥ 1` values.
pub fn complex_forward(length: usize) -> Arc<dyn Fft<f32>> {
    FftPlanner::new().plan_fft_forward(length)
}

/// The inverse of [`complex_forward`], `length` times the line.
pub fn complex_inverse(length: usize) -> Arc<dyn Fft<f32>> {
    FftPlanner::new().plan_fft_inverse(length)
}

/// [`real_forward`] in `f64`.
pub fn real_forward_f64(length: usize) -> Arc<dyn RealToComplex<f64>> {
    RealFftPlanner::new().plan_fft_forward(length)
}

/// [`complex_forward`] in `f64`.
pub fn complex_forward_f64(length: usize) -> Arc<dyn Fft<f64>> {
    FftPlanner::new().plan_fft_forward(length)
}

/// [`complex_inverse`] in `f64`.
pub fn complex_inverse_f64(length: usize) -> Arc<dyn Fft<f64>> {
    FftPlanner::new().plan_fft_inverse(length)
}
