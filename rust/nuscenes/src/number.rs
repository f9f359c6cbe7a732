//! Numbers of JSON text without the detour over a general parser.

/// Powers of ten that are exact in an f64.
const POWERS: [f64; 23] = [
    1e0, 1e1, 1e2, 1e3, 1e4, 1e5, 1e6, 1e7, 1e8, 1e9, 1e10, 1e11, 1e12, 1e13, 1e14, 1e15, 1e16, 1e17, 1e18,
    1e19, 1e20, 1e21, 1e22,
];
/// Whole numbers up to here are exact in an f64.
const MAX_EXACT: u64 = 1 << f64::MANTISSA_DIGITS;
/// Digits that certainly fit a u64.
const MAX_DIGITS: usize = 19;

/// The value of the number that `text` begins with, and the length of it; `None` for one that is not plain: with an
/// exponent, with more digits than an f64 holds exactly, or not as JSON has it. Rounded correctly.
#[inline]
fn plain_prefix(text: &[u8]) -> Option<(f64, usize)> {
    let negative = text.first() == Some(&b'-');
    let start = usize::from(negative);
    let mut at = start;
    let mut significand = 0_u64;
    let mut digits = |at: &mut usize| {
        while let Some(digit) = text.get(*at).map(|b| b.wrapping_sub(b'0')).filter(|d| *d < 10) {
            significand = significand.wrapping_mul(10).wrapping_add(u64::from(digit));
            *at += 1;
        }
    };
    digits(&mut at);
    let mut num_digits = at - start;
    if num_digits == 0 || (num_digits > 1 && text[start] == b'0') {
        return None;
    }
    let mut num_decimals = 0;
    if text.get(at) == Some(&b'.') {
        at += 1;
        let point = at;
        digits(&mut at);
        num_decimals = at - point;
        num_digits += num_decimals;
        if num_decimals == 0 {
            return None;
        }
    }
    if num_digits > MAX_DIGITS || significand > MAX_EXACT || matches!(text.get(at), Some(b'e' | b'E')) {
        return None;
    }
    // one rounding of two exact numbers (Clinger, PLDI 1990)
    let value = significand as f64 / POWERS[num_decimals];
    Some((if negative { -value } else { value }, at))
}

/// The value of a whole number without sign or exponent.
pub(crate) fn plain_integer(text: &[u8]) -> Option<i64> {
    // eighteen digits certainly fit
    if !(1..=18).contains(&text.len()) || (text.len() > 1 && text[0] == b'0') {
        return None;
    }
    text.iter().try_fold(0, |value, byte| {
        let digit = byte.wrapping_sub(b'0');
        (digit < 10).then(|| value * 10 + i64::from(digit))
    })
}

/// The value of a plain number.
pub(crate) fn plain_number(text: &[u8]) -> Option<f64> {
    plain_prefix(text).filter(|(_, length)| *length == text.len()).map(|(value, _)| value)
}

/// The values of an array of so many plain numbers.
pub(crate) fn plain_numbers<const K: usize>(text: &[u8]) -> Option<[f64; K]> {
    let mut rest = text.strip_prefix(b"[")?;
    let mut values = [0.0; K];
    for (i, value) in values.iter_mut().enumerate() {
        rest = rest.trim_ascii_start();
        let (number, length) = plain_prefix(rest)?;
        *value = number;
        rest = rest[length..].trim_ascii_start();
        rest = rest.strip_prefix(if i + 1 < K { b"," } else { b"]" })?;
    }
    rest.is_empty().then_some(values)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn what_is_not_plain_is_left_to_others() {
        for text in [
            "",
            "-",
            "01",
            "-00",
            ".5",
            "5.",
            "1e3",
            "1.5E2",
            "+1",
            "9007199254740993",
            "1.00000000000000000000",
            "1 ",
        ] {
            assert_eq!(plain_number(text.as_bytes()), None, "{text}");
        }
        for text in ["", "[", "[1]", "[1,2", "[1,2]x", "[1,2,3]", "[1,,2]", "[1 2]", "1,2"] {
            assert_eq!(plain_numbers::<2>(text.as_bytes()), None, "{text}");
        }
        assert_eq!(plain_numbers::<2>(b"[ -0.5 ,\n2 ]"), Some([-0.5, 2.0]));
        assert_eq!(plain_number(b"-0").map(f64::to_bits), Some((-0.0_f64).to_bits()));
    }

    proptest! {
        #[test]
        fn values_are_those_of_serde_and_of_the_standard_library(
            whole in prop_oneof![0_u64..3, any::<u64>()], decimals in "[0-9]{0,12}", negative in any::<bool>(),
        ) {
            let point = if decimals.is_empty() { "" } else { "." };
            let text = format!("{}{whole}{point}{decimals}", if negative { "-" } else { "" });
            if let Some(value) = plain_number(text.as_bytes()) {
                prop_assert_eq!(value.to_bits(), text.parse::<f64>().unwrap().to_bits());
                prop_assert_eq!(value.to_bits(), serde_json::from_str::<f64>(&text).unwrap().to_bits());
            } else {
                prop_assert!(text.len() > 15, "{text} is plain");
            }
        }

        #[test]
        fn whatever_is_taken_for_a_number_is_one(text in "[-+0-9.eE ]{0,8}") {
            if let Some(value) = plain_number(text.as_bytes()) {
                prop_assert_eq!(serde_json::from_str::<f64>(&text).ok().map(f64::to_bits), Some(value.to_bits()));
            }
        }
    }
}
