//! `gs4d completions` and `gs4d man`: what a shell and `man` know of this program.

use crate::answer::Answer;
use crate::failure::Failure;
use crate::output::{check_free, create_folder};
use clap_complete::Shell;
use gs_core::io::write_file;
use serde_json::json;
use std::path::PathBuf;

/// Print completions for a shell: bash, zsh, fish, elvish or powershell
#[derive(clap::Args)]
pub struct Completions {
    /// The shell.
    #[arg(value_enum)]
    shell: Shell,
}

impl Completions {
    pub fn run(self) -> Answer {
        let mut text = Vec::new();
        clap_complete::generate(self.shell, &mut crate::command(), "gs4d", &mut text);
        let text = String::from_utf8_lossy(&text).into_owned();
        Answer::new(text.clone(), json!({"shell": self.shell.to_string(), "completions": text}))
    }
}

/// Write man pages of every verb into a folder
#[derive(clap::Args)]
pub struct Man {
    /// The folder; made if missing.
    #[arg(value_name = "DIR")]
    out: PathBuf,
    /// Overwrite existing pages.
    #[arg(short, long)]
    force: bool,
}

impl Man {
    pub fn run(self) -> Result<Answer, Failure> {
        let command = crate::command();
        let mut pages = vec![("gs4d.1".to_owned(), command.clone())];
        for verb in command.get_subcommands() {
            let name = format!("gs4d-{}", verb.get_name());
            pages.push((format!("{name}.1"), verb.clone().display_name(name).hide(false)));
        }
        let path = |name: &str| self.out.join(name);
        let files: Vec<PathBuf> = pages.iter().map(|p| path(&p.0)).collect();
        check_free(self.force, "page", "folder", &files)?;
        create_folder(&self.out)?;
        for (name, command) in &pages {
            let man = clap_mangen::Man::new(command.clone());
            write_file(&path(name), self.force, |out| man.render(out))?;
        }
        let text = format!("{} pages: man -l {}\n", pages.len(), path("gs4d.1").display());
        Ok(Answer::new(text, json!({"files": files})))
    }
}
