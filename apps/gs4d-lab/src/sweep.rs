//! Sweeps: one setting at a time varied around a preset, to see what each costs and buys.
//!
//! A sweep is a [`Contest`] with generated entries: the preset as it stands, then every value of every key alone. A value
//! that the preset has already is not trained again. The rows say quality against bytes, seconds and splats.

pub mod page;

use crate::contest::{Contest, ContestError, Entry, Length, Standing, Told};
use gs_train::evaluate::EvalReport;
use gs_train::registry::Registry;
use serde::Serialize;
use std::path::PathBuf;
use std::sync::atomic::AtomicBool;

/// A setting and the values it takes in turn.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Vary {
    /// The setting, as in `KEY=VALUE`.
    pub key: String,
    /// Its values.
    pub values: Vec<String>,
}

impl Vary {
    /// Reads `KEY=A|B|C`.
    ///
    /// # Errors
    /// If there is no key, or a value is empty or given twice.
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

/// What is to be swept.
#[derive(Clone, Debug)]
pub struct Sweep {
    /// The methods there are.
    pub registry: Registry,
    /// Folder of the data.
    pub data: PathBuf,
    /// Folder of the trials.
    pub root: PathBuf,
    /// The method.
    pub method: String,
    /// The preset everything is varied around.
    pub preset: String,
    /// The settings that are varied, each by itself.
    pub vary: Vec<Vary>,
    /// Every entry runs once with each.
    pub seeds: Vec<u64>,
    /// Length of every trial.
    pub length: Length,
    /// Settings of all entries, `KEY=VALUE`.
    pub sets: Vec<String>,
}

/// A column of a table of rows.
#[derive(Clone, Copy, Debug)]
pub struct Column {
    /// Its heading.
    pub head: &'static str,
    digits: usize,
    value: fn(&Row) -> Option<f64>,
}

const COLUMNS: [Column; 8] = [
    Column { head: "PSNR", digits: 2, value: |r| r.psnr },
    Column { head: "ext dB", digits: 2, value: |r| r.extrapolated },
    Column { head: "SSIM", digits: 4, value: |r| r.ssim },
    Column { head: "proxy", digits: 4, value: |r| r.proxy },
    Column { head: "MB", digits: 3, value: |r| r.megabytes },
    Column { head: "seconds", digits: 1, value: |r| r.seconds },
    Column { head: "splats", digits: 0, value: |r| r.splats },
    Column { head: "steps", digits: 0, value: |r| Some(r.steps as f64) },
];

impl Column {
    /// The number of a row as text, `absent` if it has none.
    pub fn cell(&self, row: &Row, absent: &str) -> String {
        (self.value)(row).map_or(absent.to_owned(), |v| format!("{v:.*}", self.digits))
    }
}

/// One setting and what it came to, means over seeds.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Row {
    /// The varied setting; absent for the preset itself.
    pub key: Option<String>,
    /// Its value.
    pub value: Option<String>,
    /// Whether this is what the preset has, and its numbers are the preset's.
    pub preset: bool,
    /// Mean PSNR, dB.
    pub psnr: Option<f64>,
    /// Its standard deviation over seeds.
    pub psnr_deviation: Option<f64>,
    /// Mean PSNR beyond the last training time, dB, where the data have such views.
    pub extrapolated: Option<f64>,
    /// Mean SSIM.
    pub ssim: Option<f64>,
    /// Mean perceptual proxy; not LPIPS.
    pub proxy: Option<f64>,
    /// Megabytes (10⁶ bytes) of all parameters as `f32`.
    pub megabytes: Option<f64>,
    /// Seconds of training.
    pub seconds: Option<f64>,
    /// Splats.
    pub splats: Option<f64>,
    /// Steps of every trial.
    pub steps: u64,
    /// Folders of the trials.
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

    /// The columns of a table of rows: those that any row has a number for.
    pub fn columns(rows: &[Self]) -> Vec<Column> {
        COLUMNS.iter().filter(|c| rows.iter().any(|r| (c.value)(r).is_some())).copied().collect()
    }

    /// The setting in words.
    pub fn label(&self) -> String {
        match (&self.key, &self.value) {
            (Some(key), Some(value)) => format!("{key}={value}"),
            _ => "preset".to_owned(),
        }
    }
}

impl Sweep {
    /// Runs the sweep: the preset first, then the varied settings in order.
    ///
    /// # Errors
    /// Those of [`Contest::run`]; settings are verified before anything is trained.
    pub fn run(&self, stop: &AtomicBool, tell: &mut dyn FnMut(Told)) -> Result<Vec<Row>, ContestError> {
        let entry = |sets: Vec<String>| Entry::new(&self.method, sets);
        let mut contest = Contest {
            registry: self.registry.clone(),
            data: self.data.clone(),
            root: self.root.clone(),
            preset: self.preset.clone(),
            entries: vec![entry(Vec::new())],
            seeds: self.seeds.clone(),
            length: self.length,
            sets: self.sets.clone(),
        };
        let settings: Vec<(&str, &str)> =
            self.vary.iter().flat_map(|v| v.values.iter().map(|value| (v.key.as_str(), value.as_str()))).collect();
        // The place of each setting's standing; 0 is the preset's.
        let mut places = Vec::new();
        for (key, value) in &settings {
            let varied = entry(vec![format!("{key}={value}")]);
            if contest.same(&contest.entries[0], &varied)? {
                places.push(0);
            } else {
                places.push(contest.entries.len());
                contest.entries.push(varied);
            }
        }
        let standings = contest.run(stop, tell)?;
        let mut rows = vec![Row::new(None, true, &standings[0])];
        rows.extend(settings.iter().zip(places).map(|(v, at)| Row::new(Some(*v), at == 0, &standings[at])));
        Ok(rows)
    }
}

/// The rows as comma-separated values with a heading.
pub fn csv(rows: &[Row]) -> String {
    let number = |v: Option<f64>| v.map_or(String::new(), |v| v.to_string());
    let quoted = |text: &str| format!("\"{}\"", text.replace('"', "\"\""));
    let mut out =
        "setting,psnr,psnr_deviation,psnr_extrapolated,ssim,proxy,megabytes,seconds,splats,steps\n".to_owned();
    for r in rows {
        let numbers =
            [r.psnr, r.psnr_deviation, r.extrapolated, r.ssim, r.proxy, r.megabytes, r.seconds, r.splats].map(number);
        out.push_str(&format!("{},{},{}\n", quoted(&r.label()), numbers.join(","), r.steps));
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use gs_synth::{SynthOptions, write};

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
        let small = SynthOptions { size: 32, train_views: 5, val_views: 1, test_views: 1, ..SynthOptions::default() };
        write(&data, "static", &small, false).unwrap();
        let sweep = Sweep {
            registry: gs_methods::registry().clone(),
            data,
            root: folder.path().join("sweep"),
            method: "static3d".into(),
            preset: "tiny".into(),
            vary: ["init.points=150|300", "schedule.lambda_dssim=0.5"].map(|v| Vary::parse(v).unwrap()).to_vec(),
            seeds: vec![0],
            length: Length::Steps(6),
            sets: vec!["init.points=300".into()],
        };
        let mut trials = 0;
        let rows =
            sweep.run(&AtomicBool::new(false), &mut |t| trials += u32::from(matches!(t, Told::Trial(_)))).unwrap();
        let labels: Vec<String> = rows.iter().map(Row::label).collect();
        assert_eq!(labels, ["preset", "init.points=150", "init.points=300", "schedule.lambda_dssim=0.5"]);
        assert_eq!((trials, rows.iter().map(|r| r.preset).collect::<Vec<_>>()), (3, vec![true, false, true, false]));
        assert!(rows[1].megabytes < rows[0].megabytes && rows[2].megabytes == rows[0].megabytes);
        let text = csv(&rows);
        assert!(text.lines().count() == 5 && text.contains("\n\"init.points=150\","), "{text}");
        let html = crate::sweep::page::page("static3d", &rows).unwrap();
        assert!(html.contains("<svg") && html.contains("schedule.lambda_dssim=0.5") && !html.contains("<script"));
        let wrong = Sweep {
            registry: gs_methods::registry().clone(),
            vary: vec![Vary::parse("no.such=1|2").unwrap()],
            ..sweep
        };
        assert!(wrong.run(&AtomicBool::new(false), &mut |_| {}).is_err());
    }
}
