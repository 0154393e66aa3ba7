//! A data set without a filmed person is refused by name.

use gs_data::Dataset;
use gs_method_texel::ENTRY;
use gs_synth::avatar::{AvatarOptions, generate};
use gs_train::method::MethodError;
use gs_train::registry::MethodEntry;

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
