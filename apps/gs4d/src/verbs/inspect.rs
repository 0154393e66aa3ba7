//! `gs4d inspect`: contents of a splat file, a checkpoint or a run.

use crate::answer::Answer;
use crate::failure::{Class, Failure};
use crate::global::Global;
use crate::opening::RunData;
use gs_core::io::{Limits, RawSplats, load_splats};
use gs_data::Split;
use gs_synth as synth;
use gs_train::checkpoint::Checkpoint;
use gs_train::timestamp::Timestamp;
use gs4d_eval::particles::Particles;
use gs4d_eval::physics_check::{self, PhysicsOptions, PhysicsReport};
use gs4d_report::analysis::paths::sample_count;
use gs4d_report::analysis::{Analysis, RenderCost};
use gs4d_report::inspect::{BlockSummary, SplatSummary, bytes_text};
use gs4d_report::needs::{needs, neutral_camera};
use gs4d_report::storage::Storage;
use gs4d_run::folder::{JOURNAL, METRICS};
use gs4d_run::{OpenRun, check_exists};
use serde_json::{Value, json};
use std::path::{Path, PathBuf};

/// Views rendered to measure their cost.
const ECONOMY_VIEWS: usize = 5;

/// Counts, ranges, needles and non-finite rows of a splat file or checkpoint; for a run, what its scene needed
#[derive(clap::Args)]
pub struct Inspect {
    /// A .ply, .splat, .spz, .glb, .sog or .gs4d file, or a run folder.
    #[arg(value_name = "FILE|RUN")]
    path: PathBuf,
    /// For a run: times at which its motion is sampled [default: its training times, 8 to 200].
    #[arg(long, value_parser = clap::value_parser!(u32).range(4..=2000))]
    moments: Option<u32>,
    /// For a run: lowest frequency that counts as fast motion, cycles over the training span [default: moments / 4].
    #[arg(long, value_parser = clap::value_parser!(u32).range(1..=1000))]
    cutoff: Option<u32>,
    #[command(flatten)]
    place: RunData,
}

impl Inspect {
    pub fn run(self, global: &Global) -> Result<Answer, Failure> {
        let path = &self.path;
        check_exists(path)?;
        if path.is_dir() {
            self.run_folder(path, global)
        } else if path.extension().is_some_and(|e| e == "gs4d") {
            checkpoint_file(path)
        } else {
            splat_file(path, global)
        }
    }
}

fn splat_file(path: &Path, global: &Global) -> Result<Answer, Failure> {
    let limits = Limits { allow_non_finite: true, ..global.limits() };
    let raw = load_splats(path, &limits)?;
    let bytes = file_bytes(path)?;
    let summary = SplatSummary::of(&raw);
    let rendered = if raw.antialiased { "anti-aliased" } else { "without anti-aliasing" };
    let text =
        format!("{}  {} on disk, to be rendered {rendered}\n{}", path.display(), bytes_text(bytes), summary.to_text());
    let json = json!({
        "file": path.display().to_string(),
        "file_bytes": bytes,
        "antialiased": raw.antialiased,
        "summary": summary,
    });
    Ok(Answer::new(text, json))
}

fn checkpoint_file(path: &Path) -> Result<Answer, Failure> {
    let checkpoint = Checkpoint::load(path)?;
    let bytes = file_bytes(path)?;
    let blocks: Vec<BlockSummary> = checkpoint.tensors.iter().map(|(n, v)| BlockSummary::of(n, v)).collect();
    let field = |name: &str| checkpoint.meta.get(name).map_or(String::new(), Value::to_string);
    let mut text = format!(
        "{}  {}, verified; method {}, step {}\n{}",
        path.display(),
        bytes_text(bytes),
        field("method"),
        field("step"),
        BlockSummary::table_head()
    );
    blocks.iter().for_each(|b| text.push_str(&b.to_text()));
    let json =
        json!({"file": path.display().to_string(), "file_bytes": bytes, "meta": checkpoint.meta, "tensors": blocks});
    Ok(Answer::new(text, json))
}

impl Inspect {
    fn run_folder(&self, root: &Path, global: &Global) -> Result<Answer, Failure> {
        let run = self.place.open(root, global)?;
        let method = &run.loaded.model;
        let seen = run.training_views().ok().and_then(|views| views.first().map(|view| view.camera.clone()));
        let camera = seen.unwrap_or_else(neutral_camera);
        let needs = needs(method, &camera, run.loaded.scene.extent)?;
        let raw = RawSplats::from_splats(&method.all_splats(&Timestamp::normalised(0.0), &camera)?);
        let raw = raw.map_err(|e| Failure::new(Class::Data, "data.splats", e.to_string()).place(run.path.display()))?;
        let summary = SplatSummary::of(&raw);
        let mut text = format!("{}  {} at step {}\n", run.path.display(), method.name(), run.loaded.step);
        for n in &needs {
            text.push_str(&format!("{:26}{:>22}  {}\n", n.name, n.value, n.meaning));
        }
        let moments = self.moments.map_or_else(|| sample_count(run.loaded.scene.timestamps as usize), |m| m as usize);
        let cutoff = self.cutoff.map(|c| c as usize);
        let highest = moments / 2;
        if cutoff.is_some_and(|c| c > highest) {
            return Err(Failure::usage(format!(
                "--cutoff is above {highest}, the highest frequency of {moments} moments"
            )));
        }
        let analysis = Analysis::of(method, moments, cutoff)?;
        let economy = economy(&run);
        let section = method.report_section(&run.folder()?.log_lines(JOURNAL)?)?;
        text.push('\n');
        let mut rows = analysis.rows();
        rows.extend(economy.iter().flat_map(RenderCost::rows));
        rows.extend(section.iter().flat_map(|s| s.rows.clone()));
        for n in rows {
            text.push_str(&format!("{:26}{:>46}  {}\n", n.name, n.value, n.meaning));
        }
        let storage = Storage::of(method, method.capabilities().inspect.and_then(|i| i.paper_storage()));
        text.push_str(&format!("\n{}", storage.to_text()));
        let physics = physics(&run);
        if let Some(physics) = &physics {
            text.push_str(&format!("\n{}", physics.to_text()));
        }
        text.push_str("\nat time 0: ");
        text.push_str(&summary.to_text());
        let json = json!({
            "run": root.display().to_string(),
            "checkpoint": run.path.display().to_string(),
            "method": method.name(),
            "step": run.loaded.step,
            "train_seconds": run.loaded.train_seconds,
            "needs": needs,
            "analysis": analysis,
            "economy": economy,
            "journal": section.map(|s| s.json),
            "storage": storage,
            "physics": physics,
            "summary": summary,
            "skipped": run.skipped.iter().map(|s| s.why.clone()).collect::<Vec<_>>(),
        });
        Ok(Answer::new(text, json))
    }
}

/// Cost of rendering the test views (training views if there are none); `None` if the data cannot be opened.
fn economy(run: &OpenRun) -> Option<RenderCost> {
    let dataset = run.open_data().ok()?;
    let split = if dataset.test.is_empty() { Split::Train } else { Split::Test };
    let images = run.images();
    let views: Vec<_> = dataset.views(split).iter().take(ECONOMY_VIEWS).map(|v| (images.camera(v), v.time)).collect();
    let method = &run.loaded.model;
    let options = method.raster_options(run.background());
    let scores = run.folder().ok().and_then(|folder| folder.read(METRICS).ok());
    let scores: Option<Value> = scores.and_then(|text| serde_json::from_str(&text).ok());
    let of_this_step = scores.filter(|s| s["step"] == run.loaded.step);
    RenderCost::of(method, &views, &options, of_this_step.and_then(|s| s["mean"]["psnr"].as_f64())).ok().flatten()
}

/// Learnt motion against ground truth, for methods with particles on a generated scene with unchanged times.
fn physics(run: &OpenRun) -> Option<PhysicsReport> {
    let particles = Particles::of(&run.loaded.model)?;
    let truth = synth::truth_of(Path::new(&run.resolved.run.data))?;
    let dataset = run.open_data().ok()?;
    let same_clock = dataset.train.iter().all(|v| (f64::from(v.time.normalised) - v.time.seconds).abs() < 1e-6);
    let options = PhysicsOptions::of(&particles, run.loaded.scene.last_time.into());
    same_clock.then(|| physics_check::check(&particles, &truth, &options))
}

fn file_bytes(path: &Path) -> Result<usize, Failure> {
    let meta = std::fs::metadata(path).map_err(|e| Failure::io("read", path, &e))?;
    Ok(usize::try_from(meta.len()).unwrap_or(usize::MAX))
}
