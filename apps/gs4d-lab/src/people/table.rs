//! The result of an experiment as text, Markdown, CSV, JSON and SVG charts.

use crate::aligned;
use gs_core::io::{IoError, disk, write_file};
use gs4d_report::chart::chart;
use gs4d_report::{Curve, ReportError, Scale};
use serde_json::{Map, Value, json};
use std::path::Path;

/// Heading and format of a column.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Head {
    /// Heading, with the unit where there is one.
    pub name: &'static str,
    /// Digits after the decimal point in text and Markdown.
    pub digits: usize,
}

/// Value of one cell.
#[derive(Clone, Debug, PartialEq)]
pub enum Cell {
    /// Text.
    Text(String),
    /// A number; `None` if not measured or not finite.
    Number(Option<f64>),
}

impl From<&str> for Cell {
    fn from(text: &str) -> Self {
        Self::Text(text.to_owned())
    }
}

impl From<String> for Cell {
    fn from(text: String) -> Self {
        Self::Text(text)
    }
}

impl From<f64> for Cell {
    fn from(value: f64) -> Self {
        Self::from(Some(value))
    }
}

impl From<Option<f64>> for Cell {
    fn from(value: Option<f64>) -> Self {
        Self::Number(value.filter(|v| v.is_finite()))
    }
}

impl Cell {
    /// The number of a cell that has one.
    pub(crate) fn number(&self) -> Option<f64> {
        if let Self::Number(n) = self { *n } else { None }
    }

    fn format(&self, head: Head) -> String {
        match self {
            Self::Text(text) => text.clone(),
            Self::Number(n) => n.map_or("-".to_owned(), |n| format!("{n:.*}", head.digits)),
        }
    }
}

/// A line chart of some columns over another column.
#[derive(Clone, Debug, PartialEq)]
pub struct Chart {
    /// Suffix of the file name after the experiment's name; empty for none.
    pub part: &'static str,
    /// Title of the chart.
    pub title: String,
    /// Heading of the column on the horizontal axis.
    pub across: &'static str,
    /// Headings of the plotted columns; rows without a number are left out.
    pub drawn: Vec<&'static str>,
    /// Heading of a text column; each of its values becomes a line.
    pub split: Option<&'static str>,
}

/// The result of an experiment.
#[derive(Clone, Debug, PartialEq)]
pub struct Findings {
    /// Name of the experiment, and of the files.
    pub name: &'static str,
    /// What the numbers mean, in a sentence or two.
    pub remark: String,
    /// Headings of the columns.
    pub heads: Vec<Head>,
    /// Rows with one cell per column.
    pub rows: Vec<Vec<Cell>>,
    /// Charts of the table.
    pub charts: Vec<Chart>,
    /// Number of leading rows in the charts; `None`: all.
    pub charted: Option<usize>,
}

impl Findings {
    /// An empty table; `heads` holds `(heading, digits)` of each column.
    pub fn new(name: &'static str, remark: impl Into<String>, heads: &[(&'static str, usize)]) -> Self {
        let heads = heads.iter().map(|&(name, digits)| Head { name, digits }).collect();
        Self { name, remark: remark.into(), heads, rows: Vec::new(), charts: Vec::new(), charted: None }
    }

    /// The numbers of a column, one per row; all `None` for an unknown heading or a text column.
    fn column(&self, name: &str) -> Vec<Option<f64>> {
        let at = self.heads.iter().position(|h| h.name == name);
        self.rows.iter().map(|row| at.and_then(|k| row.get(k)).and_then(Cell::number)).collect()
    }

    /// Indices of the columns with a value in some row.
    fn used(&self) -> Vec<usize> {
        let filled = |k: &usize| self.rows.iter().any(|row| row.get(*k).is_some_and(|c| *c != Cell::Number(None)));
        (0..self.heads.len()).filter(filled).collect()
    }

    /// Aligned columns, without those that are empty, then the remark.
    pub fn text(&self) -> String {
        let used = self.used();
        let head: Vec<&str> = used.iter().map(|&k| self.heads[k].name).collect();
        let cells = |row: &Vec<Cell>| used.iter().map(|&k| row[k].format(self.heads[k])).collect();
        let is_text = |c: usize| self.rows.iter().any(|row| matches!(row[used[c]], Cell::Text(_)));
        aligned(&head, &self.rows.iter().map(cells).collect::<Vec<_>>(), is_text) + &self.remark + "\n"
    }

    /// A Markdown page with the remark and the table.
    pub fn markdown(&self) -> String {
        let used = self.used();
        let line = |cells: Vec<String>| format!("| {} |\n", cells.join(" | "));
        let mut text = format!("# {}\n\n{}\n\n", self.name, self.remark);
        text.push_str(&line(used.iter().map(|&k| self.heads[k].name.to_owned()).collect()));
        text.push_str(&format!("|{}\n", "---|".repeat(used.len())));
        for row in &self.rows {
            text.push_str(&line(used.iter().map(|&k| row[k].format(self.heads[k]).replace('|', "\\|")).collect()));
        }
        text
    }

    /// Comma-separated values with all columns and all digits.
    fn csv(&self) -> String {
        let quoted = |t: &str| format!("\"{}\"", t.replace('"', "\"\""));
        let line = |cells: Vec<String>| cells.join(",") + "\n";
        let mut text = line(self.heads.iter().map(|h| quoted(h.name)).collect());
        let cell = |c: &Cell| match c {
            Cell::Text(t) => quoted(t),
            Cell::Number(n) => n.map_or(String::new(), |n| n.to_string()),
        };
        self.rows.iter().for_each(|row| text.push_str(&line(row.iter().map(cell).collect())));
        text
    }

    /// One JSON object: `experiment`, `remark`, and `rows` as objects by heading.
    pub fn json(&self) -> Value {
        let cell = |c: &Cell| match c {
            Cell::Text(t) => json!(t),
            Cell::Number(n) => json!(n),
        };
        let row = |row: &Vec<Cell>| -> Map<String, Value> {
            self.heads.iter().zip(row).map(|(h, c)| (h.name.to_owned(), cell(c))).collect()
        };
        json!({"experiment": self.name, "remark": self.remark, "rows": self.rows.iter().map(row).collect::<Vec<_>>()})
    }

    /// A chart as SVG; `None` without a point.
    fn svg(&self, c: &Chart) -> Result<Option<String>, ReportError> {
        let label = |row: &Vec<Cell>, name: &str| {
            let at = self.heads.iter().position(|h| h.name == name);
            at.and_then(|k| row.get(k)).map_or(String::new(), |cell| cell.format(Head { name: "", digits: 0 }))
        };
        let rows = &self.rows[..self.charted.unwrap_or(self.rows.len()).min(self.rows.len())];
        let labels: Vec<String> =
            rows.iter().map(|row| c.split.map_or(String::new(), |name| label(row, name))).collect();
        let mut groups = labels.clone();
        groups.sort();
        groups.dedup();
        let across = self.column(c.across);
        let mut curves = Vec::new();
        for &column in &c.drawn {
            let values = self.column(column);
            for group in &groups {
                let of_group = (0..rows.len()).filter(|&i| labels[i] == *group);
                let mut points: Vec<(f64, f64)> = of_group.filter_map(|i| across[i].zip(values[i])).collect();
                points.sort_by(|a, b| a.0.total_cmp(&b.0));
                let name = [group.as_str(), if c.drawn.len() > 1 { column } else { "" }];
                let name = name.into_iter().filter(|n| !n.is_empty()).collect::<Vec<_>>().join(", ");
                curves.push(Curve { name, points });
            }
        }
        chart(&c.title, c.across, Scale::Linear, &curves)
    }

    /// Writes `NAME.json`, `NAME.csv`, `NAME.md` and one `.svg` per chart; creates the folder if it is missing.
    ///
    /// # Errors
    /// If a file exists and `overwrite` is not set, a file cannot be written, or a chart cannot be encoded.
    pub fn write(&self, folder: &Path, overwrite: bool) -> Result<(), WriteError> {
        let failed = |source| IoError::Os { file: folder.display().to_string().into(), action: "create", source };
        disk::create_folder(folder).map_err(failed)?;
        let mut files = vec![
            (format!("{}.json", self.name), format!("{:#}\n", self.json())),
            (format!("{}.csv", self.name), self.csv()),
            (format!("{}.md", self.name), self.markdown()),
        ];
        for c in &self.charts {
            let stem = if c.part.is_empty() { self.name.to_owned() } else { format!("{}-{}", self.name, c.part) };
            files.extend(self.svg(c)?.map(|svg| (format!("{stem}.svg"), svg)));
        }
        for (name, content) in files {
            write_file(&folder.join(name), overwrite, |out| out.write_all(content.as_bytes()))?;
        }
        Ok(())
    }

    /// Checks that a folder holds no file in the place of a result of the experiment `name`.
    ///
    /// # Errors
    /// [`IoError::Exists`] with the file's name.
    pub fn vacant(name: &str, folder: &Path) -> Result<(), IoError> {
        let Ok(files) = std::fs::read_dir(folder) else { return Ok(()) };
        let ours = |file: &str| {
            let chart = file.strip_prefix(name).is_some_and(|rest| rest.starts_with('-') && rest.ends_with(".svg"));
            chart || ["json", "csv", "md", "svg"].iter().any(|ending| file == format!("{name}.{ending}"))
        };
        let names = files.flatten().map(|file| file.file_name().to_string_lossy().into_owned());
        match names.filter(|file| ours(file)).min() {
            Some(file) => Err(IoError::Exists { file: folder.join(file).display().to_string().into() }),
            None => Ok(()),
        }
    }
}

/// Why a result was not written.
#[derive(Debug, thiserror::Error)]
pub enum WriteError {
    /// A file exists or cannot be written.
    #[error(transparent)]
    Io(#[from] IoError),
    /// A chart cannot be encoded.
    #[error(transparent)]
    Chart(#[from] ReportError),
}

#[cfg(test)]
mod tests {
    use super::*;

    fn findings() -> Findings {
        let mut f = Findings::new("probe", "Made up.", &[("rule", 0), ("angle", 1), ("PSNR", 2), ("ms", 1)]);
        f.rows = vec![
            vec!["a|b".into(), 0.0.into(), 31.256.into(), None.into()],
            vec!["c \"d\"".into(), 30.0.into(), f64::NAN.into(), None.into()],
        ];
        let chart = |part, drawn| Chart { part, title: "t".into(), across: "angle", drawn, split: Some("rule") };
        f.charts = vec![chart("", vec!["PSNR"]), chart("time", vec!["ms"])];
        f
    }

    #[test]
    fn a_table_reads_the_same_in_every_form() {
        let f = findings();
        assert_eq!(f.text(), "rule   angle   PSNR\na|b      0.0  31.26\nc \"d\"   30.0      -\nMade up.\n");
        assert_eq!(f.csv(), "\"rule\",\"angle\",\"PSNR\",\"ms\"\n\"a|b\",0,31.256,\n\"c \"\"d\"\"\",30,,\n");
        assert!(
            f.markdown()
                .ends_with("| rule | angle | PSNR |\n|---|---|---|\n| a\\|b | 0.0 | 31.26 |\n| c \"d\" | 30.0 | - |\n")
        );
        assert_eq!(f.json()["rows"][0], json!({"rule": "a|b", "angle": 0.0, "PSNR": 31.256, "ms": null}));
        assert_eq!(f.column("PSNR"), [Some(31.256), None]);
    }

    #[test]
    fn files_are_written_once() {
        let dir = tempfile::tempdir().unwrap();
        let (mut f, folder) = (findings(), dir.path().join("a/b"));
        f.rows.push(vec!["a|b".into(), 10.0.into(), 30.0.into(), None.into()]);
        Findings::vacant("probe", &folder).unwrap();
        f.write(&folder, false).unwrap();
        let names = ["probe.json", "probe.csv", "probe.md", "probe.svg"];
        assert!(names.iter().all(|n| folder.join(n).is_file()));
        assert!(!folder.join("probe-time.svg").exists(), "there is nothing to draw");
        assert!(matches!(Findings::vacant("probe", &folder), Err(IoError::Exists { .. })));
        assert!(matches!(f.write(&folder, false), Err(WriteError::Io(IoError::Exists { .. }))));
        f.write(&folder, true).unwrap();
        // Any file in the place of a result is found before the experiment is made.
        ["probe.json", "probe.md", "probe.svg"].iter().for_each(|n| std::fs::remove_file(folder.join(n)).unwrap());
        assert!(
            matches!(Findings::vacant("probe", &folder), Err(IoError::Exists { file }) if file.ends_with("probe.csv"))
        );
        Findings::vacant("pro", &folder).unwrap();
    }
}
