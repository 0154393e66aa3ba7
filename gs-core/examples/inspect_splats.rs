//! Prints what a splat file holds: counts, quantiles of each column, needles, rows that are not finite.
//!
//! ```text
//! cargo run --release -p gs-core --example inspect_splats -- scene.ply
//! ```
//! Reads `.ply`, `.splat` and `.spz`; without an argument a generated cloud is inspected.

use glam::Vec3;
use gs_core::Rng;
use gs_core::io::{IoError, Limits, RawSplats, load_splats, sigmoid};
use std::path::Path;
use std::process::ExitCode;

/// Longest axis over shortest above which a splat counts as a needle.
const NEEDLE_ASPECT: f32 = 100.0;

fn main() -> ExitCode {
    let (name, splats) = match std::env::args_os().nth(1) {
        Some(path) => match load(Path::new(&path)) {
            Ok(splats) => (path.to_string_lossy().into_owned(), splats),
            Err(error) => {
                eprintln!("error: {error}");
                return ExitCode::FAILURE;
            }
        },
        None => ("generated cloud".to_owned(), generated(10_000)),
    };
    println!("{name}: {} splats, SH degree {}", splats.len(), splats.degree);
    report(&splats);
    ExitCode::SUCCESS
}

/// Values that are not finite are kept, so that they can be reported.
fn load(path: &Path) -> Result<RawSplats, IoError> {
    load_splats(path, &Limits { allow_non_finite: true, ..Limits::default() })
}

/// Log-normal sizes, random rotations, and one broken row to find.
fn generated(n: usize) -> RawSplats {
    let mut out = RawSplats { degree: 1, ..RawSplats::default() };
    for row in 0..n {
        let mut r = Rng::new(3, "inspect", 0, row as u64);
        let mut three = |scale: f32, shift: f32| Vec3::from_array([(); 3].map(|()| shift + scale * r.normal()));
        out.means.push(three(1.0, 0.0));
        out.log_scales.push(three(1.5, -4.0));
        out.quats.push([r.normal(), r.normal(), r.normal(), r.normal()]);
        out.logit_opacities.push(1.8 * r.normal());
        out.sh.extend((0..12).map(|_| 0.3 * r.normal()));
    }
    if let Some(mean) = out.means.get_mut(n / 2) {
        mean.y = f32::NAN;
    }
    out
}

fn report(splats: &RawSplats) {
    println!("{:16} {:>12} {:>12} {:>12} {:>12} {:>12}", "column", "min", "1 %", "median", "99 %", "max");
    for (axis, name) in ["x", "y", "z"].iter().enumerate() {
        range(name, splats.means.iter().map(|m| m[axis]));
    }
    range("scale", splats.log_scales.iter().flat_map(|s| s.to_array()).map(f32::exp));
    range("aspect", splats.log_scales.iter().map(aspect));
    range("opacity", splats.logit_opacities.iter().map(|&o| sigmoid(o)));
    range("|quat|", splats.quats.iter().map(|q| q.iter().map(|v| v * v).sum::<f32>().sqrt()));
    range("sh dc", splats.sh.chunks_exact(splats.sh_width()).flat_map(|row| row[..3].to_vec()));
    range("sh rest", splats.sh.chunks_exact(splats.sh_width()).flat_map(|row| row[3..].to_vec()));
    let count =
        |what: &str, n: usize| println!("{what:44} {n:9}  ({:.2} %)", 100.0 * n as f64 / splats.len().max(1) as f64);
    count(
        &format!("needles (aspect above {NEEDLE_ASPECT})"),
        splats.log_scales.iter().filter(|s| aspect(s) > NEEDLE_ASPECT).count(),
    );
    count(
        "opacity below 1/255 (never rendered)",
        splats.logit_opacities.iter().filter(|&&o| sigmoid(o) < 1.0 / 255.0).count(),
    );
    count("zero quaternions (rendered unrotated)", splats.quats.iter().filter(|q| **q == [0.0; 4]).count());
    let bad = splats.non_finite_rows();
    count("rows with a value that is not finite", bad.len());
    for (row, column) in bad.iter().take(10) {
        println!("  row {row}: {column}");
    }
}

/// Longest axis over shortest.
fn aspect(log_scale: &Vec3) -> f32 {
    (log_scale.max_element() - log_scale.min_element()).exp()
}

/// One line of quantiles over the finite values.
fn range(name: &str, values: impl Iterator<Item = f32>) {
    let mut v: Vec<f32> = values.filter(|v| v.is_finite()).collect();
    v.sort_unstable_by(f32::total_cmp);
    let at = |q: f64| v.get((q * v.len().saturating_sub(1) as f64).round() as usize).copied();
    let line: String =
        [0.0, 0.01, 0.5, 0.99, 1.0].iter().filter_map(|&q| at(q)).map(|v| format!(" {v:12.5}")).collect();
    println!("{name:16}{line}");
}
