//! Checks of images: readable, not blank, no duplicates, even exposure and sharpness, plausible alpha and masks.

use super::sample::Sample;
use super::{Finding, Verdict, luma, median};
use gs_core::cast;
use gs_data::{Dataset, ImageCache, ImageU8, Split, View};
use rayon::prelude::*;
use std::collections::{BTreeMap, BTreeSet};
use std::hash::{DefaultHasher, Hasher};

/// Least standard deviation of luma (0..255) of an image that is not blank.
const MIN_SPREAD: f64 = 1.5;
/// Factor between an image's mean luma and the median one above which its exposure is reported.
const EXPOSURE_FACTOR: f64 = 1.8;
/// Images with less than this share of the median detail are reported as blurred.
const MIN_SHARPNESS: f64 = 0.3;
/// Side of the image corners in which alpha is checked, as a share of the image's sides.
const CORNER_SIZE: f64 = 0.06;
/// Opaque share of an image from which its alpha is no silhouette.
const WHOLE: f64 = 0.98;

/// Cells on each side of a thumbnail.
const THUMB: usize = 24;

/// Statistics of an image.
#[derive(Clone, Debug)]
struct Traits {
    /// Mean luma of opaque pixels, 0..255, and its standard deviation.
    mean: f64,
    spread: f64,
    /// Mean absolute Laplacian of luma over opaque pixels.
    detail: f64,
    /// Opaque share of the image, and of its corners.
    opaque: f64,
    corners: f64,
    /// Hash of all pixels.
    hash: u64,
    /// Mean luma over black of [`THUMB`]² cells, row by row.
    thumb: Vec<f32>,
}

/// What identifies an image: its hash.
pub(super) struct Fingerprint<'a> {
    pub(super) view: &'a View,
    pub(super) hash: u64,
}

/// An image that was read, or the error.
struct CheckedImage {
    split: Split,
    index: usize,
    /// Statistics, or the error's text, code and fix.
    traits: Result<Traits, (String, &'static str, String)>,
}

/// Statistics of the images that were read.
pub(super) struct ImageChecks {
    seen: Vec<CheckedImage>,
    /// The views whose image or mask cannot be read.
    unreadable: BTreeSet<(Split, usize)>,
    /// Names of masks that cannot be read, and of those that are zero everywhere.
    masks: [Vec<String>; 2],
    masked: usize,
    whole: bool,
    max_image_mib: Option<u32>,
}

/// Reads the images and masks of a sample; `max_image_mib` bounds the memory for decoding one. `keep` is given each image that can be
/// read, with the split and the index of its view.
pub(super) fn check(
    data: &Dataset,
    sample: &Sample,
    max_image_mib: Option<u32>,
    keep: &(dyn Fn((Split, usize), &ImageU8) + Sync),
) -> ImageChecks {
    // Each is read once.
    let images = ImageCache::new(0, 1.0).with_max_image_mib(max_image_mib);
    let see = |&(split, index): &(Split, usize)| {
        let found = images.get(&data.views(split)[index]).inspect(|image| keep((split, index), image));
        let traits = found.map(|i| traits(&i)).map_err(|e| (e.to_string(), e.code(), e.fix()));
        CheckedImage { split, index, traits }
    };
    let seen: Vec<CheckedImage> = sample.views.par_iter().map(see).collect();
    let mask_of = |&(s, i): &(Split, usize)| Some(((s, i), mask(&data.views(s)[i], &images)?));
    let masks: Vec<_> = sample.views.par_iter().filter_map(mask_of).collect();
    let named = |empty: bool| masks.iter().filter(|m| m.1.1 == Some(empty)).map(|m| m.1.0.clone()).collect();
    let without_image = seen.iter().filter(|s| s.traits.is_err()).map(|s| (s.split, s.index));
    let without_mask = masks.iter().filter(|m| m.1.1 == Some(false)).map(|m| m.0);
    let unreadable = without_image.chain(without_mask).collect();
    let whole = seen.len() == sample.total;
    ImageChecks { masks: [named(false), named(true)], masked: masks.len(), seen, unreadable, whole, max_image_mib }
}

/// Name of a masked view, and whether its mask is zero everywhere (`Some(true)`), cannot be read (`Some(false)`) or is right
/// (`None`); `None` without a mask.
fn mask(v: &View, images: &ImageCache) -> Option<(String, Option<bool>)> {
    v.mask.as_ref()?;
    let state = match images.mask(v) {
        Ok(Some(m)) if m.data.iter().all(|w| *w < 0.5) => Some(true),
        Ok(_) => None,
        Err(e) => return Some((e.to_string(), Some(false))),
    };
    Some((v.name.clone(), state))
}

fn traits(image: &ImageU8) -> Traits {
    let (w, h) = (image.width, image.height);
    let grey = grey(image);
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
    let side = |n: usize| cast::to_usize(n as f64 * CORNER_SIZE).clamp(1, n);
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

/// Luma of the pixels of an image, 0..255.
fn grey(image: &ImageU8) -> Vec<f64> {
    image.data.as_chunks().0.iter().map(|&[r, g, b, _]| f64::from(luma([r, g, b].map(f32::from)))).collect()
}

/// Mean luma of the cells of an image, over black.
fn thumbnail(image: &ImageU8, grey: &[f64]) -> Vec<f32> {
    let (mut sums, mut counts) = (vec![0.0f64; THUMB * THUMB], vec![0.0f64; THUMB * THUMB]);
    for (i, g) in grey.iter().enumerate() {
        let (x, y) = (i % image.width, i / image.width);
        let cell = y * THUMB / image.height * THUMB + x * THUMB / image.width;
        sums[cell] += g * f64::from(image.data[4 * i + 3]) / 255.0;
        counts[cell] += 1.0;
    }
    sums.iter().zip(counts).map(|(s, c)| cast::to_f32(s / c.max(1.0))).collect()
}

impl ImageChecks {
    /// The data set without the views whose image or mask cannot be read.
    pub(super) fn readable(&self, data: &Dataset) -> Dataset {
        let kept = |split: Split| -> Vec<View> {
            let views = data.views(split).iter().enumerate();
            views.filter(|(i, _)| !self.unreadable.contains(&(split, *i))).map(|(_, v)| v.clone()).collect()
        };
        let [train, val, test, extrapolate] = Split::ALL.map(kept);
        Dataset { train, val, test, extrapolate, ..data.clone() }
    }

    /// The fingerprints of all readable images.
    pub(super) fn fingerprints<'a>(&'a self, data: &'a Dataset) -> Vec<Fingerprint<'a>> {
        self.good(data).map(|(view, _, t)| Fingerprint { view, hash: t.hash }).collect()
    }

    /// Whether every image was read.
    pub(super) fn is_whole(&self) -> bool {
        self.whole
    }

    /// Mean luma over black of [`THUMB`]² cells of the images of these views; those that were not read before are read. `None` of an
    /// image that cannot be.
    pub(super) fn thumbnails(&self, data: &Dataset, views: &[(Split, usize)]) -> Vec<Option<Vec<f32>>> {
        let known: BTreeMap<(Split, usize), &CheckedImage> =
            self.seen.iter().map(|s| ((s.split, s.index), s)).collect();
        let images = ImageCache::new(0, 1.0).with_max_image_mib(self.max_image_mib);
        let of = |&(split, index): &(Split, usize)| match known.get(&(split, index)) {
            Some(seen) => seen.traits.as_ref().ok().map(|t| t.thumb.clone()),
            None => images.get(&data.views(split)[index]).ok().map(|i| thumbnail(&i, &grey(&i))),
        };
        views.par_iter().map(of).collect()
    }

    fn good<'s, 'd>(&'s self, data: &'d Dataset) -> impl Iterator<Item = (&'d View, Split, &'s Traits)> {
        self.seen.iter().filter_map(move |s| Some((&data.views(s.split)[s.index], s.split, s.traits.as_ref().ok()?)))
    }

    /// All findings on images and masks.
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
            out.push(Finding::ok("images", format!("{} images can be read, {size}", self.seen.len())));
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
            let what = format!("{} of {} images cannot be used", list.len(), self.seen.len());
            let fix = list[0].1.clone();
            Finding::new("images", code, Verdict::Problem, what).at(list.into_iter().map(|l| l.0)).fix(fix)
        };
        kinds.into_iter().map(finding).collect()
    }

    fn blank(&self, data: &Dataset) -> Option<Finding> {
        let flat = |t: &Traits| t.spread < MIN_SPREAD || t.opaque == 0.0;
        let names: Vec<&str> = self.good(data).filter(|(_, _, t)| flat(t)).map(|(v, _, _)| v.name.as_str()).collect();
        (!names.is_empty()).then(|| {
            let what = format!("{} images show nothing: one colour, or transparent all over", names.len());
            let fix = "remove them, or export them again";
            Finding::new("images", "images.blank", Verdict::Problem, what).at(names).fix(fix)
        })
    }

    /// The same pixels under two names; twice in training is a warning, in training and elsewhere a problem.
    fn twice(&self, data: &Dataset) -> Vec<Finding> {
        let mut by_hash: BTreeMap<u64, Vec<(&View, Split)>> = BTreeMap::new();
        for (v, split, t) in self.good(data).filter(|(_, _, t)| t.spread >= MIN_SPREAD) {
            by_hash.entry(t.hash).or_default().push((v, split));
        }
        let named = |list: &[(&View, Split)]| {
            let one = |(v, s): &(&View, Split)| format!("{} ({})", v.name, format!("{s:?}").to_lowercase());
            list.iter().map(one).collect::<Vec<_>>().join(" = ")
        };
        let several = || by_hash.values().filter(|l| l.len() > 1);
        let crosses = |l: &[(&View, Split)]| {
            // Motion may come back after training as it was: later views are other moments.
            l.iter().any(|(_, s)| *s == Split::Train) && l.iter().any(|(_, s)| matches!(s, Split::Val | Split::Test))
        };
        let leaks: Vec<String> = several().filter(|l| crosses(l)).map(|l| named(l)).collect();
        let copies: Vec<String> = several().filter(|l| !crosses(l)).map(|l| named(l)).collect();
        let mut out = Vec::new();
        if !leaks.is_empty() {
            let what = format!(
                "{} images are in training and held out as well: scores would be of what was learnt by heart",
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
                "{} images are there more than once, pixel for pixel, under other poses or times",
                copies.len()
            );
            let fix = "check how frames were extracted: a frozen video, or copies under other names";
            out.push(Finding::new("images", "images.twice", Verdict::Warning, what).at(copies).fix(fix));
        }
        out
    }

    fn exposure(&self, data: &Dataset) -> Option<Finding> {
        let usual = median(&self.good(data).map(|(_, _, t)| t.mean).collect::<Vec<_>>());
        let odd = |t: &Traits| t.mean > EXPOSURE_FACTOR * usual + 4.0 || EXPOSURE_FACTOR * (t.mean + 4.0) < usual;
        let names: Vec<String> = self
            .good(data)
            .filter(|(_, _, t)| t.spread >= MIN_SPREAD && odd(t))
            .map(|(v, _, t)| format!("{} ({:.0})", v.name, t.mean))
            .collect();
        (!names.is_empty()).then(|| {
            let what =
                format!("{} images are much darker or brighter than usual (mean {usual:.0} of 255)", names.len());
            let fix = "expose all cameras alike, or scale these images; a scene has one brightness here";
            Finding::new("images", "images.exposure", Verdict::Warning, what).at(names).fix(fix)
        })
    }

    fn blurred(&self, data: &Dataset) -> Option<Finding> {
        // Detail of a pixel is less in larger images of the same.
        let size = |v: &View| [v.camera.width, v.camera.height];
        let mut by_size: BTreeMap<[u32; 2], Vec<f64>> = BTreeMap::new();
        self.good(data).for_each(|(v, _, t)| by_size.entry(size(v)).or_default().push(t.detail));
        let usual: BTreeMap<[u32; 2], f64> = by_size.iter().map(|(size, all)| (*size, median(all))).collect();
        let names: Vec<&str> = self
            .good(data)
            .filter(|(v, _, t)| t.spread >= MIN_SPREAD && t.detail < MIN_SHARPNESS * usual[&size(v)])
            .map(|(v, _, _)| v.name.as_str())
            .collect();
        (!names.is_empty()).then(|| {
            let what =
                format!("{} images have less than a third of the usual detail: blurred, or out of focus", names.len());
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
        if part(&|t| t.corners > 0.9 && t.opaque < WHOLE) > 0.8 {
            let what = "alpha is 1 in the corners of most images and 0 in parts of the rest: it looks inverted";
            let fix = "write 255 − alpha; or images without alpha, if what is transparent was cut out of whole images";
            return Some(Finding::new("images", "images.alpha", Verdict::Problem, what).fix(fix));
        }
        (part(&|t| t.opaque >= WHOLE) > 0.99).then(|| {
            let what = "images have an alpha channel that is 1 everywhere, or nearly: it gives no silhouette, and the visual hull would be the whole box";
            let fix = "write images without alpha, or with the mask in it; if it is inverted, 255 − alpha";
            Finding::new("images", "images.alpha", Verdict::Warning, what).fix(fix)
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

#[cfg(test)]
mod tests {
    use super::*;
    use gs_data::ImageSource;
    use gs_synth::{SynthOptions, generate};
    use std::sync::Arc;

    #[test]
    fn alpha_that_is_0_in_a_small_part_is_no_silhouette_and_in_a_larger_one_inverted() {
        let data = generate("static", &SynthOptions::of_views(40, 6, 1)).expect("scene").dataset;
        let with_hole = |v: &mut View, side: usize| {
            let mut image = (*ImageCache::new(0, 1.0).get(v).expect("image")).clone();
            let inside = |x: usize| (10..10 + side).contains(&x);
            for (k, p) in image.data.chunks_exact_mut(4).enumerate() {
                p[3] = if inside(k % 40) && inside(k / 40) { 0 } else { 255 };
            }
            v.image = ImageSource::Memory(Arc::new(image));
        };
        for (side, verdict) in [(0, Verdict::Warning), (4, Verdict::Warning), (16, Verdict::Problem)] {
            let mut data = data.clone();
            data.train.iter_mut().chain(&mut data.test).for_each(|v| with_hole(v, side));
            let found = check(&data, &Sample::of(&data, false), None, &|_, _| ()).alpha(&data).expect("a finding");
            assert_eq!((found.code, found.verdict), ("images.alpha", verdict), "{side}: {found:?}");
        }
    }
}
