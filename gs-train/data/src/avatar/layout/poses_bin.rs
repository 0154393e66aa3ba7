//! `poses.bin`: values that replace those of the motion's pose, in binary. All little-endian:
//!
//! ```text
//! "GS4DPOSE"   u32 1   u32 nodes   u32 morphs   u32 frames
//! nodes times: u16 length, name
//! frames times: u32 frame, nodes times f32 (translation x y z, rotation w x y z, scale x y z), morphs times f32
//! ```

use std::collections::BTreeMap;
use std::path::Path;

use glam::DVec3;
use gs_texel::{Character, Pose};

use crate::error::{DataError, Place};
use crate::files::read_bytes;

/// Largest file: 60 nodes over 100 000 frames.
const MAX_BYTES: u64 = 256 << 20;
const MAGIC: &[u8; 8] = b"GS4DPOSE";
const VERSION: u32 = 1;
/// Numbers of a node.
const NODE: usize = 10;

/// The values a file states, by frame.
pub(super) struct Stated {
    /// Numbers of the nodes in the skeleton.
    nodes: Vec<u32>,
    morphs: usize,
    frames: BTreeMap<u32, Vec<f32>>,
}

impl Stated {
    /// Reads the file; empty where there is none.
    ///
    /// # Errors
    /// `data.syntax`, `data.truncated` or `data.field`.
    pub(super) fn read(file: &Path, character: &Character) -> Result<Self, DataError> {
        let mut stated = Self { nodes: Vec::new(), morphs: 0, frames: BTreeMap::new() };
        if !file.is_file() {
            return Ok(stated);
        }
        let bytes = read_bytes(file, MAX_BYTES)?;
        let mut reader = Reader { file, bytes: &bytes, at: 0 };
        if reader.take(MAGIC.len())? != MAGIC {
            return Err(DataError::syntax(file, "byte 0", "the file begins with GS4DPOSE"));
        }
        let [version, nodes, morphs, frames] = [reader.number()?, reader.number()?, reader.number()?, reader.number()?];
        if version != VERSION {
            return Err(DataError::syntax(file, "byte 8", format!("version {version} is not known, only {VERSION}")));
        }
        let known = character.skeleton.rest_morphs.len();
        if morphs as usize != known {
            return Err(DataError::syntax(file, "byte 16", format!("{morphs} morphs; the template has {known}")));
        }
        for _ in 0..nodes {
            stated.nodes.push(reader.node(character)?);
        }
        stated.morphs = known;
        for _ in 0..frames {
            let number = reader.number()?;
            let values = reader.frame(stated.nodes.len(), known, number)?;
            stated.frames.insert(number, values);
        }
        if reader.at < bytes.len() {
            let place = format!("byte {}", reader.at);
            return Err(DataError::syntax(file, place, "there is more than the frames its head names"));
        }
        Ok(stated)
    }

    /// Whether no frame is stated.
    pub(super) fn is_empty(&self) -> bool {
        self.frames.is_empty()
    }

    /// Replaces the values of a pose that its frame states.
    pub(super) fn amend(&self, pose: &mut Pose, frame: u32) {
        let Some(values) = self.frames.get(&frame) else { return };
        let (nodes, morphs) = values.split_at(values.len() - self.morphs);
        for (&node, v) in self.nodes.iter().zip(nodes.as_chunks::<NODE>().0) {
            let [tx, ty, tz, w, x, y, z, sx, sy, sz] = v.map(f64::from);
            let local = &mut pose.locals[node as usize];
            (local.translation, local.scale) = (DVec3::new(tx, ty, tz), DVec3::new(sx, sy, sz));
            local.rotation = [w, x, y, z];
        }
        pose.morphs.copy_from_slice(morphs);
    }
}

struct Reader<'a> {
    file: &'a Path,
    bytes: &'a [u8],
    at: usize,
}

impl<'a> Reader<'a> {
    fn take(&mut self, count: usize) -> Result<&'a [u8], DataError> {
        let left = &self.bytes[self.at..];
        let place = || Place::new(self.file, format!("byte {}", self.at));
        let (needed, present) = (count as u64, left.len() as u64);
        let taken = left.get(..count).ok_or_else(|| DataError::Truncated { place: place(), needed, present })?;
        self.at += count;
        Ok(taken)
    }

    fn number(&mut self) -> Result<u32, DataError> {
        let b = self.take(4)?;
        Ok(u32::from_le_bytes([b[0], b[1], b[2], b[3]]))
    }

    /// The node of a name.
    fn node(&mut self, character: &Character) -> Result<u32, DataError> {
        let at = format!("byte {}", self.at);
        let length = self.take(2)?;
        let name = self.take(usize::from(u16::from_le_bytes([length[0], length[1]])))?;
        let node = std::str::from_utf8(name).ok().and_then(|n| character.skeleton.node(n));
        node.ok_or_else(|| {
            let name = String::from_utf8_lossy(name).chars().take(80).collect::<String>();
            DataError::syntax(self.file, at, format!("`{name}` is no node of the template"))
        })
    }

    fn frame(&mut self, nodes: usize, morphs: usize, number: u32) -> Result<Vec<f32>, DataError> {
        let bytes = self.take(4 * (NODE * nodes + morphs))?;
        let values: Vec<f32> = bytes.as_chunks::<4>().0.iter().map(|b| f32::from_le_bytes(*b)).collect();
        let rotations_valid = values[..NODE * nodes].as_chunks::<NODE>().0.iter().all(|v| v[3..7] != [0.0; 4]);
        if !rotations_valid || values.iter().any(|v| !v.is_finite()) {
            let what = "numbers are finite, and a rotation is a quaternion of any length but 0";
            return Err(DataError::syntax(self.file, format!("frame {number}"), what));
        }
        Ok(values)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::avatar::builtin;

    fn bytes(character: &Character, names: &[&str], frames: &[(u32, f32)]) -> Vec<u8> {
        let morphs = character.skeleton.rest_morphs.len() as u32;
        let mut out = MAGIC.to_vec();
        out.extend([VERSION, names.len() as u32, morphs, frames.len() as u32].iter().flat_map(|v| v.to_le_bytes()));
        for name in names {
            out.extend((name.len() as u16).to_le_bytes());
            out.extend(name.as_bytes());
        }
        for &(number, v) in frames {
            out.extend(number.to_le_bytes());
            for _ in names {
                out.extend([v, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 2.0, 1.0].iter().flat_map(|v: &f32| v.to_le_bytes()));
            }
            out.extend([0.5f32, v].iter().flat_map(|v| v.to_le_bytes()));
        }
        out
    }

    #[test]
    fn frames_are_amended_and_faults_named() {
        let person = builtin("person").unwrap();
        let dir = tempfile::tempdir().unwrap();
        let file = dir.path().join("poses.bin");
        let read = |content: &[u8]| {
            std::fs::write(&file, content).unwrap();
            Stated::read(&file, &person)
        };
        let good = bytes(&person, &["head", "left foot"], &[(3, 0.25), (7, 0.75)]);
        let stated = read(&good).unwrap();
        let mut pose = person.skeleton.rest_pose();
        stated.amend(&mut pose, 4);
        assert_eq!(pose, person.skeleton.rest_pose());
        stated.amend(&mut pose, 7);
        let head = person.skeleton.node("head").unwrap() as usize;
        assert_eq!((pose.locals[head].translation.x, pose.locals[head].scale.y), (0.75, 2.0));
        assert_eq!(pose.morphs, [0.5, 0.75]);
        assert!(Stated::read(&dir.path().join("none"), &person).unwrap().is_empty());

        for cut in 0..good.len() {
            let error = read(&good[..cut]).err().unwrap();
            assert_eq!(error.code(), "data.truncated", "{cut}");
        }
        let mut long = good.clone();
        long.push(0);
        let mut nan = good.clone();
        let end = nan.len();
        nan[end - 4..].copy_from_slice(&f32::NAN.to_le_bytes());
        let strange = bytes(&person, &["tail"], &[]);
        let words = [(long, "more than"), (nan, "frame 7"), (strange, "`tail`"), (b"GS4DPOSX".to_vec(), "GS4DPOSE")];
        for (content, word) in words {
            let error = read(&content).err().unwrap().to_string();
            assert!(error.contains(word), "{error}");
        }
    }
}
