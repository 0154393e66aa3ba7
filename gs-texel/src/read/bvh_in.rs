//! Motions in BVH files (Biovision): a hierarchy of joints and their angles frame by frame.
//!
//! Of a joint, `OFFSET` is its place in its parent's frame at rest, where no joint is turned. Channels apply in the order of the
//! file: `Zrotation Xrotation Yrotation` is `R_z R_x R_y`, angles are degrees. Positions take the place of the offset.

use super::error::CharacterError;
use crate::clip::{Channel, Clip, Interpolation, Target};
use crate::skeleton::{Node, Skeleton, Trs, axis_angle};
use glam::DVec3;
use gs_core::io::{Limits, read_file};
use gs_core::rot;
use std::path::Path;

/// Deepest nesting of joints.
const MAX_DEPTH: usize = 256;
/// Most channels of a joint: positions and angles of the three axes.
const MAX_CHANNELS: usize = 6;

/// A skeleton without a mesh, and how it moves.
#[derive(Clone, Debug, PartialEq)]
pub struct Motion {
    /// The joints at rest, in the units of the file.
    pub skeleton: Skeleton,
    /// Their motion; rows of `skeleton`.
    pub clip: Clip,
    /// Seconds between two frames.
    pub frame_time: f64,
}

/// Reads a `.bvh` file.
///
/// # Errors
/// If it cannot be read or is no BVH, see [`CharacterError`].
pub fn load_motion(path: &Path, limits: &Limits) -> Result<Motion, CharacterError> {
    parse_motion(&read_file(path, limits)?, &path.display().to_string())
}

/// Reads BVH text from memory; `file` is the name used in errors.
///
/// # Errors
/// As [`load_motion`].
///
/// ```
/// use gs_texel::read::parse_motion;
///
/// let text = "HIERARCHY\nROOT hips\n{\nOFFSET 0 90 0\nCHANNELS 3 Zrotation Xrotation Yrotation\nEnd Site\n{\nOFFSET 0 10 0\n}\n}\n\
///             MOTION\nFrames: 2\nFrame Time: 0.5\n0 0 0\n90 0 0\n";
/// let motion = parse_motion(text.as_bytes(), "turn.bvh")?;
/// let pose = motion.clip.pose(&motion.skeleton, 0.5);
/// // The end of the bone, 10 above the hips, lies beside them after a quarter turn about z.
/// let end = motion.skeleton.globals(&pose)[1].translation;
/// assert!(end.abs_diff_eq(glam::DVec3::new(-10.0, 90.0, 0.0), 1e-9));
/// # Ok::<(), gs_texel::CharacterError>(())
/// ```
pub fn parse_motion(bytes: &[u8], file: &str) -> Result<Motion, CharacterError> {
    let text = String::from_utf8_lossy(bytes);
    let mut reader =
        Reader { file, words: Words { lines: text.lines().enumerate(), line: 0, words: "".split_whitespace() } };
    reader.expect("HIERARCHY")?;
    let mut joints = Vec::new();
    reader.expect("ROOT")?;
    reader.joint(None, 0, &mut joints)?;
    reader.motion(&joints)
}

/// Words of a text with the number of their line.
struct Words<'a> {
    lines: std::iter::Enumerate<std::str::Lines<'a>>,
    line: usize,
    words: std::str::SplitWhitespace<'a>,
}

impl<'a> Iterator for Words<'a> {
    type Item = &'a str;

    fn next(&mut self) -> Option<&'a str> {
        loop {
            if let Some(word) = self.words.next() {
                return Some(word);
            }
            let (line, text) = self.lines.next()?;
            (self.line, self.words) = (line + 1, text.split_whitespace());
        }
    }
}

/// What a channel changes: the place or the angle about an axis.
#[derive(Clone, Copy)]
enum Change {
    Position(usize),
    Angle(DVec3),
}

/// A joint of the hierarchy and its channels.
struct BvhJoint {
    node: Node,
    channels: Vec<Change>,
}

struct Reader<'a> {
    file: &'a str,
    words: Words<'a>,
}

impl<'a> Reader<'a> {
    fn wrong(&self, what: impl Into<String>) -> CharacterError {
        let place = format!("line {}", self.words.line);
        CharacterError::Malformed { file: self.file.into(), place, what: what.into() }
    }

    fn word(&mut self, wanted: &str) -> Result<&'a str, CharacterError> {
        self.words.next().ok_or_else(|| self.wrong(format!("the file ends where {wanted} should be")))
    }

    fn expect(&mut self, wanted: &str) -> Result<(), CharacterError> {
        let found = self.word(wanted)?;
        if found.eq_ignore_ascii_case(wanted) {
            Ok(())
        } else {
            Err(self.wrong(format!("`{found}` where {wanted} should be")))
        }
    }

    fn number(&mut self) -> Result<f64, CharacterError> {
        let word = self.word("a number")?;
        let number = word.parse::<f64>().ok().filter(|v| v.is_finite() && v.abs() < 1e12);
        number.ok_or_else(|| self.wrong(format!("`{word}` where a finite number should be")))
    }

    fn offset(&mut self) -> Result<DVec3, CharacterError> {
        self.expect("OFFSET")?;
        Ok(DVec3::new(self.number()?, self.number()?, self.number()?))
    }

    /// The text after `ROOT` or `JOINT`, and the joints below.
    fn joint(&mut self, parent: Option<u32>, depth: usize, joints: &mut Vec<BvhJoint>) -> Result<(), CharacterError> {
        if depth > MAX_DEPTH {
            return Err(self.wrong(format!("joints are nested deeper than {MAX_DEPTH}")));
        }
        // A name may have blanks.
        let mut name = self.word("a name")?.to_owned();
        loop {
            match self.word("{")? {
                "{" => break,
                more => {
                    name.push(' ');
                    name.push_str(more);
                }
            }
        }
        let rest = Trs::at(self.offset()?);
        self.expect("CHANNELS")?;
        let count = self.number()?;
        let known = (0..=MAX_CHANNELS).find(|k| *k as f64 == count);
        let count = known.ok_or_else(|| self.wrong(format!("{count} channels; a joint has up to {MAX_CHANNELS}")))?;
        let channels = (0..count).map(|_| self.channel()).collect::<Result<_, _>>()?;
        let own = joints.len() as u32;
        joints.push(BvhJoint { node: Node { name, parent, rest }, channels });
        loop {
            match self.word("JOINT, End or }")? {
                "}" => return Ok(()),
                "JOINT" => self.joint(Some(own), depth + 1, joints)?,
                "End" => {
                    self.expect("Site")?;
                    self.expect("{")?;
                    let rest = Trs::at(self.offset()?);
                    self.expect("}")?;
                    joints.push(BvhJoint {
                        node: Node { name: String::new(), parent: Some(own), rest },
                        channels: Vec::new(),
                    });
                }
                other => return Err(self.wrong(format!("`{other}` where JOINT, End or }} should be"))),
            }
        }
    }

    fn channel(&mut self) -> Result<Change, CharacterError> {
        let word = self.word("a channel")?;
        let (axis, kind) = word.split_at_checked(1).unwrap_or(("", word));
        let axis = match axis.to_ascii_lowercase().as_str() {
            "x" => 0,
            "y" => 1,
            "z" => 2,
            _ => return Err(self.wrong(format!("`{word}` is no channel"))),
        };
        match kind.to_ascii_lowercase().as_str() {
            "position" => Ok(Change::Position(axis)),
            "rotation" => Ok(Change::Angle(DVec3::AXES.get(axis).copied().unwrap_or(DVec3::X))),
            _ => Err(self.wrong(format!("`{word}` is no channel"))),
        }
    }

    /// The frames.
    fn motion(mut self, joints: &[BvhJoint]) -> Result<Motion, CharacterError> {
        self.expect("MOTION")?;
        self.expect("Frames:")?;
        let frames = self.number()?;
        self.expect("Frame")?;
        self.expect("Time:")?;
        let frame_time = self.number()?;
        if frame_time <= 0.0 {
            return Err(self.wrong(format!("a frame takes {frame_time} seconds")));
        }
        // Every frame has a number at least, so a short file cannot ask for many.
        if joints.iter().all(|j| j.channels.is_empty()) {
            return Err(self.wrong("no joint has a channel"));
        }
        let moved = |j: &BvhJoint| j.channels.iter().any(|c| matches!(c, Change::Position(_)));
        let mut turns: Vec<Vec<f64>> = vec![Vec::new(); joints.len()];
        let mut places = turns.clone();
        let mut times = Vec::new();
        // The count is believed as far as there are numbers.
        while (times.len() as f64) < frames {
            times.push(times.len() as f64 * frame_time);
            let all = joints.iter().zip(&mut turns).zip(&mut places);
            for ((joint, turns), places) in all.filter(|((j, _), _)| !j.channels.is_empty()) {
                let (mut at, mut turn) = (joint.node.rest.translation, Trs::IDENTITY.rotation);
                for change in &joint.channels {
                    let value = self.number()?;
                    match *change {
                        Change::Position(axis) => at = with(at, axis, value),
                        Change::Angle(axis) => turn = rot::hamilton(turn, axis_angle(axis, value.to_radians())),
                    }
                }
                turns.extend(turn);
                places.extend(at.to_array());
            }
        }
        if times.is_empty() {
            return Err(self.wrong("there is no frame"));
        }
        if let Some(more) = self.words.next() {
            return Err(self.wrong(format!("`{more}` behind the last frame: more numbers than channels and frames")));
        }
        let mut channels = Vec::new();
        for (k, (joint, (turns, places))) in joints.iter().zip(turns.into_iter().zip(places)).enumerate() {
            let mut add = |target, values| {
                let times = times.clone();
                channels.push(Channel { target, interpolation: Interpolation::Linear, times, values });
            };
            if !joint.channels.is_empty() {
                add(Target::Rotation(k as u32), turns);
            }
            if moved(joint) {
                add(Target::Translation(k as u32), places);
            }
        }
        let skeleton = Skeleton { nodes: joints.iter().map(|j| j.node.clone()).collect(), ..Skeleton::default() };
        Ok(Motion { skeleton, clip: Clip { name: String::new(), channels }, frame_time })
    }
}

/// A vector with one of its components replaced.
fn with(mut v: DVec3, axis: usize, value: f64) -> DVec3 {
    match axis {
        0 => v.x = value,
        1 => v.y = value,
        _ => v.z = value,
    }
    v
}

#[cfg(test)]
mod tests {
    use super::*;

    const TWO: &str = "HIERARCHY\nROOT Hips\n{\n  OFFSET 1 2 3\n  CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation\n  \
        JOINT Left Leg\n  {\n    OFFSET 0 -4 0\n    CHANNELS 3 Yrotation Zrotation Xrotation\n    End Site\n    {\n      OFFSET 0 -5 0\n    }\n  }\n}\n\
        MOTION\nFrames: 2\nFrame Time: 0.1\n10 20 30 90 0 0 0 0 0\n0 0 0 30 40 50 -20 60 70\n";

    #[test]
    fn places_and_angles_are_those_of_the_text() {
        let m = parse_motion(TWO.as_bytes(), "two.bvh").unwrap();
        let names: Vec<&str> = m.skeleton.nodes.iter().map(|n| n.name.as_str()).collect();
        assert_eq!((names, m.frame_time, m.clip.duration()), (vec!["Hips", "Left Leg", ""], 0.1, 0.1));
        let at = |t: f64| m.skeleton.globals(&m.clip.pose(&m.skeleton, t));
        // A quarter turn about z takes -y to x.
        let first = at(0.0);
        assert!(first[1].translation.abs_diff_eq(DVec3::new(14.0, 20.0, 30.0), 1e-12));
        assert!(first[2].translation.abs_diff_eq(DVec3::new(19.0, 20.0, 30.0), 1e-12));
        use glam::DMat3;
        let r = |axis: char, degrees: f64| match axis {
            'x' => DMat3::from_rotation_x(degrees.to_radians()),
            'y' => DMat3::from_rotation_y(degrees.to_radians()),
            _ => DMat3::from_rotation_z(degrees.to_radians()),
        };
        let hips = r('z', 30.0) * r('x', 40.0) * r('y', 50.0);
        let leg = hips * r('y', -20.0) * r('z', 60.0) * r('x', 70.0);
        let want = hips * DVec3::new(0.0, -4.0, 0.0) + leg * DVec3::new(0.0, -5.0, 0.0);
        assert!(at(0.1)[2].translation.abs_diff_eq(want, 1e-12));
    }

    #[test]
    fn texts_that_are_none_are_refused_with_their_line() {
        let wrong =
            |from: &str, to: &str| parse_motion(TWO.replacen(from, to, 1).as_bytes(), "x.bvh").unwrap_err().to_string();
        for (from, to, what) in [
            ("HIERARCHY", "HIER", "x.bvh: line 1: `HIER` where HIERARCHY should be"),
            ("OFFSET 1", "OFFSET one", "line 4: `one` where a finite number should be"),
            ("Xposition", "Wposition", "line 5: `Wposition` is no channel"),
            ("CHANNELS 6", "CHANNELS 6e9", "a joint has up to 6"),
            ("Time: 0.1", "Time: 0", "a frame takes 0 seconds"),
            ("Frames: 2", "Frames: 1e15", "a finite number"),
            ("Frames: 2", "Frames: 0", "there is no frame"),
            ("60 70\n", "60 nan\n", "line 20: `nan`"),
            ("60 70\n", "60\n", "the file ends where a number should be"),
            ("60 70\n", "60 70 80\n", "`80` behind the last frame"),
        ] {
            assert!(wrong(from, to).contains(what), "{to}: {}", wrong(from, to));
        }
        let deep = format!("HIERARCHY ROOT a {}", "{ OFFSET 0 0 0 CHANNELS 0 JOINT a ".repeat(400));
        assert!(parse_motion(deep.as_bytes(), "x.bvh").unwrap_err().to_string().contains("nested deeper"));
        let still = "HIERARCHY ROOT a { OFFSET 0 0 0 CHANNELS 0 } MOTION Frames: 99999999999 Frame Time: 1";
        assert!(parse_motion(still.as_bytes(), "x.bvh").unwrap_err().to_string().contains("no joint has a channel"));
        // Cut anywhere, there is an error and no panic.
        (0..TWO.len() - 4).for_each(|n| assert!(parse_motion(&TWO.as_bytes()[..n], "x.bvh").is_err(), "{n}"));
    }
}
