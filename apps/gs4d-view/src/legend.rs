//! Legends: name, unit, range, histogram and colours of the values shown.

use gs_core::cast;
use gs_train::palette::color_scale;
use serde_json::{Value, json};

/// Bars of a histogram.
const BARS: usize = 24;

/// Histogram of the finite `values` over `span`, or over their own range. Values outside fall into the first or last bar.
pub(crate) fn histogram(name: &str, unit: &str, span: Option<[f32; 2]>, values: &[f32]) -> Value {
    let known = || values.iter().copied().filter(|v| v.is_finite());
    let [low, high] = span.unwrap_or_else(|| {
        let [low, high] = known().fold([f32::INFINITY, f32::NEG_INFINITY], |[a, b], v| [a.min(v), b.max(v)]);
        match low.is_finite() {
            true => [low, high],
            false => [0.0; 2],
        }
    });
    let mut bars = [0u32; BARS];
    for v in known() {
        let at = (v - low) / (high - low).max(1e-12) * BARS as f32;
        bars[cast::to_usize(at).min(BARS - 1)] += 1;
    }
    json!({"name": name, "unit": unit, "low": low, "high": high, "bars": bars})
}

/// A [`histogram`] with the colour of each bar on the colour scale of quantities.
pub(crate) fn scaled(name: &str, unit: &str, span: [f32; 2], values: &[f32]) -> Value {
    colored(histogram(name, unit, Some(span), values), color_scale)
}

/// A [`histogram`] over 0..1 with bars from black to white.
pub(crate) fn grey(name: &str, values: &[f32]) -> Value {
    colored(histogram(name, "", Some([0.0, 1.0]), values), |share| [share; 3])
}

/// Counts of `k` labels with the colour of each, and the caption `words`.
pub(crate) fn named(name: &str, words: &str, labels: &[u32], k: usize, color: impl Fn(u32) -> [f32; 3]) -> Value {
    let mut bars = vec![0u32; k];
    labels.iter().filter_map(|l| usize::try_from(*l).ok()).filter(|l| *l < k).for_each(|l| bars[l] += 1);
    let colors: Vec<String> = (0..cast::to_u32(k)).map(|label| hexadecimal(color(label))).collect();
    json!({"name": name, "words": words, "bars": bars, "colors": colors})
}

fn colored(mut legend: Value, color: impl Fn(f32) -> [f32; 3]) -> Value {
    let of = |k: usize| hexadecimal(color(k as f32 / (BARS - 1) as f32));
    legend["colors"] = json!((0..BARS).map(of).collect::<Vec<_>>());
    legend
}

fn hexadecimal(color: [f32; 3]) -> String {
    let [r, g, b] = color.map(|v| cast::to_u8((v * 255.0).round()));
    format!("#{r:02x}{g:02x}{b:02x}")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_scale_grows_lighter() {
        let light = |x: f32| color_scale(x).iter().zip([0.2126, 0.7152, 0.0722]).map(|(c, w)| c * w).sum::<f32>();
        assert!((0..20).all(|k| light((k + 1) as f32 / 20.0) > light(k as f32 / 20.0)));
        assert_eq!(color_scale(f32::NAN), color_scale(0.0));
    }

    #[test]
    fn every_finite_value_is_in_one_bar() {
        let values = [0.0, 0.5, 1.0, 7.0, -3.0, f32::NAN];
        let counted = |v: &Value| v["bars"].as_array().unwrap().iter().map(|n| n.as_u64().unwrap()).sum::<u64>();
        let given = histogram("x", "m", Some([0.0, 1.0]), &values);
        assert_eq!((counted(&given), &given["bars"][0], &given["bars"][23]), (5, &json!(2), &json!(2)));
        let own = histogram("x", "m", None, &values);
        assert_eq!((own["low"].as_f64(), own["high"].as_f64(), counted(&own)), (Some(-3.0), Some(7.0), 5));
        assert_eq!(counted(&histogram("x", "m", None, &[2.0, 2.0])), 2);
        assert_eq!(counted(&histogram("x", "m", None, &[])), 0);
        assert_eq!(grey("alpha", &[])["colors"][23], "#ffffff");
        let parts = named("x", "", &[0, 1, 1, 7], 2, |k| [k as f32, 0.0, 0.0]);
        assert_eq!((&parts["bars"], &parts["colors"]), (&json!([1, 2]), &json!(["#000000", "#ff0000"])));
    }
}
