//! A step of training: the frame it learns from, and the way back to GeoNet, to GauNet or to the values of texels.

use super::actor::{First, FrameError, Second};
use super::config::Phase;
use super::mean::MeanTexture;
use super::{Dut, Source, light};
use gs_core::{Rng, cast};
use gs_data::avatar::AvatarFrame;
use gs_texel::gaussians::{decode_backward, offset_penalty};
use gs_train::method::{MethodError, RenderView};
use std::sync::Arc;

/// Why a step failed: an input of the frame, or rendering.
#[derive(Debug)]
pub(super) enum StepError {
    Frame(FrameError),
    Render(MethodError),
}

impl<E: Into<FrameError>> From<E> for StepError {
    fn from(e: E) -> Self {
        Self::Frame(e.into())
    }
}

impl From<MethodError> for StepError {
    fn from(e: MethodError) -> Self {
        Self::Render(e)
    }
}

impl Dut {
    /// The frame before GeoNet; in a share of the steps as one camera alone sees it, if the settings ask for that.
    fn occluded(&self, frame: &AvatarFrame) -> Result<Arc<First>, FrameError> {
        let first = self.first(frame)?;
        let mut rng = Rng::new(self.seed, "dut.one_view", self.at.step, frame.number.into());
        if rng.uniform() >= self.config.surface.one_view {
            return Ok(first);
        }
        let images = self.actor.images(frame)?;
        let one = rng.below(cast::to_u32(images.len().max(1))) as usize;
        Ok(Arc::new(self.actor.first_of(first.posed.clone(), images.get(one..=one).unwrap_or(&images))?))
    }

    /// The frame that a step learns from: in the warm-up one of the first ones, if the settings ask for that.
    pub(super) fn frame_of_step<'a>(&self, frames: &'a [AvatarFrame], frame: &'a AvatarFrame) -> &'a AvatarFrame {
        if self.phase() != Phase::WarmUp {
            return frame;
        }
        let learnt: Vec<&AvatarFrame> = frames.iter().filter(|f| f.learnt).collect();
        let at = learnt.iter().position(|f| f.number == frame.number).unwrap_or(0);
        let first = cast::to_usize(at as f64 * f64::from(self.config.gaunet.warm_up_frames));
        learnt.get(first).copied().unwrap_or(frame)
    }

    /// Leaves the gradients of one view in the parameters, and what its regularisers say in the penalties of the step.
    pub(super) fn learn(&mut self, frame: &AvatarFrame, render: &mut dyn RenderView) -> Result<(), StepError> {
        let share = 1.0 / self.at.batch as f32;
        let phase = self.phase();
        if phase == Phase::Geometry {
            let first = self.occluded(frame)?;
            let Some(geometry) = &mut self.geometry else { return Ok(()) };
            let terms = geometry.learn(&self.actor, frame, &first, share)?;
            terms.into_iter().for_each(|(name, value)| self.add_penalty(name, value));
            return Ok(());
        }
        let second = self.jittered(self.second(frame)?, frame.number);
        let (mut rows, mut d_rows) = (std::mem::take(&mut self.rows), std::mem::take(&mut self.d_rows));
        self.rows(&second, &mut rows)?;
        d_rows.clear();
        d_rows.resize(rows.len(), 0.0);
        if let (Phase::WarmUp, Source::Network(net)) = (phase, &self.source) {
            let loss = net.warm_up(&self.actor, &second, &rows, share, &mut d_rows)?;
            self.add_penalty("warm_up", loss);
        } else {
            self.render(&second, &rows, &mut d_rows, render)?;
            let penalty = offset_penalty(&rows, self.channels, self.config.gaussians.reg * share, &mut d_rows);
            self.add_penalty("offsets", cast::to_f32(penalty));
        }
        match &mut self.source {
            Source::Network(net) => net.backward(&self.actor, &second, &d_rows)?,
            Source::Direct(direct) => direct.backward(&self.actor, &second, &d_rows),
        }
        (self.rows, self.d_rows) = (rows, d_rows);
        Ok(())
    }

    /// The frame under a light of this step's own, if the settings ask for that.
    fn jittered(&self, second: Arc<Second>, number: u32) -> Arc<Second> {
        let most = self.config.jitter;
        if most == 0.0 || self.phase() != Phase::Main {
            return second;
        }
        let mut rng = Rng::new(self.seed, "dut.jitter", self.at.step, number.into());
        let gain = std::array::from_fn(|_| (most * (2.0 * rng.uniform() - 1.0)).exp());
        Arc::new(self.actor.relit(&second, gain, self.config.jitter_image))
    }

    /// Texel values to an image and its loss, and backward.
    fn render(
        &mut self,
        second: &Second,
        rows: &[f32],
        d_rows: &mut [f32],
        render: &mut dyn RenderView,
    ) -> Result<(), StepError> {
        let splats = self.decode(rows, second)?;
        render.render(splats.view(), &mut self.d_splats)?;
        light::pull_back(&mut self.d_splats, second.light);
        Ok(decode_backward(rows, self.channels, &second.base, &self.decoding(), &self.d_splats, d_rows, None)
            .map_err(FrameError::from)?)
    }

    fn add_penalty(&mut self, name: &'static str, value: f32) {
        match self.penalties.iter_mut().find(|p| p.0 == name) {
            Some(sum) => sum.1 += value,
            None => self.penalties.push((name, value)),
        }
    }

    /// Makes the mean colours anew while GeoNet learns, if asked for.
    pub(super) fn refresh_mean_textures(&mut self) -> Result<(), FrameError> {
        let every = self.config.surface.refresh;
        let due = every > 0 && self.at.step.is_multiple_of(every) && self.phase() == Phase::Geometry;
        if due && !self.actor.mean.gau.is_empty() {
            let through = |frame: &AvatarFrame| self.first(frame).and_then(|first| self.offsets(&first));
            let [MeanTexture { colors, known }] = self.actor.mean_textures([Some(&self.actor.gau)], through)?;
            (self.actor.mean.gau, self.actor.mean.known) = (colors, known);
            // Their light is relative to the mean colours.
            self.firsts.clear();
        }
        Ok(())
    }
}
