//! Command lines for a run, as its report lists them.

use gs_data::shell_quoted;
use std::path::Path;

/// What the commands of a run depend on.
pub(crate) struct Subject<'a> {
    /// The run folder, as it was given.
    pub(crate) root: &'a Path,
    /// Split of its scores.
    pub(crate) split: &'a str,
    /// Whether the scene moves.
    pub(crate) dynamic: bool,
    /// Optimizer steps made.
    pub(crate) step: u32,
    /// Optimizer steps of the whole schedule.
    pub(crate) steps: u64,
    /// The command of a training in rounds, which alone goes on with it.
    pub(crate) rounds: Option<String>,
}

/// What can be done with a run: in words, and as a command line for a POSIX shell. New files are put beside the run folder.
pub(crate) fn commands(of: &Subject<'_>) -> Vec<[String; 2]> {
    let quoted = |path: &Path| shell_quoted(path.to_string_lossy().into_owned());
    let run = quoted(of.root);
    let beside = |ending: &str| match of.root.file_name() {
        Some(name) => quoted(&of.root.with_file_name(format!("{}{ending}", name.to_string_lossy()))),
        None => quoted(&of.root.join(ending.trim_start_matches(['-', '.']))),
    };
    let (resume, resumed) = match u64::from(of.step) < of.steps {
        true => (format!("go on to step {}", of.steps), String::new()),
        false => ("train twice as long".to_owned(), format!(" --steps {}", 2 * of.steps)),
    };
    let (times, time) = if of.dynamic { ("0..1:24", "0.5") } else { ("0..0:24", "0") };
    let line = |what: &str, command: String| [what.to_owned(), format!("gs4d {command}")];
    vec![
        line("Look at the scene in a browser", format!("view {run}")),
        match &of.rounds {
            Some(command) => ["Go on with the rounds".to_owned(), command.clone()],
            None => line(&format!("Resume: {resume}"), format!("resume {run}{resumed}")),
        },
        line("Score the views again", format!("eval {run} --split {}", of.split)),
        line(
            "Render once around the scene",
            format!("render {run} --camera orbit --times {times} -o {}", beside("-orbit")),
        ),
        line(
            &format!("Export the splats at time {time}"),
            format!("export {run} --times {time} -o {}", beside(".ply")),
        ),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn paths_are_quoted_and_files_stand_beside_the_run() {
        let of = |root: &str, step: u32, dynamic: bool| {
            let root = Path::new(root);
            let lines = commands(&Subject { root, split: "test", dynamic, step, steps: 300, rounds: None });
            lines.into_iter().map(|[_, line]| line).collect::<Vec<_>>()
        };
        let lines = of("my runs/it's one", 300, true);
        assert_eq!(lines[0], r"gs4d view 'my runs/it'\''s one'");
        assert_eq!(lines[1], r"gs4d resume 'my runs/it'\''s one' --steps 600");
        assert!(lines[3].ends_with(r"-o 'my runs/it'\''s one-orbit'"), "{}", lines[3]);
        assert_eq!(lines[4], r"gs4d export 'my runs/it'\''s one' --times 0.5 -o 'my runs/it'\''s one.ply'");
        let lines = of("run/", 100, false);
        assert_eq!((lines[0].as_str(), lines[1].as_str()), ("gs4d view run/", "gs4d resume run/"));
        assert_eq!(lines[4], "gs4d export run/ --times 0 -o run.ply");
        assert!(of(".", 1, true)[3].ends_with("-o ./orbit"));
    }
}
