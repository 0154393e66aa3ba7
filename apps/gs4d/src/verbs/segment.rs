//! `gs4d segment`: the rigid parts of a run's scene, as masks, numbers and a table.

use super::eval::SplitName;
use crate::answer::Answer;
use crate::failure::{Class, Failure};
use crate::global::Global;
use crate::opening::{RunData, note_extrapolated};
use crate::output::{check_free, create_folder, stems};
use crate::parse;
use crate::progress::Progress;
use gs_core::io::images::{save_png, write_png8};
use gs_core::io::{npy, write_file};
use gs_data::{Dataset, Split, View};
use gs_synth as synth;
use gs_train::evaluate::split_name;
use gs4d_eval::Placing;
use gs4d_eval::particles::Particles;
use gs4d_eval::segment::{
    self, Complexity, Count, Feature, Labels, Options, Part, Scores, SegmentError, Source, TrueLabels, ViewMask, parts,
    scene_complexity, study,
};
use gs4d_run::OpenRun;
use serde_json::{Value, json};
use std::path::{Path, PathBuf};

/// What can be segmented.
const MOVING: &str = "give a run of a method that deforms or moves its splats, such as trace or defgs";

/// Output folders below `--out`.
const FOLDERS: [&str; 3] = ["masks", "labels", "overlays"];
/// Output files in `--out`.
const FILES: [&str; 2] = ["labels.npy", "segment.json"];

/// Find the rigid parts of a scene: masks of its views, scores against ground-truth masks, and how each part moves
#[derive(clap::Args)]
pub struct Segment {
    /// Folder of the run, or a .gs4d file.
    #[arg(value_name = "RUN|FILE")]
    run: PathBuf,
    /// How many parts: a number from 1 to 254, or auto for as many as do not share a rigid motion.
    #[arg(long, default_value = "auto", value_parser = count)]
    k: Count,
    /// Normalised time at which motions are compared [default: where the method's law of motion begins, else the last
    /// training time].
    #[arg(long, value_name = "T", allow_hyphen_values = true, value_parser = parse::finite)]
    at: Option<f32>,
    /// What parts are told by: learnt twists, or paths (OGC) [default: twists where the method has a law of motion, else paths].
    #[arg(long, value_enum)]
    by: Option<By>,
    /// What twists are compared by [default: polar].
    #[arg(long, value_enum)]
    feature: Option<Compare>,
    /// Weight of places beside twists, with a number of parts: parts that move alike but are apart.
    #[arg(long, default_value = "0", value_name = "BETA", allow_hyphen_values = true, value_parser = parse::not_negative)]
    positions: f64,
    /// Which views get masks.
    #[arg(long, value_enum, default_value_t = SplitName::Test)]
    split: SplitName,
    /// Folder of ground-truth label images by the names of views, .png or .npy; 0 is the background
    /// [default: those of the data, or the bodies of a generated scene].
    #[arg(long, value_name = "DIR")]
    truth: Option<PathBuf>,
    /// At most so many views, spread over all.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    limit: Option<u32>,
    /// Folder for labels.npy (a label per splat), segment.json, and masks, labels (8 bits: 0 background, label + 1) and
    /// overlays of each view; made if missing.
    #[arg(short, long, value_name = "DIR")]
    out: PathBuf,
    #[command(flatten)]
    place: RunData,
    /// Overwrite existing files.
    #[arg(short, long)]
    force: bool,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum By {
    Twists,
    Paths,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum Compare {
    /// Lengths and directions, as published.
    Polar,
    /// The twist itself.
    Plain,
}

fn count(text: &str) -> Result<Count, String> {
    match text.trim().parse::<usize>() {
        _ if text.trim() == "auto" => Ok(Count::Auto),
        Ok(k) if (1..=254).contains(&k) => Ok(Count::Fixed(k)),
        _ => Err("give a number from 1 to 254, or auto".to_owned()),
    }
}

impl From<SegmentError> for Failure {
    fn from(e: SegmentError) -> Self {
        let text = e.to_string();
        match e {
            SegmentError::NoPaths(_) => Self::new(Class::Data, "segment.paths", text).remedy(MOVING),
            SegmentError::NoTwists(_) => {
                Self::new(Class::Usage, "segment.twists", text).remedy("leave --by out, or say --by paths")
            }
            SegmentError::Labels { .. } => Self::new(Class::Data, "data.labels", text)
                .remedy("a label image is [H, W] whole numbers, 0 the background"),
            SegmentError::Method(e) => e.into(),
            SegmentError::Io(e) => e.into(),
            SegmentError::Data(e) => e.into(),
            SegmentError::Metric(_) => Self::new(Class::Data, "data.metric", text),
        }
    }
}

impl Segment {
    pub fn run(self, global: &Global) -> Result<Answer, Failure> {
        let run = self.place.open(&self.run, global)?;
        let dataset = run.open_data()?;
        if !run.resolved.learns_motion() && dataset.avatar.is_none() {
            let what = format!("{} has no motion: there are no parts to tell apart", run.loaded.model.name());
            return Err(Failure::new(Class::Data, "segment.paths", what).remedy(MOVING));
        }
        let (method, options) = (&run.loaded.model, self.options(&dataset));
        self.refuse_unused(options.source(Particles::of(method).as_ref()))?;
        note_extrapolated(self.at, &run, global);
        let split: Split = self.split.into();
        let views = self.limited(dataset.views(split))?;
        let names = stems(&views);
        self.prepare(&names)?;
        let labels = segment::segment(method, &options)?;
        let truth = self.truth(&run, &views);
        let mut progress = Progress::new(views.len() as u64, "views", global.quiet);
        let mut done = 0;
        let placed = run.placed();
        let place = |view: &View| placed.held_out(view);
        let rendering = (&run.images(), run.background(), &place as &Placing<'_>);
        let scores = study(method, &labels, (split_name(split), &views), truth.as_ref(), rendering, |seen| {
            self.save(&seen, &names[done])?;
            done += 1;
            progress.at(done as u64, || seen.view.name.clone());
            Ok::<(), Failure>(())
        })?;
        progress.finish();
        let (table, motion) = (parts::table(&labels), scene_complexity(method, &dataset)?);
        let values: Vec<f32> = labels.of.iter().map(|l| *l as f32).collect();
        self.write(FILES[0], |out| npy::write(&[values.len()], &values, out))?;
        let source = truth.as_ref().map(TrueLabels::source);
        let json = self.json(&run, &labels, (&table, &motion), (&scores, &source), views.len());
        self.write(FILES[1], |out| out.write_all(format!("{json:#}\n").as_bytes()))?;
        Ok(Answer::new(text(&labels, &table, &motion, (&scores, &source), &self.out), json))
    }

    fn options(&self, dataset: &Dataset) -> Options {
        let last = dataset.train.iter().map(|v| v.time.normalised).fold(0.0, f32::max);
        Options {
            count: self.k,
            by: self.by.map(|by| if by == By::Twists { Source::Twists } else { Source::Paths }),
            feature: if self.feature == Some(Compare::Plain) { Feature::Plain } else { Feature::Polar },
            at: self.at,
            observed: last,
            positions: self.positions as f32,
            ..Options::default()
        }
    }

    /// Refuses options that would do nothing.
    fn refuse_unused(&self, source: Source) -> Result<(), Failure> {
        let (paths, places) = (source == Source::Paths, self.positions > 0.0);
        let (option, why, remedy) = if paths && (places || self.feature.is_some()) {
            let option = if places { "--positions" } else { "--feature" };
            (option, "where parts are found by their paths", "leave it out")
        } else if places && self.k == Count::Auto {
            let why = "with --k auto: parts that move alike are one, wherever they are";
            ("--positions", why, "say how many parts there are, --k N, or leave it out")
        } else {
            return Ok(());
        };
        Err(Failure::usage(format!("{option} has no effect {why}")).remedy(remedy))
    }

    /// At most `--limit` views, spread over all ([`gs_data::spread()`]).
    fn limited(&self, views: &[View]) -> Result<Vec<View>, Failure> {
        if views.is_empty() {
            return Err(
                Failure::new(Class::Data, "data.split", "the split has no views").remedy("choose another --split")
            );
        }
        let most = self.limit.map_or(views.len(), |n| n as usize);
        Ok(gs_data::spread(views.len(), most).into_iter().map(|k| views[k].clone()).collect())
    }

    fn truth(&self, run: &OpenRun, views: &[View]) -> Option<TrueLabels> {
        if let Some(folder) = &self.truth {
            return Some(TrueLabels::Folder(folder.clone()));
        }
        if views.iter().any(|v| v.labels.is_some()) {
            return Some(TrueLabels::Views);
        }
        synth::truth_of(Path::new(&run.resolved.run.data)).map(|t| TrueLabels::Scene(Box::new(t)))
    }

    /// Creates the output folders; fails if an output exists, unless forced.
    fn prepare(&self, names: &[String]) -> Result<(), Failure> {
        let images = FOLDERS.iter().flat_map(|f| names.iter().map(move |n| format!("{f}/{n}.png")));
        let files = images.chain(FILES.map(str::to_owned)).map(|f| self.out.join(f));
        check_free(self.force, "file", "folder", files)?;
        FOLDERS.iter().try_for_each(|folder| create_folder(&self.out.join(folder)))
    }

    fn save(&self, seen: &ViewMask<'_>, name: &str) -> Result<(), Failure> {
        let [masks, labels, overlays] = FOLDERS.map(|f| self.out.join(f).join(format!("{name}.png")));
        save_png(&masks, &seen.colored(), self.force)?;
        save_png(&overlays, &seen.overlaid(), self.force)?;
        let ids: Vec<u8> = seen.mask.ids.iter().map(|id| *id as u8).collect();
        let (width, height) = (seen.mask.width, seen.mask.height);
        Ok(write_file(&labels, self.force, |out| write_png8(width, height, 1, &ids, out))?)
    }

    fn write(
        &self,
        name: &str,
        fill: impl FnOnce(&mut dyn std::io::Write) -> std::io::Result<()>,
    ) -> Result<(), Failure> {
        Ok(write_file(&self.out.join(name), self.force, fill)?)
    }

    fn json(
        &self,
        run: &OpenRun,
        labels: &Labels,
        (table, motion): (&[Part], &Complexity),
        (scores, source): (&Option<Scores>, &Option<String>),
        views: usize,
    ) -> Value {
        json!({
            "run": self.run.display().to_string(),
            "method": run.loaded.model.name(),
            "step": run.loaded.step,
            "labels_from": labels.source,
            "at": labels.particles.at,
            "asked": if let Count::Fixed(k) = self.k { json!(k) } else { json!("auto") },
            "parts": table,
            "radius": labels.radius,
            "resting": labels.resting.iter().filter(|r| **r).count(),
            "merged_at": labels.distances.0,
            "next_merger_at": labels.distances.1,
            "split": split_name(self.split.into()),
            "views": views,
            "truth": source,
            "protocol": segment::score::PROTOCOL,
            "scores": scores,
            "motion": motion_json(motion),
        })
    }
}

fn motion_json(m: &Complexity) -> Value {
    json!({
        "velocity": m.velocity,
        "acceleration": m.acceleration,
        "acceleration_per_time": m.acceleration_per_time,
        "tracks": m.tracks,
        "moving": m.moving,
    })
}

fn text(
    labels: &Labels,
    table: &[Part],
    motion: &Complexity,
    (scores, source): (&Option<Scores>, &Option<String>),
    out: &Path,
) -> String {
    let mut text = format!(
        "{:>5}{:>9}{:>8}{:>9}{:>10}{:>10}{:>10}{:>11}{:>11}\n",
        "part", "splats", "share", "resting", "speed", "spin", "pitch", "followers", "residual"
    );
    for p in table {
        let pitch = p.pitch.map_or("-".to_owned(), |v| format!("{v:.3}"));
        let (share, resting) = (100.0 * p.share, 100.0 * p.resting);
        text.push_str(&format!(
            "{:>5}{:>9}{share:>7.1}%{resting:>8.1}%{:>10.4}{:>10.4}{pitch:>10}{:>11}{:>11.4}\n",
            p.id, p.splats, p.speed, p.spin, p.followers, p.residual
        ));
    }
    let (v, a) = (motion.velocity, motion.acceleration);
    text.push_str(&format!("scene motion velocity {v:.4}, acceleration {a:.4} (parts of the image per span)\n"));
    if let (Some(s), Some(source)) = (scores, source) {
        text.push_str(&format!(
            "AP {:.2}  PQ {:.2}  F1 {:.2}  Pre {:.2}  Rec {:.2}  mIoU {:.2} (strict {:.2})  over {} views, against {source}\n",
            100.0 * s.ap,
            100.0 * s.pq,
            100.0 * s.f1,
            100.0 * s.precision,
            100.0 * s.recall,
            100.0 * s.miou,
            100.0 * s.miou_strict,
            s.views
        ));
    }
    let from = if labels.source == segment::Source::Twists { "twists" } else { "paths" };
    text.push_str(&format!(
        "{} parts from {from} at time {:.3}\n-> {}\n",
        labels.k,
        labels.particles.at,
        out.display()
    ));
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use clap::Parser;

    #[derive(Parser)]
    struct Line {
        #[command(flatten)]
        verb: Segment,
    }

    #[test]
    fn options_that_would_do_nothing_are_refused() {
        let refused = |more: &[&str], source| {
            let line = Line::try_parse_from([&["segment", "run", "-o", "out"][..], more].concat()).unwrap();
            line.verb.refuse_unused(source).err().map(|e| e.message()).unwrap_or_default()
        };
        let (places, feature) = (["--positions", "0.5"], ["--feature", "polar"]);
        let by_paths = "has no effect where parts are found by their paths";
        assert!(refused(&places, Source::Twists).starts_with("--positions has no effect with --k auto"));
        assert_eq!(refused(&places, Source::Paths), format!("--positions {by_paths}"));
        assert_eq!(refused(&feature, Source::Paths), format!("--feature {by_paths}"));
        assert_eq!(refused(&[&places[..], &["--k", "3"]].concat(), Source::Twists), "");
        assert_eq!(refused(&feature, Source::Twists), "");
        assert_eq!(refused(&[], Source::Paths), "");
    }
}
