//! The visual hull (Laurentini 1994): cells of a grid over the scene box that silhouettes agree on.
//!
//! A static scene keeps a cell that 95 % of the views that see it show inside the silhouette. In a moving scene every view
//! has its own time, so no cell agrees with all of them; views are ordered by time and a cell is kept if it agrees with 95 %
//! of *some* run of consecutive views (at least eight, about a twelfth of all): the union over time of the hulls of short
//! runs. Points are sampled uniformly in the kept cells and take the mean colour that the views of the best run show
//! there.
//!
//! Where the silhouettes are masks at a single timestamp ([`Dataset::at_first_time`]) all views must agree, and the box of the kept
//! cells is carved a second time, so that small objects keep their shape.

use std::sync::Arc;

use glam::{DVec3, Vec3};
use gs_core::{Camera, Rng, cast};
use rayon::prelude::*;

use super::cache::ImageCache;
use super::error::DataError;
use super::pixels::ImageU8;
use super::{Dataset, PointCloud, View};

/// Cells along each side of the cubic grid.
const SIDE: usize = 64;
/// Most views used; of more, an even selection.
const MAX_VIEWS: usize = 160;
/// Images are shrunk to about this many pixels per side.
const IMAGE_SIDE: f64 = 200.0;
/// Share of the views that must agree.
const AGREEMENT: f64 = 0.95;
/// Length of a run of views in a dynamic scene: at least this many, and the number of all views over `RUN_PART`.
pub(super) const MIN_RUN: usize = 8;
const RUN_PART: usize = 12;
/// Alpha above which a pixel belongs to the silhouette.
const OPAQUE: u8 = 16;

/// A silhouette at reduced size with its camera.
#[derive(Clone, Debug)]
pub struct Silhouette {
    /// Index of its view in the list it was made of.
    pub index: usize,
    /// The view's camera for the reduced image.
    pub camera: Camera,
    /// The reduced image; its alpha is the silhouette.
    pub image: Arc<ImageU8>,
}

/// Where a point is in a view: outside the frame or behind the camera, outside the silhouette, or inside with this colour.
#[derive(Clone, Copy, PartialEq)]
enum Verdict {
    Unseen,
    Outside,
    Inside([u8; 3]),
}

impl Silhouette {
    /// Which pixels are inside, row-major.
    pub fn inside(&self) -> Vec<bool> {
        self.image.data.chunks_exact(4).map(|p| p[3] > OPAQUE).collect()
    }

    fn verdict(&self, p: DVec3) -> Verdict {
        let c = self.camera.to_camera(p);
        if c.z <= 0.0 {
            return Verdict::Unseen;
        }
        let at = self.camera.to_pixel(c);
        let (w, h) = (self.image.width as f64, self.image.height as f64);
        if !(at.x >= 0.0 && at.x < w && at.y >= 0.0 && at.y < h) {
            return Verdict::Unseen;
        }
        let [r, g, b, a] = self.image.pixel(cast::to_usize(at.x), cast::to_usize(at.y));
        if a > OPAQUE { Verdict::Inside([r, g, b]) } else { Verdict::Outside }
    }
}

/// The kept cells.
pub(super) struct Hull {
    /// Centres, world units, and colours.
    pub(super) cells: Vec<(Vec3, [f32; 3])>,
    /// Sides of one cell, world units.
    size: Vec3,
}

impl Hull {
    pub(super) fn carve(data: &Dataset) -> Result<Self, DataError> {
        let views = silhouettes(&data.train, !data.has_alpha, data.max_image_mib)?;
        Ok(Self::of(&views, data, AGREEMENT))
    }

    fn of(views: &[Silhouette], data: &Dataset, agreement: f64) -> Self {
        let run = if data.dynamic { MIN_RUN.max(views.len() / RUN_PART) } else { views.len() }.min(views.len());
        let hull = Self::carve_box(views, run, data.scene_bounds(), agreement);
        let again = if data.dynamic || data.has_alpha { None } else { hull.bounds() };
        again.map_or(hull, |bounds| Self::carve_box(views, run, bounds, agreement))
    }

    /// The cells of a box that agree with some run of `run` consecutive views.
    fn carve_box(views: &[Silhouette], run: usize, [low, high]: [Vec3; 2], agreement: f64) -> Self {
        let size = (high - low) / SIDE as f32;
        let slab = |k: usize| {
            let centre = |i: usize, j: usize| low + size * Vec3::new(i as f32 + 0.5, j as f32 + 0.5, k as f32 + 0.5);
            let mut verdicts = vec![Verdict::Unseen; views.len()];
            let mut kept = Vec::new();
            for cell in 0..SIDE * SIDE {
                let p = centre(cell % SIDE, cell / SIDE);
                verdicts.iter_mut().zip(views).for_each(|(out, v)| *out = v.verdict(p.as_dvec3()));
                kept.extend(agreed_color(&verdicts, run, agreement).map(|color| (p, color)));
            }
            kept
        };
        let slabs: Vec<Vec<(Vec3, [f32; 3])>> = (0..SIDE).into_par_iter().map(slab).collect();
        Self { cells: slabs.concat(), size }
    }

    /// The box of the kept cells, wider by one cell on each side; none without cells.
    fn bounds(&self) -> Option<[Vec3; 2]> {
        let grown = |c: &(Vec3, [f32; 3])| [c.0 - 1.5 * self.size, c.0 + 1.5 * self.size];
        self.cells.iter().map(grown).reduce(|a, b| [a[0].min(b[0]), a[1].max(b[1])])
    }

    /// `n` points uniform in the kept cells.
    pub(super) fn sample(&self, n: usize, seed: u64) -> PointCloud {
        let mut points = PointCloud::default();
        for i in 0..n {
            let mut r = Rng::new(seed, "data.hull", 0, i as u64);
            let (centre, color) = self.cells[r.below(cast::to_u32(self.cells.len())) as usize];
            let jitter = Vec3::new(r.uniform(), r.uniform(), r.uniform()) - Vec3::splat(0.5);
            points.positions.push(centre + jitter * self.size);
            points.colors.push(color);
        }
        points
    }
}

/// A visual hull and the silhouettes that carved it; made by [`carve`].
pub struct Carved {
    /// The silhouettes used, ascending in time.
    pub silhouettes: Vec<Silhouette>,
    by_mask: bool,
    max_image_mib: Option<u32>,
    hull: Hull,
}

/// Carves the visual hull of the training views, whose cameras are replaced by `camera(&view.camera)`. A cell is kept where a
/// share `agreement`, in 0..1, of the views that see it show it inside. None where there are neither alpha nor masks.
///
/// # Errors
/// Those of decoding the images.
pub fn carve(data: &Dataset, agreement: f64, camera: impl Fn(&Camera) -> Camera) -> Result<Option<Carved>, DataError> {
    let train = data.train.iter().map(|v| View { camera: camera(&v.camera), ..v.clone() }).collect();
    let (points, bounds, dynamic) = (data.points.clone(), data.bounds, data.dynamic);
    let data = Dataset { train, points, bounds, dynamic, ..data.without_views() };
    if !data.has_alpha && data.train.iter().filter(|v| v.mask.is_some()).count() < MIN_RUN {
        return Ok(None);
    }
    let (by_mask, max_image_mib) = (!data.has_alpha, data.max_image_mib);
    let silhouettes = silhouettes(&data.train, by_mask, max_image_mib)?;
    let hull = Hull::of(&silhouettes, &data, agreement);
    Ok(Some(Carved { silhouettes, by_mask, max_image_mib, hull }))
}

impl Carved {
    /// The silhouettes of other views, such as held-out ones, ascending in time: an even selection of many.
    ///
    /// # Errors
    /// Those of decoding the images.
    pub fn silhouettes_of(&self, views: &[View]) -> Result<Vec<Silhouette>, DataError> {
        silhouettes(views, self.by_mask, self.max_image_mib)
    }

    /// Colours of the nearest projected cells in a camera's image, display-encoded RGB; none where no cell covers a pixel.
    /// Row-major.
    pub fn render(&self, camera: &Camera) -> Vec<Option<[u8; 3]>> {
        let (w, h) = (camera.width as usize, camera.height as usize);
        let mut nearest = vec![(f32::INFINITY, [0u8; 3]); w * h];
        let half = 0.5 * f64::from(self.hull.size.max_element());
        for (p, color) in &self.hull.cells {
            let c = camera.to_camera(p.as_dvec3());
            if c.z <= half {
                continue;
            }
            let (at, r) = (camera.to_pixel(c), half * camera.fx.max(camera.fy) / c.z);
            let (z, color) = (cast::to_f32(c.z), color.map(|v| cast::to_u8(v * 255.0)));
            let range = |x: f64, n: usize| cast::to_usize(x - r).min(n)..cast::to_usize(x + r + 1.0).min(n);
            for y in range(at.y, h) {
                let row = &mut nearest[y * w..(y + 1) * w];
                for pixel in &mut row[range(at.x, w)] {
                    if z < pixel.0 {
                        *pixel = (z, color);
                    }
                }
            }
        }
        nearest.into_iter().map(|(z, color)| z.is_finite().then_some(color)).collect()
    }

    /// Which pixels of a camera's image the projected cells cover, row-major.
    pub fn cover(&self, camera: &Camera) -> Vec<bool> {
        self.render(camera).iter().map(Option::is_some).collect()
    }

    /// Centres of the kept cells, world units, and their colours, display-encoded RGB in 0..1.
    pub fn cells(&self) -> &[(Vec3, [f32; 3])] {
        &self.hull.cells
    }
}

/// The views ascending in time, an even selection at reduced size; `by_mask` takes those with a mask, which becomes their alpha.
fn silhouettes(train: &[View], by_mask: bool, max_image_mib: Option<u32>) -> Result<Vec<Silhouette>, DataError> {
    let mut order: Vec<(usize, &View)> =
        train.iter().enumerate().filter(|(_, v)| !by_mask || v.mask.is_some()).collect();
    order.sort_by(|a, b| a.1.time.normalised.total_cmp(&b.1.time.normalised));
    let count = order.len().min(MAX_VIEWS);
    let chosen: Vec<(usize, &View)> = (0..count).map(|k| order[k * order.len() / count]).collect();
    let largest = chosen.iter().map(|(_, v)| v.camera.width.max(v.camera.height)).max().unwrap_or(1);
    let cache = ImageCache::new(0, IMAGE_SIDE / f64::from(largest)).with_max_image_mib(max_image_mib);
    let load = |&(index, v): &(usize, &View)| {
        let mut image = cache.get(v)?;
        if let Some(mask) = cache.mask(v)?.filter(|_| by_mask) {
            let pixels = Arc::make_mut(&mut image).data.chunks_exact_mut(4);
            pixels.zip(&mask.data).for_each(|(p, w)| p[3] = cast::to_u8(w * 255.0));
        }
        Ok(Silhouette { index, camera: cache.camera(v), image })
    };
    // An indexed parallel map keeps the order; of several errors the first in order is reported.
    chosen.par_iter().map(load).collect::<Vec<_>>().into_iter().collect()
}

/// The mean colour over the best run of consecutive views, if enough of those that see the cell show it inside.
fn agreed_color(verdicts: &[Verdict], run: usize, agreement: f64) -> Option<[f32; 3]> {
    let tally = |v: &Verdict| match v {
        Verdict::Unseen => (0i32, 0i32),
        Verdict::Outside => (0, 1),
        Verdict::Inside(_) => (1, 1),
    };
    let (mut inside, mut seen) = (0, 0);
    let mut best: Option<(f64, usize)> = None;
    for end in 0..verdicts.len() {
        let (i, s) = tally(&verdicts[end]);
        (inside, seen) = (inside + i, seen + s);
        if end >= run {
            let (i, s) = tally(&verdicts[end - run]);
            (inside, seen) = (inside - i, seen - s);
        }
        let enough = end + 1 >= run && 2 * seen as usize >= run;
        let part = f64::from(inside) / f64::from(seen.max(1));
        if enough && part >= agreement && best.is_none_or(|(b, _)| part > b) {
            best = Some((part, end));
        }
    }
    let (_, end) = best?;
    let (mut sum, mut count) = ([0.0f32; 3], 0.0f32);
    for v in &verdicts[end + 1 - run..=end] {
        if let Verdict::Inside(c) = v {
            sum.iter_mut().zip(c).for_each(|(a, &b)| *a += f32::from(b) / 255.0);
            count += 1.0;
        }
    }
    Some(sum.map(|s| s / count.max(1.0)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_enough_agreement_keeps_a_cell() {
        let (i, o, u) = (Verdict::Inside([255, 0, 51]), Verdict::Outside, Verdict::Unseen);
        assert_eq!(agreed_color(&[i, i, o, o], 2, AGREEMENT), Some([1.0, 0.0, 0.2]), "inside early, gone later");
        assert_eq!(agreed_color(&[i, o, i, o], 2, AGREEMENT), None);
        assert_eq!(agreed_color(&[i, u, u, u], 4, AGREEMENT), None, "too few views see it");
        assert_eq!(agreed_color(&[i, i, u, u], 4, AGREEMENT), Some([1.0, 0.0, 0.2]));
    }
}
