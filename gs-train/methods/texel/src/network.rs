//! GauNet under training: rows of texel Gaussians from a frame's second texture.

use super::actor::{Actor, FrameError, Second};
use super::config::{Config, UnseenColor};
use super::mean::MeanTextures;
use super::tape::{covered, last, with_tape};
use super::texels::{TexelRows, coefficient, reference};
use gs_core::{Image, Param, Params, cast};
use gs_texel::gaussians::{COLOR, Channels, OFFSET, warm_up};
use gs_texel::{GauNet, GauNetTape};
use std::sync::Mutex;

/// GauNet with the tape of one frame.
pub(crate) struct Network {
    net: GauNet,
    tape: Mutex<GauNetTape>,
    channels: Channels,
    residual: bool,
    clip: f32,
    /// Reference rows `[K, width]`, black.
    reference: Vec<f32>,
    /// Their colours where no camera sees them.
    unseen: UnseenColor,
    /// Values of the texels' own, beside the network's.
    own: Option<TexelRows>,
    /// Metres of an offset of one.
    unit: f32,
}

impl Network {
    /// A network with random weights; one whose values are added to reference Gaussians begins with these.
    ///
    /// # Errors
    /// If its shape does not fit, or texels have no neighbours.
    pub(crate) fn new(config: &Config, actor: &Actor, channels: Channels, seed: u64) -> Result<Self, FrameError> {
        let mut net = GauNet::new("gau", config.gaunet_shape(), seed)?;
        if config.gaunet.residual {
            net.visit_mut(&mut |p| {
                if p.name.starts_with("gau.out.") {
                    p.value.fill(0.0);
                }
            });
        }
        let mask = covered(&actor.gau);
        let reference = reference(config, actor, channels, &vec![[0.0; 3]; actor.gau.len()])?;
        let own = || TexelRows::new(channels, &vec![0.0; reference.len()]);
        Ok(Self {
            tape: Mutex::new(net.tape(actor.gau.size, Some(&mask))?),
            net,
            channels,
            residual: config.gaunet.residual,
            clip: config.gaunet.clip,
            own: config.gaunet.own.then(own),
            unit: config.gaunet.offset_unit,
            unseen: config.gaunet.unseen,
            reference,
        })
    }

    /// The Gaussians that stand for a frame's texels before anything is learnt.
    fn reference(&self, actor: &Actor, second: &Second) -> Vec<f32> {
        let Second { seen, relit, .. } = second;
        let mut rows = self.reference.clone();
        let mean = MeanTextures::rows(&actor.mean.gau);
        let of_texels = rows.chunks_exact_mut(self.channels.width()).zip(seen.colors.iter().zip(&seen.views));
        for (k, (row, (color, views))) in of_texels.enumerate() {
            let color = match self.unseen {
                _ if *views > 0.0 => *color,
                UnseenColor::Mean => std::array::from_fn(|i| mean[k][i] * relit[i]),
                UnseenColor::Black => continue,
            };
            row[COLOR..COLOR + 3].copy_from_slice(&color.map(coefficient));
        }
        rows
    }

    /// Rows `[K, width]` of a frame.
    ///
    /// # Errors
    /// If the input is not finite.
    pub(crate) fn rows(&self, actor: &Actor, second: &Second, rows: &mut Vec<f32>) -> Result<(), FrameError> {
        let fresh = || self.net.tape(actor.gau.size, Some(&covered(&actor.gau)));
        let data = with_tape(&self.tape, fresh, |tape| Ok(self.net.forward(&second.input, tape)?.to_vec()))?;
        let size = actor.gau.size;
        let map = Image { width: size, height: size, channels: self.channels.width(), data };
        *rows = self.channels.gather(&map, &actor.gau.valid)?;
        self.scale_offsets(rows);
        if self.residual {
            rows.iter_mut().zip(self.reference(actor, second)).for_each(|(v, r)| *v += r);
        }
        self.own.iter().for_each(|own| own.add_to(rows, second.own));
        Ok(())
    }

    /// Adds the gradients of the pass that [`Self::rows`] made last, of this frame.
    ///
    /// # Errors
    /// If cotangents are not finite.
    pub(crate) fn backward(&mut self, actor: &Actor, second: &Second, d_rows: &[f32]) -> Result<(), FrameError> {
        self.own.iter_mut().for_each(|own| own.backward(d_rows, second.own));
        let mut d_rows = d_rows.to_vec();
        self.scale_offsets(&mut d_rows);
        let d_map = self.channels.scatter(&d_rows, &actor.gau.valid, actor.gau.size)?;
        let tape = last(&mut self.tape);
        Ok(self.net.backward(tape, &d_map.data)?)
    }

    /// The network's offsets in metres, or the cotangents of such in its units.
    fn scale_offsets(&self, rows: &mut [f32]) {
        if self.unit != 1.0 {
            let offsets = rows.chunks_exact_mut(self.channels.width()).flat_map(|row| &mut row[OFFSET]);
            offsets.for_each(|d| *d *= self.unit);
        }
    }

    /// Adds the gradient of the distance of rows to reference Gaussians, times `share`, and gives that distance.
    ///
    /// # Errors
    /// As [`Self::rows`].
    pub(crate) fn warm_up(
        &self,
        actor: &Actor,
        second: &Second,
        rows: &[f32],
        share: f32,
        d_rows: &mut [f32],
    ) -> Result<f32, FrameError> {
        let targets = self.reference(actor, second);
        let loss = warm_up::loss(rows, &targets, self.channels, d_rows)?;
        d_rows.iter_mut().for_each(|d| *d *= share);
        Ok(cast::to_f32(loss) * share)
    }

    /// Whether a gradient may be shortened.
    pub(crate) fn clips(&self) -> bool {
        self.clip > 0.0
    }

    /// Shortens the gradient of all weights to the longest allowed.
    pub(crate) fn clip(&mut self) {
        let mut square = 0.0f64;
        self.net.visit(&mut |p| square += p.grad.iter().map(|g| f64::from(*g).powi(2)).sum::<f64>());
        let (length, most) = (square.sqrt(), f64::from(self.clip));
        if most > 0.0 && length > most && length.is_finite() {
            let factor = cast::to_f32(most / length);
            self.net.visit_mut(&mut |p| p.grad.iter_mut().for_each(|g| *g *= factor));
        }
    }
}

impl Params for Network {
    fn visit(&self, f: &mut dyn FnMut(&Param)) {
        self.net.visit(f);
        self.own.iter().for_each(|own| own.visit(f));
    }

    fn visit_mut(&mut self, f: &mut dyn FnMut(&mut Param)) {
        self.net.visit_mut(f);
        self.own.iter_mut().for_each(|own| own.visit_mut(f));
    }
}
