//! Decoding of all texels, and its backward.

use super::base::TexelBase;
use super::channels::{COLOR, Channels, ChannelsError, OFFSET};
use super::row::{self, Base, Gaussian};
use glam::Vec3;
use gs_core::{Color, Kernel, Splats, SplatsGrad, sh};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// Texels of one parallel task; sums of tasks are added in order.
const CHUNK: usize = 1024;

/// How skinning transforms the covariance of a Gaussian.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Covariance {
    /// Rotated by the nearest rotation to the blended matrix; standard deviations are kept.
    #[default]
    Polar,
    /// Transformed by the matrix itself: `R Σ Rᵀ` shrinks and shears with the surface.
    Affine,
    /// Rotated by the matrix-to-quaternion conversion of the blended matrix, which is not of unit length where joints bend, and
    /// is not normalised. DUT's published code; for comparison.
    Raw,
}

/// How [`decode`] turns and moves the Gaussians of texels.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct DecodeOptions {
    /// How skinning transforms covariances. Default: [`Covariance::Polar`].
    pub covariance: Covariance,
    /// Degree of spherical harmonics in the splats, at most that of the channels. Default: 1; the published method uses 0.
    pub sh_active: u8,
    /// Smallest and largest standard deviation before κ, metres. Log-scales outside have no gradient. Default: 1e-5 to 0.5.
    pub scale_range: [f64; 2],
}

impl Default for DecodeOptions {
    fn default() -> Self {
        Self { covariance: Covariance::Polar, sh_active: 1, scale_range: [1e-5, 0.5] }
    }
}

impl DecodeOptions {
    fn range(&self) -> [f64; 2] {
        self.scale_range.map(f64::ln)
    }

    /// SH values per splat.
    fn color_width(&self, channels: Channels) -> usize {
        3 * sh::coeffs(self.sh_active.min(channels.degree()))
    }
}

impl TexelBase {
    /// The base of texel `k`, for the functions of [`row`].
    pub fn row(&self, k: usize) -> Base<f32> {
        let t = &self.transforms[k];
        Base {
            point: self.points[k].to_array(),
            linear: t.matrix3.transpose().to_cols_array_2d(),
            translation: t.translation.to_array(),
            rotation: self.rotations[k],
            kappa: self.kappas[k],
        }
    }
}

/// The `K` posed Gaussians of rows `[K, width]` (equations in [`crate::gaussians`]).
///
/// # Errors
/// If rows and base have different lengths.
pub fn decode(
    rows: &[f32],
    channels: Channels,
    base: &TexelBase,
    options: &DecodeOptions,
) -> Result<Splats, ChannelsError> {
    let (width, colors) = (channels.width(), options.color_width(channels));
    channels.length("rows", rows.len(), width, base.len())?;
    let range = options.range();
    let one = |(k, row): (usize, &[f32])| row::decode(row, &base.row(k), options.covariance, range);
    let made: Vec<Gaussian<f32>> = rows.par_chunks_exact(width).enumerate().with_min_len(CHUNK).map(one).collect();
    let coeffs = rows.chunks_exact(width).flat_map(|row| &row[COLOR..COLOR + colors]).copied().collect();
    let degree = options.sh_active.min(channels.degree());
    Ok(Splats {
        means: made.iter().map(|g| Vec3::from_array(g.mean)).collect(),
        quats: made.iter().map(|g| g.quat).collect(),
        scales: made.iter().map(|g| Vec3::from_array(g.scale)).collect(),
        opacities: made.iter().map(|g| g.opacity).collect(),
        color: Color::Sh { degree, coeffs },
        kernel: Kernel::Gaussian,
    })
}

/// Backward of [`decode`]: adds to `grad`, `[K, width]`, and to `d_points`, `dL/dc` with `K` rows, if given.
///
/// # Errors
/// If a column has another length.
pub fn decode_backward(
    rows: &[f32],
    channels: Channels,
    base: &TexelBase,
    options: &DecodeOptions,
    d: &SplatsGrad,
    grad: &mut [f32],
    d_points: Option<&mut [Vec3]>,
) -> Result<(), ChannelsError> {
    let (width, colors, n) = (channels.width(), options.color_width(channels), base.len());
    channels.length("rows", rows.len(), width, n)?;
    channels.length("gradient", grad.len(), width, n)?;
    channels.length("splats' gradient", d.means.len(), 1, n)?;
    channels.length("splats' colour gradient", d.color.len(), colors, n)?;
    let range = options.range();
    let one = |(k, (row, grad)): (usize, (&[f32], &mut [f32]))| {
        let cotangent = Gaussian {
            mean: d.means[k].to_array(),
            quat: d.quats[k],
            scale: d.scales[k].to_array(),
            opacity: d.opacities[k],
        };
        let moved = row::backward(row, &base.row(k), options.covariance, range, &cotangent, grad);
        grad[COLOR..].iter_mut().zip(&d.color[k * colors..][..colors]).for_each(|(g, d)| *g += d);
        Vec3::from_array(moved)
    };
    let pairs = rows.par_chunks_exact(width).zip(grad.par_chunks_exact_mut(width)).enumerate().with_min_len(CHUNK);
    match d_points {
        None => pairs.for_each(|pair| {
            one(pair);
        }),
        Some(d_points) => {
            channels.length("points' gradient", d_points.len(), 1, n)?;
            pairs.zip(d_points).for_each(|(pair, d_point)| *d_point += one(pair));
        }
    }
    Ok(())
}

/// `λ mean(d²)` over the three axes of all texels; its gradient `2λ d/(3K)` is added to `grad`, `[K, width]`.
pub fn offset_penalty(rows: &[f32], channels: Channels, lambda: f32, grad: &mut [f32]) -> f64 {
    let width = channels.width();
    let count = (3 * (rows.len() / width)).max(1) as f64;
    let slope = (2.0 * f64::from(lambda) / count) as f32;
    let chunk = |(rows, grad): (&[f32], &mut [f32])| {
        let mut sum = 0.0f64;
        for (row, grad) in rows.chunks_exact(width).zip(grad.chunks_exact_mut(width)) {
            for (g, d) in grad[OFFSET].iter_mut().zip(&row[OFFSET]) {
                *g += slope * d;
                sum += f64::from(*d) * f64::from(*d);
            }
        }
        sum
    };
    let chunks = rows.par_chunks(CHUNK * width).zip(grad.par_chunks_mut(CHUNK * width));
    let sums: Vec<f64> = chunks.map(chunk).collect();
    f64::from(lambda) * sums.iter().sum::<f64>() / count
}
