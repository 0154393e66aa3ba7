//! What a browser may ask. Every number is checked before anything is made of it.

use glam::DVec3;
use gs_core::Camera;
use serde::Deserialize;

/// Most pixels of a picture: 4K.
pub const MOST_PIXELS: u32 = 3840 * 2160;
/// Longest question, bytes.
pub const MOST_BYTES: usize = 64 << 10;
/// Times beyond this many training spans are not asked for.
const FARTHEST: f32 = 100.0;

/// A picture that is wanted.
#[derive(Clone, Debug, Deserialize, PartialEq)]
#[serde(deny_unknown_fields)]
pub struct Question {
    /// Comes back with the answer.
    pub id: u64,
    /// Index of the show.
    pub show: usize,
    /// `color`, `truth`, `depth`, `alpha`, or a quantity of the method.
    pub layer: String,
    /// Normalised time.
    pub time: f32,
    /// From where.
    pub look: Look,
    /// Pixels; a view of the data keeps its own ratio.
    pub width: u32,
    /// Pixels.
    pub height: u32,
    /// A pixel of the picture as shares of its width and height: which splats made it?
    #[serde(default)]
    pub pick: Option<[f32; 2]>,
}

/// From where a picture is taken.
#[derive(Clone, Debug, Deserialize, PartialEq)]
#[serde(rename_all = "lowercase", deny_unknown_fields)]
pub enum Look {
    /// A free camera: eye, target, up in world units, horizontal field of view in radians.
    Free([f64; 3], [f64; 3], [f64; 3], f64),
    /// A view of the data, by its number among [`views`](crate::stage::Show::views).
    View(usize),
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
        let pixels = u64::from(question.width) * u64::from(question.height);
        if question.width == 0 || question.height == 0 || pixels > u64::from(MOST_PIXELS) {
            return Err(format!("a picture has 1 to {MOST_PIXELS} pixels"));
        }
        if question.time.is_nan() || question.time.abs() > FARTHEST {
            return Err(format!("time must be a number from -{FARTHEST} to {FARTHEST}"));
        }
        if question.pick.is_some_and(|p| p.iter().any(|v| !(0.0..1.0).contains(v))) {
            return Err("a pixel is picked inside the picture".into());
        }
        Ok(question)
    }

    /// The camera of a free look.
    ///
    /// # Errors
    /// If eye, target and up span no frame or are not finite.
    pub fn free_camera(&self) -> Result<Option<Camera>, String> {
        let Look::Free(eye, target, up, fov) = self.look else { return Ok(None) };
        let [eye, target, up] = [eye, target, up].map(DVec3::from_array);
        let sane = |v: &DVec3| v.is_finite() && v.length() < 1e9;
        if !((0.01..3.0).contains(&fov) && [eye, target, up].iter().all(sane)) {
            return Err("the camera must be finite, its field of view between 0.01 and 3 radians".into());
        }
        let camera = Camera::look_at(self.width, self.height, fov, eye, target, up);
        camera.map(Some).map_err(|e| e.to_string())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn text(edit: &str) -> String {
        let base = r#""id":1,"show":0,"layer":"color","time":0.5,"width":64,"height":48"#;
        format!("{{{base},{edit}}}")
    }

    #[test]
    fn good_questions_are_understood() {
        let free = text(r#""look":{"free":[[0,0,-4],[0,0,0],[0,-1,0],0.8]}"#);
        let camera = Question::parse(&free).unwrap().free_camera().unwrap().unwrap();
        assert_eq!((camera.width, camera.height), (64, 48));
        let view = Question::parse(&text(r#""look":{"view":3},"pick":[0.5,0.25]"#)).unwrap();
        assert_eq!((view.look.clone(), view.pick), (Look::View(3), Some([0.5, 0.25])));
        assert_eq!(view.free_camera(), Ok(None));
    }

    #[test]
    fn bad_questions_are_refused_with_a_reason() {
        let nested = format!("{}{}", "[".repeat(200), "]".repeat(200));
        let cases = [
            (text(r#""look":{"view":3},"pick":[1.5,0]"#), "inside the picture"),
            (text(r#""look":{"view":3},"time":1e9"#), "duplicate field"),
            (text(r#""look":{"view":-3}"#), "invalid value"),
            (text(r#""look":{"view":3},"file":"/etc/passwd""#), "unknown field"),
            (text(r#""look":{"view":3}"#).replace("64", "100000000"), "pixels"),
            (text(r#""look":{"view":3}"#).replace("0.5", "1e30"), "time"),
            (nested, "invalid type"),
            ("x".repeat(MOST_BYTES + 1), "at most"),
        ];
        for (text, want) in cases {
            let error = Question::parse(&text).unwrap_err();
            assert!(error.contains(want), "{error}: {want}");
        }
        for look in ["[[0,0,0],[0,0,0],[0,1,0],0.8]", "[[0,0,1],[0,0,0],[0,0,1],0.8]", "[[0,0,1],[0,0,0],[0,1,0],9]"] {
            let question = Question::parse(&text(&format!(r#""look":{{"free":{look}}}"#))).unwrap();
            assert!(question.free_camera().is_err(), "{look}");
        }
    }
}
