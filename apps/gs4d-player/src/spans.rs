//! A scene as Gaussians that each last for a span of time, as `.4dgs` files hold it.

use crate::PlayerError;
use crate::clip::flat;
use crate::fit::Bounds;
use crate::frames::{Frames, Size, Tolerance, VISIBLE, aligned, mean_coefficient, sizes};
use fourdgs::quantization::{DEFAULT_CUTOFF, Profile, SH_QUANT_HI, SH_QUANT_LO, sh_coefficient};
use fourdgs::{GaussianSet, ReadOptions, SceneExtras, WriteOptions};
use glam::Vec3;
use gs_core::{Camera, Color, Kernel, Splats, cast, rot, sh};
use std::collections::BTreeMap;
use std::ops::Range;

/// Times are whole multiples of this in a file, seconds: the step of [`Profile::Fine`].
const TICK: f64 = 1e-3;
/// Longest span of a Gaussian that moves, seconds: the format bounds the error of a displacement over no more (section 6.3).
const LONGEST: f64 = 2.0;
/// Header attributes: the normalised time at 0 s, and the seconds of a unit of normalised time.
const ATTRIBUTES: [&str; 2] = ["gs4d_first_time", "gs4d_seconds"];

/// A moving scene as Gaussians with one velocity each, visible from a time to another and constant but for that: what the temporal model
/// `gaussian-birth` of `.4dgs` files says (Avala AI, 2026, specification version 1, section 3). A splat becomes as many of them as its
/// motion needs. Colours of degree 0 are clamped to 0..1, harmonics above it are their mean over time. The format does not say how splats
/// are drawn: small ones of a scene that is drawn anti-aliased are too opaque.
pub struct Spans {
    gaussians: GaussianSet,
    /// Normalised time at 0 s.
    first: f64,
    /// Seconds per unit of normalised time.
    seconds: f64,
    /// Of the whole file, seconds.
    duration: f64,
    /// Marginal below which a reader does not show a Gaussian.
    cutoff: f64,
}

/// What is constant while a Gaussian lasts: quaternion, natural logarithms of the scales, opacity, colour of degree 0.
type Row = [f32; 11];

/// A splat over the frames.
struct Path {
    means: Vec<Vec3>,
    rows: Vec<Row>,
    /// How far a mean may be off, world units.
    mean: f32,
    /// The same of the values of a row.
    row: Row,
}

/// The frames that a Gaussian lasts for, and whether its mean rests.
struct Span {
    frames: Range<usize>,
    rests: bool,
}

impl Spans {
    /// The frames within a tolerance, as the nearest of `cameras` sees them; `seconds` is how long a unit of normalised time plays.
    /// Between frames where rotation, size, opacity or colour change by more than twice the tolerance, they are their mean. The last
    /// frame is held for the mean interval of the others. Kernels that are not Gaussian are taken for Gaussian ones.
    pub fn fit(frames: &Frames, cameras: &[Camera], tolerance: Tolerance, seconds: f64) -> Self {
        let first = frames.times.first().map_or(0.0, |&t| f64::from(t));
        let mut starts: Vec<f64> = frames.times.iter().map(|&t| (f64::from(t) - first) * seconds).collect();
        let last = starts.last().copied().unwrap_or(0.0);
        let interval = if last > 0.0 { last / (starts.len() - 1) as f64 } else { seconds };
        let duration = last + interval;
        // Every span ends where the next begins, to the bit.
        starts.push(duration);
        let degree = match frames.middle().color {
            Color::Sh { degree, .. } => degree,
            Color::Rgb(_) => 0,
        };
        let count = sh::coeffs(degree) - 1;
        let mut gaussians = GaussianSet { sh_degree: degree, sh_coefficients: count, ..GaussianSet::default() };
        let mut harmonics = Vec::new();
        for (i, size) in sizes(frames, cameras).into_iter().enumerate() {
            let (path, bytes) = (Path::new(frames, i, size, tolerance), harmonic_bytes(frames, i, count));
            let mut from = 0;
            while from < path.rows.len() {
                let span = path.span(from, &starts);
                from = span.frames.end;
                if path.push(&mut gaussians, &span, &starts) {
                    harmonics.extend_from_slice(&bytes);
                }
            }
        }
        gaussians.sh = (degree > 0).then_some(harmonics);
        Self { gaussians, first, seconds, duration, cutoff: DEFAULT_CUTOFF }
    }

    /// Number of Gaussians.
    pub fn len(&self) -> usize {
        self.gaussians.count()
    }

    /// Whether there are none.
    pub fn is_empty(&self) -> bool {
        self.gaussians.is_empty()
    }

    /// How long the file plays, seconds.
    pub fn duration(&self) -> f64 {
        self.duration
    }

    /// As a `.4dgs` file of the finest of its profiles: means lie on a grid of a twenty-fifth of the median scale.
    ///
    /// # Errors
    /// If the encoder refuses a value.
    pub fn bytes(&self) -> Result<Vec<u8>, PlayerError> {
        let times = ATTRIBUTES.into_iter().zip([self.first, self.seconds].map(|v| v.to_string()));
        let registered = [("color_space", "srgb-rec709-display"), ("visibility_profile", "box"), ("source", "gs4d")];
        let registered = registered.map(|(key, value)| (key, value.to_owned()));
        let metadata: BTreeMap<String, String> =
            times.chain(registered).map(|(key, value)| (key.to_owned(), value)).collect();
        let options = WriteOptions {
            profile: Profile::Fine,
            cutoff: self.cutoff,
            sh_bands: self.gaussians.sh_degree,
            library: format!("gs4d {}", env!("CARGO_PKG_VERSION")),
            metadata,
            // It takes the rounding of large coordinates to f32 for a violation.
            verify: false,
            ..WriteOptions::default()
        };
        let written = fourdgs::write_to_vec(&self.gaussians, self.duration, &options, &SceneExtras::default());
        written.map_err(|e| PlayerError::Write(e.to_string()))
    }

    /// Reads such a file. One of another program has normalised time 0 to 1 from its beginning to its end.
    ///
    /// # Errors
    /// If it is damaged, or of another temporal model.
    pub fn read(bytes: &[u8]) -> Result<Self, PlayerError> {
        let options = ReadOptions { recover_truncated: false, ..ReadOptions::default() };
        let scene = fourdgs::stream_reader::read_from(bytes, &options);
        let scene = scene.map_err(|e| PlayerError::Damaged(e.to_string()))?;
        let g = &scene.gaussians;
        if g.sh.is_some() && g.sh_coefficients + 1 != sh::coeffs(g.sh_degree) {
            return Err(PlayerError::Damaged(format!("harmonics are missing of degree {}", g.sh_degree)));
        }
        let attribute =
            |key| scene.header.attributes.get(key).and_then(|v| v.parse::<f64>().ok()).filter(|v| v.is_finite());
        let [first, seconds] = ATTRIBUTES.map(attribute);
        let seconds = seconds.filter(|s| *s > 0.0).unwrap_or(scene.duration_sec);
        let (gaussians, duration, cutoff) = (scene.gaussians, scene.duration_sec, scene.header.cutoff);
        Ok(Self { gaussians, first: first.unwrap_or(0.0), seconds, duration, cutoff })
    }

    /// The Gaussians of a normalised time; times outside are those of the ends.
    pub fn splats(&self, time: f32) -> Splats {
        let g = &self.gaussians;
        // The end itself is no longer within any span.
        let t = ((f64::from(time) - self.first) * self.seconds).clamp(0.0, (self.duration - 0.5 * TICK).max(0.0));
        let state = g.state_at(t, self.cutoff);
        let rows: Vec<usize> = state.indices.iter().map(|&k| k as usize).collect();
        let three = |all: &[f32], k: usize| Vec3::from_slice(&all[3 * k..3 * k + 3]);
        let rgb = rows.iter().map(|&k| [0, 1, 2].map(|c| g.colors[4 * k + c]));
        let color = match &g.sh {
            None => Color::Rgb(rgb.collect()),
            Some(bytes) => {
                let (count, mut coeffs) = (g.sh_coefficients, Vec::new());
                for (&k, rgb) in rows.iter().zip(rgb) {
                    let row = &bytes[3 * count * k..][..3 * count];
                    coeffs.extend(rgb.map(|v| (v - 0.5) / cast::to_f32(sh::C0)));
                    let value = |j: usize, c: usize| cast::to_f32(sh_coefficient(row[c * count + j]));
                    coeffs.extend((0..count).flat_map(|j| [0, 1, 2].map(|c| value(j, c))));
                }
                Color::Sh { degree: g.sh_degree, coeffs }
            }
        };
        Splats {
            means: (0..rows.len()).map(|k| three(&state.centers, k)).collect(),
            quats: state.orientations.chunks_exact(4).map(|q| [q[3], q[0], q[1], q[2]]).collect(),
            scales: rows.iter().map(|&k| three(&g.scales, k)).collect(),
            opacities: state.opacity,
            color,
            kernel: Kernel::Gaussian,
        }
    }
}

impl Path {
    fn new(frames: &Frames, i: usize, size: Size, tolerance: Tolerance) -> Self {
        let largest = frames.splats.iter().fold(0.0f32, |m, s| m.max(s.opacities[i]));
        let Bounds { mean, quat, log_scale, opacity, color } = Bounds::new(tolerance.0, size, largest);
        let quats = aligned(frames, i);
        let row = |(s, q): (&Splats, &[f32; 4])| {
            let size = s.scales[i].to_array().map(|v| v.abs().max(1e-12).ln());
            let rgb = flat(&s.color, i).map(|v| v.clamp(0.0, 1.0));
            [q[0], q[1], q[2], q[3], size[0], size[1], size[2], s.opacities[i], rgb[0], rgb[1], rgb[2]]
        };
        Self {
            means: frames.splats.iter().map(|s| s.means[i]).collect(),
            rows: frames.splats.iter().zip(quats.as_chunks().0).map(row).collect(),
            mean,
            row: [quat, quat, quat, quat, log_scale, log_scale, log_scale, opacity, color, color, color],
        }
    }

    /// The span from a frame on: the longest found that stays within the bounds, of one frame at least.
    fn span(&self, from: usize, starts: &[f64]) -> Span {
        let last = self.rows.len() - 1;
        let [mut low, mut high] = [self.rows[from]; 2];
        let [mut nearest, mut farthest] = [self.means[from]; 2];
        let (mut to, mut rests) = (from, true);
        while to < last {
            let (next, mean) = (&self.rows[to + 1], self.means[to + 1]);
            low.iter_mut().zip(next).for_each(|(low, v)| *low = low.min(*v));
            high.iter_mut().zip(next).for_each(|(high, v)| *high = high.max(*v));
            (nearest, farthest) = (nearest.min(mean), farthest.max(mean));
            let still = low.iter().zip(high).zip(self.row).all(|((low, high), bound)| high - low <= 2.0 * bound);
            let resting = (farthest - nearest).max_element() <= 2.0 * self.mean;
            if !(still && (resting || self.is_straight(from, to + 1, starts))) {
                break;
            }
            (to, rests) = (to + 1, resting);
        }
        if to == from {
            return Span { frames: from..from + 1, rests: from == last };
        }
        // Over a short span within its bounds, a line is nearer to what moves than its middle.
        let moves = self.means[from].distance(self.means[to]) > self.mean && self.is_straight(from, to, starts);
        let rests = rests && !moves;
        // What rests at the last frame stays; what moves has arrived there.
        let end = if to == last && rests { last + 1 } else { to };
        Span { frames: from..end, rests }
    }

    /// Whether the mean is on a line between two frames, and no longer on it than a file can say.
    fn is_straight(&self, from: usize, to: usize, starts: &[f64]) -> bool {
        let length = starts[to] - starts[from];
        let near = |m: usize| {
            let share = cast::to_f32((starts[m] - starts[from]) / length);
            self.means[from].lerp(self.means[to], share).distance(self.means[m]) <= self.mean
        };
        (to == from + 1 || length <= LONGEST) && (from + 1..to).all(near)
    }

    /// Appends the Gaussian of a span; not one that is invisible.
    fn push(&self, to: &mut GaussianSet, span: &Span, starts: &[f64]) -> bool {
        let (a, b) = (span.frames.start, span.frames.end.min(self.rows.len() - 1));
        let [w, x, y, z, size @ .., opacity, red, green, blue] = middle(&self.rows[a..=b]);
        if opacity < VISIBLE {
            return false;
        }
        // The time that the mean is of, as a file keeps it.
        let birth = (starts[a] / TICK).round() * TICK;
        let (mean, velocity) = if span.rests {
            let range = |pick: fn(Vec3, Vec3) -> Vec3| self.means[a..=b].iter().copied().fold(self.means[a], pick);
            (0.5 * (range(Vec3::min) + range(Vec3::max)), Vec3::ZERO)
        } else {
            let velocity = (self.means[b] - self.means[a]) / cast::to_f32(starts[b] - starts[a]);
            (self.means[a] + velocity * cast::to_f32(birth - starts[a]), velocity)
        };
        to.positions.extend(mean.to_array());
        to.scales.extend(size.map(f32::exp));
        to.rotations.extend([x, y, z, w]);
        to.colors.extend([red, green, blue, opacity]);
        to.motions.extend(velocity.to_array());
        to.mu_t.push(cast::to_f32(birth));
        to.sigma_t.push(f32::INFINITY);
        to.win_lo.push(cast::to_f32(starts[a]));
        to.win_hi.push(cast::to_f32(starts[span.frames.end]));
        true
    }
}

/// The middle of the range of each value, the quaternion a unit one.
fn middle(rows: &[Row]) -> Row {
    let mut out: Row = std::array::from_fn(|c| {
        let range = rows.iter().fold([f32::INFINITY, f32::NEG_INFINITY], |[a, b], r| [a.min(r[c]), b.max(r[c])]);
        0.5 * (range[0] + range[1])
    });
    let unit = rot::normalise([out[0], out[1], out[2], out[3]]).wxyz;
    out[..4].copy_from_slice(&unit);
    out
}

/// The harmonics above degree 0 of a splat as bytes, all of red first; they do not change with time.
fn harmonic_bytes(frames: &Frames, i: usize, count: usize) -> Vec<u8> {
    let scale = 255.0 / (SH_QUANT_HI - SH_QUANT_LO);
    let byte = |v: f32| cast::to_u8(cast::to_f32((f64::from(v) - SH_QUANT_LO) * scale).round());
    let each = |c: usize| (1..=count).map(move |j| mean_coefficient(frames, i, 3 * j + c));
    (0..3).flat_map(each).map(byte).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn path(means: Vec<Vec3>) -> Path {
        let rows = vec![[0.5; 11]; means.len()];
        Path { means, rows, mean: 0.01, row: [0.01; 11] }
    }

    /// Frames of the spans of a path, and whether they rest.
    fn spans(path: &Path, starts: &[f64]) -> Vec<(Range<usize>, bool)> {
        let (mut from, mut out) = (0, Vec::new());
        while from < path.rows.len() {
            let span = path.span(from, starts);
            from = span.frames.end;
            out.push((span.frames, span.rests));
        }
        out
    }

    #[test]
    fn a_span_ends_where_the_motion_bends_or_the_rest_changes() {
        let starts: Vec<f64> = (0..10).map(|k| 0.1 * f64::from(k)).collect();
        let line = |at: fn(f32) -> f32| path((0..9).map(|k| Vec3::X * at(k as f32)).collect());
        assert_eq!(spans(&line(|_| 1.0), &starts), [(0..9, true)]);
        assert_eq!(spans(&line(|k| k), &starts), [(0..8, false), (8..9, true)]);
        assert_eq!(spans(&line(|k| (k - 4.0).abs()), &starts), [(0..4, false), (4..8, false), (8..9, true)]);
        // Half of the time at rest.
        assert_eq!(spans(&line(|k| (k - 4.0).max(0.0)), &starts), [(0..4, true), (4..8, false), (8..9, true)]);
        let mut fades = line(|k| k);
        fades.rows[6][7] = 0.4;
        let want = [(0..5, false), (5..6, false), (6..7, false), (7..8, false), (8..9, true)];
        assert_eq!(spans(&fades, &starts), want);
        // Longer than the format can say.
        let slow: Vec<f64> = (0..10).map(|k| 0.7 * f64::from(k)).collect();
        assert_eq!(spans(&line(|k| k), &slow)[..2], [(0..2, false), (2..4, false)]);
        // A line in time is none in frames that are not evenly spaced.
        let uneven = [0.0, 0.1, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0, 1.1];
        let moved = path(uneven[..9].iter().map(|t| Vec3::X * *t as f32).collect());
        assert_eq!(spans(&moved, &uneven), [(0..8, false), (8..9, true)]);
    }
}
