//! A run under training as browsers see it: copies of its state, made between two steps, drawn by one thread of the viewer's
//! own, never for more than a share of the machine.
//!
//! ```text
//! training ── copy, if one is due ──▶ feed ── method built anew ──▶ show ── pictures ──▶ browsers
//! ```
//! Nothing goes the other way: training neither waits for the viewer nor reads anything it changes. The share is halved:
//! one half for copies and what is built of them, one for pictures.

use crate::scene::Scene;
use crate::server::Shared;
use gs_data::avatar::AvatarScene;
use gs_train::checkpoint::Checkpoint;
use gs_train::registry::Registry;
use gs_train::saved::load_with;
use gs_train::trainer::Trainer;
use gs4d_run::Progress;
use serde_json::{Value, json};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

/// What threads of the viewer are called; a fault in one of them is no reason to end the process.
pub const THREADS: &str = "gs4d-view";
/// Copies are at least this far apart.
const APART: Duration = Duration::from_millis(500);

/// When the next piece of work may begin, so that all of it takes no more than a share of one thread's time.
#[derive(Debug)]
pub struct Pace {
    share: f64,
    ready: Mutex<Instant>,
}

impl Pace {
    /// A pace of this share of the machine's threads; whoever has more than one thread's time never waits.
    pub fn of(share: f64) -> Self {
        let threads = std::thread::available_parallelism().map_or(1, usize::from);
        Self { share: (share * threads as f64).clamp(1e-3, 1.0), ready: Mutex::new(Instant::now()) }
    }

    /// When the next piece may begin.
    pub fn ready(&self) -> Instant {
        *self.ready.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// A piece has taken this long.
    pub fn spent(&self, time: Duration) {
        let rest = time.mul_f64(1.0 / self.share - 1.0);
        *self.ready.lock().unwrap_or_else(PoisonError::into_inner) = Instant::now() + rest;
    }
}

/// Where training brings its state. Belongs to the first show of a server.
pub struct Feed {
    copies: SyncSender<(Checkpoint, Progress, Duration)>,
    shared: Arc<Shared>,
    building: Arc<AtomicBool>,
    pace: Arc<Pace>,
    /// The step that is shown already.
    shown: u32,
}

impl Feed {
    /// A feed that may take this share of the machine, and its thread.
    ///
    /// # Errors
    /// The system's, if there is no thread.
    pub(crate) fn start(
        registry: Registry,
        shared: Arc<Shared>,
        avatar: Option<Arc<AvatarScene>>,
        share: f64,
    ) -> std::io::Result<Self> {
        let (copies, brought) = sync_channel(1);
        let (building, pace) = (Arc::new(AtomicBool::new(false)), Arc::new(Pace::of(share)));
        let feed = Self { copies, shared: shared.clone(), building: building.clone(), pace: pace.clone(), shown: 0 };
        let work = move || build(&registry, &brought, &shared, avatar.as_ref(), &building, &pace);
        std::thread::Builder::new().name(THREADS.into()).spawn(work)?;
        Ok(feed)
    }

    /// Between two steps: copies the state if somebody looks and one is due.
    pub fn offer(&mut self, progress: Progress, trainer: &Trainer) {
        let last = progress.step == progress.steps;
        let due = last || Instant::now() >= self.pace.ready();
        let looked_at = self.shared.clients.load(Ordering::Relaxed) > 0;
        if !due || !looked_at || self.shown == progress.step || self.building.swap(true, Ordering::SeqCst) {
            return;
        }
        let begun = Instant::now();
        let copy = trainer.state_for_rendering();
        // The thread ends only with the feed; if it has failed, what was shown last stays.
        let _ = self.copies.try_send((copy, progress, begun.elapsed()));
        self.shown = progress.step;
    }

    /// Whether the state after a step has been brought.
    pub fn has_shown(&self, step: u32) -> bool {
        self.shown == step
    }
}

/// Makes scenes of copies until the feed is dropped.
fn build(
    registry: &Registry,
    brought: &Receiver<(Checkpoint, Progress, Duration)>,
    shared: &Shared,
    avatar: Option<&Arc<AvatarScene>>,
    building: &AtomicBool,
    pace: &Pace,
) {
    while let Ok((copy, progress, copied)) = brought.recv() {
        let begun = Instant::now();
        let news = match shared.alone(|| load_with(registry, &copy, None, avatar.cloned())) {
            Ok(loaded) => {
                shared.stage.shows[0].replace(Scene::method(loaded.model));
                told(progress, shared)
            }
            Err(why) => json!({"error": format!("step {} cannot be shown: {why}", progress.step)}),
        };
        shared.news.send_replace(Some(news.to_string()));
        pace.spent((begun.elapsed() + copied).max(APART.mul_f64(pace.share)));
        building.store(false, Ordering::SeqCst);
    }
}

/// What browsers hear of a new state.
fn told(p: Progress, shared: &Shared) -> Value {
    let mut news = shared.stage.shows[0].changing();
    news["training"] = json!({
        "step": p.step, "steps": p.steps, "splats": p.splats, "seconds": p.seconds,
        "loss": Some(p.loss).filter(|v| v.is_finite()), "psnr": Some(p.psnr).filter(|v| v.is_finite()),
    });
    json!({"news": news})
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn work_is_followed_by_its_rest() {
        let pace = Pace { share: 0.25, ready: Mutex::new(Instant::now()) };
        let before = Instant::now();
        pace.spent(Duration::from_millis(100));
        let rest = pace.ready().duration_since(before);
        assert!(rest >= Duration::from_millis(300) && rest < Duration::from_millis(400), "{rest:?}");
        assert!((Pace::of(1e9).share, Pace::of(0.0).share) == (1.0, 1e-3));
    }
}
