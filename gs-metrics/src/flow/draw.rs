//! Pictures of flows.

use gs_core::Image;

use super::Flow;
use crate::error::{MetricError, check_image};

/// Mean displacements shorter than this are not drawn, pixels.
const LEAST: f32 = 0.5;
/// Half the thickness of an arrow, pixels.
const HALF_LINE: f32 = 0.6;
/// Length of an arrow's head over that of the arrow, and its limit in pixels.
const HEAD: (f32, f32) = (0.4, 5.0);
/// Cosine and sine of the angle between a head's side and the shaft.
const BARB: (f32, f32) = (0.866_025_4, 0.5);

/// The colour wheel: hue is the direction `atan2(v, u)` (right is red, down lies 90° further, towards green), saturation the
/// length over `longest` pixels, or over the longest of the map; no motion is white. RGB.
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
    let turn = |u: f32, v: f32| (v.atan2(u) / std::f32::consts::TAU).rem_euclid(1.0);
    let pixels = flow.u.iter().zip(&flow.v).zip(&lengths);
    let data = pixels.flat_map(|((u, v), length)| hue(turn(*u, *v), (length / longest).min(1.0))).collect();
    Ok(Image { width: flow.width, height: flow.height, channels: 3, data })
}

/// A colour of full value: `turn` in `[0, 1)` from red over green and blue, `saturation` in `[0, 1]`.
fn hue(turn: f32, saturation: f32) -> [f32; 3] {
    [0.0, 2.0 / 3.0, 1.0 / 3.0].map(|shift| {
        let away = ((turn + shift).rem_euclid(1.0) * 6.0 - 3.0).abs();
        1.0 - saturation * (1.0 - (away - 1.0).clamp(0.0, 1.0))
    })
}

/// `image` (RGB) with an arrow in `color` for each cell of `spacing × spacing` pixels (16 or 24 read well): the cell's mean
/// displacement, `stretch` times, from its middle. Cells which move less than half a pixel have none.
///
/// # Errors
/// Another size than the flow's, not 3 channels, values of the flow that are not finite, `spacing` of 0.
pub fn arrows(image: &Image, flow: &Flow, spacing: usize, stretch: f32, color: [f32; 3]) -> Result<Image, MetricError> {
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
            if mean[0].hypot(mean[1]) >= LEAST {
                let from = [(left + right - 1) as f32 * 0.5, (top + bottom - 1) as f32 * 0.5];
                arrow(&mut out, from, mean.map(|d| d * stretch), color);
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
    sum.map(|s| (s / count as f64) as f32)
}

/// A shaft with two sides of a head.
fn arrow(image: &mut Image, from: [f32; 2], along: [f32; 2], color: [f32; 3]) {
    let length = along[0].hypot(along[1]);
    let tip = [from[0] + along[0], from[1] + along[1]];
    line(image, from, tip, color);
    let back = (HEAD.0 * length).min(HEAD.1) / length.max(f32::MIN_POSITIVE);
    for side in [-BARB.1, BARB.1] {
        let d = [BARB.0 * along[0] - side * along[1], BARB.0 * along[1] + side * along[0]];
        line(image, tip, [tip[0] - back * d[0], tip[1] - back * d[1]], color);
    }
}

/// A line with soft edges; what lies outside is cut off.
fn line(image: &mut Image, a: [f32; 2], b: [f32; 2], color: [f32; 3]) {
    let reach = HALF_LINE + 1.0;
    let span = |k: usize, n: usize| {
        let (low, high) = (a[k].min(b[k]) - reach, a[k].max(b[k]) + reach);
        // The cast of a negative number is 0.
        low.ceil() as usize..((high.floor() + 1.0) as usize).min(n)
    };
    let d = [b[0] - a[0], b[1] - a[1]];
    let square = (d[0] * d[0] + d[1] * d[1]).max(f32::MIN_POSITIVE);
    for y in span(1, image.height) {
        for x in span(0, image.width) {
            let p = [x as f32 - a[0], y as f32 - a[1]];
            let t = ((p[0] * d[0] + p[1] * d[1]) / square).clamp(0.0, 1.0);
            let away = (p[0] - t * d[0]).hypot(p[1] - t * d[1]);
            let cover = (HALF_LINE + 0.5 - away).clamp(0.0, 1.0);
            for (v, c) in image.pixel_mut(x, y).iter_mut().zip(color) {
                *v += cover * (c - *v);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_wheel_turns_from_red_and_fades_to_white() {
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
    fn arrows_lie_along_the_flow_and_only_where_there_is_some() {
        let (w, h) = (48, 32);
        let mut flow = Flow::zeros(w, h);
        for y in 0..16 {
            flow.u[y * w..y * w + 16].fill(6.0);
        }
        let black = Image::zeros(w, h, 3);
        let drawn = arrows(&black, &flow, 16, 1.0, [1.0, 0.5, 0.25]).unwrap();
        let row: Vec<usize> = (0..w).filter(|x| drawn.pixel(*x, 7)[0] > 0.5).collect();
        assert_eq!((row.first(), row.last()), (Some(&8), Some(&14)), "{row:?}");
        assert!((16..h).all(|y| (0..w).all(|x| drawn.pixel(x, y)[0] == 0.0)));
        let p = drawn.pixel(10, 8);
        assert!(p[0] > 0.0 && p[1] == 0.5 * p[0] && p[2] == 0.25 * p[0]);
        let small = Flow { u: vec![0.4; w * h], ..Flow::zeros(w, h) };
        assert_eq!(arrows(&black, &small, 16, 1.0, [1.0; 3]).unwrap(), black);
        let wild = Flow { u: vec![-1e6; w * h], ..Flow::zeros(w, h) };
        assert!(arrows(&black, &wild, 24, 1.0, [1.0; 3]).unwrap().first_non_finite().is_none());
        assert!(arrows(&black, &flow, 0, 1.0, [1.0; 3]).is_err());
        assert!(arrows(&Image::zeros(w, h, 1), &flow, 16, 1.0, [1.0; 3]).is_err());
    }
}
