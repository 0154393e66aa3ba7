//! The rows the benches of fields write.

use gs_core::speed::{BenchRow, median_seconds};

/// What the rows of one bench share.
pub struct Rows {
    /// Points or splats.
    pub n: usize,
    /// Calls a median is taken of.
    pub runs: usize,
}

impl Rows {
    /// Measures, prints and records; returns milliseconds.
    pub fn measured(
        &self,
        case: &str,
        variant: &str,
        work: f64,
        error: Option<(f64, &'static str)>,
        f: impl FnMut(),
    ) -> f64 {
        let ms = 1e3 * median_seconds(self.runs, f);
        self.keep(case, variant, work, error, ms);
        ms
    }

    /// Prints and records what was measured elsewhere.
    pub fn keep(&self, case: &str, variant: &str, work: f64, error: Option<(f64, &'static str)>, ms: f64) {
        let line = BenchRow {
            krate: "gs-deform",
            case: case.to_owned(),
            variant: variant.to_owned(),
            n: self.n,
            threads: rayon::current_num_threads(),
            ms,
            work,
            error: error.map(|e| e.0),
            error_kind: error.map_or("measured elsewhere", |e| e.1),
        };
        line.append(env!("CARGO_MANIFEST_DIR"));
    }
}
