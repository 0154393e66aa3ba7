//! The boundary between past and future: views up to it may train, later ones measure extrapolation.
//!
//! With `data.time_boundary = b` the whole sequence, from its first time `T₀` to its last `T₁`, is mapped to 0..1. Views at
//! `t ≤ T₀ + b (T₁ − T₀)` keep their split; all later ones, of every camera and split, are the future. Views of
//! training cameras beyond the boundary are scored, too: averages are over seen and unseen cameras (Li et al., NVFi, 2023).

use std::collections::HashSet;

use super::error::DataError;
use super::options::{DataOptions, TimeRange};
use super::times::{Draft, Drafts, SLACK, span_of};

/// The part of a sequence that is later than the boundary.
pub(crate) struct Future {
    /// The whole sequence, in the data's own times.
    pub(crate) whole: TimeRange,
    /// Views later than the boundary, those of training cameras first.
    pub(crate) beyond: Vec<Draft>,
}

/// Moves later views out of the splits; none without a boundary.
///
/// # Errors
/// `data.option` if the boundary is not in (0, 1], the scene is static, or no training view or no later view is left.
pub(crate) fn cut(
    mut drafts: Drafts,
    options: &DataOptions,
    notes: &mut Vec<String>,
) -> Result<(Drafts, Option<Future>), DataError> {
    let Some(share) = options.time_boundary else { return Ok((drafts, None)) };
    let wrong = |rule: String| DataError::Option { name: "data.time_boundary", value: share.to_string(), rule };
    if !(share > 0.0 && share <= 1.0) {
        return Err(wrong("above 0, at most 1".into()));
    }
    if share == 1.0 {
        return Ok((drafts, None));
    }
    let all = drafts.train.iter().chain(&drafts.val).chain(&drafts.test);
    let Some(whole) = options.time_range.or_else(|| span_of(all)) else {
        return Err(wrong("1, or leave it out: all views show one moment".into()));
    };
    let last = whole.start + (share + SLACK) * (whole.end - whole.start);
    let mut beyond = Vec::new();
    for (split, list) in [("train", &mut drafts.train), ("val", &mut drafts.val), ("test", &mut drafts.test)] {
        let (past, future): (Vec<_>, Vec<_>) =
            std::mem::take(list).into_iter().partition(|d| d.stated.is_none_or(|t| t <= last));
        *list = past;
        beyond.extend(future.into_iter().map(|d| (split, d)));
    }
    if drafts.train.is_empty() {
        return Err(wrong(format!("no training view of the sequence {whole} lies before that; give a larger share")));
    }
    if beyond.is_empty() {
        return Err(wrong(format!(
            "no view of the sequence {whole} lies beyond that; give a smaller share, or 1 for none"
        )));
    }
    let seen = beyond.iter().filter(|(split, _)| *split == "train").count();
    notes.push(format!(
        "the whole sequence {whole} is 0..1; training ends at {share}: {} later views are for extrapolation, {seen} of them of \
         training cameras",
        beyond.len()
    ));
    Ok((drafts, Some(Future { whole, beyond: renamed(beyond) })))
}

/// Views of several splits in one list: where names repeat, all get their split as a prefix.
fn renamed(mut beyond: Vec<(&str, Draft)>) -> Vec<Draft> {
    let names: HashSet<&str> = beyond.iter().map(|(_, d)| d.view.name.as_str()).collect();
    if names.len() < beyond.len() {
        beyond.iter_mut().for_each(|(split, d)| d.view.name = format!("{split}_{}", d.view.name));
    }
    beyond.into_iter().map(|(_, d)| d).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::times::settle;

    /// Cameras 0 to 3 at times 10, 11, …, 14; cameras 0 and 1 train, 2 watches, 3 is held out.
    fn drafts() -> Drafts {
        let draft = |k: u32| Draft::of_camera(format!("r_{}", k / 4), k % 4, 10.0 + f64::from(k / 4));
        let of = |cameras: &[u32]| (0..20).filter(|k| cameras.contains(&(k % 4))).map(draft).collect();
        Drafts { train: of(&[0, 1]), val: of(&[2]), test: of(&[3]) }
    }

    fn options(boundary: f64) -> DataOptions {
        DataOptions { time_boundary: Some(boundary), ..DataOptions::default() }
    }

    #[test]
    fn later_views_of_every_camera_are_the_future() {
        let s = settle(drafts(), &options(0.5), None).unwrap();
        assert_eq!([s.train.len(), s.val.len(), s.test.len(), s.extrapolate.len()], [6, 3, 3, 8]);
        let last = s.train.iter().map(|v| v.time.normalised).fold(0.0, f32::max);
        assert_eq!(last, 0.5, "the boundary itself belongs to the past");
        let cameras: HashSet<u32> = s.extrapolate.iter().map(|v| v.camera_id).collect();
        assert_eq!(cameras.len(), 4);
        assert!(s.extrapolate.iter().all(|v| v.time.normalised > 0.5 && v.time.seconds > 12.0));
        assert_eq!(s.extrapolate.iter().map(|v| v.time.normalised).fold(0.0, f32::max), 1.0);
        assert!(s.extrapolate.iter().any(|v| v.name == "test_r_3"), "names of several splits are told apart");
        let note = s.notes.join("\n");
        assert!(note.contains("8 later views are for extrapolation, 4 of them of training cameras"), "{note}");
        assert!(!note.contains("they extrapolate"), "{note}");
    }

    #[test]
    fn the_range_of_the_user_is_the_whole_sequence() {
        let o = DataOptions { time_range: Some(TimeRange { start: 10.0, end: 12.0 }), ..options(0.5) };
        let s = settle(drafts(), &o, None).unwrap();
        assert_eq!([s.train.len(), s.extrapolate.len()], [4, 12]);
        assert_eq!(s.extrapolate.iter().map(|v| v.time.normalised).fold(0.0, f32::max), 2.0);
        // Frame 3 of 5 at 0.6: rounding of printed times does not move it beyond 0.6.
        let mut rounded = drafts();
        rounded.train.iter_mut().for_each(|d| d.stated = d.stated.map(|t| t / 5.0 - 2.0 + 1e-9));
        rounded.val.clear();
        rounded.test.clear();
        let o = DataOptions { time_range: Some(TimeRange { start: 0.0, end: 1.0 }), ..options(0.6) };
        assert_eq!(settle(rounded, &o, None).unwrap().train.len(), 8);
    }

    #[test]
    fn without_a_boundary_nothing_changes() {
        let plain = settle(drafts(), &DataOptions::default(), None).unwrap();
        let whole = settle(drafts(), &options(1.0), None).unwrap();
        assert_eq!((plain.train, plain.extrapolate.len()), (whole.train, 0));
        assert_eq!(plain.notes, whole.notes);
    }

    #[test]
    fn impossible_boundaries_are_named() {
        for (share, text) in [
            (0.0, "above 0, at most 1"),
            (1.5, "above 0, at most 1"),
            (f64::NAN, "above 0, at most 1"),
            (-0.1, "above 0, at most 1"),
        ] {
            let e = settle(drafts(), &options(share), None).err().unwrap();
            assert!(e.code() == "data.option" && e.to_string().contains(text), "{share}: {e}");
        }
        let mut late = drafts();
        late.train.retain(|d| d.stated > Some(12.0));
        let e = settle(late, &options(0.5), None).err().unwrap();
        assert!(e.to_string().contains("no training view of the sequence 10..14 lies before"), "{e}");
        let wide = DataOptions { time_range: Some(TimeRange { start: 0.0, end: 100.0 }), ..options(0.5) };
        let e = settle(drafts(), &wide, None).err().unwrap();
        assert!(e.to_string().contains("no view of the sequence 0..100 lies beyond"), "{e}");
        let mut still = drafts();
        [&mut still.train, &mut still.val, &mut still.test].into_iter().flatten().for_each(|d| d.stated = None);
        let e = settle(still, &options(0.5), None).err().unwrap();
        assert!(e.to_string().contains("all views show one moment"), "{e}");
    }
}
