//! LPIPS against the package `lpips` 0.1.4 (torch 2), with weights that both sides make by the same formula: the published ones are not ours.

use gs_core::Image;
use gs_metrics::mrf::{FeatureNet, Mrf, MrfOptions};
use gs_metrics::testkit::{alex, file, unit, vgg16, vgg19};
use gs_metrics::{Lpips, LpipsNet, LpipsRange, MetricError, WeightsError};

fn image(width: usize, height: usize, salt: u64) -> Image {
    Image { width, height, channels: 3, data: unit(width * height * 3, salt).map(|u| u as f32).collect() }
}

/// Two images, and the first with a tenth of the second.
fn images(width: usize, height: usize) -> [Image; 3] {
    let (a, b) = (image(width, height, 1), image(width, height, 2));
    let mixed = a.data.iter().zip(&b.data).map(|(a, b)| (0.9 * f64::from(*a) + 0.1 * f64::from(*b)) as f32).collect();
    [a.clone(), b, Image { data: mixed, ..a }]
}

#[test]
fn distances_are_those_of_the_package() {
    // Evaluated there in f64.
    let cases = [
        (LpipsNet::Alex, alex(), (67, 45), [0.095_281_768_465, 0.001_325_295_488]),
        (LpipsNet::Alex, alex(), (64, 64), [0.094_228_770_998, 0.001_245_612_779]),
        (LpipsNet::Vgg, vgg16(), (67, 45), [0.070_740_213_436, 0.001_532_433_690]),
        (LpipsNet::Vgg, vgg16(), (64, 64), [0.070_361_241_695, 0.001_527_998_076]),
    ];
    for (net, shapes, (width, height), want) in cases {
        let lpips = Lpips::read(&file(&shapes)).unwrap();
        assert_eq!(lpips.net(), net);
        let [a, b, mixed] = images(width, height);
        for (other, want) in [(&b, want[0]), (&mixed, want[1])] {
            let got = lpips.distance(&a, other).unwrap();
            println!("{net:?} {width}x{height}: {got:.9}, package {want:.9}");
            assert!((got - want).abs() < 1e-5 * want, "{net:?}: {got} {want}");
        }
        assert_eq!(lpips.distance(&a, &a).unwrap(), 0.0);
        assert_eq!(lpips.distance(&a, &b).unwrap(), lpips.distance(&b, &a).unwrap());
    }
}

/// What stands beside each value names the file of a network.
#[test]
fn weights_name_their_file() {
    let bytes = file(&alex());
    let mut other = bytes.clone();
    // The least bit of the last parameter.
    let at = other.len() - 4;
    other[at] ^= 1;
    let [a, b, again] = [&bytes, &other, &bytes].map(|bytes| Lpips::read(bytes).unwrap().weights());
    assert!(a == again && a != b, "{a} {b}");
}

/// Evaluations after 3DGS hand colours in [0, 1] to the package.
#[test]
fn distances_of_the_unit_range_are_those_of_the_package_without_its_map() {
    for (shapes, want) in [(alex(), 0.026_254_607_075), (vgg16(), 0.016_010_906_259)] {
        let lpips = Lpips::read(&file(&shapes)).unwrap().with_range(LpipsRange::Unit);
        let [a, b, _] = images(67, 45);
        let got = lpips.distance(&a, &b).unwrap();
        assert!((got - want).abs() < 1e-5 * want, "{got} {want}");
        assert!(lpips.weights().ends_with("colours in [0, 1]"));
    }
}

/// DyCheck's protocol, evaluated by the package in f64 with `spatial=True`.
#[test]
fn masked_distances_are_those_of_dycheck() {
    let lpips = Lpips::read(&file(&alex())).unwrap();
    let [a, b, _] = images(67, 45);
    let mask = |counts: fn(usize, usize) -> bool| {
        let data = (0..67 * 45).map(|k| f32::from(u8::from(counts(k % 67, k / 67)))).collect();
        Image { width: 67, height: 45, channels: 1, data }
    };
    for (mask, want) in [
        (mask(|x, y| (x + 2 * y) % 7 < 3), 0.030_180_207_771),
        (mask(|x, y| (20..50).contains(&x) && (10..40).contains(&y)), 0.071_189_497_626),
    ] {
        let got = lpips.masked(&a, &b, &mask).unwrap();
        println!("masked: {got:.9}, package {want:.9}");
        assert!((got - want).abs() < 1e-5 * want, "{got} {want}");
    }
    assert!(matches!(lpips.masked(&a, &b, &mask(|_, _| false)), Err(MetricError::EmptyMask)));
    assert!(lpips.masked(&a, &b, &Image::zeros(66, 45, 1)).is_err());
}

#[test]
fn threads_do_not_change_a_bit() {
    let lpips = Lpips::read(&file(&alex())).unwrap();
    let [a, b, _] = images(67, 45);
    let with = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| lpips.distance(&a, &b).unwrap().to_bits())
    };
    assert_eq!(with(1), with(3));
}

#[test]
fn files_that_do_not_fit_are_refused_by_the_parameter() {
    let refused = |file: &[u8]| Lpips::read(file).err().unwrap();
    assert!(matches!(refused(b"no weights"), WeightsError::Format(_)));
    let mut shapes = alex();
    let missing = shapes.remove(2);
    assert!(matches!(refused(&file(&shapes)), WeightsError::Missing { name, .. } if name == missing.0));
    shapes.insert(2, (missing.0.clone(), vec![192, 64, 3, 3]));
    let error = refused(&file(&shapes)).to_string();
    assert!(error.contains(&missing.0) && error.contains("[192, 64, 5, 5]"), "{error}");
    let whole = file(&alex());
    assert!((0..64).all(|k| Lpips::read(&whole[..whole.len() * k / 64]).is_err()), "a part of a file is no file");
    let (name, lpips) = ("alex ", Lpips::read(&whole).unwrap());
    assert!(lpips.weights().starts_with(name) && lpips.weights().len() == name.len() + 8);
    assert!(matches!(
        lpips.distance(&image(16, 16, 1), &image(16, 16, 2)),
        Err(MetricError::TooSmall { need: 31, .. })
    ));
}

/// The gradient of the MRF loss on VGG-19 goes back through maxima over windows; by differences along random parts of it.
#[test]
fn the_mrf_loss_on_vgg_19_has_the_gradient_of_its_value() {
    let net = FeatureNet::vgg19(&file(&vgg19())).unwrap();
    let mrf = Mrf::new(net, MrfOptions { side: 32, ..MrfOptions::default() }).unwrap();
    let [a, b, _] = images(32, 32);
    let mut grad = Image::default();
    mrf.value_and_grad(&a, &b, &mut grad).unwrap();
    for salt in [7, 8, 9] {
        let part: Vec<f64> = unit(a.data.len(), salt).zip(&grad.data).map(|(u, g)| u * f64::from(*g)).collect();
        let length = part.iter().map(|v| v * v).sum::<f64>().sqrt();
        let moved = |h: f64| {
            let data = a.data.iter().zip(&part).map(|(v, d)| (f64::from(*v) + h * d / length) as f32).collect();
            mrf.value(&Image { data, ..a.clone() }, &b).unwrap().total
        };
        let h = 2e-2;
        let slope = (moved(h) - moved(-h)) / (2.0 * h);
        let of_gradient = part.iter().zip(&grad.data).map(|(d, g)| d * f64::from(*g)).sum::<f64>() / length;
        println!("{slope:.6} {of_gradient:.6}");
        assert!((slope / of_gradient - 1.0).abs() < 2e-2, "{slope} {of_gradient}");
    }
    assert!(FeatureNet::vgg19(&file(&alex())).is_err());
}
