//! Turns: one image is rendered at a time.
//!
//! Who waits is ordered by the time of the question plus the expected time of its image. A small image so passes large ones
//! that were asked for shortly before, and no large one waits for ever.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};
use tokio::sync::oneshot;

/// Expected time per pixel.
const PER_PIXEL: Duration = Duration::from_micros(1);

/// The line of those who wait.
#[derive(Default)]
pub(crate) struct Turns {
    line: Mutex<Line>,
}

#[derive(Default)]
struct Line {
    /// Whether somebody has the turn.
    taken: bool,
    /// Number of those who have waited.
    count: u64,
    /// By deadline and number.
    waiting: BTreeMap<(Instant, u64), oneshot::Sender<Turn>>,
}

/// The right to render; dropped, it passes to the next.
pub(crate) struct Turn(Arc<Turns>);

impl Turns {
    fn line(&self) -> MutexGuard<'_, Line> {
        self.line.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Waits for the turn of an image of so many pixels. `None`: there will be none, because the line is gone.
    pub(crate) async fn wait(self: &Arc<Self>, pixels: u64) -> Option<Turn> {
        let turn = {
            let mut line = self.line();
            if !line.taken {
                line.taken = true;
                return Some(Turn(self.clone()));
            }
            let (give, turn) = oneshot::channel();
            line.count += 1;
            let deadline = Instant::now() + PER_PIXEL.saturating_mul(u32::try_from(pixels).unwrap_or(u32::MAX));
            let place = (deadline, line.count);
            // Those who have left would otherwise pass the turn on one inside the other.
            line.waiting.retain(|_, give| !give.is_closed());
            line.waiting.insert(place, give);
            turn
        };
        turn.await.ok()
    }
}

impl Drop for Turn {
    fn drop(&mut self) {
        let next = {
            let mut line = self.0.line();
            let next = line.waiting.pop_first();
            line.taken = next.is_some();
            next
        };
        if let Some((_, give)) = next {
            // Where the next one has left, the turn comes back, is dropped, and so passes on.
            let _ = give.send(Turn(self.0.clone()));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Waits in a task of its own, which adds `name` to the list when its turn comes.
    fn enter(
        turns: &Arc<Turns>,
        list: &Arc<Mutex<Vec<&'static str>>>,
        name: &'static str,
        pixels: u64,
    ) -> tokio::task::JoinHandle<()> {
        let (turns, list) = (turns.clone(), list.clone());
        tokio::spawn(async move {
            let _turn = turns.wait(pixels).await;
            list.lock().unwrap().push(name);
        })
    }

    #[test]
    fn small_images_pass_large_ones_and_who_leaves_loses_no_turn() {
        let runtime = tokio::runtime::Builder::new_current_thread().build().unwrap();
        runtime.block_on(async {
            let (turns, list) = (Arc::new(Turns::default()), Arc::default());
            let first = turns.wait(1).await;
            let mut tasks = Vec::new();
            for (name, pixels) in [("large", 8_000_000), ("left", 10), ("larger", 9_000_000), ("small", 3_000)] {
                tasks.push(enter(&turns, &list, name, pixels));
                tokio::task::yield_now().await;
            }
            tasks.remove(1).abort();
            tokio::task::yield_now().await;
            assert!(list.lock().unwrap().is_empty());
            drop(first);
            for task in tasks {
                task.await.unwrap();
            }
            assert_eq!(*list.lock().unwrap(), ["small", "large", "larger"]);
            assert!(!turns.line().taken && turns.line().waiting.is_empty());
        });
    }

    #[test]
    fn any_number_may_come_and_go_while_somebody_has_the_turn() {
        let runtime = tokio::runtime::Builder::new_current_thread().build().unwrap();
        runtime.block_on(async {
            let turns = Arc::new(Turns::default());
            let first = turns.wait(1).await;
            for _ in 0..100_000 {
                let mut left = std::pin::pin!(turns.wait(1));
                let mut context = std::task::Context::from_waker(std::task::Waker::noop());
                assert!(left.as_mut().poll(&mut context).is_pending());
            }
            assert!(turns.line().waiting.len() <= 1);
            drop(first);
            assert!(!turns.line().taken);
        });
    }
}
