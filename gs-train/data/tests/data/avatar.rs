//! Films of people: what the generator makes, and what it refuses.

use crate::film::{film, names, open, pixels, scene, small};
use gs_core::io::Limits;
use gs_data::Dataset;
use gs_synth::avatar::{AvatarOptions, Morphs, generate, write};
use gs_texel::maps_exr::load_layers;
use gs_texel::surface::Topology;
use gs_texel::surface_loss::{Chamfer, Colors};
use gs_texel::zbuffer::DepthMap;

#[test]
fn roles_make_views_and_inputs() {
    let data = film();
    // Ring 0: 4 conditioning, 4 test cameras; ring 1: 8 that train.
    assert_eq!([data.train.len(), data.val.len(), data.test.len(), data.extrapolate.len()], [12 * 5, 0, 4 * 5, 0]);
    assert!(data.has_alpha && data.dynamic);
    let s = scene(data);
    assert_eq!((s.frames.len(), s.input_count(), s.fps), (5, 4, 5.0));
    let times: Vec<f32> = s.frames.iter().map(|f| f.time.normalised).collect();
    assert_eq!(times, [0.0, 0.25, 0.5, 0.75, 1.0]);
    for frame in &s.frames {
        assert_eq!(frame.inputs.iter().map(|v| v.camera_id).collect::<Vec<_>>(), [0, 2, 4, 6]);
        for input in &frame.inputs {
            assert_eq!(input.time, frame.time);
            assert!(data.train.contains(input), "inputs train, too");
        }
    }
    assert!(data.test.iter().all(|v| [1, 3, 5, 7].contains(&v.camera_id)));
    let points = data.points.as_ref().unwrap();
    let [low, high] = data.bounds.unwrap();
    assert_eq!((points.positions.len(), points.colors.len()), (20_000, 20_000));
    assert!(points.positions.iter().all(|p| p.cmpge(low).all() && p.cmple(high).all()));
    assert!((1.6..2.2).contains(&(high.y - low.y)), "a person of 1.75 m: {}", high.y - low.y);
}

#[test]
fn the_surface_is_where_the_pictures_show_it() {
    let data = film();
    for view in data.train.iter().step_by(7).chain(data.test.iter().step_by(3)) {
        let frame = scene(data).frame_at(view.time);
        let image = pixels(view);
        let (w, h) = (image.width as i64, image.height as i64);
        let alpha = |x: i64, y: i64| {
            if (0..w).contains(&x) && (0..h).contains(&y) { image.pixel(x as usize, y as usize)[3] } else { 0 }
        };
        let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        for p in scene(data).true_surface(frame) {
            let at = view.camera.to_pixel(view.camera.to_camera(p.as_dvec3()));
            let (x, y) = (at.x.floor() as i64, at.y.floor() as i64);
            let near = (-1..=1).flat_map(|dy| (-1..=1).map(move |dx| (dx, dy))).map(|(dx, dy)| alpha(x + dx, y + dy));
            assert!(near.max() > Some(0), "{} at {at} shows nothing", view.name);
            low = [low[0].min(at.x), low[1].min(at.y)];
            high = [high[0].max(at.x), high[1].max(at.y)];
        }
        // And nothing is shown where there is no surface.
        for (y, x) in (0..h).flat_map(|y| (0..w).map(move |x| (y, x))) {
            let (fx, fy) = (x as f64, y as f64);
            let outside = fx + 1.0 < low[0] || fx > high[0] || fy + 1.0 < low[1] || fy > high[1];
            assert!(!outside || alpha(x, y) == 0, "{} shows something at {x}, {y}", view.name);
            assert!(alpha(x, y) > 0 || image.pixel(x as usize, y as usize) == [0; 4], "colour is zero outside");
        }
    }
}

#[test]
fn a_film_depends_on_its_options_alone() {
    let options = AvatarOptions { per_ring: 4, rings: 1, frames: 2, ..small() };
    let with = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| generate(&options).unwrap())
    };
    let one = with(1);
    assert!(one == with(3));
    assert!(one != generate(&AvatarOptions { seed: 1, ..options.clone() }).unwrap(), "the points have a seed");
}

#[test]
fn more_samples_change_only_borders_and_texture() {
    let with = |supersample| {
        generate(&AvatarOptions { per_ring: 4, rings: 1, frames: 1, size: 96, supersample, ..small() }).unwrap()
    };
    let (usual, dense) = (with(4), with(16));
    let (mut alpha, mut colour, mut inside) = (0.0, 0.0f64, 0);
    for (a, b) in usual.train.iter().zip(&dense.train) {
        for (p, q) in pixels(a).data.chunks_exact(4).zip(pixels(b).data.chunks_exact(4)) {
            alpha = f64::max(alpha, (f64::from(p[3]) - f64::from(q[3])).abs() / 255.0);
            if p[3] == 255 && q[3] == 255 {
                inside += 1;
                colour += (0..3).map(|c| f64::from(p[c]) - f64::from(q[c])).map(|d| d * d).sum::<f64>() / 3.0;
            }
        }
    }
    let rmse = (colour / f64::from(inside)).sqrt() / 255.0;
    println!("4x4 against 16x16 samples: alpha off by at most {alpha:.3}, colour by {rmse:.5} (root mean square)");
    assert!(alpha < 0.25 && rmse < 0.01, "{alpha} {rmse}");
}

#[test]
fn morphs_are_shown_known_or_left_out() {
    let with = |morph| generate(&AvatarOptions { per_ring: 4, rings: 1, morph, ..small() }).unwrap();
    let [gt, apply, ignore] = [Morphs::Gt, Morphs::Apply, Morphs::Ignore].map(with);
    let largest = |data: &Dataset, k: usize| {
        let s = scene(data);
        let offsets = s.true_offsets(&s.frames[k]).unwrap();
        offsets.iter().map(|d| d.length()).fold(0.0, f32::max)
    };
    assert!(largest(&gt, 2) > 0.015, "{}", largest(&gt, 2));
    assert_eq!((largest(&apply, 2), largest(&ignore, 2)), (0.0, 0.0));
    let surface = |data: &Dataset| scene(data).true_surface(&scene(data).frames[2]);
    assert_eq!(surface(&gt), surface(&apply));
    assert_ne!(surface(&gt), surface(&ignore));
    let (s, t) = (scene(&gt), scene(&ignore));
    assert_eq!(s.posed(&s.frames[2]), t.posed(&t.frames[2]), "what is known is the same");
    assert_eq!(pixels(&gt.train[2]), pixels(&apply.train[2]));
    assert_ne!(pixels(&gt.train[2]), pixels(&ignore.train[2]));
}

#[test]
fn morphs_act_one_by_one() {
    let with = |names: &[&str]| {
        let only_morphs = names.iter().map(|n| n.to_string()).collect();
        generate(&AvatarOptions { per_ring: 4, rings: 1, only_morphs, ..small() }).unwrap()
    };
    let films = [with(&[]), with(&["breathe"]), with(&["swing"]), with(&["swing", "breathe"])];
    let [all, breathe, swing, both] = films.each_ref().map(|f| scene(f).frames[1].true_morphs.clone().unwrap());
    assert!(all.iter().all(|w| w.abs() > 0.1), "{all:?}");
    assert_eq!((breathe, swing, both), (vec![all[0], 0.0], vec![0.0, all[1]], all));
}

#[test]
fn a_template_that_is_not_in_metres_is_named() {
    let noted = |template: &str| {
        let options = AvatarOptions { template: template.into(), per_ring: 4, rings: 1, frames: 1, ..small() };
        generate(&options).unwrap().notes.iter().any(|n| n.contains("a unit is taken for a metre"))
    };
    assert!(!noted("builtin:person"));
    let Some(folder) = gs_core::testkit::shared("data/gltf_public") else { return };
    assert!(noted(folder.join("Fox.glb").to_str().unwrap()));
    assert!(!noted(folder.join("CesiumMan.glb").to_str().unwrap()));
}

#[test]
fn points_lie_on_the_true_surface() {
    let s = scene(film());
    let frame = &s.frames[2];
    let points = frame.points.as_ref().unwrap().read().unwrap();
    assert_eq!(points.positions.len(), 400);
    let (surface, faces) = (s.true_surface(frame), &s.character.template.faces);
    for p in points.positions.iter().step_by(20) {
        let off = |f: &[u32; 3]| {
            let [a, b, c] = f.map(|v| surface[v as usize]);
            let n = (b - a).cross(c - a).normalize_or_zero();
            let centre = (a + b + c) / 3.0;
            let reach = [a, b, c].iter().map(|q| q.distance(centre)).fold(0.0, f32::max);
            if p.distance(centre) <= reach + 1e-5 { (*p - a).dot(n).abs() } else { f32::INFINITY }
        };
        assert!(faces.iter().map(off).fold(f32::INFINITY, f32::min) < 1e-5);
    }
    // They have the colours of the surface there.
    let colors = points.colors.as_ref().unwrap();
    let topology = Topology::new(faces, surface.len()).unwrap();
    let chamfer = Chamfer::new(&points.positions).unwrap();
    let away = |points: &[[f32; 3]]| {
        let colors = Colors { paint: &s.character.template, points, weight: 0.05 };
        chamfer.evaluate_faces(&surface, faces, &topology, Some(&colors)).unwrap().value
    };
    assert!(away(colors) < 1e-5 && away(&[[0.5; 3]; 400]) > 1e-3, "{} {}", away(colors), away(&[[0.5; 3]; 400]));
}

#[test]
fn test_frames_are_held_out() {
    let data = generate(&AvatarOptions { per_ring: 4, frames: 8, test_every: 4, ..small() }).unwrap();
    // Frames 2 and 6 of 8 are for tests; cameras: 4 cond, 2 train, 2 test.
    assert_eq!((data.train.len(), data.test.len()), (6 * 6, 2 * 8));
    assert_eq!(scene(&data).frames.len(), 8, "inputs of test frames are there");
    let test = data.test.iter().find(|v| v.name.ends_with("f000006")).unwrap();
    assert_eq!(scene(&data).frame_at(test.time).number, 6);
}

#[test]
fn depth_is_that_of_the_depth_buffer_and_positions_project_back() {
    let dir = tempfile::tempdir().unwrap();
    let options = AvatarOptions { rings: 1, per_ring: 4, frames: 2, size: 128, ..small() };
    write(dir.path(), &options, true, false).unwrap();
    let data = open(dir.path()).unwrap();
    let (mut covered, mut off, mut worst) = (0, 0, 0.0f64);
    for view in &data.train {
        let frame = scene(&data).frame_at(view.time);
        let file = dir.path().join(format!("gt/{:03}/{:06}.exr", view.camera_id, frame.number));
        let layers = load_layers(&file, &Limits::default()).unwrap();
        let map = |name: &str| &layers.iter().find(|l| l.name == name).unwrap().map;
        let buffer = DepthMap::new(
            &scene(&data).true_surface(frame),
            &scene(&data).character.template.faces,
            &view.camera,
            1e-3,
        );
        for (i, (&z, &want)) in map("depth").data.iter().zip(&buffer.depth).enumerate() {
            covered += usize::from(z > 0.0);
            if (z > 0.0) != want.is_finite() {
                off += 1;
                continue;
            }
            if z > 0.0 {
                let far = f64::from((z - want).abs() / want);
                off += usize::from(far > 1e-5);
                worst = worst.max(far);
                let (x, y) = (i % 128, i / 128);
                let at = glam::Vec3::from_slice(map("P").pixel(x, y)).as_dvec3();
                let at = view.camera.to_pixel(view.camera.to_camera(at));
                assert!((at.x - x as f64 - 0.5).abs() < 1e-2 && (at.y - y as f64 - 0.5).abs() < 1e-2, "{at}");
                let n = glam::Vec3::from_slice(map("N").pixel(x, y));
                assert!((n.length() - 1.0).abs() < 1e-4);
            }
        }
    }
    println!("{covered} pixels, {off} differ, worst relative depth error {worst:.2e}");
    assert!(covered > 5_000 && off * 1000 <= covered, "{off} of {covered}");
}

#[test]
fn options_of_the_generator_have_domains() {
    let o = small;
    for (options, words) in [
        (AvatarOptions { per_ring: 6, ..o() }, "multiple of 4"),
        (AvatarOptions { rings: 4, ..o() }, "rings"),
        (AvatarOptions { frames: 0, ..o() }, "frames"),
        (AvatarOptions { size: 0, ..o() }, "size"),
        (AvatarOptions { supersample: 2, ..o() }, "supersample"),
        (AvatarOptions { test_every: 1, ..o() }, "test_every"),
        (AvatarOptions { fps: Some(f64::NAN), ..o() }, "fps"),
        (AvatarOptions { frames: 100_000, size: 2048, ..o() }, "8 GiB"),
        (AvatarOptions { clip: Some("fly".into()), ..o() }, "walk, wave, turn"),
        (AvatarOptions { template: "builtin:horse".into(), ..o() }, "builtin:person"),
        (AvatarOptions { only_morphs: vec!["fly".into()], ..o() }, "breathe, swing"),
    ] {
        names(&generate(&options).unwrap_err(), "data.option", &[words]);
    }
}
