//! Tokens as 128-bit numbers.

use serde::de::{Deserialize, Deserializer, Visitor};
use std::fmt;
use xxhash_rust::xxh3::xxh3_128;

/// A token of the data set in 16 bytes: the value of 32 lower-case hexadecimal digits, otherwise a hash of the text.
///
/// Official tokens are of the first kind. Two different texts with one value would be reported as a duplicate or a
/// wrong reference; with 128-bit hashes that does not happen by chance.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Default)]
pub(crate) struct Token(pub(crate) u128);

impl Token {
    pub(crate) fn from_text(text: &str) -> Self {
        Self(hex_value(text.as_bytes()).unwrap_or_else(|| xxh3_128(text.as_bytes())))
    }
}

fn hex_value(bytes: &[u8]) -> Option<u128> {
    if bytes.len() != 32 {
        return None;
    }
    bytes.iter().try_fold(0_u128, |value, byte| {
        let digit = match byte {
            b'0'..=b'9' => byte - b'0',
            b'a'..=b'f' => byte - b'a' + 10,
            _ => return None,
        };
        Some(value << 4 | u128::from(digit))
    })
}

/// For messages: the digits of an official token; of any other only its hash is known.
impl fmt::Display for Token {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:032x}", self.0)
    }
}

impl<'de> Deserialize<'de> for Token {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        struct TokenVisitor;
        impl Visitor<'_> for TokenVisitor {
            type Value = Token;
            fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
                f.write_str("a token (string)")
            }
            fn visit_str<E: serde::de::Error>(self, text: &str) -> Result<Token, E> {
                Ok(Token::from_text(text))
            }
        }
        deserializer.deserialize_str(TokenVisitor)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn official_tokens_keep_their_digits_and_others_are_told_apart() {
        let text = "00e0f9ee6f8d4170a3d22a6179f1ca3a";
        assert_eq!(Token::from_text(text).to_string(), text);
        let others = [
            "",
            "a",
            "b",
            "00E0F9EE6F8D4170A3D22A6179F1CA3A",
            "00e0f9ee6f8d4170a3d22a6179f1ca3",
            "0658b80c-8ef7-4272-bf16-150f8a32025d",
        ];
        let mut values: Vec<Token> = others.iter().map(|t| Token::from_text(t)).collect();
        values.push(Token::from_text(text));
        values.sort_unstable();
        values.dedup();
        assert_eq!(values.len(), others.len() + 1);
    }
}
