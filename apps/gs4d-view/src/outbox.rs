//! Answers on their way to browsers: their bytes are bounded, and a slow reader makes room for others.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Most bytes of answers that wait for browsers, all together. One answer alone may have more.
pub(crate) const MAX_BYTES: usize = 64 << 20;
/// Bytes of an answer that are sent at once: what a browser that does not read holds besides the outbox.
pub(crate) const PART: usize = 256 << 10;

/// All answers that are being sent, oldest first.
#[derive(Default)]
pub(crate) struct Outbox {
    answers: Mutex<Answers>,
}

#[derive(Default)]
struct Answers {
    /// Number of answers so far.
    count: u64,
    /// Number and bytes of an answer.
    waiting: VecDeque<(u64, Vec<u8>)>,
}

/// An answer in the outbox; dropped, it is taken out.
pub(crate) struct Sending {
    outbox: Arc<Outbox>,
    id: u64,
    /// Number of bytes.
    pub(crate) length: usize,
}

impl Outbox {
    fn answers(&self) -> MutexGuard<'_, Answers> {
        self.answers.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Bytes that wait.
    pub(crate) fn bytes(&self) -> usize {
        self.answers().waiting.iter().map(|(_, bytes)| bytes.len()).sum()
    }

    /// Puts an answer in. The oldest ones are thrown away until all fit into [`MAX_BYTES`].
    pub(crate) fn put(self: &Arc<Self>, bytes: Vec<u8>) -> Sending {
        let mut answers = self.answers();
        answers.count += 1;
        let (id, length) = (answers.count, bytes.len());
        let mut all = length + answers.waiting.iter().map(|(_, bytes)| bytes.len()).sum::<usize>();
        while all > MAX_BYTES
            && let Some((_, oldest)) = answers.waiting.pop_front()
        {
            all -= oldest.len();
        }
        answers.waiting.push_back((id, bytes));
        Sending { outbox: self.clone(), id, length }
    }
}

impl Sending {
    /// The part that begins at a byte; `None` if the answer has been thrown away.
    pub(crate) fn part(&self, from: usize) -> Option<Vec<u8>> {
        let answers = self.outbox.answers();
        let (_, bytes) = answers.waiting.iter().find(|(id, _)| *id == self.id)?;
        bytes.get(from..self.length.min(from + PART)).map(<[u8]>::to_vec)
    }
}

impl Drop for Sending {
    fn drop(&mut self) {
        self.outbox.answers().waiting.retain(|(id, _)| *id != self.id);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_oldest_answers_make_room() {
        let outbox = Arc::new(Outbox::default());
        let answer = |mib: usize| outbox.put(vec![7; mib << 20]);
        let (first, second, third) = (answer(30), answer(30), answer(30));
        assert!(first.part(0).is_none() && second.part(0).is_some() && third.part(0).is_some());
        assert_eq!(outbox.bytes(), 60 << 20);
        let alone = answer(100);
        assert!(second.part(0).is_none() && third.part(0).is_none());
        let mut from = 0;
        while let Some(part) = alone.part(from).filter(|p| !p.is_empty()) {
            assert!(part.len() <= PART && part.iter().all(|b| *b == 7));
            from += part.len();
        }
        assert_eq!(from, 100 << 20);
        drop(alone);
        assert_eq!(outbox.bytes(), 0);
    }
}
