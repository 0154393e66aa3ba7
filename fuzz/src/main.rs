//! Fuzzes every reader of gs4d; README.md says how.
//!
//! | file | |
//! |---|---|
//! | targets | what is fuzzed: a function of an input, seeds, repair |
//! | case, mutate | an input, and its random changes |
//! | guard, memory | the rules for every input |
//! | coverage | edges taken |
//! | child, parent, state | processes: one runs inputs, one watches |
//! | findings | inputs that broke a rule |

mod case;
mod child;
mod coverage;
mod findings;
mod guard;
mod memory;
mod mutate;
mod parent;
mod state;
mod targets;

use child::Until;
use clap::Parser;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::Duration;
use targets::{Error, Target};

/// Fuzzes every reader of gs4d. Prints a table; ends with 1 if an input broke a rule.
#[derive(Parser)]
struct Arguments {
    /// Time for all targets together, seconds.
    #[arg(long, default_value_t = 60.0, value_parser = positive)]
    seconds: f64,
    /// Inputs of each target at most.
    #[arg(long, default_value_t = u64::MAX)]
    inputs: u64,
    /// Fuzz these targets alone.
    #[arg(long)]
    target: Vec<String>,
    /// Processes at once.
    #[arg(long, default_value_t = std::thread::available_parallelism().map_or(1, |n| n.get()))]
    jobs: usize,
    /// Seed of the mutations: the same inputs in the same order for each target.
    #[arg(long, default_value_t = 1)]
    seed: u64,
    /// Run the inputs of the folder regressions instead.
    #[arg(long)]
    regressions: bool,
    /// Run one input, a folder as in findings, instead: `--target` names its target.
    #[arg(long)]
    input: Option<PathBuf>,
    /// Be the child that fuzzes this target.
    #[arg(long, hide = true)]
    child: Option<String>,
    /// Folder of the child.
    #[arg(long, hide = true)]
    work: Option<PathBuf>,
}

fn positive(text: &str) -> Result<f64, String> {
    text.parse().ok().filter(|s: &f64| *s >= 0.0 && *s < 1e9).ok_or_else(|| "a number of seconds is needed".into())
}

/// The folder of a target: its data and the state of its child.
struct WorkFolder {
    path: PathBuf,
    /// Removes the folder.
    _owned: Option<tempfile::TempDir>,
}

impl WorkFolder {
    /// A new folder, in memory where the system has such a place.
    fn new() -> std::io::Result<Self> {
        let memory = Path::new("/dev/shm");
        let owned = if memory.is_dir() { tempfile::tempdir_in(memory) } else { tempfile::tempdir() }?;
        std::fs::create_dir(owned.path().join("data"))?;
        Ok(Self { path: owned.path().to_owned(), _owned: Some(owned) })
    }

    fn path(&self) -> &Path {
        &self.path
    }

    fn data(&self) -> PathBuf {
        self.path.join("data")
    }

    fn state(&self) -> PathBuf {
        self.path.join("state")
    }
}

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    match run(&arguments) {
        Ok(true) => ExitCode::SUCCESS,
        Ok(false) => ExitCode::FAILURE,
        Err(e) => {
            eprintln!("error: {e}");
            ExitCode::from(2)
        }
    }
}

fn run(arguments: &Arguments) -> Result<bool, Error> {
    let mut all = targets::all();
    if let (Some(name), Some(path)) = (&arguments.child, &arguments.work) {
        let until = Until { time: Duration::from_secs_f64(arguments.seconds), inputs: arguments.inputs };
        let work = WorkFolder { path: path.clone(), _owned: None };
        return child::run(find(&all, name)?, arguments.seed, until, &work).map(|()| true);
    }
    for name in &arguments.target {
        find(&all, name)?;
    }
    all.retain(|t| arguments.target.is_empty() || arguments.target.iter().any(|name| name == t.name));
    if let Some(input) = &arguments.input {
        let [target] = &all[..] else { return Err("--input needs one --target".into()) };
        guard::prepare()?;
        return replay(target, std::slice::from_ref(input));
    }
    if arguments.regressions {
        guard::prepare()?;
        let mut good = true;
        for target in &all {
            good &= replay(target, &findings::folders(&findings::regressions().join(target.name))?)?;
        }
        return Ok(good);
    }
    parent::run(&all, arguments)
}

fn find<'a>(targets: &'a [Target], name: &str) -> Result<&'a Target, Error> {
    let names = || targets.iter().map(|t| t.name).collect::<Vec<_>>().join(", ");
    targets.iter().find(|t| t.name == name).ok_or_else(|| format!("no target {name}; there are {}", names()).into())
}

/// Runs stored inputs; whether none broke a rule.
fn replay(target: &Target, inputs: &[PathBuf]) -> Result<bool, Error> {
    if inputs.is_empty() {
        return Ok(true);
    }
    let work = WorkFolder::new()?;
    (target.seeds)(&work.data())?;
    let mut good = true;
    for input in inputs {
        let outcome = guard::run(target, &case::Case::read(input)?, &work.data());
        let end = match (&outcome.fault, &outcome.accepted) {
            (Some(fault), _) => format!("{}: {}", fault.kind, fault.why),
            (None, Ok(())) => "accepted".into(),
            (None, Err(e)) => format!("refused: {e}"),
        };
        println!("{}: {end}", input.display());
        good &= outcome.fault.is_none();
    }
    Ok(good)
}
