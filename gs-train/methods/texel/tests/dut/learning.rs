//! Runs that learn: values of the texels' own, GauNet on unseen cameras, and GauNet over-fitting a frame.

use super::*;
use gs_synth::avatar::{self, AvatarOptions, Morphs};

#[test]
fn values_of_the_texels_own_show_what_was_filmed() {
    let data = film("cylinder", 64, 3);
    let over = "
[textures]
unproject = 64
geo = 32
gau = 64
[schedule]
stages.geometry.steps = 0
stages.main.steps = 1500
lr.texels.log_scales.steps = 1500
lr.texels.sh_dc.steps = 1500
lr.texels.offsets.steps = 1500
lr.texels.gain.steps = 1500
";
    let mut trainer = start(&data, &config(&[DIRECT, "input = \"single\"", over]));
    let before = in_mask(&trainer, &data, Split::Train);
    run(&mut trainer, 1500);
    let after = in_mask(&trainer, &data, Split::Train);
    assert!(after > 32.0 && after > before + 2.0, "{before:.2} dB before, {after:.2} dB after");
}

#[test]
fn networks_show_a_person_to_unseen_cameras() {
    let options = AvatarOptions { size: 96, frames: 4, points: 0, morph: Morphs::Apply, ..AvatarOptions::default() };
    let data = Arc::new(avatar::generate(&options).expect("film"));
    let over = "
textures = { unproject = 64, geo = 32, gau = 64 }
[schedule]
stages.geometry.steps = 0
stages.main.steps = 150
lr.gau.all.steps = 150
lr.texels = { log_scales.steps = 150, sh_dc.steps = 150, offsets.steps = 150 }
";
    let config = config(&["input = \"single\"", over]);
    let mut trainer = start(&data, &config);
    let before = in_mask(&trainer, &data, Split::Test);
    run(&mut trainer, 150);
    let after = in_mask(&trainer, &data, Split::Test);
    assert!(after > 23.0 && after > before + 5.0, "{before:.2} dB before, {after:.2} dB after");
}

#[test]
fn gaunet_fits_four_views_of_a_frame() {
    let data = film("cylinder", 64, 1);
    assert_eq!(data.train.len(), 4);
    let over = "
input = \"single\"
gaunet.residual = false
gaunet.own = false
textures = { unproject = 64, geo = 32, gau = 64 }
[schedule]
stages.geometry.steps = 0
stages.warm_up.steps = 200
stages.main.steps = 450
lr.gau.all = { start = 3e-3, end = 1e-4, steps = 450 }
";
    let mut trainer = start(&data, &config(&[over]));
    run(&mut trainer, 200);
    let warm = in_mask(&trainer, &data, Split::Train);
    run(&mut trainer, 450);
    let fitted = in_mask(&trainer, &data, Split::Train);
    assert!(warm > 20.0 && fitted > 30.0, "{warm:.2} dB after the warm-up, {fitted:.2} dB in the end");
}
