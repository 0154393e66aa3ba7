//! Texel Gaussians without a network: every texel has values of its own, the same at all timestamps; only colours may follow
//! what the cameras see.
//!
//! ```text
//! h_dc(t) = b + a ∘ (T(t) − ½)/C0        T: the timestamp's texture where seen, else its mean over the recording
//! ```
//! Under another light that the image has as well, these are the Gaussians of the recorded one, lit.

use super::actor::{Actor, FrameError, Second};
use super::config::{Config, DirectColor};
use super::light;
use super::mean::MeanTextures;
use super::texels::{TexelRows, coefficient, reference};
use gs_core::{Param, Params};
use gs_texel::gaussians::{COLOR, Channels};

/// The texels' values and what they are laid over.
pub(crate) struct Direct {
    width: usize,
    texels: TexelRows,
    /// `a`, if colours follow the texture.
    gain: Option<Param>,
}

impl Direct {
    /// Gaussians as large as their texels, of the mean colour that the cameras see.
    ///
    /// # Errors
    /// If texels have no neighbours.
    pub(crate) fn new(config: &Config, actor: &Actor, channels: Channels) -> Result<Self, FrameError> {
        let mut rows = reference(config, actor, channels, MeanTextures::rows(&actor.mean.gau))?;
        let follows = config.direct.color == DirectColor::Texture;
        if follows {
            rows.chunks_exact_mut(channels.width()).for_each(|row| row[COLOR..COLOR + 3].fill(0.0));
        }
        let gain = follows.then(|| Param::rows("texels.gain", 3, vec![1.0; 3 * actor.gau.len()]));
        Ok(Self { width: channels.width(), texels: TexelRows::new(channels, &rows), gain })
    }

    /// Rows `[K, width]` at a timestamp that shows `seen`.
    pub(crate) fn rows(&self, actor: &Actor, second: &Second, rows: &mut Vec<f32>) {
        rows.clear();
        rows.resize(actor.gau.len() * self.width, 0.0);
        self.texels.add_to(rows, light::NONE);
        let gains = self.gain.iter().flat_map(|gain| gain.value.chunks_exact(3));
        for (k, (row, a)) in rows.chunks_exact_mut(self.width).zip(gains).enumerate() {
            let texture = texture(actor, second, k);
            (0..3).for_each(|i| row[COLOR + i] += a[i] * texture[i]);
        }
        if second.own != light::NONE {
            rows.chunks_exact_mut(self.width).for_each(|row| light::put_on_one(&mut row[COLOR..], second.own));
        }
    }

    /// Adds to the gradients what rows of the same timestamp got.
    pub(crate) fn backward(&mut self, actor: &Actor, second: &Second, d_rows: &[f32]) {
        self.texels.backward(d_rows, second.own);
        let Some(mut gain) = self.gain.take() else { return };
        for (k, (grad, d)) in gain.grad.chunks_exact_mut(3).zip(d_rows.chunks_exact(self.width)).enumerate() {
            let texture = texture(actor, second, k);
            (0..3).for_each(|i| grad[i] += d[COLOR + i] * second.own[i] * texture[i]);
        }
        self.gain = Some(gain);
    }
}

/// `(T − ½)/C0` of a texel, without the light that is put on its Gaussian.
fn texture(actor: &Actor, second: &Second, k: usize) -> [f32; 3] {
    let Second { seen, relit, own, .. } = second;
    let mean = || MeanTextures::rows(&actor.mean.gau)[k];
    let color = if seen.views[k] > 0.0 { seen.colors[k] } else { std::array::from_fn(|i| mean()[i] * relit[i]) };
    std::array::from_fn(|i| coefficient(color[i] / own[i]))
}

impl Params for Direct {
    fn visit(&self, f: &mut dyn FnMut(&Param)) {
        self.texels.visit(f);
        self.gain.iter().for_each(f);
    }

    fn visit_mut(&mut self, f: &mut dyn FnMut(&mut Param)) {
        self.texels.visit_mut(f);
        self.gain.iter_mut().for_each(f);
    }
}
