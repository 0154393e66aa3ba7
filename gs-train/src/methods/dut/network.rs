//! GauNet under training: rows of texel Gaussians from a frame's second texture.

use super::actor::{Actor, FrameError, Second};
use super::config::Config;
use gs_core::{Image, Param, Params};
use gs_texel::gaussians::{Channels, warm_up};
use gs_texel::net::NetError;
use gs_texel::{GauNet, GauNetConfig, GauNetTape};
use std::sync::{Mutex, PoisonError};

/// GauNet and its memory.
pub struct Network {
    net: GauNet,
    tape: Mutex<GauNetTape>,
    channels: Channels,
    residual: bool,
    clip: f32,
    scale_range: [f64; 2],
}

impl Network {
    /// A network with random weights; one whose values are added to reference Gaussians begins with these.
    ///
    /// # Errors
    /// If its shape does not fit.
    pub fn new(config: &Config, actor: &Actor, channels: Channels, seed: u64) -> Result<Self, NetError> {
        let shape = GauNetConfig { inputs: 6, sh_degree: u32::from(channels.degree()), ..config.gaunet.net };
        let mut net = GauNet::new("gau", shape, seed)?;
        if config.gaunet.residual {
            net.visit_mut(&mut |p| {
                if p.name.starts_with("gau.out.") {
                    p.value.fill(0.0);
                }
            });
        }
        let mask: Vec<bool> = actor.gau.mask().iter().map(|m| *m > 0.0).collect();
        Ok(Self {
            tape: Mutex::new(net.tape(actor.gau.size, Some(&mask))?),
            net,
            channels,
            residual: config.gaunet.residual,
            clip: config.gaunet.clip,
            scale_range: config.gaussians.decode.scale_range,
        })
    }

    /// The Gaussians that stand for a frame's texels before anything is learnt.
    ///
    /// # Errors
    /// If texels have no neighbours.
    pub fn reference(&self, actor: &Actor, second: &Second) -> Result<Vec<f32>, FrameError> {
        let t = &actor.scene.character.template;
        let normals = actor.gau.interp_vec3(&t.faces, &actor.topology.normals(&t.vertices, &t.faces));
        let (colors, points) = (&second.seen.colors, &second.base.points);
        Ok(warm_up::targets(self.channels, colors, points, &normals, self.scale_range)?)
    }

    /// Rows `[K, width]` of a frame.
    ///
    /// # Errors
    /// If the input is not finite.
    pub fn rows(&self, actor: &Actor, second: &Second, rows: &mut Vec<f32>) -> Result<(), FrameError> {
        let mut tape = self.tape.lock().unwrap_or_else(PoisonError::into_inner);
        let data = self.net.forward(&second.input, &mut tape)?.to_vec();
        let size = actor.gau.size;
        let map = Image { width: size, height: size, channels: self.channels.width(), data };
        *rows = self.channels.gather(&map, &actor.gau.valid)?;
        if self.residual {
            rows.iter_mut().zip(self.reference(actor, second)?).for_each(|(v, r)| *v += r);
        }
        Ok(())
    }

    /// Adds the weights' gradients of the pass that [`Self::rows`] made last.
    ///
    /// # Errors
    /// If cotangents are not finite.
    pub fn backward(&mut self, actor: &Actor, d_rows: &[f32]) -> Result<(), FrameError> {
        let d_map = self.channels.scatter(d_rows, &actor.gau.valid, actor.gau.size)?;
        let tape = self.tape.get_mut().unwrap_or_else(PoisonError::into_inner);
        Ok(self.net.backward(tape, &d_map.data)?)
    }

    /// Adds the gradient of the distance of rows to reference Gaussians, times `share`, and gives that distance.
    ///
    /// # Errors
    /// As [`Self::rows`].
    pub fn warm_up(
        &self,
        actor: &Actor,
        second: &Second,
        rows: &[f32],
        share: f32,
        d_rows: &mut [f32],
    ) -> Result<f32, FrameError> {
        let targets = self.reference(actor, second)?;
        let loss = warm_up::loss(rows, &targets, self.channels, d_rows)?;
        d_rows.iter_mut().for_each(|d| *d *= share);
        Ok(loss as f32 * share)
    }

    /// Shortens the gradient of all weights to the longest allowed.
    pub fn clip(&mut self) {
        let mut square = 0.0f64;
        self.net.visit(&mut |p| square += p.grad.iter().map(|g| f64::from(*g).powi(2)).sum::<f64>());
        let (length, most) = (square.sqrt(), f64::from(self.clip));
        if most > 0.0 && length > most && length.is_finite() {
            let factor = (most / length) as f32;
            self.net.visit_mut(&mut |p| p.grad.iter_mut().for_each(|g| *g *= factor));
        }
    }
}

impl Params for Network {
    fn visit(&self, f: &mut dyn FnMut(&Param)) {
        self.net.visit(f);
    }

    fn visit_mut(&mut self, f: &mut dyn FnMut(&mut Param)) {
        self.net.visit_mut(f);
    }
}
