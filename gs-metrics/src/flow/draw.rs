//! Images of flows: colour coding and arrows.

use gs_core::{Image, cast};

use super::Flow;
use crate::error::{MetricError, check_image};

/// Length of the shortest mean displacement with an arrow, pixels.
const MIN_ARROW: f32 = 0.5;
/// Half the thickness of an arrow, pixels.
const HALF_LINE: f32 = 0.6;
/// Length of the head over that of the arrow, and its limit in pixels.
const HEAD: (f32, f32) = (0.4, 5.0);
/// Cosine and sine of the angle between a side of the head and the shaft, 30°.
const BARB: (f32, f32) = (0.866_025_4, 0.5);

/// The flow as an RGB image `[H, W, 3]`: hue is the direction `atan2(v, u)` (right is red, down is 90° further towards green),
/// saturation the length over `longest` pixels (`None`: over the longest displacement). No motion is white.
///
/// # Errors
/// A malformed flow, a value that is not finite, or `longest` not positive.
pub fn wheel(flow: &Flow, longest: Option<f32>) -> Result<Image, MetricError> {
    flow.check("flow")?;
    let lengths = flow.magnitudes();
    let longest = match longest {
        Some(given) if given > 0.0 && given.is_finite() => given,
        Some(given) => {
            let must = "a positive length in pixels";
            return Err(MetricError::Option { name: "longest", value: given.to_string(), must });
        }
        None => lengths.iter().fold(f32::MIN_POSITIVE, |m, v| m.max(*v)),
    };
    let angle = |u: f32, v: f32| (v.atan2(u) / std::f32::consts::TAU).rem_euclid(1.0);
    let pixels = flow.u.iter().zip(&flow.v).zip(&lengths);
    let data = pixels.flat_map(|((u, v), length)| hue(angle(*u, *v), (length / longest).min(1.0))).collect();
    Ok(Image { width: flow.width, height: flow.height, channels: 3, data })
}

/// A colour of value 1 (HSV): `turn` in `[0, 1)` is the hue from red over green and blue, `saturation` lies in `[0, 1]`.
fn hue(turn: f32, saturation: f32) -> [f32; 3] {
    [0.0, 2.0 / 3.0, 1.0 / 3.0].map(|shift| {
        let distance = ((turn + shift).rem_euclid(1.0) * 6.0 - 3.0).abs();
        1.0 - saturation * (1.0 - (distance - 1.0).clamp(0.0, 1.0))
    })
}

/// `image` `[H, W, 3]` with an arrow in the RGB colour `color` for each cell of `spacing × spacing` pixels (typically 16 or 24):
/// `scale` times the mean displacement of the cell, from its centre. Cells that move less than half a pixel have no arrow.
///
/// # Errors
/// Another size than the flow's, not 3 channels, values of the flow that are not finite, `spacing` of 0.
pub fn arrows(image: &Image, flow: &Flow, spacing: usize, scale: f32, color: [f32; 3]) -> Result<Image, MetricError> {
    flow.check("flow")?;
    check_image("image", image)?;
    let want = (flow.width, flow.height, 3);
    if image.shape() != want {
        return Err(MetricError::Shape { what: "flow and image (RGB)", first: want, second: image.shape() });
    }
    if spacing == 0 {
        let must = "at least 1 pixel, usually 16 or 24";
        return Err(MetricError::Option { name: "spacing", value: "0".into(), must });
    }
    let mut out = image.clone();
    for top in (0..flow.height).step_by(spacing) {
        for left in (0..flow.width).step_by(spacing) {
            let (right, bottom) = ((left + spacing).min(flow.width), (top + spacing).min(flow.height));
            let mean = cell_mean(flow, left..right, top..bottom);
            if mean[0].hypot(mean[1]) >= MIN_ARROW {
                let from = [(left + right - 1) as f32 * 0.5, (top + bottom - 1) as f32 * 0.5];
                arrow(&mut out, from, mean.map(|d| d * scale), color);
            }
        }
    }
    Ok(out)
}

fn cell_mean(flow: &Flow, columns: std::ops::Range<usize>, rows: std::ops::Range<usize>) -> [f32; 2] {
    let mut sum = [0.0f64; 2];
    let count = columns.len() * rows.len();
    for y in rows {
        for x in columns.clone() {
            flow.at(x, y).iter().zip(&mut sum).for_each(|(d, s)| *s += f64::from(*d));
        }
    }
    sum.map(|s| cast::to_f32(s / count as f64))
}

/// A shaft from `from` to `from + vector`, and the two sides of a head.
fn arrow(image: &mut Image, from: [f32; 2], vector: [f32; 2], color: [f32; 3]) {
    let length = vector[0].hypot(vector[1]);
    let tip = [from[0] + vector[0], from[1] + vector[1]];
    line(image, from, tip, color);
    let head = (HEAD.0 * length).min(HEAD.1) / length.max(f32::MIN_POSITIVE);
    for side in [-BARB.1, BARB.1] {
        let d = [BARB.0 * vector[0] - side * vector[1], BARB.0 * vector[1] + side * vector[0]];
        line(image, tip, [tip[0] - head * d[0], tip[1] - head * d[1]], color);
    }
}

/// An anti-aliased line, clipped to the image.
fn line(image: &mut Image, a: [f32; 2], b: [f32; 2], color: [f32; 3]) {
    let margin = HALF_LINE + 1.0;
    let span = |k: usize, n: usize| {
        let (low, high) = (a[k].min(b[k]) - margin, a[k].max(b[k]) + margin);
        cast::to_usize(low.ceil())..cast::to_usize(high.floor() + 1.0).min(n)
    };
    let d = [b[0] - a[0], b[1] - a[1]];
    let square = (d[0] * d[0] + d[1] * d[1]).max(f32::MIN_POSITIVE);
    for y in span(1, image.height) {
        for x in span(0, image.width) {
            let p = [x as f32 - a[0], y as f32 - a[1]];
            let t = ((p[0] * d[0] + p[1] * d[1]) / square).clamp(0.0, 1.0);
            let distance = (p[0] - t * d[0]).hypot(p[1] - t * d[1]);
            let coverage = (HALF_LINE + 0.5 - distance).clamp(0.0, 1.0);
            for (v, c) in image.pixel_mut(x, y).iter_mut().zip(color) {
                *v += coverage * (c - *v);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hue_is_the_direction_and_saturation_the_length() {
        let u = vec![2.0, 0.0, -2.0, 0.0, 0.0, 1.0];
        let v = vec![0.0, 2.0, 0.0, -2.0, 0.0, 0.0];
        let flow = Flow { width: 6, height: 1, u, v };
        let want = [[1.0, 0.0, 0.0], [0.5, 1.0, 0.0], [0.0, 1.0, 1.0], [0.5, 0.0, 1.0], [1.0; 3], [1.0, 0.5, 0.5]];
        for (x, want) in want.iter().enumerate() {
            let got = wheel(&flow, None).unwrap();
            got.pixel(x, 0).iter().zip(want).for_each(|(g, w)| assert!((g - w).abs() < 1e-6, "{x}: {got:?}"));
        }
        assert_eq!(wheel(&flow, Some(1.0)).unwrap().pixel(5, 0), [1.0, 0.0, 0.0]);
        assert!(wheel(&Flow::zeros(3, 2), None).unwrap().data.iter().all(|v| *v == 1.0));
        assert!(wheel(&flow, Some(0.0)).is_err());
    }

    #[test]
    fn arrows_lie_along_the_flow_where_it_moves() {
        let (w, h) = (48, 32);
        let mut flow = Flow::zeros(w, h);
        for y in 0..16 {
            flow.u[y * w..y * w + 16].fill(6.0);
        }
        let black = Image::zeros(w, h, 3);
        let image = arrows(&black, &flow, 16, 1.0, [1.0, 0.5, 0.25]).unwrap();
        let row: Vec<usize> = (0..w).filter(|x| image.pixel(*x, 7)[0] > 0.5).collect();
        assert_eq!((row.first(), row.last()), (Some(&8), Some(&14)), "{row:?}");
        assert!((16..h).all(|y| (0..w).all(|x| image.pixel(x, y)[0] == 0.0)));
        let p = image.pixel(10, 8);
        assert!(p[0] > 0.0 && p[1] == 0.5 * p[0] && p[2] == 0.25 * p[0]);
        let small = Flow { u: vec![0.4; w * h], ..Flow::zeros(w, h) };
        assert_eq!(arrows(&black, &small, 16, 1.0, [1.0; 3]).unwrap(), black);
        let huge = Flow { u: vec![-1e6; w * h], ..Flow::zeros(w, h) };
        assert!(arrows(&black, &huge, 24, 1.0, [1.0; 3]).unwrap().first_non_finite().is_none());
        assert!(arrows(&black, &flow, 0, 1.0, [1.0; 3]).is_err());
        assert!(arrows(&Image::zeros(w, h, 1), &flow, 16, 1.0, [1.0; 3]).is_err());
    }
}
