//! Cameras that are not quite right: a small correction of every training camera, learnt with the scene.
//!
//! ```text
//! R' = E R      T' = E (T − c) + c + v      f' = e^s f      E = exp([w]×)      c = (0, 0, pivot)
//! ```
//! `w` (radians) turns the camera about a point of its axis at the depth of the scene, `v` (world units) shifts it in its own
//! axes, `s` scales both focal lengths. (About its own centre, a turn would move the image as a shift does, and Adam, which
//! takes every number for itself, would be slow to tell them apart.) Views share a correction where the data give them the same camera: the
//! same number and the same pose. So a film by a resting camera has one, and a camera that moves has one for each image.
//!
//! The gradient of the image loss flows into the correction through the rasteriser. What a method makes of the camera before
//! that (anchors decode colours for a direction of view) is taken as given: that path has no gradient.
//!
//! A clock may be early or late as well: a camera with images of several times can have an offset of its clock
//! that is learnt by a central difference of the splats over time; all its images share it, whether it rests or moves.
//!
//! The loss does not know where the world's origin is: a motion of the whole scene and of all cameras changes no training
//! image, and neither does an offset of all clocks. So held-out cameras, which no correction is learnt for, are placed anew before they are scored
//! ([`place`](crate::evaluate::place)).

use crate::adam::Update;
use crate::clocks;
use glam::DVec3;
use gs_core::{Camera, Param, Time};
use gs_data::View;
use gs_raster::CameraGrad;
use serde::{Deserialize, Serialize};
use std::collections::{BTreeMap, BTreeSet};

/// Names of the blocks of corrections.
const NAMES: [&str; 4] = ["cameras.turn", "cameras.shift", "cameras.focal", CLOCKS];
/// Values of a camera in each block.
const WIDTHS: [usize; 4] = [3, 3, 1, 1];
/// Name of the block of clock offsets, the last.
const CLOCKS: &str = "cameras.time";

/// Section `[cameras]` of a configuration.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CameraConfig {
    /// Whether corrections of the poses are learnt.
    pub refine: bool,
    /// Whether a focal factor of every camera is learnt with them.
    pub focal: bool,
    /// Whether an offset of every camera's clock is learnt, with or without poses.
    #[serde(default)]
    pub time: bool,
    /// Learning rate of clock offsets, normalised time.
    #[serde(default)]
    pub time_rate: f32,
    /// Learning rate of `w`, radians.
    pub turn_rate: f32,
    /// Learning rate of `v`, as a share of the extent of the scene.
    pub shift_rate: f32,
    /// Learning rate of `s`.
    pub focal_rate: f32,
    /// Rates fall log-linearly to this share of themselves at [`Self::until`].
    pub rate_end: f32,
    /// Share of the run, later than [`Self::after`], at which rates have fallen so far; they go on falling after it.
    #[serde(default = "whole")]
    pub until: f64,
    /// Share of the run after which corrections begin to learn.
    pub after: f64,
}

/// The end of the run, as a share of it.
fn whole() -> f64 {
    1.0
}

impl CameraConfig {
    /// Verifies what the domains of single settings do not say.
    pub(crate) fn check(&self) -> Result<(), String> {
        let Self { after, until, .. } = *self;
        if until <= after && after < 1.0 {
            return Err(format!(
                "cameras.until = {until} is not later than cameras.after = {after}: rates would have fallen before they begin"
            ));
        }
        Ok(())
    }
}

impl Default for CameraConfig {
    /// Nothing is learnt.
    fn default() -> Self {
        let (turn_rate, shift_rate, focal_rate) = Default::default();
        Self {
            refine: false,
            focal: false,
            time: false,
            time_rate: 0.0,
            turn_rate,
            shift_rate,
            focal_rate,
            rate_end: 1.0,
            until: whole(),
            after: 0.0,
        }
    }
}

/// The correction of one camera.
#[derive(Clone, Copy, Debug, PartialEq, Default, Serialize, Deserialize)]
pub struct Correction {
    /// Depth of the point that turns are about, world units.
    pub pivot: f32,
    /// `w`, a rotation vector in the camera's axes, radians.
    pub turn: [f32; 3],
    /// `v`, in the camera's axes, world units.
    pub shift: [f32; 3],
    /// `s`, the logarithm of the focal factor.
    pub focal: f32,
    /// Offset of the clock, normalised time: the image shows the scene at the time of the data plus this.
    #[serde(default)]
    pub time: f32,
    /// [`KnownCamera::clock`].
    #[serde(default)]
    pub clock: f64,
}

impl Correction {
    /// The corrected camera.
    ///
    /// ```
    /// use glam::DVec3;
    /// use gs_core::Camera;
    /// use gs_train::cameras::Correction;
    ///
    /// let camera = Camera::look_at(64, 48, 0.7, DVec3::new(0.0, 0.0, -2.0), DVec3::ZERO, DVec3::NEG_Y)?;
    /// let nearer = Correction { shift: [0.0, 0.0, -0.5], ..Correction::default() }.apply(&camera);
    /// assert_eq!(nearer.to_camera(DVec3::ZERO).z, 1.5);
    /// assert_eq!(Correction::default().apply(&camera), camera);
    /// # Ok::<(), gs_core::camera::CameraError>(())
    /// ```
    pub fn apply(&self, camera: &Camera) -> Camera {
        let Self { pivot, turn, shift, focal, .. } = *self;
        if (turn, shift, focal) == Default::default() {
            return camera.clone();
        }
        let (factor, about) = (f64::from(focal).exp(), DVec3::Z * f64::from(pivot));
        let moved =
            Camera { translation: camera.translation - about, ..camera.clone() }.moved(vector(turn), vector(shift));
        Camera { fx: camera.fx * factor, fy: camera.fy * factor, translation: moved.translation + about, ..moved }
    }

    /// The corrected time of an image.
    pub fn at(&self, t: Time) -> Time {
        clocks::moved(t, self.time, self.clock)
    }

    /// A view with the corrected camera and time, to be rendered. Its image is that of the view as the data give it: a lens is
    /// undistorted with the data's camera.
    pub fn corrected(&self, view: &View) -> View {
        View { camera: self.apply(&view.camera), time: self.at(view.time), ..view.clone() }
    }

    /// Pulls the gradient at the corrected camera back to `w`, `v` and `s`. A change of `w` turns the camera by `J_l(w) dw`
    /// (left Jacobian of the exponential map; Solà et al. 2018, equation 145), about the point that turns are about.
    pub fn pull_back(&self, camera: &Camera, grad: &CameraGrad) -> ([f64; 3], [f64; 3], f64) {
        let corrected = self.apply(camera);
        let fixed = vector(self.shift) + DVec3::Z * f64::from(self.pivot);
        let turned = Camera { translation: corrected.translation - fixed, ..corrected.clone() };
        let [a, b, c, x, y, z] = grad.twist(&turned);
        let turn = left_jacobian_transposed(vector(self.turn), DVec3::new(a, b, c));
        (turn.to_array(), [x, y, z], grad.fx * corrected.fx + grad.fy * corrected.fy)
    }
}

fn vector(v: [f32; 3]) -> DVec3 {
    DVec3::from_array(v.map(f64::from))
}

/// `J_l(w)ᵀ g = g − (1 − cos θ)/θ² w × g + (θ − sin θ)/θ³ w × (w × g)`, by its series where `θ` is small.
fn left_jacobian_transposed(w: DVec3, g: DVec3) -> DVec3 {
    let square = w.length_squared();
    let (first, second) = if square < 1e-4 {
        (0.5 - square / 24.0, 1.0 / 6.0 - square / 120.0)
    } else {
        let angle = square.sqrt();
        ((1.0 - angle.cos()) / square, (angle - angle.sin()) / (square * angle))
    };
    let once = w.cross(g);
    g - first * once + second * w.cross(once)
}

/// A camera that has a correction, as the data give it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct KnownCamera {
    /// Name of the first view seen of it.
    pub name: String,
    /// Number of the camera ([`View::camera_id`]).
    pub camera_id: u32,
    /// World→camera transform in the data, rows of `[R | T]`.
    pub viewmat: [[f64; 4]; 3],
    /// [`Correction::pivot`].
    pub pivot: f32,
    /// Seconds per unit of normalised time of its clock; 0 where no offset is learnt: unless asked for, and of a camera with
    /// images of one time.
    #[serde(default)]
    pub clock: f64,
}

impl KnownCamera {
    /// The camera of a view, which turns about a point at this depth.
    pub fn new(view: &View, pivot: f32) -> Self {
        let (rows, t) = (view.camera.rotation.transpose().to_cols_array_2d(), view.camera.translation);
        let viewmat = [0, 1, 2].map(|r| [rows[r][0], rows[r][1], rows[r][2], t[r]]);
        Self { name: view.name.clone(), camera_id: view.camera_id, viewmat, pivot, clock: 0.0 }
    }

    /// Whether it is the same camera in the same pose.
    pub(crate) fn is(&self, other: &Self) -> bool {
        self.camera_id == other.camera_id && self.viewmat == other.viewmat
    }
}

/// The corrections of a model: none unless they are asked for.
#[derive(Clone, Debug)]
pub struct Cameras {
    config: CameraConfig,
    known: Vec<KnownCamera>,
    /// `w`, `v`, `s` and the clock offsets of all cameras.
    blocks: [Param; 4],
}

impl Default for Cameras {
    fn default() -> Self {
        Self::new(CameraConfig::default(), Vec::new())
    }
}

impl Cameras {
    /// Corrections of zero for cameras.
    pub(crate) fn new(config: CameraConfig, known: Vec<KnownCamera>) -> Self {
        let count = known.len();
        let blocks = std::array::from_fn(|k| Param::shared(NAMES[k], vec![0.0; WIDTHS[k] * count]));
        Self { config, known, blocks }
    }

    /// How corrections are learnt.
    pub fn config(&self) -> &CameraConfig {
        &self.config
    }

    /// The cameras that have corrections.
    pub fn known(&self) -> &[KnownCamera] {
        &self.known
    }

    /// Whether no camera has a correction.
    pub fn is_empty(&self) -> bool {
        self.known.is_empty()
    }

    /// The correction of a camera; none beyond the last.
    pub fn correction(&self, row: usize) -> Correction {
        let at = |block: usize, k: usize| self.blocks[block].value.get(WIDTHS[block] * row + k).copied().unwrap_or(0.0);
        let (pivot, clock) = self.known.get(row).map(|known| (known.pivot, known.clock)).unwrap_or_default();
        Correction {
            pivot,
            turn: [0, 1, 2].map(|k| at(0, k)),
            shift: [0, 1, 2].map(|k| at(1, k)),
            focal: at(2, 0),
            time: self.blocks[3].value.get(self.clock_row(row)).copied().unwrap_or(0.0),
            clock,
        }
    }

    /// The row that the clock of a camera is kept in: the first of the same number.
    fn clock_row(&self, row: usize) -> usize {
        let id = self.known.get(row).map(|known| known.camera_id);
        self.known.iter().position(|known| Some(known.camera_id) == id).unwrap_or(row)
    }

    /// The offset that was learnt for the clock of the cameras of this number, normalised time; none where none is learnt.
    pub(crate) fn clock_offset(&self, camera_id: u32) -> Option<f32> {
        let row = self.known.iter().position(|known| known.camera_id == camera_id && known.clock != 0.0)?;
        Some(self.correction(row).time)
    }

    /// The number of the correction for the camera of a view.
    pub fn row(&self, view: &View) -> Option<usize> {
        if self.is_empty() {
            return None;
        }
        let camera = KnownCamera::new(view, 0.0);
        self.known.iter().position(|known| known.is(&camera))
    }

    /// The correction for the camera of a view, if it has one.
    pub fn of(&self, view: &View) -> Option<Correction> {
        self.row(view).map(|row| self.correction(row))
    }

    /// Gives the cameras of training views that have no correction one of zero, where corrections are to be learnt. Turns are
    /// about the depth of the middle of the scene, at least half its extent away (both in world units).
    pub(crate) fn add_missing(&mut self, views: &[View], middle: DVec3, extent: f32) {
        for view in views.iter().filter(|_| self.config.refine || self.config.time) {
            if self.row(view).is_none() {
                let depth = view.camera.to_camera(middle).z.max(0.5 * f64::from(extent));
                self.known.push(KnownCamera::new(view, depth as f32));
            }
        }
        if self.config.time {
            let seconds = clocks::seconds_per_unit(views);
            let mut first = BTreeMap::new();
            let several = |view: &&View| *first.entry(view.camera_id).or_insert(view.time) != view.time;
            let timed: BTreeSet<u32> = views.iter().filter(several).map(|view| view.camera_id).collect();
            for known in self.known.iter_mut().filter(|known| timed.contains(&known.camera_id)) {
                known.clock = seconds;
            }
        }
        for (block, width) in self.blocks.iter_mut().zip(WIDTHS) {
            let len = width * self.known.len();
            for values in [&mut block.value, &mut block.grad, &mut block.moment1, &mut block.moment2] {
                values.resize(len, 0.0);
            }
        }
    }

    /// The blocks, in a fixed order; that of the clocks only where one has an offset; none without cameras.
    pub(crate) fn blocks(&self) -> &[Param] {
        &self.blocks[..self.used()]
    }

    /// The same, to change them.
    pub(crate) fn blocks_mut(&mut self) -> &mut [Param] {
        let used = self.used();
        &mut self.blocks[..used]
    }

    fn used(&self) -> usize {
        if self.is_empty() { 0 } else { NAMES.len() - usize::from(!self.has_clocks()) }
    }

    /// Whether the clock of some camera has an offset.
    pub(crate) fn has_clocks(&self) -> bool {
        self.known.iter().any(|known| known.clock != 0.0)
    }

    /// How a block is updated at a share of the run, if it learns then; none of other names. `extent` in world units.
    pub(crate) fn update(&self, name: &str, share: f64, extent: f32) -> Option<Update> {
        let c = &self.config;
        let rates = [
            if c.refine { c.turn_rate } else { 0.0 },
            if c.refine { c.shift_rate * extent } else { 0.0 },
            if c.refine && c.focal { c.focal_rate } else { 0.0 },
            if c.time { c.time_rate } else { 0.0 },
        ];
        let rate = rates[NAMES.iter().position(|n| *n == name)?];
        if rate <= 0.0 || share < c.after {
            return None;
        }
        let fallen = f64::from(c.rate_end).powf((share - c.after) / (c.until - c.after).max(1e-9));
        // A camera rests in steps that do not see it.
        Some(Update { rate: rate * fallen as f32, eps: 1e-15, sparse: true, weight_decay: 0.0, ramp: 0 })
    }

    /// Whether a block of this name is one of corrections.
    pub(crate) fn owns(name: &str) -> bool {
        NAMES.contains(&name)
    }

    /// Whether a block of this name is the one of clocks.
    pub(crate) fn is_clocks(name: &str) -> bool {
        name == CLOCKS
    }

    /// Adds the gradient with respect to the time of a view. One that is not finite is left out.
    pub(crate) fn add_time_gradient(&mut self, row: usize, slope: f64) {
        let row = self.clock_row(row);
        if let Some(to) = self.blocks[3].grad.get_mut(row).filter(|_| slope.is_finite()) {
            *to += slope as f32;
        }
    }

    /// Adds the gradient at the corrected camera of a view. One that is not finite is left out.
    pub(crate) fn add_gradient(&mut self, row: usize, camera: &Camera, grad: &CameraGrad) {
        let (turn, shift, focal) = self.correction(row).pull_back(camera, grad);
        if turn.iter().chain(&shift).chain([&focal]).any(|v| !v.is_finite()) {
            return;
        }
        for (block, (values, width)) in
            self.blocks.iter_mut().zip([&turn[..], &shift, &[focal]].into_iter().zip(WIDTHS))
        {
            let to = block.grad.iter_mut().skip(width * row);
            to.zip(values).for_each(|(to, from)| *to += *from as f32);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use gs_core::Rng;

    /// A loss that is linear in the entries of the camera: its gradient is known.
    fn linear(grad: &CameraGrad, c: &Camera) -> f64 {
        let rows = c.rotation.transpose().to_cols_array_2d();
        let pose: f64 = (0..3)
            .map(|r| {
                (0..3).map(|k| grad.viewmat[r][k] * rows[r][k]).sum::<f64>() + grad.viewmat[r][3] * c.translation[r]
            })
            .sum();
        pose + grad.fx * c.fx + grad.fy * c.fy
    }

    #[test]
    fn gradients_of_corrections_match_finite_differences() {
        let camera = Camera::look_at(64, 48, 0.7, DVec3::new(1.0, -2.0, 0.5), DVec3::ZERO, DVec3::Z).unwrap();
        for (seed, size) in [(0, 0.0f32), (1, 1e-3), (2, 0.02), (3, 1.5)] {
            let mut rng = Rng::new(seed, "correction", 0, 0);
            let mut draw = || f64::from(rng.normal());
            let grad = CameraGrad {
                viewmat: std::array::from_fn(|_| std::array::from_fn(|_| draw())),
                fx: draw(),
                fy: draw(),
                ..CameraGrad::default()
            };
            let mut draw = || size * draw() as f32;
            let at = Correction {
                pivot: 1.7,
                turn: [draw(), draw(), draw()],
                shift: [draw(), draw(), draw()],
                focal: draw(),
                ..Correction::default()
            };
            let (turn, shift, focal) = at.pull_back(&camera, &grad);
            let got: Vec<f64> = turn.into_iter().chain(shift).chain([focal]).collect();
            for (k, got) in got.into_iter().enumerate() {
                let h = 2f32.powi(-9);
                let side = |sign: f32| {
                    let mut c = at;
                    let entry = match k {
                        0..3 => &mut c.turn[k],
                        3..6 => &mut c.shift[k - 3],
                        _ => &mut c.focal,
                    };
                    let before = *entry;
                    *entry += sign * h;
                    let step = f64::from(*entry) - f64::from(before);
                    (linear(&grad, &c.apply(&camera)), step)
                };
                let ((hi, up), (lo, down)) = (side(1.0), side(-1.0));
                let numeric = (hi - lo) / (up - down);
                assert!((numeric - got).abs() < 2e-4 * got.abs().max(1.0), "size {size}, entry {k}: {got} {numeric}");
            }
        }
    }

    #[test]
    fn rates_fall_from_the_first_share_to_the_last() {
        let config = CameraConfig {
            refine: true,
            turn_rate: 1e-2,
            shift_rate: 1e-3,
            rate_end: 0.01,
            after: 0.2,
            ..CameraConfig::default()
        };
        let cameras = Cameras::new(config, Vec::new());
        let rate = |name: &str, share| cameras.update(name, share, 5.0).map(|u| u.rate);
        assert_eq!((rate(NAMES[0], 0.1), rate(NAMES[0], 0.2), rate(NAMES[2], 0.5)), (None, Some(1e-2), None));
        assert!((rate(NAMES[1], 0.6).unwrap() / 5e-4 - 1.0).abs() < 1e-5);
        assert!((rate(NAMES[0], 1.0).unwrap() / 1e-4 - 1.0).abs() < 1e-5);
        // The first hundredth of a run falls as a whole one does, and the rest goes on.
        let part = CameraConfig { after: 0.002, until: 0.01, ..config };
        let of_part = |share| Cameras::new(part, Vec::new()).update(NAMES[0], share, 5.0).map(|u| u.rate);
        for share in [0.25, 0.6, 1.0, 1.8] {
            let (whole, part) = (rate(NAMES[0], share).unwrap(), of_part(share / 100.0).unwrap());
            assert!((part / whole - 1.0).abs() < 1e-5, "{share}: {part} {whole}");
        }
        for until in [0.2, 0.3] {
            let fallen = CameraConfig { after: 0.3, until, ..config }.check().unwrap_err();
            assert!(fallen.contains(&format!("cameras.until = {until}")), "{fallen}");
        }
        assert_eq!((config.check(), part.check()), (Ok(()), Ok(())));
        let off = Cameras::new(CameraConfig { refine: false, ..config }, Vec::new());
        assert_eq!((off.update(NAMES[0], 0.5, 1.0), rate("cloud.means", 0.5)), (None, None));
    }
}
