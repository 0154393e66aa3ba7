//! Builds templates from closed surfaces of revolution and their charts.

use crate::character::Character;
use crate::skeleton::{Joint, Node, Skeleton, Trs};
use crate::surface::NONE;
use crate::template::{Material, Template};
use glam::{DAffine3, DVec3, Vec2, Vec3};
use gs_core::Image;
use std::f32::consts::{PI, TAU};
use std::sync::Arc;

/// Share of a chart's cell that is left free on each side.
const GUTTER: f32 = 0.02;

/// A rectangle of the atlas.
#[derive(Clone, Copy)]
pub(super) struct Cell {
    pub(super) low: Vec2,
    pub(super) high: Vec2,
}

impl Cell {
    pub(super) fn new(u: [f32; 2], v: [f32; 2]) -> Self {
        Self { low: Vec2::new(u[0], v[0]), high: Vec2::new(u[1], v[1]) }
    }

    /// Atlas coordinate of a point of `[0, 1]²` of the chart.
    pub(super) fn place(&self, local: Vec2) -> Vec2 {
        let gutter = GUTTER * Vec2::ONE;
        self.low + gutter + local * (self.high - self.low - 2.0 * gutter)
    }

    /// Inverse of [`Cell::place`]; outside `[0, 1]²` in the gutter.
    fn local(&self, uv: Vec2) -> Vec2 {
        let gutter = GUTTER * Vec2::ONE;
        (uv - self.low - gutter) / (self.high - self.low - 2.0 * gutter)
    }
}

/// A ring of vertices, and their texture coordinates: one more, as the last is again the first.
struct Row {
    vertices: Vec<u32>,
    uvs: Vec<u32>,
}

/// The template under construction, and its charts.
#[derive(Default)]
pub(super) struct Builder {
    pub(super) template: Template,
    cells: Vec<Cell>,
}

impl Builder {
    /// Adds a vertex with its weights.
    pub(super) fn vertex(&mut self, point: Vec3, weights: Vec<(u32, f32)>) -> u32 {
        self.template.vertices.push(point);
        self.template.weights.push(weights, 0);
        self.template.vertices.len() as u32 - 1
    }

    pub(super) fn uv(&mut self, uv: Vec2) -> u32 {
        self.template.uvs.push(uv);
        self.template.uvs.len() as u32 - 1
    }

    pub(super) fn face(&mut self, face: [u32; 3], uvs: [u32; 3]) {
        self.template.faces.push(face);
        self.template.face_uvs.push(uvs);
        self.template.face_materials.push(0);
    }

    pub(super) fn chart(&mut self, cell: Cell) {
        self.cells.push(cell);
    }

    /// A closed surface `point(s, φ)`, `s` from pole to pole, `rings` bands of `segments` quads (triangles at the poles).
    /// Bands are narrow near the poles: `s = (1 − cos(π k / rings)) / 2`.
    pub(super) fn lathe(
        &mut self,
        cell: Cell,
        [rings, segments]: [usize; 2],
        point: &dyn Fn(f32, f32) -> Vec3,
        weights: &dyn Fn(Vec3) -> Vec<(u32, f32)>,
    ) {
        self.chart(cell);
        let first_face = self.template.faces.len();
        let s = |k: usize| 0.5 * (1.0 - (PI * k as f32 / rings as f32).cos());
        let angle = |i: usize| TAU * i as f32 / segments as f32;
        let row = |body: &mut Self, k: usize| {
            let points = (0..segments).map(|i| point(s(k), angle(i)));
            let vertices = points.map(|p| body.vertex(p, weights(p))).collect();
            body.row(cell, k as f32 / rings as f32, vertices)
        };
        let rows: Vec<Row> = (1..rings).map(|k| row(self, k)).collect();
        rows.windows(2).for_each(|pair| self.band(&pair[0], &pair[1], |_| true));
        for (k, row) in [(0, rows.first()), (rings, rows.last())] {
            let Some(row) = row else { continue };
            let p = point(s(k), 0.0);
            let pole = self.vertex(p, weights(p));
            self.fan(cell, row, pole, k == 0);
        }
        self.orient_outwards(first_face);
    }

    /// A tube of `rings` bands from a ring of vertices to a pole. The vertices of ring `k` are `point(k / rings, i)`, the pole
    /// is `point(1, 0)`. Quads of `hole(band, i)` are left out, and with them the vertices that no other quad has: [`NONE`] in
    /// the rows that are returned. Edges of the first ring are used against its order.
    pub(super) fn tube(
        &mut self,
        cell: Cell,
        first: Vec<u32>,
        rings: usize,
        point: &dyn Fn(f32, usize) -> Vec3,
        weights: &dyn Fn(Vec3) -> Vec<(u32, f32)>,
        hole: &dyn Fn(usize, usize) -> bool,
    ) -> Vec<Vec<u32>> {
        self.chart(cell);
        let segments = first.len();
        let share = |k: usize| k as f32 / rings as f32;
        let mut rows = vec![self.row(cell, 0.0, first)];
        for k in 1..rings {
            let before = |i: usize| (i + segments - 1) % segments;
            let inside = |i: usize| [k - 1, k].iter().all(|&band| hole(band, before(i)) && hole(band, i));
            let mut vertex = |i: usize| {
                let p = point(share(k), i);
                if inside(i) { NONE } else { self.vertex(p, weights(p)) }
            };
            let vertices = (0..segments).map(&mut vertex).collect();
            rows.push(self.row(cell, share(k), vertices));
        }
        for (k, pair) in rows.windows(2).enumerate() {
            self.band(&pair[0], &pair[1], |i| !hole(k, i));
        }
        let p = point(1.0, 0);
        let pole = self.vertex(p, weights(p));
        if let Some(row) = rows.last() {
            self.fan(cell, row, pole, false);
        }
        rows.into_iter().map(|row| row.vertices).collect()
    }

    /// A ring at the height `v` of a chart.
    fn row(&mut self, cell: Cell, v: f32, vertices: Vec<u32>) -> Row {
        let n = vertices.len();
        let uvs = (0..=n).map(|i| self.uv(cell.place(Vec2::new(i as f32 / n as f32, v)))).collect();
        Row { vertices, uvs }
    }

    /// Two triangles for each quad between two rings that is kept.
    fn band(
        &mut self,
        Row { vertices: a, uvs: ta }: &Row,
        Row { vertices: b, uvs: tb }: &Row,
        keep: impl Fn(usize) -> bool,
    ) {
        for i in (0..a.len()).filter(|&i| keep(i)) {
            let j = (i + 1) % a.len();
            self.face([a[i], b[i], b[j]], [ta[i], tb[i], tb[i + 1]]);
            self.face([a[i], b[j], a[j]], [ta[i], tb[i + 1], ta[i + 1]]);
        }
    }

    /// Triangles from a ring to a pole at the beginning or the end of the chart.
    fn fan(&mut self, cell: Cell, Row { vertices: ring, uvs }: &Row, pole: u32, begins: bool) {
        for i in 0..ring.len() {
            let j = (i + 1) % ring.len();
            let tip = Vec2::new((i as f32 + 0.5) / ring.len() as f32, if begins { 0.0 } else { 1.0 });
            let tip = self.uv(cell.place(tip));
            if begins {
                self.face([pole, ring[i], ring[j]], [tip, uvs[i], uvs[i + 1]]);
            } else {
                self.face([pole, ring[j], ring[i]], [tip, uvs[i + 1], uvs[i]]);
            }
        }
    }

    /// Reverses the faces from `first` on if the volume they enclose is negative.
    pub(super) fn orient_outwards(&mut self, first: usize) {
        let Template { vertices, faces, face_uvs, .. } = &mut self.template;
        let volume = |f: &[u32; 3]| {
            let [a, b, c] = f.map(|v| vertices[v as usize].as_dvec3());
            a.dot(b.cross(c))
        };
        if faces[first..].iter().map(volume).sum::<f64>() < 0.0 {
            faces[first..].iter_mut().for_each(|f| f.swap(1, 2));
            face_uvs[first..].iter_mut().for_each(|f| f.swap(1, 2));
        }
    }

    /// The finished character, with a texture of `size × size` texels.
    pub(super) fn finish(self, skeleton: Skeleton, name: &str, size: usize) -> Character {
        let Self { mut template, cells } = self;
        template.materials =
            vec![Material { name: name.into(), texture: Some(Arc::new(paint(&cells, size))), ..Material::default() }];
        let source_vertices = (0..template.vertices.len() as u32).collect();
        Character { template, skeleton, source_vertices, ..Character::default() }
    }
}

/// The texture: each chart in its own colour with a few waves, periodic around it.
fn paint(cells: &[Cell], size: usize) -> Image {
    let mut image = Image::zeros(size, size, 4);
    for y in 0..size {
        for x in 0..size {
            let uv = (Vec2::new(x as f32, y as f32) + 0.5) / size as f32;
            let inside = |c: &Cell| (uv - c.low).min_element() >= 0.0 && (c.high - uv).min_element() >= 0.0;
            let chart = cells.iter().position(inside);
            let colour = chart.map_or(Vec3::splat(0.5), |k| wave(k, cells[k].local(uv)));
            image.pixel_mut(x, y).copy_from_slice(&[colour.x, colour.y, colour.z, 1.0]);
        }
    }
    image
}

/// Colour of a chart at `[0, 1]²`: at most 4 waves around and 5 along, values within `[0.08, 0.92]`.
fn wave(chart: usize, at: Vec2) -> Vec3 {
    let k = chart as f32;
    let channel = |c: usize| {
        let c = c as f32;
        let base = 0.5 + 0.2 * (2.4 * k + 2.1 * c).sin();
        let around = (2.0 + (chart % 3) as f32) * TAU * at.x + 1.3 * k + 2.0 * c;
        let along = (2.0 + ((chart + 1) % 4) as f32) * TAU * at.y + 0.7 * k;
        base + 0.14 * around.sin() * along.cos() + 0.08 * (along * 0.5 + c).sin()
    };
    Vec3::new(channel(0), channel(1), channel(2))
}

/// A skeleton of unrotated nodes given by name, parent and world position; all are joints, bound in the rest pose.
pub(super) fn rig(places: &[(&str, Option<u32>, [f64; 3])]) -> Skeleton {
    let world = |k: u32| DVec3::from_array(places[k as usize].2);
    let node = |&(name, parent, at): &(&str, Option<u32>, [f64; 3])| Node {
        name: name.into(),
        parent,
        rest: Trs::at(DVec3::from_array(at) - parent.map_or(DVec3::ZERO, world)),
    };
    let joint = |k| Joint { node: k, inverse_bind: DAffine3::from_translation(-world(k)) };
    Skeleton {
        nodes: places.iter().map(node).collect(),
        joints: (0..places.len() as u32).map(joint).collect(),
        ..Skeleton::default()
    }
}

/// Weights along a chain: joint `k` takes over from joint `k − 1` around `border[k − 1]`, smoothly over `2 · width`.
pub(super) fn chain(joints: &[u32], borders: &[f32], width: f32, at: f32) -> Vec<(u32, f32)> {
    let taken = |border: f32| {
        let t = ((at - border) / (2.0 * width) + 0.5).clamp(0.0, 1.0);
        t * t * (3.0 - 2.0 * t)
    };
    let share = |k: usize| {
        let own = if k == 0 { 1.0 } else { taken(borders[k - 1]) };
        own - borders.get(k).map_or(0.0, |&b| taken(b))
    };
    joints.iter().enumerate().map(|(k, &j)| (j, share(k))).collect()
}
