//! Masks and depth maps beside images: what they say, at which size, and when they are in the loss.

use crate::layouts::Folder;
use gs_core::io::{npy, write_file};
use gs_data::{DataOptions, Dataset, ImageCache};
use serde_json::json;

#[test]
fn nerfstudio_masks_say_what_counts() {
    let f = Folder::new(3, "png");
    let mut j = f.nerfstudio();
    j["frames"][2]["mask_path"] = json!("masks/f002.png");
    f.put("transforms.json", j.to_string());
    assert_eq!(f.open(&DataOptions::default()).unwrap_err().code(), "io.read");
    std::fs::create_dir(f.path().join("masks")).unwrap();
    let left = |x: u32, _| image::Luma([if x < 20 { 255u8 } else { 0 }]);
    image::GrayImage::from_fn(40, 30, left).save(f.path().join("masks/f002.png")).unwrap();
    let d = f.open(&DataOptions::default()).unwrap();
    let masked: Vec<_> = d.train.iter().chain(&d.test).filter(|v| v.mask.is_some()).collect();
    assert!(masked.len() == 1 && masked[0].name == "f002");
    let weights = ImageCache::new(0, 1.0).mask(masked[0]).unwrap().unwrap();
    assert_eq!((weights.pixel(3, 3)[0], weights.pixel(36, 3)[0]), (1.0, 0.0));
    image::GrayImage::new(30, 40).save(f.path().join("masks/f002.png")).unwrap();
    assert_eq!(f.open(&DataOptions::default()).unwrap_err().code(), "data.image_size");
    j["frames"][2]["mask_path"] = json!("../elsewhere.png");
    f.put("transforms.json", j.to_string());
    assert_eq!(f.open(&DataOptions::default()).unwrap_err().code(), "data.escape");
}

/// A camera held upright stores its pixels lying down and says so by EXIF; the mask is as the image is looked at.
#[test]
fn masks_of_turned_images_are_upright() {
    let f = Folder::new(3, "png");
    let mut j = f.nerfstudio();
    j["frames"][2]["mask_path"] = json!("masks/f002.png");
    f.put("transforms.json", j.to_string());
    std::fs::create_dir(f.path().join("masks")).unwrap();
    let left = |x: u32, _| image::Luma([if x < 20 { 255u8 } else { 0 }]);
    image::GrayImage::from_fn(40, 30, left).save(f.path().join("masks/f002.png")).unwrap();
    // Turned by 90 degrees to the right, the lower half comes to the left.
    let lower = |_, y: u32| image::Rgb(if y >= 20 { [200u8; 3] } else { [20; 3] });
    let mut jpeg = Vec::new();
    let mut encoder = image::codecs::jpeg::JpegEncoder::new(&mut jpeg);
    let turned = b"II*\0\x08\0\0\0\x01\0\x12\x01\x03\0\x01\0\0\0\x06\0\0\0\0\0\0\0";
    image::ImageEncoder::set_exif_metadata(&mut encoder, turned.to_vec()).unwrap();
    encoder.encode_image(&image::RgbImage::from_fn(30, 40, lower)).unwrap();
    f.put("images/f002.png", jpeg);
    let d = f.open(&DataOptions::default()).unwrap();
    let view = d.train.iter().chain(&d.test).find(|v| v.mask.is_some()).unwrap();
    let images = ImageCache::new(1 << 20, 1.0);
    let (image, weights) = (images.get(view).unwrap(), images.mask(view).unwrap().unwrap());
    assert_eq!([image.width, image.height], [40, 30]);
    for x in [3, 36] {
        assert_eq!(weights.pixel(x, 3)[0] == 1.0, image.pixel(x, 3)[0] > 100, "column {x}");
    }
    assert!(image.pixel(3, 3)[0] > 100 && image.pixel(36, 3)[0] < 100);
}

#[test]
fn masks_are_in_the_loss_where_that_is_asked_for() {
    let f = Folder::new(3, "png");
    let mut j = f.nerfstudio();
    f.put("transforms.json", j.to_string());
    let asked = DataOptions { mask_loss: true, ..DataOptions::default() };
    let e = f.open(&asked).unwrap_err();
    assert!(e.code() == "data.option" && e.to_string().contains("data.mask_loss"), "{e}");
    std::fs::create_dir(f.path().join("masks")).unwrap();
    image::GrayImage::new(40, 30).save(f.path().join("masks/m.png")).unwrap();
    [0, 1].iter().for_each(|k| j["frames"][*k]["mask_path"] = json!("masks/m.png"));
    f.put("transforms.json", j.to_string());
    let d = f.open(&asked).unwrap();
    let marked: Vec<&str> = d.train.iter().filter(|v| v.mask_loss).map(|v| v.name.as_str()).collect();
    assert_eq!((d.train.len(), marked), (2, vec!["f001"]), "f000 is held out");
    assert!(
        d.notes.iter().any(|n| n.contains("of 1 of 2 training views only pixels inside the mask train")),
        "{:?}",
        d.notes
    );
    assert!(f.open(&DataOptions::default()).unwrap().train.iter().all(|v| !v.mask_loss));
}

#[test]
fn nerfstudio_depth_is_read_in_millimetres_or_what_the_file_says() {
    let f = Folder::new(3, "png");
    let mut j = f.nerfstudio();
    j["frames"][1]["depth_file_path"] = json!("depth/f001.png");
    j["frames"][2]["depth_file_path"] = json!("depth/f002.npy");
    f.put("transforms.json", j.to_string());
    assert_eq!(f.open(&DataOptions::default()).unwrap_err().code(), "io.read");
    std::fs::create_dir(f.path().join("depth")).unwrap();
    let png = f.path().join("depth/f001.png");
    let ramp = |x: u32, y: u32| image::Luma([(1000 + 10 * x + y) as u16]);
    image::ImageBuffer::<image::Luma<u16>, Vec<u16>>::from_fn(40, 30, ramp).save(&png).unwrap();
    // Half as many pixels, two of them without a measurement.
    let mut values = vec![2500.0f32; 20 * 15];
    (values[0], values[1]) = (f32::NAN, -3.0);
    write_file(&f.path().join("depth/f002.npy"), false, |out| npy::write(&[15, 20], &values, out)).unwrap();
    let at = |d: &Dataset, k: usize, scale: f64, x: usize, y: usize| {
        ImageCache::new(1 << 20, scale).depth(&d.train[k]).unwrap().unwrap().pixel(x, y)[0]
    };
    let d = f.open(&DataOptions::default()).unwrap();
    assert_eq!((at(&d, 0, 1.0, 0, 0), at(&d, 0, 1.0, 7, 5)), (1.0, 1.075));
    assert_eq!((at(&d, 1, 1.0, 0, 0), at(&d, 1, 1.0, 3, 1), at(&d, 1, 1.0, 39, 29)), (0.0, 0.0, 2.5));
    assert_eq!(at(&d, 0, 0.5, 3, 2), 1.075, "the nearest pixel of a smaller image");
    let small = f.open(&DataOptions { scale: 0.5, ..DataOptions::default() }).unwrap();
    assert_eq!(at(&small, 0, 1.0, 3, 2), 1.075);
    assert!(ImageCache::new(0, 1.0).depth(&d.test[0]).unwrap().is_none());
    j["depth_unit_scale_factor"] = json!(0.01);
    f.put("transforms.json", j.to_string());
    let d = f.open(&DataOptions::default()).unwrap();
    assert_eq!(at(&d, 1, 1.0, 39, 29), 25.0);
    image::GrayImage::new(40, 30).save(&png).unwrap();
    let e = ImageCache::new(0, 1.0).depth(&d.train[0]).unwrap_err();
    assert!(e.code() == "data.field" && e.to_string().contains("colour type"), "{e}");
    image::ImageBuffer::<image::Luma<u16>, Vec<u16>>::new(30, 40).save(&png).unwrap();
    assert_eq!(ImageCache::new(0, 1.0).depth(&d.train[0]).unwrap_err().code(), "data.image_size");
    j["depth_unit_scale_factor"] = json!(0.0);
    f.put("transforms.json", j.to_string());
    assert_eq!(f.open(&DataOptions::default()).unwrap_err().code(), "data.field");
}
