//! Binary glTF with the extension `KHR_gaussian_splatting`: plain Gaussians as a point primitive, exact in `f32`.
//!
//! The extension stores activated values: linear scales, opacities in `[0, 1]`, unit quaternions `(x, y, z, w)`; SH
//! coefficients are one attribute each, with the signs of [`crate::sh`]. glTF's axes are left, up, front: x and y of `.ply`
//! files change sign on the way in and out. `COLOR_0` holds degree 0 in linear light, for viewers that render points.
//!
//! A scene of rigid parts in motion ([`write_parts`]) has a node for each, and one animation of their translations and rotations,
//! linear between key frames.
//!
//! Readers take every primitive with the extension, from the file's own binary chunk, attributes `f32`, under the transforms of its
//! nodes: rotations, translations and equal scales, at rest or moved by the first animation ([`GlbScene::at`]). [`read()`] gives the
//! scene at the beginning. Other glTF features need a glTF library.

pub use super::glb_read::{read, read_scene};
pub use super::glb_scene::GlbScene;
pub use super::glb_write::{write, write_parts};

use super::RawSplats;
use glam::Vec3;

pub(super) const MAGIC: &[u8; 4] = b"glTF";
pub(super) const JSON_CHUNK: u32 = 0x4E4F_534A;
pub(super) const BINARY_CHUNK: u32 = 0x004E_4942;
pub(super) const EXTENSION: &str = "KHR_gaussian_splatting";
/// Display-encoded colours, which splats are blended in.
pub(super) const COLOR_SPACE: &str = "srgb_rec709_display";
/// Axes whose signs differ between `.ply` and glTF.
pub(super) const FLIPPED: [bool; 3] = [true, true, false];
/// glTF's component type of `f32`.
pub(super) const FLOAT: u64 = 5126;

/// Name of an attribute of the extension.
pub(super) fn own(name: &str) -> String {
    format!("{EXTENSION}:{name}")
}

/// Names of the SH attributes of a degree, in the order of [`RawSplats::sh`].
pub(super) fn sh_names(degree: u8) -> impl Iterator<Item = String> {
    (0..=degree).flat_map(|l| (0..=2 * l).map(move |k| own(&format!("SH_DEGREE_{l}_COEF_{k}"))))
}

/// Splats that move as one rigid body.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RigidPart {
    /// The splats before the motion, in the axes of `.ply` files.
    pub splats: RawSplats,
    /// How they move.
    pub motion: RigidMotion,
}

/// Key frames of a rigid motion `p ↦ R p + t`, in the axes of `.ply` files; without any it rests.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct RigidMotion {
    /// Times, seconds from 0 on, ascending.
    pub times: Vec<f32>,
    /// `t` at each, world units.
    pub translations: Vec<Vec3>,
    /// `R` at each, unit quaternions `(w, x, y, z)`, neighbours on the same half of the sphere.
    pub rotations: Vec<[f32; 4]>,
}

#[cfg(test)]
mod tests {
    use super::super::error::Source;
    use super::super::glb_read::chunks;
    use super::super::raw::tests::cloud;
    use super::super::{IoError, Limits, sigmoid};
    use super::*;
    use crate::rng::Rng;
    use crate::rot;
    use serde_json::{Value, json};

    fn encode(splats: &RawSplats) -> Vec<u8> {
        let mut out = Vec::new();
        write(splats, &mut out).unwrap();
        out
    }

    fn read_all(bytes: &[u8]) -> Result<RawSplats, IoError> {
        read(bytes, "t.glb", &Limits::default())
    }

    #[test]
    fn writing_and_reading_round_trips() {
        for degree in 0..=3 {
            let raw = cloud(40, degree, 5);
            let again = read_all(&encode(&raw)).unwrap();
            assert_eq!((&again.means, &again.sh, again.degree), (&raw.means, &raw.sh, degree));
            for (a, b) in again.log_scales.iter().zip(&raw.log_scales) {
                assert!((*a - *b).abs().max_element() < 2e-6);
            }
            for (a, b) in again.quats.iter().zip(&raw.quats) {
                let unit = rot::normalise(*b).wxyz;
                assert!(a.iter().zip(unit).all(|(a, b)| (a - b).abs() < 1e-6));
            }
            for (a, b) in again.logit_opacities.iter().zip(&raw.logit_opacities) {
                assert!((sigmoid(*a) - sigmoid(*b)).abs() < 1e-6);
            }
        }
    }

    /// The matrix of a unit quaternion, by rows.
    fn turn(q: [f32; 4]) -> crate::rot::Mat3<f64> {
        rot::matrix(q.map(f64::from))
    }

    #[test]
    fn parts_move_between_their_key_frames() {
        let half = std::f32::consts::FRAC_1_SQRT_2;
        let motion = RigidMotion {
            times: vec![0.5, 1.5, 2.0],
            translations: vec![Vec3::ZERO, Vec3::new(1.0, -2.0, 3.0), Vec3::new(1.0, 0.0, 0.0)],
            rotations: vec![[1.0, 0.0, 0.0, 0.0], [half, half, 0.0, 0.0], [0.0, 0.0, 0.6, 0.8]],
        };
        let (still, moving) = (cloud(7, 1, 1), cloud(5, 2, 2));
        let parts = [
            RigidPart { splats: still.clone(), ..RigidPart::default() },
            RigidPart { splats: moving.clone(), motion: motion.clone() },
        ];
        let mut bytes = Vec::new();
        write_parts(&parts, &mut bytes).unwrap();
        let scene = read_scene(&bytes, "t.glb", &Limits::default()).unwrap();
        assert_eq!(scene.duration(), 2.0);
        // A reader without animations finds the part where its motion begins.
        let (text, _) = chunks(&bytes, Source { file: "t", format: "glTF" }).unwrap();
        let document: Value = serde_json::from_slice(text).unwrap();
        assert!(document["nodes"][0].get("translation").is_none());
        assert_eq!(document["nodes"][1]["rotation"], json!([0.0, 0.0, 0.0, 1.0]));
        let compare = |seconds: f32, rotation: [f32; 4], translation: Vec3| {
            let got = scene.at(seconds);
            assert_eq!((got.len(), got.degree), (12, 2));
            assert_eq!(got.means[..7], still.means[..], "the first part rests");
            assert_eq!(got.sh[..12], still.sh[..12], "and has no coefficients of degree 2:");
            assert!(got.sh[12..27].iter().all(|v| *v == 0.0));
            let want = moving.clone().mapped(&turn(rotation));
            for (k, mean) in want.means.iter().enumerate() {
                assert!((got.means[7 + k] - *mean - translation).length() < 1e-5, "{seconds}: {k}");
                let same =
                    got.quats[7 + k].iter().zip(rot::normalise(want.quats[k]).wxyz).map(|(a, b)| a * b).sum::<f32>();
                assert!((same.abs() - 1.0).abs() < 1e-5, "{seconds}: {k}");
            }
            let sh = got.sh[7 * 27..].iter().zip(&want.sh).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
            assert!(sh < 1e-5, "{seconds}: {sh}");
        };
        for k in 0..3 {
            compare(motion.times[k], motion.rotations[k], motion.translations[k]);
        }
        compare(-7.0, motion.rotations[0], motion.translations[0]);
        compare(9.0, motion.rotations[2], motion.translations[2]);
        // Half-way: an eighth of a turn about x.
        let (c, s) = ((std::f32::consts::PI / 8.0).cos(), (std::f32::consts::PI / 8.0).sin());
        compare(1.0, [c, s, 0.0, 0.0], Vec3::new(0.5, -1.0, 1.5));
        assert_eq!(read_all(&bytes).unwrap(), scene.at(0.0));
    }

    #[test]
    fn nodes_place_their_splats() {
        let raw = cloud(6, 1, 3);
        let good = encode(&raw);
        let placed = |nodes: Value| read_all(&edited(&good, |d| d["nodes"] = nodes.clone())).map_err(|e| e.to_string());
        // glTF's x and y are those of .ply with the other sign.
        let up =
            placed(json!([{"children": [1], "translation": [0.0, 3.0, 0.0]}, {"mesh": 0, "scale": [2.0, 2.0, 2.0]}]))
                .unwrap();
        for (k, mean) in up.means.iter().enumerate() {
            assert!((*mean - (2.0 * raw.means[k] - 3.0 * Vec3::Y)).length() < 1e-5);
            assert!((up.log_scales[k] - raw.log_scales[k] - 2f32.ln()).abs().max_element() < 1e-5);
        }
        let matrix = [0.0, 2.0, 0.0, 0.0, -2.0, 0.0, 0.0, 0.0, 0.0, 0.0, 2.0, 0.0, 1.0, 0.0, 0.0, 1.0];
        let turned = placed(json!([{"mesh": 0, "matrix": matrix}])).unwrap();
        for (got, m) in turned.means.iter().zip(&raw.means) {
            assert!((*got - Vec3::new(-2.0 * m.y - 1.0, 2.0 * m.x, 2.0 * m.z)).length() < 1e-5, "{got} {m}");
        }
        assert_eq!(placed(json!([{"mesh": 0}, {"mesh": 0}])).unwrap().len(), 12, "twice");
        assert_eq!(placed(json!([])).unwrap(), read_all(&good).unwrap());
        for (nodes, want) in [
            (json!([{"mesh": 0, "scale": [1.0, 2.0, 1.0]}]), "unequally"),
            (json!([{"mesh": 0, "scale": [-1.0, -1.0, -1.0]}]), "unequally"),
            (json!([{"mesh": 0, "rotation": [0.0, 0.0, 0.0, 0.0]}]), "rotation"),
            (json!([{"mesh": 0, "translation": [1.0]}]), "translation"),
            (json!([{"mesh": 0, "children": [1]}, {"children": [0]}]), "in a ring"),
            (json!([{"mesh": 0, "translation": [0.0, 1e30, 0.0]}]), "beyond the range"),
            (json!([{"mesh": 0, "scale": [1e-30, 1e-30, 1e-30]}]), "beyond the range"),
        ] {
            let error = placed(nodes).unwrap_err();
            assert!(error.contains(want), "{error}");
        }
        // Many nodes of one mesh would make much of a small file.
        let crowd: Vec<Value> = (0..100_000).map(|_| json!({"mesh": 0})).collect();
        let many = edited(&encode(&cloud(60, 1, 3)), |d| d["nodes"] = json!(crowd));
        assert!(matches!(read_all(&many), Err(IoError::Limit { .. })));
        let shared = edited(&encode(&cloud(2000, 1, 3)), |d| {
            let one = d["meshes"][0]["primitives"][0].clone();
            d["meshes"][0]["primitives"] = json!(vec![one; 2000]);
        });
        assert!(matches!(read_all(&shared), Err(IoError::Limit { .. })));
    }

    #[test]
    fn key_frames_that_are_none_are_refused() {
        let part = |times: &[f32], n: usize| RigidPart {
            splats: cloud(3, 0, 1),
            motion: RigidMotion {
                times: times.to_vec(),
                translations: vec![Vec3::ZERO; n],
                rotations: vec![[1.0, 0.0, 0.0, 0.0]; n],
            },
        };
        for wrong in [part(&[0.0, 0.0], 2), part(&[0.0, 1.0], 1), part(&[-1.0], 1), part(&[f32::NAN], 1)] {
            assert!(write_parts(&[wrong], &mut Vec::new()).unwrap_err().to_string().contains("key frames"));
        }
        assert!(write_parts(&[], &mut Vec::new()).is_err());
        let mut good = Vec::new();
        write_parts(&[part(&[0.0, 1.0], 2)], &mut good).unwrap();
        type Edit = fn(&mut Value);
        let cases: [(Edit, &str); 5] = [
            (|d| d["animations"][0]["samplers"][0]["interpolation"] = json!("CUBICSPLINE"), "CUBICSPLINE"),
            (|d| d["animations"][0]["channels"][0]["target"]["path"] = json!("scale"), "animated scale"),
            (|d| d["animations"][0]["channels"][1]["sampler"] = json!(9), "samplers"),
            (|d| d["animations"][0]["samplers"][0]["output"] = json!(0), "key frames"),
            (|d| d["animations"][0]["samplers"][0]["input"] = json!(1), "input"),
        ];
        for (k, (edit, want)) in cases.iter().enumerate() {
            let text = read_all(&edited(&good, edit)).unwrap_err().to_string();
            assert!(text.contains(want), "case {k}: {text}");
        }
    }

    /// The file with its JSON edited.
    fn edited(bytes: &[u8], edit: impl Fn(&mut Value)) -> Vec<u8> {
        let (text, binary) = chunks(bytes, Source { file: "t", format: "glTF" }).unwrap();
        let mut document: Value = serde_json::from_slice(text).unwrap();
        edit(&mut document);
        let mut text = serde_json::to_vec(&document).unwrap();
        text.resize(text.len().next_multiple_of(4), b' ');
        let mut out = MAGIC.to_vec();
        for word in [2, (28 + text.len() + binary.len()) as u32, text.len() as u32, JSON_CHUNK] {
            out.extend(word.to_le_bytes());
        }
        out.extend(text);
        out.extend((binary.len() as u32).to_le_bytes());
        out.extend(BINARY_CHUNK.to_le_bytes());
        out.extend(binary);
        out
    }

    #[test]
    fn errors_name_the_cause() {
        let good = encode(&cloud(5, 1, 2));
        type Edit = fn(&mut Value);
        let cases: [(Edit, &str); 8] = [
            (|d| d["accessors"][2]["count"] = json!(4), "has 4 rows"),
            (|d| d["accessors"][0]["count"] = json!(1u64 << 60), "POSITION"),
            (|d| d["accessors"][3]["componentType"] = json!(5123), "SCALE"),
            (|d| d["bufferViews"][2]["buffer"] = json!(1), "a second buffer"),
            // Centres instead of opacities.
            (|d| d["accessors"][4]["bufferView"] = json!(0), "an opacity is between 0 and 1"),
            (|d| d["meshes"][0]["primitives"][0]["extensions"] = json!({}), "without Gaussian splats"),
            (|d| d["meshes"][0]["primitives"][0]["extensions"][EXTENSION]["kernel"] = json!("box"), "box"),
            (|d| d["bufferViews"][0]["byteOffset"] = json!(u64::MAX), "POSITION"),
        ];
        for (k, (edit, want)) in cases.iter().enumerate() {
            let text = read_all(&edited(&good, edit)).unwrap_err().to_string();
            assert!(text.contains(want), "case {k}: {text}");
        }
    }

    #[test]
    fn any_bytes_give_a_value_or_an_error() {
        let good = encode(&cloud(6, 2, 3));
        for cut in 0..good.len() {
            assert!(read_all(&good[..cut]).is_err(), "cut at {cut}");
        }
        let mut rng = Rng::new(7, "glb fuzz", 0, 0);
        for _ in 0..3000 {
            let mut bytes = good.clone();
            for _ in 0..=(rng.uniform() * 4.0) as usize {
                let at = ((rng.uniform() * bytes.len() as f32) as usize).min(bytes.len() - 1);
                bytes[at] = (rng.uniform() * 256.0) as u8;
            }
            let _ = read_all(&bytes);
        }
    }
}
