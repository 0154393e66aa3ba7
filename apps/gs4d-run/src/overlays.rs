//! Overlays of a view: renders of the splats coloured by scalar attributes, directions and rigid parts.

use gs_core::{Camera, Color, Splats, SplatsRef, cast};
use gs_data::View;
use gs_raster::RasterOptions;
use gs_train::capabilities::{Overlay, Quantity};
use gs_train::evaluate::clamped;
use gs_train::method::MethodError;
use gs_train::model::Model;
use gs_train::renderer::Renderer;
use gs_train::timestamp::Timestamp;
use gs4d_eval::layers;
use gs4d_eval::segment::{self, parts};
use gs4d_report::analysis::Histogram;
use gs4d_report::{Legend, OVERLAY_SIDE, OverlayFigure, Ramp, within};

/// Number of colours of a legend.
const LEGEND_COLORS: usize = 9;
/// Quantiles that bound the colour span of an attribute without an interval of its own, against outliers.
const SPAN_QUANTILES: [f64; 2] = [0.01, 0.99];

/// All overlays at the time of a view, over black; parts by the motion up to `observed`, the last training time, normalised.
///
/// # Errors
/// If the model cannot produce its splats.
pub(crate) fn overlay_figures(
    method: &Model,
    view: &View,
    camera: &Camera,
    observed: f32,
) -> Result<Vec<OverlayFigure>, MethodError> {
    let at = Timestamp::new(view.time);
    let splats = method.all_splats(&at, camera)?;
    let mut renderer = Renderer::new(RasterOptions { background: [0.0; 3], ..method.raster_options([0.0; 3]) });
    let mut render = |splats: &Splats, overlay: Overlay| {
        let color = &Color::Rgb(overlay.colors);
        let frame = renderer.render(SplatsRef { color, ..splats.view() }, camera);
        frame.map(|frame| within(clamped(frame), OVERLAY_SIDE))
    };
    let quantities = method.quantities(&at)?;
    let mut figures = Vec::new();
    for q in quantities.iter().filter(|q| q.values.len() == splats.len()) {
        let (q, clipped) = without_outliers(q);
        let image = render(&splats, q.overlay())?;
        let histogram = Some(Histogram::of(q.name, None, q.span(), &q.values));
        let name = if q.unit.is_empty() { q.name.to_owned() } else { format!("{}, {}", q.name, q.unit) };
        figures.push(OverlayFigure { name, image, legend: legend(&q, clipped), histogram });
    }
    let known = |o: &Overlay| quantities.iter().any(|q| q.name == o.name);
    for overlay in method.overlays(&at)?.into_iter().filter(|o| !known(o) && o.colors.len() == splats.len()) {
        let (name, legend) = (overlay.name.to_owned(), Legend::Words(overlay.meaning.to_owned()));
        figures.push(OverlayFigure { name, image: render(&splats, overlay)?, legend, histogram: None });
    }
    figures.extend(parts_figure(method, observed, &splats, &mut render)?);
    Ok(figures)
}

/// The rigid parts, for methods that learn twists.
fn parts_figure(
    method: &Model,
    observed: f32,
    splats: &Splats,
    render: &mut impl FnMut(&Splats, Overlay) -> Result<gs_core::Image, MethodError>,
) -> Result<Option<OverlayFigure>, MethodError> {
    let has_twists = method.capabilities().particles.is_some();
    let labels = has_twists.then(|| layers::parts(method, observed).ok()).flatten();
    let Some(labels) = labels.filter(|labels| labels.of.len() == splats.len()) else { return Ok(None) };
    let colors = layers::part_colors(&labels);
    let kind = |p: &segment::Part| {
        let text = format!(
            "{}: {} splats, {:.1} % of the opacity, speed {:.3} units/span, spin {:.3} rad/span",
            p.id,
            p.splats,
            100.0 * p.share,
            p.speed,
            p.spin
        );
        (segment::color(p.id), text)
    };
    let legend = Legend::Kinds(parts::table(&labels).iter().map(kind).collect());
    let image = render(splats, Overlay { name: "parts", colors, meaning: "" })?;
    Ok(Some(OverlayFigure { name: "parts that share a motion".to_owned(), image, legend, histogram: None }))
}

/// The attribute with an interval of nearly all of its values, and whether some lie outside.
fn without_outliers(q: &Quantity) -> (Quantity, bool) {
    let mut sorted: Vec<f32> = q.values.iter().copied().filter(|v| v.is_finite()).collect();
    sorted.sort_by(f32::total_cmp);
    let share = |s: f64| sorted.get(cast::to_usize((s * sorted.len().saturating_sub(1) as f64).round())).copied();
    match (q.range, share(SPAN_QUANTILES[0]).zip(share(SPAN_QUANTILES[1]))) {
        (None, Some((low, high))) if low < high => {
            let clipped = sorted.first() < Some(&low) || sorted.last() > Some(&high);
            (Quantity { range: Some([low, high]), ..q.clone() }, clipped)
        }
        _ => (q.clone(), false),
    }
}

/// The legend of an attribute along its span.
fn legend(q: &Quantity, clipped: bool) -> Legend {
    let [low, high] = q.span();
    let at = |k: usize| low + (high - low) * k as f32 / (LEGEND_COLORS - 1) as f32;
    let ramp = Quantity { range: Some([low, high]), values: (0..LEGEND_COLORS).map(at).collect(), ..q.clone() };
    let [below, above] = if clipped { ["≤ ", "≥ "] } else { ["", ""] };
    let ticks = [format!("{below}{}", number(low)), number(0.5 * (low + high)), format!("{above}{}", number(high))];
    Legend::Numbers(Ramp(ramp.overlay().colors), ticks)
}

/// A number with three significant digits.
fn number(v: f32) -> String {
    match v.abs() {
        0.0 => "0".to_owned(),
        a if (1e-3..1e4).contains(&a) => {
            let digits = cast::to_usize((2.0 - a.log10().floor()).clamp(0.0, 6.0));
            let text = format!("{v:.digits$}");
            if text.contains('.') { text.trim_end_matches('0').trim_end_matches('.').to_owned() } else { text }
        }
        _ => format!("{v:.1e}"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{DVec3, Vec3};
    use gs_core::{Param, Params, Time};
    use gs_data::ImageSource;
    use gs_synth::{self as synth, SynthOptions};
    use gs_train::capabilities::{Capabilities, ParticleSource, Particles};
    use gs_train::method::{Buffers, LossValue, Method, RenderView, ViewCtx};
    use gs_train::registry::section;
    use gs_train::scene::SceneInfo;
    use gs_train::step::StepCtx;

    fn figures(method: &str) -> Vec<OverlayFigure> {
        let options = SynthOptions { size: 32, train_views: 6, test_views: 1, ..SynthOptions::default() };
        let data = synth::generate("sheet", &options).unwrap().dataset;
        let entry = gs_methods::registry().find(method).unwrap();
        let config = entry.config("tiny").unwrap();
        let scene = SceneInfo::of(&data, &section(entry.name, &config, "init").unwrap(), 3).unwrap();
        let mut method = entry.model(&config, &scene).unwrap();
        method.begin_step(100_000);
        overlay_figures(&method, &data.test[0], &data.test[0].camera, scene.last_time).unwrap()
    }

    /// Splats of which every second leaves after time 0.5.
    struct Late;

    impl Params for Late {
        fn visit(&self, _f: &mut dyn FnMut(&Param)) {}
        fn visit_mut(&mut self, _f: &mut dyn FnMut(&mut Param)) {}
    }

    impl Buffers for Late {}

    impl Method for Late {
        fn begin_step(&mut self, _at: &StepCtx) {}

        fn splats(&self, at: &Timestamp, _camera: &Camera) -> Result<Splats, MethodError> {
            let n = self.splat_count();
            let gone = (at.t.normalised - 0.5).max(0.0);
            let place = |i: usize| 0.2 * Vec3::new((i % 5) as f32, (i / 5) as f32, (i % 3) as f32);
            Ok(Splats {
                means: (0..n).map(|i| place(i) + gone * (i % 2) as f32 * Vec3::X).collect(),
                quats: vec![[1.0, 0.0, 0.0, 0.0]; n],
                scales: vec![Vec3::splat(0.05); n],
                opacities: vec![0.9; n],
                color: Color::Rgb(vec![[0.5; 3]; n]),
                ..Splats::default()
            })
        }

        fn step(&mut self, _view: &ViewCtx<'_>, _render: &mut dyn RenderView) -> Result<Vec<LossValue>, MethodError> {
            Ok(Vec::new())
        }

        fn splat_count(&self) -> usize {
            40
        }

        fn capabilities(&self) -> Capabilities<'_> {
            Capabilities { particles: Some(self), ..Capabilities::default() }
        }
    }

    impl ParticleSource for Late {
        fn particles(&self) -> Particles {
            let camera = Camera::look_at(8, 8, 0.7, DVec3::Z * 4.0, DVec3::ZERO, DVec3::Y).unwrap();
            let splats = self.splats(&Timestamp::normalised(0.4), &camera).unwrap();
            let twist = |i: usize| [[(i % 2) as f32, 0.0, 0.0], [0.0; 3], [0.0; 3], [0.0; 3], [0.0; 3], [0.0; 3]];
            let twists = (0..splats.len()).map(twist).collect();
            Particles { at: 0.4, splats, twists, origin: Vec3::ZERO, lasting: true }
        }
    }

    /// What was not seen to move is one part, whatever is learnt of it.
    #[test]
    fn parts_are_found_by_what_was_seen() {
        let config = gs_methods::registry().find("static3d").unwrap().config("tiny").unwrap();
        let model = Model::new("late", Late, section("static3d", &config, "schedule").unwrap()).unwrap();
        let camera = Camera::look_at(8, 8, 0.7, DVec3::Z * 4.0, DVec3::ZERO, DVec3::Y).unwrap();
        let view = View::new("v", camera, Time::default(), ImageSource::File("v.png".into()), 0);
        let parts = |observed: f32| {
            let figures = overlay_figures(&model, &view, &view.camera, observed).unwrap();
            let Some(Legend::Kinds(parts)) = figures.into_iter().map(|f| f.legend).next() else {
                panic!("parts alone")
            };
            parts.len()
        };
        assert_eq!([0.5, 1.0].map(parts), [1, 2]);
    }

    #[test]
    fn methods_show_what_they_have() {
        let names = |m: &str| figures(m).into_iter().map(|f| f.name).collect::<Vec<_>>();
        assert!(names("static3d").is_empty());
        let fags = names("fags");
        assert!(["lambda", "beta", "gate", "motion"].iter().all(|n| fags.iter().any(|f| f == n)), "{fags:?}");
        let trace = names("trace");
        let wanted = ["speed, units/span", "spin, rad/span", "velocity", "axis", "parts that share a motion"];
        assert!(wanted.iter().all(|n| trace.iter().any(|f| f == n)), "{trace:?}");
        let modec = names("modec");
        assert!(["global", "local", "anchor", "interval"].iter().all(|n| modec.iter().any(|f| f == n)), "{modec:?}");
        for f in figures("trace") {
            assert_eq!(f.image.shape(), (32, 32, 3), "{}", f.name);
            let numbers = matches!(f.legend, Legend::Numbers(..));
            assert_eq!(f.histogram.is_some(), numbers, "{}", f.name);
        }
    }

    #[test]
    fn few_values_far_out_do_not_stretch_the_colours() {
        let mut values: Vec<f32> = (0..200).map(|i| i as f32 / 199.0).collect();
        values[7] = 1e6;
        let q = Quantity { name: "speed", unit: "m", range: None, values };
        let (held, clipped) = without_outliers(&q);
        assert!(clipped && held.span()[1] < 1.1);
        let Legend::Numbers(ramp, ticks) = legend(&held, clipped) else { panic!() };
        let drawn = held.overlay().colors;
        assert_eq!((ramp.0.len(), ramp.0[0], ramp.0[8]), (9, drawn[0], drawn[7]), "its ends are those of the picture");
        assert_ne!(ramp.0[0], ramp.0[8]);
        assert!(ticks[0].starts_with("≤ 0.01") && ticks[2].starts_with("≥ "), "{ticks:?}");
        let (same, clipped) = without_outliers(&Quantity::share("gate", vec![0.2, 9.0]));
        assert_eq!((same.span(), clipped), ([0.0, 1.0], false), "an interval of its own stays");
        assert_eq!(
            ["0", "0.5", "12.3", "1.0e6", "123"],
            [0.0, 0.5, 12.34, 1e6, 123.4].map(number).each_ref().map(|s| &s[..])
        );
    }
}
