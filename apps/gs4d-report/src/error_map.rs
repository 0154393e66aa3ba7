//! Error maps: the error of each pixel, on one colour scale for all views of a section.

use super::ramp::Ramp;
use gs_core::Image;

/// Share of all pixels whose error is within the scale.
const COVERED_SHARE: f64 = 0.995;

/// Root mean square over channels of the difference of two images, `[H, W, 1]`; `None` if their shapes differ.
pub fn error(a: &Image, b: &Image) -> Option<Image> {
    let n = a.channels;
    if a.shape() != b.shape() || n == 0 {
        return None;
    }
    let square = |(x, y): (&[f32], &[f32])| x.iter().zip(y).map(|(x, y)| (x - y) * (x - y)).sum::<f32>() / n as f32;
    let data = a.data.chunks_exact(n).zip(b.data.chunks_exact(n)).map(|pixels| square(pixels).sqrt()).collect();
    Some(Image { width: a.width, height: a.height, channels: 1, data })
}

/// A colour scale from 0 to a round error.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct ErrorScale {
    /// Error at the bright end: 1, 2 or 5 times a power of ten, at most 1.
    pub(crate) top: f32,
}

impl ErrorScale {
    /// The smallest scale that holds 99.5 % of the pixels of some error maps.
    pub(crate) fn of<'a>(errors: impl IntoIterator<Item = &'a Image>) -> Self {
        let mut all: Vec<f32> = errors.into_iter().flat_map(|e| &e.data).copied().filter(|v| v.is_finite()).collect();
        let rank = ((all.len() as f64 * COVERED_SHARE) as usize).min(all.len().saturating_sub(1));
        let held = if all.is_empty() { 0.0 } else { *all.select_nth_unstable_by(rank, f32::total_cmp).1 };
        let held = f64::from(held).clamp(1e-4, 1.0);
        let power = 10f64.powf(held.log10().floor());
        let round = [1.0, 2.0, 5.0].into_iter().find(|m| m * power >= held * (1.0 - 1e-6));
        Self { top: (round.unwrap_or(10.0) * power) as f32 }
    }

    /// Colours of an error map `[H, W, 1]`, as `[H, W, 3]`.
    pub(crate) fn map(&self, error: &Image) -> Image {
        let ramp = Ramp::magma();
        let data = error.data.iter().flat_map(|e| ramp.at(e / self.top)).collect();
        Image { width: error.width, height: error.height, channels: 3, data }
    }

    /// Labels of the dark end, the middle and the bright end, with the PSNR of an image that has this error everywhere.
    pub(crate) fn ticks(&self) -> [String; 3] {
        let db = |e: f32| 20.0 * (1.0 / f64::from(e)).log10();
        let (half, top) = (0.5 * self.top, self.top);
        ["0".to_owned(), format!("{half} ({:.0} dB)", db(half)), format!("≥ {top} ({:.0} dB)", db(top))]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn image(channels: usize, data: Vec<f32>) -> Image {
        Image { width: data.len() / channels, height: 1, channels, data }
    }

    #[test]
    fn an_error_is_the_root_of_the_mean_square_over_channels() {
        let e = error(&image(3, vec![0.5, 0.5, 0.5, 1.0, 0.0, 0.0]), &image(3, vec![0.4, 0.6, 0.5, 0.0, 0.0, 0.0]));
        let want = [(0.02f32 / 3.0).sqrt(), (1.0f32 / 3.0).sqrt()];
        assert!(e.unwrap().data.iter().zip(want).all(|(a, b)| (a - b).abs() < 1e-6));
        assert_eq!(error(&image(3, vec![0.0; 3]), &image(1, vec![0.0; 3])), None);
    }

    #[test]
    fn a_scale_is_round_and_holds_nearly_all() {
        let top = |v: Vec<f32>| ErrorScale::of([&image(1, v)]).top;
        assert_eq!([top(vec![0.03]), top(vec![0.2]), top(vec![0.07]), top(vec![3.0])], [0.05, 0.2, 0.1, 1.0]);
        let mut values = vec![0.04; 1000];
        values.push(1.0);
        assert_eq!((top(values), top(vec![f32::NAN]), top(Vec::new())), (0.05, 1e-4, 1e-4));
    }

    #[test]
    fn colours_and_ticks_belong_together() {
        let scale = ErrorScale { top: 0.1 };
        let map = scale.map(&image(1, vec![0.0, 0.05, 0.1, 9.0]));
        let at = |s: f32| Ramp::magma().at(s);
        assert_eq!((map.pixel(0, 0), map.pixel(1, 0)), (&at(0.0)[..], &at(0.5)[..]));
        assert_eq!((map.pixel(2, 0), map.pixel(3, 0)), (&at(1.0)[..], &at(1.0)[..]));
        assert_eq!(scale.ticks(), ["0", "0.05 (26 dB)", "≥ 0.1 (20 dB)"]);
    }
}
