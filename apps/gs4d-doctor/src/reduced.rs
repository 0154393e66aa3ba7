//! Reduced images of views, made of the whole ones when these are checked: few are decoded again.

use super::views::Views;
use gs_data::{Dataset, ImageCache, ImageU8, Split, hull};
use std::collections::BTreeSet;

/// Longest side of the images in which corners are detected, pixels.
const SMALL_SIDE: f64 = 480.0;
/// Most bytes of these images that are kept.
const SMALL_BYTES: usize = 256 << 20;

/// Reduced images of a data set.
pub(super) struct Reduced {
    /// Those in which corners are detected.
    pub(super) small: ImageCache,
    /// Those whose silhouettes carve the hull; none without alpha and masks.
    pub(super) silhouettes: Option<ImageCache>,
    /// Split and index of the views in which corners are detected.
    matched: BTreeSet<(Split, usize)>,
}

impl Reduced {
    /// Of a data set, none yet; `max_image_mib` bounds the memory for decoding one.
    pub(super) fn of(data: &Dataset, max_image_mib: Option<u32>) -> Self {
        let views = Split::ALL.iter().flat_map(|&s| data.views(s));
        let largest = views.map(|v| v.camera.width.max(v.camera.height)).max().unwrap_or(1);
        let small = ImageCache::new(SMALL_BYTES, (SMALL_SIDE / f64::from(largest)).min(1.0));
        Self {
            small: small.with_max_image_mib(max_image_mib),
            silhouettes: hull::images(data),
            matched: Views::of(data).0.into_iter().collect(),
        }
    }

    /// Keeps what later checks need of the whole image of a view.
    pub(super) fn keep(&self, data: &Dataset, at: (Split, usize), whole: &ImageU8) {
        let view = &data.views(at.0)[at.1];
        self.silhouettes.iter().for_each(|images| images.keep_reduced(view, whole));
        if self.matched.contains(&at) {
            self.small.keep_reduced(view, whole);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sample::Sample;
    use crate::{figures, images, poses, silhouettes, start};
    use gs_data::{ImageSource, View};
    use gs_synth::{SynthOptions, generate};
    use std::sync::Arc;

    /// The same view ten times as large.
    fn enlarge(v: &mut View) {
        let small = ImageCache::new(0, 1.0).get(v).expect("image");
        let (width, height) = (10 * small.width, 10 * small.height);
        let data = (0..width * height).flat_map(|k| small.pixel(k % width / 10, k / width / 10)).collect();
        v.camera = v.camera.scaled(10.0);
        v.image = ImageSource::Memory(Arc::new(ImageU8 { width, height, data }));
    }

    #[test]
    fn after_the_check_of_the_images_nothing_is_decoded_again() {
        let mut data = generate("static", &SynthOptions::of_views(60, 10, 2)).expect("scene").dataset;
        data.train.iter_mut().chain(&mut data.val).chain(&mut data.test).for_each(enlarge);
        data.points = None;
        let reduced = Reduced::of(&data, None);
        let keep = |at, whole: &ImageU8| reduced.keep(&data, at, whole);
        images::check(&data, &Sample::of(&data, false), None, &keep);
        let (small, carving) = (&reduced.small, reduced.silhouettes.as_ref().expect("alpha"));
        assert!(small.scale() < 1.0 && carving.scale() < small.scale() && carving.bytes() > 0);
        let carved = silhouettes::check(&data, Some(carving)).expect("images").expect("a hull");
        poses::check(&data, small, Some(&carved));
        let found = start::check(&data, Some(&carved));
        assert!(found[0].what.contains("visual hull"), "{found:?}");
        figures::all(&data, small, Some(&carved));
        assert_eq!([small, carving].map(ImageCache::decoded), [0, 0]);
    }
}
