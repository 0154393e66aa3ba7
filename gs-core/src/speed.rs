//! The row that every bench writes, time beside error, and the medians it is made of.
//!
//! ```
//! use gs_core::speed::{BenchRow, median_seconds};
//!
//! let row = BenchRow {
//!     krate: "gs-core",
//!     case: "sum".into(),
//!     variant: "f32".into(),
//!     n: 1000,
//!     threads: 1,
//!     ms: 1e3 * median_seconds(5, || drop(std::hint::black_box((0..1000).map(|v| v as f32).sum::<f32>()))),
//!     work: 1000.0,
//!     error: Some(0.0),
//!     error_kind: "abs against f64",
//! };
//! assert!(row.to_json().contains("\"case\":\"sum\"") && row.ms >= 0.0);
//! ```

use std::io::Write;
use std::path::Path;
use std::time::{Duration, Instant};

/// One measured case: a row of a table of time against error. All crates use this shape, so one plot can hold them all.
#[derive(Clone, Debug, PartialEq)]
pub struct BenchRow {
    /// Name of the measured crate; also names the file of [`BenchRow::record`].
    pub krate: &'static str,
    /// The operation and its input, such as `sh basis`.
    pub case: String,
    /// The implementation or setting, such as `f32 scalar`.
    pub variant: String,
    /// Size of the input: number of splats, points or pixels.
    pub n: usize,
    /// Number of worker threads that were used.
    pub threads: usize,
    /// Median wall time of a call, milliseconds.
    pub ms: f64,
    /// Operations of a call (blends, floating-point operations, values): the numerator of the printed rate.
    pub work: f64,
    /// Distance from the `f64` reference or from an analytic truth; `None` where there is no reference.
    pub error: Option<f64>,
    /// Kind of `error`, such as `max abs against f64`.
    pub error_kind: &'static str,
}

impl BenchRow {
    /// Operations per nanosecond: GFLOP/s where `work` counts floating-point operations.
    pub fn rate(&self) -> f64 {
        self.work / self.ms * 1e-6
    }

    /// The row as one line of JSON, without a line break; numbers that are not finite become `null`.
    pub fn to_json(&self) -> String {
        let number = |v: f64| if v.is_finite() { format!("{v:e}") } else { "null".to_owned() };
        let Self { krate, case, variant, n, threads, ms, work, error, error_kind } = self;
        format!(
            "{{\"crate\":{krate:?},\"case\":{case:?},\"variant\":{variant:?},\"n\":{n},\"threads\":{threads},\"ms\":{},\"work\":{},\"error\":{},\"error_kind\":{error_kind:?}}}",
            number(*ms),
            number(*work),
            error.map_or_else(|| "null".to_owned(), number),
        )
    }

    /// Prints the row and appends it to `<folder>/<crate>.jsonl`.
    ///
    /// # Errors
    /// If the folder or the file cannot be written.
    pub fn record(&self, folder: &Path) -> std::io::Result<()> {
        println!("{self}");
        std::fs::create_dir_all(folder)?;
        let path = folder.join(format!("{}.jsonl", self.krate));
        let mut file = std::fs::OpenOptions::new().create(true).append(true).open(path)?;
        writeln!(file, "{}", self.to_json())
    }

    /// Prints the row and appends it to `target/speed-error` beside the crate whose folder `manifest` is
    /// (`env!("CARGO_MANIFEST_DIR")`). A write error is printed and does not stop the bench.
    pub fn append(&self, manifest: &str) {
        let folder = Path::new(manifest).join("../target/speed-error");
        if let Err(e) = self.record(&folder) {
            eprintln!("cannot append to {}: {e}", folder.display());
        }
    }
}

impl std::fmt::Display for BenchRow {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{:<10} {:<26} {:<22}", self.krate, self.case, self.variant)?;
        write!(f, " n {:>8}  threads {}  {:>9.3} ms  {:>7.3} G/s", self.n, self.threads, self.ms, self.rate())?;
        match self.error {
            Some(error) => write!(f, "  {error:.1e} {}", self.error_kind),
            None => write!(f, "  no reference"),
        }
    }
}

/// Median seconds per call of `runs` calls (at least 1), after one call to warm up.
pub fn median_seconds(runs: usize, mut work: impl FnMut()) -> f64 {
    work();
    let mut times: Vec<f64> = (0..runs.max(1))
        .map(|_| {
            let start = Instant::now();
            work();
            start.elapsed().as_secs_f64()
        })
        .collect();
    times.sort_by(f64::total_cmp);
    times[times.len() / 2]
}

/// Stopwatch for the closure of criterion's `iter_custom`: keeps the time of each round, so that a row can show the median.
#[derive(Clone, Debug, Default)]
pub struct Stopwatch {
    /// Milliseconds per call, one entry per round.
    times: Vec<f64>,
}

impl Stopwatch {
    /// One round: calls `work` `calls` times and returns the total time.
    pub fn run(&mut self, calls: u64, mut work: impl FnMut()) -> Duration {
        let start = Instant::now();
        (0..calls).for_each(|_| work());
        let spent = start.elapsed();
        self.times.push(spent.as_secs_f64() * 1e3 / calls.max(1) as f64);
        spent
    }

    /// Median milliseconds per call over the rounds; `None` before the first round (a case that a filter left out).
    pub fn median_ms(&self) -> Option<f64> {
        let mut times = self.times.clone();
        times.sort_by(f64::total_cmp);
        times.get(times.len() / 2).copied()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_median_is_that_of_the_rounds() {
        let (mut laps, mut calls) = (Stopwatch::default(), 0);
        assert_eq!(laps.median_ms(), None);
        let spent: Vec<Duration> = [3, 1, 2].map(|n| laps.run(n, || calls += 1)).into();
        let each = |k: usize, n: f64| spent[k].as_secs_f64() * 1e3 / n;
        let mut expected = [each(0, 3.0), each(1, 1.0), each(2, 2.0)];
        expected.sort_by(f64::total_cmp);
        assert_eq!((calls, laps.median_ms()), (6, Some(expected[1])));
    }

    #[test]
    fn rows_are_json_and_unknown_errors_are_null() {
        let mut row = BenchRow {
            krate: "gs-core",
            case: "sum".into(),
            variant: "pair\"wise".into(),
            n: 3,
            threads: 1,
            ms: 0.5,
            work: 3.0,
            error: Some(1e-7),
            error_kind: "relative",
        };
        let want = "{\"crate\":\"gs-core\",\"case\":\"sum\",\"variant\":\"pair\\\"wise\",\"n\":3,\"threads\":1,\"ms\":5e-1,\"work\":3e0,\"error\":1e-7,\"error_kind\":\"relative\"}";
        assert_eq!(row.to_json(), want);
        assert!((row.rate() - 6e-6).abs() < 1e-15, "3 values in half a millisecond: {}", row.rate());
        row.error = None;
        row.ms = f64::NAN;
        assert!(row.to_json().contains("\"ms\":null") && row.to_json().contains("\"error\":null"));
    }
}
