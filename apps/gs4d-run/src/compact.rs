//! Compact scenes: one small file with all that rendering needs.
//!
//! It holds the parameters (without gradients and optimizer moments) and buffers of fixed length; per-row statistics are
//! dropped.
//! The file is a checkpoint with packed tensors, so [`saved::load`] reads it, and with the settings of its run, so it can
//! be scored on the same data. Training can continue from it, with optimizer moments of zero.
//!
//! | bits | positions | rows (per column) | shared blocks |
//! |---|---|---|---|
//! | 32 | f32 | f32 | f32 |
//! | 16 | 1/65535 of the range of each axis | f16 | f16 |
//! | 8 | 1/65535 of the range of each axis | 1/255 of the range of each column | 1/255 of the range of 256 neighbours |
//!
//! Positions on a known lattice are stored as whole numbers, exactly. Blocks of at most [`SMALL`] values stay `f32`.

use crate::RunError;
use crate::kept::Kept;
use gs_core::Param;
use gs_train::checkpoint::{Checkpoint, CheckpointError, Coding, Encoding};
use gs_train::model::Model;
use gs_train::saved::{self, Loaded, RunState};
use gs4d_report::inspect::bytes_text;
use gs4d_report::storage::block_of;
use serde::Serialize;
use serde_json::{Value, json};
use std::collections::BTreeMap;
use std::path::Path;

/// Key of the run's settings in `meta`, as TOML text.
pub const SETTINGS: &str = "settings";
/// Key of what is kept of the data in `meta` ([`Kept`]).
pub const DATA: &str = "data";
/// Key of the cameras that are kept in `meta` of files without [`DATA`], as camera JSON.
pub const CAMERAS: &str = "cameras";
/// Beginning of the names of blocks of cameras' corrections.
const CORRECTIONS: &str = "cameras.";
/// Largest number of values of a block that is stored as `f32` in any case.
pub const SMALL: usize = 64;
/// Number of values of a shared block that have a quantisation range in common.
const GROUP: usize = 256;

/// Bits per value that a file is packed with.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(into = "u8")]
pub enum Bits {
    /// 32-bit floats, no value rounded.
    Full,
    /// 16-bit floats; positions in 16-bit fixed point.
    Half,
    /// 8-bit quantisation; positions in 16-bit fixed point.
    Byte,
}

impl From<Bits> for u8 {
    fn from(bits: Bits) -> u8 {
        match bits {
            Bits::Full => 32,
            Bits::Half => 16,
            Bits::Byte => 8,
        }
    }
}

/// How a scene is packed.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Packing {
    /// Bits per value of blocks that may be rounded.
    pub bits: Bits,
    /// Whether to deflate blocks that become smaller by it.
    pub deflate: bool,
}

/// A tensor of a scene.
#[derive(Clone, Debug, PartialEq)]
pub struct CompactTensor {
    /// Name of the parameter or column.
    pub name: String,
    /// Values per row; `None` for tensors without rows.
    pub row_width: Option<usize>,
    /// All values, row by row.
    pub values: Vec<f32>,
    /// Whether values must not be rounded: true for buffers.
    pub exact: bool,
    /// The values are integer multiples of this step, where one is known.
    pub lattice: Option<f32>,
}

/// A scene to be packed: the configuration that builds its method, and its blocks.
#[derive(Clone, Debug, PartialEq)]
pub struct CompactScene {
    /// Resolved configuration that builds the method.
    pub config: toml::Table,
    /// Every tensor that rendering needs.
    pub tensors: Vec<CompactTensor>,
}

/// The sizes of a compact file.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CompactReport {
    /// Bits and deflation that the file was packed with.
    pub packing: Packing,
    /// Size of the file in bytes.
    pub file_bytes: usize,
    /// Bytes of the values as `f32`.
    pub value_bytes: usize,
    /// Blocks in the order of the tensors.
    pub blocks: Vec<CompactBlock>,
}

/// A block of a file: tensors of the same first two parts of their names.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CompactBlock {
    /// Name of the block, for example `field.planes`.
    pub block: String,
    /// Number of values in the block.
    pub values: usize,
    /// Bytes of the block in the file.
    pub bytes: usize,
}

impl CompactScene {
    /// The tensors that rendering needs, baked and with its quantisation step where the method has them.
    pub fn of(method: &Model, config: &toml::Table) -> Self {
        match method.fold(config) {
            Some((config, folded)) => Self::of_blocks(&folded, &config),
            None => Self::of_blocks(method, config),
        }
    }

    fn of_blocks(method: &Model, config: &toml::Table) -> Self {
        let on_lattice = method.capabilities().bake.and_then(|b| b.quantization_step());
        let mut tensors = Vec::new();
        let mut push = |p: &Param, exact: bool| {
            let (name, values) = (p.name.clone(), p.value.clone());
            let lattice = on_lattice.filter(|(block, _)| *block == name).map(|(_, step)| step);
            tensors.push(CompactTensor { name, row_width: p.row_width, values, exact, lattice });
        };
        // Those of the method, and corrections of cameras, which are few and smaller than a step of 8 bits.
        method.visit(&mut |p| push(p, p.name.starts_with(CORRECTIONS)));
        method.buffers(&mut |buffer| {
            if buffer.row_width.is_none() {
                let (name, values) = (buffer.name.to_owned(), buffer.values.clone());
                tensors.push(CompactTensor { name, row_width: None, values, exact: true, lattice: None });
            }
        });
        Self { config: config.clone(), tensors }
    }

    /// Writes the file. `settings` are those of the run, the method's own included; the path of its data is left out. What `kept`
    /// holds of its data is stored beside them.
    ///
    /// # Errors
    /// As [`Checkpoint::save`]. What is at `path` is replaced.
    pub fn write(
        &self,
        path: &Path,
        loaded: &Loaded,
        settings: &toml::Table,
        kept: &Kept,
        packing: Packing,
    ) -> Result<CompactReport, RunError> {
        let encodings: Vec<Encoding> = self.tensors.iter().map(|t| t.encoding(packing)).collect();
        let mut meta = self.meta(loaded, packing);
        meta[SETTINGS] = json!(without_path(settings)?);
        meta[DATA] = kept.to_json()?;
        let checkpoint =
            Checkpoint { meta, tensors: self.tensors.iter().map(|t| (t.name.clone(), t.values.clone())).collect() };
        let bytes = checkpoint.save_packed(path, &encodings)?;
        let file = std::fs::metadata(path);
        let file = file.map_err(|source| CheckpointError::Io { action: "read", path: path.to_owned(), source })?;
        Ok(CompactReport {
            packing,
            file_bytes: usize::try_from(file.len()).unwrap_or(usize::MAX),
            value_bytes: 4 * self.tensors.iter().map(|t| t.values.len()).sum::<usize>(),
            blocks: self.blocks(&bytes),
        })
    }

    fn meta(&self, loaded: &Loaded, packing: Packing) -> Value {
        let state = RunState {
            config: &self.config,
            scene: &loaded.scene,
            step: loaded.step,
            adam_updates: &BTreeMap::new(),
            train_seconds: loaded.train_seconds,
        };
        let mut meta = saved::save(&loaded.model, &state).meta;
        meta["packing"] = json!(packing);
        meta
    }

    fn blocks(&self, bytes: &[usize]) -> Vec<CompactBlock> {
        let mut blocks: Vec<CompactBlock> = Vec::new();
        for (tensor, &bytes) in self.tensors.iter().zip(bytes) {
            let (block, values) = (block_of(&tensor.name), tensor.values.len());
            match blocks.iter_mut().find(|b| b.block == block) {
                Some(b) => (b.values, b.bytes) = (b.values + values, b.bytes + bytes),
                None => blocks.push(CompactBlock { block: block.to_owned(), values, bytes }),
            }
        }
        blocks
    }
}

/// The settings as TOML text, without the place of the data and of other files that they name.
fn without_path(settings: &toml::Table) -> Result<String, CheckpointError> {
    let mut settings = settings.clone();
    if let Some(run) = settings.get_mut("run").and_then(toml::Value::as_table_mut) {
        run.insert("data".into(), "".into());
    }
    leave_out_absolute(&mut settings);
    toml::to_string(&settings).map_err(|e| CheckpointError::State(e.to_string()))
}

/// Empties every setting that is an absolute path.
fn leave_out_absolute(settings: &mut toml::Table) {
    for (_, value) in settings.iter_mut() {
        match value {
            toml::Value::Table(inner) => leave_out_absolute(inner),
            toml::Value::String(text) if Path::new(text).is_absolute() => text.clear(),
            _ => {}
        }
    }
}

impl CompactTensor {
    fn encoding(&self, packing: Packing) -> Encoding {
        let position = self.name.ends_with(".means") || self.name.ends_with(".positions");
        let coding = match (packing.bits, self.lattice) {
            _ if self.exact || self.values.len() <= SMALL => Coding::F32,
            (bits, Some(step)) => Coding::Lattice { step, exact: bits == Bits::Full },
            (Bits::Full, _) => Coding::F32,
            (Bits::Half | Bits::Byte, _) if position => Coding::Affine16,
            (Bits::Half, _) => Coding::F16,
            (Bits::Byte, _) => Coding::Affine8,
        };
        let (columns, group) = self.row_width.map_or((1, GROUP), |width| (width, 0));
        Encoding { coding, columns, group, deflate: packing.deflate }
    }
}

impl CompactReport {
    /// The blocks and their sizes as a table for a terminal.
    pub fn to_text(&self) -> String {
        let mut out = format!("{:26}{:>12}{:>12}{:>12}{:>8}\n", "", "values", "f32", "packed", "bits");
        for b in &self.blocks {
            let bits = 8.0 * b.bytes as f64 / b.values.max(1) as f64;
            let (full, packed) = (bytes_text(4 * b.values), bytes_text(b.bytes));
            out.push_str(&format!("{:26}{:>12}{full:>12}{packed:>12}{bits:>8.2}\n", b.block, b.values));
        }
        let (full, file) = (bytes_text(self.value_bytes), bytes_text(self.file_bytes));
        let ratio = self.value_bytes as f64 / self.file_bytes.max(1) as f64;
        out.push_str(&format!("{:26}{:>12}{full:>12}{file:>12}  values over file {ratio:.2}\n", "file", ""));
        out
    }
}

#[cfg(test)]
mod tests;
