//! Presets build, settings that do not fit are refused, and the published behaviour can be asked for.

use super::*;
use gs_train::trainer::TrainError;

#[test]
fn presets_build_and_every_parameter_learns() {
    let data = film("cylinder", 32, 2);
    for (preset, _) in registry().find("dut").unwrap().presets {
        let config =
            testkit::config(&registry(), "dut", preset, &["textures = { unproject = 64, geo = 32, gau = 64 }"]);
        let trainer = start(&data, &config);
        let method = trainer.model();
        method.visit(&mut |p| assert!(method.schedule().rule(&p.name).is_some(), "{preset} {}", p.name));
        let at = Timestamp::new(data.train[0].time);
        let splats = method.splats(&at, &data.train[0].camera).expect("splats");
        assert_eq!((splats.check(), splats.len()), (Ok(()), method.splat_count()), "{preset}");
        assert_eq!(
            method.quantities(&at).expect("quantities").iter().map(|q| q.values.len()).collect::<Vec<_>>(),
            [method.splat_count(); 4]
        );
    }
}

#[test]
fn settings_that_do_not_fit_are_refused() {
    let data = film("cylinder", 32, 2);
    let refuse = |over: &[&str]| {
        let trainer = Trainer::new(&registry(), data.clone(), "dut", &config(over), TrainOptions::default());
        trainer.err().unwrap_or_else(|| panic!("{over:?} was taken")).to_string()
    };
    for (over, why) in [
        (&["input = \"single\""][..], "has no GeoNet"),
        (&["mode = \"direct\"", "schedule.stages.warm_up.steps = 3"], "has no GauNet"),
        (&["schedule.stages.warm_up.steps = 3"], "begins where a warm-up ends"),
        (&["schedule.stages.main.own_clock = false"], "own_clock"),
        (&["schedule.stages.main.order = 0", "schedule.stages.geometry.order = 3"], "the order must be"),
        (&["textures.geo = 60"], "multiple of 8"),
        (&["gaussians.sh_degree = 4"], "`gaussians.sh_degree` = 4"),
        (&["surface.isometry = -1.0"], "`surface.isometry` = -1"),
        (&["surface.color = 0.05"], "surface.points = \"faces\""),
        (&["unproject.min_cos = 2.0"], "min_cos"),
        (&["reference.opacity = 1.0"], "reference.opacity"),
        (&["schedule.lambda_mrf = -0.1"], "`schedule.lambda_mrf` = -0.1"),
        (&["schedule.lambda_mrf = nan"], "schedule.lambda_mrf"),
        (&["schedule.mrf_side = 4"], "`schedule.mrf_side` = 4"),
        (&["schedule.mrf_sid = 4"], "unknown field `mrf_sid`"),
    ] {
        let error = refuse(over);
        assert!(error.contains(why), "{over:?}: {error}");
    }
}

/// Weights of the user stand in for the fixed filters; a run whose weights are gone can be rendered, and not trained.
#[test]
fn textures_are_compared_by_the_weights_that_are_named() {
    let (dir, data) = (tempfile::tempdir().expect("folder"), film("cylinder", 32, 2));
    let file = dir.path().join("vgg19.safetensors");
    std::fs::write(&file, gs_metrics::testkit::file(&gs_metrics::testkit::vgg19())).expect("file");
    let named = |file: &std::path::Path| {
        let weights = format!("mrf_weights = \"{}\"", file.display());
        format!(
            "schedule.lambda_mrf = 0.01\nschedule.mrf_side = 32\nschedule.{weights}\nschedule.stages.geometry.steps = 0\nschedule.stages.warm_up.steps = 0\ninput = \"single\""
        )
    };
    let term = |over: &str| -> Result<Option<f64>, TrainError> {
        let mut trainer = start(&data, &config(&[SHORT, over]));
        trainer.step().map(|report| report.loss.term("mrf"))
    };
    let own = term(&named(&file)).expect("step").expect("term");
    let bank = term(&named(&file).replace(file.to_str().expect("path"), "")).expect("step").expect("term");
    assert!(own.is_finite() && (own - bank).abs() > 1e-6, "{own} {bank}");
    let error = term(&named(&dir.path().join("gone"))).expect_err("no file").to_string();
    assert!(error.contains("schedule.mrf_weights") && error.contains("gone"), "{error}");
}

/// Everything as in the authors' code, where that is not the default.
const PUBLISHED: &str = r#"
resize = "plain"
centred = false
refine.rule = "first_edge"
gaussians.decode.covariance = "raw"
geonet.norm_over = "all"
[unproject]
rule = "bilinear"
mask = "binary"
min_weight = 0.0
compat = { align_corners = true, clip_depth = true, zero_background = true }
[surface]
slide = 1.0
laplacian_rule = "positions"
isometry = 0.1
isometry_rule = "first_edge"
texture = 0.0
seams = "first"
[gaunet]
residual = false
unseen = "black"
own = false
net.norm_over = "all"
[schedule]
lambda_mrf = 0.01
mrf_side = 32
"#;

#[test]
fn published_behaviour_can_be_asked_for() {
    let data = film("person", 48, 2);
    let mut trainer = start(&data, &config(&[SHORT, PUBLISHED]));
    for step in 1..=trainer.steps() {
        let report = trainer.step().expect("step");
        let drawn = step > 9;
        assert!(
            report.loss.total.is_finite() && report.loss.term("mrf").is_some() == drawn,
            "{step}: {:?}",
            report.loss
        );
    }
    assert!(in_mask(&trainer, &data, Split::Test).is_finite());
    let at = Timestamp::new(data.train[0].time);
    let shown = |over: &[&str]| {
        let method = bare(&data, &config(over), 15);
        let second = method.second(&method.actor().scene.frames[1]).expect("frame");
        (second.seen.clone(), method.splats(&at, &data.train[0].camera).expect("splats"))
    };
    let same_size = &format!("textures = {{ unproject = 64, geo = 32, gau = 32 }}{RESIDUAL}");
    let (masked, _) = shown(&[SHORT, same_size]);
    let (plain, turned) = shown(&[SHORT, same_size, "resize = \"plain\""]);
    // Black bleeds in: no texel is brighter, those at borders are darker.
    let darker = plain.colors.iter().zip(&masked.colors).filter(|(p, m)| p[0] + 1e-6 < m[0]).count();
    assert!(darker > plain.colors.len() / 50, "{darker} of {}", plain.colors.len());
    let brighter = plain.colors.iter().zip(&masked.colors).filter(|(p, m)| p[0] > m[0] + 1e-6).count();
    assert_eq!(brighter, 0);
    let raw = shown(&[SHORT, same_size, "resize = \"plain\"\ngaussians.decode.covariance = \"raw\""]).1;
    assert!(raw.means == turned.means && raw.quats != turned.quats && raw.scales != turned.scales);
}
