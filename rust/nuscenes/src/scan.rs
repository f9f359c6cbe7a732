//! Where strings, objects and arrays of JSON text end.

use memchr::memchr2;

/// Position of the next quotation mark or backslash from `at` on.
#[inline]
pub(crate) fn find_quote_or_escape(text: &[u8], at: usize) -> Option<usize> {
    memchr2(b'"', b'\\', text.get(at..)?).map(|i| at + i)
}

/// Where a search for the end of an object or array stands.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(crate) struct Nesting {
    /// Open brackets.
    depth: usize,
    /// Within a string.
    in_string: bool,
}

impl Nesting {
    /// Before an opening bracket.
    pub(crate) const START: Self = Self { depth: 0, in_string: false };

    /// Goes on from `at` to after the bracket that closes the outermost one (`true`), or as far as the text goes: to
    /// its end, or to an escape whose second byte is not there.
    pub(crate) fn advance(&mut self, text: &[u8], mut at: usize) -> (usize, bool) {
        while let Some(byte) = text.get(at) {
            if self.in_string {
                match find_quote_or_escape(text, at) {
                    None => return (text.len(), false),
                    Some(mark) if text[mark] == b'"' => {
                        self.in_string = false;
                        at = mark + 1;
                    }
                    Some(mark) if mark + 1 == text.len() => return (mark, false),
                    Some(mark) => at = mark + 2,
                }
                continue;
            }
            match byte {
                b'"' => self.in_string = true,
                b'{' | b'[' => self.depth += 1,
                b'}' | b']' => {
                    self.depth -= 1;
                    if self.depth == 0 {
                        return (at + 1, true);
                    }
                }
                _ => {}
            }
            at += 1;
        }
        (at, false)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn any_text(most: usize) -> impl Strategy<Value = Vec<u8>> {
        let byte = prop_oneof![
            8 => any::<u8>(), 2 => Just(b'"'), 1 => Just(b'\\'), 1 => Just(b'['), 1 => Just(b']'), 1 => Just(b'{'), 1 => Just(b'}')
        ];
        prop::collection::vec(byte, 0..most)
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
    }
}
