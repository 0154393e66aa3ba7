//! Ctrl-C, SIGTERM, SIGHUP and SIGUSR1: the first stops the run after its step and saves it, the second ends the process (the last checkpoint
//! stays valid). Batch systems, `timeout` and `docker stop` send SIGTERM, a terminal that closes SIGHUP; `mpirun` passes SIGUSR1
//! on to all ranks at once.

use crate::failure::{Class, Failure};
use crate::global::to_stderr;
use signal_hook::consts::signal::{SIGHUP, SIGINT, SIGTERM, SIGUSR1};
use signal_hook::iterator::Signals;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// Signals that ask for an end.
const ENDS: [i32; 4] = [SIGINT, SIGTERM, SIGHUP, SIGUSR1];

/// A flag that the first of these signals sets. The second one ends the process.
pub fn flag() -> Result<Arc<AtomicBool>, Failure> {
    let stop = Arc::new(AtomicBool::new(false));
    listen(Arc::clone(&stop)).map_err(|e| Failure::new(Class::Internal, "interrupt", e.to_string()))?;
    Ok(stop)
}

/// Lets these signals pass: another process answers them.
pub fn ignore() -> Result<(), Failure> {
    let failed = |e: std::io::Error| Failure::new(Class::Internal, "interrupt", e.to_string());
    let mut signals = Signals::new(ENDS).map_err(failed)?;
    let each = move || signals.forever().for_each(drop);
    std::thread::Builder::new().name("signals".to_owned()).spawn(each).map(drop).map_err(failed)
}

fn listen(stop: Arc<AtomicBool>) -> std::io::Result<()> {
    let caught = ENDS.into_iter().filter(|&signal| signal != SIGHUP || !hangup_is_ignored());
    let mut signals = Signals::new(caught)?;
    let each = move || {
        for _ in signals.forever() {
            if stop.swap(true, Ordering::Relaxed) {
                std::process::exit(Class::Interrupted as i32);
            }
            to_stderr("\nstopping after this step; press Ctrl-C again to stop at once");
        }
    };
    std::thread::Builder::new().name("signals".to_owned()).spawn(each).map(drop)
}

/// Whether this process was started to outlive its terminal (`nohup`). Where the system does not tell, it was not.
fn hangup_is_ignored() -> bool {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let mask = status.lines().find_map(|line| line.strip_prefix("SigIgn:"));
    mask.and_then(|mask| u64::from_str_radix(mask.trim(), 16).ok()).is_some_and(|mask| mask & 1 << (SIGHUP - 1) != 0)
}
