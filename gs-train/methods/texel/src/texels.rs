//! Values of the texels' own, the same at all timestamps: what direct mode learns, and what may stand beside GauNet.

use super::actor::{Actor, FrameError};
use super::config::Config;
use gs_core::{Param, Params, cast, sh};
use gs_texel::gaussians::{COLOR, Channels, OFFSET, OPACITY, QUAT, SCALE, warm_up};
use std::ops::Range;

/// The spherical harmonic of degree 0 that shows a display-encoded value.
pub(crate) fn coefficient(v: f32) -> f32 {
    cast::to_f32((f64::from(v) - 0.5) / sh::C0)
}

/// Rows `[K, width]` of the Gaussians that learning begins with, in these colours.
///
/// # Errors
/// If texels have no neighbours.
pub(crate) fn reference(
    config: &Config,
    actor: &Actor,
    channels: Channels,
    colors: &[[f32; 3]],
) -> Result<Vec<f32>, FrameError> {
    let t = &actor.scene.character.template;
    let points = actor.gau.interp_vec3(&t.faces, &t.vertices);
    let normals = actor.gau.interp_vec3(&t.faces, &actor.topology.normals(&t.vertices, &t.faces));
    let mut rows = warm_up::targets(channels, colors, &points, &normals, config.gaussians.decode.scale_range)?;
    let opacity = config.reference.opacity;
    for row in rows.chunks_exact_mut(channels.width()) {
        row[SCALE].iter_mut().for_each(|s| *s += config.reference.spread.ln());
        row[OPACITY] = (opacity / (1.0 - opacity)).ln();
    }
    Ok(rows)
}

/// Rows `[K, width]` in blocks by quantity, so that each has a learning rate.
pub(crate) struct TexelRows {
    width: usize,
    /// Blocks, and the channels each has.
    blocks: Vec<(Param, Range<usize>)>,
}

impl TexelRows {
    /// Blocks that begin at `rows`.
    pub(crate) fn new(channels: Channels, rows: &[f32]) -> Self {
        let width = channels.width();
        let dc = COLOR..COLOR + 3;
        let all = [
            ("log_scales", SCALE),
            ("quats", QUAT),
            ("logit_opacities", OPACITY..OPACITY + 1),
            ("offsets", OFFSET),
            ("sh_dc", dc.clone()),
            ("sh_rest", dc.end..width),
        ];
        let block = |(name, range): (&str, Range<usize>)| {
            let values = rows.chunks_exact(width).flat_map(|r| &r[range.clone()]).copied().collect();
            (Param::rows(format!("texels.{name}"), range.len(), values), range)
        };
        Self { width, blocks: all.into_iter().filter(|b| !b.1.is_empty()).map(block).collect() }
    }

    /// Adds the values to rows, colours times `light`.
    pub(crate) fn add_to(&self, rows: &mut [f32], light: [f32; 3]) {
        for (block, range) in &self.blocks {
            let factors = factors(range, light);
            for (row, values) in rows.chunks_exact_mut(self.width).zip(block.value.chunks_exact(range.len())) {
                row[range.clone()].iter_mut().zip(values).zip(&factors).for_each(|((r, v), f)| *r += f * v);
            }
        }
    }

    /// Adds what rows under `light` got to the gradients.
    pub(crate) fn backward(&mut self, d_rows: &[f32], light: [f32; 3]) {
        for (block, range) in &mut self.blocks {
            let factors = factors(range, light);
            for (grad, d) in block.grad.chunks_exact_mut(range.len()).zip(d_rows.chunks_exact(self.width)) {
                grad.iter_mut().zip(&d[range.clone()]).zip(&factors).for_each(|((g, d), f)| *g += f * d);
            }
        }
    }
}

/// What a light multiplies each of some channels by: colours by its own, others by 1.
fn factors(channels: &Range<usize>, light: [f32; 3]) -> Vec<f32> {
    channels.clone().map(|c| c.checked_sub(COLOR).map_or(1.0, |i| light[i % 3])).collect()
}

impl Params for TexelRows {
    fn visit(&self, f: &mut dyn FnMut(&Param)) {
        self.blocks.iter().for_each(|b| f(&b.0));
    }

    fn visit_mut(&mut self, f: &mut dyn FnMut(&mut Param)) {
        self.blocks.iter_mut().for_each(|b| f(&mut b.0));
    }
}
