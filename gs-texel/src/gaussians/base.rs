//! Base maps: point, skinning matrix, rotation and scale factor of each texel, interpolated from vertices.

use crate::texels::TexelTable;
use glam::{Affine3A, Vec3};
use gs_core::rot;
use rayon::prelude::*;

/// Texels of the smallest parallel task.
const CHUNK: usize = 1024;

/// The base maps of all valid texels, `K` rows in the order of [`TexelTable::valid`].
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TexelBase {
    /// `c`: points of the deformed bind pose, metres.
    pub points: Vec<Vec3>,
    /// `[R | τ]`: blended skinning matrices.
    pub transforms: Vec<Affine3A>,
    /// `q_R`: unit quaternions `(w, x, y, z)` of the matrices' rotations.
    pub rotations: Vec<[f32; 4]>,
    /// `κ`: factor on all three standard deviations.
    pub kappas: Vec<f32>,
}

/// Faults of the columns of vertices.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum BaseError {
    /// A column does not have one row per vertex.
    #[error("`{column}` has {got} rows, the mesh has {want} vertices")]
    Length {
        /// Name of the column concerned.
        column: &'static str,
        /// Number of rows it has.
        got: usize,
        /// Number of vertices of the mesh.
        want: usize,
    },
    /// A value is not finite.
    #[error("row {row} of `{column}` is not finite; check the pose and the offsets of this frame")]
    NotFinite {
        /// Name of the column.
        column: &'static str,
        /// First row that is not finite.
        row: usize,
    },
    /// A face names a vertex that is not there.
    #[error("face {face} names a vertex beyond the {vertices} of the mesh")]
    Face {
        /// Row of the face among the faces.
        face: u32,
        /// Number of vertices of the mesh.
        vertices: usize,
    },
}

impl TexelBase {
    /// Interpolates columns of vertices: the deformed bind pose `v̄ + D`, blended matrices and their rotations
    /// ([`crate::skin::rotations`]), and κ. Quaternions get the sign of the first corner's before they are averaged.
    ///
    /// # Errors
    /// If columns differ in length, a value is not finite, or a face names a vertex that is not there.
    pub fn new(
        table: &TexelTable,
        faces: &[[u32; 3]],
        points: &[Vec3],
        transforms: &[Affine3A],
        rotations: &[[f32; 4]],
        kappas: &[f32],
    ) -> Result<Self, BaseError> {
        let want = points.len();
        for (column, got) in
            [("transforms", transforms.len()), ("rotations", rotations.len()), ("kappas", kappas.len())]
        {
            if got != want {
                return Err(BaseError::Length { column, got, want });
            }
        }
        let bad = |face: &u32| faces.get(*face as usize).is_none_or(|f| f.iter().any(|v| *v as usize >= want));
        if let Some(&face) = table.tri.iter().find(|f| bad(f)) {
            return Err(BaseError::Face { face, vertices: want });
        }
        let finite = |column, row: Option<usize>| row.map_or(Ok(()), |row| Err(BaseError::NotFinite { column, row }));
        finite("points", points.iter().position(|p| !p.is_finite()))?;
        finite("transforms", transforms.iter().position(|t| !t.is_finite()))?;
        finite("rotations", rotations.iter().position(|q| !q.iter().all(|v| v.is_finite())))?;
        finite("kappas", kappas.iter().position(|k| !k.is_finite()))?;
        let row = |k: usize| {
            let (face, w) = (faces[table.tri[k] as usize].map(|v| v as usize), table.weights(k));
            let mut transform = Affine3A::ZERO;
            let mut rotation = [0.0f32; 4];
            for (v, w) in face.into_iter().zip(w) {
                transform.matrix3 += transforms[v].matrix3 * w;
                transform.translation += transforms[v].translation * w;
                let along: f32 = rotations[v].iter().zip(rotations[face[0]]).map(|(a, b)| a * b).sum();
                let w = if along < 0.0 { -w } else { w };
                rotation = std::array::from_fn(|i| rotation[i] + w * rotations[v][i]);
            }
            let unit = rot::normalise(rotation).wxyz;
            let rotation = if unit == [0.0; 4] { [1.0, 0.0, 0.0, 0.0] } else { unit };
            let kappa = face.into_iter().zip(w).map(|(v, w)| kappas[v] * w).sum::<f32>();
            let point = face.into_iter().zip(w).map(|(v, w)| points[v] * w).sum::<Vec3>();
            (point, transform, rotation, kappa)
        };
        let rows: Vec<_> = (0..table.len()).into_par_iter().with_min_len(CHUNK).map(row).collect();
        let mut base = Self::default();
        for (point, transform, rotation, kappa) in rows {
            base.points.push(point);
            base.transforms.push(transform);
            base.rotations.push(rotation);
            base.kappas.push(kappa);
        }
        Ok(base)
    }

    /// Number of texels `K`, the rows of every column.
    pub fn len(&self) -> usize {
        self.points.len()
    }

    /// Whether there are no texels.
    pub fn is_empty(&self) -> bool {
        self.points.is_empty()
    }
}
