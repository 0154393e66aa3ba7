//! What a browser may ask. Every number is checked before anything is made of it.

use crate::pose::Posing;
use crate::stage::Stage;
use glam::DVec3;
use gs_core::Camera;
use serde::Deserialize;

/// Most pixels of a picture: 4K.
pub const MOST_PIXELS: u32 = 3840 * 2160;
/// Longest question, bytes.
pub const MOST_BYTES: usize = 64 << 10;
/// Times beyond this many training spans are not asked for.
const FARTHEST: f32 = 100.0;

/// Deepest nesting of a question.
pub const MOST_NESTING: usize = 16;
/// Boxes of hidden splats, at most.
const MOST_BOXES: usize = 16;
/// Strongest differences are shown by, times.
const MOST_GAIN: f32 = 100.0;

/// A picture that is wanted.
#[derive(Clone, Debug, Deserialize, PartialEq)]
#[serde(deny_unknown_fields)]
pub struct Question {
    /// Comes back with the answer.
    pub id: u64,
    /// What is drawn.
    pub what: Target,
    /// What is taken away from it; the signed difference is drawn about grey then.
    #[serde(default)]
    pub against: Option<Target>,
    /// Differences are shown so many times as strong.
    #[serde(default = "one")]
    pub gain: f32,
    /// Normalised time.
    pub time: f32,
    /// From where.
    pub look: Look,
    /// Pixels; a view of the data keeps its own ratio.
    pub width: u32,
    /// Pixels.
    pub height: u32,
    /// Every pixel is the mean of 2 × 2.
    #[serde(default)]
    pub fine: bool,
    /// A pixel of the picture as shares of its width and height: which splats made it?
    #[serde(default)]
    pub pick: Option<[f32; 2]>,
    /// What is in this box of the picture: histograms of it.
    #[serde(default)]
    pub chosen: Option<Choice>,
    /// Splats that are left out.
    #[serde(default)]
    pub hidden: Vec<Choice>,
    /// Splats as a file instead of a picture.
    #[serde(default)]
    pub save: Option<Part>,
    /// Where splats go, as arrows.
    #[serde(default)]
    pub arrows: bool,
    /// Another pose of a filmed person.
    #[serde(default)]
    pub pose: Option<Posing>,
}

fn one() -> f32 {
    1.0
}

/// What is drawn: a layer of a show as it is, or as a checkpoint has it.
#[derive(Clone, Debug, Deserialize, PartialEq)]
#[serde(deny_unknown_fields)]
pub struct Target {
    /// Index of the show.
    pub show: usize,
    /// `color`, `truth`, `depth`, `alpha`, `count`, `segment`, or one of the method's.
    pub layer: String,
    /// Step of a checkpoint.
    #[serde(default)]
    pub checkpoint: Option<u32>,
}

/// From where a picture is taken.
#[derive(Clone, Debug, Deserialize, PartialEq)]
#[serde(rename_all = "lowercase", deny_unknown_fields)]
pub enum Look {
    /// A free camera: eye, target, up in world units, horizontal field of view in radians.
    Free([f64; 3], [f64; 3], [f64; 3], f64),
    /// A view of the data: number of the show, and of the view among [its](crate::stage::Show::views).
    View(usize, usize),
}

/// Splats whose centres were seen in a box of a picture.
#[derive(Clone, Debug, Deserialize, PartialEq)]
#[serde(deny_unknown_fields)]
pub struct Choice {
    /// Whose splats.
    pub show: usize,
    /// From where the box was drawn.
    pub look: Look,
    /// Normalised time it was drawn at.
    pub time: f32,
    /// Pixels of the picture it was drawn in.
    pub width: u32,
    /// Pixels.
    pub height: u32,
    /// Left, top, right, bottom as shares of the picture.
    pub at: [f32; 4],
}

/// Which splats are saved.
#[derive(Clone, Copy, Debug, Deserialize, PartialEq, Eq)]
#[serde(rename_all = "lowercase")]
pub enum Part {
    /// Those in the box.
    Chosen,
    /// All others that are not hidden.
    Rest,
}

/// How deep brackets of a text lie in each other, strings left out.
pub fn nesting(text: &str) -> usize {
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
    /// Reads and checks a question.
    ///
    /// # Errors
    /// What is wrong with it, in words for the page.
    pub fn parse(text: &str) -> Result<Self, String> {
        if text.len() > MOST_BYTES {
            return Err(format!("a question has at most {MOST_BYTES} bytes"));
        }
        let question: Self = serde_json::from_str(text).map_err(|e| e.to_string())?;
        check_size(question.width, question.height)?;
        check_time(question.time)?;
        if question.pick.is_some_and(|p| p.iter().any(|v| !(0.0..1.0).contains(v))) {
            return Err("a pixel is picked inside the picture".into());
        }
        if question.hidden.len() > MOST_BOXES {
            return Err(format!("at most {MOST_BOXES} boxes are hidden"));
        }
        if question.gain.is_nan() || question.gain.abs() > MOST_GAIN {
            return Err(format!("differences are shown up to {MOST_GAIN} times as strong"));
        }
        if question.pose.as_ref().is_some_and(|p| !p.is_sound()) {
            return Err("a pose turns a few joints by at most 10 radians".into());
        }
        question.hidden.iter().chain(&question.chosen).try_for_each(Choice::check)?;
        Ok(question)
    }
}

fn check_size(width: u32, height: u32) -> Result<(), String> {
    let pixels = u64::from(width) * u64::from(height);
    let fits = width > 0 && height > 0 && pixels <= u64::from(MOST_PIXELS);
    if fits { Ok(()) } else { Err(format!("a picture has 1 to {MOST_PIXELS} pixels")) }
}

fn check_time(time: f32) -> Result<(), String> {
    if time.abs() <= FARTHEST { Ok(()) } else { Err(format!("time must be a number from -{FARTHEST} to {FARTHEST}")) }
}

impl Choice {
    fn check(&self) -> Result<(), String> {
        check_size(self.width, self.height)?;
        check_time(self.time)?;
        let [left, top, right, bottom] = self.at;
        let inside = self.at.iter().all(|v| (0.0..=1.0).contains(v)) && left <= right && top <= bottom;
        if inside { Ok(()) } else { Err("a box lies inside the picture".into()) }
    }
}

impl Look {
    /// The camera, for a picture of so many pixels. A view of the data keeps its ratio and is not enlarged.
    ///
    /// # Errors
    /// In words, if eye, target and up span no frame or are not finite, or there is no such view.
    pub fn camera(&self, stage: &Stage, width: u32, height: u32) -> Result<Camera, String> {
        match self {
            Look::Free(eye, target, up, fov) => free_camera([*eye, *target, *up], *fov, width, height),
            Look::View(show, number) => {
                let camera = &stage.view(*show, *number)?.camera;
                let share = |have: u32, size: u32| f64::from(have) / f64::from(size);
                let factor = share(width, camera.width).min(share(height, camera.height));
                Ok(if factor < 1.0 { camera.scaled(factor) } else { camera.clone() })
            }
        }
    }
}

fn free_camera(frame: [[f64; 3]; 3], fov: f64, width: u32, height: u32) -> Result<Camera, String> {
    let [eye, target, up] = frame.map(DVec3::from_array);
    let sane = |v: &DVec3| v.is_finite() && v.length() < 1e9;
    if !((0.01..3.0).contains(&fov) && [eye, target, up].iter().all(sane)) {
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
        Stage { shows: Vec::new() }
    }

    #[test]
    fn good_questions_are_understood() {
        let free = text(r#""look":{"free":[[0,0,-4],[0,0,0],[0,-1,0],0.8]}"#);
        let camera = Question::parse(&free).unwrap().look.camera(&stage(), 64, 48).unwrap();
        assert_eq!((camera.width, camera.height), (64, 48));
        let view = Question::parse(&text(r#""look":{"view":[0,3]},"pick":[0.5,0.25]"#)).unwrap();
        assert_eq!((view.look.clone(), view.pick, view.gain), (Look::View(0, 3), Some([0.5, 0.25]), 1.0));
        assert!(view.look.camera(&stage(), 64, 48).is_err());
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
            (nested, "invalid type"),
            ("x".repeat(MOST_BYTES + 1), "at most"),
        ];
        for (text, want) in cases {
            let error = Question::parse(&text).unwrap_err();
            assert!(error.contains(want), "{error}: {want}");
        }
        for look in ["[[0,0,0],[0,0,0],[0,1,0],0.8]", "[[0,0,1],[0,0,0],[0,0,1],0.8]", "[[0,0,1],[0,0,0],[0,1,0],9]"] {
            let question = Question::parse(&text(&format!(r#""look":{{"free":{look}}}"#))).unwrap();
            assert!(question.look.camera(&stage(), 64, 48).is_err(), "{look}");
        }
    }

    #[test]
    fn nesting_is_counted_outside_of_strings() {
        assert_eq!(nesting(r#"{"a":[[1],{"b":"[[[[\"{{{"}]}"#), 3);
        assert_eq!(nesting("]]]]["), 1);
        assert!(nesting(&text(r#""look":{"free":[[0,0,-4],[0,0,0],[0,-1,0],0.8]}"#)) < MOST_NESTING);
    }
}
