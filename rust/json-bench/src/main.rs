//! Processor time of one thread to read an annotation table: the loader's own reader, serde_json, simd-json, sonic-rs.
//!
//! `cargo run --release --manifest-path rust/json-bench/Cargo.toml -- .../sample_annotation.json` prints the least of some
//! rounds, in turn, for the fields that a load takes of every record, and for a load that wants one sample in fifty.
//! All must read the same numbers. The readers of whole files get the file's bytes in memory within the time.
#![allow(dead_code, reason = "the loader's modules are taken as they are")]

#[path = "../../nuscenes/src/error.rs"]
mod error;
#[path = "../../nuscenes/src/number.rs"]
mod number;
#[path = "../../nuscenes/src/record.rs"]
mod record;
#[path = "../../nuscenes/src/scan.rs"]
mod scan;
#[path = "../../nuscenes/src/stream.rs"]
mod stream;
#[path = "../../nuscenes/src/token.rs"]
mod token;

use serde::Deserialize;
use sonic_rs::JsonValueTrait;
use std::error::Error;
use std::path::{Path, PathBuf};
use token::Token;

type Outcome<T> = Result<T, Box<dyn Error>>;
/// Number of records kept, and the sum of their numbers.
type Read = (usize, f64);

const ROUNDS: usize = 5;

/// What a load takes of an annotation.
#[derive(Deserialize)]
struct Annotation<'a> {
    #[serde(borrow)]
    token: &'a str,
    sample_token: &'a str,
    instance_token: &'a str,
    translation: [f64; 3],
    size: [f64; 3],
    rotation: [f64; 4],
}

/// Whether a record is wanted, by the end of its sample's token.
type Wanted = fn(u8) -> bool;

/// The last two digits of a token as a number below 256.
fn ending(token: &str) -> u8 {
    let digit = |byte: u8| (byte as char).to_digit(16).unwrap_or(0) as u8;
    token.as_bytes().last_chunk().map_or(0, |[a, b]: &[u8; 2]| digit(*a) << 4 | digit(*b))
}

fn every(_: u8) -> bool {
    true
}

fn few(sample: u8) -> bool {
    sample < 5
}

fn sum(translation: [f64; 3], size: [f64; 3], rotation: [f64; 4], tokens: [u8; 2]) -> f64 {
    translation.iter().chain(&size).chain(&rotation).copied().chain(tokens.map(f64::from)).sum()
}

fn total(found: impl Iterator<Item = f64>) -> Read {
    found.fold((0, 0.0), |(count, total), value| (count + 1, total + value))
}

fn annotation(row: &Annotation<'_>) -> f64 {
    sum(row.translation, row.size, row.rotation, [ending(row.token), ending(row.instance_token)])
}

fn ours(path: &Path, wanted: Wanted) -> Outcome<Read> {
    let names = &["token", "sample_token", "instance_token", "translation", "size", "rotation"];
    let found = stream::read_table(path, "annotations", names, |row, _| {
        let (token, sample) = (row.token(0)?, row.token(1)?);
        if !wanted(low_byte(sample)) {
            return Ok(None);
        }
        let instance = row.token(2)?;
        let tokens = [token, instance].map(low_byte);
        Ok(Some(sum(row.numbers(3)?, row.numbers(4)?, row.numbers(5)?, tokens)))
    })?;
    Ok(total(found.into_iter()))
}

/// [`ending`] of an official token.
fn low_byte(token: Token) -> u8 {
    token.0 as u8
}

fn serde_json(path: &Path, wanted: Wanted) -> Outcome<Read> {
    let bytes = std::fs::read(path)?;
    let rows: Vec<Annotation<'_>> = serde_json::from_slice(&bytes)?;
    Ok(total(rows.iter().filter(|row| wanted(ending(row.sample_token))).map(annotation)))
}

fn simd_json(path: &Path, wanted: Wanted) -> Outcome<Read> {
    let mut bytes = std::fs::read(path)?;
    let rows: Vec<Annotation<'_>> = simd_json::serde::from_slice(&mut bytes)?;
    Ok(total(rows.iter().filter(|row| wanted(ending(row.sample_token))).map(annotation)))
}

fn sonic_rs(path: &Path, wanted: Wanted) -> Outcome<Read> {
    let bytes = std::fs::read(path)?;
    let rows: Vec<Annotation<'_>> = sonic_rs::from_slice(&bytes)?;
    Ok(total(rows.iter().filter(|row| wanted(ending(row.sample_token))).map(annotation)))
}

/// Records are found one by one, and those that are wanted are parsed.
fn sonic_rs_lazy(path: &Path, wanted: Wanted) -> Outcome<Read> {
    let bytes = std::fs::read(path)?;
    let mut found = Vec::new();
    for record in sonic_rs::to_array_iter(bytes.as_slice()) {
        let record = record?;
        let sample = record.get("sample_token").ok_or("a record without sample")?;
        if wanted(ending(sample.as_str().ok_or("a sample that is no text")?)) {
            found.push(annotation(&sonic_rs::from_str(record.as_raw_str())?));
        }
    }
    Ok(total(found.into_iter()))
}

/// Processor time of this thread so far, seconds.
fn thread_s() -> Outcome<f64> {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat")?;
    let nanoseconds: u64 = text.split_whitespace().next().ok_or("no time in schedstat")?.parse()?;
    Ok(nanoseconds as f64 * 1e-9)
}

type Reader = (&'static str, fn(&Path, Wanted) -> Outcome<Read>);
const READERS: [Reader; 5] = [
    ("ours", ours),
    ("serde_json", serde_json),
    ("simd-json", simd_json),
    ("sonic-rs", sonic_rs),
    ("sonic-rs, lazy", sonic_rs_lazy),
];

fn compare(path: &Path) -> Result<(), String> {
    for (what, wanted) in [("every record", every as Wanted), ("one sample in 51", few)] {
        let mut least = [f64::INFINITY; READERS.len()];
        let mut first: Option<Read> = None;
        for _ in 0..ROUNDS {
            for (least, (name, reader)) in least.iter_mut().zip(READERS) {
                let timed = || {
                    let start = thread_s()?;
                    let found = reader(path, wanted)?;
                    Ok::<_, Box<dyn Error>>((found, thread_s()? - start))
                };
                let (found, seconds) = timed().map_err(|e| format!("{name}: {e}"))?;
                if *first.get_or_insert(found) != found {
                    return Err(format!("{name} reads {found:?}, others {first:?}"));
                }
                *least = least.min(seconds);
            }
        }
        println!("{what}: {} kept", first.map_or(0, |(count, _)| count));
        for (seconds, (name, _)) in least.iter().zip(READERS) {
            println!("  {name:15} {seconds:7.3} s of a processor, {:5.2} x ours", seconds / least[0]);
        }
    }
    Ok(())
}

fn main() -> Outcome<()> {
    let path = PathBuf::from(std::env::args_os().nth(1).ok_or("usage: ccdiff-json-bench TABLE.json")?);
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build()?;
    Ok(pool.install(|| compare(&path))?)
}
