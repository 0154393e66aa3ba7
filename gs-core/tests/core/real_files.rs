//! Files of other programs. They are not part of the repository: see [`gs_core::testkit`].
use glam::Vec3;
use gs_core::io::{Limits, load_cameras, load_splats, npy, ply, read_file, sigmoid, spz};
use gs_core::sh;
use gs_core::testkit::shared;

#[test]
fn a_trained_ply_is_read_and_written_back_byte_for_byte() {
    let Some(path) = shared("data/gauss_trained_ply/point_cloud_iter7000.ply") else { return };
    let splats = load_splats(&path, &Limits::default()).unwrap();
    assert_eq!((splats.len(), splats.degree), (9080, 3));
    let ready = splats.to_splats().unwrap();
    assert!(ready.scales.iter().all(|s| s.min_element() > 0.0));
    let mut out = Vec::new();
    ply::write(&splats, &mut out).unwrap();
    let bytes = read_file(&path, &Limits::default()).unwrap();
    // The data part: same length and, normals being zero there as well, the same bytes.
    let data = splats.len() * 62 * 4;
    assert_eq!(out[out.len() - data..], bytes[bytes.len() - data..]);
}

#[test]
fn opacities_of_exactly_zero_are_legal() {
    let Some(path) = shared("workload/bulba_sh3.ply") else { return };
    let splats = load_splats(&path, &Limits::default()).unwrap();
    assert_eq!(splats.len(), 11_982);
    assert!(splats.to_splats().unwrap().opacities.iter().any(|&o| o < 2e-6));
}

#[test]
fn the_minimal_formats_agree_with_each_other() {
    let Some(path) = shared("data/gauss_minimal_formats/minimal.splat") else { return };
    let load = |name: &str| load_splats(&path.with_file_name(name), &Limits::default());
    let [splat, v2, v3, v4] =
        ["minimal.splat", "minimal-v2.spz", "minimal-v3.spz", "minimal-v4.spz"].map(|name| load(name).unwrap());
    let corners = [(-1.0, -1.0), (0.0, -1.0), (-1.0, 0.0), (0.0, 0.0)].map(|(x, z)| Vec3::new(x, 0.0, z));
    assert_eq!(v4, v3);
    assert_eq!((splat.means.as_slice(), v3.means.as_slice()), (corners.as_slice(), corners.as_slice()));
    // This version-2 file was written without turning the axes, against the specification; we read by the specification.
    assert_eq!(v2.means, corners.map(|m| Vec3::new(m.x, -m.y, -m.z)));
    for i in 0..4 {
        for other in [&v2, &v3] {
            assert!((splat.log_scales[i] - other.log_scales[i]).abs().max_element() < 1.0 / 32.0);
            assert!((sigmoid(splat.logit_opacities[i]) - sigmoid(other.logit_opacities[i])).abs() < 1.0 / 255.0);
            for c in 0..3 {
                let rgb = |s: &gs_core::io::RawSplats| 0.5 + sh::C0 as f32 * s.sh[3 * i + c];
                assert!((rgb(&splat) - rgb(&v3)).abs() < 1.5 / 255.0);
            }
        }
    }
    for (name, text) in [("minimal-raw.spz", "not compressed"), ("minimal.ksplat", ".ksplat format is not supported")] {
        assert!(load(name).unwrap_err().to_string().contains(text), "{name}");
    }
    let bytes = read_file(&path.with_file_name("minimal-v3.spz"), &Limits::default()).unwrap();
    assert_eq!(spz::read(&bytes, "v3", &Limits::default()).unwrap().0.fraction_bits, 12);
}

#[test]
fn camera_files_of_all_layouts() {
    let load = |path: &str| shared(path).map(|p| load_cameras(&p, &Limits::default()));
    if let Some(cameras) = load("data/gauss_trained_ply/inria_cameras_json/cameras.json") {
        let cameras = cameras.unwrap();
        assert_eq!((cameras.len(), cameras[0].name.as_str()), (193, "_DSC8679"));
        let eye = cameras[0].camera.position();
        assert!((eye - glam::DVec3::new(-3.79362068622298, 0.8065245954399215, -1.0985056479183641)).length() < 1e-6);
    }
    if let Some(cameras) = load("golden/g1_single/camera.json") {
        let camera = &cameras.unwrap()[0].camera;
        assert_eq!((camera.fx, camera.fy, camera.cx, camera.cy), (70.0, 66.0, 31.0, 33.5));
        assert_eq!(camera.translation, glam::DVec3::new(0.05, 0.02, 1.5));
    }
    for path in
        ["workload/cam256.json", "workload/cam800.json", "workload/garden_cam.json", "workload/bulba_cam800.json"]
    {
        if let Some(cameras) = load(path) {
            assert_eq!(cameras.unwrap().len(), 1);
        }
    }
    if let Some(cameras) = load("data/dnerf_mutant_400/transforms_train.json") {
        // The sizes are in the images beside the file, which need the feature.
        if cfg!(feature = "images") {
            let first = &cameras.unwrap()[0].camera;
            assert_eq!((first.width, first.height), (400, 400));
        } else {
            assert!(cameras.unwrap_err().to_string().contains("`w` is missing (at entry 0)"));
        }
    }
    if let Some(cameras) = load("data/fox_270x480/transforms.json") {
        assert!(cameras.unwrap_err().to_string().contains("`k1` = 0.0578421"));
    }
}

/// Absent data are reported on stderr, and are a failure where they are required.
#[test]
fn absent_data_are_visible() {
    let run = |require: &str| {
        let mut command = std::process::Command::new(std::env::current_exe().unwrap());
        command.args(["golden_arrays_and_scenes", "--test-threads=2"]).env("GS4D_SHARED", "/nonexistent");
        let output = command.env("GS4D_REQUIRE_SHARED", require).output().unwrap();
        (output.status.success(), String::from_utf8_lossy(&output.stderr).into_owned())
    };
    let line = "SKIPPED real_files::golden_arrays_and_scenes: `golden/g1_single/image.npy` is absent\n";
    assert_eq!(run("0"), (true, line.to_owned()));
    assert!(!run("1").0);
}

#[test]
fn golden_arrays_and_scenes() {
    let Some(path) = shared("golden/g1_single/image.npy") else { return };
    let bytes = read_file(&path, &Limits::default()).unwrap();
    let image = npy::read(&bytes, "image.npy", &Limits::default()).unwrap();
    assert_eq!(image.shape, [64, 64, 4]);
    let splats = load_splats(&path.with_file_name("scene.ply"), &Limits::default()).unwrap();
    assert_eq!((splats.len(), splats.degree), (1, 3));
}

#[cfg(feature = "images")]
#[test]
fn png_and_jpeg_images() {
    let Some(path) = shared("data/fox_270x480/images/0001.jpg") else { return };
    let image = gs_core::io::images::load_image(&path, &Limits::default()).unwrap();
    assert_eq!(image.shape(), (270, 480, 3));
    let Some(path) = shared("data/dnerf_mutant_400/train/r_000.png") else { return };
    let image = gs_core::io::images::load_rgba8(&path, &Limits::default()).unwrap();
    assert_eq!((image.width, image.height), (400, 400));
}

#[cfg(feature = "exr")]
#[test]
fn openexr_samples() {
    let load =
        |name: &str| shared(&format!("data/exr_public/{name}")).map(|p| gs_core::io::exr::load(&p, &Limits::default()));
    let Some(grey) = load("GrayRampsHorizontal.exr") else { return };
    assert_eq!(grey.unwrap().channels, 1);
    assert!(load("WideFloatRange.exr").is_some_and(|r| r.is_ok_and(|i| i.channels == 1)));
    let text = load("BrightRingsNanInf.exr").unwrap().unwrap_err().to_string();
    assert!(text.contains("values are not finite"), "{text}");
    // t08 has its data, 400 x 300 as t01, at (30, 40) of a display window of 501 x 401.
    let (t01, t08) = (load("t01.exr").unwrap().unwrap(), load("t08.exr").unwrap().unwrap());
    assert_eq!((t01.shape(), t08.shape()), ((400, 300, 3), (501, 401, 3)));
    let outside = |x, y| x < 30 || y < 40 || x >= 430 || y >= 340;
    let mut pixels = (0..300).flat_map(|y| (0..400).map(move |x| (x, y)));
    assert!(pixels.all(|(x, y)| t01.pixel(x, y) == t08.pixel(x + 30, y + 40)), "the same image in both");
    for y in 0..401 {
        for x in 0..501 {
            assert!(!outside(x, y) || t08.pixel(x, y) == [0.0; 3], "{x} {y}");
        }
    }
}

/// D-NeRF files do not say how large their images are; the images beside them do.
#[cfg(feature = "images")]
#[test]
fn transforms_without_a_size_take_it_from_the_image() {
    let folder = tempfile::tempdir().expect("a folder");
    std::fs::create_dir(folder.path().join("test")).expect("a folder");
    let image = gs_core::Image::zeros(6, 4, 3);
    gs_core::io::images::save_png(&folder.path().join("test/r_000.png"), &image, false).expect("an image");
    let file = folder.path().join("transforms_test.json");
    let identity = "[[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]";
    let text = |name: &str| {
        format!(
            r#"{{"camera_angle_x":0.7,"frames":[{{"file_path":"{name}","time":0.5,"transform_matrix":{identity}}}]}}"#
        )
    };
    std::fs::write(&file, text("./test/r_000")).expect("a file");
    let cameras = load_cameras(&file, &Limits::default()).expect("a camera");
    assert_eq!((cameras[0].camera.width, cameras[0].camera.height, cameras[0].time), (6, 4, Some(0.5)));
    // A name that leaves the folder is not followed.
    for name in ["../test/r_000", "/test/r_000", "./test/r_404"] {
        std::fs::write(&file, text(name)).expect("a file");
        let error = load_cameras(&file, &Limits::default()).expect_err("no size").to_string();
        assert!(error.contains("`w` is missing"), "{error}");
    }
}
