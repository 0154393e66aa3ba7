//! `data.time_shift`: cameras whose clock is early or late.

use super::error::DataError;
use super::options::DataOptions;
use super::times::{Draft, Drafts};

/// Moves the images of cameras by whole moments: among the sorted distinct times of all views, an image at the `k`-th gets the
/// `k + n`-th. Images that would leave the sequence are dropped.
///
/// # Errors
/// `data.option` if a camera is named that no view has, or no training view is left.
pub(crate) fn shift(drafts: &mut Drafts, options: &DataOptions, notes: &mut Vec<String>) -> Result<(), DataError> {
    let Some(shift) = &options.time_shift else { return Ok(()) };
    let wrong = |rule: String| DataError::Option { name: "data.time_shift", value: shift.to_string(), rule };
    let all = || drafts.train.iter().chain(&drafts.val).chain(&drafts.test);
    if let Some(camera) = shift.0.keys().find(|c| !all().any(|d| d.view.camera_id == **c)) {
        return Err(wrong(format!("there is no camera {camera}")));
    }
    let mut times: Vec<f64> = all().filter_map(|d| d.stated).collect();
    times.sort_by(f64::total_cmp);
    times.dedup();
    let before = all().count();
    let moved = |d: &mut Draft| {
        let (Some(&n), Some(t)) = (shift.0.get(&d.view.camera_id), d.stated) else { return true };
        let at = times.partition_point(|other| *other < t);
        let there = isize::try_from(n).ok().and_then(|n| at.checked_add_signed(n)).and_then(|k| times.get(k));
        d.stated = there.copied();
        d.stated.is_some()
    };
    [&mut drafts.train, &mut drafts.val, &mut drafts.test].into_iter().for_each(|list| list.retain_mut(moved));
    if drafts.train.is_empty() {
        return Err(wrong(format!("there are {} moments, and some training view must be left", times.len())));
    }
    let left = before - (drafts.train.len() + drafts.val.len() + drafts.test.len());
    notes.push(format!(
        "images of cameras are moved by moments, as data.time_shift = {shift} asks; {left} that would leave the sequence are left out"
    ));
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Cameras 0 to 2 at times 10, 12, 15, 19; camera 2 is held out.
    fn drafts() -> Drafts {
        let draft = |k: u32| Draft::of_camera(format!("r_{k}"), k % 3, [10.0, 12.0, 15.0, 19.0][k as usize / 3]);
        let (test, train) = (0..12).map(draft).partition(|d| d.view.camera_id == 2);
        Drafts { train, val: Vec::new(), test }
    }

    fn shifted(text: &str) -> Result<(Drafts, Vec<String>), DataError> {
        let options = DataOptions { time_shift: Some(text.parse().unwrap()), ..DataOptions::default() };
        let (mut drafts, mut notes) = (drafts(), Vec::new());
        shift(&mut drafts, &options, &mut notes).map(|()| (drafts, notes))
    }

    #[test]
    fn a_camera_takes_the_times_of_other_moments() {
        let (drafts, notes) = shifted("1:-1,2:2").unwrap();
        let times = |list: &[Draft], camera: u32| {
            let own = list.iter().filter(|d| d.view.camera_id == camera);
            own.map(|d| (d.view.name.clone(), d.stated.unwrap())).collect::<Vec<_>>()
        };
        assert_eq!(times(&drafts.train, 0).len(), 4);
        assert_eq!(times(&drafts.train, 1), [("r_4".into(), 10.0), ("r_7".into(), 12.0), ("r_10".into(), 15.0)]);
        assert_eq!(times(&drafts.test, 2), [("r_2".into(), 15.0), ("r_5".into(), 19.0)]);
        assert!(notes[0].contains("1:-1,2:2") && notes[0].contains("; 3 that would leave"), "{notes:?}");
        assert_eq!(shifted("0:0").unwrap().0.train.len(), 8);
    }

    #[test]
    fn impossible_shifts_are_named() {
        for (text, part) in
            [("7:1", "no camera 7"), ("0:9,1:9", "there are 4 moments"), ("0:-2147483648,1:4", "4 moments")]
        {
            let e = shifted(text).err().unwrap();
            assert!(e.code() == "data.option" && e.to_string().contains(part), "{e}");
        }
    }
}
