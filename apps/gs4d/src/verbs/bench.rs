//! `gs4d bench`: speed against error of the crates, tables of cost, or the stages of a frame of a run, on this machine.

use crate::answer::Answer;
use crate::failure::{Class, Failure};
use crate::global::Global;
use crate::opening::RunData;
use gs4d_lab::bench::{
    GROUPS, Measured, Memory, PYTORCH, Roofs, StageOptions, StageTimes, approximations, frames, growth, memory,
    stage_times,
};
use gs4d_lab::people::{Findings, LabError, Trained};
use serde_json::{Value, json};
use std::path::{Path, PathBuf};

/// Measure speed and error of rendering, metrics, fields, networks and optimiser on this machine, or the stages of a frame of a dut run
#[derive(clap::Args)]
pub struct Bench {
    /// A run of the method dut: what each stage of a new frame takes, on one thread and on all.
    #[arg(value_name = "RUN", conflicts_with = "only")]
    run: Option<PathBuf>,
    /// Only this crate, for example gs-raster.
    #[arg(long = "crate", value_name = "C")]
    only: Option<String>,
    /// A table in place of the rows of the crates, as Markdown.
    #[arg(long, value_enum, value_name = "T", conflicts_with_all = ["run", "only"])]
    table: Option<Table>,
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

/// Tables that take longer than the rows of the crates.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum Table {
    /// What a frame and its gradients cost by splats, pixels and depth complexity, and what the frames of a moving scene cost by method.
    Growth,
    /// What each approximation saves, and the error it makes.
    Approximations,
}

impl Table {
    fn measure(self, global: &Global) -> Result<Answer, Failure> {
        global.say("measuring");
        let found = match self {
            Self::Growth => vec![growth(), frames(gs_methods::registry())?],
            Self::Approximations => vec![approximations(gs_methods::registry())?],
        };
        let text = found.iter().map(Findings::markdown).collect::<Vec<_>>().join("\n");
        Ok(Answer::new(text, json!(found.iter().map(Findings::json).collect::<Vec<_>>())))
    }
}

impl Bench {
    pub fn run(self, global: &Global) -> Result<Answer, Failure> {
        match (&self.run, self.table) {
            (Some(run), _) => self.stages(run, global),
            (None, Some(table)) => table.measure(global),
            (None, None) => self.crates(global),
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
        let mut rows: Vec<Measured> = Vec::new();
        for group in GROUPS.iter().filter(|g| self.only.as_deref().is_none_or(|name| name == g.name)) {
            global.say(format!("measuring {}", group.name));
            rows.extend((group.measure)());
        }
        let roofs = Roofs::measure();
        let mut text = speed_text(&rows, &roofs).trim_start().to_owned();
        let memory = if rows.iter().any(|m| m.row.krate == "gs-raster") { memory() } else { Vec::new() };
        for Memory { splats, side, bytes: [frame, both] } in &memory {
            text.push_str(&format!(
                "draw@{side}: each of {splats} splats takes {frame:.0} bytes in a frame, {both:.0} with gradients\n"
            ));
        }
        let Roofs { fma_gflops, gemm_gflops, exp2_giga_per_second, threads } = roofs;
        text.push_str(&format!(
            "roofs of this machine on {threads} threads: {fma_gflops:.1} GFLOP/s fused multiply-add, {gemm_gflops:.1} GFLOP/s products of \
             1024^3, {exp2_giga_per_second:.2} G exponentials/s\n"
        ));
        let json = json!({"rows": speed_json(&rows, &roofs), "memory": memory, "roofs": roofs, "pytorch": PYTORCH});
        Ok(Answer::new(text, json))
    }
}

/// Share of the rate of matrix products, where operations are counted.
fn of_gemm(m: &Measured, roofs: &Roofs) -> Option<f64> {
    m.gflops().map(|rate| rate / roofs.gemm_gflops)
}

/// Benchmark rows as a JSON array.
fn speed_json(rows: &[Measured], roofs: &Roofs) -> Value {
    let object = |m: &Measured| {
        // Each row writes valid JSON of its own.
        let mut row: Value = serde_json::from_str(&m.row.to_json()).unwrap_or_default();
        row["gflops"] = json!(m.gflops());
        row["of_gemm"] = json!(of_gemm(m, roofs));
        row["pytorch_ms"] = json!(m.pytorch);
        row
    };
    rows.iter().map(object).collect::<Vec<Value>>().into()
}

/// The rows of speed against error as a table.
fn speed_text(rows: &[Measured], roofs: &Roofs) -> String {
    if rows.is_empty() {
        return String::new();
    }
    let line = |what: &str, cells: [&str; 6], kind: &str| {
        let [size, ms, rate, share, pytorch, error] = cells;
        format!("{what:46}{size:>8}{ms:>10}{rate:>9}{share:>9}{pytorch:>12}{error:>9}  {kind}\n")
    };
    let head = ["size", "ms", "GFLOP/s", "of gemm", "PyTorch ms", "error"];
    let mut out = format!("\n{}", line("speed against error", head, "error is"));
    for m in rows {
        let cell = |value: Option<String>| value.unwrap_or_else(|| "-".to_owned());
        let rate = cell(m.gflops().map(|v| format!("{v:.1}")));
        let share = cell(of_gemm(m, roofs).map(|v| format!("{:.0} %", 100.0 * v)));
        let pytorch = cell(m.pytorch.map(|v| format!("{v}")));
        let error = cell(m.row.error.map(|e| format!("{e:.0e}")));
        let (size, ms) = (m.row.n.to_string(), format!("{:.3}", m.row.ms));
        let what = format!("{} · {}", m.row.case, m.row.variant);
        out.push_str(&line(&what, [&size, &ms, &rate, &share, &pytorch, &error], m.row.error_kind));
    }
    if rows.iter().any(|m| m.pytorch.is_some()) {
        out.push_str(&format!("{PYTORCH}\n"));
    }
    out + "\n"
}

#[cfg(test)]
mod tests {
    use super::*;
    use gs_core::speed::BenchRow;

    #[test]
    fn rows_are_aligned() {
        let row = BenchRow {
            krate: "c",
            case: "draw".into(),
            variant: "v".into(),
            n: 1,
            threads: 2,
            ms: 1.5,
            work: 3e8,
            error: Some(2e-7),
            error_kind: "max",
        };
        let roofs = Roofs { fma_gflops: 500.0, gemm_gflops: 400.0, exp2_giga_per_second: 1.0, threads: 2 };
        let alone = [Measured { row: row.clone(), flops: false, pytorch: None }];
        let text = speed_text(&alone, &roofs);
        assert!(text.contains("draw · v") && text.contains("1.500") && text.contains("2e-7  max"), "{text}");
        assert!(!text.contains(PYTORCH), "{text}");
        let json = speed_json(&alone, &roofs);
        assert!(
            json[0]["gflops"].is_null() && json[0]["of_gemm"].is_null() && json[0]["pytorch_ms"].is_null(),
            "{json}"
        );
        let held = [Measured { row, flops: true, pytorch: Some(17.0) }];
        let text = speed_text(&held, &roofs);
        assert!(text.contains("    200.0     50 %          17     2e-7  max") && text.contains(PYTORCH), "{text}");
        let json = speed_json(&held, &roofs);
        assert_eq!([&json[0]["gflops"], &json[0]["of_gemm"], &json[0]["pytorch_ms"]], [200.0, 0.5, 17.0]);
        assert!(speed_text(&[], &roofs).is_empty());
    }
}
