//! An outcome as text and as a page; a table before it is run.

use crate::column::Column;
use crate::outcome::{EntryOutcome, Order, Outcome, SceneOutcome, Value, Verdict};
use crate::table::Table;
use gs4d_lab::aligned;
use gs4d_report::html::{self, escape, section};

const DASH: &str = "–";

fn digits(column: &str) -> usize {
    Column::named(column).map_or(2, |c| c.digits)
}

fn number(value: Option<f64>, digits: usize) -> String {
    value.map_or(DASH.to_owned(), |v| format!("{v:.digits$}"))
}

/// Ours, its spread, the published figure.
fn cell(value: &Value, digits: usize) -> [String; 2] {
    let ours = value.ours.map_or(DASH.to_owned(), |s| match s.deviation > 0.0 {
        true => format!("{:.digits$} ±{:.digits$}", s.mean, s.deviation),
        false => format!("{:.digits$}", s.mean),
    });
    [ours, number(value.published, digits)]
}

/// Head and rows of all scenes: a column of ours and one of the paper's each, without those that hold nothing.
fn rows(outcome: &Outcome) -> (Vec<String>, Vec<Vec<String>>) {
    let entries = || outcome.scenes.iter().flat_map(|s| &s.entries);
    let shown: Vec<(usize, bool, bool)> = (0..outcome.columns.len())
        .map(|c| {
            let any = |of: fn(&Value) -> bool| entries().any(|e| e.values.get(c).is_some_and(of));
            (c, any(|v| v.ours.is_some()), any(|v| v.published.is_some()))
        })
        .collect();
    let head = shown.iter().flat_map(|&(c, ours, published)| {
        let name = &outcome.columns[c];
        [ours.then(|| name.clone()), published.then(|| format!("{name} published"))].into_iter().flatten()
    });
    let head = ["scene", "entry"].map(str::to_owned).into_iter().chain(head);
    let differ = entries().any(|e| e.values.first().and_then(Value::difference).is_some());
    let rest = ["less published", "proxy", "MB", "seconds", "seeds"].into_iter().skip(usize::from(!differ));
    let head = head.chain(rest.map(str::to_owned)).collect();
    let row = |scene: &SceneOutcome, e: &EntryOutcome| {
        let cells = shown.iter().flat_map(|&(c, ours, published)| {
            let [a, b] = e.values.get(c).map_or_else(Default::default, |v| cell(v, digits(&outcome.columns[c])));
            [ours.then_some(a), published.then_some(b)].into_iter().flatten()
        });
        let difference = e.values.first().and_then(Value::difference);
        let difference = difference.map_or(DASH.to_owned(), |d| format!("{d:+.2}"));
        let rest = [
            difference,
            number(e.perceptual_proxy, 4),
            number(e.megabytes, 2),
            number(e.seconds, 0),
            e.seeds.len().to_string(),
        ];
        let rest = rest.into_iter().skip(usize::from(!differ));
        [scene.scene.clone(), e.entry.clone()].into_iter().chain(cells).chain(rest).collect()
    };
    let rows = outcome.scenes.iter().flat_map(|s| s.entries.iter().map(move |e| row(s, e))).collect();
    (head, rows)
}

/// What an order says, in one sentence.
pub fn sentence(first: &str, order: &Order, unit: &str) -> String {
    let Order { other, published, ours, half_width, scenes, pairs, verdict } = order;
    let over = if *scenes > 0 { format!(" over {scenes} scenes") } else { String::new() };
    let here = match (ours, half_width) {
        (Some(ours), Some(half)) => format!("here {ours:+.2} ±{half:.2}{unit} (95 %{over}, {pairs} pairs)"),
        (Some(ours), None) => format!("here {ours:+.2}{unit} (one pair)"),
        (None, _) => "not run here".to_owned(),
    };
    let printed = published.map_or("not published".to_owned(), |p| format!("published {p:+.2}{unit}"));
    let verdict = match verdict {
        Some(Verdict::AsPublished) => ": the order is the published one",
        Some(Verdict::Opposite) => ": the order is the opposite",
        Some(Verdict::NotShown) => ": no order is shown",
        None => "",
    };
    format!("{first} less {other}: {printed}; {here}{verdict}.")
}

fn sentences(outcome: &Outcome) -> Vec<String> {
    let (first, unit) = (first_entry(outcome), unit(outcome));
    outcome.orders.iter().map(|o| sentence(first, o, unit)).collect()
}

/// The entry that the others are compared with.
pub(crate) fn first_entry(outcome: &Outcome) -> &str {
    outcome.scenes.first().and_then(|s| s.entries.first()).map_or("", |e| &e.entry)
}

/// Unit of the column that decides the order, with a space before it.
pub(crate) fn unit(outcome: &Outcome) -> &'static str {
    if outcome.columns.first().is_some_and(|c| c.ends_with("psnr")) { " dB" } else { "" }
}

/// The outcome as text.
pub fn text(outcome: &Outcome) -> String {
    let (head, rows) = rows(outcome);
    let head: Vec<&str> = head.iter().map(String::as_str).collect();
    let mut text = format!("{} ({})\n", outcome.title, outcome.source);
    text.push_str(&format!("published: {}\nhere: {}\n\n", outcome.protocol, outcome.conditions));
    text.push_str(&aligned(&head, &rows, |column| column < 2));
    text.push_str("± one standard deviation over seeds\n\n");
    sentences(outcome).iter().for_each(|s| text.push_str(&format!("{s}\n")));
    let without: Vec<Vec<String>> = outcome.not_run.iter().map(|n| vec![n.what.clone(), n.why.clone()]).collect();
    if !without.is_empty() {
        text.push_str("\nwithout a result:\n");
        text.push_str(&aligned(&["what", "why"], &without, |_| true));
    }
    text
}

/// The outcome as a self-contained page.
pub fn html(outcome: &Outcome) -> String {
    let (head, rows) = rows(outcome);
    let head: Vec<&str> = head.iter().map(String::as_str).collect();
    let numeric: Vec<usize> = (2..head.len()).collect();
    let remark = format!(
        "Published: {}. Here: {}. ± one standard deviation over seeds; less published: the first column, ours less theirs. {}",
        escape(&outcome.protocol),
        escape(&outcome.conditions),
        escape(outcome.remark.as_deref().unwrap_or_default())
    );
    let order: String = sentences(outcome).iter().map(|s| format!("<li>{}</li>\n", escape(s))).collect();
    let order = if order.is_empty() { order } else { format!("<ul>\n{order}</ul>\n") };
    let not_run = outcome.not_run.iter().map(|n| vec![n.what.clone(), n.why.clone()]);
    let names: Vec<&str> = ["entry"].into_iter().chain(outcome.columns.iter().map(String::as_str)).collect();
    let published = outcome.published.iter().map(|p| {
        let values = p.values.iter().zip(&outcome.columns).map(|(v, c)| number(*v, digits(c)));
        std::iter::once(p.entry.clone()).chain(values).collect()
    });
    let published = html::table(&names, &(1..names.len()).collect::<Vec<_>>(), published);
    let parts = section("Figures", &remark, &html::table(&head, &numeric, rows.into_iter()))
        + &section("The order of methods", "Paired: the same scene and seed.", &order)
        + &section("Published means, over the paper's scenes", "", &published)
        + &section("Without a result", "", &html::table(&["what", "why"], &[], not_run));
    html::document(&outcome.title, &outcome.source, &parts)
}

/// A table before it is run: published figures, and what each entry is here.
pub fn published(table: &Table) -> String {
    let columns = || table.columns.iter().enumerate();
    let head: Vec<&str> = ["scene", "entry", "here"].into_iter().chain(columns().map(|c| c.1.as_str())).collect();
    let run = |k: usize| table.entries[k].run.clone().unwrap_or_else(|| DASH.to_owned());
    let row = |scene: &str, k: usize, figure: &dyn Fn(usize) -> Option<f64>| {
        let figures: Vec<Option<f64>> = columns().map(|c| figure(c.0)).collect();
        let cells = columns().map(|(c, name)| number(figures[c], digits(name)));
        let row = [scene.to_owned(), table.entries[k].name.clone(), run(k)].into_iter().chain(cells).collect();
        figures.iter().any(Option::is_some).then_some(row)
    };
    let entries = || table.entries.iter().enumerate();
    let scenes = table.scenes.iter().flat_map(|s| {
        entries().filter_map(move |(k, e)| row(&s.name, k, &|column| table.published(s, &e.name, column)))
    });
    let average = entries().filter_map(|(k, e)| row("average", k, &|column| table.published_average(&e.name, column)));
    let rows: Vec<Vec<String>> = scenes.chain(average).collect();
    let mut text = format!("{} ({})\npublished: {}\n\n", table.title, table.source, table.protocol);
    text.push_str(&aligned(&head, &rows, |column| column < 3));
    table.remark.iter().for_each(|r| text.push_str(&format!("{r}\n")));
    table.command.iter().for_each(|c| text.push_str(&format!("our side: {c}\n")));
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_sentence_says_what_is_shown() {
        let order = |verdict, half_width| Order {
            other: "Grid4D".into(),
            published: Some(0.77),
            ours: Some(0.12),
            half_width,
            scenes: 3,
            pairs: 9,
            verdict: Some(verdict),
        };
        assert_eq!(
            sentence("FAGS", &order(Verdict::NotShown, Some(0.3)), " dB"),
            "FAGS less Grid4D: published +0.77 dB; here +0.12 ±0.30 dB (95 % over 3 scenes, 9 pairs): no order is shown."
        );
        assert!(
            sentence("FAGS", &order(Verdict::AsPublished, Some(0.1)), " dB")
                .ends_with("the order is the published one.")
        );
    }

    #[test]
    fn a_table_shows_its_figures_and_what_stands_for_them() {
        let text = published(&Table::find("fags", "dnerf").unwrap());
        assert!(
            text.lines().any(|l| l.starts_with("mutant") && l.contains("Grid4D + DRK  –") && l.contains("38.95")),
            "{text}"
        );
        assert!(text.contains("copying errors"), "{text}");
        assert!(published(&Table::find("dut", "runtime").unwrap()).contains("our side: gs4d bench RUN"));
    }
}
