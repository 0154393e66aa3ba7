//! Generated scenes: written and read again they are the same, their truth is true, and nothing depends on threads.

use glam::{DMat3, DVec2, DVec3};
use gs_data::{DataOptions, Dataset, ImageCache, ImageSource, ImageU8, Split};
use gs_synth::{self as synth, SCENES, SynthOptions};

fn small() -> SynthOptions {
    SynthOptions { val_views: 2, ..SynthOptions::of_views(48, 6, 3) }
}

fn memory(source: &ImageSource) -> &ImageU8 {
    match source {
        ImageSource::Memory(image) => image,
        ImageSource::File(f) => panic!("{} is a file", f.display()),
    }
}

#[test]
fn a_written_scene_reads_back_as_it_was() {
    for scene in SCENES {
        let dir = tempfile::tempdir().unwrap();
        let made = synth::write(dir.path(), scene.name, &small(), false).unwrap();
        let read = Dataset::open(dir.path(), &DataOptions::default()).unwrap();
        assert_eq!((read.layout, read.dynamic, read.has_alpha), ("blender", scene.dynamic, true));
        let cache = ImageCache::new(64 << 20, 1.0);
        for split in [Split::Train, Split::Val, Split::Test] {
            let (a, b) = (made.dataset.views(split), read.views(split));
            assert_eq!(a.len(), b.len());
            for (a, b) in a.iter().zip(b) {
                assert_eq!(*cache.get(b).unwrap(), *memory(&a.image), "{} {}", scene.name, a.name);
                assert_eq!((&a.name, a.time.normalised), (&b.name, b.time.normalised));
                assert!((a.camera.fx - b.camera.fx).abs() < 1e-9 && a.camera.width == b.camera.width);
                assert!((a.camera.position() - b.camera.position()).length() < 1e-9);
                let corner = DVec3::new(0.9, -0.8, 0.7);
                let (pa, pb) = (a.camera.to_camera(corner), b.camera.to_camera(corner));
                assert!((a.camera.to_pixel(pa) - b.camera.to_pixel(pb)).length() < 1e-6);
            }
        }
    }
}

#[test]
fn a_folder_with_files_is_left_alone_unless_asked() {
    let dir = tempfile::tempdir().unwrap();
    std::fs::write(dir.path().join("mine.txt"), "keep").unwrap();
    let e = synth::write(dir.path(), "balls", &small(), false).unwrap_err();
    assert_eq!((e.code(), e.exit_code()), ("io.exists", 6));
    assert_eq!(std::fs::read_dir(dir.path()).unwrap().count(), 1);
    synth::write(dir.path(), "balls", &small(), true).unwrap();
    assert_eq!(std::fs::read_to_string(dir.path().join("mine.txt")).unwrap(), "keep");
}

#[test]
fn same_seed_same_bytes_for_any_number_of_threads() {
    let bytes = |scene: &str, threads: usize, seed: u64| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let data = pool.install(|| synth::generate(scene, &SynthOptions { seed, ..small() }).unwrap());
        data.dataset.train.iter().flat_map(|v| memory(&v.image).data.clone()).collect::<Vec<u8>>()
    };
    for scene in ["balls", "waves"] {
        let one = bytes(scene, 1, 5);
        assert_eq!(one, bytes(scene, 3, 5));
        assert_ne!(one, bytes(scene, 1, 6));
    }
    let dirs = [tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap()];
    for d in &dirs {
        synth::write(d.path(), "sheet", &small(), false).unwrap();
    }
    for file in ["truth.json", "transforms_train.json", "transforms_test.json", "train/r_003.png", "test/r_002.png"] {
        let [a, b] = [0, 1].map(|k: usize| std::fs::read(dirs[k].path().join(file)).unwrap());
        assert_eq!(a, b, "{file}");
    }
}

/// The axes: a point above is higher in the image, one to the camera's right is further right, one nearer hides.
#[test]
fn axes_are_right() {
    let data = synth::generate("balls", &small()).unwrap();
    for v in &data.dataset.train {
        let pixel = |p: DVec3| v.camera.to_pixel(v.camera.to_camera(p));
        let middle = pixel(DVec3::ZERO);
        assert!((middle - DVec2::splat(24.0)).length() < 1e-6, "cameras look at the origin");
        assert!(pixel(DVec3::Z * 0.3).y < middle.y - 0.5, "above is higher");
        let right = v.camera.forward().cross(DVec3::Z);
        assert!(pixel(right * 0.3).x > middle.x + 1.0, "right is right");
        assert!((v.camera.position().length() - 4.0).abs() < 1e-9 && v.camera.position().z > 0.0);
    }
}

/// Material points, followed by the truth alone, land on pixels that show their body.
#[test]
fn the_truth_reprojects_onto_the_pictures() {
    for name in ["balls", "sheet", "waves", "reach"] {
        let data = synth::generate(name, &SynthOptions { size: 96, ..small() }).unwrap();
        for v in &data.dataset.test {
            let t = v.time.seconds;
            let (depth, segments) = (data.truth.depth(&v.camera, t), data.truth.segments(&v.camera, t));
            let image = memory(&v.image);
            let mut covered = 0;
            for (k, segment) in segments.iter().enumerate() {
                let Some(body) = *segment else {
                    assert!(image.data[4 * k + 3] < 255, "the truth sees nothing, so the pixel is not full");
                    continue;
                };
                let centre = DVec2::new((k % 96) as f64 + 0.5, (k / 96) as f64 + 0.5);
                let hit = data.truth.hit(&v.camera, t, centre.x, centre.y).unwrap();
                let again = data.truth.position_of(body as usize, hit.local, t).unwrap();
                let seen = v.camera.to_camera(again);
                assert!((v.camera.to_pixel(seen) - centre).length() < 1e-6);
                assert!((seen.z - f64::from(depth.data[k])).abs() < 1e-5);
                assert!(image.data[4 * k + 3] > 0);
                covered += 1;
            }
            assert!(covered > 500, "{name}: the scene is in the picture ({covered} pixels)");
            let on_border = |k: usize| [k % 96, k / 96].iter().any(|&side| side == 0 || side == 95);
            assert!((0..96 * 96).all(|k| !on_border(k) || image.data[4 * k + 3] == 0), "{name}: whole in the picture");
            let alpha = image.data.chunks_exact(4).filter(|p| p[3] > 127).count();
            assert!(alpha.abs_diff(covered) < 60, "{alpha} opaque pixels, {covered} in the truth");
        }
    }
}

/// With no shading, the picture at the place the flow points to shows the colour the point had.
#[test]
fn flow_carries_colours() {
    for name in ["balls", "sheet", "waves", "reach"] {
        let o = SynthOptions { size: 96, shading: 0.0, ..small() };
        let data = synth::generate(name, &o).unwrap();
        let c = &data.dataset.train[2].camera;
        let (t0, t1) = (0.30, 0.36);
        let map = data.truth.flow(c, t0, c, t1);
        let (mut moved, mut compared) = (0, 0);
        for k in 0..96 * 96 {
            if !map.visible_after[k] {
                continue;
            }
            let (u, v) = ((k % 96) as f64 + 0.5, (k / 96) as f64 + 0.5);
            let (du, dv) = (f64::from(map.flow.data[2 * k]), f64::from(map.flow.data[2 * k + 1]));
            let before = data.truth.hit(c, t0, u, v).unwrap();
            let Some(after) = data.truth.hit(c, t1, u + du, v + dv) else { continue };
            if after.body == before.body && (after.local - before.local).length() < 1e-3 {
                compared += 1;
                let worst = (0..3).map(|i| (before.color[i] - after.color[i]).abs()).fold(0.0, f64::max);
                assert!(worst < 0.02, "{name}: colour changed by {worst}");
            }
            moved += usize::from(du.hypot(dv) > 0.5);
        }
        let seen = map.visible_after.iter().filter(|&&v| v).count();
        assert!(compared * 100 > seen * 98, "{name}: {compared} of {seen} arrive at their point");
        assert!(moved > 100, "{name}: it moves ({moved})");
    }
}

#[test]
fn a_static_scene_has_one_moment_and_bodies_that_stay() {
    let data = synth::generate("static", &small()).unwrap();
    assert!(!data.dataset.dynamic && data.dataset.train.iter().all(|v| v.time.normalised == 0.0));
    for body in 0..data.truth.bodies().len() {
        let at = |t| data.truth.position_of(body, DVec3::new(0.1, 0.05, -0.1), t).unwrap();
        assert_eq!(at(0.0), at(0.83));
    }
    assert!(data.truth.position_of(99, DVec3::ZERO, 0.0).is_none());
}

#[test]
fn bodies_stay_in_the_box_and_out_of_each_other() {
    let data = synth::generate("balls", &SynthOptions { size: 8, train_views: 1, ..small() }).unwrap();
    let n = data.truth.bodies().len();
    for k in 0..=200 {
        let t = f64::from(k) / 200.0;
        let centre = |b: usize| data.truth.position_of(b, DVec3::ZERO, t).unwrap();
        let radius = [0.28, 0.2, 0.395, 0.255];
        for a in 0..n - 1 {
            let c = centre(a);
            assert!(c.abs().max_element() + radius[a] < 1.3, "body {a} at {t}");
            assert!(c.z - radius[a] > -0.75 - 0.001, "body {a} above the slab at {t}");
            for b in 0..a {
                let gap = (c - centre(b)).length() - radius[a] - radius[b];
                assert!(gap > 0.0, "bodies {b} and {a} touch at {t}: {gap}");
            }
        }
    }
}

#[test]
fn wrong_options_are_named() {
    for (o, name) in [
        (SynthOptions { size: 0, ..small() }, "size"),
        (SynthOptions { train_views: 0, ..small() }, "train_views"),
        (SynthOptions { train_views: u32::MAX, ..small() }, "train_views"),
        (SynthOptions { supersample: 99, ..small() }, "supersample"),
        (SynthOptions { shading: f64::NAN, ..small() }, "shading"),
    ] {
        let e = synth::generate("balls", &o).unwrap_err();
        assert!(e.code() == "data.option" && e.exit_code() == 2 && e.to_string().starts_with(name), "{e}");
    }
    assert!(synth::generate("bals", &small()).unwrap_err().to_string().contains("balls, sheet, static, waves, reach"));
}

/// Residual of the best `a + b cos 2πft + c sin 2πft` through evenly spaced values, as a part of their variance.
fn residual(values: &[f64], cycles: f64) -> f64 {
    let n = values.len();
    let t = |k: usize| k as f64 / (n - 1) as f64;
    let mean = values.iter().sum::<f64>() / n as f64;
    let variance: f64 = values.iter().map(|v| (v - mean).powi(2)).sum();
    let angle = |k: usize| std::f64::consts::TAU * cycles * t(k);
    let basis = |k: usize| DVec3::new(1.0, angle(k).cos(), angle(k).sin());
    let (mut a, mut b) = (DMat3::ZERO, DVec3::ZERO);
    for (k, &v) in values.iter().enumerate() {
        let e = basis(k);
        a += DMat3::from_cols(e * e.x, e * e.y, e * e.z);
        b += e * v;
    }
    let fit = a.inverse() * b;
    values.iter().enumerate().map(|(k, v)| (v - fit.dot(basis(k))).powi(2)).sum::<f64>() / variance
}

/// Every trajectory of "waves" is a single sinusoid of its own frequency, seen at the training times.
#[test]
fn waves_have_their_energy_at_their_frequencies() {
    let o = SynthOptions::of_views(8, 100, 0);
    let data = synth::generate("waves", &o).unwrap();
    assert_eq!(data.truth.options().supersample, 4, "4x4 samples although 3x3 were asked for");
    let note = "the fastest motion makes 10 cycles; 100 training times resolve it (up to 49.5 cycles)";
    assert!(data.dataset.notes.iter().any(|n| n == note), "{:?}", data.dataset.notes);
    for (body, (axis, want)) in [(2, 0.5), (0, 2.0), (1, 4.0), (2, 10.0)].into_iter().enumerate() {
        let at = |k: u32| data.truth.position_of(body, DVec3::splat(0.03), f64::from(k) / 99.0).unwrap();
        let path: Vec<DVec3> = (0..100).map(at).collect();
        let values: Vec<f64> = path.iter().map(|p| p[axis]).collect();
        let left = residual(&values, want);
        assert!(left < 1e-20, "body {body}: all energy at {want} cycles ({left:.1e} is elsewhere)");
        let others = (1..=48).map(|k| 0.25 * f64::from(k)).filter(|&f| f != want);
        let least = others.map(|f| residual(&values, f)).fold(f64::INFINITY, f64::min);
        assert!(least > 1e-4, "body {body}: no other frequency explains it ({least:.1e})");
        let swing = values.iter().fold(0.0f64, |m, v| m.max((v - values[0]).abs()));
        assert!(swing > 0.1, "body {body} swings by {swing}");
        assert!((0..3).filter(|&a| a != axis).all(|a| path.iter().all(|p| p[a] == path[0][a])), "one direction only");
    }
    let slab = |t| data.truth.position_of(4, DVec3::ONE, t).unwrap();
    assert_eq!(slab(0.0), slab(0.7));
    let few = synth::generate("waves", &SynthOptions { train_views: 20, ..o }).unwrap().dataset;
    assert!(few.notes[1].contains("20 training times do not resolve it (up to 9.5 cycles)"), "{:?}", few.notes);
}

#[test]
fn waves_stay_in_the_box_and_out_of_each_other() {
    let data = synth::generate("waves", &SynthOptions { size: 8, train_views: 1, ..small() }).unwrap();
    // Radii of balls around the bodies; the blocks are 0.36 × 0.36 × 0.4 and 0.32 × 0.4 × 0.36.
    let radius = [0.22, 0.325, 0.2, 0.314];
    for k in 0..=400 {
        let centre = |b: usize| data.truth.position_of(b, DVec3::ZERO, f64::from(k) / 400.0).unwrap();
        for a in 0..4 {
            assert!(centre(a).abs().max_element() + radius[a] < 1.3 && centre(a).z - radius[a] > -0.67);
            assert!((0..a).all(|b| (centre(b) - centre(a)).length() > radius[a] + radius[b]), "body {a} at {k}");
        }
    }
}

/// A camera that sees the box of "reach" in front of its cloth.
fn before_the_cloth() -> gs_core::Camera {
    gs_core::Camera::look_at(96, 96, synth::FOV_X, DVec3::new(-3.2, 1.4, 1.9), DVec3::ZERO, DVec3::Z).unwrap()
}

/// The face of the box of "reach" on which a material point lies: axis and side.
fn face(local: DVec3) -> (usize, bool) {
    let part = local / DVec3::new(0.26, 0.2, 0.26);
    let axis = (0..3).max_by(|&a, &b| part[a].abs().total_cmp(&part[b].abs())).unwrap();
    (axis, part[axis] > 0.0)
}

/// The flow of the box of "reach" is what its planes induce: of the plane `n·x = d` of camera space that moves by `(R, T)`
/// the image moves by the homography `K (R + T nᵀ/d) K⁻¹`.
#[test]
fn the_flow_of_a_box_is_a_homography_of_each_face() {
    let data = synth::generate("reach", &SynthOptions { size: 96, ..small() }).unwrap();
    let (truth, c) = (&data.truth, &before_the_cloth());
    let (t0, t1) = (0.52, 0.58);
    let map = truth.flow(c, t0, c, t1);
    let [p0, p1] = [t0, t1].map(|t| truth.pose_of(0, t).unwrap());
    let turn = c.rotation * p1.rotation * p0.rotation.transpose() * c.rotation.transpose();
    let shift = c.to_camera(p1.translation) - turn * c.to_camera(p0.translation);
    let k = DMat3::from_cols(DVec3::X * c.fx, DVec3::Y * c.fy, DVec3::new(c.cx, c.cy, 1.0));
    let half = DVec3::new(0.26, 0.2, 0.26);
    let (mut checked, mut farthest) = (0, 0.0f64);
    for (i, body) in truth.segments(c, t0).into_iter().enumerate().filter(|(_, b)| *b == Some(0)) {
        let from = DVec2::new((i % 96) as f64 + 0.5, (i / 96) as f64 + 0.5);
        let local = truth.hit(c, t0, from.x, from.y).unwrap().local;
        let axis = face(local).0;
        let normal = DVec3::AXES[axis] * local[axis].signum();
        let n = c.rotation * p0.rotation * normal;
        let d = n.dot(c.to_camera(p0.apply(normal * half[axis])));
        let h = k * (turn + DMat3::from_cols(shift * n.x, shift * n.y, shift * n.z) * (1.0 / d)) * k.inverse();
        let to = h * from.extend(1.0);
        let flow = DVec2::new(to.x / to.z, to.y / to.z) - from;
        let seen = DVec2::new(f64::from(map.flow.data[2 * i]), f64::from(map.flow.data[2 * i + 1]));
        assert!((flow - seen).length() < 1e-4, "{from}, body {body:?}: {flow} against {seen}");
        farthest = farthest.max(flow.length());
        checked += 1;
    }
    assert!(checked > 100 && farthest > 4.0, "{checked} pixels, at most {farthest} px");
}

/// There and back again is nothing, a moment to itself is nothing, and points at rest stay.
#[test]
fn flow_there_and_back_is_nothing() {
    let data = synth::generate("reach", &SynthOptions { size: 96, ..small() }).unwrap();
    let (truth, c) = (&data.truth, &before_the_cloth());
    assert!(truth.flow(c, 0.4, c, 0.4).flow.data.iter().all(|v| v.abs() < 1e-5));
    let (there, back) = (truth.flow(c, 0.5, c, 0.54), truth.flow(c, 0.54, c, 0.5));
    let (segments, landing) = (truth.segments(c, 0.5), truth.segments(c, 0.54));
    let (mut compared, mut worst, mut farthest) = (0, 0.0f32, 0.0f32);
    for k in (0..96 * 96).filter(|&k| there.visible_after[k]) {
        let (du, dv) = (there.flow.data[2 * k], there.flow.data[2 * k + 1]);
        if segments[k] == Some(2) {
            assert!(du.hypot(dv) < 1e-5, "the floor rests");
            continue;
        }
        let (x, y) = ((k % 96) as f32 + du, (k / 96) as f32 + dv);
        let (fx, fy) = (x.floor(), y.floor());
        let corner = |i: usize, j: usize| (fy as usize + j) * 96 + fx as usize + i;
        let four = [(0, 0), (1, 0), (0, 1), (1, 1)];
        if four.iter().any(|&(i, j)| landing[corner(i, j)] != segments[k]) {
            continue;
        }
        // Flow bends where faces meet.
        let at = |i: usize, j: usize| {
            let hit = truth.hit(c, 0.54, (fx as usize + i) as f64 + 0.5, (fy as usize + j) as f64 + 0.5);
            face(hit.unwrap().local)
        };
        if segments[k] == Some(0) && four.iter().any(|&(i, j)| at(i, j) != at(0, 0)) {
            continue;
        }
        let weigh = |i: usize, j: usize| {
            (if i == 1 { x - fx } else { 1.0 - x + fx }) * (if j == 1 { y - fy } else { 1.0 - y + fy })
        };
        let at =
            |c: usize| -> f32 { four.iter().map(|&(i, j)| weigh(i, j) * back.flow.data[2 * corner(i, j) + c]).sum() };
        worst = worst.max((du + at(0)).hypot(dv + at(1)));
        farthest = farthest.max(du.hypot(dv));
        compared += 1;
    }
    assert!(
        compared > 300 && worst < 0.05 && farthest > 2.0,
        "{compared} points, {worst} px off, {farthest} px at most"
    );
}

/// The box keeps clear of the cloth, the floor and the border; most of its way is made in the burst.
#[test]
fn the_box_reaches_mostly_in_its_burst() {
    let data = synth::generate("reach", &SynthOptions { size: 8, train_views: 1, ..small() }).unwrap();
    let centre = |t: f64| data.truth.position_of(0, DVec3::ZERO, t).unwrap();
    let radius = DVec3::new(0.26, 0.2, 0.26).length();
    let mut way = [0.0f64; 8];
    for k in 0..800 {
        let t = f64::from(k) / 800.0;
        let c = centre(t);
        assert!(
            c.abs().max_element() + radius < 1.3 && c.z - radius > -0.68 && c.x + radius < 0.55 - 0.21,
            "{c} at {t}"
        );
        way[k as usize / 100] += (centre(t + 1.0 / 800.0) - c).length();
    }
    let all: f64 = way.iter().sum();
    assert!(way[4] > 0.6 * all && all > 0.7, "{way:?}");
    let cloth = |u: f64, t: f64| data.truth.position_of(1, DVec3::new(u, 0.3, 0.0), t).unwrap();
    assert_eq!(cloth(-0.55, 0.1), cloth(-0.55, 0.7), "it hangs by its upper edge");
    assert!(cloth(-0.55, 0.0).z > 0.55 && cloth(0.55, 0.0).z < -0.45);
    assert!(
        (0..50).map(|k| (cloth(0.55, f64::from(k) / 50.0).x - 0.55).abs()).fold(0.0, f64::max) > 0.08,
        "it wobbles"
    );
}

/// Maps are written, numpy's format reads back, masks fit the segments, and the truth of a folder is found again.
#[test]
fn maps_hold_the_truth() {
    let dir = tempfile::tempdir().unwrap();
    let data = synth::write(dir.path(), "reach", &small(), false).unwrap();
    synth::write_maps(dir.path(), &data, 5, false).unwrap();
    assert_eq!(synth::write_maps(dir.path(), &data, 5, false).unwrap_err().code(), "io.exists");
    let maps = dir.path().join("maps");
    let free = gs_core::io::Limits { allow_non_finite: true, ..Default::default() };
    let load = |name: &str| gs_core::io::npy::read(&std::fs::read(maps.join(name)).unwrap(), name, &free).unwrap();
    let (depth, flow) = (load("test/r_001.depth.npy"), load("fixed/t_002.flow.npy"));
    assert_eq!((depth.shape.clone(), flow.shape.clone()), (vec![48, 48], vec![48, 48, 2]));
    let view = &data.dataset.test[1];
    let (bodies, depth) = (data.truth.segments(&view.camera, view.time.seconds), depth.to_f32());
    assert!(bodies.iter().zip(&depth).all(|(b, z)| b.is_some() == z.is_finite()));
    for (name, body) in [("global", 0), ("local", 1)] {
        let file = maps.join(format!("test/r_001.{name}.png"));
        let mask = image::open(&file).unwrap().to_luma8();
        let fits = bodies.iter().zip(mask.as_raw());
        assert!(
            fits.clone().all(|(b, m)| (*b == Some(body)) == (*m == 255))
                && fits.filter(|(_, m)| **m == 255).count() > 20
        );
    }
    let camera = &data.dataset.test[0].camera;
    let want = data.truth.flow(camera, 0.5, camera, 0.75);
    for (k, v) in flow.to_f32().iter().enumerate() {
        assert!(if want.seen[k / 2] { *v == want.flow.data[k] } else { v.is_nan() });
    }
    assert!(!maps.join("fixed/t_004.flow.npy").exists() && maps.join("fixed/t_004.local.png").exists());
    let cameras = gs_core::io::load_cameras(&maps.join("fixed/camera.json"), &free).unwrap();
    assert_eq!(cameras.iter().filter_map(|c| c.time).collect::<Vec<_>>(), [0.0, 0.25, 0.5, 0.75, 1.0]);
    let frame = image::open(maps.join("fixed/frames/t_003.png")).unwrap().to_rgba8();
    assert_eq!(frame.as_raw(), &data.truth.picture(camera, 0.75).data);
    assert_eq!(synth::truth_of(dir.path()).as_ref(), Some(&data.truth));
    assert!(synth::truth_of(&maps).is_none());
}
