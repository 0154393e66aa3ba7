//! The linear assignment problem (Kuhn 1955, Munkres 1957), solved by shortest augmenting paths with potentials (Jonker and
//! Volgenant 1987).

/// The column of each row such that the sum of `cost[row * columns + column]` is minimal, one to one. The smaller side is
/// assigned completely; rows without a column are `None`. `O(n² m)` for `n ≤ m`; ties are broken by position. Costs must be
/// finite.
///
/// ```
/// use gs_metrics::segmentation::assign;
/// // Taking the cheapest entry, 1, first would cost 1 + 9; the best sum is 2 + 3.
/// assert_eq!(assign(&[1.0, 2.0, 3.0, 9.0], 2, 2), [Some(1), Some(0)]);
/// ```
///
/// # Panics
/// In debug builds, if there are not `rows · columns` costs.
pub fn assign(cost: &[f64], rows: usize, columns: usize) -> Vec<Option<usize>> {
    debug_assert_eq!(cost.len(), rows * columns);
    let mut out = vec![None; rows];
    if rows <= columns {
        let pairs = solve(rows, columns, |r, c| cost[r * columns + c]);
        pairs.into_iter().enumerate().for_each(|(r, c)| out[r] = Some(c));
    } else {
        let pairs = solve(columns, rows, |c, r| cost[r * columns + c]);
        pairs.into_iter().enumerate().for_each(|(c, r)| out[r] = Some(c));
    }
    out
}

/// The column of each of `n` rows among `m ≥ n` columns.
fn solve(n: usize, m: usize, cost: impl Fn(usize, usize) -> f64) -> Vec<usize> {
    const NONE: usize = usize::MAX;
    // Column m is the start of every augmenting path.
    let (mut of_row, mut of_column) = (vec![0.0; n], vec![0.0; m + 1]);
    let mut row_at = vec![NONE; m + 1];
    for row in 0..n {
        row_at[m] = row;
        let mut column = m;
        let (mut min_cost, mut previous) = (vec![f64::INFINITY; m], vec![m; m]);
        let mut used = vec![false; m + 1];
        while row_at[column] != NONE {
            used[column] = true;
            let r = row_at[column];
            let (mut step, mut next) = (f64::INFINITY, NONE);
            for c in (0..m).filter(|&c| !used[c]) {
                let reduced = cost(r, c) - of_row[r] - of_column[c];
                if reduced < min_cost[c] {
                    (min_cost[c], previous[c]) = (reduced, column);
                }
                if min_cost[c] < step || next == NONE {
                    (step, next) = (min_cost[c], c);
                }
            }
            for c in 0..=m {
                if used[c] {
                    of_row[row_at[c]] += step;
                    of_column[c] -= step;
                } else {
                    min_cost[c] -= step;
                }
            }
            column = next;
        }
        while column != m {
            row_at[column] = row_at[previous[column]];
            column = previous[column];
        }
    }
    let mut out = vec![0; n];
    (0..m).filter(|&c| row_at[c] != NONE).for_each(|c| out[row_at[c]] = c);
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use gs_core::Rng;

    fn total(cost: &[f64], columns: usize, pairs: &[Option<usize>]) -> f64 {
        pairs.iter().enumerate().filter_map(|(r, c)| c.map(|c| cost[r * columns + c])).sum()
    }

    /// The minimal sum over every injective assignment of the rows from `row` on.
    fn brute(cost: &[f64], rows: usize, columns: usize, row: usize, used: &mut Vec<bool>, left: usize) -> f64 {
        if row == rows || left == 0 {
            return if left == 0 { 0.0 } else { f64::INFINITY };
        }
        let skip = if rows - row > left { brute(cost, rows, columns, row + 1, used, left) } else { f64::INFINITY };
        let mut best = skip;
        for c in 0..columns {
            if !used[c] {
                used[c] = true;
                best = best.min(cost[row * columns + c] + brute(cost, rows, columns, row + 1, used, left - 1));
                used[c] = false;
            }
        }
        best
    }

    #[test]
    fn brute_force_agrees_for_every_shape() {
        for case in 0..300u64 {
            let mut rng = Rng::new(1, "assign", 0, case);
            let (rows, columns) = (rng.below(6) as usize, rng.below(6) as usize);
            let coarse = case % 2 == 0;
            let sample = |rng: &mut Rng| if coarse { f64::from(rng.below(4)) } else { f64::from(rng.normal()) };
            let cost: Vec<f64> = (0..rows * columns).map(|_| sample(&mut rng)).collect();
            let pairs = assign(&cost, rows, columns);
            let mut taken: Vec<usize> = pairs.iter().flatten().copied().collect();
            assert_eq!(taken.len(), rows.min(columns), "the smaller side is complete");
            taken.sort_unstable();
            taken.dedup();
            assert_eq!(taken.len(), rows.min(columns), "one to one");
            let want = brute(&cost, rows, columns, 0, &mut vec![false; columns], rows.min(columns));
            assert!((total(&cost, columns, &pairs) - want).abs() < 1e-12, "{case}: {rows}x{columns}");
        }
    }
}
