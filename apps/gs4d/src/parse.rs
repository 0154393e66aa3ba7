//! Parsers of flag values.

use std::time::Duration;

/// A finite number.
pub fn finite(text: &str) -> Result<f32, String> {
    match text.trim().parse::<f32>() {
        Ok(v) if v.is_finite() => Ok(v),
        _ => Err("give a number, for example 0.25".to_owned()),
    }
}

/// A finite number that is not negative.
pub fn not_negative(text: &str) -> Result<f64, String> {
    match text.trim().parse::<f64>() {
        Ok(v) if v.is_finite() && v >= 0.0 => Ok(v),
        _ => Err("give a number that is not negative, for example 0.01".to_owned()),
    }
}

/// A finite number above 0.
pub fn positive(text: &str) -> Result<f32, String> {
    finite(text).ok().filter(|v| *v > 0.0).ok_or_else(|| "give a number above 0, for example 0.1".to_owned())
}

/// Frames per second of a video.
pub fn frame_rate(text: &str) -> Result<f64, String> {
    let rate = text.trim().parse::<f64>().ok().filter(|v| (1.0..=1000.0).contains(v));
    rate.ok_or_else(|| "give frames per second from 1 to 1000, for example 30 or 29.97".to_owned())
}

/// A number above 0 and up to 1, or percent.
pub fn share(text: &str) -> Result<f64, String> {
    let text = text.trim();
    let value = match text.strip_suffix('%') {
        Some(percent) => percent.trim().parse::<f64>().map(|v| v / 100.0),
        None => text.parse::<f64>(),
    };
    match value {
        Ok(v) if v > 0.0 && v <= 1.0 => Ok(v),
        _ => Err("give a number above 0 and up to 1, for example 0.95 or 95%".to_owned()),
    }
}

/// Normalised times, at least one, in the order given.
#[derive(Clone, Debug, PartialEq)]
pub struct Times(pub Vec<f32>);

/// Most times in one list.
const MAX_TIMES: usize = 10_000;

/// `A..B:N` for N times from A to B, or one time.
pub fn times(text: &str) -> Result<Times, String> {
    let wrong = |_| format!("give A..B:N with N from 1 to {MAX_TIMES}, for example 0..1:9, or one time");
    let Some((from, rest)) = text.split_once("..") else { return Ok(Times(vec![finite(text).map_err(wrong)?])) };
    let (to, n) = rest.split_once(':').ok_or_else(|| wrong(String::new()))?;
    let (a, b) = (finite(from).map_err(wrong)?, finite(to).map_err(wrong)?);
    match n.trim().parse::<usize>() {
        Ok(1) => Ok(Times(vec![a])),
        Ok(n) if (2..=MAX_TIMES).contains(&n) => {
            Ok(Times((0..n).map(|k| a + (b - a) * k as f32 / (n - 1) as f32).collect()))
        }
        _ => Err(wrong(String::new())),
    }
}

/// `black`, `white`, one grey or `r,g,b`, each in 0..1.
pub fn color(text: &str) -> Result<[f32; 3], String> {
    match text.trim() {
        "black" => return Ok([0.0; 3]),
        "white" => return Ok([1.0; 3]),
        _ => {}
    }
    let wrong = || "give black, white, one grey, or r,g,b with values from 0 to 1".to_owned();
    let channel = |part: &str| part.trim().parse::<f32>().ok().filter(|v| (0.0..=1.0).contains(v)).ok_or_else(wrong);
    let parts: Vec<f32> = text.split(',').map(channel).collect::<Result<_, _>>()?;
    match parts[..] {
        [grey] => Ok([grey; 3]),
        [r, g, b] => Ok([r, g, b]),
        _ => Err(wrong()),
    }
}

/// `1920x1080`: width and height, pixels.
pub fn size(text: &str) -> Result<[u32; 2], String> {
    let side = |part: &str| part.trim().parse::<u32>().ok().filter(|n| (1..=MAX_SIDE).contains(n));
    let sides = text.split_once(['x', 'X', '×']).and_then(|(w, h)| Some([side(w)?, side(h)?]));
    sides.ok_or_else(|| format!("give WIDTHxHEIGHT with sides from 1 to {MAX_SIDE}, for example 1920x1080"))
}

/// Longest side of an image, pixels.
const MAX_SIDE: u32 = 16_384;

/// An angle of view, degrees.
pub fn field_of_view(text: &str) -> Result<f64, String> {
    let degrees = text.trim().parse::<f64>().ok().filter(|v| (1.0..=170.0).contains(v));
    degrees.ok_or_else(|| "give degrees from 1 to 170, for example 60".to_owned())
}

/// A time such as `90`, `90s`, `10m` or `1.5h`.
pub fn duration(text: &str) -> Result<Duration, String> {
    let text = text.trim();
    let (number, unit) = text.split_at(text.find(|c: char| c.is_ascii_alphabetic()).unwrap_or(text.len()));
    let factor = match unit {
        "" | "s" => 1.0,
        "m" | "min" => 60.0,
        "h" => 3600.0,
        _ => return Err(format!("the unit `{unit}` is not known; use s, m or h")),
    };
    match number.trim().parse::<f64>() {
        Ok(v) if v > 0.0 && v * factor < 1e9 => Ok(Duration::from_secs_f64(v * factor)),
        _ => Err("give a positive time, for example 90s, 10m or 1.5h".to_owned()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values() {
        assert_eq!(color("1,0.5, 0").unwrap(), [1.0, 0.5, 0.0]);
        assert_eq!((color("white").unwrap(), color("0.25").unwrap()), ([1.0; 3], [0.25; 3]));
        for bad in ["-1", "1,2,3", "0,0", "nan", "", "red"] {
            assert!(color(bad).is_err(), "{bad}");
        }
        assert_eq!(duration("10m").unwrap(), Duration::from_secs(600));
        assert_eq!(duration("1.5h").unwrap(), Duration::from_secs(5400));
        assert_eq!(duration("90").unwrap(), duration("90s").unwrap());
        for bad in ["", "0", "-5m", "10 parsecs", "nan", "1e300h", "infs"] {
            assert!(duration(bad).is_err(), "{bad}");
        }
        assert_eq!(times("0..1:5").unwrap().0, [0.0, 0.25, 0.5, 0.75, 1.0]);
        assert_eq!((times("0.3").unwrap().0, times("-1..2:1").unwrap().0), (vec![0.3], vec![-1.0]));
        for bad in ["", "0..1", "0..1:0", "0..nan:3", "0..1:-2", "0..1:99999", "x"] {
            assert!(times(bad).is_err(), "{bad}");
        }
        assert_eq!((size("1920x1080").unwrap(), size("7X9").unwrap()), ([1920, 1080], [7, 9]));
        for bad in ["", "1920", "0x5", "5x", "-1x5", "99999x5", "1920x1080x3"] {
            assert!(size(bad).is_err(), "{bad}");
        }
        assert!(field_of_view("60").is_ok() && field_of_view("0").is_err() && field_of_view("180").is_err());
        assert!(frame_rate("29.97") == Ok(29.97) && frame_rate("0").is_err() && frame_rate("-1").is_err());
        assert!(share("1").is_ok() && share("0").is_err() && share("1.1").is_err());
        assert!(finite("-0.5").is_ok() && finite("inf").is_err() && not_negative("-1").is_err());
    }
}
