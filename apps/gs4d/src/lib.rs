//! The command line of gs4d: parses arguments, calls the libraries and prints their results. No mathematics here. A library, so that a
//! program with other [`Ranks`] has the same command line.
//!
//! Results go to stdout (text, or one JSON value with `--json`), progress and messages to stderr. Exit codes: 0 done ·
//! 1 internal fault · 2 wrong usage · 3 invalid data · 4 numerical failure · 5 resource limit · 6 input or output ·
//! 7 verification failed · 130 interrupted, state saved.

#![warn(clippy::print_stderr, clippy::print_stdout, reason = "both panic where nobody reads them any more")]

mod answer;
mod device;
mod encoder;
mod failure;
mod global;
mod help;
mod interrupt;
mod opening;
mod output;
mod parse;
mod progress;
mod verbs;

use global::{Global, to_stderr};

use answer::Answer;
use clap::{CommandFactory, FromArgMatches, Parser, Subcommand};
use failure::{Class, Failure};
use gs_train::ranks::{Ranks, Share};
use std::process::ExitCode;
use std::sync::Arc;

/// Train moving Gaussian splat scenes from images; render them from any camera at any time.
#[derive(Parser)]
#[command(name = "gs4d", version = help::version(), max_term_width = 110)]
struct Cli {
    #[command(subcommand)]
    verb: Verb,
    #[command(flatten)]
    global: Global,
}

#[derive(Subcommand)]
enum Verb {
    Demo(verbs::demo::Demo),
    Import(Box<verbs::import::ImportVerb>),
    Doctor(verbs::doctor::Doctor),
    Init(verbs::init::Init),
    Train(verbs::train::Train),
    Resume(verbs::resume::Resume),
    Eval(verbs::eval::Eval),
    Render(verbs::render::Render),
    View(verbs::view::View),
    Export(verbs::export::Export),
    // The others are listed in groups: `help::GROUPS`.
    #[command(hide = true)]
    Compare(verbs::compare::Compare),
    #[command(hide = true)]
    Continual(verbs::continual::ContinualVerb),
    #[command(hide = true)]
    Reproduce(Box<verbs::reproduce::ReproduceVerb>),
    #[command(hide = true)]
    ImportCheckpoint(verbs::import_checkpoint::ImportCheckpointVerb),
    #[command(hide = true)]
    Methods(verbs::methods::Methods),
    #[command(hide = true)]
    Config(verbs::config::ShowConfig),
    #[command(hide = true)]
    Inspect(verbs::inspect::Inspect),
    #[command(hide = true)]
    Forecast(verbs::forecast::ForecastVerb),
    #[command(hide = true)]
    Segment(verbs::segment::Segment),
    #[command(hide = true)]
    Live(verbs::live::Live),
    #[command(hide = true)]
    Glmd(verbs::glmd::Glmd),
    #[command(hide = true)]
    Synth(verbs::synth::Synth),
    #[command(hide = true)]
    Pose(verbs::pose::PoseVerb),
    #[command(hide = true)]
    Covisible(verbs::covisible::Covisible),
    #[command(hide = true)]
    Lab(verbs::lab::Lab),
    #[command(hide = true)]
    Bench(verbs::bench::Bench),
    #[command(hide = true)]
    Completions(verbs::shell::Completions),
    #[command(hide = true)]
    Man(verbs::shell::Man),
    // Older names.
    #[command(hide = true)]
    Contest(verbs::contest::ContestVerb),
    #[command(hide = true)]
    Sweep(verbs::sweep::SweepVerb),
    #[command(hide = true)]
    Compact(verbs::compact::Compact),
}

impl Verb {
    /// Whether the ranks share what it makes.
    fn is_shared(&self) -> bool {
        match self {
            Verb::Eval(verb) => verb.is_of_run(),
            Verb::Export(verb) => !verb.is_of_file(),
            Verb::Render(_) => true,
            _ => false,
        }
    }
}

fn set_threads(threads: Option<u16>) -> Result<(), Failure> {
    let Some(threads) = threads else { return Ok(()) };
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads.into());
    pool.build_global().map_err(|e| Failure::new(Class::Resource, "limits.threads", e.to_string()))
}

fn run(cli: Cli) -> Result<Answer, Failure> {
    let global = &cli.global;
    match cli.verb {
        Verb::Demo(verb) => verb.run(global),
        Verb::Import(verb) => verb.run(global),
        Verb::ImportCheckpoint(verb) => verb.run(global),
        Verb::Doctor(verb) => verb.run(global),
        Verb::Init(verb) => verb.run(global),
        Verb::Synth(verb) => verb.run(global),
        Verb::Train(verb) => verb.run(global),
        Verb::Resume(verb) => verb.run(global),
        Verb::Eval(verb) => verb.run(global),
        Verb::Compare(verb) => verb.run(global),
        Verb::Render(verb) => verb.run(global),
        Verb::View(verb) => verb.run(global),
        Verb::Forecast(verb) => verb.run(global),
        Verb::Live(verb) => verb.run(global),
        Verb::Glmd(verb) => verb.run(global),
        Verb::Segment(verb) => verb.run(global),
        Verb::Inspect(verb) => verb.run(global),
        Verb::Completions(verb) => Ok(verb.run()),
        Verb::Man(verb) => verb.run(),
        Verb::Compact(verb) => renamed("compact", "export -o NAME.gs4d", global, |global| verb.run(global)),
        Verb::Export(verb) => verb.run(global),
        Verb::Methods(verb) => Ok(verb.run()),
        Verb::Config(verb) => verb.run(),
        Verb::Contest(verb) => renamed("contest", "compare methods", global, |global| verb.run(global)),
        Verb::Continual(verb) => verb.run(global),
        Verb::Reproduce(verb) => verb.run(global),
        Verb::Sweep(verb) => renamed("sweep", "compare settings", global, |global| verb.run(global)),
        Verb::Pose(verb) => verb.run(global),
        Verb::Covisible(verb) => verb.run(global),
        Verb::Lab(verb) => verb.run(global),
        Verb::Bench(verb) => verb.run(global),
    }
}

/// Runs a verb by its older name, and says so.
fn renamed(
    old: &str,
    new: &str,
    global: &Global,
    run: impl FnOnce(&Global) -> Result<Answer, Failure>,
) -> Result<Answer, Failure> {
    global.say(format!("gs4d {old} is gs4d {new} now; the older name goes with the next version"));
    run(global)
}

/// The whole command line, with its help.
fn command() -> clap::Command {
    let command = Cli::command();
    let help = help::after(&command);
    with_negative_numbers(command.after_help(help))
}

/// Lets the parser of every flag see a negative number; else it is taken for a flag.
fn with_negative_numbers(command: clap::Command) -> clap::Command {
    let takes_one = |arg: &clap::Arg| !arg.is_positional() && arg.get_action().takes_values();
    command
        .mut_args(|arg| if takes_one(&arg) { arg.allow_negative_numbers(true) } else { arg })
        .mut_subcommands(with_negative_numbers)
}

fn parsed() -> Result<Cli, clap::Error> {
    Cli::from_arg_matches(&command().try_get_matches()?)
}

/// Runs the command line of this process, with the other `ranks`; gives its exit code. `train` and `resume` are done by all ranks
/// together, what `render`, `eval` and `export` make is shared among them, everything else is done by the first.
pub fn main(ranks: Arc<dyn Ranks>) -> ExitCode {
    let default_hook = std::panic::take_hook();
    std::panic::set_hook(Box::new(move |info| {
        default_hook(info);
        // A panic in the viewer ends neither training nor the viewer.
        if std::thread::current().name() == Some(gs4d_view::THREAD_NAME) {
            return;
        }
        to_stderr("error[internal]: this is a fault of gs4d; please report it with the lines above");
        std::process::exit(Class::Internal as i32);
    }));
    let code = if ranks.rank() == 0 { lead(&ranks) } else { follow(&ranks) };
    ExitCode::from(code)
}

/// What the first rank does.
fn lead(ranks: &Arc<dyn Ranks>) -> u8 {
    let code = match parsed() {
        Err(e) => {
            // A closed pipe (`| head`) is no failure.
            let _ = e.print();
            u8::try_from(e.exit_code()).unwrap_or(Class::Usage as u8)
        }
        Ok(mut cli) => {
            cli.global.ranks = ranks.clone();
            let json = cli.global.json;
            let done = set_threads(cli.global.threads).and_then(|()| {
                if !cli.verb.is_shared() {
                    return run(cli);
                }
                gs4d_run::ranks::share(&**ranks)?;
                run_shared(cli, ranks)
            });
            match done.and_then(|answer| answer.print(json)) {
                Ok(()) => 0,
                Err(failure) if failure.is_of_ranks() => leave(&failure),
                Err(failure) => {
                    to_stderr(&failure);
                    failure.class as u8
                }
            }
        }
    };
    gs4d_run::ranks::dismiss(&**ranks, code);
    code
}

/// What the other ranks do: they ignore signals, which the first rank answers for all, and print nothing that it prints.
fn follow(ranks: &Arc<dyn Ranks>) -> u8 {
    let cli = parsed();
    let ready = set_threads(cli.as_ref().ok().and_then(|cli| cli.global.threads)).and_then(|()| interrupt::ignore());
    let shared = || match cli.map(|cli| run_shared(cli, ranks)) {
        Ok(Err(failure)) if failure.is_of_ranks() => leave(&failure),
        // The first rank hears of what else fails.
        Ok(_) => {}
        Err(e) => {
            leave(&Failure::usage(format!("this rank cannot read the command line that the first one reads: {e}")))
        }
    };
    let followed = ready.and_then(|()| Ok(gs4d_run::ranks::follow(gs_methods::registry(), ranks, shared)?));
    followed.unwrap_or_else(|failure| leave(&failure))
}

/// Ends this process at once. Others may wait for this rank: one that goes without ending MPI ends the job.
fn leave(failure: &Failure) -> ! {
    to_stderr(failure);
    std::process::exit(failure.class as i32)
}

/// Does a share of what all ranks make.
fn run_shared(mut cli: Cli, ranks: &Arc<dyn Ranks>) -> Result<Answer, Failure> {
    let share = Arc::new(Share::new(ranks.clone()));
    cli.global.share = share.clone();
    cli.global.quiet |= !share.leads();
    share.finish(|_| run(cli), |failure| (failure.class as u8, failure.message()))
}
