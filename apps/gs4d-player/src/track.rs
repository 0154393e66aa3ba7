//! One attribute of all splats over time: values at key frames of each splat's own, linear in between.

use crate::stream::{Reader, Writer};

/// Values at key frames, `width` for each key.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Track {
    pub(crate) width: usize,
    /// Logarithm to base 2 of the step that the values of a splat are multiples of.
    pub(crate) exponents: Vec<i8>,
    /// Number of keys before each splat; one more at the end.
    pub(crate) starts: Vec<usize>,
    /// Frame of each key; those of a splat ascend, the first is 0.
    pub(crate) frames: Vec<u16>,
    /// `[keys, width]`, in steps.
    pub(crate) values: Vec<i32>,
}

/// How far two values of a track are apart, in steps.
pub(crate) fn apart(a: i32, b: i32) -> f32 {
    (i64::from(b) - i64::from(a)) as f32
}

/// The step of an exponent.
pub(crate) fn step(exponent: i8) -> f32 {
    f32::from(exponent).exp2()
}

impl Track {
    pub(crate) fn new(width: usize) -> Self {
        Self { width, starts: vec![0], ..Self::default() }
    }

    /// Appends a splat: frames and values of its keys.
    pub(crate) fn push(&mut self, exponent: i8, frames: &[u16], values: &[i32]) {
        self.exponents.push(exponent);
        self.frames.extend(frames);
        self.values.extend(values);
        self.starts.push(self.frames.len());
    }

    /// The value of a splat at a frame, which may lie between two; `out` has `width` places.
    pub(crate) fn at(&self, splat: usize, frame: f32, out: &mut [f32]) {
        let keys = &self.frames[self.starts[splat]..self.starts[splat + 1]];
        let after = keys.partition_point(|&f| f32::from(f) <= frame).clamp(1, keys.len());
        let (a, b) = (after - 1, after.min(keys.len() - 1));
        let span = f32::from(keys[b]) - f32::from(keys[a]);
        let share = if span > 0.0 { ((frame - f32::from(keys[a])) / span).clamp(0.0, 1.0) } else { 0.0 };
        let step = step(self.exponents[splat]);
        let row = |key: usize| &self.values[(self.starts[splat] + key) * self.width..][..self.width];
        for (out, (&x, &y)) in out.iter_mut().zip(row(a).iter().zip(row(b))) {
            *out = step * (x as f32 + share * apart(x, y));
        }
    }

    pub(crate) fn write(&self, to: &mut Writer) {
        let rows = || self.starts.windows(2).map(|w| w[0]..w[1]);
        to.bytes(self.exponents.iter().map(|e| e.cast_unsigned()));
        rows().for_each(|keys| to.unsigned(keys.len() as u32));
        for keys in rows() {
            self.frames[keys].windows(2).for_each(|f| to.unsigned(u32::from(f[1] - f[0])));
        }
        for c in 0..self.width {
            for keys in rows() {
                let mut last = 0;
                for key in keys {
                    let value = self.values[key * self.width + c];
                    to.signed(value.wrapping_sub(last));
                    last = value;
                }
            }
        }
    }

    /// Reads [`Self::write`] of `count` splats over `frames` frames.
    pub(crate) fn read(from: &mut Reader<'_>, width: usize, count: usize, frames: usize) -> Result<Self, String> {
        let exponents = from.bytes(count)?.iter().map(|e| e.cast_signed()).collect();
        let mut starts = vec![0];
        for splat in 0..count {
            let keys = from.unsigned()? as usize;
            if keys == 0 || keys > frames {
                return Err(format!("{keys} keys in {frames} frames"));
            }
            starts.push(starts[splat] + keys);
        }
        let total = starts[count];
        // A key takes at least a byte of each component: what cannot be there is not reserved.
        from.expect(total)?;
        let mut times = Vec::with_capacity(total);
        for splat in 0..count {
            let mut frame = 0u32;
            for key in starts[splat]..starts[splat + 1] {
                frame = if key == starts[splat] { 0 } else { frame.saturating_add(from.unsigned()?.max(1)) };
                times.push(
                    u16::try_from(frame).ok().filter(|f| usize::from(*f) < frames).ok_or("a key beyond the end")?,
                );
            }
        }
        let mut values = vec![0; total * width];
        for c in 0..width {
            for keys in starts.windows(2) {
                let mut last = 0i32;
                for key in keys[0]..keys[1] {
                    last = last.wrapping_add(from.signed()?);
                    values[key * width + c] = last;
                }
            }
        }
        Ok(Self { width, exponents, starts, frames: times, values })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_at_the_ends_of_their_range_are_joined_by_a_line() {
        let mut track = Track::new(1);
        track.push(0, &[0, 2], &[i32::MIN, i32::MAX]);
        let mut out = [0.0];
        track.at(0, 1.0, &mut out);
        assert!(out[0].abs() <= 128.0, "half-way, of 2^32 steps: {}", out[0]);
    }
}
