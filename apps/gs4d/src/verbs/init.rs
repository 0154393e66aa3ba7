//! `gs4d init`: initial points and the bounding box of the scene.

use crate::answer::Answer;
use crate::failure::Failure;
use crate::global::Global;
use clap::ValueEnum;
use gs_data::{DataOptions, Dataset, StartFrom, cube, write_start};
use gs4d_run::settings::{Request, resolve};
use serde_json::json;
use std::path::PathBuf;

/// Make initial points (start.ply) and write them, and the bounding box, into the folder's scene.toml
#[derive(clap::Args)]
pub struct Init {
    /// The folder.
    #[arg(value_name = "DATA")]
    data: PathBuf,
    /// Where points come from [default: the first of these that has any].
    #[arg(long, value_enum)]
    from: Option<From>,
    /// At most so many.
    #[arg(long, default_value_t = 20_000, value_parser = clap::value_parser!(u32).range(1..=10_000_000))]
    points: u32,
    /// Half the side of the box around the origin, world units [default: the box of the layout or of the cameras].
    #[arg(long, value_name = "HALF", value_parser = positive)]
    bound: Option<f32>,
    /// Seed of every random number.
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Read the folder with this layout [default: the one that fits].
    #[arg(long)]
    layout: Option<String>,
    /// A setting of the data, data.KEY=VALUE (repeatable).
    #[arg(long = "set", value_name = "KEY=VALUE")]
    sets: Vec<String>,
    /// Overwrite start.ply and the section `start` of scene.toml.
    #[arg(short, long)]
    force: bool,
}

/// Sources of points.
#[derive(Clone, Copy, ValueEnum)]
enum From {
    /// The data's own points, or a COLMAP model in the folder.
    Colmap,
    /// Depth maps of training views.
    Depth,
    /// The visual hull of alpha or masks.
    Hull,
    /// Uniform in the box.
    Random,
}

fn positive(text: &str) -> Result<f32, String> {
    crate::parse::finite(text).and_then(|v| if v > 0.0 { Ok(v) } else { Err("give a length above 0".to_owned()) })
}

impl Init {
    pub fn run(self, global: &Global) -> Result<Answer, Failure> {
        if let Some(other) = self.sets.iter().find(|s| !s.starts_with("data.")) {
            return Err(Failure::usage(format!("`{other}` is no setting of the data")));
        }
        // Every method reads its data by the same settings.
        let method = "static3d".to_owned();
        let request = Request { method, preset: "fast".into(), sets: self.sets.clone(), ..Request::default() };
        let options = resolve(gs_methods::registry(), &request)?.data;
        let options = DataOptions { layout: self.layout.clone().or(options.layout.clone()), ..options };
        let mut data = Dataset::open(&self.data, &options)?;
        let bounds = self.bound.map(cube);
        data.bounds = bounds.or(data.bounds);
        let from = self.from.map(|f| match f {
            From::Colmap => StartFrom::Colmap,
            From::Depth => StartFrom::Depth,
            From::Hull => StartFrom::Hull,
            From::Random => StartFrom::Random,
        });
        let mut start = data.start(from, self.points as usize, self.seed)?;
        start.bounds = bounds;
        let files = write_start(&self.data, &start, self.force)?;
        global.detail(format!("layout {}", data.layout));
        let (count, source) = (start.cloud.positions.len(), start.from.name());
        let [low, high] = bounds.unwrap_or_else(|| data.scene_bounds());
        let text = format!(
            "{count} points from {source}, in the box {low:.2} to {high:.2}\nwrote {} and the section [start] of {}\n",
            files[0].display(),
            files[1].display()
        );
        let json = json!({
            "points": count,
            "from": source,
            "bounds": [low.to_array(), high.to_array()],
            "files": files.map(|f| f.display().to_string()),
        });
        Ok(Answer::new(text, json))
    }
}
