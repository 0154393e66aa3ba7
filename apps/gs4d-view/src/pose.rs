//! Posing of an avatar, and the images its textures come from.

use glam::DVec3;
use gs_method_texel::Dut;
use gs_texel::Pose;
use gs_train::timestamp::Timestamp;
use serde::Deserialize;
use serde_json::{Value, json};

/// Most rotated joints of a question.
const MAX_ROTATIONS: usize = 256;

/// A pose: that of a frame, with some joints rotated.
#[derive(Clone, Debug, Default, Deserialize, PartialEq)]
#[serde(deny_unknown_fields)]
pub struct Posing {
    /// Normalised time of the frame whose pose is used; `None`: the time of the images.
    #[serde(default)]
    pub from: Option<f32>,
    /// Joint indices, and rotations about the joint's own x, y and z axes, radians.
    #[serde(default)]
    pub turns: Vec<(u32, [f64; 3])>,
}

impl Posing {
    /// Checks that angles, times and their number are within limits.
    pub(crate) fn check(&self) -> Result<(), String> {
        let angles_ok = self.turns.iter().flat_map(|t| t.1).all(|angle| angle.abs() <= 10.0);
        match angles_ok && self.turns.len() <= MAX_ROTATIONS && self.from.is_none_or(|t| t.abs() <= 100.0) {
            true => Ok(()),
            false => Err("a pose turns a few joints by at most 10 radians".into()),
        }
    }

    /// The pose of `avatar`, whose images are those at the normalised time `time`.
    ///
    /// # Errors
    /// A message, if there is no such joint.
    pub fn of(&self, avatar: &Dut, time: f32) -> Result<Pose, String> {
        let scene = avatar.scene();
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

/// Names of the joints, as a JSON array.
pub fn joints(avatar: &Dut) -> Value {
    let skeleton = &avatar.scene().character.skeleton;
    let name = |j: &gs_texel::Joint| skeleton.nodes.get(j.node as usize).map_or("", |n| n.name.as_str());
    json!(skeleton.joints.iter().map(name).collect::<Vec<_>>())
}

/// Number of the frame whose images give the textures at a normalised time, and the names of its cameras, as JSON.
pub fn inputs(avatar: &Dut, time: f32) -> Value {
    let frame = avatar.scene().frame_at(Timestamp::normalised(time).t);
    let cameras: Vec<&str> = frame.inputs.iter().map(|v| v.name.as_str()).collect();
    json!({"frame": frame.number, "images": cameras})
}
