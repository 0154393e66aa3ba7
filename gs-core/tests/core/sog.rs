//! SOG scenes: `golden/cloud.sog` was written by splat-transform 2.7.1 from a cloud of 60 splats of degree 2, `golden/cloud.ply` is what
//! it reads back.
use gs_core::io::{IoError, Limits, RawSplats, load_splats, parse_splats, sog, zip};
use std::path::{Path, PathBuf};

fn golden(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden").join(name)
}

fn bytes() -> Vec<u8> {
    std::fs::read(golden("cloud.sog")).unwrap()
}

const MEMBERS: [&str; 8] = [
    "meta.json",
    "means_l.webp",
    "means_u.webp",
    "quats.webp",
    "scales.webp",
    "sh0.webp",
    "shN_centroids.webp",
    "shN_labels.webp",
];

/// The members in a folder, some of them changed.
fn unpacked(change: impl Fn(&str, Vec<u8>) -> Option<Vec<u8>>) -> (tempfile::TempDir, PathBuf) {
    let (dir, all) = (tempfile::tempdir().unwrap(), bytes());
    for name in MEMBERS {
        let member = zip::member(&all, "cloud.sog", name, &Limits::default()).unwrap();
        if let Some(member) = change(name, member) {
            std::fs::write(dir.path().join(name), member).unwrap();
        }
    }
    let meta = dir.path().join("meta.json");
    (dir, meta)
}

fn worst<'a>(a: impl IntoIterator<Item = &'a f32>, b: impl IntoIterator<Item = &'a f32>) -> f32 {
    a.into_iter().zip(b).map(|(a, b)| (a - b).abs() / (1.0 + b.abs())).fold(0.0, f32::max)
}

#[test]
fn the_archive_and_its_folder_are_read_as_their_writer_reads_them() {
    let want = load_splats(&golden("cloud.ply"), &Limits::default()).unwrap();
    let (header, got) = sog::read(&bytes(), "cloud.sog", &Limits::default()).unwrap();
    assert_eq!((header.count, header.degree, header.antialiased), (60, 2, false));
    assert_eq!((got.len(), got.degree), (60, 2));
    let flat = |v: &[glam::Vec3]| v.iter().flat_map(|v| v.to_array()).collect::<Vec<f32>>();
    assert!(worst(&flat(&got.means), &flat(&want.means)) < 1e-6);
    assert_eq!((&got.log_scales, &got.sh), (&want.log_scales, &want.sh));
    assert!(worst(got.quats.as_flattened(), want.quats.as_flattened()) < 1e-6);
    assert!(worst(&got.logit_opacities, &want.logit_opacities) < 1e-4);
    // By content, whatever the name; and from a folder.
    assert_eq!(parse_splats(&bytes(), "scene.zip", &Limits::default()).unwrap(), got);
    let (_dir, meta) = unpacked(|_, member| Some(member));
    assert_eq!(load_splats(&meta, &Limits::default()).unwrap(), got);
}

#[test]
fn both_words_for_antialiased_are_read() {
    for (words, want) in [
        ("\"antialias\":true", true),
        ("\"model\":\"antialiased\"", true),
        ("\"antialias\":false,\"model\":\"default\"", false),
    ] {
        let (_dir, meta) = unpacked(|name, member| match name {
            "meta.json" => {
                let text = String::from_utf8(member).unwrap();
                Some(text.replacen("\"version\":2", &format!("\"version\":2,{words}"), 1).into_bytes())
            }
            _ => Some(member),
        });
        let (header, splats) = sog::load(&meta, &Limits::default()).unwrap();
        assert_eq!((header.antialiased, splats.antialiased), (want, want), "{words}");
    }
}

#[test]
fn faults_are_named() {
    type Change<'a> = &'a dyn Fn(&str, Vec<u8>) -> Option<Vec<u8>>;
    let error = |change: Change<'_>| {
        let (_dir, meta) = unpacked(change);
        load_splats(&meta, &Limits::default()).unwrap_err().to_string()
    };
    let edited = |from: &str, to: &str| {
        error(&|name, member| {
            let text = || String::from_utf8(member.clone()).unwrap();
            assert!(name != "meta.json" || text().contains(from), "{from}");
            Some(if name == "meta.json" { text().replacen(from, to, 1).into_bytes() } else { member })
        })
    };
    assert!(edited("\"version\":2,", "").contains("SOG version 1 is not supported"));
    assert!(edited("\"version\":2", "\"version\":3").contains("SOG version 3"));
    assert!(edited("\"count\":60", "\"count\":100000").contains("means_l.webp has"));
    // Images without detail have millions of pixels in few bytes.
    assert!(edited("\"count\":60", "\"count\":1000000").contains("`max_expansion`"));
    assert!(edited("\"means_l.webp\"", "\"../means_l.webp\"").contains("not one beside it"));
    assert!(edited("\"bands\":2", "\"bands\":1").contains("pixels wide, not 192"));
    assert!(edited("\"bands\":2", "\"bands\":4").contains("4 bands"));
    assert!(edited("\"sh0\":", "\"sh9\":").contains("meta.json: sh0"));
    let palette = edited("\"shN\":{\"count\":", "\"shN\":{\"count\":0,\"was\":");
    assert!(palette.contains("row of the palette"), "{palette}");
    let missing = error(&|name, member| (name != "quats.webp").then_some(member));
    assert!(missing.contains("quats.webp") && missing.contains("cannot open"), "{missing}");
    // The colours have an alpha below 252.
    let sh0 = zip::member(&bytes(), "cloud.sog", "sh0.webp", &Limits::default()).unwrap();
    let modes = error(&|name, member| Some(if name == "quats.webp" { sh0.clone() } else { member }));
    assert!(modes.contains("`quats`") && modes.contains("252"), "{modes}");
    let small = edited("\"sh0\":{\"codebook\":[", "\"sh0\":{\"codebook\":[0],\"was\":[");
    assert!(small.contains("row of the codebook"), "{small}");
    let tight = Limits { max_rows: 59, ..Limits::default() };
    assert!(matches!(parse_splats(&bytes(), "a", &tight), Err(IoError::Limit { .. })));
}

#[test]
fn damaged_archives_are_errors_or_the_same_splats() {
    let (whole, limits) = (bytes(), Limits::default());
    let want = parse_splats(&whole, "a.sog", &limits).unwrap();
    let same = |read: Result<RawSplats, IoError>| read.map_or(true, |got| got == want);
    for cut in (0..whole.len()).step_by(97) {
        assert!(parse_splats(&whole[..cut], "a.sog", &limits).is_err(), "cut at {cut}");
    }
    for at in (0..whole.len()).step_by(31) {
        let mut bytes = whole.clone();
        bytes[at] ^= 0x55;
        // The checksums of the archive find changed contents.
        assert!(same(parse_splats(&bytes, "a.sog", &limits)), "byte {at}");
    }
}
