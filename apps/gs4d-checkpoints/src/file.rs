//! The exported file: tensors by name, settings, iteration.

use crate::CheckpointError;
use safetensors::{Dtype, SafeTensors};
use serde_json::Value;
use std::collections::BTreeMap;

/// An exported checkpoint.
pub(crate) struct Exported<'a> {
    tensors: SafeTensors<'a>,
    about: BTreeMap<String, String>,
    args: Value,
}

/// A tensor: its sizes, the slowest first, and its values.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Tensor {
    pub(crate) shape: Vec<usize>,
    pub(crate) values: Vec<f32>,
}

impl<'a> Exported<'a> {
    pub(crate) fn read(bytes: &'a [u8]) -> Result<Self, CheckpointError> {
        let wrong = |e: safetensors::SafeTensorError| CheckpointError::Format(e.to_string());
        let (_, metadata) = SafeTensors::read_metadata(bytes).map_err(wrong)?;
        let about: BTreeMap<String, String> = metadata.metadata().clone().into_iter().flatten().collect();
        let args = about.get("args").and_then(|text| serde_json::from_str(text).ok());
        let args = args.ok_or(CheckpointError::NotExported("args"))?;
        Ok(Self { tensors: SafeTensors::deserialize(bytes).map_err(wrong)?, about, args })
    }

    pub(crate) fn code(&self) -> &str {
        self.about.get("code").map_or("", String::as_str)
    }

    pub(crate) fn iteration(&self) -> Result<u64, CheckpointError> {
        let iteration = self.about.get("iteration").and_then(|text| text.parse().ok());
        iteration.ok_or(CheckpointError::NotExported("iteration"))
    }

    pub(crate) fn has(&self, name: &str) -> bool {
        self.tensors.tensor(name).is_ok()
    }

    /// The names of tensors that begin so.
    pub(crate) fn names(&self, prefix: &str) -> usize {
        self.tensors.names().into_iter().filter(|name| name.starts_with(prefix)).count()
    }

    pub(crate) fn tensor(&self, name: &str) -> Result<Tensor, CheckpointError> {
        let found = self.tensors.tensor(name).map_err(|_| CheckpointError::Missing(name.to_owned()))?;
        if found.dtype() != Dtype::F32 {
            let got = format!("{:?}", found.dtype());
            return Err(CheckpointError::Shape { name: name.to_owned(), got, want: "F32".to_owned() });
        }
        let values = found.data().as_chunks::<4>().0.iter().map(|b| f32::from_le_bytes(*b)).collect();
        Ok(Tensor { shape: found.shape().to_vec(), values })
    }

    /// The values of a tensor of this shape.
    pub(crate) fn values(&self, name: &str, shape: &[usize]) -> Result<Vec<f32>, CheckpointError> {
        let tensor = self.tensor(name)?;
        if tensor.shape == shape {
            Ok(tensor.values)
        } else {
            Err(misshapen(name, &tensor.shape, format!("{shape:?}")))
        }
    }

    /// The sizes of a matrix: rows, columns.
    pub(crate) fn matrix(&self, name: &str) -> Result<[usize; 2], CheckpointError> {
        let shape = self.tensor(name)?.shape;
        <[usize; 2]>::try_from(shape.as_slice()).map_err(|_| misshapen(name, &shape, "a matrix".to_owned()))
    }

    /// Columns `ply.PREFIX0`, `ply.PREFIX1`, … of the point cloud, one row per point.
    pub(crate) fn rows(&self, names: &[String]) -> Result<Vec<f32>, CheckpointError> {
        let n = self.points()?;
        let mut rows = vec![0.0; n * names.len()];
        for (k, name) in names.iter().enumerate() {
            let column = self.values(&format!("ply.{name}"), &[n])?;
            rows.iter_mut().skip(k).step_by(names.len()).zip(column).for_each(|(to, v)| *to = v);
        }
        Ok(rows)
    }

    /// Number of points of the point cloud.
    pub(crate) fn points(&self) -> Result<usize, CheckpointError> {
        Ok(self.tensor("ply.x")?.values.len())
    }

    pub(crate) fn flag(&self, name: &'static str) -> Result<bool, CheckpointError> {
        self.args[name].as_bool().ok_or(CheckpointError::Setting(name))
    }

    /// A switch that earlier versions of a code do not have.
    pub(crate) fn flag_or(&self, name: &'static str, absent: bool) -> Result<bool, CheckpointError> {
        if self.args[name].is_null() { Ok(absent) } else { self.flag(name) }
    }

    pub(crate) fn number(&self, name: &'static str) -> Result<f64, CheckpointError> {
        self.args[name].as_f64().ok_or(CheckpointError::Setting(name))
    }

    /// A setting as JSON; null if there is none.
    pub(crate) fn setting(&self, name: &str) -> &Value {
        &self.args[name]
    }
}

/// The error of a tensor of another shape.
pub(crate) fn misshapen(name: &str, shape: &[usize], want: String) -> CheckpointError {
    CheckpointError::Shape { name: name.to_owned(), got: format!("F32 {shape:?}"), want }
}
