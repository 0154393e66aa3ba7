//! The decoder in three levels: the `f64` reference against its own central differences, production against the
//! reference, and what must hold to the last bit.
//!
//! Tolerances (relative to the largest entry of the column or block, at least four times the worst seen):
//! | quantity | bound |
//! |---|---|
//! | reference's gradients, central differences | 1e-6 |
//! | splats | 5e-7 |
//! | gradients of anchors | 4e-6 |
//! | gradients of parameters | 4e-6 |

use crate::support::{EYE, assert_close, cotangent, cotangents, flat_anchor, wide};
use glam::Vec3;
use gs_anchor::reference::{AnchorRef, Blocks, DecoderRef, GaussianRef};
use gs_anchor::{AnchorShape, DecodeTape, Decoder, DecoderConfig, HeadInputs, LocalAnchors, LocalAnchorsGrad, Visible};
use gs_core::nn::BLOCK;
use gs_core::{Color, Kernel, Params, Rng, Splats};

const SHAPE: AnchorShape = AnchorShape { offsets: 4, features: 8, dynamics: 0 };

/// Every input option on and off.
fn configs() -> Vec<DecoderConfig> {
    let plain = DecoderConfig { appearance: 3, ..DecoderConfig::default() };
    let color = HeadInputs { color: true, ..HeadInputs::NONE };
    vec![
        plain.clone(),
        DecoderConfig { appearance: 0, ..plain.clone() },
        DecoderConfig { distance: color, ..plain.clone() },
        DecoderConfig { distance: HeadInputs::ALL, feature_bank: true, ..plain.clone() },
        DecoderConfig { direction: color, distance: HeadInputs::ALL, ..plain.clone() },
        DecoderConfig { direction: HeadInputs::NONE, ..plain.clone() },
        DecoderConfig { feature_bank: true, ..plain },
    ]
}

fn decoder(config: &DecoderConfig) -> Decoder {
    Decoder::new(config, SHAPE, 5).unwrap()
}

/// `n` random anchors around the origin; every fourth has a negative extent, every fifth a negative spread.
fn anchors(n: usize, k: usize, c: usize) -> LocalAnchors {
    let mut local = LocalAnchors::default();
    for v in 0..n {
        let mut rng = Rng::new(11, "anchors", 0, v as u64);
        let mut values = |n: usize, scale: f32| (0..n).map(|_| scale * rng.normal()).collect::<Vec<f32>>();
        local.positions.push(Vec3::from_slice(&values(3, 0.5)));
        local.offsets.extend(values(3 * k, 1.0));
        local.features.extend(values(c, 1.0));
        let mut scales: Vec<f32> = values(6, 0.5).iter().map(|s| 0.1 * s.exp()).collect();
        scales[3 + v % 3] *= if v % 4 == 1 { -1.0 } else { 1.0 };
        scales[v % 3] *= if v % 5 == 2 { -1.0 } else { 1.0 };
        local.scales.extend(scales);
    }
    local
}

fn flat(g: &GaussianRef) -> Vec<f64> {
    [&[g.activation][..], &g.mean, &g.scale, &g.quat, &g.color].concat()
}

/// `Σ cotangent · Gaussian` over the Gaussians of anchor `v` that exist.
fn loss(reference: &DecoderRef, anchor: &AnchorRef, v: usize) -> f64 {
    let gaussians = reference.decode(anchor, EYE.to_array());
    let kept = gaussians.iter().enumerate().filter(|(_, g)| g.activation > 0.0);
    let dot = |(j, g)| flat(g).iter().zip(flat(&cotangent(v * SHAPE.offsets + j))).map(|(a, b)| a * b).sum::<f64>();
    kept.map(dot).sum()
}

/// The slot of an anchor that [`flat_anchor`] puts at `i`.
fn slot(a: &mut AnchorRef, i: usize) -> &mut f64 {
    let (k, c) = (a.offsets.len(), a.features.len());
    match i {
        0..3 => &mut a.position[i],
        _ if i < 3 + k => &mut a.offsets[i - 3],
        _ if i < 3 + k + c => &mut a.features[i - 3 - k],
        _ => &mut a.scales[i - 3 - k - c],
    }
}

const STEP: f64 = 1e-5;

#[test]
fn the_references_gradients_are_its_central_differences() {
    for config in configs() {
        let (mut reference, local) = (DecoderRef::new(&decoder(&config)), anchors(3, SHAPE.offsets, SHAPE.features));
        let all: Vec<AnchorRef> = (0..3).map(|v| AnchorRef::new(&local, v)).collect();
        let mut grads: Blocks = reference.blocks.iter().map(|(n, b)| (n.clone(), vec![0.0; b.len()])).collect();
        for (v, anchor) in all.iter().enumerate() {
            let d: Vec<_> = (0..SHAPE.offsets).map(|j| cotangent(v * SHAPE.offsets + j)).collect();
            let got = flat_anchor(&reference.backward(anchor, EYE.to_array(), &d, &mut grads));
            let want: Vec<f64> = (0..got.len())
                .map(|i| {
                    let (mut hi, mut lo) = (anchor.clone(), anchor.clone());
                    *slot(&mut hi, i) += STEP;
                    *slot(&mut lo, i) -= STEP;
                    (loss(&reference, &hi, v) - loss(&reference, &lo, v)) / (2.0 * STEP)
                })
                .collect();
            assert_close(&got, &want, 1e-6, &format!("{config:?}: anchor {v}"));
        }
        let total = |reference: &DecoderRef| all.iter().enumerate().map(|(v, a)| loss(reference, a, v)).sum::<f64>();
        for (name, got) in &grads {
            let mut want = vec![0.0; got.len()];
            for (i, want) in want.iter_mut().enumerate() {
                let mut at = |by: f64| {
                    reference.blocks.get_mut(name).unwrap()[i] += by;
                    let value = total(&reference);
                    reference.blocks.get_mut(name).unwrap()[i] -= by;
                    value
                };
                *want = (at(STEP) - at(-STEP)) / (2.0 * STEP);
            }
            assert_close(got, &want, 1e-6, &format!("{config:?}: {name}"));
        }
    }
}

#[test]
fn production_agrees_with_the_reference() {
    for config in configs() {
        for n in [3, 300] {
            let (mut decoder, local) = (decoder(&config), anchors(n, SHAPE.offsets, SHAPE.features));
            let (reference, mut tape, mut out) = (DecoderRef::new(&decoder), DecodeTape::default(), Splats::default());
            decoder.forward(&local, Visible::All, EYE, &mut tape, &mut out);
            let d_out = cotangents(&tape.rows, &out);
            let mut d = LocalAnchorsGrad::default();
            d.reset(&local);
            decoder.backward(&local, &mut tape, &d_out, &mut d);

            let (mut rows, mut want, mut back) = (Vec::new(), Vec::new(), Vec::new());
            let mut grads: Blocks = reference.blocks.iter().map(|(n, b)| (n.clone(), vec![0.0; b.len()])).collect();
            for v in 0..n {
                let anchor = AnchorRef::new(&local, v);
                for (j, g) in reference.decode(&anchor, EYE.to_array()).iter().enumerate() {
                    if g.activation > 0.0 {
                        rows.push((v * SHAPE.offsets + j) as u32);
                        want.push(flat(g));
                    }
                }
                let d: Vec<_> = (0..SHAPE.offsets).map(|j| cotangent(v * SHAPE.offsets + j)).collect();
                back.push(flat_anchor(&reference.backward(&anchor, EYE.to_array(), &d, &mut grads)));
            }
            assert_eq!(tape.rows, rows);
            assert!(!rows.is_empty() && rows.len() < 4 * n, "some exist, some do not");
            assert_eq!((out.check(), &out.kernel), (Ok(()), &Kernel::Gaussian));
            assert_close(&splat_columns(&out), &want.concat(), 5e-7, "splats");
            for (v, want) in back.iter().enumerate() {
                assert_close(&local_row(&d, v), want, 4e-6, &format!("{config:?}: anchor {v} of {n}"));
            }
            decoder.visit(&mut |p| {
                assert_close(&wide(&p.grad), &grads[&p.name], 4e-6, &format!("{config:?}: {} at {n}", p.name));
            });
        }
    }
}

/// Rows as [`flat`] lays them out.
fn splat_columns(s: &Splats) -> Vec<f64> {
    let row = |n: usize| -> Vec<f32> {
        let (mean, scale) = (s.means[n].to_array(), s.scales[n].to_array());
        [&[s.opacities[n]][..], &mean, &scale, &s.quats[n], &s.color.as_flat()[3 * n..][..3]].concat()
    };
    (0..s.len()).flat_map(|n| wide(&row(n))).collect()
}

/// Row `v` as [`flat_anchor`] lays it out.
fn local_row(d: &LocalAnchorsGrad, v: usize) -> Vec<f64> {
    let (k, c) = (3 * SHAPE.offsets, SHAPE.features);
    let position = d.positions[v].to_array();
    wide(&[&position[..], &d.offsets[v * k..][..k], &d.features[v * c..][..c], &d.scales[v * 6..][..6]].concat())
}

/// Everything a step produces, bit by bit.
fn step(decoder: &mut Decoder, local: &LocalAnchors, visible: Visible<'_>, tape: &mut DecodeTape) -> Vec<u32> {
    let (mut out, mut d) = (Splats::default(), LocalAnchorsGrad::default());
    decoder.clear_grads();
    decoder.forward(local, visible, EYE, tape, &mut out);
    d.reset(local);
    decoder.backward(local, tape, &cotangents(&tape.rows, &out), &mut d);
    let mut all: Vec<f32> = splat_columns(&out).iter().map(|v| *v as f32).collect();
    all.extend(d.positions.iter().flat_map(|p| p.to_array()));
    all.extend([&d.offsets[..], &d.features, &d.scales, &tape.activations].concat());
    decoder.visit(&mut |p| all.extend(&p.grad));
    all.iter().map(|v| v.to_bits()).chain(tape.rows.iter().copied()).collect()
}

#[test]
fn threads_and_warm_tapes_change_no_bit() {
    for config in configs() {
        // More blocks than chunks, and a ragged end.
        let local = anchors(9 * BLOCK + 17, SHAPE.offsets, SHAPE.features);
        let list: Vec<u32> = (0..local.len() as u32).filter(|v| v % 7 != 3).collect();
        for visible in [Visible::All, Visible::List(&list)] {
            let on = |threads: usize| {
                let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
                pool.install(|| step(&mut decoder(&config), &local, visible, &mut DecodeTape::default()))
            };
            let one = on(1);
            assert!(one == on(2) && one == on(4), "results depend on the number of threads");
            let mut tape = DecodeTape::default();
            for n in [local.len() + 300, 0, 1, BLOCK, BLOCK + 1] {
                let other = anchors(n, SHAPE.offsets, SHAPE.features);
                let fresh = step(&mut decoder(&config), &other, Visible::All, &mut DecodeTape::default());
                assert!(step(&mut decoder(&config), &other, Visible::All, &mut tape) == fresh, "{n} anchors");
            }
            assert!(step(&mut decoder(&config), &local, visible, &mut tape) == one, "a warm tape changes the result");
        }
    }
}

/// Leaving anchors out changes nothing of the others, and they receive nothing.
#[test]
fn a_list_decodes_its_anchors_as_all_does() {
    let (mut decoder, local) = (decoder(&configs()[3]), anchors(700, SHAPE.offsets, SHAPE.features));
    let list: Vec<u32> = (100..650).step_by(3).collect();
    let (mut all, mut some) = (Splats::default(), Splats::default());
    let (mut tape, mut d) = (DecodeTape::default(), LocalAnchorsGrad::default());
    decoder.forward(&local, Visible::All, EYE, &mut tape, &mut all);
    let rows: Vec<usize> = (0..all.len()).filter(|&n| list.contains(&(tape.rows[n] / SHAPE.offsets as u32))).collect();
    decoder.forward(&local, Visible::List(&list), EYE, &mut tape, &mut some);
    assert_eq!((&tape.visible, some.len()), (&list, rows.len()));
    let columns = splat_columns(&all);
    let picked: Vec<f64> = rows.iter().flat_map(|&n| columns[14 * n..][..14].to_vec()).collect();
    assert_close(&splat_columns(&some), &picked, 1e-6, "splats");
    d.reset(&local);
    let d_out = cotangents(&tape.rows, &some);
    decoder.backward(&local, &mut tape, &d_out, &mut d);
    for v in 0..700 {
        let touched = local_row(&d, v).iter().any(|g| *g != 0.0);
        assert!(list.contains(&(v as u32)) || !touched, "anchor {v} was not decoded");
    }
}

#[test]
fn a_folded_appearance_gives_the_same_bits() {
    for config in configs() {
        let (decoder, local) = (decoder(&config), anchors(BLOCK + 40, SHAPE.offsets, SHAPE.features));
        let folded = decoder.folded();
        assert_eq!(folded.config().appearance, 0);
        assert_eq!(decoder.param_count() - folded.param_count(), config.appearance * (1 + SHAPE.features));
        let (mut a, mut b) = (Splats::default(), Splats::default());
        decoder.forward(&local, Visible::All, EYE, &mut DecodeTape::default(), &mut a);
        folded.forward(&local, Visible::All, EYE, &mut DecodeTape::default(), &mut b);
        assert!(a == b, "{config:?}");
    }
}

#[test]
fn an_anchor_at_the_eye_is_dropped() {
    let (mut decoder, mut local) = (decoder(&configs()[3]), anchors(5, SHAPE.offsets, SHAPE.features));
    local.positions[2] = Vec3::new(0.25, -0.5, 1.0);
    local.positions[3] = local.positions[2] + Vec3::new(2e-6, 0.0, 0.0);
    let eye = local.positions[2].as_dvec3();
    let (mut tape, mut out, mut d) = (DecodeTape::default(), Splats::default(), LocalAnchorsGrad::default());
    decoder.forward(&local, Visible::All, eye, &mut tape, &mut out);
    assert_eq!(tape.visible, [0, 1, 3, 4]);
    assert_eq!(out.check(), Ok(()));
    d.reset(&local);
    let d_out = cotangents(&tape.rows, &out);
    decoder.backward(&local, &mut tape, &d_out, &mut d);
    assert!((0..5).all(|v| local_row(&d, v).iter().all(|g| g.is_finite())));
    assert!(local_row(&d, 2).iter().all(|g| *g == 0.0));
}

#[test]
fn extreme_anchors_give_finite_splats_and_gradients() {
    let mut decoder = decoder(&configs()[0]);
    // No rotation at all, and opacities that saturate.
    decoder.visit_mut(&mut |p| match p.name.as_str() {
        "heads.covariance.1.weight" | "heads.covariance.1.bias" => p.value.fill(0.0),
        "heads.opacity.1.bias" => p.value.copy_from_slice(&[100.0, -100.0, 0.5, 0.0]),
        "heads.opacity.1.weight" => p.value.fill(0.0),
        _ => {}
    });
    let mut local = anchors(4, SHAPE.offsets, SHAPE.features);
    for (v, l) in [0.0, -1e-30, 1e15, -1e15].into_iter().enumerate() {
        local.scales[6 * v..][..6].fill(l);
    }
    let (mut tape, mut out, mut d) = (DecodeTape::default(), Splats::default(), LocalAnchorsGrad::default());
    decoder.forward(&local, Visible::All, EYE, &mut tape, &mut out);
    assert_eq!(out.check(), Ok(()));
    let kept: Vec<u32> = (0..4).flat_map(|v| [4 * v, 4 * v + 2]).collect();
    assert_eq!(tape.rows, kept, "saturated, and exactly zero is dropped");
    assert_eq!((out.opacities[0], out.quats[0]), (1.0, [0.0; 4]));
    assert!(out.scales.iter().all(|s| s.min_element() >= 0.0));
    let Color::Rgb(_) = out.color else { panic!("plain colours") };
    d.reset(&local);
    let d_out = cotangents(&tape.rows, &out);
    decoder.backward(&local, &mut tape, &d_out, &mut d);
    assert!((0..4).all(|v| local_row(&d, v).iter().all(|g| g.is_finite())));
    decoder.visit(&mut |p| assert!(p.grad.iter().all(|g| g.is_finite()), "{}", p.name));
}

#[test]
fn gradients_are_added_not_overwritten() {
    let (mut decoder, local) = (decoder(&configs()[3]), anchors(40, SHAPE.offsets, SHAPE.features));
    let (mut tape, mut out, mut d) = (DecodeTape::default(), Splats::default(), LocalAnchorsGrad::default());
    decoder.forward(&local, Visible::All, EYE, &mut tape, &mut out);
    let d_out = cotangents(&tape.rows, &out);
    d.reset(&local);
    let mut totals = Vec::new();
    for _ in 0..2 {
        decoder.backward(&local, &mut tape, &d_out, &mut d);
        let mut all: Vec<f64> = (0..40).flat_map(|v| local_row(&d, v)).collect();
        decoder.visit(&mut |p| all.extend(wide(&p.grad)));
        totals.push(all);
    }
    let twice: Vec<f64> = totals[0].iter().map(|g| 2.0 * g).collect();
    assert_close(&totals[1], &twice, 1e-6, "twice");
}

#[test]
fn names_counts_and_refusals() {
    let shape = AnchorShape { offsets: 10, features: 32, dynamics: 2 };
    let published = Decoder::new(&DecoderConfig::default(), shape, 1).unwrap();
    let mut names = Vec::new();
    published.visit(&mut |p| names.push(p.name.clone()));
    let layers = ["opacity.0", "opacity.1", "color.0", "color.1", "covariance.0", "covariance.1"];
    let mut want: Vec<String> =
        layers.iter().flat_map(|l| ["weight", "bias"].map(|p| format!("heads.{l}.{p}"))).collect();
    want.push("heads.appearance".into());
    assert_eq!(names, want);
    let count = |inputs: usize, outputs: usize| (inputs + 1) * 32 + 33 * outputs;
    assert_eq!(published.param_count(), count(35, 10) + count(51, 30) + count(35, 70) + 16);
    let error = |config: &DecoderConfig, shape| Decoder::new(config, shape, 1).unwrap_err().field;
    assert_eq!(error(&DecoderConfig::default(), AnchorShape { offsets: 0, ..shape }), "offsets");
    let bank = DecoderConfig { feature_bank: true, ..DecoderConfig::default() };
    assert_eq!(error(&bank, AnchorShape { features: 30, ..shape }), "features");
}
