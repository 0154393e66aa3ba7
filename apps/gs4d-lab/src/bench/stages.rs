//! Time of each stage of a new avatar frame, with DUT's protocol: input images are in memory, everything else is computed per
//! frame, and warm-up frames are discarded.

use gs_core::{Camera, Image};
use gs_data::avatar::AvatarFrame;
use gs_method_texel::{Dut, FrameError};
use gs_raster::{Workspace, render};
use gs_texel::bvh::Tracer;
use gs_texel::texels::{TexelOptions, TexelTable};
use serde::Serialize;
use std::time::Instant;

/// Names of the stages, in order of execution.
pub const STAGES: [&str; 6] = ["pose", "first texture", "GeoNet", "second texture", "GauNet", "render"];
/// Most distinct frames whose input images are kept in memory.
const MAX_FRAMES: usize = 16;

/// How many frames are timed, and at what size they are rendered.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StageOptions {
    /// Untimed frames before each repeat.
    pub warm_up: usize,
    /// Timed frames per repeat; 0 counts as 1.
    pub frames: usize,
    /// Repeats; 0 counts as 1.
    pub repeats: usize,
    /// Side of the rendered square frame, pixels.
    pub size: u32,
}

impl Default for StageOptions {
    /// DUT's protocol: 10 warm-up and 100 timed frames, three repeats, 512 pixels.
    fn default() -> Self {
        Self { warm_up: 10, frames: 100, repeats: 3, size: 512 }
    }
}

/// Statistics of a time over the timed frames, milliseconds.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Spread {
    /// Mean over frames.
    pub mean: f64,
    /// Standard deviation over frames (`n − 1`).
    pub deviation: f64,
    /// Minimum over frames.
    pub least: f64,
}

/// Times of one stage.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Stage {
    /// One of [`STAGES`].
    pub name: &'static str,
    /// Time of this stage.
    pub ms: Spread,
    /// Time of this stage and all before it.
    pub accumulated: Spread,
}

/// Times of all stages of a new frame.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct StageTimes {
    /// Threads of the rayon pool.
    pub threads: usize,
    /// Timed frames over all repeats.
    pub frames: usize,
    /// Texels per side of the unprojected texture, of GeoNet and of GauNet.
    pub textures: [usize; 3],
    /// Name and milliseconds of what is computed once per avatar, not per frame.
    pub once: Vec<(&'static str, f64)>,
    /// One entry per stage, in the order of [`STAGES`].
    pub stages: Vec<Stage>,
}

impl StageTimes {
    /// Mean milliseconds of a whole frame.
    pub fn total(&self) -> f64 {
        self.stages.last().map_or(0.0, |s| s.accumulated.mean)
    }

    /// A text table: own and accumulated time of each stage, then the one-time costs.
    pub fn text(&self) -> String {
        let [fine, geo, gau] = self.textures;
        let mut text = format!(
            "{} frames on {} threads; textures {fine}, GeoNet {geo}, GauNet {gau}\n{:16} {:>9} {:>8} {:>9} {:>12}\n",
            self.frames, self.threads, "stage", "ms", "±", "least", "accumulated"
        );
        for Stage { name, ms, accumulated } in &self.stages {
            let Spread { mean, deviation, least } = ms;
            text.push_str(&format!("{name:16} {mean:9.2} {deviation:8.2} {least:9.2} {:12.2}\n", accumulated.mean));
        }
        text.push_str(&format!("{:.2} ms a frame, {:.2} frames a second\n", self.total(), 1e3 / self.total()));
        self.once.iter().for_each(|(name, ms)| text.push_str(&format!("once: {name} {ms:.2} ms\n")));
        text
    }
}

/// Times `dut` on the frames of its dataset, in the current rayon pool.
///
/// # Errors
/// If an input image cannot be read or a frame cannot be computed.
pub fn stage_times(dut: &Dut, options: &StageOptions) -> Result<StageTimes, FrameError> {
    let actor = dut.actor();
    let frames: Vec<&AvatarFrame> = actor.scene.frames.iter().take(MAX_FRAMES).collect();
    let images = frames.iter().map(|f| actor.images(f)).collect::<Result<Vec<_>, _>>()?;
    let mut bench = Bench { dut, workspace: Workspace::new(), rows: Vec::new(), size: options.size };
    let mut times: Vec<[f64; STAGES.len()]> = Vec::new();
    for _ in 0..options.repeats.max(1) {
        for k in 0..options.warm_up + options.frames.max(1) {
            let ms = bench.frame(frames[k % frames.len()], &images[k % frames.len()])?;
            if k >= options.warm_up {
                times.push(ms);
            }
        }
    }
    let of = |value: &dyn Fn(&[f64; STAGES.len()]) -> f64| spread(&times.iter().map(value).collect::<Vec<_>>());
    let stage = |(k, &name): (usize, &&'static str)| Stage {
        name,
        ms: of(&|t| t[k]),
        accumulated: of(&|t| t[..=k].iter().sum()),
    };
    Ok(StageTimes {
        threads: rayon::current_num_threads(),
        frames: times.len(),
        textures: [actor.fine.size, actor.geo.size, actor.gau.size],
        once: once(dut),
        stages: STAGES.iter().enumerate().map(stage).collect(),
    })
}

fn spread(values: &[f64]) -> Spread {
    let n = values.len().max(1) as f64;
    let mean = values.iter().sum::<f64>() / n;
    let squares: f64 = values.iter().map(|v| (v - mean).powi(2)).sum();
    let least = values.iter().copied().fold(f64::INFINITY, f64::min);
    Spread { mean, deviation: (squares / (n - 1.0).max(1.0)).sqrt(), least }
}

/// Name and milliseconds of what is computed once per avatar.
fn once(dut: &Dut) -> Vec<(&'static str, f64)> {
    let actor = dut.actor();
    let t = &actor.scene.character.template;
    let ms = |begun: Instant| begun.elapsed().as_secs_f64() * 1e3;
    let begun = Instant::now();
    for table in [&actor.fine, &actor.geo, &actor.gau] {
        // The same arguments succeeded when the method was built.
        let _ = TexelTable::build(&t.faces, &t.uvs, &t.face_uvs, table.size, &TexelOptions::default());
    }
    let tables = ms(begun);
    let begun = Instant::now();
    let _ = Tracer::new(&t.vertices, &t.faces);
    vec![("texel tables", tables), ("tree of triangles (rules with rays)", ms(begun))]
}

struct Bench<'a> {
    dut: &'a Dut,
    workspace: Workspace,
    rows: Vec<f32>,
    size: u32,
}

impl Bench<'_> {
    /// Milliseconds of each stage of one frame.
    fn frame(&mut self, frame: &AvatarFrame, images: &[(Camera, Image)]) -> Result<[f64; STAGES.len()], FrameError> {
        let (dut, actor) = (self.dut, self.dut.actor());
        let mut marks = vec![Instant::now()];
        let posed = actor.pose(&frame.pose);
        marks.push(Instant::now());
        let first = actor.first_of(posed, images)?;
        marks.push(Instant::now());
        let offsets = dut.offsets(&first)?;
        marks.push(Instant::now());
        let second = actor.second_of(&first, offsets, images)?;
        marks.push(Instant::now());
        dut.rows(&second, &mut self.rows)?;
        let splats = dut.decode(&self.rows, &second)?;
        marks.push(Instant::now());
        if let Some((camera, _)) = images.first() {
            let camera = camera.scaled(f64::from(self.size) / f64::from(camera.width));
            render(&splats, &camera, &dut.raster_options(), &mut self.workspace);
        }
        marks.push(Instant::now());
        Ok(std::array::from_fn(|k| (marks[k + 1] - marks[k]).as_secs_f64() * 1e3))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn spreads() {
        assert_eq!(spread(&[1.0, 3.0]), Spread { mean: 2.0, deviation: 2f64.sqrt(), least: 1.0 });
        assert_eq!(spread(&[5.0]).deviation, 0.0);
    }
}
