//! The motion of one skeleton on another that has joints of the same meaning.
//!
//! With `S` the orientations of the source's joints in the world and `T` those of the target's, a bar where they are at rest:
//! ```text
//! T_n(t) = S_m(t) S̄_mᵀ A_n T̄_n
//! ```
//! for a joint `n` that corresponds to `m`; `A_n` is the smallest rotation from the direction of the target's bone at rest to that
//! of the source's, so that a motion from a T-pose fits a template in an A-pose. Joints without a partner stay at rest. The
//! uppermost joint with a partner moves as its partner does, times the ratio of the skeletons' bones.

use crate::clip::{Channel, Clip, Interpolation, Target};
use crate::skeleton::Skeleton;
use crate::skin::{quat_of, rotation_of};
use glam::{DAffine3, DMat3, DQuat, DVec3};
use std::collections::BTreeMap;

/// A motion that cannot be brought to a skeleton.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum RetargetError {
    /// No joint of one skeleton has the meaning of a joint of the other.
    #[error("no joint of the motion ({motion}) is known under a name of the skeleton ({skeleton}); name partners")]
    NoPartner {
        /// Names of the motion's first joints.
        motion: String,
        /// Names of the skeleton's first joints.
        skeleton: String,
    },
    /// A name that was given belongs to no joint.
    #[error("`{name}` is no joint of the {of}; it has {known}")]
    Unknown {
        /// The name given.
        name: String,
        /// Which of both: `motion` or `skeleton`.
        of: &'static str,
        /// Names there are.
        known: String,
    },
    /// The motion has no key.
    #[error("the motion has no keys")]
    Still,
}

/// A motion on another skeleton.
#[derive(Clone, Debug, PartialEq)]
pub struct Retargeted {
    /// The motion; rows of the target's nodes.
    pub clip: Clip,
    /// Rows of corresponding nodes: of the target, of the source.
    pub partners: Vec<(u32, u32)>,
    /// Length of the target's bones over that of the source's: the factor on how far it moves.
    pub scale: f64,
}

/// Brings `clip`, a motion of `source`, to `target`. Joints correspond if `names` says so (target's name to source's), if they
/// have the same name, or if both names mean the same part of a body in a common convention ([`part`]).
///
/// # Errors
/// [`RetargetError`] if no joints correspond, or a name in `names` is none.
///
/// ```
/// use gs_texel::figure::person;
/// use gs_texel::retarget::retarget;
/// use std::collections::BTreeMap;
///
/// // A person's walk on a person twice as tall.
/// let small = person();
/// let mut tall = small.skeleton.clone();
/// tall.nodes.iter_mut().for_each(|n| n.rest.translation *= 2.0);
/// let walk = small.clip("walk").expect("clip");
/// let moved = retarget(&small.skeleton, walk, &tall, &BTreeMap::new())?;
/// assert_eq!((moved.scale, moved.partners.len()), (2.0, 17));
/// # Ok::<(), gs_texel::retarget::RetargetError>(())
/// ```
pub fn retarget(
    source: &Skeleton,
    clip: &Clip,
    target: &Skeleton,
    names: &BTreeMap<String, String>,
) -> Result<Retargeted, RetargetError> {
    let partners = partners(source, target, names)?;
    let mut times: Vec<f64> = clip.channels.iter().flat_map(|c| c.times.iter().copied()).collect();
    times.sort_by(f64::total_cmp);
    times.dedup();
    if times.is_empty() {
        return Err(RetargetError::Still);
    }
    let rest = [source, target].map(|s| s.globals(&s.rest_pose()));
    let align: Vec<DMat3> = (0..partners.len()).map(|k| alignment(k, &partners, target, &rest)).collect();
    let scale = bones(&partners, target, &rest);
    // Parents come before children, so the first partner is an uppermost one.
    let root = partners[0];
    let mut turns: BTreeMap<u32, Vec<f64>> = partners.iter().map(|p| (p.0, Vec::new())).collect();
    let mut places = Vec::new();
    for &t in &times {
        let moved = source.globals(&clip.pose(source, t));
        let mut pose = target.rest_pose();
        for (n, node) in target.nodes.iter().enumerate() {
            let Some(k) = partners.iter().position(|p| p.0 as usize == n) else { continue };
            let m = partners[k].1 as usize;
            let turned = turn(&moved[m]) * turn(&rest[0][m]).transpose();
            let world = turned * align[k] * turn(&rest[1][n]);
            // Only what lies above a node decides its parent's frame.
            let parent = node.parent.map_or(DAffine3::IDENTITY, |p| above(target, &pose, p));
            let local = &mut pose.locals[n];
            local.rotation = quat_of(&(turn(&parent).transpose() * world));
            if n == root.0 as usize {
                local.translation = parent.inverse().transform_point3(scale * moved[m].translation);
                places.extend(local.translation.to_array());
            }
            if let Some(turns) = turns.get_mut(&(n as u32)) {
                turns.extend(local.rotation);
            }
        }
    }
    let channel =
        |target, values| Channel { target, interpolation: Interpolation::Linear, times: times.clone(), values };
    let mut channels = vec![channel(Target::Translation(root.0), places)];
    channels.extend(turns.into_iter().map(|(n, values)| channel(Target::Rotation(n), values)));
    Ok(Retargeted { clip: Clip { name: clip.name.clone(), channels }, partners, scale })
}

/// The rotation of a frame; none for one that has no volume.
fn turn(frame: &DAffine3) -> DMat3 {
    rotation_of(frame.matrix3).unwrap_or(DMat3::IDENTITY)
}

/// The frame of a node in the world.
fn above(skeleton: &Skeleton, pose: &crate::skeleton::Pose, node: u32) -> DAffine3 {
    let chain: Vec<u32> = std::iter::successors(Some(node), |n| skeleton.nodes[*n as usize].parent).collect();
    chain.iter().rev().fold(DAffine3::IDENTITY, |frame, n| frame * pose.locals[*n as usize].affine())
}

/// The partners among the descendants of partner `k` that have no partner in between: the ends of its bones.
fn ends(k: usize, partners: &[(u32, u32)], target: &Skeleton) -> Vec<usize> {
    let mut ends = Vec::new();
    for (other, p) in partners.iter().enumerate() {
        let mut up = target.nodes[p.0 as usize].parent;
        while let Some(node) = up {
            if node == partners[k].0 {
                ends.push(other);
                break;
            }
            if partners.iter().any(|p| p.0 == node) {
                break;
            }
            up = target.nodes[node as usize].parent;
        }
    }
    ends
}

/// The smallest rotation from the bone of partner `k` in the target to that in the source, both at rest; none where several bones
/// begin, or none. A joint at the end of a limb turns with the bone above it.
fn alignment(k: usize, partners: &[(u32, u32)], target: &Skeleton, rest: &[Vec<DAffine3>; 2]) -> DMat3 {
    match ends(k, partners, target)[..] {
        [end] => {
            let [from, to] = [partners[k], partners[end]];
            let bone = |of: usize, a: u32, b: u32| rest[of][b as usize].translation - rest[of][a as usize].translation;
            let [a, b] = [bone(1, from.0, to.0), bone(0, from.1, to.1)].map(DVec3::try_normalize);
            a.zip(b).map_or(DMat3::IDENTITY, |(a, b)| DMat3::from_quat(DQuat::from_rotation_arc(a, b)))
        }
        [] => {
            let above = (0..partners.len()).find(|&p| ends(p, partners, target).contains(&k));
            above
                .filter(|&p| ends(p, partners, target).len() == 1)
                .map_or(DMat3::IDENTITY, |p| alignment(p, partners, target, rest))
        }
        _ => DMat3::IDENTITY,
    }
}

/// Length of the target's bones between partners over that of the source's.
fn bones(partners: &[(u32, u32)], target: &Skeleton, rest: &[Vec<DAffine3>; 2]) -> f64 {
    let mut lengths = [0.0; 2];
    for k in 0..partners.len() {
        for end in ends(k, partners, target) {
            let (from, to) = (partners[k], partners[end]);
            lengths[0] += rest[0][from.1 as usize].translation.distance(rest[0][to.1 as usize].translation);
            lengths[1] += rest[1][from.0 as usize].translation.distance(rest[1][to.0 as usize].translation);
        }
    }
    let ratio = lengths[1] / lengths[0];
    if ratio.is_finite() && ratio > 0.0 { ratio } else { 1.0 }
}

/// Corresponding nodes, ascending in the target's row.
fn partners(
    source: &Skeleton,
    target: &Skeleton,
    names: &BTreeMap<String, String>,
) -> Result<Vec<(u32, u32)>, RetargetError> {
    let list = |s: &Skeleton| {
        let named: Vec<&str> = s.nodes.iter().map(|n| n.name.as_str()).filter(|n| !n.is_empty()).collect();
        let more = if named.len() > 24 { ", …" } else { "" };
        format!("{}{more}", named.into_iter().take(24).collect::<Vec<_>>().join(", "))
    };
    let find = |skeleton: &Skeleton, name: &str, of| {
        skeleton.node(name).ok_or_else(|| RetargetError::Unknown { name: name.into(), of, known: list(skeleton) })
    };
    let mut found: BTreeMap<u32, u32> = BTreeMap::new();
    for (of_target, of_source) in names {
        found.insert(find(target, of_target, "skeleton")?, find(source, of_source, "motion")?);
    }
    let given: Vec<u32> = found.values().copied().collect();
    // Of several joints that are one part of a body, such as those of a spine, the last turns with all of them.
    let mut by_part: BTreeMap<String, u32> = BTreeMap::new();
    for (m, node) in source.nodes.iter().enumerate().filter(|(m, _)| !given.contains(&(*m as u32))) {
        by_part.extend(part(&node.name).map(|part| (part, m as u32)));
    }
    let mut taken: BTreeMap<String, u32> = BTreeMap::new();
    for (n, node) in target.nodes.iter().enumerate().filter(|(_, node)| !node.name.is_empty()) {
        let n = n as u32;
        if found.contains_key(&n) {
            continue;
        }
        if let Some(m) = source.node(&node.name).filter(|m| !given.contains(m)) {
            found.insert(n, m);
        } else if let Some((part, m)) = part(&node.name).and_then(|p| by_part.get(&p).map(|m| (p, *m))) {
            if let Some(before) = taken.insert(part, n) {
                found.remove(&before);
            }
            found.insert(n, m);
        }
    }
    if found.is_empty() {
        return Err(RetargetError::NoPartner { motion: list(source), skeleton: list(target) });
    }
    Ok(found.into_iter().collect())
}

/// Words for the parts of a body, by part; the first that a name contains counts.
const PARTS: [(&str, &[&str]); 14] = [
    ("toe", &["toe", "ball"]),
    ("hand", &["hand", "wrist"]),
    ("foot", &["foot", "ankle"]),
    ("forearm", &["forearm", "lowerarm", "elbow", "lowarm"]),
    ("clavicle", &["clavicle", "collar"]),
    ("upperarm", &["upperarm", "uparm"]),
    ("thigh", &["thigh", "upleg", "upperleg"]),
    ("shin", &["shin", "calf", "knee", "lowerleg", "lowleg"]),
    ("head", &["head"]),
    ("neck", &["neck"]),
    ("chest", &["chest", "spine2", "spine3", "upperspine"]),
    ("spine", &["spine", "abdomen", "lowerback", "torso"]),
    ("hips", &["hips", "pelvis"]),
    ("root", &["armature"]),
];

/// The part of a body that a joint's name means, with its side, in the conventions of CMU, Mixamo, Rokoko, Blender and VRM; none for
/// names that mean none, such as fingers.
///
/// ```
/// use gs_texel::retarget::part;
///
/// assert_eq!(part("mixamorig:LeftForeArm").as_deref(), Some("left forearm"));
/// assert_eq!(part("forearm.L"), part("left fore arm"));
/// assert_eq!(part("J_Bip_L_LowerArm"), part("left fore arm"));
/// assert_eq!((part("LeftArm").as_deref(), part("LeftLeg").as_deref()), (Some("left upperarm"), Some("left shin")));
/// assert_eq!(part("LeftHandThumb1"), None);
/// ```
pub fn part(name: &str) -> Option<String> {
    let own = name.rsplit([':', '|']).next().unwrap_or(name);
    let lower = own.to_lowercase();
    let words: String = lower.chars().filter(|c| c.is_alphanumeric()).collect();
    if ["thumb", "index", "middle", "ring", "pinky", "finger", "end", "nub", "twist", "roll"]
        .iter()
        .any(|w| words.contains(w))
    {
        return None;
    }
    let one = |side: &str| {
        // forearm.L, J_Bip_L_LowerArm.
        let apart = lower.split(['.', '_', ' ', '-']).any(|word| word == side);
        // lThigh, LThigh.
        let mut letters = own.chars();
        let first = letters.next().is_some_and(|c| c.to_lowercase().eq(side.chars()));
        apart || first && letters.next().is_some_and(char::is_uppercase)
    };
    let side = match () {
        () if words.contains("left") => "left ",
        () if words.contains("right") => "right ",
        () if one("l") => "left ",
        () if one("r") => "right ",
        () => "",
    };
    let found = PARTS.iter().find(|(_, known)| known.iter().any(|w| words.contains(w))).map(|p| p.0);
    // Bare words: an arm is the upper one, a leg the lower one; a shoulder is the clavicle, as in CMU and Mixamo.
    let bare = || {
        let bare = [("arm", "upperarm"), ("leg", "shin"), ("shoulder", "clavicle"), ("hip", "thigh")];
        bare.into_iter().find(|(w, _)| !side.is_empty() && words.contains(w)).map(|p| p.1)
    };
    found.filter(|p| *p != "root").or_else(bare).map(|part| format!("{side}{part}"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::figure::person;
    use crate::skeleton::{axis_angle, rotation_matrix};
    use gs_core::{Rng, rot};

    const TIMES: [f64; 4] = [0.0, 0.21, 0.5, 0.93];

    fn moved(skeleton: &Skeleton, clip: &Clip, t: f64) -> Vec<DAffine3> {
        skeleton.globals(&clip.pose(skeleton, t))
    }

    /// Largest angle between the bones of two skeletons with the same joints, radians.
    fn apart(a: &[DAffine3], b: &[DAffine3], skeleton: &Skeleton) -> f64 {
        let bone = |g: &[DAffine3], n: usize, p: u32| (g[n].translation - g[p as usize].translation).normalize();
        let bones = skeleton.nodes.iter().enumerate().filter_map(|(n, node)| node.parent.map(|p| (n, p)));
        bones.map(|(n, p)| bone(a, n, p).angle_between(bone(b, n, p))).fold(0.0, f64::max)
    }

    #[test]
    fn on_its_own_skeleton_a_motion_stays_what_it_is() {
        let person = person();
        for clip in &person.clips {
            let same = retarget(&person.skeleton, clip, &person.skeleton, &BTreeMap::new()).unwrap();
            assert_eq!((same.scale, same.partners.len()), (1.0, 17));
            for t in TIMES.map(|t| t * clip.duration()) {
                let (a, b) = (moved(&person.skeleton, clip, t), moved(&person.skeleton, &same.clip, t));
                // Channels of the clip have the same keys, so nothing is interpolated anew.
                assert!(a.iter().zip(&b).all(|(a, b)| a.abs_diff_eq(*b, 1e-9)), "{} {t}", clip.name);
            }
        }
    }

    /// The skeleton with joints whose axes point anywhere, and the same places at rest.
    fn with_other_axes(skeleton: &Skeleton) -> Skeleton {
        let globals = skeleton.globals(&skeleton.rest_pose());
        let mut rng = Rng::new(3, "retarget", 0, 0);
        let mut random = || DVec3::from_array(std::array::from_fn(|_| f64::from(rng.range(-1.0, 1.0))));
        let frames: Vec<DAffine3> = globals
            .iter()
            .map(|g| DAffine3::from_mat3_translation(rotation_matrix(axis_angle(random(), 2.0)), g.translation))
            .collect();
        let mut other = skeleton.clone();
        for (n, node) in other.nodes.iter_mut().enumerate() {
            let local = node.parent.map_or(frames[n], |p| frames[p as usize].inverse() * frames[n]);
            (node.rest.rotation, node.rest.translation) = (quat_of(&local.matrix3), local.translation);
        }
        other
    }

    #[test]
    fn axes_and_units_of_the_joints_do_not_matter() {
        let person = person();
        let clip = person.clip("walk").unwrap();
        let mut other = with_other_axes(&person.skeleton);
        other.nodes.iter_mut().for_each(|n| n.rest.translation *= 100.0);
        let there = retarget(&person.skeleton, clip, &other, &BTreeMap::new()).unwrap();
        assert!((there.scale - 100.0).abs() < 1e-9);
        let back = retarget(&other, &there.clip, &person.skeleton, &BTreeMap::new()).unwrap();
        for t in TIMES {
            let (a, b, c) = (
                moved(&person.skeleton, clip, t),
                moved(&other, &there.clip, t),
                moved(&person.skeleton, &back.clip, t),
            );
            for ((a, b), c) in a.iter().zip(&b).zip(&c) {
                assert!(
                    (100.0 * a.translation).abs_diff_eq(b.translation, 1e-3),
                    "{t} {} {}",
                    a.translation,
                    b.translation
                );
                assert!(a.abs_diff_eq(*c, 1e-4), "{t}");
            }
        }
    }

    #[test]
    fn a_template_in_an_a_pose_makes_the_motion_of_a_t_pose() {
        let person = person();
        let clip = person.clip("wave").unwrap();
        let mut lowered = person.skeleton.clone();
        for (joint, degrees) in [("left upper arm", -50.0f64), ("right upper arm", 50.0), ("left shin", 5.0)] {
            let n = lowered.node(joint).unwrap() as usize;
            let rest = &mut lowered.nodes[n].rest;
            rest.rotation = rot::hamilton(rest.rotation, axis_angle(DVec3::Z, degrees.to_radians()));
        }
        let fitted = retarget(&person.skeleton, clip, &lowered, &BTreeMap::new()).unwrap();
        for t in TIMES {
            let (a, b) = (moved(&person.skeleton, clip, t), moved(&lowered, &fitted.clip, t));
            assert!(apart(&a, &b, &lowered) < 1e-6, "{t}: {}", apart(&a, &b, &lowered));
        }
    }

    #[test]
    fn a_side_may_stand_inside_a_name() {
        for (name, meaning) in [
            ("J_Bip_L_UpperArm", "left upperarm"),
            ("J_Bip_R_LowerLeg", "right shin"),
            ("J_Bip_R_Shoulder", "right clavicle"),
            ("J_Bip_C_Hips", "hips"),
            ("Bip01 L Thigh", "left thigh"),
            ("upper_arm.R.001", "right upperarm"),
        ] {
            assert_eq!(part(name).as_deref(), Some(meaning), "{name}");
        }
        assert_eq!(part("J_Bip_L_Thumb1"), None);
    }

    #[test]
    fn conventions_meet_and_partners_can_be_named() {
        let person = person();
        let clip = person.clip("walk").unwrap();
        let mixamo = [
            ("hips", "mixamorig:Hips"),
            ("spine", "mixamorig:Spine"),
            ("chest", "mixamorig:Spine2"),
            ("neck", "mixamorig:Neck"),
            ("head", "mixamorig:Head"),
            ("left upper arm", "mixamorig:LeftArm"),
            ("left fore arm", "mixamorig:LeftForeArm"),
            ("left hand", "mixamorig:LeftHand"),
            ("right thigh", "mixamorig:RightUpLeg"),
            ("right shin", "mixamorig:RightLeg"),
            ("right foot", "mixamorig:RightFoot"),
        ];
        let mut other = person.skeleton.clone();
        other.nodes.iter_mut().for_each(|n| n.name = mixamo.iter().find(|m| m.0 == n.name).map_or("", |m| m.1).into());
        let there = retarget(&person.skeleton, clip, &other, &BTreeMap::new()).unwrap();
        let own: Vec<(u32, u32)> = mixamo.iter().map(|m| person.skeleton.node(m.0).unwrap()).map(|n| (n, n)).collect();
        assert_eq!(there.partners, {
            let mut own = own;
            own.sort_unstable();
            own
        });
        other.nodes.iter_mut().for_each(|n| n.name = format!("bone {}", n.name.len()));
        let refused = retarget(&person.skeleton, clip, &other, &BTreeMap::new()).unwrap_err();
        assert!(matches!(refused, RetargetError::NoPartner { .. }));
        let names = |a: &str, b: &str| BTreeMap::from([(a.to_owned(), b.to_owned())]);
        let first = other.nodes[0].name.clone();
        let named = retarget(&person.skeleton, clip, &other, &names(&first, "hips")).unwrap();
        assert_eq!(named.partners, [(0, 0)]);
        let unknown = retarget(&person.skeleton, clip, &other, &names(&first, "tail")).unwrap_err();
        assert!(unknown.to_string().starts_with("`tail` is no joint of the motion; it has hips, spine"), "{unknown}");
        assert_eq!(
            retarget(&person.skeleton, &Clip::default(), &person.skeleton, &BTreeMap::new()),
            Err(RetargetError::Still)
        );
    }
}
