//! A scene as Gaussians that each last for a span of time, as `.4dgs` files hold it.

use crate::PlayerError;
use crate::clip::flat;
use crate::fit::Bounds;
use crate::frames::{Frames, Tolerance, VISIBLE, aligned, mean_coefficient, sizes};
use fourdgs::quantization::{DEFAULT_CUTOFF, Profile, SH_QUANT_HI, SH_QUANT_LO, sh_coefficient};
use fourdgs::{GaussianSet, ReadOptions, SceneExtras, WriteOptions};
use glam::Vec3;
use gs_core::{Camera, Color, Kernel, Splats, cast, rot, sh};
use std::collections::BTreeMap;
use std::ops::Range;

/// Times are whole multiples of this in a file, seconds: the step of [`Profile::Fine`].
const TICK: f64 = 1e-3;
/// Header attributes: the normalised time at 0 s, and the seconds of a unit of normalised time.
const ATTRIBUTES: [&str; 2] = ["gs4d_first_time", "gs4d_seconds"];

/// A moving scene as Gaussians with one velocity each, visible from a time to another and constant but for that: what the temporal model
/// `gaussian-birth` of `.4dgs` files says (Avala AI, 2026, specification version 1, section 3). A splat becomes as many of them as its
/// motion needs.
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

impl Spans {
    /// The frames within a tolerance, as the nearest of `cameras` sees them; `seconds` is how long a unit of normalised time plays.
    /// Between frames where rotation, size, opacity or colour change by more than twice the tolerance, they are their mean. The last
    /// frame lasts as long as the others. Kernels that are not Gaussian are taken for Gaussian ones.
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
        let mut gaussians = GaussianSet { sh_degree: degree, ..GaussianSet::default() };
        gaussians.sh_coefficients = sh::coeffs(degree) - 1;
        let mut harmonics = Vec::new();
        for (i, size) in sizes(frames, cameras).into_iter().enumerate() {
            let largest = frames.splats.iter().fold(0.0f32, |m, s| m.max(s.opacities[i]));
            let bounds = Bounds::new(tolerance.0, size, largest);
            let means: Vec<Vec3> = frames.splats.iter().map(|s| s.means[i]).collect();
            let rows = rows(frames, i);
            let bytes = harmonic_bytes(frames, i, gaussians.sh_coefficients);
            let mut from = 0;
            while from < rows.len() {
                let to = end(from, &means, &rows, bounds);
                let middle = middle(&rows[from..=to.min(rows.len() - 1)]);
                if middle[7] >= VISIBLE {
                    push(&mut gaussians, &means, &middle, from..to, &starts);
                    harmonics.extend_from_slice(&bytes);
                }
                from = to;
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

    /// As a `.4dgs` file of the finest of its profiles.
    ///
    /// # Errors
    /// If the encoder refuses a value or finds one outside the bounds that the file declares.
    pub fn bytes(&self) -> Result<Vec<u8>, PlayerError> {
        let own =
            ATTRIBUTES.into_iter().zip([self.first, self.seconds]).map(|(key, v)| (key.to_owned(), v.to_string()));
        let said = [("color_space", "srgb-rec709-display"), ("visibility_profile", "box"), ("source", "gs4d")];
        let said = said.into_iter().map(|(key, value)| (key.to_owned(), value.to_owned()));
        let metadata: BTreeMap<String, String> = own.chain(said).collect();
        let options = WriteOptions {
            profile: Profile::Fine,
            cutoff: self.cutoff,
            sh_bands: self.gaussians.sh_degree,
            library: format!("gs4d {}", env!("CARGO_PKG_VERSION")),
            metadata,
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

/// The constant values of a splat at each frame.
fn rows(frames: &Frames, i: usize) -> Vec<Row> {
    let quats = aligned(frames, i);
    let row = |(s, q): (&Splats, &[f32; 4])| {
        let size = s.scales[i].to_array().map(|v| v.abs().max(1e-12).ln());
        let rgb = flat(&s.color, i).map(|v| v.clamp(0.0, 1.0));
        [q[0], q[1], q[2], q[3], size[0], size[1], size[2], s.opacities[i], rgb[0], rgb[1], rgb[2]]
    };
    frames.splats.iter().zip(quats.as_chunks().0).map(row).collect()
}

/// The frame that a span from `from` ends before: the farthest found that stays within the bounds; the next one at least.
fn end(from: usize, means: &[Vec3], rows: &[Row], bounds: Bounds) -> usize {
    let Bounds { mean, quat, log_scale, opacity, color } = bounds;
    let bound: Row = [quat, quat, quat, quat, log_scale, log_scale, log_scale, opacity, color, color, color];
    let [mut low, mut high] = [rows[from]; 2];
    let mut still = |to: usize| {
        let row = &rows[to];
        low.iter_mut().zip(row).for_each(|(low, v)| *low = low.min(*v));
        high.iter_mut().zip(row).for_each(|(high, v)| *high = high.max(*v));
        low.iter().zip(high).zip(bound).all(|((low, high), bound)| high - low <= 2.0 * bound)
    };
    let straight = |to: usize| {
        (from + 1..to).all(|m| {
            let share = (m - from) as f32 / (to - from) as f32;
            means[from].lerp(means[to], share).distance(means[m]) <= mean
        })
    };
    let far = (from + 1..rows.len()).take_while(|&to| still(to) && straight(to)).last();
    match far {
        // Nothing comes after the last frame, so it is within.
        Some(to) if to == rows.len() - 1 => rows.len(),
        far => far.unwrap_or(from + 1),
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

/// Appends the Gaussian of some frames.
fn push(to: &mut GaussianSet, means: &[Vec3], row: &Row, frames: Range<usize>, starts: &[f64]) {
    let (a, b) = (frames.start, frames.end.min(means.len() - 1));
    let span = starts[b] - starts[a];
    let velocity = if span > 0.0 { (means[b] - means[a]) / cast::to_f32(span) } else { Vec3::ZERO };
    // The time that the mean is of, as a file keeps it.
    let birth = (starts[a] / TICK).round() * TICK;
    let mean = means[a] + velocity * cast::to_f32(birth - starts[a]);
    let [w, x, y, z, size @ .., opacity, r, g, b] = *row;
    to.positions.extend(mean.to_array());
    to.scales.extend(size.map(f32::exp));
    to.rotations.extend([x, y, z, w]);
    to.colors.extend([r, g, b, opacity]);
    to.motions.extend(velocity.to_array());
    to.mu_t.push(cast::to_f32(birth));
    to.sigma_t.push(f32::INFINITY);
    to.win_lo.push(cast::to_f32(starts[frames.start]));
    to.win_hi.push(cast::to_f32(starts[frames.end]));
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

    #[test]
    fn a_span_ends_where_the_motion_bends_or_the_rest_changes() {
        let bounds = Bounds { mean: 0.01, quat: 0.01, log_scale: 0.1, opacity: 0.01, color: 0.01 };
        let straight: Vec<Vec3> = (0..9).map(|k| Vec3::X * k as f32).collect();
        let bent: Vec<Vec3> = (0..9).map(|k| Vec3::X * (k as f32 - 4.0).abs()).collect();
        let same = vec![[0.5; 11]; 9];
        assert_eq!([end(0, &straight, &same, bounds), end(0, &bent, &same, bounds)], [9, 4]);
        assert_eq!([end(4, &bent, &same, bounds), end(8, &bent, &same, bounds)], [9, 9]);
        let mut fades = same;
        fades[6][7] = 0.4;
        assert_eq!(end(0, &straight, &fades, bounds), 5);
    }
}
