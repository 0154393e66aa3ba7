//! Visibility rules and their thresholds.

use super::region::Region;
use super::subject::{Errors, InputImages};
use super::{Cell, Chart, Findings, LabError, Log, Setup, Subject};
use glam::Vec3;
use gs_data::avatar::AvatarFrame;
use gs_texel::texels::TexelTable;
use gs_texel::unproject::{Compat, UnprojectConfig};
use gs_texel::visibility::{Rates, Rule};

/// Thresholds on the cosine between normal and direction to the camera.
const COSINES: [f32; 5] = [0.0, 0.1, 0.17, 0.34, 0.5];
/// Depth tolerances, metres.
const TOLERANCES: [f32; 4] = [0.005, 0.01, 0.02, 0.04];

const REMARK: &str = "On the true surface, so that only visibility errs; against the template's own colour at seen texels. False \
                      visible and false hidden: pairs of texel and view against an exact ray under the same gates, as shares of \
                      the pairs the ray sees.";
const HEADS: [(&str, usize); 5] =
    [("seen %", 1), ("texture dB", 2), ("false visible %", 3), ("false hidden %", 3), ("ms", 1)];

/// Every rule, the align-corners fault, and the settings of other methods.
pub(super) fn cases() -> impl Iterator<Item = (&'static str, UnprojectConfig)> {
    let plain = UnprojectConfig::default();
    let compat = Compat { align_corners: true, ..Compat::default() };
    let rules = Rule::ALL.into_iter().map(move |rule| (rule.name(), UnprojectConfig { rule, ..plain }));
    rules.chain([
        ("bilinear, align corners", UnprojectConfig { rule: Rule::Bilinear, compat, ..plain }),
        ("as DUT's code", UnprojectConfig::dut_code()),
        ("as HoloChar", UnprojectConfig::holochar()),
        ("as DVA", UnprojectConfig::dva()),
        ("as GHG", UnprojectConfig::ghg()),
    ])
}

/// All [`cases`].
pub(super) fn rules(setup: &Setup, log: &mut Log<'_>) -> Result<Findings, LabError> {
    let mut out =
        measured("vis", &[("rule", 0)], setup, log, cases().map(|(name, config)| (vec![name.into()], config)))?;
    out.charts = vec![chart("Texture (dB) against time (ms)", "ms", "rule")];
    Ok(out)
}

/// The four-tap rule under every pair of thresholds.
pub(super) fn thresholds(setup: &Setup, log: &mut Log<'_>) -> Result<Findings, LabError> {
    let cases = TOLERANCES.into_iter().flat_map(|depth_tolerance| {
        COSINES.into_iter().map(move |min_cos| {
            let tolerance = format!("{:.0} mm", 1e3 * depth_tolerance);
            let config =
                UnprojectConfig { rule: Rule::FourTap, min_cos, depth_tolerance, ..UnprojectConfig::default() };
            (vec![f64::from(min_cos).into(), tolerance.into()], config)
        })
    });
    let mut out = measured("thresholds", &[("least cosine", 2), ("tolerance", 0)], setup, log, cases)?;
    out.charts = vec![chart("Texture (dB) against texels seen", "seen %", "tolerance")];
    Ok(out)
}

/// A table with one row per case: its own cells, then those under [`HEADS`].
fn measured(
    name: &'static str,
    first: &[(&'static str, usize)],
    setup: &Setup,
    log: &mut Log<'_>,
    cases: impl Iterator<Item = (Vec<Cell>, UnprojectConfig)>,
) -> Result<Findings, LabError> {
    let subject = Subject::new(setup, log)?;
    let bench = Bench::new(&subject, setup.texels, None, |frame| Ok(subject.scene.true_surface(frame)))?;
    let mut out = Findings::new(name, REMARK, &[first, &HEADS].concat());
    for (mut row, config) in cases {
        if let [Cell::Text(case)] = &row[..] {
            log(case);
        }
        row.extend(bench.measure(&config)?.map(Cell::from));
        out.rows.push(row);
    }
    Ok(out)
}

fn chart(title: &str, across: &'static str, split: &'static str) -> Chart {
    Chart { part: "", title: title.into(), across, drawn: vec!["texture dB"], split: Some(split) }
}

/// A surface and the input images of every evaluated frame, and the texels that count.
pub(super) struct Bench<'a> {
    subject: &'a Subject,
    table: TexelTable,
    truth: Vec<[f32; 3]>,
    within: Vec<bool>,
    frames: Vec<(Vec<Vec3>, InputImages)>,
}

impl<'a> Bench<'a> {
    /// With `texels` a side, on the `surface` of each frame; of `region` alone if there is one.
    pub(super) fn new(
        subject: &'a Subject,
        texels: usize,
        region: Option<&Region>,
        surface: impl Fn(&AvatarFrame) -> Result<Vec<Vec3>, LabError>,
    ) -> Result<Self, LabError> {
        let table = subject.table(texels)?;
        let of_frame = |f: &AvatarFrame| Ok::<_, LabError>((surface(f)?, subject.images(&f.inputs)?));
        let frames = subject.scene.frames.iter().map(of_frame).collect::<Result<_, _>>()?;
        let within = region.map_or_else(|| vec![true; table.len()], |r| r.texels(&table));
        Ok(Self { truth: subject.truth(&table), subject, table, within, frames })
    }

    /// The values under [`HEADS`].
    pub(super) fn measure(&self, config: &UnprojectConfig) -> Result<[Option<f64>; 5], LabError> {
        let mut errors = Errors::default();
        let (mut visible, mut shown, mut hidden) = (0.0, 0.0, 0.0);
        for (surface, images) in &self.frames {
            let unproject = |config: &UnprojectConfig| self.subject.texture(surface, images, &self.table, config);
            let (texture, ms) = unproject(config)?;
            errors.add_within(&texture, &self.truth, &self.within, ms);
            let per_view = |config: UnprojectConfig| -> Result<Vec<f32>, LabError> {
                let weights = unproject(&UnprojectConfig { keep_views: true, ..config })?.0.by_view;
                let of_texels = weights.chunks(images.len().max(1)).zip(&self.within);
                Ok(of_texels.filter(|(_, within)| **within).flat_map(|(weights, _)| weights).copied().collect())
            };
            let exact = UnprojectConfig { rule: Rule::Ray, compat: Compat::default(), ..*config };
            let rates = Rates::of(&per_view(*config)?, &per_view(exact)?);
            visible += rates.visible as f64;
            shown += rates.false_visible * rates.visible as f64;
            hidden += rates.false_hidden * rates.visible as f64;
        }
        let percent = |n: f64| Some(100.0 * n / visible);
        Ok([Some(100.0 * errors.coverage()), errors.psnr(), percent(shown), percent(hidden), Some(errors.ms())])
    }
}
