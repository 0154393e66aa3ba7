//! Why a method cannot be built, trained or rendered, and why a schedule cannot be followed.

use std::path::PathBuf;

/// A method that cannot be built, trained or rendered.
#[derive(Debug, thiserror::Error)]
pub enum MethodError {
    /// No method of that name.
    #[error("there is no method `{name}`; choose one of {known}")]
    Unknown {
        /// Name asked for.
        name: String,
        /// Names there are.
        known: String,
    },
    /// The configuration does not fit the method.
    #[error("configuration of method `{method}`: {why}")]
    Config {
        /// Name of the method.
        method: &'static str,
        /// What is wrong, and where.
        why: String,
    },
    /// A setting lies outside its domain.
    #[error("setting `{key}` = {value} of method `{method}` is out of range: it must be from {low} to {high}")]
    Domain {
        /// Name of the method.
        method: &'static str,
        /// Dotted key of the setting.
        key: String,
        /// Value met, as text.
        value: String,
        /// Lowest value allowed.
        low: f64,
        /// Highest value allowed.
        high: f64,
    },
    /// Networks and fields are larger than allowed.
    #[error(
        "the settings of method `{method}` ask for {count} parameters of networks and fields, and at most {limit} are \
         allowed (what a checkpoint holds where one is read): make widths, depths, planes or tables smaller"
    )]
    TooLarge {
        /// Name of the method.
        method: &'static str,
        /// Parameters asked for.
        count: u64,
        /// Parameters allowed.
        limit: u64,
    },
    /// The schedule cannot be followed.
    #[error(transparent)]
    Schedule(#[from] ScheduleError),
    /// The initial points cannot be used.
    #[error(transparent)]
    Cloud(#[from] gs_core::cloud::CloudError),
    /// The images the first points are carved from cannot be read.
    #[error(transparent)]
    Data(Box<gs_data::DataError>),
    /// The data show no person with a template.
    #[error(
        "method `{method}` needs a filmed person with template and poses (layout avatar), and {} holds none; make one \
         with `gs4d synth avatar`, or choose another method",
        if folder.as_os_str().is_empty() { "the data set".into() } else { folder.display().to_string() }
    )]
    NoAvatar {
        /// Name of the method.
        method: &'static str,
        /// The folder of the data.
        folder: PathBuf,
    },
    /// A timestamp cannot be made into splats: an input image that cannot be read, say.
    #[error("{0}")]
    Render(String),
    /// The device that renders failed.
    #[error(transparent)]
    Device(#[from] gs_raster::DeviceError),
    /// The image loss of a training view is not finite or not defined.
    #[error(transparent)]
    Loss(Box<gs_metrics::MetricError>),
    /// Row blocks that belong together do not fit each other.
    #[error(transparent)]
    Rows(#[from] gs_core::param::RowEditError),
    /// The scene or its initial points cannot be used.
    #[error("scene: {0}")]
    Scene(String),
}

impl From<gs_data::DataError> for MethodError {
    fn from(e: gs_data::DataError) -> Self {
        Self::Data(Box::new(e))
    }
}

impl From<gs_metrics::MetricError> for MethodError {
    fn from(e: gs_metrics::MetricError) -> Self {
        Self::Loss(Box::new(e))
    }
}

/// A schedule that cannot be followed.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("schedule: {field} = {value} is out of range; {rule}")]
pub struct ScheduleError {
    /// Name of the field.
    pub field: String,
    /// Value met.
    pub value: f64,
    /// What it must satisfy.
    pub rule: &'static str,
}

/// Ranks that cannot talk to each other.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("ranks cannot talk to each other: {what}; resume from the last checkpoint, if one was saved")]
pub struct RanksError {
    /// What was noticed.
    pub what: String,
}

impl RanksError {
    /// A message of a rank that ends too early, or says something else.
    pub(crate) fn short(rank: usize) -> Self {
        Self {
            what: format!("the message of rank {rank} is not the one expected; all ranks must run the same program"),
        }
    }
}
