//! Warm-up of texel Gaussians: reference values of every channel, and the loss against them.
//!
//! ```text
//! dc = (rgb − ½)/Y₀    rest = 0    ŝ = ln √max(d̄², mean d̄²)    r rotates +x onto the normal    α̂ = 0    d = 0
//! L = Σ_groups w mean over texels and channels of (raw − reference)²
//! ```
//! `d̄²` is the mean squared distance of a texel's point in the bind pose to its three nearest neighbours; `w` is 0.1 for the opacity and 1
//! for all others (DUT, published code).

use super::channels::{COLOR, Channels, ChannelsError, OFFSET, OPACITY, QUAT, SCALE};
use glam::Vec3;
use gs_core::sh;
use kiddo::{ImmutableKdTree, SquaredEuclidean};
use rayon::prelude::*;
use std::num::NonZero;
use std::ops::Range;

/// Texels of one parallel task; sums of tasks are added in order.
const CHUNK: usize = 1024;
/// Neighbours that the initial scale is computed from.
const NEIGHBOURS: usize = 3;
/// Weight of the opacity channel.
const OPACITY_WEIGHT: f64 = 0.1;

/// Why [`targets`] refuses its inputs.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum WarmUpError {
    /// A column has another length.
    #[error(transparent)]
    Columns(#[from] ChannelsError),
    /// A colour, point or normal is not finite.
    #[error("row {row} of `{column}` is not finite; check the template and the texture of this frame")]
    NotFinite {
        /// Name of the column.
        column: &'static str,
        /// First row that is not finite.
        row: usize,
    },
    /// The k-d tree cannot be built: too many texels at one point.
    #[error("the texels' points cannot be indexed: {0}; is the template without extent?")]
    Tree(String),
}

/// Reference rows `[K, width]` of texels, from their display-encoded colours, and their points (metres) and unit normals in
/// the bind pose. `scale_range` bounds the standard deviations, as [`super::DecodeOptions::scale_range`].
///
/// # Errors
/// If columns differ in length, a value is not finite, or too many texels lie at one point.
pub fn targets(
    channels: Channels,
    colors: &[[f32; 3]],
    points: &[Vec3],
    normals: &[Vec3],
    scale_range: [f64; 2],
) -> Result<Vec<f32>, WarmUpError> {
    let texels = points.len();
    channels.length("colours", colors.len(), 1, texels)?;
    channels.length("normals", normals.len(), 1, texels)?;
    let finite = |column, row: Option<usize>| row.map_or(Ok(()), |row| Err(WarmUpError::NotFinite { column, row }));
    finite("colours", colors.iter().position(|c| !c.iter().all(|v| v.is_finite())))?;
    finite("points", points.iter().position(|p| !p.is_finite()))?;
    finite("normals", normals.iter().position(|n| !n.is_finite()))?;
    let squares = squared_spacings(points)?;
    let mean = squares.iter().sum::<f64>() / texels.max(1) as f64;
    let mut rows = vec![0.0; texels * channels.width()];
    for (k, row) in rows.chunks_exact_mut(channels.width()).enumerate() {
        let sigma = squares[k].max(mean).sqrt().max(scale_range[0]).min(scale_range[1]);
        row[SCALE].fill(sigma.ln() as f32);
        row[QUAT].copy_from_slice(&from_x_to(normals[k]));
        for (c, rgb) in row[COLOR..COLOR + 3].iter_mut().zip(colors[k]) {
            *c = ((f64::from(rgb) - 0.5) / sh::C0) as f32;
        }
    }
    Ok(rows)
}

/// Mean squared distance of each point to its three nearest, square metres; 0 for a lone point.
fn squared_spacings(points: &[Vec3]) -> Result<Vec<f64>, WarmUpError> {
    let near = points.len().saturating_sub(1).min(NEIGHBOURS);
    let Some(wanted) = NonZero::new(near + 1).filter(|_| near > 0) else { return Ok(vec![0.0; points.len()]) };
    let flat: Vec<[f32; 3]> = points.iter().map(|p| p.to_array()).collect();
    let tree: ImmutableKdTree<f32, 3> =
        ImmutableKdTree::new_from_slice(&flat).map_err(|e| WarmUpError::Tree(format!("{e:?}")))?;
    let mean = |point: &[f32; 3]| {
        // The nearest of all is the point itself.
        let found = tree.query(point).nearest_n::<SquaredEuclidean<f32>>(wanted).execute();
        found.iter().map(|f| f64::from(f.distance)).sum::<f64>() / near as f64
    };
    Ok(flat.par_iter().with_min_len(CHUNK).map(mean).collect())
}

/// The quaternion `(w, x, y, z)` of the shortest rotation from +x to a unit vector; 180 degrees about z for −x.
fn from_x_to(n: Vec3) -> [f32; 4] {
    let [x, y, z] = n.as_dvec3().normalize_or(glam::DVec3::X).to_array();
    // cos and sin of half the angle: w = √((1 + x)/2), axis (0, −z, y).
    let w = (0.5 * (1.0 + x)).max(0.0).sqrt();
    if w < 1e-6 { [0.0, 0.0, 0.0, 1.0] } else { [w, 0.0, -0.5 * z / w, 0.5 * y / w].map(|v| v as f32) }
}

/// The warm-up loss of raw rows against reference rows, both `[K, width]`; adds its gradient to `grad`.
///
/// # Errors
/// If a column has another length.
pub fn loss(rows: &[f32], targets: &[f32], channels: Channels, grad: &mut [f32]) -> Result<f64, ChannelsError> {
    let width = channels.width();
    let texels = rows.len() / width;
    for (column, got) in [("rows", rows.len()), ("targets", targets.len()), ("gradient", grad.len())] {
        channels.length(column, got, width, texels)?;
    }
    let groups: [(Range<usize>, f64); 6] = [
        (SCALE, 1.0),
        (QUAT, 1.0),
        (OPACITY..OPACITY + 1, OPACITY_WEIGHT),
        (OFFSET, 1.0),
        (COLOR..COLOR + 3, 1.0),
        (COLOR + 3..width, 1.0),
    ];
    let mut weights = vec![0.0f64; width];
    for (group, weight) in groups {
        let each = weight / (group.len() * texels).max(1) as f64;
        weights[group].fill(each);
    }
    let chunk = |((rows, targets), grad): ((&[f32], &[f32]), &mut [f32])| {
        let mut sum = 0.0f64;
        for ((row, target), grad) in
            rows.chunks_exact(width).zip(targets.chunks_exact(width)).zip(grad.chunks_exact_mut(width))
        {
            for (((a, b), g), w) in row.iter().zip(target).zip(grad).zip(&weights) {
                let away = f64::from(*a) - f64::from(*b);
                sum += w * away * away;
                *g += (2.0 * w * away) as f32;
            }
        }
        sum
    };
    let size = CHUNK * width;
    let chunks = rows.par_chunks(size).zip(targets.par_chunks(size)).zip(grad.par_chunks_mut(size));
    let sums: Vec<f64> = chunks.map(chunk).collect();
    Ok(sums.iter().sum())
}
