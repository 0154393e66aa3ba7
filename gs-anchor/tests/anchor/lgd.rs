//! Local deformation: each encoder has the bits of the field it wraps; what hash grids need and refuse; and what must hold to the last bit.

use glam::Vec3;
use gs_anchor::{AnchorShape, Anchors, Lgd, LgdConfig, LgdEncoder, LgdHashConfig, LgdTape};
use gs_core::{Geometry, Params, Rng, Time};
use gs_deform::apply::ScaleRule;
use gs_deform::encode::HashGridConfig;
use gs_deform::{Aabb, Field, FourDgsConfig};

const T: Time = Time { normalised: 0.3, seconds: 0.3 };

/// A small field of hash grids, dense and hashed levels in it.
fn small() -> LgdConfig {
    let canonical = HashGridConfig { base: [3.0; 3], end: [5.0, 6.0, 9.0], levels: 3, log2_table: 7 };
    let temporal = HashGridConfig { base: [2.0, 3.0, 4.0], end: [4.0, 5.0, 6.0], levels: 2, log2_table: 6 };
    LgdConfig {
        encoder: LgdEncoder::Hash,
        hash: LgdHashConfig { canonical, temporal, ..LgdHashConfig::default() },
        field: FourDgsConfig {
            width: 16,
            zero_init: false,
            scale_rule: ScaleRule::Add,
            detach_coordinates: true,
            ..FourDgsConfig::default()
        },
    }
}

/// A box whose cube reaches to ±1.5.
fn aabb() -> Aabb {
    Aabb::new(Vec3::new(-1.5, -1.0, 0.0), Vec3::new(0.5, 1.0, 1.2)).unwrap()
}

fn lgd(config: &LgdConfig) -> Lgd {
    Lgd::new(config, aabb(), 3).unwrap()
}

/// A field whose every parameter matters: tables of order one.
fn trained() -> Lgd {
    let mut lgd = lgd(&small());
    lgd.visit_mut(&mut |p| {
        let mut rng = Rng::new(1, &p.name, 1, 0);
        if p.name.starts_with("lgd.grids.") {
            p.value.iter_mut().for_each(|v| *v = rng.normal());
        }
    });
    lgd
}

/// Random Gaussians, every eighth outside the cube.
fn gaussians(n: usize) -> Geometry {
    let mut g = Geometry::zeros(n);
    for row in 0..n {
        let mut rng = Rng::new(4, "gaussians", 0, row as u64);
        let mut vec3 = |lo, hi| Vec3::new(rng.range(lo, hi), rng.range(lo, hi), rng.range(lo, hi));
        g.means[row] = if row % 8 == 7 { Vec3::new(0.2, 1.6, -0.4) } else { vec3(-1.4, 1.4) };
        g.scales[row] = vec3(0.01, 0.3);
        g.quats[row] = std::array::from_fn(|_| rng.normal());
    }
    g
}

fn forward(lgd: &Lgd, from: &Geometry, tape: &mut LgdTape) -> Geometry {
    let mut out = Geometry::default();
    lgd.forward_at(&from.means, from.view(), T, tape, &mut out);
    out
}

/// Cotangents of the Gaussians; those of the parameters are left in the field.
fn backward(lgd: &mut Lgd, from: &Geometry, tape: &mut LgdTape, d_out: &Geometry) -> Geometry {
    let mut d = Geometry::zeros(from.len());
    lgd.clear_grads();
    lgd.backward(from.view(), tape, d_out.view(), &mut d, None);
    d
}

#[test]
fn an_untrained_field_of_hash_grids_is_the_identity() {
    let mut config = small();
    config.field.zero_init = true;
    let from = gaussians(300);
    assert_eq!(forward(&lgd(&config), &from, &mut LgdTape::default()), from, "bit for bit");
}

#[test]
fn hash_grids_give_the_same_bits_for_any_number_of_threads() {
    let (from, d_out) = (gaussians(700), gaussians(700));
    let anchors = Anchors::new(AnchorShape { offsets: 1, features: 1, dynamics: 0 }, &from.means, &[0.0; 700]);
    let run = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| {
            let (mut lgd, mut tape) = (trained(), LgdTape::default());
            let out = forward(&lgd, &from, &mut tape);
            let d = backward(&mut lgd, &from, &mut tape, &d_out);
            let terms = lgd.regularise(&anchors, T, 5);
            let mut grads = Vec::new();
            lgd.visit(&mut |p| grads.push(p.grad.clone()));
            (out, d, terms, grads)
        })
    };
    let one = run(1);
    assert!([2, 3].iter().all(|threads| run(*threads) == one));
    assert_eq!(one.2.iter().map(|t| t.0).collect::<Vec<_>>(), ["local_space", "local_time"]);
    assert!(one.2.iter().all(|t| t.1 > 0.0), "{:?}", one.2);
}

/// Smoothness is that of the places of the anchors: of grids and of nothing else.
#[test]
fn the_regulariser_reaches_the_grids_alone() {
    let means = gaussians(40).means;
    let anchors = Anchors::new(AnchorShape { offsets: 1, features: 1, dynamics: 0 }, &means, &[0.0; 40]);
    let mut lgd = trained();
    lgd.regularise(&anchors, T, 1);
    lgd.visit(&mut |p| {
        assert_eq!(p.grad.iter().any(|g| *g != 0.0), p.name.starts_with("lgd.grids."), "{}", p.name);
    });
}

/// Moved Gaussians, their cotangents and the gradients of the parameters, by a field without [`Lgd`].
fn of_field<F: Field>(mut field: F, from: &Geometry, d_out: &Geometry) -> (Geometry, Geometry, Vec<Vec<f32>>) {
    let (mut tape, mut out, mut d) = (F::Tape::default(), Geometry::default(), Geometry::zeros(from.len()));
    field.forward(from.view(), T, &mut tape, &mut out);
    field.backward(from.view(), &mut tape, d_out.view(), &mut d);
    (out, d, gradients(&field))
}

fn gradients(params: &dyn Params) -> Vec<Vec<f32>> {
    let mut all = Vec::new();
    params.visit(&mut |p| all.push(p.grad.clone()));
    all
}

/// The fields are held to their `f64` references in gs-deform.
#[test]
fn either_encoder_has_the_bits_of_its_field() {
    let planes = lgd(&LgdConfig { encoder: LgdEncoder::Planes, ..small() });
    let (from, d_out) = (gaussians(300), gaussians(301));
    let d_out = d_out.view().pick(&(1..301).collect::<Vec<_>>());
    for mut lgd in [trained(), planes] {
        let mut tape = LgdTape::default();
        let out = forward(&lgd, &from, &mut tape);
        let want = match lgd.clone() {
            Lgd::Planes(field) => of_field(*field, &from, &d_out),
            Lgd::Hash(field) => of_field(*field, &from, &d_out),
        };
        let d = backward(&mut lgd, &from, &mut tape, &d_out);
        let grads = gradients(&lgd);
        assert!(out != from && grads.iter().any(|g| g.iter().any(|g| *g != 0.0)));
        assert_eq!((out, d, grads), want);
    }
}

#[test]
fn tables_are_counted_and_named() {
    let hash = LgdConfig { hash: LgdHashConfig::default(), ..small() };
    let lgd = lgd(&hash);
    let [tables, networks] = lgd.hash_values().unwrap();
    assert_eq!((tables as u64, tables), (hash.hash.values(), 182_166));
    assert_eq!((tables + networks, lgd.param_count() as u64), (lgd.param_count(), hash.param_count()));
    let mut names = Vec::new();
    lgd.visit(&mut |p| names.push(p.name.clone()));
    assert_eq!(names[..4], ["lgd.grids.xyz", "lgd.grids.xyt", "lgd.grids.yzt", "lgd.grids.xzt"]);
    assert!(names[4..].iter().all(|name| name.starts_with("lgd.net.")), "{names:?}");
}

#[test]
fn what_hash_grids_cannot_do_is_refused_by_name() {
    let error = |change: &dyn Fn(&mut LgdConfig)| {
        let mut config = small();
        change(&mut config);
        Lgd::new(&config, aabb(), 3).unwrap_err().to_string()
    };
    assert!(error(&|c| c.field.detach_coordinates = false).contains("`lgd.detach_coordinates` = false"));
    assert!(error(&|c| c.field.move_quats = false).contains("`lgd.move_quats` = false"));
    assert!(error(&|c| c.field.scale_rule = ScaleRule::Log).contains("`lgd.scale_rule` = log"));
    assert!(error(&|c| c.field.width = 0).contains("`width` = 0"));
    assert!(error(&|c| c.hash.canonical.levels = 0).contains("`levels` = 0"));
    assert!(error(&|c| c.hash.canonical.levels = usize::MAX).contains("at most 64 levels"));
    let large = HashGridConfig { base: [64.0; 3], end: [64.0; 3], levels: 2, log2_table: 17 };
    assert!(
        error(&|c| c.hash.temporal = large).contains("values cannot be built: it must be at most 480000 in all tables")
    );
}

#[test]
fn settings_are_read_beside_those_of_the_planes() {
    let read = |text: &str| serde_json::from_str::<LgdConfig>(text);
    let hash = read(r#"{"encoder": "hash", "hash": {"lambda_t": 0.1}, "width": 32}"#).unwrap();
    assert_eq!((hash.encoder, hash.hash.lambda_t, hash.field.width), (LgdEncoder::Hash, 0.1, 32));
    assert_eq!(read(r#"{"width": 32}"#).unwrap().encoder, LgdEncoder::Planes, "as before there was a choice");
    assert!(read(r#"{"widht": 32}"#).unwrap_err().to_string().contains("widht"));
    let again = read(&serde_json::to_string(&hash).unwrap()).unwrap();
    assert_eq!(again, hash);
}

#[test]
fn grids_have_no_more_time_nodes_than_planes_may() {
    let mut config = LgdConfig { hash: LgdHashConfig::default(), ..small() };
    assert_eq!(config.clone().for_moments(30.0).hash, config.hash, "no bound");
    config.field.rows_per_moment = 0.5;
    // 15 rows of planes, of which times 0 to 1 reach 8.
    let HashGridConfig { base, end, .. } = config.clone().for_moments(30.0).hash.temporal;
    assert_eq!((base[2], end), (4.0, [64.0, 64.0, 8.0]));
    // More moments than the planes have rows for bound nothing.
    assert_eq!(config.clone().for_moments(1e4).hash, config.hash);
}
