//! Photographs: can they be read, do they show something, is one of them there twice, are they alike in exposure and
//! sharpness, do alpha and masks make sense.

use super::{Finding, Verdict, luma, median};
use gs_data::{Dataset, ImageCache, ImageU8, Split, View};
use rayon::prelude::*;
use std::collections::{BTreeMap, BTreeSet};
use std::hash::{DefaultHasher, Hasher};

/// Most photographs looked at; of more, evenly.
const MOST: usize = 1500;
/// Sides of photographs in which corners are looked for, pixels.
const SMALL: f64 = 480.0;
/// A photograph whose values spread less than this shows nothing, of 0..255.
const FLAT: f64 = 1.5;
/// Photographs this much darker or brighter than usual, as a factor.
const EXPOSURE: f64 = 1.8;
/// Photographs with less than this part of the usual detail are blurred.
const SHARPNESS: f64 = 0.3;
/// Size of the corners in which alpha is looked at, as a part of the sides.
const CORNER: f64 = 0.06;

/// Cells along each side of a thumbnail.
const THUMB: usize = 24;

/// What a photograph is like.
#[derive(Clone, Debug)]
struct Traits {
    /// Mean luma of what is opaque, 0..255, and its spread.
    mean: f64,
    spread: f64,
    /// Mean absolute Laplacian of luma where opaque.
    detail: f64,
    /// Share of the picture that is opaque, and of its corners.
    opaque: f64,
    corners: f64,
    /// Alike where all pixels are.
    hash: u64,
    /// Mean luma, over black, of cells of the picture, [`THUMB`]² of them, row by row.
    thumb: Vec<f32>,
}

/// What tells a photograph from others.
pub(super) struct Print<'a> {
    pub(super) view: &'a View,
    pub(super) hash: u64,
    pub(super) thumb: &'a [f32],
}

/// A photograph that was looked at.
struct Seen {
    split: Split,
    index: usize,
    traits: Result<Traits, (String, &'static str, String)>,
}

/// All photographs that were looked at.
pub(super) struct Looked {
    seen: Vec<Seen>,
    total: usize,
    /// Masks that cannot be read, and those that count nothing.
    masks: [Vec<String>; 2],
    masked: usize,
    largest: u32,
}

/// Looks at photographs and masks of all splits.
pub(super) fn look(data: &Dataset, photographs: &ImageCache) -> Looked {
    let all: Vec<(Split, usize)> =
        Split::ALL.iter().flat_map(|&s| (0..data.views(s).len()).map(move |i| (s, i))).collect();
    let count = all.len().min(MOST);
    let chosen: Vec<(Split, usize)> = (0..count).map(|k| all[k * all.len() / count]).collect();
    let see = |&(split, index): &(Split, usize)| {
        let found = photographs.get(&data.views(split)[index]);
        let traits = found.map(|i| traits(&i)).map_err(|e| (e.to_string(), e.code(), e.fix()));
        Seen { split, index, traits }
    };
    let seen: Vec<Seen> = chosen.par_iter().map(see).collect();
    let masks = chosen.par_iter().filter_map(|&(s, i)| mask(&data.views(s)[i], photographs)).collect::<Vec<_>>();
    let named = |empty: bool| masks.iter().filter(|m| m.1 == Some(empty)).map(|m| m.0.clone()).collect();
    let views = || Split::ALL.iter().flat_map(|&s| data.views(s));
    let largest = views().map(|v| v.camera.width.max(v.camera.height)).max().unwrap_or(1);
    Looked { seen, total: all.len(), masks: [named(false), named(true)], masked: masks.len(), largest }
}

/// Name of a masked view, and whether its mask counts nothing (`true`) or cannot be read (`false`); nothing if it is right.
fn mask(v: &View, photographs: &ImageCache) -> Option<(String, Option<bool>)> {
    v.mask.as_ref()?;
    let state = match photographs.mask(v) {
        Ok(Some(m)) if m.data.iter().all(|w| *w < 0.5) => Some(true),
        Ok(_) => None,
        Err(e) => return Some((e.to_string(), Some(false))),
    };
    Some((v.name.clone(), state))
}

fn traits(image: &ImageU8) -> Traits {
    let (w, h) = (image.width, image.height);
    let grey: Vec<f64> =
        image.data.as_chunks().0.iter().map(|&[r, g, b, _]| f64::from(luma([r, g, b].map(f32::from)))).collect();
    let solid: Vec<bool> = image.data.chunks_exact(4).map(|p| p[3] > 127).collect();
    let inside = || grey.iter().zip(&solid).filter(|(_, s)| **s).map(|(g, _)| *g);
    let count = inside().count().max(1) as f64;
    let mean = inside().sum::<f64>() / count;
    let spread = (inside().map(|g| (g - mean).powi(2)).sum::<f64>() / count).sqrt();
    let (mut detail, mut places) = (0.0, 0usize);
    for y in 1..h.saturating_sub(1) {
        for x in 1..w.saturating_sub(1) {
            let i = y * w + x;
            if [i, i - 1, i + 1, i - w, i + w].iter().all(|&k| solid[k]) {
                detail += (4.0 * grey[i] - grey[i - 1] - grey[i + 1] - grey[i - w] - grey[i + w]).abs();
                places += 1;
            }
        }
    }
    let side = |n: usize| ((n as f64 * CORNER) as usize).clamp(1, n);
    let at_corner = |i: usize| {
        let near = |x: usize, n: usize| x < side(n) || x >= n - side(n);
        near(i % w, w) && near(i / w, h)
    };
    let corners: Vec<bool> = (0..w * h).filter(|&i| at_corner(i)).map(|i| solid[i]).collect();
    let share = |s: &[bool]| s.iter().filter(|v| **v).count() as f64 / s.len().max(1) as f64;
    let mut hash = DefaultHasher::new();
    hash.write(&image.data);
    Traits {
        mean,
        spread,
        detail: detail / places.max(1) as f64,
        opaque: share(&solid),
        corners: share(&corners),
        hash: hash.finish(),
        thumb: thumbnail(image, &grey),
    }
}

/// Mean luma of the cells of a picture, over black.
fn thumbnail(image: &ImageU8, grey: &[f64]) -> Vec<f32> {
    let (mut sums, mut counts) = (vec![0.0f64; THUMB * THUMB], vec![0.0f64; THUMB * THUMB]);
    for (i, g) in grey.iter().enumerate() {
        let (x, y) = (i % image.width, i / image.width);
        let cell = y * THUMB / image.height * THUMB + x * THUMB / image.width;
        sums[cell] += g * f64::from(image.data[4 * i + 3]) / 255.0;
        counts[cell] += 1.0;
    }
    sums.iter().zip(counts).map(|(s, c)| (s / c.max(1.0)) as f32).collect()
}

impl Looked {
    /// The factor that makes photographs small enough to look for corners.
    pub(super) fn small_scale(&self) -> f64 {
        (SMALL / f64::from(self.largest)).min(1.0)
    }

    /// The data without training views whose photograph cannot be read.
    pub(super) fn readable(&self, data: &Dataset) -> Dataset {
        let bad = |i: usize| self.seen.iter().any(|s| s.split == Split::Train && s.index == i && s.traits.is_err());
        let kept = data.train.iter().enumerate().filter(|(i, _)| !bad(*i)).map(|(_, v)| v.clone()).collect();
        Dataset { train: kept, ..data.clone() }
    }

    /// A hash of the pixels of each photograph, and its thumbnail.
    pub(super) fn prints<'a>(&'a self, data: &'a Dataset) -> Vec<Print<'a>> {
        self.good(data).map(|(view, _, t)| Print { view, hash: t.hash, thumb: &t.thumb }).collect()
    }

    fn good<'s, 'd>(&'s self, data: &'d Dataset) -> impl Iterator<Item = (&'d View, Split, &'s Traits)> {
        self.seen.iter().filter_map(move |s| Some((&data.views(s.split)[s.index], s.split, s.traits.as_ref().ok()?)))
    }

    /// What was found.
    pub(super) fn findings(&self, data: &Dataset) -> Vec<Finding> {
        let mut out = self.unreadable(data);
        out.extend(self.blank(data));
        out.extend(self.twice(data));
        out.extend(self.exposure(data));
        out.extend(self.blurred(data));
        out.extend(self.alpha(data));
        if out.is_empty() {
            let sizes: BTreeSet<_> = self.good(data).map(|(v, _, _)| (v.camera.width, v.camera.height)).collect();
            let size = match sizes.iter().next() {
                Some((w, h)) if sizes.len() == 1 => format!("{w}x{h}"),
                _ => format!("{} sizes", sizes.len()),
            };
            let part = if self.seen.len() < self.total { format!(" (of {})", self.total) } else { String::new() };
            out.push(Finding::ok("images", format!("{}{part} photographs can be read, {size}", self.seen.len())));
        }
        out.extend(self.masks(data));
        out
    }

    fn unreadable(&self, data: &Dataset) -> Vec<Finding> {
        let mut kinds: BTreeMap<&'static str, Vec<(String, String)>> = BTreeMap::new();
        for s in &self.seen {
            if let Err((what, code, fix)) = &s.traits {
                kinds
                    .entry(code)
                    .or_default()
                    .push((format!("{}: {what}", data.views(s.split)[s.index].name), fix.clone()));
            }
        }
        let finding = |(code, list): (&'static str, Vec<(String, String)>)| {
            let what = format!("{} of {} photographs cannot be used", list.len(), self.seen.len());
            let fix = list[0].1.clone();
            Finding::new("images", code, Verdict::Problem, what).at(list.into_iter().map(|l| l.0)).fix(fix)
        };
        kinds.into_iter().map(finding).collect()
    }

    fn blank(&self, data: &Dataset) -> Option<Finding> {
        let flat = |t: &Traits| t.spread < FLAT || t.opaque == 0.0;
        let names: Vec<&str> = self.good(data).filter(|(_, _, t)| flat(t)).map(|(v, _, _)| v.name.as_str()).collect();
        (!names.is_empty()).then(|| {
            let what = format!("{} photographs show nothing: one colour, or transparent all over", names.len());
            let fix = "remove them, or export them again";
            Finding::new("images", "images.blank", Verdict::Problem, what).at(names).fix(fix)
        })
    }

    /// The same pixels under two names; twice in training is a warning, in training and elsewhere a problem.
    fn twice(&self, data: &Dataset) -> Vec<Finding> {
        let mut by_hash: BTreeMap<u64, Vec<(&View, Split)>> = BTreeMap::new();
        for (v, split, t) in self.good(data).filter(|(_, _, t)| t.spread >= FLAT) {
            by_hash.entry(t.hash).or_default().push((v, split));
        }
        let named = |list: &[(&View, Split)]| {
            list.iter().map(|(v, s)| format!("{} ({s:?})", v.name)).collect::<Vec<_>>().join(" = ").to_lowercase()
        };
        let several = || by_hash.values().filter(|l| l.len() > 1);
        let crosses = |l: &[(&View, Split)]| {
            l.iter().any(|(_, s)| *s == Split::Train) && l.iter().any(|(_, s)| *s != Split::Train)
        };
        let leaks: Vec<String> = several().filter(|l| crosses(l)).map(|l| named(l)).collect();
        let copies: Vec<String> = several().filter(|l| !crosses(l)).map(|l| named(l)).collect();
        let mut out = Vec::new();
        if !leaks.is_empty() {
            let what = format!(
                "{} photographs are in training and held out as well: scores would be of what was learnt by heart",
                leaks.len()
            );
            out.push(
                Finding::new("split", "split.leak", Verdict::Problem, what)
                    .at(leaks)
                    .fix("remove them from one of the lists"),
            );
        }
        if !copies.is_empty() {
            let what = format!(
                "{} photographs are there more than once, pixel for pixel, under other poses or times",
                copies.len()
            );
            let fix = "check how frames were extracted: a frozen video, or copies under other names";
            out.push(Finding::new("images", "images.twice", Verdict::Warning, what).at(copies).fix(fix));
        }
        out
    }

    fn exposure(&self, data: &Dataset) -> Option<Finding> {
        let usual = median(&self.good(data).map(|(_, _, t)| t.mean).collect::<Vec<_>>());
        let odd = |t: &Traits| t.mean > EXPOSURE * usual + 4.0 || EXPOSURE * (t.mean + 4.0) < usual;
        let names: Vec<String> = self
            .good(data)
            .filter(|(_, _, t)| t.spread >= FLAT && odd(t))
            .map(|(v, _, t)| format!("{} ({:.0})", v.name, t.mean))
            .collect();
        (!names.is_empty()).then(|| {
            let what =
                format!("{} photographs are much darker or brighter than usual (mean {usual:.0} of 255)", names.len());
            let fix = "expose all cameras alike, or scale these images; a scene has one brightness here";
            Finding::new("images", "images.exposure", Verdict::Warning, what).at(names).fix(fix)
        })
    }

    fn blurred(&self, data: &Dataset) -> Option<Finding> {
        let usual = median(&self.good(data).map(|(_, _, t)| t.detail).collect::<Vec<_>>());
        let names: Vec<&str> = self
            .good(data)
            .filter(|(_, _, t)| t.spread >= FLAT && t.detail < SHARPNESS * usual)
            .map(|(v, _, _)| v.name.as_str())
            .collect();
        (!names.is_empty()).then(|| {
            let what = format!(
                "{} photographs have less than a third of the usual detail: blurred, or out of focus",
                names.len()
            );
            Finding::new("images", "images.blurred", Verdict::Warning, what)
                .at(names)
                .fix("leave them out if others show the same")
        })
    }

    fn alpha(&self, data: &Dataset) -> Option<Finding> {
        if !data.has_alpha {
            return None;
        }
        let list: Vec<&Traits> = self.good(data).map(|(_, _, t)| t).collect();
        let part = |f: &dyn Fn(&Traits) -> bool| list.iter().filter(|t| f(t)).count() as f64 / list.len().max(1) as f64;
        if part(&|t| t.corners > 0.9 && t.opaque < 0.98) > 0.8 {
            let what = "alpha is 1 in the corners of most photographs and 0 elsewhere: it looks inverted";
            let fix = "write 255 − alpha";
            return Some(Finding::new("images", "images.alpha", Verdict::Problem, what).fix(fix));
        }
        (part(&|t| t.opaque > 0.999) > 0.99).then(|| {
            let what = "images have an alpha channel that is 1 everywhere: it tells no outline, and the visual hull would be the whole box";
            Finding::new("images", "images.alpha", Verdict::Warning, what).fix("write images without alpha, or with the mask in it")
        })
    }

    fn masks(&self, data: &Dataset) -> Vec<Finding> {
        let [bad, empty] = &self.masks;
        let mut out = Vec::new();
        if !bad.is_empty() {
            let what = format!("{} masks cannot be used", bad.len());
            out.push(
                Finding::new("masks", "masks.unreadable", Verdict::Problem, what)
                    .at(bad.clone())
                    .fix("export them at the size of their images"),
            );
        }
        if !empty.is_empty() {
            let what = format!("{} masks count nothing", empty.len());
            out.push(
                Finding::new("masks", "masks.empty", Verdict::Warning, what)
                    .at(empty.clone())
                    .fix("white counts: check that they are not inverted"),
            );
        }
        if out.is_empty() {
            let text = match (self.masked, data.has_alpha) {
                (0, true) => "none; images carry alpha".to_owned(),
                (0, false) => "none".to_owned(),
                (n, _) => format!("{n} of {} views have one", self.seen.len()),
            };
            out.push(Finding::ok("masks", text));
        }
        out
    }
}
