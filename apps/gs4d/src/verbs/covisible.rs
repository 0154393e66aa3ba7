//! `gs4d covisible`: masks of what enough training images show of held-out ones.

use super::eval::SplitName;
use crate::answer::Answer;
use crate::failure::{Class, Failure};
use crate::global::Global;
use crate::opening::Reading;
use crate::output::{check_free, create_folder, stems};
use crate::parse;
use crate::progress::Progress;
use gs_core::cast;
use gs_core::io::images::save_png;
use gs_data::{Dataset, ImageCache, Split, View, shell_quoted};
use gs_train::evaluate::split_name;
use gs4d_eval::covisible::{CovisibleError, CovisibleOptions, Options, mask};
use serde_json::{Value, json};
use std::path::{Path, PathBuf};

/// Most memory for decoded images, bytes.
const IMAGE_BYTES: usize = 512 << 20;
/// Where the reader of DyCheck captures looks for masks.
const OF_DYCHECK: &str = "covisible/2x/val";

/// Make co-visibility masks of held-out images: white where enough training images show the same, by optical flow there and back
#[derive(clap::Args)]
pub struct Covisible {
    /// The folder of the data.
    #[arg(value_name = "DATA")]
    data: PathBuf,
    /// Which views get masks: val, test or extrapolate.
    #[arg(long, value_enum, default_value_t = SplitName::Test)]
    split: SplitName,
    /// Compare with so many training images, the nearest in place, direction and time [default: all, as DyCheck does].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    images: Option<u32>,
    /// Training images that must see a pixel [default: 6, and more than a tenth of them, as DyCheck does].
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    least: Option<u32>,
    /// By how much flow there and back may miss, squared, pixels; 0.01 of the squares of both flows is added.
    #[arg(long, value_name = "PIXELS2", default_value = "0.5", allow_hyphen_values = true, value_parser = parse::not_negative)]
    threshold: f64,
    /// Look at the flow alone, as DyCheck does with a learned flow; else colours must match too, without which most of what is hidden
    /// counts as seen here.
    #[arg(long)]
    flow_only: bool,
    #[command(flatten)]
    reading: Reading,
    /// Folder for one PNG per view, by its name; made if missing. DyCheck captures read DATA/covisible/2x/val.
    #[arg(short, long, value_name = "DIR")]
    out: PathBuf,
    /// Overwrite existing files.
    #[arg(short, long)]
    force: bool,
}

impl From<CovisibleError> for Failure {
    fn from(e: CovisibleError) -> Self {
        let text = e.to_string();
        match e {
            CovisibleError::Few { images, .. } => {
                Self::new(Class::Data, "covisible.few", text).remedy(format!("lower it: --least N, N up to {images}"))
            }
            CovisibleError::Data(e) => e.into(),
            CovisibleError::Metric { .. } => Self::new(Class::Data, "data.metric", text)
                .why("flow leads from an image to one of the same size")
                .remedy("leave cameras with images of another size out with --set data.cameras=[..]"),
        }
    }
}

impl Covisible {
    pub fn run(self, global: &Global) -> Result<Answer, Failure> {
        if self.split == SplitName::Train {
            return Err(Failure::usage("training images are what held-out ones are compared with")
                .remedy("choose --split val, test or extrapolate"));
        }
        let dataset = Dataset::open(&self.data, &self.reading.options()?)?;
        let split: Split = self.split.into();
        let views = dataset.views(split);
        if views.is_empty() {
            return Err(
                Failure::new(Class::Data, "data.split", "the split has no views").remedy("choose another --split")
            );
        }
        let options = self.options(&dataset);
        let needed = options.needed(&dataset)?;
        let files: Vec<PathBuf> = stems(views).iter().map(|stem| self.out.join(format!("{stem}.png"))).collect();
        check_free(self.force, "mask", "folder", &files)?;
        create_folder(&self.out)?;
        let images = ImageCache::new(IMAGE_BYTES, 1.0).with_max_image_mib(dataset.max_image_mib);
        let mut progress = Progress::new(views.len() as u64, "views", global.quiet);
        let mut shares = Vec::with_capacity(views.len());
        for (view, file) in views.iter().zip(&files) {
            let mask = mask(&dataset, view, &images, &options)?;
            save_png(file, &mask, self.force)?;
            shares.push(mask.data.iter().map(|m| f64::from(*m)).sum::<f64>() / mask.data.len() as f64);
            progress.at(shares.len() as u64, || view.name.clone());
        }
        progress.finish();
        Ok(self.answer(&dataset, views, &shares, [options.images(&dataset), needed]))
    }

    fn options(&self, dataset: &Dataset) -> Options {
        let published = CovisibleOptions::default();
        let (more_than, share) =
            self.least.map_or((published.more_than, published.share), |least| (least as usize - 1, 0.0));
        let slack = cast::to_f32(self.threshold);
        Options {
            rule: CovisibleOptions { slack, more_than, share, colors: !self.flow_only, ..published },
            nearest: self.images.map(|n| n as usize),
            stored: reads_masks(dataset),
        }
    }

    fn answer(&self, dataset: &Dataset, views: &[View], shares: &[f64], [images, needed]: [usize; 2]) -> Answer {
        let mean = shares.iter().sum::<f64>() / shares.len() as f64;
        let least = views.iter().zip(shares).min_by(|a, b| a.1.total_cmp(b.1));
        let least = least.map_or(String::new(), |(v, s)| format!(", least {:.1} % of {}", 100.0 * s, v.name));
        let how = self.how_to_use(dataset);
        let text = format!(
            "{} masks in {}: {:.1} % of the pixels are co-visible{least}\nseen by at least {needed} of {images} training \
             images, by flow there and back{}\n{how}\n",
            views.len(),
            self.out.display(),
            100.0 * mean,
            if self.flow_only { "" } else { " and colours" },
        );
        let each = |(v, s): (&View, &f64)| json!({"name": v.name, "share": s});
        let json = json!({
            "folder": self.out.display().to_string(),
            "layout": dataset.layout,
            "split": split_name(self.split.into()),
            "images": images,
            "needed": needed,
            "flow_only": self.flow_only,
            "share": mean,
            "views": views.iter().zip(shares).map(each).collect::<Vec<Value>>(),
            "use": how,
        });
        Answer::new(text, json)
    }

    /// What is to be done for masked scores.
    fn how_to_use(&self, dataset: &Dataset) -> String {
        let (data, out) = (self.data.display(), shell_quoted(self.out.display().to_string()));
        match dataset.layout {
            "hypernerf" if same_folder(&self.out, &self.data.join(OF_DYCHECK)) => {
                "runs on these data are scored with them; make masks before training, since they count as data"
                    .to_owned()
            }
            "hypernerf" => format!("for masked scores put them into {data}/{OF_DYCHECK}, before training"),
            "nerfstudio" => {
                format!("for masked scores name each as the mask_path of its frame in {data}, before training")
            }
            layout => format!(
                "the layout {layout} has no such masks: for masked scores gs4d eval --pred FRAMES --gt IMAGES --mask {out}"
            ),
        }
    }
}

/// Whether the reader of the data's layout takes masks of held-out views.
fn reads_masks(dataset: &Dataset) -> bool {
    matches!(dataset.layout, "hypernerf" | "nerfstudio")
}

/// Whether two paths are one folder, however they are written.
fn same_folder(a: &Path, b: &Path) -> bool {
    a == b || a.canonicalize().is_ok_and(|a| b.canonicalize().is_ok_and(|b| a == b))
}
