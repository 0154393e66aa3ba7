//! What the scores of an entry are of: they can be compared where it is the same.

use gs_data::{Dataset, View};
use gs4d_run::Resolved;
use gs4d_run::config::ConfigError;

const BACKGROUND: &str = "schedule.background";

/// Images that are scored, and what lies behind them.
#[derive(PartialEq)]
pub(super) struct Scene {
    /// None where images cover it.
    background: Option<String>,
    /// Name, size and time of every view: held-out ones, or those of training where there are none; then later ones.
    views: [Vec<(String, [u32; 2], u32)>; 2],
}

impl Scene {
    /// What these settings score on these data, which they have read.
    pub(super) fn of(resolved: &Resolved, data: &Dataset) -> Self {
        // Training over random colours is scored over black.
        let stated = resolved.config.get(BACKGROUND).and_then(|s| s.value.as_str());
        let background = stated.map_or("black", |b| if b == "random" { "black" } else { b }).to_owned();
        let scored = if data.test.is_empty() { &data.train } else { &data.test };
        let seen = data.has_alpha || scored.iter().chain(&data.extrapolate).any(|v| v.cut_out);
        let view = |v: &View| (v.name.clone(), [v.camera.width, v.camera.height], v.time.normalised.to_bits());
        let views = [scored, &data.extrapolate].map(|views| views.iter().map(view).collect());
        Self { background: Some(background).filter(|_| seen), views }
    }

    /// Fails if the scores of another entry are of something else than those of the entry `label`.
    pub(super) fn same(&self, label: &str, other: &Self) -> Result<(), ConfigError> {
        let differs = |what: String| {
            Err(ConfigError::Invalid(format!("scores are not of the same images as those of {label}: {what}")))
        };
        if let (Some(own), Some(theirs)) = (&self.background, &other.background)
            && own != theirs
        {
            return differs(format!("{BACKGROUND} is {own} and {theirs}; set one for all entries"));
        }
        match self.views == other.views {
            true => Ok(()),
            false => differs("views differ in number, size or time; set data.* alike for all entries".into()),
        }
    }
}
