//! Short runs for the tests and benches of methods (feature `testkit`). Every function panics where it fails.

mod device;

pub use device::fake_device;

use crate::checkpoint::Checkpoint;
use crate::error::RanksError;
use crate::ranks::Ranks;
use crate::registry::{Registry, overlay};
use crate::trainer::{StepReport, TrainOptions, Trainer};
use gs_data::Dataset;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Mutex};

/// Growth, pruning, a reset and steps of the SH degree inside 60 steps: of clouds …
const SHORT_CLOUD: &str = "
init.points = 150
[schedule]
density.from = 5
density.until = 55
density.every = 10
density.reset_every = 25
density.max_splats = 300
sh_every = 20
";

/// … and of anchors.
const SHORT_ANCHORS: &str = "
init.points = 150
[adapt]
observe_from = 0
from = 5
until = 55
every = 10
grad = 2e-5
";

/// Of films: networks of 32 texels a side, one stage after the other in 15 steps.
pub const SHORT_FILM: &str = "
cache_mib = 64
[textures]
unproject = 32
geo = 16
gau = 32
[gaunet]
residual = false
[gaunet.net]
width = 8
levels = 2
[geonet]
width = 16
[schedule]
stages.geometry.steps = 5
stages.warm_up.steps = 4
stages.main.steps = 6
";

/// A preset of a method with TOML laid over it, one after the other.
pub fn config(registry: &Registry, method: &str, preset: &str, over: &[&str]) -> toml::Table {
    let mut config = registry.find(method).and_then(|m| m.config(preset)).expect("preset");
    over.iter().for_each(|o| overlay(&mut config, o.parse().expect("TOML")));
    config
}

/// The `tiny` preset of a method of clouds or anchors, 60 steps in stages of one length, with TOML laid over it.
pub fn short(registry: &Registry, method: &str, over: &[&str]) -> toml::Table {
    let mut config = config(registry, method, "tiny", &[]);
    let short = if config.contains_key("adapt") { SHORT_ANCHORS } else { SHORT_CLOUD };
    overlay(&mut config, short.parse().expect("TOML"));
    let stages = config["schedule"]["stages"].as_table_mut().expect("stages");
    let count = stages.len() as i64;
    stages.iter_mut().for_each(|(_, stage)| stage["steps"] = (60 / count).into());
    over.iter().for_each(|o| overlay(&mut config, o.parse().expect("TOML")));
    config
}

/// A run before its first step.
pub fn start(registry: &Registry, data: &Arc<Dataset>, method: &str, config: &toml::Table, seed: u64) -> Trainer {
    let options = TrainOptions { seed, ..TrainOptions::default() };
    Trainer::new(registry, data.clone(), method, config, options).expect("trainer")
}

/// Makes steps.
pub fn run(trainer: &mut Trainer, steps: u32) -> Vec<StepReport> {
    (0..steps).map(|_| trainer.step().expect("step")).collect()
}

/// Everything that a state says but the clock on the wall.
pub fn timeless(mut state: Checkpoint) -> Checkpoint {
    state.meta["train_seconds"] = 0.into();
    state
}

/// Largest difference of a value of the state after so many steps on one thread and on two: 0 by contract.
pub fn thread_difference(start: impl Fn() -> Trainer + Sync, steps: u32) -> f64 {
    let [one, two] = [1, 2].map(|threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("pool");
        pool.install(|| {
            let mut trainer = start();
            run(&mut trainer, steps);
            trainer.state().tensors
        })
    });
    assert!(one.iter().map(|t| (&t.0, t.1.len())).eq(two.iter().map(|t| (&t.0, t.1.len()))), "the same tensors");
    let pairs = one.iter().zip(&two).flat_map(|(a, b)| a.1.iter().zip(&b.1));
    pairs.map(|(a, b)| f64::from((a - b).abs())).fold(0.0, f64::max)
}

/// Threads as ranks: what one end of a channel between two threads sends, the other receives.
struct Threads {
    rank: usize,
    to: Vec<Sender<Vec<u8>>>,
    from: Vec<Mutex<Receiver<Vec<u8>>>>,
}

impl Ranks for Threads {
    fn rank(&self) -> usize {
        self.rank
    }

    fn size(&self) -> usize {
        self.to.len()
    }

    fn all_to_all(&self, to: Vec<Vec<u8>>) -> Result<Vec<Vec<u8>>, RanksError> {
        let gone = |rank: usize| RanksError { what: format!("rank {rank} is gone") };
        for (rank, bytes) in to.into_iter().enumerate() {
            self.to[rank].send(bytes).map_err(|_| gone(rank))?;
        }
        let receive = |from: &Mutex<Receiver<_>>| from.lock().ok()?.recv().ok();
        self.from.iter().enumerate().map(|(rank, from)| receive(from).ok_or_else(|| gone(rank))).collect()
    }
}

/// So many ranks, each for a thread of its own. One that is dropped is noticed by the others.
pub fn threads_as_ranks(count: usize) -> Vec<Arc<dyn Ranks>> {
    let mut ends: Vec<(Vec<_>, Vec<_>)> = (0..count).map(|_| Default::default()).collect();
    for sender in 0..count {
        for receiver in 0..count {
            let (to, from) = channel();
            ends[sender].0.push(to);
            ends[receiver].1.push(Mutex::new(from));
        }
    }
    let rank = |(rank, (to, from))| Arc::new(Threads { rank, to, from }) as Arc<dyn Ranks>;
    ends.into_iter().enumerate().map(rank).collect()
}

/// Does the work of one of several ranks on a thread of its own: ranks that share threads wait for each other.
pub fn on_a_thread<T: Send>(work: impl FnOnce() -> T + Send) -> T {
    rayon::ThreadPoolBuilder::new().num_threads(1).build().expect("pool").install(work)
}

/// Lets ranks make a run together, each on one thread: `lead` is called with that of the first.
pub fn on_ranks<T: Send>(
    registry: &Registry,
    data: &Arc<Dataset>,
    trainer: Trainer,
    count: usize,
    lead: impl FnOnce(Trainer) -> T + Send,
) -> T {
    let mut ranks = threads_as_ranks(count);
    let first = ranks.remove(0);
    std::thread::scope(|scope| {
        for rank in ranks {
            let follow = move || Trainer::join(registry, Ok(data.clone()), 64 << 20, rank).and_then(|mut t| t.follow());
            scope.spawn(move || on_a_thread(follow).expect("rank"));
        }
        on_a_thread(|| lead(trainer.lead(first).expect("first rank")))
    })
}
