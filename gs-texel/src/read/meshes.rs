//! Meshes of a glTF file: weights, morphs, triangles and texture coordinates of every primitive in the scene, in one mesh.

use super::accessors::{Data, Table};
use super::error::CharacterError;
use super::materials::{Layout, srgb_encode};
use super::nodes::Nodes;
use super::weld::RawMesh;
use crate::character::Fallbacks;
use crate::skeleton::Joint;
use crate::template::Material;
use glam::{DAffine3, DMat4, DVec3, Vec2, Vec4};
use gltf::Semantic;
use gltf::json::accessor::Type;
use gltf::json::mesh::{Mode, Primitive};
use gltf::json::validation::Checked;
use std::collections::HashMap;

/// Weights whose sum differs from 1 by more than this are counted as repaired.
const WEIGHT_SUM: f64 = 1e-2;
/// Memory of a vertex, and of a triangle, while it is read and welded, bytes.
const VERTEX_BYTES: u64 = 200;
const FACE_BYTES: u64 = 150;

/// Rows of the morphs of one node's mesh.
pub(super) struct MorphBlock {
    pub(super) node: u32,
    pub(super) first: u32,
    pub(super) count: u32,
}

/// The meshes of the scene, joined.
pub(super) struct Meshes<'a> {
    data: &'a Data<'a>,
    nodes: &'a Nodes,
    /// World transforms of the rest pose.
    rest: Vec<DAffine3>,
    materials: &'a [(Material, Layout)],
    uv_set: Option<u32>,
    /// Rows of joints, by skin.
    skins: HashMap<usize, Vec<u32>>,
    /// Joint of each node with a rigid mesh.
    rigid: HashMap<u32, u32>,
    pub(super) mesh: RawMesh,
    pub(super) joints: Vec<Joint>,
    /// The first joint of skins at each node.
    of_skins: HashMap<u32, Joint>,
    pub(super) blocks: Vec<MorphBlock>,
    pub(super) rest_morphs: Vec<f32>,
    pub(super) fallbacks: Fallbacks,
}

impl<'a> Meshes<'a> {
    pub(super) fn new(
        data: &'a Data<'a>,
        nodes: &'a Nodes,
        rest: Vec<DAffine3>,
        materials: &'a [(Material, Layout)],
        uv_set: Option<u32>,
    ) -> Self {
        Self {
            data,
            nodes,
            rest,
            materials,
            uv_set,
            skins: HashMap::new(),
            rigid: HashMap::new(),
            mesh: RawMesh::default(),
            joints: Vec::new(),
            of_skins: HashMap::new(),
            blocks: Vec::new(),
            rest_morphs: Vec::new(),
            fallbacks: Fallbacks::default(),
        }
    }

    /// Reads every mesh in the scene; skins first, so that rigid parts find the joint above them.
    pub(super) fn read(&mut self) -> Result<(), CharacterError> {
        let nodes = self.nodes;
        let shown = nodes.source.iter().zip(&nodes.shown).enumerate().filter(|(_, (_, shown))| **shown);
        let shown: Vec<(u32, usize)> = shown.map(|(place, (source, _))| (place as u32, *source)).collect();
        for &(_, source) in &shown {
            let node = self.data.root.nodes.get(source).filter(|n| n.mesh.is_some());
            if let Some(skin) = node.and_then(|n| n.skin) {
                self.skin(skin.value())?;
            }
        }
        for (node, source) in shown {
            self.instance(node, source)?;
        }
        let dense = (self.mesh.points.len() as u64).saturating_mul(12 * self.rest_morphs.len() as u64);
        self.data.spend(dense, "the morph targets")
    }

    /// Adds the joints of a skin; equal joints of different skins are shared.
    fn skin(&mut self, index: usize) -> Result<(), CharacterError> {
        let place = format!("skin {index}");
        let wrong = |what: &str| self.data.malformed(place.as_str(), what);
        if self.skins.contains_key(&index) {
            return Ok(());
        }
        let skin = self.data.root.skins.get(index).ok_or_else(|| wrong("does not exist"))?;
        let binds = skin.inverse_bind_matrices.map(|m| self.data.table(m, &[Type::Mat4])).transpose()?;
        if skin.joints.is_empty() || binds.as_ref().is_some_and(|b| b.len() < skin.joints.len()) {
            return Err(wrong("has no joints, or fewer inverse bind matrices than joints"));
        }
        self.data.spend(200 * skin.joints.len() as u64, &place)?;
        let mut known: HashMap<u32, Vec<u32>> = HashMap::new();
        self.joints.iter().enumerate().for_each(|(k, j)| known.entry(j.node).or_default().push(k as u32));
        let mut numbers = Vec::with_capacity(skin.joints.len());
        for (k, joint) in skin.joints.iter().enumerate() {
            let node = self.nodes.place.get(joint.value()).ok_or_else(|| wrong("has a joint that does not exist"))?;
            let inverse_bind = match binds.as_ref().and_then(|b| b.row(k)) {
                Some(m) => affine(m).ok_or_else(|| wrong("has an inverse bind matrix with perspective"))?,
                None => DAffine3::IDENTITY,
            };
            let joint = Joint { node: *node, inverse_bind };
            let same = |&&n: &&u32| self.joints.get(n as usize) == Some(&joint);
            let number = known.get(node).and_then(|n| n.iter().find(same)).copied();
            let number = number.unwrap_or(self.joints.len() as u32);
            if number as usize == self.joints.len() {
                self.of_skins.entry(*node).or_insert(joint);
                self.joints.push(joint);
            }
            numbers.push(number);
        }
        self.skins.insert(index, numbers);
        Ok(())
    }

    /// The joint of a node with a rigid mesh, and the world transform of the node in the bind pose: relative to the nearest
    /// joint above it, else its rest transform.
    fn rigid_joint(&mut self, node: u32) -> (u32, DAffine3) {
        let rest = |n: u32| self.rest.get(n as usize).copied().unwrap_or(DAffine3::IDENTITY);
        let parent = |n: &u32| self.nodes.nodes.get(*n as usize).and_then(|n| n.parent);
        let of_skins = |n: u32| self.of_skins.get(&n).filter(|_| !self.rigid.contains_key(&n)).copied();
        let above = std::iter::successors(Some(node), parent).find_map(|n| of_skins(n).map(|j| (n, j)));
        let bind = match above {
            Some((n, joint)) => joint.inverse_bind.inverse() * rest(n).inverse() * rest(node),
            None => rest(node),
        };
        // Where a scale of 0 hides the part, its own space is its bind pose.
        let inverse = bind.inverse();
        let (bind, inverse_bind) = if bind.is_finite() && inverse.is_finite() {
            (bind, inverse)
        } else {
            (DAffine3::IDENTITY, DAffine3::IDENTITY)
        };
        let next = self.joints.len() as u32;
        let number = *self.rigid.entry(node).or_insert(next);
        if number == next {
            self.joints.push(Joint { node, inverse_bind });
        }
        (number, bind)
    }

    /// Adds the mesh of a node.
    fn instance(&mut self, node: u32, source: usize) -> Result<(), CharacterError> {
        let Some((source_node, mesh)) = self.data.root.nodes.get(source).and_then(|n| Some((n, n.mesh?))) else {
            return Ok(());
        };
        let place = format!("mesh {}", mesh.value());
        let mesh = self.data.root.get(mesh).ok_or_else(|| self.data.malformed(place.as_str(), "does not exist"))?;
        let count = mesh.primitives.iter().map(|p| p.targets.as_ref().map_or(0, Vec::len)).max().unwrap_or(0);
        self.data.spend(100 * count as u64, &place)?;
        let first = self.rest_morphs.len() as u32;
        self.blocks.push(MorphBlock { node, first, count: count as u32 });
        let weights = source_node.weights.as_ref().or(mesh.weights.as_ref());
        for k in 0..count {
            let weight = weights.and_then(|w| w.get(k)).copied().unwrap_or(0.0);
            if !weight.is_finite() {
                return Err(self.data.malformed(place, "has morph weights that are not finite"));
            }
            self.rest_morphs.push(weight);
            self.mesh.morphs.push(format!("{}.{k}", mesh.name.as_deref().unwrap_or("mesh")));
        }
        for (k, primitive) in mesh.primitives.iter().enumerate() {
            let place = format!("{place}, primitive {k}");
            self.primitive(primitive, (node, first), source_node.skin.map(|s| s.value()), &place)?;
        }
        Ok(())
    }

    fn primitive(
        &mut self,
        primitive: &Primitive,
        (node, first_morph): (u32, u32),
        skin: Option<usize>,
        place: &str,
    ) -> Result<(), CharacterError> {
        let attribute = |s: Semantic| primitive.attributes.get(&Checked::Valid(s)).copied();
        let data = self.data;
        let (Checked::Valid(mode @ (Mode::Triangles | Mode::TriangleStrip | Mode::TriangleFan)), Some(positions)) =
            (primitive.mode, attribute(Semantic::Positions))
        else {
            self.fallbacks.ignored_primitives += 1;
            return Ok(());
        };
        if data.root.get(positions).is_some_and(|a| a.buffer_view.is_none() && a.sparse.is_none()) {
            return Err(data.malformed(place, "has positions without data (compressed?)"));
        }
        let positions = data.table(positions, &[Type::Vec3])?;
        let n = positions.len();
        data.spend(VERTEX_BYTES * n as u64, place)?;
        let of_this = |table: Table| match table.len() {
            rows if rows == n => Ok(table),
            rows => Err(data.malformed(place, format!("has {n} positions and {rows} rows of something else"))),
        };
        let base = self.mesh.points.len() as u32;
        let influences = self.influences(&attribute, skin, place, &of_this)?;
        let colors = attribute(Semantic::Colors(0)).map(|c| data.table(c, &[Type::Vec3, Type::Vec4]).and_then(of_this));
        self.colors(colors.transpose()?, n);
        let bind = if influences.is_some() { None } else { Some(self.rigid_joint(node)) };
        let mut targets = Vec::new();
        for target in primitive.targets.iter().flatten() {
            let table = target.positions.map(|p| data.table(p, &[Type::Vec3]).and_then(of_this)).transpose()?;
            data.spend(16 * table.as_ref().map_or(0, Table::len) as u64, place)?;
            targets.push(table);
        }
        for (i, position) in positions.rows().enumerate() {
            let (joint, frame) = bind.unwrap_or((0, DAffine3::IDENTITY));
            self.mesh.points.push(frame.transform_point3(DVec3::from_slice(position)).as_vec3());
            match &influences {
                Some(rows) => self.bind_vertex(rows, (i, DVec3::from_slice(position)), place)?,
                None => {
                    self.mesh.weights.push([(joint, 1.0)], joint);
                }
            }
            for (k, target) in targets.iter().enumerate() {
                let delta = target.as_ref().and_then(|t| t.row(i)).map_or(DVec3::ZERO, DVec3::from_slice);
                if delta != DVec3::ZERO {
                    let delta = frame.transform_vector3(delta).as_vec3();
                    self.mesh.deltas.push((base + i as u32, first_morph + k as u32, delta));
                }
            }
        }
        if self.mesh.points.iter().skip(base as usize).any(|p| !p.is_finite()) {
            return Err(data.malformed(place, "has positions that are not finite in its bind pose"));
        }
        let mirrored = bind.is_some_and(|(_, frame)| frame.matrix3.determinant() < 0.0);
        self.triangles(primitive, mode, (base, n), mirrored, place)
    }

    /// Joint and weight tables of a skinned primitive, with the joints of its skin.
    fn influences(
        &self,
        attribute: &dyn Fn(Semantic) -> Option<gltf::json::Index<gltf::json::Accessor>>,
        skin: Option<usize>,
        place: &str,
        of_this: &dyn Fn(Table) -> Result<Table, CharacterError>,
    ) -> Result<Option<Influences>, CharacterError> {
        let Some(joints) = skin.and_then(|s| self.skins.get(&s)) else { return Ok(None) };
        let mut sets = Vec::new();
        for set in 0.. {
            match (attribute(Semantic::Joints(set)), attribute(Semantic::Weights(set))) {
                (Some(j), Some(w)) => {
                    let joints = of_this(self.data.integers(j, &[Type::Vec4])?)?;
                    sets.push((joints, of_this(self.data.table(w, &[Type::Vec4])?)?));
                }
                (None, None) => break,
                _ => return Err(self.data.malformed(place, format!("has JOINTS_{set} or WEIGHTS_{set} alone"))),
            }
        }
        Ok((!sets.is_empty()).then(|| Influences { sets, joints: joints.clone() }))
    }

    /// Adds the display-encoded vertex colours of a primitive; white if it has none.
    fn colors(&mut self, table: Option<Table>, n: usize) {
        match table {
            None => self.mesh.colors.resize(self.mesh.colors.len() + n, Vec4::ONE),
            Some(table) => {
                self.mesh.has_colors = true;
                self.mesh.colors.extend(table.rows().map(|row| {
                    let [r, g, b, a] = std::array::from_fn(|k| row.get(k).map_or(1.0, |v| v.clamp(0.0, 1.0) as f32));
                    Vec4::new(srgb_encode(r), srgb_encode(g), srgb_encode(b), a)
                }));
            }
        }
    }

    /// The joint of a skin that is nearest to a point of the bind pose.
    fn nearest(&self, joints: &[u32], point: DVec3, place: &str) -> Result<u32, CharacterError> {
        // Each comparison costs a byte of the budget, which bounds the time by the size of the file.
        self.data.spend(joints.len() as u64, place)?;
        let distance = |number: &u32| {
            let joint = self.joints.get(*number as usize);
            let at = joint.map(|j| j.inverse_bind.inverse().translation.distance_squared(point));
            at.filter(|d| d.is_finite()).unwrap_or(f64::INFINITY)
        };
        let nearest = joints.iter().map(|j| (distance(j), *j)).reduce(|a, b| if b.0 < a.0 { b } else { a });
        Ok(nearest.map_or(0, |(_, joint)| joint))
    }

    fn bind_vertex(&mut self, rows: &Influences, (i, at): (usize, DVec3), place: &str) -> Result<(), CharacterError> {
        let (mut row, mut sum, mut mended) = (Vec::with_capacity(4 * rows.sets.len()), 0.0, false);
        for (joints, weights) in &rows.sets {
            for (&joint, &weight) in joints.row(i).into_iter().flatten().zip(weights.row(i).into_iter().flatten()) {
                mended |= weight < 0.0;
                if weight as f32 > 0.0 {
                    let number = rows.joints.get(joint as usize).ok_or_else(|| {
                        let what = format!("vertex {i} is bound to joint {joint} of {}", rows.joints.len());
                        self.data.malformed(place, what)
                    })?;
                    row.push((*number, weight as f32));
                    sum += weight;
                }
            }
        }
        mended |= sum > 0.0 && (sum - 1.0).abs() > WEIGHT_SUM;
        self.fallbacks.mended_weights += usize::from(mended);
        let nearest = if row.is_empty() { self.nearest(&rows.joints, at, place)? } else { 0 };
        self.fallbacks.unbound_vertices += usize::from(row.is_empty());
        self.mesh.weights.push(row, nearest);
        Ok(())
    }

    /// Adds the triangles of a primitive of `n` vertices from `base` on; of mirrored ones the other way round, so that their
    /// outside stays outside.
    fn triangles(
        &mut self,
        primitive: &Primitive,
        mode: Mode,
        (base, n): (u32, usize),
        mirrored: bool,
        place: &str,
    ) -> Result<(), CharacterError> {
        let data = self.data;
        let corners: Vec<u32> = match primitive.indices {
            Some(i) => data.integers(i, &[Type::Scalar])?.values.iter().map(|&v| v as u32).collect(),
            None => (0..n as u32).collect(),
        };
        if let Some(at) = corners.iter().position(|&c| c as usize >= n) {
            return Err(data.malformed(place, format!("index {at} is a vertex beyond its {n}")));
        }
        let number = primitive.material.map_or(self.materials.len() - 1, |m| m.value());
        let material = self.materials.get(number).zip(u16::try_from(number).ok());
        let ((_, layout), number) =
            material.ok_or_else(|| data.malformed(place, "has a material that is not there"))?;
        let uvs = Semantic::TexCoords(self.uv_set.unwrap_or(layout.set));
        let uvs = primitive.attributes.get(&Checked::Valid(uvs)).map(|&a| data.table(a, &[Type::Vec2])).transpose()?;
        let read = |c: u32| {
            let uv = uvs.as_ref()?.row(c as usize)?;
            Some(layout.apply(DVec3::new(*uv.first()?, *uv.get(1)?, 0.0).as_vec3().truncate()))
        };
        data.spend(FACE_BYTES * corners.len() as u64, place)?;
        let mut add = |[a, b, c]: [u32; 3]| {
            let [b, c] = if mirrored { [c, b] } else { [b, c] };
            if a != b && b != c && c != a {
                self.mesh.faces.push([a, b, c].map(|v| base + v));
                let uvs_of_face = read(a).zip(read(b)).zip(read(c)).map(|((a, b), c)| [a, b, c]);
                self.mesh.material_uvs.push(uvs_of_face.filter(|p| p.iter().all(|uv: &Vec2| uv.is_finite())));
                self.mesh.face_materials.push(number);
            }
        };
        match (mode, corners.as_slice()) {
            (Mode::TriangleStrip, all) => all.array_windows().enumerate().for_each(|(i, &[a, b, c])| {
                add(if i % 2 == 0 { [a, b, c] } else { [b, a, c] });
            }),
            (Mode::TriangleFan, [hub, rim @ ..]) => rim.array_windows().for_each(|&[b, c]| add([*hub, b, c])),
            (_, all) => all.as_chunks().0.iter().for_each(|&face| add(face)),
        }
        Ok(())
    }
}

struct Influences {
    sets: Vec<(Table, Table)>,
    /// Rows of the skin's joints.
    joints: Vec<u32>,
}

/// A column-major matrix without perspective.
fn affine(m: &[f64]) -> Option<DAffine3> {
    let m = DMat4::from_cols_array(m.first_chunk()?);
    let plain = m.row(3).abs_diff_eq(glam::DVec4::W, 1e-5);
    plain.then(|| DAffine3::from_mat4(m))
}
