//! Entries of a contest: a method with its own settings.

/// Most letters of a folder's name; file systems take 255.
const LONGEST_NAME: usize = 120;

/// One entry of a contest: `METHOD[:PRESET] [KEY=VALUE …]`.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Entry {
    /// The parsed text with single spaces; the name of the entry in tables.
    pub label: String,
    pub(super) method: String,
    pub(super) preset: Option<String>,
    pub(super) sets: Vec<String>,
}

impl Entry {
    /// A method with the preset of the contest and no settings of its own.
    pub fn new(method: &str) -> Self {
        Self { label: method.to_owned(), method: method.to_owned(), preset: None, sets: Vec::new() }
    }

    /// The same entry with one more setting `KEY=VALUE`.
    pub(crate) fn with(&self, set: String) -> Self {
        let label = format!("{} {set}", self.label);
        Self { label, sets: self.sets.iter().cloned().chain([set]).collect(), ..self.clone() }
    }

    /// Parses `METHOD[:PRESET] [KEY=VALUE …]`.
    ///
    /// # Errors
    /// If there is no method, or a word after it is no `KEY=VALUE`.
    ///
    /// ```
    /// use gs4d_lab::contest::Entry;
    /// assert_eq!(Entry::parse("fags:tiny  ablate=gate").unwrap().label, "fags:tiny ablate=gate");
    /// assert!(Entry::parse("fags quick").is_err());
    /// ```
    pub fn parse(text: &str) -> Result<Self, String> {
        let mut words = text.split_whitespace();
        let name = words.next().ok_or("an entry begins with a method, for example \"fourdgs\"")?;
        let (method, preset) = match name.split_once(':') {
            Some((method, preset)) => (method, Some(preset.to_owned())),
            None => (name, None),
        };
        let sets: Vec<String> = words.map(str::to_owned).collect();
        if let Some(bad) = sets.iter().find(|s| !s.contains('=')) {
            return Err(format!("`{bad}` in the entry \"{text}\" is no KEY=VALUE"));
        }
        let label = std::iter::once(name).chain(sets.iter().map(String::as_str)).collect::<Vec<_>>().join(" ");
        Ok(Self { label, method: method.to_owned(), preset, sets })
    }

    /// Name of the folder of its trials; a long one is cut, and ends with a hash of the label.
    pub(super) fn slug(&self) -> String {
        let plain = |c: char| if c.is_ascii_alphanumeric() || "._-=".contains(c) { c } else { '_' };
        let name: String = self.label.chars().map(plain).collect();
        if name.len() <= LONGEST_NAME {
            return name;
        }
        let hash = crc32fast::hash(self.label.as_bytes());
        let begin: String = name.chars().take(LONGEST_NAME - 9).collect();
        format!("{begin}-{hash:08x}")
    }
}
