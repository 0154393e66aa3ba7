//! Frames once prepared: training meets each of them many times.

use std::collections::{BTreeMap, VecDeque};
use std::sync::{Arc, Mutex, PoisonError};

/// Values by number of frame; the oldest makes room.
pub(crate) struct Cache<T> {
    kept: Mutex<Kept<T>>,
    most: usize,
}

struct Kept<T> {
    values: BTreeMap<u32, Arc<T>>,
    order: VecDeque<u32>,
}

impl<T> Cache<T> {
    /// Room for so many, at least one.
    pub(crate) fn new(most: usize) -> Self {
        Self { kept: Mutex::new(Kept { values: BTreeMap::new(), order: VecDeque::new() }), most: most.max(1) }
    }

    /// The value of a frame, made if it is not there.
    ///
    /// # Errors
    /// As `make`.
    pub(crate) fn get<E>(&self, frame: u32, make: impl FnOnce() -> Result<T, E>) -> Result<Arc<T>, E> {
        if let Some(value) = self.lock().values.get(&frame) {
            return Ok(value.clone());
        }
        let value = Arc::new(make()?);
        let mut kept = self.lock();
        if kept.values.insert(frame, value.clone()).is_none() {
            kept.order.push_back(frame);
        }
        if kept.order.len() > self.most
            && let Some(oldest) = kept.order.pop_front()
        {
            kept.values.remove(&oldest);
        }
        Ok(value)
    }

    /// Drops all values, as after a change of parameters.
    pub(crate) fn clear(&self) {
        let mut kept = self.lock();
        kept.values.clear();
        kept.order.clear();
    }

    fn lock(&self) -> std::sync::MutexGuard<'_, Kept<T>> {
        self.kept.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_oldest_makes_room_and_failures_are_not_kept() {
        let cache = Cache::new(2);
        let get = |frame| cache.get(frame, || Ok::<_, ()>(10 * frame)).map(|v| *v);
        assert_eq!([get(1), get(2), get(3)], [Ok(10), Ok(20), Ok(30)]);
        assert_eq!(cache.get(2, || Err(())).map(|v| *v), Ok(20));
        assert_eq!(cache.get(1, || Err("made again")).map(|v| *v), Err("made again"));
        cache.clear();
        assert_eq!(cache.get(2, || Err(())).map(|v| *v), Err(()));
    }
}
