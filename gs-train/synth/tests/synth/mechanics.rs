//! Generated scenes of rigid mechanics and cameras at rest: what they promise about motion, room, cameras and files.

use std::collections::BTreeMap;

use glam::DVec3;
use gs_data::{DataOptions, Dataset, ImageCache, ImageSource, ImageU8, Split, View};
use gs_synth::body::MotionClass;
use gs_synth::{self as synth, SynthOptions, Truth};

const MECHANICS: [&str; 8] = ["falling", "screw", "wheel", "projectile", "hinge", "spinner", "twins", "trio"];
const SPLITS: [Split; 4] = [Split::Train, Split::Val, Split::Test, Split::Extrapolate];

/// Three cameras and one held out, nine moments: two after 0.75.
fn small() -> SynthOptions {
    SynthOptions { size: 24, cameras: 3, held_out: 1, moments: 9, supersample: 1, ..SynthOptions::default() }
}

fn truth(scene: &str) -> Truth {
    synth::truth(scene, &small()).unwrap()
}

fn landmarks(truth: &Truth, body: usize, t: f64) -> Vec<DVec3> {
    let points = truth.bodies()[body].shape.landmarks();
    points.into_iter().map(|p| truth.position_of(body, p, t).unwrap()).collect()
}

/// Fails where a body is in another at one of `steps + 1` times, or reaches farther than `most` from the origin.
fn check_room(truth: &Truth, steps: u32, most: f64) {
    let (scene, variant, bodies) = (truth.scene(), truth.options().variant, truth.bodies());
    for k in 0..=steps {
        let t = f64::from(k) / f64::from(steps);
        for a in 0..bodies.len() {
            let name = bodies[a].name;
            for p in landmarks(truth, a, t) {
                assert!(p.length() < most, "{scene} {variant}: {name} at {t} reaches {p}");
                for b in (0..bodies.len()).filter(|&b| b != a) {
                    let gap = bodies[b].distance(p, t);
                    assert!(gap > 0.01, "{scene} {variant}: {name} at {t} is {gap} from {}", bodies[b].name);
                }
            }
        }
    }
}

#[test]
fn bodies_stay_in_the_picture_and_out_of_each_other() {
    MECHANICS.iter().for_each(|scene| check_room(&truth(scene), 100, 1.33));
}

#[test]
fn bodies_of_variants_stay_out_of_each_other() {
    for scene in MECHANICS {
        for variant in 1..=100 {
            check_room(&synth::truth(scene, &SynthOptions { variant, ..small() }).unwrap(), 20, f64::INFINITY);
        }
    }
}

#[test]
fn bodies_move_visibly_before_and_after_the_boundary() {
    for scene in MECHANICS {
        let truth = truth(scene);
        for (k, body) in truth.bodies().iter().enumerate() {
            let way = |from: f64, to: f64| {
                let [a, b] = [from, to].map(|t| landmarks(&truth, k, t));
                a.iter().zip(&b).map(|(a, b)| a.distance(*b)).fold(0.0, f64::max)
            };
            let moves = body.class() == MotionClass::Global;
            assert_eq!(moves, !["slab", "base"].contains(&body.name));
            let (past, future) = (way(0.0, 0.5).max(way(0.25, 0.75)), way(0.75, 1.0));
            assert!(
                if moves { past > 0.3 && future > 0.15 } else { past + future == 0.0 },
                "{scene}, {}: {past} {future}",
                body.name
            );
        }
    }
}

/// The twist of a body is the slope of its positions, and its rate the slope of the twist.
#[test]
fn twists_are_slopes_of_positions() {
    let origin = DVec3::new(0.1, -0.2, 0.3);
    let h = 2e-4;
    let slope = |f: &dyn Fn(f64) -> DVec3, t: f64| {
        (8.0 * (f(t + h) - f(t - h)) - (f(t + 2.0 * h) - f(t - 2.0 * h))) / (12.0 * h)
    };
    for scene in MECHANICS.into_iter().chain(["balls", "waves"]) {
        let truth = truth(scene);
        for (k, body) in truth.bodies().iter().enumerate() {
            for t in [0.1, 0.4, 0.75, 0.9] {
                let of = |t: f64| truth.twist_of(k, t, origin).unwrap();
                let m = of(t);
                let [v, w] = [m.twist.v, m.twist.w].map(DVec3::from);
                for p in body.shape.landmarks() {
                    let at = |t: f64| truth.position_of(k, p, t).unwrap();
                    let off = (v + w.cross(at(t) - origin)).distance(slope(&at, t));
                    assert!(off < 1e-6, "{scene}, {} at {t}: {off}", body.name);
                }
                let rate = slope(&|t| of(t).twist.v.into(), t).distance(m.rate.v.into());
                let turn = slope(&|t| of(t).twist.w.into(), t).distance(m.rate.w.into());
                assert!(rate < 1e-5 && turn < 1e-5, "{scene}, {} at {t}: {rate} {turn}", body.name);
            }
        }
    }
    let sheet = synth::truth("sheet", &SynthOptions::default()).unwrap();
    assert!(sheet.twist_of(0, 0.3, origin).is_none() && truth("screw").twist_of(7, 0.3, origin).is_none());
}

/// What the scenes promise about their twists.
#[test]
fn each_scene_has_its_kind_of_motion() {
    let twist = |scene: &str, body: usize, t: f64| truth(scene).twist_of(body, t, DVec3::ZERO).unwrap();
    let near = |a: [f64; 3], b: [f64; 3]| DVec3::from(a).distance(b.into()) < 1e-12;
    let zero = [0.0; 3];
    let ball = twist("falling", 0, 0.4);
    assert!(ball.twist.w == zero && near(ball.rate.v, [0.0, 0.0, -4.4]) && ball.jerk.v == zero);
    let (a, b) = (twist("screw", 0, 0.1).twist, twist("screw", 0, 0.9).twist);
    assert!(near(a.v, b.v) && near(a.w, b.w), "a constant twist");
    let rolling = twist("wheel", 0, 0.6);
    assert!(near(rolling.rate.w, zero) && near(rolling.jerk.v, zero) && DVec3::from(rolling.rate.v).length() > 1.0);
    let lowest = truth("wheel").rates_of(0, 0.6).unwrap();
    assert!(lowest.velocity(lowest.centre[0] - DVec3::Z * 0.4).length() < 1e-12, "the tread rests on the ground");
    let thrown = twist("projectile", 0, 0.2);
    assert!(DVec3::from(thrown.jerk.v).length() > 1.0 && thrown.rate.w == zero);
    let rates: Vec<DVec3> = (0..4).map(|k| twist("hinge", k, 0.5).twist.w.into()).collect();
    assert!((0..4).all(|a| (0..a).all(|b| rates[a].distance(rates[b]) > 1.0)), "{rates:?}");
    assert!(near(twist("hinge", 0, 0.1).rate.w, [-1.2, 0.0, 0.0]));
    let disc = twist("spinner", 0, 0.4);
    assert!(near(disc.twist.w, [0.0, -4.5, 0.0]) && near(disc.twist.v, zero) && near(disc.rate.v, zero), "on the axis");
    let [one, two, other] = [0, 1, 2].map(|k| twist("twins", k, 0.3));
    assert!(near(one.twist.v, two.twist.v) && near(one.twist.w, two.twist.w) && near(one.rate.v, two.rate.v));
    assert!(!near(one.twist.w, other.twist.w));
}

fn memory(source: &ImageSource) -> &ImageU8 {
    match source {
        ImageSource::Memory(image) => image,
        ImageSource::File(f) => panic!("{} is a file", f.display()),
    }
}

#[test]
fn cameras_at_rest_photograph_every_moment() {
    let data = synth::generate("falling", &small()).unwrap().dataset;
    assert_eq!(SPLITS.map(|s| data.views(s).len()), [3 * 7, 0, 7, 4 * 2]);
    let mut moments: BTreeMap<u32, Vec<f64>> = BTreeMap::new();
    for v in SPLITS.iter().flat_map(|&s| data.views(s)) {
        moments.entry(v.camera_id).or_default().push(v.time.seconds);
        let first = data.train.iter().chain(&data.test).find(|f| f.camera_id == v.camera_id).unwrap();
        assert_eq!(first.camera, v.camera, "a camera stays where it is");
    }
    let all: Vec<f64> = (0..9).map(|k| f64::from(k) / 8.0).collect();
    assert_eq!(moments.keys().copied().collect::<Vec<_>>(), [0, 1, 2, 3]);
    assert!(moments.values().all(|m| *m == all));
    assert!(data.train.iter().all(|v| v.camera_id < 3 && v.time.seconds <= 0.75));
    assert!(data.test.iter().all(|v| v.camera_id == 3 && v.time.seconds <= 0.75));
    assert!(data.extrapolate.iter().all(|v| v.time.seconds > 0.75));
    assert_eq!(
        memory(&data.train[6].image),
        &synth::truth("falling", &small()).unwrap().picture(&data.train[6].camera, 0.75)
    );
    let still = synth::generate("static", &small()).unwrap().dataset;
    assert_eq!(SPLITS.map(|s| still.views(s).len()), [3, 0, 1, 0]);
}

#[test]
fn cameras_at_rest_are_spread() {
    let o = SynthOptions { size: 8, cameras: 12, held_out: 3, moments: 2, ..small() };
    for seed in 0..20 {
        let data = synth::generate("falling", &SynthOptions { seed, ..o }).unwrap().dataset;
        let of = |v: &View| v.camera.position() / synth::CAMERA_RADIUS;
        let eyes: Vec<DVec3> = data.train.iter().chain(&data.test).map(of).collect();
        assert_eq!(eyes.len(), 15);
        assert!(eyes.iter().all(|e| (0.1..0.95).contains(&e.z)));
        let closest = (0..15).flat_map(|a| (0..a).map(move |b| (a, b))).map(|(a, b)| eyes[a].distance(eyes[b]));
        assert!(closest.fold(f64::INFINITY, f64::min) > 0.2, "seed {seed}");
    }
}

#[test]
fn a_written_future_reads_back_as_it_was() {
    for (scene, boundary) in [("screw", 0.75), ("wheel", 0.6), ("static", 0.75), ("falling", 1.0)] {
        let dir = tempfile::tempdir().unwrap();
        let o = SynthOptions { boundary, moments: 11, ..small() };
        let made = synth::write(dir.path(), scene, &o, false).unwrap().dataset;
        let read = Dataset::open(dir.path(), &DataOptions::default()).unwrap();
        assert_eq!((made.dynamic, made.has_alpha), (read.dynamic, read.has_alpha));
        let cache = ImageCache::new(64 << 20, 1.0);
        for split in SPLITS {
            let (a, b) = (made.views(split), read.views(split));
            assert_eq!(a.len(), b.len(), "{scene} {split:?}");
            for (a, b) in a.iter().zip(b) {
                assert_eq!((&a.name, a.time), (&b.name, b.time), "{scene}");
                assert!(!made.dynamic || a.camera_id == b.camera_id, "{scene} {}: camera {}", a.name, b.camera_id);
                assert!((a.camera.position() - b.camera.position()).length() < 1e-9);
                assert_eq!(*cache.get(b).unwrap(), *memory(&a.image), "{scene} {}", a.name);
            }
        }
        assert_eq!(read.extrapolate.is_empty(), scene == "static" || boundary == 1.0);
        let truth = synth::truth_of(dir.path()).unwrap();
        assert_eq!((truth.scene(), truth.options().boundary), (scene, boundary));
    }
}

#[test]
fn truth_of_bodies_is_written() {
    let dir = tempfile::tempdir().unwrap();
    let truth = synth::write(dir.path(), "wheel", &small(), false).unwrap().truth;
    let text = std::fs::read_to_string(dir.path().join("truth.json")).unwrap();
    let json: serde_json::Value = serde_json::from_str(&text).unwrap();
    let vec = |v: &serde_json::Value| DVec3::from(std::array::from_fn(|k| v[k].as_f64().unwrap()));
    let wheel = &json["bodies"][0];
    let (pose, track) = (&wheel["poses"][40], &wheel["tracks"][5]);
    let t = pose["time"].as_f64().unwrap();
    let m = truth.twist_of(0, t, DVec3::ZERO).unwrap();
    for (key, value) in [("v", m.twist.v), ("w", m.twist.w), ("v_rate", m.rate.v), ("w_rate", m.rate.w)] {
        assert!(vec(&pose["twist"][key]).distance(value.into()) < 1e-12, "{key}");
    }
    let world = truth.position_of(0, vec(&track["body"]), t).unwrap();
    assert!(vec(&track["world"][40]).distance(world) < 1e-12 && wheel["tracks"].as_array().unwrap().len() == 16);
}

#[test]
fn every_picture_has_labels() {
    let dir = tempfile::tempdir().unwrap();
    let data = synth::write(dir.path(), "hinge", &small(), false).unwrap();
    synth::write_maps(dir.path(), &data, 2, false).unwrap();
    let read = Dataset::open(dir.path(), &DataOptions::default()).unwrap();
    let mut seen = [0usize; 256];
    for (split, folder) in SPLITS.into_iter().zip(["train", "val", "test", "extrapolate"]) {
        for v in read.views(split) {
            let file = dir.path().join("maps").join("labels").join(folder).join(format!("{}.png", v.name));
            let image::DynamicImage::ImageLuma8(labels) = image::open(file).unwrap() else { panic!("one channel") };
            let truth = data.truth.segments(&v.camera, v.time.seconds);
            for (label, body) in labels.as_raw().iter().zip(&truth) {
                assert_eq!(u32::from(*label), body.map_or(0, |k| k + 1), "{}", v.name);
                seen[usize::from(*label)] += 1;
            }
        }
    }
    assert!(seen[..5].iter().all(|&n| n > 20) && seen[5..] == [0; 251], "{seen:?}");
}

#[test]
fn wrong_cameras_and_boundaries_are_named() {
    for (o, name) in [
        (SynthOptions { moments: 1, ..small() }, "moments"),
        (SynthOptions { boundary: 0.0, ..small() }, "boundary"),
        (SynthOptions { boundary: 1.5, ..small() }, "boundary"),
        (SynthOptions { boundary: f64::NAN, ..small() }, "boundary"),
        (SynthOptions { cameras: u32::MAX, held_out: u32::MAX, ..small() }, "cameras"),
    ] {
        let e = synth::generate("falling", &o).unwrap_err();
        assert!(e.code() == "data.option" && e.to_string().starts_with(name), "{e}");
    }
    let dir = tempfile::tempdir().unwrap();
    let e = synth::write_nerfies(dir.path(), "falling", &small(), false).unwrap_err();
    assert!(e.to_string().starts_with("cameras"), "{e}");
}
