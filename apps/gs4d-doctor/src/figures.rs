//! Figures of a check-up: the hull over silhouettes, points over images, a plan of the cameras, matched corners.

use super::Figure;
use super::silhouettes::Silhouettes;
use glam::{DVec2, DVec3, Vec3};
use gs_core::{Image, cast};
use gs_data::{Dataset, ImageCache, ImageU8, View};

/// Side of a plan, pixels.
const PLAN_SIZE: usize = 420;
/// Views shown per kind of figure.
const MAX_FIGURES: usize = 3;
/// Most points plotted in a figure.
const MAX_POINTS: usize = 4000;
/// Most cameras plotted in a plan.
const MAX_CAMERAS: usize = 200;
/// Most lines between pixels of two images.
const MAX_MARKS: usize = 120;

const GREEN: [f32; 3] = [0.2, 0.8, 0.35];
const RED: [f32; 3] = [0.95, 0.25, 0.2];
const BLUE: [f32; 3] = [0.25, 0.5, 1.0];
const GREY: [f32; 3] = [0.6, 0.6, 0.65];

/// Every figure except that of matched corners.
pub(super) fn all(data: &Dataset, small_images: &ImageCache, silhouettes: Option<&Silhouettes>) -> Vec<Figure> {
    let mut out: Vec<Figure> = silhouettes.into_iter().flat_map(|s| hulls(data, s)).collect();
    let chosen = gs_data::evenly(data.train.len(), MAX_FIGURES).map(|k| &data.train[k]);
    if let Some(points) = &data.points {
        out.extend(chosen.filter_map(|v| dotted(v, &points.positions, small_images)));
    }
    let cells = silhouettes.map_or(Vec::new(), |s| s.carved.cells().iter().map(|c| c.0).collect());
    let points = data.points.as_ref().map_or(cells, |p| p.positions.clone());
    out.extend(plans(data, &points));
    out
}

/// Silhouettes with what the hull covers: green inside both, red what is not covered, blue what lies outside.
fn hulls(data: &Dataset, s: &Silhouettes) -> Vec<Figure> {
    let n = s.carved.silhouettes.len();
    let show = |k: usize| {
        let shape = &s.carved.silhouettes[k];
        let out = tinted(&shape.image, s.carved.cover(&shape.camera));
        let caption = format!(
            "{}: green is carved and seen, red is seen and not carved, blue is carved and not seen (where things move: seen at another time)",
            data.train[shape.index].name
        );
        Figure { topic: "poses", caption, image: out }
    };
    gs_data::evenly(n, MAX_FIGURES).map(show).collect()
}

/// An image with what should cover its silhouette: green inside both, red in the silhouette alone, blue outside it.
pub(super) fn tinted(image: &ImageU8, covered: impl IntoIterator<Item = bool>) -> Image {
    let mut out = image.over([0.12; 3]);
    for (i, (p, covered)) in image.data.chunks_exact(4).zip(covered).enumerate() {
        let tint = match (p[3] > 127, covered) {
            (true, true) => Some((GREEN, 0.25)),
            (true, false) => Some((RED, 0.75)),
            (false, true) => Some((BLUE, 0.5)),
            (false, false) => None,
        };
        if let Some((color, share)) = tint {
            blend(&mut out.data[3 * i..3 * i + 3], color, share);
        }
    }
    out
}

/// An image beside a rendering of the hull from its pose.
pub(super) fn beside_hull(image: &ImageU8, rendering: &[Option<[u8; 3]>]) -> Image {
    let left = image.over([0.12; 3]);
    let pixel = |c: &Option<[u8; 3]>| c.map_or([0.12; 3], |c| c.map(|v| f32::from(v) / 255.0));
    let right = Image { data: rendering.iter().flat_map(pixel).collect(), ..left.clone() };
    side_by_side(&left, &right, &[])
}

/// An image with the points that project into it, near ones red, far ones blue.
fn dotted(v: &View, points: &[Vec3], small_images: &ImageCache) -> Option<Figure> {
    let mut image = small_images.get(v).ok()?.over([0.12; 3]);
    image.data.iter_mut().for_each(|c| *c *= 0.6);
    let camera = small_images.camera(v);
    let mut inside = 0usize;
    let seen: Vec<(DVec2, f64)> = gs_data::evenly(points.len(), MAX_POINTS)
        .map(|k| camera.to_camera(points[k].as_dvec3()))
        .filter(|c| c.z > 0.0)
        .map(|c| (camera.to_pixel(c), c.z))
        .collect();
    let near = seen.iter().map(|s| s.1).fold(f64::INFINITY, f64::min);
    let far = seen.iter().map(|s| s.1).fold(0.0, f64::max).max(near + 1e-9);
    for (at, z) in &seen {
        let share = cast::to_f32((far - z) / (far - near));
        let color: [f32; 3] = std::array::from_fn(|c| RED[c] * share + BLUE[c] * (1.0 - share));
        inside += usize::from(dot(&mut image, *at, color));
    }
    let caption = format!(
        "{}: {inside} of {} points fall into it (near ones red, far ones blue)",
        v.name,
        points.len().min(MAX_POINTS)
    );
    Some(Figure { topic: "init", caption, image })
}

/// Cameras, box and points (or cells of the hull) from above and from the side.
fn plans(data: &Dataset, points: &[Vec3]) -> Vec<Figure> {
    [("from +z (x to the right, y up)", [0, 1]), ("from −y (x to the right, z up)", [0, 2])]
        .map(|(name, axes)| Figure {
            topic: "bound",
            caption: format!("cameras (blue, with their lines of sight), box (grey) and points (green) {name}"),
            image: plan(data, points, axes),
        })
        .into()
}

fn plan(data: &Dataset, points: &[Vec3], [i, j]: [usize; 2]) -> Image {
    let [low, high] = data.scene_bounds().map(Vec3::as_dvec3);
    let centres: Vec<DVec3> = data.train.iter().map(|v| v.camera.position()).collect();
    let corners = centres.iter().copied().chain([low, high]);
    let (mut from, mut to) = (DVec3::INFINITY, DVec3::NEG_INFINITY);
    corners.for_each(|c| (from, to) = (from.min(c), to.max(c)));
    let size = (to - from).max_element().max(1e-9) * 1.1;
    let middle = 0.5 * (from + to);
    let scale = PLAN_SIZE as f64 / size;
    let put = |p: DVec3| {
        DVec2::new((p[i] - middle[i]) * scale, -(p[j] - middle[j]) * scale) + DVec2::splat(0.5 * PLAN_SIZE as f64)
    };
    let mut image =
        Image { width: PLAN_SIZE, height: PLAN_SIZE, channels: 3, data: vec![0.07; PLAN_SIZE * PLAN_SIZE * 3] };
    let box_corners = [(low[i], low[j]), (high[i], low[j]), (high[i], high[j]), (low[i], high[j])].map(|(a, b)| {
        let mut p = DVec3::ZERO;
        (p[i], p[j]) = (a, b);
        put(p)
    });
    (0..4).for_each(|k| line(&mut image, box_corners[k], box_corners[(k + 1) % 4], GREY));
    for k in gs_data::evenly(points.len(), MAX_POINTS) {
        dot(&mut image, put(points[k].as_dvec3()), GREEN);
    }
    for k in gs_data::evenly(centres.len(), MAX_CAMERAS) {
        let (c, forward) = (centres[k], data.train[k].camera.forward());
        line(&mut image, put(c), put(c + 0.08 * size * forward), BLUE.map(|v| 0.6 * v));
        dot(&mut image, put(c), BLUE);
    }
    image
}

/// Two images with lines between pixels: green where they agree, red where not.
pub(super) fn side_by_side(a: &Image, b: &Image, marks: &[([DVec2; 2], bool)]) -> Image {
    let (width, height) = (a.width + b.width, a.height.max(b.height));
    let mut out = Image { width, height, channels: 3, data: vec![0.0; width * height * 3] };
    for (image, left) in [(a, 0), (b, a.width)] {
        for y in 0..image.height {
            let to = (y * width + left) * 3;
            let row = &image.data[y * image.width * 3..(y + 1) * image.width * 3];
            out.data[to..to + row.len()]
                .iter_mut()
                .zip(row)
                .for_each(|(o, v)| *o = if marks.is_empty() { *v } else { 0.6 * v });
        }
    }
    let shift = DVec2::new(a.width as f64, 0.0);
    for ([p, q], agrees) in gs_data::evenly(marks.len(), MAX_MARKS).map(|k| &marks[k]) {
        line(&mut out, *p, *q + shift, if *agrees { GREEN } else { RED });
    }
    out
}

fn blend(pixel: &mut [f32], color: [f32; 3], share: f32) {
    pixel.iter_mut().zip(color).for_each(|(p, c)| *p += share * (c - *p));
}

/// A dot of 3×3 pixels; whether its middle is inside.
fn dot(image: &mut Image, at: DVec2, color: [f32; 3]) -> bool {
    for k in 0..9 {
        let beside = at.floor() + DVec2::new(f64::from(k % 3 - 1), f64::from(k / 3 - 1));
        paint(image, beside, color, if k == 4 { 1.0 } else { 0.5 });
    }
    inside(image, at)
}

fn line(image: &mut Image, from: DVec2, to: DVec2, color: [f32; 3]) {
    let steps = cast::to_usize((to - from).abs().max_element().clamp(1.0, 4000.0));
    for k in 0..=steps {
        let p = from.lerp(to, k as f64 / steps as f64);
        paint(image, p, color, 0.7);
    }
}

/// Blends a colour into the pixel that a point lies in, if it lies in one.
fn paint(image: &mut Image, at: DVec2, color: [f32; 3], share: f32) {
    if inside(image, at) {
        blend(image.pixel_mut(cast::to_usize(at.x), cast::to_usize(at.y)), color, share);
    }
}

fn inside(image: &Image, at: DVec2) -> bool {
    at.cmpge(DVec2::ZERO).all() && at.x < image.width as f64 && at.y < image.height as f64
}
