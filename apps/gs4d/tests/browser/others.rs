//! Files of other programs and ours show one scene: splat-transform (PlayCanvas) and Spark read and write what `gs4d export` does.
//!
//! The packages come from npm: `npm install @playcanvas/splat-transform @sparkjsdev/spark three` in a folder that `GS4D_NPM` names.

use crate::chromium::{self, Chromium};
use crate::{good, text};
use glam::Vec3;
use gs_core::io::{Limits, RawSplats, load_splats, save_splats};
use gs_core::rng::Rng;
use gs_core::rot;
use std::io::{BufRead, BufReader, Write};
use std::net::TcpListener;
use std::path::{Path, PathBuf};
use std::process::Command;

/// Splats in one corner of space, long and thin, whose colours depend on the direction: no turn of it looks the same.
fn cloud() -> RawSplats {
    let mut raw = RawSplats { degree: 3, ..RawSplats::default() };
    for row in 0..40 {
        let mut r = Rng::new(1, "other programs", 0, row);
        raw.means.push(Vec3::new(r.range(0.0, 1.0), r.range(0.0, 2.0), r.range(0.0, 3.0)));
        raw.quats.push(rot::normalise([r.normal(), r.normal(), r.normal(), r.normal()]).wxyz);
        raw.log_scales.push(Vec3::new(-2.0, -3.0, -4.0));
        raw.logit_opacities.push(1.0);
        raw.sh.extend((0..48).map(|_| r.range(-0.5, 0.5)));
    }
    raw
}

/// Centre and covariance of a splat, the latter in shares of its largest variance.
type Shape = ([f32; 3], [f32; 6]);

fn shape(mean: [f32; 3], quat: [f32; 4], scales: [f32; 3]) -> Shape {
    let m = rot::matrix(rot::normalise(quat).wxyz);
    let v = scales.map(|s| (s / scales[0].max(scales[1]).max(scales[2])).powi(2));
    let entry = |[r, c]: [usize; 2]| (0..3).map(|k| m[r][k] * v[k] * m[c][k]).sum();
    (mean, [[0, 0], [0, 1], [0, 2], [1, 1], [1, 2], [2, 2]].map(entry))
}

fn shapes(raw: &RawSplats) -> Vec<Shape> {
    let of = |i: usize| shape(raw.means[i].to_array(), raw.quats[i], raw.log_scales[i].to_array().map(f32::exp));
    (0..raw.len()).map(of).collect()
}

/// Every splat of `truth` is in `found`, to the accuracy of the coarsest format.
fn agree(truth: &[Shape], found: &[Shape], of: &str) {
    assert_eq!(truth.len(), found.len(), "{of}");
    for (mean, covariance) in truth {
        let far = |m: &[f32; 3]| m.iter().zip(mean).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        let nearest = found.iter().min_by(|a, b| far(&a.0).total_cmp(&far(&b.0))).unwrap();
        let worst = nearest.1.iter().zip(covariance).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        assert!(far(&nearest.0) < 2e-3 && worst < 0.05, "{of}: {} {worst}", far(&nearest.0));
    }
}

/// Largest difference of the coefficients of splats in one order.
fn harmonics(a: &RawSplats, b: &RawSplats) -> f32 {
    a.sh.iter().zip(&b.sh).map(|(x, y)| (x - y).abs()).fold(0.0, f32::max)
}

fn packages() -> Option<PathBuf> {
    let folder = std::env::var_os("GS4D_NPM").map(PathBuf::from);
    if folder.is_none() {
        println!("SKIPPED: GS4D_NPM names no folder with the packages of npm");
    }
    folder
}

/// The cloud as every format, by our program.
fn exported(dir: &Path) -> RawSplats {
    let raw = cloud();
    save_splats(&dir.join("scene.ply"), &raw, false).unwrap();
    for extension in ["splat", "spz", "glb"] {
        good(&["export", text(&dir.join("scene.ply")), "-o", text(&dir.join(format!("scene.{extension}")))]);
    }
    raw
}

#[test]
#[ignore = "needs node and npm packages"]
fn splat_transform_reads_and_writes_the_same_scene() {
    let Some(packages) = packages() else { return };
    let dir = tempfile::tempdir().unwrap();
    let raw = exported(dir.path());
    let load = |name: &str| load_splats(&dir.path().join(name), &Limits::default()).unwrap();
    let convert = |from: &str, to: &str| {
        let program = packages.join("node_modules/@playcanvas/splat-transform/bin/cli.mjs");
        let mut command = Command::new("node");
        let output = command.arg(program).arg("-w").args([from, to].map(|n| dir.path().join(n))).output().unwrap();
        assert!(output.status.success(), "{from} {to}: {}", String::from_utf8_lossy(&output.stderr));
        load(to)
    };
    for from in ["scene.ply", "scene.splat", "scene.spz"] {
        agree(&shapes(&raw), &shapes(&convert(from, "theirs.ply")), from);
    }
    for to in ["theirs.glb", "theirs.spz"] {
        agree(&shapes(&raw), &shapes(&convert("scene.ply", to)), to);
    }
    // Formats that keep the order of splats keep their colours from every side.
    assert!(harmonics(&load("scene.spz"), &raw) < 0.07);
    assert!(harmonics(&load("scene.glb"), &load("scene.ply")) < 1e-6);
    let (theirs, plain) = (load("theirs.glb"), convert("scene.ply", "theirs.ply"));
    assert!(harmonics(&theirs, &plain) < 1e-5, "{}", harmonics(&theirs, &plain));
}

#[test]
#[ignore = "needs Chromium and npm packages"]
fn spark_shows_the_same_scene() {
    let (Some(packages), Some(program)) = (packages(), chromium::find()) else { return };
    let dir = tempfile::tempdir().unwrap();
    let raw = exported(dir.path());
    std::fs::write(dir.path().join("page.html"), PAGE).unwrap();
    let address = serve(vec![dir.path().to_owned(), packages.join("node_modules")]);
    let mut browser = Chromium::start(&program);
    for extension in ["ply", "splat", "spz"] {
        browser.open(&format!("{address}/page.html?scene.{extension}"));
        browser.until("window.splats !== undefined");
        let rows = browser.eval("splats");
        let number = |v: &serde_json::Value| v.as_f64().unwrap() as f32;
        let found = rows.as_array().unwrap_or_else(|| panic!("{extension}: {rows}")).iter().map(|row| {
            let [x, y, z, sx, sy, sz, w, i, j, k] = std::array::from_fn(|at| number(&row[at]));
            shape([x, y, z], [w, i, j, k], [sx, sy, sz])
        });
        // Spark turns nothing: each file stands in its own axes.
        let own = if extension == "spz" { raw.clone().flipped([false, true, true]) } else { raw.clone() };
        agree(&shapes(&own), &found.collect::<Vec<Shape>>(), extension);
    }
}

/// Loads the scene that its address names, and keeps its splats as rows of numbers.
const PAGE: &str = r#"<!doctype html><script type="importmap">{"imports": {"three": "/three/build/three.module.js", "three/addons/": "/three/examples/jsm/"}}</script>
<script type="module">
import { SplatMesh } from "/@sparkjsdev/spark/dist/spark.module.js";
try {
  const mesh = new SplatMesh({ url: location.search.slice(1) });
  await mesh.initialized;
  const rows = [];
  mesh.forEachSplat((_, c, s, q) => rows.push([c.x, c.y, c.z, s.x, s.y, s.z, q.w, q.x, q.y, q.z]));
  window.splats = rows;
} catch (error) { window.splats = String(error); }
</script>"#;

/// Serves the files of folders on a free port of this machine until the process ends.
fn serve(folders: Vec<PathBuf>) -> String {
    let listener = TcpListener::bind("127.0.0.1:0").unwrap();
    let address = format!("http://{}", listener.local_addr().unwrap());
    std::thread::spawn(move || {
        for stream in listener.incoming().flatten() {
            let mut lines = BufReader::new(stream.try_clone().unwrap()).lines().map_while(Result::ok);
            let Some(first) = lines.next() else { continue };
            lines.take_while(|l| !l.is_empty()).for_each(drop);
            let path = first
                .split(' ')
                .nth(1)
                .unwrap_or("/")
                .split('?')
                .next()
                .unwrap_or("")
                .trim_start_matches('/')
                .to_owned();
            let bytes = folders.iter().find_map(|f| std::fs::read(f.join(&path)).ok());
            let kind = if path.ends_with("js") { "text/javascript" } else { "text/html" };
            let (status, body) = bytes.map_or(("404 Not Found", Vec::new()), |b| ("200 OK", b));
            let head = format!(
                "HTTP/1.1 {status}\r\nContent-Type: {kind}\r\nContent-Length: {}\r\nConnection: close\r\n\r\n",
                body.len()
            );
            let mut stream = stream;
            // The browser may have gone.
            let _ = stream.write_all(head.as_bytes()).and_then(|()| stream.write_all(&body));
        }
    });
    address
}
