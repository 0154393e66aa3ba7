use super::silhouette::MAX_FRAMES;
use super::*;
use glam::DVec3;
use gs_core::Camera;
use gs_data::avatar::{AvatarFrame, Morphs};
use gs_data::{ImageSource, View};
use gs_synth::avatar::{AvatarOptions, generate};
use std::sync::{Arc, Mutex, OnceLock};

/// A film of the built-in person by eight cameras; each is made once.
fn film(clip: &str, size: u32, morph: Morphs) -> Dataset {
    static MADE: Mutex<BTreeMap<String, Arc<OnceLock<Dataset>>>> = Mutex::new(BTreeMap::new());
    let made = MADE.lock().expect("films").entry(format!("{clip} {size} {morph:?}")).or_default().clone();
    let options = AvatarOptions {
        clip: Some(clip.into()),
        size,
        frames: 16,
        rings: 1,
        points: 0,
        supersample: 4,
        morph,
        ..AvatarOptions::default()
    };
    made.get_or_init(|| generate(&options).expect("film")).clone()
}

fn findings(data: &Dataset) -> Vec<Finding> {
    checked(data).findings
}

fn checked(data: &Dataset) -> Checked {
    check(data, &ImageCache::new(256 << 20, 1.0))
}

/// The film with something changed about the person.
fn edited(data: &Dataset, edit: impl FnOnce(&mut AvatarScene)) -> Dataset {
    let mut data = data.clone();
    let mut scene = (**data.avatar.as_ref().expect("person")).clone();
    edit(&mut scene);
    data.avatar = Some(scene.into());
    data
}

/// The film whose poses are those of frames `by` later.
fn late(data: &Dataset, by: isize) -> Dataset {
    edited(data, |scene| {
        let poses: Vec<_> = scene.frames.iter().map(|f| f.pose.clone()).collect();
        let last = poses.len() as isize - 1;
        for (k, frame) in scene.frames.iter_mut().enumerate() {
            frame.pose = poses[(k as isize + by).clamp(0, last) as usize].clone();
        }
    })
}

/// The film with the views of one camera changed.
fn with_camera(data: &Dataset, id: u32, edit: impl Fn(&mut View, usize)) -> Dataset {
    let mut data = edited(data, |scene| {
        for (k, frame) in scene.frames.iter_mut().enumerate() {
            frame.inputs.iter_mut().filter(|v| v.camera_id == id).for_each(|v| edit(v, k));
        }
    });
    let scene = data.avatar.clone().expect("person");
    let row = |t| scene.frames.iter().position(|f| f.number == scene.frame_at(t).number).expect("frame");
    data.train.iter_mut().filter(|v| v.camera_id == id).for_each(|v| edit(v, row(v.time)));
    data
}

fn turned(camera: &Camera, degrees: f64) -> Camera {
    let turn = glam::DMat3::from_rotation_y(degrees.to_radians());
    Camera { rotation: turn * camera.rotation, translation: turn * camera.translation, ..camera.clone() }
}

const CLIPS: [&str; 3] = ["walk", "wave", "turn"];
const SIZES: [u32; 2] = [64, 128];

/// Every clip, at sizes in turn.
fn films() -> Vec<(String, Dataset)> {
    let named = |(clip, size): (&&str, u32)| (format!("{clip} {size}"), film(clip, size, Morphs::Gt));
    CLIPS.iter().zip(SIZES.into_iter().cycle()).map(named).collect()
}

/// The code of every finding above a note, with the places it names.
fn reported(data: &Dataset) -> Vec<(&'static str, String)> {
    let found = findings(data).into_iter().filter(|f| f.verdict > Verdict::Note);
    found.map(|f| (f.code, format!("{} {}", f.what, f.places.join(", ")))).collect()
}

#[test]
fn a_sound_film_has_no_finding_whatever_its_morphs_do() {
    for clip in CLIPS {
        let [small, large] = SIZES;
        for (size, morph) in [(small, Morphs::Gt), (small, Morphs::Apply), (small, Morphs::Ignore), (large, Morphs::Gt)]
        {
            let found = findings(&film(clip, size, morph));
            let good = found.len() == 1 && found[0].verdict == Verdict::Ok;
            assert!(good, "{clip} {size} {morph:?}: {found:?}");
        }
    }
}

#[test]
fn poses_of_other_frames_are_found_with_their_number() {
    for (name, data) in films() {
        for by in [-3, -2, 2, 3] {
            let reported = reported(&late(&data, by));
            let way = if by < 0 { "later" } else { "earlier" };
            let right =
                |t: &(&str, String)| t.0 == "template.time" && t.1.contains(&format!("{} frames {way}", by.abs()));
            assert!(reported.len() == 1 && right(&reported[0]), "{name} {by}: {reported:?}");
        }
    }
}

#[test]
fn a_joint_that_is_bent_is_named() {
    for (name, data) in films() {
        for (joint, degrees) in [("left upper arm", 10.0f64), ("left upper arm", 40.0), ("right thigh", 15.0)] {
            let bent = edited(&data, |scene| {
                let node = scene.character.skeleton.node(joint).expect("joint");
                scene.frames.iter_mut().for_each(|f| f.pose.turn(node, DVec3::Z, degrees.to_radians()));
            });
            let reported = reported(&bent);
            let part = if joint.contains("arm") { "left hand" } else { "right " };
            let right = |t: &(&str, String)| ["template.joint", "template.fit"].contains(&t.0) && t.1.contains(part);
            assert!(reported.len() == 1 && right(&reported[0]), "{name} {joint} {degrees}: {reported:?}");
        }
    }
}

#[test]
fn a_camera_that_is_turned_or_late_is_named() {
    for (name, data) in films() {
        let id = data.train[0].camera_id;
        for degrees in [1.0, 4.0] {
            let reported = reported(&with_camera(&data, id, |v, _| v.camera = turned(&v.camera, degrees)));
            let right = |t: &(&str, String)| t.0 == "template.camera" && t.1.contains(&format!("camera {id}:"));
            assert!(reported.len() == 1 && right(&reported[0]), "{name} {degrees}: {reported:?}");
        }
        let scene = data.avatar.clone().expect("person");
        let image = |f: &AvatarFrame| {
            let own = f.inputs.iter().chain(&data.train).find(|v| v.camera_id == id && v.time == f.time);
            own.expect("a view of every frame").image.clone()
        };
        let images: Vec<_> = scene.frames.iter().map(image).collect();
        for by in [-3isize, 2] {
            let of = |k: usize| images[k.saturating_add_signed(by).min(images.len() - 1)].clone();
            let reported = reported(&with_camera(&data, id, |v, k| v.image = of(k)));
            let right =
                |t: &(&str, String)| t.0 == "template.clock" && t.1.contains(&format!("camera {id}: {by:+} frames"));
            assert!(reported.len() == 1 && right(&reported[0]), "{name} {by}: {reported:?}");
        }
    }
}

#[test]
fn a_template_of_another_size_is_told_with_its_ratio() {
    let data = film("walk", 128, Morphs::Gt);
    for (factor, code) in [(1.12f32, "template.fit"), (0.85, "template.fit"), (100.0, "template.away")] {
        let scaled = edited(&data, |scene| scene.character.template.vertices.iter_mut().for_each(|v| *v *= factor));
        let reported = reported(&scaled);
        assert!(reported.len() == 1 && reported[0].0 == code, "{factor}: {reported:?}");
        let ratio =
            reported[0].1.split("silhouettes are ").nth(1).and_then(|t| t.split(' ').next()?.parse::<f32>().ok());
        // Of a template in centimetres the camera sees nothing whole.
        assert!(factor > 10.0 || ratio.is_some_and(|r| (r * factor - 1.0).abs() < 0.03), "{factor}: {reported:?}");
    }
}

#[test]
fn images_without_silhouettes_say_so() {
    let data = film("walk", 64, Morphs::Gt);
    let opaque = |v: &mut View| {
        let image = ImageCache::new(0, 1.0).get(v).expect("image");
        let mut image = (*image).clone();
        image.data.chunks_exact_mut(4).for_each(|p| p[3] = 255);
        v.image = ImageSource::Memory(image.into());
    };
    let mut data = edited(&data, |scene| scene.frames.iter_mut().flat_map(|f| &mut f.inputs).for_each(opaque));
    data.train.iter_mut().for_each(opaque);
    assert_eq!(reported(&data).iter().map(|t| t.0).collect::<Vec<_>>(), ["template.masks"]);
    assert_eq!(checked(&data).outlines, None);
    let Checked { findings, figures, .. } = checked(&film("walk", 64, Morphs::Gt));
    assert_eq!((findings.len(), figures.len()), (1, NAMED));
}

/// Whether or not anything is wrong with the film.
#[test]
fn distances_of_every_camera_and_joint_are_listed() {
    let data = film("walk", 64, Morphs::Gt);
    let listed = |data: &Dataset| checked(data).outlines.expect("silhouettes");
    let sound = listed(&data);
    assert!(sound.cameras.len() > 3 && sound.cameras.iter().all(|c| c.views == MAX_FRAMES), "{sound:?}");
    assert!(sound.cameras.iter().all(|c| c.metres > 0.0 && c.metres < 0.04), "{sound:?}");
    assert!(sound.joints.len() > 4 && sound.joints.is_sorted_by(|a, b| a.metres >= b.metres), "{sound:?}");

    let id = data.train[0].camera_id;
    let turned = listed(&with_camera(&data, id, |v, _| v.camera = turned(&v.camera, 4.0)));
    for (before, after) in sound.cameras.iter().zip(&turned.cameras) {
        assert_eq!(before == after, before.camera != id, "{before:?} {after:?}");
    }
    let bent = listed(&edited(&data, |scene| {
        let node = scene.character.skeleton.node("left upper arm").expect("joint");
        scene.frames.iter_mut().for_each(|f| f.pose.turn(node, DVec3::Z, 40f64.to_radians()));
    }));
    let hand = |o: &Outlines| o.joints.iter().find(|j| j.joint == "left hand").expect("a hand").metres;
    assert!(hand(&bent) > 2.0 * hand(&sound), "{bent:?}");

    let text = bent.text();
    let lines = text.lines().count();
    assert_eq!(lines, 2 + bent.cameras.len() + bent.joints.len(), "{text}");
    let first = &bent.joints[0];
    let row = text.lines().find(|l| l.starts_with(first.joint.as_str())).expect("a line of each joint");
    assert!(row.ends_with(&format!(" {:.2}", 100.0 * first.metres)), "{row}");
}
