//! A scene as tracks: made from frames, evaluated at any time, as bytes.

use crate::PlayerError;
use crate::fit::{Bounds, add};
use crate::frames::{Frames, Tolerance, aligned, mean_coefficient, sizes};
use crate::stream::{Reader, Writer};
use crate::track::Track;
use crate::words::{knot, unit};
use glam::Vec3;
use gs_core::{Camera, Color, Kernel, Splats, cast, rot, sh};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};

/// Steps of an SH coefficient in 1.
const SH_STEPS: f32 = 64.0;
/// Shares of ½ in a byte of a knot.
const KNOT_STEPS: f32 = 510.0;

/// Colours that can be shown in place of the scene's.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Layer {
    /// Its name, such as `velocity`.
    pub name: String,
    /// What the colours say, in words.
    pub meaning: String,
    /// One display-encoded colour per splat of the clip.
    pub colors: Vec<[u8; 3]>,
}

/// How a clip is rendered; as in `gs_raster::RasterOptions`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct RenderSettings {
    /// Splats whose centre is no deeper in front of the camera are not rendered, world units.
    pub near: f64,
    /// Added to the variances of projected splats, pixels².
    pub dilation: f64,
    /// Whether opacities make up for the dilation, as in Mip-Splatting.
    pub antialias: bool,
}

impl Default for RenderSettings {
    /// 3D Gaussian Splatting's, but for gsplat's near plane.
    fn default() -> Self {
        Self { near: 0.01, dilation: 0.3, antialias: false }
    }
}

/// A moving scene whose error is bounded by a [`Tolerance`].
#[derive(Clone, Debug, PartialEq)]
pub struct Clip {
    times: Vec<f32>,
    /// Means, quaternions, natural logarithms of the scales, opacities, colours.
    tracks: [Track; 5],
    /// SH degree, and `[splats, (degree + 1)², 3]` in 1/64; the first coefficient is a colour to be added.
    harmonics: Option<(u8, Vec<i8>)>,
    knots: Option<Knots>,
    layers: Vec<Layer>,
    render_settings: RenderSettings,
}

/// Knot and value of the kernel of each splat, see [`crate::words`].
#[derive(Clone, Debug, PartialEq, Eq)]
struct Knots {
    kind: Kind,
    of: Vec<[u8; 2]>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
enum Kind {
    Frequency,
    Acutance,
}

/// The part of a clip that is text. A page with a key that is not here is refused: it would be rendered in another way than its own.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Head {
    version: u32,
    count: usize,
    times: Vec<f32>,
    degree: Option<u8>,
    kernel: Option<Kind>,
    layers: Vec<(String, String)>,
    #[serde(default)]
    render_settings: RenderSettings,
}

/// The key of a head that says which others there may be.
#[derive(Deserialize)]
struct HeadVersion {
    version: u32,
}

const VERSION: u32 = 1;
/// Components of each track.
const WIDTHS: [usize; 5] = [3, 4, 3, 1, 3];
/// Most splats of a clip.
const MOST: usize = 1 << 24;

impl Head {
    /// Reads the head, its version before anything else.
    fn read(from: &mut Reader<'_>) -> Result<Self, PlayerError> {
        let length = from.unsigned().map_err(PlayerError::Damaged)? as usize;
        let text = from.bytes(length).map_err(PlayerError::Damaged)?;
        let HeadVersion { version } = from_head(text)?;
        match version {
            VERSION => from_head(text),
            other => Err(PlayerError::OtherVersion(format!("version {other}, not {VERSION}"))),
        }
    }
}

/// Reads what is known of a head. Text that is JSON and does not hold it is of another version.
fn from_head<T: DeserializeOwned>(text: &[u8]) -> Result<T, PlayerError> {
    serde_json::from_slice(text).map_err(|e| match e.is_data() {
        true => PlayerError::OtherVersion(e.to_string()),
        false => PlayerError::Damaged(e.to_string()),
    })
}

impl Clip {
    /// The frames within a tolerance, as the nearest of `cameras` sees them.
    pub fn fit(frames: &Frames, cameras: &[Camera], tolerance: Tolerance) -> Self {
        let (middle, count) = (frames.middle(), frames.len());
        let harmonics = match &middle.color {
            Color::Rgb(_) => None,
            Color::Sh { degree, .. } => Some((*degree, harmonics(frames))),
        };
        let base = |i: usize, c: usize| {
            harmonics.as_ref().map_or(0.0, |(d, all)| f32::from(all[i * 3 * sh::coeffs(*d) + c]) / SH_STEPS)
        };
        let mut tracks = WIDTHS.map(Track::new);
        let [means, quats, log_scales, opacities, colors] = &mut tracks;
        for (i, size) in sizes(frames, cameras).into_iter().enumerate() {
            let largest = frames.splats.iter().fold(0.0f32, |m, s| m.max(s.opacities[i]));
            let bounds = Bounds::new(tolerance.0, size, largest);
            let each = |of: &dyn Fn(&Splats) -> Vec<f32>| frames.splats.iter().flat_map(of).collect::<Vec<f32>>();
            add(means, &each(&|s| s.means[i].to_array().to_vec()), bounds.mean);
            add(quats, &aligned(frames, i), bounds.quat);
            let logarithm = |v: f32| v.abs().max(1e-12).ln();
            add(log_scales, &each(&|s| s.scales[i].to_array().map(logarithm).to_vec()), bounds.log_scale);
            add(opacities, &each(&|s| vec![s.opacities[i]]), bounds.opacity);
            let rgb = |s: &Splats| (0..3).map(|c| (flat(&s.color, i)[c] - base(i, c)).clamp(0.0, 1.0)).collect();
            add(colors, &each(&rgb), bounds.color);
        }
        let kind = match &middle.kernel {
            Kernel::Frequency { .. } => Some(Kind::Frequency),
            Kernel::Acutance { .. } => Some(Kind::Acutance),
            _ => None,
        };
        let of = |i| middle.kernel.bend(i).map_or([128; 2], knot);
        let knots = kind.map(|kind| Knots { kind, of: (0..count).map(of).collect() });
        let (layers, render_settings) = (Vec::new(), RenderSettings::default());
        Self { times: frames.times.clone(), tracks, harmonics, knots, layers, render_settings }
    }

    /// The same, rendered in another way than by default.
    pub fn with_render_settings(self, render_settings: RenderSettings) -> Self {
        Self { render_settings, ..self }
    }

    /// How the page renders it.
    pub fn render_settings(&self) -> RenderSettings {
        self.render_settings
    }

    /// The same with layers, each with a colour for every splat; others are left out.
    pub fn with_layers(mut self, layers: Vec<Layer>) -> Self {
        let count = self.len();
        self.layers = layers.into_iter().filter(|l| l.colors.len() == count).collect();
        self
    }

    /// Number of splats.
    pub fn len(&self) -> usize {
        self.tracks[0].exponents.len()
    }

    /// Whether there are no splats.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Normalised times of the frames.
    pub fn times(&self) -> &[f32] {
        &self.times
    }

    /// Keys of all means together: as many as splats where nothing moves.
    pub fn keys(&self) -> usize {
        self.tracks[0].frames.len()
    }

    /// Splats whose mean has more than one key.
    pub fn moving(&self) -> usize {
        self.tracks[0].starts.windows(2).filter(|w| w[1] - w[0] > 1).count()
    }

    /// The frame of a normalised time, in whole frames and parts of them; times outside are those of the ends.
    fn frame(&self, time: f32) -> f32 {
        let after = self.times.partition_point(|&t| t <= time);
        match (after.checked_sub(1).map(|k| (k, self.times[k])), self.times.get(after)) {
            (Some((k, a)), Some(&b)) => k as f32 + (time - a) / (b - a),
            (Some((k, _)), None) => k as f32,
            (None, _) => 0.0,
        }
    }

    /// The scene at a normalised time, as the page draws it.
    pub fn splats(&self, time: f32) -> Splats {
        let (frame, count) = (self.frame(time), self.len());
        let [means, quats, log_scales, opacities, colors] = &self.tracks;
        fn column<const N: usize>(track: &Track, count: usize, frame: f32) -> Vec<[f32; N]> {
            let value = |i| {
                let mut out = [0.0; N];
                track.at(i, frame, &mut out);
                out
            };
            (0..count).map(value).collect()
        }
        let rgb: Vec<[f32; 3]> = column::<3>(colors, count, frame).into_iter().map(|c| c.map(in_bytes)).collect();
        let color = match &self.harmonics {
            None => Color::Rgb(rgb),
            Some((degree, values)) => {
                let mut coeffs: Vec<f32> = values.iter().map(|&v| f32::from(v) / SH_STEPS).collect();
                for (row, rgb) in coeffs.chunks_exact_mut(3 * sh::coeffs(*degree)).zip(rgb) {
                    for (base, v) in row.iter_mut().zip(rgb) {
                        *base = (*base + v - 0.5) / cast::to_f32(sh::C0);
                    }
                }
                Color::Sh { degree: *degree, coeffs }
            }
        };
        Splats {
            means: column::<3>(means, count, frame).into_iter().map(Vec3::from_array).collect(),
            quats: column::<4>(quats, count, frame).into_iter().map(|q| rot::normalise(q).wxyz).collect(),
            scales: column::<3>(log_scales, count, frame)
                .into_iter()
                .map(|s| Vec3::from_array(s.map(f32::exp)))
                .collect(),
            opacities: column::<1>(opacities, count, frame).into_iter().map(|[o]| in_bytes(o)).collect(),
            color,
            kernel: self.knots.as_ref().map_or(Kernel::Gaussian, Knots::kernel),
        }
    }

    /// As bytes: the length of the head, the head, the tracks, harmonics, knots, layers.
    pub(crate) fn bytes(&self) -> Result<Vec<u8>, serde_json::Error> {
        let head = Head {
            version: VERSION,
            count: self.len(),
            times: self.times.clone(),
            degree: self.harmonics.as_ref().map(|h| h.0),
            kernel: self.knots.as_ref().map(|k| k.kind),
            layers: self.layers.iter().map(|l| (l.name.clone(), l.meaning.clone())).collect(),
            render_settings: self.render_settings,
        };
        let text = serde_json::to_vec(&head)?;
        let mut out = Writer::default();
        out.unsigned(text.len() as u32);
        out.bytes(text);
        self.tracks.iter().for_each(|t| t.write(&mut out));
        if let Some((degree, values)) = &self.harmonics {
            planes(&mut out, values.iter().map(|v| v.cast_unsigned()), 3 * sh::coeffs(*degree));
        }
        if let Some(knots) = &self.knots {
            planes(&mut out, knots.of.iter().flatten().copied(), 2);
        }
        self.layers.iter().for_each(|l| planes(&mut out, l.colors.iter().flatten().copied(), 3));
        Ok(out.0)
    }

    /// Reads [`Self::bytes`].
    pub(crate) fn parse(bytes: &[u8]) -> Result<Self, PlayerError> {
        let mut from = Reader(bytes);
        let head = Head::read(&mut from)?;
        Self::behind(head, from).map_err(PlayerError::Damaged)
    }

    /// Reads what follows a head.
    fn behind(head: Head, mut from: Reader<'_>) -> Result<Self, String> {
        let (count, frames) = (head.count, head.times.len());
        if let Some(degree) = head.degree.filter(|d| *d > sh::MAX_DEGREE) {
            return Err(format!("harmonics of degree {degree}"));
        }
        if count > MOST || frames == 0 || frames > usize::from(u16::MAX) || !head.times.is_sorted_by(|a, b| a < b) {
            return Err(format!("{count} splats at {frames} times"));
        }
        let mut track = |width| Track::read(&mut from, width, count, frames);
        let [a, b, c, d, e] = WIDTHS.map(&mut track);
        let tracks = [a?, b?, c?, d?, e?];
        let harmonics = match head.degree {
            Some(degree) => {
                let values = unplaned(&mut from, count, 3 * sh::coeffs(degree))?;
                Some((degree, values.into_iter().map(u8::cast_signed).collect()))
            }
            None => None,
        };
        let knots = match head.kernel {
            Some(kind) => Some(Knots { kind, of: unplaned(&mut from, count, 2)?.as_chunks().0.to_vec() }),
            None => None,
        };
        let mut layers = Vec::new();
        for (name, meaning) in head.layers {
            layers.push(Layer { name, meaning, colors: unplaned(&mut from, count, 3)?.as_chunks().0.to_vec() });
        }
        match from.0 {
            [] => {
                Ok(Self { times: head.times, tracks, harmonics, knots, layers, render_settings: head.render_settings })
            }
            rest => Err(format!("{} bytes too many", rest.len())),
        }
    }
}

/// A share of 1 rounded to 8 bits, as the page keeps it.
fn in_bytes(v: f32) -> f32 {
    f32::from(unit(v)) / 255.0
}

/// Colour of degree 0 of a splat.
pub(crate) fn flat(color: &Color, i: usize) -> [f32; 3] {
    match color {
        Color::Rgb(all) => all[i],
        Color::Sh { coeffs, .. } => {
            let row = &coeffs[i * color.width()..];
            [row[0], row[1], row[2]].map(|v| 0.5 + cast::to_f32(sh::C0) * v)
        }
    }
}

/// The mean coefficients over time in 1/64; the first is by how much the middle of the range of the colour of degree 0 is off ½, where that range leaves 0..1.
fn harmonics(frames: &Frames) -> Vec<i8> {
    let width = frames.middle().color.width();
    let byte = |v: f32| (v * SH_STEPS).round().clamp(-127.0, 127.0) as i8;
    let mut out = Vec::with_capacity(width * frames.len());
    for i in 0..frames.len() {
        for c in 0..3 {
            let all = frames.splats.iter().map(|s| flat(&s.color, i)[c]);
            let [low, high] = all.fold([f32::INFINITY, f32::NEG_INFINITY], |[a, b], v| [a.min(v), b.max(v)]);
            let inside = low >= 0.0 && high <= 1.0;
            let half = 0.5 * (low + high);
            out.push(if inside { 0 } else { byte(half - 0.5) });
        }
        out.extend((3..width).map(|k| byte(mean_coefficient(frames, i, k))));
    }
    out
}

impl Knots {
    fn kernel(&self) -> Kernel {
        let knots = || self.of.iter().map(|k| k.map(|v| f32::from(v) / KNOT_STEPS));
        match self.kind {
            // p = (1 + κ)/4
            Kind::Acutance => {
                Kernel::Acutance { acutances: knots().map(|[p, _]| (4.0 * p - 1.0).clamp(-0.999, 0.999)).collect() }
            }
            // v = (1 − β)/2, p = (½ + λ − β)/(1 + 2λ)
            Kind::Frequency => {
                let beta = |v: f32| (1.0 - 2.0 * v).clamp(0.0, 1.0);
                let lambda = |[p, v]: [f32; 2]| {
                    if p == v { 0.5 } else { ((beta(v) + p - 0.5) / (1.0 - 2.0 * p).max(1e-3)).clamp(0.0, 1.0) }
                };
                Kernel::Frequency {
                    lambdas: knots().map(lambda).collect(),
                    betas: knots().map(|[_, v]| beta(v)).collect(),
                }
            }
        }
    }
}

/// Appends rows of `width` bytes component by component.
fn planes(out: &mut Writer, rows: impl Iterator<Item = u8>, width: usize) {
    let rows: Vec<u8> = rows.collect();
    (0..width).for_each(|c| out.bytes(rows.iter().skip(c).step_by(width).copied()));
}

/// Reads [`planes`].
fn unplaned(from: &mut Reader<'_>, count: usize, width: usize) -> Result<Vec<u8>, String> {
    let planes = from.bytes(count.saturating_mul(width))?;
    Ok((0..count * width).map(|k| planes[(k % width) * count + k / width]).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Settings under a name that is not known would be read as the default, so they are refused.
    #[test]
    fn heads_of_other_versions_are_not_called_damaged() {
        let splats = Splats {
            means: vec![Vec3::Z],
            quats: vec![[1.0, 0.0, 0.0, 0.0]],
            scales: vec![Vec3::splat(0.1)],
            opacities: vec![0.9],
            color: Color::Rgb(vec![[1.0, 0.0, 0.0]]),
            kernel: Kernel::Gaussian,
        };
        let frames = Frames::new(vec![0.0], vec![splats]).unwrap();
        let settings = RenderSettings { near: 0.2, dilation: 0.1, antialias: true };
        let clip = Clip::fit(&frames, &[], Tolerance::default()).with_render_settings(settings);
        let bytes = clip.bytes().unwrap();
        assert_eq!(Clip::parse(&bytes).unwrap(), clip);
        // The same length, so that the head stays as long as it says.
        let with = |[old, new]: [&str; 2]| {
            let at = bytes.windows(old.len()).position(|w| w == old.as_bytes()).unwrap();
            let mut bytes = bytes.clone();
            bytes[at..at + old.len()].copy_from_slice(new.as_bytes());
            Clip::parse(&bytes).unwrap_err()
        };
        for (change, what) in [
            (["render_settings", "drawing_options"], "unknown field `drawing_options`"),
            (["\"count\"", "\"tally\""], "unknown field `tally`"),
            (["\"version\"", "\"edition\""], "missing field `version`"),
            (["\"version\":1", "\"version\":2"], "version 2, not 1"),
            (["\"version\":1,\"count\"", "\"version\":2,\"tally\""], "version 2, not 1"),
        ] {
            let e = with(change);
            assert!(matches!(&e, PlayerError::OtherVersion(why) if why.contains(what)), "{e}");
            assert!(e.to_string().contains("export it again from the run"), "{e}");
        }
        for change in [["{\"version\"", "{:version\""], ["\"degree\":null", "\"degree\":  99"]] {
            let e = with(change);
            assert!(matches!(&e, PlayerError::Damaged(_)), "{e}");
        }
    }
}
