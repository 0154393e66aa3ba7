//! The fields of one object, read with the place of every error.

use crate::error::{DataError, Place};
use gs_core::cast;
use serde_json::{Map, Value};
use std::borrow::Cow;
use std::ops::RangeInclusive;
use std::path::Path;

/// The remedy for numbers of the wrong shape.
const FIX: &str = "export the file again";

/// The fields of one object, with their place.
pub(crate) struct Fields<'a> {
    pub(super) file: &'a Path,
    pub(super) prefix: String,
    pub(super) map: Cow<'a, Map<String, Value>>,
}

impl<'a> Fields<'a> {
    /// The fields of `map`, at the JSON path `prefix` (empty: the whole file).
    pub(crate) fn new(file: &'a Path, prefix: impl Into<String>, map: &'a Map<String, Value>) -> Self {
        Self { file, prefix: prefix.into(), map: Cow::Borrowed(map) }
    }

    /// File and JSON path of a field.
    pub(crate) fn place(&self, key: &str) -> Place {
        let dot = if self.prefix.is_empty() || key.is_empty() { "" } else { "." };
        Place::new(self.file, format!("{}{dot}{key}", self.prefix))
    }

    /// A finite number, if the field is there (`null` counts as absent).
    ///
    /// # Errors
    /// `data.field` for anything else.
    pub(crate) fn number(&self, key: &str) -> Result<Option<f64>, DataError> {
        match self.map.get(key) {
            None | Some(Value::Null) => Ok(None),
            Some(v) => finite(v).map(Some).ok_or_else(|| not_finite(self.place(key), v)),
        }
    }

    /// A number that must be there.
    ///
    /// # Errors
    /// `data.field` if it is not.
    pub(crate) fn required_number(&self, key: &str) -> Result<f64, DataError> {
        self.number(key)?.ok_or_else(|| self.fault(key, "missing", "the layout requires this number", "add the field"))
    }

    /// A list of exactly `N` finite numbers, if the field is there.
    ///
    /// # Errors
    /// `data.field` naming the entry.
    pub(crate) fn numbers<const N: usize>(&self, key: &str) -> Result<Option<[f64; N]>, DataError> {
        let cells = match self.map.get(key) {
            None | Some(Value::Null) => return Ok(None),
            Some(Value::Array(cells)) if cells.len() == N => cells,
            Some(v) => {
                return Err(self.fault(key, &v.to_string(), "it must be a list of numbers of fixed length", FIX));
            }
        };
        let mut out = [0.0; N];
        for (i, (value, cell)) in out.iter_mut().zip(cells).enumerate() {
            *value = finite(cell).ok_or_else(|| not_finite(self.place(&format!("{key}[{i}]")), cell))?;
        }
        Ok(Some(out))
    }

    /// Three rows of three finite numbers, which must be there.
    ///
    /// # Errors
    /// `data.field` naming the entry.
    pub(crate) fn rows3(&self, key: &str) -> Result<[[f64; 3]; 3], DataError> {
        self.rows(key)?.ok_or_else(|| self.fault(key, "missing", "it must be three rows of three numbers", FIX))
    }

    /// `N` rows of three finite numbers, if the field is there.
    ///
    /// # Errors
    /// `data.field` naming the entry.
    pub(crate) fn rows<const N: usize>(&self, key: &str) -> Result<Option<[[f64; 3]; N]>, DataError> {
        let rows = match self.map.get(key) {
            None | Some(Value::Null) => return Ok(None),
            Some(Value::Array(rows)) if rows.len() == N => rows,
            Some(v) => return Err(self.fault(key, &v.to_string(), "it must be rows of three numbers", FIX)),
        };
        let mut m = [[0.0; 3]; N];
        for (i, row) in rows.iter().enumerate() {
            let at = format!("{key}[{i}]");
            let cells = row.as_array().filter(|c| c.len() == 3);
            let cells =
                cells.ok_or_else(|| self.fault(&at, &row.to_string(), "it must be a row of three numbers", FIX))?;
            for (j, cell) in cells.iter().enumerate() {
                m[i][j] = finite(cell).ok_or_else(|| not_finite(self.place(&format!("{at}[{j}]")), cell))?;
            }
        }
        Ok(Some(m))
    }

    /// A text, if the field is there.
    ///
    /// # Errors
    /// `data.field` for anything else.
    pub(crate) fn text(&self, key: &str) -> Result<Option<&str>, DataError> {
        match self.map.get(key) {
            None | Some(Value::Null) => Ok(None),
            Some(Value::String(s)) => Ok(Some(s)),
            Some(v) => Err(self.fault(key, &v.to_string(), "it must be a text", "write it in quotes")),
        }
    }

    /// Whether a field is true; false where it is not there.
    ///
    /// # Errors
    /// `data.field` for anything else.
    pub(crate) fn flag(&self, key: &str) -> Result<bool, DataError> {
        match self.map.get(key) {
            None | Some(Value::Null) => Ok(false),
            Some(Value::Bool(v)) => Ok(*v),
            Some(v) => Err(self.fault(key, &v.to_string(), "it must be true or false", "correct the field")),
        }
    }

    /// A text that must be there.
    ///
    /// # Errors
    /// `data.field` if it is not.
    pub(crate) fn required_text(&self, key: &str) -> Result<&str, DataError> {
        self.text(key)?.ok_or_else(|| self.fault(key, "missing", "every frame names its image", "add the field"))
    }

    /// The first three rows of a 4×4 (or 3×4) matrix of finite numbers; a fourth row must be `0 0 0 1`.
    ///
    /// # Errors
    /// `data.field` naming the entry.
    pub(crate) fn matrix(&self, key: &str) -> Result<[[f64; 4]; 3], DataError> {
        const WHY: &str = "a rigid transform has 4 rows of 4 numbers, the last 0 0 0 1";
        const FIX: &str = "export the matrix again";
        let fault = |place: String, value: String| DataError::Field {
            place: Place::new(self.file, place),
            value,
            why: WHY,
            fix: FIX,
        };
        let at = self.place(key).at;
        let rows = match self.map.get(key) {
            None => return Err(fault(at, "missing".into())),
            Some(Value::Array(rows)) if rows.len() == 3 || rows.len() == 4 => rows,
            Some(v) => return Err(fault(at, shorten(&v.to_string()))),
        };
        let mut m = [[0.0, 0.0, 0.0, 1.0]; 4];
        for (i, row) in rows.iter().enumerate() {
            let cells = row.as_array().filter(|c| c.len() == 4);
            let cells = cells.ok_or_else(|| fault(format!("{at}[{i}]"), shorten(&row.to_string())))?;
            for (j, cell) in cells.iter().enumerate() {
                let place = || Place::new(self.file, format!("{at}[{i}][{j}]"));
                m[i][j] = finite(cell).ok_or_else(|| not_finite(place(), cell))?;
            }
        }
        if rows.len() == 4 && m[3].iter().zip([0.0, 0.0, 0.0, 1.0]).any(|(a, b)| (a - b).abs() > 1e-6) {
            return Err(fault(format!("{at}[3]"), shorten(&rows[3].to_string())));
        }
        Ok([m[0], m[1], m[2]])
    }

    /// The error for a value of this field.
    pub(crate) fn fault(&self, key: &str, value: &str, why: &'static str, fix: &'static str) -> DataError {
        DataError::Field { place: self.place(key), value: shorten(value), why, fix }
    }
}

fn finite(v: &Value) -> Option<f64> {
    v.as_f64().filter(|x| x.is_finite())
}

fn not_finite(place: Place, v: &Value) -> DataError {
    // `quote_non_finite` made these strings.
    let bare = v.as_str().filter(|s| ["NaN", "Infinity", "-Infinity"].contains(s));
    let value = shorten(&bare.map_or_else(|| v.to_string(), str::to_owned));
    let text = v.is_string() && bare.is_none();
    let fix = if text { "write it as a number, without quotes" } else { "correct the number" };
    DataError::Field { place, value, why: "it must be a finite number", fix }
}

/// The whole number that `value` is, if it is one of the range.
pub(crate) fn whole(value: f64, range: RangeInclusive<u32>) -> Option<u32> {
    let limits = f64::from(*range.start())..=f64::from(*range.end());
    (value.fract() == 0.0 && limits.contains(&value)).then(|| cast::to_u32(cast::to_usize(value)))
}

/// A value for an error text, at most 40 characters.
pub(super) fn shorten(text: &str) -> String {
    let mut short: String = text.chars().take(40).collect();
    if short.len() < text.len() {
        short.push('…');
    }
    short
}

#[cfg(test)]
mod tests {
    use crate::json::tests::parse;

    #[test]
    fn fields_are_read_with_their_place() {
        let text = r#"{"fl_x": 3.5, "big": [1,2], "frames": [{"file_path": "a", "time": 0.5}, {"time": "x"}]}"#;
        let d = parse(text).unwrap();
        assert_eq!((d.len(), d.top().number("fl_x").unwrap(), d.top().number("cx").unwrap()), (2, Some(3.5), None));
        let f = d.frame(0).unwrap();
        assert_eq!((f.required_text("file_path").unwrap(), f.number("time").unwrap()), ("a", Some(0.5)));
        let e = d.frame(1).unwrap().number("time").unwrap_err();
        assert!(e.to_string() == "frames[1].time is \"x\"" && e.fix().contains("without quotes"), "{e}");
        let e = d.frame(1).unwrap().required_text("file_path").unwrap_err().to_string();
        assert_eq!(e, "frames[1].file_path is missing");
    }

    #[test]
    fn matrices_are_complete() {
        let with = |m: &str| {
            let text = format!("{{\"frames\": [{{\"m\": {m}}}]}}");
            let d = parse(&text).unwrap();
            d.frame(0).unwrap().matrix("m").map_err(|e| e.to_string())
        };
        let good = "[[1,0,0,5],[0,1,0,6],[0,0,1,7],[0,0,0,1]]";
        assert_eq!(with(good).unwrap()[1][3], 6.0);
        assert_eq!(with("[[1,0,0,5],[0,1,0,6],[0,0,1,7]]").unwrap()[2][3], 7.0);
        assert_eq!(with("[[1,0,0,5],[0,1,0],[0,0,1,7]]").unwrap_err(), "frames[0].m[1] is [0,1,0]");
        assert_eq!(with("[[1,0,0,5],[0,1,0,\"NaN\"],[0,0,1,7]]").unwrap_err(), "frames[0].m[1][3] is NaN");
        assert_eq!(with("7").unwrap_err(), "frames[0].m is 7");
        assert!(with("[[1,0,0,5],[0,1,0,6],[0,0,1,7],[0,0,0,2]]").unwrap_err().starts_with("frames[0].m[3]"));
    }
}
