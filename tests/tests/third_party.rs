//! THIRD-PARTY.md names the crates that the program is built from, and no others.

use std::collections::BTreeSet;
use std::path::Path;
use std::process::Command;

/// Name, version and licence of every crate from elsewhere in `gs4d` on Linux.
fn built_from(root: &Path) -> BTreeSet<String> {
    let tree = ["tree", "-p", "gs4d", "-e", "normal", "--target", "x86_64-unknown-linux-gnu", "--locked"];
    let format = ["--prefix", "none", "--no-dedupe", "-f", "{p} | {l}"];
    let out = Command::new(env!("CARGO")).args(tree).args(format).current_dir(root).output().expect("cargo runs");
    assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
    let lines = String::from_utf8(out.stdout).expect("UTF-8");
    // A crate of this workspace has its path behind the version, a macro a remark; a slash is the older way to say OR.
    let crates = lines.lines().filter(|line| !line.is_empty() && !line.contains("(/"));
    crates.map(|line| line.replace(" (proc-macro)", "").replace('/', " OR ").replacen(" v", " | ", 1)).collect()
}

/// The rows of the table.
fn named(root: &Path) -> BTreeSet<String> {
    let text = std::fs::read_to_string(root.join("THIRD-PARTY.md")).expect("THIRD-PARTY.md");
    let rows = text.lines().filter_map(|line| line.strip_prefix("| ")?.strip_suffix(" |"));
    rows.filter(|row| *row != "crate | version | licence").map(str::to_owned).collect()
}

#[test]
fn the_list_of_third_parties_is_that_of_the_program() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let (built, named) = (built_from(&root), named(&root));
    let missing: Vec<_> = built.difference(&named).collect();
    let gone: Vec<_> = named.difference(&built).collect();
    let advice = "write THIRD-PARTY.md anew, as CONTRIBUTING.md says";
    assert!(missing.is_empty() && gone.is_empty(), "missing {missing:?}, gone {gone:?}: {advice}");
}
