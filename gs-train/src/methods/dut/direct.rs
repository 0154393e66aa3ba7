//! Texel Gaussians without a network: every texel has values of its own, the same at all moments; only colours may follow
//! what the cameras see.
//!
//! ```text
//! h_dc(t) = b + a ∘ (T(t) − ½)/C0        T: the moment's texture where seen, else its mean over the first frames
//! ```

use super::actor::{Actor, FrameError, Seen};
use super::config::{Config, DirectColor};
use gs_core::{Param, Params, sh};
use gs_texel::gaussians::{COLOR, Channels, OFFSET, OPACITY, QUAT, SCALE, warm_up};
use gs_texel::inpaint::{Unseen, inpaint};
use std::ops::Range;

/// The mean texture is that of so many frames, spread over the recording.
const FRAMES: usize = 8;

/// The texels' values and what they are laid over.
pub struct Direct {
    channels: Channels,
    /// Blocks, and the channels each has.
    blocks: Vec<(Param, Range<usize>)>,
    /// `a`, if colours follow the texture.
    gain: Option<Param>,
    /// `(T̄ − ½)/C0`, three per texel.
    mean: Vec<[f32; 3]>,
}

/// The coefficient of a display-encoded value.
fn coefficient(v: f32) -> f32 {
    ((f64::from(v) - 0.5) / sh::C0) as f32
}

impl Direct {
    /// Gaussians as large as their texels, of the mean colour that the cameras see.
    ///
    /// # Errors
    /// If the first frames cannot be prepared.
    pub fn new(config: &Config, actor: &Actor, channels: Channels) -> Result<Self, FrameError> {
        let colors = mean_texture(actor)?;
        let t = &actor.scene.character.template;
        let points = actor.gau.interp_vec3(&t.faces, &t.vertices);
        let normals = actor.topology.normals(&t.vertices, &t.faces);
        let normals = actor.gau.interp_vec3(&t.faces, &normals);
        let mut rows = warm_up::targets(channels, &colors, &points, &normals, config.gaussians.decode.scale_range)?;
        let opacity = config.direct.opacity;
        let follows = config.direct.color == DirectColor::Texture;
        for row in rows.chunks_exact_mut(channels.width()) {
            row[SCALE].iter_mut().for_each(|s| *s += config.direct.spread.ln());
            row[OPACITY] = (opacity / (1.0 - opacity)).ln();
            if follows {
                row[COLOR..COLOR + 3].fill(0.0);
            }
        }
        let dc = COLOR..COLOR + 3;
        let all = [
            ("log_scales", SCALE),
            ("quats", QUAT),
            ("logit_opacities", OPACITY..OPACITY + 1),
            ("offsets", OFFSET),
            ("sh_dc", dc.clone()),
            ("sh_rest", dc.end..channels.width()),
        ];
        let block = |(name, range): (&str, Range<usize>)| {
            let values = rows.chunks_exact(channels.width()).flat_map(|r| &r[range.clone()]).copied().collect();
            (Param::rows(format!("texels.{name}"), range.len(), values), range)
        };
        let blocks = all.into_iter().filter(|b| !b.1.is_empty()).map(block).collect();
        let gain = follows.then(|| Param::rows("texels.gain", 3, vec![1.0; 3 * colors.len()]));
        Ok(Self { channels, blocks, gain, mean: colors.iter().map(|c| c.map(coefficient)).collect() })
    }

    /// Rows `[K, width]` at a moment that shows `seen`.
    pub fn rows(&self, seen: &Seen, rows: &mut Vec<f32>) {
        let width = self.channels.width();
        rows.clear();
        rows.resize(self.mean.len() * width, 0.0);
        for (block, range) in &self.blocks {
            for (row, values) in rows.chunks_exact_mut(width).zip(block.value.chunks_exact(range.len())) {
                row[range.clone()].copy_from_slice(values);
            }
        }
        let Some(gain) = &self.gain else { return };
        for (k, (row, a)) in rows.chunks_exact_mut(width).zip(gain.value.chunks_exact(3)).enumerate() {
            let texture = self.texture(seen, k);
            (0..3).for_each(|i| row[COLOR + i] += a[i] * texture[i]);
        }
    }

    /// Adds to the gradients what rows of the same moment got.
    pub fn backward(&mut self, seen: &Seen, d_rows: &[f32]) {
        let width = self.channels.width();
        for (block, range) in &mut self.blocks {
            for (grad, d) in block.grad.chunks_exact_mut(range.len()).zip(d_rows.chunks_exact(width)) {
                grad.iter_mut().zip(&d[range.clone()]).for_each(|(g, d)| *g += d);
            }
        }
        let Some(mut gain) = self.gain.take() else { return };
        for (k, (grad, d)) in gain.grad.chunks_exact_mut(3).zip(d_rows.chunks_exact(width)).enumerate() {
            let texture = self.texture(seen, k);
            (0..3).for_each(|i| grad[i] += d[COLOR + i] * texture[i]);
        }
        self.gain = Some(gain);
    }

    fn texture(&self, seen: &Seen, k: usize) -> [f32; 3] {
        if seen.views[k] > 0.0 { seen.colors[k].map(coefficient) } else { self.mean[k] }
    }
}

/// The mean of the first textures where they are seen, in-painted elsewhere.
fn mean_texture(actor: &Actor) -> Result<Vec<[f32; 3]>, FrameError> {
    let texels = actor.gau.len();
    let (mut sums, mut counts) = (vec![[0.0f32; 3]; texels], vec![0.0f32; texels]);
    let step = actor.scene.frames.len().div_ceil(FRAMES).max(1);
    for frame in actor.scene.frames.iter().step_by(step) {
        let seen = actor.resized(&actor.first(frame)?.seen, &actor.gau);
        for (k, (color, views)) in seen.colors.iter().zip(&seen.views).enumerate() {
            if *views > 0.0 {
                sums[k].iter_mut().zip(color).for_each(|(s, c)| *s += c);
                counts[k] += 1.0;
            }
        }
    }
    let mut colors: Vec<[f32; 3]> = sums.iter().zip(&counts).map(|(s, n)| s.map(|v| v / n.max(1.0))).collect();
    let known: Vec<bool> = counts.iter().map(|n| *n > 0.0).collect();
    inpaint(&actor.gau, &mut colors, &known, Unseen::Nearest)?;
    Ok(colors)
}

impl Params for Direct {
    fn visit(&self, f: &mut dyn FnMut(&Param)) {
        self.blocks.iter().for_each(|b| f(&b.0));
        self.gain.iter().for_each(f);
    }

    fn visit_mut(&mut self, f: &mut dyn FnMut(&mut Param)) {
        self.blocks.iter_mut().for_each(|b| f(&mut b.0));
        self.gain.iter_mut().for_each(f);
    }
}
