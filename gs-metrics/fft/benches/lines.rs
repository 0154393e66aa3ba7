//! Time and error of transforms of real lines.

use criterion::{BenchmarkId, Criterion, criterion_group, criterion_main};

fn lines(criterion: &mut Criterion) {
    let mut group = criterion.benchmark_group("real line, f32");
    for n in [400, 800, 809, 1014] {
        let line: Vec<f32> = (0..n).map(|x| (1.3 * x as f32).sin()).collect();
        let (plan, exact) = (gs_fft::real_forward(n), gs_fft::real_forward_f64(n));
        let (mut spectrum, mut want) = (plan.make_output_vec(), exact.make_output_vec());
        plan.process(&mut line.clone(), &mut spectrum).unwrap();
        exact.process(&mut line.iter().map(|v| f64::from(*v)).collect::<Vec<_>>(), &mut want).unwrap();
        let squares = spectrum
            .iter()
            .zip(&want)
            .map(|(a, b)| (f64::from(a.re) - b.re).powi(2) + (f64::from(a.im) - b.im).powi(2));
        let norm: f64 = want.iter().map(|v| v.norm_sqr()).sum();
        println!("{n}: relative L2 error against f64 {:.1e}", (squares.sum::<f64>() / norm).sqrt());
        group.bench_function(BenchmarkId::from_parameter(n), |b| {
            let mut buffer = line.clone();
            b.iter(|| {
                buffer.copy_from_slice(&line);
                plan.process(&mut buffer, &mut spectrum)
            });
        });
    }
    group.finish();
}

criterion_group!(benches, lines);
criterion_main!(benches);
