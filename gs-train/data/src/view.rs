//! What a data set is made of: views, and coloured points.

use crate::depth::DepthMap;
use crate::lens::Lens;
use crate::pixels::ImageU8;
use glam::Vec3;
use gs_core::{Camera, Time};
use std::path::PathBuf;
use std::sync::Arc;

/// Where the pixels of a view are.
#[derive(Clone, Debug, PartialEq)]
pub enum ImageSource {
    /// Path of a PNG or JPEG file.
    File(PathBuf),
    /// Pixels in memory, shared.
    Memory(Arc<ImageU8>),
}

/// A camera, a timestamp and where the image is. Nothing is decoded: [`ImageCache::get`](crate::ImageCache::get) does that.
///
/// ```
/// use gs_core::{Camera, Time};
/// use gs_data::{ImageCache, ImageSource, ImageU8, View};
///
/// let camera = Camera::look_at(2, 2, 0.7, glam::DVec3::Z * 4.0, glam::DVec3::ZERO, glam::DVec3::Y)?;
/// let grey = ImageU8 { width: 2, height: 2, data: vec![128; 2 * 2 * 4] };
/// let view = View::new("r_000", camera, Time::new(0.5)?, ImageSource::Memory(grey.into()), 0);
/// assert_eq!(ImageCache::new(0, 1.0).get(&view)?.pixel(1, 1), [128; 4]);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct View {
    /// Unique within its split, for example `r_017`: the stem of the image file, or its whole path where stems repeat.
    pub name: String,
    /// The pinhole camera, world to camera with OpenCV axes. Its size is that of the image in use, after `data.scale`.
    pub camera: Camera,
    /// Width and height of the stored image, where it is shrunk to the size of the camera (`data.scale`); none otherwise.
    pub stored: Option<[u32; 2]>,
    /// Lens distortion of the stored image, which the [`ImageCache`](crate::ImageCache) removes; none for a pinhole.
    pub lens: Option<Lens>,
    /// Timestamp: normalised over the training span, and in seconds.
    pub time: Time,
    /// The ground-truth image: a file, or pixels in memory.
    pub image: ImageSource,
    /// Number of the physical camera, where the data name one or poses repeat; else of the view.
    pub camera_id: u32,
    /// Which pixels count in masked scores, and in the loss with [`Self::mask_loss`] ([`mask`](mod@crate::mask)): one channel, 0 does not count, 255 counts fully. None: all count.
    pub mask: Option<ImageSource>,
    /// Whether the alpha channel of the file is ignored and taken as 1.
    pub opaque: bool,
    /// Whether pixels outside [`Self::mask`] become transparent (`data.cut_out`).
    pub cut_out: bool,
    /// Whether pixels outside [`Self::mask`] are left out of the loss (`data.mask_loss`).
    pub mask_loss: bool,
    /// Camera-space z, where the data have it.
    pub depth: Option<DepthMap>,
    /// `.npy` file `[H, W]` of whole-number segment labels, where the data have one.
    pub labels: Option<PathBuf>,
}

impl View {
    /// A view without distortion, mask, depth and labels, whose alpha counts.
    pub fn new(name: impl Into<String>, camera: Camera, time: Time, image: ImageSource, camera_id: u32) -> Self {
        Self {
            name: name.into(),
            camera,
            stored: None,
            lens: None,
            time,
            image,
            camera_id,
            mask: None,
            opaque: false,
            cut_out: false,
            mask_loss: false,
            depth: None,
            labels: None,
        }
    }

    /// Scales the camera; the [`ImageCache`](crate::ImageCache) averages the image down to it.
    pub(crate) fn shrink(&mut self, scale: f64) {
        self.stored = Some([self.camera.width, self.camera.height]);
        self.camera = self.camera.scaled(scale);
    }
}

/// Which list of a [`Dataset`](crate::Dataset) a view is in.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Split {
    /// Views that training learns from.
    Train,
    /// Validation views, scored during training.
    Val,
    /// Held-out views within the training span, as a rule.
    Test,
    /// Views of all cameras that are later than every training view.
    Extrapolate,
}

impl Split {
    /// All splits, in this order.
    pub const ALL: [Self; 4] = [Self::Train, Self::Val, Self::Test, Self::Extrapolate];
}

/// Coloured points, one row each in both columns.
#[derive(Clone, Debug, PartialEq, Default)]
pub struct PointCloud {
    /// Positions of the points, world units.
    pub positions: Vec<Vec3>,
    /// Display-encoded RGB in 0..1, one row per position.
    pub colors: Vec<[f32; 3]>,
}
