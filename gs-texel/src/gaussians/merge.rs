//! Fewer, larger Gaussians where neighbouring texels say the same: a quadtree over the texture.
//!
//! A block of `2^l × 2^l` texels becomes one Gaussian if all its texels are valid and of one chart, their colours, opacities,
//! normals and offsets are alike; otherwise its quarters are tried. The one Gaussian has the block's moments and mean opacity,
//! and its two wide axes grow until it covers as much as the block did:
//! ```text
//! w_i = α_i A_i,  A = product of the two larger σ      μ = Σ w μ_i / Σ w      Σ ∝ Σ w (Σ_i + (μ_i − μ)(μ_i − μ)ᵀ) / Σ w
//! α = mean α_i      σ₁, σ₂ scaled alike until α σ₁ σ₂ = Σ w
//! ```
//! This is for drawing; nothing flows back through it. It is approximate: its error is measured in `benches/gaussians.rs`.

use super::affine::of_covariance;
use super::channels::ChannelsError;
use crate::surface::NONE;
use crate::texels::TexelTable;
use glam::{DMat3, DVec3, Vec3};
use gs_core::{Color, Kernel, Splats, rot};
use serde::{Deserialize, Serialize};

/// What counts as the same.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct MergeOptions {
    /// Range of display-encoded colour in a block, from any direction.
    pub color: f32,
    /// Range of opacity.
    pub opacity: f32,
    /// Largest angle between a texel's normal and the block's mean, degrees.
    pub normal_degrees: f32,
    /// Largest distance of an offset from the block's mean offset, as a share of the block's extent.
    pub offset: f32,
    /// How far the wide axes grow: 0 not at all, 1 until the block's coverage is kept. 0.75 is better where all is opaque.
    pub growth: f32,
    /// Blocks at the border of a chart stay as they are, lest the surface grow beyond its outline.
    pub keep_borders: bool,
    /// Blocks have at most `2^levels` texels a side; 0 merges nothing.
    pub levels: u32,
}

impl Default for MergeOptions {
    fn default() -> Self {
        Self {
            color: 2.0 / 255.0,
            opacity: 0.05,
            normal_degrees: 5.0,
            offset: 0.25,
            growth: 1.0,
            keep_borders: true,
            levels: 1,
        }
    }
}

/// What merging did.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct MergeReport {
    /// Gaussians before.
    pub before: usize,
    /// Gaussians after.
    pub after: usize,
    /// Blocks of side `2^l` that became one Gaussian, `l` from 0 (untouched).
    pub blocks: Vec<usize>,
    /// Root mean square over texels of the change of their display-encoded colour (degree 0).
    pub color_rms: f64,
}

/// The columns a block is judged by.
struct Texels<'a> {
    splats: &'a Splats,
    coeffs: &'a [f32],
    width: usize,
    table: &'a TexelTable,
    normals: &'a [Vec3],
    offsets: &'a [Vec3],
    options: &'a MergeOptions,
}

/// Merges decoded texel Gaussians; all columns have `K` rows in the order of `table.valid`. `normals` are unit, world or bind
/// pose; `offsets` the `d` of the texels, metres. Colours other than spherical harmonics are not merged.
///
/// # Errors
/// If a column has another length.
pub fn merge(
    splats: &Splats,
    table: &TexelTable,
    normals: &[Vec3],
    offsets: &[Vec3],
    options: &MergeOptions,
) -> Result<(Splats, MergeReport), ChannelsError> {
    let texels = table.len();
    for (column, got) in [("splats", splats.len()), ("normals", normals.len()), ("offsets", offsets.len())] {
        if got != texels {
            return Err(ChannelsError::Length { column, got, want: texels, texels });
        }
    }
    let Color::Sh { degree, coeffs } = &splats.color else {
        let report = MergeReport { before: texels, after: texels, blocks: vec![texels], color_rms: 0.0 };
        return Ok((splats.clone(), report));
    };
    let width = splats.color.width();
    let all = Texels { splats, coeffs, width, table, normals, offsets, options };
    let mut out = Splats { color: Color::Sh { degree: *degree, coeffs: Vec::new() }, ..Splats::default() };
    let mut report = MergeReport { before: texels, blocks: vec![0; options.levels as usize + 1], ..Default::default() };
    let side = 1usize << options.levels.min(usize::BITS - 2);
    for y in (0..table.size).step_by(side) {
        for x in (0..table.size).step_by(side) {
            all.descend([x, y], options.levels, &mut out, &mut report);
        }
    }
    report.after = out.len();
    report.color_rms = (report.color_rms / (3 * texels.max(1)) as f64).sqrt();
    out.kernel = Kernel::Gaussian;
    Ok((out, report))
}

impl Texels<'_> {
    /// Emits one Gaussian for the block of side `2^level` at `(x, y)`, or those of its quarters.
    fn descend(&self, [x, y]: [usize; 2], level: u32, out: &mut Splats, report: &mut MergeReport) {
        let side = 1usize << level;
        let rows: Vec<usize> = (y..(y + side).min(self.table.size))
            .flat_map(|v| (x..(x + side).min(self.table.size)).map(move |u| [u, v]))
            .map(|[u, v]| self.table.row[v * self.table.size + u])
            .filter(|row| *row != NONE)
            .map(|row| row as usize)
            .collect();
        if rows.is_empty() {
            return;
        }
        let whole = level > 0 && rows.len() == side * side && (!self.options.keep_borders || self.inside([x, y], side));
        let merged = (whole && self.alike(&rows)).then(|| self.one(&rows)).flatten();
        if let Some(one) = merged {
            report.blocks[level as usize] += 1;
            let mean = &one.color[..3];
            for row in rows {
                let change = |(a, b): (&f32, &f32)| (f64::from(a - b) * gs_core::sh::C0).powi(2);
                report.color_rms += self.color(row).iter().zip(mean).map(change).sum::<f64>();
            }
            one.push(out);
        } else if level == 0 {
            report.blocks[0] += 1;
            self.copy(rows[0], out);
        } else {
            let half = side / 2;
            for at in [[x, y], [x + half, y], [x, y + half], [x + half, y + half]] {
                self.descend(at, level - 1, out, report);
            }
        }
    }

    /// Whether all texels around a block are valid and of its chart.
    fn inside(&self, [x, y]: [usize; 2], side: usize) -> bool {
        let size = self.table.size;
        let Some((left, top)) = x.checked_sub(1).zip(y.checked_sub(1)) else { return false };
        let chart = |u: usize, v: usize| {
            let row = self.table.row[v * size + u];
            (row != NONE).then(|| self.table.chart[row as usize])
        };
        let (right, bottom) = (x + side, y + side);
        let here = chart(x, y);
        right < size
            && bottom < size
            && (left..=right).all(|u| chart(u, top) == here && chart(u, bottom) == here)
            && (top..=bottom).all(|v| chart(left, v) == here && chart(right, v) == here)
    }

    fn color(&self, row: usize) -> &[f32] {
        &self.coeffs[row * self.width..][..self.width]
    }

    fn copy(&self, row: usize, out: &mut Splats) {
        let s = self.splats;
        let copied = Merged {
            mean: s.means[row],
            quat: s.quats[row],
            scale: s.scales[row],
            opacity: s.opacities[row],
            color: self.color(row).to_vec(),
        };
        copied.push(out);
    }

    /// Whether texels may be drawn as one.
    fn alike(&self, rows: &[usize]) -> bool {
        let o = self.options;
        let spread = |value: &dyn Fn(usize) -> f32| {
            let ends = |(low, high): (f32, f32), v: f32| (low.min(v), high.max(v));
            let (low, high) = rows.iter().map(|r| value(*r)).fold((f32::INFINITY, f32::NEG_INFINITY), ends);
            high - low
        };
        // Coefficient by coefficient, each by the largest its basis function can be.
        let channel = |c: usize| {
            let terms = (c..self.width).step_by(3).enumerate();
            terms.map(|(k, at)| largest_basis(k) * spread(&|r| self.color(r)[at])).sum::<f32>()
        };
        let mean = |column: &[Vec3]| rows.iter().map(|r| column[*r]).sum::<Vec3>() / rows.len() as f32;
        let normal = mean(self.normals).normalize_or_zero();
        let cosine = o.normal_degrees.to_radians().cos();
        let (centre, offset) = (mean(&self.splats.means), mean(self.offsets));
        let extent = rows.iter().map(|r| self.splats.means[*r].distance(centre)).fold(0.0, f32::max);
        let far = rows.iter().map(|r| self.offsets[*r].distance(offset)).fold(0.0, f32::max);
        rows.iter().all(|r| self.table.chart[*r] == self.table.chart[rows[0]])
            && spread(&|r| self.splats.opacities[r]) <= o.opacity
            && (0..3).all(|c| channel(c) <= o.color)
            && rows.iter().all(|r| self.normals[*r].dot(normal) >= cosine)
            && far <= o.offset * extent
    }

    /// The Gaussian of a block; none if it has no weight or no finite shape.
    fn one(&self, rows: &[usize]) -> Option<Merged> {
        let s = self.splats;
        let weight = |r: usize| f64::from(s.opacities[r]) * wide_area(s.scales[r].as_dvec3().to_array());
        let total: f64 = rows.iter().map(|r| weight(*r)).sum();
        if total <= 0.0 || !total.is_finite() {
            return None;
        }
        let mean = rows.iter().map(|r| s.means[*r].as_dvec3() * weight(*r)).sum::<DVec3>() / total;
        let mut sigma = DMat3::ZERO;
        let mut color = vec![0.0f64; self.width];
        for &r in rows {
            let share = weight(r) / total;
            let turn = rot::matrix(rot::normalise(s.quats[r].map(f64::from)).wxyz);
            let m = DMat3::from_cols_array_2d(&turn).transpose() * DMat3::from_diagonal(s.scales[r].as_dvec3());
            let away = s.means[r].as_dvec3() - mean;
            sigma += (m * m.transpose() + DMat3::from_cols(away * away.x, away * away.y, away * away.z)) * share;
            color.iter_mut().zip(self.color(r)).for_each(|(c, v)| *c += share * f64::from(*v));
        }
        let (quat, mut scale) = of_covariance(&sigma)?;
        let opacity = rows.iter().map(|r| f64::from(s.opacities[*r])).sum::<f64>() / rows.len() as f64;
        let grow = (total / (opacity * wide_area(scale))).powf(0.5 * f64::from(self.options.growth));
        let thinnest = (0..3).min_by(|a, b| scale[*a].total_cmp(&scale[*b]))?;
        (0..3).filter(|k| *k != thinnest).for_each(|k| scale[k] *= grow);
        Some(Merged {
            mean: mean.as_vec3(),
            quat: quat.map(|v| v as f32),
            scale: DVec3::from_array(scale).as_vec3(),
            opacity: opacity as f32,
            color: color.into_iter().map(|v| v as f32).collect(),
        })
    }
}

/// The largest absolute value of basis function `k` of the spherical harmonics on the sphere, or a bound on it.
fn largest_basis(k: usize) -> f32 {
    match k {
        0 => 0.283,
        1..=3 => 0.489,
        _ => 0.75,
    }
}

/// The product of the two larger of three lengths.
fn wide_area(lengths: [f64; 3]) -> f64 {
    let [a, b, c] = lengths.map(f64::abs);
    (a * b).max(b * c).max(a * c)
}

struct Merged {
    mean: Vec3,
    quat: [f32; 4],
    scale: Vec3,
    opacity: f32,
    color: Vec<f32>,
}

impl Merged {
    fn push(self, out: &mut Splats) {
        out.means.push(self.mean);
        out.quats.push(self.quat);
        out.scales.push(self.scale);
        out.opacities.push(self.opacity);
        if let Color::Sh { coeffs, .. } = &mut out.color {
            coeffs.extend(self.color);
        }
    }
}
