//! Reads a table, a JSON array of objects, as a stream: in blocks, in parallel, never whole.
//!
//! One thread reads the next block and finds where its records end while the others parse the records of the block
//! before. Layout does not matter: pretty-printed or on one line, fields in any order.

use crate::error::{NuscenesError, Result};
use crate::file;
use memchr::memchr2;
use rayon::prelude::*;
use serde::de::DeserializeOwned;
use std::io::Read;
use std::ops::Range;
use std::path::Path;

/// Bytes read at a time. Two blocks are in memory at once.
const BLOCK_BYTES: usize = 1 << 20;
/// A longer record means a string or an object that never ends.
const MAX_RECORD_BYTES: usize = 16 << 20;
/// UTF-8's byte-order mark, which a file may begin with.
pub(crate) const BYTE_ORDER_MARK: &[u8] = b"\xef\xbb\xbf";
/// Records parsed by one task.
const RECORDS_PER_TASK: usize = 256;

/// What `keep` makes of the rows of a table, in the order of the file.
pub(crate) fn read_table<Row: DeserializeOwned, Kept: Send>(
    path: &Path,
    what: &str,
    keep: &(impl Fn(Row) -> Result<Option<Kept>> + Sync),
) -> Result<Vec<Kept>> {
    let file = file::open(path).map_err(|e| NuscenesError::from_io(path, what, e))?;
    read_rows(file, path, BLOCK_BYTES, keep)
}

/// [`read_table`] from any reader; `path` is for messages.
fn read_rows<Row: DeserializeOwned, Kept: Send>(
    reader: impl Read + Send,
    path: &Path,
    block_bytes: usize,
    keep: &(impl Fn(Row) -> Result<Option<Kept>> + Sync),
) -> Result<Vec<Kept>> {
    let mut blocks = Blocks::new(reader, path, block_bytes);
    let mut kept = Vec::new();
    let mut current = blocks.next_block(Vec::new())?;
    let mut spare = Vec::new();
    while let Some(block) = current {
        let parse = |records: &[Range<usize>]| {
            let row = |record: &Range<usize>| {
                parse(&block.bytes[record.clone()], path, block.offset + record.start as u64)
            };
            records.iter().filter_map(|record| row(record).and_then(keep).transpose()).collect()
        };
        let (next, parsed): (_, Result<Vec<Vec<Kept>>>) = rayon::join(
            || blocks.next_block(spare),
            || block.records.par_chunks(RECORDS_PER_TASK).map(parse).collect(),
        );
        // an error in this block comes before one in the next
        kept.extend(parsed?.into_iter().flatten());
        current = next?;
        spare = block.bytes;
    }
    Ok(kept)
}

/// A value of JSON from the text at an offset of a file.
pub(crate) fn parse<T: DeserializeOwned>(text: &[u8], path: &Path, offset: u64) -> Result<T> {
    serde_json::from_slice(text).map_err(|error| {
        let lines = text.split_inclusive(|byte| *byte == b'\n').take(error.line().saturating_sub(1));
        let at = lines.map(<[u8]>::len).sum::<usize>() + error.column().saturating_sub(1);
        let before = String::from_utf8_lossy(&text[..at.min(text.len())]);
        let message = error.to_string();
        let mut message = message.split(" at line ").next().unwrap_or_default().to_owned();
        // serde names a field that is missing, and none that is wrong
        let field = before.rsplit_once("\":").and_then(|(before, _)| before.rsplit_once('"'));
        if let Some((_, field)) = field.filter(|_| !message.contains("missing field")) {
            message.push_str(&format!(" (field {field:?})"));
        }
        let shown = String::from_utf8_lossy(&text[..text.len().min(80)]).replace(['\n', '\r'], " ");
        let message = format!("{message}, in {shown}");
        NuscenesError::Json { path: path.to_owned(), offset: offset + at as u64, message }
    })
}

/// Bytes at which something begins or ends within an object.
static MARKS: [bool; 256] = {
    let mut marks = [false; 256];
    (marks[b'"' as usize], marks[b'{' as usize], marks[b'[' as usize]) = (true, true, true);
    (marks[b']' as usize], marks[b'}' as usize]) = (true, true);
    marks
};

/// Position after the object that begins at `at`; `None` where the text ends in it.
fn object_end(text: &[u8], mut at: usize) -> Option<usize> {
    let mut depth = 0_usize;
    loop {
        match text.get(at)? {
            b'"' => loop {
                at += 1 + memchr2(b'"', b'\\', text.get(at + 1..)?)?;
                if text[at] == b'"' {
                    break;
                }
                at += 1;
            },
            b'{' | b'[' => depth += 1,
            _ => depth -= 1,
        }
        at += 1;
        if depth == 0 {
            return Some(at);
        }
        at += text[at..].iter().position(|byte| MARKS[usize::from(*byte)])?;
    }
}

/// Whole records, and where each of them lies.
struct Block {
    bytes: Vec<u8>,
    /// Offset of `bytes[0]` in the file.
    offset: u64,
    records: Vec<Range<usize>>,
}

/// What follows in a table, in the words of messages.
const START: &str = "an array of records";
const FIRST: &str = "a record or the end of the array";
const RECORD: &str = "a record";
const SEPARATOR: &str = "a comma or the end of the array";
const END: &str = "nothing after the array";

struct Blocks<'a, R> {
    reader: R,
    path: &'a Path,
    block_bytes: usize,
    /// Bytes of the record that the last block broke off in.
    tail: Vec<u8>,
    /// Offset of `tail[0]` in the file.
    offset: u64,
    /// One of [`START`] to [`END`].
    expected: &'static str,
}

impl<'a, R: Read> Blocks<'a, R> {
    fn new(reader: R, path: &'a Path, block_bytes: usize) -> Self {
        Self { reader, path, block_bytes, tail: Vec::new(), offset: 0, expected: START }
    }

    fn fail(&self, position: usize, message: impl Into<String>) -> NuscenesError {
        let offset = self.offset + position as u64;
        NuscenesError::Json { path: self.path.to_owned(), offset, message: message.into() }
    }

    /// The next block, in the memory of one that is done with; `None` at the end of a complete array.
    fn next_block(&mut self, mut bytes: Vec<u8>) -> Result<Option<Block>> {
        bytes.clear();
        bytes.append(&mut self.tail);
        let limit = self.block_bytes as u64;
        bytes.reserve(self.block_bytes + 32);
        let read = self
            .reader
            .by_ref()
            .take(limit)
            .read_to_end(&mut bytes)
            .map_err(|source| NuscenesError::Io { path: self.path.to_owned(), source })?;
        if read == 0 {
            return match self.expected {
                END => Ok(None),
                START => Err(self.fail(bytes.len(), "the file is empty")),
                _ => Err(self.fail(bytes.len(), "the file ends in the middle of the array")),
            };
        }
        let (records, consumed) = self.scan(&bytes)?;
        if bytes.len() - consumed > MAX_RECORD_BYTES {
            return Err(self.fail(consumed, "a record longer than 16 MiB"));
        }
        self.tail.extend_from_slice(&bytes[consumed..]);
        let offset = self.offset;
        self.offset += consumed as u64;
        Ok(Some(Block { bytes, offset, records }))
    }

    /// Finds the records that end in `bytes`, and how many bytes are done with.
    fn scan(&mut self, bytes: &[u8]) -> Result<(Vec<Range<usize>>, usize)> {
        let mut records = Vec::with_capacity(bytes.len() / 256);
        let mut i = 0;
        while let Some(&byte) = bytes.get(i) {
            match (self.expected, byte) {
                _ if byte.is_ascii_whitespace() => {}
                (START, b'[') => self.expected = FIRST,
                (START, _) if BYTE_ORDER_MARK.get(self.offset as usize + i) == Some(&byte) => {}
                (FIRST | RECORD, b'{') => {
                    let Some(end) = object_end(bytes, i) else { break };
                    records.push(i..end);
                    self.expected = SEPARATOR;
                    i = end;
                    continue;
                }
                (SEPARATOR, b',') => self.expected = RECORD,
                (FIRST | SEPARATOR, b']') => self.expected = END,
                (expected, _) => {
                    return Err(self.fail(i, format!("found {:?}, expected {expected}", byte as char)));
                }
            }
            i += 1;
        }
        Ok((records, i))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[derive(serde::Deserialize)]
    struct Row {
        a: i64,
        s: String,
    }

    fn read(text: &[u8], block_bytes: usize) -> Result<Vec<(i64, String)>> {
        read_rows(text, Path::new("t.json"), block_bytes, &|row: Row| Ok(Some((row.a, row.s))))
    }

    #[test]
    fn any_layout_and_any_block_size_give_the_same_rows() {
        let text = br#" [
{
"s": "br{ack}]ets, \"quotes\", \\ and \u00e9",
"a": 1,
"extra": [1, {"b": "]"}, -1.5e-3, true]
},{"a":2,"s":""} ]
"#;
        let expected = vec![(1, "br{ack}]ets, \"quotes\", \\ and é".to_owned()), (2, String::new())];
        for block_bytes in 1..=text.len() + 1 {
            assert_eq!(read(text, block_bytes).unwrap(), expected, "block of {block_bytes}");
            let marked = [BYTE_ORDER_MARK, text].concat();
            assert_eq!(read(&marked, block_bytes).unwrap(), expected, "block of {block_bytes}, marked");
        }
        assert!(read(b"[]", 1).unwrap().is_empty());
    }

    #[test]
    fn damage_is_refused_with_its_byte_offset() {
        let cases: [(&str, u64, &str); 10] = [
            ("[\u{feff}]", 1, "a record"),
            ("", 0, "empty"),
            ("  ", 2, "empty"),
            ("{}", 0, "an array of records"),
            ("[{\"a\":1,\"s\":\"\"}", 15, "ends"),
            ("[{\"a\":1,\"s\":\"\"},]", 16, "expected a record"),
            ("[{\"a\":1,\"s\":\"\"}{", 15, "comma"),
            ("[] []", 3, "nothing after"),
            ("[3]", 1, "a record"),
            ("[{\"a\":NaN,\"s\":\"\"}]", 6, "expected value (field \"a\")"),
        ];
        for (text, at, words) in cases {
            match read(text.as_bytes(), 1 << 20) {
                Err(NuscenesError::Json { offset, message, .. }) => {
                    assert!(message.contains(words), "{text}: {message}");
                    assert_eq!(offset, at, "{text}: {message}");
                }
                other => panic!("{text}: {other:?}"),
            }
        }
        let named = read(b"[{\"s\":\"\",\n\"a\": [1, NaN]}]", 99).unwrap_err().to_string();
        assert!(named.contains("byte 14") && named.contains("field \"a\""), "{named}");
        let missing = read(b"[{\"a\":1}]", 9).unwrap_err().to_string();
        assert!(missing.contains("missing field `s`, in {\"a\":1}: t.json"), "{missing}");
    }

    proptest! {
        #[test]
        fn arbitrary_bytes_never_panic_and_block_size_does_not_matter(
            bytes in proptest::collection::vec(prop_oneof![
                Just(b'['), Just(b']'), Just(b'{'), Just(b'}'), Just(b'"'), Just(b'\\'), Just(b','), any::<u8>()
            ], 0..80),
            block_bytes in 1_usize..100,
        ) {
            let whole = read(&bytes, 1 << 20).map_err(|e| matches!(e, NuscenesError::Json { .. }));
            let parts = read(&bytes, block_bytes).map_err(|e| matches!(e, NuscenesError::Json { .. }));
            prop_assert_eq!(whole, parts);
        }
    }
}
