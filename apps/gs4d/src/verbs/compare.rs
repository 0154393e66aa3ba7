//! `gs4d compare`: two or more runs on the same data, as a table and as a page.

use super::contest::ContestVerb;
use super::eval::SplitName;
use super::sweep::SweepVerb;
use crate::answer::Answer;
use crate::failure::{Class, Failure};
use crate::global::Global;
use crate::opening::{RunData, say_skipped};
use crate::output::prepare_file;
use crate::parse;
use gs_core::io::write_file;
use gs4d_lab::aligned;
use gs4d_run::RunError;
use gs4d_run::compare::page::page;
use gs4d_run::compare::{CompareError, Compared, Options, Row, Side, columns, compare};
use serde_json::json;
use std::path::PathBuf;

/// Compare runs, methods or settings on the same data: scores, paired differences, and the views they disagree about
#[derive(clap::Args)]
#[command(args_conflicts_with_subcommands = true, subcommand_negates_reqs = true)]
pub struct Compare {
    #[command(subcommand)]
    trials: Option<Trials>,

    /// Run folders, or .gs4d files; differences are against the first.
    #[arg(value_name = "RUN", required = true, num_args = 2..)]
    runs: Vec<PathBuf>,
    /// The page to write: one file that opens offline.
    #[arg(short, long, value_name = "HTML")]
    out: Option<PathBuf>,
    /// What error maps compare the renders with.
    #[arg(long, value_enum, default_value_t = Against::Gt, requires = "out")]
    against: Against,
    /// Which views.
    #[arg(long, value_enum, default_value_t = SplitName::Test)]
    split: SplitName,
    /// Colour behind renders and images: black, white, one grey or r,g,b in 0..1 [default: the runs', which must
    /// agree].
    #[arg(long, allow_hyphen_values = true, value_parser = parse::color)]
    background: Option<[f32; 3]>,
    /// Views shown with images: those whose renders differ most.
    #[arg(long, value_name = "N", default_value_t = 4, value_parser = clap::value_parser!(u8).range(1..=20))]
    views: u8,
    /// Overwrite an existing file.
    #[arg(short, long)]
    force: bool,
    #[command(flatten)]
    place: RunData,
}

/// What is trained to be compared.
#[derive(clap::Subcommand)]
enum Trials {
    Methods(ContestVerb),
    Settings(SweepVerb),
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum Against {
    /// The ground-truth images.
    Gt,
    /// The renders of the first run.
    First,
}

impl Compare {
    pub fn run(self, global: &Global) -> Result<Answer, Failure> {
        match self.trials {
            Some(Trials::Methods(verb)) => verb.run(global),
            Some(Trials::Settings(verb)) => verb.run(global),
            None => self.runs(global),
        }
    }

    fn runs(self, global: &Global) -> Result<Answer, Failure> {
        self.out.as_deref().map_or(Ok(()), |out| prepare_file(self.force, out))?;
        let mut sides = Vec::new();
        for path in &self.runs {
            let side = Side::open(gs_methods::registry(), path, self.place.data.as_deref())?;
            say_skipped(path, &side.run.skipped, global);
            if !side.may_be_of_its_data() {
                let path = path.display();
                global.say(format!("warning: {path} was trained on other data than it is scored on"));
            }
            sides.push(side);
        }
        let options = Options { split: self.split.into(), background: self.background, shown: self.views.into() };
        global.say(format!("rendering and scoring {} runs", sides.len()));
        let (compared, images) = compare(&sides, &options)?;
        let mut text = table(&compared);
        let mut json = json!(compared);
        if let Some(out) = &self.out {
            let html = page(&compared, &images, &sides, self.against == Against::First).map_err(RunError::from)?;
            write_file(out, self.force, |file| file.write_all(html.as_bytes()))?;
            text.push_str(&format!("-> {}\n", out.display()));
            json["page"] = json!(out.display().to_string());
        }
        Ok(Answer::new(text, json))
    }
}

impl From<CompareError> for Failure {
    fn from(e: CompareError) -> Self {
        let text = e.to_string();
        match e {
            CompareError::Method(e) => e.into(),
            CompareError::Differ { other, background_only, .. } => Self::new(Class::Data, "data.differ", text)
                .place(other.display())
                .why("scores on different images, sizes or backgrounds cannot be compared")
                .remedy(if background_only {
                    "score all over one background with --background"
                } else {
                    "compare runs of one data set with the same data settings"
                }),
            CompareError::Eval(e) => Self::from(*e),
        }
    }
}

/// One line per run, then the paired differences.
fn table(c: &Compared) -> String {
    let columns = columns(&c.runs);
    let head: Vec<&str> = std::iter::once("run").chain(columns.iter().map(|(name, _)| *name)).collect();
    let row = |(k, r): (usize, &Row)| {
        let label = format!("{} ({})", r.name, r.method);
        std::iter::once(label).chain(columns.iter().map(|(_, values)| values[k].clone())).collect()
    };
    let mut text = aligned(&head, &c.runs.iter().enumerate().map(row).collect::<Vec<_>>(), |column| column == 0);
    for d in &c.differences {
        let (Some(over), Some([low, high])) = (d.over_views, d.range) else { continue };
        text.push_str(&format!(
            "{} against {}: {:+.2} dB, ± {:.2} over views ({low:+.2} to {high:+.2}), better in {} of {}\n",
            d.name, c.runs[0].name, over.mean, over.deviation, d.better, d.of
        ));
    }
    text.push_str(&format!("{}\n{} Data {}.\n", c.seeds, c.conditions, c.data_digest));
    text
}
