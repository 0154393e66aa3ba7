//! Points to start from: those the data bring along, else a visual hull, else random points in a box.
//!
//! **Visual hull** (Laurentini 1994), where images carry alpha. A grid of cells over [`Dataset::scene_bounds`] is carved
//! by the silhouettes. A static scene keeps a cell that 95 % of the views that see it show inside the silhouette.
//! In a moving scene every view has its own time, so no cell agrees with all of them; views are ordered by time and a cell is
//! kept if it agrees with 95 % of *some* run of consecutive views (at least eight, about a twelfth of
//! all): the union over time of the hulls of short stretches. Points are then drawn uniformly from the kept cells and
//! take the mean colour that the views of the best run show there.
//!
//! Images without alpha whose views have masks ([`View::mask`]) are carved by these. Masks cut out what moves, so half of the
//! points are drawn from that hull and the others from the whole box.
//!
//! Where masks cut parts out of a single moment ([`Dataset::at_first_moment`]) all views must agree, and the box of what they
//! keep is carved again, so that small things keep their shape.
//!
//! Everything is a function of data set, count and seed.

use std::sync::Arc;

use glam::{DVec3, Vec3};
use gs_core::Rng;
use rayon::prelude::*;

use super::cache::ImageCache;
use super::error::DataError;
use super::pixels::ImageU8;
use super::{Dataset, PointCloud, View};

/// Cells along each side of the grid.
const SIDE: usize = 64;
/// Most views used; more are thinned evenly.
const MAX_VIEWS: usize = 160;
/// Images are shrunk to about this many pixels per side.
const IMAGE_SIDE: f64 = 200.0;
/// Part of the views that must agree.
const AGREEMENT: f64 = 0.95;
/// A run of views in a moving scene: at least this many, and this part of all.
const LEAST_RUN: usize = 8;
const RUN_PART: usize = 12;
/// Alpha above which a pixel belongs to the silhouette.
const OPAQUE: u8 = 16;

impl Dataset {
    /// About `n` points to start from. Points of the data: all of them, or a random `n`; a hull: exactly `n`; where
    /// neither is possible `n` points uniform in [`Dataset::scene_bounds`] with mid grey.
    ///
    /// # Errors
    /// Whatever decoding the training images finds.
    pub fn initial_points(&self, n: usize, seed: u64) -> Result<PointCloud, DataError> {
        if let Some(points) = self.points.as_ref().filter(|p| !p.positions.is_empty()) {
            return Ok(subset(points, n, seed));
        }
        if self.has_alpha {
            let hull = Hull::carve(self)?;
            if !hull.cells.is_empty() {
                return Ok(hull.draw(n, seed));
            }
        }
        let masked = self.train.iter().filter(|v| v.mask.is_some()).count();
        if !self.has_alpha && masked >= LEAST_RUN {
            let hull = Hull::carve(self)?;
            if !hull.cells.is_empty() {
                let (mut cloud, rest) = (hull.draw(n / 2, seed), uniform(self.scene_bounds(), n - n / 2, seed));
                cloud.positions.extend(rest.positions);
                cloud.colors.extend(rest.colors);
                return Ok(cloud);
            }
        }
        Ok(uniform(self.scene_bounds(), n, seed))
    }

    /// The data as if only the first training moment had been photographed.
    pub fn at_first_moment(&self) -> Self {
        let first = self.train.iter().map(|v| v.time.normalised).fold(f32::INFINITY, f32::min);
        let train = self.train.iter().filter(|v| v.time.normalised == first).cloned().collect();
        let (points, bounds) = (self.points.clone(), Some(self.scene_bounds()));
        Self { train, points, bounds, dynamic: false, ..self.without_views() }
    }

    /// Whether the data say where the scene is: by points, silhouettes, a box, or masks.
    pub fn has_start(&self) -> bool {
        let masked = || self.train.iter().any(|v| v.mask.is_some());
        self.points.is_some() || self.has_alpha || self.bounds.is_some() || masked()
    }
}

fn subset(points: &PointCloud, n: usize, seed: u64) -> PointCloud {
    if points.positions.len() <= n {
        return points.clone();
    }
    let mut rows = Rng::new(seed, "data.subset", 0, 0).permutation(points.positions.len());
    rows.truncate(n);
    rows.sort_unstable();
    PointCloud {
        positions: rows.iter().map(|&r| points.positions[r as usize]).collect(),
        colors: rows.iter().map(|&r| points.colors[r as usize]).collect(),
    }
}

fn uniform([low, high]: [Vec3; 2], n: usize, seed: u64) -> PointCloud {
    let position = |i| {
        let mut r = Rng::new(seed, "data.uniform", 0, i as u64);
        low + (high - low) * Vec3::new(r.uniform(), r.uniform(), r.uniform())
    };
    PointCloud { positions: (0..n).map(position).collect(), colors: vec![[0.5; 3]; n] }
}

/// A small silhouette with its camera.
struct Silhouette {
    camera: gs_core::Camera,
    image: Arc<ImageU8>,
}

/// What a view says about a point.
#[derive(Clone, Copy, PartialEq)]
enum Verdict {
    Unseen,
    Outside,
    Inside([u8; 3]),
}

impl Silhouette {
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
        let [r, g, b, a] = self.image.pixel(at.x as usize, at.y as usize);
        if a > OPAQUE { Verdict::Inside([r, g, b]) } else { Verdict::Outside }
    }
}

/// The kept cells: their centres and colours.
struct Hull {
    cells: Vec<(Vec3, [f32; 3])>,
    size: Vec3,
}

impl Hull {
    fn carve(data: &Dataset) -> Result<Self, DataError> {
        let views = silhouettes(&data.train, !data.has_alpha)?;
        let run = if data.dynamic { LEAST_RUN.max(views.len() / RUN_PART) } else { views.len() }.min(views.len());
        let hull = Self::carve_box(&views, run, data.scene_bounds());
        let again = if data.dynamic || data.has_alpha { None } else { hull.bounds() };
        Ok(again.map_or(hull, |bounds| Self::carve_box(&views, run, bounds)))
    }

    /// The cells of a box that agree with some run of so many views.
    fn carve_box(views: &[Silhouette], run: usize, [low, high]: [Vec3; 2]) -> Self {
        let size = (high - low) / SIDE as f32;
        let slab = |k: usize| {
            let centre = |i: usize, j: usize| low + size * Vec3::new(i as f32 + 0.5, j as f32 + 0.5, k as f32 + 0.5);
            let mut verdicts = vec![Verdict::Unseen; views.len()];
            let mut kept = Vec::new();
            for cell in 0..SIDE * SIDE {
                let p = centre(cell % SIDE, cell / SIDE);
                verdicts.iter_mut().zip(views).for_each(|(out, v)| *out = v.verdict(p.as_dvec3()));
                kept.extend(agreed_color(&verdicts, run).map(|color| (p, color)));
            }
            kept
        };
        let slabs: Vec<Vec<(Vec3, [f32; 3])>> = (0..SIDE).into_par_iter().map(slab).collect();
        Self { cells: slabs.concat(), size }
    }

    /// The box of the kept cells and one more all around; none without cells.
    fn bounds(&self) -> Option<[Vec3; 2]> {
        let grown = |c: &(Vec3, [f32; 3])| [c.0 - 1.5 * self.size, c.0 + 1.5 * self.size];
        self.cells.iter().map(grown).reduce(|a, b| [a[0].min(b[0]), a[1].max(b[1])])
    }

    fn draw(&self, n: usize, seed: u64) -> PointCloud {
        let mut points = PointCloud::default();
        for i in 0..n {
            let mut r = Rng::new(seed, "data.hull", 0, i as u64);
            let (centre, color) = self.cells[r.below(self.cells.len() as u32) as usize];
            let jitter = Vec3::new(r.uniform(), r.uniform(), r.uniform()) - Vec3::splat(0.5);
            points.positions.push(centre + jitter * self.size);
            points.colors.push(color);
        }
        points
    }
}

/// The views in order of time, thinned and shrunk; `by_mask` takes those with a mask, which becomes their alpha.
fn silhouettes(train: &[View], by_mask: bool) -> Result<Vec<Silhouette>, DataError> {
    let mut order: Vec<&View> = train.iter().filter(|v| !by_mask || v.mask.is_some()).collect();
    order.sort_by(|a, b| a.time.normalised.total_cmp(&b.time.normalised));
    let count = order.len().min(MAX_VIEWS);
    let chosen: Vec<&View> = (0..count).map(|k| order[k * order.len() / count]).collect();
    let largest = chosen.iter().map(|v| v.camera.width.max(v.camera.height)).max().unwrap_or(1);
    let cache = ImageCache::new(0, IMAGE_SIDE / f64::from(largest));
    let load = |v: &&View| {
        let mut image = cache.get(v)?;
        if let Some(mask) = cache.mask(v)?.filter(|_| by_mask) {
            let pixels = Arc::make_mut(&mut image).data.chunks_exact_mut(4);
            pixels.zip(&mask.data).for_each(|(p, w)| p[3] = (w * 255.0) as u8);
        }
        Ok(Silhouette { camera: cache.camera(v), image })
    };
    // An indexed parallel map keeps the order; of several errors the first in order is reported.
    chosen.par_iter().map(load).collect::<Vec<_>>().into_iter().collect()
}

/// The mean colour over the best run of consecutive views, if enough of those that see the cell show it inside.
fn agreed_color(verdicts: &[Verdict], run: usize) -> Option<[f32; 3]> {
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
        if enough && part >= AGREEMENT && best.is_none_or(|(b, _)| part > b) {
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
    use crate::data::ImageSource;
    use crate::synth::{SynthOptions, generate};

    fn options() -> SynthOptions {
        SynthOptions { size: 64, train_views: 60, val_views: 0, test_views: 0, ..SynthOptions::default() }
    }

    #[test]
    fn the_hull_of_a_static_scene_holds_the_scene_and_little_more() {
        let data = generate("static", &options()).unwrap();
        let cloud = data.dataset.initial_points(4000, 1).unwrap();
        assert_eq!((cloud.positions.len(), cloud.colors.len()), (4000, 4000));
        // No camera looks from below, so some space under the slab cannot be carved.
        let outer = cloud.positions.iter().filter(|p| p.abs().max_element() > 1.1).count();
        assert!(outer < 160, "{outer} of 4000 points in the empty outer 40 % of the box");
        for (body, b) in data.truth.bodies().iter().enumerate() {
            let centre = data.truth.position_of(body, DVec3::ZERO, 0.0).unwrap().as_vec3();
            let near = cloud.positions.iter().any(|p| (*p - centre).length() < 0.1);
            assert!(near, "points in \"{}\"", b.name);
        }
        let above = cloud.positions.iter().filter(|p| p.z > 0.75).count();
        assert!(above < 40, "{above} of 4000 points above everything");
    }

    #[test]
    fn a_moving_scene_keeps_the_places_its_bodies_pass() {
        let data = generate("balls", &SynthOptions { train_views: 120, ..options() }).unwrap();
        let cloud = data.dataset.initial_points(20_000, 1).unwrap();
        for t in [0.1, 0.5, 0.9] {
            for body in 0..4 {
                let centre = data.truth.position_of(body, DVec3::ZERO, t).unwrap().as_vec3();
                let near = cloud.positions.iter().filter(|p| (**p - centre).length() < 0.12).count();
                assert!(near > 3, "body {body} at {t}: {near} points");
            }
        }
        let outer = cloud.positions.iter().filter(|p| p.abs().max_element() > 1.1).count();
        assert!(outer < 3000, "{outer} of 20000 points in the outer 40 % of the box");
    }

    #[test]
    fn the_same_seed_gives_the_same_points_for_any_number_of_threads() {
        let data = generate("balls", &SynthOptions { train_views: 20, ..options() }).unwrap().dataset;
        let with = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| data.initial_points(500, 3).unwrap())
        };
        assert_eq!(with(1), with(3));
        assert_ne!(with(1), data.initial_points(500, 4).unwrap());
    }

    #[test]
    fn without_alpha_points_fill_the_box_and_given_points_are_kept() {
        let mut data = generate("static", &SynthOptions { train_views: 2, ..options() }).unwrap().dataset;
        data.has_alpha = false;
        let cloud = data.initial_points(2000, 0).unwrap();
        let mean: Vec3 = cloud.positions.iter().sum::<Vec3>() / 2000.0;
        assert!(mean.length() < 0.1 && cloud.positions.iter().all(|p| p.abs().max_element() <= 1.3));
        data.points = Some(cloud.clone());
        assert_eq!(data.initial_points(5000, 0).unwrap(), cloud);
        assert_eq!(data.initial_points(10, 0).unwrap().positions.len(), 10);
    }

    /// The same data with alpha moved into masks.
    fn masked(mut data: Dataset) -> Dataset {
        data.has_alpha = false;
        for v in &mut data.train {
            let ImageSource::Memory(image) = &v.image else { panic!("generated images are in memory") };
            let mut mask = ImageU8::clone(image);
            mask.data.chunks_exact_mut(4).for_each(|p| p.fill(p[3]));
            v.mask = Some(ImageSource::Memory(Arc::new(mask)));
        }
        data
    }

    /// Half of the points lie in the hull of these.
    #[test]
    fn masks_carve_where_there_is_no_alpha() {
        let data = generate("balls", &options()).unwrap().dataset;
        let hull = data.initial_points(1000, 2).unwrap();
        let data = masked(data);
        let cloud = data.initial_points(2000, 2).unwrap();
        assert_eq!(cloud.positions.len(), 2000);
        let near = |p: &Vec3| hull.positions.iter().any(|q| (*p - *q).length() < 0.1);
        let inside = |points: &[Vec3]| points.iter().filter(|p| near(p)).count();
        let (first, rest) = (inside(&cloud.positions[..1000]), inside(&cloud.positions[1000..]));
        assert!(first > 900 && rest < 700, "{first} and {rest} of 1000 near the hull");
        assert!(data.has_start() && cloud.colors[1500] == [0.5; 3]);
    }

    #[test]
    fn small_things_have_points_where_they_are_at_the_first_moment() {
        let options = SynthOptions { cameras: 12, moments: 4, ..options() };
        let made = generate("falling", &options).unwrap();
        let first = masked(made.dataset).at_first_moment();
        assert!(!first.dynamic && first.train.len() == 12);
        let cloud = first.initial_points(2000, 2).unwrap();
        let ball = made.truth.position_of(0, DVec3::ZERO, 0.0).unwrap().as_vec3();
        let near = cloud.positions[..1000].iter().filter(|p| p.distance(ball) < 0.3).count();
        assert!(near > 20, "{near} points of the hull in the ball");
    }

    #[test]
    fn only_enough_agreement_keeps_a_cell() {
        let (i, o, u) = (Verdict::Inside([255, 0, 51]), Verdict::Outside, Verdict::Unseen);
        assert_eq!(agreed_color(&[i, i, o, o], 2), Some([1.0, 0.0, 0.2]), "inside early, gone later");
        assert_eq!(agreed_color(&[i, o, i, o], 2), None);
        assert_eq!(agreed_color(&[i, u, u, u], 4), None, "too few views see it");
        assert_eq!(agreed_color(&[i, i, u, u], 4), Some([1.0, 0.0, 0.2]));
    }
}
