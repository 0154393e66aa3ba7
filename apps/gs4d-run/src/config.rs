//! Settings that know the source of every value.
//!
//! A [`Config`] is a tree of TOML values, kept flat by dotted key (`density.until`). It starts from the defaults, which
//! also fix which keys exist and of what kind they are, and is then overlaid: defaults ← preset ← file ← flag. An
//! unknown key is an error that names the nearest one, so a typing error never trains with a default silently.
//!
//! ```
//! use gs4d_run::config::Config;
//!
//! let mut config = Config::of_toml("[density]\nuntil = 15000  # last step\n")?;
//! config.set("density.until=500")?;
//! let setting = config.get("density.until").unwrap();
//! assert_eq!(setting.source.to_string(), "flag --set density.until=500");
//! assert!(config.set("density.untill=1").unwrap_err().to_string().contains("did you mean `density.until`?"));
//! # Ok::<(), gs4d_run::config::ConfigError>(())
//! ```

use gs_core::cast;
use serde::de::DeserializeOwned;
use std::collections::BTreeMap;
use std::fmt::{self, Write as _};
use toml::{Table, Value};

/// The source of a value.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Source {
    /// A default of the program.
    Default,
    /// The preset of this name.
    Preset(String),
    /// The file of this path.
    File(String),
    /// A flag of the command line, as written.
    Flag(String),
    /// A length in steps that another source states for a run of another length: what it states, in words.
    Scaled(String),
}

impl fmt::Display for Source {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Source::Default => write!(f, "default"),
            Source::Preset(name) => write!(f, "preset {name}"),
            Source::File(name) => write!(f, "file {name}"),
            Source::Flag(text) => write!(f, "flag {text}"),
            Source::Scaled(text) => write!(f, "{text}"),
        }
    }
}

/// A value with its source.
#[derive(Clone, Debug, PartialEq)]
pub struct Setting {
    /// The value, of the type that its default has.
    pub value: Value,
    /// Where the value was set.
    pub source: Source,
    /// Meaning and published source of the default; empty without a comment in the defaults.
    pub about: String,
}

/// A tree of settings by dotted key.
#[derive(Clone, Debug, PartialEq)]
pub struct Config {
    settings: BTreeMap<String, Setting>,
    /// Keys that may be given but have no default, with an example of their kind and what they are.
    optional: BTreeMap<String, (Value, String)>,
}

/// Settings that are not valid.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ConfigError {
    /// No setting has this key.
    #[error("unknown setting `{key}` ({origin}){}", hint(near))]
    Unknown {
        /// The key as it was given.
        key: String,
        /// Where the key was given.
        origin: Source,
        /// The nearest key, or the keys of the section.
        near: Vec<String>,
    },
    /// The value has the wrong type.
    #[error("setting `{key}` ({origin}) must be {want}, got {got}")]
    Kind {
        /// Dotted key of the setting.
        key: String,
        /// Where the value was given.
        origin: Source,
        /// The type needed, in words.
        want: &'static str,
        /// The value as it was given.
        got: String,
    },
    /// The text is not TOML.
    #[error("{origin}: {why}")]
    Syntax {
        /// Where the text was given.
        origin: Source,
        /// The parser's reason, with line and column.
        why: String,
    },
    /// Not of the form `key=value`.
    #[error("`{0}` is not of the form key=value, for example schedule.density.until=5000")]
    Assignment(String),
    /// The values do not make a valid configuration (a negative count, an unknown choice).
    #[error("settings are not valid: {0}")]
    Invalid(String),
}

fn hint(near: &[String]) -> String {
    match near {
        [] => String::new(),
        [one] => format!("; did you mean `{one}`?"),
        many => format!("; its keys are {}", many.join(", ")),
    }
}

impl Config {
    /// Defaults written as TOML; the comment behind a value becomes its [`Setting::about`].
    ///
    /// # Errors
    /// If the text is not TOML.
    pub fn of_toml(text: &str) -> Result<Self, ConfigError> {
        let mut config = Self::of_table(&parse(text, &Source::Default)?);
        config.describe(text);
        Ok(config)
    }

    /// The comments behind the values of a TOML text become their [`Setting::about`]; a value without one has none.
    pub(crate) fn describe(&mut self, text: &str) {
        for (key, about) in comments(text) {
            if let Some(setting) = self.settings.get_mut(&key) {
                setting.about = about;
            } else if let Some(optional) = self.optional.get_mut(&key) {
                optional.1 = about;
            }
        }
    }

    /// Defaults as a table.
    pub(crate) fn of_table(table: &Table) -> Self {
        let setting = |value| Setting { value, source: Source::Default, about: String::new() };
        let settings = flatten(table).into_iter().map(|(k, v)| (k, setting(v))).collect();
        Self { settings, optional: BTreeMap::new() }
    }

    /// Declares a key that has no value until it is given one, of the kind of `example`; nothing where it has a value. It is listed
    /// once it is described.
    pub fn allow(&mut self, key: &str, example: impl Into<Value>) {
        if !self.settings.contains_key(key) {
            self.optional.insert(key.to_owned(), (example.into(), String::new()));
        }
    }

    /// The value, or else the example, that defines the type of a key.
    fn model(&self, key: &str) -> Option<&Value> {
        self.settings.get(key).map(|s| &s.value).or_else(|| self.optional.get(key).map(|o| &o.0))
    }

    /// All keys, those with a value last.
    fn keys(&self) -> impl Iterator<Item = &String> {
        self.optional.keys().chain(self.settings.keys())
    }

    /// Overlays a TOML text.
    ///
    /// # Errors
    /// If it is not TOML, names an unknown key or gives a value of another kind; nothing is changed then.
    pub fn overlay_toml(&mut self, text: &str, source: &Source) -> Result<(), ConfigError> {
        self.overlay(&parse(text, source)?, source)
    }

    /// Overlays a table.
    ///
    /// # Errors
    /// If it names an unknown key or gives a value of another kind; nothing is changed then.
    pub fn overlay(&mut self, table: &Table, source: &Source) -> Result<(), ConfigError> {
        let mut checked = Vec::new();
        for (key, value) in flatten(table) {
            checked.push((key.clone(), self.checked(&key, value, source)?));
        }
        for (key, value) in checked {
            self.store(&key, value, source);
        }
        Ok(())
    }

    /// Overlays one `key=value`. The value is TOML; a bare word is taken as a string where a string is needed.
    ///
    /// # Errors
    /// If it is not of that form, names an unknown key or gives a value of another kind.
    pub fn set(&mut self, assignment: &str) -> Result<(), ConfigError> {
        let source = Source::Flag(format!("--set {assignment}"));
        let (key, text) = assignment.split_once('=').ok_or_else(|| ConfigError::Assignment(assignment.to_owned()))?;
        let (key, text) = (key.trim(), text.trim());
        if key.is_empty() || text.is_empty() {
            return Err(ConfigError::Assignment(assignment.to_owned()));
        }
        let wants_text = self.model(key).ok_or_else(|| self.unknown(key, &source))?.is_str();
        let value = match text.parse::<Value>() {
            Ok(value) if !wants_text || value.is_str() => value,
            _ if wants_text => Value::String(text.to_owned()),
            Ok(value) => value,
            Err(e) => return Err(ConfigError::Syntax { origin: source, why: e.message().to_owned() }),
        };
        let value = self.checked(key, value, &source)?;
        self.store(key, value, &source);
        Ok(())
    }

    /// Sets one value with its source.
    ///
    /// # Errors
    /// If the key is unknown or the value of another kind.
    pub fn put(&mut self, key: &str, value: impl Into<Value>, source: Source) -> Result<(), ConfigError> {
        let value = self.checked(key, value.into(), &source)?;
        self.store(key, value, &source);
        Ok(())
    }

    /// The setting of a dotted key.
    pub fn get(&self, key: &str) -> Option<&Setting> {
        self.settings.get(key)
    }

    /// All settings in order of their keys.
    pub fn iter(&self) -> impl Iterator<Item = (&str, &Setting)> {
        self.settings.iter().map(|(k, s)| (k.as_str(), s))
    }

    /// All values as a TOML table.
    pub fn table(&self) -> Table {
        let mut root = Table::new();
        for (key, setting) in &self.settings {
            let mut parts: Vec<&str> = key.split('.').collect();
            let leaf = parts.pop().unwrap_or_default();
            let mut at = &mut root;
            for part in parts {
                let next = at.entry(part).or_insert_with(|| Value::Table(Table::new()));
                let Value::Table(table) = next else { unreachable!("a key is either a value or a section") };
                at = table;
            }
            at.insert(leaf.to_owned(), setting.value.clone());
        }
        root
    }

    /// Deserialises the values into a configuration structure.
    ///
    /// # Errors
    /// If a value lies outside what the structure accepts.
    pub fn build<T: DeserializeOwned>(&self) -> Result<T, ConfigError> {
        self.table().try_into().map_err(|e: toml::de::Error| ConfigError::Invalid(e.to_string().trim().to_owned()))
    }

    /// TOML with a comment behind each value that says where it came from (and what it is, if known). Reads back as TOML.
    pub fn to_commented_toml(&self) -> String {
        let mut lines: Vec<(Option<&str>, String, String)> = Vec::new();
        for (key, setting) in &self.settings {
            let (section, leaf) = key.rsplit_once('.').map_or((None, key.as_str()), |(s, l)| (Some(s), l));
            let about = if setting.about.is_empty() { String::new() } else { format!("; {}", setting.about) };
            let line = format!("{leaf} = {}", show(&setting.value));
            lines.push((section, line, format!("# {}{about}", setting.source).replace(['\n', '\r'], " ")));
        }
        let described =
            |(key, (_, about)): &(&String, &(Value, String))| !about.is_empty() && !self.settings.contains_key(*key);
        for (key, (example, about)) in self.optional.iter().filter(described) {
            let (section, leaf) = key.rsplit_once('.').map_or((None, key.as_str()), |(s, l)| (Some(s), l));
            lines.push((section, format!("# {leaf} = {}", show(example)), format!("# not set; {about}")));
        }
        // Values of a section must not follow those of its subsections, and those without a section come first.
        lines.sort_by(|a, b| a.0.cmp(&b.0));
        let width = lines.iter().map(|l| l.1.chars().count()).max().unwrap_or(0).min(48);
        let mut out = String::new();
        let mut open = None;
        for (section, line, comment) in lines {
            if section != open {
                let blank = if out.is_empty() { "" } else { "\n" };
                let _ = writeln!(out, "{blank}[{}]", section.unwrap_or_default());
                open = section;
            }
            let _ = writeln!(out, "{line:width$}  {comment}");
        }
        out
    }

    fn store(&mut self, key: &str, value: Value, source: &Source) {
        let about = self.settings.get(key).map(|s| s.about.clone()).unwrap_or_default();
        self.settings.insert(key.to_owned(), Setting { value, source: source.clone(), about });
    }

    /// The value in the type of its key: integers become floats where floats are needed.
    fn checked(&self, key: &str, value: Value, source: &Source) -> Result<Value, ConfigError> {
        let Some(model) = self.model(key) else { return Err(self.unknown(key, source)) };
        let wrong = |want| ConfigError::Kind {
            key: key.to_owned(),
            origin: source.clone(),
            want,
            got: show(&value).chars().take(80).collect(),
        };
        match (model, &value) {
            (Value::Float(_), Value::Integer(i)) => Ok(Value::Float(*i as f64)),
            (Value::Float(_), Value::Float(f)) if !f.is_finite() => Err(wrong("a finite number")),
            (Value::Array(old), Value::Array(_)) => {
                like_array(old, &value).ok_or_else(|| wrong("a list of such values"))
            }
            (old, new) if old.same_type(new) => Ok(value),
            (old, _) => Err(wrong(kind(old))),
        }
    }

    fn unknown(&self, key: &str, source: &Source) -> ConfigError {
        let section = format!("{key}.");
        let mut near: Vec<String> = self.keys().filter(|k| k.starts_with(&section)).cloned().collect();
        near.sort();
        near.dedup();
        if near.is_empty() {
            let ranked = self.keys().map(|known| (similarity(known, key), known));
            let nearest =
                ranked.max_by(|([a, whole_a], _), ([b, whole_b], _)| a.total_cmp(b).then(whole_a.total_cmp(whole_b)));
            near.extend(nearest.filter(|([similarity, _], _)| *similarity > 0.6).map(|(_, known)| known.clone()));
        }
        ConfigError::Unknown { key: key.to_owned(), origin: source.clone(), near }
    }
}

/// Similarity of two keys, 0..1: a right name in the wrong section is similar, too; then that of the keys as a whole, which chooses among
/// equally similar ones.
fn similarity(known: &str, given: &str) -> [f64; 2] {
    let leaf = |k: &str| k.rsplit('.').next().unwrap_or_default().to_owned();
    let whole = strsim::normalized_damerau_levenshtein(known, given);
    [whole.max(0.9 * strsim::normalized_damerau_levenshtein(&leaf(known), &leaf(given))), whole]
}

fn parse(text: &str, origin: &Source) -> Result<Table, ConfigError> {
    text.parse::<Table>()
        .map_err(|e| ConfigError::Syntax { origin: origin.clone(), why: e.to_string().trim().to_owned() })
}

/// Leaves by dotted key. Depth is bounded by the parser's own limit.
fn flatten(table: &Table) -> Vec<(String, Value)> {
    let mut leaves = Vec::new();
    let mut open: Vec<(String, &Table)> = vec![(String::new(), table)];
    while let Some((prefix, table)) = open.pop() {
        for (key, value) in table {
            let path = if prefix.is_empty() { key.clone() } else { format!("{prefix}.{key}") };
            match value {
                Value::Table(inner) if !inner.is_empty() => open.push((path, inner)),
                Value::Table(_) => {}
                value => leaves.push((path, value.clone())),
            }
        }
    }
    leaves
}

/// Comments behind values of hand-written TOML, by dotted key; empty where there is none.
fn comments(text: &str) -> Vec<(String, String)> {
    let mut section = String::new();
    let mut found = Vec::new();
    for line in text.lines().map(str::trim) {
        if let Some(name) = line.strip_prefix('[').and_then(|l| l.split(']').next()) {
            section = name.trim().to_owned();
            continue;
        }
        let Some((key, rest)) = line.split_once('=') else { continue };
        // A `#` inside a quoted value opens no comment.
        let after_value = match rest.trim_start().strip_prefix('"') {
            Some(quoted) => quoted.split_once('"').map_or("", |(_, after)| after),
            None => rest,
        };
        let about = after_value.split_once('#').map_or("", |(_, about)| about.trim());
        let key = key.trim();
        let path = if section.is_empty() { key.to_owned() } else { format!("{section}.{key}") };
        found.push((path, about.to_owned()));
    }
    found
}

fn kind(value: &Value) -> &'static str {
    match value {
        Value::String(_) => "a string",
        Value::Integer(_) => "a whole number",
        Value::Float(_) => "a number",
        Value::Boolean(_) => "true or false",
        Value::Datetime(_) => "a date",
        Value::Array(_) => "a list",
        Value::Table(_) => "a section",
    }
}

/// A list whose members are of the kind the old members had (any kind if there were none).
fn like_array(old: &[Value], new: &Value) -> Option<Value> {
    let members = new.as_array()?.iter().map(|v| match (old.first(), v) {
        (Some(Value::Float(_)), Value::Integer(i)) => Some(Value::Float(*i as f64)),
        (Some(Value::Float(_)), Value::Float(f)) if !f.is_finite() => None,
        (Some(o), v) if !o.same_type(v) => None,
        (_, v) => Some(v.clone()),
    });
    members.collect::<Option<Vec<_>>>().map(Value::Array)
}

/// TOML text of a value. A float that is exactly an `f32` is printed with the digits of the `f32`.
fn show(value: &Value) -> String {
    match value {
        Value::Float(f) if f64::from(cast::to_f32(*f)) == *f => {
            Value::Float(cast::to_f32(*f).to_string().parse().unwrap_or(*f)).to_string()
        }
        Value::Array(members) => format!("[{}]", members.iter().map(show).collect::<Vec<_>>().join(", ")),
        other => other.to_string(),
    }
}

#[cfg(test)]
mod tests;
