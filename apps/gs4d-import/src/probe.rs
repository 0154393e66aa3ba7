//! What a video is: its size as it is shown, its rate, its length.

use crate::error::ImportError;
use crate::program::{Call, FFPROBE, Runner, Sink};
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::ffi::OsString;
use std::path::Path;

/// A video file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Video {
    /// Width and height as shown, pixels: turned as the file says, with square pixels.
    pub size: [u32; 2],
    /// Mean frames per second.
    pub fps: f64,
    /// Length, seconds.
    pub seconds: f64,
}

/// How a program of ffmpeg is given a file: no name is taken for a flag or for a protocol.
pub(crate) fn input(path: &Path) -> OsString {
    let absolute = std::path::absolute(path).unwrap_or_else(|_| path.to_path_buf());
    let mut text = OsString::from("file:");
    text.push(absolute);
    text
}

/// Asks ffprobe.
pub(crate) fn probe(runner: &Runner<'_>, path: &Path) -> Result<Video, ImportError> {
    let fields = "stream=width,height,avg_frame_rate,r_frame_rate,duration,sample_aspect_ratio:stream_tags=rotate\
        :stream_side_data=rotation:format=duration";
    let call = Call::new(FFPROBE, ".", format!("read {}", path.display()))
        .args(["-v", "error", "-select_streams", "v:0", "-show_entries", fields, "-of", "json"])
        .args([input(path)]);
    let mut bytes = Vec::new();
    runner.run(call, Sink::Bytes(&mut |b| bytes.extend_from_slice(b)))?;
    parse(&serde_json::from_slice(&bytes).unwrap_or_default()).ok_or_else(|| ImportError::Input {
        what: "it has no video with a size, a rate and a length".to_owned(),
        path: path.to_path_buf(),
        why: "frames are taken at times",
        fix: "give a video that ffmpeg plays, or extract the frames and give their folder with --images".to_owned(),
    })
}

fn parse(answer: &Value) -> Option<Video> {
    let stream = answer.get("streams")?.get(0)?;
    let side = |key: &str| u32::try_from(stream.get(key)?.as_u64()?).ok().filter(|s| *s > 0);
    let fps = ["avg_frame_rate", "r_frame_rate"].iter().find_map(|key| ratio(stream.get(*key)?.as_str()?, '/'));
    let seconds = |of: &Value| of.get("duration")?.as_str()?.parse::<f64>().ok().filter(|s| s.is_finite() && *s > 0.0);
    let tagged = || stream.get("tags")?.get("rotate")?.as_str()?.parse::<f64>().ok();
    let listed = || stream.get("side_data_list")?.as_array()?.iter().find_map(|d| d.get("rotation")?.as_f64());
    let quarter = listed().or_else(tagged).map_or(0.0, |degrees: f64| (degrees / 90.0).round().rem_euclid(2.0));
    let aspect = stream.get("sample_aspect_ratio").and_then(Value::as_str).and_then(|t| ratio(t, ':')).unwrap_or(1.0);
    let (width, height) =
        (gs_core::cast::to_u32(gs_core::cast::to_usize((f64::from(side("width")?) * aspect).round())), side("height")?);
    let size = if quarter == 1.0 { [height, width] } else { [width, height] };
    Some(Video { size, fps: fps?, seconds: seconds(stream).or_else(|| seconds(answer.get("format")?))? })
}

/// `30000/1001`; none of what is not above 0.
fn ratio(text: &str, between: char) -> Option<f64> {
    let (a, b) = text.split_once(between)?;
    let value = a.parse::<f64>().ok()? / b.parse::<f64>().ok()?;
    (value.is_finite() && value > 0.0).then_some(value)
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn a_telephone_held_upright_gives_upright_pictures() {
        let stream = |more: Value| {
            let mut stream = json!({"width": 1920, "height": 1080, "avg_frame_rate": "30000/1001", "duration": "2.5"});
            stream.as_object_mut().unwrap().extend(more.as_object().unwrap().clone());
            parse(&json!({"streams": [stream], "format": {"duration": "3"}}))
        };
        let plain = stream(json!({})).unwrap();
        assert_eq!((plain.size, plain.seconds), ([1920, 1080], 2.5));
        assert!((plain.fps - 29.97).abs() < 1e-3);
        assert_eq!(stream(json!({"side_data_list": [{"rotation": -90}]})).unwrap().size, [1080, 1920]);
        assert_eq!(stream(json!({"tags": {"rotate": "180"}})).unwrap().size, [1920, 1080]);
        assert_eq!(stream(json!({"sample_aspect_ratio": "4:3"})).unwrap().size, [2560, 1080]);
        assert_eq!(stream(json!({"duration": "N/A"})).unwrap().seconds, 3.0);
        assert_eq!(stream(json!({"avg_frame_rate": "0/0", "r_frame_rate": "25/1"})).unwrap().fps, 25.0);
        assert!(stream(json!({"avg_frame_rate": "0/0"})).is_none() && parse(&json!({})).is_none());
    }

    #[test]
    fn names_are_neither_flags_nor_protocols() {
        let text = input(Path::new("-y:a.mp4"));
        let text = text.to_str().unwrap();
        assert!(text.starts_with("file:") && text.ends_with("-y:a.mp4") && text.len() > 15, "{text}");
    }
}
