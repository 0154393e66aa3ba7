//! What each stage of a new frame of a filmed person takes (DUT's protocol): pictures in memory, everything else computed
//! anew, frames before the first that counts thrown away.

use gs_core::{Camera, Image};
use gs_data::avatar::AvatarFrame;
use gs_method_texel::{Dut, FrameError};
use gs_raster::{Workspace, render};
use gs_texel::bvh::Tracer;
use gs_texel::texels::{TexelOptions, TexelTable};
use serde::Serialize;
use std::time::Instant;

/// Names of the stages, in their order.
pub const STAGES: [&str; 6] = ["pose", "first texture", "GeoNet", "second texture", "GauNet", "render"];
/// Frames whose pictures are kept in memory.
const MOST_FRAMES: usize = 16;

/// How stages are measured.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct StageOptions {
    /// Frames thrown away before each repeat.
    pub warm_up: usize,
    /// Frames that count, at least one.
    pub frames: usize,
    /// How often.
    pub repeats: usize,
    /// Side of the square frame drawn, pixels.
    pub size: u32,
}

impl Default for StageOptions {
    /// As DUT was measured: 10 and 100 frames, three times.
    fn default() -> Self {
        Self { warm_up: 10, frames: 100, repeats: 3, size: 512 }
    }
}

/// Milliseconds over frames.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Spread {
    /// Mean.
    pub mean: f64,
    /// Standard deviation.
    pub deviation: f64,
    /// Least.
    pub least: f64,
}

/// A stage.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Stage {
    /// Its name.
    pub name: &'static str,
    /// What it takes.
    pub ms: Spread,
    /// What it and all before it take.
    pub accumulated: Spread,
}

/// What a new frame takes.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct StageTimes {
    /// Threads in the pool.
    pub threads: usize,
    /// Frames that counted.
    pub frames: usize,
    /// Texels per side: unprojected, of GeoNet, of GauNet.
    pub textures: [usize; 3],
    /// Milliseconds of what is made once per person.
    pub once: Vec<(&'static str, f64)>,
    /// In order.
    pub stages: Vec<Stage>,
}

impl StageTimes {
    /// Mean milliseconds of a whole frame.
    pub fn total(&self) -> f64 {
        self.stages.last().map_or(0.0, |s| s.accumulated.mean)
    }

    /// For people: stage, its own and accumulated time, then what is made once.
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

/// Measures a method on the frames of its film, in the rayon pool in scope.
///
/// # Errors
/// If a picture cannot be read or a frame cannot be made.
pub fn stage_times(dut: &Dut, options: &StageOptions) -> Result<StageTimes, FrameError> {
    let actor = dut.actor();
    let frames: Vec<&AvatarFrame> = actor.scene.frames.iter().take(MOST_FRAMES).collect();
    let photographs = frames.iter().map(|f| actor.images(f)).collect::<Result<Vec<_>, _>>()?;
    let mut bench = Bench { dut, workspace: Workspace::new(), rows: Vec::new(), size: options.size };
    let mut times: Vec<[f64; STAGES.len()]> = Vec::new();
    for _ in 0..options.repeats.max(1) {
        for k in 0..options.warm_up + options.frames.max(1) {
            let ms = bench.frame(frames[k % frames.len()], &photographs[k % frames.len()])?;
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

/// What is made once per person.
fn once(dut: &Dut) -> Vec<(&'static str, f64)> {
    let actor = dut.actor();
    let t = &actor.scene.character.template;
    let ms = |begun: Instant| begun.elapsed().as_secs_f64() * 1e3;
    let begun = Instant::now();
    for table in [&actor.fine, &actor.geo, &actor.gau] {
        // It was made of the same before.
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
    /// Milliseconds of the stages of a frame.
    fn frame(
        &mut self,
        frame: &AvatarFrame,
        photographs: &[(Camera, Image)],
    ) -> Result<[f64; STAGES.len()], FrameError> {
        let (dut, actor) = (self.dut, self.dut.actor());
        let mut marks = vec![Instant::now()];
        let posed = actor.pose(frame);
        marks.push(Instant::now());
        let first = actor.first_of(posed, photographs)?;
        marks.push(Instant::now());
        let offsets = dut.offsets(&first)?;
        marks.push(Instant::now());
        let second = actor.second_of(&first, offsets, photographs)?;
        marks.push(Instant::now());
        dut.rows(&second, &mut self.rows)?;
        let splats = dut.decode(&self.rows, &second)?;
        marks.push(Instant::now());
        if let Some((camera, _)) = photographs.first() {
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
