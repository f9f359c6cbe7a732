//! One JSON object of which some fields are wanted: they are found in one pass, and only those asked for are parsed.
//!
//! Tables have many fields that nobody needs here (file names, links between annotations …). Passing over values is several
//! times faster than making something of them.

use crate::error::{NuscenesError, Result};
use crate::token::Token;
use serde::Deserialize;
use serde::de::{DeserializeSeed, Deserializer, Error, IgnoredAny, MapAccess, Visitor};
use serde_json::value::RawValue;
use std::collections::BTreeMap;
use std::fmt;
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

impl<'a> Source<'a> {
    pub(crate) fn fail(&self, at: usize, message: impl Into<String>) -> NuscenesError {
        let offset = self.offset + at as u64;
        NuscenesError::Json { path: self.path.to_owned(), offset, message: message.into() }
    }

    /// Where a value of the stretch's text stands.
    fn text(&self, text: &'a [u8], value: &'a RawValue) -> Text<'a> {
        let at = value.get().as_ptr().addr() - text.as_ptr().addr();
        (value.get().as_bytes(), Source { offset: self.offset + at as u64, ..*self })
    }

    /// Invalid JSON in the stretch's text.
    fn invalid(&self, text: &[u8], error: &serde_json::Error) -> NuscenesError {
        let lines = text.split(|byte| *byte == b'\n').take(error.line().saturating_sub(1));
        let at = lines.map(|line| line.len() + 1).sum::<usize>() + error.column().saturating_sub(1);
        self.fail(at, reason(error))
    }
}

/// What is wrong, without line and column, which count from the value's beginning.
fn reason(error: &serde_json::Error) -> String {
    let text = error.to_string();
    text.split(" at line ").next().unwrap_or_default().to_owned()
}

/// The first bytes of a text, for a message.
fn excerpt(bytes: &[u8]) -> String {
    const SHOWN: usize = 80;
    let text = String::from_utf8_lossy(&bytes[..bytes.len().min(SHOWN)]).replace(['\n', '\r'], " ");
    if bytes.len() > SHOWN { format!("{text}…") } else { text }
}

/// Which of some names a key is; looks at a likely one first.
struct Name<'n>(&'n [&'static str], usize);

impl<'de> DeserializeSeed<'de> for Name<'_> {
    type Value = Option<usize>;

    fn deserialize<D: Deserializer<'de>>(self, key: D) -> std::result::Result<Option<usize>, D::Error> {
        key.deserialize_str(self)
    }
}

impl Visitor<'_> for Name<'_> {
    type Value = Option<usize>;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("the name of a field")
    }

    fn visit_str<E>(self, key: &str) -> std::result::Result<Option<usize>, E> {
        let Self(names, likely) = self;
        let is_likely = names.get(likely).is_some_and(|name| *name == key);
        Ok(if is_likely { Some(likely) } else { names.iter().position(|name| *name == key) })
    }
}

/// The values of some names in an object.
struct Fields<const N: usize>(&'static [&'static str; N]);

impl<'de, const N: usize> Visitor<'de> for Fields<N> {
    type Value = [Option<&'de RawValue>; N];

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("an object")
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> std::result::Result<Self::Value, A::Error> {
        let (mut values, mut likely) = ([None; N], 0);
        while let Some(name) = map.next_key_seed(Name(self.0, likely))? {
            let Some(field) = name else {
                map.next_value::<IgnoredAny>()?;
                continue;
            };
            let named = |error: A::Error| {
                let text = error.to_string();
                let text = text.split(" at line ").next().unwrap_or_default();
                A::Error::custom(format!("{text} (field {:?})", self.0[field]))
            };
            values[field].get_or_insert(map.next_value::<&RawValue>().map_err(named)?);
            likely = field + 1;
        }
        Ok(values)
    }
}

/// Some fields of an object. If a name appears twice, the first one counts.
pub(crate) struct Record<'a, const N: usize> {
    source: Source<'a>,
    text: &'a [u8],
    names: &'static [&'static str; N],
    values: [Option<&'a RawValue>; N],
}

impl<'a, const N: usize> Record<'a, N> {
    /// The record of a text that should be an object.
    pub(crate) fn new(text: &'a [u8], names: &'static [&'static str; N], source: Source<'a>) -> Result<Self> {
        let mut json = serde_json::Deserializer::from_slice(text);
        let values = json.deserialize_map(Fields(names)).and_then(|values| json.end().map(|()| values));
        let values =
            values.map_err(|e| source.fail(0, format!("{}, in record {}", reason(&e), excerpt(text))))?;
        Ok(Self { source, text, names, values })
    }

    fn fault(&self, field: usize, reason: &str) -> NuscenesError {
        let message = format!("{reason} (field {:?}), in record {}", self.names[field], excerpt(self.text));
        self.source.fail(0, message)
    }

    /// The text of a value, and where it stands.
    pub(crate) fn raw(&self, field: usize) -> Result<Text<'a>> {
        let value = self.values[field].ok_or_else(|| self.fault(field, "missing field"))?;
        Ok(self.source.text(self.text, value))
    }

    /// Whether there is such a field and it is not null.
    pub(crate) fn has(&self, field: usize) -> bool {
        self.values[field].is_some_and(|value| value.get() != "null")
    }

    /// A value of any kind.
    pub(crate) fn parse<T: Deserialize<'a>>(&self, field: usize) -> Result<T> {
        let (text, _) = self.raw(field)?;
        serde_json::from_slice(text)
            .map_err(|e| self.fault(field, &format!("{} in {}", reason(&e), excerpt(text))))
    }

    /// A token.
    pub(crate) fn token(&self, field: usize) -> Result<Token> {
        let (text, _) = self.raw(field)?;
        match plain_string(text) {
            Some(bytes) => Ok(Token::from_bytes(bytes)),
            None => Ok(Token::from_text(&self.parse::<String>(field)?)),
        }
    }

    /// A token as it is written.
    pub(crate) fn text(&self, field: usize) -> Result<String> {
        self.parse(field)
    }
}

/// The bytes of a string that has no escapes.
pub(crate) fn plain_string(text: &[u8]) -> Option<&[u8]> {
    let inner = text.strip_prefix(b"\"")?.strip_suffix(b"\"")?;
    (!inner.contains(&b'\\')).then_some(inner)
}

/// A value of any kind from its text.
pub(crate) fn parse<'a, T: Deserialize<'a>>((text, source): Text<'a>) -> Result<T> {
    serde_json::from_slice(text).map_err(|e| source.invalid(text, &e))
}

/// The members of an object.
pub(crate) fn members(of: Text<'_>) -> Result<BTreeMap<String, Text<'_>>> {
    let found: BTreeMap<String, &RawValue> = parse(of)?;
    Ok(found.into_iter().map(|(key, value)| (key, of.1.text(of.0, value))).collect())
}

/// The elements of an array.
pub(crate) fn elements(of: Text<'_>) -> Result<Vec<Text<'_>>> {
    let found: Vec<&RawValue> = parse(of)?;
    Ok(found.into_iter().map(|value| of.1.text(of.0, value)).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn source() -> Source<'static> {
        Source { path: Path::new("t.json"), offset: 100 }
    }

    #[test]
    fn fields_are_found_in_any_order_and_layout() {
        let names = &["a", "b", "t"];
        for text in [
            r#"{"a": [1.5, -2e3], "x": {"a": "}]\"", "y": [[]]}, "b":"\u00e9{","t":"00000000000000000000000000000010"}"#,
            "{ \"t\"\n:\"00000000000000000000000000000010\" ,\"b\" : \"é{\",\"a\":[1.5,-2000.0], \"a\": 3\r\n}",
        ] {
            let record = Record::new(text.as_bytes(), names, source()).unwrap();
            assert_eq!(record.parse::<[f64; 2]>(0).unwrap(), [1.5, -2000.0]);
            assert_eq!(record.text(1).unwrap(), "é{");
            assert_eq!(record.token(2).unwrap(), Token(16));
            let (value, place) = record.raw(1).unwrap();
            assert_eq!(&text.as_bytes()[(place.offset - 100) as usize..][..value.len()], value);
        }
    }

    #[test]
    fn faults_name_field_value_and_place() {
        let names = &["a", "b"];
        let whole = Record::new(br#"{"a": [1, 2, 3]}"#, names, source()).unwrap();
        let broken = Record::new(br#"{"a": [1, NaN]}"#, names, source());
        for message in [whole.parse::<[f64; 2]>(0).unwrap_err(), broken.err().unwrap()].map(|e| e.to_string())
        {
            for words in ["byte 100", "t.json", "\"a\"", "[1, "] {
                assert!(message.contains(words), "{message}");
            }
        }
        assert!(whole.text(1).unwrap_err().to_string().contains("missing field"));
        let two_lines = parse::<[f64; 2]>((b"[1,\n x]", source())).unwrap_err().to_string();
        assert!(two_lines.contains("byte 105"), "{two_lines}");
        for text in [
            "",
            "[",
            "{",
            "{\"a\"",
            "{\"a\":",
            "{\"a\":1",
            "{\"a\":1,}",
            "{\"a\" 1}",
            "{a:1}",
            "{\"a\":}",
            "{}x",
        ] {
            assert!(Record::new(text.as_bytes(), names, source()).is_err(), "{text}");
        }
    }

    proptest! {
        #[test]
        fn arbitrary_bytes_never_panic(bytes in proptest::collection::vec(prop_oneof![
            Just(b'['), Just(b']'), Just(b'{'), Just(b'}'), Just(b'"'), Just(b'\\'), Just(b','), Just(b':'), any::<u8>()
        ], 0..60)) {
            let _ = (elements((&bytes, source())), members((&bytes, source())));
            if let Ok(record) = Record::new(&bytes, &["", "a"], source()) {
                let _ = (record.token(0), record.parse::<[f64; 3]>(1), record.text(0), record.has(1));
            }
        }
    }
}
