//! Texture resolution.

use super::subject::Errors;
use super::trained::{SCORES, scores};
use super::{Cell, Chart, Findings, LabError, Log, Setup, Subject, Trained};
use gs_core::Params;
use gs_method_texel::Dut;
use gs_texel::unproject::UnprojectConfig;
use gs_train::method::{Method, MethodError};
use gs_train::timestamp::Timestamp;
use std::time::Instant;

/// Unprojects at every resolution, and with a recipe trains texel Gaussians at every resolution.
pub(super) fn sizes(setup: &Setup, log: &mut Log<'_>) -> Result<Findings, LabError> {
    let subject = Subject::new(setup, log)?;
    let mut heads = vec![("of", 0), ("side", 0), ("texels", 0), ("MB", 2), ("seen %", 1), ("texture dB", 2), ("ms", 1)];
    heads.extend(SCORES);
    let remark = "Texture: colours unprojected on the true surface against the template's own, seen texels, means over \
                  frames; MB of its map. Gaussians: test views; MB of all parameters; ms of one frame up to its Gaussians.";
    let mut out = Findings::new("tex", remark, &heads);
    for &side in &setup.sizes {
        log(&format!("texture of {side}x{side}"));
        out.rows.push(unprojected(&subject, side)?);
    }
    for &side in setup.sizes.iter().filter(|_| setup.recipe.is_some()) {
        out.rows.push(gaussians(&subject, setup, side, log)?);
    }
    let chart = |part, title: &str, column| Chart {
        part,
        title: title.into(),
        across: "side",
        drawn: vec![column],
        split: Some("of"),
    };
    out.charts = vec![
        chart("", "Texture, dB over seen texels", "texture dB"),
        chart("time", "Milliseconds a frame", "ms"),
        chart("scores", "In-mask PSNR of test views, dB", "in-mask PSNR"),
    ];
    Ok(out)
}

fn unprojected(subject: &Subject, side: usize) -> Result<Vec<Cell>, LabError> {
    let table = subject.table(side)?;
    let (truth, mut errors) = (subject.truth(&table), Errors::default());
    for frame in &subject.scene.frames {
        let images = subject.images(&frame.inputs)?;
        let surface = subject.scene.true_surface(frame);
        let (texture, ms) = subject.texture(&surface, &images, &table, &UnprojectConfig::default())?;
        errors.add(&texture.colors, texture.seen.iter().map(|&n| n > 0), &truth, ms);
    }
    let mut row: Vec<Cell> = vec!["texture".into(), (side as f64).into(), (table.len() as f64).into()];
    let megabytes = (side * side * 3 * size_of::<f32>()) as f64 * 1e-6;
    row.extend([megabytes.into(), (100.0 * errors.coverage()).into(), errors.psnr().into(), errors.ms().into()]);
    row.extend([None; 4].map(Cell::from));
    Ok(row)
}

fn gaussians(subject: &Subject, setup: &Setup, side: usize, log: &mut Log<'_>) -> Result<Vec<Cell>, LabError> {
    let Some(recipe) = &setup.recipe else { return Ok(Vec::new()) };
    // A texture finer than the Gaussians only costs time.
    let sets = [format!("textures.gau={side}"), format!("textures.unproject={side}")];
    let trained = Trained::learn(&subject.full_film, recipe, &sets.each_ref().map(String::as_str), log)?;
    let report = trained.scores(&subject.film, &[])?;
    let dut = trained.on(&subject.film, &[])?;
    let megabytes = 4.0 * Params::param_count(&dut) as f64 * 1e-6;
    let mut row: Vec<Cell> = vec!["Gaussians".into(), (side as f64).into(), (dut.splat_count() as f64).into()];
    row.extend([megabytes.into(), None.into(), None.into(), ms_per_frame(&dut, subject)?.into()]);
    row.extend(scores(Some(&report)).map(Cell::from));
    Ok(row)
}

/// Mean milliseconds to compute the Gaussians of a frame.
fn ms_per_frame(dut: &Dut, subject: &Subject) -> Result<f64, MethodError> {
    let frames = &subject.scene.frames;
    let begun = Instant::now();
    for frame in frames {
        dut.splats(&Timestamp::new(frame.time), &frame.inputs[0].camera)?;
    }
    Ok(begun.elapsed().as_secs_f64() * 1e3 / frames.len() as f64)
}
