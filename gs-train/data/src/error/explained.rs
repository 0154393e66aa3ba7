//! What an error is called, where it lies, why it matters and what to do about it.

use super::{DataError, Place};
use crate::advice;

impl DataError {
    /// Stable name of the kind of error, for example `data.time`.
    pub fn code(&self) -> &'static str {
        match self {
            Self::NotFound { .. } => "data.path",
            Self::Layout { .. } => "data.layout",
            Self::Read { .. } => "io.read",
            Self::Write { .. } => "io.write",
            Self::Occupied { .. } => "io.exists",
            Self::TooLarge { .. } => "limits.file",
            Self::Syntax { .. } => "data.syntax",
            Self::Truncated { .. } => "data.truncated",
            Self::Field { .. } => "data.field",
            Self::Pose { .. } => "data.pose",
            Self::Time { .. } => "data.time",
            Self::Missing { .. } => "data.missing",
            Self::Video { .. } => "data.video",
            Self::Escape { .. } => "data.escape",
            Self::CameraModel { .. } => "data.camera_model",
            Self::Decode { .. } => "data.image",
            Self::Points { .. } => "data.points",
            Self::Character { .. } => "data.character",
            Self::ImageSize { .. } => "data.image_size",
            Self::Empty { .. } => "data.empty",
            Self::Option { .. } | Self::Idle { .. } => "data.option",
        }
    }

    /// Exit code for a command line: 2 usage, 3 data, 5 limit, 6 input and output.
    pub fn exit_code(&self) -> u8 {
        match self {
            Self::Option { .. } | Self::Idle { .. } => 2,
            Self::TooLarge { .. } => 5,
            Self::Read { .. } | Self::Write { .. } | Self::Occupied { .. } => 6,
            _ => 3,
        }
    }

    /// File and position, where the error has one.
    pub fn place(&self) -> Option<Place> {
        match self {
            Self::TooLarge { place, .. }
            | Self::Syntax { place, .. }
            | Self::Truncated { place, .. }
            | Self::Field { place, .. }
            | Self::Pose { place, .. }
            | Self::Time { place, .. }
            | Self::Escape { place, .. }
            | Self::CameraModel { place, .. } => Some(place.clone()),
            Self::Missing { listed_in: file, .. }
            | Self::Decode { file, .. }
            | Self::Points { file, .. }
            | Self::Character { file, .. }
            | Self::ImageSize { file, .. }
            | Self::Empty { file }
            | Self::Read { file, .. }
            | Self::Write { file, .. } => Some(Place::new(file, "")),
            Self::NotFound { .. }
            | Self::Layout { .. }
            | Self::Occupied { .. }
            | Self::Video { .. }
            | Self::Option { .. }
            | Self::Idle { .. } => None,
        }
    }

    /// Why the error matters, in one clause.
    pub fn why(&self) -> &'static str {
        match self {
            Self::NotFound { .. } | Self::Read { .. } => "without it there is nothing to read",
            Self::Layout { .. } => "guessing a layout would give wrong cameras without a word",
            Self::Write { .. } => "the folder would be incomplete",
            Self::Occupied { .. } => "nothing is overwritten unless asked",
            Self::TooLarge { .. } => "a small file must not take all memory",
            Self::Syntax { .. } | Self::Truncated { .. } => "the rest of the file cannot be trusted",
            Self::Field { why, .. } => why,
            Self::Pose { .. } => "a scaled, sheared or mirrored camera sees another scene",
            Self::Time { .. } => "outside the training span it would train the extrapolation range",
            Self::Missing { .. } => "training on fewer views than listed changes the result without a word",
            Self::Video { .. } => "videos are not decoded here, frames are read as images",
            Self::Escape { .. } => "data from elsewhere must not read files outside its own folder",
            Self::CameraModel { .. } => "its distortion would be ignored and every ray bent",
            Self::Decode { .. } => "the view cannot be compared",
            Self::Points { .. } => "the file that names these points expects training to start from them",
            Self::Character { .. } => "the scene's poses are those of this template",
            Self::ImageSize { .. } => "focal lengths and principal point are in pixels of the camera's size",
            Self::Empty { .. } => "there is nothing to learn from",
            Self::Option { .. } | Self::Idle { .. } => "the value has no meaning here",
        }
    }

    /// What to do about it, in one clause.
    pub fn fix(&self) -> String {
        match self {
            Self::NotFound { path } => advice::instead_of(path),
            Self::Layout { path, looked_for } => match looked_for.contains("was asked for") {
                true => "name one of these with --set data.layout=NAME, or leave it out".into(),
                false => advice::instead_of(path),
            },
            Self::Read { .. } | Self::Write { .. } => "check permissions and disk".into(),
            Self::Occupied { .. } => "choose another folder, or pass -f to overwrite".into(),
            Self::TooLarge { .. } => "make the file smaller, or raise --set data.max_image_mib for images".into(),
            Self::Syntax { .. } | Self::Truncated { .. } => "copy or export the file again".into(),
            Self::Field { fix, .. } => (*fix).into(),
            Self::Pose { .. } => "export camera-to-world matrices without scale".into(),
            Self::Time { span, .. } => format!("--set data.time_range={span}; or correct the file"),
            Self::Missing { .. } => "copy the files, or pass --set data.allow_missing=true to leave them out".into(),
            Self::Video { command, .. } => format!("run in that folder: {command}"),
            Self::Escape { place, path, inside: Some(inside) } => advice::relative(&place.file, path, inside),
            Self::Escape { .. } => "copy the file into the data folder and use a relative path".into(),
            Self::CameraModel { .. } => {
                "undistort first (colmap image_undistorter), or use SIMPLE_PINHOLE, PINHOLE, SIMPLE_RADIAL, RADIAL, OPENCV or OPENCV_FISHEYE"
                    .into()
            }
            Self::Decode { .. } => "open the image elsewhere; export it as 8 or 16 bit PNG or as JPEG".into(),
            Self::Character { .. } => "export the character again as glTF or GLB".into(),
            Self::Points { .. } => "put the file there or export it again; to start without it, remove what names it: points of [start] in \
                                    scene.toml, or ply_file_path in transforms.json"
                .into(),
            Self::ImageSize { .. } => "resize the image, or correct w and h in the camera file".into(),
            Self::Empty { .. } => "list at least one training view whose image exists".into(),
            Self::Option { name: "--from", .. } => "leave --from out, or name another source".into(),
            Self::Idle { name, .. } => format!("leave {name} out"),
            Self::Option { rule, .. } => format!("give a value that fits: {rule}"),
        }
    }

    /// The whole text for people, one line each: headline, `in`, `why`, `do`.
    ///
    /// ```text
    /// error[data.time]: frame "r_017" has time 1.3, the other 149 lie in 0..1
    ///   in   transforms_train.json, frames[17].time
    ///   why  outside the training span it would train the extrapolation range
    ///   do   --set data.time_range=0..1.3; or correct the file
    /// ```
    pub fn report(&self) -> String {
        let place = self.place().map_or(String::new(), |p| format!("\n  in   {p}"));
        format!("error[{}]: {self}{place}\n  why  {}\n  do   {}", self.code(), self.why(), self.fix())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::options::TimeRange;
    use std::path::Path;

    #[test]
    fn the_report_says_what_where_why_and_what_to_do() {
        let e = DataError::Time {
            place: Place::new(Path::new("data/balls/transforms_train.json"), "frames[17].time"),
            frame: "r_017".into(),
            value: 1.3,
            outside: 1,
            total: 150,
            span: TimeRange { start: 0.0, end: 1.3 },
            range: TimeRange { start: 0.0, end: 1.0 },
        };
        assert_eq!(
            e.report(),
            "error[data.time]: frame \"r_017\" has time 1.3; 1 of 150 training times lie outside 0..1, all frames are in 0..1.3\n  \
             in   data/balls/transforms_train.json, frames[17].time\n  \
             why  outside the training span it would train the extrapolation range\n  \
             do   --set data.time_range=0..1.3; or correct the file"
        );
        assert_eq!(e.exit_code(), 3);
    }
}
