//! GeoNet and GauNet: sizes, values and gradients against `f64`, the same bits for any number of threads and whether or
//! not empty texels are computed, and that a small one learns.

use gs_core::nn::map_reference::{Dual, RefMap};
use gs_core::{Params, Rng};
use gs_texel::gaunet::{GauNet, GauNetConfig, GauNetTape};
use gs_texel::geonet::{GeoNet, GeoNetConfig, GeoNetTape};
use gs_texel::net::{NetError, NormOver, reference};

/// `f64` derivative along a random direction of a block against a central difference of step 1e-6, relative to the
/// largest derivative of any block.
const DIFFERENCE: f64 = 1e-6;
/// Largest `f32` output against `f64`, relative to the largest output.
const VALUE: f64 = 5e-6;
/// `f32` gradient along the same direction, relative to the largest derivative of any block.
const GRADIENT: f64 = 2e-5;

fn random(n: usize, name: &str) -> Vec<f32> {
    let mut rng = Rng::new(7, name, 0, n as u64);
    (0..n).map(|_| rng.normal()).collect()
}

/// Three round charts, about half of the map.
fn charts(size: usize) -> Vec<bool> {
    let place = |i: usize| ((i % size) as f32 / size as f32, (i / size) as f32 / size as f32);
    let inside = |(x, y): (f32, f32)| {
        let near = |cx: f32, cy: f32, r: f32| (x - cx).powi(2) + (y - cy).powi(2) < r * r;
        near(0.3, 0.3, 0.3) || near(0.75, 0.7, 0.25) || near(0.2, 0.85, 0.12)
    };
    (0..size * size).map(|i| inside(place(i))).collect()
}

/// Either network, for the tests that treat them alike.
trait Net: Params + Clone + Sync {
    type Tape: Send;
    const HALVINGS: u32;
    fn channels(&self) -> [usize; 2];
    fn tape(&self, size: usize, mask: Option<&[bool]>) -> Self::Tape;
    fn forward(&self, map: &[f32], tape: &mut Self::Tape) -> Vec<f32>;
    fn backward(&mut self, tape: &mut Self::Tape, d: &[f32]);
    fn reference(params: &[Vec<Dual>], input: &RefMap<Dual>, masks: &[Vec<bool>]) -> RefMap<Dual>;

    /// Parameters as after some training: no layer silent, no scale exactly one.
    fn stirred(mut self) -> Self {
        self.visit_mut(&mut |p| {
            let noise = random(p.len(), &p.name);
            p.value.iter_mut().zip(noise).for_each(|(v, n)| *v += 0.1 * n);
        });
        self
    }

    fn grads(&self) -> Vec<Vec<f32>> {
        let mut grads = Vec::new();
        self.visit(&mut |p| grads.push(p.grad.clone()));
        grads
    }

    /// Output and all gradients of one pass.
    fn pass(&self, size: usize, mask: Option<&[bool]>) -> (Vec<f32>, Vec<Vec<f32>>) {
        let (mut net, [inputs, outputs]) = (self.clone(), self.channels());
        let mut tape = net.tape(size, mask);
        let y = net.forward(&random(size * size * inputs, "input"), &mut tape);
        net.backward(&mut tape, &random(size * size * outputs, "d"));
        (y, net.grads())
    }
}

impl Net for GeoNet {
    type Tape = GeoNetTape;
    const HALVINGS: u32 = 3;
    fn channels(&self) -> [usize; 2] {
        [self.config().inputs, 3]
    }
    fn tape(&self, size: usize, mask: Option<&[bool]>) -> GeoNetTape {
        GeoNet::tape(self, size, mask).unwrap()
    }
    fn forward(&self, map: &[f32], tape: &mut GeoNetTape) -> Vec<f32> {
        GeoNet::forward(self, map, tape).unwrap().to_vec()
    }
    fn backward(&mut self, tape: &mut GeoNetTape, d: &[f32]) {
        GeoNet::backward(self, tape, d).unwrap();
    }
    fn reference(params: &[Vec<Dual>], input: &RefMap<Dual>, masks: &[Vec<bool>]) -> RefMap<Dual> {
        reference::geonet(params, input, masks)
    }
}

impl Net for GauNet {
    type Tape = GauNetTape;
    const HALVINGS: u32 = 2;
    fn channels(&self) -> [usize; 2] {
        [self.config().inputs, self.config().outputs()]
    }
    fn tape(&self, size: usize, mask: Option<&[bool]>) -> GauNetTape {
        GauNet::tape(self, size, mask).unwrap()
    }
    fn forward(&self, map: &[f32], tape: &mut GauNetTape) -> Vec<f32> {
        GauNet::forward(self, map, tape).unwrap().to_vec()
    }
    fn backward(&mut self, tape: &mut GauNetTape, d: &[f32]) {
        GauNet::backward(self, tape, d).unwrap();
    }
    fn reference(params: &[Vec<Dual>], input: &RefMap<Dual>, masks: &[Vec<bool>]) -> RefMap<Dual> {
        reference::gaunet(params, input, masks)
    }
}

fn geonet(norm_over: NormOver, sparse: bool) -> GeoNet {
    let config = GeoNetConfig { width: 16, norm_over, sparse, ..GeoNetConfig::default() };
    GeoNet::new("geonet", config, 1).unwrap().stirred()
}

fn gaunet(norm_over: NormOver, sparse: bool) -> GauNet {
    let config = GauNetConfig { width: 8, levels: 2, norm_over, sparse, ..GauNetConfig::tiny() };
    GauNet::new("gaunet", config, 1).unwrap().stirred()
}

#[test]
fn parameters_number_as_published() {
    let count = |config| GeoNet::new("g", config, 1).unwrap().param_count();
    let full = count(GeoNetConfig::default());
    assert_eq!((full as f64 / 1e3).round(), 1087.0, "{full}");
    assert!(count(GeoNetConfig { width: 16, ..GeoNetConfig::default() }) < full / 3);
    let net = GauNet::new("g", GauNetConfig::default(), 1).unwrap();
    assert_eq!((net.param_count() as f64 / 1e4).round(), 3104.0, "{}", net.param_count());
    assert_eq!((net.config().outputs(), GauNetConfig::tiny().outputs()), (23, 14));
    let mut names = std::collections::HashSet::new();
    net.visit(&mut |p| assert!(names.insert(p.name.clone()), "{} twice", p.name));
}

/// Of 8 channels and one level by hand: 9 (6 · 8 + 8 · 8) down, a quarter of 9 (8 · 16 + 16 · 16) below, 16 · 8 grown,
/// 9 (16 · 8 + 8 · 8) up, 8 · 14 out.
#[test]
fn multiply_adds_are_those_of_the_convolutions() {
    let config = GauNetConfig { width: 8, levels: 1, ..GauNetConfig::tiny() };
    assert_eq!(config.multiply_adds(), 1008.0 + 864.0 + 128.0 + 1728.0 + 112.0);
}

#[test]
fn a_new_geonet_leaves_the_template_as_it_is() {
    let net = GeoNet::new("g", GeoNetConfig { width: 16, ..GeoNetConfig::default() }, 1).unwrap();
    assert!(net.pass(16, None).0.iter().all(|v| *v == 0.0));
}

/// Values and gradients of a network: `f64` derivatives along one random direction per parameter block, against
/// differences where asked for, and against the `f32` gradients.
fn three_levels<N: Net>(what: &str, net: &N, size: usize, mask: Option<&[bool]>, differences: bool) {
    let [inputs, outputs] = net.channels();
    let full = vec![true; size * size];
    let masks = reference::masks(mask.unwrap_or(&full), size, N::HALVINGS);
    let wide = |v: &[f32]| v.iter().map(|v| Dual { v: f64::from(*v), d: 0.0 }).collect::<Vec<_>>();
    let data = wide(&random(size * size * inputs, "input"));
    let input = RefMap { height: size, width: size, channels: inputs, data };
    let (mut names, mut params) = (Vec::new(), Vec::new());
    net.visit(&mut |p| {
        names.push(p.name.clone());
        params.push(wide(&p.value));
    });
    let (y, grads) = net.pass(size, mask);
    assert!(grads.iter().flatten().chain(&y).all(|v| v.is_finite()), "{what}");
    let want = N::reference(&params, &input, &masks);
    let largest = want.data.iter().fold(0.0f64, |m, v| m.max(v.v.abs()));
    let value = y.iter().zip(&want.data).fold(0.0f64, |m, (y, w)| m.max((f64::from(*y) - w.v).abs())) / largest;
    let weight = random(size * size * outputs, "d");
    let loss = |params: &[Vec<Dual>]| {
        let y = N::reference(params, &input, &masks);
        let add = |s: [f64; 2], (y, w): (&Dual, &f32)| [s[0] + y.v * f64::from(*w), s[1] + y.d * f64::from(*w)];
        y.data.iter().zip(&weight).fold([0.0; 2], add)
    };
    let mut rows = Vec::new();
    for (b, name) in names.iter().enumerate() {
        let direction = random(params[b].len(), name);
        let along = |step: f64, d: f64| {
            let mut moved = params.clone();
            for (v, r) in moved[b].iter_mut().zip(&direction) {
                (v.v, v.d) = (v.v + step * f64::from(*r), d * f64::from(*r));
            }
            loss(&moved)
        };
        let (exact, h) = (along(0.0, 1.0)[1], 1e-6);
        let difference = if differences { (along(h, 0.0)[0] - along(-h, 0.0)[0]) / (2.0 * h) } else { exact };
        let found: f64 = grads[b].iter().zip(&direction).map(|(g, r)| f64::from(*g) * f64::from(*r)).sum();
        rows.push([exact, difference, found]);
    }
    let scale = rows.iter().fold(0.0f64, |m, r| m.max(r[0].abs()));
    let worst = |i: usize| rows.iter().fold(0.0f64, |m, r| m.max((r[i] - r[0]).abs())) / scale;
    println!(
        "{what:<24} value {value:.1e}   difference {:.1e}   gradient {:.1e}   blocks {}",
        worst(1),
        worst(2),
        rows.len()
    );
    assert!(value < VALUE, "{what}: {value}");
    assert!(worst(1) < DIFFERENCE, "{what}: {}", worst(1));
    assert!(worst(2) < GRADIENT, "{what}: {}", worst(2));
    assert!(rows.iter().all(|r| r[0] != 0.0), "{what}: a block without a gradient");
}

#[test]
fn gradients_stand_on_three_levels() {
    // Differences check the reference, which has one rule for all masks.
    let mask = charts(16);
    three_levels("GeoNet", &geonet(NormOver::All, true), 8, None, true);
    three_levels("GeoNet over a mask", &geonet(NormOver::Mask, true), 16, Some(&mask), false);
    three_levels("GauNet", &gaunet(NormOver::All, true), 8, None, true);
    three_levels("GauNet over a mask", &gaunet(NormOver::Mask, true), 16, Some(&mask), false);
}

#[test]
fn leaving_out_empty_texels_changes_no_bit() {
    for size in [16, 40] {
        let mask = charts(size);
        let run = |sparse| geonet(NormOver::Mask, sparse).pass(size, Some(&mask));
        assert!(run(true) == run(false), "GeoNet at {size}");
        let run = |sparse| gaunet(NormOver::Mask, sparse).pass(size, Some(&mask));
        assert!(run(true) == run(false), "GauNet at {size}");
    }
    // The mask does matter, and a full one is the published network.
    let (mask, full) = (charts(16), vec![true; 256]);
    let all = geonet(NormOver::All, true).pass(16, None);
    assert!(all != geonet(NormOver::Mask, true).pass(16, Some(&mask)));
    assert!(all == geonet(NormOver::Mask, true).pass(16, Some(&full)));
}

#[test]
fn what_stands_outside_the_mask_has_no_say() {
    let (net, mask) = (gaunet(NormOver::Mask, true), charts(16));
    let mut tape = Net::tape(&net, 16, Some(&mask));
    let mut map = random(16 * 16 * 6, "input");
    let want = Net::forward(&net, &map, &mut tape);
    map.chunks_mut(6).zip(&mask).filter(|(_, m)| !**m).for_each(|(texel, _)| texel.fill(-1.0));
    assert!(want == Net::forward(&net, &map, &mut tape));
    let outside = want.chunks(14).zip(&mask).filter(|(_, m)| !**m);
    assert!(outside.flat_map(|(texel, _)| texel).all(|v| *v == 0.0));
}

fn threads<N: Net>(net: &N, size: usize, mask: Option<&[bool]>) {
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| net.pass(size, mask))
    };
    let one = run(1);
    assert!(one == run(2) && one == run(4));
}

#[test]
fn threads_do_not_change_a_bit() {
    let mask = charts(64);
    threads(&geonet(NormOver::All, true), 64, None);
    threads(&geonet(NormOver::Mask, true), 64, Some(&mask));
    threads(&gaunet(NormOver::All, true), 64, None);
    threads(&gaunet(NormOver::Mask, false), 64, Some(&mask));
}

#[test]
fn a_used_tape_is_as_good_as_a_new_one() {
    let mut net = geonet(NormOver::Mask, true);
    let mask = charts(16);
    let mut tape = Net::tape(&net, 16, Some(&mask));
    let (input, d) = (random(16 * 16 * 6, "input"), random(16 * 16 * 3, "d"));
    Net::forward(&net, &random(16 * 16 * 6, "another"), &mut tape);
    Net::backward(&mut net, &mut tape, &random(16 * 16 * 3, "another"));
    net.clear_grads();
    let y = Net::forward(&net, &input, &mut tape);
    Net::backward(&mut net, &mut tape, &d);
    assert!((y, net.grads()) == net.clone().tap(|n| n.clear_grads()).pass(16, Some(&mask)));
}

trait Tap: Sized {
    fn tap(mut self, f: impl FnOnce(&mut Self)) -> Self {
        f(&mut self);
        self
    }
}
impl Tap for GeoNet {}

/// One step of Adam with the usual constants.
fn adam(net: &mut GeoNet, step: i32, rate: f32) {
    net.visit_mut(&mut |p| {
        for i in 0..p.len() {
            let g = p.grad[i];
            p.moment1[i] += 0.1 * (g - p.moment1[i]);
            p.moment2[i] += 0.001 * (g * g - p.moment2[i]);
            let [m, v] = [p.moment1[i] / (1.0 - 0.9f32.powi(step)), p.moment2[i] / (1.0 - 0.999f32.powi(step))];
            p.value[i] -= rate * m / (v.sqrt() + 1e-8);
        }
        p.clear_grad();
    });
}

/// A map of a few waves.
fn waves(size: usize, channels: usize, name: &str, row: u64) -> Vec<f32> {
    let mut rng = Rng::new(5, name, 0, row);
    let waves: Vec<[f32; 4]> = (0..channels * 3)
        .map(|_| [rng.range(-9.0, 9.0), rng.range(-9.0, 9.0), rng.range(0.0, 6.3), rng.range(-0.5, 0.5)])
        .collect();
    let place = |i: usize| ((i % size) as f32 / size as f32, (i / size) as f32 / size as f32);
    let value = |i: usize, c: usize| -> f32 {
        let (x, y) = place(i);
        waves[c * 3..][..3].iter().map(|[kx, ky, phase, a]| a * (kx * x + ky * y + phase).sin()).sum()
    };
    (0..size * size * channels).map(|i| value(i / channels, i % channels)).collect()
}

#[test]
fn a_small_geonet_learns_eight_maps_by_heart() {
    let size = 16;
    let mut net = GeoNet::new("g", GeoNetConfig { width: 16, ..GeoNetConfig::default() }, 1).unwrap();
    let mut tape = GeoNet::tape(&net, size, None).unwrap();
    let pairs: Vec<_> = (0..8).map(|i| (waves(size, 6, "input", i), waves(size, 3, "target", i))).collect();
    let mut losses = Vec::new();
    for step in 1..=600 {
        let mut loss = 0.0;
        for (input, target) in &pairs {
            let y = GeoNet::forward(&net, input, &mut tape).unwrap();
            let n = (8 * y.len()) as f32;
            let d: Vec<f32> = y.iter().zip(target).map(|(y, t)| 2.0 * (y - t) / n).collect();
            loss += y.iter().zip(target).map(|(y, t)| f64::from((y - t).powi(2))).sum::<f64>() / f64::from(n);
            GeoNet::backward(&mut net, &mut tape, &d).unwrap();
        }
        losses.push(loss);
        if loss < 0.1 * losses[0] {
            break;
        }
        adam(&mut net, step, 3e-3);
    }
    let (first, last) = (losses[0], losses[losses.len() - 1]);
    println!("loss {first:.4} at first, {last:.5} after {} steps", losses.len());
    assert!(last < 0.1 * first, "{first} {last}");
}

#[test]
fn what_does_not_fit_is_refused_with_its_reason() {
    let make = |config| GeoNet::new("g", config, 1).map(|_| ());
    let base = GeoNetConfig { width: 16, ..GeoNetConfig::default() };
    let width = make(GeoNetConfig { width: 24, ..base }).unwrap_err();
    assert_eq!(width, NetError::Width { net: "GeoNet", width: 24, multiple: 16 });
    assert!(make(GeoNetConfig { inputs: 0, ..base }).is_err());
    assert!(GauNet::new("g", GauNetConfig { levels: 0, ..GauNetConfig::tiny() }, 1).is_err());
    for (what, config) in [
        ("sh_degree", GauNetConfig { sh_degree: 4, ..GauNetConfig::tiny() }),
        ("levels", GauNetConfig { levels: u32::MAX, ..GauNetConfig::tiny() }),
    ] {
        let error = GauNet::new("g", config, 1).map(|_| ()).unwrap_err();
        assert!(error.to_string().starts_with(&format!("{what} of a GauNet is at most")), "{error}");
        assert!(config.param_count() > 0 && config.multiply_adds() > 0.0);
    }
    let mut net = GeoNet::new("g", base, 1).unwrap();
    assert_eq!(GeoNet::tape(&net, 12, None).unwrap_err(), NetError::Size { size: 12, halvings: 3 });
    assert!(GeoNet::tape(&net, 0, None).is_err());
    let mut tape = GeoNet::tape(&net, 8, None).unwrap();
    let mut map = vec![0.0; 8 * 8 * 6];
    map[(8 * 2 + 5) * 6 + 1] = f32::NAN;
    let text = GeoNet::forward(&net, &map, &mut tape).unwrap_err().to_string();
    assert_eq!(text, "input of GeoNet: value of texel (5, 2), channel 1 is not finite");
    assert!(GeoNet::forward(&net, &[0.0; 3], &mut tape).is_err());
    assert!(GeoNet::backward(&mut net, &mut tape, &[f32::INFINITY; 8 * 8 * 3]).is_err());
    assert!(net.grads().iter().flatten().all(|g| *g == 0.0));
    let masked = GeoNet::new("g", GeoNetConfig { norm_over: NormOver::Mask, ..base }, 1).unwrap();
    for mask in [None, Some(vec![true; 3]), Some(vec![false; 64])] {
        assert!(matches!(GeoNet::tape(&masked, 8, mask.as_deref()), Err(NetError::Mask { want: 64, .. })));
    }
}
