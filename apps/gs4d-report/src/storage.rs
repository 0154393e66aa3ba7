//! Storage of a scene by block of parameters (MB = 10⁶ bytes).
//!
//! A block holds the parameters whose names have the same first two parts. A method may also report the sizes by the counting
//! rule of its paper, and what rendering needs ([`PaperStorage`]).

use gs_core::Params;
use gs_train::capabilities::PaperStorage;
use serde::Serialize;

/// The storage of a scene.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Storage {
    /// Blocks in the order of the parameters.
    pub blocks: Vec<StoredBlock>,
    /// The same scene by the counting rule of its paper, where there is one.
    pub paper: Option<PaperStorage>,
}

/// The parameters of one block.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct StoredBlock {
    /// Name of the block, for example `field.planes`.
    pub block: String,
    /// Number of values, 4 bytes each as `f32`.
    pub values: usize,
}

/// The first two parts of a dotted parameter name: its block.
///
/// ```
/// assert_eq!(gs4d_report::storage::block_of("field.planes.xy.0"), "field.planes");
/// ```
pub fn block_of(name: &str) -> &str {
    let end = name.match_indices('.').nth(1).map_or(name.len(), |(at, _)| at);
    &name[..end]
}

impl Storage {
    /// Counts the parameters of a scene; `paper` is its table by the published rule.
    pub fn of(scene: &dyn Params, paper: Option<PaperStorage>) -> Self {
        let mut blocks: Vec<StoredBlock> = Vec::new();
        scene.visit(&mut |p| {
            let block = block_of(&p.name);
            match blocks.iter_mut().find(|b| b.block == block) {
                Some(b) => b.values += p.len(),
                None => blocks.push(StoredBlock { block: block.to_owned(), values: p.len() }),
            }
        });
        Self { blocks, paper }
    }

    /// Bytes of all values as `f32`.
    pub fn bytes(&self) -> usize {
        4 * self.blocks.iter().map(|b| b.values).sum::<usize>()
    }

    /// The blocks and their sizes as a table for a terminal.
    pub fn to_text(&self) -> String {
        let mb = |bytes: usize| format!("{:.3}", bytes as f64 / 1e6);
        let mut out = format!("{:30}{:>12}{:>12}{:>12}\n", "storage", "values", "f32 MB", "f16 MB");
        for b in &self.blocks {
            out.push_str(&format!("{:30}{:>12}{:>12}{:>12}\n", b.block, b.values, mb(4 * b.values), mb(2 * b.values)));
        }
        let (all, bytes) = (self.bytes() / 4, self.bytes());
        out.push_str(&format!("{:30}{all:>12}{:>12}{:>12}\n", "all", mb(bytes), mb(bytes / 2)));
        let Some(paper) = &self.paper else { return out };
        out.push_str(&format!(
            "\n{:30}{:>12}{:>12}{:>14}{:>12}\n",
            "as published", "values", "paper MB", "as needed MB", "f16 MB"
        ));
        let mut line = |block: &str, values: usize, paper: usize, needed: usize| {
            let [p, n, half] = [paper, needed, needed / 2].map(mb);
            out.push_str(&format!("{block:30}{values:>12}{p:>12}{n:>14}{half:>12}\n"));
        };
        for r in &paper.rows {
            line(&r.block, r.needed_values, 4 * r.paper_values, 4 * r.needed_values);
        }
        line("all", paper.needed_bytes() / 4, paper.paper_bytes(), paper.needed_bytes());
        for (block, bytes) in &paper.unused {
            out.push_str(&format!("{:30}{:>12}{:>12}  left in the folder, not counted\n", block, "", mb(*bytes)));
        }
        out
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use gs_core::Param;

    struct Blocks(Vec<Param>);

    impl Params for Blocks {
        fn visit(&self, f: &mut dyn FnMut(&Param)) {
            self.0.iter().for_each(f);
        }

        fn visit_mut(&mut self, f: &mut dyn FnMut(&mut Param)) {
            self.0.iter_mut().for_each(f);
        }
    }

    #[test]
    fn blocks_are_the_first_two_parts_of_names() {
        assert_eq!(["a", "a.b", "a.b.c", "lgd.planes.xy.0"].map(block_of), ["a", "a.b", "a.b", "lgd.planes"]);
        let scene = Blocks(vec![
            Param::rows("cloud.means", 3, vec![0.0; 30]),
            Param::shared("field.planes.xy.0", vec![0.0; 100]),
            Param::shared("field.planes.xz.0", vec![0.0; 50]),
        ]);
        let storage = Storage::of(&scene, None);
        let blocks: Vec<_> = storage.blocks.iter().map(|b| (b.block.as_str(), b.values)).collect();
        assert_eq!(blocks, [("cloud.means", 30), ("field.planes", 150)]);
        assert_eq!(storage.bytes(), 720);
        assert_eq!(storage.to_text().lines().count(), 4);
    }
}
