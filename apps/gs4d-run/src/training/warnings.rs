//! What a user should know of a run before its first step.

use crate::Resolved;
use gs_train::registry::section;
use gs_train::still::training::StillConfig;
use gs_train::trainer::Trainer;

/// The warnings of a run that begins.
pub(super) fn at_begin(trainer: &Trainer, resolved: &Resolved) -> Vec<String> {
    [undrawn(trainer), undecided(trainer, resolved)].into_iter().flatten().collect()
}

/// A warning if the run is too short to draw every training view.
fn undrawn(trainer: &Trainer) -> Option<String> {
    let (steps, views) = (trainer.steps(), trainer.dataset().train.len());
    let shortest = trainer.schedule().shortest(views);
    let warning =
        || format!("{steps} steps cannot draw each of the {views} training views once; --steps {shortest} does");
    (u64::from(steps) < shortest).then(warning)
}

/// A warning if splats that hardly move are to be left out of the field, and no step decides which.
fn undecided(trainer: &Trainer, resolved: &Resolved) -> Option<String> {
    // Other methods have no such section.
    let still: StillConfig = section(trainer.model().name(), &resolved.method, "still").ok()?;
    let StillConfig { pixels, every, from, until, .. } = still;
    still.never_decides(trainer.schedule()).then(|| {
        format!(
            "no splat is left out of the field: no step in which splats may rest (still.from = {from}, still.until = {until} of a stage) \
             is a multiple of still.every = {every}; lower it, or set still.pixels = 0 (it is {pixels})"
        )
    })
}
