//! What only some methods offer. Each is a small trait of its own, reached through
//! [`Method::capabilities`].

use crate::densify::GrowthLimits;
use crate::method::{Method, MethodError};
use crate::palette::color_scale;
use crate::report::Section;
use crate::timestamp::Timestamp;
use glam::Vec3;
use gs_core::{Camera, Splats};
use serde::Serialize;
use serde_json::Value;
use std::any::Any;

/// The capabilities of a method; absent where it has none of the kind.
#[derive(Clone, Copy, Default)]
pub struct Capabilities<'a> {
    /// Attributes, overlays and stages of its splats: for reports and the viewer.
    pub inspect: Option<&'a dyn Inspect>,
    /// Learnt rigid motion: for forecasts and segmentation.
    pub particles: Option<&'a dyn ParticleSource>,
    /// Smaller forms for rendering alone: for compact files.
    pub bake: Option<&'a dyn Bake>,
    /// Bounds of densification; absent if the number of splats stays.
    pub growth: Option<GrowthLimits>,
    /// The method itself, for a crate that knows its type.
    pub concrete: Option<&'a dyn Any>,
}

/// Attributes, overlays and stages of the splats of a method.
pub trait Inspect: Method {
    /// All splats, in the same order at every timestamp: [`Method::splat_count`] of them, those absent at this timestamp
    /// with opacity 0. `camera` matters only where colours or shapes depend on the view.
    ///
    /// # Errors
    /// As [`Method::splats`].
    fn all_splats(&self, at: &Timestamp, camera: &Camera) -> Result<Splats, MethodError> {
        self.splats(at, camera)
    }

    /// Scalar attributes of every splat of [`Self::all_splats`].
    ///
    /// # Errors
    /// As [`Method::splats`].
    fn quantities(&self, _at: &Timestamp) -> Result<Vec<Quantity>, MethodError> {
        Ok(Vec::new())
    }

    /// Colours that may be rendered in place of the scene's: every quantity, at least.
    ///
    /// # Errors
    /// As [`Method::splats`].
    fn overlays(&self, at: &Timestamp) -> Result<Vec<Overlay>, MethodError> {
        Ok(self.quantities(at)?.iter().map(Quantity::overlay).collect())
    }

    /// The stages a scene passes on its way to a timestamp, as `camera` sees them; the last is [`Method::splats`].
    ///
    /// # Errors
    /// As [`Method::splats`].
    fn stages(&self, at: &Timestamp, camera: &Camera) -> Result<Vec<StageView>, MethodError> {
        Ok(vec![StageView { name: "full", splats: self.splats(at, camera)?, before: None }])
    }

    /// Normalised times at which what moves the scene changes: where splats may jump.
    fn borders(&self) -> Vec<f32> {
        Vec::new()
    }

    /// Settings that have no effect or another one than they seem to, for people.
    fn warnings(&self) -> Vec<String> {
        Vec::new()
    }

    /// Bytes on disk by the rule of the method's paper, where there is one.
    fn paper_storage(&self) -> Option<PaperStorage> {
        None
    }

    /// Its own section of the report of a run, from `events`: all that its run has logged
    /// ([`StepEvents::log`](crate::method::StepEvents::log)), in order. None if there is nothing to report.
    ///
    /// # Errors
    /// As [`Method::splats`].
    fn report_section(&self, _events: &[Value]) -> Result<Option<Section>, MethodError> {
        Ok(None)
    }
}

/// A colour per splat that shows something about it, rendered by the same rasteriser.
#[derive(Clone, Debug, PartialEq)]
pub struct Overlay {
    /// Name of the layer in viewer and report: `velocity`, `gate`, `segment`, …
    pub name: &'static str,
    /// One colour per splat of [`Inspect::all_splats`] at the same timestamp, display-encoded, 0 to 1.
    pub colors: Vec<[f32; 3]>,
    /// What the colours say, in words.
    pub meaning: &'static str,
}

/// The colour of splats whose number is not known.
const UNKNOWN: [f32; 3] = [0.5; 3];

/// A number about each splat.
#[derive(Clone, Debug, PartialEq)]
pub struct Quantity {
    /// Name in tables, histograms and overlays: `lambda`, `beta`, `gate`, …
    pub name: &'static str,
    /// Its unit; empty for a pure number.
    pub unit: &'static str,
    /// The interval its colours and histograms span; from the smallest to the largest value if absent.
    pub range: Option<[f32; 2]>,
    /// One value per splat of [`Inspect::all_splats`] at the same timestamp.
    pub values: Vec<f32>,
}

impl Quantity {
    /// A pure number in `[0, 1]`.
    pub fn share(name: &'static str, values: Vec<f32>) -> Self {
        Self { name, unit: "", range: Some([0.0, 1.0]), values }
    }

    /// The interval its colours and histograms span.
    pub fn span(&self) -> [f32; 2] {
        self.range.unwrap_or_else(|| {
            let whole = [f32::INFINITY, f32::NEG_INFINITY];
            let [low, high] = self.values.iter().fold(whole, |[a, b], &v| [a.min(v), b.max(v)]);
            match (low < high, low.is_finite()) {
                (true, _) => [low, high],
                (false, true) => [low, low + 1.0],
                (false, false) => [0.0, 1.0],
            }
        })
    }

    /// The values in the colours of [`color_scale`], from the lower to the upper end of the span; grey where they are no numbers.
    pub fn overlay(&self) -> Overlay {
        let [low, high] = self.span();
        let color = |v: &f32| if v.is_nan() { UNKNOWN } else { color_scale((v - low) / (high - low)) };
        let meaning = match self.values.iter().any(|v| v.is_nan()) {
            false => "dark blue is least, pale yellow most",
            true => "dark blue is least, pale yellow most, grey is not known",
        };
        Overlay { name: self.name, colors: self.values.iter().map(color).collect(), meaning }
    }
}

/// The scene after one stage on its way to a timestamp.
#[derive(Clone, Debug, PartialEq)]
pub struct StageView {
    /// Name of the stage: `canonical`, `global`, `local` or `full`.
    pub name: &'static str,
    /// The splats after this stage.
    pub splats: Splats,
    /// Centres of the same splats one stage earlier; absent in the first stage.
    pub before: Option<Vec<Vec3>>,
}

/// A method whose splats are rigid particles with learnt motion.
pub trait ParticleSource {
    /// The particles at the last time the deformation is asked for.
    fn particles(&self) -> Particles;

    /// Twists as in [`Particles::twists`] that rule the splats at another normalised time; `None`: those of [`Self::particles`] go on
    /// to it.
    fn twists_at(&self, _t: f64) -> Option<Vec<[[f32; 3]; 6]>> {
        None
    }

    /// Rigid bodies whose paths are known as wholes, with the error of their forecasts at these normalised times.
    fn bodies(&self, _times: &[f64]) -> Vec<RigidBody> {
        Vec::new()
    }
}

/// What is known of how a rigid body goes on.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RigidBody {
    /// How it moves: `rest`, `coast`, `fall`, `screw`, `roll`, `throw` or `twist`.
    pub path: &'static str,
    /// Number of splats that follow it.
    pub splats: usize,
    /// Centroid when the forecast begins, world units.
    pub centroid: [f64; 3],
    /// Velocity of the centroid then, world units per unit of normalised time.
    pub velocity: [f64; 3],
    /// Angular velocity then, radians per unit of normalised time.
    pub spin: [f64; 3],
    /// Acceleration of the centroid then, world units per unit of normalised time squared.
    pub acceleration: [f64; 3],
    /// Number of frames that its path explains.
    pub frames: usize,
    /// Standard deviation of where its splats are forecast to be, time by time, world units.
    pub deviations: Vec<f64>,
}

/// Splats as rigid particles: their state at one time and how they move from there.
#[derive(Clone, Debug, PartialEq)]
pub struct Particles {
    /// Time of this state, normalised: the last one the deformation is asked for.
    pub at: f64,
    /// The splats at that time.
    pub splats: Splats,
    /// Per splat the twist `(v, w)` about `origin` and its first and second derivatives, per unit of normalised time:
    /// `[v, w, v', w', v'', w'']`.
    pub twists: Vec<[[f32; 3]; 6]>,
    /// The origin that twists refer to, world units.
    pub origin: Vec3,
    /// Whether each motion is that of its particle from then on (TRACE), and not that of a flow where the particle is (NVFi).
    pub lasting: bool,
}

/// Smaller forms of a trained scene, for rendering alone.
pub trait Bake {
    /// The same scene without what only training needs, no image changed: its configuration, made of `config`, and the method.
    /// None if there is nothing to leave out.
    fn fold(&self, _config: &toml::Table) -> Option<(toml::Table, Box<dyn Method>)> {
        None
    }

    /// The same scene with splats that hardly move left at rest, an approximation, and what was left. A change of any
    /// parameter ends it. None if the method cannot, or nothing moves.
    fn freeze_static(&self, _options: &FreezeOptions<'_>) -> Option<(Box<dyn Method>, FreezeReport)> {
        None
    }

    /// A row block whose values are whole multiples of a length, and that length, world units.
    fn quantization_step(&self) -> Option<(&'static str, f32)> {
        None
    }
}

/// When a splat counts as static.
#[derive(Clone, Copy, Debug)]
pub struct FreezeOptions<'a> {
    /// Farthest a centre may be off on the screen of any camera, pixels.
    pub pixels: f32,
    /// Times that motion is probed at, from 0 to 1.
    pub probes: usize,
    /// Cameras that will be rendered from; without any, nothing that moves is left at rest.
    pub cameras: &'a [Camera],
    /// Largest relative change of scales and rotations.
    pub shape: f32,
    /// Factors of local motion below this count as zero where the global motion is zero.
    pub weight: f32,
}

impl<'a> FreezeOptions<'a> {
    /// 0.05 pixels, 0.1 % and 1e-4, at 17 times.
    pub fn usual(cameras: &'a [Camera]) -> Self {
        Self { pixels: 0.05, probes: 17, cameras, shape: 1e-3, weight: 1e-4 }
    }
}

/// What was left at rest, and the largest change this makes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FreezeReport {
    /// Splats of the scene, still and moving.
    pub splats: usize,
    /// Splats left at rest: their motion stays within the tolerances.
    pub still: usize,
    /// Farthest a centre is off at the probe times, pixels.
    pub bound_pixels: f32,
    /// Number of times that motion was probed at, from 0 to 1.
    pub probes: usize,
    /// Largest relative change of shape.
    pub shape: f32,
    /// Splats within the tolerances at the probe times but not between them; they keep moving.
    pub between: usize,
    /// Anchors whose global deformation is left out.
    pub anchors: usize,
}

/// Bytes of a scene by the rule of its paper.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct PaperStorage {
    /// Blocks in the order of the paper's table.
    pub rows: Vec<PaperStorageRow>,
    /// Files the published code leaves beside the scene, name and bytes; not in the sums.
    pub unused: Vec<(String, usize)>,
}

/// One block of [`PaperStorage`], in numbers of `f32` values.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct PaperStorageRow {
    /// Name of the block, as in the paper.
    pub block: String,
    /// `f32` values by the published rule.
    pub paper_values: usize,
    /// `f32` values that rendering needs.
    pub needed_values: usize,
}

impl PaperStorage {
    /// Bytes by the published rule.
    pub fn paper_bytes(&self) -> usize {
        4 * self.rows.iter().map(|r| r.paper_values).sum::<usize>()
    }

    /// Bytes that rendering needs, four per value.
    pub fn needed_bytes(&self) -> usize {
        4 * self.rows.iter().map(|r| r.needed_values).sum::<usize>()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_not_known_is_neither_least_nor_most() {
        let of = |values: Vec<f32>| Quantity { name: "deviation", unit: "units", range: None, values };
        let (known, some) = (of(vec![0.1, 0.3, 0.2]), of(vec![0.1, f32::NAN, 0.3, 0.2]));
        let [least, most, middle]: [[f32; 3]; 3] = known.overlay().colors.try_into().unwrap();
        assert_eq!((some.overlay().colors, some.span()), (vec![least, UNKNOWN, most, middle], known.span()));
        assert!(some.overlay().meaning.contains("grey") && !known.overlay().meaning.contains("grey"));
        let none = of(vec![f32::NAN; 2]);
        assert_eq!((none.overlay().colors, none.span()), (vec![UNKNOWN; 2], [0.0, 1.0]));
    }
}
