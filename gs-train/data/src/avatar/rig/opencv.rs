//! OpenCV's YAML (`cv::FileStorage`): matrices, texts and lists by name. Events of a YAML parser, without anchors and deep nesting.

use crate::error::DataError;
use crate::files::read_text;
use saphyr_parser::{Event, Parser, StrInput};
use std::collections::BTreeMap;
use std::path::Path;

/// Largest file; one camera takes a kilobyte.
const MAX_BYTES: u64 = 8 << 20;
/// Lists and mappings within each other: a matrix in the file has three.
const MAX_DEPTH: usize = 4;

/// What a name stands for.
enum Node {
    Text(String),
    List(Vec<Node>),
    Map(BTreeMap<String, Node>),
}

/// The values of a file by name.
pub(super) struct Storage(BTreeMap<String, Node>);

impl Storage {
    /// Reads a file.
    ///
    /// # Errors
    /// `data.syntax` if it is not such a file; `io.read`, `limits.file`.
    pub(super) fn read(file: &Path) -> Result<Self, DataError> {
        let text = read_text(file, MAX_BYTES)?;
        // OpenCV begins files with "%YAML:1.0", which is no directive of YAML.
        let text = text.strip_prefix("%YAML:1.0").unwrap_or(&text);
        let wrong = |what: String| DataError::syntax(file, "", what);
        let mut events = Parser::new_from_str(text);
        loop {
            match next(&mut events).map_err(wrong)? {
                Event::StreamStart | Event::DocumentStart(_) => {}
                Event::MappingStart(..) => return map(&mut events, 1).map(Self).map_err(wrong),
                _ => return Err(wrong("OpenCV's files are a mapping of names".into())),
            }
        }
    }

    /// The numbers of a matrix, row by row, or of a list.
    pub(super) fn numbers(&self, name: &str) -> Option<Vec<f64>> {
        let list = match self.0.get(name)? {
            Node::Map(matrix) => matrix.get("data")?,
            list => list,
        };
        let Node::List(values) = list else { return None };
        values.iter().map(|v| if let Node::Text(v) = v { v.parse().ok() } else { None }).collect()
    }

    /// A whole number.
    pub(super) fn whole(&self, name: &str) -> Option<u32> {
        if let Some(Node::Text(v)) = self.0.get(name) { v.parse().ok() } else { None }
    }

    /// A list of texts.
    pub(super) fn texts(&self, name: &str) -> Option<Vec<String>> {
        let Node::List(values) = self.0.get(name)? else { return None };
        values.iter().map(|v| if let Node::Text(v) = v { Some(v.clone()) } else { None }).collect()
    }

    /// What follows `prefix` in the names that begin with it.
    pub(super) fn endings(&self, prefix: &str) -> Vec<String> {
        self.0.keys().filter_map(|k| k.strip_prefix(prefix)).map(str::to_owned).collect()
    }
}

type Events<'a> = Parser<'a, StrInput<'a>>;

fn next<'a>(events: &mut Events<'a>) -> Result<Event<'a>, String> {
    match events.next() {
        Some(Ok((event, _))) => Ok(event),
        Some(Err(e)) => Err(e.to_string()),
        None => Err("it ends too early".into()),
    }
}

fn map(events: &mut Events<'_>, depth: usize) -> Result<BTreeMap<String, Node>, String> {
    let mut all = BTreeMap::new();
    loop {
        match next(events)? {
            Event::MappingEnd => return Ok(all),
            Event::Scalar(key, ..) => {
                let value = next(events)?;
                all.insert(key.into_owned(), node(value, events, depth)?);
            }
            _ => return Err("names are texts".into()),
        }
    }
}

fn node(first: Event<'_>, events: &mut Events<'_>, depth: usize) -> Result<Node, String> {
    if depth >= MAX_DEPTH {
        return Err(format!("lists and mappings lie more than {MAX_DEPTH} deep in each other"));
    }
    match first {
        Event::Scalar(text, ..) => Ok(Node::Text(text.into_owned())),
        Event::MappingStart(..) => map(events, depth + 1).map(Node::Map),
        Event::SequenceStart(..) => {
            let mut list = Vec::new();
            loop {
                match next(events)? {
                    Event::SequenceEnd => return Ok(Node::List(list)),
                    value => list.push(node(value, events, depth + 1)?),
                }
            }
        }
        _ => Err("a value is a text, a number, a list or a mapping".into()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(text: &str) -> Result<Storage, DataError> {
        let dir = tempfile::tempdir().unwrap();
        let file = dir.path().join("a.yml");
        std::fs::write(&file, text).unwrap();
        Storage::read(&file)
    }

    #[test]
    fn what_opencv_writes_is_read() {
        let text = "%YAML:1.0\n---\nnames:\n   - \"01\"\n   - \"B1\"\nH_01: 480\nK_01: !!opencv-matrix\n   rows: 3\n   cols: 3\n   \
                    dt: d\n   data: [ 5.5e+02, 0., 320.,\n       0., 551., 240., 0., 0., 1. ]\n";
        let s = read(text).unwrap();
        assert_eq!(s.texts("names").unwrap(), ["01", "B1"]);
        assert_eq!(s.whole("H_01"), Some(480));
        assert_eq!(s.numbers("K_01").unwrap(), [550.0, 0.0, 320.0, 0.0, 551.0, 240.0, 0.0, 0.0, 1.0]);
        assert_eq!(s.endings("K_"), ["01"]);
        assert!(s.numbers("names").is_none() && s.numbers("D_01").is_none());
    }

    #[test]
    fn bad_files_are_errors() {
        let deep = format!("a: {}1{}", "[".repeat(60_000), "]".repeat(60_000));
        let cut = "K: !!opencv-matrix\n   data: [1, 2";
        for text in
            ["", "- 1\n- 2\n", "a: &x [1]\nb: *x\n", "a: [1\nb: 2\n", &deep, cut, "? [1]\n: 2\n", "%YAML:1.0\n---\n\0"]
        {
            let shown = &text[..text.len().min(20)];
            assert_eq!(read(text).err().unwrap_or_else(|| panic!("{shown}")).code(), "data.syntax", "{shown}");
        }
    }
}
