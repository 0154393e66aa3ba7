//! The first screen: the verbs that most people need, then the others in groups.

use std::sync::LazyLock;

/// Groups of the verbs that are not among the first.
const GROUPS: [(&str, &[&str]); 4] = [
    ("Compare", &["compare", "continual", "reproduce"]),
    ("Look inside", &["methods", "config", "inspect", "forecast", "segment", "glmd", "live"]),
    ("Make data, take over a scene", &["synth", "pose", "covisible", "import-checkpoint"]),
    ("Measure, and set up a shell", &["lab", "bench", "completions", "man"]),
];

const EXIT_CODES: &str = "Exit codes: 0 done, 1 internal fault, 2 wrong usage, 3 invalid data, 4 numerical failure, \
    5 resource limit, 6 input or output, 7 verification failed, 130 interrupted (state saved)";

/// Number and commit, for example `0.1.0 (1a2b3c4d5e6f)`.
pub fn version() -> &'static str {
    static TEXT: LazyLock<String> = LazyLock::new(|| {
        let commit = gs4d_run::provenance::COMMIT.map_or(String::new(), |c| format!(" ({c})"));
        format!("{}{commit}", env!("CARGO_PKG_VERSION"))
    });
    &TEXT
}

/// What stands below the first verbs.
pub fn after(command: &clap::Command) -> String {
    let mut text = String::new();
    for (group, names) in GROUPS {
        text.push_str(&format!("{group}:\n"));
        for name in names {
            let about = command.find_subcommand(name).and_then(|c| c.get_about()).map(ToString::to_string);
            text.push_str(&format!("  {name:<17} {}\n", about.unwrap_or_default()));
        }
        text.push('\n');
    }
    text + EXIT_CODES
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeSet;

    /// Names that go with the next version.
    const OLDER: [&str; 3] = ["contest", "sweep", "compact"];

    #[test]
    fn every_verb_is_on_the_first_screen_once() {
        let command = crate::command();
        let hidden: BTreeSet<&str> =
            command.get_subcommands().filter(|c| c.is_hide_set()).map(clap::Command::get_name).collect();
        let grouped: Vec<&str> = GROUPS.iter().flat_map(|g| g.1).copied().collect();
        assert_eq!(grouped.iter().copied().chain(OLDER).collect::<BTreeSet<_>>(), hidden);
        assert_eq!(grouped.len() + OLDER.len(), hidden.len());
        let shown = command.get_subcommands().filter(|c| !c.is_hide_set()).count();
        assert!(shown <= 10, "{shown} verbs on the first screen");
        command.debug_assert();
    }

    #[test]
    fn every_verb_says_what_it_does() {
        let text = after(&crate::command());
        assert!(GROUPS.iter().flat_map(|g| g.1).all(|name| text.contains(&format!("  {name} "))), "{text}");
        assert!(text.lines().filter(|l| l.starts_with("  ")).all(|l| l.len() > 20), "{text}");
    }
}
