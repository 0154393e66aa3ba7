//! `gs4d eval`: scores a run on a split of its data, or a folder of images against their ground truth.

use super::train::all_scores_text;
use crate::answer::Answer;
use crate::device::DeviceFlag;
use crate::failure::{Class, Failure};
use crate::global::{Global, to_stderr};
use crate::opening::RunData;
use crate::parse;
use crate::progress::Waiting;
use gs_core::io::{Limits, read_file};
use gs_data::{Dataset, Split};
use gs_train::evaluate::MaskedScores;
use gs_train::report::Section;
use gs4d_eval::compare::{Metric, SetScores};
use gs4d_eval::folders::{
    FolderScores, FolderTask, Lpips, LpipsRange, Quantise, TofOptions, VideoScore, score, tof_protocol,
};
use gs4d_eval::temporal;
use gs4d_reproduce::carry_columns;
use gs4d_run::folder::METRICS;
use gs4d_run::opened::metrics_json;
use gs4d_run::summary::color_name;
use gs4d_run::{OpenRun, RunFolder};
use serde_json::{Value, json};
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Difference of two backgrounds, 0..1, from which on it is told.
const FAR_OFF: f64 = 0.04;

/// Score a run on its test views, or a folder of images against a folder of ground truth
#[derive(clap::Args)]
pub struct Eval {
    /// Folder of the run, or a .gs4d file: one of its checkpoints, or what gs4d export made.
    #[arg(value_name = "RUN|FILE", required_unless_present = "pred", conflicts_with_all = ["pred", "gt", "mask"])]
    run: Option<PathBuf>,
    /// Which views of the run's data.
    #[arg(long, value_enum, default_value_t = SplitName::Test)]
    split: SplitName,
    /// Colour behind render and ground truth: black, white, one grey or r,g,b in 0..1 [default: the run's; folders: black].
    #[arg(long, allow_hyphen_values = true, value_parser = parse::color)]
    background: Option<[f32; 3]>,
    /// Folder of images to score, taken in the order of the numbers in their names.
    #[arg(long, value_name = "DIR", requires = "gt", conflicts_with_all = ["split", "device", "data"])]
    pred: Option<PathBuf>,
    /// Folder of their ground truth; files belong together by name, or by order where names differ but hold numbers.
    #[arg(long, value_name = "DIR", requires = "pred")]
    gt: Option<PathBuf>,
    /// Folder of masks: adds scores where pixels are bright: masked PSNR, SSIM and proxy, and as papers on avatars report them PSNR of the whole
    /// frame and SSIM of the box, black outside the eroded mask.
    #[arg(long, value_name = "DIR", requires = "pred")]
    mask: Option<PathBuf>,
    /// Metrics, separated by commas [default: those of single images; masked where there are masks]. A run always gets
    /// those; tof (motion of consecutive frames, pixels) must be asked for.
    #[arg(long, value_enum, value_delimiter = ',')]
    metrics: Option<Vec<MetricName>>,
    /// tof: keep the first and last two frames.
    #[arg(long)]
    no_trim: bool,
    /// tof: keep the border.
    #[arg(long)]
    no_crop: bool,
    /// Rounding of images to 8 bit before they are scored, as papers do that score PNG files [default: none; round with --half].
    #[arg(long, value_enum)]
    quantise: Option<QuantiseName>,
    /// Reduce images, ground truth and masks to half size by means of 2x2 pixels before they are scored (metrics.py --half_res of TRACE's authors); tof is of
    /// full size. Such scores are not kept with a run.
    #[arg(long, conflicts_with = "fit_colors")]
    half: bool,
    /// Adds LPIPS with the weights of this safetensors file: the state of lpips.LPIPS(net="alex") or "vgg"; docs/guide/report.md says how
    /// it is made.
    #[arg(long, value_name = "FILE")]
    lpips: Option<PathBuf>,
    /// What LPIPS makes of colours: signed maps them to -1..1, as the network was trained; unit leaves them in 0..1, as the evaluation of 3DGS and most
    /// papers after it do.
    #[arg(long, value_enum, default_value_t = RangeName::Signed, requires = "lpips")]
    lpips_range: RangeName,
    /// Adds PSNR and SSIM of a run after the linear map of colours that brings each frame nearest to its image: for images that were not exposed alike. Runs
    /// trained with schedule.exposure.fit always have them; those with schedule.exposure.offset have maps with an offset.
    #[arg(long, conflicts_with = "pred")]
    fit_colors: bool,
    #[command(flatten)]
    device: DeviceFlag,
    #[command(flatten)]
    place: RunData,
}

/// A split of the data.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum SplitName {
    Train,
    Val,
    Test,
    /// Views after the last training time (data.time_boundary).
    Extrapolate,
}

impl From<SplitName> for Split {
    fn from(name: SplitName) -> Self {
        match name {
            SplitName::Train => Split::Train,
            SplitName::Val => Split::Val,
            SplitName::Test => Split::Test,
            SplitName::Extrapolate => Split::Extrapolate,
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum MetricName {
    Psnr,
    Ssim,
    #[value(name = "ms_ssim")]
    MsSsim,
    /// A perceptual distance without learned weights; not LPIPS.
    #[value(alias = "perceptual_proxy")]
    Proxy,
    /// Motion against true motion.
    Tof,
    /// PSNR, SSIM and proxy where masks count.
    Masked,
}

impl MetricName {
    /// The metric of single images it names.
    fn of_images(self) -> Option<Metric> {
        match self {
            MetricName::Psnr => Some(Metric::Psnr),
            MetricName::Ssim => Some(Metric::Ssim),
            MetricName::MsSsim => Some(Metric::MsSsim),
            MetricName::Proxy => Some(Metric::PerceptualProxy),
            MetricName::Tof | MetricName::Masked => None,
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum QuantiseName {
    None,
    /// To the nearest step, as writing PNG files does.
    Round,
    /// Images down to the next step (DyCheck), ground truth to the nearest.
    Truncate,
}

/// What LPIPS makes of colours.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum RangeName {
    Signed,
    Unit,
}

impl From<RangeName> for LpipsRange {
    fn from(name: RangeName) -> Self {
        match name {
            RangeName::Signed => LpipsRange::Signed,
            RangeName::Unit => LpipsRange::Unit,
        }
    }
}

impl From<QuantiseName> for Quantise {
    fn from(name: QuantiseName) -> Self {
        match name {
            QuantiseName::None => Quantise::None,
            QuantiseName::Round => Quantise::Round,
            QuantiseName::Truncate => Quantise::Truncate,
        }
    }
}

impl Eval {
    pub fn run(self, global: &Global) -> Result<Answer, Failure> {
        match (&self.run, &self.pred, &self.gt) {
            (Some(run), _, _) => self.of_run(run, global),
            (None, Some(pred), Some(gt)) => self.of_folders(pred, gt, global),
            _ => Err(Failure::usage("give a run, or two folders with --pred and --gt")),
        }
    }

    /// Whether a run is scored, not a folder.
    pub fn is_of_run(&self) -> bool {
        self.run.is_some()
    }

    fn lpips(&self) -> Result<Option<Lpips>, Failure> {
        self.lpips.as_deref().map(|file| read_lpips(file, self.lpips_range)).transpose()
    }

    fn asks_for(&self, name: MetricName) -> bool {
        self.metrics.as_ref().is_some_and(|m| m.contains(&name))
    }

    /// Rounding of images; those of half size are of 8-bit ones.
    fn quantise(&self) -> Quantise {
        let default = if self.half { Quantise::Round } else { Quantise::None };
        self.quantise.map_or(default, Into::into)
    }

    /// Options of tOF; `None` if it is not asked for.
    fn tof(&self) -> Result<Option<TofOptions>, Failure> {
        let asked = self.asks_for(MetricName::Tof);
        if !asked && (self.no_trim || self.no_crop) {
            return Err(Failure::usage("--no-trim and --no-crop belong to tof; add tof to --metrics"));
        }
        Ok(asked.then_some(TofOptions { trim: !self.no_trim, crop: !self.no_crop }))
    }

    fn of_run(&self, root: &Path, global: &Global) -> Result<Answer, Failure> {
        let tof = self.tof()?;
        let device = self.device.open(global)?;
        let mut run = self.place.open(root, global)?;
        run.device = device;
        (run.quantise, run.half) = (self.quantise(), self.half);
        run.lpips = self.lpips()?.map(Arc::new);
        run.fit_colors = self.fit_colors;
        let dataset = run.open_data()?;
        let background = self.background.unwrap_or_else(|| run.background());
        let split = self.split.into();
        let views = dataset.views(split).len();
        let waiting = Waiting::new(format!("scoring {views} views"), global.quiet);
        let motion = tof.filter(|_| global.share.leads()).map(|options| {
            let (method, images) = (&run.loaded.model, run.images());
            temporal::tof(method, &dataset, split, &run.scoring(background, &images), options).map(|s| (s, options))
        });
        let motion = motion.transpose()?;
        // The file in the run folder holds the extrapolation scores as well.
        let as_trained = self.background.is_none() && run.quantise == Quantise::None && !self.half;
        let kept = self.split == SplitName::Test && as_trained;
        let folder = run.folder().ok().filter(|_| kept);
        let scores = match folder {
            Some(_) => run.score_for_folder(&dataset)?,
            None => run.score(&dataset, split, background)?,
        };
        drop(waiting);
        if self.asks_for(MetricName::Masked) && scores.mean.masked.is_none() {
            return Err(Failure::new(Class::Data, "data.mask", "no view of this split has a mask")
                .remedy("leave masked out of --metrics"));
        }
        let step = run.loaded.step;
        let mut answer = Answer::new(all_scores_text(&scores, step), metrics_json(&scores, step));
        if let Some((score, options)) = motion {
            answer.text.push_str(&motion_text(&score, options));
            answer.json["tof"] = json!(score);
            answer.json["tof_protocol"] = json!(tof_protocol(options));
        }
        if global.share.leads() { finish(answer, &run, folder, &dataset, global) } else { Ok(answer) }
    }

    fn of_folders(&self, pred: &Path, gt: &Path, global: &Global) -> Result<Answer, Failure> {
        if self.asks_for(MetricName::Masked) && self.mask.is_none() {
            return Err(Failure::usage("masked needs masks: give their folder with --mask"));
        }
        let background = self.background.unwrap_or_default();
        let named = |m: &Vec<MetricName>| m.iter().filter_map(|m| m.of_images()).collect();
        let task = FolderTask {
            pred: pred.to_owned(),
            gt: gt.to_owned(),
            mask: self.mask.clone(),
            metrics: self.metrics.as_ref().map_or(Metric::ALL.to_vec(), named),
            lpips: self.lpips()?,
            tof: self.tof()?,
            quantise: self.quantise(),
            half: self.half,
            background,
        };
        let scores = score(&task)?;
        if let Some(behind) = scores.behind.filter(|b| b.off(background) > FAR_OFF) {
            let [r, g, b] = behind.color.map(|c| (c * 100.0).round() / 100.0);
            global.say(format!(
                "warning: where ground truth is transparent, {} images show {r},{g},{b}, but it was put over {}: scores suffer; score with the \
                 background that the images were rendered over: --background {r},{g},{b}",
                behind.images,
                color_name(background)
            ));
        }
        let mut json = json!(scores);
        json["pred"] = json!(pred.display().to_string());
        json["gt"] = json!(gt.display().to_string());
        json["background"] = json!(background);
        Ok(Answer::new(table(&scores), json))
    }
}

/// LPIPS with the weights of a file.
pub fn read_lpips(path: &Path, range: RangeName) -> Result<Lpips, Failure> {
    let bytes = read_file(path, &Limits::default()).map_err(gs4d_run::RunError::from)?;
    Lpips::read(&bytes).map(|lpips| lpips.with_range(range.into())).map_err(|e| {
        Failure::new(Class::Data, "data.weights", e.to_string())
            .place(path.display())
            .remedy("make the file as docs/guide/report.md says, with Python's packages lpips and safetensors")
    })
}

/// Keeps the scores of a run in its folder, if it has one; then adds what the model says of itself. Where it cannot say it, the scores are kept and printed.
fn finish(
    mut answer: Answer,
    run: &OpenRun,
    folder: Option<&RunFolder>,
    dataset: &Dataset,
    global: &Global,
) -> Result<Answer, Failure> {
    let mut kept = folder.filter(|folder| keep(run, folder, &answer.json, dataset));
    // Without events nothing of its training.
    match run.loaded.model.report_section(&[]) {
        Ok(Some(section)) if !section.rows.is_empty() => {
            add_section(section, &mut answer);
            kept = kept.filter(|folder| keep(run, folder, &answer.json, dataset));
        }
        Ok(_) => {}
        Err(e) => {
            answer.print(global.json)?;
            return Err(e.into());
        }
    }
    if let Some(folder) = kept {
        answer.text.push_str(&format!("-> {}\n", folder.root().join(METRICS).display()));
    }
    Ok(answer)
}

/// Writes scores into the folder of their run, with the columns of `gs4d reproduce` that are of the same images. Scores that cannot be kept are printed all the
/// same; returns whether they are kept.
fn keep(run: &OpenRun, folder: &RunFolder, scores: &Value, dataset: &Dataset) -> bool {
    if !run.trained_on(dataset) {
        let (data, kept) = (dataset.root.display(), folder.root().join(METRICS));
        to_stderr(format_args!(
            "warning: the data at {data} are not those that the run knows: {} is left as it is",
            kept.display()
        ));
        return false;
    }
    let mut scores = scores.clone();
    carry_columns(folder, &mut scores);
    let written = folder.write_scores(scores, dataset);
    if let Err(e) = &written {
        to_stderr(format_args!("warning: the scores are not kept: {e}"));
    }
    written.is_ok()
}

/// Adds the method's own statistics to the scores.
fn add_section(section: Section, answer: &mut Answer) {
    for row in &section.rows {
        answer.text.push_str(&format!("{:26}{:>22}  {}\n", row.name, row.value, row.meaning));
    }
    answer.json["section"] = section.json;
}

fn motion_text(score: &VideoScore, options: TofOptions) -> String {
    format!("tof {:.3} px over {} pairs ({})\n", score.mean, score.pairs.len(), tof_protocol(options))
}

/// A column of the table: heading, digits, value of each row, value of the means.
type Column = (&'static str, usize, Vec<Option<f64>>, Option<f64>);

fn columns(scores: &FolderScores) -> Vec<Column> {
    let SetScores { views, mean, .. } = &scores.images;
    let mut all: Vec<Column> = vec![
        (
            "psnr",
            3,
            views.iter().map(|v| v.psnr.or((v.mse == Some(0.0)).then_some(f64::INFINITY))).collect(),
            mean.psnr,
        ),
        ("ssim", 4, views.iter().map(|v| v.ssim).collect(), mean.ssim),
        ("ms-ssim", 4, views.iter().map(|v| v.ms_ssim).collect(), mean.ms_ssim),
        ("proxy", 4, views.iter().map(|v| v.perceptual_proxy).collect(), mean.perceptual_proxy),
        ("lpips", 4, views.iter().map(|v| v.lpips).collect(), mean.lpips),
    ];
    if let Some(means) = mean.masked {
        let of = |name, digits, value: fn(&MaskedScores) -> Option<f64>| -> Column {
            (name, digits, views.iter().map(|v| value(v.masked.as_ref()?)).collect(), value(&means))
        };
        all.push(of("m-psnr", 3, |m| m.psnr));
        all.push(of("m-ssim", 4, |m| m.ssim));
        all.push(of("m-proxy", 4, |m| Some(m.perceptual_proxy)));
        all.push(of("m-lpips", 4, |m| m.lpips));
        all.push(of("f-psnr", 3, |m| m.frame_psnr));
        all.push(of("box-ssim", 4, |m| m.box_ssim));
    }
    if let Some(tof) = &scores.tof {
        let of = |i: usize| tof.pairs.iter().find(|p| p.frame == i).map(|p| p.tof);
        all.push(("tof px", 3, (0..views.len()).map(of).collect(), Some(tof.mean)));
    }
    all.retain(|c| c.3.is_some() || c.2.iter().any(Option::is_some));
    all
}

fn table(scores: &FolderScores) -> String {
    let columns = columns(scores);
    let cell = |v: Option<f64>, digits: usize| match v {
        Some(v) => format!("{v:>10.digits$}"),
        None => format!("{:>10}", "-"),
    };
    let mut out = format!("{:24}", "");
    columns.iter().for_each(|c| out.push_str(&format!("{:>10}", c.0)));
    out.push('\n');
    for (i, view) in scores.images.views.iter().enumerate() {
        let row: Vec<String> = columns.iter().map(|c| cell(c.2[i], c.1)).collect();
        out.push_str(&format!("{:24}{}\n", view.name, row.concat()));
    }
    let row: Vec<String> = columns.iter().map(|c| cell(c.3, c.1)).collect();
    out.push_str(&format!("{:24}{}\n", "mean", row.concat()));
    let images = &scores.images;
    let from_mean = images.psnr_of_mean_mse.map_or(String::new(), |p| format!("psnr of the mean error {p:.3} dB; "));
    out.push_str(&format!("{from_mean}{} views, {} without error\n", images.views.len(), images.perfect_views));
    out.push_str(&format!("{}\n", scores.protocol));
    out
}
