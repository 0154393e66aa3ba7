//! Nodes of a binary glTF file, and where they put its splats at a time.

use super::error::{At, Source};
use super::glb::FLIPPED;
use super::glb_read::Reader;
use super::{IoError, Limits, RawSplats};
use glam::{DMat3, DMat4, DQuat, DVec3, Vec3};
use serde_json::Value;
use std::collections::BTreeMap;
use std::sync::Arc;

/// Most nodes above one another.
const MAX_DEPTH: usize = 64;
/// Largest difference of the scales of a node's axes, and of their products from 0, relative.
const SIMILAR: f64 = 1e-4;
/// Coordinates and scales are below this and scales above its inverse: far from the ends of `f32`, squares included.
const LIMIT: f64 = 1e18;
const ADVICE: &str = "write the file again";

/// The splats of a binary glTF file under its nodes.
#[derive(Clone, Debug)]
pub struct GlbScene {
    nodes: Vec<Node>,
    /// Splats of each primitive, in glTF's axes.
    splats: Vec<RawSplats>,
    /// Primitives that are shown, and the node of each.
    shown: Vec<(usize, Option<usize>)>,
    duration: f32,
}

/// A node: where it lies in the one above it.
#[derive(Clone, Debug, Default)]
struct Node {
    parent: Option<usize>,
    rest: Placement,
    translation: Option<Arc<Track>>,
    rotation: Option<Arc<Track>>,
}

/// `p ↦ s R p + t`.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Placement {
    translation: DVec3,
    rotation: DQuat,
    scale: f64,
}

impl Default for Placement {
    fn default() -> Self {
        Self { translation: DVec3::ZERO, rotation: DQuat::IDENTITY, scale: 1.0 }
    }
}

impl Placement {
    /// This one after `inner`.
    fn after(&self, inner: &Self) -> Self {
        Self {
            translation: self.translation + self.rotation * (self.scale * inner.translation),
            rotation: self.rotation * inner.rotation,
            scale: self.scale * inner.scale,
        }
    }

    /// The splats under it.
    fn place(&self, mut splats: RawSplats) -> RawSplats {
        if self.rotation != DQuat::IDENTITY {
            splats = splats.mapped(&DMat3::from_quat(self.rotation).transpose().to_cols_array_2d());
        }
        if self.scale != 1.0 {
            let (factor, log) = (self.scale as f32, self.scale.ln() as f32);
            splats.means.iter_mut().for_each(|m| *m *= factor);
            splats.log_scales.iter_mut().for_each(|s| *s += log);
        }
        if self.translation != DVec3::ZERO {
            splats.means.iter_mut().for_each(|m| *m += self.translation.as_vec3());
        }
        splats
    }
}

/// Bytes of a key frame: a time and four values.
const KEY_BYTES: u64 = 36;

/// Key frames of a translation (three values) or a rotation (four, x, y, z, w).
#[derive(Clone, Debug)]
struct Track {
    times: Vec<f32>,
    values: Vec<[f64; 4]>,
    /// Whether a value holds until the next; else they are interpolated.
    steps: bool,
}

impl Track {
    /// The keys around a time and the weight of the second.
    fn at(&self, seconds: f32) -> Option<([f64; 4], [f64; 4], f64)> {
        let after = self.times.partition_point(|t| *t <= seconds).min(self.times.len().checked_sub(1)?);
        let before = after.saturating_sub(1);
        let (from, to) = (*self.times.get(before)?, *self.times.get(after)?);
        let share = if to > from { f64::from(((seconds - from) / (to - from)).clamp(0.0, 1.0)) } else { 0.0 };
        let share = if self.steps { share.floor() } else { share };
        Some((*self.values.get(before)?, *self.values.get(after)?, share))
    }

    fn translation(&self, seconds: f32) -> Option<DVec3> {
        let ([ax, ay, az, _], [bx, by, bz, _], share) = self.at(seconds)?;
        Some(DVec3::new(ax, ay, az).lerp(DVec3::new(bx, by, bz), share))
    }

    fn rotation(&self, seconds: f32) -> Option<DQuat> {
        let (a, b, share) = self.at(seconds)?;
        // The shorter way, as glTF asks for.
        Some(DQuat::from_array(a).normalize().slerp(DQuat::from_array(b).normalize(), share).normalize())
    }
}

impl GlbScene {
    /// The nodes of a file that show its primitives, given with the mesh of each.
    pub(super) fn of(
        reader: &Reader<'_>,
        primitives: Vec<(usize, RawSplats)>,
        file_bytes: usize,
        limits: &Limits,
    ) -> Result<Self, IoError> {
        let list = |name: &str| reader.document.get(name).and_then(Value::as_array).map_or(&[][..], Vec::as_slice);
        let src = reader.src;
        let mut nodes = list("nodes").iter().map(|n| node(n, src)).collect::<Result<Vec<_>, _>>()?;
        for (k, entry) in list("nodes").iter().enumerate() {
            for child in entry.get("children").and_then(Value::as_array).into_iter().flatten() {
                if let Some(child) = index(child).and_then(|c| nodes.get_mut(c)) {
                    child.parent = Some(k);
                }
            }
        }
        let mut of_mesh = BTreeMap::<usize, Vec<usize>>::new();
        primitives.iter().enumerate().for_each(|(p, (mesh, _))| of_mesh.entry(*mesh).or_default().push(p));
        let of_node = |n: &Value| {
            n.get("mesh").and_then(index).and_then(|mesh| of_mesh.get(&mesh)).map_or(&[][..], Vec::as_slice)
        };
        let count: u64 = list("nodes").iter().map(|n| of_node(n).len() as u64).fold(0, u64::saturating_add);
        limits.expansion(src, count.saturating_mul(size_of::<(usize, Option<usize>)>() as u64), file_bytes)?;
        let mut shown = Vec::new();
        for (k, entry) in list("nodes").iter().enumerate() {
            shown.extend(of_node(entry).iter().map(|p| (*p, Some(k))));
        }
        if shown.is_empty() {
            shown = (0..primitives.len()).map(|p| (p, None)).collect();
        }
        let rows = |p: &usize| primitives.get(*p).map_or(0, |(_, s)| s.len() as u64);
        let degree = primitives.iter().map(|(_, s)| s.degree).max().unwrap_or(0);
        let all: u64 = shown.iter().map(|(p, _)| rows(p)).fold(0, u64::saturating_add);
        limits.splats(src, all, RawSplats::row_bytes(degree))?;
        if shown.len() > primitives.len() {
            limits.expansion(src, all.saturating_mul(RawSplats::row_bytes(degree) as u64), file_bytes)?;
        }
        let splats = primitives.into_iter().map(|(_, s)| s).collect();
        let mut scene = Self { nodes, splats, shown, duration: 0.0 };
        if let Some(animation) = list("animations").first() {
            scene.animate(animation, reader, file_bytes, limits)?;
        }
        for (primitive, node) in &scene.shown {
            scene.depth(*node, src)?;
            scene.reach(*primitive, *node, src)?;
        }
        Ok(scene)
    }

    /// Fails if nodes may take splats farther than numbers reach.
    fn reach(&self, primitive: usize, mut node: Option<usize>, src: Source<'_>) -> Result<(), IoError> {
        let means = self.splats.get(primitive).map_or(&[][..], |s| s.means.as_slice());
        let farthest = means.iter().map(|m| m.abs().max_element()).fold(0.0, f32::max);
        let (mut reach, mut scale, mut plain) = (f64::from(farthest) * 2.0, 1.0f64, true);
        while let Some(n) = node.and_then(|k| self.nodes.get(k)) {
            let keys =
                n.translation.iter().flat_map(|t| &t.values).map(|v| v.map(f64::abs).into_iter().fold(0.0, f64::max));
            let moved = keys.fold(n.rest.translation.abs().max_element(), f64::max);
            (reach, scale) = (reach * n.rest.scale + 2.0 * moved, scale * n.rest.scale);
            plain &= n.rest == Placement::default() && n.translation.is_none() && n.rotation.is_none();
            node = n.parent;
        }
        if plain || reach < LIMIT && (1.0 / LIMIT..LIMIT).contains(&scale) {
            return Ok(());
        }
        Err(src.malformed(At::Byte(0), "nodes that take splats beyond the range of f32", ADVICE))
    }

    /// Seconds from 0 to the last key frame; 0 for a scene at rest.
    pub fn duration(&self) -> f32 {
        self.duration
    }

    /// The splats at a time in seconds, in the axes of `.ply` files; before and after the key frames as at the nearest.
    pub fn at(&self, seconds: f32) -> RawSplats {
        let mut all =
            RawSplats { degree: self.splats.iter().map(|s| s.degree).max().unwrap_or(0), ..RawSplats::default() };
        for (primitive, node) in &self.shown {
            if let Some(splats) = self.splats.get(*primitive) {
                append(&mut all, self.world(*node, seconds).place(splats.clone()));
            }
        }
        all.flipped(FLIPPED)
    }

    /// Where a node lies in the world.
    fn world(&self, mut node: Option<usize>, seconds: f32) -> Placement {
        let mut world = Placement::default();
        while let Some(n) = node.and_then(|k| self.nodes.get(k)) {
            let moved = n.translation.as_ref().and_then(|t| t.translation(seconds));
            let turned = n.rotation.as_ref().and_then(|t| t.rotation(seconds));
            let local = Placement {
                translation: moved.unwrap_or(n.rest.translation),
                rotation: turned.unwrap_or(n.rest.rotation),
                scale: n.rest.scale,
            };
            world = local.after(&world);
            node = n.parent;
        }
        world
    }

    /// Fails if a node lies too deep, or below itself.
    fn depth(&self, mut node: Option<usize>, src: Source<'_>) -> Result<(), IoError> {
        for _ in 0..MAX_DEPTH {
            match node.and_then(|k| self.nodes.get(k)) {
                Some(n) => node = n.parent,
                None => return Ok(()),
            }
        }
        Err(src.malformed(At::Byte(0), format!("nodes below one another, more than {MAX_DEPTH} or in a ring"), ADVICE))
    }

    /// Gives nodes their key frames; a sampler is read once, however many channels take it.
    fn animate(
        &mut self,
        animation: &Value,
        reader: &Reader<'_>,
        file_bytes: usize,
        limits: &Limits,
    ) -> Result<(), IoError> {
        let (mut tracks, mut keys) = (BTreeMap::<(usize, usize), Arc<Track>>::new(), 0u64);
        let list = |name: &str| animation.get(name).and_then(Value::as_array).map_or(&[][..], Vec::as_slice);
        for channel in list("channels") {
            let node = channel.pointer("/target/node").and_then(index).filter(|k| *k < self.nodes.len());
            let Some(node) = node.and_then(|k| self.nodes.get_mut(k)) else { continue };
            let path = channel.pointer("/target/path").and_then(Value::as_str).unwrap_or_default();
            let sampler = channel.get("sampler").and_then(index).and_then(|k| Some((k, list("samplers").get(k)?)));
            let sampler = sampler.ok_or_else(|| reader.src.missing(At::Byte(0), "animations[0].samplers", ADVICE))?;
            let track = match path {
                "translation" => &mut node.translation,
                "rotation" => &mut node.rotation,
                "scale" => return Err(reader.src.unsupported("an animated scale", "export motions that are rigid")),
                _ => continue,
            };
            let width = if path == "rotation" { 4 } else { 3 };
            let read = match tracks.get(&(sampler.0, width)) {
                Some(known) => known.clone(),
                None => {
                    let read = Arc::new(read_track(sampler.1, width, reader)?);
                    // Samplers may share their bytes.
                    keys = keys.saturating_add(read.times.len() as u64);
                    limits.expansion(reader.src, keys.saturating_mul(KEY_BYTES), file_bytes)?;
                    tracks.insert((sampler.0, width), read.clone());
                    read
                }
            };
            self.duration = self.duration.max(read.times.last().copied().unwrap_or(0.0));
            *track = Some(read);
        }
        Ok(())
    }
}

fn read_track(sampler: &Value, width: usize, reader: &Reader<'_>) -> Result<Track, IoError> {
    let src = reader.src;
    let steps = match sampler.get("interpolation").and_then(Value::as_str) {
        None | Some("LINEAR") => false,
        Some("STEP") => true,
        Some(other) => {
            return Err(src.unsupported(format!("the interpolation {other}"), "export linear key frames"));
        }
    };
    let accessor = |name: &str, width: usize| {
        let at = sampler.get(name).and_then(Value::as_u64);
        let at = at.ok_or_else(|| src.missing(At::Byte(0), format!("a sampler's {name}"), ADVICE))?;
        reader.accessor(at, &format!("a sampler's {name}"), width)
    };
    let ((_, times), (_, values)) = (accessor("input", 1)?, accessor("output", width)?);
    let values: Vec<[f64; 4]> =
        values.chunks_exact(width).map(|v| std::array::from_fn(|k| v.get(k).copied().map_or(0.0, f64::from))).collect();
    let ascending = times.is_sorted_by(|a, b| a < b) && times.iter().all(|t| t.is_finite());
    let finite = values.iter().flatten().all(|v| v.is_finite());
    let turns = width == 3 || values.iter().all(|q| q.iter().any(|v| *v != 0.0));
    if times.is_empty() || times.len() != values.len() || !ascending || !finite || !turns {
        let what = "key frames that are not one finite value for each of ascending times";
        return Err(src.malformed(At::Byte(0), what, ADVICE));
    }
    Ok(Track { times, values, steps })
}

fn index(value: &Value) -> Option<usize> {
    usize::try_from(value.as_u64()?).ok()
}

/// A node at rest.
fn node(entry: &Value, src: Source<'_>) -> Result<Node, IoError> {
    let bad = |what: &str| src.malformed(At::Byte(0), format!("a node's {what} is not what glTF has there"), ADVICE);
    let unequal = || {
        let advice = "apply the node's scale before exporting";
        src.unsupported("a node that mirrors, shears or scales its axes unequally", advice)
    };
    let rest = if let Some(matrix) = entry.get("matrix") {
        let matrix = DMat4::from_cols_array(&numbers::<16>(matrix).ok_or_else(|| bad("matrix"))?);
        let axes = DMat3::from_mat4(matrix);
        let scale = axes.determinant().max(0.0).cbrt();
        let gram = axes.transpose() * axes - DMat3::from_diagonal(DVec3::splat(scale * scale));
        if !(scale > 0.0 && gram.to_cols_array().iter().all(|v| v.abs() <= SIMILAR * scale * scale)) {
            return Err(unequal());
        }
        let rotation = DQuat::from_mat3(&(axes * (1.0 / scale))).normalize();
        Placement { translation: matrix.w_axis.truncate(), rotation, scale }
    } else {
        let of = |name: &str| entry.get(name);
        let translation = of("translation").map_or(Some([0.0; 3]), numbers::<3>).ok_or_else(|| bad("translation"))?;
        let rotation =
            of("rotation").map_or(Some([0.0, 0.0, 0.0, 1.0]), numbers::<4>).ok_or_else(|| bad("rotation"))?;
        let [x, y, z] = of("scale").map_or(Some([1.0; 3]), numbers::<3>).ok_or_else(|| bad("scale"))?;
        if !(x > 0.0 && (y - x).abs() <= SIMILAR * x && (z - x).abs() <= SIMILAR * x) {
            return Err(unequal());
        }
        let rotation = DQuat::from_array(rotation);
        if rotation.length() == 0.0 {
            return Err(bad("rotation"));
        }
        let rotation = if rotation == DQuat::IDENTITY { rotation } else { rotation.normalize() };
        Placement { translation: translation.into(), rotation, scale: x }
    };
    Ok(Node { rest, ..Node::default() })
}

/// A list of `N` finite numbers.
fn numbers<const N: usize>(value: &Value) -> Option<[f64; N]> {
    let list: Vec<f64> = value.as_array()?.iter().filter_map(Value::as_f64).filter(|v| v.is_finite()).collect();
    list.try_into().ok()
}

/// Adds splats of no higher degree to `all`; coefficients that they lack are 0.
fn append(all: &mut RawSplats, splats: RawSplats) {
    let (width, whole) = (splats.sh_width(), all.sh_width());
    for row in splats.sh.chunks_exact(width) {
        all.sh.extend_from_slice(row);
        all.sh.resize(all.sh.len() + whole - width, 0.0);
    }
    all.means.extend::<Vec<Vec3>>(splats.means);
    all.quats.extend(splats.quats);
    all.log_scales.extend(splats.log_scales);
    all.logit_opacities.extend(splats.logit_opacities);
}
