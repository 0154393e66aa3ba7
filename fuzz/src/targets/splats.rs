//! Splats, cameras and arrays in one file.

use super::{Error, Target, as_it_is, written};
use crate::case::Case;
use flate2::Compression;
use flate2::read::GzDecoder;
use flate2::write::GzEncoder;
use glam::{DVec3, Vec3};
use gs_core::io::glb::{self, RigidMotion, RigidPart};
use gs_core::io::{
    Limits, NamedCamera, RawSplats, SplatFormat, cameras, load_splats, npy, parse_cameras, parse_splats, ply, spz,
    write_splats, zip,
};
use gs_core::{Camera, Color, Kernel, Rng, Splats};
use std::io::{Read, Write};
use std::path::Path;

pub fn targets() -> Vec<Target> {
    let one = |name, share, seeds, run| Target { name, share, seeds, repair: as_it_is, run };
    vec![
        one("ply", 1, ply_seeds, |c, _| splats(c.first(), "a.ply")),
        one("plycols", 1, column_seeds, |c, _| columns(c.first())),
        one("splat", 1, |_| Ok(vec![file(SplatFormat::Splat, 0)?]), |c, _| splats(c.first(), "a.splat")),
        one("spz", 2, spz_payloads, |c, _| splats(&gzip(c.first()), "a.spz")),
        one("spzraw", 1, spz_files, |c, _| splats(c.first(), "a.spz")),
        one("glb", 1, glb_seeds, |c, _| splats(&glb_of(c), "a.glb")),
        one("sog", 2, sog_seeds, read_sog),
        one("cameras", 1, camera_seeds, |c, _| read_cameras(c.first())),
        one("npy", 1, npy_seeds, |c, _| read_npy(c.first())),
    ]
}

/// A few random splats.
fn some(n: u64, degree: u8) -> Result<RawSplats, Error> {
    let mut rng = Rng::new(1, "seeds", n as u32, u64::from(degree));
    let mut values = |n: u64| (0..n).map(|_| rng.range(0.1, 0.9)).collect::<Vec<f32>>();
    let vectors = |values: Vec<f32>| values.as_chunks().0.iter().map(|v| Vec3::from_array(*v)).collect();
    let width = 3 * (u64::from(degree) + 1).pow(2);
    let splats = Splats {
        means: vectors(values(3 * n)),
        quats: values(4 * n).as_chunks().0.to_vec(),
        scales: vectors(values(3 * n)),
        opacities: values(n),
        color: Color::Sh { degree, coeffs: values(n * width) },
        kernel: Kernel::Gaussian,
    };
    Ok(RawSplats::from_splats(&splats)?)
}

fn file(format: SplatFormat, degree: u8) -> Result<Case, Error> {
    let splats = some(4, degree)?;
    Ok(Case::one("a", written(|out| write_splats(format, &splats, out))?))
}

fn ply_seeds(_: &Path) -> Result<Vec<Case>, Error> {
    let (small, large) = (file(SplatFormat::Ply, 0)?, file(SplatFormat::Ply, 2)?);
    Ok(vec![Case::one("a", ascii(small.first())), small, large])
}

/// Columns that are no splats, then the splats.
fn column_seeds(dir: &Path) -> Result<Vec<Case>, Error> {
    let text = "ply\nformat ascii 1.0\ncomment x\nelement vertex 2\nproperty float x\nproperty float y\n\
        property float z\nproperty uchar red\nproperty uchar green\nproperty uchar blue\nelement face 1\n\
        property list uchar int vertex_indices\nend_header\n0 1 2 3 4 5\n1 2 3 4 5 6\n3 0 1 1\n";
    let mut seeds = ply_seeds(dir)?;
    seeds.push(Case::one("a", text));
    Ok(seeds)
}

/// The same PLY with its rows as text.
fn ascii(bytes: &[u8]) -> Vec<u8> {
    let mark = b"end_header\n";
    let end = bytes.windows(mark.len()).position(|w| w == mark).map_or(0, |at| at + mark.len());
    let head = String::from_utf8_lossy(&bytes[..end]).replace("binary_little_endian", "ascii");
    let width = head.matches("property").count();
    let values: Vec<String> = bytes[end..].as_chunks().0.iter().map(|b| f32::from_le_bytes(*b).to_string()).collect();
    let rows = values.chunks(width).map(|row| row.join(" ") + "\n");
    (head + &rows.collect::<String>()).into_bytes()
}

fn splats(bytes: &[u8], name: &str) -> Result<(), String> {
    whole(parse_splats(bytes, name, &Limits::default()).map_err(|e| e.to_string())?)
}

/// What every reader of splats promises.
fn whole(raw: RawSplats) -> Result<(), String> {
    raw.check_shape().expect("columns of one length");
    assert!(raw.non_finite_rows().is_empty(), "a value that is not finite");
    Ok(())
}

fn columns(bytes: &[u8]) -> Result<(), String> {
    let names = ply::property_names(bytes, "a.ply").map_err(|e| e.to_string())?;
    let names: Vec<&str> = names.iter().map(String::as_str).collect();
    let all = ply::read_columns(bytes, "a.ply", &Limits::default(), &names).map_err(|e| e.to_string())?;
    assert!(all.iter().all(|v| v.is_finite()), "a value that is not finite");
    Ok(())
}

fn spz_files(_: &Path) -> Result<Vec<Case>, Error> {
    let of = |version, degree| {
        let options = spz::SpzOptions { version, ..spz::SpzOptions::default() };
        let splats = some(4, degree)?;
        Ok(Case::one("a", written(|out| spz::write(&splats, &options, out))?))
    };
    [(spz::Version::V2, 1), (spz::Version::V3, 3)].into_iter().map(|(v, d)| of(v, d)).collect()
}

/// What is inside the gzip streams.
fn spz_payloads(dir: &Path) -> Result<Vec<Case>, Error> {
    let inflated = |case: Case| {
        let mut out = Vec::new();
        GzDecoder::new(case.first()).read_to_end(&mut out)?;
        Ok(Case::one("a", out))
    };
    spz_files(dir)?.into_iter().map(inflated).collect()
}

fn gzip(payload: &[u8]) -> Vec<u8> {
    let mut gz = GzEncoder::new(Vec::new(), Compression::fast());
    gz.write_all(payload).and_then(|()| gz.finish()).expect("memory takes every byte")
}

fn glb_seeds(_: &Path) -> Result<Vec<Case>, Error> {
    let whole = file(SplatFormat::Glb, 1)?;
    let motion = RigidMotion {
        times: vec![0.0, 1.0],
        translations: vec![Vec3::ZERO, Vec3::X],
        rotations: vec![[1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0]],
    };
    let parts = [RigidPart { splats: some(4, 0)?, motion }, RigidPart { splats: some(3, 1)?, ..RigidPart::default() }];
    let moving = written(|out| glb::write_parts(&parts, out))?;
    let split = |glb: &[u8]| glb_parts(glb).ok_or("two chunks were written");
    Ok(vec![split(whole.first())?, split(&moving)?, whole])
}

/// JSON and binary chunk of a GLB as files of their own, so that mutation keeps the lengths right.
fn glb_parts(glb: &[u8]) -> Option<Case> {
    let (length, rest) = glb.get(12..)?.split_first_chunk()?;
    let (json, bin) = rest.get(4..)?.split_at_checked(u32::from_le_bytes(*length) as usize)?;
    Some(Case::one("json", json).with("bin", bin.get(8..)?))
}

/// The GLB of its parts, or the file as it is.
pub fn glb_of(case: &Case) -> Vec<u8> {
    let (Some(json), Some(bin)) = (case.get("json"), case.get("bin")) else { return case.first().to_vec() };
    let mut chunks = Vec::new();
    for (bytes, kind, padding) in [(json, b"JSON", b' '), (bin, b"BIN\0", 0)] {
        let padded = bytes.len().next_multiple_of(4);
        chunks.extend((padded as u32).to_le_bytes());
        chunks.extend(kind);
        chunks.extend(bytes);
        chunks.resize(chunks.len() + padded - bytes.len(), padding);
    }
    [b"glTF\x02\0\0\0", &(12 + chunks.len() as u32).to_le_bytes()[..], &chunks].concat()
}

/// A scene as the tests of gs-core have it: its description and some of its images are mutated, the others lie beside them.
fn sog_seeds(dir: &Path) -> Result<Vec<Case>, Error> {
    let archive = include_bytes!("../../../gs-core/tests/golden/cloud.sog");
    let member = |name: &str| zip::member(archive, "cloud.sog", name, &Limits::default());
    for name in ["means_l.webp", "means_u.webp", "scales.webp", "sh0.webp", "shN_labels.webp"] {
        std::fs::write(dir.join(name), member(name)?)?;
    }
    let names = ["meta.json", "quats.webp", "shN_centroids.webp"];
    let case = names.iter().try_fold(Case::default(), |case, name| Ok::<_, Error>(case.with(name, member(name)?)));
    Ok(vec![case?])
}

fn read_sog(case: &Case, dir: &Path) -> Result<(), String> {
    case.write(dir).map_err(|e| e.to_string())?;
    whole(load_splats(&dir.join("meta.json"), &Limits::default()).map_err(|e| e.to_string())?)
}

fn camera_seeds(_: &Path) -> Result<Vec<Case>, Error> {
    let camera = Camera::look_at(64, 48, 0.7, DVec3::new(1.0, -2.0, 0.5), DVec3::ZERO, DVec3::Z)?;
    let named = |name: &str, time| NamedCamera { name: name.into(), camera: camera.clone(), time };
    let own = written(|out| cameras::write_cameras(&[named("a", None), named("b", Some(0.5))], out))?;
    let blender = r#"{"camera_angle_x":0.69,"w":8,"h":4,"frames":[{"file_path":"./r_0","rotation":0.1,"time":0.5,
        "transform_matrix":[[1,0,0,1],[0,1,0,2],[0,0,1,3],[0,0,0,1]]},{"transform_matrix":[[1,0,0,1],[0,1,0,2],[0,0,1,3]]}]}"#;
    let inria = r#"[{"id":0,"img_name":"a","fx":9,"fy":8,"width":16,"height":12,"position":[0,1,2],
        "rotation":[[1,0,0],[0,1,0],[0,0,1]]}]"#;
    Ok(vec![Case::one("a", own), Case::one("a", blender), Case::one("a", inria)])
}

fn read_cameras(bytes: &[u8]) -> Result<(), String> {
    for c in parse_cameras(bytes, "c.json", &Limits::default()).map_err(|e| e.to_string())? {
        c.camera.check().expect("a valid camera");
        assert!(c.time.is_none_or(f32::is_finite), "{:?}", c.time);
    }
    Ok(())
}

fn npy_seeds(_: &Path) -> Result<Vec<Case>, Error> {
    let of = |shape: &[usize], values: &[f32]| {
        Ok::<_, Error>(Case::one("a", written(|out| npy::write(shape, values, out))?))
    };
    Ok(vec![of(&[2, 3], &[1.0, 2.0, 3.0, 4.0, 5.0, 6.0])?, of(&[], &[1.0])?, of(&[0, 7], &[])?])
}

fn read_npy(bytes: &[u8]) -> Result<(), String> {
    let array = npy::read(bytes, "a.npy", &Limits::default()).map_err(|e| e.to_string())?;
    assert_eq!(array.shape.iter().product::<usize>(), array.to_f32().len());
    assert!(array.to_f64().iter().all(|v| v.is_finite()), "a value that is not finite");
    Ok(())
}
