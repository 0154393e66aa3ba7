//! Presets as they were kept in `docs/presets`, against those of this program.

use super::{DocumentError, read};
use gs_train::registry::Registry;
use gs4d_run::config::Config;
use gs4d_run::settings::with_preset;
use std::collections::BTreeMap;
use std::path::Path;

/// Kept presets, read once.
pub(super) struct Presets<'a> {
    root: &'a Path,
    registry: &'a Registry,
    known: BTreeMap<String, (String, Option<String>)>,
}

impl<'a> Presets<'a> {
    /// Those of the repository `root`, none of them read yet.
    pub(super) fn new(root: &'a Path, registry: &'a Registry) -> Self {
        Self { root, registry, known: BTreeMap::new() }
    }

    /// How `METHOD:PRESET` differs from what had this digest; `None` if it does not.
    pub(super) fn difference(&mut self, preset: &str, digest: &str) -> Result<Option<String>, DocumentError> {
        if !self.known.contains_key(preset) {
            let state = self.state(preset)?;
            self.known.insert(preset.to_owned(), state);
        }
        let (kept, changed) = &self.known[preset];
        Ok(if kept == digest { changed.clone() } else { Some(format!("the kept settings have the digest {kept}")) })
    }

    /// Fails if there is no such preset.
    pub(super) fn exists(&self, preset: &str) -> Result<(), DocumentError> {
        let (method, name) = named(preset);
        with_preset(self.registry, method, name)?;
        Ok(())
    }

    /// The digest of the kept settings, and how the present ones differ from them.
    fn state(&self, preset: &str) -> Result<(String, Option<String>), DocumentError> {
        let (method, name) = named(preset);
        let file = self.root.join(format!("docs/presets/{method}-{name}.toml"));
        let kept = values(&Config::of_toml(&read(&file)?)?);
        let now = values(&with_preset(self.registry, method, name)?);
        let differs = |(key, then): (&String, &String)| match now.get(key) {
            Some(now) if now == then => None,
            Some(now) => Some(format!("{key} was {then}, is {now}")),
            None => Some(format!("{key} is gone")),
        };
        let all: Vec<String> = kept.iter().filter_map(differs).collect();
        Ok((digest(&kept), (!all.is_empty()).then(|| all.join("; "))))
    }
}

/// Method and preset of `METHOD:PRESET`.
fn named(preset: &str) -> (&str, &str) {
    preset.split_once(':').unwrap_or((preset, "fast"))
}

/// The settings of a method by key, those of the run and of the data left out.
pub(super) fn values(config: &Config) -> BTreeMap<String, String> {
    let own = config.iter().filter(|(key, _)| !key.starts_with("run.") && !key.starts_with("data."));
    own.map(|(key, setting)| (key.to_owned(), setting.value.to_string())).collect()
}

/// CRC-32 of the settings, eight hexadecimal digits.
pub(super) fn digest(values: &BTreeMap<String, String>) -> String {
    let text: String = values.iter().map(|(key, value)| format!("{key}={value}\n")).collect();
    format!("{:08x}", crc32fast::hash(text.as_bytes()))
}
