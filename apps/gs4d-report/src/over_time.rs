//! The chart of the scores of views against the time of the scene.

use super::ReportError;
use super::chart::{Area, COLORS, Curve, GRID, entries, framed, ranges, svg, with_margin};
use plotters::prelude::*;

/// Renders a point for every view, `(time, PSNR)`, as an `<svg>` element; the points of a curve are joined where each has a
/// time of its own. A band marks `training`, the first and last training time, if a view lies outside of it. `None` if all
/// views have one time.
///
/// # Errors
/// If the plotting library fails.
pub fn over_time(title: &str, curves: &[Curve], training: Option<[f64; 2]>) -> Result<Option<String>, ReportError> {
    let Some((x, y)) = ranges(curves) else { return Ok(None) };
    let (x_name, y) = ("normalised time", with_margin(y));
    let band = training.filter(|[first, last]| x.0 < *first || x.1 > *last);
    let mut legend = entries(curves);
    legend.extend(band.map(|_| ("training times".to_owned(), GRID)));
    let (low, high) = band.map_or(x, |b| (x.0.min(b[0]), x.1.max(b[1])));
    let margin = 0.02 * (high - low);
    let draw = |root: &Area<'_>| {
        let mut chart = framed(root, title, x_name, low - margin..high + margin, y.clone())?;
        let band = band.map(|[first, last]| Rectangle::new([(first, y.start), (last, y.end)], GRID.mix(0.6).filled()));
        chart.draw_series(band).map_err(|e| e.to_string())?;
        for (curve, color) in curves.iter().zip(COLORS.iter().cycle()) {
            let mut points = curve.points.clone();
            points.sort_by(|a, b| a.0.total_cmp(&b.0));
            if points.windows(2).all(|w| w[0].0 < w[1].0) {
                let line = LineSeries::new(points.iter().copied(), color.stroke_width(1));
                chart.draw_series(line).map_err(|e| e.to_string())?;
            }
            let dots = points.iter().map(|p| Circle::new(*p, 3, color.filled()));
            chart.draw_series(dots).map_err(|e| e.to_string())?;
        }
        Ok(())
    };
    svg(&format!("{title}, against {x_name}"), &legend, draw).map(Some)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn curve(points: &[(f64, f64)]) -> Curve {
        Curve { name: "test views".into(), points: points.to_vec() }
    }

    #[test]
    fn every_view_is_a_point_and_training_is_marked_where_views_lie_outside() {
        let inside = curve(&[(0.5, 24.0), (0.25, 21.0), (0.75, 22.0)]);
        let shown = |curves: &[Curve]| over_time("PSNR, dB", curves, Some([0.0, 1.0])).unwrap().unwrap();
        let svg = shown(std::slice::from_ref(&inside));
        assert_eq!((svg.matches("<circle").count(), svg.matches("training times").count()), (3, 0), "{svg}");
        let svg = shown(&[inside, curve(&[(1.5, 20.0), (1.25, 19.0)])]);
        assert_eq!((svg.matches("<circle").count(), svg.matches("training times").count()), (5, 1), "{svg}");
    }

    #[test]
    fn views_of_one_time_are_not_joined_and_need_no_chart() {
        let lines = |points: &[(f64, f64)]| {
            let svg = over_time("PSNR, dB", &[curve(points)], None).unwrap().unwrap();
            svg.matches("stroke=\"#0072B2\"").count()
        };
        let apart = lines(&[(0.0, 24.0), (1.0, 21.0)]);
        assert_eq!(apart, lines(&[(0.0, 24.0), (0.0, 23.0), (1.0, 21.0)]) + 1);
        for still in [&[(0.5, 24.0)][..], &[(0.5, 24.0), (0.5, 21.0)], &[]] {
            assert_eq!(over_time("PSNR, dB", &[curve(still)], None).unwrap(), None);
        }
    }
}
