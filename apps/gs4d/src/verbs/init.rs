//! `gs4d init`: initial points and the bounding box of the scene; cameras of a filmed person.

use crate::answer::Answer;
use crate::failure::Failure;
use crate::global::Global;
use crate::opening::Reading;
use clap::ValueEnum;
use gs_data::avatar::layout::Role;
use gs_data::avatar::rig::{RigOptions, WrittenCamera, write_rig};
use gs_data::{Dataset, StartFrom, cube, write_start};
use serde_json::json;
use std::path::{Path, PathBuf};

/// Most points, unless more or fewer are asked for.
const POINTS: u32 = 20_000;

/// Make initial points (start.ply) and write them, and the bounding box, into the folder's scene.toml; or write a rig's cameras.json
#[derive(clap::Args)]
pub struct Init {
    /// The folder.
    #[arg(value_name = "DATA")]
    data: PathBuf,
    /// Where points come from [default: the first of these that has any].
    #[arg(long, value_enum)]
    from: Option<From>,
    /// At most so many.
    #[arg(long, default_value_t = POINTS, value_parser = clap::value_parser!(u32).range(1..=10_000_000))]
    points: u32,
    /// Half the side of the box around the origin, world units [default: the box of the layout or of the cameras].
    #[arg(long, value_name = "HALF", value_parser = positive)]
    bound: Option<f32>,
    /// Seed of every random number.
    #[arg(long, default_value_t = 0)]
    seed: u64,
    #[command(flatten)]
    reading: Reading,
    /// Write cameras.json of a filmed person from another program's cameras: OpenCV's intri.yml with extri.yml beside it (EasyMocap), or
    /// the folder of a COLMAP model with one image per camera.
    #[arg(long, value_name = "FILE|DIR", conflicts_with_all = ["from", "bound"])]
    cameras: Option<PathBuf>,
    /// With --cameras: metres per unit of that file (0.001 for millimetres).
    #[arg(long, value_name = "METRES", default_value_t = 1.0, value_parser = positive, requires = "cameras")]
    camera_unit: f32,
    /// With --cameras: numbers of the conditioning cameras [default: four, far from each other].
    #[arg(long, value_name = "ID,ID", value_delimiter = ',', requires = "cameras")]
    conditioning: Vec<u32>,
    /// With --cameras: numbers of the cameras that are held out for scores.
    #[arg(long, value_name = "ID,ID", value_delimiter = ',', requires = "cameras")]
    held_out: Vec<u32>,
    /// Overwrite start.ply and the section `start` of scene.toml, or cameras.json.
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
    /// Points of a folder with these settings, as they are made without other flags, in place of those that were made before.
    pub fn of(data: PathBuf, sets: Vec<String>) -> Self {
        Self {
            data,
            from: None,
            points: POINTS,
            bound: None,
            seed: 0,
            reading: Reading::of(sets),
            cameras: None,
            camera_unit: 1.0,
            conditioning: Vec::new(),
            held_out: Vec::new(),
            force: true,
        }
    }

    pub fn run(self, global: &Global) -> Result<Answer, Failure> {
        match &self.cameras {
            Some(source) => self.rig(source),
            None => self.points(global),
        }
    }

    fn rig(&self, source: &Path) -> Result<Answer, Failure> {
        let options = RigOptions {
            unit: f64::from(self.camera_unit),
            conditioning: self.conditioning.clone(),
            held_out: self.held_out.clone(),
            overwrite: self.force,
        };
        let cameras = write_rig(&self.data, source, &options)?;
        let role = |role: Role| Role::NAMES.iter().find(|r| r.1 == role).map_or("", |r| r.0);
        let line = |c: &WrittenCamera| {
            let [w, h] = c.size;
            format!(
                "{:>4}  {:5}  {w}x{h}  at {:.2} m  {}  images/{:03}/\n",
                c.id,
                role(c.role),
                c.position,
                c.name,
                c.id
            )
        };
        let lines: String = cameras.iter().map(line).collect();
        let file = self.data.join("cameras.json");
        let text = format!(
            "{lines}wrote {}; gs4d doctor {} holds it against the images\n",
            file.display(),
            self.data.display()
        );
        let of = |c: &WrittenCamera| json!({"id": c.id, "name": c.name, "role": role(c.role), "size": c.size, "position": c.position.to_array()});
        Ok(Answer::new(text, json!({"file": file, "cameras": cameras.iter().map(of).collect::<Vec<_>>()})))
    }

    fn points(self, global: &Global) -> Result<Answer, Failure> {
        // Points that this command wrote before are not those of the data.
        let mut data = Dataset::open_without_start(&self.data, &self.reading.options()?)?;
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
