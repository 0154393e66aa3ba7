//! What is imported, and how.

use crate::colmap::CameraModel;
use crate::look::Rig;
use crate::rates::Taking;
use serde::{Deserialize, Serialize};
use std::path::PathBuf;

/// What is imported.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Source {
    /// Videos, one per camera.
    Videos(Vec<PathBuf>),
    /// A folder of the images of one camera, or of one such folder per camera.
    Images(PathBuf),
}

/// How it is imported.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Settings {
    /// What the cameras do; none: it is found out.
    pub rig: Option<Rig>,
    /// Images of a scene at rest, in any order: they get no times.
    pub unordered: bool,
    /// Frames of videos; of images, `fps` alone (30 if it is not given).
    pub taking: Taking,
    /// Factor on the size of frames.
    pub scale: f64,
    /// Longest side of frames, pixels.
    pub longest: Option<u32>,
    /// Seconds by which what the first video shows at a time is later in each video, in place of what is found.
    pub offsets: Option<Vec<f64>>,
    /// Look for such offsets.
    pub sync: bool,
    /// Folder of masks.
    pub masks: Option<PathBuf>,
    /// Model of the cameras; none: SIMPLE_RADIAL of a rig, OPENCV of a moving camera.
    pub model: Option<CameraModel>,
    /// All cameras have one lens and one zoom.
    pub same_lens: bool,
    /// Known horizontal field of view, degrees.
    pub fov: Option<f64>,
    /// Moments at which a rig is reconstructed; none: as many as make some 60 images, at most 4.
    pub moments: Option<u32>,
    /// Frames of moving cameras, or images in any order, that are reconstructed together; the others are placed afterwards.
    pub keyframes: u32,
    /// Keep blurred and duplicate frames.
    pub keep_all: bool,
    /// Camera of a rig that is held out for scores; none: the most central one of at least five.
    pub held_out: Option<u32>,
    /// Let COLMAP use the graphics card.
    pub gpu: bool,
    /// Most memory for decoding one image, MiB; none: 64 MiB plus eight times the size of its file. Each call has its own.
    #[serde(skip)]
    pub max_image_mib: Option<u32>,
}

impl Default for Settings {
    fn default() -> Self {
        Self {
            rig: None,
            unordered: false,
            taking: Taking { fps: None, max_frames: 300, start: 0.0, duration: None },
            scale: 1.0,
            longest: None,
            offsets: None,
            sync: true,
            masks: None,
            model: None,
            same_lens: false,
            fov: None,
            moments: None,
            keyframes: 100,
            keep_all: false,
            held_out: None,
            gpu: false,
            max_image_mib: None,
        }
    }
}
