//! Our figures beside the published ones.

use crate::beside::Beside;
use crate::column::Column;
use crate::reproduction::{Chosen, Reproduction};
use crate::table::{Table, TableEntry};
use gs_train::evaluate::EvalReport;
use gs4d_eval::spread::Spread;
use gs4d_lab::contest::{Length, Results, Standing, Trial};
use serde::Serialize;

/// A figure of a paper and ours.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Value {
    /// As printed.
    pub published: Option<f64>,
    /// Mean and deviation over seeds.
    pub ours: Option<Spread>,
}

impl Value {
    /// Ours less the published figure.
    pub fn difference(&self) -> Option<f64> {
        Some(self.ours?.mean - self.published?)
    }
}

/// An entry on a scene, or its mean over scenes.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct EntryOutcome {
    /// Name in the paper.
    pub entry: String,
    /// Seeds that stand.
    pub seeds: Vec<u64>,
    /// Steps of every trial.
    pub steps: Option<u64>,
    /// By column of the table.
    pub values: Vec<Value>,
    /// The weight-free perceptual distance of gs-metrics, which is not LPIPS.
    pub perceptual_proxy: Option<f64>,
    /// Millions of bytes of all parameters as `f32`.
    pub megabytes: Option<f64>,
    /// Seconds of training, mean over seeds.
    pub seconds: Option<f64>,
}

/// A scene, or the mean over scenes.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SceneOutcome {
    /// Name.
    pub scene: String,
    /// Whether it is generated: the paper has no figures of it.
    pub generated: bool,
    /// In the order of the table.
    pub entries: Vec<EntryOutcome>,
}

/// What the differences say of the paper's order.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Verdict {
    /// The interval lies on the published side of 0.
    AsPublished,
    /// The interval lies on the other side.
    Opposite,
    /// The interval holds 0, or there are fewer than three pairs.
    NotShown,
}

/// The first entry against another one, in the first column.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Order {
    /// The other entry.
    pub other: String,
    /// Published mean of the first less that of the other, over the scenes that have pairs; over all where generated ones stand in. Absent where the paper
    /// has no figures of just these scenes.
    pub published: Option<f64>,
    /// Mean over pairs of the same scene and seed.
    pub ours: Option<f64>,
    /// Half the 95 % interval of that mean by Student's t, over the means of scenes where there are three, else over pairs: seeds of one scene
    /// are not as independent as scenes are. Absent below two pairs.
    pub half_width: Option<f64>,
    /// Number of scenes whose means the interval is over; 0: it is over pairs.
    pub scenes: usize,
    /// Number of pairs.
    pub pairs: usize,
    /// What they say; absent where the paper has no difference.
    pub verdict: Option<Verdict>,
}

/// Something of the table without a result of ours.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct NotRun {
    /// A scene, an entry, a column or a trial.
    pub what: String,
    /// The cause.
    pub why: String,
}

/// Published means of an entry over the paper's scenes.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct PublishedMean {
    /// Name in the paper.
    pub entry: String,
    /// By column of the table.
    pub values: Vec<Option<f64>>,
}

/// A table with our figures.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Outcome {
    /// `PAPER-TABLE`.
    pub table: String,
    /// What it shows.
    pub title: String,
    /// Where it is printed.
    pub source: String,
    /// Conditions of the published figures.
    pub protocol: String,
    /// What a reader must know of the published figures.
    pub remark: Option<String>,
    /// Conditions of ours.
    pub conditions: String,
    /// Names of the columns.
    pub columns: Vec<String>,
    /// The published means of all entries, those that were not run included.
    pub published: Vec<PublishedMean>,
    /// One per scene, then the mean over scenes if there are several.
    pub scenes: Vec<SceneOutcome>,
    /// The first entry against each other one.
    pub orders: Vec<Order>,
    /// What has no result, and why.
    pub not_run: Vec<NotRun>,
}

impl Outcome {
    pub(crate) fn of(reproduction: &Reproduction, results: &[Results], beside: &Beside) -> Self {
        let Reproduction { table, scenes, .. } = reproduction;
        let mut outcomes: Vec<SceneOutcome> =
            scenes.iter().zip(results).map(|(s, r)| scene(reproduction, s, &r.standings, beside)).collect();
        if outcomes.len() > 1 {
            outcomes.push(average(reproduction, results, beside));
        }
        Self {
            table: table.full_name(),
            title: table.title.clone(),
            source: table.source.clone(),
            protocol: table.protocol.clone(),
            remark: table.remark.clone(),
            conditions: conditions(reproduction) + &measures(table, beside),
            columns: table.columns.clone(),
            published: table.entries.iter().filter_map(|e| published_row(table, e)).collect(),
            scenes: outcomes,
            orders: orders(reproduction, results, beside),
            not_run: not_run(reproduction, results, beside),
        }
    }
}

fn published_row(table: &Table, entry: &TableEntry) -> Option<PublishedMean> {
    let values: Vec<_> = (0..table.columns.len()).map(|c| table.published_average(&entry.name, c)).collect();
    values.iter().any(Option::is_some).then(|| PublishedMean { entry: entry.name.clone(), values })
}

/// The conditions of our figures, in words.
fn conditions(reproduction: &Reproduction) -> String {
    let c = &reproduction.conditions;
    let preset = c.preset.as_ref().map_or("published recipes".to_owned(), |p| format!("preset {p}"));
    let length = match c.length {
        Length::Recipe => String::new(),
        Length::Steps(n) => format!(", {n} steps"),
        Length::Seconds(s) => format!(", {s} s a trial"),
    };
    let scale = c.scale.map_or(String::new(), |s| format!(", data.scale={s}"));
    let of_table = reproduction.table.sets.iter().filter(|s| !s.starts_with("data."));
    let sets = of_table.chain(&c.sets).map(|s| format!(", {s}")).collect::<String>();
    let seeds = c.seeds.iter().map(u64::to_string).collect::<Vec<_>>().join(", ");
    format!("{preset}{length}{scale}{sets}; seeds {seeds}")
}

/// How PSNR and the scores beside those of training were measured.
fn measures(table: &Table, beside: &Beside) -> String {
    let psnr = table.columns.iter().any(|c| c.ends_with("psnr"));
    let psnr = psnr.then(|| format!("; psnr: {}", table.psnr.words()));
    psnr.into_iter().chain(beside.how.values().map(|how| format!("; {how}"))).collect()
}

/// Mean and deviation of a column over the trials that have it.
fn spread(standing: &Standing, column: &Column, beside: &Beside) -> Option<Spread> {
    Spread::of(&standing.trials.iter().filter_map(|t| beside.score(column, t)).collect::<Vec<_>>())
}

/// The published figure of a scene; none of a generated one.
fn published(table: &Table, chosen: &Chosen, entry: &str, column: usize) -> Option<f64> {
    match chosen {
        Chosen::Published(scene, _) => table.published(scene, entry, column),
        Chosen::Generated(_) => None,
    }
}

fn scene(reproduction: &Reproduction, chosen: &Chosen, standings: &[Standing], beside: &Beside) -> SceneOutcome {
    let table = &reproduction.table;
    let generated = chosen.is_generated();
    let columns = table.measured_columns(generated);
    let entries = table.runnable().zip(standings).map(|(entry, standing)| {
        let of =
            |(k, c)| Value { published: published(table, chosen, &entry.name, k), ours: spread(standing, c, beside) };
        outcome(entry, standing, columns.iter().enumerate().map(of).collect())
    });
    SceneOutcome { scene: chosen.name().to_owned(), generated, entries: entries.collect() }
}

fn outcome(entry: &TableEntry, standing: &Standing, values: Vec<Value>) -> EntryOutcome {
    let mean = |score: fn(&EvalReport) -> Option<f64>| standing.spread(score).map(|s| s.mean);
    EntryOutcome {
        entry: entry.name.clone(),
        seeds: standing.trials.iter().map(|t| t.seed).collect(),
        steps: standing.steps,
        values,
        perceptual_proxy: mean(|r| r.mean.perceptual_proxy),
        megabytes: mean(|r| Some(r.parameter_bytes as f64 * 1e-6)),
        seconds: mean(|r| r.train_seconds),
    }
}

/// Means over scenes of every seed that stands on all of them; their spread is that over seeds.
fn average(reproduction: &Reproduction, results: &[Results], beside: &Beside) -> SceneOutcome {
    let table = &reproduction.table;
    let generated = reproduction.scenes.iter().all(Chosen::is_generated);
    let mixed = !generated && reproduction.scenes.iter().any(Chosen::is_generated);
    let columns = table.measured_columns(generated);
    let entries = table.runnable().enumerate().map(|(k, entry)| {
        let standings: Vec<&Standing> = results.iter().filter_map(|r| r.standings.get(k)).collect();
        let everywhere = |seed: &&u64| standings.iter().all(|s| s.of_seed(**seed).is_some());
        let seeds: Vec<u64> = reproduction.conditions.seeds.iter().filter(everywhere).copied().collect();
        let mean = |score: &dyn Fn(&Trial) -> Option<f64>| {
            let of = |seed: &u64| -> Option<f64> {
                let values: Option<Vec<f64>> = standings.iter().map(|s| score(s.of_seed(*seed)?)).collect();
                Spread::of(&values?).map(|s| s.mean)
            };
            Spread::of(&seeds.iter().filter_map(of).collect::<Vec<_>>())
        };
        let of = |(k, column): (usize, &Column)| Value {
            published: published_mean(table, &entry.name, k, &reproduction.scenes.iter().collect::<Vec<_>>()),
            // Masked scores of some scenes and whole ones of others have no mean.
            ours: mean(&|t| beside.score(column, t)).filter(|_| !(mixed && column.is_masked())),
        };
        let plain = |score: fn(&EvalReport) -> Option<f64>| mean(&|t| score(&t.scores)).map(|s| s.mean);
        EntryOutcome {
            entry: entry.name.clone(),
            values: columns.iter().enumerate().map(of).collect(),
            steps: None,
            perceptual_proxy: plain(|r| r.mean.perceptual_proxy),
            megabytes: plain(|r| Some(r.parameter_bytes as f64 * 1e-6)),
            seconds: plain(|r| r.train_seconds),
            seeds,
        }
    });
    SceneOutcome { scene: "mean over these scenes".to_owned(), generated, entries: entries.collect() }
}

/// The published mean over some scenes: the printed one if these are all of the paper's, else that of the printed rows; none over
/// generated ones.
fn published_mean(table: &Table, entry: &str, column: usize, scenes: &[&Chosen]) -> Option<f64> {
    if scenes.iter().any(|scene| scene.is_generated()) {
        return None;
    }
    let printed = table.published_average(entry, column).filter(|_| scenes.len() == table.scenes.len());
    let rows = || scenes.iter().map(|scene| published(table, scene, entry, column)).collect::<Option<Vec<f64>>>();
    printed.or_else(|| Spread::of(&rows()?).map(|s| s.mean))
}

fn orders(reproduction: &Reproduction, results: &[Results], beside: &Beside) -> Vec<Order> {
    let table = &reproduction.table;
    let names: Vec<&TableEntry> = table.runnable().collect();
    let generated = reproduction.scenes.iter().all(Chosen::is_generated);
    let columns = table.measured_columns(generated);
    let (Some(first), Some(column)) = (names.first(), columns.first()) else {
        return Vec::new();
    };
    // What stands in for the paper's scenes stands in for all of them.
    let printed = |entry: &str, stand: &[&Chosen]| match generated {
        true => table.published_average(entry, 0),
        false => published_mean(table, entry, 0, stand),
    };
    let order = |(k, other): (usize, &&TableEntry)| {
        let pairs = |r: &Results| match (r.standings.first(), r.standings.get(k)) {
            (Some(first), Some(other)) => less(first, other, column, beside),
            _ => Vec::new(),
        };
        let scenes: Vec<Vec<f64>> = results.iter().map(pairs).collect();
        let with_pairs = reproduction.scenes.iter().zip(&scenes).filter(|(_, pairs)| !pairs.is_empty());
        let stand: Vec<&Chosen> = with_pairs.map(|(scene, _)| scene).collect();
        let published = printed(&first.name, &stand).zip(printed(&other.name, &stand)).map(|(a, b)| a - b);
        Order::of(other.name.clone(), published, &scenes)
    };
    names.iter().enumerate().skip(1).map(order).collect()
}

/// A column less that of another entry with the same seed, for every seed of which both have it.
fn less(first: &Standing, other: &Standing, column: &Column, beside: &Beside) -> Vec<f64> {
    let pair = |a: &Trial| {
        let b = other.of_seed(a.seed)?;
        match column.less {
            Some(less) => less(&a.scores, &b.scores),
            None => Some(beside.score(column, a)? - beside.score(column, b)?),
        }
    };
    first.trials.iter().filter_map(pair).collect()
}

impl Order {
    /// From the differences of every scene.
    fn of(other: String, published: Option<f64>, scenes: &[Vec<f64>]) -> Self {
        let pairs = scenes.concat();
        let means: Vec<f64> = scenes.iter().filter_map(|pairs| Spread::of(pairs)).map(|s| s.mean).collect();
        let samples = if means.len() > 2 { &means } else { &pairs };
        let spread = Spread::of(samples);
        let half_width = spread.filter(|_| samples.len() > 1).map(|s| {
            let n = samples.len();
            student_975(n - 1) * s.deviation / (n as f64).sqrt()
        });
        let ours = spread.map(|s| s.mean);
        let scenes = if means.len() > 2 { means.len() } else { 0 };
        let mut order = Self { other, published, ours, half_width, scenes, pairs: pairs.len(), verdict: None };
        // Entries that were published as equal have no order.
        let published = published.filter(|p| *p != 0.0 && ours.is_some());
        order.verdict = published.map(|published| match order.side() {
            Some(side) if side * published > 0.0 => Verdict::AsPublished,
            Some(_) => Verdict::Opposite,
            None => Verdict::NotShown,
        });
        order
    }

    /// The side of 0 that the interval lies on, 1 or −1; `None` where it holds 0, or there are fewer than three pairs.
    pub(crate) fn side(&self) -> Option<f64> {
        let (ours, half) = self.ours.zip(self.half_width)?;
        (self.pairs > 2 && ours.abs() > half).then(|| ours.signum())
    }
}

/// The 97.5 % quantile of Student's t.
fn student_975(freedom: usize) -> f64 {
    const SMALL: [f64; 30] = [
        12.706, 4.303, 3.182, 2.776, 2.571, 2.447, 2.365, 2.306, 2.262, 2.228, 2.201, 2.179, 2.160, 2.145, 2.131,
        2.120, 2.110, 2.101, 2.093, 2.086, 2.080, 2.074, 2.069, 2.064, 2.060, 2.056, 2.052, 2.048, 2.045, 2.042,
    ];
    // Beyond: the normal quantile and two terms of its expansion in 1/n.
    let n = freedom as f64;
    let beyond = || 1.959_964 + 2.372_3 / n + 2.822_5 / (n * n);
    SMALL.get(freedom.saturating_sub(1)).copied().unwrap_or_else(beyond)
}

fn not_run(reproduction: &Reproduction, results: &[Results], beside: &Beside) -> Vec<NotRun> {
    let Reproduction { table, set, absent, .. } = reproduction;
    let row = |what: &str, why: String| NotRun { what: what.to_owned(), why };
    let scenes = absent.iter().map(|(s, absence)| row(s, format!("{absence}; from {}; {}", set.from, set.layout)));
    let entries = table.entries.iter().filter(|e| e.run.is_none());
    let entries = entries.map(|e| row(&e.name, "no method of gs4d".to_owned()));
    let some_generated = reproduction.scenes.iter().any(Chosen::is_generated);
    let masked = table.measured_columns(false).iter().any(Column::is_masked);
    let why = "generated scenes have none: masked columns are of all pixels there";
    let masks = (masked && some_generated).then(|| row("masks", why.to_owned()));
    let trials = results.iter().zip(&reproduction.scenes);
    let trials = trials.flat_map(|(r, s)| {
        r.missing.iter().map(move |m| row(&format!("{} / {}", s.name(), m.trial), m.source.to_string()))
    });
    let columns = not_measured(reproduction, results, beside);
    scenes.chain(entries).chain(masks).chain(columns).chain(trials).collect()
}

/// The columns of LPIPS and tOF without a score, and why; where some scenes have one, the scenes without.
fn not_measured(reproduction: &Reproduction, results: &[Results], beside: &Beside) -> Vec<NotRun> {
    let table = &reproduction.table;
    let trials = || results.iter().flat_map(|r| &r.standings).flat_map(|s| &s.trials);
    let mut rows = Vec::new();
    for column in table.measured_columns(false).iter().filter(|c| c.is_beside()) {
        let mut left_out = beside.left_out.iter().filter(|l| l.column == column.name);
        if trials().any(|t| beside.score(column, t).is_some()) {
            rows.extend(left_out.map(|l| NotRun { what: format!("{} / {}", l.scene, l.column), why: l.why.clone() }));
            continue;
        }
        let network = table.networks.get(column.name).filter(|_| !beside.how.contains_key(column.name));
        let why = match (left_out.next(), network) {
            (Some(first), _) => first.why.clone(),
            (None, Some(network)) => format!(
                "needs weights of the network {} that gs4d does not have (--lpips FILE); the perceptual proxy stands beside",
                network.net_name()
            ),
            (None, None) if column.is_masked() => "no test view has a mask".to_owned(),
            (None, None) => "no run has it".to_owned(),
        };
        rows.push(NotRun { what: column.name.to_owned(), why });
    }
    rows
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::column::PsnrMean;

    #[test]
    fn the_order_needs_an_interval_on_one_side() {
        let of = |published, pairs: &[f64]| Order::of("other".into(), published, &[pairs.to_vec()]).verdict;
        assert_eq!(of(Some(0.8), &[0.5, 0.6, 0.7]), Some(Verdict::AsPublished));
        assert_eq!(of(Some(-0.8), &[0.5, 0.6, 0.7]), Some(Verdict::Opposite));
        assert_eq!(of(Some(0.8), &[0.5, -0.6, 0.7]), Some(Verdict::NotShown));
        assert_eq!(of(Some(0.8), &[0.5, 0.6]), Some(Verdict::NotShown), "two pairs");
        assert_eq!(of(None, &[0.5, 0.6, 0.7]), None);
        assert_eq!(of(Some(0.8), &[]), None);
        assert_eq!(of(Some(0.0), &[0.5, 0.6, 0.7]), None, "published as equal");
        let side = |pairs: &[f64]| Order::of("other".into(), None, &[pairs.to_vec()]).side();
        assert_eq!(side(&[0.5, 0.6, 0.7]), Some(1.0));
        assert_eq!(side(&[-0.5, -0.6, -0.7]), Some(-1.0));
        assert_eq!((side(&[0.5, -0.6, 0.7]), side(&[0.5, 0.6]), side(&[])), (None, None, None));
    }

    #[test]
    fn conditions_say_how_columns_were_measured() {
        let mut table = Table::find("fags", "dnerf").unwrap();
        let mut beside = Beside::default();
        beside.how.insert("lpips", "lpips: vgg 1a2b3c4d".to_owned());
        assert_eq!(measures(&table, &beside), "; psnr: the mean of the images' PSNR; lpips: vgg 1a2b3c4d");
        table.psnr = PsnrMean::MeanError;
        assert!(measures(&table, &Beside::default()).ends_with("the PSNR of the images' mean squared error"));
        table.columns = vec!["ssim".into()];
        assert_eq!(measures(&table, &Beside::default()), "");
    }

    #[test]
    fn the_interval_is_students() {
        let order = Order::of("other".into(), None, &[vec![1.0, 2.0, 3.0]]);
        assert!((order.half_width.unwrap() - 4.303 / 3f64.sqrt()).abs() < 1e-12);
        assert_eq!((order.ours, order.pairs, order.scenes), (Some(2.0), 3, 0));
        // Three scenes with seeds that agree: as uncertain as three scenes.
        let order = Order::of("other".into(), None, &[vec![1.0; 5], vec![2.0; 5], vec![3.0; 5]]);
        assert!((order.half_width.unwrap() - 4.303 / 3f64.sqrt()).abs() < 1e-12);
        assert_eq!((order.ours, order.pairs, order.scenes), (Some(2.0), 15, 3));
        assert!((student_975(31) - 2.0395).abs() < 1e-3 && (student_975(120) - 1.9799).abs() < 1e-3);
    }
}
