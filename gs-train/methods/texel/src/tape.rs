//! The tape of a network that several threads may ask.

use gs_texel::texels::TexelTable;
use std::sync::{Mutex, PoisonError, TryLockError};

/// The texels that a network works on.
pub(crate) fn covered(table: &TexelTable) -> Vec<bool> {
    table.mask().iter().map(|m| *m > 0.0).collect()
}

/// Runs `pass` on the kept tape, or on a fresh one while another pass has it. To wait could be for ever: a pass waits for tasks of a
/// thread pool, and the thread that waits may be given one that asks for the tape itself.
///
/// # Errors
/// Those of `fresh` and of `pass`.
pub(crate) fn with_tape<T, R, E>(
    kept: &Mutex<T>,
    fresh: impl FnOnce() -> Result<T, E>,
    pass: impl FnOnce(&mut T) -> Result<R, E>,
) -> Result<R, E> {
    match kept.try_lock() {
        Ok(mut tape) => pass(&mut tape),
        Err(TryLockError::Poisoned(tape)) => pass(&mut tape.into_inner()),
        Err(TryLockError::WouldBlock) => pass(&mut fresh()?),
    }
}

/// The kept tape, of the last pass, for a pass back.
pub(crate) fn last<T>(kept: &mut Mutex<T>) -> &mut T {
    kept.get_mut().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_pass_within_a_pass_has_a_tape_of_its_own() {
        let mut kept = Mutex::new(1);
        let fresh = || Ok::<_, ()>(10);
        let inner = |outer: &mut i32| {
            let seen = with_tape(&kept, fresh, |inner| Ok(*inner))?;
            *outer += seen;
            Ok(seen)
        };
        assert_eq!(with_tape(&kept, fresh, inner), Ok(10));
        assert_eq!((with_tape(&kept, fresh, |tape| Ok(*tape)), *last(&mut kept)), (Ok(11), 11));
    }
}
