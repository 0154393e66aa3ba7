//! Animations of a glTF file.

use super::accessors::Data;
use super::error::CharacterError;
use super::meshes::MorphBlock;
use super::nodes::Nodes;
use crate::character::Fallbacks;
use crate::clip::{Channel, Clip, Interpolation, Target};
use gltf::json::accessor::Type;
use gltf::json::animation::{self, Property};
use gltf::json::validation::Checked;

pub(super) fn read(
    data: &Data<'_>,
    nodes: &Nodes,
    morphs: &[MorphBlock],
    fallbacks: &mut Fallbacks,
) -> Result<Vec<Clip>, CharacterError> {
    let mut clips = Vec::with_capacity(data.root.animations.len());
    for (i, animation) in data.root.animations.iter().enumerate() {
        let mut clip = Clip { name: animation.name.clone().unwrap_or_default(), channels: Vec::new() };
        for (k, source) in animation.channels.iter().enumerate() {
            let place = format!("animation {i}, channel {k}");
            match target(data, source, nodes, morphs, &place)? {
                Some(target) => clip.channels.push(channel(data, animation, source, target, &place)?),
                None => fallbacks.ignored_channels += 1,
            }
        }
        clips.push(clip);
    }
    Ok(clips)
}

/// The target of a channel; `None` for weights of a mesh that has no morphs or is not in the scene.
fn target(
    data: &Data<'_>,
    channel: &animation::Channel,
    nodes: &Nodes,
    morphs: &[MorphBlock],
    place: &str,
) -> Result<Option<Target>, CharacterError> {
    let node = channel.target.node.value();
    let node = *nodes.place.get(node).ok_or_else(|| data.malformed(place, format!("moves node {node}, of none")))?;
    Ok(match channel.target.path {
        Checked::Valid(Property::Translation) => Some(Target::Translation(node)),
        Checked::Valid(Property::Rotation) => Some(Target::Rotation(node)),
        Checked::Valid(Property::Scale) => Some(Target::Scale(node)),
        Checked::Valid(Property::MorphTargetWeights) => {
            let block = morphs.iter().find(|b| b.node == node && b.count > 0);
            block.map(|b| Target::Morphs { first: b.first, count: b.count })
        }
        Checked::Invalid => None,
    })
}

fn channel(
    data: &Data<'_>,
    animation: &animation::Animation,
    source: &animation::Channel,
    target: Target,
    place: &str,
) -> Result<Channel, CharacterError> {
    let sampler = animation.samplers.get(source.sampler.value());
    let sampler = sampler.ok_or_else(|| data.malformed(place, "has a sampler that does not exist"))?;
    let interpolation = match sampler.interpolation {
        Checked::Valid(animation::Interpolation::Step) => Interpolation::Step,
        Checked::Valid(animation::Interpolation::Linear) => Interpolation::Linear,
        Checked::Valid(animation::Interpolation::CubicSpline) => Interpolation::Cubic,
        Checked::Invalid => return Err(data.malformed(place, "has an unknown interpolation")),
    };
    let times = data.table(sampler.input, &[Type::Scalar])?.values;
    if times.is_empty() || !times.is_sorted_by(|a, b| a <= b) {
        return Err(data.malformed(place, "has no keys, or keys that go back in time"));
    }
    let kind = match target {
        Target::Rotation(_) => Type::Vec4,
        Target::Morphs { .. } => Type::Scalar,
        _ => Type::Vec3,
    };
    let mut values = data.table(sampler.output, &[kind])?.values;
    let per_key = target.width() * if interpolation == Interpolation::Cubic { 3 } else { 1 };
    if values.len() != times.len().saturating_mul(per_key) {
        let (have, keys) = (values.len(), times.len());
        return Err(data.malformed(place, format!("has {have} values for {keys} keys of {per_key}")));
    }
    if matches!(target, Target::Rotation(_)) {
        values.as_chunks_mut::<4>().0.iter_mut().for_each(|q| q.rotate_right(1));
    }
    Ok(Channel { target, interpolation, times, values })
}
