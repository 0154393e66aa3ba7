//! Texel maps as one EXR file with named layers: channels `P.X`, `P.Y`, `P.Z`, `T1.R`, … as `f32` or half floats.
//!
//! ```
//! use gs_core::{Image, io::Limits};
//! use gs_texel::maps_exr::{Kind, Layer, load_layers, save_layers};
//!
//! let folder = tempfile::tempdir()?;
//! let file = folder.path().join("maps.exr");
//! let positions = Layer { name: "P".into(), kind: Kind::Vector, half: false, map: Image::zeros(8, 8, 3) };
//! save_layers(&file, &[positions.clone()], false)?;
//! assert_eq!(load_layers(&file, &Limits::default())?, [positions]);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

use gs_core::Image;
use gs_core::io::exr::{Channel, read_channels, save_channels};
use gs_core::io::{IoError, Limits, read_file};
use std::path::Path;

/// Names of the channels of a layer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// `R`, `G`, `B`, `A`; up to 4 channels.
    Color,
    /// `X`, `Y`, `Z`, `W`; up to 4 channels.
    Vector,
    /// `c000`, `c001`, …; up to 1000 channels.
    Plain,
}

/// A named map with the names of its channels.
#[derive(Clone, Debug, PartialEq)]
pub struct Layer {
    /// Name (`P`, `N`, `D`, `T1`, `vis`, …): not empty, without a dot.
    pub name: String,
    /// Names of its channels in the file.
    pub kind: Kind,
    /// Whether values are stored as half floats: 11 bits, magnitude up to 65504.
    pub half: bool,
    /// Values; all maps of a file have one size.
    pub map: Image,
}

impl Kind {
    fn channel(self, i: usize) -> String {
        match self {
            Self::Color => "RGBA".chars().nth(i).map_or_else(String::new, String::from),
            Self::Vector => "XYZW".chars().nth(i).map_or_else(String::new, String::from),
            Self::Plain => format!("c{i:03}"),
        }
    }

    /// Kind and index of a channel name.
    fn of(channel: &str) -> Option<(Self, usize)> {
        let one = |set: &str| set.find(channel).filter(|_| channel.len() == 1);
        let plain = || channel.strip_prefix('c').filter(|n| n.len() == 3).and_then(|n| n.parse().ok());
        one("RGBA")
            .map(|i| (Self::Color, i))
            .or_else(|| one("XYZW").map(|i| (Self::Vector, i)))
            .or_else(|| plain().map(|i| (Self::Plain, i)))
    }
}

/// Writes layers as one EXR file, atomically.
///
/// # Errors
/// If there is no layer, maps differ in size, a name is empty, repeated or has a dot, a map has more channels than its kind
/// has names, a value does not fit a half float, or the file cannot be written.
pub fn save_layers(path: &Path, layers: &[Layer], overwrite: bool) -> Result<(), IoError> {
    let channels: Vec<Channel> = layers.iter().flat_map(channels_of).collect();
    let (width, height) = layers.first().map_or((0, 0), |l| (l.map.width, l.map.height));
    save_channels(path, (width, height), &channels, overwrite)
}

fn channels_of(layer: &Layer) -> Vec<Channel> {
    let c = layer.map.channels;
    let channel = |i: usize| {
        let values = layer.map.data.iter().skip(i).step_by(c).copied().collect();
        Channel { name: format!("{}.{}", layer.name, layer.kind.channel(i)), half: layer.half, values }
    };
    (0..c).map(channel).collect()
}

/// Reads the layers of an EXR file, sorted by name. Channels without a layer, or with other names than those of
/// [`save_layers`], are ignored.
///
/// # Errors
/// If the file is damaged or not supported, exceeds the limits, or has values that are not finite.
pub fn load_layers(path: &Path, limits: &Limits) -> Result<Vec<Layer>, IoError> {
    let bytes = read_file(path, limits)?;
    let ((width, height), channels) = read_channels(&bytes, &path.display().to_string(), limits)?;
    let mut named: Vec<(String, Kind, usize, Channel)> = Vec::new();
    for channel in channels {
        let Some((layer, last)) = channel.name.rsplit_once('.') else { continue };
        if let Some((kind, place)) = Kind::of(last) {
            named.push((layer.to_owned(), kind, place, channel));
        }
    }
    named.sort_by(|a, b| a.0.cmp(&b.0).then((a.1 as u8).cmp(&(b.1 as u8))).then(a.2.cmp(&b.2)));
    let assemble = |same: &[(String, Kind, usize, Channel)]| {
        let mut map = Image::zeros(width, height, same.len());
        for (i, (_, _, _, channel)) in same.iter().enumerate() {
            map.data.iter_mut().skip(i).step_by(same.len()).zip(&channel.values).for_each(|(m, v)| *m = *v);
        }
        Layer { name: same[0].0.clone(), kind: same[0].1, half: same.iter().all(|c| c.3.half), map }
    };
    Ok(named.chunk_by(|a, b| a.0 == b.0 && a.1 == b.1).map(assemble).collect())
}
