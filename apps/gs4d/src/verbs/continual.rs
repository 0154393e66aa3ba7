//! `gs4d continual`: trains in rounds on a growing part of the sequence, and scores the extrapolation after each.

use super::train::time_text;
use crate::answer::{Answer, number};
use crate::failure::{Class, Failure};
use crate::global::Global;
use crate::interrupt;
use crate::progress::Progress;
use gs_train::evaluate::MeanScores;
use gs4d_lab::continual::{Event, FILE, Plan, RoundScores, Rounds, run};
use gs4d_run::settings::Request;
use gs4d_run::shell_quoted;
use serde_json::json;
use std::path::{Path, PathBuf};

/// Train in rounds, each on a longer part of the sequence, and score what comes next
///
/// Parameters and optimiser state are kept from round to round. Times are normalised over the whole sequence, 0 to 1.
#[derive(clap::Args)]
pub struct ContinualVerb {
    /// Folder of the data.
    #[arg(value_name = "DATA")]
    data: PathBuf,
    /// Name of the method.
    #[arg(short, long)]
    method: String,
    /// Preset of the first round.
    #[arg(long, default_value = "fast")]
    preset: String,
    /// Last training time of each round.
    #[arg(long, value_name = "T,T,…", value_delimiter = ',', default_value = "0.15,0.30,0.45,0.60,0.75")]
    rounds: Vec<f64>,
    /// How far beyond it views are scored.
    #[arg(long, value_name = "T", default_value_t = 0.15)]
    future: f64,
    /// In place of --rounds: frames of the first round (PanopticSports: 15).
    #[arg(long, value_name = "N", conflicts_with_all = ["rounds", "future"])]
    frames_first: Option<usize>,
    /// Frames that each later round adds.
    #[arg(long, value_name = "N", default_value_t = 1, requires = "frames_first")]
    frames_per_round: usize,
    /// Frames of the future that are scored.
    #[arg(long, value_name = "N", default_value_t = 10, requires = "frames_first")]
    score_next: usize,
    /// Most frames seen (PanopticSports: 135) [default: as long as a whole future is left].
    #[arg(long, value_name = "N", requires = "frames_first")]
    frames_last: Option<usize>,
    /// Steps of the first round: compresses or stretches its schedule.
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    steps_first: Option<u32>,
    /// Steps of every later round.
    #[arg(long, value_name = "N", default_value_t = 1000, value_parser = clap::value_parser!(u32).range(1..))]
    steps_later: u32,
    /// A setting (repeatable).
    #[arg(long = "set", value_name = "KEY=VALUE")]
    sets: Vec<String>,
    /// A setting of later rounds alone (repeatable). Without one, rates that decay are held at an eighth of their start.
    #[arg(long = "later-set", value_name = "KEY=VALUE")]
    later_sets: Vec<String>,
    /// Most views scored of each split in a round, evenly spaced; 0: all.
    #[arg(long, value_name = "N", default_value_t = 0)]
    score_views: usize,
    /// Seed of every random number.
    #[arg(long)]
    seed: Option<u64>,
    /// Folder of the run; made if missing.
    #[arg(short, long, value_name = "RUN")]
    out: PathBuf,
    /// Overwrite an older run in that folder. Without it, the same command goes on with a run that was interrupted.
    #[arg(short, long)]
    force: bool,
}

impl ContinualVerb {
    pub fn run(self, global: &Global) -> Result<Answer, Failure> {
        let rounds = match self.frames_first {
            None => Rounds::Times { until: self.rounds, future: self.future },
            Some(first) => Rounds::Frames {
                first,
                per_round: self.frames_per_round,
                next: self.score_next,
                last: self.frames_last,
            },
        };
        let request = Request {
            method: self.method,
            preset: self.preset,
            data: Some(self.data),
            steps: self.steps_first,
            seed: self.seed,
            sets: self.sets,
            ..Request::default()
        };
        let plan = Plan {
            registry: gs_methods::registry().clone(),
            request,
            rounds,
            later_steps: self.steps_later,
            later_sets: self.later_sets,
            score_views: self.score_views,
            command: again(std::env::args_os().skip(1).map(|a| a.to_string_lossy().into_owned())),
        };
        match follow(&plan, &self.out, self.force, global)? {
            Some(rounds) => Ok(Answer::new(table(&rounds, &self.out), json!({"rounds": rounds}))),
            None => {
                let kept = format!("interrupted; what was trained is saved in {}", self.out.display());
                Err(Failure::new(Class::Interrupted, "interrupted", kept).remedy(plan.command))
            }
        }
    }
}

/// The command with these arguments, without `-f`, which would begin anew.
fn again(arguments: impl Iterator<Item = String>) -> String {
    let kept = arguments.filter_map(|argument| match argument.strip_prefix('-') {
        Some("-force") => None,
        Some(short) if !short.starts_with('-') => {
            // Flags without a value may be joined, and stand before one with a value.
            let rest = short.trim_start_matches(['f', 'q', 'v']);
            let text = short[..short.len() - rest.len()].replace('f', "") + rest;
            (!text.is_empty()).then(|| format!("-{text}"))
        }
        _ => Some(argument),
    });
    std::iter::once("gs4d".to_owned()).chain(kept.map(shell_quoted)).collect::<Vec<_>>().join(" ")
}

/// Runs the rounds with a progress line for each.
fn follow(plan: &Plan, out: &Path, force: bool, global: &Global) -> Result<Option<Vec<RoundScores>>, Failure> {
    let stop = interrupt::flag()?;
    let mut progress: Option<Progress> = None;
    let rounds = run(plan, out, force, &stop, &mut |event| match event {
        Event::Round(k, n, round) => global.say(format!("round {k} of {n}: up to {:.4}", round.last)),
        Event::Step(p) => Progress::step(&mut progress, p, global.quiet),
        Event::Done(scores) => {
            progress.take().into_iter().for_each(Progress::finish);
            global.say(format!("{}\n{}", HEAD.join("  "), row(scores)));
        }
    });
    progress.into_iter().for_each(Progress::finish);
    Ok(rounds?)
}

const HEAD: [&str; 8] = ["   T_obs", "views", "  steps", "splats", "int. dB", "int. SSIM", "ext. dB", "ext. SSIM"];

fn pair(m: Option<&MeanScores>) -> [String; 2] {
    [number(m.and_then(|m| m.psnr), 2), number(m.and_then(|m| m.ssim), 4)]
}

fn row(r: &RoundScores) -> String {
    let ([ip, is], [ep, es]) = (pair(r.interpolation.as_ref()), pair(r.extrapolation.as_ref()));
    format!(
        "{:>8.4}  {:>5}  {:>7}  {:>6}  {ip:>7}  {is:>9}  {ep:>7}  {es:>9}",
        r.round.last, r.views, r.steps, r.splats
    )
}

fn table(rounds: &[RoundScores], out: &Path) -> String {
    let mut text = HEAD.join("  ") + "\n";
    rounds.iter().for_each(|r| text.push_str(&format!("{}\n", row(r))));
    let mean = |score: fn(&RoundScores) -> Option<f64>| {
        let all: Vec<f64> = rounds.iter().filter_map(score).collect();
        number((!all.is_empty()).then(|| all.iter().sum::<f64>() / all.len() as f64), 2)
    };
    let (inside, beyond) = (mean(|r| r.interpolation.as_ref()?.psnr), mean(|r| r.extrapolation.as_ref()?.psnr));
    let seconds = rounds.last().map_or(0.0, |r| r.seconds);
    text.push_str(&format!(
        "mean over rounds: {inside} dB inside, {beyond} dB beyond; {} of training\n",
        time_text(seconds)
    ));
    text.push_str(&format!("-> {}\n", out.join(FILE).display()));
    text
}

#[cfg(test)]
mod tests {
    use super::again;

    #[test]
    fn the_command_that_goes_on_has_no_force_and_reads_back() {
        let of = |words: &[&str]| again(words.iter().map(|w| (*w).to_owned()));
        assert_eq!(
            of(&["continual", "d", "-fo", "r", "--force", "-qf", "-mfags", "-f"]),
            "gs4d continual d -o r -q -mfags"
        );
        assert_eq!(of(&["continual", "my data", "--set", "a.b=it's"]), r"gs4d continual 'my data' --set 'a.b=it'\''s'");
    }
}
