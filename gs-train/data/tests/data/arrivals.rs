//! Frames of a person that arrive in a folder.

use gs_data::avatar::layout::{Arrivals, PosesFrom};
use gs_data::avatar::{AvatarScene, Morphs};
use gs_data::{DataOptions, Dataset, ImageCache};
use gs_synth::avatar::{AvatarOptions, write};
use serde_json::{Value, json};
use std::time::Duration;

#[test]
fn the_newest_whole_frame_arrives() {
    let film = tempfile::tempdir().unwrap();
    let options = AvatarOptions { per_ring: 8, rings: 1, frames: 3, size: 16, points: 50, ..AvatarOptions::default() };
    write(film.path(), &options, false, false).unwrap();
    let data = Dataset::open(film.path(), &DataOptions::default()).unwrap();
    let s = data.avatar.as_ref().unwrap();
    let skeleton = &s.character.skeleton;
    let dir = tempfile::tempdir().unwrap();
    let mut arrivals =
        Arrivals::new(dir.path(), &data, PosesFrom::Folder, DataOptions { scale: 0.5, ..DataOptions::default() })
            .unwrap();
    let ids: Vec<u32> = arrivals.cameras().collect();
    assert_eq!(ids, s.frames[0].inputs.iter().map(|v| v.camera_id).collect::<Vec<_>>());
    let image = |id: u32, number: u32| format!("images/{id:03}/{number:06}.png");
    let put = |id: u32, from: u32, to: u32| {
        let target = dir.path().join(image(id, to));
        std::fs::create_dir_all(target.parent().unwrap()).unwrap();
        std::fs::copy(film.path().join(image(id, from)), target).unwrap();
    };
    let pose = |number: u32, pose: Value| {
        std::fs::create_dir_all(dir.path().join("poses")).unwrap();
        std::fs::write(dir.path().join(format!("poses/{number:06}.json")), pose.to_string()).unwrap();
    };
    // Not before all cameras and the pose are there.
    ids[1..].iter().for_each(|id| put(*id, 1, 101));
    pose(101, json!({"nodes": {"head": {"rotation": [0, 1, 0, 0]}}}));
    assert!(arrivals.newest().unwrap().is_none());
    put(ids[0], 1, 101);
    ids.iter().for_each(|id| put(*id, 2, 102));
    let frame = arrivals.newest().unwrap().unwrap();
    assert_eq!((frame.number, frame.passed_over), (101, 0));
    let mut want = skeleton.rest_pose();
    want.locals[skeleton.node("head").unwrap() as usize].rotation = [0.0, 1.0, 0.0, 0.0];
    assert_eq!(frame.pose, want);
    let cache = ImageCache::new(0, 1.0);
    let half = Dataset::open(film.path(), &DataOptions { scale: 0.5, ..DataOptions::default() }).unwrap();
    assert_eq!(
        frame.images,
        AvatarScene::input_images(&half.avatar.as_ref().unwrap().frames[1].inputs, &cache).unwrap()
    );
    assert!(frame.written.elapsed().unwrap().as_secs() < 60);
    // A change within one tick of the file system's clock is seen a little later.
    let tick = || std::thread::sleep(Duration::from_millis(60));
    // Of several the newest; older ones never again.
    ids.iter().for_each(|id| put(*id, 0, 103));
    pose(102, json!({}));
    pose(103, json!({}));
    tick();
    let frame = arrivals.newest().unwrap().unwrap();
    assert_eq!((frame.number, frame.passed_over), (103, 1));
    assert!(arrivals.newest().unwrap().is_none());
    // A file that is being written is waited for; one that stays damaged is named once.
    ids.iter().for_each(|id| put(*id, 0, 104));
    pose(104, json!({"nodes": {"tail": {}}}));
    assert!(arrivals.newest().unwrap().is_none());
    let old = std::time::SystemTime::now() - Duration::from_secs(5);
    let files = ids.iter().map(|id| image(*id, 104)).chain(["poses/000104.json".into()]);
    files.for_each(|f| {
        std::fs::File::options().append(true).open(dir.path().join(f)).unwrap().set_modified(old).unwrap()
    });
    tick();
    let fault = arrivals.newest().unwrap_err();
    assert!(fault.code() == "data.field" && fault.report().contains("000104.json") && fault.report().contains("tail"));
    assert!(arrivals.newest().unwrap().is_none());
    // Poses of the film, by number.
    let mut filmed = Arrivals::new(film.path(), &data, PosesFrom::Film, DataOptions::default()).unwrap();
    let last = filmed.newest().unwrap().unwrap();
    let newest = s.frames.last().unwrap();
    assert_eq!((last.number, &last.pose, last.passed_over), (newest.number, &newest.pose, s.frames.len() - 1));
    let nobody = Dataset { avatar: None, ..data.without_views() };
    assert!(Arrivals::new(dir.path(), &nobody, PosesFrom::Film, DataOptions::default()).is_err());
}

#[test]
fn morphs_of_an_arriving_pose_count_where_poses_of_the_film_state_them() {
    for morph in [Morphs::Gt, Morphs::Apply, Morphs::Ignore] {
        let film = tempfile::tempdir().unwrap();
        let options =
            AvatarOptions { per_ring: 4, rings: 1, frames: 1, size: 16, points: 0, morph, ..AvatarOptions::default() };
        write(film.path(), &options, false, false).unwrap();
        let data = Dataset::open(film.path(), &DataOptions::default()).unwrap();
        let rest = &data.avatar.as_ref().unwrap().character.skeleton.rest_morphs;
        assert!(!rest.is_empty());
        let stated: Vec<f32> = rest.iter().map(|m| m + 0.25).collect();
        let poses = film.path().join("poses");
        std::fs::create_dir_all(&poses).unwrap();
        std::fs::write(poses.join("000000.json"), json!({"nodes": {}, "morphs": stated}).to_string()).unwrap();
        let mut arrivals = Arrivals::new(film.path(), &data, PosesFrom::Folder, DataOptions::default()).unwrap();
        let frame = arrivals.newest().unwrap().unwrap();
        assert_eq!(&frame.pose.morphs, if morph == Morphs::Apply { &stated } else { rest }, "{morph:?}");
    }
}
