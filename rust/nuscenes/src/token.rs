//! Tokens of records, and what is looked up by them.

use serde::de::{Deserialize, Deserializer, Visitor};
use std::fmt;
use xxhash_rust::xxh3::xxh3_128;

const BYTES: usize = 32;

/// A token in the 32 bytes of official ones: shorter texts are filled up with zeros, longer ones become their hash.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Default)]
pub(crate) struct Token([u8; BYTES]);

/// Values by token.
#[allow(clippy::disallowed_types, reason = "looked up, never iterated over: no order is seen")]
pub(crate) type Index<T> = std::collections::HashMap<Token, T>;

/// Collects values by token.
pub(crate) fn index<T>(rows: impl IntoIterator<Item = (Token, T)>) -> Result<Index<T>, Token> {
    let rows = rows.into_iter();
    let mut found = Index::with_capacity(rows.size_hint().0);
    for (token, value) in rows {
        if found.insert(token, value).is_some() {
            return Err(token);
        }
    }
    Ok(found)
}

impl From<&str> for Token {
    fn from(text: &str) -> Self {
        let mut bytes = [0; BYTES];
        match bytes.get_mut(..text.len()) {
            Some(place) => place.copy_from_slice(text.as_bytes()),
            None => bytes.copy_from_slice(format!("{:032x}", xxh3_128(text.as_bytes())).as_bytes()),
        }
        Self(bytes)
    }
}

impl<'de> Deserialize<'de> for Token {
    fn deserialize<D: Deserializer<'de>>(from: D) -> Result<Self, D::Error> {
        struct Text;
        impl Visitor<'_> for Text {
            type Value = Token;

            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a token")
            }

            fn visit_str<E>(self, text: &str) -> Result<Token, E> {
                Ok(Token::from(text))
            }
        }
        from.deserialize_str(Text)
    }
}

impl fmt::Display for Token {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(String::from_utf8_lossy(&self.0).trim_end_matches('\0'))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tokens_are_told_apart_and_shown_as_they_are_written() {
        let texts = ["", "a", "b", "00e0f9ee6f8d4170a3d22a6179f1ca3a", "00E0F9EE6F8D4170A3D22A6179F1CA3A"];
        let longer = ["0658b80c-8ef7-4272-bf16-150f8a32025d", "0658b80c-8ef7-4272-bf16-150f8a32025e"];
        assert!(texts.iter().all(|text| Token::from(*text).to_string() == *text));
        let tokens = || texts.iter().chain(&longer).map(|text| (Token::from(*text), ()));
        assert_eq!(index(tokens()).map(|found| found.len()), Ok(texts.len() + longer.len()));
        assert_eq!(index(tokens().chain([(Token::from("a"), ())])), Err(Token::from("a")));
    }
}
