//! Data without a filmed person, or with a frame that cannot be read, are refused by name.

use super::*;
use gs_data::ImageSource;
use gs_method_texel::ENTRY;
use gs_synth::SynthOptions;
use gs_synth::avatar::{AvatarOptions, generate};
use gs_synth::testkit::dataset;
use gs_train::registry::MethodEntry;
use gs_train::saved;
use gs_train::trainer::TrainError;

#[test]
fn a_data_set_without_a_person_is_refused() {
    let options = AvatarOptions { per_ring: 8, rings: 2, frames: 5, size: 40, points: 400, ..AvatarOptions::default() };
    let film = generate(&options).unwrap();
    assert!(ENTRY.avatar(&film).unwrap().is_some());
    let other = MethodEntry { needs_avatar: false, ..ENTRY };
    assert!(other.avatar(&film).unwrap().is_none(), "others are not given one");
    let bare = Dataset { avatar: None, root: "some/folder".into(), ..film };
    let e = ENTRY.avatar(&bare).unwrap_err();
    assert!(matches!(e, MethodError::NoAvatar { method: "dut", .. }));
    assert!(e.to_string().contains("some/folder") && e.to_string().contains("gs4d synth avatar"), "{e}");
}

#[test]
fn data_without_a_person_are_refused() {
    let data = dataset("balls", &SynthOptions::of_views(32, 4, 0));
    let error = Trainer::new(&registry(), data, "dut", &config(&[]), TrainOptions::default())
        .err()
        .expect("refused")
        .to_string();
    assert!(error.contains("method `dut` needs a filmed person"), "{error}");
    let state = start(&film("cylinder", 32, 2), &config(&[SHORT])).state();
    let error = saved::load(&registry(), &state, None).err().expect("refused");
    assert!(error.contains("needs a filmed person"), "{error}");
}

#[test]
fn a_frame_that_cannot_be_made_stops_training_with_its_number() {
    let mut data = film("cylinder", 32, 2);
    let person = Arc::make_mut(Arc::make_mut(&mut data).avatar.as_mut().expect("person"));
    person.frames[1].inputs[0].image = ImageSource::File("/nowhere/0.png".into());
    person.frames[0].points = None;
    let mut trainer =
        start(&data, &config(&[SHORT, "centred = false\nsurface.texture = 0.0\ngaunet.unseen = \"black\""]));
    let error = (0..5).find_map(|_| trainer.step().err()).expect("stopped");
    assert!(matches!(error, TrainError::Method(_)), "{error}");
    let text = error.to_string();
    assert!(text.contains("frame 0") && text.contains("no points") || text.contains("frame 1"), "{text}");
}
