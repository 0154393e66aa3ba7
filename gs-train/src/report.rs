//! What a method has to say of its own in the report of a run, as plain data
//! ([`Inspect::report_section`](crate::capabilities::Inspect::report_section)). Whoever writes the report draws it.

use serde::Serialize;
use serde_json::Value;

/// A section of a report. Empty parts are left out.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Section {
    /// Heading.
    pub title: String,
    /// A paragraph below the heading.
    pub remark: String,
    /// Line charts.
    pub charts: Vec<Chart>,
    /// Heat maps.
    pub matrices: Vec<Matrix>,
    /// Statistics; `gs4d inspect` prints them, too, and `gs4d eval` those that need no events.
    pub rows: Vec<ReportRow>,
    /// Long tables, shown collapsed.
    pub tables: Vec<Table>,
    /// The same facts for programs: `gs4d inspect --json`, and `metrics.json` of `gs4d eval`.
    pub json: Value,
}

/// A line chart.
#[derive(Clone, Debug, PartialEq)]
pub struct Chart {
    /// What the vertical axis shows, and its unit.
    pub title: String,
    /// What the horizontal axis shows, and its unit.
    pub x: String,
    /// Spacing of the vertical axis.
    pub scale: Scale,
    /// The lines.
    pub curves: Vec<Curve>,
}

/// A named line of a chart.
#[derive(Clone, Debug, PartialEq)]
pub struct Curve {
    /// Shown in the legend when there are several curves; empty: not in the legend.
    pub name: String,
    /// `(x, y)`, x ascending (a step has two points with the same x); points that are not finite are left out.
    pub points: Vec<(f64, f64)>,
}

/// Spacing of the vertical axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Scale {
    /// A linear axis.
    Linear,
    /// A logarithmic axis; points that are not positive are left out.
    Log,
}

/// Counts as a heat map: each column by itself, darker for larger counts.
#[derive(Clone, Debug, PartialEq)]
pub struct Matrix {
    /// What columns and rows are, from where to where.
    pub caption: String,
    /// Columns from left to right, the counts of each from the bottom up; all of the same length.
    pub columns: Vec<Vec<u32>>,
}

/// A row of a table of statistics.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ReportRow {
    /// For example `splats that move`.
    pub name: String,
    /// For example `1 204 of 5 000 (24 %)`.
    pub value: String,
    /// Explanation of the value in words.
    pub meaning: String,
}

impl ReportRow {
    /// A row of these texts.
    pub fn new(name: impl Into<String>, value: String, meaning: &str) -> Self {
        Self { name: name.into(), value, meaning: meaning.to_owned() }
    }
}

/// A table of texts and numbers.
#[derive(Clone, Debug, PartialEq)]
pub struct Table {
    /// What stands there while it is collapsed, for example `3 passes`.
    pub summary: String,
    /// Names of the columns.
    pub head: Vec<String>,
    /// Columns of numbers, from 0; they are aligned right.
    pub numeric: Vec<usize>,
    /// Rows with one cell per column.
    pub rows: Vec<Vec<String>>,
}
