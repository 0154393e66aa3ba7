//! `gs4d bench`: speed against error of the crates, or the stages of a frame of a run, on this machine.

use crate::answer::Answer;
use crate::failure::{Class, Failure};
use crate::global::Global;
use crate::opening::RunData;
use gs_core::speed::BenchRow;
use gs4d_lab::bench::{GROUPS, Memory, StageOptions, StageTimes, memory, roofline, stage_times};
use gs4d_lab::people::{LabError, Trained};
use serde_json::{Value, json};
use std::path::{Path, PathBuf};

/// Measure speed and error of rendering, metrics, fields and optimiser on this machine, or the stages of a frame of a dut run
#[derive(clap::Args)]
pub struct Bench {
    /// A run of the method dut: what each stage of a new frame takes, on one thread and on all.
    #[arg(value_name = "RUN", conflicts_with = "only")]
    run: Option<PathBuf>,
    /// Only this crate, for example gs-raster.
    #[arg(long = "crate", value_name = "C")]
    only: Option<String>,
    /// Timed frames, of a run.
    #[arg(long, value_name = "N", requires = "run", default_value_t = StageOptions::default().frames as u32, value_parser = clap::value_parser!(u32).range(1..=100_000))]
    frames: u32,
    /// Untimed frames before them.
    #[arg(long, value_name = "N", requires = "run", default_value_t = StageOptions::default().warm_up as u32)]
    warm_up: u32,
    /// Repeats of the measurement.
    #[arg(long, value_name = "N", requires = "run", default_value_t = StageOptions::default().repeats as u32, value_parser = clap::value_parser!(u32).range(1..=1000))]
    repeats: u32,
    /// Side of the rendered frame, pixels.
    #[arg(long, value_name = "PX", requires = "run", default_value_t = StageOptions::default().size, value_parser = clap::value_parser!(u32).range(1..=4096))]
    size: u32,
}

impl Bench {
    pub fn run(self, global: &Global) -> Result<Answer, Failure> {
        match &self.run {
            Some(run) => self.stages(run, global),
            None => self.crates(global),
        }
    }

    fn stages(&self, run: &Path, global: &Global) -> Result<Answer, Failure> {
        let run = RunData::default().open(run, global)?;
        let film = run.open_data()?;
        let dut = Trained::of_run(&run)?.on(&film, &[])?;
        let (warm_up, frames, repeats) = (self.warm_up as usize, self.frames as usize, self.repeats as usize);
        let options = StageOptions { warm_up, frames, repeats, size: self.size };
        let one = rayon::ThreadPoolBuilder::new().num_threads(1).build();
        let one = one.map_err(|e| Failure::new(Class::Resource, "limits.threads", e.to_string()))?;
        global.say("measuring on one thread");
        let mut all = vec![one.install(|| stage_times(&dut, &options)).map_err(LabError::from)?];
        if rayon::current_num_threads() > 1 {
            global.say(format!("measuring on {} threads", rayon::current_num_threads()));
            all.push(stage_times(&dut, &options).map_err(LabError::from)?);
        }
        let text = all.iter().map(StageTimes::text).collect::<Vec<_>>().join("\n");
        Ok(Answer::new(text, json!({"run": run.path, "size": self.size, "times": all})))
    }

    fn crates(&self, global: &Global) -> Result<Answer, Failure> {
        let known: Vec<&str> = GROUPS.iter().map(|g| g.name).collect();
        if let Some(name) = self.only.as_deref().filter(|n| !known.contains(n)) {
            return Err(Failure::usage(format!("there are no measurements of `{name}`"))
                .remedy(format!("choose one of {}", known.join(", "))));
        }
        let mut rows: Vec<BenchRow> = Vec::new();
        for group in GROUPS.iter().filter(|g| self.only.as_deref().is_none_or(|name| name == g.name)) {
            global.say(format!("measuring {}", group.name));
            rows.extend((group.measure)());
        }
        let (fma, exp) = roofline();
        let mut text = speed_text(&rows).trim_start().to_owned();
        let memory = if rows.iter().any(|r| r.krate == "gs-raster") { memory() } else { Vec::new() };
        for Memory { splats, side, bytes: [frame, both] } in &memory {
            text.push_str(&format!(
                "draw@{side}: each of {splats} splats takes {frame:.0} bytes in a frame, {both:.0} with gradients\n"
            ));
        }
        text.push_str(&format!(
            "roofs of this machine on {} threads: {fma:.1} GFLOP/s fused multiply-add, {exp:.2} G exponentials/s\n",
            rayon::current_num_threads()
        ));
        let roofs = json!({"fma_gflops": fma, "exp2_giga_per_second": exp, "threads": rayon::current_num_threads()});
        Ok(Answer::new(text, json!({"rows": speed_json(&rows), "memory": memory, "roofs": roofs})))
    }
}

/// Benchmark rows as a JSON array.
fn speed_json(rows: &[BenchRow]) -> Value {
    // Each row writes valid JSON of its own.
    rows.iter().map(|r| serde_json::from_str(&r.to_json()).unwrap_or_default()).collect::<Vec<Value>>().into()
}

/// The rows of speed against error as a table.
fn speed_text(rows: &[BenchRow]) -> String {
    let mut out = String::new();
    for (i, r) in rows.iter().enumerate() {
        if i == 0 {
            out.push_str(&format!(
                "\n{:46}{:>8}{:>10}{:>9}  {}\n",
                "speed against error", "size", "ms", "error", "error is"
            ));
        }
        let what = format!("{} · {}", r.case, r.variant);
        let error = r.error.map_or("-".to_owned(), |e| format!("{e:.0e}"));
        out.push_str(&format!("{what:46}{:>8}{:>10.3}{error:>9}  {}\n", r.n, r.ms, r.error_kind));
    }
    if !rows.is_empty() {
        out.push('\n');
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_are_aligned() {
        let row = BenchRow {
            krate: "c",
            case: "draw".into(),
            variant: "v".into(),
            n: 1,
            threads: 2,
            ms: 1.5,
            work: 1.0,
            error: Some(2e-7),
            error_kind: "max",
        };
        let text = speed_text(&[row]);
        assert!(text.contains("draw · v") && text.contains("1.500") && text.contains("2e-7  max"), "{text}");
        assert!(speed_text(&[]).is_empty());
    }
}
