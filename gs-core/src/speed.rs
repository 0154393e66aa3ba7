//! Speed beside error: the row every bench writes, and the median it is made of.

use std::io::Write;
use std::path::Path;
use std::time::{Duration, Instant};

/// One measured case. Rows of all crates have this shape, so they can share one plot.
#[derive(Clone, Debug, PartialEq)]
pub struct SpeedError {
    /// The crate measured.
    pub krate: &'static str,
    /// What is done, on which input.
    pub case: String,
    /// Which way of doing it.
    pub variant: String,
    /// Size of the input: splats, points, pixels.
    pub n: usize,
    /// Threads used.
    pub threads: usize,
    /// Median wall time, milliseconds.
    pub ms: f64,
    /// Count behind the rate: blends, floating-point operations, values.
    pub work: f64,
    /// Distance from the `f64` reference or an analytic truth; `None` where there is none.
    pub error: Option<f64>,
    /// What the error measures.
    pub error_kind: &'static str,
}

impl SpeedError {
    /// The row as one line of JSON.
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
    /// If the folder or file cannot be written.
    pub fn record(&self, folder: &Path) -> std::io::Result<()> {
        println!("{self}");
        std::fs::create_dir_all(folder)?;
        let path = folder.join(format!("{}.jsonl", self.krate));
        let mut file = std::fs::OpenOptions::new().create(true).append(true).open(path)?;
        writeln!(file, "{}", self.to_json())
    }

    /// Prints the row and appends it to `target/speed-error` beside the crate whose folder `manifest` is
    /// (`env!("CARGO_MANIFEST_DIR")`). A bench goes on where that cannot be written, and says so.
    pub fn keep(&self, manifest: &str) {
        let folder = Path::new(manifest).join("../target/speed-error");
        if let Err(e) = self.record(&folder) {
            eprintln!("cannot append to {}: {e}", folder.display());
        }
    }
}

impl std::fmt::Display for SpeedError {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let rate = self.work / self.ms * 1e-6;
        write!(f, "{:<10} {:<26} {:<22}", self.krate, self.case, self.variant)?;
        write!(f, " n {:>8}  threads {}  {:>9.3} ms  {rate:>7.3} G/s", self.n, self.threads, self.ms)?;
        match self.error {
            Some(error) => write!(f, "  {error:.1e} {}", self.error_kind),
            None => write!(f, "  no truth to compare with"),
        }
    }
}

/// Median seconds of `runs` calls after one warm-up.
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

/// Times of a bench's rounds, kept beside the bencher's own so that a row can show their median.
#[derive(Clone, Debug, Default)]
pub struct Laps {
    /// Milliseconds per call, one per round.
    times: Vec<f64>,
}

impl Laps {
    /// Calls `work` `calls` times; gives what they took together.
    pub fn run(&mut self, calls: u64, mut work: impl FnMut()) -> Duration {
        let start = Instant::now();
        (0..calls).for_each(|_| work());
        let spent = start.elapsed();
        self.times.push(spent.as_secs_f64() * 1e3 / calls.max(1) as f64);
        spent
    }

    /// Median milliseconds per call; none if nothing ran, as where a command line's filter leaves a case out.
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
    fn laps_know_their_median() {
        let (mut laps, mut calls) = (Laps::default(), 0);
        assert_eq!(laps.median_ms(), None);
        let spent: Vec<Duration> = [3, 1, 2].map(|n| laps.run(n, || calls += 1)).into();
        let each = |k: usize, n: f64| spent[k].as_secs_f64() * 1e3 / n;
        let mut expected = [each(0, 3.0), each(1, 1.0), each(2, 2.0)];
        expected.sort_by(f64::total_cmp);
        assert_eq!((calls, laps.median_ms()), (6, Some(expected[1])));
    }

    #[test]
    fn rows_are_json_and_unknown_errors_are_null() {
        let mut row = SpeedError {
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
        row.error = None;
        row.ms = f64::NAN;
        assert!(row.to_json().contains("\"ms\":null") && row.to_json().contains("\"error\":null"));
    }
}
