//! Where strings and brackets of JSON text end, found many bytes at a time.

/// Bytes looked at at once.
const BLOCK: usize = 64;
/// Bytes that a string is searched in at once: a token and its closing mark fit nearly.
const STRIP: usize = 32;

/// For each of 64 bytes a bit, the first byte's lowest.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Marks {
    /// Quotation marks.
    quotes: u64,
    /// Backslashes.
    escapes: u64,
    /// Brackets and braces, opening and closing.
    brackets: u64,
}

impl Marks {
    #[inline(always)]
    fn of(block: &[u8; BLOCK]) -> Self {
        let (strips, _) = block.as_chunks::<16>();
        let mut marks = Self { quotes: 0, escapes: 0, brackets: 0 };
        for (i, strip) in strips.iter().enumerate() {
            let strip = Strip::new(strip);
            marks.quotes |= u64::from(strip.equal_to(b'"')) << (16 * i);
            marks.escapes |= u64::from(strip.equal_to(b'\\')) << (16 * i);
            marks.brackets |= u64::from(strip.brackets()) << (16 * i);
        }
        marks
    }
}

/// Sixteen bytes in a vector that every processor of the architecture has.
#[cfg(target_arch = "x86_64")]
#[derive(Clone, Copy)]
struct Strip(std::arch::x86_64::__m128i);

#[cfg(target_arch = "x86_64")]
#[allow(unsafe_code, reason = "the compiler does not count on what the architecture prescribes")]
impl Strip {
    #[inline(always)]
    fn new(bytes: &[u8; 16]) -> Self {
        // SAFETY: sixteen bytes from anywhere; SSE2 is part of x86-64
        Self(unsafe { std::arch::x86_64::_mm_loadu_si128(bytes.as_ptr().cast()) })
    }

    #[inline(always)]
    fn equal_to(self, byte: u8) -> u16 {
        use std::arch::x86_64::{_mm_cmpeq_epi8, _mm_movemask_epi8, _mm_set1_epi8};
        // SAFETY: SSE2 is part of x86-64
        unsafe { _mm_movemask_epi8(_mm_cmpeq_epi8(self.0, _mm_set1_epi8(byte as i8))) as u16 }
    }

    /// Brackets and braces differ in one bit.
    #[inline(always)]
    fn brackets(self) -> u16 {
        use std::arch::x86_64::{_mm_or_si128, _mm_set1_epi8};
        // SAFETY: SSE2 is part of x86-64
        let folded = Self(unsafe { _mm_or_si128(self.0, _mm_set1_epi8(0x20)) });
        folded.equal_to(b'{') | folded.equal_to(b'}')
    }
}

/// Sixteen bytes, on other processors.
#[cfg(not(target_arch = "x86_64"))]
#[derive(Clone, Copy)]
struct Strip(PlainStrip);

#[cfg(not(target_arch = "x86_64"))]
impl Strip {
    #[inline(always)]
    fn new(bytes: &[u8; 16]) -> Self {
        Self(PlainStrip(*bytes))
    }

    #[inline(always)]
    fn equal_to(self, byte: u8) -> u16 {
        self.0.equal_to(byte)
    }

    #[inline(always)]
    fn brackets(self) -> u16 {
        self.0.brackets()
    }
}

/// Sixteen bytes, one after the other.
#[cfg(any(test, not(target_arch = "x86_64")))]
#[derive(Clone, Copy)]
struct PlainStrip([u8; 16]);

#[cfg(any(test, not(target_arch = "x86_64")))]
impl PlainStrip {
    #[inline(always)]
    fn equal_to(self, byte: u8) -> u16 {
        self.0.iter().enumerate().fold(0, |bits, (i, b)| bits | u16::from(*b == byte) << i)
    }

    #[inline(always)]
    fn brackets(self) -> u16 {
        [b'{', b'}', b'[', b']'].into_iter().fold(0, |bits, byte| bits | self.equal_to(byte))
    }
}

/// A bit is set where an odd number of bits are set up to and with it.
#[inline(always)]
fn parity_up_to(mut bits: u64) -> u64 {
    for shift in [1, 2, 4, 8, 16, 32] {
        bits ^= bits << shift;
    }
    bits
}

/// Position of the next quotation mark or backslash from `at` on.
#[inline]
pub(crate) fn find_quote_or_escape(text: &[u8], mut at: usize) -> Option<usize> {
    while let Some(bytes) = text.get(at..).and_then(|rest| rest.first_chunk::<STRIP>()) {
        let (halves, _) = bytes.as_chunks::<16>();
        let mut hits = 0;
        for (i, half) in halves.iter().enumerate() {
            let half = Strip::new(half);
            hits |= u32::from(half.equal_to(b'"') | half.equal_to(b'\\')) << (16 * i);
        }
        if hits != 0 {
            return Some(at + hits.trailing_zeros() as usize);
        }
        at += STRIP;
    }
    let rest = text.get(at..)?;
    rest.iter().position(|b| matches!(b, b'"' | b'\\')).map(|i| at + i)
}

/// Position after the array or object that begins at `at`, where it is short and has neither strings nor brackets in
/// it; as [`Nesting::advance`] finds it.
#[inline]
pub(crate) fn flat_end(text: &[u8], at: usize) -> Option<usize> {
    let bytes = text.get(at + 1..)?.first_chunk::<STRIP>()?;
    let (halves, _) = bytes.as_chunks::<16>();
    let mut hits = 0;
    for (i, half) in halves.iter().enumerate() {
        let half = Strip::new(half);
        hits |= u32::from(half.brackets() | half.equal_to(b'"') | half.equal_to(b'\\')) << (16 * i);
    }
    let first = hits.trailing_zeros() as usize;
    bytes.get(first).is_some_and(|b| matches!(b, b']' | b'}')).then_some(at + first + 2)
}

/// Where a search for the end of an object or array stands.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) struct Nesting {
    /// Open brackets.
    pub(crate) depth: usize,
    /// Within a string.
    pub(crate) in_string: bool,
}

impl Nesting {
    /// Before an opening bracket.
    pub(crate) const START: Self = Self { depth: 0, in_string: false };

    /// Goes on from `at` to after the bracket that closes the outermost one (`true`), or as far as the text goes: to
    /// its end, or to an escape whose second byte is not there.
    #[inline]
    pub(crate) fn advance(&mut self, text: &[u8], mut at: usize) -> (usize, bool) {
        // blocks up to here have an escape and are gone through byte by byte
        let mut slow_until = at;
        loop {
            while at >= slow_until
                && let Some(block) = text.get(at..).and_then(|rest| rest.first_chunk::<BLOCK>())
            {
                let marks = Marks::of(block);
                if marks.escapes != 0 {
                    slow_until = at + BLOCK;
                    break;
                }
                if let Some(end) = self.advance_block(block, marks) {
                    return (at + end, true);
                }
                at += BLOCK;
            }
            match text.get(at) {
                None => return (at, false),
                Some(b'\\') if self.in_string => {
                    if at + 1 >= text.len() {
                        return (at, false);
                    }
                    at += 1;
                }
                Some(b'"') => self.in_string = !self.in_string,
                Some(b'{' | b'[') if !self.in_string => self.depth += 1,
                Some(b'}' | b']') if !self.in_string => {
                    self.depth -= 1;
                    if self.depth == 0 {
                        return (at + 1, true);
                    }
                }
                _ => {}
            }
            at += 1;
        }
    }

    /// Position in a block without escapes after the bracket that closes the outermost one.
    #[inline(always)]
    fn advance_block(&mut self, block: &[u8; BLOCK], marks: Marks) -> Option<usize> {
        let before = if self.in_string { u64::MAX } else { 0 };
        let in_string = parity_up_to(marks.quotes) ^ before;
        let mut brackets = marks.brackets & !in_string;
        while brackets != 0 {
            let at = brackets.trailing_zeros() as usize;
            // bit 2 tells closing from opening ones
            if block[at] & 4 == 0 {
                self.depth += 1;
            } else {
                self.depth -= 1;
                if self.depth == 0 {
                    self.in_string = false;
                    return Some(at + 1);
                }
            }
            brackets &= brackets - 1;
        }
        self.in_string = in_string >> (BLOCK - 1) == 1;
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn any_text(most: usize) -> impl Strategy<Value = Vec<u8>> {
        let byte = prop_oneof![
            8 => any::<u8>(), 2 => Just(b'"'), 1 => Just(b'\\'), 1 => Just(b'['), 1 => Just(b']'), 1 => Just(b'{'),
            1 => Just(b'}'), 1 => Just(b'!'), 1 => Just(b'#')
        ];
        // long stretches without a backslash, too
        let calm = any_text_without_escapes(most);
        prop_oneof![prop::collection::vec(byte, 0..most), calm]
    }

    fn any_text_without_escapes(most: usize) -> impl Strategy<Value = Vec<u8>> {
        prop::collection::vec(
            prop_oneof![4 => Just(b'x'), 1 => Just(b'"'), 2 => Just(b'['), 1 => Just(b']'), 1 => Just(b'{'), 1 => Just(b'}')],
            0..most,
        )
    }

    /// What [`Nesting::advance`] does, byte by byte.
    fn plain_end(text: &[u8], mut at: usize) -> (usize, bool) {
        let (mut depth, mut in_string) = (0, false);
        while at < text.len() {
            match text[at] {
                b'\\' if in_string && at + 1 == text.len() => return (at, false),
                b'\\' if in_string => at += 1,
                b'"' => in_string = !in_string,
                b'{' | b'[' if !in_string => depth += 1,
                b'}' | b']' if !in_string => {
                    depth -= 1;
                    if depth == 0 {
                        return (at + 1, true);
                    }
                }
                _ => {}
            }
            at += 1;
        }
        (at, false)
    }

    proptest! {
        #[test]
        fn brackets_close_where_a_plain_search_closes_them_however_the_text_comes(
            text in any_text(400), cuts in prop::collection::vec(0_usize..400, 0..4),
        ) {
            let text = [b"[", text.as_slice()].concat();
            let expected = plain_end(&text, 0);
            prop_assert_eq!({ Nesting::START }.advance(&text, 0), expected);
            if let Some(end) = flat_end(&text, 0) {
                prop_assert_eq!((end, true), expected);
            }
            let (mut nesting, mut at, mut closed) = (Nesting::START, 0, false);
            let mut cuts: Vec<usize> = cuts.into_iter().map(|c| c.min(text.len())).collect();
            cuts.sort_unstable();
            for cut in cuts.into_iter().chain([text.len()]).skip_while(|c| *c == 0) {
                if !closed {
                    (at, closed) = nesting.advance(&text[..cut], at);
                }
            }
            prop_assert_eq!((at, closed), expected);
        }

        #[test]
        fn short_arrays_of_numbers_end_at_their_bracket(numbers in "[0-9., -]{0,31}", rest in any_text(60)) {
            let text = [b"[", numbers.as_bytes(), b"]", rest.as_slice()].concat();
            let whole = text.len() > 32;
            prop_assert_eq!(flat_end(&text, 0), whole.then_some(numbers.len() + 2));
        }

        #[test]
        fn quotes_and_escapes_are_found_where_a_plain_search_finds_them(
            bytes in proptest::collection::vec(prop_oneof![Just(b'"'), Just(b'\\'), any::<u8>(), any::<u8>(), any::<u8>(),
                Just(b'!'), Just(b'#'), Just(b'[')], 0..40),
            at in 0_usize..45,
        ) {
            let plain = bytes.iter().enumerate().skip(at).find(|(_, b)| matches!(b, b'"' | b'\\')).map(|(i, _)| i);
            prop_assert_eq!(find_quote_or_escape(&bytes, at), plain);
        }

        #[test]
        fn vectors_and_single_bytes_give_the_same_marks(bytes in prop::array::uniform16(any::<u8>()), byte in any::<u8>()) {
            let (strip, plain) = (Strip::new(&bytes), PlainStrip(bytes));
            prop_assert_eq!(strip.brackets(), plain.brackets());
            for byte in [byte, bytes[3], b'"', b'\\'] {
                prop_assert_eq!(strip.equal_to(byte), plain.equal_to(byte));
            }
        }
    }
}
