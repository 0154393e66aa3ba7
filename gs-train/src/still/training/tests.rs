use super::*;
use crate::schedule::Stage;
use crate::schedule::tests::schedule;

/// Four splats that differ.
fn canonical() -> Geometry {
    let row = |i: u8| Vec3::new(f32::from(i), 0.5, 2.0);
    let quats = vec![[1.0, 0.0, 0.0, 0.0]; 4];
    Geometry { means: (0..4).map(row).collect(), quats, scales: (1..5).map(row).collect() }
}

/// Row `i` swings by `i` hundredths of a world unit; scales double.
fn swing(t: Time, from: GeometryRef<'_>, to: &mut Geometry) {
    *to = from.pick(&[0, 1, 2, 3]);
    for (i, mean) in to.means.iter_mut().enumerate() {
        mean.y += 0.01 * i as f32 * (2.0 * t.normalised - 1.0);
    }
    to.scales.iter_mut().for_each(|s| *s *= 2.0);
}

fn step(step: u32) -> StepCtx {
    StepCtx { step, stage_steps: 100, stage_offset: 50, dynamic: true, ..StepCtx::default() }
}

/// Decided with a tolerance of 1.5 pixels where a world unit is 100 pixels long: rows 0 and 1 are still.
fn decided() -> StillRows {
    let config =
        StillConfig { pixels: 1.5, shape: 0.01, every: 200, turn: 7, probes: 17, from: 0.15, until: 0.95, pull: 0.0 };
    let mut rows = StillRows::new(config, 4, 1.0);
    rows.reach.fill(100.0);
    let canonical = canonical();
    assert_eq!(rows.decide(canonical.view(), 0.0, |t, out| swing(t, canonical.view(), out)), (2, 0));
    rows
}

#[test]
fn what_moves_further_than_the_tolerance_takes_part_and_the_others_in_turn() {
    let mut rows = decided();
    assert!(rows.flags().eq([true, true, false, false]));
    let mut takes_part = |at: StepCtx| {
        rows.begin_step(&at);
        rows.rows.clone()
    };
    assert_eq!(takes_part(step(8)), Some(vec![2, 3]));
    assert_eq!(takes_part(step(7)), Some(vec![0, 2, 3]), "row 0 in every seventh step");
    assert_eq!(takes_part(StepCtx { stage_offset: 5, ..step(8) }), None, "all at the beginning of a stage");
    assert_eq!(takes_part(StepCtx { stage_offset: 97, ..step(8) }), None, "all at its end");
    assert_eq!(takes_part(StepCtx { deform_only: true, ..step(8) }), None, "all where the cloud rests");
    (rows.config.from, rows.config.every) = (0.0, 1);
    let first = StepCtx { stage_offset: 0, ..step(8) };
    rows.begin_step(&first);
    assert!(rows.flags().all(|still| !still), "a stage begins with none");
    assert!(!rows.due(&first) && rows.due(&step(8)), "resumed after its first step, it would drop what that decided");
}

#[test]
fn a_tolerance_that_leaves_out_none_is_refused() {
    let config = StillConfig { pixels: 1.0, from: 0.95, until: 0.5, ..StillConfig::default() };
    assert!(config.check().unwrap_err().contains("still.from"));
    assert_eq!(StillConfig { pixels: 0.0, ..config }.check(), Ok(()));
    assert_eq!(decided().config.check(), Ok(()));
    let config = StillConfig { pull: 1.0, ..decided().config };
    assert_eq!(config.check(), Ok(()));
    assert!(StillConfig { shape: 0.0, ..config }.check().unwrap_err().contains("still.pull"));
}

/// Of 20 steps without the field and 100 with it.
#[test]
fn a_run_may_be_too_short_for_a_decision() {
    let stage = |order, steps| Stage { order, steps, dynamic: order > 0, image_scale: 1.0, ..Stage::default() };
    let schedule = schedule(vec![stage(0, 20), stage(1, 100)]);
    let never = |every| StillConfig { every, ..decided().config }.never_decides(&schedule);
    // The field's stage is open from its step 15 to its step 94: steps 36 to 115.
    assert_eq!([35, 36, 115, 116, 200].map(never), [false, false, false, true, true]);
    let off = StillConfig { pixels: 0.0, every: 200, ..decided().config };
    assert!(!off.never_decides(&schedule));
}

/// Rows 0 and 1 are left out, row 2 was never shown, row 3 is 0.03 away at time 1: 3 pixels, two tolerances.
#[test]
fn what_takes_part_is_pulled_to_rest() {
    let mut rows = decided();
    rows.config.pull = 2.0;
    rows.reach[2] = 0.0;
    rows.begin_step(&step(8));
    let (canonical, mut moved) = (canonical(), Geometry::default());
    swing(Time { normalised: 1.0, seconds: 1.0 }, canonical.view(), &mut moved);
    let at = StepCtx { batch: 2, ..step(8) };
    let (grad, value) = rows.pull(canonical.view(), &moved, &at).expect("a pull");
    // Of four splats in one of two views; scales double: a hundred tolerances by their largest.
    let u = 2.0 + 100.0 * canonical.scales[3].length() / canonical.scales[3].max_element();
    assert!((value - 2.0 / 8.0 * u.ln_1p()).abs() < 1e-4, "{value}");
    let slope = 2.0 / 8.0 * (100.0 / 1.5) / (1.0 + u);
    assert!((grad.means[3] - Vec3::Y * slope).length() < 1e-4 * slope, "{:?}", grad.means);
    assert_eq!(grad.means[..3], [Vec3::ZERO; 3]);
    assert!(rows.pull(canonical.view(), &moved, &StepCtx { stage_offset: 97, ..at.clone() }).is_none());
    rows.config.pull = 0.0;
    assert!(rows.pull(canonical.view(), &moved, &at).is_none());
}

/// Seen from the larger extreme scales change by a third, seen from the smaller one by as much as that is.
#[test]
fn a_shape_is_held_against_both_extremes() {
    let (canonical, row) = (canonical(), |t: Time, from: GeometryRef<'_>, to: &mut Geometry| {
        *to = from.pick(&[0, 1, 2, 3]);
        to.scales.iter_mut().for_each(|s| *s *= 1.0 + 2.0 * t.normalised);
    });
    for (shape, still) in [(0.5, 0), (1.01, 4)] {
        let mut rows = decided();
        rows.config.shape = shape;
        assert_eq!(rows.decide(canonical.view(), 0.0, |t, out| row(t, canonical.view(), out)).0, still);
    }
}

#[test]
fn what_no_view_has_shown_rests_only_if_its_centre_does_not_move() {
    let (mut rows, canonical) = (decided(), canonical());
    rows.reach.fill(0.0);
    assert_eq!(rows.decide(canonical.view(), 0.0, |t, out| swing(t, canonical.view(), out)), (1, 0));
    assert!(rows.flags().eq([true, false, false, false]));
}

/// Everything is linear in the canonical splats, so a difference of outputs is a derivative.
#[test]
fn a_still_splat_keeps_its_pose_and_its_gradient_goes_straight() {
    let mut rows = decided();
    rows.begin_step(&step(8));
    let (mut from, mut out, mut d) = (canonical(), Geometry::default(), Geometry::default());
    let triple = |from: GeometryRef<'_>, to: &mut Geometry| {
        *to = from.pick(&[0, 1]);
        to.means.iter_mut().for_each(|m| *m *= 3.0);
    };
    from.means[0].x += 0.25;
    rows.forward(from.view(), triple, &mut out);
    assert_eq!((out.means[0], out.means[3]), (Vec3::new(0.25, 0.5, 2.0), 3.0 * from.means[3]));
    assert_eq!(out.scales[1], 2.0 * from.scales[1], "a factor of scales");
    assert_eq!(out.scales[2], from.scales[2], "row 2 is the field's");
    let ones = Geometry { means: vec![Vec3::ONE; 4], quats: vec![[1.0; 4]; 4], scales: vec![Vec3::ONE; 4] };
    let back = |_: GeometryRef<'_>, d: GeometryRef<'_>, to: &mut Geometry| {
        to.means.iter_mut().zip(d.means).for_each(|(to, d)| *to += 3.0 * *d);
        to.scales.copy_from_slice(d.scales);
    };
    rows.backward(from.view(), ones.view(), back, &mut d);
    assert_eq!(d.means, [Vec3::ONE, Vec3::ONE, Vec3::splat(3.0), Vec3::splat(3.0)]);
    assert_eq!(d.scales, [Vec3::splat(2.0), Vec3::splat(2.0), Vec3::ONE, Vec3::ONE]);
    assert_eq!(d.quats, [[1.0; 4], [1.0; 4], [0.0; 4], [0.0; 4]]);
}

/// Half the image is 50 pixels wide: the means of rows 0 and 1 are 25 and 150 half-image units.
#[test]
fn a_still_splat_of_large_screen_gradient_takes_part_until_the_next_decision() {
    let (mut rows, canonical) = (decided(), canonical());
    let camera = Camera::look_at(100, 80, 0.8, glam::DVec3::Z * 4.0, glam::DVec3::ZERO, glam::DVec3::Y).unwrap();
    let see = |rows: &mut StillRows, at: u32, gradients: [f32; 4]| {
        rows.begin_step(&step(at));
        let grad_means2d = gradients.map(|g| [g, 0.0]).to_vec();
        rows.see(&canonical, &ScreenStats { grad_means2d, radii: vec![1.0; 4] }, &camera);
    };
    see(&mut rows, 8, [0.0, 1.0, 9.0, 9.0]);
    see(&mut rows, 9, [1.0, 5.0, 9.0, 9.0]);
    see(&mut rows, 6, [0.5, 0.0, 9.0, 9.0]);
    assert_eq!(rows.loss, [75.0, 3.0, 300.0, 2.0, 0.0, 0.0, 0.0, 0.0], "row 1 takes part in step 6");
    let decide = |rows: &mut StillRows| {
        let numbers = rows.decide(canonical.view(), 50.0, |t, out| swing(t, canonical.view(), out));
        (numbers, rows.flags().collect::<Vec<_>>())
    };
    assert_eq!(decide(&mut rows), ((1, 1), vec![true, false, false, false]));
    assert_eq!(rows.loss, [0.0; 8]);
    rows.begin_step(&step(8));
    assert_eq!(rows.rows, Some(vec![1, 2, 3]));
    assert_eq!(decide(&mut rows), ((2, 0), vec![true, true, false, false]), "the probe decides again");
}

#[test]
fn a_view_tells_how_far_a_shift_goes_on_its_screen() {
    let mut rows = StillRows::new(StillConfig { pixels: 1.0, ..StillConfig::default() }, 2, 1.0);
    let camera = Camera::look_at(200, 160, 0.8, glam::DVec3::Z * 4.0, glam::DVec3::ZERO, glam::DVec3::Y).unwrap();
    let moved = Geometry { means: vec![Vec3::new(0.3, 0.2, 0.1); 2], ..Geometry::zeros(2) };
    let stats = ScreenStats { grad_means2d: vec![[0.0; 2]; 2], radii: vec![3.0, 0.0] };
    rows.see(&moved, &stats, &camera);
    let pixel = |m: Vec3| {
        let p = camera.rotation * m.as_dvec3() + camera.translation;
        glam::DVec2::new(camera.fx * p.x / p.z, camera.fy * p.y / p.z)
    };
    for direction in [Vec3::X, Vec3::Y, Vec3::Z] {
        let way = pixel(moved.means[0]).distance(pixel(moved.means[0] + 1e-3 * direction));
        assert!(way <= 1e-3 * f64::from(rows.reach[0]) * 1.001, "{direction}: {way} pixels");
    }
    assert_eq!(rows.reach[1], 0.0, "not visible");
}
