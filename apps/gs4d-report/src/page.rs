//! The HTML of a report: scores, views, curves and cost first, then details and commands.

use super::chart::{Curve, Scale, chart, short};
use super::details::{commands, details};
use super::embed::reduced;
use super::heat::heat_map;
use super::html::{captioned, collapsed, document, escape, figure, section, table, wrapped};
use super::method_section::method_section;
use super::over_time::over_time;
use super::overlay::overlays;
use super::views::{comparisons, script};
use super::{Comparison, Figure, Report, ReportError, Sample};
use std::fmt::Write as _;

/// Longest side of an image of the strip, pixels.
pub const STRIP_SIDE: usize = 320;
/// A table of more cameras is folded.
const MAX_CAMERAS: usize = 8;

/// Renders a report; sections without content are left out.
pub(crate) fn page(report: &Report) -> Result<String, ReportError> {
    let parts = [
        cards(&report.figures),
        views("Ground truth beside render", &report.conditions, &report.views)?,
        views("Extrapolated views", &report.future_conditions, &report.future)?,
        times(report)?,
        course(report)?,
        cost(report)?,
        overlays(&report.overlay_view, &report.overlays, &maps(report)?)?,
        report.method.as_ref().map_or(Ok(String::new()), method_section)?,
        details(report),
        commands(&report.commands),
        script(!(report.views.is_empty() && report.future.is_empty())),
    ];
    Ok(document(&report.title, &report.subtitle, &parts.concat()))
}

fn cards(figures: &[Figure]) -> String {
    let mut out = String::new();
    for f in figures {
        let (value, name, remark) = (escape(&f.value), escape(&f.name), escape(&f.remark));
        let _ = writeln!(out, "<div class=\"card\"><b>{value}</b><span>{name}</span><small>{remark}</small></div>");
    }
    wrapped("cards", out)
}

fn views(heading: &str, conditions: &str, views: &[Comparison]) -> Result<String, ReportError> {
    let remark = format!("A view of median PSNR first, then others from the worst up. {}", escape(conditions));
    Ok(section(heading, &remark, &comparisons(views)?))
}

/// The scores of the views over time and by camera, and the scene over time.
fn times(report: &Report) -> Result<String, ReportError> {
    let mut strip = String::new();
    for still in &report.strip {
        strip += &captioned(&reduced(&still.image, STRIP_SIDE), &still.caption)?;
    }
    let chart = over_time("PSNR of each view, dB", &report.over_time, report.training_times)?;
    let rows = report.cameras.iter().map(|r| r.to_vec());
    let mut cameras = table(&["camera", "views", "mean PSNR, dB", "worst, dB"], &[0, 1, 2, 3], rows);
    if report.cameras.len() > MAX_CAMERAS {
        cameras = collapsed(&format!("{} cameras", report.cameras.len()), cameras);
    }
    let content = wrapped("charts", figure(chart) + &wrapped("strip", strip)) + &cameras;
    let remark = format!("{} {}", report.conditions, report.future_conditions);
    Ok(section("Over time", &escape(remark.trim_end()), &content))
}

fn course(report: &Report) -> Result<String, ReportError> {
    let names: Vec<&str> = report.psnr.iter().map(|(name, _)| name.as_str()).collect();
    let title = format!("PSNR of {}, dB", names.join(" and of "));
    let loss = [("loss".to_owned(), report.loss.clone())];
    let charts = figure(training_chart(&title, Scale::Linear, &report.psnr, Sample::at_step, "step")?)
        + &figure(training_chart("Training loss", Scale::Log, &loss, Sample::at_step, "step")?);
    let remark = "Batches are images that the run learns from. Their PSNR says nothing about held-out views.";
    Ok(section("Course of training", remark, &wrapped("charts", charts)))
}

/// Two charts of named training curves: over steps and over seconds; empty without samples.
///
/// # Errors
/// If the plotting library fails.
pub fn training_charts(title: &str, scale: Scale, curves: &[(String, Vec<Sample>)]) -> Result<String, ReportError> {
    let over_seconds = training_chart(title, scale, curves, |s| s.seconds, "seconds of training")?;
    Ok(figure(training_chart(title, scale, curves, Sample::at_step, "step")?) + &figure(over_seconds))
}

fn training_chart(
    title: &str,
    scale: Scale,
    curves: &[(String, Vec<Sample>)],
    x: impl Fn(&Sample) -> f64,
    axis: &str,
) -> Result<Option<String>, ReportError> {
    let curve = |(name, samples): &(String, Vec<Sample>)| Curve {
        name: name.clone(),
        points: samples.iter().map(|s| (x(s), s.value)).collect(),
    };
    chart(title, axis, scale, &curves.iter().map(curve).collect::<Vec<_>>())
}

/// What training and rendering took, and where the time of a step went.
fn cost(report: &Report) -> Result<String, ReportError> {
    let splats = [("splats".to_owned(), report.splats.clone())];
    let chart = training_chart("Splats", Scale::Linear, &splats, Sample::at_step, "step")?;
    let charts = wrapped("charts", figure(chart) + &wrapped("phases", phases(&report.phases)));
    Ok(section("Cost", "", &(cards(&report.cost) + &charts)))
}

/// The parts of a step as a table with bars.
fn phases(phases: &[(String, f64)]) -> String {
    let total: f64 = phases.iter().map(|p| p.1).sum();
    let mut rows = String::new();
    for (name, ms) in phases {
        let share = 100.0 * ms / total.max(f64::MIN_POSITIVE);
        let _ = writeln!(
            rows,
            "<tr><td>{}</td><td class=\"n\">{ms:.2} ms</td><td class=\"n\">{share:.0} %</td>\
             <td><i style=\"width:{share:.1}%\"></i></td></tr>",
            escape(name)
        );
    }
    if rows.is_empty() {
        return rows;
    }
    format!("<table>\n<caption>Where the time of a training step goes</caption>\n<tbody>\n{rows}</tbody>\n</table>\n")
}

/// Heat maps of attributes over training, and renders coloured by second differences.
fn maps(report: &Report) -> Result<String, ReportError> {
    let mut maps = String::new();
    for map in report.heat_maps.iter().filter(|m| !m.steps.is_empty()) {
        let [low, high] = map.span.map(|v| short(f64::from(v)));
        let (first, last) = (map.steps[0], map.steps[map.steps.len() - 1]);
        let caption = format!("{}: {low} (bottom) to {high}, steps {first} to {last}; darker: more splats", map.name);
        maps += &heat_map(&map.counts, &map.name, &caption)?;
    }
    for still in &report.jerk {
        maps += &captioned(&still.image, &still.caption)?;
    }
    Ok(wrapped("strip maps", maps))
}
