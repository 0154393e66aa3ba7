//! Measures steps of training on ranks of this machine, and models what more ranks on a network would give:
//! ```text
//! cargo build --release -p gs4d-mpi --features mpi
//! cargo run --release -p gs4d-mpi --features mpi --example scaling -- target/release/gs4d-mpi docs
//! ```
//! Prints the tables of `docs/scaling.md` and writes `scaling.svg` to the folder.

use gs_methods::registry;
use gs_synth::SynthOptions;
use gs_synth::avatar::{self, AvatarOptions};
use gs4d_report::{Curve, Scale, chart::chart};
use serde_json::Value;
use std::path::Path;
use std::process::Command;

/// Views of a step that is measured.
const BATCH: usize = 8;
const STEPS: usize = 48;
/// The last steps of these count.
const COUNTED: usize = 24;
/// Views of a step in the model.
const MODELLED_BATCH: f64 = 64.0;
/// Bytes a second of 1, 10 and 100 Gb Ethernet, at 90 % of their rate.
const NETWORKS: [(&str, f64); 3] = [("1 GbE", 0.11e9), ("10 GbE", 1.1e9), ("100 GbE", 11e9)];
/// Exchanges of a step (sums, statistics, values, three times facts), two calls each.
const CALLS: f64 = 12.0;
/// Seconds of a call between two machines; among `R` it takes `log2 R` of them.
const LATENCY: f64 = 30e-6;
/// Twice the ranks pay if a step takes less than this share of its time.
const PAYS: f64 = 0.8;

type Error = Box<dyn std::error::Error>;

/// Means over the steps that count.
#[derive(Clone, Copy)]
struct Measured {
    /// Seconds of a step.
    step: f64,
    /// Seconds of its views, of Adam and of the exchange on the first rank.
    views: f64,
    adam: f64,
    exchange: f64,
    /// Bytes that the first rank sends.
    sent: f64,
    splats: f64,
}

/// A method on this machine: one rank with one thread, one with two, two and four ranks with one.
struct Method {
    name: &'static str,
    alone: Measured,
    threads: Measured,
    two: Measured,
    four: Measured,
}

impl Method {
    /// Bytes that a rank of so many sends in a step: sums to the owners of rows, then the values of its own rows to all.
    fn bytes(&self, ranks: f64) -> f64 {
        self.two.sent * 2.0 * (ranks - 1.0) / ranks
    }

    /// Seconds of a step of `batch` views on so many ranks of a core each, with `wire` seconds a byte and `cpu` seconds to pack,
    /// unpack and add one.
    fn step(&self, batch: f64, ranks: f64, wire: f64, latency: f64, cpu: f64) -> f64 {
        let a = self.alone;
        let rest = a.step - a.views - a.adam;
        let views = a.views / BATCH as f64 * (batch / ranks).ceil();
        let calls = CALLS * latency * ranks.log2();
        views + a.adam / ranks + rest + self.bytes(ranks) * (cpu + wire) + calls
    }
}

fn main() -> Result<(), Error> {
    let mut words = std::env::args().skip(1);
    let (Some(program), Some(out)) = (words.next(), words.next()) else {
        return Err("usage: scaling GS4D-MPI FOLDER".into());
    };
    let folder = tempfile::tempdir()?;
    let (scene, film) = (folder.path().join("sheet"), folder.path().join("film"));
    gs_synth::write(&scene, "sheet", &SynthOptions::of_views(400, 40, 1), false)?;
    avatar::write(&film, &AvatarOptions { frames: 6, ..AvatarOptions::default() }, false, false)?;
    let mut methods = Vec::new();
    for entry in registry().iter() {
        let data = if entry.needs_avatar { &film } else { &scene };
        let measure = |ranks, threads| measure(&program, data, entry.name, ranks, threads);
        let (alone, threads, two, four) = (measure(1, 1)?, measure(1, 2)?, measure(2, 1)?, measure(4, 1)?);
        methods.push(Method { name: entry.name, alone, threads, two, four });
    }
    let cpu = cost_of_a_byte(&methods);
    println!("{:.2} ns a byte to pack, unpack, add and wait\n", cpu * 1e9);
    measured_table(&methods, cpu);
    modelled_table(&methods, cpu);
    let curves = NETWORKS.map(|(network, rate)| speedups(&methods, "fourdgs", network, rate, cpu));
    let (slow, rate) = NETWORKS[0];
    let more = [speedups(&methods, "defgs-nvfi", slow, rate, cpu)];
    let svg =
        chart("Times faster than one rank, 64 views a step", "ranks", Scale::Log, &[&curves[..], &more].concat())?;
    std::fs::write(Path::new(&out).join("scaling.svg"), svg.ok_or("no curve")?)?;
    Ok(())
}

/// Runs a short training, and reads its log.
fn measure(program: &str, data: &Path, method: &str, ranks: usize, threads: usize) -> Result<Measured, Error> {
    let run = tempfile::tempdir()?;
    let out = run.path().join("run");
    let status = Command::new("mpirun")
        .args(["-n", &ranks.to_string(), "--oversubscribe", "--bind-to", "none", program, "train"])
        .arg(data)
        .args([
            "-m",
            method,
            "--preset",
            "fast",
            "-q",
            "--steps",
            &STEPS.to_string(),
            "--threads",
            &threads.to_string(),
        ])
        .args(["--set", &format!("schedule.batch={BATCH}"), "--set", "run.log_every=1", "-o"])
        .arg(&out)
        .stdout(std::process::Stdio::null())
        .status()?;
    if !status.success() {
        return Err(format!("{method} on {ranks} ranks: {status}").into());
    }
    let log = std::fs::read_to_string(out.join("log.jsonl"))?;
    let steps = log.lines().map(serde_json::from_str).collect::<Result<Vec<Value>, _>>()?;
    let steps: Vec<Value> = steps.into_iter().filter(|line| line["ms_last"].is_object()).collect();
    let mean = |of: &dyn Fn(&Value) -> Option<f64>| {
        let counted = steps.iter().rev().take(COUNTED).filter_map(of);
        counted.sum::<f64>() / COUNTED.min(steps.len()) as f64
    };
    let seconds = |phase: &str| mean(&|line| Some(line["ms_last"][phase].as_f64()? * 1e-3));
    let views = ["data", "field", "raster_forward", "loss", "raster_backward"];
    Ok(Measured {
        step: seconds("total"),
        views: views.iter().map(|phase| seconds(phase)).sum(),
        adam: seconds("adam"),
        exchange: seconds("exchange"),
        sent: mean(&|line| line["sent_last"].as_f64()),
        splats: mean(&|line| line["splats"].as_f64()),
    })
}

/// Seconds of exchange for each byte sent on two ranks: the median of the methods.
fn cost_of_a_byte(methods: &[Method]) -> f64 {
    let mut costs: Vec<f64> = methods.iter().map(|m| m.two.exchange / m.two.sent).collect();
    costs.sort_by(f64::total_cmp);
    costs[costs.len() / 2]
}

fn measured_table(methods: &[Method], cpu: f64) {
    println!("| method | splats | 1 × 1 | 1 × 2 | 2 × 1 | model | 4 × 1 | model | MB, 2 ranks | MB, 4 | model |");
    println!("|---|---|---|---|---|---|---|---|---|---|---|");
    for m in methods {
        let rate = |seconds: f64| format!("{:.2}", 1.0 / seconds);
        let two = m.step(BATCH as f64, 2.0, 0.0, 0.0, cpu);
        // Four ranks share two cores.
        let four = 2.0 * m.step(BATCH as f64, 4.0, 0.0, 0.0, cpu);
        let mb = |bytes: f64| format!("{:.1}", bytes * 1e-6);
        let row = [
            m.name.to_owned(),
            format!("{:.0}", m.alone.splats),
            rate(m.alone.step),
            rate(m.threads.step),
            rate(m.two.step),
            rate(two),
            rate(m.four.step),
            rate(four),
            mb(m.two.sent),
            mb(m.four.sent),
            mb(m.bytes(4.0)),
        ];
        println!("| {} |", row.join(" | "));
    }
    println!();
}

/// How many ranks of one core pay in each network, and how many times faster they are than one.
fn modelled_table(methods: &[Method], cpu: f64) {
    println!("| method | s a step, 1 rank | {} |", NETWORKS.map(|n| n.0).join(" | "));
    println!("|---|---|---|---|---|");
    for m in methods {
        let cells = NETWORKS.map(|(_, rate)| {
            let step = |ranks: f64| m.step(MODELLED_BATCH, ranks, 1.0 / rate, LATENCY, cpu);
            let mut ranks = 1.0;
            while ranks < MODELLED_BATCH && step(2.0 * ranks) < PAYS * step(ranks) {
                ranks *= 2.0;
            }
            format!("{ranks:.0} ({:.1}×)", alone(m) / step(ranks))
        });
        println!("| {} | {:.2} | {} |", m.name, alone(m), cells.join(" | "));
    }
}

/// Seconds of a step of the model on one rank, which exchanges nothing.
fn alone(m: &Method) -> f64 {
    m.step(MODELLED_BATCH, 1.0, 0.0, 0.0, 0.0)
}

fn speedups(methods: &[Method], name: &str, network: &str, rate: f64, cpu: f64) -> Curve {
    let method = methods.iter().find(|m| m.name == name);
    let point = |m: &Method, ranks: f64| (ranks, alone(m) / m.step(MODELLED_BATCH, ranks, 1.0 / rate, LATENCY, cpu));
    let points = method.map(|m| (0..=6).map(|k| point(m, f64::from(1 << k))).collect()).unwrap_or_default();
    Curve { name: format!("{name}, {network}"), points }
}
