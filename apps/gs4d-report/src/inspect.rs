//! Summary of a set of splats: quantiles of each column, rows that are not finite, needles, invisible splats.

use gs_core::io::{RawSplats, sigmoid};
use gs_core::sh;
use serde::Serialize;

/// Ratio of the largest to the middle scale from which a splat is a needle.
pub const NEEDLE_ASPECT: f32 = 100.0;
/// Opacity below which no sample of a splat is ever blended (3DGS: alpha ≥ 1/255).
pub const INVISIBLE_OPACITY: f32 = 1.0 / 255.0;
/// Most rows listed that are not finite.
pub const ROWS_LISTED: usize = 20;

/// A summary of splats, non-finite ones included.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SplatSummary {
    /// Number of splats, rows of every column.
    pub splats: usize,
    /// SH degree, 0 to 3.
    pub sh_degree: u8,
    /// Bytes of all values as `f32`.
    pub bytes: usize,
    /// Number of rows with a value that is not finite.
    pub non_finite_rows: usize,
    /// The first [`ROWS_LISTED`] of them: row and name of the first such column.
    pub non_finite_first: Vec<(usize, &'static str)>,
    /// Number of rows whose largest scale is at least [`NEEDLE_ASPECT`] times the middle one.
    pub needles: usize,
    /// Number of rows of opacity below [`INVISIBLE_OPACITY`].
    pub invisible: usize,
    /// Share of the colour variance that depends on the view direction, 0..1; 0 at degree 0.
    pub view_dependent_share: f64,
    /// Quantiles of positions, activated scales and opacities, quaternion lengths and base colours.
    pub columns: Vec<Column>,
}

/// Quantiles of one quantity over its finite values, by nearest rank; all zero if there are none.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Column {
    /// Name of the quantity, for example `opacity`.
    pub name: &'static str,
    /// Smallest finite value.
    pub min: f32,
    /// 1st percentile of the finite values.
    pub q01: f32,
    /// 25th percentile of the finite values.
    pub q25: f32,
    /// 50th percentile of the finite values.
    pub median: f32,
    /// 75th percentile of the finite values.
    pub q75: f32,
    /// 99th percentile of the finite values.
    pub q99: f32,
    /// Largest finite value.
    pub max: f32,
}

impl Column {
    /// Computes the quantiles; values that are not finite are left out.
    ///
    /// ```
    /// let c = gs4d_report::inspect::Column::of("v", (0..100).map(|i| i as f32));
    /// assert_eq!((c.min, c.median, c.q99, c.max), (0.0, 49.0, 98.0, 99.0));
    /// ```
    pub fn of(name: &'static str, values: impl Iterator<Item = f32>) -> Self {
        let mut sorted: Vec<f32> = values.filter(|v| v.is_finite()).collect();
        sorted.sort_unstable_by(f32::total_cmp);
        let at = |share: f64| {
            let rank = (share * sorted.len() as f64).ceil() as usize;
            sorted.get(rank.max(1) - 1).or(sorted.last()).copied().unwrap_or(0.0)
        };
        let (min, q01, q25, median) = (at(0.0), at(0.01), at(0.25), at(0.5));
        Self { name, min, q01, q25, median, q75: at(0.75), q99: at(0.99), max: at(1.0) }
    }
}

impl SplatSummary {
    /// Summarises splats with raw parameters, as files hold them.
    pub fn of(raw: &RawSplats) -> Self {
        let width = raw.sh_width();
        let bad = raw.non_finite_rows();
        let scales: Vec<[f32; 3]> = raw.log_scales.iter().map(|s| ordered(s.to_array().map(f32::exp))).collect();
        let opacities: Vec<f32> = raw.logit_opacities.iter().map(|&o| sigmoid(o)).collect();
        let base = |c: usize| raw.sh.chunks_exact(width).map(move |row| 0.5 + sh::C0 as f32 * row[c]);
        let norm = |q: &[f32; 4]| q.iter().map(|v| f64::from(*v).powi(2)).sum::<f64>().sqrt() as f32;
        let columns = vec![
            Column::of("x", raw.means.iter().map(|m| m.x)),
            Column::of("y", raw.means.iter().map(|m| m.y)),
            Column::of("z", raw.means.iter().map(|m| m.z)),
            Column::of("smallest scale", scales.iter().map(|s| s[0])),
            Column::of("middle scale", scales.iter().map(|s| s[1])),
            Column::of("largest scale", scales.iter().map(|s| s[2])),
            Column::of("opacity", opacities.iter().copied()),
            Column::of("quaternion length", raw.quats.iter().map(norm)),
            Column::of("red", base(0)),
            Column::of("green", base(1)),
            Column::of("blue", base(2)),
        ];
        Self {
            splats: raw.len(),
            sh_degree: raw.degree,
            bytes: 4 * raw.len() * (3 + 4 + 3 + 1 + width),
            non_finite_rows: bad.len(),
            non_finite_first: bad.into_iter().take(ROWS_LISTED).collect(),
            needles: scales.iter().filter(|s| s[2] >= NEEDLE_ASPECT * s[1]).count(),
            invisible: opacities.iter().filter(|&&o| o < INVISIBLE_OPACITY).count(),
            view_dependent_share: view_dependent_share(raw),
            columns,
        }
    }

    /// The summary as a table for a terminal.
    pub fn to_text(&self) -> String {
        use std::fmt::Write as _;
        let mut out = format!(
            "{} splats, SH degree {}, {}; {} rows not finite, {} needles, {} below opacity 1/255\n",
            self.splats,
            self.sh_degree,
            bytes_text(self.bytes),
            self.non_finite_rows,
            self.needles,
            self.invisible
        );
        for (row, column) in &self.non_finite_first {
            let _ = writeln!(out, "  not finite: row {row}, column {column}");
        }
        let _ = writeln!(out, "{:18}{:>11}{:>11}{:>11}{:>11}{:>11}", "", "min", "1 %", "median", "99 %", "max");
        for c in &self.columns {
            let cells: String =
                [c.min, c.q01, c.median, c.q99, c.max].iter().map(|v| format!("{:>11}", number(*v))).collect();
            let _ = writeln!(out, "{:18}{cells}", c.name);
        }
        let _ = writeln!(out, "view-dependent share of colour variance  {:.1} %", 100.0 * self.view_dependent_share);
        out
    }
}

/// Summary of one tensor of a checkpoint.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct BlockSummary {
    /// Name of the tensor in the checkpoint.
    pub name: String,
    /// Number of values of the tensor.
    pub values: usize,
    /// Number of values that are not finite.
    pub non_finite: usize,
    /// Smallest finite value.
    pub min: f32,
    /// Median of the finite values.
    pub median: f32,
    /// Largest finite value.
    pub max: f32,
}

impl BlockSummary {
    /// Summarises one tensor of a checkpoint.
    pub fn of(name: &str, values: &[f32]) -> Self {
        let column = Column::of("", values.iter().copied());
        let non_finite = values.iter().filter(|v| !v.is_finite()).count();
        let (min, median, max) = (column.min, column.median, column.max);
        Self { name: name.to_owned(), values: values.len(), non_finite, min, median, max }
    }

    /// The header of a table of tensors.
    pub fn table_head() -> String {
        format!("{:32}{:>11}{:>12}{:>11}{:>11}{:>11}\n", "", "values", "not finite", "min", "median", "max")
    }

    /// The row of that table.
    pub fn to_text(&self) -> String {
        let [min, median, max] = [self.min, self.median, self.max].map(number);
        format!("{:32}{:>11}{:>12}{min:>11}{median:>11}{max:>11}\n", self.name, self.values, self.non_finite)
    }
}

/// A number of bytes with a decimal unit: bytes, kB, MB or GB.
pub fn bytes_text(bytes: usize) -> String {
    match bytes as f64 {
        b if b >= 1e9 => format!("{:.2} GB", b / 1e9),
        b if b >= 1e6 => format!("{:.2} MB", b / 1e6),
        b if b >= 1e3 => format!("{:.1} kB", b / 1e3),
        b => format!("{b} bytes"),
    }
}

/// A number with four significant digits.
fn number(v: f32) -> String {
    match v.abs() {
        0.0 => "0".to_owned(),
        a if (1e-3..1e5).contains(&a) => {
            let digits = (3 - a.log10().floor() as i32).clamp(0, 7) as usize;
            format!("{v:.digits$}")
        }
        _ => format!("{v:.3e}"),
    }
}

fn ordered(mut s: [f32; 3]) -> [f32; 3] {
    s.sort_unstable_by(f32::total_cmp);
    s
}

/// By orthonormality of spherical harmonics, the variance over directions is the sum of squares above degree 0.
fn view_dependent_share(raw: &RawSplats) -> f64 {
    let width = raw.sh_width();
    let mean: [f64; 3] = std::array::from_fn(|c| {
        let finite = raw.sh.chunks_exact(width).map(|r| f64::from(r[c])).filter(|v| v.is_finite());
        let (sum, n) = finite.fold((0.0, 0usize), |(s, n), v| (s + v, n + 1));
        sum / n.max(1) as f64
    });
    let (mut base, mut rest) = (0.0f64, 0.0f64);
    for row in raw.sh.chunks_exact(width).filter(|r| r.iter().all(|v| v.is_finite())) {
        base += (0..3).map(|c| (f64::from(row[c]) - mean[c]).powi(2)).sum::<f64>();
        rest += row[3..].iter().map(|v| f64::from(*v).powi(2)).sum::<f64>();
    }
    if rest > 0.0 { rest / (base + rest) } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;

    fn raw(n: usize) -> RawSplats {
        RawSplats {
            means: (0..n).map(|i| Vec3::splat(i as f32)).collect(),
            quats: vec![[2.0, 0.0, 0.0, 0.0]; n],
            log_scales: vec![Vec3::new(0.0, -1.0, -2.0); n],
            logit_opacities: vec![0.0; n],
            sh: vec![0.0; n * 12],
            degree: 1,
            ..RawSplats::default()
        }
    }

    #[test]
    fn quantiles_are_nearest_ranks_of_finite_values() {
        let c = Column::of("v", (0..100).map(|i| i as f32).chain([f32::NAN, f32::INFINITY]));
        assert_eq!((c.min, c.q01, c.median, c.q99, c.max), (0.0, 0.0, 49.0, 98.0, 99.0));
        let empty = Column::of("v", std::iter::empty());
        assert_eq!((empty.min, empty.max), (0.0, 0.0));
    }

    #[test]
    fn faults_are_counted_and_named() {
        let mut r = raw(10);
        r.log_scales[3].x = 9.0;
        r.means[7].y = f32::NAN;
        r.logit_opacities[0] = -9.0;
        let s = SplatSummary::of(&r);
        assert_eq!((s.splats, s.needles, s.invisible, s.non_finite_rows), (10, 1, 1, 1));
        assert_eq!(s.non_finite_first, [(7, "means")]);
        assert_eq!(s.bytes, 4 * 10 * 23);
        let text = s.to_text();
        assert!(text.contains("10 splats, SH degree 1, 920 bytes") && text.contains("row 7, column means"), "{text}");
        let quats = s.columns.iter().find(|c| c.name == "quaternion length").unwrap();
        assert_eq!((quats.min, quats.max), (2.0, 2.0));
    }

    #[test]
    fn view_dependence_is_a_share_of_variance() {
        let mut r = raw(2);
        assert_eq!(SplatSummary::of(&r).view_dependent_share, 0.0);
        // Base colours ±1 in red: variance sum 2. One coefficient of the rest with 3² = 9.
        r.sh[0] = 1.0;
        r.sh[12] = -1.0;
        r.sh[5] = 3.0;
        assert!((SplatSummary::of(&r).view_dependent_share - 9.0 / 11.0).abs() < 1e-12);
    }

    #[test]
    fn numbers_have_four_digits() {
        let cases = [
            (0.0, "0"),
            (1.0, "1.000"),
            (-12.345_6, "-12.35"),
            (0.001_234_56, "0.001235"),
            (1e6, "1.000e6"),
            (2e-9, "2.000e-9"),
        ];
        for (v, want) in cases {
            assert_eq!(number(v), want);
        }
    }
}
