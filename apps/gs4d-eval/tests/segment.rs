//! Segments of generated scenes, with the truth itself as a method: labels, masks, scores, parts, motion, label images.

use glam::{DVec3, Vec3};
use gs_core::{Camera, Color, Param, Params, Rng, Splats};
use gs_data::{ImageCache, View};
use gs_physics::complexity::{ImageTracks, STATIC_PATH, complexity};
use gs_synth::{self as synth, SynthData, SynthOptions};
use gs_train::capabilities::{Capabilities, ParticleSource, Particles};
use gs_train::method::{Buffers, LossValue, Method, MethodError, RenderView, ViewCtx};
use gs_train::model::Model;
use gs_train::registry::section;
use gs_train::step::StepCtx;
use gs_train::timestamp::Timestamp;
use gs4d_eval::Placing;
use gs4d_eval::segment::*;
use gs4d_report::needs::neutral_camera;

const ORIGIN: DVec3 = DVec3::new(0.05, -0.1, 0.02);
/// The moment of the particles.
const AT: f64 = 0.7;
/// Side of the views, pixels.
const SIDE: u32 = 200;
/// Standard deviation of a splat, world units: a fifth of a pixel, so that outlines are as sharp as the rasteriser draws them.
const SCALE: f32 = 0.003;

/// Splats lie so far below the surface that the outlines of their union, blurred by the rasteriser's dilation, are those of
/// the body: where half of the light is theirs was found by trying.
fn inset(local: DVec3) -> DVec3 {
    local.signum() * (local.abs() - 0.0105).max(DVec3::ZERO)
}

/// A generated scene as a method: small splats on what its views see, moved by the truth itself.
#[derive(Clone)]
struct Cast {
    data: SynthData,
    points: Vec<(usize, DVec3)>,
    /// Relative noise of twists; none: no twists at all.
    noise: Option<f32>,
}

impl Cast {
    fn new(scene: &str, noise: Option<f32>) -> Self {
        let options = SynthOptions::of_views(SIDE, 16, 2);
        let mut data = synth::generate(scene, &SynthOptions { supersample: 1, ..options }).unwrap();
        let seen = |view: &View| {
            let at = |k: u32| (f64::from(2 * (k % (SIDE / 2))) + 0.5, f64::from(2 * (k / (SIDE / 2))) + 0.5);
            let hit = |k: u32| data.truth.hit(&view.camera, view.time.seconds, at(k).0, at(k).1);
            (0..SIDE * SIDE / 4).filter_map(hit).map(|h| (h.body, inset(h.local))).collect::<Vec<_>>()
        };
        let points = data.dataset.train.iter().flat_map(seen).collect();
        data.dataset.train = data.dataset.train.into_iter().step_by(3).collect();
        Self { points, noise, data }
    }

    fn model(&self) -> Model {
        let config = gs_methods::registry().find("static3d").unwrap().config("tiny").unwrap();
        Model::new("cast", self.clone(), section("static3d", &config, "schedule").unwrap()).unwrap()
    }

    fn segment(&self, options: &Options) -> Labels {
        segment(&self.model(), options).unwrap()
    }

    /// Every splat a pixel.
    fn score_of_splats(&self, labels: &Labels) -> gs_metrics::SegmentScores {
        let truth: Vec<u32> = self.points.iter().map(|p| p.0 as u32).collect();
        let mut all = gs_metrics::Segmentation::default();
        all.add(&labels.of, &truth, &vec![1.0; truth.len()]).unwrap();
        all.scores().unwrap()
    }

    fn study(&self, labels: &Labels) -> Scores {
        self.study_from(labels, &View::clone)
    }

    fn study_from(&self, labels: &Labels, placed: &Placing<'_>) -> Scores {
        let truth = TrueLabels::Scene(Box::new(self.data.truth.clone()));
        let rendering = (&ImageCache::new(1 << 20, 1.0), [0.0; 3], placed);
        let mut views = 0;
        let each = |seen: ViewMask<'_>| {
            views += 1;
            assert_eq!(seen.colored().shape(), (SIDE as usize, SIDE as usize, 3));
            assert!(seen.overlaid().data.iter().all(|v| (0.0..=1.0).contains(v)));
            Ok::<(), SegmentError>(())
        };
        let scores =
            study(&self.model(), labels, ("train", &self.data.dataset.train), Some(&truth), rendering, each).unwrap();
        assert_eq!(views, 6);
        scores.unwrap()
    }
}

impl Params for Cast {
    fn visit(&self, _f: &mut dyn FnMut(&Param)) {}
    fn visit_mut(&mut self, _f: &mut dyn FnMut(&mut Param)) {}
}

impl Buffers for Cast {}

impl Method for Cast {
    fn begin_step(&mut self, _at: &StepCtx) {}

    fn splats(&self, at: &Timestamp, _camera: &Camera) -> Result<Splats, MethodError> {
        let place = |(body, local): &(usize, DVec3)| {
            self.data.truth.position_of(*body, *local, at.t.normalised.into()).unwrap().as_vec3()
        };
        let n = self.points.len();
        Ok(Splats {
            means: self.points.iter().map(place).collect(),
            quats: vec![[1.0, 0.0, 0.0, 0.0]; n],
            scales: vec![Vec3::splat(SCALE); n],
            opacities: vec![0.9; n],
            color: Color::Rgb(vec![[0.5; 3]; n]),
            ..Splats::default()
        })
    }

    fn step(&mut self, _view: &ViewCtx<'_>, _render: &mut dyn RenderView) -> Result<Vec<LossValue>, MethodError> {
        Ok(Vec::new())
    }

    fn splat_count(&self) -> usize {
        self.points.len()
    }

    fn capabilities(&self) -> Capabilities<'_> {
        let particles = self.noise.map(|_| self as &dyn ParticleSource);
        Capabilities { particles, ..Capabilities::default() }
    }
}

impl ParticleSource for Cast {
    fn particles(&self) -> Particles {
        let splats = self.splats(&Timestamp::normalised(AT as f32), &neutral_camera()).unwrap();
        Particles { at: AT, splats, twists: self.twists_at(AT).unwrap(), origin: ORIGIN.as_vec3(), lasting: true }
    }

    fn twists_at(&self, t: f64) -> Option<Vec<[[f32; 3]; 6]>> {
        let noise = self.noise.unwrap();
        let twists = |(i, (body, _)): (usize, &(usize, DVec3))| {
            let mut m = self.data.truth.twist_of(*body, t, ORIGIN).unwrap().to_f32();
            let mut rng = Rng::new(1, "noise", 0, i as u64);
            m.twist.v.iter_mut().chain(&mut m.twist.w).for_each(|x| *x += noise * x.abs().max(0.2) * rng.normal());
            [m.twist, m.rate, m.jerk].map(|twist| [twist.v, twist.w]).concat().try_into().unwrap()
        };
        Some(self.points.iter().enumerate().map(twists).collect())
    }
}

/// Noisy twists, the number of bodies known or not: labels are those of the bodies. Where it is not known, so are masks of views at
/// every time.
#[test]
fn bodies_are_found_from_their_twists() {
    for (scene, bodies) in [("projectile", 2), ("hinge", 4), ("balls", 5)] {
        let cast = Cast::new(scene, Some(0.05));
        assert_eq!(cast.data.truth.bodies().len(), bodies, "{scene}");
        for count in [Count::Fixed(bodies), Count::Auto] {
            let labels = cast.segment(&Options { count, ..Options::default() });
            let distances = &labels.distances;
            assert_eq!((labels.k, labels.source), (bodies, Source::Twists), "{scene} {count:?}: {distances:?}");
            let splats = cast.score_of_splats(&labels);
            println!("{scene}, {count:?}: splats mIoU {:.4}", splats.miou);
            assert!(splats.f1 == 1.0 && splats.miou > 0.95, "{scene} {count:?}: {splats:?}");
            if matches!(count, Count::Auto) {
                let masks = cast.study(&labels);
                println!("{scene}, {count:?}: views F1 {:.4}, mIoU {:.4}", masks.f1, masks.miou);
                assert!(masks.f1 == 1.0 && masks.miou > 0.95, "{scene} {count:?}: {masks:?}");
            }
        }
    }
}

/// Masks are drawn from where views are placed, and held against the truth where the data have them.
#[test]
fn views_are_drawn_where_they_are_placed() {
    let cast = Cast::new("projectile", Some(0.05));
    let labels = cast.segment(&Options { count: Count::Fixed(2), ..Options::default() });
    let aside = |view: &View| {
        let mut view = view.clone();
        view.camera.translation.x += 0.3;
        view
    };
    let (right, off) = (cast.study(&labels).miou, cast.study_from(&labels, &aside).miou);
    assert!(right > 0.95 && off < 0.8, "{right} {off}");
}

/// A thrown ball, a rolling wheel, a block that rises and turns, and a slab at rest: four parts, with and without their number.
#[test]
fn three_bodies_and_what_rests_are_four_parts() {
    let cast = Cast::new("trio", Some(0.05));
    for count in [Count::Fixed(4), Count::Auto] {
        let labels = cast.segment(&Options { count, ..Options::default() });
        let (splats, masks) = (cast.score_of_splats(&labels), cast.study(&labels));
        println!("trio, {count:?}: splats mIoU {:.4}; views F1 {:.4}, mIoU {:.4}", splats.miou, masks.f1, masks.miou);
        assert_eq!((labels.k, splats.f1, masks.f1), (4, 1.0, 1.0), "{count:?}: {masks:?}");
        assert!(splats.miou > 0.95 && masks.miou > 0.95, "{count:?}: {splats:?} {masks:?}");
    }
}

/// Two bodies that move as one are one part, unless places count.
#[test]
fn twins_are_told_apart_by_their_places() {
    let cast = Cast::new("twins", Some(0.05));
    let one = cast.segment(&Options::default());
    assert_eq!(one.k, 3, "{:?}", one.distances);
    let label = |labels: &Labels, body: usize| labels.of[cast.points.iter().position(|p| p.0 == body).unwrap()];
    assert_eq!(label(&one, 0), label(&one, 1));
    assert!(label(&one, 0) != label(&one, 2) && label(&one, 2) != label(&one, 3));
    let apart = Options { count: Count::Fixed(6), positions: 1.0, ..Options::default() };
    let apart = cast.segment(&apart);
    assert_ne!(label(&apart, 0), label(&apart, 1));
}

/// Without twists, from paths alone: labels are pure, and what rests is known.
#[test]
fn bodies_are_found_from_their_paths() {
    let mut cast = Cast::new("projectile", None);
    cast.points = cast.points.into_iter().step_by(10).collect();
    let labels = cast.segment(&Options { count: Count::Fixed(4), ..Options::default() });
    assert_eq!(labels.source, Source::Paths);
    let mut counts = vec![[0usize; 2]; labels.k];
    cast.points.iter().zip(&labels.of).for_each(|((body, _), label)| counts[*label as usize][*body] += 1);
    let pure: usize = counts.iter().map(|c| *c.iter().max().unwrap()).sum();
    assert!(pure * 100 > 95 * cast.points.len(), "{counts:?}");
    let still: Vec<bool> = cast.data.truth.bodies().iter().map(|b| !b.motion.moves()).collect();
    assert!(cast.points.iter().zip(&labels.resting).all(|((body, _), rests)| still[*body] == *rests));
}

#[test]
fn parts_move_as_their_bodies_do() {
    let cast = Cast::new("hinge", Some(0.0));
    let labels = cast.segment(&Options::default());
    let table = parts::table(&labels);
    assert_eq!(table.len(), 4);
    assert!((table.iter().map(|p| p.share).sum::<f64>() - 1.0).abs() < 1e-9);
    for part in &table {
        let member = labels.of.iter().position(|l| *l + 1 == part.id).unwrap();
        let truth = cast.data.truth.twist_of(cast.points[member].0, AT, ORIGIN).unwrap().twist;
        let far = |a: [f64; 3], b: [f64; 3]| (DVec3::from(a) - DVec3::from(b)).length();
        assert!(far(part.twist[0], truth.v) < 1e-3 && far(part.twist[1], truth.w) < 1e-3, "{part:?} {truth:?}");
        assert!((part.spin - DVec3::from(truth.w).length()).abs() < 1e-3 && part.residual < 1e-3);
        assert_eq!(
            (part.followers, part.splats),
            (part.splats, labels.of.iter().filter(|l| **l + 1 == part.id).count())
        );
        if let Some(at) = part.axis_at {
            let slide = DVec3::from(truth.v) + DVec3::from(truth.w).cross(DVec3::from(at) - ORIGIN);
            let along = part.pitch.unwrap() * DVec3::from(truth.w);
            assert!((slide - along).length() < 1e-2, "points of the axis only slide along it");
        } else {
            assert!(part.spin < 0.01);
        }
    }
}

/// Balls on an orbit: no motion of theirs at [`AT`] goes back to how they moved long before.
#[test]
fn motions_at_another_time_are_those_of_that_time() {
    let cast = Cast::new("balls", Some(0.0));
    let labels = cast.segment(&Options { at: Some(0.125), ..Options::default() });
    for ((body, _), m) in cast.points.iter().zip(&labels.particles.motions) {
        let truth = cast.data.truth.twist_of(*body, 0.125, ORIGIN).unwrap().twist;
        let far = |a: [f32; 3], b: [f64; 3]| (Vec3::from(a).as_dvec3() - DVec3::from(b)).length();
        assert!(far(m.twist.v, truth.v) < 1e-4 && far(m.twist.w, truth.w) < 1e-4, "{body}: {m:?} {truth:?}");
    }
}

/// Tracks by the splats that pixels see against tracks of the material points themselves.
#[test]
fn the_motion_of_a_scene_is_that_of_its_material_points() {
    let cast = Cast::new("balls", None);
    let camera = cast.data.dataset.train[0].camera.clone();
    let times: Vec<f32> = (0..12).map(|k| k as f32 / 11.0).collect();
    let got =
        complexity(&tracks::tracks(&cast.model(), std::slice::from_ref(&camera), &times, 2500).unwrap(), STATIC_PATH);
    let path = |k: u32| {
        let (x, y) = (f64::from(4 * (k % 50)) + 2.5, f64::from(4 * (k / 50)) + 2.5);
        let hit = cast.data.truth.hit(&camera, 0.0, x, y)?;
        let place = |t: &f32| cast.data.truth.position_of(hit.body, hit.local, (*t).into());
        Some(times.iter().map(|t| place(t).map(|p| camera.to_pixel(camera.to_camera(p)))).collect())
    };
    let truth = ImageTracks {
        size: [SIDE.into(); 2],
        times: times.iter().map(|t| f64::from(*t)).collect(),
        tracks: (0..2500).filter_map(path).collect(),
    };
    let want = complexity(&[truth], STATIC_PATH);
    assert!((got.velocity / want.velocity - 1.0).abs() < 0.1, "{got:?} {want:?}");
    assert!((got.acceleration / want.acceleration - 1.0).abs() < 0.15, "{got:?} {want:?}");
    let whole = scene_complexity(&cast.model(), &cast.data.dataset).unwrap();
    assert!(whole.moving > 0 && whole.velocity > 0.3 * want.velocity && whole.velocity < 3.0 * want.velocity);
}

/// Labels at the first moment see the same paths as labels at the last.
#[test]
fn bodies_are_found_at_the_first_moment() {
    let mut cast = Cast::new("projectile", None);
    cast.points = cast.points.into_iter().step_by(8).collect();
    for count in [Count::Fixed(2), Count::Auto] {
        let first = cast.segment(&Options { count, at: Some(0.0), ..Options::default() });
        assert!(first.resting.contains(&true) && first.resting.contains(&false), "{count:?}");
        let splats = cast.score_of_splats(&first);
        assert!(first.k == 2 && splats.miou > 0.9, "{count:?}: {splats:?}");
    }
}

/// Three times as many moments: the same speed, a third of the change from one moment to the next.
#[test]
fn changes_of_velocity_are_those_between_training_times() {
    let cast = Cast::new("balls", None);
    let timed = |count: u32| {
        let view = &cast.data.dataset.train[0];
        let at = |k| {
            let mut view = view.clone();
            view.time.normalised = k as f32 / (count - 1) as f32;
            view
        };
        let mut dataset = cast.data.dataset.without_views();
        dataset.train = (0..count).map(at).collect();
        scene_complexity(&cast.model(), &dataset).unwrap()
    };
    let (few, many) = (timed(61), timed(181));
    assert!((many.velocity / few.velocity - 1.0).abs() < 1e-3, "{few:?} {many:?}");
    assert!((many.acceleration / few.acceleration - 1.0 / 3.0).abs() < 1e-3, "{few:?} {many:?}");
    assert!((many.acceleration_per_time / few.acceleration_per_time - 1.0).abs() < 1e-3, "{few:?} {many:?}");
}

/// A second camera at the same place, late by a fortieth of the interval, sees the same moments.
#[test]
fn cameras_that_are_not_quite_together_see_one_motion() {
    let cast = Cast::new("balls", None);
    let seen_by = |cameras: u32| {
        let view = &cast.data.dataset.train[0];
        let at = |(k, camera): (u32, u32)| {
            let mut view = view.clone();
            view.camera_id = camera;
            view.time.normalised = k as f32 / 12.0 + 0.002 * camera as f32;
            view
        };
        let mut dataset = cast.data.dataset.without_views();
        dataset.train = (0..12).flat_map(|k| (0..cameras).map(move |camera| (k, camera))).map(at).collect();
        scene_complexity(&cast.model(), &dataset).unwrap()
    };
    let (one, two) = (seen_by(1), seen_by(2));
    assert!((two.velocity / one.velocity - 1.0).abs() < 0.05, "{one:?} {two:?}");
    assert!((two.acceleration / one.acceleration - 1.0).abs() < 0.1, "{one:?} {two:?}");
}

#[test]
fn of_five_cameras_four_see_the_motion() {
    let cast = Cast::new("balls", None);
    let tracked_by = |cameras: u32| {
        let of = |camera_id| {
            let mut view = cast.data.dataset.train[0].clone();
            view.camera_id = camera_id;
            view
        };
        let mut dataset = cast.data.dataset.without_views();
        dataset.train = (0..cameras).map(of).collect();
        scene_complexity(&cast.model(), &dataset).unwrap().tracks
    };
    let one = tracked_by(1);
    assert!(one > 0);
    assert_eq!(tracked_by(5), 4 * one);
}

#[test]
fn the_strongest_part_or_the_background_is_shown() {
    let camera = Camera::look_at(16, 16, 0.7, DVec3::new(0.0, 0.0, -4.0), DVec3::ZERO, DVec3::Y).unwrap();
    let splats = |opacities: [f32; 2]| Splats {
        means: vec![Vec3::ZERO, Vec3::Z * 0.5],
        quats: vec![[1.0, 0.0, 0.0, 0.0]; 2],
        scales: vec![Vec3::splat(5.0); 2],
        opacities: opacities.to_vec(),
        color: Color::Rgb(vec![[0.3; 3]; 2]),
        ..Splats::default()
    };
    let mut masker = Masker::new(gs_raster::RasterOptions { background: [1.0; 3], ..Default::default() });
    for (opacities, id, sure) in [([0.7, 0.9], 6, 0.7), ([0.2, 0.8], 1, 0.64), ([0.3, 0.2], 0, 0.56)] {
        let mask = masker.draw(&splats(opacities), &[5, 0], 6, &camera).unwrap();
        assert_eq!((mask.ids[8 * 16 + 8], mask.width, mask.height), (id, 16, 16));
        assert!((mask.confidence[8 * 16 + 8] - sure).abs() < 0.01, "{}", mask.confidence[8 * 16 + 8]);
    }
    let colors: Vec<[f32; 3]> = (0..12).map(color).collect();
    assert!(colors.iter().enumerate().all(|(k, c)| !colors[..k].contains(c)), "told apart: {colors:?}");
}

#[test]
fn label_images_are_read_in_every_form_and_refused_by_name() {
    let dir = tempfile::tempdir().unwrap();
    let options = SynthOptions::of_views(64, 1, 0);
    let view = synth::generate("twins", &options).unwrap().dataset.train.remove(0);
    let camera = view.camera.clone();
    let want: Vec<u32> = (0..64 * 64).map(|k| k / 64 % 3 * 300 + k % 2).collect();
    let read = |truth: &TrueLabels, view: &View| truth.of(view, "train", &camera);
    let folder = TrueLabels::Folder(dir.path().to_owned());
    assert_eq!(read(&folder, &view).unwrap(), None, "no file");

    let wide = image::ImageBuffer::from_fn(64, 64, |x, y| image::Luma([want[(y * 64 + x) as usize] as u16]));
    image::DynamicImage::ImageLuma16(wide).save(dir.path().join("r_000.png")).unwrap();
    assert_eq!(read(&folder, &view).unwrap(), Some(want.clone()));

    std::fs::create_dir(dir.path().join("train")).unwrap();
    let header = "{'descr': '<i8', 'fortran_order': False, 'shape': (64, 64), }\n";
    let head = [b"\x93NUMPY\x01\x00".as_slice(), &(header.len() as u16).to_le_bytes(), header.as_bytes()].concat();
    let npy = |ids: &dyn Fn(u32) -> i64| {
        let bytes: Vec<u8> = want.iter().flat_map(|id| ids(*id).to_le_bytes()).collect();
        std::fs::write(dir.path().join("train/r_000.npy"), [head.clone(), bytes].concat()).unwrap();
    };
    npy(&|id| i64::from(id) - 1);
    let shifted = want.iter().map(|id| id.saturating_sub(1)).collect();
    assert_eq!(read(&folder, &view).unwrap(), Some(shifted), "the split's own folder first, -1 is the background");
    let named = View { labels: Some(dir.path().join("train/r_000.npy")), ..view.clone() };
    assert!(read(&TrueLabels::Views, &named).unwrap().is_some() && read(&TrueLabels::Views, &view).unwrap().is_none());
    npy(&|_| 1 << 40);
    assert!(read(&folder, &view).unwrap_err().to_string().contains("is no label"));

    let small = image::ImageBuffer::from_fn(64, 32, |_, _| image::Luma([3u8]));
    std::fs::remove_dir_all(dir.path().join("train")).unwrap();
    image::DynamicImage::ImageLuma8(small).save(dir.path().join("r_000.png")).unwrap();
    assert!(matches!(read(&folder, &view), Err(SegmentError::Data(_))), "another shape");
    std::fs::write(dir.path().join("r_000.png"), b"no picture").unwrap();
    assert!(matches!(read(&folder, &view), Err(SegmentError::Data(_))));
}
