//! Sweeps: contests in which one setting at a time is varied around a preset, to see its cost and its benefit.
//!
//! The entries of the [`Contest`] are the preset itself, then every value of every setting alone. A value that the preset has
//! already is not trained again. The result is quality against bytes, seconds and splats.

pub mod page;

use crate::contest::{Contest, ContestError, Entry, Standing};
use gs_train::evaluate::EvalReport;
use serde::Serialize;
use std::path::PathBuf;

/// A setting and the values it takes in turn.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Vary {
    /// Key of the setting, as in `KEY=VALUE`.
    pub key: String,
    /// Distinct values, as written in `KEY=VALUE`; at least one.
    pub values: Vec<String>,
}

impl Vary {
    /// Parses `KEY=A|B|C`.
    ///
    /// # Errors
    /// If the key is missing, or a value is empty or given twice.
    ///
    /// ```
    /// use gs4d_lab::sweep::Vary;
    /// let vary = Vary::parse("init.points=1000|2000").unwrap();
    /// assert_eq!((vary.key.as_str(), vary.values.len()), ("init.points", 2));
    /// assert!(Vary::parse("init.points=1000|1000").is_err());
    /// ```
    pub fn parse(text: &str) -> Result<Self, String> {
        let wrong = || format!("`{text}` is no KEY=A|B|C, for example \"init.points=1000|2000|4000\"");
        let (key, values) = text.split_once('=').ok_or_else(wrong)?;
        let values: Vec<String> = values.split('|').map(|v| v.trim().to_owned()).collect();
        if key.trim().is_empty() || values.iter().any(String::is_empty) {
            return Err(wrong());
        }
        if let Some(twice) = values.iter().enumerate().find(|(i, v)| values[..*i].contains(v)) {
            return Err(format!("the value {} of {key} is given twice", twice.1));
        }
        Ok(Self { key: key.trim().to_owned(), values })
    }
}

/// A number of a row: heading, digits, value.
type Column = (&'static str, usize, fn(&Row) -> Option<f64>);

const COLUMNS: [Column; 8] = [
    ("PSNR", 2, |r| r.psnr),
    ("ext dB", 2, |r| r.extrapolated),
    ("SSIM", 4, |r| r.ssim),
    ("proxy", 4, |r| r.proxy),
    ("MB", 3, |r| r.megabytes),
    ("seconds", 1, |r| r.seconds),
    ("splats", 0, |r| r.splats),
    ("steps", 0, |r| r.steps.map(|s| s as f64)),
];

/// One setting and its scores, means over seeds.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Row {
    /// Key of the varied setting; `None` for the preset itself.
    pub key: Option<String>,
    /// Value of the varied setting; `None` for the preset itself.
    pub value: Option<String>,
    /// Whether the preset has this value, so that the scores are those of the preset.
    pub preset: bool,
    /// Mean PSNR, dB.
    pub psnr: Option<f64>,
    /// Standard deviation of the PSNR over seeds, dB.
    pub psnr_deviation: Option<f64>,
    /// Mean PSNR of views after the last training time, dB; `None` without such views.
    pub extrapolated: Option<f64>,
    /// Mean SSIM.
    pub ssim: Option<f64>,
    /// Mean perceptual proxy; not LPIPS.
    pub proxy: Option<f64>,
    /// Megabytes (10⁶ bytes) of all parameters as `f32`.
    pub megabytes: Option<f64>,
    /// Seconds of training.
    pub seconds: Option<f64>,
    /// Number of splats.
    pub splats: Option<f64>,
    /// Steps of every trial; `None` without the pilot that gives them.
    pub steps: Option<u64>,
    /// Run folders of the trials that stand, one per seed.
    pub runs: Vec<PathBuf>,
}

impl Row {
    fn new(vary: Option<(&str, &str)>, preset: bool, standing: &Standing) -> Self {
        let mean = |score: fn(&EvalReport) -> Option<f64>| standing.spread(score).map(|s| s.mean);
        Self {
            key: vary.map(|v| v.0.to_owned()),
            value: vary.map(|v| v.1.to_owned()),
            preset,
            psnr: mean(|r| r.mean.psnr),
            psnr_deviation: standing.spread(|r| r.mean.psnr).map(|s| s.deviation),
            extrapolated: mean(EvalReport::extrapolated_psnr),
            ssim: mean(|r| r.mean.ssim),
            proxy: mean(|r| r.mean.perceptual_proxy),
            megabytes: mean(|r| Some(r.parameter_bytes as f64 * 1e-6)),
            seconds: mean(|r| r.train_seconds),
            splats: mean(|r| Some(r.gaussians as f64)),
            steps: standing.steps,
            runs: standing.trials.iter().map(|t| t.run.clone()).collect(),
        }
    }

    /// `KEY=VALUE`, or `preset`.
    pub fn label(&self) -> String {
        match (&self.key, &self.value) {
            (Some(key), Some(value)) => format!("{key}={value}"),
            _ => "preset".to_owned(),
        }
    }

    /// Whether this is a value that the preset has, and was not trained.
    pub fn repeats_preset(&self) -> bool {
        self.preset && self.key.is_some()
    }

    /// Headings and cells of a table: the label, then the numbers that some row has; `missing` stands where a row has none.
    pub fn table(rows: &[Self], missing: &str) -> (Vec<&'static str>, Vec<Vec<String>>) {
        let columns: Vec<&Column> = COLUMNS.iter().filter(|c| rows.iter().any(|r| c.2(r).is_some())).collect();
        let cell = |c: &Column, r: &Self| c.2(r).map_or(missing.to_owned(), |v| format!("{v:.*}", c.1));
        let cells = |r: &Self| std::iter::once(r.label()).chain(columns.iter().map(|c| cell(c, r))).collect();
        (std::iter::once("setting").chain(columns.iter().map(|c| c.0)).collect(), rows.iter().map(cells).collect())
    }
}

/// A contest of a base and the same with each value of some settings alone.
#[derive(Clone, Debug)]
pub struct Sweep {
    /// The contest; its entries are the base, then the varied settings that the base has not already.
    pub contest: Contest,
    /// Key, value and index of the entry; 0 is the base.
    settings: Vec<(String, String, usize)>,
}

impl Sweep {
    /// `base` and `base` with each value of `vary` alone, under the conditions of `contest`, whose entries do not matter.
    ///
    /// # Errors
    /// If settings are invalid.
    pub fn new(contest: Contest, base: &Entry, vary: &[Vary]) -> Result<Self, ContestError> {
        let mut contest = Contest { entries: vec![base.clone()], ..contest };
        let mut settings = Vec::new();
        for (key, value) in vary.iter().flat_map(|v| v.values.iter().map(|value| (v.key.clone(), value.clone()))) {
            let entry = base.with(format!("{key}={value}"));
            let repeats_preset = contest.same(base, &entry)?;
            settings.push((key, value, if repeats_preset { 0 } else { contest.entries.len() }));
            contest.entries.extend((!repeats_preset).then_some(entry));
        }
        Ok(Self { contest, settings })
    }

    /// The rows of the contest's standings: the preset (the base), then the varied settings in order.
    pub fn rows(&self, standings: &[Standing]) -> Vec<Row> {
        let row = |(key, value, k): &(String, String, usize)| Row::new(Some((key, value)), *k == 0, &standings[*k]);
        std::iter::once(Row::new(None, true, &standings[0])).chain(self.settings.iter().map(row)).collect()
    }
}

/// The rows as comma-separated values with a heading, all digits.
pub fn csv(rows: &[Row]) -> String {
    let number = |v: Option<f64>| v.map_or(String::new(), |v| v.to_string());
    let quoted = |text: &str| format!("\"{}\"", text.replace('"', "\"\""));
    let mut out =
        "setting,psnr,psnr_deviation,psnr_extrapolated,ssim,proxy,megabytes,seconds,splats,steps\n".to_owned();
    for r in rows {
        let numbers =
            [r.psnr, r.psnr_deviation, r.extrapolated, r.ssim, r.proxy, r.megabytes, r.seconds, r.splats].map(number);
        let steps = r.steps.map_or(String::new(), |s| s.to_string());
        out.push_str(&format!("{},{},{steps}\n", quoted(&r.label()), numbers.join(",")));
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::contest::{Event, Length};
    use gs_synth::{SynthOptions, write};
    use std::sync::atomic::AtomicBool;

    #[test]
    fn settings_are_read_and_bad_ones_named() {
        let v = Vary::parse("init.points=10| 20|30").unwrap();
        assert_eq!((v.key.as_str(), v.values), ("init.points", vec!["10".to_owned(), "20".into(), "30".into()]));
        for bad in ["", "a", "=1|2", "a=", "a=1||2"] {
            assert!(Vary::parse(bad).unwrap_err().contains("KEY=A|B|C"), "{bad}");
        }
        assert!(Vary::parse("a=1|2|1").unwrap_err().contains("1 of a is given twice"));
    }

    #[test]
    fn each_setting_is_varied_alone_and_the_preset_is_trained_once() {
        let folder = tempfile::tempdir().unwrap();
        let data = folder.path().join("data");
        let small = SynthOptions { val_views: 1, ..SynthOptions::of_views(32, 5, 1) };
        write(&data, "static", &small, false).unwrap();
        let contest = Contest {
            registry: gs_methods::registry().clone(),
            data,
            root: folder.path().join("sweep"),
            preset: "tiny".into(),
            entries: Vec::new(),
            seeds: vec![0],
            length: Length::Steps(6),
            sets: vec!["init.points=300".into()],
        };
        let vary = ["init.points=150|300", "schedule.lambda_dssim=0.5"].map(|v| Vary::parse(v).unwrap());
        let (base, go) = (Entry::new("static3d"), AtomicBool::new(false));
        let mut trials = 0;
        let mut count = |t: Event| trials += u32::from(matches!(t, Event::Trial(_)));
        let sweep = Sweep::new(contest.clone(), &base, &vary).unwrap();
        let rows = sweep.rows(&sweep.contest.run(&go, &mut count).unwrap().standings);
        let labels: Vec<String> = rows.iter().map(Row::label).collect();
        assert_eq!(labels, ["preset", "init.points=150", "init.points=300", "schedule.lambda_dssim=0.5"]);
        assert_eq!((trials, rows.iter().map(|r| r.preset).collect::<Vec<_>>()), (3, vec![true, false, true, false]));
        assert!(rows[1].megabytes < rows[0].megabytes && rows[2].megabytes == rows[0].megabytes);
        let text = csv(&rows);
        assert!(text.lines().count() == 5 && text.contains("\n\"init.points=150\","), "{text}");
        let html = crate::sweep::page::page("static3d", &rows).unwrap();
        assert!(html.contains("<svg") && html.contains("schedule.lambda_dssim=0.5") && !html.contains("<script"));
        let wrong = [Vary::parse("no.such=1|2").unwrap()];
        assert!(Sweep::new(contest, &base, &wrong).is_err());
    }
}
