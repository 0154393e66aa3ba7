//! Co-visibility masks of held-out views ([`gs_metrics::covisible`]): what enough training images show of each.
//!
//! DyCheck compares a held-out image with all training images. [`Options::nearest`] takes fewer: those whose
//! ```text
//! |c − c'| / extent + angle between the optical axes (radians) + |t − t'|
//! ```
//! is least, with camera centres `c`, the extent of the training cameras and normalised times `t`. This measure is ours.

use gs_core::Image;
use gs_data::{DataError, Dataset, ImageCache, View};
pub use gs_metrics::CovisibleOptions;
use gs_metrics::{MetricError, seen};

/// Colour behind transparent pixels.
const BACKGROUND: [f32; 3] = [0.0; 3];

/// How masks are made; the default is over all training images, for the images that cameras without a lens would take.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Options {
    /// When a training image sees a pixel, and how many must.
    pub rule: CovisibleOptions,
    /// Take so many training images, the nearest in place and time; none: all.
    pub nearest: Option<usize>,
    /// Whether masks belong to images as they are stored, with their lens, as readers take them. Else to images as they are
    /// scored, without it.
    pub stored: bool,
}

impl Options {
    /// Number of training images that a view is compared with.
    pub fn images(&self, dataset: &Dataset) -> usize {
        self.nearest.map_or(dataset.train.len(), |n| n.min(dataset.train.len()))
    }

    /// Fewest of them that must see a co-visible pixel.
    ///
    /// # Errors
    /// [`CovisibleError::Few`] if there are not so many.
    pub fn needed(&self, dataset: &Dataset) -> Result<usize, CovisibleError> {
        let images = self.images(dataset);
        let needed = self.rule.needed(images);
        if needed > images { Err(CovisibleError::Few { images, needed }) } else { Ok(needed) }
    }
}

/// A view without a mask.
#[derive(Debug, thiserror::Error)]
pub enum CovisibleError {
    /// No pixel could be co-visible.
    #[error("a co-visible pixel is seen by at least {needed} training images, and {images} are compared")]
    Few {
        /// Number of training images that are compared.
        images: usize,
        /// Fewest that must see a pixel.
        needed: usize,
    },
    /// An image cannot be read.
    #[error(transparent)]
    Data(#[from] DataError),
    /// An image cannot be compared with the training images.
    #[error("view {view}: {source}")]
    Metric {
        /// Name of the held-out view.
        view: String,
        /// Why it cannot be compared.
        source: MetricError,
    },
}

/// Why an image of the set is not compared.
enum Fault {
    Data(DataError),
    Metric(MetricError),
}

impl From<MetricError> for Fault {
    fn from(e: MetricError) -> Self {
        Self::Metric(e)
    }
}

/// The mask of a held-out view, `[H, W, 1]` at the size of its image, `data.scale` included: 1 where a pixel is co-visible, else 0.
/// Transparent pixels are compared over black.
///
/// # Errors
/// Too few training images, an image that cannot be read, or training images of another size than the view's.
pub fn mask(dataset: &Dataset, view: &View, images: &ImageCache, options: &Options) -> Result<Image, CovisibleError> {
    let needed = options.needed(dataset)?;
    let near = nearest(dataset, view, options.images(dataset));
    let read = |view: &View| images.get(&shown(view, options.stored)).map(|image| image.over(BACKGROUND));
    let counts = seen(&read(view)?, near.len(), |k| read(near[k]).map_err(Fault::Data), &options.rule);
    match counts {
        Ok(counts) => Ok(counts.mask(needed)),
        Err(Fault::Data(e)) => Err(e.into()),
        Err(Fault::Metric(source)) => Err(CovisibleError::Metric { view: view.name.clone(), source }),
    }
}

/// The view whose image is compared: whole, and with its lens where masks belong to stored images.
fn shown(view: &View, stored: bool) -> View {
    View { lens: view.lens.filter(|_| !stored), cut_out: false, ..view.clone() }
}

/// So many training views, those nearest to a view in place, direction and time first; of equally near ones the first of the data.
fn nearest<'a>(dataset: &'a Dataset, view: &View, count: usize) -> Vec<&'a View> {
    let extent = f64::from(dataset.scene_extent());
    let apart = |other: &View| {
        let place = view.camera.position().distance(other.camera.position()) / extent;
        let turn = view.camera.forward().angle_between(other.camera.forward());
        place + turn + f64::from((view.time.normalised - other.time.normalised).abs())
    };
    let mut near: Vec<(f64, &View)> = dataset.train.iter().map(|other| (apart(other), other)).collect();
    near.sort_by(|a, b| a.0.total_cmp(&b.0));
    near.into_iter().take(count).map(|(_, view)| view).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;
    use gs_core::{Camera, Time};
    use gs_data::{ImageSource, ImageU8, Lens};
    use gs_synth::{SynthOptions, generate};

    /// Eight views of a camera that looks along +z from places on the x axis, at times that pass, and a held-out one between.
    fn dataset() -> Dataset {
        let shot = |x: f64, t: f32| {
            let eye = DVec3::new(x, 0.0, -4.0);
            let camera = Camera::look_at(32, 32, 0.7, eye, eye + DVec3::Z, -DVec3::Y).unwrap();
            let value = |k: usize| [(37 * k % 251) as u8, (91 * k % 241) as u8, (53 * k % 239) as u8, 255];
            let image = ImageU8 { width: 32, height: 32, data: (0..32 * 32).flat_map(value).collect() };
            View::new(format!("v{x}"), camera, Time::new(t).unwrap(), ImageSource::Memory(image.into()), 0)
        };
        let mut data = generate("static", &SynthOptions::of_views(8, 1, 1)).unwrap().dataset;
        data.train = (0..8u8).map(|k| shot(f64::from(k), f32::from(k) / 7.0)).collect();
        data.test = vec![shot(2.6, 0.4)];
        data
    }

    #[test]
    fn near_is_near_in_place_direction_and_time() {
        let mut data = dataset();
        let names = |data: &Dataset| nearest(data, &data.test[0], 3).iter().map(|v| v.name.clone()).collect::<Vec<_>>();
        assert_eq!(names(&data), ["v3", "v2", "v4"]);
        data.train[3].time = Time::new(1.0).unwrap();
        assert_eq!(names(&data), ["v2", "v4", "v1"], "another time");
        let camera = &data.train[2].camera;
        let aside = Camera::look_at(32, 32, 0.7, camera.position(), camera.position() + DVec3::X, -DVec3::Y).unwrap();
        data.train[2].camera = aside;
        assert_eq!(names(&data), ["v4", "v1", "v3"], "another direction");
        assert_eq!(nearest(&data, &data.test[0], 99).len(), 8);
    }

    #[test]
    fn equal_images_are_wholly_co_visible() {
        let (data, images) = (dataset(), ImageCache::new(1 << 20, 1.0));
        let all = Options::default();
        assert_eq!((all.images(&data), all.needed(&data).unwrap()), (8, 6));
        let whole = mask(&data, &data.test[0], &images, &all).unwrap();
        assert_eq!(whole.shape(), (32, 32, 1));
        assert!(whole.data.iter().all(|m| *m == 1.0));
        let few = Options { nearest: Some(5), ..all };
        let e = mask(&data, &data.test[0], &images, &few).unwrap_err();
        assert!(matches!(e, CovisibleError::Few { images: 5, needed: 6 }), "{e}");
    }

    #[test]
    fn masks_of_stored_images_keep_the_lens() {
        let mut view = dataset().test.remove(0);
        (view.lens, view.cut_out) = (Some(Lens { k1: 0.3, ..Lens::default() }), true);
        assert_eq!((shown(&view, true).lens, shown(&view, true).cut_out), (None, false), "nothing is resampled");
        assert_eq!((shown(&view, false).lens, shown(&view, false).cut_out), (view.lens, false));
    }

    #[test]
    fn an_image_of_another_size_is_named() {
        let (mut data, images) = (dataset(), ImageCache::new(1 << 20, 1.0));
        data.test[0].camera = data.test[0].camera.scaled(0.5);
        data.test[0].image = ImageSource::Memory(ImageU8 { width: 16, height: 16, data: vec![9; 1024] }.into());
        let e = mask(&data, &data.test[0], &images, &Options::default()).unwrap_err();
        assert!(e.to_string().starts_with("view v2.6: ") && e.to_string().contains("(16, 16, 3)"), "{e}");
    }
}
