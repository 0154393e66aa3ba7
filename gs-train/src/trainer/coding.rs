//! Columns as bytes, between ranks. Rows that are as the other side knows them do not travel.
//!
//! A run of values is one bit per row, whether it travels, and the values of those that do, little-endian.

/// A message that ends too early.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Short;

/// Appends the rows of `values`, each of `unit` values, whose bits differ from `known` (zeros if empty).
pub(super) fn encode(values: &[f32], known: &[f32], unit: usize, out: &mut Vec<u8>) {
    let rows = values.len().div_ceil(unit);
    let marks = out.len();
    out.resize(marks + rows.div_ceil(8), 0);
    for (i, row) in values.chunks(unit).enumerate() {
        let same = match known.get(i * unit..i * unit + row.len()) {
            Some(known) => row.iter().zip(known).all(|(a, b)| a.to_bits() == b.to_bits()),
            None => row.iter().all(|v| v.to_bits() == 0),
        };
        if !same {
            out[marks + i / 8] |= 1 << (i % 8);
            row.iter().for_each(|v| out.extend_from_slice(&v.to_le_bytes()));
        }
    }
}

/// Reads the rows that travelled into `values`, which hold what is known.
pub(super) fn decode(bytes: &mut &[u8], values: &mut [f32], unit: usize) -> Result<(), Short> {
    let rows = values.len().div_ceil(unit);
    let (marks, mut rest) = bytes.split_at_checked(rows.div_ceil(8)).ok_or(Short)?;
    for (i, row) in values.chunks_mut(unit).enumerate() {
        if marks[i / 8] & (1 << (i % 8)) != 0 {
            let (travelled, after) = rest.split_at_checked(4 * row.len()).ok_or(Short)?;
            row.iter_mut().zip(travelled.as_chunks::<4>().0).for_each(|(v, b)| *v = f32::from_le_bytes(*b));
            rest = after;
        }
    }
    *bytes = rest;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_that_are_known_do_not_travel_and_every_bit_arrives() {
        for (unit, len) in [(1, 9), (3, 30), (16, 40), (4, 0)] {
            let mut values = vec![0.0f32; len];
            let odd = [f32::NAN, -0.0, f32::MIN_POSITIVE / 2.0, 1.5];
            values.iter_mut().step_by(7).zip(odd).for_each(|(v, o)| *v = o);
            let known: Vec<f32> = values.iter().map(|v| v + 1.0).collect();
            for known in [&known[..], &[], &values[..]] {
                let mut bytes = Vec::new();
                encode(&values, known, unit, &mut bytes);
                bytes.push(77);
                let mut back = if known.is_empty() { vec![0.0; len] } else { known.to_vec() };
                let mut rest = &bytes[..];
                decode(&mut rest, &mut back, unit).unwrap();
                assert_eq!(rest, [77]);
                assert!(values.iter().zip(&back).all(|(a, b)| a.to_bits() == b.to_bits()));
            }
            let mut none = Vec::new();
            encode(&values, &values, unit, &mut none);
            assert_eq!(none.len(), len.div_ceil(unit).div_ceil(8));
        }
    }

    #[test]
    fn messages_that_end_early_are_refused() {
        let (values, mut bytes) = ([1.0f32; 12], Vec::new());
        encode(&values, &[], 3, &mut bytes);
        for cut in 0..bytes.len() {
            assert_eq!(decode(&mut &bytes[..cut], &mut [0.0; 12], 3), Err(Short));
        }
    }
}
