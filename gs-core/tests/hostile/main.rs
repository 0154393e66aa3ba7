//! Hostile input: for every reader, any bytes give a valid value or a typed error. No panic, nothing slower than a
//! second on a small file, no more memory than `8 × file size + 64 MiB` (counted by the allocator).
//!
//! Run with `--features images,exr` to include the image readers.
#![cfg(feature = "io")]

mod bombs;
mod seeds;

use gs_core::Rng;
use gs_core::io::IoError;
use gs_core::testkit::alloc::{Counting, peak_of};
use seeds::Parser;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::time::{Duration, Instant};

#[global_allocator]
static ALLOCATOR: Counting = Counting;

/// Mutated files per reader.
const MUTATIONS: u32 = 12_000;
/// Memory a reader may use beyond eight times the file.
const MEMORY_BASE: usize = 64 << 20;
/// Longest a reader may take on a small file; a large one gets as much again per [`BYTES_PER_TIME`] bytes (loaded machines).
const TIME: Duration = Duration::from_secs(1);
const BYTES_PER_TIME: usize = 4 << 20;

/// Runs a reader on `bytes` under the memory and time bounds.
fn guarded(what: &str, bytes: &[u8], read: fn(&[u8]) -> Result<(), IoError>) -> Result<(), IoError> {
    let start = Instant::now();
    let (result, peak) = peak_of(|| catch_unwind(AssertUnwindSafe(|| read(bytes))));
    let took = start.elapsed();
    let Ok(result) = result else { panic!("{what}: panicked on {} bytes", bytes.len()) };
    assert!(peak <= 8 * bytes.len() + MEMORY_BASE, "{what}: {peak} bytes held for a file of {}", bytes.len());
    assert!(took < TIME * (1 + bytes.len() / BYTES_PER_TIME) as u32, "{what}: took {took:?}");
    if let Err(error) = &result {
        let text = error.to_string();
        assert!(text.len() < 2000 && text.contains(';'), "{what}: message without advice or too long: {text}");
    }
    result
}

/// One random change of the bytes.
fn mutate(bytes: &mut Vec<u8>, r: &mut Rng) {
    const WORDS: [u32; 8] = [0, 1, 0x7fff_ffff, 0x8000_0000, u32::MAX, 0x7fc0_0000, 0x7f80_0000, 1 << 24];
    const TOKENS: [&str; 12] = [
        "-1",
        "NaN",
        "1e999",
        "18446744073709551616",
        "4294967295",
        "\r\n",
        "list uchar int",
        "[",
        "}",
        "null",
        "-inf",
        "element vertex 9223372036854775808\n",
    ];
    let len = bytes.len().max(1) as u32;
    let at = (r.below(len) as usize).min(bytes.len());
    let span = (1 + r.below(16) as usize).min(bytes.len() - at);
    match r.below(9) {
        0 => bytes.truncate(at),
        1 => drop(bytes.drain(at..at + span)),
        2 => {
            let copy = bytes[at..at + span].to_vec();
            bytes.splice(at..at, copy);
        }
        3 => {
            let token = TOKENS[r.below(TOKENS.len() as u32) as usize];
            bytes.splice(at..at + span.min(token.len()), token.bytes());
        }
        4 => {
            let word = WORDS[r.below(WORDS.len() as u32) as usize];
            let word = if r.below(2) == 0 { word.to_le_bytes() } else { word.to_be_bytes() };
            bytes.splice(at..at + span.min(4), word);
        }
        5 => bytes.splice(at..at, (0..span).map(|_| r.bits() as u8)).for_each(drop),
        6 => bytes[at..at + span].fill([0, 0xff, 0x80, b' '][r.below(4) as usize]),
        7 => bytes[at..at + span].iter_mut().for_each(|b| *b = r.bits() as u8),
        _ => bytes[at..at + span.min(1)].iter_mut().for_each(|b| *b ^= 1 << r.below(8)),
    }
}

/// Mutates the seeds of one reader; returns how many mutated files were still valid.
fn fuzz(parser: &Parser) -> u32 {
    let mut good = 0;
    for case in 0..MUTATIONS {
        let mut r = Rng::new(2026, parser.name, case, 0);
        let mut bytes = parser.seeds[r.below(parser.seeds.len() as u32) as usize].clone();
        for _ in 0..1 + r.below(4) {
            mutate(&mut bytes, &mut r);
        }
        let what = format!("{} case {case}", parser.name);
        good += u32::from(guarded(&what, &(parser.wrap)(&bytes), parser.read).is_ok());
    }
    good
}

#[test]
fn mutated_files_give_a_valid_value_or_a_typed_error() {
    for parser in seeds::parsers() {
        let good = fuzz(&parser);
        println!("{:12} {MUTATIONS} mutations, {good} still valid", parser.name);
        assert!(good < MUTATIONS, "{}: no file was refused", parser.name);
    }
}

#[test]
fn seeds_are_valid_and_every_cut_is_an_error() {
    for parser in seeds::parsers() {
        for seed in &parser.seeds {
            guarded(parser.name, &(parser.wrap)(seed), parser.read).expect("the seed is valid");
            for cut in 0..seed.len() - parser.soft_tail {
                // Whole rows of a format without a header are a shorter file.
                if parser.name == "splat" && cut % splat_row() == 0 {
                    continue;
                }
                let what = format!("{} cut at {cut} of {}", parser.name, seed.len());
                let result = guarded(&what, &(parser.wrap)(&seed[..cut]), parser.read);
                assert!(result.is_err(), "{what} was accepted");
            }
        }
    }
}

fn splat_row() -> usize {
    gs_core::io::splat::ROW
}

#[test]
fn trailing_bytes_are_an_error() {
    for parser in seeds::parsers().iter().filter(|p| p.strict_end) {
        for trailing in [b"x".as_slice(), b"\x00", b" 7 7 7", &[0xff; 33]] {
            let mut bytes = parser.seeds[0].clone();
            bytes.extend_from_slice(trailing);
            let result = guarded(parser.name, &(parser.wrap)(&bytes), parser.read);
            assert!(result.is_err(), "{}: {trailing:?} after the end was accepted", parser.name);
        }
    }
}

#[test]
fn random_bytes_are_refused() {
    for parser in seeds::parsers() {
        for case in 0..300 {
            let mut r = Rng::new(7, parser.name, case, 0);
            let bytes: Vec<u8> = (0..r.below(400)).map(|_| r.bits() as u8).collect();
            // An empty .splat is an empty cloud, and 32 random bytes may be finite.
            let result = guarded(parser.name, &bytes, parser.read);
            assert!(
                result.is_err() || parser.name == "splat" && bytes.len().is_multiple_of(splat_row()),
                "{}",
                parser.name
            );
        }
    }
}

#[test]
fn a_non_finite_value_in_any_property_is_named() {
    use gs_core::io::{Limits, ply};
    let good = seeds::ply_binary(4, 3);
    let names = ply::property_names(&good, "a.ply").expect("a good file");
    let width = 4 * names.len();
    let data = good.len() - 4 * width;
    for (column, name) in names.iter().enumerate().filter(|(_, n)| !n.starts_with('n')) {
        for value in [f32::NAN, f32::INFINITY, f32::NEG_INFINITY] {
            if name == "opacity" && value.is_infinite() {
                continue; // opacity 0 or 1, legal
            }
            let mut bytes = good.clone();
            bytes[data + 2 * width + 4 * column..][..4].copy_from_slice(&value.to_le_bytes());
            let text = ply::read(&bytes, "a.ply", &Limits::default()).expect_err("not finite").to_string();
            assert!(text.contains(&format!("row 2, `{name}` = {value}")), "{text}");
        }
    }
}

#[test]
fn the_counter_counts() {
    let ((), peak) = peak_of(|| drop(std::hint::black_box(vec![0u8; 1 << 20])));
    assert!((1 << 20..(1 << 20) + 4096).contains(&peak), "{peak}");
    let (_, peak) = peak_of(|| {
        let mut v: Vec<u8> = std::hint::black_box(Vec::with_capacity(1000));
        v.reserve_exact(3000);
        v.len()
    });
    assert!((4000..8000).contains(&peak), "{peak}");
}
