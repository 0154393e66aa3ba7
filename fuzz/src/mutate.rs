//! Random changes of an input.

use crate::case::Case;
use gs_core::Rng;

/// Largest file that mutation makes out of a smaller one.
const MAX_GROWN: usize = 1 << 20;
/// Longest run of bytes that is copied, removed or replaced.
const MAX_SPAN: u32 = 64;

const WORDS: [u32; 10] =
    [0, 1, 0x7fff_ffff, 0x8000_0000, u32::MAX, 0x7fc0_0000, 0x7f80_0000, 0x7f7f_ffff, 1 << 24, 0xffff];
const NUMBERS: [&str; 16] = [
    "0",
    "-0",
    "1",
    "-1",
    "2",
    "255",
    "65536",
    "1e-320",
    "1e38",
    "1e999",
    "NaN",
    "-Infinity",
    "4294967295",
    "4294967296",
    "9223372036854775808",
    "18446744073709551616",
];
const TOKENS: [&str; 18] = [
    "\r\n",
    "\"",
    "\\",
    "[",
    "]",
    "{",
    "}",
    ",",
    ":",
    "null",
    "true",
    "\"\"",
    "[]",
    "{}",
    "../",
    "\0",
    "\u{e9}",
    "property list uchar int i\n",
];

/// Changes one to eight places, few more often than many, now and then with pieces of `other`.
pub fn mutate(case: &mut Case, other: &Case, rng: &mut Rng) {
    let most = 1 + rng.below(4);
    for _ in 0..1 << rng.below(most) {
        let k = below(rng, case.0.len());
        let Some(file) = case.0.get_mut(k) else { return };
        let limit = file.bytes.len().max(MAX_GROWN);
        let donor = other.0.get(k).map_or(&[][..], |f| &f.bytes);
        change(&mut file.bytes, donor, rng);
        file.bytes.truncate(limit);
    }
}

/// A random index below `n`; 0 if there is none.
fn below(rng: &mut Rng, n: usize) -> usize {
    u32::try_from(n).ok().filter(|n| *n > 0).map_or(0, |n| rng.below(n) as usize)
}

fn pick<'a, T: ?Sized>(from: &[&'a T], rng: &mut Rng) -> &'a T {
    from[below(rng, from.len())]
}

fn change(bytes: &mut Vec<u8>, donor: &[u8], rng: &mut Rng) {
    let at = below(rng, bytes.len());
    let span = (1 + rng.below(MAX_SPAN) as usize).min(bytes.len() - at);
    match rng.below(15) {
        0 => bytes.truncate(at),
        1 => drop(bytes.drain(at..at + span)),
        2 => {
            let copy = bytes[at..at + span].to_vec();
            let to = below(rng, bytes.len());
            bytes.splice(to..to, copy);
        }
        3 => {
            let token = pick(&TOKENS, rng);
            bytes.splice(at..at + span.min(token.len()), token.bytes());
        }
        4 => {
            let word = WORDS[below(rng, WORDS.len())];
            let word = if rng.below(2) == 0 { word.to_le_bytes() } else { word.to_be_bytes() };
            let width = span.min(1 << rng.below(3));
            bytes.splice(at..at + width, word[..width].iter().copied());
        }
        5 => bytes.splice(at..at, (0..span).map(|_| rng.bits() as u8)).for_each(drop),
        6 => bytes[at..at + span].fill([0, 0xff, 0x80, b' '][below(rng, 4)]),
        7 | 13 | 14 => number(bytes, at, pick(&NUMBERS, rng)),
        8 => {
            let step = rng.below(70).wrapping_sub(35) as u8;
            bytes[at..at + span.min(1)].iter_mut().for_each(|b| *b = b.wrapping_add(step));
        }
        9 | 10 => bytes[at..at + span.min(1)].iter_mut().for_each(|b| *b = rng.bits() as u8),
        11 => {
            let from = below(rng, donor.len());
            let piece = &donor[from..donor.len().min(from + span)];
            bytes.splice(at..at + piece.len().min(span), piece.iter().copied());
        }
        _ => bytes[at..at + span.min(1)].iter_mut().for_each(|b| *b ^= 1 << rng.below(8)),
    }
}

/// Replaces the written number at or behind a place.
fn number(bytes: &mut Vec<u8>, at: usize, by: &str) {
    let is_part = |b: &u8| b.is_ascii_digit() || b"+-.eE".contains(b);
    let Some(start) = bytes[at..].iter().position(u8::is_ascii_digit).map(|k| at + k) else { return };
    let start = bytes[..start].iter().rposition(|b| !is_part(b)).map_or(0, |k| k + 1);
    let end = bytes[start..].iter().position(|b| !is_part(b)).map_or(bytes.len(), |k| start + k);
    bytes.splice(start..end, by.bytes());
}
