//! Tokens as 128-bit numbers.

use std::fmt;
use xxhash_rust::xxh3::xxh3_128;

/// One in each of eight bytes.
const EACH: u64 = 0x0101_0101_0101_0101;

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
        Self::from_digits(bytes).unwrap_or_else(|| Self(xxh3_128(bytes)))
    }

    /// The token of 32 lower-case hexadecimal digits.
    pub(crate) fn from_digits(bytes: &[u8]) -> Option<Self> {
        hex_value(bytes).map(Self)
    }
}

/// The value of 32 lower-case hexadecimal digits, eight of them at a time.
fn hex_value(bytes: &[u8]) -> Option<u128> {
    let bytes: &[u8; 32] = bytes.try_into().ok()?;
    let (mut value, mut wrong) = (0, 0);
    for digits in bytes.as_chunks::<8>().0 {
        let text = u64::from_be_bytes(*digits);
        // letters have bit 6, and 1 to 6 in their lower half
        let lower_half = EACH * 0x0f;
        let nibbles = ((text & lower_half) + (text >> 6 & EACH) * 9) & lower_half;
        // what is not a digit is not what its value is written as
        let is_letter = (nibbles + EACH * 6) >> 4 & EACH;
        wrong |= text ^ (nibbles + EACH * 0x30 + is_letter * 0x27);
        let pairs = (nibbles | nibbles >> 4) & 0x00ff_00ff_00ff_00ff;
        let fours = (pairs | pairs >> 8) & 0x0000_ffff_0000_ffff;
        value = value << 32 | u128::from((fours | fours >> 16) as u32);
    }
    (wrong == 0).then_some(value)
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
