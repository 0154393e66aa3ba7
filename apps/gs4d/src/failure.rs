//! Errors of the command line: what happened, where, why it matters, what to do; and the exit code.

use gs_core::io::IoError;
use gs_data::DataError;
use gs_train::checkpoint::CheckpointError;
use gs_train::evaluate::EvalError;
use gs_train::method::MethodError;
use gs_train::ranks::ShareError;
use gs_train::trainer::TrainError;
use gs4d_eval::folders::FolderError;
use gs4d_eval::forecast::ForecastError;
use gs4d_eval::temporal::{MetricError, TemporalError};
use gs4d_run::RunError;
use gs4d_run::config::ConfigError;
use std::fmt;
use std::io::{self, ErrorKind};
use std::path::Path;

/// Class of a failure; its number is the exit code.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Class {
    /// Bug in this program.
    Internal = 1,
    /// Wrong use of the command line; also the exit code of the argument parser.
    Usage = 2,
    /// Invalid data.
    Data = 3,
    /// Numerical failure.
    Numeric = 4,
    /// Memory, disk or time limit.
    Resource = 5,
    /// Input or output.
    Io = 6,
    /// A result does not meet a requested bound.
    Verification = 7,
    /// Interrupted by the user, state saved.
    Interrupted = 130,
}

impl Class {
    /// The class of an exit code of a library's error.
    fn of_code(code: u8) -> Self {
        match code {
            2 => Class::Usage,
            3 => Class::Data,
            4 => Class::Numeric,
            5 => Class::Resource,
            6 => Class::Io,
            7 => Class::Verification,
            _ => Class::Internal,
        }
    }
}

/// Name of the failure of ranks that cannot talk to each other.
const RANKS: &str = "ranks";
/// What to do where views or images have no tOF.
const WITHOUT_TOF: &str = "leave tof out of --metrics";

/// A failure as printed on stderr.
#[derive(Debug)]
pub struct Failure {
    /// Class and exit code.
    pub class: Class,
    /// Stable name of the error, such as `data.time`.
    id: &'static str,
    text: Box<Text>,
}

#[derive(Debug, Default)]
struct Text {
    /// What happened.
    what: String,
    /// File, field, row.
    place: String,
    /// Why it matters.
    why: String,
    /// What to do.
    remedy: String,
}

impl Failure {
    /// A failure without place, reason and remedy.
    pub fn new(class: Class, id: &'static str, what: impl Into<String>) -> Self {
        Self { class, id, text: Box::new(Text { what: what.into(), ..Text::default() }) }
    }

    /// Wrong use of the command line.
    pub fn usage(what: impl Into<String>) -> Self {
        Self::new(Class::Usage, "usage", what)
    }

    /// A failed system call on a path; `action` completes "cannot …".
    pub fn io(action: &str, path: &Path, source: &io::Error) -> Self {
        Self::new(Class::Io, "io", format!("cannot {action}: {source}")).place(path.display()).remedy(remedy_of(source))
    }

    /// Whether ranks could not talk to each other.
    pub fn is_of_ranks(&self) -> bool {
        self.id == RANKS
    }

    /// What happened, and where.
    pub fn message(&self) -> String {
        let Text { what, place, .. } = self.text.as_ref();
        if place.is_empty() { what.clone() } else { format!("{what} (in {place})") }
    }

    /// Adds where it happened.
    pub fn place(mut self, place: impl fmt::Display) -> Self {
        self.text.place = place.to_string();
        self
    }

    /// Adds why it matters.
    pub fn why(mut self, why: impl fmt::Display) -> Self {
        self.text.why = why.to_string();
        self
    }

    /// Adds what to do after that.
    pub fn then(mut self, remedy: impl fmt::Display) -> Self {
        let first = &mut self.text.remedy;
        *first = if first.is_empty() { remedy.to_string() } else { format!("{first}; {remedy}") };
        self
    }

    /// Adds what to do.
    pub fn remedy(mut self, remedy: impl fmt::Display) -> Self {
        self.text.remedy = remedy.to_string();
        self
    }

    /// A metric that refuses its images. Where tOF leaves out too much of them, the option that keeps it.
    fn of_metric(what: String, source: &MetricError) -> Self {
        let failure = Self::new(Class::Data, "data.metric", what);
        let keep = match source {
            MetricError::TooFewFrames { metric: "tOF", .. } => "keep the first and last frames with --no-trim",
            MetricError::TooSmall { metric: "cropped tOF", .. } => "keep the border with --no-crop",
            _ => return failure,
        };
        failure.remedy(format!("{keep}, or {WITHOUT_TOF}"))
    }
}

impl From<ShareError> for Failure {
    fn from(e: ShareError) -> Self {
        match e {
            ShareError::Ranks(_) => Self::new(Class::Io, RANKS, e.to_string()),
            ShareError::Rank { code, .. } => Self::new(Class::of_code(code), "rank", e.to_string())
                .why("all ranks work on one result")
                .remedy("see that every machine reads the same files at the same paths"),
        }
    }
}

impl fmt::Display for Failure {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Text { what, place, why, remedy } = self.text.as_ref();
        write!(f, "error[{}]: {what}", self.id)?;
        for (label, text) in [("in  ", place), ("why ", why), ("do  ", remedy)] {
            if !text.is_empty() {
                write!(f, "\n  {label} {text}")?;
            }
        }
        Ok(())
    }
}

/// What to do about an error of the operating system.
fn remedy_of(source: &io::Error) -> &'static str {
    match source.kind() {
        ErrorKind::NotFound => "check the path",
        ErrorKind::PermissionDenied | ErrorKind::ReadOnlyFilesystem => "check the permissions of the path",
        ErrorKind::StorageFull | ErrorKind::QuotaExceeded => "make space on the disk, or choose a path on another one",
        _ => "check the path, its permissions and the space on the disk",
    }
}

const LAYOUT_REMEDY: &str = "give the folder that holds the cameras, or name its layout with --set data.layout=NAME";

impl From<DataError> for Failure {
    fn from(e: DataError) -> Self {
        Self::new(Class::of_code(e.exit_code()), e.code(), e.to_string())
            .place(e.place().map_or(String::new(), |p| p.to_string()))
            .why(e.why())
            .remedy(if matches!(e, DataError::Layout { .. }) { LAYOUT_REMEDY.to_owned() } else { e.fix() })
    }
}

impl From<ConfigError> for Failure {
    fn from(e: ConfigError) -> Self {
        Self::new(Class::Usage, "config", e.to_string())
            .why("a setting that is not understood would train with its default in silence")
            .remedy("gs4d config METHOD lists every setting with its default and kind")
    }
}

impl From<IoError> for Failure {
    fn from(e: IoError) -> Self {
        let (class, id) = match &e {
            IoError::Os { source, .. } if source.kind() == ErrorKind::NotFound => (Class::Io, "io.missing"),
            IoError::Os { .. } | IoError::Exists { .. } | IoError::Full { .. } => (Class::Io, "io"),
            IoError::Limit { .. } => (Class::Resource, "limits.file"),
            IoError::Unsupported { .. } => (Class::Data, "data.unsupported"),
            _ => (Class::Data, "data.file"),
        };
        let failure = Self::new(class, id, e.to_string());
        match &e {
            IoError::Os { source, .. } | IoError::Full { source, .. } => failure.remedy(remedy_of(source)),
            _ => failure,
        }
    }
}

impl From<CheckpointError> for Failure {
    fn from(e: CheckpointError) -> Self {
        if let CheckpointError::NoneUsable { dir, skipped } = &e
            && skipped.is_empty()
        {
            return Self::new(Class::Data, "checkpoint.none", format!("there is no checkpoint in {}", dir.display()))
                .why("nothing can be rendered or gone on with")
                .remedy("bring it back if there was one, or begin the run anew: gs4d train with -f");
        }
        let (class, id, remedy) = match &e {
            CheckpointError::Io { source, .. } => (Class::Io, "checkpoint.io", remedy_of(source)),
            CheckpointError::Write(_) => (Class::Io, "checkpoint.io", "check the path and the space on the disk"),
            CheckpointError::Damaged { .. } | CheckpointError::NoneUsable { .. } => {
                (Class::Data, "checkpoint.damaged", "use an older checkpoint of the run, or train again")
            }
            CheckpointError::Version { .. } => (Class::Data, "checkpoint.version", "use the program that wrote it"),
            CheckpointError::Tensor { .. } => {
                (Class::Data, "checkpoint.tensor", "the run is of another method or version")
            }
            CheckpointError::State(_) => (Class::Internal, "checkpoint.state", "please report this"),
        };
        Self::new(class, id, e.to_string()).remedy(remedy)
    }
}

impl From<MethodError> for Failure {
    fn from(e: MethodError) -> Self {
        let class = match e {
            MethodError::Data(e) => return (*e).into(),
            MethodError::Device(e) => return e.into(),
            MethodError::Render(_) => return Self::new(Class::Data, "method.moment", e.to_string()),
            MethodError::Loss(_) => return Self::new(Class::Numeric, "numeric", e.to_string()),
            MethodError::Scene(_) | MethodError::Cloud(_) => Class::Data,
            _ => Class::Usage,
        };
        Self::new(class, "method", e.to_string())
            .remedy("gs4d methods lists methods and presets, gs4d config METHOD settings")
    }
}

impl From<TrainError> for Failure {
    fn from(e: TrainError) -> Self {
        match e {
            TrainError::Data(e) => e.into(),
            TrainError::Method(e) => e.into(),
            TrainError::Numeric { step, view, what } => {
                Self::new(Class::Numeric, "numeric", format!("step {step}, view {view}: {what}"))
                    .why("what is not finite spreads to everything it touches")
                    .remedy("lower the learning rates; what was saved before is good")
            }
            TrainError::State(_) => Self::new(Class::Data, "checkpoint.state", e.to_string())
                .remedy("resume with the data and the version the run began with"),
            TrainError::Rank { code, .. } => Self::new(Class::of_code(code), "rank", e.to_string())
                .why("all ranks make every step together")
                .remedy("see that every machine reads the same data at the same path, and resume from the last checkpoint, if one was saved"),
            TrainError::Ranks(_) => Self::new(Class::Io, RANKS, e.to_string()),
            TrainError::Diverged { .. } => Self::new(Class::Internal, "ranks.diverged", e.to_string()),
            TrainError::Finished(_) => {
                Self::new(Class::Usage, "finished", e.to_string()).remedy("gs4d resume RUN --steps N")
            }
        }
    }
}

impl From<EvalError> for Failure {
    fn from(e: EvalError) -> Self {
        match e {
            EvalError::Data(e) => e.into(),
            EvalError::Device(e) => e.into(),
            EvalError::Rank(e) => e.into(),
            EvalError::NoViews(_) => Self::new(Class::Data, "data.split", e.to_string()),
            EvalError::Method { .. } => Self::new(Class::Data, "method.moment", e.to_string()),
            EvalError::Metric { .. } => Self::new(Class::Data, "data.metric", e.to_string()),
        }
    }
}

impl From<FolderError> for Failure {
    fn from(e: FolderError) -> Self {
        let text = e.to_string();
        match e {
            FolderError::List { folder, source } => Self::io("list the folder", &folder, &source),
            FolderError::Empty { folder, .. } => Self::new(Class::Data, "data.empty", text)
                .place(folder.display())
                .remedy("give the folder that holds the images themselves"),
            FolderError::SameName { first, .. } => Self::new(Class::Data, "data.names", text)
                .place(first.display())
                .why("images belong together by name, whatever their extension")
                .remedy("remove one of them"),
            FolderError::Unpaired { folder, .. } => Self::new(Class::Data, "data.missing", text)
                .place(folder.display())
                .why("a mean over fewer images than given is another number")
                .remedy("add the missing files, or remove their partners"),
            FolderError::Image { path, remedy, .. } => {
                Self::new(Class::Data, "data.image", text).place(path.display()).remedy(remedy)
            }
            FolderError::Io(e) => e.into(),
            FolderError::Metric { path, source } => Self::of_metric(text, &source).place(path.display()),
        }
    }
}

impl From<ForecastError> for Failure {
    fn from(e: ForecastError) -> Self {
        let text = e.to_string();
        match e {
            ForecastError::Eval(e) => e.into(),
            ForecastError::NoView { .. } => Self::new(Class::Data, "data.view", text),
            ForecastError::Empty { .. } => Self::usage(text).remedy(
                "give a later --until, or an earlier --from; times are normalised: the last training time is 1, or data.time_boundary",
            ),
            ForecastError::Frames { .. } => {
                Self::usage(text).remedy("say how many with --frames, or how many per unit of the data's clock with --fps")
            }
        }
    }
}

impl From<TemporalError> for Failure {
    fn from(e: TemporalError) -> Self {
        let text = e.to_string();
        let no_video = |why: &str, choose: &str| {
            let remedy = format!("{WITHOUT_TOF}, or choose a split {choose} with --split");
            Self::new(Class::Data, "data.video", text.as_str()).why(why).remedy(remedy)
        };
        match e {
            TemporalError::Data(e) => e.into(),
            TemporalError::Method(e) => e.into(),
            TemporalError::Place(e) => e.into(),
            TemporalError::NoVideo(_) => no_video("flow is that from one frame to the next", "of more views"),
            TemporalError::Cameras { .. } => {
                no_video("between two cameras the picture moves, whatever the scene does", "of one camera")
            }
            TemporalError::SameTime { .. } => {
                no_video("no time passes between them, so there is no motion", "whose times differ")
            }
            TemporalError::Sparse { .. } => {
                no_video("flow between views that do not follow each other is noise", "whose times lie closer")
            }
            TemporalError::Metric { source, .. } => Self::of_metric(text, &source),
        }
    }
}

impl From<RunError> for Failure {
    fn from(e: RunError) -> Self {
        let text = e.to_string();
        match e {
            RunError::Occupied { is_run, .. } => {
                Self::new(Class::Io, "io.exists", text).why("nothing is overwritten unless asked").remedy(if is_run {
                    "choose another folder with -o, pass -f, or go on with gs4d resume"
                } else {
                    "choose another folder with -o"
                })
            }
            RunError::OtherSettings { .. } => Self::new(Class::Io, "io.exists", text)
                .why("nothing is overwritten unless asked")
                .remedy("choose another folder with -o, or pass -f"),
            RunError::Unfinished { .. } => Self::new(Class::Data, "run", text).remedy("gs4d resume goes on with it"),
            RunError::InRounds { .. } => Self::new(Class::Usage, "rounds", text),
            RunError::NotARun { .. } => {
                Self::new(Class::Data, "run", text).remedy("give the folder that gs4d train -o made")
            }
            RunError::SplatFile { .. } => Self::new(Class::Data, "run", text)
                .why("it has one moment, no method and no data")
                .remedy("give the run folder, or a .gs4d file that gs4d export made"),
            RunError::NoViews { .. } => {
                Self::new(Class::Data, "data.split", text).remedy("choose one of these with --split")
            }
            RunError::NoSettings { .. } => {
                Self::new(Class::Data, "run", text).remedy("give the run folder, or a .gs4d file that gs4d export made")
            }
            RunError::DataGone { .. } => {
                Self::new(Class::Data, "data.path", text).remedy("say where they are with --data DIR")
            }
            RunError::Static { .. } => Self::new(Class::Data, "data.static", text)
                .remedy("give times: --set data.time_from=name (the last number of each file name) or order; or train a method without motion: -m static3d"),
            RunError::DataChanged { run, .. } => Self::new(Class::Data, "data.changed", text)
                .why("the run would not be the one that it says it is")
                .remedy(format!(
                    "bring the data back, or accept them with gs4d resume {} --accept-changed-data, which provenance.json keeps",
                    run.display()
                )),
            RunError::SettingsChanged { path } => {
                let config = gs4d_run::shell_quoted(path.display().to_string());
                Self::new(Class::Data, "run.settings", text)
                    .why("a run goes on with the settings that it began with; its report states them for all of its steps")
                    .remedy(format!("restore the file, or begin another run with it: gs4d train DATA -m METHOD -o NEW --config {config}"))
            }
            RunError::OtherMethod { .. } => {
                Self::new(Class::Data, "checkpoint.method", text).remedy("move the file out of the run")
            }
            RunError::Memory { .. } => Self::new(Class::Resource, "limits.memory", text)
                .why("a program that takes all memory is ended by the system, with whatever else is running")
                .remedy("make pictures smaller or splats fewer, or allow more with --max-mem MIB"),
            RunError::Busy { .. } => Self::new(Class::Io, "run.busy", text).remedy("wait for it, or stop it"),
            RunError::Steps(_) => Self::new(Class::Usage, "steps", text),
            RunError::Rounds(_) => Self::new(Class::Usage, "rounds", text),
            RunError::Os { source, .. } => Self::new(Class::Io, "io", text).remedy(remedy_of(&source)),
            RunError::Report(_) => Self::new(Class::Internal, "report", text),
            RunError::Io(e) => e.into(),
            RunError::Config(e) => e.into(),
            RunError::Data(e) => e.into(),
            RunError::Method(e) => e.into(),
            RunError::Checkpoint(e) => e.into(),
            RunError::Train(e) => e.into(),
            RunError::Eval(e) => e.into(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use gs_train::error::RanksError;

    /// What keeps views from being a video is remedied each in its way; other errors as elsewhere.
    #[test]
    fn errors_of_videos_have_remedies_of_their_own() {
        let (first, second) = ("a".to_owned(), "b".to_owned());
        let of_videos = [
            TemporalError::NoVideo(1),
            TemporalError::Cameras { first: first.clone(), second: second.clone() },
            TemporalError::SameTime { first, second },
            TemporalError::Sparse { gap: 0.5, step: 0.1 },
        ]
        .map(Failure::from);
        assert!(of_videos.iter().all(|f| f.id == "data.video" && f.text.remedy.contains("--split")));
        let mut remedies: Vec<&str> = of_videos.iter().map(|f| f.text.remedy.as_str()).collect();
        remedies.sort_unstable();
        remedies.dedup();
        assert_eq!(remedies.len(), of_videos.len(), "{remedies:?}");

        let unreadable = || MethodError::Render("an input image cannot be read".into());
        let unplaced = || EvalError::NoViews("test");
        for (got, want) in [
            (Failure::from(TemporalError::Method(unreadable())), Failure::from(unreadable())),
            (Failure::from(TemporalError::Place(unplaced())), Failure::from(unplaced())),
        ] {
            assert_eq!((got.class, got.to_string()), (want.class, want.to_string()));
        }
    }

    /// Frames of views and of folders alike: an option of tOF helps tOF alone.
    #[test]
    fn frames_that_tof_refuses_are_remedied_by_its_options() {
        let of_views = |source| Failure::from(TemporalError::Metric { view: "a".into(), source });
        let of_folders = |source| Failure::from(FolderError::Metric { path: "a".into(), source });
        let small = |metric| MetricError::TooSmall { metric, need: 48, width: 47, height: 64, hint: "" };
        for of in [&of_views as &dyn Fn(MetricError) -> Failure, &of_folders] {
            let short = of(MetricError::TooFewFrames { metric: "tOF", got: 5, need: 6 });
            assert!(short.text.remedy.contains("--no-trim") && !short.text.remedy.contains("--no-crop"), "{short}");
            let cropped = of(small("cropped tOF"));
            let remedy = &cropped.text.remedy;
            assert!(remedy.contains("--no-crop") && !remedy.contains("--no-trim"), "{cropped}");
            let spoilt = MetricError::NotFinite { which: "a", x: 0, y: 0, channel: 0 };
            for other in [of(small("LPIPS")), of(spoilt)] {
                assert!(other.id == "data.metric" && other.text.remedy.is_empty(), "{other}");
            }
        }
    }

    /// Ranks that are out of step must not be told anything: whatever such an error passes through, it is known.
    #[test]
    fn ranks_that_cannot_talk_are_told_from_a_rank_that_fails() {
        let error = || RanksError { what: "rank 1 is gone".into() };
        let shared = || EvalError::Rank(ShareError::Ranks(error()));
        let trained = || RunError::Train(TrainError::Ranks(error()));
        for failure in
            [Failure::from(shared()), Failure::from(RunError::Eval(shared())), Failure::from(trained()).then("go on")]
        {
            assert!(failure.is_of_ranks(), "{failure}");
        }
        let (rank, what, code) = (1, "an image is missing".to_owned(), 3);
        let other = Failure::from(ShareError::Rank { rank, what: what.clone(), code });
        assert!(!other.is_of_ranks() && !Failure::from(TrainError::Rank { rank, what, code }).is_of_ranks());
    }
}
