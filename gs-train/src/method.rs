//! What a method must provide: a moving scene under training.
//!
//! The trainer, checkpoints, evaluation and the viewer see a method only through [`Method`] and its
//! [`MethodEntry`](crate::registry::MethodEntry). A step of training calls, in this order:
//!
//! ```text
//! begin_step → step, once per view (splats → render → backward) → regularise → Adam → end_step
//! ```

use crate::capabilities::Capabilities;
use crate::densify::DensifyStats;
use crate::step::StepCtx;
use crate::timestamp::Timestamp;
use gs_core::{Camera, Cloud, Params, Splats, SplatsGrad, SplatsRef, Time};
use gs_raster::ScreenStats;
use std::any::Any;

pub use crate::error::MethodError;

/// A dynamic scene under training. Parameters are visited through [`Params`], other state through [`Buffers`]. After a
/// change of either from outside, [`Self::begin_step`] is called before anything else.
pub trait Method: Params + Buffers + Send + Sync {
    /// Step `at.step` is about to be made, or was the last one made. Whatever depends on the step, such as the SH degree or
    /// whether the deformation field takes part, follows from it; caches of earlier parameters are dropped.
    fn begin_step(&mut self, at: &StepCtx);

    /// The splats at a timestamp as `camera` sees them, without gradients.
    ///
    /// # Errors
    /// If an input of the method cannot be read.
    fn splats(&self, at: &Timestamp, camera: &Camera) -> Result<Splats, MethodError>;

    /// Forward and backward of one training view: builds the splats, hands them to `render`, and adds what comes back to the
    /// gradient of every parameter. Views of a step may be computed by different processes, so nothing here may depend on
    /// what another view of the step has left, and nothing else may change but gradients and buffers ([`Merge`]). A view may
    /// be left unrendered.
    ///
    /// Returns terms of the loss beside those of the image, weights and the view's share applied, by name.
    ///
    /// # Errors
    /// Those of `render`, and of inputs that cannot be read. The parameters are to be thrown away.
    fn step(&mut self, view: &ViewCtx<'_>, render: &mut dyn RenderView) -> Result<Vec<LossValue>, MethodError>;

    /// Once the gradients of all views are summed: regularisers add theirs. `last` is the timestamp of the last view of the
    /// step, which this process need not have computed.
    ///
    /// Returns the regularisers, weights applied, by name.
    fn regularise(&mut self, _last: &Timestamp) -> Vec<LossValue> {
        Vec::new()
    }

    /// Whether a block takes part in the step begun. One that does not is not updated, and the optimiser does not count the step
    /// for it: its first update has the corrections of a first one (as a parameter without gradient in PyTorch).
    fn takes_part(&self, _parameter: &str) -> bool {
        true
    }

    /// Whether [`Self::regularise`] looks at the gradient of all parameters, to clip it, say. Otherwise it may only add to it.
    fn needs_whole_gradient(&self) -> bool {
        false
    }

    /// Whether the coming [`Self::end_step`] edits rows, or reads buffers of rows.
    fn needs_whole_rows(&self) -> bool {
        true
    }

    /// After the optimiser's update: densification, and whatever else follows from the step's statistics.
    ///
    /// # Errors
    /// If an input of the method cannot be read.
    fn end_step(&mut self) -> Result<StepEvents, MethodError> {
        Ok(StepEvents::default())
    }

    /// The step begun in parts, for a device that makes whole steps ([`crate::device::DeviceSteps`]). Parameters, moments and buffers
    /// may then change without [`Self::begin_step`], between steps: nothing computed from them may outlive [`Self::end_step`].
    ///
    /// # Errors
    /// What makes the step more than a cloud, a field that moves it and the regularisers of that field, in words.
    fn moved_cloud(&self, _view: &ViewCtx<'_>) -> Result<MovedCloud<'_>, &'static str> {
        Err("the method is more than a cloud and a field")
    }

    /// Number of splats, at most (an anchor counts with all it can be decoded to).
    fn splat_count(&self) -> usize;

    /// What this method offers beyond training and rendering.
    fn capabilities(&self) -> Capabilities<'_> {
        Capabilities::default()
    }
}

/// A loss value by name, weight applied.
pub type LossValue = (&'static str, f32);

/// One training view, as a method sees it.
#[derive(Clone, Copy, Debug)]
pub struct ViewCtx<'a> {
    /// When the image was taken.
    pub at: Timestamp,
    /// The camera, at the size of the training image.
    pub camera: &'a Camera,
    /// Which draw of the step this view is, from 0.
    pub draw: u32,
    /// Whether this is the last view drawn for the step.
    pub last: bool,
}

/// A step of a method that is a cloud and a field that moves it.
#[derive(Clone, Copy)]
pub struct MovedCloud<'a> {
    /// The raw Gaussians.
    pub cloud: &'a Cloud,
    /// Degree of the spherical harmonics that are rendered.
    pub sh_degree: u8,
    /// The field that moves it, a type of gs-deform, if there is one.
    pub field: Option<&'a dyn Any>,
    /// Whether the field takes part in this step; otherwise the cloud is rendered where it is.
    pub moves: bool,
    /// Whether scales have no gradient in this step ([`StepCtx::keep_sizes`]).
    pub keeps_sizes: bool,
    /// What the field is asked for.
    pub time: Time,
    /// Whether the view counts in the statistics of densification.
    pub counts: bool,
    /// Whether the coming [`Method::end_step`] reads or changes parameters or statistics.
    pub edits: bool,
}

/// Renders the splats of a training view, compares them with the ground-truth image, and pulls the loss back to the splats.
pub trait RenderView {
    /// Writes the cotangents of every column of `splats` into `grad`, whatever it held. The statistics are of the loss of
    /// this view alone.
    ///
    /// # Errors
    /// If the ground truth cannot be read, or the loss is not finite.
    fn render(&mut self, splats: SplatsRef<'_>, grad: &mut SplatsGrad) -> Result<&ScreenStats, MethodError>;
}

/// What followed from a step.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct StepEvents {
    /// Splats cloned, split and pruned.
    pub densified: DensifyStats,
    /// Events worth keeping (an interval boundary that moved, say): one JSON object each, with its `step`.
    pub log: Vec<serde_json::Value>,
}

/// State of a method that is not a parameter (statistics of densification, say). It is kept in checkpoints.
pub trait Buffers {
    /// Calls `f` on every buffer, in a fixed order.
    fn buffers(&self, _f: &mut dyn FnMut(Buffer<'_>)) {}

    /// The same, to be restored. Buffers with rows may have any length before; afterwards they must fit the parameters.
    fn buffers_mut(&mut self, _f: &mut dyn FnMut(BufferMut<'_>)) {}
}

/// How [`Method::step`] changes a buffer. Views of one step find it as the step began, or at zero, and are put together after.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Merge {
    /// Views leave it as it is.
    Keep,
    /// Views add to it. A view finds zeros.
    Sum,
    /// Views raise values. A view finds those of the beginning of the step.
    Max,
}

/// A named buffer.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Buffer<'a> {
    /// Dotted name, unique within a method.
    pub name: &'static str,
    /// `Some(w)`: `w` values per row of the row blocks; `None`: any number of values.
    pub row_width: Option<usize>,
    /// How the views of a step change it.
    pub merge: Merge,
    /// The values.
    pub values: &'a Vec<f32>,
}

/// A [`Buffer`] to be restored.
#[derive(Debug)]
pub struct BufferMut<'a> {
    /// Dotted name, unique within a method.
    pub name: &'static str,
    /// As in [`Buffer`].
    pub row_width: Option<usize>,
    /// As in [`Buffer`].
    pub merge: Merge,
    /// The values.
    pub values: &'a mut Vec<f32>,
}
