//! `gs4d live`: frames of a person that arrive in a folder, in a browser.

use super::view::{Serving, name_of};
use crate::answer::Answer;
use crate::failure::{Class, Failure};
use crate::global::Global;
use crate::opening::RunData;
use gs_data::avatar::layout::PosesFrom;
use gs4d_view::{LiveFilm, LiveFilmError, ShownFrame};
use serde_json::json;
use std::collections::VecDeque;
use std::path::PathBuf;
use std::time::{Duration, Instant};

/// How often the folder is looked at, and how often a line is printed at most.
const LOOK: Duration = Duration::from_millis(4);
const SAY: Duration = Duration::from_millis(500);
/// Latencies are summed up over so many of the newest frames.
const KEPT: usize = 10_000;

/// Show a person live in a browser: frames that arrive in a folder, through a trained avatar
#[derive(clap::Args)]
pub struct Live {
    /// A run of a method of people: dut.
    #[arg(value_name = "RUN")]
    run: PathBuf,
    /// Where frames arrive: images/CAMERA/FRAME.png of every conditioning camera with alpha (or masks/CAMERA/FRAME.png), and
    /// poses/FRAME.json. The newest whole frame is shown, older ones are passed over.
    #[arg(value_name = "DIR")]
    dir: PathBuf,
    /// Take the pose of a frame from the frame of the same number of the run's film, not from poses/.
    #[arg(long)]
    film_poses: bool,
    /// Stop by itself after so many frames.
    #[arg(long, value_name = "N")]
    frames: Option<u64>,
    #[command(flatten)]
    serving: Serving,
    #[command(flatten)]
    place: RunData,
}

impl Live {
    pub fn run(self, global: &Global) -> Result<Answer, Failure> {
        let run = self.place.open(&self.run, global)?;
        let poses = if self.film_poses { PosesFrom::Film } else { PosesFrom::Folder };
        let mut film = LiveFilm::open(run, &self.dir, poses)?;
        let served = self.serving.start(vec![film.show(name_of(&self.run))?], global)?;
        let folders: Vec<String> = film.cameras().map(|id| format!("{id:03}")).collect();
        global.say(format!("waits for {}/images/{{{}}}/FRAME.png", self.dir.display(), folders.join(",")));
        let (mut latency, mut said) = (Latency::default(), None::<Instant>);
        while served.goes_on() && self.frames.is_none_or(|n| latency.frames < n) {
            match film.next(&served.server) {
                Ok(None) => std::thread::sleep(LOOK),
                Ok(Some(frame)) => {
                    let [waited, read, computed] = latency.add(&frame);
                    if said.is_none_or(|s| s.elapsed() > SAY) {
                        let ms = waited + read + computed;
                        global.say(format!("frame {}: {ms:.0} ms after its files", frame.number));
                        said = Some(Instant::now());
                    }
                }
                Err(e) => global.say(format!("warning: a frame is passed over: {e}")),
            }
        }
        Ok(latency.answer(&served.server.url))
    }
}

/// How long frames took from their last file to their splats.
#[derive(Default)]
struct Latency {
    frames: u64,
    passed_over: usize,
    /// Milliseconds of waiting, reading and computing of the newest frames.
    parts: VecDeque<[f64; 3]>,
}

impl Latency {
    /// Adds a frame; its parts in milliseconds.
    fn add(&mut self, frame: &ShownFrame) -> [f64; 3] {
        let ms = [frame.waited, frame.read, frame.computed].map(|d| d.as_secs_f64() * 1e3);
        self.frames += 1;
        self.passed_over += frame.passed_over;
        if self.parts.len() == KEPT {
            self.parts.pop_front();
        }
        self.parts.push_back(ms);
        ms
    }

    fn answer(&self, url: &str) -> Answer {
        let n = self.parts.len();
        let mut sums: Vec<f64> = self.parts.iter().map(|p| p.iter().sum()).collect();
        sums.sort_by(f64::total_cmp);
        let at = |share: usize| (n > 0).then(|| sums[(n - 1) * share / 100]);
        let mean = |k: usize| (n > 0).then(|| self.parts.iter().map(|p| p[k]).sum::<f64>() / n as f64);
        let (means, [median, late]) = ([mean(0), mean(1), mean(2)], [at(50), at(95)]);
        let mut text = format!("{} frames shown, {} passed over\n", self.frames, self.passed_over);
        if let ([Some(waited), Some(read), Some(made)], Some(median), Some(late)) = (means, median, late) {
            let sum = waited + read + made;
            text.push_str(&format!(
                "latency from files to splats: mean {sum:.1} ms (waiting {waited:.1}, reading {read:.1}, splats {made:.1}), median {median:.1}, 95 % within {late:.1}\n"
            ));
        }
        let ms =
            json!({"waiting": means[0], "reading": means[1], "splats": means[2], "median": median, "within_95": late});
        Answer::new(text, json!({"url": url, "frames": self.frames, "passed_over": self.passed_over, "latency_ms": ms}))
    }
}

impl From<LiveFilmError> for Failure {
    fn from(e: LiveFilmError) -> Self {
        let text = e.to_string();
        match e {
            LiveFilmError::NoPerson(_) => Self::usage(text).remedy("give a run of `gs4d train FILM -m dut`"),
            LiveFilmError::Run(e) => e.into(),
            LiveFilmError::Data(e) => e.into(),
            LiveFilmError::Method(e) => e.into(),
            LiveFilmError::Frame(..) => Self::new(Class::Data, "data.frame", text),
        }
    }
}
