//! Scatter chart of speed against error: one numbered point per benchmark row.

use super::ReportError;
use super::chart::{Area, TEXT, framed, svg};
use gs_core::speed::BenchRow;
use plotters::prelude::*;

/// Colour of the points (blue of Okabe and Ito).
const POINT: RGBColor = RGBColor(0, 114, 178);

/// Renders the chart as an `<svg>` element with logarithmic axes; point `k` is row `k`, from 1. `None` if no row has a positive
/// time and error.
///
/// # Errors
/// If the plotting library fails.
pub(crate) fn scatter(rows: &[BenchRow]) -> Result<Option<String>, ReportError> {
    let place = |(k, r): (usize, &BenchRow)| Some((k + 1, r.ms, r.error?));
    let shown = |v: f64| v.is_finite() && v > 0.0;
    let points: Vec<(usize, f64, f64)> =
        rows.iter().enumerate().filter_map(place).filter(|p| shown(p.1) && shown(p.2)).collect();
    let Some((x, y)) = span(points.iter().map(|p| p.1)).zip(span(points.iter().map(|p| p.2))) else { return Ok(None) };
    let draw = |root: &Area<'_>| {
        let (x, y) = (x.log_scale().base(2.0), y.log_scale());
        let mut chart = framed(root, "Error against time", "milliseconds", x, y)?;
        let text = ("sans-serif", 13).into_font().color(&TEXT);
        let marks = points.iter().map(|(k, ms, error)| {
            EmptyElement::at((*ms, *error))
                + Circle::new((0, 0), 4, POINT.filled())
                + Text::new(k.to_string(), (7, -7), text.clone())
        });
        chart.draw_series(marks).map(|_| ()).map_err(|e| e.to_string())
    };
    svg("Error against time", draw).map(Some)
}

/// The range of values with a margin of 30 %.
fn span(values: impl Iterator<Item = f64> + Clone) -> Option<std::ops::Range<f64>> {
    let low = values.clone().reduce(f64::min)?;
    Some(low / 1.3..values.fold(low, f64::max) * 1.3)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn points_carry_the_numbers_of_their_rows() {
        let row = |ms: f64, error: Option<f64>| BenchRow {
            krate: "c",
            case: "draw".into(),
            variant: "v".into(),
            n: 1,
            threads: 1,
            ms,
            work: 1.0,
            error,
            error_kind: "e",
        };
        let svg = scatter(&[row(1.0, Some(1e-6)), row(2.0, None), row(0.5, Some(1e-2))]).unwrap().unwrap();
        assert_eq!(svg.matches("<circle").count(), 2);
        let labels: Vec<_> = ["\n1\n", "\n2\n", "\n3\n"].iter().map(|n| svg.matches(n).count()).collect();
        assert!(labels[0] >= 1 && labels[2] >= 1, "{svg}");
        assert_eq!(scatter(&[row(1.0, Some(0.0)), row(f64::NAN, Some(1.0))]).unwrap(), None);
        assert!(scatter(&[row(1.0, Some(1e-3))]).unwrap().is_some(), "one point has a range");
    }
}
