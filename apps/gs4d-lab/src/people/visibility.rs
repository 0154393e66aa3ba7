//! Rules and thresholds of visibility.

use super::subject::{Errors, Photographs};
use super::{Cell, Chart, Findings, LabError, Setup, Subject, Tell};
use glam::Vec3;
use gs_data::avatar::AvatarFrame;
use gs_texel::texels::TexelTable;
use gs_texel::unproject::{Compat, UnprojectConfig};
use gs_texel::visibility::{Rates, Rule};

/// Least cosines between normal and direction to the camera.
const COSINES: [f32; 5] = [0.0, 0.1, 0.17, 0.34, 0.5];
/// Depth tolerances, metres.
const TOLERANCES: [f32; 4] = [0.005, 0.01, 0.02, 0.04];

const REMARK: &str = "On the true surface, so that only visibility errs; against the template's own colour at seen texels. False \
                      visible and false hidden: pairs of texel and view against an exact ray under the same gates, as shares of \
                      the pairs the ray sees.";
const HEADS: [(&str, usize); 5] =
    [("seen %", 1), ("texture dB", 2), ("false visible %", 3), ("false hidden %", 3), ("ms", 1)];

/// Every rule, the align-corners fault, and other methods' ways.
pub(super) fn rules(setup: &Setup, tell: &mut Tell<'_>) -> Result<Findings, LabError> {
    let bench = Bench::new(setup, tell)?;
    let mut out = Findings::new("vis", REMARK, &[&[("rule", 0)][..], &HEADS].concat());
    let plain = UnprojectConfig::default();
    let mut ways: Vec<(&str, UnprojectConfig)> =
        Rule::ALL.into_iter().map(|rule| (rule.name(), UnprojectConfig { rule, ..plain })).collect();
    let compat = Compat { align_corners: true, ..Compat::default() };
    ways.extend([
        ("bilinear, align corners", UnprojectConfig { rule: Rule::Bilinear, compat, ..plain }),
        ("as DUT's code", UnprojectConfig::dut_code()),
        ("as HoloChar", UnprojectConfig::holochar()),
        ("as DVA", UnprojectConfig::dva()),
        ("as GHG", UnprojectConfig::ghg()),
    ]);
    for (name, config) in ways {
        tell(name);
        let mut row: Vec<Cell> = vec![name.into()];
        row.extend(bench.measure(&config)?);
        out.rows.push(row);
    }
    out.charts = vec![Chart {
        part: "",
        title: "Texture (dB) against time (ms)".into(),
        across: "ms",
        drawn: vec!["texture dB"],
        split: Some("rule"),
    }];
    Ok(out)
}

/// The four-tap rule under every pair of thresholds.
pub(super) fn thresholds(setup: &Setup, tell: &mut Tell<'_>) -> Result<Findings, LabError> {
    let bench = Bench::new(setup, tell)?;
    let heads = [&[("least cosine", 2), ("tolerance", 0)][..], &HEADS].concat();
    let mut out = Findings::new("thresholds", REMARK, &heads);
    for depth_tolerance in TOLERANCES {
        for min_cos in COSINES {
            let config = UnprojectConfig { min_cos, depth_tolerance, ..UnprojectConfig::default() };
            let tolerance = format!("{:.0} mm", 1e3 * depth_tolerance);
            let mut row: Vec<Cell> = vec![f64::from(min_cos).into(), tolerance.into()];
            row.extend(bench.measure(&config)?);
            out.rows.push(row);
        }
    }
    out.charts = vec![Chart {
        part: "",
        title: "Texture (dB) against texels seen".into(),
        across: "seen %",
        drawn: vec!["texture dB"],
        split: Some("tolerance"),
    }];
    Ok(out)
}

/// The film, its true surfaces and pictures.
struct Bench {
    subject: Subject,
    table: TexelTable,
    truth: Vec<[f32; 3]>,
    frames: Vec<(Vec<Vec3>, Photographs)>,
}

impl Bench {
    fn new(setup: &Setup, tell: &mut Tell<'_>) -> Result<Self, LabError> {
        let subject = Subject::new(setup, tell)?;
        let table = subject.table(setup.texels)?;
        let of_frame =
            |f: &AvatarFrame| Ok::<_, LabError>((subject.scene.true_surface(f), subject.photographs(&f.inputs)?));
        let frames = subject.scene.frames.iter().map(of_frame).collect::<Result<_, _>>()?;
        Ok(Self { truth: subject.truth(&table), table, frames, subject })
    }

    /// The numbers under [`HEADS`].
    fn measure(&self, config: &UnprojectConfig) -> Result<Vec<Cell>, LabError> {
        let mut errors = Errors::default();
        let (mut visible, mut shown, mut hidden) = (0.0, 0.0, 0.0);
        for (surface, photographs) in &self.frames {
            let look = |config: &UnprojectConfig| self.subject.texture(surface, photographs, &self.table, config);
            let (texture, ms) = look(config)?;
            errors.add(&texture.colors, texture.seen.iter().map(|&n| n > 0), &self.truth, ms);
            let kept = |config: UnprojectConfig| look(&UnprojectConfig { keep_views: true, ..config });
            let oracle = UnprojectConfig { rule: Rule::Ray, compat: Compat::default(), ..*config };
            let rates = Rates::of(&kept(*config)?.0.by_view, &kept(oracle)?.0.by_view);
            visible += rates.visible as f64;
            shown += rates.false_visible * rates.visible as f64;
            hidden += rates.false_hidden * rates.visible as f64;
        }
        let percent = |n: f64| Some(100.0 * n / visible);
        let row = [Some(100.0 * errors.coverage()), errors.psnr(), percent(shown), percent(hidden), Some(errors.ms())];
        Ok(row.map(Cell::from).into())
    }
}
