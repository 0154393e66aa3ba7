//! Files of a run folder that are text: settings, log and journal.

use super::{Error, Target, as_it_is, checkpoints};
use crate::case::Case;
use gs_train::saved::Loaded;
use gs4d_run::{Resolved, RunFolder, folder, settings};
use serde_json::json;
use std::path::Path;

thread_local! {
    /// A method that reports on its journal.
    static METHOD: Loaded = checkpoints::scene("modec").expect("a scene of a method that there is");
}

pub fn targets() -> Vec<Target> {
    let one = |name, share, seeds, run| Target { name, share, seeds, repair: as_it_is, run };
    vec![one("config", 2, configurations, |c, _| read_settings(c.first())), one("log", 2, logs, read_logs)]
}

fn configurations(_: &Path) -> Result<Vec<Case>, Error> {
    let registry = gs_methods::registry();
    let of = |name: &str| {
        let config = settings::with_preset(registry, name, "tiny")?;
        Ok::<_, Error>(Case::one("a", toml::to_string(&config.table())?))
    };
    registry.iter().map(|entry| of(entry.name)).collect()
}

fn read_settings(bytes: &[u8]) -> Result<(), String> {
    let text = std::str::from_utf8(bytes).map_err(|e| e.to_string())?;
    let resolved = Resolved::read(gs_methods::registry(), text, folder::CONFIG).map_err(|e| e.to_string())?;
    let again = resolved.config.to_commented_toml();
    again.parse::<toml::Table>().expect("settings are written as TOML");
    Ok(())
}

fn logs(dir: &Path) -> Result<Vec<Case>, Error> {
    Case::one(folder::CONFIG, "").write(dir)?;
    let line = json!({"step": 10, "seconds": 0.5, "losses": {"l1": 0.25}, "counts": {"splats": 7}, "psnr": 20.5});
    let moves = json!({"step": 1050, "starts": [0.0, 0.3, 0.6], "intervals": {
        "clock": 1000, "step": 0.1, "means": [null, 1.0, 2.0], "threshold": 1.5, "hot": [1],
        "moves": [{"boundary": 1, "from": 0.3, "to": 0.4}],
        "rejected": [{"boundary": 2, "at": 0.5, "reason": "busy on both sides"}], "frames": [4, 5, 6]}});
    let grown = json!({"step": 1100, "anchors": 100, "grown": {"added": 12, "pruned": 3, "per_level": [4, 2, 1]}});
    let case = Case::one(folder::LOG, format!("{line}\n{line}\n"));
    Ok(vec![case.with(folder::JOURNAL, format!("{moves}\n{grown}\n"))])
}

fn read_logs(case: &Case, dir: &Path) -> Result<(), String> {
    case.write(dir).map_err(|e| format!("the work folder: {e}"))?;
    let run = RunFolder::open(dir).map_err(|e| e.to_string())?;
    let lines = run.log_lines(folder::LOG).map_err(|e| e.to_string())?;
    let events = run.log_lines(folder::JOURNAL).map_err(|e| e.to_string())?;
    let section = METHOD.with(|m| m.model.report_section(&events)).map_err(|e| e.to_string())?;
    if lines.is_empty() && section.is_none() { Err("no line was read".into()) } else { Ok(()) }
}
