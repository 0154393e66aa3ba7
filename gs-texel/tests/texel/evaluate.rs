//! A second evaluator of glTF: straight from the JSON, `f64`, matrices multiplied out, no code of the crate.

use serde_json::Value;
use std::path::Path;

type Mat = [[f64; 4]; 4];

/// A file's JSON and buffers.
pub struct Asset {
    json: Value,
    buffers: Vec<Vec<u8>>,
}

fn at(v: &Value, key: &str) -> usize {
    v[key].as_u64().unwrap_or(0) as usize
}

fn list(v: &Value) -> &[Value] {
    v.as_array().map_or(&[], Vec::as_slice)
}

fn numbers(v: &Value) -> Option<Vec<f64>> {
    Some(v.as_array()?.iter().map(|n| n.as_f64().unwrap()).collect())
}

fn mul(a: &Mat, b: &Mat) -> Mat {
    std::array::from_fn(|i| std::array::from_fn(|j| (0..4).map(|k| a[i][k] * b[k][j]).sum()))
}

fn identity() -> Mat {
    std::array::from_fn(|i| std::array::from_fn(|j| f64::from(u8::from(i == j))))
}

fn from_columns(m: &[f64]) -> Mat {
    std::array::from_fn(|i| std::array::from_fn(|j| m[4 * j + i]))
}

fn moved(m: &Mat, p: [f64; 3]) -> [f64; 3] {
    std::array::from_fn(|i| m[i][0] * p[0] + m[i][1] * p[1] + m[i][2] * p[2] + m[i][3])
}

fn compose(t: &[f64], q: &[f64], s: &[f64]) -> Mat {
    let n = q.iter().map(|v| v * v).sum::<f64>().sqrt();
    let (x, y, z, w) = (q[0] / n, q[1] / n, q[2] / n, q[3] / n);
    let r = [
        [w * w + x * x - y * y - z * z, 2.0 * (x * y - w * z), 2.0 * (x * z + w * y)],
        [2.0 * (x * y + w * z), w * w - x * x + y * y - z * z, 2.0 * (y * z - w * x)],
        [2.0 * (x * z - w * y), 2.0 * (y * z + w * x), w * w - x * x - y * y + z * z],
    ];
    let mut m = identity();
    for i in 0..3 {
        for j in 0..3 {
            m[i][j] = r[i][j] * s[j];
        }
        m[i][3] = t[i];
    }
    m
}

/// `a (a⁻¹ b)^s` through the axis and angle of the relative rotation.
fn arc(a: &[f64], b: &[f64], s: f64) -> Vec<f64> {
    let product = |p: &[f64], q: &[f64]| {
        vec![
            p[3] * q[0] + p[0] * q[3] + p[1] * q[2] - p[2] * q[1],
            p[3] * q[1] - p[0] * q[2] + p[1] * q[3] + p[2] * q[0],
            p[3] * q[2] + p[0] * q[1] - p[1] * q[0] + p[2] * q[3],
            p[3] * q[3] - p[0] * q[0] - p[1] * q[1] - p[2] * q[2],
        ]
    };
    let unit = |q: &[f64]| {
        let n = q.iter().map(|v| v * v).sum::<f64>().sqrt();
        q.iter().map(|v| v / n).collect::<Vec<_>>()
    };
    let (a, b) = (unit(a), unit(b));
    let mut d = product(&[-a[0], -a[1], -a[2], a[3]], &b);
    if d[3] < 0.0 {
        d.iter_mut().for_each(|v| *v = -*v);
    }
    let sine = (d[0] * d[0] + d[1] * d[1] + d[2] * d[2]).sqrt();
    let half = sine.atan2(d[3]);
    let k = if sine > 1e-15 { (s * half).sin() / sine } else { s };
    product(&a, &[k * d[0], k * d[1], k * d[2], (s * half).cos()])
}

impl Asset {
    pub fn open(path: &Path) -> Self {
        let bytes = std::fs::read(path).unwrap();
        let word = |at: usize| u32::from_le_bytes(bytes[at..at + 4].try_into().unwrap()) as usize;
        let (json, binary) = if bytes.starts_with(b"glTF") {
            let n = word(12);
            let rest =
                if 20 + n + 8 <= bytes.len() { bytes[28 + n..28 + n + word(20 + n)].to_vec() } else { Vec::new() };
            (bytes[20..20 + n].to_vec(), rest)
        } else {
            (bytes, Vec::new())
        };
        let json: Value = serde_json::from_slice(&json).unwrap();
        let load = |b: &Value| match b["uri"].as_str() {
            None => binary.clone(),
            Some(uri) if uri.starts_with("data:") => decoded(uri.split_once(',').unwrap().1),
            Some(uri) => std::fs::read(path.with_file_name(uri)).unwrap(),
        };
        let buffers = list(&json["buffers"]).iter().map(load).collect();
        Self { json, buffers }
    }

    pub fn clips(&self) -> usize {
        list(&self.json["animations"]).len()
    }

    fn rows(&self, accessor: &Value) -> Vec<Vec<f64>> {
        let a = &self.json["accessors"][accessor.as_u64().unwrap() as usize];
        let width = match a["type"].as_str().unwrap() {
            "SCALAR" => 1,
            "VEC2" => 2,
            "VEC3" => 3,
            "VEC4" => 4,
            "MAT4" => 16,
            other => panic!("{other}"),
        };
        let mut out = vec![vec![0.0; width]; at(a, "count")];
        let kind = at(a, "componentType");
        let normalised = a["normalized"].as_bool().unwrap_or(false);
        if let Some(view) = a["bufferView"].as_u64() {
            for (i, row) in out.iter_mut().enumerate() {
                *row = self.row((view as usize, at(a, "byteOffset")), i, kind, width, normalised);
            }
        }
        let sparse = &a["sparse"];
        for k in 0..at(sparse, "count") {
            let (i, v) = (&sparse["indices"], &sparse["values"]);
            let place = |s: &Value| (at(s, "bufferView"), at(s, "byteOffset"));
            let target = self.row(place(i), k, at(i, "componentType"), 1, false)[0] as usize;
            out[target] = self.row(place(v), k, kind, width, normalised);
        }
        out
    }

    fn row(&self, (view, offset): (usize, usize), i: usize, kind: usize, width: usize, normalised: bool) -> Vec<f64> {
        let view = &self.json["bufferViews"][view];
        let size = match kind {
            5120 | 5121 => 1,
            5122 | 5123 => 2,
            _ => 4,
        };
        let stride = view["byteStride"].as_u64().map_or(size * width, |s| s as usize);
        let bytes = &self.buffers[at(view, "buffer")][at(view, "byteOffset") + offset + i * stride..];
        let value = |b: &[u8]| match (kind, normalised) {
            (5121, true) => f64::from(b[0]) / 255.0,
            (5121, false) => f64::from(b[0]),
            (5123, n) => f64::from(u16::from_le_bytes([b[0], b[1]])) / if n { 65_535.0 } else { 1.0 },
            (5125, _) => f64::from(u32::from_le_bytes([b[0], b[1], b[2], b[3]])),
            (5126, _) => f64::from(f32::from_le_bytes([b[0], b[1], b[2], b[3]])),
            other => panic!("{other:?}"),
        };
        bytes.chunks(size).take(width).map(value).collect()
    }

    /// What an animation gives for `path` of a node at `t`.
    fn animated(&self, clip: Option<usize>, node: usize, path: &str, t: f64) -> Option<Vec<f64>> {
        let animation = &self.json["animations"][clip?];
        let is_it = |c: &&Value| c["target"]["node"].as_u64() == Some(node as u64) && c["target"]["path"] == path;
        let channel = list(&animation["channels"]).iter().rfind(is_it)?;
        let sampler = &animation["samplers"][at(channel, "sampler")];
        let times: Vec<f64> = self.rows(&sampler["input"]).concat();
        let values = self.rows(&sampler["output"]).concat();
        let mode = sampler["interpolation"].as_str().unwrap_or("LINEAR");
        let width = values.len() / times.len() / if mode == "CUBICSPLINE" { 3 } else { 1 };
        let key = |k: usize, part: usize| match mode {
            "CUBICSPLINE" => values[(3 * k + part) * width..(3 * k + part + 1) * width].to_vec(),
            _ => values[k * width..(k + 1) * width].to_vec(),
        };
        let last = times.len() - 1;
        if t <= times[0] {
            return Some(key(0, 1));
        }
        if t >= times[last] {
            return Some(key(last, 1));
        }
        let k = (0..last).rev().find(|&k| times[k] <= t).unwrap();
        let span = times[k + 1] - times[k];
        let s = (t - times[k]) / span;
        let (a, b) = (key(k, 1), key(k + 1, 1));
        Some(match mode {
            "STEP" => a,
            "LINEAR" if path == "rotation" => arc(&a, &b, s),
            "LINEAR" => a.iter().zip(&b).map(|(a, b)| a + s * (b - a)).collect(),
            _ => {
                let (out, into) = (key(k, 2), key(k + 1, 0));
                let (s2, s3) = (s * s, s * s * s);
                (0..width)
                    .map(|i| {
                        (2.0 * s3 - 3.0 * s2 + 1.0) * a[i]
                            + span * (s3 - 2.0 * s2 + s) * out[i]
                            + (3.0 * s2 - 2.0 * s3) * b[i]
                            + span * (s3 - s2) * into[i]
                    })
                    .collect()
            }
        })
    }

    fn local(&self, clip: Option<usize>, node: usize, t: f64) -> Mat {
        let n = &self.json["nodes"][node];
        if let Some(m) = numbers(&n["matrix"]) {
            return from_columns(&m);
        }
        let part = |path: &str, default: &[f64]| {
            let rest = numbers(&n[path]).unwrap_or(default.to_vec());
            self.animated(clip, node, path, t).unwrap_or(rest)
        };
        compose(&part("translation", &[0.0; 3]), &part("rotation", &[0.0, 0.0, 0.0, 1.0]), &part("scale", &[1.0; 3]))
    }

    /// World positions of all vertices of the scene: nodes depth first, primitives, rows.
    pub fn vertices(&self, clip: Option<usize>, t: f64) -> Vec<[f64; 3]> {
        let mut globals = vec![identity(); list(&self.json["nodes"]).len()];
        let scene = &self.json["scenes"][at(&self.json, "scene")];
        let mut order = Vec::new();
        for root in list(&scene["nodes"]) {
            self.walk(root.as_u64().unwrap() as usize, &identity(), (clip, t), &mut globals, &mut order);
        }
        order.iter().flat_map(|&node| self.mesh(node, &globals, (clip, t))).collect()
    }

    fn walk(&self, node: usize, up: &Mat, at: (Option<usize>, f64), globals: &mut [Mat], order: &mut Vec<usize>) {
        globals[node] = mul(up, &self.local(at.0, node, at.1));
        order.push(node);
        let here = globals[node];
        for child in list(&self.json["nodes"][node]["children"]) {
            self.walk(child.as_u64().unwrap() as usize, &here, at, globals, order);
        }
    }

    fn mesh(&self, node: usize, globals: &[Mat], (clip, t): (Option<usize>, f64)) -> Vec<[f64; 3]> {
        let n = &self.json["nodes"][node];
        let Some(mesh) = n["mesh"].as_u64() else { return Vec::new() };
        let mesh = &self.json["meshes"][mesh as usize];
        let weights = self.animated(clip, node, "weights", t).or(numbers(&n["weights"])).or(numbers(&mesh["weights"]));
        let joints = n["skin"].as_u64().map(|s| {
            let skin = &self.json["skins"][s as usize];
            let binds = (!skin["inverseBindMatrices"].is_null()).then(|| self.rows(&skin["inverseBindMatrices"]));
            let bind = |k: usize| binds.as_ref().map_or(identity(), |b| from_columns(&b[k]));
            let joint = |(k, j): (usize, &Value)| mul(&globals[j.as_u64().unwrap() as usize], &bind(k));
            list(&skin["joints"]).iter().enumerate().map(joint).collect::<Vec<Mat>>()
        });
        let mut out = Vec::new();
        for primitive in list(&mesh["primitives"]) {
            let attributes = &primitive["attributes"];
            let mut points = self.rows(&attributes["POSITION"]);
            for (k, target) in list(&primitive["targets"]).iter().enumerate() {
                let w = weights.as_ref().map_or(0.0, |w| w[k]);
                for (p, d) in points.iter_mut().zip(self.rows(&target["POSITION"])) {
                    (0..3).for_each(|i| p[i] += w * d[i]);
                }
            }
            let skin =
                joints.as_ref().map(|j| (j, self.rows(&attributes["JOINTS_0"]), self.rows(&attributes["WEIGHTS_0"])));
            for (i, p) in points.iter().enumerate() {
                let p = [p[0], p[1], p[2]];
                let Some((joints, numbers, weights)) = &skin else {
                    out.push(moved(&globals[node], p));
                    continue;
                };
                let sum: f64 = weights[i].iter().sum();
                let mut x = [0.0; 3];
                for (j, w) in numbers[i].iter().zip(&weights[i]) {
                    let q = moved(&joints[*j as usize], p);
                    (0..3).for_each(|k| x[k] += w / sum * q[k]);
                }
                out.push(x);
            }
        }
        out
    }
}

fn decoded(text: &str) -> Vec<u8> {
    const ALPHABET: &str = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    let bits: String = text.chars().filter_map(|c| ALPHABET.find(c)).map(|v| format!("{v:06b}")).collect();
    bits.as_bytes().chunks_exact(8).map(|b| u8::from_str_radix(std::str::from_utf8(b).unwrap(), 2).unwrap()).collect()
}
