//! Rigid parts of a trained scene: labels of splats, masks of views, scores, and the complexity of the motion.
//!
//! ```text
//! particles with twists ─ K-means, merged where one twist explains both ─┐
//! splats that only deform ─ OGC on their paths ──────────────────────────┴→ labels → masks of any view → scores
//! ```
//! * [`labels`]: a label per splat, by clustering of [`Particles`](crate::particles::Particles) where the method learns twists
//!   (TRACE, GVFi), else by the paths of its splats ([`gs_physics::segment::Ogc`], as DefGS is scored).
//! * [`masks`]: one-hot label colours, alpha-blended by the rasteriser; the background is the remaining transmittance.
//! * [`truth`]: ground-truth label images: of a generated scene, of the data set, or of a folder.
//! * [`score`]: AP, PQ, F1 and mIoU ([`gs_metrics::segmentation`]) over the views of a split.
//! * [`parts`]: motion and rigidity of each part.
//! * [`tracks`]: scene motion velocity and acceleration from tracks of pixels.

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

/// A scene that cannot be segmented.
#[derive(Debug, thiserror::Error)]
pub enum SegmentError {
    /// The model cannot produce its splats.
    #[error(transparent)]
    Method(#[from] MethodError),
    /// There are no splats, or their number changes over time.
    #[error("method `{0}` keeps its splats in no order that lasts, or has none: there are no paths to segment by")]
    NoPaths(String),
    /// Twists are asked for, and the method learns none.
    #[error("method `{0}` learns no twists to segment by")]
    NoTwists(String),
    /// A ground-truth label image cannot be used.
    #[error("labels of view `{view}`: {why}")]
    Labels {
        /// Name of the view in the data set.
        view: String,
        /// What is wrong with its labels.
        why: String,
    },
    /// A file of labels cannot be read.
    #[error(transparent)]
    Io(#[from] IoError),
    /// A label image cannot be decoded, or has the wrong size.
    #[error(transparent)]
    Data(#[from] DataError),
    /// Rendered masks cannot be scored against labels.
    #[error(transparent)]
    Metric(#[from] MetricError),
}
