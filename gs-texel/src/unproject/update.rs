//! Unprojecting again after part of the mesh has moved, under the same images.
//!
//! A texel is looked at again if its face or a neighbour of it moved, or if anything moved, there or away, within its
//! face's pixels in some view. The rest keeps its colour and visibility. With a threshold of 0 the result is that of a
//! fresh unprojection, bit for bit.

use super::{Eye, Gaze, Texture, UnprojectConfig, UnprojectError, View, check, tracer_of};
use crate::coverage::Window;
use crate::surface::{CHUNK, Mesh};
use crate::texels::TexelTable;
use crate::zbuffer::Screen;
use glam::Vec3;
use rayon::prelude::*;
use serde::Serialize;

/// Side of the squares in which movement on the screen is noted, pixels.
const TILE: usize = 8;
/// Footprints reach this far beyond the pixels of a face, with room for the offset of rays.
const MARGIN: usize = 3;

/// What an update had to do.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Redone {
    /// Vertices that moved.
    pub vertices: usize,
    /// Faces looked at again.
    pub faces: usize,
    /// Texels looked at again.
    pub texels: usize,
    /// Pixels of depth maps drawn again.
    pub pixels: usize,
}

impl Texture {
    /// Makes this the texture of `mesh`, which has moved since; table, views and settings must be those it was made with.
    /// Vertices that moved by no more than `threshold` pixels in every view (`‖ΔP‖·f/z`) are taken to be where they were;
    /// small steps add up over several updates. The mesh's normals must follow from its positions.
    ///
    /// # Errors
    /// As [`super::unproject`], and if mesh, table or views are of other sizes than before.
    pub fn update(
        &mut self,
        mesh: &Mesh<'_>,
        table: &TexelTable,
        views: &[View<'_>],
        config: &UnprojectConfig,
        threshold: f32,
    ) -> Result<Redone, UnprojectError> {
        check(mesh, table, views, config)?;
        self.same_sizes(mesh, table, views, config)?;
        let before = std::mem::take(&mut self.state.vertices);
        let moved = moved(&before, mesh.vertices, views, config, threshold);
        let touched = ring(mesh.faces, &moved);
        let pick = |new: &[Vec3], old: &[Vec3], which: &[bool]| -> Vec<Vec3> {
            (0..new.len()).map(|v| if which[v] { new[v] } else { old[v] }).collect()
        };
        let vertices = pick(mesh.vertices, &before, &moved);
        let normals = pick(mesh.normals, &self.state.normals, &touched);
        let now = Mesh { vertices: &vertices, normals: &normals, faces: mesh.faces };

        let mut dirty = faces_of(mesh.faces, &touched);
        let depths = std::mem::take(&mut self.state.depths);
        let mut eyes: Vec<Eye<'_>> = views.iter().map(Eye::new).collect();
        eyes.iter_mut().zip(depths).for_each(|(eye, depth)| eye.depth = depth);
        let of_eye =
            |i: usize, eye: &mut Eye<'_>| look_again(eye, self.used[i], &views[i], (&before, &now), &moved, config);
        let looks: Vec<(Vec<bool>, usize)> = eyes.par_iter_mut().enumerate().map(|(i, eye)| of_eye(i, eye)).collect();
        for (of_view, _) in &looks {
            dirty.iter_mut().zip(of_view).for_each(|(d, v)| *d |= v);
        }
        let rows: Vec<u32> = (0..table.len() as u32).filter(|&k| dirty[table.tri[k as usize] as usize]).collect();
        let tracer = tracer_of(&now, config)?;
        self.used = eyes.iter().map(|e| e.used).collect();
        self.fuse(&Gaze { mesh: &now, table, eyes: &eyes, tracer: tracer.as_ref(), config }, &rows);
        self.state.depths = eyes.into_iter().map(|e| e.depth).collect();
        let count = |flags: &[bool]| flags.iter().filter(|&&d| d).count();
        let redone = Redone {
            vertices: count(&moved),
            faces: count(&dirty),
            texels: rows.len(),
            pixels: looks.iter().map(|l| l.1).sum(),
        };
        (self.state.vertices, self.state.normals) = (vertices, normals);
        Ok(redone)
    }

    fn same_sizes(
        &self,
        mesh: &Mesh<'_>,
        table: &TexelTable,
        views: &[View<'_>],
        config: &UnprojectConfig,
    ) -> Result<(), UnprojectError> {
        let kept = if config.keep_views { table.len() * views.len() } else { 0 };
        let sizes = [
            ("texels", self.colors.len(), table.len()),
            ("vertices", self.state.vertices.len(), mesh.vertices.len()),
            ("views", self.used.len(), views.len()),
            ("kept weights", self.by_view.len(), kept),
        ];
        let other = sizes.into_iter().find(|s| s.1 != s.2);
        other.map_or(Ok(()), |(what, was, now)| Err(UnprojectError::Other { what, was, now }))
    }
}

/// Vertices that moved by more than `threshold` pixels in some view.
fn moved(old: &[Vec3], new: &[Vec3], views: &[View<'_>], config: &UnprojectConfig, threshold: f32) -> Vec<bool> {
    let in_view = |old: Vec3, new: Vec3, view: &View<'_>| {
        let c = view.camera;
        let depth = |p: Vec3| c.to_camera(p.as_dvec3()).z.max(config.near);
        let pixels = f64::from((new - old).length()) * c.fx.max(c.fy) / depth(old).min(depth(new));
        pixels > f64::from(threshold)
    };
    let moves = |(&old, &new): (&Vec3, &Vec3)| {
        old != new && (threshold <= 0.0 || views.iter().any(|view| in_view(old, new, view)))
    };
    old.par_iter().zip(new).with_min_len(CHUNK).map(moves).collect()
}

/// Faces with a marked corner.
fn faces_of(faces: &[[u32; 3]], marked: &[bool]) -> Vec<bool> {
    faces.iter().map(|f| f.iter().any(|&v| marked[v as usize])).collect()
}

/// Vertices of the faces with a marked corner: those whose normal may have turned.
fn ring(faces: &[[u32; 3]], marked: &[bool]) -> Vec<bool> {
    let mut out = marked.to_vec();
    for (face, _) in faces.iter().zip(faces_of(faces, marked)).filter(|f| f.1) {
        face.iter().for_each(|&v| out[v as usize] = true);
    }
    out
}

/// Draws the part of the view in which something moved; returns the faces with pixels there and the pixels drawn.
fn look_again(
    eye: &mut Eye<'_>,
    used: bool,
    view: &View<'_>,
    (before, now): (&[Vec3], &Mesh<'_>),
    moved: &[bool],
    config: &UnprojectConfig,
) -> (Vec<bool>, usize) {
    let screen = Screen::new(now.vertices, now.faces, view.camera, config.near);
    let behind = screen.corners.iter().filter(|c| c.camera.z <= config.near).count();
    eye.used = 2 * behind <= now.vertices.len();
    if eye.used != used {
        eye.depth = None;
        eye.look(view, now, config);
        return (vec![true; now.faces.len()], view.image.width * view.image.height);
    }
    if !used {
        return (vec![false; now.faces.len()], 0);
    }
    let then = Screen::new(before, now.faces, view.camera, config.near);
    let mut tiles = Tiles::new(view.image.width, view.image.height);
    for (face, _) in now.faces.iter().zip(faces_of(now.faces, moved)).filter(|f| f.1) {
        [&then, &screen].into_iter().filter_map(|s| s.bounds(face)).for_each(|w| tiles.mark(w));
    }
    let all = tiles.all;
    if let (Some(depth), Some(window)) = (eye.depth.as_mut(), all) {
        depth.fill(&screen, window);
    }
    eye.tag(view, now, config);
    let touches = |f: &[u32; 3]| screen.bounds(f).is_some_and(|w| tiles.meet(w));
    let faces = now.faces.par_iter().with_min_len(CHUNK).map(touches).collect();
    (faces, all.map_or(0, |w| (w.x1 - w.x0) * (w.y1 - w.y0)))
}

/// Squares of the screen in which something moved.
struct Tiles {
    across: usize,
    down: usize,
    marked: Vec<bool>,
    /// The smallest window around them.
    all: Option<Window>,
}

impl Tiles {
    fn new(width: usize, height: usize) -> Self {
        let (across, down) = (width.div_ceil(TILE), height.div_ceil(TILE));
        Self { across, down, marked: vec![false; across * down], all: None }
    }

    fn mark(&mut self, w: Window) {
        let all = self.all.get_or_insert(w);
        *all = Window { x0: all.x0.min(w.x0), y0: all.y0.min(w.y0), x1: all.x1.max(w.x1), y1: all.y1.max(w.y1) };
        for y in w.y0 / TILE..w.y1.div_ceil(TILE) {
            self.marked[y * self.across + w.x0 / TILE..y * self.across + w.x1.div_ceil(TILE)].fill(true);
        }
    }

    /// Whether a window with its margin meets a marked square.
    fn meet(&self, w: Window) -> bool {
        let low = |v: usize| v.saturating_sub(MARGIN) / TILE;
        let high = |v: usize, end: usize| (v + MARGIN).div_ceil(TILE).min(end);
        let (x0, x1) = (low(w.x0), high(w.x1, self.across));
        (low(w.y0)..high(w.y1, self.down))
            .any(|y| self.marked[y * self.across + x0..y * self.across + x1].contains(&true))
    }
}
