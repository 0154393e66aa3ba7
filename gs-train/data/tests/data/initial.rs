//! Initial points: the visual hull of alpha or masks, random points in a box, given points.

use glam::DVec3;
use glam::Vec3;
use gs_data::pixels::ImageU8;
use gs_data::{DataOptions, Dataset, ImageSource};
use gs_synth::{SynthOptions, generate, write};
use std::collections::BTreeSet;
use std::sync::Arc;

fn options() -> SynthOptions {
    SynthOptions::of_views(64, 60, 0)
}

#[test]
fn the_hull_of_a_static_scene_holds_the_scene_and_little_more() {
    let data = generate("static", &options()).unwrap();
    let cloud = data.dataset.initial_points(4000, 1).unwrap();
    assert_eq!((cloud.positions.len(), cloud.colors.len()), (4000, 4000));
    // No camera looks from below, so some space under the slab cannot be carved.
    let outer = cloud.positions.iter().filter(|p| p.abs().max_element() > 1.1).count();
    assert!(outer < 160, "{outer} of 4000 points in the empty outer 40 % of the box");
    for (body, b) in data.truth.bodies().iter().enumerate() {
        let centre = data.truth.position_of(body, DVec3::ZERO, 0.0).unwrap().as_vec3();
        let near = cloud.positions.iter().any(|p| (*p - centre).length() < 0.1);
        assert!(near, "points in \"{}\"", b.name);
    }
    let above = cloud.positions.iter().filter(|p| p.z > 0.75).count();
    assert!(above < 40, "{above} of 4000 points above everything");
}

#[test]
fn a_moving_scene_keeps_the_places_its_bodies_pass() {
    let data = generate("balls", &SynthOptions { train_views: 120, ..options() }).unwrap();
    let cloud = data.dataset.initial_points(20_000, 1).unwrap();
    for t in [0.1, 0.5, 0.9] {
        for body in 0..4 {
            let centre = data.truth.position_of(body, DVec3::ZERO, t).unwrap().as_vec3();
            let near = cloud.positions.iter().filter(|p| (**p - centre).length() < 0.12).count();
            assert!(near > 3, "body {body} at {t}: {near} points");
        }
    }
    let outer = cloud.positions.iter().filter(|p| p.abs().max_element() > 1.1).count();
    assert!(outer < 3000, "{outer} of 20000 points in the outer 40 % of the box");
}

#[test]
fn the_hull_of_a_long_sequence_is_carved_by_all_cameras_of_its_rig() {
    let rig = SynthOptions { size: 16, cameras: 8, moments: 160, ..options() };
    let data = generate("falling", &rig).unwrap().dataset;
    let carved = gs_data::hull::carve(&data, 0.95, None).unwrap().unwrap();
    let of = |views: &mut dyn Iterator<Item = usize>| views.map(|i| data.train[i].camera_id).collect::<BTreeSet<_>>();
    let [used, all] = [of(&mut carved.silhouettes.iter().map(|s| s.index)), of(&mut (0..data.train.len()))];
    assert!(data.train.len() > 5 * 160 && all.len() > 5 && used == all, "{used:?} of {all:?}");
}

#[test]
fn every_view_whose_silhouette_cannot_be_read_is_named() {
    let mut data = generate("static", &SynthOptions::of_views(16, 10, 0)).unwrap().dataset;
    let wrong = Arc::new(ImageU8 { width: 2, height: 1, data: vec![0; 8] });
    let spoilt = [2, 5, 9].map(|k| {
        let view = &mut data.train[k];
        view.image = ImageSource::Memory(wrong.clone());
        view.name.clone()
    });
    let errors = gs_data::hull::carve(&data, 0.95, None).err().unwrap();
    let named: BTreeSet<String> = errors.iter().map(|e| e.place().unwrap().file.display().to_string()).collect();
    assert_eq!((errors.len(), named), (spoilt.len(), BTreeSet::from(spoilt)));
}

#[test]
fn the_points_that_are_tested_are_not_every_second_one() {
    let mut data = generate("static", &SynthOptions::of_views(16, 4, 0)).unwrap().dataset;
    data.train.truncate(1);
    let camera = &data.train[0].camera;
    let [seen, unseen] = [1.0, -1.0].map(|way| (camera.position() + way * camera.forward()).as_vec3());
    // Every second point is seen.
    let points: Vec<Vec3> = (0..7500).map(|k| if k % 2 == 0 { seen } else { unseen }).collect();
    assert!((data.seen_share(&points) - 0.5).abs() < 0.01, "{}", data.seen_share(&points));
    assert_eq!((data.seen_share(&[]), data.seen_share(&[seen])), (0.0, 1.0));
}

#[test]
fn the_same_seed_gives_the_same_points_for_any_number_of_threads() {
    let data = generate("balls", &SynthOptions { train_views: 20, ..options() }).unwrap().dataset;
    let with = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| data.initial_points(500, 3).unwrap())
    };
    assert_eq!(with(1), with(3));
    assert_ne!(with(1), data.initial_points(500, 4).unwrap());
}

#[test]
fn without_alpha_points_fill_the_box_and_given_points_are_kept() {
    let mut data = generate("static", &SynthOptions { train_views: 2, ..options() }).unwrap().dataset;
    data.has_alpha = false;
    let cloud = data.initial_points(2000, 0).unwrap();
    let mean: Vec3 = cloud.positions.iter().sum::<Vec3>() / 2000.0;
    assert!(mean.length() < 0.1 && cloud.positions.iter().all(|p| p.abs().max_element() <= 1.3));
    data.points = Some(cloud.clone());
    assert_eq!(data.initial_points(5000, 0).unwrap(), cloud);
    assert_eq!(data.initial_points(10, 0).unwrap().positions.len(), 10);
}

/// The same data with alpha moved into masks.
fn masked(mut data: Dataset) -> Dataset {
    data.has_alpha = false;
    for v in &mut data.train {
        let ImageSource::Memory(image) = &v.image else { panic!("generated images are in memory") };
        let mut mask = ImageU8::clone(image);
        mask.data.chunks_exact_mut(4).for_each(|p| p.fill(p[3]));
        v.mask = Some(ImageSource::Memory(Arc::new(mask)));
    }
    data
}

/// Half of the points lie in the hull of these, and all of them where the images show nothing else.
#[test]
fn masks_carve_where_there_is_no_alpha() {
    let data = generate("balls", &options()).unwrap().dataset;
    let [hull, by_alpha] = [1000, 2000].map(|n| data.initial_points(n, 2).unwrap());
    let mut data = masked(data);
    let cloud = data.initial_points(2000, 2).unwrap();
    assert_eq!(cloud.positions.len(), 2000);
    let near = |p: &Vec3| hull.positions.iter().any(|q| (*p - *q).length() < 0.1);
    let inside = |points: &[Vec3]| points.iter().filter(|p| near(p)).count();
    let (first, rest) = (inside(&cloud.positions[..1000]), inside(&cloud.positions[1000..]));
    assert!(first > 900 && rest < 700, "{first} and {rest} of 1000 near the hull");
    assert!(data.has_start() && cloud.colors[1500] == [0.5; 3]);
    data.train.iter_mut().for_each(|v| v.cut_out = true);
    let cloud = data.initial_points(2000, 2).unwrap();
    assert_eq!(cloud.positions, by_alpha.positions);
    assert!(cloud.colors.iter().all(|c| *c != [0.5; 3]));
}

#[test]
fn small_things_have_points_where_they_are_at_the_first_moment() {
    let options = SynthOptions { cameras: 12, moments: 4, ..options() };
    let made = generate("falling", &options).unwrap();
    let first = masked(made.dataset).at_first_time();
    assert!(!first.dynamic && first.train.len() == 12);
    let cloud = first.initial_points(2000, 2).unwrap();
    let ball = made.truth.position_of(0, DVec3::ZERO, 0.0).unwrap().as_vec3();
    let near = cloud.positions[..1000].iter().filter(|p| p.distance(ball) < 0.3).count();
    assert!(near > 20, "{near} points of the hull in the ball");
}

#[test]
fn images_are_carved_within_the_limit_of_the_data() {
    let dir = tempfile::tempdir().unwrap();
    let (folder, file) = (dir.path().join("data"), dir.path().join("large.png"));
    write(&folder, "static", &SynthOptions::of_views(16, 3, 1), false).unwrap();
    let opened = Dataset::open(&folder, &DataOptions { max_image_mib: Some(3), ..DataOptions::default() }).unwrap();
    assert_eq!([opened.max_image_mib, opened.at_first_time().max_image_mib], [Some(3); 2]);

    image::RgbaImage::from_pixel(640, 640, image::Rgba([9, 9, 9, 255])).save(&file).unwrap();
    let mut data = generate("static", &SynthOptions { train_views: 2, ..options() }).unwrap().dataset;
    for v in &mut data.train {
        (v.camera, v.image) = (v.camera.scaled(10.0), ImageSource::File(file.clone()));
    }
    let fault = |max_image_mib| {
        let points = Dataset { max_image_mib, ..data.clone() }.initial_points(10, 0);
        points.err().map(|e| e.code())
    };
    assert_eq!([None, Some(1), Some(8)].map(fault), [None, Some("limits.file"), None]);
}
