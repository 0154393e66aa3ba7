//! Which views of nerfstudio's layout train, and from which images.

use crate::layouts::{Folder, number};
use gs_data::{DataOptions, ImageSource, TimeFrom};
use serde_json::json;

#[test]
fn nerfstudio_frames_that_are_held_out_never_train() {
    type Lists<'a> = &'a [(&'a str, &'a [usize])];
    let f = Folder::new(5, "png");
    let open = |lists: Lists| {
        let mut j = f.nerfstudio();
        for (key, frames) in lists {
            let names: Vec<String> = frames.iter().map(|k| format!("images/f{k:03}.png")).collect();
            j[format!("{key}_filenames")] = json!(names);
        }
        f.put("transforms.json", j.to_string());
        f.open(&DataOptions::default())
    };
    let splits = |lists: Lists| {
        let d = open(lists).unwrap();
        [d.train, d.val, d.test].map(|views| views.iter().map(|v| number(&v.name)).collect::<Vec<_>>())
    };
    assert_eq!(splits(&[("test", &[1, 3])]), [vec![0, 2, 4], vec![], vec![1, 3]]);
    assert_eq!(splits(&[("val", &[0])]), [vec![1, 2, 3, 4], vec![0], vec![]]);
    assert_eq!(
        splits(&[("val", &[0, 1]), ("test", &[1])]),
        [vec![2, 3, 4], vec![0], vec![1]],
        "a test view is no other"
    );
    assert_eq!(splits(&[("train", &[0, 2])]), [vec![0, 2], vec![], vec![]]);
    assert_eq!(splits(&[("val", &[]), ("test", &[])]), [vec![1, 2, 3, 4], vec![], vec![0]], "every eighth");
    let notes = open(&[("test", &[1])]).unwrap().notes.concat();
    assert!(notes.contains("the 4 frames that are not held out train"), "{notes}");
    let faults: [(Lists, &str); 6] = [
        (&[("train", &[0, 1]), ("test", &[3, 1])], "images/f001.png\", which train_filenames lists too"),
        (&[("train", &[0]), ("val", &[2, 0])], "images/f000.png\", which train_filenames lists too"),
        (&[("test", &[3, 9])], "images/f009.png\", which is the file_path of no frame"),
        (&[("train", &[0, 9])], "images/f009.png\", which is the file_path of no frame"),
        (&[("train", &[0, 1]), ("val", &[2, 9])], "images/f009.png\", which is the file_path of no frame"),
        (&[("train", &[0, 1]), ("test", &[2, 9])], "images/f009.png\", which is the file_path of no frame"),
    ];
    for (lists, want) in faults {
        let e = open(lists).unwrap_err();
        assert!(e.code() == "data.field" && e.to_string().contains("_filenames[1] is "), "{e}");
        assert!(e.to_string().contains(want), "{e}");
    }
}

#[test]
fn another_image_folder_scales_the_intrinsics_and_must_exist() {
    let f = Folder::new(3, "png");
    let mut j = f.nerfstudio();
    let names: Vec<String> = (0..3).map(|k| format!("images/f{k:03}.png")).collect();
    j["train_filenames"] = json!(names[1..]);
    f.put("transforms.json", j.to_string());
    let half = DataOptions { images: Some("images_2".into()), ..DataOptions::default() };
    let e = f.open(&half).unwrap_err();
    assert!(e.code() == "data.missing" && e.to_string().contains("images_2/f000.png"), "{e}");
    std::fs::create_dir(f.path().join("images_2")).unwrap();
    for name in &names {
        let file = f.path().join(name.replace("images/", "images_2/"));
        image::RgbImage::from_pixel(20, 15, image::Rgb([9; 3])).save(file).unwrap();
    }
    let d = f.open(&half).unwrap();
    let (c, whole) = (&d.train[0].camera, &f.cameras[1]);
    assert_eq!((c.width, c.height, d.train.len()), (20, 15, 2));
    assert!((c.fx - 0.5 * whole.fx).abs() < 1e-9 && (c.cx - 0.5 * whole.cx).abs() < 1e-9);
    assert!(matches!(&d.train[0].image, ImageSource::File(file) if file.ends_with("images_2/f001.png")));

    let out = DataOptions { images: Some("../images".into()), ..DataOptions::default() };
    assert_eq!(f.open(&out).unwrap_err().code(), "data.escape");
    j.as_object_mut().unwrap().remove("w");
    f.put("transforms.json", j.to_string());
    assert!(f.open(&half).unwrap_err().to_string().contains("frames[0].w"), "focal lengths in pixels of no size");
    j["frames"][0]["file_path"] = json!("f000.png");
    f.put("transforms.json", j.to_string());
    let e = f.open(&half).unwrap_err();
    assert!(e.code() == "data.option" && e.to_string().contains("\"f000.png\""), "{e}");
}

#[test]
fn options_that_would_do_nothing_are_refused() {
    let f = Folder::new(3, "png");
    let frames = f.nerfstudio();
    f.put("transforms_train.json", json!({"camera_angle_x": 0.8, "frames": frames["frames"]}).to_string());
    f.put("transforms.json", frames.to_string());
    f.colmap_text("PINHOLE 40 30 40 40 20 15");
    let with = |layout: &str, o: DataOptions| f.open(&DataOptions { layout: Some(layout.into()), ..o }).map(|_| ());
    for layout in ["blender", "nvfi"] {
        let e = with(layout, DataOptions { images: Some("images_4".into()), ..Default::default() }).unwrap_err();
        assert!(e.code() == "data.option" && e.to_string().contains("data.images"), "{layout}: {e}");
    }
    for layout in ["blender", "nvfi", "nerfstudio", "colmap"] {
        let o = DataOptions { fps: Some(10.0), hold_out: 0, ..Default::default() };
        let e = with(layout, o.clone()).unwrap_err();
        assert!(e.code() == "data.option" && e.to_string().contains("data.fps"), "{layout}: {e}");
        if layout != "nvfi" {
            with(layout, DataOptions { time_from: TimeFrom::Name, ..o }).unwrap();
        }
    }
}
