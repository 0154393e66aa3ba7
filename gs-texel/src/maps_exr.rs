//! Texel maps as one EXR file with named layers: `P.X`, `P.Y`, `P.Z`, `T1.R`, … Positions as `f32`, colours as half floats
//! if they may be rounded.

use gs_core::Image;
use gs_core::io::exr::{Channel, read_channels, save_channels};
use gs_core::io::{IoError, Limits, read_file};
use std::path::Path;

/// What the values of a layer are, which names their channels.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kind {
    /// R, G, B and perhaps A.
    Color,
    /// X, Y, Z and perhaps W.
    Vector,
    /// c000, c001, …
    Plain,
}

/// A map and its name.
#[derive(Clone, Debug, PartialEq)]
pub struct Layer {
    /// Its name (`P`, `N`, `D`, `T1`, `vis`, …): not empty, no dot.
    pub name: String,
    /// What its values are.
    pub kind: Kind,
    /// Stored as half floats: 11 bits, magnitude up to 65504.
    pub half: bool,
    /// The map; all of a file have one size.
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

    /// Kind and place of a channel.
    fn of(channel: &str) -> Option<(Self, usize)> {
        let one = |set: &str| set.find(channel).filter(|_| channel.len() == 1);
        let plain = || channel.strip_prefix('c').filter(|n| n.len() == 3).and_then(|n| n.parse().ok());
        one("RGBA")
            .map(|i| (Self::Color, i))
            .or_else(|| one("XYZW").map(|i| (Self::Vector, i)))
            .or_else(|| plain().map(|i| (Self::Plain, i)))
    }
}

/// Writes layers as one EXR file, whole or not at all.
///
/// # Errors
/// No layer, maps of different sizes, names that are empty, doubled or hold a dot, channels a kind has no names for, values a
/// half float cannot hold; and those of the writer.
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

/// Reads the layers of an EXR file, by name; channels without a layer, or named otherwise than [`save_layers`] does, are
/// passed over.
///
/// # Errors
/// Damaged or unsupported content, more than the limits allow, values that are not finite.
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
    named.sort_by(|a, b| a.0.cmp(&b.0).then(a.2.cmp(&b.2)));
    let assemble = |same: &[(String, Kind, usize, Channel)]| {
        let mut map = Image::zeros(width, height, same.len());
        for (i, (_, _, _, channel)) in same.iter().enumerate() {
            map.data.iter_mut().skip(i).step_by(same.len()).zip(&channel.values).for_each(|(m, v)| *m = *v);
        }
        Layer { name: same[0].0.clone(), kind: same[0].1, half: same.iter().all(|c| c.3.half), map }
    };
    Ok(named.chunk_by(|a, b| a.0 == b.0 && a.1 == b.1).map(assemble).collect())
}
