//! Questions from a browser: JSON messages, checked before use.

use crate::pose::Posing;
use crate::stage::Stage;
use crate::style::{MAX_POINT, Style};
use glam::DVec3;
use gs_core::Camera;
use serde::Deserialize;

/// Most pixels of an image: 4K.
pub(crate) const MAX_PIXELS: u32 = 3840 * 2160;
/// Longest question, bytes.
pub(crate) const MAX_BYTES: usize = 64 << 10;
/// Largest absolute normalised time.
const MAX_TIME: f32 = 100.0;

/// Deepest nesting of brackets in a question.
pub(crate) const MAX_NESTING: usize = 16;
/// Most boxes of hidden splats.
pub(crate) const MAX_BOXES: usize = 16;
/// Largest gain of differences.
const MAX_GAIN: f32 = 100.0;

/// A message of a browser.
pub(crate) enum Demand {
    /// A question.
    Image(Box<Question>),
    /// Pause the training, or let it go on.
    Pause {
        /// Whether it pauses.
        pause: bool,
    },
}

impl Demand {
    /// Parses and checks a message.
    ///
    /// # Errors
    /// As [`Question::parse`].
    pub(crate) fn parse(text: &str) -> Result<Self, String> {
        #[derive(Deserialize)]
        #[serde(deny_unknown_fields)]
        struct Pause {
            pause: bool,
        }
        if let Ok(Pause { pause }) = serde_json::from_str(text) {
            return Ok(Self::Pause { pause });
        }
        Question::parse(text).map(|q| Self::Image(Box::new(q)))
    }
}

/// A request for an image, or for a splat file.
#[derive(Clone, Debug, Deserialize, PartialEq)]
#[serde(deny_unknown_fields)]
pub struct Question {
    /// Identifier, repeated in the answer.
    pub id: u64,
    /// Which show and layer to render.
    pub what: Target,
    /// Subtracted from `what`; the signed difference is then shown around grey.
    #[serde(default)]
    pub against: Option<Target>,
    /// Gain of the difference, up to 100. Default: 1.
    #[serde(default = "one")]
    pub gain: f32,
    /// Normalised time of the image.
    pub time: f32,
    /// Camera the image is rendered from.
    pub look: Look,
    /// Width, pixels; a view of the dataset keeps its aspect ratio.
    pub width: u32,
    /// Height of the image, pixels.
    pub height: u32,
    /// Whether to render at twice the resolution and average 2 × 2 pixels.
    #[serde(default)]
    pub fine: bool,
    /// A pixel as shares of width and height, 0..1: list the splats behind it.
    #[serde(default)]
    pub pick: Option<[f32; 2]>,
    /// A box of the image: histograms of the splats in it.
    #[serde(default)]
    pub chosen: Option<Choice>,
    /// Boxes of splats that are not rendered, at most 16.
    #[serde(default)]
    pub hidden: Vec<Choice>,
    /// Answer with this instead of the image on the page.
    #[serde(default)]
    pub save: Option<Save>,
    /// How the splats are drawn. Default: as they are.
    #[serde(default)]
    pub style: Style,
    /// Colour behind the scene, RGB in 0..1; `None`: that of the show.
    #[serde(default)]
    pub background: Option<[f32; 3]>,
    /// Whether a view of the dataset may be rendered larger than its own image. Not for ground truth and differences.
    #[serde(default)]
    pub enlarge: bool,
    /// Whether to compute the PSNR of a view of the dataset, at the size of its image.
    #[serde(default)]
    pub score: bool,
    /// Whether to add velocity arrows.
    #[serde(default)]
    pub arrows: bool,
    /// Pose of an avatar; `None`: the pose at `time`.
    #[serde(default)]
    pub pose: Option<Posing>,
}

fn one() -> f32 {
    1.0
}

/// A layer of a show, at its newest state or at a checkpoint.
#[derive(Clone, Debug, Deserialize, PartialEq)]
#[serde(deny_unknown_fields)]
pub struct Target {
    /// Index of the show in the stage.
    pub show: usize,
    /// `color`, `truth`, `depth`, `alpha`, `count`, `segment`, or one of the method's.
    pub layer: String,
    /// Step of a checkpoint; `None`: the newest state.
    #[serde(default)]
    pub checkpoint: Option<u32>,
}

/// The camera of an image.
#[derive(Clone, Debug, Deserialize, PartialEq)]
#[serde(rename_all = "lowercase", deny_unknown_fields)]
pub enum Look {
    /// A free camera: eye, target, up in world units, horizontal field of view in radians.
    Free([f64; 3], [f64; 3], [f64; 3], f64),
    /// A view of the dataset: index of the show, and of the view in the list the page received.
    View(usize, usize),
}

/// Splats whose centres lie in a box of an image.
#[derive(Clone, Debug, Deserialize, PartialEq)]
#[serde(deny_unknown_fields)]
pub struct Choice {
    /// Index of the show in the stage.
    pub show: usize,
    /// Camera the image was rendered from.
    pub look: Look,
    /// Normalised time of the image.
    pub time: f32,
    /// Width of the image, pixels.
    pub width: u32,
    /// Height of the image, pixels.
    pub height: u32,
    /// Left, top, right, bottom as shares of the image, 0..1.
    pub at: [f32; 4],
    /// Pose of an avatar in the image; `None`: the pose at `time`.
    #[serde(default)]
    pub pose: Option<Posing>,
}

/// What is saved.
#[derive(Clone, Copy, Debug, Deserialize, PartialEq, Eq)]
#[serde(rename_all = "lowercase")]
pub enum Save {
    /// A `.ply` file of the splats in the box.
    Chosen,
    /// A `.ply` file of all others that are not hidden.
    Rest,
    /// The image as PNG; a view of the dataset is enlarged to its size.
    Image,
    /// The splats, for the renderer in the browser: 32 bytes each, with the colours of the layer.
    Splats,
}

/// Depth of nested brackets in a text, ignoring strings.
pub(crate) fn nesting(text: &str) -> usize {
    let (mut depth, mut deepest, mut quoted, mut escaped) = (0usize, 0, false, false);
    for byte in text.bytes() {
        match byte {
            _ if escaped => escaped = false,
            b'\\' if quoted => escaped = true,
            b'"' => quoted = !quoted,
            b'[' | b'{' if !quoted => depth += 1,
            b']' | b'}' if !quoted => depth = depth.saturating_sub(1),
            _ => {}
        }
        deepest = deepest.max(depth);
    }
    deepest
}

impl Question {
    /// Parses and checks a JSON question.
    ///
    /// # Errors
    /// A message for the page.
    ///
    /// ```
    /// use gs4d_view::question::Question;
    /// let what = r#""id": 1, "what": {"show": 0, "layer": "color"}, "look": {"view": [0, 3]}, "width": 64, "height": 48"#;
    /// assert_eq!(Question::parse(&format!("{{{what}, \"time\": 0.5}}")).unwrap().gain, 1.0);
    /// assert!(Question::parse(&format!("{{{what}, \"time\": 1e30}}")).is_err());
    /// ```
    pub fn parse(text: &str) -> Result<Self, String> {
        if text.len() > MAX_BYTES {
            return Err(format!("a question has at most {MAX_BYTES} bytes"));
        }
        let question: Self = serde_json::from_str(text).map_err(|e| e.to_string())?;
        check_size(question.width, question.height)?;
        check_time(question.time)?;
        if question.pick.is_some_and(|p| p.iter().any(|v| !(0.0..1.0).contains(v))) {
            return Err("a pixel is picked inside the picture".into());
        }
        if question.hidden.len() > MAX_BOXES {
            return Err(format!("at most {MAX_BOXES} boxes are hidden"));
        }
        if question.gain.is_nan() || question.gain.abs() > MAX_GAIN {
            return Err(format!("differences are shown up to {MAX_GAIN} times as strong"));
        }
        question.pose.iter().try_for_each(Posing::check)?;
        if question.background.is_some_and(|b| b.iter().any(|v| !(0.0..=1.0).contains(v))) {
            return Err("a background has three values from 0 to 1".into());
        }
        if matches!(question.style, Style::Points(d) if !(0.5..=MAX_POINT).contains(&d)) {
            return Err(format!("points have 0.5 to {MAX_POINT} pixels"));
        }
        question.hidden.iter().chain(&question.chosen).try_for_each(Choice::check)?;
        Ok(question)
    }

    /// Whether a view is rendered larger than its own image, if need be.
    pub(crate) fn enlarges(&self) -> bool {
        (self.enlarge || self.save == Some(Save::Image)) && self.against.is_none() && self.what.layer != "truth"
    }

    /// Pixels to render.
    pub(crate) fn work(&self) -> u64 {
        let layers = 1 + u64::from(self.against.is_some());
        let samples = if self.fine { 4 } else { 1 };
        layers * samples * u64::from(self.width) * u64::from(self.height)
    }
}

fn check_size(width: u32, height: u32) -> Result<(), String> {
    let pixels = u64::from(width) * u64::from(height);
    let fits = width > 0 && height > 0 && pixels <= u64::from(MAX_PIXELS);
    if fits { Ok(()) } else { Err(format!("an image has 1 to {MAX_PIXELS} pixels")) }
}

fn check_time(time: f32) -> Result<(), String> {
    if time.abs() <= MAX_TIME { Ok(()) } else { Err(format!("time must be a number from -{MAX_TIME} to {MAX_TIME}")) }
}

impl Choice {
    fn check(&self) -> Result<(), String> {
        check_size(self.width, self.height)?;
        check_time(self.time)?;
        self.pose.iter().try_for_each(Posing::check)?;
        let [left, top, right, bottom] = self.at;
        let inside = self.at.iter().all(|v| (0.0..=1.0).contains(v)) && left <= right && top <= bottom;
        if inside { Ok(()) } else { Err("a box lies inside the picture".into()) }
    }
}

impl Look {
    /// The camera for an image of at most `width` × `height` pixels. A view keeps its aspect ratio; unless `enlarge`, it is not
    /// larger than its own image.
    ///
    /// # Errors
    /// A message, if eye, target and up are not finite or not independent, or there is no such view.
    pub(crate) fn camera(&self, stage: &Stage, width: u32, height: u32, enlarge: bool) -> Result<Camera, String> {
        match self {
            Look::Free(eye, target, up, fov) => free_camera([*eye, *target, *up], *fov, width, height),
            Look::View(show, number) => {
                let camera = &stage.view(*show, *number)?.camera;
                let share = |have: u32, size: u32| f64::from(have) / f64::from(size);
                let factor = share(width, camera.width).min(share(height, camera.height));
                Ok(if factor < 1.0 || enlarge { camera.scaled(factor) } else { camera.clone() })
            }
        }
    }
}

fn free_camera(frame: [[f64; 3]; 3], fov: f64, width: u32, height: u32) -> Result<Camera, String> {
    let [eye, target, up] = frame.map(DVec3::from_array);
    let in_range = |v: &DVec3| v.is_finite() && v.length() < 1e9;
    if !((0.01..3.0).contains(&fov) && [eye, target, up].iter().all(in_range)) {
        return Err("the camera must be finite, its field of view between 0.01 and 3 radians".into());
    }
    Camera::look_at(width, height, fov, eye, target, up).map_err(|e| e.to_string())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn text(edit: &str) -> String {
        let base = r#""id":1,"what":{"show":0,"layer":"color"},"time":0.5,"width":64,"height":48"#;
        format!("{{{base},{edit}}}")
    }

    fn stage() -> Stage {
        Stage::new(Vec::new())
    }

    #[test]
    fn good_questions_are_understood() {
        let free = text(r#""look":{"free":[[0,0,-4],[0,0,0],[0,-1,0],0.8]}"#);
        let camera = Question::parse(&free).unwrap().look.camera(&stage(), 64, 48, false).unwrap();
        assert_eq!((camera.width, camera.height), (64, 48));
        let view = Question::parse(&text(r#""look":{"view":[0,3]},"pick":[0.5,0.25]"#)).unwrap();
        assert_eq!((view.look.clone(), view.pick, view.gain), (Look::View(0, 3), Some([0.5, 0.25]), 1.0));
        assert!(view.look.camera(&stage(), 64, 48, false).is_err());
    }

    #[test]
    fn bad_questions_are_refused_with_a_reason() {
        let nested = format!("{}{}", "[".repeat(200), "]".repeat(200));
        let view = |more: &str| text(&format!(r#""look":{{"view":[0,3]}}{more}"#));
        let chosen = |at: &str| {
            view(&format!(r#","chosen":{{"show":0,"look":{{"view":[0,3]}},"time":0,"width":9,"height":9,"at":{at}}}"#))
        };
        let cases = [
            (view(r#","pick":[1.5,0]"#), "inside the picture"),
            (view(r#","time":1e9"#), "duplicate field"),
            (text(r#""look":{"view":[0,-3]}"#), "invalid value"),
            (view(r#","file":"/etc/passwd""#), "unknown field"),
            (view("").replace("64", "100000000"), "pixels"),
            (view("").replace("0.5", "1e30"), "time"),
            (view(r#","gain":1000"#), "as strong"),
            (view(r#","pose":{"turns":[[0,[0,0,99]]]}"#), "radians"),
            (chosen("[0.5,0,0.4,1]"), "box"),
            (chosen("[0,0,1,2]"), "box"),
            (view(r#","save":"/etc/passwd""#), "unknown variant"),
            (view(r#","style":{"points":1e9}"#), "pixels"),
            (view(r#","background":[0,0,2]"#), "background"),
            (nested, "invalid type"),
            ("x".repeat(MAX_BYTES + 1), "at most"),
        ];
        for (text, want) in cases {
            let error = Question::parse(&text).unwrap_err();
            assert!(error.contains(want), "{error}: {want}");
        }
        for look in ["[[0,0,0],[0,0,0],[0,1,0],0.8]", "[[0,0,1],[0,0,0],[0,0,1],0.8]", "[[0,0,1],[0,0,0],[0,1,0],9]"] {
            let question = Question::parse(&text(&format!(r#""look":{{"free":{look}}}"#))).unwrap();
            assert!(question.look.camera(&stage(), 64, 48, false).is_err(), "{look}");
        }
    }

    #[test]
    fn nesting_is_counted_outside_of_strings() {
        assert_eq!(nesting(r#"{"a":[[1],{"b":"[[[[\"{{{"}]}"#), 3);
        assert_eq!(nesting("]]]]["), 1);
        assert!(nesting(&text(r#""look":{"free":[[0,0,-4],[0,0,0],[0,-1,0],0.8]}"#)) < MAX_NESTING);
    }
}
