//! The command line of gs4d: parses arguments, calls the libraries, presents what they return. No mathematics here.
//!
//! Results go to stdout (text, or one JSON value with `--json`), progress and messages to stderr. Exit codes: 0 done ·
//! 1 internal fault · 2 wrong usage · 3 invalid data · 4 numerical failure · 5 resource limit · 6 input or output ·
//! 130 interrupted, state saved.

mod answer;
mod failure;
mod progress;
mod verbs;

use answer::Answer;
use clap::{Args, Parser, Subcommand};
use failure::{Class, Failure};
use std::process::ExitCode;

/// Learn moving Gaussian splat scenes from images; draw them from any camera at any time. On the CPU.
#[derive(Parser)]
#[command(name = "gs4d", version, max_term_width = 110, after_help = EXIT_CODES)]
struct Cli {
    #[command(subcommand)]
    verb: Verb,
    #[command(flatten)]
    global: Global,
}

const EXIT_CODES: &str = "Exit codes: 0 done, 1 internal fault, 2 wrong usage, 3 invalid data, 4 numerical failure, \
    5 resource limit, 6 input or output, 130 interrupted (state saved)";

/// Flags every verb takes.
#[derive(Args, Clone, Debug)]
pub struct Global {
    /// Print the result as one JSON value on stdout.
    #[arg(long, global = true)]
    json: bool,
    /// No progress on stderr.
    #[arg(short, long, global = true, conflicts_with = "verbose")]
    quiet: bool,
    /// More detail on stderr.
    #[arg(short, long, global = true)]
    verbose: bool,
    /// Threads to use; results are the same for any number [default: all cores].
    #[arg(long, global = true, value_name = "T", value_parser = clap::value_parser!(u16).range(1..=1024))]
    threads: Option<u16>,
}

#[derive(Subcommand)]
enum Verb {
    Inspect(verbs::inspect::Inspect),
}

fn run(cli: Cli) -> Result<Answer, Failure> {
    let global = &cli.global;
    if let Some(threads) = global.threads {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads.into());
        pool.build_global().map_err(|e| Failure::new(Class::Resource, "limits.threads", e.to_string()))?;
    }
    match cli.verb {
        Verb::Inspect(verb) => verb.run(),
    }
}

fn main() -> ExitCode {
    let default_hook = std::panic::take_hook();
    std::panic::set_hook(Box::new(move |info| {
        default_hook(info);
        eprintln!("error[internal]: this is a fault of gs4d; please report it with the lines above");
        std::process::exit(Class::Internal as i32);
    }));
    let cli = Cli::parse();
    let json = cli.global.json;
    let code = match run(cli).and_then(|answer| answer.print(json)) {
        Ok(()) => 0,
        Err(failure) => {
            eprintln!("{failure}");
            failure.class as u8
        }
    };
    ExitCode::from(code)
}
