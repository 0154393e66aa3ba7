//! Splats that the field hardly moves, left out of it while training. An approximation, off where `pixels` is 0.
//!
//! ```text
//! every `every` steps   low, high = range over `probes` times of field(x, t);  o = (low + high)/2 − x  (scales: a factor)
//! still                 ½ ‖high − low‖ of the mean ≤ `pixels` on the screen of every view yet rendered, shape within `shape`
//! a still splat         is rendered at x + o; its gradient goes straight to x
//! every `turn` steps    it takes part in the field, which so goes on learning from it, a different part of them in each step
//! enters again          until the next decision, if mean |screen gradient| > `density.grad` over the views rendered at x + o
//! pull                  a loss of the motion that the field gives to splats that take part, in units of the tolerances
//! ```
//! The first share `from` of a stage and the last share `1 − until` leave out none: the field first learns what moves, and what the
//! run ends with is the field's. A splat that no view has shown is still only if its centre does not move at all.

use super::pull::Pull;
use super::{fold, shape_change};
use crate::densify::screen_gradients;
use crate::method::{Buffer, BufferMut, Merge};
use crate::schedule::Schedule;
use crate::step::StepCtx;
use glam::{Vec3, Vec4};
use gs_core::{Camera, Geometry, GeometryRef, Time, cast};
use gs_raster::ScreenStats;
use serde::{Deserialize, Serialize};

/// Which splats are left out of the field while training, and when; by default none is. One enters again where its mean screen gradient
/// since the last decision is above [`DensifyRules::grad`](crate::densify::DensifyRules::grad).
#[derive(Clone, Copy, Debug, PartialEq, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StillConfig {
    /// Farthest the field may move the centre of a still splat from its pose, pixels; 0: none is left out.
    pub pixels: f32,
    /// Largest relative change of its scales and rotation.
    pub shape: f32,
    /// Steps between two decisions; at least 1.
    pub every: u32,
    /// A still splat takes part in one of so many steps; at least 1.
    pub turn: u32,
    /// Times at which the field is asked; at least 2.
    pub probes: u32,
    /// Share of a stage before which all take part.
    pub from: f32,
    /// Share of a stage after which all take part.
    pub until: f32,
    /// Weight of the mean over splats of how far the field moves them, in units of `pixels` and `shape`; 0: no pull.
    #[serde(default)]
    pub pull: f32,
}

impl StillConfig {
    /// Fails if splats may be left out, but in no step, or if there is a pull without tolerances.
    ///
    /// # Errors
    /// What is wrong, with the settings to change.
    pub fn check(&self) -> Result<(), String> {
        let Self { pixels, shape, from, until, pull, .. } = *self;
        if pull > 0.0 && (pixels <= 0.0 || shape <= 0.0) {
            return Err(format!(
                "still.pull = {pull} counts in units of still.pixels = {pixels} and still.shape = {shape}: make both larger than 0, or \
                 set still.pull = 0"
            ));
        }
        if pixels > 0.0 && from >= until {
            return Err(format!(
                "still.from = {from} and still.until = {until} leave no step in which a splat may rest: make still.from the smaller \
                 one, or set still.pixels = 0"
            ));
        }
        Ok(())
    }

    /// Whether splats may be left out, but no step of the schedule decides which.
    pub fn never_decides(&self, schedule: &Schedule) -> bool {
        let every = self.every.max(1);
        let mut steps = (every..=schedule.steps()).step_by(every as usize);
        self.pixels > 0.0 && !steps.any(|step| self.decides(&schedule.at(step)))
    }

    /// Whether the end of a step may decide: not of the first of a stage, which drops decisions.
    fn decides(&self, at: &StepCtx) -> bool {
        self.is_open(at) && at.stage_offset > 0 && at.step.is_multiple_of(self.every.max(1))
    }

    /// Whether splats may be left out in a step.
    fn is_open(&self, at: &StepCtx) -> bool {
        let share = at.stage_offset as f32 / at.stage_steps.max(1) as f32;
        at.dynamic && !at.deform_only && (self.from..self.until).contains(&share)
    }
}

/// Values of a row of `still.pose`: whether it is still, shifts of mean and quaternion, factors of scales.
const POSE: usize = 11;
/// Values of a row of `still.loss`.
const LOSS: usize = 2;

/// The still splats of a cloud under training.
#[derive(Clone, Debug)]
pub struct StillRows {
    config: StillConfig,
    /// The last training time: later ones are not probed.
    last_time: f32,
    /// `[n, 11]`.
    pose: Vec<f32>,
    /// `[n, 1]`: most pixels that a shift of one world unit made on the screen of a view, the largest number where a centre lay behind it.
    reach: Vec<f32>,
    /// `[n, 2]`, since the last decision: sum of the norms of the screen gradient, half-image units, over the views that showed a splat
    /// left out, and their number.
    loss: Vec<f32>,
    /// The rows that take part in the field in this step, unless all do.
    rows: Option<Vec<u32>>,
    picked: Geometry,
    moved: Geometry,
}

impl StillRows {
    /// For `n` splats, none of them still. Training times end at `last_time`, normalised.
    pub fn new(config: StillConfig, n: usize, last_time: f32) -> Self {
        let n = if config.pixels > 0.0 { n } else { 0 };
        let [pose, reach, loss] = [POSE, 1, LOSS].map(|width| vec![0.0; n * width]);
        let (picked, moved) = Default::default();
        Self { config, last_time, pose, reach, loss, rows: None, picked, moved }
    }

    /// Whether any splat may be left out.
    pub fn on(&self) -> bool {
        self.config.pixels > 0.0
    }

    /// Whether each splat is still; empty where none is ever left out.
    pub fn flags(&self) -> impl Iterator<Item = bool> {
        self.pose.chunks_exact(POSE).map(|row| row[0] != 0.0)
    }

    /// Chooses the rows that take part in the field in this step. What an earlier stage decided ends with it.
    pub fn begin_step(&mut self, at: &StepCtx) {
        self.rows = None;
        if at.stage_offset == 0 {
            self.pose.chunks_exact_mut(POSE).for_each(|row| row[0] = 0.0);
            self.loss.fill(0.0);
        }
        if !self.on() || !self.config.is_open(at) {
            return;
        }
        let turn = self.config.turn.max(1);
        let takes_part = |(row, still): (u32, bool)| (!still || (row + at.step).is_multiple_of(turn)).then_some(row);
        let rows: Vec<u32> = (0..).zip(self.flags()).filter_map(takes_part).collect();
        self.rows = (rows.len() * POSE < self.pose.len()).then_some(rows);
    }

    /// Writes all splats: those that take part as `field` moves these rows of `canonical`, the others in their pose.
    pub fn forward(
        &mut self,
        canonical: GeometryRef<'_>,
        field: impl FnOnce(GeometryRef<'_>, &mut Geometry),
        out: &mut Geometry,
    ) {
        let Some(rows) = &self.rows else { return field(canonical, out) };
        self.picked = canonical.pick(rows);
        field(self.picked.view(), &mut self.moved);
        out.resize(canonical.len());
        for (i, pose) in self.pose.chunks_exact(POSE).enumerate() {
            out.means[i] = canonical.means[i] + Vec3::from_slice(&pose[1..4]);
            out.quats[i] = (Vec4::from(canonical.quats[i]) + Vec4::from_slice(&pose[4..8])).to_array();
            out.scales[i] = canonical.scales[i] * Vec3::from_slice(&pose[8..11]);
        }
        out.scatter(&self.moved, rows);
    }

    /// The gradient of the pull with respect to the output of [`Self::forward`], `moved`, for one view of the step, and its value; none
    /// in steps without a pull.
    /// ```text
    /// pull / n · Σ ln(1 + reach ‖Δm‖ / pixels + (‖Δs‖ / max |s| + 2 ‖Δq‖ / ‖q‖) / shape)        Δ: what the field adds
    /// ```
    pub fn pull(&self, canonical: GeometryRef<'_>, moved: &Geometry, at: &StepCtx) -> Option<(Geometry, f32)> {
        let StillConfig { pixels, shape, pull, .. } = self.config;
        if pull <= 0.0 || !self.on() || !self.config.is_open(at) {
            return None;
        }
        let weight = pull / (canonical.len().max(1) as f32 * at.batch.max(1) as f32);
        let (pull, mut to) = (Pull { weight, pixels, shape }, Geometry::zeros(canonical.len()));
        let mut sum = 0.0;
        let mut add = |row: usize| {
            // One that lay behind a view is never still.
            if self.reach[row] > 0.0 && self.reach[row] < f32::MAX {
                sum += f64::from(pull.row(row, self.reach[row], canonical, moved, &mut to));
            }
        };
        match &self.rows {
            Some(rows) => rows.iter().for_each(|row| add(*row as usize)),
            None => (0..canonical.len()).for_each(&mut add),
        }
        Some((to, cast::to_f32(sum)))
    }

    /// The cotangents of all canonical splats, from those of [`Self::forward`]'s output: of the rows that take part through
    /// `field` (canonical, cotangents of its output, cotangents to be added to), of the others straight.
    pub fn backward(
        &mut self,
        canonical: GeometryRef<'_>,
        d_out: GeometryRef<'_>,
        field: impl FnOnce(GeometryRef<'_>, GeometryRef<'_>, &mut Geometry),
        d_canonical: &mut Geometry,
    ) {
        d_canonical.reset(canonical.len());
        let Some(rows) = &self.rows else { return field(canonical, d_out, d_canonical) };
        let mut d_picked = Geometry::zeros(rows.len());
        field(self.picked.view(), d_out.pick(rows).view(), &mut d_picked);
        d_canonical.view_mut().copy_from(d_out);
        for (scales, pose) in d_canonical.scales.iter_mut().zip(self.pose.chunks_exact(POSE)) {
            *scales *= Vec3::from_slice(&pose[8..11]);
        }
        d_canonical.scatter(&d_picked, rows);
    }

    /// Notes how far on the screen of a view a shift of its splats goes, and the screen gradients of those left out of the field.
    /// ```text
    /// pixels ≤ f / z · (1 + tan(fov/2)) · shift        for shifts ≪ z
    /// ```
    pub fn see(&mut self, moved: &Geometry, stats: &ScreenStats, camera: &Camera) {
        if !self.on() {
            return;
        }
        let (width, height) = (f64::from(camera.width), f64::from(camera.height));
        let [x, y] = [camera.cx.max(width - camera.cx) / camera.fx, camera.cy.max(height - camera.cy) / camera.fy];
        let focal = (camera.fx.max(camera.fy) * (1.0 + x.max(y))) as f32;
        let (axis, shift) = (camera.rotation.row(2).as_vec3(), camera.translation.z as f32);
        let left_out = |row: u32| self.rows.as_ref().is_some_and(|rows| rows.binary_search(&row).is_err());
        for (i, norm) in screen_gradients(stats, camera.width, camera.height) {
            let depth = axis.dot(moved.means[i]) + shift;
            self.reach[i] = self.reach[i].max(if depth > 0.0 { focal / depth } else { f32::MAX }.min(f32::MAX));
            if left_out(cast::to_u32(i)) {
                self.loss[LOSS * i] += norm;
                self.loss[LOSS * i + 1] += 1.0;
            }
        }
    }

    /// Whether [`Self::decide`] is due at the end of this step.
    pub fn due(&self, at: &StepCtx) -> bool {
        self.on() && self.config.decides(at)
    }

    /// Decides anew which splats are still: `probe` writes what the field makes of all splats at a time. Those left out so far whose
    /// mean screen gradient is above `grad`, half-image units, enter again. Returns the numbers of both.
    pub fn decide(
        &mut self,
        canonical: GeometryRef<'_>,
        grad: f32,
        mut probe: impl FnMut(Time, &mut Geometry),
    ) -> (usize, usize) {
        let gaps = self.config.probes.max(2) - 1;
        let (mut low, mut high) = <(Geometry, Geometry)>::default();
        for p in 0..=gaps {
            let normalised = self.last_time * p as f32 / gaps as f32;
            probe(Time { normalised, seconds: f64::from(normalised) }, &mut self.moved);
            if p == 0 {
                (low, high) = (self.moved.clone(), self.moved.clone());
            }
            fold(&mut low, &self.moved, f32::min);
            fold(&mut high, &self.moved, f32::max);
        }
        let StillConfig { pixels, shape, .. } = self.config;
        let (mut count, mut entered) = (0, 0);
        for (i, (row, loss)) in self.pose.chunks_exact_mut(POSE).zip(self.loss.chunks_exact(LOSS)).enumerate() {
            let [quat_low, quat_high] = [&low, &high].map(|g| Vec4::from(g.quats[i]));
            let (mean, quat) = (0.5 * (low.means[i] + high.means[i]), 0.5 * (quat_low + quat_high));
            let scales = 0.5 * (low.scales[i] + high.scales[i]);
            let way = 0.5 * low.means[i].distance(high.means[i]);
            let change = [&low, &high]
                .map(|g| shape_change((g.scales[i], g.quats[i]), (scales, quat.to_array())))
                .into_iter()
                .fold(0.0, f32::max);
            let known = way == 0.0 || self.reach[i] > 0.0;
            let enters = loss[0] > grad * loss[1];
            let still = !enters && known && way * self.reach[i] <= pixels && change <= shape;
            row[0] = f32::from(u8::from(still));
            row[1..4].copy_from_slice(&(mean - canonical.means[i]).to_array());
            row[4..8].copy_from_slice(&(quat - Vec4::from(canonical.quats[i])).to_array());
            row[8..].copy_from_slice(&(scales / canonical.scales[i]).to_array());
            count += usize::from(still);
            entered += usize::from(enters);
        }
        self.loss.fill(0.0);
        (count, entered)
    }

    /// The columns of the splats and their widths, for edits of rows; none where none is ever left out.
    pub fn columns_mut(&mut self) -> Vec<(&mut Vec<f32>, usize)> {
        if !self.on() {
            return Vec::new();
        }
        vec![(&mut self.pose, POSE), (&mut self.reach, 1), (&mut self.loss, LOSS)]
    }

    /// What checkpoints keep.
    pub fn buffers(&self, f: &mut dyn FnMut(Buffer<'_>)) {
        if self.on() {
            let [pose, reach, loss] = [&self.pose, &self.reach, &self.loss];
            f(Buffer { name: "still.pose", row_width: Some(POSE), merge: Merge::Keep, values: pose });
            f(Buffer { name: "still.reach", row_width: Some(1), merge: Merge::Max, values: reach });
            f(Buffer { name: "still.loss", row_width: Some(LOSS), merge: Merge::Sum, values: loss });
        }
    }

    /// The same, to be restored.
    pub fn buffers_mut(&mut self, f: &mut dyn FnMut(BufferMut<'_>)) {
        if self.on() {
            let [pose, reach, loss] = [&mut self.pose, &mut self.reach, &mut self.loss];
            f(BufferMut { name: "still.pose", row_width: Some(POSE), merge: Merge::Keep, values: pose });
            f(BufferMut { name: "still.reach", row_width: Some(1), merge: Merge::Max, values: reach });
            f(BufferMut { name: "still.loss", row_width: Some(LOSS), merge: Merge::Sum, values: loss });
        }
    }
}

#[cfg(test)]
mod tests;
