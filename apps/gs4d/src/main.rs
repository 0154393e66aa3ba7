//! The program `gs4d`: its command line ([`gs4d::main`]) on one rank.

use std::process::ExitCode;

fn main() -> ExitCode {
    gs4d::main(gs_train::ranks::alone())
}
