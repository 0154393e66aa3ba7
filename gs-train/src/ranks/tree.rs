//! The aligned binary tree over the leaves of a sum.
//!
//! A node over `n` leaves has a left child over the largest power of two below `n`, and a right child over the rest. Which
//! nodes there are does not depend on who computes them, so neither does the order of additions.

use std::ops::Range;

/// A node: the leaves `from..to`.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Node {
    /// First leaf.
    pub from: usize,
    /// One past the last leaf.
    pub to: usize,
}

impl Node {
    /// The children; none of a leaf.
    pub fn children(self) -> Option<[Self; 2]> {
        let count = self.to - self.from;
        let middle = self.from + count.next_power_of_two() / 2;
        (count > 1).then_some([Self { to: middle, ..self }, Self { from: middle, ..self }])
    }

    /// The largest nodes at or below this one whose leaves all lie in `run`, in the order of leaves.
    pub fn within(self, run: &Range<usize>) -> Vec<Self> {
        if self.to <= run.start || run.end <= self.from || self.from == self.to {
            return Vec::new();
        }
        if run.start <= self.from && self.to <= run.end {
            return vec![self];
        }
        self.children().into_iter().flatten().flat_map(|child| child.within(run)).collect()
    }

    /// The sum at this node, of sums at some of the nodes below: `part` gives one where there is one, `add` adds the second to
    /// the first.
    pub fn sum<T>(self, part: &mut impl FnMut(Self) -> Option<T>, add: &mut impl FnMut(&mut T, T)) -> Option<T> {
        if let Some(sum) = part(self) {
            return Some(sum);
        }
        let [left, right] = self.children()?;
        let mut sum = left.sum(part, add)?;
        let right = right.sum(part, add)?;
        add(&mut sum, right);
        Some(sum)
    }
}

/// The run of `count` things that belongs to a rank; lower ranks have more where they cannot be even.
pub fn run_of(count: usize, rank: usize, ranks: usize) -> Range<usize> {
    (rank * count).div_ceil(ranks)..((rank + 1) * count).div_ceil(ranks)
}

#[cfg(test)]
mod tests {
    use super::*;

    const ROOT: Node = Node { from: 0, to: 7 };

    #[test]
    fn children_are_aligned_to_powers_of_two() {
        let [left, right] = ROOT.children().unwrap();
        assert_eq!((left, right), (Node { from: 0, to: 4 }, Node { from: 4, to: 7 }));
        assert_eq!(right.children().unwrap(), [Node { from: 4, to: 6 }, Node { from: 6, to: 7 }]);
        assert_eq!(Node { from: 6, to: 7 }.children(), None);
    }

    #[test]
    fn runs_cover_everything_once_and_the_first_rank_is_never_idle() {
        for (count, ranks) in [(1, 1), (1, 4), (7, 3), (12, 5), (256, 9)] {
            let runs: Vec<usize> = (0..ranks).flat_map(|r| run_of(count, r, ranks)).collect();
            assert_eq!(runs, (0..count).collect::<Vec<_>>());
            assert!(!run_of(count, 0, ranks).is_empty());
        }
    }

    #[test]
    fn a_sum_has_the_same_bits_for_any_number_of_ranks() {
        let leaf = |i: usize| (1.0 + i as f32).sqrt() * f32::exp2((i * 7 % 40) as f32 - 20.0);
        for leaves in 1..=33 {
            let root = Node { from: 0, to: leaves };
            let alone =
                |node: Node| node.sum(&mut |n| (n.children().is_none()).then(|| leaf(n.from)), &mut add).unwrap();
            fn add(a: &mut f32, b: f32) {
                *a += b;
            }
            for ranks in 1..=9 {
                let nodes: Vec<Node> = (0..ranks).flat_map(|r| root.within(&run_of(leaves, r, ranks))).collect();
                let parts: Vec<(Node, f32)> = nodes.into_iter().map(|n| (n, alone(n))).collect();
                let mut part = |n: Node| parts.iter().find(|p| p.0 == n).map(|p| p.1);
                let sum = root.sum(&mut part, &mut add).unwrap();
                assert_eq!(sum.to_bits(), alone(root).to_bits(), "{leaves} leaves, {ranks} ranks");
            }
        }
    }

    #[test]
    fn a_missing_part_is_noticed() {
        assert_eq!(ROOT.sum(&mut |n| (n.to <= 4).then_some(1), &mut |a, b| *a += b), None);
    }
}
