//! Points to begin with, kept in `scene.toml`.

use glam::Vec3;
use gs_core::io::{npy, write_file};
use gs_data::DataOptions;
use gs_data::{Dataset, DepthMap, ImageCache, ImageSource, PointCloud, StartFrom, View, write_start};
use gs_synth::{self as synth, SynthOptions};

fn folder(name: &str) -> (tempfile::TempDir, Dataset) {
    let dir = tempfile::tempdir().unwrap();
    let options = SynthOptions { val_views: 1, ..SynthOptions::of_views(48, 24, 1) };
    synth::write(dir.path(), name, &options, true).unwrap();
    let data = Dataset::open(dir.path(), &DataOptions::default()).unwrap();
    (dir, data)
}

#[test]
fn what_is_written_is_what_the_folder_begins_with() {
    let (dir, data) = folder("balls");
    let mut start = data.start(None, 300, 4).unwrap();
    assert_eq!((start.from, start.cloud.positions.len()), (StartFrom::Hull, 300));
    start.bounds = Some([Vec3::splat(-1.5), Vec3::splat(1.25)]);
    std::fs::write(dir.path().join("scene.toml"), "# mine\n[time]\nrange = \"0..1\"\n").unwrap();
    write_start(dir.path(), &start, false).unwrap();
    let again = Dataset::open(dir.path(), &DataOptions::default()).unwrap();
    assert_eq!(again.points.as_ref().unwrap().positions, start.cloud.positions);
    assert_eq!(again.scene_bounds(), start.bounds.unwrap());
    assert_eq!(write_start(dir.path(), &start, false).unwrap_err().code(), "io.exists");
    start.bounds = None;
    write_start(dir.path(), &start, true).unwrap();
    let text = std::fs::read_to_string(dir.path().join("scene.toml")).unwrap();
    assert_eq!(text.matches("[start]").count(), 1);
    assert!(text.starts_with("# mine\n[time]\nrange") && !text.contains("bounds"), "{text}");
}

#[test]
fn depth_gives_points_on_the_surface() {
    let (dir, mut data) = folder("static");
    let truth = synth::truth_of(dir.path()).unwrap();
    for (k, v) in data.train.iter_mut().enumerate() {
        let file = dir.path().join(format!("depth{k}.npy"));
        let depth = truth.depth(&v.camera, v.time.seconds);
        write_file(&file, true, |out| npy::write(&[depth.height, depth.width], &depth.data, out)).unwrap();
        v.depth = Some(DepthMap::new(file));
    }
    let start = data.start(None, 400, 0).unwrap();
    assert_eq!((start.from, start.cloud.positions.len()), (StartFrom::Depth, 400));
    let off = |p: &Vec3| {
        let nearest = |b: &synth::body::Body| b.distance(p.as_dvec3(), 0.0).abs();
        truth.bodies().iter().map(nearest).fold(f64::INFINITY, f64::min)
    };
    let worst = start.cloud.positions.iter().map(off).fold(0.0, f64::max);
    assert!(worst < 1e-3, "{worst} off the surface");
}

#[test]
fn depth_is_read_within_the_limit_of_the_data() {
    let (dir, mut data) = folder("static");
    let file = dir.path().join("depth.png");
    // 1.6 MiB beside images of 48 by 48 pixels.
    let far = image::Luma([4000u16]);
    image::ImageBuffer::<image::Luma<u16>, Vec<u16>>::from_pixel(640, 640, far).save(&file).unwrap();
    data.train.iter_mut().for_each(|v| v.depth = Some(DepthMap { file: file.clone(), unit: 1e-3 }));
    let fault = |max_image_mib| {
        let data = Dataset { max_image_mib, ..data.clone() };
        let begun = data.start(Some(StartFrom::Depth), 10, 0).err().map(|e| e.code());
        let images = ImageCache::new(0, 1.0).with_max_image_mib(max_image_mib);
        [begun, images.depth(&data.train[0]).err().map(|e| e.code())]
    };
    assert_eq!([None, Some(1), Some(8)].map(fault), [[None; 2], [Some("limits.file"); 2], [None; 2]]);
}

/// A COLMAP model beside other layouts: one point that the first training image saw, one that the last image of all saw.
#[test]
fn points_of_the_held_out_end_are_left_out_of_a_model_beside() {
    let (dir, _) = folder("balls");
    let early = DataOptions { time_boundary: Some(0.5), ..DataOptions::default() };
    let data = Dataset::open(dir.path(), &early).unwrap();
    let name = |v: &View| match &v.image {
        ImageSource::File(path) => path.strip_prefix(&data.root).unwrap().display().to_string(),
        ImageSource::Memory(_) => panic!("of files"),
    };
    let names = [name(&data.train[0]), name(data.extrapolate.last().unwrap())];
    let sparse = dir.path().join("sparse/0");
    std::fs::create_dir_all(&sparse).unwrap();
    std::fs::write(sparse.join("cameras.txt"), "1 PINHOLE 48 48 50 50 24 24\n").unwrap();
    let images = names.iter().enumerate().map(|(k, name)| format!("{} 1 0 0 0 0 0 4 1 {name}\n\n", k + 5));
    std::fs::write(sparse.join("images.txt"), images.collect::<String>()).unwrap();
    let write = |tracks: [&str; 2]| {
        let points = format!("1 0 0 0 9 9 9 0.1{}\n2 0.1 0 0 9 9 9 0.1{}\n", tracks[0], tracks[1]);
        std::fs::write(sparse.join("points3D.txt"), points).unwrap();
    };
    let found = |data: &Dataset| data.start(Some(StartFrom::Colmap), 10, 0).unwrap().cloud.positions;
    write([" 5 0", " 6 0"]);
    assert_eq!(found(&data), [Vec3::ZERO]);
    let options = DataOptions { layout: Some("blender".into()), ..DataOptions::default() };
    assert_eq!(found(&Dataset::open(dir.path(), &options).unwrap()).len(), 2, "nothing is held out");
    write(["", ""]);
    assert_eq!(found(&data).len(), 2, "without tracks nobody knows");
}

#[test]
fn what_the_data_cannot_give_is_said() {
    let (_dir, mut data) = folder("static");
    let why = |d: &Dataset, from| d.start(Some(from), 10, 0).unwrap_err().to_string();
    assert!(why(&data, StartFrom::Colmap).contains("COLMAP"));
    assert!(why(&data, StartFrom::Depth).contains("no depth"));
    data.points = Some(PointCloud { positions: vec![Vec3::splat(1e4); 9], colors: vec![[0.0; 3]; 9] });
    assert!(why(&data, StartFrom::Colmap).contains("frame of its poses"), "points elsewhere");
    data.has_alpha = false;
    assert!(why(&data, StartFrom::Hull).contains("neither alpha nor masks"));
    assert_eq!(data.start(None, 10, 0).unwrap().from, StartFrom::Random);
}
