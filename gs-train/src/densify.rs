//! Adaptive density control: clone, split, prune and opacity reset (3D Gaussian Splatting, Kerbl et al. 2023, section 5).
//!
//! Each step adds to every splat drawn: `grad_sum += |(u_x W/2, u_y H/2)|`, `seen += 1`, `max_radius = max(…, 3σ px)`,
//! with `u = dL/d means2d` per pixel, so that the statistic does not depend on the image size. Every `every` steps, with
//! `ḡ = grad_sum / seen`, `s` the largest scale and `E` the extent of the scene:
//! ```text
//! ḡ ≥ grad and s ≤ dense_share E   clone: an exact copy
//! ḡ ≥ grad and s > dense_share E   split: two samples of the Gaussian with scales / split_factor; the parent goes
//! opacity < min_opacity            prune; after the first opacity reset also s > max_world E, and radius > max_screen
//! ```
//! Copies and children have the kernel of their parent; a reset of opacities leaves it alone. Samples come from the
//! counter-based generator, one stream per (step, parent, child). Where the reference code clears the radii before it
//! tests them, so that the screen rule never fires, here both size rules are live. A splat that no frame has shown since the last pass
//! stays, whatever its opacity; too large for `max_world` it goes nevertheless, as there.

use gs_core::cloud::{Cloud, logit, sigmoid};
use gs_core::param::RowEditError;
use gs_core::{Rng, RowEdit, rot};
use gs_raster::ScreenStats;
use serde::{Deserialize, Serialize};

use crate::method::Merge;

mod rules;
#[cfg(test)]
mod tests;

pub use rules::{DensifyRules, GrowthLimits};

/// What a pass of density control did.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default, Serialize, Deserialize)]
pub struct DensifyStats {
    /// Splats copied, or anchors added.
    pub cloned: u32,
    /// Splats split: replaced by two smaller ones.
    pub split: u32,
    /// Splats or anchors removed (parents of splits not counted).
    pub pruned: u32,
    /// Whether opacities were reset in this step.
    pub reset: bool,
}

/// What a pass must know beside the rules.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DensifyContext {
    /// Step of the run, for random numbers.
    pub step: u32,
    /// Step on the schedule's clock, for the rules.
    pub clock: u32,
    /// Extent of the scene, world units.
    pub extent: f32,
    /// Seed of the run, for the positions of children.
    pub seed: u64,
    /// Whether the background is white.
    pub white: bool,
}

/// Gaussians that density control may edit: a cloud, and whatever else has one row per Gaussian.
pub trait GaussianRows {
    /// The cloud that the rules look at.
    fn cloud(&self) -> &Cloud;

    /// The same, for new values of children and opacities.
    fn cloud_mut(&mut self) -> &mut Cloud;

    /// Applies an edit to the rows of the cloud and to all others, or to none.
    ///
    /// # Errors
    /// If some rows are fewer than the edit names.
    fn edit(&mut self, edit: &RowEdit) -> Result<(), RowEditError>;
}

impl GaussianRows for Cloud {
    fn cloud(&self) -> &Cloud {
        self
    }

    fn cloud_mut(&mut self) -> &mut Cloud {
        self
    }

    fn edit(&mut self, edit: &RowEdit) -> Result<(), RowEditError> {
        Cloud::edit(self, edit)
    }
}

/// The statistics of density control, one row per splat.
#[derive(Clone, Debug, PartialEq, Default)]
pub struct Densify {
    /// Sum over frames of the screen gradient's norm, half-image units.
    pub grad_sum: Vec<f32>,
    /// Number of frames each splat was drawn in.
    pub seen: Vec<f32>,
    /// Largest 3σ radius met, pixels.
    pub max_radius: Vec<f32>,
}

/// Rows to append and what becomes of them.
#[derive(Default)]
struct Plan {
    edit: RowEdit,
    /// Parents of the children at the end of `append_from`, two in a row each.
    children: Vec<u32>,
    stats: DensifyStats,
}

impl Densify {
    /// Empty statistics for `n` splats.
    pub fn new(n: usize) -> Self {
        let mut d = Self::default();
        d.clear(n);
        d
    }

    /// Sets all statistics to zero, for `n` splats.
    pub fn clear(&mut self, n: usize) {
        for column in self.columns_mut() {
            column.2.clear();
            column.2.resize(n, 0.0);
        }
    }

    /// The columns with their names and how views change them, for checkpoints.
    pub fn columns(&self) -> [(&'static str, Merge, &Vec<f32>); 3] {
        [
            ("density.grad_sum", Merge::Sum, &self.grad_sum),
            ("density.seen", Merge::Sum, &self.seen),
            ("density.max_radius", Merge::Max, &self.max_radius),
        ]
    }

    /// The columns of [`Self::columns`], to restore them.
    pub fn columns_mut(&mut self) -> [(&'static str, Merge, &mut Vec<f32>); 3] {
        [
            ("density.grad_sum", Merge::Sum, &mut self.grad_sum),
            ("density.seen", Merge::Sum, &mut self.seen),
            ("density.max_radius", Merge::Max, &mut self.max_radius),
        ]
    }

    /// Adds one frame of `width × height` pixels. Gradients that are not finite count as zero.
    pub fn accumulate(&mut self, seen: &ScreenStats, width: u32, height: u32) {
        for (i, norm) in screen_gradients(seen, width, height) {
            self.grad_sum[i] += norm;
            self.seen[i] += 1.0;
            self.max_radius[i] = self.max_radius[i].max(seen.radii[i].ceil());
        }
    }

    /// Whatever the rules ask for at this step: growth and pruning, then the opacity reset. Copies and children take over
    /// every value of their parent but the centres and scales of children.
    ///
    /// # Errors
    /// If `gaussians` have fewer rows somewhere than in their cloud.
    pub fn densify(
        &mut self,
        rules: &DensifyRules,
        at: &DensifyContext,
        gaussians: &mut dyn GaussianRows,
    ) -> Result<DensifyStats, RowEditError> {
        let mut stats = DensifyStats::default();
        if rules.grows_at(at.clock) {
            let plan = self.plan(rules, at, gaussians.cloud());
            stats = plan.stats;
            gaussians.edit(&plan.edit)?;
            self.place_children(rules, at, gaussians.cloud_mut(), &plan);
        }
        if rules.resets_at(at.clock, at.white) {
            reset_opacities(gaussians.cloud_mut(), rules.reset_opacity);
            stats.reset = true;
        }
        Ok(stats)
    }

    fn plan(&self, rules: &DensifyRules, at: &DensifyContext, cloud: &Cloud) -> Plan {
        let n = cloud.len();
        let largest =
            |i: usize| cloud.log_scales.value[3 * i..3 * i + 3].iter().copied().fold(f32::MIN, f32::max).exp();
        let in_turn = rules.prune_every == 0 || at.clock % rules.prune_every < rules.every;
        let prunes = in_turn && n > rules.prune_above as usize;
        let sizes_live = prunes && rules.reset_every > 0 && at.clock > rules.reset_every;
        let too_large = |s: f32| sizes_live && rules.max_world > 0.0 && s > rules.max_world * at.extent;
        let on_screen = |i: usize| sizes_live && rules.max_screen > 0.0 && self.max_radius[i] > rules.max_screen;
        let faint =
            |i: usize| prunes && self.seen[i] > 0.0 && sigmoid(cloud.logit_opacities.value[i]) < rules.min_opacity;
        let grows = self.growing(rules, n);
        let mut plan = Plan::default();
        let mut clones = Vec::new();
        for (i, grows) in grows.into_iter().enumerate() {
            let (s, row) = (largest(i), i as u32);
            let split = grows && s > rules.dense_share * at.extent;
            if grows && !split && !faint(i) && !too_large(s) {
                clones.push(row);
            }
            if split {
                plan.stats.split += 1;
                if !faint(i) && !too_large(s / rules.split_factor) {
                    plan.children.push(row);
                }
            } else if faint(i) || too_large(s) || on_screen(i) {
                plan.stats.pruned += 1;
            } else {
                plan.edit.keep.push(row);
            }
        }
        plan.stats.cloned = clones.len() as u32;
        plan.edit.append_from = clones;
        plan.edit.append_from.extend(plan.children.iter().flat_map(|&p| [p, p]));
        match plan.edit.new_rows() {
            0 if rules.min_splats == 0 => keep_the_strongest(cloud),
            left if left < rules.min_splats as usize => plan.without_pruning(n),
            _ => plan,
        }
    }

    /// Which splats are cloned or split: those of large gradient, the largest first where the cap binds.
    fn growing(&self, rules: &DensifyRules, n: usize) -> Vec<bool> {
        let mean = |i: usize| if self.seen[i] > 0.0 { self.grad_sum[i] / self.seen[i] } else { 0.0 };
        let mut wanted: Vec<usize> = (0..n).filter(|&i| self.seen[i] > 0.0 && mean(i) >= rules.grad).collect();
        let room = (rules.max_splats as usize).saturating_sub(n);
        if wanted.len() > room {
            wanted.sort_by(|&a, &b| mean(b).total_cmp(&mean(a)).then(a.cmp(&b)));
            wanted.truncate(room);
        }
        let mut grows = vec![false; n];
        wanted.into_iter().for_each(|i| grows[i] = true);
        grows
    }

    fn place_children(&mut self, rules: &DensifyRules, at: &DensifyContext, cloud: &mut Cloud, plan: &Plan) {
        let n = cloud.len();
        self.clear(n);
        let first = n - 2 * plan.children.len();
        for (k, &parent) in plan.children.iter().enumerate() {
            for child in 0..2 {
                let mut rng = Rng::new(at.seed, "split", at.step, 2 * u64::from(parent) + child as u64);
                place_child(cloud, first + 2 * k + child, rules.split_factor, &mut rng);
            }
        }
    }
}

/// The splats that a frame of `width × height` pixels shows, and the norms of their screen gradients, half-image units: 0 where one is
/// not finite.
pub(crate) fn screen_gradients(seen: &ScreenStats, width: u32, height: u32) -> impl Iterator<Item = (usize, f32)> {
    let (half_w, half_h) = (0.5 * width as f32, 0.5 * height as f32);
    let rows = seen.grad_means2d.iter().zip(&seen.radii).enumerate();
    rows.filter(|(_, (_, radius))| **radius > 0.0).map(move |(i, (g, _))| {
        let norm = (g[0] * half_w).hypot(g[1] * half_h);
        (i, if norm.is_finite() { norm } else { 0.0 })
    })
}

/// Moves a copied row to a sample of its own Gaussian, `μ + R (s ⊙ ε)`, and shrinks it.
fn place_child(cloud: &mut Cloud, row: usize, factor: f32, rng: &mut Rng) {
    let scales = &mut cloud.log_scales.value[3 * row..3 * row + 3];
    let offset: [f32; 3] = std::array::from_fn(|k| scales[k].exp() * rng.normal());
    scales.iter_mut().for_each(|s| *s -= factor.ln());
    let quat = std::array::from_fn(|k| cloud.quats.value[4 * row + k]);
    let r = rot::matrix(rot::normalise(quat).wxyz);
    for (mean, axis) in cloud.means.value[3 * row..3 * row + 3].iter_mut().zip(r) {
        *mean += axis[0] * offset[0] + axis[1] * offset[1] + axis[2] * offset[2];
    }
}

impl Plan {
    /// The same growth of `n` splats, of which only those that are replaced by children go.
    fn without_pruning(mut self, n: usize) -> Self {
        self.edit.keep = (0..n as u32).filter(|row| self.children.binary_search(row).is_err()).collect();
        self.stats = DensifyStats { pruned: 0, split: self.children.len() as u32, ..self.stats };
        self
    }
}

/// A scene is never pruned to nothing: the splat of highest opacity stays.
fn keep_the_strongest(cloud: &Cloud) -> Plan {
    let logits = &cloud.logit_opacities.value;
    let best = (0..logits.len()).max_by(|&a, &b| logits[a].total_cmp(&logits[b]).then(b.cmp(&a))).unwrap_or(0);
    let edit = RowEdit { keep: vec![best as u32], append_from: Vec::new() };
    let stats = DensifyStats { pruned: logits.len().saturating_sub(1) as u32, ..DensifyStats::default() };
    Plan { edit, children: Vec::new(), stats }
}

/// Lowers every opacity to at most `limit` and forgets the moments of the block.
fn reset_opacities(cloud: &mut Cloud, limit: f32) {
    let limit = logit(limit);
    cloud.logit_opacities.value.iter_mut().for_each(|v| *v = v.min(limit));
    cloud.logit_opacities.clear_moments();
}
