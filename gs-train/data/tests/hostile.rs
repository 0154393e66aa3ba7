//! Damaged and malicious data: any bytes give a data set or a typed error, without a panic, without a long run, and with
//! at most eight times the size of the files plus 64 MiB of memory.

use std::path::Path;
use std::time::{Duration, Instant};

use gs_core::testkit::alloc::{Counting, peak_of};
use gs_core::{Camera, Rng, Time};
use gs_data::decode::decode;
use gs_data::{DataError, DataOptions, Dataset, ImageCache, ImageSource, View};
use gs_synth::{self as synth, SynthOptions};

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// Runs `f` and checks memory (against the bytes of the files involved) and time.
fn bounded<T>(file_bytes: usize, what: &str, f: impl FnOnce() -> T) -> T {
    let start = Instant::now();
    let (out, peak) = peak_of(f);
    let took = start.elapsed();
    let limit = 8 * file_bytes + (64 << 20);
    assert!(peak <= limit, "{what}: {peak} bytes for a file of {file_bytes}, limit {limit}");
    assert!(took < Duration::from_secs(10), "{what}: {took:?}");
    out
}

/// A generated scene on disk: its folder and the text of its training JSON.
fn scene() -> (tempfile::TempDir, Vec<u8>) {
    let dir = tempfile::tempdir().unwrap();
    let o = SynthOptions::of_views(12, 3, 0);
    synth::write(dir.path(), "balls", &o, false).unwrap();
    let text = std::fs::read(dir.path().join("transforms_train.json")).unwrap();
    (dir, text)
}

/// Flips, inserts, deletes or copies a few bytes.
fn mutate(bytes: &[u8], rng: &mut Rng) -> Vec<u8> {
    let mut out = bytes.to_vec();
    for _ in 0..1 + rng.below(4) {
        let at = rng.below(out.len().max(1) as u32) as usize;
        let other = rng.below(out.len().max(1) as u32) as usize;
        match rng.below(5) {
            0 if !out.is_empty() => out[at] ^= 1 << rng.below(8),
            1 if !out.is_empty() => out[at] = rng.bits() as u8,
            2 => out.insert(at, b"0123456789eE.-+[]{}\",:"[rng.below(22) as usize]),
            3 if !out.is_empty() => drop(out.remove(at)),
            _ => out = [&out[..at.min(other)], &out[at.max(other)..]].concat(),
        }
    }
    out
}

/// Writes a file anew: truncating one in place makes some file systems wait for the disk.
fn put(file: &Path, bytes: &[u8]) {
    let _ = std::fs::remove_file(file);
    std::fs::write(file, bytes).unwrap();
}

fn open(dir: &Path) -> Result<Dataset, DataError> {
    Dataset::open(dir, &DataOptions::default())
}

#[test]
fn mutated_json_gives_data_or_an_error() {
    let (dir, text) = scene();
    let file = dir.path().join("transforms_train.json");
    let (mut good, mut bad) = (0, 0);
    for k in 0..3000 {
        let bytes = mutate(&text, &mut Rng::new(1, "mutate.json", 0, k));
        put(&file, &bytes);
        match bounded(bytes.len(), "mutated json", || open(dir.path())) {
            Ok(d) => {
                good += 1;
                assert!(d.train.iter().all(|v| v.camera.check().is_ok() && v.time.normalised.is_finite()));
            }
            Err(e) => {
                bad += 1;
                assert!(e.report().contains("\n  do   "), "{e}");
            }
        }
    }
    assert!(good > 100 && bad > 500, "both happen: {good} good, {bad} bad");
}

#[test]
fn json_cut_at_every_place_is_an_error() {
    let (dir, text) = scene();
    let file = dir.path().join("transforms_train.json");
    for cut in (0..text.len() - 2).step_by(7) {
        put(&file, &text[..cut]);
        let e = bounded(cut, "cut json", || open(dir.path())).unwrap_err();
        assert_eq!(e.code(), "data.syntax", "cut at {cut}: {e}");
    }
}

#[test]
fn json_bombs_are_cheap() {
    let (dir, _) = scene();
    let file = dir.path().join("transforms_train.json");
    let n = 2_000_000;
    let bombs: [(&str, String); 9] = [
        ("numbers", format!("{{\"camera_angle_x\":1,\"frames\":[{}0]}}", "0,".repeat(n))),
        ("deep", format!("{{\"camera_angle_x\":1,\"frames\":[{}{}]}}", "[".repeat(n), "]".repeat(n))),
        ("deep top", format!("{{\"x\":{}", "[".repeat(n))),
        ("one huge frame", format!("{{\"camera_angle_x\":1,\"frames\":[{{\"x\":[{}[]]}}]}}", "[],".repeat(n))),
        ("huge field", format!("{{\"camera_angle_x\":[{}0],\"frames\":[]}}", "0,".repeat(n))),
        ("list of names", format!("{{\"train_filenames\":[{}0],\"frames\":[]}}", "0,".repeat(n))),
        ("many keys", {
            let keys: Vec<String> = (0..n / 8).map(|k| format!("\"{k:x}\":[0]")).collect();
            format!("{{{},\"camera_angle_x\":1,\"frames\":[]}}", keys.join(","))
        }),
        ("long text", format!("{{\"camera_angle_x\":1,\"frames\":[{{\"file_path\":\"{}\"}}]}}", "x".repeat(n))),
        ("many small frames", {
            let frame = "{\"file_path\":\"a\",\"transform_matrix\":[[1,0,0,0],[0,1,0,0],[0,0,1,0]]}";
            format!("{{\"camera_angle_x\":1,\"frames\":[{}]}}", vec![frame; 20_000].join(","))
        }),
    ];
    for (what, text) in &bombs {
        put(&file, text.as_bytes());
        for (layout, name) in [("blender", "transforms_train.json"), ("nerfstudio", "transforms.json")] {
            put(&dir.path().join(name), text.as_bytes());
            let options = DataOptions { layout: Some(layout.into()), ..DataOptions::default() };
            let out = bounded(text.len(), what, || Dataset::open(dir.path(), &options).map(|_| ()));
            assert!(out.is_err(), "{what} as {layout}");
        }
    }
}

#[test]
fn scenes_by_camera_cannot_ask_for_memory() {
    let (dir, _) = scene();
    let n = 1_000_000;
    let keys = |entry: &str| (0..n / 8).map(|k| format!("\"{k:x}\":{entry},")).collect::<String>();
    let matrix = "[[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]";
    let camera = |frames: &str| format!("\"a\":{{\"transform_matrix\":{matrix},\"frames\":[{frames}]}}");
    let bombs = [
        ("many cameras", keys("0") + "\"z\":0"),
        ("empty cameras", keys("{}") + "\"z\":0"),
        ("deep", format!("\"a\":{}{}", "[".repeat(n), "]".repeat(n))),
        ("many frames", camera(&("{},".repeat(n) + "{}"))),
        ("one huge frame", camera(&format!("{{\"x\":[{}0]}}", "0,".repeat(n)))),
        ("huge matrix", format!("\"a\":{{\"transform_matrix\":[{}0],\"frames\":[]}}", "0,".repeat(n))),
        ("long text", camera(&format!("{{\"file_path\":\"{}\"}}", "x".repeat(n)))),
    ];
    for (what, data) in &bombs {
        let text = format!("{{\"camera_angle_x\":1,\"data\":{{{data}}}}}");
        put(&dir.path().join("transforms_train.json"), text.as_bytes());
        let options = DataOptions { layout: Some("nvfi".into()), ..DataOptions::default() };
        let e = bounded(text.len(), what, || Dataset::open(dir.path(), &options)).unwrap_err();
        assert!(["data.syntax", "data.field", "limits.file"].contains(&e.code()), "{what}: {} {e}", e.code());
        assert!(e.to_string().len() < 400, "{what}: {}", e.to_string().len());
    }
    let huge = format!("[time]\nboundary = 0.{}", "5".repeat(1 << 17));
    put(&dir.path().join("scene.toml"), huge.as_bytes());
    assert_eq!(bounded(huge.len(), "scene.toml", || open(dir.path())).unwrap_err().code(), "limits.file");
}

#[test]
fn lists_and_arrays_of_captures_cannot_ask_for_memory() {
    let dir = tempfile::tempdir().unwrap();
    std::fs::create_dir(dir.path().join("camera")).unwrap();
    let n = 1_000_000;
    let flat = format!("{{\"ids\":[{}0]}}", "0,".repeat(n));
    let keys = format!("{{{}\"z\":0}}", (0..n / 6).map(|k| format!("\"{k:x}\":0,")).collect::<String>());
    let small = String::from("{\"center\":[0,0,0],\"scale\":1,\"ids\":[\"a\"],\"train_ids\":[\"a\"]}");
    for (dataset, metadata) in [(&flat, &small), (&keys, &small), (&small, &flat), (&small, &keys)] {
        put(&dir.path().join("scene.json"), small.as_bytes());
        put(&dir.path().join("dataset.json"), dataset.as_bytes());
        put(&dir.path().join("metadata.json"), metadata.as_bytes());
        let bytes = dataset.len() + metadata.len();
        let e = bounded(bytes, "capture", || open(dir.path())).unwrap_err();
        assert!(["data.field", "data.layout", "data.empty"].contains(&e.code()), "{e}");
    }
    for shape in ["(99999999, 17)", "(0, 17)", "(17,)", "()", "(18446744073709551615, 17)", "(1, 17, 9)"] {
        let mut dict = format!("{{'descr': '<f8', 'fortran_order': False, 'shape': {shape}, }}");
        dict.extend(std::iter::repeat_n(' ', 118 - dict.len()));
        let poses = [&b"\x93NUMPY\x01\x00\x76\x00"[..], dict.as_bytes(), &[0; 136]].concat();
        std::fs::remove_file(dir.path().join("dataset.json")).ok();
        put(&dir.path().join("poses_bounds.npy"), &poses);
        let e = bounded(poses.len(), "poses", || open(dir.path())).unwrap_err();
        assert!(["data.syntax", "data.field"].contains(&e.code()), "{shape}: {} {e}", e.code());
    }
}

/// The three files of a small binary model: one camera, one image, two points.
fn model() -> [(&'static str, Vec<u8>); 3] {
    let mut cameras = [1u64.to_le_bytes(), (1u64 | 1 << 32).to_le_bytes(), 12u64.to_le_bytes()].concat();
    cameras.extend(12u64.to_le_bytes());
    cameras.extend([10.0f64, 10.0, 6.0, 6.0].map(f64::to_le_bytes).concat());
    let mut images = 1u64.to_le_bytes().to_vec();
    images.extend(1u32.to_le_bytes());
    images.extend([1.0f64, 0.0, 0.0, 0.0, 0.0, 0.0, 4.0].map(f64::to_le_bytes).concat());
    images.extend(1u32.to_le_bytes());
    images.extend(b"r_000.png\0");
    images.extend(1u64.to_le_bytes());
    images.extend([0u8; 24]);
    let mut points = 2u64.to_le_bytes().to_vec();
    for _ in 0..2 {
        points.extend([0u8; 8 + 24 + 3 + 8]);
        points.extend(1u64.to_le_bytes());
        points.extend([0u8; 8]);
    }
    [("cameras.bin", cameras), ("images.bin", images), ("points3D.bin", points)]
}

fn write_model(dir: &Path, files: &[(&str, Vec<u8>)]) -> usize {
    std::fs::create_dir_all(dir.join("sparse/0")).unwrap();
    files.iter().for_each(|(name, bytes)| put(&dir.join("sparse/0").join(name), bytes));
    files.iter().map(|(_, b)| b.len()).sum()
}

fn open_model(dir: &Path) -> Result<Dataset, DataError> {
    let o = DataOptions { layout: Some("colmap".into()), images: Some("train".into()), ..DataOptions::default() };
    Dataset::open(dir, &o)
}

#[test]
fn colmap_cut_anywhere_or_with_huge_counts_is_an_error() {
    let (dir, _) = scene();
    write_model(dir.path(), &model());
    assert_eq!(open_model(dir.path()).unwrap().train.len(), 1, "undamaged it opens");
    for k in 0..3 {
        let whole = model();
        for cut in 0..whole[k].1.len() {
            let mut files = model();
            files[k].1.truncate(cut);
            let bytes = write_model(dir.path(), &files);
            let e = bounded(bytes, "cut model", || open_model(dir.path())).unwrap_err();
            assert_eq!(e.code(), "data.truncated", "{} cut at {cut}: {e}", files[k].0);
            assert!(e.to_string().contains("byte "), "{e}");
        }
        for count in [1u64 << 63, u64::MAX, (1 << 32) - 1, 1 << 31, 3] {
            let mut files = model();
            files[k].1[..8].copy_from_slice(&count.to_le_bytes());
            let bytes = write_model(dir.path(), &files);
            let e = bounded(bytes, "huge count", || open_model(dir.path())).unwrap_err();
            assert_eq!(e.code(), "data.truncated", "{e}");
        }
        let mut files = model();
        files[k].1.push(0);
        write_model(dir.path(), &files);
        assert!(open_model(dir.path()).unwrap_err().to_string().contains("1 bytes too many"));
    }
}

#[test]
fn mutated_colmap_gives_data_or_an_error() {
    let (dir, _) = scene();
    let (mut good, mut bad) = (0, 0);
    for k in 0..3000 {
        let mut files = model();
        let which = k as usize % 3;
        files[which].1 = mutate(&files[which].1, &mut Rng::new(2, "mutate.colmap", 0, k));
        let bytes = write_model(dir.path(), &files);
        match bounded(bytes, "mutated model", || open_model(dir.path())) {
            Ok(d) => {
                good += 1;
                assert!(d.train.iter().all(|v| v.camera.check().is_ok()));
                assert!(d.points.iter().flat_map(|p| &p.positions).all(|p| p.is_finite()));
            }
            Err(_) => bad += 1,
        }
    }
    assert!(good > 50 && bad > 500, "both happen: {good} good, {bad} bad");
}

#[test]
fn names_in_binary_models_must_be_text_and_stay_inside() {
    let (dir, _) = scene();
    for (name, code) in
        [(&b"../../x.p\0"[..], "data.escape"), (b"r_\xff0.png\0", "data.syntax"), (b"/etc/pass\0", "data.missing")]
    {
        let mut files = model();
        let at = files[1].1.windows(10).position(|w| w == b"r_000.png\0").unwrap();
        files[1].1.splice(at..at + 10, name.iter().copied());
        write_model(dir.path(), &files);
        let e = open_model(dir.path()).unwrap_err();
        assert_eq!(e.code(), code, "an absolute name below the image folder is a missing file, no other: {e}");
    }
}

/// A PNG that is valid but all zero: small on disk, large in memory.
fn blank_png(side: u32) -> Vec<u8> {
    let mut bytes = Vec::new();
    let encoder = image::codecs::png::PngEncoder::new(&mut bytes);
    let pixels = vec![0u8; side as usize * side as usize];
    image::ImageEncoder::write_image(encoder, &pixels, side, side, image::ExtendedColorType::L8).unwrap();
    bytes
}

#[test]
fn image_bombs_are_refused_before_they_are_unpacked() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("bomb.png");
    let bomb = blank_png(8000);
    put(&file, &bomb);
    let e = bounded(bomb.len(), "8000x8000", || decode(&file, None)).unwrap_err();
    assert_eq!((e.code(), e.exit_code()), ("limits.file", 5));
    for (width, height) in [(30_000u32, 30_000u32), (u32::MAX, 1), (65_535, 65_535), (0, 5), (1 << 31, 1 << 31)] {
        let mut lie = blank_png(4);
        lie[16..20].copy_from_slice(&width.to_be_bytes());
        lie[20..24].copy_from_slice(&height.to_be_bytes());
        put(&file, &lie);
        let e = bounded(lie.len(), "lying header", || decode(&file, None)).unwrap_err();
        assert!(["limits.file", "data.image"].contains(&e.code()), "{e}");
    }
    let large = blank_png(3000);
    put(&file, &large);
    assert_eq!(bounded(large.len(), "3000x3000", || decode(&file, None)).unwrap().width, 3000, "ordinary sizes open");
    // A JPEG whose frame header claims 65535×65535.
    let mut jpeg = Vec::new();
    image::codecs::jpeg::JpegEncoder::new(&mut jpeg).encode(&[0; 64], 8, 8, image::ExtendedColorType::L8).unwrap();
    let at = jpeg.windows(2).position(|w| w == [0xff, 0xc0]).unwrap();
    jpeg[at + 5..at + 9].fill(0xff);
    put(&file, &jpeg);
    let e = bounded(jpeg.len(), "jpeg", || decode(&file, None)).unwrap_err();
    assert_eq!(e.code(), "limits.file", "{e}");
}

#[test]
fn mutated_images_decode_or_fail_with_a_word() {
    let dir = tempfile::tempdir().unwrap();
    let pixels: Vec<u8> = (0..24 * 16 * 3).map(|k| (k * 7 % 251) as u8).collect();
    let (mut png, mut jpeg) = (Vec::new(), Vec::new());
    let encoder = image::codecs::png::PngEncoder::new(&mut png);
    image::ImageEncoder::write_image(encoder, &pixels, 24, 16, image::ExtendedColorType::Rgb8).unwrap();
    image::codecs::jpeg::JpegEncoder::new(&mut jpeg).encode(&pixels, 24, 16, image::ExtendedColorType::Rgb8).unwrap();
    let file = dir.path().join("image");
    let mut decoded = [0, 0];
    for (kind, bytes) in [&png, &jpeg].into_iter().enumerate() {
        for k in 0..1500 {
            let mut damaged = mutate(bytes, &mut Rng::new(3, "mutate.image", kind as u32, k));
            if k % 3 == 0 {
                damaged = bytes[..k as usize % bytes.len()].to_vec();
            }
            put(&file, &damaged);
            if let Ok(im) = bounded(damaged.len(), "mutated image", || decode(&file, None)) {
                decoded[kind] += 1;
                assert_eq!(im.data.len(), im.width * im.height * 4);
            }
        }
    }
    assert!(decoded[1] > 0, "damaged JPEGs often still decode: {decoded:?}");
}

#[test]
fn a_bomb_behind_a_view_is_an_error_of_the_cache() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("bomb.png");
    let bomb = blank_png(8000);
    put(&file, &bomb);
    let camera = Camera::look_at(8000, 8000, 0.7, glam::DVec3::X, glam::DVec3::ZERO, glam::DVec3::Z).unwrap();
    let view = View::new("bomb", camera, Time::default(), ImageSource::File(file), 0);
    let e = bounded(bomb.len(), "bomb in a view", || ImageCache::new(1 << 30, 0.5).get(&view)).unwrap_err();
    assert_eq!(e.code(), "limits.file");
    let allowed = ImageCache::new(1 << 30, 0.1).with_max_image_mib(Some(512));
    assert_eq!(allowed.get(&view).unwrap().width, 800, "on request it opens");
}
