//! Every command of the user guide, as it stands there but for the length of what it does: pictures become small, recipes
//! short, seeds and frames few.

use crate::support::command;
use std::path::{Path, PathBuf};

/// Flags whose value is replaced, and by what.
const SHORTER: [(&str, &str); 6] = [
    ("--size", "40"),
    ("--steps", "30"),
    ("--preset", "tiny"),
    ("--points", "200"),
    ("--time-budget", "2s"),
    ("--seeds", "0"),
];
/// Verbs, and what is added to them.
const ADDED: [(&str, &[&str]); 8] = [
    ("synth", &["--train-views", "12", "--val-views", "1", "--test-views", "2"]),
    ("synth", &["--size", "40"]),
    ("train", &["--steps", "30"]),
    ("doctor", &["--preset", "tiny"]),
    ("compare settings", &["--steps", "30"]),
    ("compare methods", &["--steps", "30"]),
    ("resume", &["--quiet"]),
    ("reproduce fags ablation", &["--scale", "0.2"]),
];

pub fn guide() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../docs/guide")
}

/// The blocks of a language of a chapter.
pub fn blocks(text: &str, language: &str) -> Vec<String> {
    let (begin, mut inside) = (format!("```{language}"), false);
    let mut out = Vec::new();
    for line in text.lines() {
        match line.trim() {
            mark if mark == begin => {
                inside = true;
                out.push(String::new());
            }
            "```" => inside = false,
            _ if inside => out.last_mut().into_iter().for_each(|block| *block += &format!("{line}\n")),
            _ => {}
        }
    }
    out
}

/// The commands of the `sh` blocks of a chapter.
fn commands(text: &str) -> Vec<String> {
    let lines = blocks(text, "sh").concat();
    lines.lines().map(|line| line.trim().to_owned()).filter(|line| !line.is_empty()).collect()
}

/// Words of a command line; quotes hold words together, `#` begins a remark.
fn words(line: &str) -> Vec<String> {
    let (mut out, mut word, mut quoted) = (Vec::new(), String::new(), false);
    for c in line.chars() {
        match c {
            '"' => quoted = !quoted,
            '#' if !quoted && word.is_empty() => break,
            c if c.is_whitespace() && !quoted => {
                if !word.is_empty() {
                    out.push(std::mem::take(&mut word));
                }
            }
            c => word.push(c),
        }
    }
    if !word.is_empty() {
        out.push(word);
    }
    out
}

fn shortened(words: &[String]) -> Vec<String> {
    let mut out: Vec<String> = words.to_vec();
    for k in 1..out.len() {
        if let Some((_, value)) = SHORTER.iter().find(|s| s.0 == out[k - 1]) {
            out[k] = (*value).to_owned();
        }
    }
    if out[0] == "synth" && out.iter().any(|w| w == "--cameras") {
        out.extend(["--moments", "12"].map(str::to_owned));
        return out;
    }
    // A film of a person has no numbers of views.
    let film = out[0] == "synth" && out.iter().any(|w| w == "avatar");
    for (verb, flags) in ADDED.into_iter().filter(|(_, flags)| !(film && flags[0] == "--train-views")) {
        let has = |flag: &str| out.iter().any(|w| w == flag);
        let named = out.iter().zip(verb.split(' ')).all(|(w, v)| w == v);
        if named && out.len() > 1 && !flags.iter().any(|f| f.starts_with("--") && has(f)) {
            out.extend(flags.iter().map(|f| (*f).to_owned()));
        }
    }
    out
}

/// Runs the command of a line of a chapter in a folder.
pub fn run_line(name: &str, line: &str, folder: &Path) {
    let words = words(line);
    assert_eq!(words[0], "gs4d", "{name}: only commands of gs4d stand in sh blocks: {line}");
    let short = shortened(&words[1..]);
    let arguments: Vec<&str> = short.iter().map(String::as_str).collect();
    let output = command(&arguments).current_dir(folder).output().expect("gs4d runs");
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{name}: `{line}` (as {short:?}) failed: {stderr}");
}

fn chapter(name: &str) {
    let text = std::fs::read_to_string(guide().join(name)).expect("chapter");
    let folder = tempfile::tempdir().expect("folder");
    let lines = commands(&text);
    assert!(!lines.is_empty(), "{name} has no commands");
    lines.iter().for_each(|line| run_line(name, line, folder.path()));
}

#[test]
fn every_chapter_is_in_the_list_and_has_what_it_links_to() {
    let list = std::fs::read_to_string(guide().join("README.md")).expect("list");
    for entry in std::fs::read_dir(guide()).expect("guide") {
        let path = entry.expect("entry").path();
        let name = path.file_name().expect("name").to_string_lossy().into_owned();
        if !name.ends_with(".md") {
            continue;
        }
        assert!(name == "README.md" || list.contains(&format!("({name})")), "{name} is not in the list");
        let text = std::fs::read_to_string(&path).expect("chapter");
        for link in text.split("](").skip(1).filter_map(|l| l.split(')').next()).filter(|l| !l.contains("://")) {
            let target = link.split('#').next().unwrap_or("");
            assert!(guide().join(target).exists(), "{name} links to {link}");
        }
    }
}

#[test]
fn commands_of_the_first_run() {
    chapter("first-run.md");
}

#[test]
fn commands_about_data() {
    chapter("data.md");
}

#[test]
fn commands_about_methods() {
    chapter("methods.md");
}

#[test]
fn commands_about_the_viewer() {
    chapter("viewer.md");
}

#[test]
fn commands_about_reports() {
    chapter("report.md");
}

#[test]
fn commands_about_the_page() {
    chapter("player.md");
}

#[test]
fn commands_about_axes() {
    chapter("axes.md");
}

#[test]
fn commands_about_tables() {
    chapter("tables.md");
}
