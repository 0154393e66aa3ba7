//! The rigid parts of a trained scene: labels of splats, masks of views, scores, and how complex the motion is.
//!
//! ```text
//! particles with twists ─ K-means, merged where one twist explains both ─┐
//! splats that only deform ─ OGC on their paths ──────────────────────────┴→ labels → masks of any view → scores
//! ```
//! * [`labels`]: a label per splat, from [`Method::particles`](gs_train::method::Method::particles) where the method has learnt
//!   twists (TRACE, GVFi), else from where its splats go ([`gs_physics::segment::Ogc`], as DefGS is scored).
//! * [`masks`]: splats in the colour of their label, alpha-blended by the rasteriser; the background is what light is left.
//! * [`truth`]: true label images: of a generated scene, of the data set, or of a folder.
//! * [`score`]: AP, PQ, F1 and mIoU ([`gs_metrics::segmentation`]) over the views of a split.
//! * [`parts`]: how each part moves, and how rigid it is.
//! * [`tracks`]: scene motion velocity and acceleration from the particles that pixels see.

pub mod labels;
pub mod masks;
pub mod parts;
pub mod score;
pub mod tracks;
pub mod truth;

pub use gs_train::palette::label_color as color;
pub use labels::{Count, Labels, Options, Source, of_particles, segment};
pub use masks::{Mask, Masker};
pub use parts::Part;
pub use score::{Scores, ViewMask, study};
pub use tracks::scene_complexity;
pub use truth::TrueLabels;

pub use gs_physics::complexity::Complexity;
pub use gs_physics::segment::Feature;

use gs_core::io::IoError;
use gs_data::DataError;
use gs_metrics::MetricError;
use gs_train::method::MethodError;

/// Why there are no parts.
#[derive(Debug, thiserror::Error)]
pub enum SegmentError {
    /// The method cannot be asked for its splats.
    #[error(transparent)]
    Method(#[from] MethodError),
    /// Nothing to tell apart.
    #[error("method `{0}` keeps its splats in no order that lasts, or has none: there are no paths to segment by")]
    NoPaths(String),
    /// A true label image cannot be used.
    #[error("labels of view `{view}`: {why}")]
    Labels {
        /// Name of the view.
        view: String,
        /// What is wrong with them.
        why: String,
    },
    /// A file of labels cannot be read.
    #[error(transparent)]
    Io(#[from] IoError),
    /// A file of labels cannot be read.
    #[error(transparent)]
    Data(#[from] DataError),
    /// Masks cannot be scored.
    #[error(transparent)]
    Metric(#[from] MetricError),
}
