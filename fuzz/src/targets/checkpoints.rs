//! Checkpoints and compact scenes: the file, the method that is built from it, and four moments of it rendered.
//!
//! The layout of the file is that of `gs_train::checkpoint`: a header of 20 bytes, then sections
//! `name_len u32, payload_len u64, name, payload, crc32 u32`, the first of which is `meta`.

use super::{Error, Target};
use crate::case::Case;
use glam::{DMat3, DVec3, Vec3};
use gs_core::{Camera, Rng};
use gs_data::PointCloud;
use gs_raster::{Workspace, render};
use gs_train::checkpoint::{Checkpoint, Coding, Encoding};
use gs_train::saved::{self, Loaded, RunState};
use gs_train::scene::SceneInfo;
use gs_train::timestamp::Timestamp;
use gs4d_run::compact::{Bits, CompactScene, Packing};
use std::collections::BTreeMap;
use std::path::Path;

const FILE: &str = "a.gs4d";
const HEADER: usize = 20;
/// The two lengths of a section.
const LENGTHS: usize = 12;
/// Splats of a scene.
const SPLATS: usize = 12;

pub fn targets() -> Vec<Target> {
    let one = |name, share, seeds, run| Target { name, share, seeds, repair, run };
    vec![
        one("ckpt", 6, checkpoints, load),
        Target { repair: super::as_it_is, ..one("ckpt_meta", 6, metas, load_meta) },
        one("compact", 6, compact_files, load),
        one("packed", 1, packed, |c, d| read(c.first(), d).map(drop)),
    ]
}

/// Untrained scenes of every method that needs no film.
fn scenes() -> Result<Vec<(&'static str, Loaded)>, Error> {
    let entries = gs_methods::registry().iter().filter(|e| !e.needs_avatar);
    entries.map(|e| Ok((e.name, scene(e.name)?))).collect()
}

/// An untrained scene of a method.
pub fn scene(method: &str) -> Result<Loaded, Error> {
    let registry = gs_methods::registry();
    let entry = registry.find(method)?;
    let config = entry.config("tiny")?;
    let mut rng = Rng::new(1, "fuzz.scene", 0, 0);
    let positions: Vec<Vec3> =
        (0..SPLATS).map(|_| Vec3::from_array(std::array::from_fn(|_| rng.range(-1.0, 1.0)))).collect();
    let scene = SceneInfo {
        points: PointCloud { colors: vec![[0.5; 3]; SPLATS], positions },
        extent: 2.0,
        bounds: [Vec3::NEG_ONE, Vec3::ONE],
        views: 4,
        timestamps: 4,
        last_time: 1.0,
        frame_interval: 0.25,
        first_interval: 0.25,
        view_spacing: 6.0,
        seed: 1,
        avatar: None,
        max_parameters: gs_train::scene::MAX_PARAMETERS,
    };
    let model = entry.model(&config, &scene)?;
    let adam_updates = BTreeMap::from([("cloud.means".to_owned(), 40)]);
    let state = RunState { config: &config, scene: &scene, step: 40, adam_updates: &adam_updates, train_seconds: 1.5 };
    Ok(saved::load(registry, &saved::save(&model, &state), None)?)
}

fn checkpoint(loaded: &Loaded, moments: bool) -> Checkpoint {
    let state = RunState {
        config: &loaded.config,
        scene: &loaded.scene,
        step: loaded.step,
        adam_updates: &loaded.adam_updates,
        train_seconds: loaded.train_seconds,
    };
    if moments { saved::save(&loaded.model, &state) } else { saved::save_for_rendering(&loaded.model, &state) }
}

fn stored(checkpoint: &Checkpoint, dir: &Path) -> Result<Vec<u8>, Error> {
    checkpoint.save(&dir.join(FILE))?;
    Ok(std::fs::read(dir.join(FILE))?)
}

fn checkpoints(dir: &Path) -> Result<Vec<Case>, Error> {
    let of =
        |(name, loaded): (&str, Loaded)| Ok(Case::one(FILE, stored(&checkpoint(&loaded, name == "static3d"), dir)?));
    scenes()?.into_iter().map(of).collect()
}

fn compact_files(dir: &Path) -> Result<Vec<Case>, Error> {
    let of = |(k, (_, loaded)): (usize, (&str, Loaded))| {
        let packing = Packing { bits: [Bits::Byte, Bits::Half, Bits::Full][k % 3], deflate: k % 2 == 0 };
        let compact = CompactScene::of(&loaded.model, &loaded.config);
        compact.write(&dir.join(FILE), &loaded, &toml::Table::new(), &gs4d_run::Kept::default(), packing)?;
        Ok(Case::one(FILE, std::fs::read(dir.join(FILE))?))
    };
    scenes()?.into_iter().enumerate().map(of).collect()
}

/// The text of `meta` alone, in a file named after the method; what follows it lies in the folder.
fn metas(dir: &Path) -> Result<Vec<Case>, Error> {
    let of = |(name, loaded): (&str, Loaded)| {
        let bytes = stored(&checkpoint(&loaded, false), dir)?;
        let section = Section::at(&bytes, HEADER).ok_or("a checkpoint begins with meta")?;
        std::fs::write(dir.join(format!("{name}.rest")), &bytes[section.end()..])?;
        std::fs::write(dir.join(format!("{name}.head")), &bytes[..HEADER])?;
        Ok(Case::one(name, &bytes[section.payload()]))
    };
    scenes()?.into_iter().map(of).collect()
}

fn load_meta(case: &Case, dir: &Path) -> Result<(), String> {
    let file = case.0.first().ok_or("no file")?;
    let part = |kind: &str| std::fs::read(dir.join(format!("{}.{kind}", file.name))).map_err(|e| e.to_string());
    let mut meta = [&4u32.to_le_bytes()[..], &(file.bytes.len() as u64).to_le_bytes(), b"meta", &file.bytes].concat();
    meta.extend(crc32fast::hash(&meta).to_le_bytes());
    let whole = [part("head")?, meta, part("rest")?].concat();
    load(&Case::one(FILE, whole), dir)
}

/// Tensors in every coding, without a method.
fn packed(dir: &Path) -> Result<Vec<Case>, Error> {
    let values: Vec<f32> = (0..24).map(|k| (k * k % 17) as f32 * 0.25).collect();
    let codings =
        [Coding::F32, Coding::F16, Coding::Affine8, Coding::Affine16, Coding::Lattice { step: 0.25, exact: false }];
    let tensors = codings.iter().enumerate().map(|(k, _)| (format!("t{k}"), values.clone())).collect();
    let checkpoint = Checkpoint { meta: serde_json::json!({"step": 1}), tensors };
    let of = |deflate| {
        let encodings = codings.map(|coding| Encoding { coding, columns: 3, group: 4, deflate });
        checkpoint.save_packed(&dir.join(FILE), &encodings)?;
        Ok(Case::one(FILE, std::fs::read(dir.join(FILE))?))
    };
    [false, true].into_iter().map(of).collect()
}

fn read(bytes: &[u8], dir: &Path) -> Result<Checkpoint, String> {
    Case::one(FILE, bytes).write(dir).map_err(|e| format!("the work folder: {e}"))?;
    Checkpoint::load(&dir.join(FILE)).map_err(|e| e.to_string())
}

fn load(case: &Case, dir: &Path) -> Result<(), String> {
    let loaded = saved::load(gs_methods::registry(), &read(case.first(), dir)?, None)?;
    let camera = Camera {
        width: 4,
        height: 4,
        fx: 2.0,
        fy: 2.0,
        cx: 2.0,
        cy: 2.0,
        rotation: DMat3::IDENTITY,
        translation: DVec3::new(0.0, 0.0, 3.0),
    };
    let options = loaded.model.raster_options(loaded.model.background());
    for t in [0.0, 0.3, 0.6, 1.0] {
        let splats = loaded.model.splats(&Timestamp::normalised(t), &camera).map_err(|e| e.to_string())?;
        splats.check().map_err(|e| e.to_string())?;
        render(&splats, &camera, &options, &mut Workspace::default());
    }
    Ok(())
}

/// Where a section is.
struct Section {
    start: usize,
    name: usize,
    payload: usize,
}

impl Section {
    fn at(bytes: &[u8], start: usize) -> Option<Self> {
        let (name, rest) = bytes.get(start..)?.split_first_chunk()?;
        let payload = u64::from_le_bytes(*rest.first_chunk()?);
        let section = Self { start, name: u32::from_le_bytes(*name) as usize, payload: usize::try_from(payload).ok()? };
        let end = section.payload.checked_add(section.name)?.checked_add(start + LENGTHS + 4)?;
        (end <= bytes.len()).then_some(section)
    }

    fn payload(&self) -> std::ops::Range<usize> {
        let start = self.start + LENGTHS + self.name;
        start..start + self.payload
    }

    fn end(&self) -> usize {
        self.payload().end + 4
    }
}

/// Makes every checksum right; most of the time the length of a section that does not end and the number of sections, too.
fn repair(case: &mut Case, rng: &mut Rng) {
    let Some(bytes) = case.0.first_mut().map(|f| &mut f.bytes).filter(|b| b.len() > HEADER) else { return };
    let lengths = rng.below(4) > 0;
    let (mut at, mut count) = (HEADER, 0u32);
    while bytes.len() >= at + LENGTHS + 4 {
        if lengths && Section::at(bytes, at).is_none() {
            let left = bytes.len() - at - LENGTHS - 4;
            let name = left.min(4);
            bytes[at..at + 4].copy_from_slice(&(name as u32).to_le_bytes());
            bytes[at + 4..at + LENGTHS].copy_from_slice(&((left - name) as u64).to_le_bytes());
        }
        let Some(section) = Section::at(bytes, at) else { break };
        let crc = crc32fast::hash(&bytes[at..section.payload().end]);
        bytes[section.payload().end..section.end()].copy_from_slice(&crc.to_le_bytes());
        (at, count) = (section.end(), count + 1);
    }
    if lengths {
        bytes.truncate(at);
        bytes[12..16].copy_from_slice(&count.to_le_bytes());
    }
    let crc = crc32fast::hash(&bytes[..16]);
    bytes[16..HEADER].copy_from_slice(&crc.to_le_bytes());
}
