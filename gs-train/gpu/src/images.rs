//! Ground-truth images on the device.

use gs_data::ImageU8;
use gs_gpu::{Array, Gpu, GpuError};
use std::collections::BTreeMap;

/// Bytes of images kept; where another does not fit, all are given up.
const MOST: u64 = 2 << 30;

/// Images by their number, all of one scale.
#[derive(Default)]
pub(crate) struct Images {
    scale: f64,
    by_view: BTreeMap<usize, Array>,
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
        let mut array = Array::new(gpu, "an image");
        array.upload(gpu, &image.data)?;
        let size = array.buffer().size();
        if scale != self.scale || self.bytes + size > MOST {
            *self = Self { scale, ..Self::default() };
        }
        self.by_view.insert(view, array);
        self.bytes += size;
        Ok(())
    }
}
