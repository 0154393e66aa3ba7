//! Every method learns a generated scene, end to end.

use crate::support::*;

#[test]
fn a_static_scene_is_learnt() {
    let data = scene("static", 48, 24);
    let mut trainer = trainer(&data, "static3d", "");
    let before = psnr(&trainer, &data);
    let reports = run(&mut trainer, 300);
    let after = psnr(&trainer, &data);
    assert!(after > before + 8.0 && after > 22.0, "{before:.2} dB before, {after:.2} dB after");
    let mean = |r: &[gs_train::trainer::StepReport]| r.iter().map(|r| r.loss.total).sum::<f64>() / r.len() as f64;
    assert!(mean(&reports[280..]) < 0.5 * mean(&reports[..20]));
    assert!(reports.iter().any(|r| r.adapted.cloned + r.adapted.split > 0), "growth took part");
    assert!(reports.iter().any(|r| r.adapted.reset), "a reset took part");
    assert!(matches!(trainer.step(), Err(gs_train::trainer::TrainError::Finished(300))));
}

/// Moving scenes are learnt better with their field than a still cloud can.
#[test]
fn motion_is_learnt() {
    let data = scene("sheet", 48, 60);
    let scored = |method: &str| {
        let mut trainer = trainer(&data, method, "density.max_splats = 700");
        let steps = trainer.steps();
        run(&mut trainer, steps);
        psnr(&trainer, &data)
    };
    let still = scored("static3d");
    for method in ["defgs", "fourdgs", "grid4d", "fags", "acutance"] {
        let moving = scored(method);
        println!("{method}: {moving:.2} dB, a still cloud has {still:.2} dB");
        assert!(moving > still + 4.0, "{method}: {moving:.2} dB, a still cloud has {still:.2} dB");
    }
}
