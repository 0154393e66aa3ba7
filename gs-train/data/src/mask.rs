//! Masks: which pixels of a view count, and how much.
//!
//! A mask is an image of one channel: 255 counts fully, 0 not at all; of a coloured file the first channel is used. It has
//! the aspect ratio of the view's stored image, at any size. The centre of each pixel of the view is mapped through the
//! view's lens to the stored image and there to the nearest pixel of the mask, so a binary mask stays binary. Pixels
//! outside the stored image have weight 0.

use std::path::Path;

use glam::DVec2;
use gs_core::{Camera, Image, cast};

use super::error::DataError;
use super::header;
use super::intrinsics::same_shape;
use super::pixels::ImageU8;
use super::view::View;

/// Checks that a mask file fits images of a size, by its header alone.
///
/// # Errors
/// `data.image_size` for another shape; `data.image`, `io.read` if it is no image.
pub(crate) fn check(file: &Path, want: [u32; 2]) -> Result<(), DataError> {
    let header = header::read(file)?;
    check_shape(file, [header.width, header.height], want)
}

/// Checks that a map of size `got`, read from `file`, has the aspect ratio of images of size `want`; sizes are width, height.
///
/// # Errors
/// `data.image_size` if the ratios differ by more than 1 %.
pub fn check_shape(file: &Path, got: [u32; 2], want: [u32; 2]) -> Result<(), DataError> {
    let size = |s: [u32; 2]| DVec2::new(f64::from(s[0]), f64::from(s[1]));
    if same_shape(size(got), size(want)) {
        return Ok(());
    }
    Err(DataError::ImageSize { file: file.to_path_buf(), got, want })
}

/// The weights of a view's mask at the size of `camera`: [`View::camera`], or that camera scaled. `[H, W, 1]`, in 0..1.
pub(crate) fn weights(mask: &ImageU8, v: &View, camera: &Camera) -> Image {
    let value = |at: Option<[usize; 2]>| at.map_or(0.0, |[x, y]| f32::from(mask.pixel(x, y)[0]) / 255.0);
    let data = nearest([mask.width, mask.height], v, camera).map(value).collect();
    Image { width: camera.width as usize, height: camera.height as usize, channels: 1, data }
}

/// Multiplies the alpha of a stored image by the mask: each pixel takes the weight of the nearest pixel of the mask.
pub(crate) fn cut(image: &mut ImageU8, mask: &ImageU8) {
    let (width, height) = (image.width, image.height);
    for (k, pixel) in image.data.chunks_exact_mut(4).enumerate() {
        let at = |i: usize, side: usize, of: usize| (2 * i + 1) * of / (2 * side);
        let weight = mask.pixel(at(k % width, width, mask.width), at(k / width, height, mask.height))[0];
        pixel[3] = product(pixel[3], weight);
    }
}

/// Makes the pixels transparent that a lens shows outside the stored image. `image` has the size of the view's camera.
pub(crate) fn clear_outside(image: &mut ImageU8, v: &View) {
    let seen = nearest([image.width, image.height], v, &v.camera);
    for (pixel, seen) in image.data.chunks_exact_mut(4).zip(seen) {
        if seen.is_none() {
            pixel.fill(0);
        }
    }
}

/// `a b / 255`, rounded down.
#[expect(clippy::cast_possible_truncation, reason = "255 · 255 / 255 is 255")]
fn product(a: u8, b: u8) -> u8 {
    (u32::from(a) * u32::from(b) / 255) as u8
}

/// For every pixel of `camera`, row-major, the nearest pixel `[x, y]` of a map of size `[width, height]` with the aspect ratio
/// of the view's stored image; none outside that image. `camera` is [`View::camera`], or that camera scaled.
pub fn nearest<'a>(
    [width, height]: [usize; 2],
    v: &'a View,
    camera: &'a Camera,
) -> impl Iterator<Item = Option<[usize; 2]>> + 'a {
    let size = |width: u32, height: u32| DVec2::new(f64::from(width), f64::from(height));
    let full = size(v.camera.width, v.camera.height);
    let to_full = full / size(camera.width, camera.height);
    let stored = DVec2::new(width as f64, height as f64);
    let pixels = (0..camera.height).flat_map(|j| (0..camera.width).map(move |i| [i, j]));
    pixels.map(move |[i, j]| {
        let at = DVec2::new(f64::from(i) + 0.5, f64::from(j) + 0.5) * to_full;
        let seen = v.lens.map_or(at, |lens| lens.source_pixel(&v.camera, at)) * stored / full;
        let inside = seen.x >= 0.0 && seen.x < stored.x && seen.y >= 0.0 && seen.y < stored.y;
        inside.then_some([seen.x, seen.y].map(cast::to_usize))
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{ImageCache, ImageSource, Lens};
    use glam::DVec3;
    use gs_core::Time;
    use std::sync::Arc;

    /// Columns below `split` count.
    fn mask(width: usize, height: usize, split: usize) -> ImageSource {
        let value = |k: usize| if k % width < split { [255, 0, 0, 255] } else { [0; 4] };
        ImageSource::Memory(Arc::new(ImageU8 { width, height, data: (0..width * height).flat_map(value).collect() }))
    }

    fn view(width: u32, height: u32, mask: ImageSource) -> View {
        let camera = Camera::look_at(width, height, 0.7, DVec3::X, DVec3::ZERO, DVec3::Z).unwrap();
        let pixels = ImageU8 { width: width as usize, height: height as usize, ..ImageU8::default() };
        let mut view = View::new("v", camera, Time::default(), ImageSource::Memory(Arc::new(pixels)), 0);
        view.mask = Some(mask);
        view
    }

    #[test]
    fn weights_have_the_size_of_the_view_whatever_the_mask_has() {
        for (mw, mh, split) in [(12, 8, 6), (6, 4, 3), (24, 16, 12)] {
            let v = view(12, 8, mask(mw, mh, split));
            for scale in [1.0, 0.5] {
                let cache = ImageCache::new(0, scale);
                let w = cache.mask(&v).unwrap().unwrap();
                let c = cache.camera(&v);
                assert_eq!(w.shape(), (c.width as usize, c.height as usize, 1));
                let half = w.width / 2;
                assert!((0..w.data.len()).all(|k| w.data[k] == if k % w.width < half { 1.0 } else { 0.0 }));
            }
        }
        assert!(ImageCache::new(0, 1.0).mask(&View { mask: None, ..view(2, 2, mask(2, 2, 1)) }).unwrap().is_none());
    }

    #[test]
    fn what_a_mask_leaves_out_is_transparent_at_every_scale() {
        for (mw, mh, split) in [(12, 8, 6), (6, 4, 3), (24, 16, 12)] {
            let mut v = view(12, 8, mask(mw, mh, split));
            let white = ImageU8 { width: 12, height: 8, data: vec![255; 12 * 8 * 4] };
            v.image = ImageSource::Memory(Arc::new(white));
            let whole = ImageCache::new(1 << 20, 1.0);
            assert!(whole.get(&v).unwrap().data.iter().all(|b| *b == 255), "unasked, all is seen");
            v.cut_out = true;
            for scale in [1.0, 0.5] {
                let cache = ImageCache::new(1 << 20, scale);
                let image = cache.get(&v).unwrap();
                let alpha = |k: usize| image.data[4 * k + 3];
                let half = image.width / 2;
                assert!((0..image.width * image.height).all(|k| alpha(k) == 255 * u8::from(k % image.width < half)));
            }
        }
    }

    #[test]
    fn the_lens_moves_the_mask_with_the_picture() {
        let mut v = view(100, 80, mask(100, 80, 100));
        let all = |v: &View| ImageCache::new(0, 1.0).mask(v).unwrap().unwrap();
        assert!(all(&v).data.iter().all(|w| *w == 1.0));
        v.lens = Some(Lens { k1: 0.5, ..Lens::default() });
        let w = all(&v);
        assert_eq!((w.pixel(50, 40), w.pixel(0, 0)), (&[1.0][..], &[0.0][..]), "the corners lie outside the image");
        // The border of the mask lies where the lens shows column 70.
        v.mask = Some(mask(100, 80, 70));
        let w = all(&v);
        for i in 0..100usize {
            let seen = v.lens.unwrap().source_pixel(&v.camera, DVec2::new(i as f64 + 0.5, 40.5));
            assert_eq!(w.pixel(i, 40)[0] == 1.0, seen.x >= 0.0 && seen.x < 70.0, "column {i}");
        }
    }

    #[test]
    fn what_a_lens_shows_outside_the_image_is_cut_out_with_it() {
        let mut v = view(100, 80, mask(100, 80, 100));
        v.image = ImageSource::Memory(Arc::new(ImageU8 { width: 100, height: 80, data: vec![255; 100 * 80 * 4] }));
        (v.lens, v.cut_out) = (Some(Lens { k1: 0.5, ..Lens::default() }), true);
        let cache = ImageCache::new(0, 1.0);
        let (image, weights) = (cache.get(&v).unwrap(), cache.mask(&v).unwrap().unwrap());
        assert!(image.alpha().data == weights.data, "the mask is white, so alpha is where the image is");
        assert_eq!((image.pixel(50, 40), image.pixel(0, 0)), ([255; 4], [0; 4]));
        v.cut_out = false;
        assert_eq!(cache.get(&v).unwrap().pixel(0, 0), [255; 4], "unasked, the edge is repeated");
    }

    #[test]
    fn another_shape_is_an_error_that_names_the_mask() {
        let dir = tempfile::tempdir().unwrap();
        let file = dir.path().join("mask.png");
        image::GrayImage::new(12, 12).save(&file).unwrap();
        let e = ImageCache::new(0, 1.0).mask(&view(12, 8, ImageSource::File(file.clone()))).unwrap_err();
        assert!(e.code() == "data.image_size" && e.to_string().contains("mask.png is 12x12"), "{e}");
        assert_eq!(check(&file, [24, 24]).map_err(|e| e.code()), Ok(()));
        assert_eq!(check(&file, [24, 12]).unwrap_err().code(), "data.image_size");
        assert_eq!(check(&dir.path().join("none.png"), [2, 2]).unwrap_err().code(), "io.read");
    }
}
