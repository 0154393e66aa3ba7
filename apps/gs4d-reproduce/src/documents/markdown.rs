//! Tables of Markdown documents, and which of them hold figures.

use super::{DocumentError, read};
use serde::Serialize;
use std::path::Path;

/// A table of a document.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Found {
    /// The document, relative to the repository.
    pub file: String,
    /// Line of its head, from 1.
    pub line: usize,
    /// The head as it stands.
    pub head: String,
    /// Cells of the rows below.
    pub rows: Vec<Vec<String>>,
}

/// The tables of all documents.
pub(super) fn tables(root: &Path) -> Result<Vec<Found>, DocumentError> {
    let mut all = Vec::new();
    for folder in ["", "docs", "docs/guide"] {
        let entries = std::fs::read_dir(root.join(folder)).into_iter().flatten().flatten();
        let mut names: Vec<String> = entries.filter_map(|e| e.file_name().into_string().ok()).collect();
        names.retain(|n| n.ends_with(".md") && (!folder.is_empty() || n == "README.md"));
        names.sort();
        for name in names {
            let file = if folder.is_empty() { name } else { format!("{folder}/{name}") };
            all.extend(of_text(&file, &read(&root.join(&file))?));
        }
    }
    Ok(all)
}

/// The tables of a Markdown text: a line of cells, a line of dashes, lines of cells.
fn of_text(file: &str, text: &str) -> Vec<Found> {
    let lines: Vec<&str> = text.lines().collect();
    let is_row = |k: usize| lines.get(k).is_some_and(|l| l.starts_with('|'));
    let is_rule = |k: usize| is_row(k) && lines[k].chars().all(|c| "|-: ".contains(c));
    let table = |k: usize| {
        let rows = (k + 2..).take_while(|j| is_row(*j)).map(|j| cells(lines[j])).collect();
        Found { file: file.to_owned(), line: k + 1, head: lines[k].to_owned(), rows }
    };
    (0..lines.len()).filter(|k| is_row(*k) && is_rule(k + 1)).map(table).collect()
}

fn cells(line: &str) -> Vec<String> {
    line.trim().trim_matches('|').split('|').map(|c| c.trim().to_owned()).collect()
}

impl Found {
    /// Whether most rows hold a cell with a figure, beside the first.
    pub(super) fn holds_figures(&self) -> bool {
        let with = self.rows.iter().filter(|r| r.iter().skip(1).any(|c| holds_figure(c))).count();
        2 * with > self.rows.len()
    }
}

/// Whether a cell holds a figure, anywhere but in code.
fn holds_figure(cell: &str) -> bool {
    cell.split('`').step_by(2).flat_map(str::split_whitespace).any(is_figure)
}

/// Whether a word is a number with or without a sign and a symbol. A name (`3D`, `8th`) is none, a year neither.
fn is_figure(word: &str) -> bool {
    let word = word.trim_start_matches(['+', '−', '-', '±', '*', '<', '(', '≤', '≥', '≈']);
    let bare = word.trim_end_matches([',', '.', ';', ':', ')']);
    let year = bare.parse::<u64>().is_ok_and(|y| (1900..2100).contains(&y));
    let letter = |c: char| c.is_ascii_alphabetic() && c != 'e';
    word.starts_with(|c: char| c.is_ascii_digit()) && !word.contains(letter) && !year
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::documents::tests::DOCUMENT;

    #[test]
    fn tables_are_read_with_their_rows() {
        let found = of_text("a.md", DOCUMENT);
        assert_eq!((found.len(), found[0].line, found[0].rows[1][1].as_str()), (2, 3, "**39.1**"));
        assert!(found[0].holds_figures() && !found[1].holds_figures());
    }

    #[test]
    fn a_figure_may_stand_anywhere_in_a_cell() {
        for cell in ["**39.1**", "−0.10 ± 0.26", "at most 72 more files", "its ratio within 3 %", "3e-6 of `f64`"] {
            assert!(holds_figure(cell), "{cell}");
        }
        for cell in ["`--size 128`", "Kerbl et al. 2023", "every 8th", "4K", "[below](#two-3)", "–", ""] {
            assert!(!holds_figure(cell), "{cell}");
        }
    }
}
