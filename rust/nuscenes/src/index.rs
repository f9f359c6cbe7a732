//! Values by token.

use crate::token::Token;
use rayon::prelude::*;

/// Bits of a token that choose its bucket, at most.
const MAX_BUCKET_BITS: u32 = 16;

/// Values sorted by token, with a table of where tokens with the same first bits begin: official tokens are random, so
/// a look-up reads about one entry.
#[derive(Debug, Clone)]
pub(crate) struct TokenIndex<T> {
    entries: Vec<(Token, T)>,
    shift: u32,
    /// Bucket b is `entries[starts[b]..starts[b + 1]]`.
    starts: Vec<u32>,
}

impl<T: Send> TokenIndex<T> {
    /// Sorts the entries; gives back a token that is there twice.
    pub(crate) fn new(mut entries: Vec<(Token, T)>) -> Result<Self, Token> {
        entries.par_sort_unstable_by_key(|(token, _)| *token);
        if let Some(pair) = entries.windows(2).find(|w| w[0].0 == w[1].0) {
            return Err(pair[0].0);
        }
        let bits = (usize::BITS - entries.len().leading_zeros()).clamp(1, MAX_BUCKET_BITS);
        let shift = u128::BITS - bits;
        let mut starts = vec![0; (1 << bits) + 1];
        for (token, _) in &entries {
            starts[(token.0 >> shift) as usize + 1] += 1;
        }
        for bucket in 1..starts.len() {
            starts[bucket] += starts[bucket - 1];
        }
        Ok(Self { entries, shift, starts })
    }

    /// The value of a token.
    pub(crate) fn get(&self, token: Token) -> Option<&T> {
        let bucket = (token.0 >> self.shift) as usize;
        let range = self.starts[bucket] as usize..self.starts[bucket + 1] as usize;
        let entries = &self.entries[range];
        entries.binary_search_by_key(&token, |(t, _)| *t).ok().map(|i| &entries[i].1)
    }

    /// All entries in the order of tokens.
    pub(crate) fn into_entries(self) -> Vec<(Token, T)> {
        self.entries
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::collections::BTreeMap;

    proptest! {
        #[test]
        fn finds_what_a_map_finds(
            random in proptest::collection::vec(any::<u128>(), 0..200),
            close in proptest::collection::vec(0_u128..50, 0..30),
        ) {
            let tokens: Vec<Token> = random.into_iter().chain(close).map(Token).collect();
            let expected: BTreeMap<Token, usize> = tokens.iter().copied().zip(0..).collect();
            let index = TokenIndex::new(expected.clone().into_iter().collect()).ok().unwrap();
            for token in tokens.iter().copied().chain((0..60).map(Token)) {
                prop_assert_eq!(index.get(token), expected.get(&token));
            }
            if let Some(token) = tokens.first() {
                prop_assert_eq!(TokenIndex::new(vec![(*token, 1), (*token, 2)]).err(), Some(*token));
            }
        }
    }
}
