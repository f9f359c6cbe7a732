//! One JSON object of which some fields are wanted: they are found in one pass, and only those asked for are parsed.
//!
//! Tables have many fields that nobody needs here (file names, links between annotations …). Of these only the end is looked
//! for, which is several times faster than reading them; what stands within them, and after the last field
//! asked for, is not checked.

use crate::error::{NuscenesError, Result};
use crate::token::Token;
use memchr::{memchr, memchr2};
use serde::Deserialize;
use std::borrow::Cow;
use std::collections::BTreeMap;
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

    /// What stands at a place of the stretch's text is not what should.
    fn expected(&self, text: &[u8], at: usize, what: &str) -> NuscenesError {
        let found = text.get(at).map_or("the end".to_owned(), |byte| format!("{:?}", *byte as char));
        self.fail(at, format!("found {found}, expected {what}, in {}", excerpt(text)))
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

/// Position of the first byte from `at` on that is not white space.
fn skip_space(text: &[u8], at: usize) -> usize {
    let space = text[at..].iter().take_while(|byte| byte.is_ascii_whitespace());
    at + space.count()
}

/// Bytes at which something begins or ends within objects and arrays.
static MARKS: [bool; 256] = {
    let mut marks = [false; 256];
    (marks[b'"' as usize], marks[b'{' as usize], marks[b'[' as usize]) = (true, true, true);
    (marks[b']' as usize], marks[b'}' as usize]) = (true, true);
    marks
};

/// Position after the value that begins at `at`; `None` where the text ends in it or no value begins there.
pub(crate) fn value_end(text: &[u8], mut at: usize) -> Option<usize> {
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
            b'}' | b']' => depth = depth.checked_sub(1)?,
            _ => {
                let ends = |b: &u8| matches!(b, b',' | b':' | b'}' | b']') || b.is_ascii_whitespace();
                let length = text[at..].iter().position(ends)?;
                return (length > 0).then_some(at + length);
            }
        }
        at += 1;
        if depth == 0 {
            return Some(at);
        }
        at += text[at..].iter().position(|byte| MARKS[usize::from(*byte)])?;
    }
}

/// Gives `take` where each of the items between brackets begins, for where it ends; `None` if no more are wanted.
fn walk(
    (text, source): Text<'_>,
    brackets: [u8; 2],
    mut take: impl FnMut(usize) -> Result<Option<usize>>,
) -> Result<()> {
    let mut at = skip_space(text, 0);
    if text.get(at) != Some(&brackets[0]) {
        return Err(source.expected(text, at, if brackets[0] == b'{' { "an object" } else { "an array" }));
    }
    at = skip_space(text, at + 1);
    if text.get(at) != Some(&brackets[1]) {
        loop {
            let Some(end) = take(at)? else { return Ok(()) };
            at = skip_space(text, end);
            match text.get(at) {
                Some(b',') => at = skip_space(text, at + 1),
                Some(byte) if *byte == brackets[1] => break,
                _ => return Err(source.expected(text, at, "a comma or a closing bracket")),
            }
        }
    }
    at = skip_space(text, at + 1);
    if at < text.len() { Err(source.expected(text, at, "the end of the record")) } else { Ok(()) }
}

/// The value that begins at a place, and where it ends.
fn value<'a>((text, source): Text<'a>, at: usize) -> Result<(Text<'a>, usize)> {
    let end = value_end(text, at).ok_or_else(|| source.expected(text, at, "a value"))?;
    Ok(((&text[at..end], Source { offset: source.offset + at as u64, ..source }), end))
}

/// Gives `take` the texts of the name and the value of each member of an object, until it wants no more (`false`).
fn walk_members<'a>(of: Text<'a>, mut take: impl FnMut(Text<'a>, Text<'a>) -> Result<bool>) -> Result<()> {
    let (text, source) = of;
    walk(of, *b"{}", |at| {
        let (name, end) = value(of, at)?;
        let colon = skip_space(text, end);
        if text[at] != b'"' || text.get(colon) != Some(&b':') {
            return Err(source.expected(text, at, "the name of a field and a colon"));
        }
        let (member, end) = value(of, skip_space(text, colon + 1))?;
        Ok(take(name, member)?.then_some(end))
    })
}

/// Some fields of an object. If a name appears twice, the first one counts.
pub(crate) struct Record<'a, const N: usize> {
    source: Source<'a>,
    text: &'a [u8],
    names: &'static [&'static str; N],
    values: [Option<Text<'a>>; N],
}

impl<'a, const N: usize> Record<'a, N> {
    /// The record of a text that should be an object.
    pub(crate) fn new(text: &'a [u8], names: &'static [&'static str; N], source: Source<'a>) -> Result<Self> {
        let (mut values, mut likely) = ([None; N], 0);
        walk_members((text, source), |name, value| {
            let is = |key: &[u8], field: usize| names[field].as_bytes() == key;
            // fields come in one order in most records
            let field = if is(&name.0[1..name.0.len() - 1], likely) {
                Some(likely)
            } else {
                let key = string(name)?;
                (0..N).find(|field| is(&key, *field))
            };
            if let Some(field) = field {
                values[field].get_or_insert(value);
                likely = (field + 1) % N;
                return Ok(values.iter().any(Option::is_none));
            }
            Ok(true)
        })?;
        Ok(Self { source, text, names, values })
    }

    fn fault(&self, field: usize, reason: &str) -> NuscenesError {
        let message = format!("{reason} (field {:?}), in record {}", self.names[field], excerpt(self.text));
        self.source.fail(0, message)
    }

    /// The text of a value, and where it stands.
    pub(crate) fn raw(&self, field: usize) -> Result<Text<'a>> {
        self.values[field].ok_or_else(|| self.fault(field, "missing field"))
    }

    /// Whether there is such a field and it is not null.
    pub(crate) fn has(&self, field: usize) -> bool {
        self.values[field].is_some_and(|(text, _)| text != b"null")
    }

    /// A value of any kind.
    pub(crate) fn parse<T: Deserialize<'a>>(&self, field: usize) -> Result<T> {
        let (text, _) = self.raw(field)?;
        serde_json::from_slice(text)
            .map_err(|e| self.fault(field, &format!("{} in {}", reason(&e), excerpt(text))))
    }

    /// A token.
    pub(crate) fn token(&self, field: usize) -> Result<Token> {
        match plain_token(self.raw(field)?.0) {
            Some(token) => Ok(token),
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
    memchr(b'\\', inner).is_none().then_some(inner)
}

/// The token that a string without escapes is.
fn plain_token(text: &[u8]) -> Option<Token> {
    let inner = text.strip_prefix(b"\"")?.strip_suffix(b"\"")?;
    Token::from_digits(inner).or_else(|| plain_string(text).map(Token::from_bytes))
}

/// The token that a string is.
pub(crate) fn token(of: Text<'_>) -> Result<Token> {
    plain_token(of.0).map_or_else(|| Ok(Token::from_bytes(&string(of)?)), Ok)
}

/// The bytes of a string.
fn string(of: Text<'_>) -> Result<Cow<'_, [u8]>> {
    plain_string(of.0).map_or_else(|| Ok(parse::<String>(of)?.into_bytes().into()), |bytes| Ok(bytes.into()))
}

/// A value of any kind from its text.
pub(crate) fn parse<'a, T: Deserialize<'a>>((text, source): Text<'a>) -> Result<T> {
    serde_json::from_slice(text).map_err(|e| source.invalid(text, &e))
}

/// The members of an object.
pub(crate) fn members(of: Text<'_>) -> Result<BTreeMap<String, Text<'_>>> {
    let mut found = BTreeMap::new();
    walk_members(of, |name, value| {
        found.insert(parse(name)?, value);
        Ok(true)
    })?;
    Ok(found)
}

/// The elements of an array.
pub(crate) fn elements(of: Text<'_>) -> Result<Vec<Text<'_>>> {
    let mut found = Vec::new();
    walk(of, *b"[]", |at| {
        let (text, end) = value(of, at)?;
        found.push(text);
        Ok(Some(end))
    })?;
    Ok(found)
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
            "{ \"\\u0074\"\n:\"00000000000000000000000000000010\" ,\"b\" : \"é{\",\"a\":[1.5,-2000.0], \"a\": 3\r\n}",
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
        let broken = Record::new(br#"{"a": [1, NaN]}"#, names, source()).unwrap();
        for record in [&whole, &broken] {
            let message = record.parse::<[f64; 2]>(0).unwrap_err().to_string();
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
            "{\"a\":]}",
            "{\"a\\x\":1}",
            "{}x",
        ] {
            assert!(Record::new(text.as_bytes(), names, source()).is_err(), "{text}");
        }
    }

    fn any_json() -> impl Strategy<Value = Value> {
        let leaf = prop_oneof![
            Just(Value::Null),
            any::<i64>().prop_map(Value::from),
            ".{0,6}".prop_map(Value::from)
        ];
        leaf.prop_recursive(3, 24, 4, |inner| {
            prop_oneof![
                proptest::collection::vec(inner.clone(), 0..4).prop_map(Value::from),
                proptest::collection::btree_map(".{0,3}", inner, 0..4)
                    .prop_map(|members| Value::Object(members.into_iter().collect())),
            ]
        })
    }

    proptest! {
        #[test]
        fn members_and_elements_are_those_that_serde_json_finds(json in any_json(), is_pretty in any::<bool>()) {
            let text = if is_pretty { serde_json::to_string_pretty(&json) } else { serde_json::to_string(&json) }.unwrap();
            let of = (text.as_bytes(), source());
            let found = members(of).map(|found| found.into_iter().map(|(k, v)| (k, parse(v).unwrap())).collect());
            prop_assert_eq!(found.ok().map(Value::Object), json.is_object().then(|| json.clone()));
            let found = elements(of).map(|found| found.into_iter().map(|v| parse(v).unwrap()).collect());
            prop_assert_eq!(found.ok().map(Value::Array), json.is_array().then_some(json));
        }

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
