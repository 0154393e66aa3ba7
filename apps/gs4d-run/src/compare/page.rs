//! The HTML page of a comparison of runs.

use crate::compare::{Compared, DifferingSetting, Row, Side, ViewRenders, ViewRow, columns};
use crate::summary::samples;
use gs4d_report::chart::{Curve, Scale};
use gs4d_report::error_map::error;
use gs4d_report::html::{collapsed, document, escape, figure, section, table, wrapped};
use gs4d_report::over_time::over_time as scores_over_time;
use gs4d_report::page::training_charts;
use gs4d_report::views::{ViewFigure, figures, script};
use gs4d_report::{ReportError, Sample};
use serde_json::Value;

/// One self-contained HTML page. Error maps are against ground truth or, with `against_first`, against the renders of the
/// first run. `sides` are the compared runs, in the same order.
///
/// # Errors
/// If a chart or image cannot be encoded.
pub fn page(
    c: &Compared,
    pictures: &[ViewRenders],
    sides: &[Side],
    against_first: bool,
) -> Result<String, ReportError> {
    let names: Vec<&str> = c.runs.iter().map(|r| r.name.as_str()).collect();
    let parts = [
        runs_table(c),
        differences(c),
        over_time(c)?,
        disagreements(c, pictures, &names, against_first)?,
        course(&sides.iter().zip(&names).map(|(side, name)| (*name, vec![&side.log[..]])).collect::<Vec<_>>())?,
        each_view(c, &names),
        settings(c, &names),
        provenance(c),
        script(!pictures.is_empty()),
    ];
    let subtitle = format!("{} Data {}.", c.conditions, c.data_digest);
    Ok(document(&names.join(" · "), &subtitle, &parts.concat()))
}

fn runs_table(c: &Compared) -> String {
    let mut head = vec!["run", "method", "preset", "seed"];
    let columns = columns(&c.runs);
    head.extend(columns.iter().map(|c| c.0));
    let row = |(k, r): (usize, &Row)| {
        let mut cells = vec![r.name.clone(), r.method.clone(), r.preset.clone(), r.seed.to_string()];
        cells.extend(columns.iter().map(|(_, values)| values[k].clone()));
        cells
    };
    let numeric: Vec<usize> = (3..head.len()).collect();
    let remark = format!(
        "{} Means over the views; proxy is not LPIPS. Seconds are those of each run's own training, ms/frame was measured here.",
        escape(&c.conditions)
    );
    section("Runs", &remark, &table(&head, &numeric, c.runs.iter().enumerate().map(row)))
}

fn differences(c: &Compared) -> String {
    let Some(first) = c.runs.first() else { return String::new() };
    let db = |v: Option<f64>| v.map_or("–".to_owned(), |v| format!("{v:+.2}"));
    let rows = c.differences.iter().zip(c.runs.iter().skip(1)).map(|(d, run)| {
        let spread = d.over_views.map_or("–".to_owned(), |s| format!("± {:.2}", s.deviation));
        let same = run.psnr_to_first.map_or("equal".to_owned(), |p| format!("{p:.2} dB"));
        vec![
            d.name.clone(),
            db(d.over_views.map(|s| s.mean)),
            spread,
            db(d.range.map(|r| r[0])),
            db(d.range.map(|r| r[1])),
            format!("{} of {}", d.better, d.of),
            same,
        ]
    });
    let head = ["run", "mean dB", "over views", "least", "most", "views better", "renders to the first's"];
    let remark = format!(
        "PSNR of each view minus that of the same view of {}. The spread is over views, not over seeds. {}",
        escape(&first.name),
        escape(&c.seeds)
    );
    section("Paired differences", &remark, &table(&head, &[1, 2, 3, 4, 5, 6], rows))
}

fn over_time(c: &Compared) -> Result<String, ReportError> {
    let of_run = |k: usize| Curve {
        name: c.runs[k].name.clone(),
        points: c.views.iter().filter_map(|v| Some((f64::from(v.time), v.psnr[k]?))).collect(),
    };
    let lines: Vec<Curve> = (0..c.runs.len()).map(of_run).collect();
    let content = wrapped("charts", figure(scores_over_time("PSNR of each view, dB", &lines, None)?));
    Ok(section("Over time", &escape(&c.conditions), &content))
}

fn disagreements(
    c: &Compared,
    pictures: &[ViewRenders],
    names: &[&str],
    against_first: bool,
) -> Result<String, ReportError> {
    let shown: Vec<ViewFigure> = pictures
        .iter()
        .map(|p| {
            let truth = if against_first { p.renders.first().unwrap_or(&p.truth) } else { &p.truth };
            let errors = p.renders.iter().zip(names).skip(usize::from(against_first));
            ViewFigure {
                caption: &p.caption,
                images: std::iter::once(("ground truth", &p.truth))
                    .chain(names.iter().copied().zip(&p.renders))
                    .collect(),
                errors: errors.filter_map(|(d, n)| Some((format!("error of {n}"), error(truth, d)?))).collect(),
            }
        })
        .collect();
    let held = match (against_first, names.first()) {
        (true, Some(first)) => format!("the renders of {}", escape(first)),
        _ => "the ground truth".to_owned(),
    };
    let remark = format!(
        "The {} views whose renders differ most from each other. Errors are against {held}. {}",
        pictures.len(),
        escape(&c.conditions)
    );
    Ok(section("Where they disagree most", &remark, &figures(&shown)?))
}

/// The section of a page that shows how runs were trained: names, and the lines of [`LOG`](crate::folder::LOG) of the runs of that
/// name, of which the means are shown.
///
/// # Errors
/// If the plotting library fails.
pub fn course(runs: &[(&str, Vec<&[Value]>)]) -> Result<String, ReportError> {
    type Kind = (&'static str, fn(&Value) -> Option<f64>);
    let kinds: [Kind; 3] = [
        ("PSNR of training batches, dB", |line| line["psnr"].as_f64()),
        ("PSNR of views scored while training, dB", |line| line["eval"]["mean"]["psnr"].as_f64()),
        ("Splats", |line| line["splats"].as_f64()),
    ];
    let mut out = String::new();
    for (title, value) in kinds {
        let curve = |(name, logs): &(&str, Vec<&[Value]>)| {
            ((*name).to_owned(), mean_curve(&logs.iter().map(|log| samples(log, value)).collect::<Vec<_>>()))
        };
        out += &training_charts(title, Scale::Linear, &runs.iter().map(curve).collect::<Vec<_>>())?;
    }
    let means = if runs.iter().any(|(_, logs)| logs.len() > 1) { ", means over seeds" } else { "" };
    let remark = format!("All runs, against optimiser steps and against seconds{means}.");
    Ok(section("Course of training", &remark, &wrapped("charts", out)))
}

/// Means of the samples that all curves have at the same steps.
fn mean_curve(curves: &[Vec<Sample>]) -> Vec<Sample> {
    let Some((first, others)) = curves.split_first() else { return Vec::new() };
    let n = curves.len() as f64;
    let at = |sample: &Sample| {
        let same = |curve: &Vec<Sample>| curve.iter().find(|s| s.step == sample.step).copied();
        let all: Option<Vec<Sample>> = std::iter::once(Some(*sample)).chain(others.iter().map(same)).collect();
        let all = all?;
        let mean = |of: fn(&Sample) -> f64| all.iter().map(of).sum::<f64>() / n;
        Some(Sample { step: sample.step, seconds: mean(|s| s.seconds), value: mean(|s| s.value) })
    };
    first.iter().filter_map(at).collect()
}

/// The header of a table: fixed names, then the escaped names of the runs.
fn head(fixed: &[&str], names: &[&str]) -> Vec<String> {
    fixed.iter().map(|n| (*n).to_owned()).chain(names.iter().map(|n| escape(n))).collect()
}

fn each_view(c: &Compared, names: &[&str]) -> String {
    let mut head = head(&["view", "time"], names);
    head.push("renders differ by".to_owned());
    let head: Vec<&str> = head.iter().map(String::as_str).collect();
    let row = |v: &ViewRow| {
        let psnr = v.psnr.iter().map(|p| p.map_or("perfect".to_owned(), |p| format!("{p:.2} dB")));
        let mut cells: Vec<String> = [v.name.clone(), format!("{:.3}", v.time)].into_iter().chain(psnr).collect();
        cells.push(format!("{:.4}", v.disagreement));
        cells
    };
    let numeric: Vec<usize> = (1..head.len()).collect();
    let content = table(&head, &numeric, c.views.iter().map(row));
    section("PSNR of each view", &escape(&c.conditions), &collapsed(&format!("{} views", c.views.len()), content))
}

fn settings(c: &Compared, names: &[&str]) -> String {
    let head = head(&["setting"], names);
    let head: Vec<&str> = head.iter().map(String::as_str).collect();
    let row = |u: &DifferingSetting| {
        let values = u.values.iter().map(|v| v.clone().unwrap_or_else(|| "–".to_owned()));
        std::iter::once(u.key.clone()).chain(values).collect::<Vec<_>>()
    };
    let content = table(&head, &[], c.settings.iter().map(row));
    let folded = match content.is_empty() {
        true => "<p>None.</p>\n".to_owned(),
        false => collapsed(&format!("{} settings", c.settings.len()), content),
    };
    section("Settings that differ", "", &folded)
}

fn provenance(c: &Compared) -> String {
    let row = |r: &Row| {
        let machine = r.trained_on.clone().unwrap_or_else(|| "–".to_owned());
        vec![r.name.clone(), r.path.clone(), machine]
    };
    section("Provenance", "", &table(&["run", "read from", "trained on"], &[], c.runs.iter().map(row)))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn means_are_of_the_steps_that_all_runs_have() {
        let curve = |points: &[[f64; 3]]| -> Vec<Sample> {
            points
                .iter()
                .map(|[step, seconds, value]| Sample { step: *step, seconds: *seconds, value: *value })
                .collect()
        };
        let two = [
            curve(&[[1.0, 2.0, 10.0], [2.0, 4.0, 20.0], [3.0, 6.0, 30.0]]),
            curve(&[[1.0, 4.0, 12.0], [3.0, 8.0, 20.0]]),
        ];
        assert_eq!(mean_curve(&two), curve(&[[1.0, 3.0, 11.0], [3.0, 7.0, 25.0]]));
        assert_eq!(mean_curve(&two[..1]), two[0]);
        assert_eq!(mean_curve(&[]), []);
    }
}
