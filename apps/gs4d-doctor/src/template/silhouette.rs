//! Silhouettes of a person: those that images show, and those of the posed template in the same cameras.

use glam::{DVec2, DVec3, Vec3};
use gs_core::Camera;
use gs_data::avatar::{AvatarFrame, AvatarScene};
use gs_data::{Dataset, ImageCache, ImageU8, View};
use gs_texel::surface::NONE;
use gs_texel::zbuffer::face_map;
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::sync::Arc;

/// Most frames that are compared, spread evenly.
pub(super) const MAX_FRAMES: usize = 12;
/// Near plane of the template's silhouette, metres.
const NEAR: f64 = 0.05;

/// What a view shows of the person.
pub(super) struct Shown {
    pub(super) camera_id: u32,
    /// Row of the frame among those compared.
    pub(super) frame: usize,
    pub(super) name: String,
    pub(super) camera: Camera,
    pub(super) image: Arc<ImageU8>,
    pub(super) outline: Vec<DVec2>,
}

/// The template in a view.
pub(super) struct Drawn {
    pub(super) covered: Vec<bool>,
    /// Outline pixels with the joint that moves the surface there.
    pub(super) outline: Vec<(DVec2, u32)>,
    /// Side of a pixel at the depth of the person, metres.
    pub(super) pixel: f64,
}

/// Rows of the frames that are compared.
pub(super) fn compared(scene: &AvatarScene) -> Vec<usize> {
    let count = scene.frames.len().min(MAX_FRAMES);
    (0..count).map(|k| (2 * k + 1) * scene.frames.len() / (2 * count)).collect()
}

/// The views of the compared frames that show an outline: those of conditioning cameras, then training views.
pub(super) fn silhouettes(
    data: &Dataset,
    scene: &AvatarScene,
    rows: &[usize],
    small_images: &ImageCache,
) -> Vec<Shown> {
    let number = |at: &AvatarFrame| rows.iter().position(|&r| scene.frames[r].number == at.number);
    let own = rows.iter().enumerate().flat_map(|(k, &r)| scene.frames[r].inputs.iter().map(move |v| (k, v)));
    let others = data.train.iter().filter_map(|v| number(scene.frame_at(v.time)).map(|k| (k, v)));
    let mut views: BTreeMap<(u32, usize), &View> = BTreeMap::new();
    own.chain(others).for_each(|(k, v)| {
        views.entry((v.camera_id, k)).or_insert(v);
    });
    let show = |((camera_id, frame), v): ((u32, usize), &View)| {
        let image = AvatarScene::input_pixels(v, small_images).ok()?;
        let inside: Vec<bool> = image.data.chunks_exact(4).map(|p| p[3] > 127).collect();
        let outline = outline(&inside, image.width);
        let camera = small_images.camera(v);
        (!outline.is_empty()).then(|| Shown { camera_id, frame, name: v.name.clone(), camera, image, outline })
    };
    views.into_par_iter().filter_map(show).collect()
}

/// The joint with the largest weight at each vertex.
pub(super) fn dominant(scene: &AvatarScene) -> Vec<u32> {
    let t = &scene.character.template;
    let joint = |v: usize| t.weights.row(v).max_by(|a, b| a.1.total_cmp(&b.1)).map_or(0, |w| w.0);
    (0..t.vertices.len()).map(joint).collect()
}

/// The silhouette of a posed template.
pub(super) fn draw(scene: &AvatarScene, surface: &[Vec3], joints: &[u32], camera: &Camera) -> Drawn {
    let faces = &scene.character.template.faces;
    let nearest = face_map(surface, faces, camera, NEAR);
    let covered: Vec<bool> = nearest.iter().map(|f| *f != NONE).collect();
    let width = camera.width as usize;
    let joint = |p: &DVec2| {
        let face = nearest[gs_core::cast::to_usize(p.y) * width + gs_core::cast::to_usize(p.x)];
        joints[faces[face as usize][0] as usize]
    };
    let middle = surface.iter().map(|v| v.as_dvec3()).sum::<DVec3>() / surface.len().max(1) as f64;
    let depth = camera.to_camera(middle).z;
    // A camera inside or behind the template sees no outline of it.
    let outline = if depth > NEAR { outline(&covered, width) } else { Vec::new() };
    let outline = outline.into_iter().map(|p| (p, joint(&p))).collect();
    Drawn { covered, outline, pixel: depth.max(NEAR) / camera.fx }
}

/// Pixels inside that have a neighbour outside, not counting the border of the image, where a silhouette is cut.
fn outline(inside: &[bool], width: usize) -> Vec<DVec2> {
    let height = inside.len() / width.max(1);
    let at = |x: usize, y: usize| inside[y * width + x];
    let mut out = Vec::new();
    for y in 1..height.saturating_sub(1) {
        for x in 1..width - 1 {
            if at(x, y) && !(at(x - 1, y) && at(x + 1, y) && at(x, y - 1) && at(x, y + 1)) {
                out.push(DVec2::new(x as f64, y as f64));
            }
        }
    }
    out
}

/// Row of the nearest of some points, of which there is one at least, and its distance, pixels.
pub(super) fn nearest(to: DVec2, among: &[DVec2]) -> (usize, f64) {
    let squares = among.iter().map(|p| p.distance_squared(to)).enumerate();
    let (row, square) = squares.fold((0, f64::INFINITY), |best, other| if other.1 < best.1 { other } else { best });
    (row, square.sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_outline_is_one_pixel_wide_and_leaves_the_border_out() {
        // A square of 4 × 4 in the middle of 8 × 8, and one that the border cuts.
        let square = |x0: usize, y0: usize| {
            let inside: Vec<bool> =
                (0..64).map(|i| (x0..x0 + 4).contains(&(i % 8)) && (y0..y0 + 4).contains(&(i / 8))).collect();
            outline(&inside, 8)
        };
        assert_eq!(square(2, 2).len(), 12);
        assert!(square(0, 2).iter().all(|p| p.x == 3.0 || (1.0..3.0).contains(&p.x) && (p.y == 2.0 || p.y == 5.0)));
        assert!(outline(&[true; 64], 8).is_empty());
        assert_eq!(nearest(DVec2::new(3.0, 4.0), &[DVec2::splat(9.0), DVec2::ZERO]), (1, 5.0));
    }
}
