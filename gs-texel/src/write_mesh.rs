//! Writers of posed meshes as OBJ and PLY text.
//!
//! ```
//! let plate = gs_texel::figure::plate(1.0, 1);
//! let mut text = Vec::new();
//! gs_texel::write_mesh::write_obj(&plate, &plate.template.vertices, &mut text)?;
//! assert!(text.starts_with(b"v -0.5 0.5 0\nv 0.5 0.5 0\n"));
//! # Ok::<(), std::io::Error>(())
//! ```

use crate::character::Character;
use glam::Vec3;
use std::io::Write;

/// Writes a character's mesh as OBJ, with `posed` as the positions of the template's vertices: a `v x y z` line for each vertex
/// in the order of its file, `vt` lines (`v` upwards, as in OBJ) if there are texture coordinates, and `f` lines.
///
/// # Errors
/// If writing fails.
pub fn write_obj(character: &Character, posed: &[Vec3], out: &mut dyn Write) -> std::io::Result<()> {
    let template = &character.template;
    let rows = Rows::of(character, posed.len());
    for &v in &rows.vertices {
        let p = posed[v as usize];
        writeln!(out, "v {} {} {}", p.x, p.y, p.z)?;
    }
    for uv in &template.uvs {
        writeln!(out, "vt {} {}", uv.x, 1.0 - uv.y)?;
    }
    for (k, face) in template.faces.iter().enumerate() {
        let [a, b, c] = face.map(|v| rows.first[v as usize] + 1);
        match template.face_uvs.get(k).map(|t| t.map(|t| t + 1)) {
            Some([s, t, u]) => writeln!(out, "f {a}/{s} {b}/{t} {c}/{u}")?,
            None => writeln!(out, "f {a} {b} {c}")?,
        }
    }
    Ok(())
}

/// Writes the vertices and triangles of [`write_obj`] as ASCII PLY.
///
/// # Errors
/// If writing fails.
pub fn write_ply(character: &Character, posed: &[Vec3], out: &mut dyn Write) -> std::io::Result<()> {
    let rows = Rows::of(character, posed.len());
    let faces = &character.template.faces;
    writeln!(out, "ply\nformat ascii 1.0\nelement vertex {}", rows.vertices.len())?;
    writeln!(out, "property float x\nproperty float y\nproperty float z")?;
    writeln!(out, "element face {}\nproperty list uchar int vertex_indices\nend_header", faces.len())?;
    for &v in &rows.vertices {
        let p = posed[v as usize];
        writeln!(out, "{} {} {}", p.x, p.y, p.z)?;
    }
    for face in faces {
        let [a, b, c] = face.map(|v| rows.first[v as usize]);
        writeln!(out, "3 {a} {b} {c}")?;
    }
    Ok(())
}

/// Vertices in the order of the file, and the first row of each of the template's vertices.
struct Rows {
    vertices: Vec<u32>,
    first: Vec<u32>,
}

impl Rows {
    fn of(character: &Character, count: usize) -> Self {
        let listed = &character.source_vertices;
        let vertices = if listed.is_empty() { (0..count as u32).collect() } else { listed.clone() };
        let mut first = vec![0; count];
        for (row, &v) in vertices.iter().enumerate().rev() {
            first[v as usize] = row as u32;
        }
        Self { vertices, first }
    }
}
