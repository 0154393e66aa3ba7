//! From the times that files state to [`Time`]: the training span `[T₀, T₁]` is mapped to 0..1, `(t − T₀)/(T₁ − T₀)`; the clock
//! keeps the data's seconds. With `data.time_boundary` the span is the whole sequence ([`super::boundary`]).

use std::path::Path;

use gs_core::{Time, cast};

use super::boundary;
use super::error::{DataError, Place};
use super::options::{DataOptions, TimeFrom, TimeRange};
use super::select::select;
use super::shift::shift;
use super::{Dataset, ImageSource, View};

/// A view whose timestamp is not final yet.
pub(crate) struct Draft {
    /// The view, at time 0.
    pub(crate) view: View,
    /// The time the file states.
    pub(crate) stated: Option<f64>,
    /// Where the file states the time, or should.
    pub(crate) place: Place,
}

/// Drafts by split, before the boundary makes the fourth.
#[derive(Default)]
pub(crate) struct Drafts {
    pub(crate) train: Vec<Draft>,
    pub(crate) val: Vec<Draft>,
    pub(crate) test: Vec<Draft>,
}

/// Views with final timestamps, by split, and where these come from.
pub(crate) struct Settled {
    pub(crate) train: Vec<View>,
    pub(crate) val: Vec<View>,
    pub(crate) test: Vec<View>,
    pub(crate) extrapolate: Vec<View>,
    pub(crate) dynamic: bool,
    pub(crate) source: String,
    /// For timestamps that are not of views: the frames of a filmed person.
    #[cfg(feature = "avatar")]
    pub(crate) clock: Clock,
    pub(crate) notes: Vec<String>,
}

impl Settled {
    /// The data set of these views, without points and box. `notes` go before those of the timestamps.
    pub(crate) fn dataset(self, dir: &Path, layout: &'static str, has_alpha: bool, mut notes: Vec<String>) -> Dataset {
        notes.extend(self.notes);
        Dataset {
            root: dir.to_path_buf(),
            layout,
            train: self.train,
            val: self.val,
            test: self.test,
            extrapolate: self.extrapolate,
            points: None,
            has_alpha,
            dynamic: self.dynamic,
            time_source: self.source,
            bounds: None,
            avatar: None,
            max_image_mib: None,
            notes,
        }
    }
}

/// Tolerance at the ends of a range, as a share of its length: files print few digits.
pub(super) const SLACK: f64 = 1e-6;

/// Gives all views their final timestamps. `declared` is the range the layout prescribes for the training times it states
/// (D-NeRF: 0..1).
///
/// # Errors
/// `data.time` if a training time lies outside [`DataOptions::time_range`] or `declared`; `data.field` if only some
/// frames have times, or a file name holds no number when times come from names; `data.option` if no view is left by
/// [`select`] or [`shift`], or the boundary leaves no past or no future.
pub(crate) fn settle(
    mut drafts: Drafts,
    options: &DataOptions,
    declared: Option<TimeRange>,
) -> Result<Settled, DataError> {
    let mut notes = Vec::new();
    let source = apply_time_from(&mut drafts, options)?;
    check_all_or_none(&drafts)?;
    shift(&mut drafts, options, &mut notes)?;
    let drafts = select(drafts, options, &mut notes)?;
    // Numbers of files are no times of the layout.
    if let Some(range) = declared.filter(|_| options.time_range.is_none() && options.time_from == TimeFrom::File) {
        check_range(&drafts.train, [&drafts.val, &drafts.test], range)?;
    }
    let (drafts, future) = boundary::cut(drafts, options, &mut notes)?;
    // The user's range may end before the sequence does where a boundary holds out what is later.
    if let Some(range) = options.time_range {
        check_range(&drafts.train, [&drafts.val, &drafts.test], range)?;
    }
    let (whole, beyond) = future.map_or((None, Vec::new()), |f| (Some(f.whole), f.beyond));
    let span = whole.or(options.time_range).or_else(|| span_of(&drafts.train));
    let dynamic = span_of(&drafts.train).is_some();
    let outside = span.map_or(0, |s| count_outside(&drafts.val, s) + count_outside(&drafts.test, s));
    if outside > 0 {
        notes.push(format!("{outside} val and test views lie outside the training span: they extrapolate"));
    }
    let clock = Clock { span, by_number: options.time_from != TimeFrom::File, fps: options.fps };
    let finish = |list: Vec<Draft>| list.into_iter().map(|d| clock.apply(d)).collect::<Result<Vec<_>, _>>();
    let (train, val, test) = (finish(drafts.train)?, finish(drafts.val)?, finish(drafts.test)?);
    let extrapolate = finish(beyond)?;
    let source = if dynamic { source } else { "static: all training views have one timestamp".into() };
    Ok(Settled {
        train,
        val,
        test,
        extrapolate,
        dynamic,
        source,
        #[cfg(feature = "avatar")]
        clock,
        notes,
    })
}

/// Replaces the stated times where the user asked for names or order. Returns the source of the times in words.
fn apply_time_from(drafts: &mut Drafts, options: &DataOptions) -> Result<String, DataError> {
    let mut all: Vec<&mut Draft> = drafts.train.iter_mut().chain(&mut drafts.val).chain(&mut drafts.test).collect();
    match options.time_from {
        TimeFrom::File => Ok("time of each frame, as the files state it".into()),
        TimeFrom::Name => {
            for d in all {
                d.stated = Some(last_number(&stem(&d.view)).ok_or_else(|| DataError::Field {
                    place: d.place.clone(),
                    value: format!("in a file named \"{}\"", stem(&d.view)),
                    why: "times come from the last number in each file name, and this one has none",
                    fix: "rename the images, or pass --set data.time_from=file",
                })?);
            }
            Ok(format!("last number in each file name{}", rate(options)))
        }
        TimeFrom::Order => {
            all.sort_by_key(|d| stem(&d.view));
            all.into_iter().enumerate().for_each(|(k, d)| d.stated = Some(k as f64));
            Ok(format!("order of file names, as asked for{}", rate(options)))
        }
    }
}

fn rate(options: &DataOptions) -> String {
    options.fps.map_or(String::new(), |fps| format!(", {fps} frames per second"))
}

/// The file name without folder and extension, or the view's name.
fn stem(v: &View) -> String {
    match &v.image {
        ImageSource::File(f) => f.file_stem().map_or_else(|| v.name.clone(), |s| s.to_string_lossy().into_owned()),
        ImageSource::Memory(_) => v.name.clone(),
    }
}

fn last_number(name: &str) -> Option<f64> {
    let upto = name.trim_end_matches(|c: char| !c.is_ascii_digit());
    let start = upto.trim_end_matches(|c: char| c.is_ascii_digit()).len();
    upto[start..].parse().ok().filter(|v: &f64| v.is_finite())
}

/// Refuses data of which only some views have times.
fn check_all_or_none(drafts: &Drafts) -> Result<(), DataError> {
    let all = || drafts.train.iter().chain(&drafts.val).chain(&drafts.test);
    if !drafts.train.iter().any(|d| d.stated.is_some()) {
        return Ok(());
    }
    match all().find(|d| d.stated.is_none()) {
        None => Ok(()),
        Some(d) => Err(DataError::Field {
            place: d.place.clone(),
            value: "missing".into(),
            why: "other frames have times, so this scene moves",
            fix: "add the time, or remove all of them if the scene is static",
        }),
    }
}

fn inside(t: f64, r: TimeRange) -> bool {
    let slack = SLACK * (r.end - r.start);
    t >= r.start - slack && t <= r.end + slack
}

/// Verifies that training times lie in a range; the error says what the times of all views are.
///
/// # Errors
/// `data.time`.
pub(super) fn check_range(train: &[Draft], others: [&[Draft]; 2], range: TimeRange) -> Result<(), DataError> {
    let all = train.iter().chain(others[0]).chain(others[1]);
    let Some(first) = train.iter().find(|d| d.stated.is_some_and(|t| !inside(t, range))) else { return Ok(()) };
    let (value, frame) = (first.stated.unwrap_or(range.start), first.view.name.as_str().into());
    let span = span_of(all).unwrap_or(TimeRange { start: value.min(range.start), end: value.max(range.end) });
    // Times of one recording begin where it begins: a first frame number or time above zero is an offset only where it is large.
    let start = if span.start > 0.0 && span.start < 0.5 * span.end { 0.0 } else { span.start };
    let span = TimeRange { start, ..span };
    Err(DataError::Time {
        place: first.place.clone(),
        frame,
        value,
        outside: cast::to_u32(count_outside(train, range)),
        total: cast::to_u32(train.len()),
        span,
        range,
    })
}

fn count_outside(list: &[Draft], span: TimeRange) -> usize {
    list.iter().filter(|d| d.stated.is_some_and(|t| !inside(t, span))).count()
}

/// First and last time, if they differ.
pub(super) fn span_of<'a>(list: impl IntoIterator<Item = &'a Draft> + Clone) -> Option<TimeRange> {
    let times = || list.clone().into_iter().filter_map(|d| d.stated);
    let (start, end) = (times().fold(f64::INFINITY, f64::min), times().fold(f64::NEG_INFINITY, f64::max));
    (end > start).then_some(TimeRange { start, end })
}

/// The mapping from stated times to [`Time`].
#[derive(Clone, Copy, Debug)]
pub(crate) struct Clock {
    span: Option<TimeRange>,
    by_number: bool,
    fps: Option<f64>,
}

impl Clock {
    fn apply(&self, d: Draft) -> Result<View, DataError> {
        let time = self.time(d.stated, &d.place)?;
        Ok(View { time, ..d.view })
    }

    /// The timestamp of a time stated at `place`.
    pub(crate) fn time(&self, stated: Option<f64>, place: &Place) -> Result<Time, DataError> {
        let (Some(t), Some(r)) = (stated, self.span) else { return Ok(Time::default()) };
        let normalised = (t - r.start) / (r.end - r.start);
        let seconds = match (self.by_number, self.fps) {
            (false, _) => t,
            (true, Some(fps)) => t / fps,
            (true, None) => normalised,
        };
        Time::with_seconds(cast::to_f32(normalised), seconds).map_err(|e| DataError::Field {
            place: place.clone(),
            value: e.value.to_string(),
            why: "after mapping the training span to 0..1 it must be a finite number",
            fix: "correct the time, or data.time_range and data.fps",
        })
    }
}

#[cfg(test)]
impl Draft {
    /// A view of a camera at a time, without a place of its own.
    pub(super) fn of_camera(name: String, camera_id: u32, stated: f64) -> Self {
        let camera = gs_core::Camera::look_at(2, 2, 0.7, glam::DVec3::X, glam::DVec3::ZERO, glam::DVec3::Z);
        let image = ImageSource::File("a.png".into());
        let view = View::new(name, camera.expect("a camera"), Time::default(), image, camera_id);
        Self { view, stated: Some(stated), place: Place::new("t.json".as_ref(), "") }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;
    use gs_core::Camera;
    use std::path::Path;

    fn drafts(stated: &[Option<f64>]) -> Vec<Draft> {
        let draft = |(k, &stated): (usize, &Option<f64>)| {
            let camera = Camera::look_at(2, 2, 0.7, DVec3::X, DVec3::ZERO, DVec3::Z).unwrap();
            let image = ImageSource::File(format!("images/cam3_f{:03}.png", 2 * k + 10).into());
            let view = View::new(format!("r_{k:03}"), camera, Time::default(), image, 0);
            Draft { view, stated, place: Place::new(Path::new("t.json"), format!("frames[{k}].time")) }
        };
        stated.iter().enumerate().map(draft).collect()
    }

    fn settled(train: &[Option<f64>], test: &[Option<f64>], o: &DataOptions) -> Result<Settled, DataError> {
        let d = Drafts { train: drafts(train), val: vec![], test: drafts(test) };
        settle(d, o, None)
    }

    #[test]
    fn the_training_span_becomes_zero_to_one() {
        let s = settled(&[Some(2.0), Some(6.0), Some(3.0)], &[Some(8.0)], &DataOptions::default()).unwrap();
        let t: Vec<f32> = s.train.iter().map(|v| v.time.normalised).collect();
        assert_eq!(t, [0.0, 1.0, 0.25]);
        assert_eq!((s.test[0].time.normalised, s.test[0].time.seconds, s.dynamic), (1.5, 8.0, true));
        assert!(s.notes[0].starts_with("1 val and test views"));
        let wide = DataOptions { time_range: Some(TimeRange { start: 0.0, end: 8.0 }), ..Default::default() };
        let s = settled(&[Some(2.0), Some(6.0)], &[Some(8.0)], &wide).unwrap();
        assert_eq!((s.train[0].time.normalised, s.test[0].time.normalised), (0.25, 1.0));
    }

    #[test]
    fn times_outside_the_range_and_missing_ones_are_named() {
        let d = Drafts { train: drafts(&[Some(0.0), Some(1.3), Some(1.0)]), ..Default::default() };
        let unit = TimeRange { start: 0.0, end: 1.0 };
        let e = settle(d, &DataOptions::default(), Some(unit)).err().unwrap();
        let text = "frame \"r_001\" has time 1.3; 1 of 3 training times lie outside 0..1, all frames are in 0..1.3";
        assert_eq!(e.to_string(), text);
        assert!(e.fix().starts_with("--set data.time_range=0..1.3;"));
        for (stated, range, guess) in [
            (&[16.0, 94.0, 3.0][..], "0..94", "frame numbers"),
            (&[1_699_999_999_000.0, 1_699_999_999_161.5], "1699999999000..1699999999161.5", "milliseconds since 1970"),
            (&[1.7e9, 1.7e9 + 3.5], "1700000000..1700000003.5", "seconds since 1970"),
            (&[-0.5, 0.5], "-0.5..0.5", "0.5"),
        ] {
            let stated: Vec<Option<f64>> = stated.iter().copied().map(Some).collect();
            let refused = |o: &DataOptions| {
                settle(Drafts { train: drafts(&stated), ..Default::default() }, o, Some(unit)).map(|s| s.train)
            };
            let e = refused(&DataOptions::default()).err().unwrap();
            assert!(e.fix().contains(range) && e.to_string().contains(guess), "{} {}", e, e.fix());
            // What it says to do is enough, at once, and moments stay apart.
            let views =
                refused(&DataOptions { time_range: Some(range.parse().unwrap()), ..Default::default() }).unwrap();
            let last = views.iter().map(|v| v.time.normalised).fold(0.0, f32::max);
            assert!(last == 1.0 && views[0].time.normalised != views[1].time.normalised, "{range}");
        }
        let e = settled(&[Some(0.0), None], &[], &DataOptions::default()).err().unwrap();
        assert_eq!(e.to_string(), "frames[1].time is missing");
    }

    #[test]
    fn one_moment_is_static() {
        for stated in [&[None, None][..], &[Some(0.5), Some(0.5)]] {
            let s = settled(stated, &[], &DataOptions::default()).unwrap();
            assert!(!s.dynamic && s.train[1].time == Time::default());
        }
    }

    #[test]
    fn names_and_order_give_times_on_request() {
        let by = |time_from, fps| DataOptions { time_from, fps, ..Default::default() };
        let s = settled(&[None, None, None], &[], &by(TimeFrom::Name, Some(4.0))).unwrap();
        assert_eq!((s.train[1].time.normalised, s.train[1].time.seconds), (0.5, 3.0), "frame 12 at 4 per second");
        let s = settled(&[None, None, None], &[], &by(TimeFrom::Order, None)).unwrap();
        assert_eq!((s.train[1].time.normalised, s.train[2].time.seconds), (0.5, 1.0));
        for (name, want) in [("cam3_f012", Some(12.0)), ("7", Some(7.0)), ("é12x", Some(12.0)), ("none", None)] {
            assert_eq!(last_number(name), want, "{name}");
        }
    }
}
