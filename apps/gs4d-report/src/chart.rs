//! Line charts as inline SVG.

use super::ReportError;
use super::html::escape;
use plotters::coord::ranged1d::{AsRangedCoord, Ranged, ValueFormatter};
use plotters::prelude::*;

pub use gs_train::report::{Curve, Scale};

/// Width and height of a chart without its legend, in SVG units; the page scales it.
const SIZE: (u32, u32) = (560, 260);
/// Height of a row of the legend, SVG units.
const ROW: i32 = 18;
/// Twice the estimated width of a letter of the legend, SVG units.
const LETTER: i32 = 15;
/// Left end of the legend: that of the axis.
const LEFT: i32 = 62;
/// Colours of the lines, safe for colour-blind readers (Okabe and Ito).
pub(super) const COLORS: [RGBColor; 6] = [
    RGBColor(0, 114, 178),
    RGBColor(213, 94, 0),
    RGBColor(0, 158, 115),
    RGBColor(204, 121, 167),
    RGBColor(230, 159, 0),
    RGBColor(86, 180, 233),
];
/// Colour of text; the page's style sheet replaces it in dark mode.
pub(super) const TEXT: RGBColor = RGBColor(75, 85, 99);
const TITLE: RGBColor = RGBColor(17, 24, 39);
pub(super) const GRID: RGBColor = RGBColor(229, 231, 235);
/// Most points of a line; more are averaged in groups.
const MAX_POINTS: usize = 600;

/// Renders curves as an `<svg>` element; `None` if fewer than two places on the horizontal axis are left.
///
/// ```
/// use gs4d_report::chart::{Curve, Scale, chart};
///
/// let curve = Curve { name: "loss".into(), points: vec![(1.0, 0.5), (2.0, 0.25), (3.0, f64::NAN)] };
/// let svg = chart("Training loss", "step", Scale::Log, &[curve])?.unwrap();
/// assert!(svg.contains("aria-label=\"Training loss, against step\""));
/// assert_eq!(chart("Empty", "step", Scale::Linear, &[])?, None);
/// # Ok::<(), gs4d_report::ReportError>(())
/// ```
///
/// # Errors
/// If the plotting library fails.
pub fn chart(title: &str, x_name: &str, scale: Scale, curves: &[Curve]) -> Result<Option<String>, ReportError> {
    let shown = |y: f64| y.is_finite() && (scale == Scale::Linear || y > 0.0);
    let curves: Vec<Curve> = curves
        .iter()
        .map(|c| {
            let kept: Vec<_> = c.points.iter().copied().filter(|p| p.0.is_finite() && shown(p.1)).collect();
            Curve { name: c.name.clone(), points: thinned(&kept) }
        })
        .filter(|c| !c.points.is_empty())
        .collect();
    let Some((x, y)) = ranges(&curves) else { return Ok(None) };
    let draw = |root: &Area<'_>| match scale {
        // Between few powers of a base there would be no mark.
        Scale::Log if y.1 < 4.0 * y.0 => lines(framed(root, title, x_name, x.0..x.1, with_margin(y))?, &curves),
        Scale::Linear => lines(framed(root, title, x_name, x.0..x.1, with_margin(y))?, &curves),
        Scale::Log => {
            let (low, high) = (y.0 * 0.9, (y.1 * 1.1).max(y.0 * 1.5));
            // Over few decades, powers of two give more marks than powers of ten.
            let base = if high / low < 64.0 { 2.0 } else { 10.0 };
            lines(framed(root, title, x_name, x.0..x.1, (low..high).log_scale().base(base))?, &curves)
        }
    };
    svg(&format!("{title}, against {x_name}"), &entries(&curves), draw).map(Some)
}

/// The plot area of a chart.
pub(super) type Area<'a> = DrawingArea<SVGBackend<'a>, plotters::coord::Shift>;

/// An entry of a legend.
pub(super) type Entry = (String, RGBColor);

/// The legend of curves: none for a single one, and no entry for a curve without a name.
pub(super) fn entries(curves: &[Curve]) -> Vec<Entry> {
    if curves.len() < 2 {
        return Vec::new();
    }
    let named = curves.iter().zip(COLORS.iter().cycle()).filter(|(c, _)| !c.name.is_empty());
    named.map(|(c, color)| (c.name.clone(), *color)).collect()
}

/// An `<svg>` element that fills the width of its parent, with a legend below the plot; `name` is its label for screen readers.
pub(super) fn svg(
    name: &str,
    legend: &[Entry],
    draw: impl FnOnce(&Area<'_>) -> Result<(), String>,
) -> Result<String, ReportError> {
    let (places, rows) = legend_places(legend);
    let height = SIZE.1 + rows * ROW.unsigned_abs();
    let mut svg = String::new();
    let root = SVGBackend::with_string(&mut svg, (SIZE.0, height)).into_drawing_area();
    let (plot, below) = root.split_vertically(SIZE.1);
    let drawn = draw(&plot).and_then(|()| {
        let text = ("sans-serif", 13).into_font().color(&TEXT);
        for ((name, color), (x, y)) in legend.iter().zip(places) {
            let swatch = Rectangle::new([(x, y + 3), (x + 14, y + 9)], color.filled());
            below.draw(&swatch).map_err(|e| e.to_string())?;
            below.draw(&Text::new(name.clone(), (x + 20, y), text.clone())).map_err(|e| e.to_string())?;
        }
        root.present().map_err(|e| e.to_string())
    });
    drawn.map_err(ReportError::Chart)?;
    drop((plot, below, root));
    // The page sets the width; the height follows from the view box.
    let fixed = format!("width=\"{}\" height=\"{height}\" ", SIZE.0);
    Ok(svg.replacen(&fixed, &format!("role=\"img\" aria-label=\"{}\" ", escape(name)), 1))
}

/// Where the entries of a legend stand, in rows, and the number of rows.
fn legend_places(legend: &[Entry]) -> (Vec<(i32, i32)>, u32) {
    let (mut x, mut row) = (LEFT, 0);
    let place = |(name, _): &Entry| {
        let width = i32::try_from(name.chars().count()).map_or(i32::MAX / 2, |n| n.saturating_mul(LETTER) / 2 + 36);
        if x > LEFT && x + width > SIZE.0.cast_signed() {
            (x, row) = (LEFT, row + 1);
        }
        x += width;
        (x - width, row * ROW)
    };
    let places: Vec<_> = legend.iter().map(place).collect();
    let rows = places.last().map_or(0, |p| p.1.unsigned_abs() / ROW.unsigned_abs() + 1);
    (places, rows)
}

/// A chart with axes.
type Framed<'a, 'b, X, Y> = ChartContext<
    'a,
    SVGBackend<'b>,
    Cartesian2d<<X as AsRangedCoord>::CoordDescType, <Y as AsRangedCoord>::CoordDescType>,
>;

/// Adds title, axes and grid.
pub(super) fn framed<'a, 'b, X, Y>(
    root: &'a Area<'b>,
    title: &str,
    x_name: &str,
    x: X,
    y: Y,
) -> Result<Framed<'a, 'b, X, Y>, String>
where
    X: AsRangedCoord<Value = f64>,
    Y: AsRangedCoord<Value = f64>,
    X::CoordDescType: ValueFormatter<f64>,
    Y::CoordDescType: ValueFormatter<f64>,
{
    let text = ("sans-serif", 13).into_font().color(&TEXT);
    let mut chart = ChartBuilder::on(root)
        .caption(title, ("sans-serif", 15).into_font().color(&TITLE))
        .margin(8)
        .margin_right(18)
        .x_label_area_size(38)
        .y_label_area_size(54)
        .build_cartesian_2d(x, y)
        .map_err(|e| e.to_string())?;
    chart
        .configure_mesh()
        .disable_x_mesh()
        .light_line_style(WHITE.mix(0.0))
        .bold_line_style(GRID)
        .axis_style(RGBColor(156, 163, 175))
        .x_labels(7)
        .y_labels(6)
        .x_label_formatter(&|v| short(*v))
        .y_label_formatter(&|v| short(*v))
        .x_desc(x_name)
        .label_style(text.clone())
        .axis_desc_style(text)
        .draw()
        .map_err(|e| e.to_string())?;
    Ok(chart)
}

fn lines<'a, 'b: 'a, X, Y>(
    mut chart: ChartContext<'a, SVGBackend<'b>, Cartesian2d<X, Y>>,
    curves: &[Curve],
) -> Result<(), String>
where
    X: Ranged<ValueType = f64>,
    Y: Ranged<ValueType = f64>,
{
    for (curve, color) in curves.iter().zip(COLORS.iter().cycle()) {
        let line = LineSeries::new(curve.points.iter().copied(), color.stroke_width(2))
            .point_size(u32::from(curve.points.len() < 20) * 3);
        chart.draw_series(line).map_err(|e| e.to_string())?;
    }
    Ok(())
}

/// The least and the greatest x and y; `None` if all points have one x.
pub(super) fn ranges(curves: &[Curve]) -> Option<((f64, f64), (f64, f64))> {
    let all = || curves.iter().flat_map(|c| c.points.iter());
    range(all().map(|p| p.0)).filter(|x| x.0 < x.1).zip(range(all().map(|p| p.1)))
}

/// A vertical axis a little longer than its values.
pub(super) fn with_margin((low, high): (f64, f64)) -> std::ops::Range<f64> {
    // A constant stands in the middle of an axis that has more than one number.
    let range = if high - low > 1e-6 * high.abs() { high - low } else { 4.0 * high.abs() };
    let margin = 0.06 * range.max(1e-12);
    low - margin..high + margin
}

fn range(values: impl Iterator<Item = f64>) -> Option<(f64, f64)> {
    values.fold(None, |r: Option<(f64, f64)>, v| Some(r.map_or((v, v), |(lo, hi)| (lo.min(v), hi.max(v)))))
}

/// At most [`MAX_POINTS`] points: means of equal groups, in order.
fn thinned(points: &[(f64, f64)]) -> Vec<(f64, f64)> {
    let group = points.len().div_ceil(MAX_POINTS).max(1);
    let mean = |g: &[(f64, f64)]| {
        let n = g.len() as f64;
        (g.iter().map(|p| p.0).sum::<f64>() / n, g.iter().map(|p| p.1).sum::<f64>() / n)
    };
    points.chunks(group).map(mean).collect()
}

/// A tick label: `1500` as `1.5k`, small numbers with few digits.
pub(super) fn short(v: f64) -> String {
    let a = v.abs();
    let text = match a {
        0.0 => return "0".to_owned(),
        _ if a >= 1e6 => format!("{:.2}M", v / 1e6),
        _ if a >= 1e4 => format!("{:.1}k", v / 1e3),
        _ if a >= 100.0 => format!("{v:.0}"),
        _ if a >= 1.0 => format!("{v:.2}"),
        _ if a >= 1e-3 => format!("{v:.4}"),
        _ => return format!("{v:.0e}"),
    };
    let (digits, unit) = text.split_at(text.trim_end_matches(['k', 'M']).len());
    let digits = if digits.contains('.') { digits.trim_end_matches('0').trim_end_matches('.') } else { digits };
    format!("{digits}{unit}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn labels_are_short() {
        let cases = [
            (0.0, "0"),
            (25.0, "25"),
            (1500.0, "1500"),
            (12_000.0, "12k"),
            (2.5e6, "2.5M"),
            (0.05, "0.05"),
            (2e-4, "2e-4"),
        ];
        for (v, want) in cases {
            assert_eq!(short(v), want);
        }
    }

    #[test]
    fn odd_points_do_not_stop_a_chart() {
        let curve = |points: Vec<(f64, f64)>| [Curve { name: "a".into(), points }];
        let poor = vec![(0.0, f64::NAN), (1.0, f64::INFINITY)];
        assert_eq!(chart("t", "x", Scale::Linear, &curve(poor)).unwrap(), None);
        assert_eq!(chart("t", "x", Scale::Log, &curve(vec![(0.0, -1.0), (1.0, 0.0)])).unwrap(), None);
        for alone in [vec![(3.0, 0.25)], vec![(3.0, 0.25), (3.0, 0.5)]] {
            assert_eq!(chart("t", "x", Scale::Log, &curve(alone)).unwrap(), None, "nothing to see along the axis");
        }
        let two = chart("t", "x", Scale::Log, &curve(vec![(3.0, 0.25), (4.0, 0.5)])).unwrap().unwrap();
        assert!(
            two.starts_with("<svg role=\"img\" aria-label=\"t, against x\" viewBox=")
                && two.trim_end().ends_with("</svg>"),
            "{two}"
        );
        let near = chart("t", "x", Scale::Log, &curve(vec![(10.0, 0.0522), (40.0, 0.0413)])).unwrap().unwrap();
        assert!(near.contains("0.044") && near.contains("0.05"), "marks: {near}");
        let even = chart("t", "x", Scale::Linear, &curve(vec![(0.0, 50_000.0), (1.0, 50_000.0)])).unwrap().unwrap();
        assert!(even.matches("50k").count() == 1 && even.contains("45k"), "one mark a number: {even}");
        let flat = chart("a<b", "x", Scale::Linear, &curve(vec![(0.0, 0.0), (1.0, 0.0)])).unwrap().unwrap();
        assert!(flat.contains("a&lt;b"));
    }

    #[test]
    fn a_legend_stands_below_the_plot_and_is_not_cut() {
        let curve = |name: &str| Curve { name: name.into(), points: vec![(0.0, 0.5), (1.0, 0.25)] };
        let of = |names: &[&str]| {
            chart("t", "x", Scale::Linear, &names.iter().map(|n| curve(n)).collect::<Vec<_>>()).unwrap().unwrap()
        };
        assert!(of(&["alone"]).contains("viewBox=\"0 0 560 260\"") && !of(&["alone"]).contains("alone"));
        assert!(of(&["a", "b", ""]).contains("viewBox=\"0 0 560 278\""));
        let long = "a long name of a curve, which takes half a row";
        assert!(of(&[long, long]).contains("viewBox=\"0 0 560 296\""), "two rows");
    }

    #[test]
    fn many_points_are_thinned_to_their_means() {
        let points: Vec<_> = (0..6000).map(|i| (f64::from(i), 2.0)).collect();
        let thin = thinned(&points);
        assert_eq!(thin.len(), 600);
        assert_eq!(thin[0], (4.5, 2.0));
    }
}
