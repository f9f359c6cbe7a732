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

/// Values of lower-case hexadecimal digits; 255 for other bytes.
const DIGITS: [u8; 256] = {
    let mut digits = [255; 256];
    let mut value = 0;
    while value < 16 {
        digits[b"0123456789abcdef"[value] as usize] = value as u8;
        value += 1;
    }
    digits
};

fn hex_value(bytes: &[u8]) -> Option<u128> {
    let bytes: &[u8; 32] = bytes.try_into().ok()?;
    let (mut halves, mut seen) = ([0_u64; 2], 0);
    for (half, digits) in halves.iter_mut().zip(bytes.as_chunks::<16>().0) {
        for byte in digits {
            let digit = DIGITS[*byte as usize];
            seen |= digit;
            *half = *half << 4 | u64::from(digit & 15);
        }
    }
    (seen < 16).then_some(u128::from(halves[0]) << 64 | u128::from(halves[1]))
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
