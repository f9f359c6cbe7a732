//! Tokens as 128-bit numbers.

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
        Self::from_bytes(text.as_bytes())
    }

    /// [`Self::from_text`] without a look at the encoding.
    pub(crate) fn from_bytes(bytes: &[u8]) -> Self {
        Self(hex_value(bytes).unwrap_or_else(|| xxh3_128(bytes)))
    }
}

/// The value of 32 lower-case hexadecimal digits.
fn hex_value(bytes: &[u8]) -> Option<u128> {
    let is_digit = |byte: &u8| matches!(byte, b'0'..=b'9' | b'a'..=b'f');
    let digit = |byte: &u8| u64::from(if *byte < b'a' { byte - b'0' } else { byte - b'a' + 10 });
    let value = |digits: &[u8]| u128::from(digits.iter().fold(0, |value, byte| value << 4 | digit(byte)));
    let (high, low) = bytes.split_at_checked(16)?;
    (low.len() == 16 && bytes.iter().all(is_digit)).then(|| value(high) << 64 | value(low))
}

/// For messages: the digits of an official token; of any other only its hash is known.
impl fmt::Display for Token {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:032x}", self.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn digits_are_read_as_the_standard_library_reads_them(
            value in any::<u128>(),
            place in 0_usize..32,
            other in any::<u8>(),
        ) {
            let mut text = format!("{value:032x}").into_bytes();
            prop_assert_eq!(hex_value(&text), Some(value));
            text[place] = other;
            let known = std::str::from_utf8(&text).ok();
            let known = known.filter(|t| !t.contains(|c: char| c == '+' || c.is_ascii_uppercase()));
            prop_assert_eq!(hex_value(&text), known.and_then(|t| u128::from_str_radix(t, 16).ok()));
        }
    }

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
