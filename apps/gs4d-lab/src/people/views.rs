//! Number of conditioning cameras.

use super::subject::Errors;
use super::trained::{SCORES, scores};
use super::{Cell, Chart, Findings, LabError, Log, Setup, Subject, Trained};
use glam::DVec3;
use gs_data::View;
use gs_synth::avatar::AvatarOptions;
use gs_texel::unproject::UnprojectConfig;

/// Numbers of conditioning cameras compared.
const COUNTS: [usize; 6] = [1, 2, 3, 4, 6, 8];

/// Conditions on the first 1 to 8 cameras, then on the film's own cameras without one of them.
pub(super) fn views(setup: &Setup, log: &mut Log<'_>) -> Result<Findings, LabError> {
    // Without test frames, every frame has more cameras than its inputs.
    let setup = &Setup { film: AvatarOptions { test_every: 0, ..setup.film.clone() }, ..setup.clone() };
    let whole = Subject::new(setup, log)?;
    let trained = Trained::of(setup, &whole.full_film, log)?;
    let (subject, orders) = with_most_cameras(&whole)?;
    let table = subject.table(setup.texels)?;
    let truth = subject.truth(&table);
    let heads = [("views", 0), ("cameras", 0), ("seen %", 1), ("texture dB", 2), ("ms", 1)];
    let remark = "Cameras: the film's inputs first, then training cameras, each time the one farthest from those before; test \
                  cameras are never inputs. Texture: on the true surface, against the template's own colour at seen texels.";
    let mut out = Findings::new("views", remark, &[&heads[..], &SCORES].concat());
    let row = |chosen: &dyn Fn(usize) -> Vec<View>| -> Result<Vec<Cell>, LabError> {
        let film = subject.changed(|k, frame| frame.inputs = chosen(k));
        let Some(scene) = &film.avatar else { return Ok(Vec::new()) };
        let mut errors = Errors::default();
        for frame in &scene.frames {
            let images = subject.images(&frame.inputs)?;
            let (texture, ms) =
                subject.texture(&scene.true_surface(frame), &images, &table, &UnprojectConfig::default())?;
            errors.add(&texture.colors, texture.seen.iter().map(|&n| n > 0), &truth, ms);
        }
        let report = trained.as_ref().map(|t| t.scores(&film, &[])).transpose()?;
        let names: Vec<String> = scene.frames[0].inputs.iter().map(|v| v.camera_id.to_string()).collect();
        let mut row: Vec<Cell> = vec![(names.len() as f64).into(), names.join(" ").into()];
        row.extend([Some(100.0 * errors.coverage()), errors.psnr(), Some(errors.ms())].map(Cell::from));
        row.extend(scores(report.as_ref()).map(Cell::from));
        Ok(row)
    };
    let available = orders.iter().map(Vec::len).min().unwrap_or(0);
    for count in COUNTS.into_iter().filter(|c| *c <= available) {
        log(&format!("{count} views"));
        out.rows.push(row(&|k| orders[k][..count].to_vec())?);
    }
    let counted = out.rows.len();
    let own = Some(subject.scene.input_count()).filter(|n| *n > 1);
    for left in 0..own.unwrap_or(0) {
        let all_but = |k: usize| {
            let inputs = subject.scene.frames[k].inputs.iter().enumerate();
            inputs.filter(|(i, _)| *i != left).map(|(_, v)| v.clone()).collect()
        };
        out.rows.push(row(&all_but)?);
    }
    // Rows with a camera left out are not charted.
    let chart = |part, title: &str, column| Chart {
        part,
        title: title.into(),
        across: "views",
        drawn: vec![column],
        split: None,
    };
    out.charts =
        vec![chart("", "Texels seen, %", "seen %"), chart("scores", "In-mask PSNR of test views, dB", "in-mask PSNR")];
    out.charted = Some(counted);
    Ok(out)
}

/// Restricts the subject to the frames with the most cameras; also returns the cameras of each in the order of selection.
fn with_most_cameras(subject: &Subject) -> Result<(Subject, Vec<Vec<View>>), LabError> {
    let orders: Vec<Vec<View>> = subject
        .scene
        .frames
        .iter()
        .map(|frame| {
            let more = subject.film.train.iter().filter(|v| v.time == frame.time);
            let more = more.filter(|v| frame.inputs.iter().all(|i| i.camera_id != v.camera_id));
            let mut order = Vec::new();
            farthest_first(&mut order, frame.inputs.clone());
            farthest_first(&mut order, more.cloned().collect());
            order
        })
        .collect();
    let most = orders.iter().map(Vec::len).max().unwrap_or(0);
    let kept: Vec<bool> = orders.iter().map(|o| o.len() == most).collect();
    let orders = orders.into_iter().zip(&kept).filter(|(_, keep)| **keep).map(|(o, _)| o).collect();
    let none = || LabError::Unfit("there is no frame to evaluate".into());
    Ok((subject.only(&kept)?.ok_or_else(none)?, orders))
}

/// Appends views in farthest-point order of their cameras (the first of equals).
fn farthest_first(order: &mut Vec<View>, mut views: Vec<View>) {
    let place = |v: &View| v.camera.position();
    while !views.is_empty() {
        let distance = |at: DVec3| order.iter().map(|o| place(o).distance(at)).fold(f64::INFINITY, f64::min);
        let mut best = 0;
        for k in 1..views.len() {
            // Cameras of a ring are equally far apart: rounding must not decide.
            if distance(place(&views[k])) > distance(place(&views[best])) * (1.0 + 1e-9) {
                best = k;
            }
        }
        order.push(views.remove(best));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use gs_core::{Camera, Time};
    use gs_data::ImageSource;
    use gs_data::ImageU8;
    use std::sync::Arc;

    #[test]
    fn cameras_are_taken_from_afar() {
        let view = |k: u32| {
            let turn = f64::from(k) * std::f64::consts::FRAC_PI_4;
            let eye = 3.0 * DVec3::new(turn.sin(), 0.0, turn.cos());
            let camera = Camera::look_at(4, 4, 0.7, eye, DVec3::ZERO, DVec3::Y).unwrap();
            let image = ImageSource::Memory(Arc::new(ImageU8 { width: 0, height: 0, data: Vec::new() }));
            View::new("", camera, Time::default(), image, k)
        };
        let mut order = Vec::new();
        farthest_first(&mut order, (0..4).map(|k| view(2 * k)).collect());
        farthest_first(&mut order, (0..4).map(|k| view(2 * k + 1)).collect());
        let ids: Vec<u32> = order.iter().map(|v| v.camera_id).collect();
        // Those between are as far from their neighbours as each other, whichever went before: in their own order.
        assert_eq!(ids, [0, 4, 2, 6, 1, 3, 5, 7]);
    }
}
