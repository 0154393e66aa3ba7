//! Text tables.

/// A table as lines of text: columns as wide as their widest cell, two spaces apart. Columns for which `left` is true are
/// aligned to the left, the others to the right. Every row has one cell per heading.
///
/// ```
/// let rows = [vec!["a".to_owned(), "1.5".to_owned()], vec!["long".to_owned(), "10".to_owned()]];
/// assert_eq!(gs4d_lab::aligned(&["name", "ms"], &rows, |column| column == 0), "name   ms\na     1.5\nlong   10\n");
/// ```
pub fn aligned(head: &[&str], rows: &[Vec<String>], left: impl Fn(usize) -> bool) -> String {
    let width = |c: usize| rows.iter().map(|r| r[c].chars().count()).fold(head[c].chars().count(), usize::max);
    let widths: Vec<usize> = (0..head.len()).map(width).collect();
    let line = |cells: &mut dyn Iterator<Item = &str>| {
        let padded = cells
            .zip(&widths)
            .enumerate()
            .map(|(c, (cell, &w))| if left(c) { format!("{cell:<w$}") } else { format!("{cell:>w$}") });
        padded.collect::<Vec<_>>().join("  ").trim_end().to_owned() + "\n"
    };
    let body = rows.iter().map(|r| line(&mut r.iter().map(String::as_str)));
    std::iter::once(line(&mut head.iter().copied())).chain(body).collect()
}
