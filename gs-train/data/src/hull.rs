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
/// Most views used; of more, a selection ([`spread`](super::spread())).
const MAX_VIEWS: usize = 160;
/// Images are shrunk to about this many pixels per side.
const IMAGE_SIDE: f64 = 200.0;
/// Most bytes of reduced images that are kept for [`carve`].
const IMAGE_BYTES: usize = 64 << 20;
/// Share of the views that must agree.
const AGREEMENT: f64 = 0.95;
/// Length of a run of views in a dynamic scene: at least this many, and the number of all views over `RUN_PART`.
const MIN_RUN: usize = 8;
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

/// Where a point is in a view: outside the frame or behind the camera, outside the silhouette, or inside.
#[derive(Clone, Copy, PartialEq)]
enum Verdict {
    Unseen,
    Outside,
    Inside,
}

impl Silhouette {
    /// Which pixels are inside, row-major.
    pub fn inside(&self) -> Vec<bool> {
        self.image.data.chunks_exact(4).map(|p| p[3] > OPAQUE).collect()
    }

    /// The pixel that shows a point, as an index of the row-major image; none outside the frame and behind the camera.
    #[inline(always)]
    fn pixel(&self, p: DVec3) -> Option<usize> {
        let c = self.camera.to_camera(p);
        let at = self.camera.to_pixel(c);
        let (w, h) = (self.image.width as f64, self.image.height as f64);
        let seen = c.z > 0.0 && at.x >= 0.0 && at.x < w && at.y >= 0.0 && at.y < h;
        seen.then(|| cast::to_usize(at.y) * self.image.width + cast::to_usize(at.x))
    }

    /// Where points are in the view, whose silhouette is [`inside`](Self::inside).
    fn judge(&self, inside: &[bool], points: &[DVec3; SIDE], to: &mut [Verdict; SIDE]) {
        for (p, to) in points.iter().zip(to) {
            *to = match self.pixel(*p) {
                None => Verdict::Unseen,
                Some(at) if inside[at] => Verdict::Inside,
                Some(_) => Verdict::Outside,
            };
        }
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
        let views = silhouettes(&data.train, !data.has_alpha, data.max_image_mib, None);
        // Of several errors the first in order is reported.
        Ok(Self::of(&views.into_iter().collect::<Result<Vec<_>, _>>()?, data, AGREEMENT))
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
        if views.is_empty() {
            return Self { cells: Vec::new(), size };
        }
        let insides: Vec<Vec<bool>> = views.par_iter().map(Silhouette::inside).collect();
        let agreement = Agreement::new(run, agreement);
        let slab = |k: usize| {
            let centre = |i: usize, j: usize| low + size * Vec3::new(i as f32 + 0.5, j as f32 + 0.5, k as f32 + 0.5);
            // Of each view, where the cells of a row are in it.
            let mut verdicts = vec![[Verdict::Unseen; SIDE]; views.len()];
            let mut kept = Vec::new();
            for j in 0..SIDE {
                let points: [DVec3; SIDE] = std::array::from_fn(|i| centre(i, j).as_dvec3());
                for ((view, inside), verdicts) in views.iter().zip(&insides).zip(&mut verdicts) {
                    view.judge(inside, &points, verdicts);
                }
                for i in 0..SIDE {
                    let Some(end) = agreement.best_run(&verdicts, i) else { continue };
                    let of_run = end + 1 - run..=end;
                    let shows = of_run.filter(|&v| verdicts[v][i] == Verdict::Inside).map(|v| &views[v]);
                    kept.push((centre(i, j), mean_color(shows, points[i])));
                }
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

/// Whether there are alpha or masks to carve a hull.
pub(super) fn has_silhouettes(data: &Dataset) -> bool {
    data.has_alpha || data.train.iter().filter(|v| v.mask.is_some()).count() >= MIN_RUN
}

/// An empty cache of the images that [`carve`] looks at; none where there are neither alpha nor masks. What it holds
/// ([`ImageCache::keep_reduced`]) is not decoded again.
pub fn images(data: &Dataset) -> Option<ImageCache> {
    let empty = || ImageCache::new(IMAGE_BYTES, scale(&chosen(&data.train, !data.has_alpha)));
    has_silhouettes(data).then(|| empty().with_max_image_mib(data.max_image_mib))
}

/// Carves the visual hull of the training views. A cell is kept where a share `agreement`, in 0..1, of the views that see it show
/// it inside. None where there are neither alpha nor masks. `images` may hold some of the images ([`images`]).
///
/// # Errors
/// Those of decoding the images or masks, at least one: one for each view of the selection that cannot be read, ascending in time.
pub fn carve(data: &Dataset, agreement: f64, images: Option<&ImageCache>) -> Result<Option<Carved>, Vec<DataError>> {
    if !has_silhouettes(data) {
        return Ok(None);
    }
    let (by_mask, max_image_mib) = (!data.has_alpha, data.max_image_mib);
    let silhouettes = all_read(silhouettes(&data.train, by_mask, max_image_mib, images))?;
    let hull = Hull::of(&silhouettes, data, agreement);
    Ok(Some(Carved { silhouettes, by_mask, max_image_mib, hull }))
}

impl Carved {
    /// The same silhouettes of `data` carved under other poses: `camera` gives the rotation and the translation of each.
    pub fn under(&self, data: &Dataset, agreement: f64, camera: impl Fn(&Camera) -> Camera) -> Self {
        let train = data.train.iter().map(|v| View { camera: camera(&v.camera), ..v.clone() }).collect();
        let (points, bounds, dynamic) = (data.points.clone(), data.bounds, data.dynamic);
        let data = Dataset { train, points, bounds, dynamic, ..data.without_views() };
        let silhouettes: Vec<Silhouette> =
            self.silhouettes.iter().map(|s| Silhouette { camera: camera(&s.camera), ..s.clone() }).collect();
        let hull = Hull::of(&silhouettes, &data, agreement);
        Self { silhouettes, hull, ..*self }
    }

    /// The silhouettes of other views, such as held-out ones, ascending in time: a selection of many. `images` as for [`carve`].
    ///
    /// # Errors
    /// As [`carve`].
    pub fn silhouettes_of(
        &self,
        views: &[View],
        images: Option<&ImageCache>,
    ) -> Result<Vec<Silhouette>, Vec<DataError>> {
        all_read(silhouettes(views, self.by_mask, self.max_image_mib, images))
    }

    /// Whether [`Dataset::start`] has points of the hull of `data`, whose training views carved this one.
    pub fn gives_points(&self, data: &Dataset) -> bool {
        !Hull::of(&self.silhouettes, data, AGREEMENT).cells.is_empty()
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

/// A selection of the views with their indices, ascending in time; `by_mask` takes those with a mask.
fn chosen(views: &[View], by_mask: bool) -> Vec<(usize, &View)> {
    let mut order: Vec<(usize, &View)> =
        views.iter().enumerate().filter(|(_, v)| !by_mask || v.mask.is_some()).collect();
    order.sort_by(|a, b| a.1.time.normalised.total_cmp(&b.1.time.normalised));
    super::spread(order.len(), MAX_VIEWS).into_iter().map(|k| order[k]).collect()
}

/// Factor on the size of the images of chosen views.
fn scale(chosen: &[(usize, &View)]) -> f64 {
    let largest = chosen.iter().map(|(_, v)| v.camera.width.max(v.camera.height)).max().unwrap_or(1);
    IMAGE_SIDE / f64::from(largest)
}

/// The chosen views at reduced size, or why they cannot be read, ascending in time; `by_mask` takes the masks for alpha. Images are those of
/// `images` if it has their scale.
fn silhouettes(
    views: &[View],
    by_mask: bool,
    max_image_mib: Option<u32>,
    images: Option<&ImageCache>,
) -> Vec<Result<Silhouette, DataError>> {
    let chosen = chosen(views, by_mask);
    let own = ImageCache::new(0, scale(&chosen)).with_max_image_mib(max_image_mib);
    let cache = images.filter(|i| i.scale() == own.scale()).unwrap_or(&own);
    let load = |&(index, v): &(usize, &View)| {
        let mut image = cache.get(v)?;
        if let Some(mask) = cache.mask(v)?.filter(|_| by_mask) {
            let pixels = Arc::make_mut(&mut image).data.chunks_exact_mut(4);
            pixels.zip(&mask.data).for_each(|(p, w)| p[3] = cast::to_u8(w * 255.0));
        }
        Ok(Silhouette { index, camera: cache.camera(v), image })
    };
    // An indexed parallel map keeps the order.
    chosen.par_iter().map(load).collect()
}

/// The silhouettes, or the errors of all that could not be read.
fn all_read(silhouettes: Vec<Result<Silhouette, DataError>>) -> Result<Vec<Silhouette>, Vec<DataError>> {
    let mut errors = Vec::new();
    let read = silhouettes.into_iter().filter_map(|s| s.map_err(|e| errors.push(e)).ok()).collect();
    if errors.is_empty() { Ok(read) } else { Err(errors) }
}

/// When a run of consecutive views agrees on a cell.
struct Agreement {
    /// Views in a run.
    run: usize,
    /// Of so many views of a run that see a cell, how many must show it inside.
    least: Vec<u32>,
}

impl Agreement {
    fn new(run: usize, share: f64) -> Self {
        let agrees = |inside: u32, seen: u32| f64::from(inside) / f64::from(seen.max(1)) >= share;
        let least = |seen: u32| (0..=seen).find(|inside| agrees(*inside, seen)).unwrap_or(u32::MAX);
        Self { run, least: (0..=cast::to_u32(run)).map(least).collect() }
    }

    /// The last view of the run that agrees best on a cell, if one does: at least half of it see the cell. The first of equals.
    fn best_run<const CELLS: usize>(&self, verdicts: &[[Verdict; CELLS]], cell: usize) -> Option<usize> {
        let (mut inside, mut seen) = (0u32, 0u32);
        // The share of the best run so far, and its last view.
        let mut best = ([0, 1], None);
        for (end, of_view) in verdicts.iter().enumerate() {
            inside += u32::from(of_view[cell] == Verdict::Inside);
            seen += u32::from(of_view[cell] != Verdict::Unseen);
            if end + 1 < self.run {
                continue;
            }
            let agrees = 2 * seen as usize >= self.run && inside >= self.least[seen as usize];
            if agrees && (best.1.is_none() || inside * best.0[1] > best.0[0] * seen) {
                best = ([inside, seen], Some(end));
            }
            let first = verdicts[end + 1 - self.run][cell];
            inside -= u32::from(first == Verdict::Inside);
            seen -= u32::from(first != Verdict::Unseen);
        }
        best.1
    }
}

/// The mean colour of a point in views that show it.
fn mean_color<'a>(views: impl Iterator<Item = &'a Silhouette>, p: DVec3) -> [f32; 3] {
    let (mut sum, mut count) = ([0.0f32; 3], 0.0f32);
    for view in views {
        let Some(at) = view.pixel(p) else { continue };
        let color = &view.image.data[4 * at..][..3];
        sum.iter_mut().zip(color).for_each(|(a, &b)| *a += f32::from(b) / 255.0);
        count += 1.0;
    }
    sum.map(|s| s / count.max(1.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_enough_agreement_keeps_a_cell() {
        let (i, o, u) = (Verdict::Inside, Verdict::Outside, Verdict::Unseen);
        let end = |run, verdicts: [Verdict; 4]| Agreement::new(run, AGREEMENT).best_run(&verdicts.map(|v| [v]), 0);
        assert_eq!(end(2, [i, i, o, o]), Some(1), "inside early, gone later");
        assert_eq!(end(2, [i, o, i, o]), None);
        assert_eq!(end(4, [i, u, u, u]), None, "too few views see it");
        assert_eq!(end(4, [i, i, u, u]), Some(3));
        let end = |verdicts: [Verdict; 4]| Agreement::new(2, 0.5).best_run(&verdicts.map(|v| [v]), 0);
        assert_eq!(end([o, i, i, i]), Some(2), "the first of the best");
    }

    #[test]
    fn a_cell_has_the_mean_colour_of_the_views_that_show_it() {
        let camera = Camera::look_at(2, 2, 0.8, DVec3::Z * 4.0, DVec3::ZERO, DVec3::Y).unwrap();
        let view = |color: [u8; 4]| Silhouette {
            index: 0,
            camera: camera.clone(),
            image: Arc::new(ImageU8 { width: 2, height: 2, data: color.repeat(4) }),
        };
        let views = [view([255, 0, 51, 255]), view([0, 0, 51, 255])];
        assert_eq!(mean_color(views.iter(), DVec3::splat(0.01)), [0.5, 0.0, 0.2]);
        assert_eq!(views[0].pixel(DVec3::Z * 5.0), None, "behind the camera");
        assert_eq!(mean_color(views.iter(), DVec3::Z * 5.0), [0.0; 3]);
    }
}
