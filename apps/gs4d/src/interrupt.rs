//! Ctrl-C: the first stops the run after its step and saves it, the second ends the process (the last checkpoint stays valid).

use crate::failure::{Class, Failure};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// A flag that the first Ctrl-C (or SIGTERM) sets. The second one ends the process.
pub fn flag() -> Result<Arc<AtomicBool>, Failure> {
    let stop = Arc::new(AtomicBool::new(false));
    let set = Arc::clone(&stop);
    let handler = move || {
        if set.swap(true, Ordering::Relaxed) {
            std::process::exit(Class::Interrupted as i32);
        }
        eprintln!("\nstopping after this step; press Ctrl-C again to stop at once");
    };
    ctrlc::set_handler(handler).map_err(|e| Failure::new(Class::Internal, "interrupt", e.to_string()))?;
    Ok(stop)
}
