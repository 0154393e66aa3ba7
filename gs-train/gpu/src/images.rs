//! Ground-truth images on the device.
//!
//! Training goes through all images in another order each time. Where not all have room, the one that came last makes room for the next: so a
//! pass finds about as large a part of them as has room.

use gs_data::ImageU8;
use gs_gpu::{Array, Gpu, GpuError};
use std::collections::BTreeMap;

/// Bytes of images kept, but for one that is larger alone.
const MOST: u64 = 2 << 30;

/// Images by their number, all of one scale.
#[derive(Default)]
pub(crate) struct Images {
    scale: f64,
    by_view: BTreeMap<usize, Array>,
    /// Their numbers, in the order they came.
    order: Vec<usize>,
    bytes: u64,
}

impl Images {
    pub(crate) fn has(&self, view: usize, scale: f64) -> bool {
        scale == self.scale && self.by_view.contains_key(&view)
    }

    pub(crate) fn get(&self, view: usize) -> Option<&Array> {
        self.by_view.get(&view)
    }

    pub(crate) fn put(&mut self, gpu: &Gpu, view: usize, scale: f64, image: &ImageU8) -> Result<(), GpuError> {
        self.put_within(gpu, view, scale, image, MOST)
    }

    fn put_within(&mut self, gpu: &Gpu, view: usize, scale: f64, image: &ImageU8, most: u64) -> Result<(), GpuError> {
        if scale != self.scale {
            *self = Self { scale, ..Self::default() };
        }
        while self.bytes + image.data.len() as u64 > most
            && let Some(newest) = self.order.pop()
        {
            self.bytes -= self.by_view.remove(&newest).map_or(0, |array| array.bytes());
        }
        let array = Array::of(gpu, "an image", &image.data)?;
        self.bytes += array.bytes();
        self.order.push(view);
        self.by_view.insert(view, array);
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use gs_core::Rng;

    #[test]
    fn passes_in_random_order_find_the_part_that_has_room() {
        let gpu = match Gpu::open() {
            Ok(gpu) => gpu,
            Err(e) => {
                assert!(std::env::var_os("GS4D_REQUIRE_GPU").is_none(), "{e}");
                return println!("SKIPPED gs-train-gpu: {e}");
            }
        };
        let image = ImageU8 { width: 4, height: 4, data: vec![7; 64] };
        for room in [10, 20, 30] {
            let (mut images, mut found) = (Images::default(), 0);
            for pass in 0..20 {
                for view in Rng::new(3, "order", pass, 0).permutation(40) {
                    let view = view as usize;
                    match images.has(view, 1.0) {
                        true => found += 1,
                        false => images.put_within(&gpu, view, 1.0, &image, room * 64).unwrap(),
                    }
                    assert!(images.get(view).is_some() && images.bytes <= room * 64);
                }
            }
            // The first pass finds nothing, a later one all but those that made room.
            assert!((19 * (room - 1)..19 * room + 19 * room / 4).contains(&found), "{room} of 40: {found}");
        }
        images_of_another_scale(&gpu, &image);
    }

    fn images_of_another_scale(gpu: &Gpu, image: &ImageU8) {
        let mut images = Images::default();
        images.put(gpu, 0, 1.0, image).unwrap();
        images.put(gpu, 1, 0.5, image).unwrap();
        assert!(images.get(0).is_none() && images.has(1, 0.5) && !images.has(1, 1.0));
    }
}
