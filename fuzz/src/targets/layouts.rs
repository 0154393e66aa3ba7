//! Data folders: the files that state cameras, times and points; images and masks.

use super::folders::{self, open};
use super::{Error, Target, as_it_is, images, written};
use crate::case::Case;
use flate2::Compression;
use flate2::write::DeflateEncoder;
use gs_core::Rng;
use gs_core::io::npy;
use gs_data::ImageCache;
use gs_synth::{SynthOptions, write, write_nerfies};
use std::io::Write;
use std::path::Path;

/// The array of an archive as a file of its own, so that mutation keeps the archive right.
const ARRAY: &str = "data.npy";
const ARCHIVE: &str = "init_pt_cld.npz";

pub fn targets() -> Vec<Target> {
    let one = |name, share, seeds, run| Target { name, share, seeds, repair: as_it_is, run };
    vec![
        one("blender", 3, blender, |c, d| open(c, d, "blender").map(drop)),
        one("nvfi", 3, folders::nvfi, |c, d| open(c, d, "nvfi").map(drop)),
        one("nerfstudio", 2, folders::nerfstudio, |c, d| open(c, d, "nerfstudio").map(drop)),
        one("colmapbin", 2, folders::colmap_binary, |c, d| open(c, d, "colmap").map(drop)),
        one("colmaptxt", 2, folders::colmap_text, |c, d| open(c, d, "colmap").map(drop)),
        one("llff", 2, folders::llff, |c, d| open(c, d, "llff").map(drop)),
        one("panoptic", 2, folders::panoptic, |c, d| open(c, d, "panoptic").map(drop)),
        Target { name: "npz", share: 6, seeds: npz, repair: repair_zip, run: open_npz },
        one("hypernerf", 3, hypernerf, |c, d| open(c, d, "hypernerf").map(drop)),
        Target {
            name: "images",
            share: 5,
            seeds: folders::images_and_masks,
            repair: images::repair_png,
            run: open_images,
        },
    ]
}

fn blender(dir: &Path) -> Result<Vec<Case>, Error> {
    write(dir, "balls", &SynthOptions::of_views(8, 3, 2), true)?;
    let scene = "[time]\nboundary = 0.75\n[start]\npoints = \"start.ply\"\nbounds = [[-1, -1, -1], [1, 1, 1]]\n";
    let points = "ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\nend_header\n0 1 2\n";
    let case = Case::of_folder(dir, &["transforms_train.json", "transforms_test.json"])?;
    Ok(vec![case.with("scene.toml", scene).with("start.ply", points)])
}

fn hypernerf(dir: &Path) -> Result<Vec<Case>, Error> {
    write_nerfies(dir, "balls", &SynthOptions::of_views(8, 3, 2), true)?;
    let points = written(|out| npy::write(&[2, 3], &[1.0, 2.0, 3.0, 4.0, 5.0, 6.0], out))?;
    let case = Case::of_folder(dir, &["dataset.json", "metadata.json", "scene.json", "camera/train_001.json"])?;
    Ok(vec![case.with("points.npy", points)])
}

/// An archive, and an array to be put into one.
fn npz(dir: &Path) -> Result<Vec<Case>, Error> {
    folders::panoptic(dir)?.iter().try_for_each(|case| case.write(dir))?;
    let array = written(|out| npy::write(&[2, 7], &[0.5; 14], out))?;
    let archive = |deflated| zip(&array, deflated).map(|bytes| Case::one(ARCHIVE, bytes));
    Ok(vec![Case::one(ARRAY, array.clone()), archive(true)?, archive(false)?])
}

/// A ZIP archive with one member.
fn zip(array: &[u8], deflated: bool) -> std::io::Result<Vec<u8>> {
    let packed = match deflated {
        true => {
            let mut deflate = DeflateEncoder::new(Vec::new(), Compression::fast());
            deflate.write_all(array)?;
            deflate.finish()?
        }
        false => array.to_vec(),
    };
    let words = |values: &[u16]| values.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>();
    let longs = |values: &[u32]| values.iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<u8>>();
    let name = ARRAY.as_bytes();
    let sizes = longs(&[crc32fast::hash(array), packed.len() as u32, array.len() as u32]);
    let shared = [words(&[0, u16::from(deflated) * 8, 0, 0]), sizes, words(&[name.len() as u16, 0])].concat();
    let local = [b"PK\x03\x04", &words(&[20])[..], &shared, name, &packed].concat();
    let central = [b"PK\x01\x02", &words(&[20, 20])[..], &shared, &[0; 14], name].concat();
    let end = [words(&[0, 0, 1, 1]), longs(&[central.len() as u32, local.len() as u32]), words(&[0])].concat();
    Ok([&local[..], &central, b"PK\x05\x06", &end].concat())
}

/// Puts the checksum of a stored member into the list of an archive; a deflated one stays as it is.
fn repair_zip(case: &mut Case, _: &mut Rng) {
    let Some(file) = case.0.first_mut().filter(|f| f.name == ARCHIVE) else { return };
    let Some(list) = file.bytes.windows(4).rposition(|w| w == b"PK\x01\x02") else { return };
    let start = 30 + ARRAY.len();
    let Some(crc) = file.bytes.get(start..list).map(crc32fast::hash) else { return };
    if let Some(slot) = file.bytes.get_mut(list + 16..list + 20) {
        slot.copy_from_slice(&crc.to_le_bytes());
    }
}

fn open_npz(case: &Case, dir: &Path) -> Result<(), String> {
    let case = match case.get(ARRAY) {
        Some(array) => &Case::one(ARCHIVE, zip(array, true).map_err(|e| e.to_string())?),
        None => case,
    };
    let data = open(case, dir, "panoptic")?;
    assert!(data.points.is_some(), "the points of the archive");
    Ok(())
}

fn open_images(case: &Case, dir: &Path) -> Result<(), String> {
    let data = open(case, dir, "nerfstudio")?;
    let cache = ImageCache::new(0, 1.0);
    for view in data.train.iter().chain(&data.test) {
        let image = cache.get(view).map_err(|e| e.to_string())?;
        assert_eq!(image.data.len(), image.width * image.height * 4);
        cache.mask(view).map_err(|e| e.to_string())?;
    }
    Ok(())
}
