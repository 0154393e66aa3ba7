//! How well each image fits the coloured visual hull under its own pose, under shifts of it and under the poses of other
//! views; single wrong poses and images that do not belong.
//!
//! The misfit of an image and a rendering of the hull is, per pixel of the silhouette: the mean difference of colours where both are, 1 where
//! the hull is missing, and 0.25 where the hull is outside the silhouette (a moving scene's hull is the union of what was somewhere
//! at some time). A view is flagged only where another explanation fits far better than its own pose, by more than anything
//! gains in the views of the same data.

use super::silhouettes::Silhouettes;
use gs_core::Camera;
use gs_data::ImageU8;
use gs_data::hull::Carved;
use rayon::prelude::*;

/// Misfits are measured on about this many pixels a side.
const SIDE: usize = 64;
/// Largest shift that is tried, in steps of one of these pixels.
const MAX_SHIFT: usize = 8;
/// An explanation flags a view if it gains so many times what the views that gain most after the flagged ones do, and at least so much:
/// shifts, exchanges of two poses, and misfits inside the silhouette of images that fit nowhere.
const SHIFT: Limit = Limit { times: 3.0, least: 0.06 };
/// The same of few silhouettes, whose hull is coarse.
const SHIFT_OF_FEW: Limit = Limit { times: 3.0, least: 0.15 };
const EXCHANGE: Limit = Limit { times: 3.0, least: 0.03 };
const FOREIGN: Limit = Limit { times: 1.5, least: 0.2 };
/// What each of two exchanged views must gain, and as a share of what the other gains.
const MIN_EACH: f64 = 0.01;
const MIN_PART: f64 = 0.35;
/// A fault that is tried must exceed the limit by this factor: it was not among the views that carved the hull.
const MARGIN: f64 = 1.3;
/// Places below a flagged one that says what is usual: one more may be at fault.
const BELOW: usize = 2;
/// A view is not exchanged if a shift gains this share of what the other's pose gains.
const MOST_BY_SHIFT: f64 = 0.75;
/// Fewest silhouettes that say what is usual, and that tell exchanged ones.
const MIN_VIEWS: usize = 12;
const MANY_VIEWS: usize = 32;
/// Share of the exchanges tried that must be found before any view is flagged of one.
const LIKELY: f64 = 0.8;
/// Share of the views that fit worst: others are not flagged by corners either.
const WORST: f64 = 0.1;
/// Views that are turned, and pairs that are exchanged, to learn what would be found.
const TRIED_VIEWS: usize = 12;
const TRIED_PAIRS: usize = 40;

/// What is wrong with the pose of a view, by index among the silhouettes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Wrong {
    /// Two views have each other's pose.
    Exchanged(usize, usize),
    /// The view looks elsewhere, by so many degrees at least.
    Turned(usize, f64),
    /// The image shows something else.
    Foreign(usize),
}

/// Faults put into the data's own poses that would have been found, of those tried.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Found {
    pub(super) found: usize,
    pub(super) tried: usize,
}

/// When a value stands out from a list.
#[derive(Clone, Copy)]
struct Limit {
    times: f64,
    least: f64,
}

impl Limit {
    /// The value that must be exceeded where the others, descending, are these.
    fn over(self, others: &[f64]) -> f64 {
        let usual = others.get(BELOW - 1).or(others.last()).copied().unwrap_or(0.0);
        self.least.max(self.times * usual)
    }

    /// How many values at the head of a descending list stand out.
    fn outstanding(self, values: &[f64]) -> usize {
        (0..values.len()).take_while(|&k| values[k] > self.over(&values[k + 1..])).count()
    }
}

impl Found {
    /// Found of tried, 0..1.
    pub(super) fn share(self) -> f64 {
        self.found as f64 / self.tried.max(1) as f64
    }
}

/// Every `stride`-th pixel of every `stride`-th row, with a margin of nothing.
struct Grid {
    /// Without the margin.
    width: usize,
    height: usize,
    /// Red, green, blue, and [`THERE`] or 0; row-major.
    pixels: Vec<[u8; 4]>,
}

/// The fourth value of a pixel where something is.
const THERE: u8 = 255;

impl Grid {
    /// Of an image whose pixels are `at(index)`.
    fn of([w, h]: [usize; 2], stride: usize, margin: usize, at: impl Fn(usize) -> [u8; 4]) -> Self {
        let [width, height] = [w, h].map(|n| n.div_ceil(stride));
        let row = width + 2 * margin;
        let mut pixels = vec![[0; 4]; row * (height + 2 * margin)];
        for y in 0..height {
            let to = &mut pixels[(y + margin) * row + margin..][..width];
            to.iter_mut().enumerate().for_each(|(x, p)| *p = at(y * stride * w + x * stride));
        }
        Self { width, height, pixels }
    }
}

/// An image, and its silhouette on a grid of about [`SIDE`] pixels a side.
struct Shape<'a> {
    image: &'a ImageU8,
    stride: usize,
    grid: Grid,
    /// Grid pixels by which sums are divided: those of the silhouette, or of the median one if it has more; a sliver would
    /// make much of little.
    area: f64,
}

type Rendering = Vec<Option<[u8; 3]>>;

/// Misfits of all views.
pub(super) struct HullFit<'a> {
    carved: &'a Carved,
    cameras: Vec<&'a Camera>,
    shapes: Vec<Shape<'a>>,
    /// `others[i][j]`: the misfit of image `i` under the pose of view `j`.
    others: Vec<Vec<f64>>,
    /// The misfit inside the silhouette alone, under the own pose.
    inner: Vec<f64>,
    /// Most that a shift of the rendering gains, and the shift, pixels.
    shifts: Vec<(f64, [isize; 2])>,
}

impl<'a> HullFit<'a> {
    /// None where there are too few silhouettes, or of different sizes.
    pub(super) fn of(s: &'a Silhouettes) -> Option<Self> {
        let images: Vec<&ImageU8> = s.shapes.iter().map(|(_, h)| &*h.image).collect();
        let first = images.first()?;
        if images.len() < MIN_VIEWS || images.iter().any(|i| (i.width, i.height) != (first.width, first.height)) {
            return None;
        }
        let stride = (first.width.max(first.height) / SIDE).max(1);
        let mut shapes: Vec<Shape<'_>> = images.into_iter().map(|image| Shape::of(image, stride)).collect();
        let areas: Vec<f64> = shapes.iter().map(|s| s.area).collect();
        let least = super::median(&areas).max(1.0);
        shapes.iter_mut().for_each(|s| s.area = s.area.max(least));
        let cameras: Vec<&Camera> = s.shapes.iter().map(|(_, h)| &h.camera).collect();
        let renderings: Vec<Rendering> = cameras.par_iter().map(|c| s.carved.render(c)).collect();
        let grids: Vec<Grid> = renderings.par_iter().zip(&shapes).map(|(r, h)| h.grid_of(r)).collect();
        let others = shapes.par_iter().map(|h| grids.iter().map(|g| h.misfit(g)).collect()).collect();
        let inner = shapes.par_iter().zip(&renderings).map(|(h, r)| inner_misfit(h.image, r)).collect();
        let shifts = shapes.par_iter().zip(&grids).map(|(h, g)| h.best_shift(g)).collect();
        Some(Self { carved: &s.carved, cameras, shapes, others, inner, shifts })
    }

    /// Number of views that are compared.
    pub(super) fn count(&self) -> usize {
        self.shapes.len()
    }

    /// The misfit of a view under its own pose.
    fn own(&self, k: usize) -> f64 {
        self.others[k][k]
    }

    /// What exchanging the poses of two views gains; nothing where either loses by it.
    fn exchange(&self, i: usize, j: usize) -> f64 {
        both([self.own(i) - self.others[i][j], self.own(j) - self.others[j][i]])
    }

    /// What it would gain if these two were exchanged now.
    fn exchanged_back(&self, i: usize, j: usize) -> f64 {
        both([self.others[i][j] - self.own(i), self.others[j][i] - self.own(j)])
    }

    /// Whether a shift of one of two views explains most of what their exchange gains there: another view may stand where it
    /// looks by chance.
    fn is_shift(&self, [i, j]: [usize; 2]) -> bool {
        let by_shift = |k: usize, other: usize| {
            let (shift, exchange) = (self.shifts[k].0, self.own(k) - self.others[k][other]);
            shift > self.shift_limit().least.max(MOST_BY_SHIFT * exchange)
        };
        by_shift(i, j) || by_shift(j, i)
    }

    fn shift_limit(&self) -> Limit {
        if self.shapes.len() < MANY_VIEWS { SHIFT_OF_FEW } else { SHIFT }
    }

    /// Whether a view is among those that fit worst: inside the silhouette, or by what a shift gains.
    pub(super) fn is_doubtful(&self, k: usize) -> bool {
        let most = gs_core::cast::to_usize((WORST * self.shapes.len() as f64).ceil());
        let rank = |value: &dyn Fn(usize) -> f64| (0..self.shapes.len()).filter(|j| value(*j) > value(k)).count();
        rank(&|j| self.inner[j]) < most || rank(&|j| self.shifts[j].0) < most
    }

    /// Disjoint pairs with what their exchange gains, the largest first.
    fn exchanges(&self) -> Vec<(f64, [usize; 2])> {
        let pairs = (0..self.shapes.len()).flat_map(|i| (0..i).map(move |j| [j, i]));
        let mut all: Vec<(f64, [usize; 2])> = pairs.map(|p| (self.exchange(p[0], p[1]), p)).collect();
        all.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
        let mut free = vec![true; self.shapes.len()];
        all.retain(|(_, [i, j])| {
            let both = free[*i] && free[*j];
            if both {
                (free[*i], free[*j]) = (false, false);
            }
            both
        });
        all
    }

    /// What is wrong, each view once.
    pub(super) fn wrong(&self) -> Vec<Wrong> {
        let all: Vec<usize> = (0..self.shapes.len()).collect();
        let (foreign, limit) = outstanding(&all, FOREIGN, |k| self.inner[k]);
        let foreign: Vec<usize> = foreign.into_iter().filter(|k| self.fits_nowhere(*k, limit)).collect();
        let mut out: Vec<Wrong> = foreign.iter().map(|k| Wrong::Foreign(*k)).collect();
        let mut exchanges = self.exchanges();
        exchanges.retain(|e| !e.1.iter().any(|k| foreign.contains(k)) && !self.is_shift(e.1));
        let gains: Vec<f64> = exchanges.iter().map(|e| e.0).collect();
        // Where many exchanges would not be found, one that is found may be chance.
        let count = if self.exchanges_found().share() < LIKELY { 0 } else { EXCHANGE.outstanding(&gains) };
        let exchanged: Vec<[usize; 2]> = exchanges[..count].iter().map(|e| e.1).collect();
        out.extend(exchanged.iter().map(|&[i, j]| Wrong::Exchanged(i, j)));
        let named = |k: &usize| foreign.contains(k) || exchanged.as_flattened().contains(k);
        let left: Vec<usize> = all.into_iter().filter(|k| !named(k)).collect();
        let (turned, _) = outstanding(&left, self.shift_limit(), |k| self.shifts[k].0);
        out.extend(turned.into_iter().map(|k| Wrong::Turned(k, self.degrees(k, self.shifts[k].1))));
        out
    }

    /// Whether an image differs from the hull under the shift that fits best, and under the other pose that fits best.
    fn fits_nowhere(&self, k: usize, limit: f64) -> bool {
        let best = (0..self.shapes.len()).min_by(|a, b| self.others[k][*a].total_cmp(&self.others[k][*b]));
        let shifted = turned(self.cameras[k], self.shifts[k].1);
        let cameras = best.map(|j| self.cameras[j].clone()).into_iter().chain([shifted]);
        cameras.into_iter().all(|c| inner_misfit(self.shapes[k].image, &self.carved.render(&c)) > limit)
    }

    fn degrees(&self, k: usize, shift: [isize; 2]) -> f64 {
        let c = self.cameras[k];
        (shift[0] as f64 / c.fx).hypot(shift[1] as f64 / c.fy).atan().to_degrees()
    }

    /// Turns views of the data by an angle, one at a time, and counts those that would be flagged.
    pub(super) fn turns_found(&self, degrees: f64) -> Found {
        let tried: Vec<usize> = gs_data::evenly(self.shapes.len(), TRIED_VIEWS).collect();
        let found = |k: usize| {
            let i = tried[k];
            let camera = turned_by(self.cameras[i], degrees.to_radians(), 2.4 * k as f64);
            let shape = &self.shapes[i];
            let gain = shape.best_shift(&shape.grid_of(&self.carved.render(&camera))).0;
            gain > MARGIN * self.shift_limit().over(&self.sorted(i, |k| self.shifts[k].0))
        };
        Found { found: (0..tried.len()).into_par_iter().filter(|k| found(*k)).count(), tried: tried.len() }
    }

    /// Values of all views but one, descending.
    fn sorted(&self, but: usize, value: impl Fn(usize) -> f64) -> Vec<f64> {
        let mut all: Vec<f64> = (0..self.shapes.len()).filter(|k| *k != but).map(value).collect();
        all.sort_by(|a, b| b.total_cmp(a));
        all
    }

    /// Turns images upside down and exchanges their colours, one at a time, and counts those that would be found foreign.
    pub(super) fn foreign_found(&self) -> Found {
        let n = self.shapes.len();
        let tried: Vec<usize> = gs_data::evenly(n, TRIED_VIEWS).collect();
        let found = |&i: &usize| {
            let limit = MARGIN * FOREIGN.over(&self.sorted(i, |k| self.inner[k]));
            let mut image = self.shapes[i].image.clone();
            image.data.as_chunks_mut::<4>().0.reverse();
            image.data.as_chunks_mut::<4>().0.iter_mut().for_each(|p| p[..3].rotate_left(1));
            let other = self.carved.render(self.cameras[(i + n / 2) % n]);
            [self.carved.render(self.cameras[i]), other].iter().all(|r| inner_misfit(&image, r) > limit)
        };
        Found { found: tried.par_iter().filter(|i| found(i)).count(), tried: tried.len() }
    }

    /// Exchanges poses of pairs, one pair at a time, and counts those that would be found.
    pub(super) fn exchanges_found(&self) -> Found {
        let n = self.shapes.len();
        if n < MANY_VIEWS {
            return Found { found: 0, tried: TRIED_PAIRS };
        }
        let all = self.exchanges();
        let pairs: Vec<[usize; 2]> = (0..TRIED_PAIRS)
            .map(|k| {
                let i = k * n / TRIED_PAIRS;
                let j = (i + 1 + (7 * k + n / 2) % (n - 1)) % n;
                [i.min(j), i.max(j)]
            })
            .collect();
        // Exchanged, such a pair would gain what it loses now.
        let found = |p: &&[usize; 2]| {
            let others = all.iter().filter(|e| !e.1.iter().any(|k| p.contains(k)));
            self.exchanged_back(p[0], p[1]) > MARGIN * EXCHANGE.over(&others.map(|e| e.0).collect::<Vec<_>>())
        };
        Found { found: pairs.iter().filter(found).count(), tried: pairs.len() }
    }
}

/// The sum of what two views gain; nothing where one gains next to nothing.
fn both(each: [f64; 2]) -> f64 {
    let [less, more] = [each[0].min(each[1]), each[0].max(each[1])];
    if less > MIN_EACH.max(MIN_PART * more) { less + more } else { 0.0 }
}

/// The views of a list whose values stand out, and what they exceed.
fn outstanding(list: &[usize], limit: Limit, value: impl Fn(usize) -> f64) -> (Vec<usize>, f64) {
    let mut order = list.to_vec();
    order.sort_by(|a, b| value(*b).total_cmp(&value(*a)));
    let values: Vec<f64> = order.iter().map(|k| value(*k)).collect();
    let count = limit.outstanding(&values);
    (order[..count].to_vec(), limit.over(&values[count..]))
}

/// A camera turned such that its image moves by a number of pixels.
fn turned(c: &Camera, [x, y]: [isize; 2]) -> Camera {
    super::silhouettes::turn(c, glam::DVec3::new(-y as f64 / c.fy, x as f64 / c.fx, 0.0))
}

/// A camera turned by an angle about an axis across its view in some direction, radians.
pub(super) fn turned_by(c: &Camera, angle: f64, direction: f64) -> Camera {
    super::silhouettes::turn(c, glam::DVec3::new(direction.cos(), direction.sin(), 0.2).normalize() * angle)
}

impl<'a> Shape<'a> {
    /// With the silhouette's own area.
    fn of(image: &'a ImageU8, stride: usize) -> Self {
        let at = |i: usize| {
            let p = &image.data[4 * i..][..4];
            [p[0], p[1], p[2], if p[3] > 127 { THERE } else { 0 }]
        };
        let grid = Grid::of([image.width, image.height], stride, 0, at);
        let area = grid.pixels.iter().filter(|p| p[3] == THERE).count() as f64;
        Self { image, stride, grid, area }
    }

    /// A rendering of the image's size, with room for shifts.
    fn grid_of(&self, rendering: &Rendering) -> Grid {
        let size = [self.image.width, self.image.height];
        Grid::of(size, self.stride, MAX_SHIFT, |i| rendering[i].map_or([0; 4], |[r, g, b]| [r, g, b, THERE]))
    }

    /// The misfit of the image and a rendering.
    fn misfit(&self, rendering: &Grid) -> f64 {
        self.share(self.sum(rendering, [0, 0], u64::MAX))
    }

    /// The misfit whose sum over all pixels this is.
    fn share(&self, sum: u64) -> f64 {
        sum as f64 / (f64::from(ALL) * self.area)
    }

    /// The misfit of the image and a rendering moved by some grid pixels, [`MAX_SHIFT`] at most, summed over all pixels; where
    /// the sum reaches `most`, over as many rows as that takes. The rows in the middle, where something is, come first.
    fn sum(&self, rendering: &Grid, [dx, dy]: [isize; 2], most: u64) -> u64 {
        let Grid { width, height, .. } = self.grid;
        let row = width + 2 * MAX_SHIFT;
        let (top, left) = (MAX_SHIFT.wrapping_add_signed(-dy), MAX_SHIFT.wrapping_add_signed(-dx));
        let mut total = 0u64;
        for k in 0..height {
            let y = if k % 2 == 0 { height / 2 + k / 2 } else { height / 2 - k.div_ceil(2) };
            let own = &self.grid.pixels[y * width..][..width];
            let other = &rendering.pixels[(top + y) * row + left..][..width];
            // A row cannot overflow; sums that check it are not vectorised.
            total += u64::from(own.iter().zip(other).fold(0u32, |sum, (p, c)| sum.wrapping_add(misfit(*p, *c))));
            if total >= most {
                break;
            }
        }
        total
    }

    /// Most that a shift of the rendering gains, and the shift, pixels of the image.
    fn best_shift(&self, rendering: &Grid) -> (f64, [isize; 2]) {
        let now = self.sum(rendering, [0, 0], u64::MAX);
        let most = MAX_SHIFT.cast_signed();
        let mut best = (now, [0, 0]);
        for shift in (-most..=most).flat_map(|y| (-most..=most).map(move |x| [x, y])) {
            let sum = self.sum(rendering, shift, best.0);
            if sum < best.0 {
                best = (sum, shift);
            }
        }
        (self.share(now) - self.share(best.0), best.1.map(|d| d * self.stride.cast_signed()))
    }
}

/// What a pixel of the silhouette adds to the misfit where the hull is missing; a quarter of it where the hull is outside.
const ALL: u32 = 4 * 3 * 255;

/// What a pixel of an image and one of a rendering add to the misfit: masks in place of branches.
#[inline(always)]
fn misfit(p: [u8; 4], c: [u8; 4]) -> u32 {
    let [inside, covered] = [p[3], c[3]];
    let color = |k: usize| u32::from(p[k].abs_diff(c[k]) & inside & covered);
    let [missing, outside] = [inside & !covered, !inside & covered].map(u32::from);
    let there = u32::from(THERE);
    let colors = color(0).wrapping_add(color(1)).wrapping_add(color(2)).wrapping_mul(4);
    colors.wrapping_add(missing.wrapping_mul(ALL / there)).wrapping_add(outside.wrapping_mul(ALL / 4 / there))
}

/// The misfit over the silhouette alone, of all its pixels; their mean.
fn inner_misfit(image: &ImageU8, rendering: &Rendering) -> f64 {
    let all = image.data.as_chunks::<4>().0.iter().zip(rendering);
    let inside = all.filter(|(p, _)| p[3] > 127).map(|(p, c)| c.map_or(ALL, |c| 4 * difference(*p, c)));
    let (sum, count) = inside.fold((0u64, 0usize), |(sum, count), misfit| (sum + u64::from(misfit), count + 1));
    sum as f64 / f64::from(ALL) / count.max(1) as f64
}

/// The sum of the differences of two colours, 0..=765.
fn difference(p: [u8; 4], c: [u8; 3]) -> u32 {
    (0..3).map(|k| u32::from(p[k].abs_diff(c[k]))).sum()
}
