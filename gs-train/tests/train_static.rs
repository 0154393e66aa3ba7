//! Training of a static scene, end to end: it learns, it does not depend on threads, it resumes bit for bit.

mod train_support;

use train_support::*;

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
