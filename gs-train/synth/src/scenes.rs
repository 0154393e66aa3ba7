//! The list of generated scenes. All of them fit in the cube `[-1.3, 1.3]³`; up is +z.

use glam::{DVec2, DVec3};

use super::body::{Body, Shape, Wave};
use super::mechanics;
use super::motion::{Burst, Motion};
use super::variant::FASTEST;

/// An entry in the list of scenes.
pub struct SynthScene {
    /// Name, as [`super::generate`] takes it.
    pub name: &'static str,
    /// The scene in one line, for help texts.
    pub about: &'static str,
    /// Whether any body of the scene moves.
    pub dynamic: bool,
    /// Fewest samples per pixel along each axis that its texture needs.
    pub least_supersample: u32,
    /// Largest pace of a variant, at most 1.1: bodies stay out of each other up to it; 1 is the designed speed.
    pub fastest: f32,
    /// Makes the bodies of the scene.
    pub bodies: fn() -> Vec<Body>,
}

/// All scenes that [`super::generate`] knows.
pub const SCENES: &[SynthScene] = &[
    SynthScene {
        name: "balls",
        about: "two balls on an orbit, a turning block, a tumbling block and a slab at rest: rigid bodies",
        dynamic: true,
        least_supersample: 1,
        fastest: FASTEST,
        bodies: balls,
    },
    SynthScene {
        name: "sheet",
        about: "a sheet held at one side with a wave travelling through it: motion without rigid parts",
        dynamic: true,
        least_supersample: 1,
        fastest: FASTEST,
        bodies: sheet,
    },
    SynthScene {
        name: "static",
        about: "the bodies of \"balls\" at rest: for methods without motion",
        dynamic: false,
        least_supersample: 1,
        fastest: FASTEST,
        bodies: at_rest,
    },
    SynthScene {
        name: "waves",
        about: "four finely textured bodies that swing at 1/2, 2, 4 and 10 cycles over a slab at rest: low and high frequencies",
        dynamic: true,
        least_supersample: 4,
        fastest: FASTEST,
        bodies: waves,
    },
    SynthScene {
        name: "reach",
        about: "a box that is carried along an arc, most of the way in an eighth of the time, beside a hanging cloth that wobbles: global and local motion",
        dynamic: true,
        least_supersample: 4,
        fastest: FASTEST,
        bodies: reach,
    },
    rigid("falling", "a ball thrown in an arc over a slab, without turning: constant acceleration", mechanics::falling),
    rigid("screw", "a block that winds around an axis while it advances along it: a constant twist", mechanics::screw),
    rigid("wheel", "a wheel that rolls over a slab: even hub, even spin, a twist that changes", mechanics::wheel),
    rigid("projectile", "a block that is thrown and turns on its way", mechanics::projectile),
    rigid("hinge", "a box with a lid, a door and an arm that turn about hinges", mechanics::hinge),
    rigid("spinner", "a disc that turns about its own axis close before a box", mechanics::spinner),
    rigid("twins", "two bodies apart that move as one, and a third that does not", mechanics::twins),
    SynthScene {
        // The ball meets the slab at the pace 1.0363.
        fastest: 1.036,
        ..rigid("trio", "a thrown ball, a rolling wheel and a block that rises and turns, over a slab", mechanics::trio)
    },
];

/// A scene of rigid bodies.
const fn rigid(name: &'static str, about: &'static str, bodies: fn() -> Vec<Body>) -> SynthScene {
    SynthScene { name, about, dynamic: true, least_supersample: 1, fastest: FASTEST, bodies }
}

const TURN: f64 = std::f64::consts::TAU;

fn balls() -> Vec<Body> {
    let body = |name, shape, motion, colors, pattern| Body { name, shape, motion, colors, pattern };
    let orbit = Motion { orbit_radius: 0.7, orbit_rate: 0.5 * TURN, ..Motion::default() };
    vec![
        body(
            "ball",
            Shape::Sphere { radius: 0.28 },
            Motion {
                start: DVec3::new(0.0, 0.0, -0.25),
                spin_axis: DVec3::new(0.3, 0.2, 1.0),
                spin_rate: 0.75 * TURN,
                ..orbit
            },
            [[0.86, 0.24, 0.18], [0.97, 0.88, 0.72]],
            14.0,
        ),
        body(
            "bobbing ball",
            Shape::Sphere { radius: 0.2 },
            Motion {
                start: DVec3::new(0.0, 0.0, -0.15),
                spin_axis: DVec3::X,
                spin_rate: 0.5 * TURN,
                orbit_phase: 0.5 * TURN,
                bob: DVec3::Z * 0.25,
                bob_rate: 1.0,
                ..orbit
            },
            [[0.14, 0.42, 0.78], [0.80, 0.92, 0.95]],
            18.0,
        ),
        body(
            "turning block",
            Shape::Box { half: DVec3::new(0.2, 0.16, 0.3) },
            Motion { start: DVec3::Z * -0.35, spin_axis: DVec3::Z, spin_rate: -0.25 * TURN, ..Motion::default() },
            [[0.20, 0.58, 0.30], [0.93, 0.85, 0.35]],
            13.0,
        ),
        body(
            "tumbling block",
            Shape::Box { half: DVec3::new(0.17, 0.12, 0.14) },
            Motion {
                start: DVec3::new(-0.5, 0.1, 0.45),
                velocity: DVec3::new(1.0, -0.2, 0.1),
                spin_axis: DVec3::new(1.0, 1.0, 0.4),
                spin_rate: 0.5 * TURN,
                ..Motion::default()
            },
            [[0.56, 0.25, 0.62], [0.95, 0.72, 0.45]],
            17.0,
        ),
        body(
            "slab",
            Shape::Box { half: DVec3::new(0.72, 0.72, 0.05) },
            Motion { start: DVec3::Z * -0.72, ..Motion::default() },
            [[0.42, 0.44, 0.48], [0.80, 0.80, 0.76]],
            9.0,
        ),
    ]
}

fn at_rest() -> Vec<Body> {
    let still = |b: Body| {
        let pose = b.motion.at(0.3);
        // Positions at time 0.3; rotations are left out.
        Body { motion: Motion { start: pose.translation, ..Motion::default() }, ..b }
    };
    balls().into_iter().map(still).collect()
}

fn sheet() -> Vec<Body> {
    vec![Body {
        name: "sheet",
        shape: Shape::Sheet {
            half: DVec2::new(1.0, 0.7),
            waves: const { &[Wave { amplitude: 0.3, wave: DVec2::new(4.5, 1.2), rate: TURN }] },
            pace: 1.0,
        },
        motion: Motion::default(),
        colors: [[0.82, 0.30, 0.22], [0.92, 0.90, 0.80]],
        pattern: 9.0,
    }]
}

/// Cycles over the whole span of time, one per moving body of "waves".
const WAVE_CYCLES: [f64; 4] = [0.5, 2.0, 4.0, 10.0];

/// Bodies oscillate sinusoidally along one direction each, with amplitudes such that none leaves its quarter of the slab. The
/// patterns have a wavelength of about a tenth of the scene, which blurs if a trajectory is smoothed.
fn waves() -> Vec<Body> {
    const FINE: f64 = 42.0;
    let body = |name, shape, [x, y]: [f64; 2], swing: DVec3, cycles, colors| {
        let motion = Motion { start: DVec3::new(x, y, -0.2), bob: swing, bob_rate: cycles, ..Motion::default() };
        Body { name, shape, motion, colors, pattern: FINE }
    };
    let ball = |radius| Shape::Sphere { radius };
    let block = |x, y, z| Shape::Box { half: DVec3::new(x, y, z) };
    let [half, two, four, ten] = WAVE_CYCLES;
    let slab = Motion { start: DVec3::Z * -0.72, ..Motion::default() };
    vec![
        body("half cycle", ball(0.22), [-0.42, -0.42], DVec3::Z * 0.3, half, [[0.86, 0.24, 0.18], [0.97, 0.88, 0.72]]),
        body(
            "two cycles",
            block(0.18, 0.18, 0.2),
            [0.42, -0.42],
            DVec3::X * 0.2,
            two,
            [[0.14, 0.42, 0.78], [0.88, 0.95, 0.97]],
        ),
        body("four cycles", ball(0.2), [0.42, 0.42], DVec3::Y * 0.18, four, [[0.20, 0.58, 0.30], [0.95, 0.90, 0.40]]),
        body(
            "ten cycles",
            block(0.16, 0.2, 0.18),
            [-0.42, 0.42],
            DVec3::Z * 0.12,
            ten,
            [[0.56, 0.25, 0.62], [0.97, 0.80, 0.55]],
        ),
        Body {
            name: "slab",
            shape: block(0.72, 0.72, 0.05),
            motion: slab,
            colors: [[0.30, 0.32, 0.36], [0.86, 0.86, 0.82]],
            pattern: FINE,
        },
    ]
}

/// Waves of the cloth of "reach": 1, 2 and 3½ cycles over the span of time.
const CLOTH_WAVES: &[Wave] = &[
    Wave { amplitude: 0.11, wave: DVec2::new(3.5, 1.0), rate: TURN },
    Wave { amplitude: 0.06, wave: DVec2::new(-2.0, 5.0), rate: 2.0 * TURN },
    Wave { amplitude: 0.04, wave: DVec2::new(6.0, -3.0), rate: 3.5 * TURN },
];

/// A box moves over 80 degrees of an arc, lifted and rotated, and a cloth hangs behind it. The box makes 60 % of
/// its motion between the times 0.5 and 0.625, one of eight even intervals.
fn reach() -> Vec<Body> {
    let carried = Motion {
        start: DVec3::Z * -0.25,
        orbit_radius: 0.5,
        orbit_phase: TURN * 140.0 / 360.0,
        orbit_rate: TURN * 80.0 / 360.0,
        spin_axis: DVec3::new(0.2, 0.1, 1.0),
        spin_rate: -0.15 * TURN,
        bob: DVec3::Z * 0.15,
        bob_rate: 0.5,
        burst: Some(Burst { from: 0.5, until: 0.625, share: 0.6 }),
        ..Motion::default()
    };
    // The sheet's x points down, so it hangs from its upper edge.
    let hanging = Motion { start: DVec3::new(0.55, 0.0, 0.05), tilt: DVec3::Y * (0.25 * TURN), ..Motion::default() };
    vec![
        Body {
            name: "box",
            shape: Shape::Box { half: DVec3::new(0.26, 0.2, 0.26) },
            motion: carried,
            colors: [[0.80, 0.22, 0.16], [0.98, 0.90, 0.70]],
            pattern: 16.0,
        },
        Body {
            name: "cloth",
            shape: Shape::Sheet { half: DVec2::new(0.55, 0.6), waves: CLOTH_WAVES, pace: 1.0 },
            motion: hanging,
            colors: [[0.12, 0.36, 0.66], [0.85, 0.93, 0.96]],
            pattern: 12.0,
        },
        Body {
            name: "floor",
            shape: Shape::Box { half: DVec3::new(0.75, 0.75, 0.04) },
            motion: Motion { start: DVec3::Z * -0.72, ..Motion::default() },
            colors: [[0.34, 0.36, 0.34], [0.82, 0.82, 0.76]],
            pattern: 9.0,
        },
    ]
}
