//! Options of readers: the section `[data]` of a run's configuration.

use std::collections::BTreeMap;
use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use super::error::DataError;

/// A closed range of times in the data's own units, written `0..1.3`; `end > start`, both finite.
///
/// ```
/// use gs_data::TimeRange;
///
/// let range: TimeRange = "0..1.3".parse()?;
/// assert_eq!((range.start, range.end, range.to_string()), (0.0, 1.3, "0..1.3".into()));
/// assert!("2..1".parse::<TimeRange>().is_err());
/// # Ok::<(), String>(())
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct TimeRange {
    /// First time, mapped to normalised 0.
    pub start: f64,
    /// Last time, mapped to normalised 1.
    pub end: f64,
}

impl fmt::Display for TimeRange {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}..{}", self.start, self.end)
    }
}

impl From<TimeRange> for String {
    fn from(r: TimeRange) -> Self {
        r.to_string()
    }
}

impl FromStr for TimeRange {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let wrong = || format!("\"{text}\" is no time range; write for example 0..1.3");
        let (a, b) = text.split_once("..").ok_or_else(wrong)?;
        let number = |s: &str| s.trim().parse::<f64>().ok().filter(|v| v.is_finite()).ok_or_else(wrong);
        let range = Self { start: number(a)?, end: number(b)? };
        if range.end > range.start { Ok(range) } else { Err(wrong()) }
    }
}

impl TryFrom<String> for TimeRange {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        text.parse()
    }
}

/// Moments by which the images of cameras are moved in time, written `CAMERA:MOMENTS`, separated by commas: `4:-2,17:1`.
///
/// ```
/// use gs_data::TimeShift;
///
/// let shift: TimeShift = "4:-2, 17:1".parse()?;
/// assert_eq!((shift.0[&4], shift.to_string()), (-2, "4:-2,17:1".into()));
/// assert!("4".parse::<TimeShift>().is_err());
/// # Ok::<(), String>(())
/// ```
#[derive(Clone, Debug, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub struct TimeShift(
    /// Moments by camera ([`super::View::camera_id`]): an image at the `k`-th of all timestamps gets the `k + n`-th one.
    pub BTreeMap<u32, i32>,
);

impl fmt::Display for TimeShift {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let each: Vec<String> = self.0.iter().map(|(camera, n)| format!("{camera}:{n}")).collect();
        f.write_str(&each.join(","))
    }
}

impl From<TimeShift> for String {
    fn from(s: TimeShift) -> Self {
        s.to_string()
    }
}

impl FromStr for TimeShift {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let wrong = || format!("\"{text}\" shifts no camera; write for example 4:-2,17:1 (camera and moments)");
        let each = |part: &str| {
            let (camera, moments) = part.split_once(':')?;
            Some((camera.trim().parse().ok()?, moments.trim().parse().ok()?))
        };
        text.split(',').map(|part| each(part).ok_or_else(wrong)).collect::<Result<_, _>>().map(Self)
    }
}

impl TryFrom<String> for TimeShift {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        text.parse()
    }
}

/// Where the time of a frame comes from: `data.time_from`, in lower case.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum TimeFrom {
    /// The files of the layout; a layout without times is static.
    #[default]
    File,
    /// The last number in the image's file name is its frame number.
    Name,
    /// The index of the image in sorted order of file names: an assumption about the capture, hence never a default.
    Order,
}

/// Options of every reader; the name of a field `x` on the command line is `data.x`. Deserialising refuses unknown keys.
///
/// ```
/// use gs_data::DataOptions;
///
/// let options = DataOptions { scale: 0.5, test_cameras: vec![0], ..DataOptions::default() };
/// assert_eq!((options.hold_out, options.layout), (8, None));
/// ```
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DataOptions {
    /// Name of the layout (see [`super::LAYOUTS`]); none: detect it.
    pub layout: Option<String>,
    /// Range of training times (with a boundary: of the whole sequence), mapped to 0..1; times outside are errors. None: the span of the
    /// training views that are read, but in four layouts that of the data whatever part of them is read: rigs of `llff` (frame `k` of `n`
    /// at `k/n`), `nvidia` (image `k` of `n` at `k/(n−1)`), `hypernerf` (over the largest id of all lists) and `nvfi` (times as they
    /// stand). `blender` and `nvfi` refuse training times outside 0..1.
    pub time_range: Option<TimeRange>,
    /// Share of the whole sequence, above 0 and at most 1, that may train: views up to it keep their split, all later
    /// ones, of every camera and split, are [`super::Split::Extrapolate`]. The whole sequence is `time_range`, else the layout's own
    /// span, else that of all views, and is mapped to 0..1. None: the value in `scene.toml` of the data folder, else no boundary; 1: no boundary.
    pub time_boundary: Option<f64>,
    /// Where the times of frames come from.
    pub time_from: TimeFrom,
    /// Frames per second for [`TimeFrom::Name`], [`TimeFrom::Order`] and layouts whose files count frames; refused elsewhere. None:
    /// the rate of the layout, else [`gs_core::Time::seconds`] equals the normalised time.
    pub fps: Option<f64>,
    /// Cameras whose clock is early or late, and the moments by which their images are moved; images that would leave the sequence
    /// are left out. None: the value in `scene.toml` of the data folder.
    pub time_shift: Option<TimeShift>,
    /// Leave out views whose image is missing, with a note, instead of returning an error.
    pub allow_missing: bool,
    /// Where the data give no split: every `hold_out`-th view in order of names, starting with the first, is held out.
    /// 0 holds out none.
    pub hold_out: u32,
    /// Cameras to read, by [`super::View::camera_id`], held-out ones included; empty: all.
    pub cameras: Vec<u32>,
    /// Cameras to hold out, of those that are read, instead of the data's own split; all others train. Empty: the data's split.
    pub test_cameras: Vec<u32>,
    /// First timestamp to read, as an index from 0 into the sorted distinct times of all views. What is read is 0..1, or a slice of it
    /// where [`Self::time_range`] or the layout sets the span.
    pub first_frame: u32,
    /// Number of timestamps from `first_frame` on, including those that `frame_step` leaves out; 0: all.
    pub frame_count: u32,
    /// Read every `frame_step`-th of these; at least 1.
    pub frame_step: u32,
    /// Resample distorted images to their pinhole camera; `false` makes a distorted camera an error.
    pub undistort: bool,
    /// Nerfies and DyCheck captures: transform cameras and points to the normalised frame of `scene.json`; `false` stays in the
    /// raw frame, as 4DGaussians does.
    pub normalise: bool,
    /// Nerfies and DyCheck captures: use the focal length alone, as 4DGaussians does: principal point in the centre, no skew,
    /// no distortion.
    pub center_pp: bool,
    /// Image folder, of layouts that may have several: for a COLMAP model none is the first of `images`, `images_2`, `images_4`, `images_8`,
    /// `input`; of nerfstudio it takes the place of `images` in the paths of frames.
    pub images: Option<String>,
    /// Factor on the size of the stored images: above 0, at most 1. Shrinking averages areas.
    pub scale: f64,
    /// Make pixels outside a view's mask transparent, so that the background of training replaces them, and leave out views
    /// without a mask.
    pub cut_out: bool,
    /// Leave pixels outside a training view's mask out of the loss: they teach nothing, whatever is rendered there. A view without a
    /// mask counts wholly.
    pub mask_loss: bool,
    /// Most memory for decoding one image, mask or depth PNG, MiB; none: 64 MiB plus eight times the size of its file.
    pub max_image_mib: Option<u32>,
}

impl Default for DataOptions {
    fn default() -> Self {
        Self {
            layout: None,
            time_range: None,
            time_boundary: None,
            time_from: TimeFrom::File,
            fps: None,
            time_shift: None,
            allow_missing: false,
            hold_out: 8,
            cameras: Vec::new(),
            test_cameras: Vec::new(),
            first_frame: 0,
            frame_count: 0,
            frame_step: 1,
            undistort: true,
            normalise: true,
            center_pp: false,
            images: None,
            scale: 1.0,
            cut_out: false,
            mask_loss: false,
            max_image_mib: None,
        }
    }
}

impl DataOptions {
    /// Refuses `data.images` in a layout without a choice of image folders.
    ///
    /// # Errors
    /// [`DataError::Idle`].
    pub(crate) fn without_images(&self, layout: &str) -> Result<(), DataError> {
        let Some(value) = self.images.clone() else { return Ok(()) };
        let rule = format!("the layout {layout} has no choice of image folders");
        Err(DataError::Idle { name: "data.images", value, rule })
    }

    /// Refuses `data.fps` where times come from files that count no frames.
    ///
    /// # Errors
    /// [`DataError::Idle`].
    pub(crate) fn without_fps(&self, layout: &str) -> Result<(), DataError> {
        let Some(fps) = self.fps.filter(|_| self.time_from == TimeFrom::File) else { return Ok(()) };
        let rule = format!(
            "the files of the layout {layout} count no frames; data.time_from=name or order counts, data.time_range \
             scales times of files"
        );
        Err(DataError::Idle { name: "data.fps", value: fps.to_string(), rule })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranges_are_read_as_they_are_written() {
        let r: TimeRange = "0..1.3".parse().unwrap();
        assert_eq!(r, TimeRange { start: 0.0, end: 1.3 });
        assert_eq!(r.to_string(), "0..1.3");
        for bad in ["", "0", "1..0", "0..0", "0..nan", "a..b", "0..inf"] {
            assert!(bad.parse::<TimeRange>().unwrap_err().contains("0..1.3"), "{bad}");
        }
    }

    #[test]
    fn shifts_are_read_as_they_are_written() {
        let s: TimeShift = " 4:-2 , 17:+1".parse().unwrap();
        assert_eq!((&s.0, s.to_string().as_str()), (&BTreeMap::from([(4, -2), (17, 1)]), "4:-2,17:1"));
        for bad in ["", "4", "4:", ":2", "4:x", "-1:2", "4:2;5:1", "4=2"] {
            assert!(bad.parse::<TimeShift>().unwrap_err().contains("4:-2,17:1"), "{bad}");
        }
    }

    #[test]
    fn options_are_read_from_toml_and_unknown_keys_refused() {
        let o: DataOptions = toml::from_str("time_range = \"0..2\"\ntime_from = \"name\"\nhold_out = 4").unwrap();
        assert_eq!((o.time_from, o.hold_out), (TimeFrom::Name, 4));
        assert_eq!(o.time_range.unwrap().end, 2.0);
        assert!(toml::from_str::<DataOptions>("time_rnage = \"0..2\"").unwrap_err().to_string().contains("time_rnage"));
    }
}
