//! A run under training: copies of its state, taken between two steps, are rendered by one thread of the viewer, limited to a
//! share of the machine.
//!
//! ```text
//! training ── copy, if due ──▶ feed ── rebuilt method ──▶ show ── images ──▶ browsers
//! ```
//! Training neither waits for the viewer nor reads anything the viewer changes, so results stay the same, bit for bit. Half of
//! the share is for copying and rebuilding the method, half for rendering.

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

/// Name of the threads of the viewer. A panic in one of them need not end the process.
pub const THREAD_NAME: &str = "gs4d-view";
/// How often a paused training looks whether it may go on.
const PAUSE_STEP: Duration = Duration::from_millis(50);
/// Least time between two copies.
const MIN_INTERVAL: Duration = Duration::from_millis(500);

/// Limits work to a share of one thread's time: each piece of work is followed by a proportional pause.
#[derive(Debug)]
pub(crate) struct Pace {
    share: f64,
    ready: Mutex<Instant>,
}

impl Pace {
    /// A limit of `share` of the machine's threads. A share of one thread or more never waits.
    pub(crate) fn of(share: f64) -> Self {
        let threads = std::thread::available_parallelism().map_or(1, usize::from);
        Self { share: (share * threads as f64).clamp(1e-3, 1.0), ready: Mutex::new(Instant::now()) }
    }

    /// When the next piece of work may begin.
    pub(crate) fn ready(&self) -> Instant {
        *self.ready.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Records a piece of work that took `time`.
    pub(crate) fn spent(&self, time: Duration) {
        let rest = time.mul_f64(1.0 / self.share - 1.0);
        *self.ready.lock().unwrap_or_else(PoisonError::into_inner) = Instant::now() + rest;
    }
}

/// Passes the state of a training run to the first show of a server.
pub struct Feed {
    copies: SyncSender<(Checkpoint, Progress, Duration)>,
    shared: Arc<Shared>,
    building: Arc<AtomicBool>,
    pace: Arc<Pace>,
    /// Step of the last copy.
    shown: u32,
    history: Arc<Mutex<History>>,
}

/// Loss and PSNR of a training so far.
#[derive(Debug)]
pub(crate) struct History {
    /// Step, loss and PSNR of training batches, in order; not finite values are `None`.
    points: Vec<(u32, [Option<f64>; 2])>,
    /// Steps between two points.
    every: u32,
}

impl Default for History {
    fn default() -> Self {
        Self { points: Vec::new(), every: 1 }
    }
}

impl History {
    /// Most points; beyond, every second one is dropped.
    const MOST: usize = 512;

    fn add(&mut self, p: &Progress) {
        if !p.step.is_multiple_of(self.every) {
            return;
        }
        self.points.push((p.step, [p.loss, p.psnr].map(|v| Some(v).filter(|v| v.is_finite()))));
        if self.points.len() > Self::MOST {
            self.every *= 2;
            self.points.retain(|(step, _)| step.is_multiple_of(self.every));
        }
    }
}

impl Feed {
    /// Starts the thread that rebuilds methods, limited to `share` of the machine.
    ///
    /// # Errors
    /// If the thread cannot be started.
    pub(crate) fn start(
        registry: Registry,
        shared: Arc<Shared>,
        avatar: Option<Arc<AvatarScene>>,
        share: f64,
    ) -> std::io::Result<Self> {
        let (copies, received) = sync_channel(1);
        let (building, pace) = (Arc::new(AtomicBool::new(false)), Arc::new(Pace::of(share)));
        let history = Arc::<Mutex<History>>::default();
        let feed = Self {
            copies,
            shared: shared.clone(),
            building: building.clone(),
            pace: pace.clone(),
            shown: 0,
            history: history.clone(),
        };
        let work = move || build(&registry, &received, &shared, avatar.as_ref(), (&building, &pace, &history));
        std::thread::Builder::new().name(THREAD_NAME.into()).spawn(work)?;
        Ok(feed)
    }

    /// Waits while a page has paused the training. It goes on when a page says so, when no page is open, or when `stop` is set.
    pub fn wait_while_paused(&self, stop: &AtomicBool) {
        let open = || self.shared.clients.load(Ordering::SeqCst) > 0;
        while self.shared.paused.load(Ordering::SeqCst) && open() && !stop.load(Ordering::SeqCst) {
            std::thread::sleep(PAUSE_STEP);
        }
        if self.shared.paused.load(Ordering::SeqCst) {
            self.shared.pause(false);
        }
    }

    /// Copies the state if a browser is connected and a copy is due; call it after each step.
    pub fn offer(&mut self, progress: Progress, trainer: &mut Trainer) {
        self.history.lock().unwrap_or_else(PoisonError::into_inner).add(&progress);
        let last = progress.step == progress.steps;
        let due = last || Instant::now() >= self.pace.ready();
        let connected = self.shared.clients.load(Ordering::Relaxed) > 0;
        if !due || !connected || self.shown == progress.step || self.building.swap(true, Ordering::SeqCst) {
            return;
        }
        let begun = Instant::now();
        if trainer.fetch().is_err() {
            // The next step says so.
            return self.building.store(false, Ordering::SeqCst);
        }
        let copy = trainer.state_for_rendering();
        // If the thread has failed, the last state stays on screen.
        let _ = self.copies.try_send((copy, progress, begun.elapsed()));
        self.shown = progress.step;
    }

    /// Whether the state after `step` has been copied.
    pub fn has_shown(&self, step: u32) -> bool {
        self.shown == step
    }
}

/// Builds a scene from each copy until the feed is dropped.
fn build(
    registry: &Registry,
    received: &Receiver<(Checkpoint, Progress, Duration)>,
    shared: &Shared,
    avatar: Option<&Arc<AvatarScene>>,
    (building, pace, history): (&AtomicBool, &Pace, &Mutex<History>),
) {
    while let Ok((copy, progress, copied)) = received.recv() {
        let begun = Instant::now();
        match shared.in_pool(|| load_with(registry, &copy, None, avatar.cloned())) {
            Ok(loaded) => {
                shared.stage.shows()[0].replace(Scene::method(loaded.model));
                let news = shared.in_pool(|| progress_message(progress, shared, history));
                *shared.last_news.lock().unwrap_or_else(PoisonError::into_inner) = Some(news);
                shared.tell();
            }
            Err(why) => {
                let error = json!({"error": format!("step {} cannot be shown: {why}", progress.step)});
                shared.news.send_replace(Some(error.to_string()));
            }
        }
        pace.spent((begun.elapsed() + copied).max(MIN_INTERVAL.mul_f64(pace.share)));
        building.store(false, Ordering::SeqCst);
    }
}

/// The message to browsers about a new state.
fn progress_message(p: Progress, shared: &Shared, history: &Mutex<History>) -> Value {
    let mut news = shared.stage.shows()[0].live_info();
    news["training"] = json!({
        "step": p.step, "steps": p.steps, "splats": p.splats, "seconds": p.seconds,
        "loss": Some(p.loss).filter(|v| v.is_finite()), "psnr": Some(p.psnr).filter(|v| v.is_finite()),
    });
    news["history"] = json!(history.lock().unwrap_or_else(PoisonError::into_inner).points);
    news
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_long_history_keeps_its_ends_and_its_spacing() {
        let mut history = History::default();
        let at = |step: u32| {
            let (steps, splats, quarantined) = (10_000, 1, 0);
            Progress { step, steps, loss: 1.0 / f64::from(step), psnr: f64::NAN, splats, quarantined, seconds: 0.0 }
        };
        (1..=10_000).for_each(|step| history.add(&at(step)));
        assert!(history.points.len() <= History::MOST && history.points.len() > History::MOST / 4);
        assert!(history.points.windows(2).all(|w| w[1].0 - w[0].0 == history.every));
        assert_eq!(history.points[0].1, [Some(1.0 / f64::from(history.every)), None]);
    }

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
