//! The methods a program offers, by name.

use crate::method::{MethodEntry, MethodError};

/// A list of methods with different names. A program builds it from the crates it depends on and hands it to whatever builds
/// methods: the trainer, the loading of checkpoints, the resolution of settings.
#[derive(Clone, Debug, Default)]
pub struct Registry(Vec<MethodEntry>);

impl Registry {
    /// The methods in this order; of entries with the same name the last one counts.
    pub fn new(entries: Vec<MethodEntry>) -> Self {
        let mut list: Vec<MethodEntry> = Vec::new();
        for entry in entries {
            match list.iter_mut().find(|e| e.name == entry.name) {
                Some(old) => *old = entry,
                None => list.push(entry),
            }
        }
        Self(list)
    }

    /// The method of that name.
    ///
    /// # Errors
    /// If there is none; the error lists the names there are.
    pub fn find(&self, name: &str) -> Result<&MethodEntry, MethodError> {
        self.0.iter().find(|m| m.name == name).ok_or_else(|| {
            let known: Vec<&str> = self.0.iter().map(|m| m.name).collect();
            MethodError::Unknown { name: name.to_owned(), known: known.join(", ") }
        })
    }

    /// All methods, in the order they were given.
    pub fn iter(&self) -> std::slice::Iter<'_, MethodEntry> {
        self.0.iter()
    }
}

/// Registries are equal if they name the same methods in the same order.
impl PartialEq for Registry {
    fn eq(&self, other: &Self) -> bool {
        self.iter().map(|m| m.name).eq(other.iter().map(|m| m.name))
    }
}

impl<'a> IntoIterator for &'a Registry {
    type Item = &'a MethodEntry;
    type IntoIter = std::slice::Iter<'a, MethodEntry>;

    fn into_iter(self) -> Self::IntoIter {
        self.iter()
    }
}
