//! Reads a table, a JSON array of objects, as a stream: in blocks, in parallel, never whole.
//!
//! One thread reads the next block and finds where its records end while the others parse the records of the block
//! before. Layout does not matter: pretty-printed or on one line, fields in any order.

use crate::error::{NuscenesError, Result};
use crate::file;
use crate::record::{Record, Source, value_end};
use rayon::prelude::*;
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

/// Finds the fields of these names in every record of a table and keeps what `keep` makes of them, in the order of the
/// file. The number that `keep` is given passes from one record to the next of a task: see `TokenIndex::place_from`.
///
/// # Errors
/// Missing and unreadable files, invalid JSON (with its byte offset), and whatever `keep` refuses.
pub(crate) fn read_table<Kept, F, const N: usize>(
    path: &Path,
    what: &str,
    names: &'static [&'static str; N],
    keep: F,
) -> Result<Vec<Kept>>
where
    Kept: Send,
    F: Fn(&Record<'_, N>, &mut usize) -> Result<Option<Kept>> + Sync,
{
    let file = file::open(path).map_err(|e| NuscenesError::from_io(path, what, e))?;
    read_records(file, path, BLOCK_BYTES, names, &keep)
}

/// [`read_table`] from any reader; `path` is for messages.
fn read_records<R, Kept, F, const N: usize>(
    reader: R,
    path: &Path,
    block_bytes: usize,
    names: &'static [&'static str; N],
    keep: &F,
) -> Result<Vec<Kept>>
where
    R: Read + Send,
    Kept: Send,
    F: Fn(&Record<'_, N>, &mut usize) -> Result<Option<Kept>> + Sync,
{
    let mut blocks = Blocks::new(reader, path, block_bytes);
    let mut kept = Vec::new();
    let mut current = blocks.next_block(Vec::new())?;
    let mut spare = Vec::new();
    while let Some(block) = current {
        let (next, parsed) =
            rayon::join(|| blocks.next_block(spare), || parse_block(&block, path, names, keep));
        // an error in this block comes before one in the next
        for part in parsed? {
            kept.extend(part);
        }
        current = next?;
        spare = block.bytes;
    }
    Ok(kept)
}

/// Whole records, and where each of them lies.
struct Block {
    bytes: Vec<u8>,
    /// Offset of `bytes[0]` in the file.
    offset: u64,
    records: Vec<Range<usize>>,
}

fn parse_block<Kept, F, const N: usize>(
    block: &Block,
    path: &Path,
    names: &'static [&'static str; N],
    keep: &F,
) -> Result<Vec<Vec<Kept>>>
where
    Kept: Send,
    F: Fn(&Record<'_, N>, &mut usize) -> Result<Option<Kept>> + Sync,
{
    let parse = |records: &[Range<usize>]| {
        let (mut kept, mut next) = (Vec::with_capacity(records.len()), 0);
        for range in records {
            let source = Source { path, offset: block.offset + range.start as u64 };
            kept.extend(keep(&Record::new(&block.bytes[range.clone()], names, source)?, &mut next)?);
        }
        Ok(kept)
    };
    block.records.par_chunks(RECORDS_PER_TASK).map(parse).collect()
}

/// Where the scanner stands.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
enum At {
    /// Before the opening bracket.
    Start,
    /// After the opening bracket, or after a comma (`true`).
    Item { after_comma: bool },
    /// After a record: a comma or the closing bracket follows.
    Separator,
    /// After the closing bracket.
    End,
}

struct Blocks<'a, R> {
    reader: R,
    path: &'a Path,
    block_bytes: usize,
    /// Bytes of the record that the last block broke off in.
    tail: Vec<u8>,
    /// Offset of `tail[0]` in the file.
    offset: u64,
    at: At,
}

impl<'a, R: Read> Blocks<'a, R> {
    fn new(reader: R, path: &'a Path, block_bytes: usize) -> Self {
        Self { reader, path, block_bytes, tail: Vec::new(), offset: 0, at: At::Start }
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
            return match self.at {
                At::End => Ok(None),
                At::Start => Err(self.fail(bytes.len(), "the file is empty")),
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
            match self.at {
                _ if byte.is_ascii_whitespace() => {}
                At::Start if BYTE_ORDER_MARK.get(self.offset as usize + i) == Some(&byte) => {}
                At::Start if byte == b'[' => self.at = At::Item { after_comma: false },
                At::Item { .. } if byte == b'{' => {
                    let Some(end) = value_end(bytes, i) else { break };
                    records.push(i..end);
                    self.at = At::Separator;
                    i = end;
                    continue;
                }
                At::Item { after_comma: false } if byte == b']' => self.at = At::End,
                At::Separator if byte == b',' => self.at = At::Item { after_comma: true },
                At::Separator if byte == b']' => self.at = At::End,
                at => {
                    return Err(self.fail(i, format!("found {:?}, expected {}", byte as char, at.expects())));
                }
            }
            i += 1;
        }
        Ok((records, i))
    }
}

impl At {
    fn expects(self) -> &'static str {
        match self {
            Self::Start => "an array of records",
            Self::Item { .. } => "a record",
            Self::Separator => "a comma or the end of the array",
            Self::End => "nothing after the array",
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn read(text: &[u8], block_bytes: usize) -> Result<Vec<(i64, String)>> {
        let keep = |row: &Record<'_, 2>, _: &mut usize| Ok(Some((row.parse(0)?, row.text(1)?)));
        read_records(text, Path::new("t.json"), block_bytes, &["a", "s"], &keep)
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
            ("[{\"a\":NaN,\"s\":\"\"}]", 1, "expected value"),
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
        assert!(named.contains("field \"a\"") && named.contains("t.json"), "{named}");
        assert!(matches!(read(b"[{\"a\":1}]", 9), Err(NuscenesError::Json { offset: 1, .. })));
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
