//! How far the outlines of a posed template are from those of its images, by camera and by joint.

use serde::Serialize;

/// How far the outlines of the posed template are from those of the images, whatever the verdict.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Outlines {
    /// Means over the compared views of each camera.
    pub cameras: Vec<CameraOutlines>,
    /// Means over the parts of the outline that each joint moves, over all compared views; farthest first.
    pub joints: Vec<JointOutlines>,
}

/// Outlines in one camera.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CameraOutlines {
    /// Number of the camera.
    pub camera: u32,
    /// Number of views compared.
    pub views: usize,
    /// Mean distance, metres.
    pub metres: f64,
}

/// Outlines that one joint moves.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct JointOutlines {
    /// Name of the joint.
    pub joint: String,
    /// Mean distance, metres.
    pub metres: f64,
}

impl Outlines {
    /// A text table of both, centimetres.
    pub fn text(&self) -> String {
        let mut out = format!("{:<24}{:>6}{:>9}\n", "outlines in camera", "views", "cm apart");
        for CameraOutlines { camera, views, metres } in &self.cameras {
            out.push_str(&format!("{camera:<24}{views:>6}{:>9.2}\n", 100.0 * metres));
        }
        out.push_str(&format!("{:<24}{:>15}\n", "outlines moved by joint", "cm apart"));
        for JointOutlines { joint, metres } in &self.joints {
            out.push_str(&format!("{joint:<24}{:>15.2}\n", 100.0 * metres));
        }
        out
    }
}
