//! Gives the crate the commit that it is built from: `GS4D_COMMIT` of the environment, else that of the git checkout, if it is one.

use std::process::Command;

fn main() {
    println!("cargo:rerun-if-env-changed=GS4D_COMMIT");
    println!("cargo:rerun-if-changed=build.rs");
    let commit = std::env::var("GS4D_COMMIT").ok().or_else(|| {
        // Moves with every commit.
        let log = std::path::Path::new(&git(&["rev-parse", "--absolute-git-dir"])?).join("logs/HEAD");
        if log.exists() {
            println!("cargo:rerun-if-changed={}", log.display());
        }
        git(&["rev-parse", "--short=12", "HEAD"])
    });
    if let Some(commit) = commit {
        println!("cargo:rustc-env=GS4D_COMMIT={commit}");
    }
}

/// What git prints; none without git or outside a checkout of this project.
fn git(arguments: &[&str]) -> Option<String> {
    let output = Command::new("git").args(arguments).output().ok()?;
    let text = String::from_utf8(output.stdout).ok()?;
    output.status.success().then(|| text.trim().to_owned()).filter(|t| !t.is_empty())
}
