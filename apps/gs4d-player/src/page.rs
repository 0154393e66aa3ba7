//! The page: a clip, its player and what it shows first, in one file.

use crate::PlayerError;
use crate::clip::Clip;
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use flate2::Compression;
use flate2::read::DeflateDecoder;
use flate2::write::DeflateEncoder;
use glam::DVec3;
use gs_core::Camera;
use serde::Serialize;
use std::io::{Read, Write};

/// The WebGL2 renderer of moving splats; its head says how it is used. It needs [`SORT_JS`] as a worker.
pub const SPLATS_JS: &str = include_str!("page/splats.js");
/// The worker that sorts splats by depth.
pub const SORT_JS: &str = include_str!("page/sort.js");
/// Vectors of three numbers, for scripts that move a camera.
pub const VECTORS_JS: &str = include_str!("page/vectors.js");

const PAGE: &str = include_str!("page/player.html");
const STYLE: &str = include_str!("page/player.css");
const CLIP_JS: &str = include_str!("page/clip.js");
const PLAYER_JS: &str = include_str!("page/player.js");
/// What stands before and behind the clip in a page.
const MARKS: [&str; 2] = ["<script id=\"clip\" type=\"text/plain\">", "</script>"];
/// Most bytes that one packed byte of a clip is read back as, and as many of any.
const MOST: [u64; 2] = [64, 48 << 20];

/// The first view of a page.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Start {
    /// Where the camera is, world units.
    pub eye: [f64; 3],
    /// What it looks at, and orbits around.
    pub target: [f64; 3],
    /// What is up.
    pub up: [f64; 3],
    /// Horizontal field of view, radians.
    pub fov: f64,
    /// Width of what is shown by its height; windows of another shape show more.
    pub aspect: f64,
}

impl Default for Start {
    fn default() -> Self {
        Self { eye: [0.0; 3], target: [0.0, 0.0, 4.0], up: [0.0, -1.0, 0.0], fov: 0.8, aspect: 1.0 }
    }
}

impl Start {
    /// What a camera sees, orbiting the point of its axis that is nearest to `centre`; `up` if that is known, else the camera's own.
    pub fn of(camera: &Camera, centre: DVec3, up: Option<DVec3>) -> Self {
        let (eye, forward) = (camera.position(), camera.forward());
        let far = (centre - eye).dot(forward).abs().max(1e-3);
        // A direction along the line of sight cannot be up.
        let up = up.filter(|u| u.normalize_or_zero().dot(forward).abs() < 0.95).unwrap_or(-camera.rotation.row(1));
        Self {
            eye: eye.to_array(),
            target: (eye + forward * far).to_array(),
            up: up.to_array(),
            fov: 2.0 * (0.5 * f64::from(camera.width) / camera.fx).atan(),
            aspect: f64::from(camera.width) / f64::from(camera.height),
        }
    }
}

/// What a page shows besides its clip.
#[derive(Clone, Debug, PartialEq)]
pub struct Page {
    /// Its title.
    pub title: String,
    /// Its first view.
    pub start: Start,
    /// Colour behind the splats, display-encoded, 0 to 1.
    pub background: [f32; 3],
    /// Seconds at the normalised times 0 and 1; none where the scene has no clock.
    pub clock: Option<[f64; 2]>,
}

impl Page {
    /// The whole page. It asks for nothing from anywhere, and its own policy forbids it.
    ///
    /// # Errors
    /// A number that JSON cannot hold.
    pub fn html(&self, clip: &Clip) -> Result<String, PlayerError> {
        let wrong = |e: serde_json::Error| PlayerError::Write(e.to_string());
        let page = serde_json::json!({"start": self.start, "background": self.background, "clock": self.clock});
        let parts = [
            ("{title}", escaped(&self.title)),
            ("{style}", STYLE.to_owned()),
            ("{page}", serde_json::to_string(&page).map_err(wrong)?),
            ("{sorter}", SORT_JS.to_owned()),
            ("{vectors}", VECTORS_JS.to_owned()),
            ("{splats}", SPLATS_JS.to_owned()),
            ("{clip_js}", CLIP_JS.to_owned()),
            ("{clip}", STANDARD.encode(deflated(&clip.bytes().map_err(wrong)?)?)),
            ("{player}", PLAYER_JS.to_owned()),
        ];
        // From one place to the next: what is put in is not searched again.
        let (mut out, mut rest) = (String::new(), PAGE);
        while let Some((at, (name, part))) =
            parts.iter().filter_map(|p| rest.find(p.0).map(|at| (at, p))).min_by_key(|(at, _)| *at)
        {
            out.push_str(&rest[..at]);
            out.push_str(part);
            rest = &rest[at + name.len()..];
        }
        out.push_str(rest);
        Ok(out)
    }
}

/// The clip of a page. It takes at most 64 times as many bytes as it is packed in, and 48 MiB.
///
/// # Errors
/// A page without one, one of another version, or a damaged one.
pub fn read(html: &str) -> Result<Clip, PlayerError> {
    let wrong = |what: &str| PlayerError::Damaged(what.to_owned());
    let text = html.split_once(MARKS[0]).and_then(|(_, rest)| rest.split_once(MARKS[1]));
    let (text, _) = text.ok_or_else(|| wrong("it holds no scene"))?;
    let packed = STANDARD.decode(text.trim()).map_err(|e| wrong(&e.to_string()))?;
    let mut bytes = Vec::new();
    let most = MOST[0] * packed.len() as u64 + MOST[1];
    DeflateDecoder::new(packed.as_slice()).take(most).read_to_end(&mut bytes).map_err(|e| wrong(&e.to_string()))?;
    Clip::parse(&bytes)
}

fn deflated(bytes: &[u8]) -> Result<Vec<u8>, PlayerError> {
    let mut to = DeflateEncoder::new(Vec::new(), Compression::best());
    to.write_all(bytes).and_then(|()| to.finish()).map_err(|e| PlayerError::Write(e.to_string()))
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}
