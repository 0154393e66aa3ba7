//! The box of what a ground-truth image shows.

use gs_core::Image;
use gs_data::ImageU8;

/// A rectangle of pixels; `high` is the first row and column beyond it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Region {
    /// Column and row of the first pixel.
    pub low: [usize; 2],
    /// Column and row behind the last pixel.
    pub high: [usize; 2],
}

impl Region {
    /// The smallest that holds all pixels of some opacity; none if there is no such pixel.
    pub fn shown(image: &ImageU8) -> Option<Self> {
        let opaque = (0..image.data.len() / 4).filter(|i| image.data[4 * i + 3] > 0);
        opaque.map(|i| [i % image.width, i / image.width]).fold(None, |found, [x, y]| {
            let Self { low, high } = found.unwrap_or(Self { low: [x, y], high: [x, y] });
            Some(Self { low: [low[0].min(x), low[1].min(y)], high: [high[0].max(x + 1), high[1].max(y + 1)] })
        })
    }

    /// The pixels of `from` inside the region.
    pub fn crop(self, from: &Image, to: &mut Image) {
        let ([x0, y0], [x1, y1], c) = (self.low, self.high, from.channels);
        (to.width, to.height, to.channels) = (x1 - x0, y1 - y0, c);
        to.data.clear();
        (y0..y1)
            .for_each(|y| to.data.extend_from_slice(&from.data[(y * from.width + x0) * c..(y * from.width + x1) * c]));
    }

    /// `from`, of the region's size, into zeros of the shape of `like`.
    pub(super) fn paste(self, from: &Image, like: &Image, to: &mut Image) {
        (to.width, to.height, to.channels) = like.shape();
        to.data.clear();
        to.data.resize(like.data.len(), 0.0);
        let ([x0, y0], width) = (self.low, from.width * from.channels);
        for (y, row) in from.data.chunks_exact(width.max(1)).enumerate() {
            to.data[((y0 + y) * like.width + x0) * like.channels..][..width].copy_from_slice(row);
        }
    }
}
