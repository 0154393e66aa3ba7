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

use crate::error::ScheduleError;
use crate::method::Merge;

/// What bounds the number of splats.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct GrowthLimits {
    /// Most splats there may be.
    pub most: usize,
    /// Densification begins after this step of the schedule's clock,
    pub from: u32,
    /// and ends before this one.
    pub until: u32,
}

/// When and what to clone, split, prune and reset. Steps are those of the schedule's clock.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DensifyRules {
    /// Growth happens after this step …
    pub from: u32,
    /// … and before this one (0: never). Resets and pruning end there too.
    pub until: u32,
    /// Steps between two passes; at least 1.
    pub every: u32,
    /// Mean screen gradient (half-image units) from which a splat is cloned or split.
    pub grad: f32,
    /// Largest scale, as a share of the extent, that is cloned rather than split.
    pub dense_share: f32,
    /// Scales of the two children are those of their parent over this.
    pub split_factor: f32,
    /// Splats below this opacity are pruned.
    pub min_opacity: f32,
    /// Splats larger than this share of the extent are pruned after the first reset; 0: never.
    pub max_world: f32,
    /// Splats whose 3σ radius exceeded this many pixels are pruned after the first reset; 0: never.
    pub max_screen: f32,
    /// Opacities are reset every so many steps; 0: never.
    pub reset_every: u32,
    /// Opacities above this are set to it.
    pub reset_opacity: f32,
    /// Also reset at step `from` when the background is white, unless `reset_every` is 0.
    pub reset_on_white: bool,
    /// Whether the last step of a stage may grow, prune and reset (TRACE's code: no, so that the next stage begins with what
    /// this one has learnt).
    #[serde(default = "yes")]
    pub at_borders: bool,
    /// Nothing is pruned where fewer would be left (TRACE's code: 1024).
    #[serde(default)]
    pub min_splats: u32,
    /// Nothing is pruned up to this many splats (4DGS's code: 200 000).
    #[serde(default)]
    pub prune_above: u32,
    /// Splats are pruned in the first pass after every so many steps (4DGS's code: 8000 or 100); 0: in every pass.
    #[serde(default)]
    pub prune_every: u32,
    /// No growth beyond this many splats; the largest gradients go first.
    pub max_splats: u32,
}

fn yes() -> bool {
    true
}

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

impl DensifyRules {
    /// The published values (Kerbl et al. 2023), with a cap of one million splats.
    pub fn kerbl2023() -> Self {
        Self {
            from: 500,
            until: 15_000,
            every: 100,
            grad: 2e-4,
            dense_share: 0.01,
            split_factor: 1.6,
            min_opacity: 0.005,
            max_world: 0.1,
            max_screen: 20.0,
            reset_every: 3000,
            reset_opacity: 0.01,
            reset_on_white: true,
            at_borders: true,
            min_splats: 0,
            prune_above: 0,
            prune_every: 0,
            max_splats: 1_000_000,
        }
    }

    /// How far and when a cloud grows.
    pub fn growth(&self) -> GrowthLimits {
        GrowthLimits { most: self.max_splats as usize, from: self.from, until: self.until }
    }

    /// Whether rows may be edited and opacities reset in a step, by its clock, whether only the field learns in it, and whether it is
    /// the last of its stage.
    pub(crate) fn edits_at(&self, clock: u32, field_alone: bool, ends_stage: bool) -> bool {
        clock < self.until && !field_alone && (self.at_borders || !ends_stage)
    }

    /// Whether growth and pruning happen at this step.
    pub fn grows_at(&self, clock: u32) -> bool {
        clock > self.from && clock < self.until && clock.is_multiple_of(self.every)
    }

    /// Whether opacities are reset at this step.
    pub(crate) fn resets_at(&self, clock: u32, white: bool) -> bool {
        let first = white && self.reset_on_white && clock == self.from;
        self.reset_every > 0 && (1..self.until).contains(&clock) && (clock.is_multiple_of(self.reset_every) || first)
    }

    /// Verifies every field.
    ///
    /// # Errors
    /// The first field out of its domain.
    pub fn check(&self) -> Result<(), ScheduleError> {
        let need = |good: bool, field: &str, value: f32, rule| {
            if good {
                Ok(())
            } else {
                Err(ScheduleError { field: format!("density.{field}"), value: f64::from(value), rule })
            }
        };
        need(self.every > 0, "every", 0.0, "at least 1 step")?;
        need(self.max_splats > 0, "max_splats", 0.0, "at least 1 splat")?;
        for (field, v) in [("grad", self.grad), ("dense_share", self.dense_share), ("max_world", self.max_world)] {
            need(v >= 0.0 && v.is_finite(), field, v, "finite, not negative")?;
        }
        need(self.max_screen >= 0.0, "max_screen", self.max_screen, "not negative")?;
        need(
            self.split_factor >= 1.0 && self.split_factor.is_finite(),
            "split_factor",
            self.split_factor,
            "at least 1",
        )?;
        for (field, v) in [("min_opacity", self.min_opacity), ("reset_opacity", self.reset_opacity)] {
            need((0.0..1.0).contains(&v), field, v, "0 or more, below 1")?;
        }
        need(self.reset_opacity > 0.0, "reset_opacity", self.reset_opacity, "above 0")
    }
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::registry::section;
    use crate::schedule::{Background, Schedule};
    use glam::Vec3;

    const AT: DensifyContext = DensifyContext { step: 600, clock: 600, extent: 1.0, seed: 5, white: false };

    fn cloud(sigmas: &[f32]) -> Cloud {
        let at: Vec<Vec3> = (0..sigmas.len()).map(|i| Vec3::splat(i as f32)).collect();
        Cloud::from_points(&at, &vec![[0.5; 3]; sigmas.len()], sigmas, 0.5, 1).unwrap()
    }

    fn seen(grad: &[f32]) -> ScreenStats {
        ScreenStats { grad_means2d: grad.iter().map(|&g| [g, 0.0]).collect(), radii: vec![1.2; grad.len()] }
    }

    #[test]
    fn small_clone_large_split_faint_go() {
        let mut c = cloud(&[0.001, 0.5, 0.001, 0.001]);
        c.logit_opacities.value[3] = logit(0.001);
        c.means.moment1.fill(3.0);
        let mut d = Densify::new(4);
        // Half of 100 pixels times 1e-4 is 5e-3 in half-image units: above the threshold.
        d.accumulate(&seen(&[1e-4, 1e-4, 0.0, 0.0]), 100, 100);
        let did = d.densify(&DensifyRules::kerbl2023(), &AT, &mut c).unwrap();
        assert_eq!(did, DensifyStats { cloned: 1, split: 1, pruned: 1, reset: false });
        assert_eq!(c.len(), 5);
        assert_eq!(c.means.value[..3], [0.0; 3]);
        assert_eq!(c.means.value[6..9], [0.0; 3], "the clone is an exact copy");
        for child in 3..5 {
            assert!((c.log_scales.value[3 * child].exp() - 0.5 / 1.6).abs() < 1e-6);
            assert!(c.means.value[3 * child..3 * child + 3].iter().any(|v| *v != 1.0), "children are samples");
        }
        assert_ne!(c.means.value[9..12], c.means.value[12..15]);
        assert_eq!((c.means.moment1[0], c.means.moment1[6], d.seen.len(), d.seen[0]), (3.0, 0.0, 5, 0.0));
    }

    #[test]
    fn children_follow_the_gaussian_of_their_parent() {
        let (mut mean, mut square, runs) = (0.0f64, [0.0f64; 3], 4000);
        for step in 0..runs {
            let mut c = cloud(&[0.5]);
            c.log_scales.value.copy_from_slice(&[0.1f32.ln(), 0.2f32.ln(), 0.4f32.ln()]);
            c.quats.value.copy_from_slice(&[0.5f32.sqrt(), 0.0, 0.0, 0.5f32.sqrt()]);
            place_child(&mut c, 0, 1.6, &mut Rng::new(1, "split", step, 0));
            mean += f64::from(c.means.value[0]) / f64::from(runs);
            for (s, v) in square.iter_mut().zip(&c.means.value) {
                *s += f64::from(v * v) / f64::from(runs);
            }
        }
        // A quarter turn about z swaps the first two axes.
        assert!(mean.abs() < 0.02);
        assert!(square.iter().zip([0.04, 0.01, 0.16]).all(|(a, b)| (a / b - 1.0).abs() < 0.1), "{square:?}");
    }

    #[test]
    fn size_rules_live_after_the_first_reset_only() {
        let rules = DensifyRules::kerbl2023();
        let run = |clock| {
            let mut c = cloud(&[0.2, 0.001, 0.001]);
            let mut d = Densify::new(3);
            d.accumulate(&ScreenStats { grad_means2d: vec![[0.0; 2]; 3], radii: vec![1.0, 30.0, 1.0] }, 64, 64);
            d.densify(&rules, &DensifyContext { clock, ..AT }, &mut c).unwrap().pruned
        };
        assert_eq!((run(2900), run(3100)), (0, 2));
    }

    /// As in the reference code: how large a splat is in the world is known without a view, its radius on the screen is not.
    #[test]
    fn a_splat_too_large_for_the_world_goes_unseen_as_well() {
        let pruned = |radius: f32| {
            let mut c = cloud(&[0.2, 0.001, 0.001]);
            c.logit_opacities.value[2] = logit(0.001);
            let mut d = Densify::new(3);
            d.accumulate(&ScreenStats { grad_means2d: vec![[0.0; 2]; 3], radii: vec![radius; 3] }, 64, 64);
            let did = d.densify(&DensifyRules::kerbl2023(), &DensifyContext { clock: 3100, ..AT }, &mut c).unwrap();
            (did.pruned, c.means.value[0])
        };
        assert_eq!([0.0, 1.0].map(pruned), [(1, 1.0), (2, 1.0)], "the small one stays, unseen the faint one too");
    }

    #[test]
    fn only_what_was_seen_is_pruned_and_never_below_the_least_number() {
        let run = |seen: f32, min_splats| {
            let mut c = cloud(&[0.001; 4]);
            c.logit_opacities.value[..2].fill(logit(0.001));
            let mut d = Densify::new(4);
            let radii = vec![1.2, seen, 1.2, 1.2];
            d.accumulate(&ScreenStats { grad_means2d: vec![[0.0; 2]; 4], radii }, 64, 64);
            let rules = DensifyRules { min_splats, ..DensifyRules::kerbl2023() };
            (d.densify(&rules, &AT, &mut c).unwrap().pruned, c.len())
        };
        assert_eq!((run(1.2, 0), run(0.0, 0)), ((2, 2), (1, 3)));
        assert_eq!((run(1.2, 2), run(1.2, 3)), ((2, 2), (0, 4)));
    }

    /// 4DGS prunes only clouds of some size, and seldom.
    #[test]
    fn pruning_has_a_turn_and_a_least_size_of_its_own() {
        let run = |clock, prune_above, prune_every| {
            let mut c = cloud(&[0.001; 4]);
            c.logit_opacities.value[0] = logit(0.001);
            let mut d = Densify::new(4);
            d.accumulate(&ScreenStats { grad_means2d: vec![[0.0; 2]; 4], radii: vec![1.2; 4] }, 64, 64);
            let rules = DensifyRules { prune_above, prune_every, every: 100, ..DensifyRules::kerbl2023() };
            d.densify(&rules, &DensifyContext { clock, ..AT }, &mut c).unwrap().pruned
        };
        assert_eq!([0, 3, 4].map(|above| run(600, above, 0)), [1, 1, 0]);
        assert_eq!([700, 800, 900, 1600].map(|clock| run(clock, 0, 800)), [0, 1, 0, 1]);
        // A turn that is no multiple of the passes comes with the pass after it.
        assert_eq!([700, 800, 1500, 1600].map(|clock| run(clock, 0, 750)), [0, 1, 1, 0]);
    }

    #[test]
    fn below_the_least_number_splats_grow_and_none_is_pruned() {
        let mut c = cloud(&[0.001, 0.5, 0.001]);
        c.logit_opacities.value[2] = logit(0.001);
        let mut d = Densify::new(3);
        d.accumulate(&seen(&[1e-4, 1e-4, 0.0]), 100, 100);
        let rules = DensifyRules { min_splats: 1024, ..DensifyRules::kerbl2023() };
        let did = d.densify(&rules, &AT, &mut c).unwrap();
        assert_eq!(did, DensifyStats { cloned: 1, split: 1, pruned: 0, reset: false });
        assert_eq!((c.len(), c.logit_opacities.value[1]), (5, logit(0.001)));
    }

    #[test]
    fn the_cap_admits_the_largest_gradients() {
        let mut c = cloud(&[0.001; 4]);
        let mut d = Densify::new(4);
        d.accumulate(&seen(&[1e-4, 4e-4, 2e-4, 3e-4]), 100, 100);
        let rules = DensifyRules { max_splats: 6, ..DensifyRules::kerbl2023() };
        assert_eq!(d.densify(&rules, &AT, &mut c).unwrap().cloned, 2);
        assert_eq!((c.means.value[12], c.means.value[15]), (1.0, 3.0));
    }

    #[test]
    fn something_always_stays() {
        let mut c = cloud(&[0.001; 3]);
        c.logit_opacities.value.copy_from_slice(&[-9.0, -8.0, -8.5]);
        let mut d = Densify::new(3);
        d.accumulate(&seen(&[0.0; 3]), 64, 64);
        let did = d.densify(&DensifyRules::kerbl2023(), &AT, &mut c).unwrap();
        assert_eq!((c.len(), c.means.value[0], did.pruned), (1, 1.0, 2));
    }

    #[test]
    fn resets_come_when_due() {
        let rules = DensifyRules::kerbl2023();
        let never = DensifyRules { reset_every: 0, ..rules.clone() };
        assert!((0..20_000).all(|clock| !never.resets_at(clock, true)));
        assert!(rules.resets_at(3000, false) && rules.resets_at(500, true));
        assert!(!rules.resets_at(500, false) && !rules.resets_at(15_000, false) && !rules.resets_at(2999, true));
        let mut c = cloud(&[0.001; 2]);
        c.logit_opacities.value[1] = -5.0;
        c.logit_opacities.moment2.fill(1.0);
        assert!(Densify::new(2).densify(&rules, &DensifyContext { clock: 3000, ..AT }, &mut c).unwrap().reset);
        assert!((sigmoid(c.logit_opacities.value[0]) - 0.01).abs() < 1e-6 && c.logit_opacities.value[1] == -5.0);
        assert_eq!(c.logit_opacities.moment2, [0.0; 2]);
    }

    /// Every 3000 steps and, over white, where growth begins. TRACE's code spares step 3000, at which its warm-up ends; that of
    /// Deformable 3DGS does not.
    #[test]
    fn published_presets_reset_opacities_as_their_authors_do_and_short_ones_never() {
        let resets = |method: &'static str, preset: &str| {
            let config = gs_methods::registry().find(method).and_then(|m| m.config(preset)).unwrap();
            let schedule: Schedule = section(method, &config, "schedule").unwrap();
            let (rules, white) = (&schedule.density, schedule.background == Background::White);
            let due = |step: &u32| {
                let at = schedule.at(*step);
                rules.edits_at(at.clock, at.deform_only, at.ends_stage) && rules.resets_at(at.clock, white)
            };
            (1..=schedule.steps()).filter(due).collect::<Vec<u32>>()
        };
        for preset in ["paper", "parity"] {
            assert_eq!(resets("trace", preset), [500, 6000, 9000, 12_000], "{preset}");
        }
        assert_eq!(resets("defgs", "paper"), [3000, 6000, 9000, 12_000]);
        for (method, preset) in [("trace", "fast"), ("trace", "tiny"), ("defgs", "fast"), ("defgs", "tiny")] {
            assert!(resets(method, preset).is_empty(), "{method} {preset}");
        }
    }

    #[test]
    fn kernels_are_inherited_and_outlive_a_reset() {
        let (mode, beta_hi) = (gs_core::kernel::BetaMode::Capped, 0.98);
        let init = gs_core::cloud::KernelInit::Frequency { mode, beta_hi, shared_lambda: false };
        let mut c = cloud(&[0.001, 0.5]).with_kernel(init).unwrap();
        for p in c.kernel.as_mut().unwrap().params_mut() {
            p.value.copy_from_slice(&[3.0, -2.0]);
            p.moment2.fill(1.0);
        }
        let mut d = Densify::new(2);
        d.accumulate(&seen(&[1e-4, 1e-4]), 100, 100);
        let rules = DensifyRules { reset_every: 600, ..DensifyRules::kerbl2023() };
        let did = d.densify(&rules, &AT, &mut c).unwrap();
        assert_eq!(did, DensifyStats { cloned: 1, split: 1, pruned: 0, reset: true });
        for p in c.kernel.as_ref().unwrap().params() {
            assert_eq!(p.value, [3.0, 3.0, -2.0, -2.0], "{}: the kept, its copy, two children", p.name);
            assert_eq!(p.moment2, [1.0, 0.0, 0.0, 0.0], "{}", p.name);
        }
    }

    #[test]
    fn poisoned_statistics_do_no_harm() {
        let mut d = Densify::new(2);
        d.accumulate(&seen(&[f32::NAN, f32::INFINITY]), 10, 10);
        assert_eq!((d.grad_sum.clone(), d.seen.clone()), (vec![0.0; 2], vec![1.0; 2]));
    }
}
