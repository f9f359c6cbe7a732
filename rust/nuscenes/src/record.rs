//! One JSON object, read lazily: its fields are found in one pass, and only those asked for are parsed.
//!
//! Tables have many fields that nobody needs here (file names, links between annotations …) and, for most loads, many
//! records that nobody needs. Finding where values end is several times faster than parsing them.

use crate::error::{NuscenesError, Result};
use crate::scan::{Nesting, find_quote_or_escape};
use crate::token::Token;
use serde::Deserialize;
use std::ops::Range;
use std::path::Path;

/// A piece of a file's text, and where it stands.
pub(crate) type Text<'a> = (&'a [u8], Source<'a>);

/// A stretch of a file.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Source<'a> {
    pub(crate) path: &'a Path,
    /// Where the stretch begins in the file.
    pub(crate) offset: u64,
}

impl Source<'_> {
    pub(crate) fn fail(&self, at: usize, message: impl Into<String>) -> NuscenesError {
        let offset = self.offset + at as u64;
        NuscenesError::Json { path: self.path.to_owned(), offset, message: message.into() }
    }
}

/// The first bytes of a text, for a message.
fn excerpt(bytes: &[u8]) -> String {
    const SHOWN: usize = 80;
    let text = String::from_utf8_lossy(&bytes[..bytes.len().min(SHOWN)]).replace(['\n', '\r'], " ");
    if bytes.len() > SHOWN { format!("{text}…") } else { text }
}

/// Some fields of an object, looked for when they are asked for.
///
/// If a name appears twice, the first one counts; text after the last field asked for is not looked at.
pub(crate) struct Record<'a, const N: usize> {
    source: Source<'a>,
    text: &'a [u8],
    names: &'static [&'static str; N],
    values: [Option<Range<usize>>; N],
    members: Members<'a>,
    /// The name that comes next in most records.
    likely: usize,
}

impl<'a, const N: usize> Record<'a, N> {
    /// The record of a text that should be an object.
    pub(crate) fn new(text: &'a [u8], names: &'static [&'static str; N], source: Source<'a>) -> Self {
        let members = Members::new(text, source);
        Self { source, text, names, values: [const { None }; N], members, likely: 0 }
    }

    fn fault(&self, field: usize, reason: &str) -> NuscenesError {
        let message = format!("{reason} (field {:?}), in record {}", self.names[field], excerpt(self.text));
        self.source.fail(0, message)
    }

    /// Place of a field's value.
    fn find(&mut self, field: usize) -> Result<Option<Range<usize>>> {
        while self.values[field].is_none() {
            let Some((key, value)) = self.members.next_member()? else { return Ok(None) };
            let matches = |i: usize| self.names[i].as_bytes() == key;
            let found = if matches(self.likely) { Some(self.likely) } else { (0..N).find(|i| matches(*i)) };
            if let Some(i) = found {
                self.values[i].get_or_insert(value);
                self.likely = (i + 1) % N;
            }
        }
        Ok(self.values[field].clone())
    }

    /// The text of a value, and where it stands.
    pub(crate) fn raw(&mut self, field: usize) -> Result<Text<'a>> {
        let range = self.find(field)?.ok_or_else(|| self.fault(field, "missing field"))?;
        let offset = self.source.offset + range.start as u64;
        Ok((&self.text[range], Source { offset, ..self.source }))
    }

    /// Whether there is such a field and it is not null.
    pub(crate) fn has(&mut self, field: usize) -> Result<bool> {
        Ok(self.find(field)?.is_some_and(|range| &self.text[range] != b"null"))
    }

    /// A value of any kind.
    pub(crate) fn parse<T: Deserialize<'a>>(&mut self, field: usize) -> Result<T> {
        let (text, _) = self.raw(field)?;
        serde_json::from_slice(text).map_err(|e| {
            // its line and column count from the value's beginning: the excerpt says more
            let reason = e.to_string();
            let reason = reason.split(" at line ").next().unwrap_or_default();
            self.fault(field, &format!("{reason} in {}", excerpt(text)))
        })
    }

    /// A token.
    pub(crate) fn token(&mut self, field: usize) -> Result<Token> {
        let (text, _) = self.raw(field)?;
        match plain_string(text) {
            Some(bytes) => Ok(Token::from_bytes(bytes)),
            None => Ok(Token::from_text(&self.parse::<String>(field)?)),
        }
    }

    /// A token as it is written.
    pub(crate) fn text(&mut self, field: usize) -> Result<String> {
        self.parse(field)
    }
}

/// The bytes of a string that has no escapes.
pub(crate) fn plain_string(text: &[u8]) -> Option<&[u8]> {
    let inner = text.strip_prefix(b"\"")?.strip_suffix(b"\"")?;
    find_quote_or_escape(inner, 0).is_none().then_some(inner)
}

/// Position of the first byte from `at` on that is not white space.
fn skip_space(text: &[u8], mut at: usize) -> usize {
    while text.get(at).is_some_and(u8::is_ascii_whitespace) {
        at += 1;
    }
    at
}

/// Position after the string that begins at `at` with a quotation mark.
fn skip_string(text: &[u8], at: usize) -> Option<usize> {
    let mut i = at + 1;
    loop {
        i = find_quote_or_escape(text, i)?;
        if text[i] == b'"' {
            return Some(i + 1);
        }
        i += 2;
    }
}

/// Position after the value that begins at `at`; `None` where the text ends in it.
fn skip_value(text: &[u8], at: usize) -> Option<usize> {
    match text.get(at)? {
        b'"' => skip_string(text, at),
        b'{' | b'[' => {
            let (end, closed) = { Nesting::START }.advance(text, at);
            closed.then_some(end)
        }
        _ => {
            let ends = |b: &u8| matches!(b, b',' | b'}' | b']') || b.is_ascii_whitespace();
            let length = text[at..].iter().position(ends)?;
            (length > 0).then_some(at + length)
        }
    }
}

/// The members of an object, one after another.
pub(crate) struct Members<'a> {
    text: &'a [u8],
    source: Source<'a>,
    at: usize,
    is_open: bool,
}

impl<'a> Members<'a> {
    pub(crate) fn new(text: &'a [u8], source: Source<'a>) -> Self {
        Self { text, source, at: 0, is_open: false }
    }

    fn expected(&self, at: usize, what: &str) -> NuscenesError {
        let found = self.text.get(at).map_or("the end".to_owned(), |b| format!("{:?}", *b as char));
        self.source.fail(at, format!("found {found}, expected {what}, in {}", excerpt(self.text)))
    }

    /// Bytes of the key and place of the value; `None` after the last one. Names with escapes are refused, which is
    /// legal JSON that no data set has.
    pub(crate) fn next_member(&mut self) -> Result<Option<(&'a [u8], Range<usize>)>> {
        let text = self.text;
        let mut at = skip_space(text, self.at);
        if !self.is_open {
            if text.get(at) != Some(&b'{') {
                return Err(self.expected(at, "an object"));
            }
            self.is_open = true;
            at = skip_space(text, at + 1);
            if text.get(at) == Some(&b'}') {
                return self.end(at);
            }
        } else {
            match text.get(at) {
                Some(b',') => at = skip_space(text, at + 1),
                Some(b'}') => return self.end(at),
                // after the closing bracket
                None => return Ok(None),
                _ => return Err(self.expected(at, "a comma or the end of the object")),
            }
        }
        if text.get(at) != Some(&b'"') {
            return Err(self.expected(at, "the name of a field"));
        }
        let key_end = find_quote_or_escape(text, at + 1)
            .ok_or_else(|| self.expected(text.len(), "the end of a string"))?;
        if text[key_end] == b'\\' {
            return Err(self.expected(key_end, "the name of a field without escapes"));
        }
        let key = &text[at + 1..key_end];
        at = skip_space(text, key_end + 1);
        if text.get(at) != Some(&b':') {
            return Err(self.expected(at, "a colon"));
        }
        at = skip_space(text, at + 1);
        let end = skip_value(text, at).ok_or_else(|| self.expected(at, "a value"))?;
        self.at = end;
        Ok(Some((key, at..end)))
    }

    fn end(&mut self, at: usize) -> Result<Option<(&'a [u8], Range<usize>)>> {
        let rest = skip_space(self.text, at + 1);
        if rest < self.text.len() {
            return Err(self.source.fail(rest, "more text after the end of an object"));
        }
        self.at = rest;
        Ok(None)
    }
}

/// Places of the elements of an array.
pub(crate) fn elements(text: &[u8], source: Source<'_>) -> Result<Vec<Range<usize>>> {
    let fail = |at: usize, what: &str| {
        let found = text.get(at).map_or("the end".to_owned(), |b| format!("{:?}", *b as char));
        source.fail(at, format!("found {found}, expected {what}"))
    };
    let mut found = Vec::new();
    if text.first() != Some(&b'[') {
        return Err(fail(0, "an array"));
    }
    let mut at = skip_space(text, 1);
    if text.get(at) == Some(&b']') {
        return Ok(found);
    }
    loop {
        let end = skip_value(text, at).ok_or_else(|| fail(at, "a value"))?;
        found.push(at..end);
        at = skip_space(text, end);
        match text.get(at) {
            Some(b',') => at = skip_space(text, at + 1),
            Some(b']') => return Ok(found),
            _ => return Err(fail(at, "a comma or the end of the array")),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use serde_json::Value;

    fn source() -> Source<'static> {
        Source { path: Path::new("t.json"), offset: 100 }
    }

    #[test]
    fn fields_are_found_in_any_order_and_layout() {
        let names = &["a", "b", "t"];
        for text in [
            r#"{"a": [1.5, -2e3], "x": {"a": "}]\"", "y": [[]]}, "b":"\u00e9{","t":"00000000000000000000000000000010"}"#,
            "{ \"t\"\n:\"00000000000000000000000000000010\" ,\"b\" : \"é{\",\"a\":[1.5,-2000.0]\r\n}",
        ] {
            let mut record = Record::new(text.as_bytes(), names, source());
            assert_eq!(record.parse::<[f64; 2]>(0).unwrap(), [1.5, -2000.0]);
            assert_eq!(record.text(1).unwrap(), "é{");
            assert_eq!(record.token(2).unwrap(), Token(16));
        }
    }

    #[test]
    fn faults_name_field_value_and_place() {
        let names = &["a", "b"];
        let mut record = Record::new(br#"{"a": [1, NaN]}"#, names, source());
        let message = record.parse::<[f64; 2]>(0).unwrap_err().to_string();
        for words in ["byte 100", "t.json", "\"a\"", "NaN"] {
            assert!(message.contains(words), "{message}");
        }
        assert!(record.text(1).unwrap_err().to_string().contains("missing field"));
        let broken = [
            "",
            "[",
            "{",
            "{\"a\"",
            "{\"a\":",
            "{\"a\":1",
            "{\"a\":1,}",
            "{\"a\" 1}",
            "{a:1}",
            r#"{"\u0061":1}"#,
            "{\"a\":}",
            "{}x",
        ];
        for text in broken {
            assert!(Record::new(text.as_bytes(), names, source()).text(1).is_err(), "{text}");
        }
    }

    fn any_json() -> impl Strategy<Value = Value> {
        let leaf = prop_oneof![
            Just(Value::Null),
            any::<bool>().prop_map(Value::from),
            any::<i64>().prop_map(Value::from),
            ".{0,6}".prop_map(Value::from),
        ];
        leaf.prop_recursive(3, 24, 4, |inner| {
            prop_oneof![
                proptest::collection::vec(inner.clone(), 0..4).prop_map(Value::from),
                proptest::collection::btree_map("[a-c]{1,2}", inner, 0..4)
                    .prop_map(|m| Value::Object(m.into_iter().collect())),
            ]
        })
    }

    proptest! {
        #[test]
        fn members_and_elements_are_those_that_serde_finds(value in any_json(), pretty in any::<bool>()) {
            let text = if pretty { serde_json::to_string_pretty(&value) } else { serde_json::to_string(&value) }.unwrap();
            let text = text.as_bytes();
            match &value {
                Value::Object(map) => {
                    let mut found = serde_json::Map::new();
                    let mut members = Members::new(text, source());
                    while let Some((key, range)) = members.next_member().unwrap() {
                        let key = std::str::from_utf8(key).unwrap().to_owned();
                        found.insert(key, serde_json::from_slice(&text[range]).unwrap());
                    }
                    prop_assert!(members.next_member().unwrap().is_none());
                    prop_assert_eq!(&found, map);
                }
                Value::Array(list) => {
                    let found = elements(text, source()).unwrap();
                    let found: Vec<Value> = found.into_iter().map(|r| serde_json::from_slice(&text[r]).unwrap()).collect();
                    prop_assert_eq!(&found, list);
                }
                _ => {
                    prop_assert!(elements(text, source()).is_err());
                }
            }
        }

        #[test]
        fn arbitrary_bytes_never_panic(bytes in proptest::collection::vec(prop_oneof![
            Just(b'['), Just(b']'), Just(b'{'), Just(b'}'), Just(b'"'), Just(b'\\'), Just(b','), Just(b':'), any::<u8>()
        ], 0..60)) {
            let _ = elements(&bytes, source());
            let mut record = Record::new(&bytes, &["", "a"], source());
            let _ = (record.token(0), record.parse::<[f64; 3]>(1), record.text(0), record.has(1));
        }
    }
}
