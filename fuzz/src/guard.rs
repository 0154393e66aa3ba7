//! The rules for every input: no panic, no run longer than a second, no more memory than `8 × bytes + 64 MiB`.

use crate::case::Case;
use crate::memory;
use crate::targets::{Error, Target};
use std::panic::{AssertUnwindSafe, catch_unwind, set_hook};
use std::path::Path;
use std::sync::Mutex;
use std::time::{Duration, Instant};

const MEMORY_PER_BYTE: usize = 8;
const MEMORY_BASE: usize = 64 << 20;
const TIME: Duration = Duration::from_secs(1);
/// A slow run is repeated so often: on a loaded machine the fastest counts.
const REPEATS: u32 = 3;

/// Where the last panic was, and what it said.
static PANIC: Mutex<(String, String)> = Mutex::new((String::new(), String::new()));

/// What one input did.
pub struct Outcome {
    /// Whether it was read.
    pub accepted: Result<(), String>,
    /// The rule it broke.
    pub fault: Option<Fault>,
    pub peak: usize,
    pub took: Duration,
}

/// A broken rule.
pub struct Fault {
    pub kind: &'static str,
    pub why: String,
    /// The place of a panic: two at the same place are the same fault.
    pub place: Option<String>,
}

/// Makes the process ready to run inputs: panics are recorded in place of printed, and one thread does all work, so that the
/// same input takes the same edges.
///
/// # Errors
/// If called twice.
pub fn prepare() -> Result<(), Error> {
    rayon::ThreadPoolBuilder::new().num_threads(1).use_current_thread().build_global()?;
    set_hook(Box::new(|info| {
        if let Ok(mut last) = PANIC.lock() {
            *last = (info.location().map(ToString::to_string).unwrap_or_default(), info.to_string());
        }
    }));
    Ok(())
}

/// Runs one input under the rules.
pub fn run(target: &Target, case: &Case, dir: &Path) -> Outcome {
    let mut outcome = once(target, case, dir);
    for _ in 1..REPEATS {
        if outcome.took <= TIME || outcome.fault.is_some() {
            break;
        }
        // What else runs may have ended by then.
        std::thread::sleep(outcome.took.min(TIME));
        outcome.took = outcome.took.min(once(target, case, dir).took);
    }
    if outcome.fault.is_none() && outcome.took > TIME {
        outcome.fault = Some(Fault { kind: "slow", why: format!("took {:?} at least", outcome.took), place: None });
    }
    outcome
}

fn once(target: &Target, case: &Case, dir: &Path) -> Outcome {
    let start = Instant::now();
    let (result, peak) = memory::peak_of(|| catch_unwind(AssertUnwindSafe(|| (target.run)(case, dir))));
    let took = start.elapsed();
    let bound = MEMORY_PER_BYTE * case.len() + MEMORY_BASE;
    let fault = match &result {
        Err(_) => {
            let (place, why) = PANIC.lock().map(|p| p.clone()).unwrap_or_default();
            Some(Fault { kind: "panic", why, place: Some(place) })
        }
        Ok(_) if peak > bound => {
            let why = format!("held {peak} bytes, {bound} are allowed for {}", case.len());
            Some(Fault { kind: "memory", why, place: None })
        }
        Ok(_) => None,
    };
    Outcome { accepted: result.unwrap_or_else(|_| Err("panicked".into())), fault, peak, took }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fault_of(run: fn(&Case, &Path) -> Result<(), String>) -> Option<&'static str> {
        let target = Target { name: "t", share: 1, seeds: |_| Ok(Vec::new()), repair: |_, _| {}, run };
        super::run(&target, &Case::one("a", b"0123"), Path::new(".")).fault.map(|f| f.kind)
    }

    fn hold(bytes: usize) -> Result<(), String> {
        drop(std::hint::black_box(vec![1u8; bytes]));
        Ok(())
    }

    #[test]
    fn a_broken_rule_is_a_fault_and_a_refusal_is_none() {
        assert_eq!(fault_of(|_, _| Ok(())), None);
        assert_eq!(fault_of(|_, _| Err("refused".into())), None);
        assert_eq!(fault_of(|case, _| Err(case.first()[4].to_string())), Some("panic"));
        assert_eq!(fault_of(|_, _| hold(60 << 20)), None);
        assert_eq!(fault_of(|_, _| hold(65 << 20)), Some("memory"));
        let slow = |_: &Case, _: &Path| {
            let start = Instant::now();
            while start.elapsed() <= TIME {}
            Ok(())
        };
        assert_eq!(fault_of(slow), Some("slow"));
    }
}
