//! Meshes, cameras and images with known truth, for the tests, the example and the bench of unprojection.
#![allow(dead_code, reason = "each user takes a part")]

use glam::{DVec3, Vec2, Vec3};
use gs_core::{Camera, Image};
use gs_texel::surface::{Mesh, Topology};
use gs_texel::texels::{TexelOptions, TexelTable};
use gs_texel::unproject::{Texture, View};
use gs_texel::zbuffer::DepthMap;

/// A mesh with texture coordinates.
#[derive(Clone, Default)]
pub struct TexturedMesh {
    pub vertices: Vec<Vec3>,
    pub normals: Vec<Vec3>,
    pub faces: Vec<[u32; 3]>,
    pub uvs: Vec<Vec2>,
    pub face_uvs: Vec<[u32; 3]>,
}

impl TexturedMesh {
    pub fn mesh(&self) -> Mesh<'_> {
        Mesh { vertices: &self.vertices, normals: &self.normals, faces: &self.faces }
    }

    pub fn table(&self, size: usize) -> TexelTable {
        TexelTable::build(&self.faces, &self.uvs, &self.face_uvs, size, &TexelOptions::default()).unwrap()
    }

    /// Normals after the vertices have moved.
    pub fn update_normals(&mut self) {
        let topology = Topology::new(&self.faces, self.vertices.len()).unwrap();
        self.normals = topology.normals(&self.vertices, &self.faces);
    }

    /// Both meshes; texture coordinates are kept.
    pub fn join(mut self, other: &TexturedMesh) -> Self {
        let (v, t) = (self.vertices.len() as u32, self.uvs.len() as u32);
        self.vertices.extend(&other.vertices);
        self.normals.extend(&other.normals);
        self.uvs.extend(&other.uvs);
        self.faces.extend(other.faces.iter().map(|f| f.map(|i| i + v)));
        self.face_uvs.extend(other.face_uvs.iter().map(|f| f.map(|i| i + t)));
        self
    }
}

/// A sphere of `2·across·(down − 1)` triangles; its map of longitude and latitude fills the rectangle `lo..hi`.
pub fn sphere(centre: Vec3, radius: f32, across: u32, down: u32, lo: Vec2, hi: Vec2) -> TexturedMesh {
    let mut out = TexturedMesh::default();
    let direction = |i: u32, j: u32| {
        let (lat, lon) = (
            std::f64::consts::PI * f64::from(i) / f64::from(down),
            std::f64::consts::TAU * f64::from(j) / f64::from(across),
        );
        DVec3::new(lat.sin() * lon.sin(), -lat.cos(), lat.sin() * lon.cos()).as_vec3()
    };
    out.normals.push(direction(0, 0));
    for i in 1..down {
        out.normals.extend((0..across).map(|j| direction(i, j)));
    }
    out.normals.push(direction(down, 0));
    out.vertices = out.normals.iter().map(|n| centre + radius * n).collect();
    let vertex = |i: u32, j: u32| match i {
        0 => 0,
        i if i == down => 1 + (down - 1) * across,
        i => 1 + (i - 1) * across + j % across,
    };
    for i in 0..=down {
        let pole = if i == 0 || i == down { 0.5 } else { 0.0 };
        let at = |j: u32| Vec2::new((j as f32 + pole) / across as f32, i as f32 / down as f32);
        out.uvs.extend((0..=across).map(|j| lo + (hi - lo) * at(j)));
    }
    let corner = |i: u32, j: u32| (vertex(i, j), i * (across + 1) + j);
    for i in 0..down {
        for j in 0..across {
            let (a, b, c, d) = (corner(i, j), corner(i, j + 1), corner(i + 1, j + 1), corner(i + 1, j));
            let mut push = |t: [(u32, u32); 3]| {
                out.faces.push(t.map(|c| c.0));
                out.face_uvs.push(t.map(|c| c.1));
            };
            if i == 0 {
                push([a, c, d]);
            } else {
                push([a, b, d]);
                if i + 1 < down {
                    push([b, c, d]);
                }
            }
        }
    }
    out
}

/// A square plate around `centre` spanned by `right` and `up` (half sides), facing `right × up`, cut into `n × n` cells.
pub fn plate(centre: Vec3, right: Vec3, up: Vec3, n: u32, lo: Vec2, hi: Vec2) -> TexturedMesh {
    let mut out = TexturedMesh::default();
    for j in 0..=n {
        for i in 0..=n {
            let at = Vec2::new(i as f32, j as f32) / n as f32;
            out.vertices.push(centre + (2.0 * at.x - 1.0) * right + (2.0 * at.y - 1.0) * up);
            out.uvs.push(lo + (hi - lo) * at);
            out.normals.push(right.cross(up).normalize());
        }
    }
    for j in 0..n {
        for i in 0..n {
            let at = |di: u32, dj: u32| (j + dj) * (n + 1) + i + di;
            out.faces.extend([[at(0, 0), at(1, 0), at(1, 1)], [at(0, 0), at(1, 1), at(0, 1)]]);
        }
    }
    out.face_uvs = out.faces.clone();
    out
}

/// A sphere of 0.9 m with a small one before it: 18.7 thousand triangles.
pub fn two_spheres() -> TexturedMesh {
    let big = sphere(Vec3::ZERO, 0.9, 96, 91, Vec2::ZERO, Vec2::new(1.0, 0.92));
    let small = sphere(Vec3::new(0.35, 0.2, 1.15), 0.15, 28, 28, Vec2::new(0.0, 0.93), Vec2::new(0.15, 1.0));
    big.join(&small)
}

/// `n` square cameras on a ring of 3 m, focal length 1.35 times their side.
pub fn ring(n: usize, side: u32) -> Vec<Camera> {
    let camera = |i: usize| {
        let turn = std::f64::consts::TAU * i as f64 / n as f64;
        let eye = 3.0 * DVec3::new(turn.sin(), 0.0, turn.cos());
        Camera::look_at(side, side, 2.0 * (0.5f64 / 1.35).atan(), eye, DVec3::ZERO, -DVec3::Y).unwrap()
    };
    (0..n).map(camera).collect()
}

/// `½ + 0.4 sin(kx) cos(ky)`.
pub fn waves(k: f64) -> impl Fn(DVec3) -> [f32; 3] + Sync {
    move |p| [(0.5 + 0.4 * (k * p.x).sin() * (k * p.y).cos()) as f32; 3]
}

/// The image of a coloured mesh: the colour of the point under each pixel centre, with opacity.
pub fn render(figure: &TexturedMesh, camera: &Camera, color: &impl Fn(DVec3) -> [f32; 3]) -> Image {
    let depth = DepthMap::new(&figure.vertices, &figure.faces, camera, 0.05);
    let mut image = Image::zeros(depth.width, depth.height, 4);
    let (origin, turn) = (camera.position(), camera.rotation.transpose());
    for y in 0..depth.height {
        for x in 0..depth.width {
            let z = f64::from(depth.at(x, y));
            if z.is_finite() {
                let d =
                    DVec3::new((x as f64 + 0.5 - camera.cx) / camera.fx, (y as f64 + 0.5 - camera.cy) / camera.fy, 1.0);
                let [r, g, b] = color(origin + turn * (d * z));
                image.pixel_mut(x, y).copy_from_slice(&[r, g, b, 1.0]);
            }
        }
    }
    image
}

pub fn views<'a>(cameras: &'a [Camera], images: &'a [Image]) -> Vec<View<'a>> {
    cameras.iter().zip(images).map(|(camera, image)| View { camera, image, mask: None }).collect()
}

/// Decibels between a texture and the truth at the texels seen.
pub fn psnr(texture: &Texture, figure: &TexturedMesh, table: &TexelTable, color: &impl Fn(DVec3) -> [f32; 3]) -> f64 {
    let (mut sum, mut n) = (0.0, 0usize);
    for k in (0..table.len()).filter(|&k| texture.seen[k] > 0) {
        let want = color(table.at(&figure.faces, &figure.vertices, k).as_dvec3());
        for (got, want) in texture.colors[k].iter().zip(want) {
            sum += f64::from(got - want).powi(2);
            n += 1;
        }
    }
    -10.0 * (sum / n.max(1) as f64).log10()
}
