//! Images decoded on demand: 8-bit RGBA, shared; the most recently used is dropped first when the bound is reached.
//!
//! A training draws every view once, in a random order, then every view again. The view drawn last is the one that comes back
//! last, so it is the one to drop: what part of the images has room is also the part that is found. Dropping the least
//! recently used finds `1 − a + a·ln a` of them, where the part `a` has no room:
//!
//! | room for | found | least recently used |
//! |---|---|---|
//! | 10 % | 10 % | 0.5 % |
//! | 25 % | 25 % | 3.4 % |
//! | 50 % | 50 % | 15 % |
//! | 75 % | 75 % | 40 % |

use std::collections::HashMap;
use std::path::PathBuf;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use gs_core::{Camera, Image, cast};

use super::decode::{decode, quarter_turn, turned};
use super::error::DataError;
use super::lens::undistorted;
use super::mask;
use super::pixels::ImageU8;
use super::view::{ImageSource, View};

/// Decodes images on demand and keeps some of them, bounded by bytes.
///
/// What it gives is the image the view's pinhole camera would have taken: alpha and mask applied as the view says, lens distortion
/// removed, shrunk to the size of [`Self::camera`]. Threads may share one; decoding happens outside the lock, so several
/// threads decode several images at once (and, at worst, one image twice with the same result).
///
/// ```
/// # use gs_core::{Camera, Time};
/// use gs_data::{ImageCache, ImageSource, ImageU8, View};
///
/// # let camera = Camera::look_at(2, 2, 0.7, glam::DVec3::Z * 4.0, glam::DVec3::ZERO, glam::DVec3::Y)?;
/// let columns = [[255, 0, 0, 255], [0, 0, 255, 0]]; // opaque red, transparent blue
/// let image = ImageU8 { width: 2, height: 2, data: [columns, columns].concat().concat() };
/// let view = View::new("r_000", camera, Time::default(), ImageSource::Memory(image.into()), 0);
/// let half = ImageCache::new(1 << 20, 0.5); // averages premultiplied colour over 2×2 pixels
/// assert_eq!((half.camera(&view).width, half.get(&view)?.pixel(0, 0)), (1, [255, 0, 0, 128]));
/// assert_eq!((half.decoded(), half.bytes()), (1, 4));
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug)]
pub struct ImageCache {
    max_bytes: usize,
    max_image_bytes: Option<u64>,
    scale: f64,
    held: Mutex<Held>,
}

#[derive(Debug, Default)]
struct Held {
    images: HashMap<Key, Entry>,
    /// Masks and depth maps, as many as have room; none is dropped.
    maps: HashMap<Key, Arc<Image>>,
    bytes: usize,
    clock: u64,
    decoded: u64,
}

#[derive(Debug)]
struct Entry {
    image: Arc<ImageU8>,
    /// Keeps an image in memory alive, so that no other can get the address that is its key.
    _source: ImageSource,
    /// Number of the last [`ImageCache::get`]; none for an image that was only decoded ahead.
    last_use: Option<u64>,
}

/// What the pixels depend on: file or address, size, the bits of camera and lens where it is resampled, and whether alpha and the mask count.
#[derive(Clone, Debug, Default, PartialEq, Eq, Hash)]
struct Key {
    file: PathBuf,
    memory: usize,
    size: [u32; 2],
    bits: [u64; 12],
    opaque: bool,
    cut_out: bool,
}

impl ImageCache {
    /// A cache of at most `max_bytes` of pixels (0 keeps nothing). `scale` in `(0, 1]` shrinks every image by area averaging of
    /// premultiplied colour; a value outside that range counts as 1.
    pub fn new(max_bytes: usize, scale: f64) -> Self {
        let scale = if scale > 0.0 && scale < 1.0 { scale } else { 1.0 };
        Self { max_bytes, max_image_bytes: None, scale, held: Mutex::default() }
    }

    /// Bounds the memory for decoding one image, mask or depth PNG, in MiB (`data.max_image_mib`); none: 64 MiB plus eight times its file.
    pub fn with_max_image_mib(mut self, mib: Option<u32>) -> Self {
        self.max_image_bytes = mib.map(|m| u64::from(m) << 20);
        self
    }

    /// Factor on the size of every image, in (0, 1].
    pub fn scale(&self) -> f64 {
        self.scale
    }

    /// The camera of the image that [`Self::get`] gives for a view: [`View::camera`] at [`Self::scale`].
    pub fn camera(&self, v: &View) -> Camera {
        if self.scale < 1.0 { v.camera.scaled(self.scale) } else { v.camera.clone() }
    }

    /// Whether any decoded image is kept.
    pub fn keeps_images(&self) -> bool {
        self.max_bytes > 0
    }

    /// Bytes of pixels that are kept at present.
    pub fn bytes(&self) -> usize {
        self.lock().bytes
    }

    /// Number of images decoded so far, repeats included.
    pub fn decoded(&self) -> u64 {
        self.lock().decoded
    }

    /// The ground-truth image of a view, at the size of [`Self::camera`]: RGBA, straight alpha.
    ///
    /// # Errors
    /// `data.image`, `limits.file` or `io.read` where decoding fails, `data.image_size` if the size of the file is not that of
    /// the camera.
    pub fn get(&self, v: &View) -> Result<Arc<ImageU8>, DataError> {
        if let (ImageSource::Memory(image), None) = (&v.image, v.lens)
            && self.scale == 1.0
            && v.stored.is_none()
            && !v.opaque
            && !v.cut_out
        {
            check_size(v, image)?;
            return Ok(image.clone());
        }
        let key = source_key(&v.image, v);
        if let Some(image) = self.lock().find(&key) {
            return Ok(image);
        }
        let image = Arc::new(self.produce(v)?);
        self.lock().keep(key, v, &image, true, self.max_bytes);
        Ok(image)
    }

    /// Decodes the image of a view ahead of [`Self::get`], unless it is kept or larger than the cache.
    ///
    /// # Errors
    /// As [`Self::get`].
    pub fn decode_ahead(&self, v: &View) -> Result<(), DataError> {
        let key = source_key(&v.image, v);
        if self.bytes_of(v) > self.max_bytes || self.lock().images.contains_key(&key) {
            return Ok(());
        }
        let image = Arc::new(self.produce(v)?);
        self.lock().keep(key, v, &image, false, self.max_bytes);
        Ok(())
    }

    /// Keeps what [`Self::get`] gives for a view, made of `whole`, its image from a cache of scale 1: the same pixels, and nothing is
    /// decoded. Nothing is dropped for it: where there is no room it is not kept.
    pub fn keep_reduced(&self, v: &View, whole: &ImageU8) {
        let key = source_key(&v.image, v);
        let size = self.bytes_of(v);
        let has_room = |held: &Held| held.bytes + size <= self.max_bytes && !held.images.contains_key(&key);
        if has_room(&self.lock()) {
            let image = Arc::new(self.reduced(v, whole).unwrap_or_else(|| whole.clone()));
            let mut held = self.lock();
            if has_room(&held) {
                held.keep(key, v, &image, false, self.max_bytes);
            }
        }
    }

    /// Bytes of the image that [`Self::get`] gives for a view.
    fn bytes_of(&self, v: &View) -> usize {
        let c = self.camera(v);
        4 * c.width as usize * c.height as usize
    }

    /// An image of the size of the view's camera at [`Self::scale`]; none where that is 1.
    fn reduced(&self, v: &View, whole: &ImageU8) -> Option<ImageU8> {
        let c = self.camera(v);
        (self.scale < 1.0).then(|| whole.box_downscaled(c.width as usize, c.height as usize))
    }

    /// Camera-space z of a view in world units, `[H, W, 1]` at the size of [`Self::camera`], 0 where nothing was measured; none
    /// without a depth map.
    ///
    /// # Errors
    /// As [`Self::get`], for the file of the depth map; `data.syntax` and `data.field` if it holds something else.
    pub fn depth(&self, v: &View) -> Result<Option<Arc<Image>>, DataError> {
        let Some(map) = &v.depth else { return Ok(None) };
        let read = || map.read(v, &self.camera(v), self.max_image_bytes);
        self.map(Key { file: map.file.clone(), ..key_of(v) }, read).map(Some)
    }

    /// The weights of a view's mask, `[H, W, 1]` in 0..1, at the size of [`Self::camera`]; none without a mask.
    ///
    /// # Errors
    /// As [`Self::get`], for the mask's file.
    pub fn mask(&self, v: &View) -> Result<Option<Arc<Image>>, DataError> {
        let Some(source) = &v.mask else { return Ok(None) };
        self.map(source_key(source, v), || self.read_mask(source, v)).map(Some)
    }

    /// A map by its key: kept, or read and kept if there is room.
    fn map(&self, key: Key, read: impl FnOnce() -> Result<Image, DataError>) -> Result<Arc<Image>, DataError> {
        if let Some(map) = self.lock().maps.get(&key) {
            return Ok(map.clone());
        }
        let map = Arc::new(read()?);
        let size = size_of_val(map.data.as_slice());
        // The address of a mask in memory may come to name another.
        let lasting = key.memory == 0;
        let mut held = self.lock();
        if lasting && held.bytes + size <= self.max_bytes && held.maps.insert(key, map.clone()).is_none() {
            held.bytes += size;
        }
        Ok(map)
    }

    fn read_mask(&self, source: &ImageSource, v: &View) -> Result<Image, DataError> {
        let image = self.pixels(source)?;
        let want = v.stored.unwrap_or([v.camera.width, v.camera.height]);
        mask::check_shape(&file_of(source, v), [image.width, image.height].map(cast::to_u32), want)?;
        Ok(mask::weights(&image, v, &self.camera(v)))
    }

    /// The pixels as they are stored.
    fn pixels(&self, source: &ImageSource) -> Result<Arc<ImageU8>, DataError> {
        match source {
            ImageSource::File(file) => decode(file, self.max_image_bytes).map(Arc::new),
            ImageSource::Memory(image) => Ok(image.clone()),
        }
    }

    fn produce(&self, v: &View) -> Result<ImageU8, DataError> {
        let mut image = upright(Arc::unwrap_or_clone(self.pixels(&v.image)?), v);
        check_size(v, &image)?;
        if v.opaque {
            image.data.chunks_exact_mut(4).for_each(|p| p[3] = 255);
        }
        if let Some(source) = v.mask.as_ref().filter(|_| v.cut_out) {
            let mask = self.pixels(source)?;
            let sizes = [&mask, &image].map(|i| [i.width, i.height].map(cast::to_u32));
            mask::check_shape(&file_of(source, v), sizes[0], sizes[1])?;
            mask::cut(&mut image, &mask);
        }
        if v.stored.is_some() {
            image = image.box_downscaled(v.camera.width as usize, v.camera.height as usize);
        }
        if let Some(lens) = &v.lens {
            image = undistorted(&image, &v.camera, lens);
            if v.cut_out && v.mask.is_some() {
                mask::clear_outside(&mut image, v);
            }
        }
        self.lock().decoded += 1;
        let reduced = self.reduced(v, &image);
        Ok(reduced.unwrap_or(image))
    }

    /// No code under the lock panics; data behind a poisoned lock would still be consistent.
    fn lock(&self) -> MutexGuard<'_, Held> {
        self.held.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Held {
    fn find(&mut self, key: &Key) -> Option<Arc<ImageU8>> {
        self.clock += 1;
        let entry = self.images.get_mut(key)?;
        entry.last_use = Some(self.clock);
        Some(entry.image.clone())
    }

    fn keep(&mut self, key: Key, v: &View, image: &Arc<ImageU8>, used: bool, max_bytes: usize) {
        let size = image.data.len();
        if size > max_bytes || self.images.contains_key(&key) {
            return;
        }
        while self.bytes + size > max_bytes {
            if !self.drop_newest() {
                return;
            }
        }
        self.clock += 1;
        self.bytes += size;
        let last_use = used.then_some(self.clock);
        self.images.insert(key, Entry { image: image.clone(), _source: v.image.clone(), last_use });
    }

    /// Drops the image used last; none that only waits for its first use. A linear scan: its cost is small beside the decoding
    /// that made it necessary.
    fn drop_newest(&mut self) -> bool {
        let used = self.images.iter().filter(|(_, e)| e.last_use.is_some());
        let newest = used.max_by_key(|(_, e)| e.last_use).map(|(k, _)| k.clone());
        let dropped = newest.and_then(|k| self.images.remove(&k));
        self.bytes -= dropped.as_ref().map_or(0, |entry| entry.image.data.len());
        dropped.is_some()
    }
}

/// The key of pixels of a view: of its image, or its mask.
fn source_key(source: &ImageSource, v: &View) -> Key {
    match source {
        ImageSource::File(file) => Key { file: file.clone(), ..key_of(v) },
        ImageSource::Memory(image) => Key { memory: Arc::as_ptr(image).addr(), ..key_of(v) },
    }
}

/// What pixels depend on beside where they are stored.
fn key_of(v: &View) -> Key {
    let mut bits = [0; 12];
    if let Some(lens) = &v.lens {
        let c = &v.camera;
        let values = [c.fx, c.fy, c.cx, c.cy].into_iter().chain(lens.to_array());
        bits.iter_mut().zip(values).for_each(|(b, value)| *b = value.to_bits());
    }
    let size = [v.camera.width, v.camera.height];
    Key { size, bits, opaque: v.opaque, cut_out: v.cut_out, ..Key::default() }
}

/// Width and height that the stored image of a view has.
fn size_of(v: &View) -> [usize; 2] {
    v.stored.unwrap_or([v.camera.width, v.camera.height]).map(|s| s as usize)
}

/// The image, turned by its EXIF orientation where the camera is upright and the stored pixels are not.
fn upright(image: ImageU8, v: &View) -> ImageU8 {
    match &v.image {
        ImageSource::File(file) if image.width != image.height && [image.height, image.width] == size_of(v) => {
            match quarter_turn(file) {
                Some(orientation) => turned(image, orientation),
                None => image,
            }
        }
        _ => image,
    }
}

fn check_size(v: &View, image: &ImageU8) -> Result<(), DataError> {
    let want = size_of(v);
    if [image.width, image.height] == want {
        return Ok(());
    }
    let got = [image.width, image.height].map(cast::to_u32);
    Err(DataError::ImageSize { file: file_of(&v.image, v), got, want: want.map(cast::to_u32) })
}

/// The file, or the name of the view whose pixels are in memory.
fn file_of(source: &ImageSource, v: &View) -> PathBuf {
    match source {
        ImageSource::File(file) => file.clone(),
        ImageSource::Memory(_) => PathBuf::from(&v.name),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;
    use gs_core::Time;

    fn view(image: ImageSource, width: u32, height: u32) -> View {
        let camera = Camera::look_at(width, height, 0.7, DVec3::X, DVec3::ZERO, DVec3::Z).unwrap();
        View::new("v", camera, Time::default(), image, 0)
    }

    #[test]
    fn the_most_recently_used_goes_first_and_the_bound_holds() {
        let dir = tempfile::tempdir().unwrap();
        let views: Vec<View> = (0..4u8)
            .map(|k| {
                let file = dir.path().join(format!("{k}.png"));
                image::RgbaImage::from_pixel(8, 8, image::Rgba([k, 0, 0, 255])).save(&file).unwrap();
                view(ImageSource::File(file), 8, 8)
            })
            .collect();
        let cache = ImageCache::new(3 * 256, 1.0);
        for k in [0, 1, 2, 0, 3] {
            assert_eq!(cache.get(&views[k]).unwrap().pixel(3, 3), [k as u8, 0, 0, 255]);
            assert!(cache.bytes() <= 3 * 256);
        }
        assert_eq!(cache.decoded(), 4, "0 came from the cache the second time");
        [1, 2].iter().for_each(|k| drop(cache.get(&views[*k])));
        assert_eq!(cache.decoded(), 4, "1 and 2 stayed");
        cache.get(&views[0]).unwrap();
        assert_eq!(cache.decoded(), 5, "0 was dropped for 3");
        // 2 made room for 0, and 0 makes room for 2; that one waits and stays.
        cache.decode_ahead(&views[2]).unwrap();
        [0, 2].iter().for_each(|k| drop(cache.get(&views[*k])));
        assert_eq!(cache.decoded(), 7, "2 was decoded ahead, 0 once more");
        let none = ImageCache::new(0, 1.0);
        none.get(&views[0]).unwrap();
        assert_eq!(none.bytes(), 0);
    }

    #[test]
    fn passes_in_random_order_find_the_part_that_has_room() {
        let image = Arc::new(ImageU8 { width: 4, height: 4, data: vec![7; 64] });
        let views: Vec<View> = (0..60)
            .map(|_| View { opaque: true, ..view(ImageSource::Memory(Arc::new(ImageU8::clone(&image))), 4, 4) })
            .collect();
        for room in [6, 15, 30, 45] {
            let cache = ImageCache::new(room * 64, 1.0);
            for pass in 0..40 {
                let order = gs_core::Rng::new(3, "order", pass, 0).permutation(60);
                order.into_iter().for_each(|k| drop(cache.get(&views[k as usize]).unwrap()));
            }
            let found = 40 * 60 - cache.decoded() as usize;
            // The first pass finds nothing, a later one all but the image that its first miss makes room for.
            assert!((39 * (room - 1)..39 * room + 39 * room / 4).contains(&found), "{room} of 60: {found}");
        }
    }

    #[test]
    fn scaled_images_fit_their_scaled_camera() {
        let data = (0..6 * 4).flat_map(|k| [k as u8 * 10, 0, 0, 255]).collect();
        let image = Arc::new(ImageU8 { width: 6, height: 4, data });
        let v = view(ImageSource::Memory(image.clone()), 6, 4);
        let half = ImageCache::new(1 << 20, 0.5);
        let small = half.get(&v).unwrap();
        let c = half.camera(&v);
        assert_eq!((small.width, small.height), (c.width as usize, c.height as usize));
        assert_eq!(small.pixel(0, 0)[0], 35, "mean of 0, 10, 60, 70");
        assert!(Arc::ptr_eq(&ImageCache::new(0, 1.0).get(&v).unwrap(), &image), "memory is not copied at full size");
    }

    #[test]
    fn what_is_kept_of_a_whole_image_is_what_would_be_decoded() {
        let data = (0..6 * 4u8).flat_map(|k| [k * 10, 7, k, if k % 5 == 0 { 90 } else { 255 }]).collect();
        let v = view(ImageSource::Memory(Arc::new(ImageU8 { width: 6, height: 4, data })), 6, 4);
        let whole = ImageCache::new(0, 1.0).get(&v).unwrap();
        let (decoded, kept) = (ImageCache::new(0, 0.5), ImageCache::new(4 * 3 * 2, 0.5));
        kept.keep_reduced(&v, &whole);
        assert_eq!(kept.get(&v).unwrap(), decoded.get(&v).unwrap());
        assert_eq!([&decoded, &kept].map(ImageCache::decoded), [1, 0]);
        let other = View { opaque: true, ..v.clone() };
        kept.keep_reduced(&other, &whole);
        assert_eq!(kept.bytes(), 4 * 3 * 2, "no room for another");
        assert_eq!((kept.get(&v).unwrap().width, kept.decoded()), (3, 0), "the first stays");
    }

    #[test]
    fn a_wrong_size_is_an_error() {
        let image = Arc::new(ImageU8 { width: 2, height: 1, data: vec![0; 8] });
        let e = ImageCache::new(0, 1.0).get(&view(ImageSource::Memory(image), 2, 2)).unwrap_err();
        assert_eq!((e.code(), e.to_string().as_str()), ("data.image_size", "v is 2x1, its camera is 2x2"));
    }

    #[test]
    fn views_of_other_sizes_have_masks_and_depth_of_their_own() {
        let dir = tempfile::tempdir().unwrap();
        let (mask, depth) = (dir.path().join("mask.png"), dir.path().join("depth.png"));
        image::GrayImage::new(8, 4).save(&mask).unwrap();
        image::ImageBuffer::<image::Luma<u16>, Vec<u16>>::new(8, 4).save(&depth).unwrap();
        let cache = ImageCache::new(1 << 20, 1.0);
        for (width, height) in [(8, 4), (4, 2)] {
            let mut v = view(ImageSource::Memory(Arc::default()), width, height);
            (v.mask, v.depth) = (Some(ImageSource::File(mask.clone())), Some(crate::DepthMap::new(depth.clone())));
            let want = (width as usize, height as usize, 1);
            assert_eq!(cache.mask(&v).unwrap().unwrap().shape(), want);
            assert_eq!(cache.depth(&v).unwrap().unwrap().shape(), want);
        }
    }

    #[test]
    fn threads_see_the_same_images() {
        let dir = tempfile::tempdir().unwrap();
        let file = dir.path().join("a.png");
        image::RgbaImage::from_pixel(16, 16, image::Rgba([1, 2, 3, 4])).save(&file).unwrap();
        let v = view(ImageSource::File(file), 16, 16);
        let cache = ImageCache::new(1 << 20, 1.0);
        std::thread::scope(|s| {
            for _ in 0..4 {
                s.spawn(|| assert_eq!(cache.get(&v).unwrap().pixel(0, 0), [1, 2, 3, 4]));
            }
        });
        assert_eq!(cache.bytes(), 16 * 16 * 4);
    }
}
