//! Offsets of every frame by themselves, without a network: what GeoNet's losses can tell.

use super::actor::{First, FrameError};
use super::{Dut, OffsetErrors};
use glam::Vec3;
use gs_core::Param;
use gs_data::avatar::AvatarFrame;
use gs_train::adam::{Adam, Refused, Update};

/// How offsets are fitted to measured points without GeoNet.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OracleOptions {
    /// Steps of each frame in each round.
    pub steps: u32,
    /// Rounds, after each of which the mean colours are made anew.
    pub rounds: u32,
    /// Rate of the first step of each round, metres; it falls to a hundredth.
    pub rate: f32,
}

impl Dut {
    /// Looks for the offsets of every frame by GeoNet's losses alone, and says how far they are from the true ones after each
    /// round. Mean colours end as the last round left them.
    ///
    /// # Errors
    /// If a frame has no points or cannot be made.
    pub fn oracle(&mut self, options: &OracleOptions) -> Result<Vec<OffsetErrors>, FrameError> {
        let scene = self.actor.scene.clone();
        let mut found: Vec<Param> = scene
            .frames
            .iter()
            .map(|_| Param::rows("offsets", 3, vec![0.0; 3 * scene.character.template.vertices.len()]))
            .collect();
        let mut errors = Vec::new();
        for _ in 0..options.rounds {
            for (frame, offsets) in scene.frames.iter().zip(&mut found) {
                let first = self.first(frame)?;
                self.descend(frame, &first, offsets, options)?;
            }
            let of = |frame: &AvatarFrame| {
                let at = scene.frames.iter().position(|f| f.number == frame.number).unwrap_or(0);
                Some(rows(&found[at].value))
            };
            errors.push(self.errors_of(|frame, _| Ok(of(frame)))?);
            if !self.actor.mean.gau.is_empty() {
                let [renewed] = self.actor.mean_textures([Some(&self.actor.gau)], |frame| Ok(of(frame)))?;
                (self.actor.mean.gau, self.actor.mean.known) = (renewed.colors, renewed.known);
            }
        }
        Ok(errors)
    }

    fn descend(
        &self,
        frame: &AvatarFrame,
        first: &First,
        offsets: &mut Param,
        options: &OracleOptions,
    ) -> Result<(), FrameError> {
        let Some(geometry) = &self.geometry else { return Ok(()) };
        let mut adam = Adam::default();
        offsets.moment1.fill(0.0);
        offsets.moment2.fill(0.0);
        for step in 0..options.steps {
            let (_, d) = geometry.loss(&self.actor, frame, first, &rows(&offsets.value))?;
            offsets.grad = d.iter().flat_map(|d| d.to_array()).collect();
            let rate = options.rate * 0.01f32.powf(step as f32 / options.steps as f32);
            let update = Update { rate, eps: 1e-12, sparse: false, weight_decay: 0.0, ramp: 0 };
            adam.update(offsets, update, &mut Refused::default());
        }
        Ok(())
    }
}

fn rows(values: &[f32]) -> Vec<Vec3> {
    values.chunks_exact(3).map(Vec3::from_slice).collect()
}
