//! Selection of views by `data.cameras`, `data.test_cameras`, `data.first_frame`, `data.frame_count` and `data.frame_step`.

use std::collections::BTreeSet;

use super::error::DataError;
use super::options::DataOptions;
use super::times::{Draft, Drafts};

/// Keeps the cameras and timestamps asked for, and makes a new split where held-out cameras are named.
///
/// # Errors
/// `data.option` if a camera is named that no view has, one is held out that is not read, or no training view is left.
pub(crate) fn select(drafts: Drafts, options: &DataOptions, notes: &mut Vec<String>) -> Result<Drafts, DataError> {
    let before = drafts.len();
    let drafts = cameras(drafts, options)?;
    let drafts = frames(drafts, options)?;
    if drafts.len() < before {
        notes.push(format!(
            "{} of {before} views are read, as data.cameras and the options of frames ask",
            drafts.len()
        ));
    }
    if !options.test_cameras.is_empty() {
        notes.push(format!(
            "cameras {:?} are held out, as data.test_cameras asks, all others train",
            options.test_cameras
        ));
    }
    Ok(drafts)
}

impl Drafts {
    fn len(&self) -> usize {
        self.train.len() + self.val.len() + self.test.len()
    }

    pub(super) fn all(&self) -> impl Iterator<Item = &Draft> {
        self.train.iter().chain(&self.val).chain(&self.test)
    }

    fn retain(&mut self, keep: impl Fn(&Draft) -> bool) {
        [&mut self.train, &mut self.val, &mut self.test].into_iter().for_each(|list| list.retain(&keep));
    }
}

fn wrong(name: &'static str, value: impl ToString, rule: impl Into<String>) -> DataError {
    DataError::Option { name, value: value.to_string(), rule: rule.into() }
}

fn cameras(mut drafts: Drafts, options: &DataOptions) -> Result<Drafts, DataError> {
    let known: BTreeSet<u32> = drafts.all().map(|d| d.view.camera_id).collect();
    for (name, list) in [("data.cameras", &options.cameras), ("data.test_cameras", &options.test_cameras)] {
        if let Some(missing) = list.iter().find(|c| !known.contains(c)) {
            let rule = format!("there are cameras {}", ranges(&known));
            return Err(wrong(name, missing, rule));
        }
    }
    let unread = |c: &&u32| !options.cameras.is_empty() && !options.cameras.contains(c);
    if let Some(unread) = options.test_cameras.iter().find(unread) {
        let rule = "held-out cameras must be among data.cameras, which alone are read";
        return Err(wrong("data.test_cameras", unread, rule));
    }
    if !options.cameras.is_empty() {
        drafts.retain(|d| options.cameras.contains(&d.view.camera_id));
    }
    if !options.test_cameras.is_empty() {
        let all = drafts.train.into_iter().chain(drafts.val).chain(drafts.test);
        let (test, train) = all.partition(|d| options.test_cameras.contains(&d.view.camera_id));
        drafts = Drafts { train, val: Vec::new(), test };
    }
    if drafts.train.is_empty() {
        let (name, list) = match &options.test_cameras[..] {
            [] => ("data.cameras", &options.cameras),
            _ => ("data.test_cameras", &options.test_cameras),
        };
        return Err(wrong(name, format!("{list:?}"), "at least one camera must train"));
    }
    Ok(drafts)
}

/// Numbers as text, consecutive ones as a range: `1-9, 11`.
fn ranges(numbers: &BTreeSet<u32>) -> String {
    let mut runs: Vec<[u32; 2]> = Vec::new();
    for &n in numbers {
        match runs.last_mut() {
            Some([_, last]) if *last + 1 == n => *last = n,
            _ => runs.push([n, n]),
        }
    }
    let text = |[a, b]: &[u32; 2]| if a == b { a.to_string() } else { format!("{a}-{b}") };
    runs.iter().map(text).collect::<Vec<_>>().join(", ")
}

fn frames(mut drafts: Drafts, options: &DataOptions) -> Result<Drafts, DataError> {
    if options.frame_step == 0 {
        return Err(wrong("data.frame_step", 0, "at least 1"));
    }
    if (options.first_frame, options.frame_count, options.frame_step) == (0, 0, 1) {
        return Ok(drafts);
    }
    let mut times: Vec<f64> = drafts.all().filter_map(|d| d.stated).collect();
    times.sort_by(f64::total_cmp);
    times.dedup();
    let count = if options.frame_count == 0 { usize::MAX } else { options.frame_count as usize };
    let first = options.first_frame as usize;
    let read = times.iter().skip(first).take(count).step_by(options.frame_step as usize);
    let read: BTreeSet<u64> = read.map(|t| t.to_bits()).collect();
    drafts.retain(|d| d.stated.is_some_and(|t| read.contains(&t.to_bits())));
    if drafts.train.is_empty() {
        let rule = format!("the data have {} moments, and some training view must be left", times.len());
        return Err(wrong("data.first_frame", first, rule));
    }
    Ok(drafts)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Cameras 0 to 3 at times 0 to 5; camera 3 is held out.
    fn drafts() -> Drafts {
        let draft = |k: u32| Draft::of_camera("v".to_owned(), k % 4, f64::from(k / 4));
        let (test, train) = (0..24).map(draft).partition(|d| d.view.camera_id == 3);
        Drafts { train, val: Vec::new(), test }
    }

    fn chosen(options: &DataOptions) -> Result<[usize; 2], DataError> {
        select(drafts(), options, &mut Vec::new()).map(|d| [d.train.len(), d.test.len()])
    }

    #[test]
    fn cameras_and_moments_are_chosen() {
        let d = DataOptions::default;
        assert_eq!(chosen(&d()).unwrap(), [18, 6]);
        assert_eq!(chosen(&DataOptions { cameras: vec![1, 3], ..d() }).unwrap(), [6, 6]);
        assert_eq!(chosen(&DataOptions { test_cameras: vec![0, 1], ..d() }).unwrap(), [12, 12]);
        assert_eq!(chosen(&DataOptions { cameras: vec![0, 1, 3], test_cameras: vec![1], ..d() }).unwrap(), [12, 6]);
        assert_eq!(chosen(&DataOptions { first_frame: 1, frame_count: 4, frame_step: 2, ..d() }).unwrap(), [6, 2]);
        let left = select(drafts(), &DataOptions { first_frame: 4, ..d() }, &mut Vec::new()).unwrap();
        assert!(left.train.iter().all(|v| v.stated.unwrap() >= 4.0));
        let mut notes = Vec::new();
        select(drafts(), &DataOptions { cameras: vec![1], ..d() }, &mut notes).unwrap();
        assert!(notes[0].starts_with("6 of 24 views"), "{notes:?}");
    }

    #[test]
    fn impossible_choices_are_named() {
        let d = DataOptions::default;
        for (options, text) in [
            (DataOptions { cameras: vec![7], ..d() }, "data.cameras = 7 is not possible: there are cameras 0-3"),
            (DataOptions { test_cameras: vec![9], ..d() }, "data.test_cameras = 9"),
            (
                DataOptions { cameras: vec![0, 1], test_cameras: vec![3], ..d() },
                "data.test_cameras = 3 is not possible",
            ),
            (DataOptions { cameras: vec![3], ..d() }, "at least one camera must train"),
            (DataOptions { test_cameras: vec![0, 1, 2, 3], ..d() }, "at least one camera must train"),
            (DataOptions { frame_step: 0, ..d() }, "data.frame_step = 0"),
            (DataOptions { first_frame: 6, ..d() }, "the data have 6 moments"),
        ] {
            let e = chosen(&options).unwrap_err();
            assert!(e.code() == "data.option" && e.to_string().contains(text), "{text}: {e}");
        }
        assert_eq!(ranges(&BTreeSet::from([1, 2, 3, 5, 7, 8])), "1-3, 5, 7-8");
    }
}
