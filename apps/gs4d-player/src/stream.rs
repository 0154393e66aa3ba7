//! Numbers as bytes: seven bits a byte, the lowest first, the eighth set where more follow; signs are the lowest bit.

/// Collects bytes.
#[derive(Default)]
pub(crate) struct Writer(pub(crate) Vec<u8>);

impl Writer {
    pub(crate) fn bytes(&mut self, bytes: impl IntoIterator<Item = u8>) {
        self.0.extend(bytes);
    }

    pub(crate) fn unsigned(&mut self, mut v: u32) {
        while v >= 128 {
            self.0.push((v & 127) as u8 | 128);
            v >>= 7;
        }
        self.0.push(v as u8);
    }

    pub(crate) fn signed(&mut self, v: i32) {
        self.unsigned(((v << 1) ^ (v >> 31)).cast_unsigned());
    }
}

/// Takes bytes from the front.
pub(crate) struct Reader<'a>(pub(crate) &'a [u8]);

impl<'a> Reader<'a> {
    /// Fails if fewer than `n` bytes are left.
    pub(crate) fn expect(&self, n: usize) -> Result<(), String> {
        if n <= self.0.len() { Ok(()) } else { Err(format!("{n} bytes needed, {} left", self.0.len())) }
    }

    pub(crate) fn bytes(&mut self, n: usize) -> Result<&'a [u8], String> {
        self.expect(n)?;
        let (head, rest) = self.0.split_at(n);
        self.0 = rest;
        Ok(head)
    }

    pub(crate) fn unsigned(&mut self) -> Result<u32, String> {
        let mut v = 0u32;
        for shift in (0..35).step_by(7) {
            let byte = self.bytes(1)?[0];
            v |= u32::from(byte & 127) << shift;
            if byte < 128 {
                return Ok(v);
            }
        }
        Err("a number longer than 32 bits".to_owned())
    }

    pub(crate) fn signed(&mut self) -> Result<i32, String> {
        let v = self.unsigned()?;
        Ok((v >> 1).cast_signed() ^ -(v & 1).cast_signed())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_come_back() {
        let unsigned = [0, 1, 127, 128, 300, u32::MAX];
        let signed = [0, -1, 1, 63, -64, 64, i32::MAX, i32::MIN];
        let mut writer = Writer::default();
        unsigned.iter().for_each(|&v| writer.unsigned(v));
        signed.iter().for_each(|&v| writer.signed(v));
        let mut reader = Reader(&writer.0);
        assert!(unsigned.iter().all(|&v| reader.unsigned() == Ok(v)));
        assert!(signed.iter().all(|&v| reader.signed() == Ok(v)));
        assert!(reader.0.is_empty() && reader.unsigned().is_err());
        assert!(Reader(&[255; 6]).unsigned().is_err());
    }
}
