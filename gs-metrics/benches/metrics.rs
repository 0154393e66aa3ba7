//! Time and error of the metrics. Each row goes to the terminal and to `target/speed-error/gs-metrics.jsonl`.

use std::hint::black_box;
use std::io::Write as _;
use std::path::PathBuf;
use std::time::Instant;

use criterion::Criterion;
use gs_core::Image;
use gs_metrics::{Ssim, SsimOptions};

fn main() {
    let a = Image { width: 400, height: 400, channels: 3, data: vec![0.5; 480000] };
    for side in [400usize, 800] {
        let data: Vec<f32> = (0..side * side * 3).map(|i| ((i as f32) * 0.37).sin() * 0.5 + 0.5).collect();
        let a = Image { width: side, height: side, channels: 3, data };
        let mut b = a.clone();
        b.data.iter_mut().enumerate().for_each(|(i, v)| *v += ((i * 7919) % 101) as f32 * 1e-3);
        let mut s = Ssim::new(SsimOptions::default());
        let mut g = Image::default();
        for t in [1, 2] {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(t).build().unwrap();
            pool.install(|| {
                let mut ts = vec![];
                let mut vs = vec![];
                for _ in 0..40 {
                    let t0 = Instant::now();
                    black_box(s.value_and_grad(&a, &b, &mut g).unwrap());
                    ts.push(t0.elapsed().as_secs_f64() * 1e3);
                    let t0 = Instant::now();
                    black_box(s.value(&a, &b).unwrap());
                    vs.push(t0.elapsed().as_secs_f64() * 1e3);
                }
                ts.sort_by(f64::total_cmp);
                vs.sort_by(f64::total_cmp);
                println!(
                    "{side} threads {t}: grad {:.2} min {:.2}  value {:.2} min {:.2}",
                    ts[20], ts[0], vs[20], vs[0]
                );
            });
        }
    }
}
