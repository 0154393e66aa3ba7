//! Other poses for a filmed person, and which images its looks come from.

use glam::DVec3;
use gs_method_texel::Dut;
use gs_texel::Pose;
use gs_train::timestamp::Timestamp;
use serde::Deserialize;
use serde_json::{Value, json};

/// Most turned joints of a question.
const MOST_TURNS: usize = 256;

/// A pose that is wanted.
#[derive(Clone, Debug, Default, Deserialize, PartialEq)]
#[serde(deny_unknown_fields)]
pub struct Posing {
    /// Normalised time of the frame whose pose is taken; that of the images if absent.
    #[serde(default)]
    pub from: Option<f32>,
    /// Numbers of joints, and by how much each is turned about its own x, y and z, radians.
    #[serde(default)]
    pub turns: Vec<(u32, [f64; 3])>,
}

impl Posing {
    /// Whether its numbers make sense.
    pub fn is_sound(&self) -> bool {
        let turned = self.turns.iter().flat_map(|t| t.1).all(|angle| angle.abs() <= 10.0);
        turned && self.turns.len() <= MOST_TURNS && self.from.is_none_or(|t| t.abs() <= 100.0)
    }

    /// The pose, for a figure whose images are those of a normalised time.
    ///
    /// # Errors
    /// In words, if it has no such joint.
    pub fn of(&self, figure: &Dut, time: f32) -> Result<Pose, String> {
        let scene = figure.scene();
        let mut pose = scene.frame_at(Timestamp::normalised(self.from.unwrap_or(time)).t).pose.clone();
        for (number, angles) in &self.turns {
            let joint = scene.character.skeleton.joints.get(*number as usize).ok_or("there is no such joint")?;
            for (axis, angle) in [DVec3::X, DVec3::Y, DVec3::Z].into_iter().zip(angles) {
                pose.turn(joint.node, axis, *angle);
            }
        }
        Ok(pose)
    }
}

/// Names of a figure's joints.
pub fn joints(figure: &Dut) -> Value {
    let skeleton = &figure.scene().character.skeleton;
    let name = |j: &gs_texel::Joint| skeleton.nodes.get(j.node as usize).map_or("", |n| n.name.as_str());
    json!(skeleton.joints.iter().map(name).collect::<Vec<_>>())
}

/// The frame whose images give the looks at a normalised time, and the cameras that took them.
pub fn inputs(figure: &Dut, time: f32) -> Value {
    let frame = figure.scene().frame_at(Timestamp::normalised(time).t);
    let cameras: Vec<&str> = frame.inputs.iter().map(|v| v.name.as_str()).collect();
    json!({"frame": frame.number, "images": cameras})
}
