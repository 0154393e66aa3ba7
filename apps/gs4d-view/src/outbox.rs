//! Answers on their way to browsers: their bytes are bounded, and a slow reader makes room for others.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Most bytes of images and files that wait for browsers, all together, and as many of splats. One answer alone may have more.
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
    waiting: VecDeque<Waiting>,
}

struct Waiting {
    /// Number of the answer.
    id: u64,
    bytes: Vec<u8>,
    /// Whether it holds splats.
    splats: bool,
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
        self.answers().waiting.iter().map(|w| w.bytes.len()).sum()
    }

    /// Puts an answer in. The oldest images and files are thrown away until all fit into [`MAX_BYTES`]. Splats throw nothing away, or two browsers
    /// that fetch large ones would do so to each other for ever: none if they do not fit beside others.
    pub(crate) fn put(self: &Arc<Self>, bytes: Vec<u8>, splats: bool) -> Option<Sending> {
        let mut answers = self.answers();
        let length = bytes.len();
        let of_its_kind = answers.waiting.iter().filter(|w| w.splats == splats);
        let mut all = length + of_its_kind.map(|w| w.bytes.len()).sum::<usize>();
        if splats && all > MAX_BYTES.max(length) {
            return None;
        }
        while !splats
            && all > MAX_BYTES
            && let Some(oldest) = answers.waiting.iter().position(|w| !w.splats)
        {
            all -= answers.waiting.remove(oldest).map_or(0, |w| w.bytes.len());
        }
        answers.count += 1;
        let id = answers.count;
        answers.waiting.push_back(Waiting { id, bytes, splats });
        Some(Sending { outbox: self.clone(), id, length })
    }
}

impl Sending {
    /// The part that begins at a byte; `None` if the answer has been thrown away.
    pub(crate) fn part(&self, from: usize) -> Option<Vec<u8>> {
        let answers = self.outbox.answers();
        let waiting = answers.waiting.iter().find(|w| w.id == self.id)?;
        waiting.bytes.get(from..self.length.min(from + PART)).map(<[u8]>::to_vec)
    }
}

impl Drop for Sending {
    fn drop(&mut self) {
        self.outbox.answers().waiting.retain(|w| w.id != self.id);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_oldest_answers_make_room() {
        let outbox = Arc::new(Outbox::default());
        let answer = |mib: usize| outbox.put(vec![7; mib << 20], false).expect("an image is always taken");
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

    #[test]
    fn splats_wait_for_room_and_throw_nothing_away() {
        let outbox = Arc::new(Outbox::default());
        let put = |mib: usize, splats: bool| outbox.put(vec![7; mib << 20], splats);
        let key = put(40, true).unwrap();
        assert!(put(40, true).is_none(), "not beside the first");
        let image = put(40, false).unwrap();
        assert!(key.part(0).is_some() && image.part(0).is_some());
        drop(key);
        assert!(put(100, true).is_some(), "alone they may have more");
    }
}
