//! Anchor deformation in three levels: the `f64` reference against its own central differences, production against the
//! reference (alone, and with the decoder behind it), and what must hold to the last bit.
//!
//! Tolerances (relative to the largest entry of the column or block, at least four times the worst seen):
//! | quantity | bound |
//! |---|---|
//! | reference's gradients, central differences | 1e-6 |
//! | moved anchors | 5e-7 |
//! | gradients of anchors, of planes and networks | 4e-6 |
//! | penalty on changes | 4e-6 |

use crate::support::{EYE, assert_close, cotangent, cotangents, flat_anchor, wide};
use glam::Vec3;
use gs_anchor::gad::{Activation, Dynamics, Factor};
use gs_anchor::reference::{AnchorRef, Blocks, DecoderRef, GadRef, GaussianRef, RestRef};
use gs_anchor::{AnchorShape, Anchors, DecodeTape, Decoder, DecoderConfig, Gad, GadConfig, GadHead, GadTape};
use gs_anchor::{LocalAnchors, LocalAnchorsGrad, Visible};
use gs_core::nn::BLOCK;
use gs_core::{Params, Rng, Splats, Time};
use gs_deform::encode::HexPlaneConfig;
use gs_deform::reference::PlaneNetRefGrad;
use gs_deform::{Aabb, DeformError, PlaneNetConfig};

const T: Time = Time { normalised: 0.3, seconds: 0.3 };

fn shape(dynamics: usize) -> AnchorShape {
    AnchorShape { offsets: 4, features: 8, dynamics }
}

fn small() -> GadConfig {
    let hexplane = HexPlaneConfig { resolution: [4, 5, 3, 6], levels: vec![1], channels: 16, ..Default::default() };
    let net = PlaneNetConfig { width: 12, depth: 1, zero_init: false, hexplane };
    GadConfig { net, ..GadConfig::default() }
}

/// Number of logits and settings: every factor, activation and subset of heads at least once.
fn cases() -> Vec<(usize, GadConfig)> {
    let with = |global, local, activation| GadConfig {
        dynamics: Dynamics { global, local, activation, ..Dynamics::default() },
        ..small()
    };
    let few = |heads: &[GadHead]| GadConfig { heads: heads.to_vec(), ..small() };
    vec![
        (2, small()),
        (1, small()),
        (0, small()),
        (2, with(Factor::Mul, Factor::Mask, Activation::Sigmoid)),
        (2, with(Factor::Mul, Factor::Mul, Activation::Tanh)),
        (1, with(Factor::Mul, Factor::Mul, Activation::Relu)),
        (2, few(&[GadHead::Positions])),
        (2, few(&[GadHead::Scales, GadHead::Features])),
        (2, penalised(small())),
        (1, penalised(with(Factor::Mul, Factor::Mask, Activation::Tanh))),
        (2, penalised(few(&[GadHead::Scales, GadHead::Features]))),
    ]
}

/// With a penalty on changes, of the size of the cotangents.
fn penalised(config: GadConfig) -> GadConfig {
    GadConfig { change_l2: 30.0, ..config }
}

/// Random anchors, some of them outside the box, every sixth with its masks closed.
fn anchors(n: usize, dynamics: usize) -> Anchors {
    let draw = |v: usize| Rng::new(21, "anchors", 0, v as u64);
    let place = |v: usize| {
        let mut rng = draw(v);
        Vec3::new(rng.range(-1.2, 1.2), rng.range(-1.2, 1.2), rng.range(-1.2, 1.2))
    };
    let positions: Vec<Vec3> = (0..n).map(place).collect();
    let mut anchors = Anchors::new(shape(dynamics), &positions, &vec![-1.5; n]);
    for v in 0..n {
        let mut rng = Rng::new(22, "anchors", 0, v as u64);
        let row = |p: &mut gs_core::Param, scale: f32, rng: &mut Rng| {
            let width = p.row_width.unwrap_or(1);
            p.value[v * width..][..width].iter_mut().for_each(|x| *x += scale * rng.normal());
        };
        row(&mut anchors.offsets, 1.0, &mut rng);
        row(&mut anchors.features, 1.0, &mut rng);
        row(&mut anchors.log_scales, 0.5, &mut rng);
        if let Some(p) = &mut anchors.dynamics {
            row(p, 1.0, &mut rng);
            p.value[v * dynamics..][..dynamics].iter_mut().for_each(|d| *d -= if v % 6 == 2 { 8.0 } else { 0.0 });
        }
    }
    anchors
}

/// A field whose time planes are not constant, as after training.
fn gad(config: &GadConfig, dynamics: usize) -> Gad {
    let mut gad = Gad::new(config, shape(dynamics), Aabb::cube(1.0), 3).unwrap();
    gad.visit_mut(&mut |p| {
        let mut rng = Rng::new(25, &p.name, 0, 0);
        if p.name.starts_with("gad.planes.") {
            p.value.iter_mut().for_each(|v| *v += 0.2 * rng.normal());
        }
    });
    gad
}

fn local_cotangents(n: usize) -> LocalAnchorsGrad {
    let mut d = LocalAnchorsGrad::default();
    for v in 0..n {
        let mut rng = Rng::new(23, "cotangents", 0, v as u64);
        let mut values = |n: usize| (0..n).map(|_| rng.normal()).collect::<Vec<f32>>();
        d.positions.push(Vec3::from_slice(&values(3)));
        d.offsets.extend(values(12));
        d.features.extend(values(8));
        d.scales.extend(values(6));
    }
    d
}

/// Row `v` of cotangents in `f64`.
fn local_cotangent(d: &LocalAnchorsGrad, v: usize) -> AnchorRef {
    AnchorRef {
        position: d.positions[v].as_dvec3().to_array(),
        offsets: wide(&d.offsets[12 * v..][..12]),
        features: wide(&d.features[8 * v..][..8]),
        scales: std::array::from_fn(|i| f64::from(d.scales[6 * v + i])),
    }
}

fn dot(a: &AnchorRef, b: &AnchorRef) -> f64 {
    flat_anchor(a).iter().zip(flat_anchor(b)).map(|(a, b)| a * b).sum()
}

/// What the reference's backward is the gradient of.
fn loss(reference: &GadRef, rest: &RestRef, d: &AnchorRef) -> f64 {
    dot(&reference.moved(rest, T), d) + reference.change_weight * reference.squared_change(rest, T)
}

const STEP: f64 = 1e-5;

/// Central differences of `loss` along the values that `slots` finds in a copy of `at`.
fn differences<A: Clone>(at: &A, slots: impl Fn(&mut A) -> Vec<&mut f64>, loss: impl Fn(&A) -> f64) -> Vec<f64> {
    let n = slots(&mut at.clone()).len();
    let moved = |i: usize, by: f64| {
        let mut to = at.clone();
        *slots(&mut to).swap_remove(i) += by;
        loss(&to)
    };
    (0..n).map(|i| (moved(i, STEP) - moved(i, -STEP)) / (2.0 * STEP)).collect()
}

/// The trained values of an anchor; its position is a constant to the net.
fn rest_slots(r: &mut RestRef) -> Vec<&mut f64> {
    let RestRef { anchor: AnchorRef { offsets, features, scales, .. }, logits } = r;
    offsets.iter_mut().chain(features).chain(scales).chain(logits).collect()
}

#[test]
fn the_references_gradients_are_its_central_differences() {
    for (dynamics, config) in cases() {
        let mut reference = GadRef::new(&gad(&config, dynamics));
        reference.surrogate = true;
        (reference.change_weight, reference.scale_unit) = (f64::from(config.change_l2), 0.2);
        let (all, d) = (anchors(3, dynamics), local_cotangents(3));
        let rest: Vec<RestRef> = (0..3).map(|v| RestRef::new(&all, v)).collect();
        let mut grad = reference.net.zero_grad();
        for (v, rest) in rest.iter().enumerate() {
            let d = local_cotangent(&d, v);
            let got = reference.backward(rest, T, &d, &mut grad);
            assert_eq!(got.anchor.position, d.position, "the position is a constant to the net");
            let want = differences(rest, rest_slots, |r| loss(&reference, r, &d));
            let got = [&got.anchor.offsets[..], &got.anchor.features, &got.anchor.scales, &got.logits].concat();
            assert_close(&got, &want, 1e-6, &format!("{config:?}: anchor {v}"));
        }
        let total =
            |reference: &GadRef| (0..3).map(|v| loss(reference, &rest[v], &local_cotangent(&d, v))).sum::<f64>();
        for (p, got) in grad.planes.iter().enumerate() {
            let want = differences(&reference, |t| t.net.hexplane.planes[p].iter_mut().collect(), total);
            assert_close(got, &want, 1e-6, &format!("plane {p}"));
        }
        for (name, got) in &grad.layers {
            let want = differences(&reference, |t| t.net.layers.get_mut(name).unwrap().iter_mut().collect(), total);
            assert_close(got, &want, 1e-6, name);
        }
    }
}

/// Gradients of planes and layers of production against those of the reference.
fn assert_net_close(gad: &Gad, want: &PlaneNetRefGrad, what: &str) {
    let mut planes = want.planes.iter();
    gad.visit(&mut |p| match p.name.strip_prefix("gad.planes.") {
        Some(_) => assert_close(&wide(&p.grad), planes.next().unwrap(), 4e-6, &p.name),
        None => {
            let short = &p.name["gad.".len()..];
            assert_close(&wide(&p.grad), &want.layers[short], 4e-6, &format!("{what}: {short}"));
        }
    });
}

/// Gradients of production's anchors against those of the reference.
fn assert_anchors_close(anchors: &Anchors, want: &[RestRef], what: &str) {
    let close = |p: &gs_core::Param, row: &dyn Fn(&RestRef) -> Vec<f64>| {
        let want: Vec<f64> = want.iter().flat_map(row).collect();
        assert_close(&wide(&p.grad), &want, 4e-6, &format!("{what}: {}", p.name));
    };
    close(&anchors.positions, &|r| r.anchor.position.to_vec());
    close(&anchors.offsets, &|r| r.anchor.offsets.clone());
    close(&anchors.features, &|r| r.anchor.features.clone());
    close(&anchors.log_scales, &|r| r.anchor.scales.to_vec());
    if let Some(p) = &anchors.dynamics {
        close(p, &|r| r.logits.clone());
    }
}

/// Of the penalty on changes in a step.
const SHARE: f32 = 0.5;

#[test]
fn production_agrees_with_the_reference() {
    for (dynamics, config) in cases() {
        for n in [3, BLOCK + 20] {
            let (mut gad, mut anchors, d) = (gad(&config, dynamics), anchors(n, dynamics), local_cotangents(n));
            let (mut reference, mut tape, mut out) = (GadRef::new(&gad), GadTape::default(), LocalAnchors::default());
            reference.change_weight = f64::from(config.change_l2 * SHARE) / n as f64;
            reference.scale_unit = (wide(&anchors.log_scales.value).iter().sum::<f64>() / (6 * n) as f64).exp();
            gad.forward(&anchors, T, &mut tape, &mut out);
            let penalty = f64::from(gad.backward(&mut anchors, &mut tape, &d, SHARE));
            let mut grad = reference.net.zero_grad();
            let (mut back, mut changes) = (Vec::new(), 0.0);
            for v in 0..n {
                let rest = RestRef::new(&anchors, v);
                let what = format!("{config:?}: anchor {v} of {n}");
                assert_close(
                    &flat_anchor(&AnchorRef::new(&out, v)),
                    &flat_anchor(&reference.moved(&rest, T)),
                    5e-7,
                    &what,
                );
                back.push(reference.backward(&rest, T, &local_cotangent(&d, v), &mut grad));
                changes += reference.change_weight * reference.squared_change(&rest, T);
            }
            assert!((penalty - changes).abs() <= 4e-6 * changes, "{config:?} at {n}: {penalty} {changes}");
            assert_eq!(penalty > 0.0, config.change_l2 > 0.0);
            assert_anchors_close(&anchors, &back, &format!("{config:?} at {n}"));
            assert_net_close(&gad, &grad, &format!("{config:?} at {n}"));
        }
    }
}

/// From the canonical anchors to Gaussians, forward and backward through both stages: three anchors of four Gaussians.
#[test]
fn both_stages_agree_with_the_reference() {
    let config = DecoderConfig { appearance: 3, ..DecoderConfig::default() };
    let mut decoder = Decoder::new(&config, shape(2), 5).unwrap();
    let (mut gad, mut anchors) = (gad(&small(), 2), anchors(3, 2));
    let (reference, decoder_reference) = (GadRef::new(&gad), DecoderRef::new(&decoder));
    let (mut tape, mut decode, mut local, mut out, mut d) = Default::default();
    gad.forward(&anchors, T, &mut tape, &mut local);
    decoder.forward(&local, Visible::All, EYE, &mut decode, &mut out);
    let d_out = cotangents(&decode.rows, &out);
    LocalAnchorsGrad::reset(&mut d, &local);
    decoder.backward(&local, &mut decode, &d_out, &mut d);
    gad.backward(&mut anchors, &mut tape, &d, SHARE);

    let mut grad = reference.net.zero_grad();
    let mut heads: Blocks = decoder_reference.blocks.iter().map(|(n, b)| (n.clone(), vec![0.0; b.len()])).collect();
    let eye = EYE.to_array();
    let back: Vec<RestRef> = (0..3)
        .map(|v| {
            let rest = RestRef::new(&anchors, v);
            let d: Vec<GaussianRef> = (0..4).map(|j| cotangent(4 * v + j)).collect();
            let d = decoder_reference.backward(&reference.moved(&rest, T), eye, &d, &mut heads);
            reference.backward(&rest, T, &d, &mut grad)
        })
        .collect();
    assert!(!out.is_empty() && out.len() < 12);
    assert_anchors_close(&anchors, &back, "both stages");
    assert_net_close(&gad, &grad, "both stages");
    decoder.visit(&mut |p| assert_close(&wide(&p.grad), &heads[&p.name], 4e-6, &p.name));
}

#[test]
fn an_untrained_field_changes_no_anchor() {
    let config = GadConfig { net: PlaneNetConfig { zero_init: true, ..small().net }, ..small() };
    let (anchors, mut rest, mut out) = (anchors(300, 2), LocalAnchors::default(), LocalAnchors::default());
    anchors.activate(&mut rest);
    gad(&config, 2).forward(&anchors, T, &mut GadTape::default(), &mut out);
    assert!(out == rest);
}

/// Everything a step produces, bit by bit.
fn step(gad: &mut Gad, anchors: &mut Anchors, tape: &mut GadTape, t: Time) -> Vec<u32> {
    let (mut out, d) = (LocalAnchors::default(), local_cotangents(anchors.len()));
    gad.clear_grads();
    anchors.clear_grads();
    gad.forward(anchors, t, tape, &mut out);
    let penalty = gad.backward(anchors, tape, &d, SHARE);
    let mut all: Vec<f32> = out.positions.iter().flat_map(|p| p.to_array()).chain([penalty]).collect();
    all.extend([&out.offsets[..], &out.features, &out.scales].concat());
    gad.visit(&mut |p| all.extend(&p.grad));
    anchors.visit(&mut |p| all.extend(&p.grad));
    all.iter().map(|v| v.to_bits()).collect()
}

#[test]
fn threads_and_warm_tapes_change_no_bit() {
    for (dynamics, config) in [(2, penalised(small())), (0, small())] {
        // More blocks than chunks, and a ragged end.
        let n = 9 * BLOCK + 17;
        let on = |threads: usize| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            let fresh = &mut GadTape::default();
            pool.install(|| step(&mut gad(&config, dynamics), &mut anchors(n, dynamics), fresh, T))
        };
        let one = on(1);
        assert!(one == on(2) && one == on(4), "results depend on the number of threads");
        let (mut warm, mut tape) = (gad(&config, dynamics), GadTape::default());
        let later = Time { normalised: 0.9, seconds: 0.9 };
        for (n, t) in [(n + 300, T), (0, T), (1, T), (1, later), (BLOCK, T), (BLOCK, later), (BLOCK + 1, T)] {
            let mut cold = (gad(&config, dynamics), anchors(n, dynamics));
            let fresh = step(&mut cold.0, &mut cold.1, &mut GadTape::default(), t);
            assert!(step(&mut warm, &mut anchors(n, dynamics), &mut tape, t) == fresh, "{n} anchors at {t:?}");
        }
        assert!(step(&mut warm, &mut anchors(n, dynamics), &mut tape, T) == one, "a warm tape changes the result");
    }
}

#[test]
fn changes_of_positions_are_not_penalised() {
    let bits = |config: &GadConfig| step(&mut gad(config, 2), &mut anchors(40, 2), &mut GadTape::default(), T);
    let positions = GadConfig { heads: vec![GadHead::Positions], ..small() };
    assert!(bits(&positions) == bits(&penalised(positions)));
    assert!(bits(&small()) != bits(&penalised(small())));
}

/// One `LocalAnchors` per interval is an exact cache: the splats of any later visit are the same bits.
#[test]
fn a_local_kept_per_interval_is_exact() {
    let (gad, anchors) = (gad(&small(), 2), anchors(400, 2));
    let decoder = Decoder::new(&DecoderConfig::default(), shape(2), 5).unwrap();
    let (mut tape, mut local) = (GadTape::default(), LocalAnchors::default());
    let times = [0.0, 0.25, 0.5, 0.75].map(|t| Time { normalised: t, seconds: t.into() });
    let kept = times.map(|t| {
        gad.forward(&anchors, t, &mut tape, &mut local);
        local.clone()
    });
    for (t, kept) in times.into_iter().zip(&kept).rev() {
        let (mut fresh, mut a, mut b) = (LocalAnchors::default(), Splats::default(), Splats::default());
        gad.forward(&anchors, t, &mut GadTape::default(), &mut fresh);
        decoder.forward(&fresh, Visible::All, EYE, &mut DecodeTape::default(), &mut a);
        decoder.forward(kept, Visible::All, EYE, &mut DecodeTape::default(), &mut b);
        assert!(a == b && !a.is_empty());
    }
    assert!(kept[0] != kept[1], "intervals differ");
}

#[test]
fn names_and_refusals() {
    let mut names = Vec::new();
    gad(&small(), 2).visit(&mut |p| names.push(p.name.clone()));
    for head in GadHead::ALL {
        assert!(names.contains(&format!("gad.{}.weight", head.name())), "{names:?}");
    }
    let mut few = Vec::new();
    gad(&GadConfig { heads: vec![GadHead::Positions], ..small() }, 2).visit(&mut |p| few.push(p.name.clone()));
    assert_eq!(names.len() - few.len(), 6, "a head that is off is not built");
    let error = |config: &GadConfig| match Gad::new(config, shape(2), Aabb::cube(1.0), 0) {
        Err(DeformError::Config { field, .. }) => field,
        other => panic!("{other:?}"),
    };
    assert_eq!(error(&GadConfig { heads: vec![], ..small() }), "heads");
    assert_eq!(error(&GadConfig { heads: vec![GadHead::Scales; 2], ..small() }), "heads");
    for change_l2 in [-1.0, f32::NAN, f32::INFINITY] {
        assert_eq!(error(&GadConfig { change_l2, ..small() }), "change_l2");
    }
    let dynamics = Dynamics { threshold: f32::NAN, ..Dynamics::default() };
    assert_eq!(error(&GadConfig { dynamics, ..small() }), "threshold");
    assert_eq!(error(&GadConfig { net: PlaneNetConfig { width: 0, ..small().net }, ..small() }), "width");
}
