//! Values by token.

use crate::token::Token;

/// Bits of a token that choose its bucket, at most.
const MAX_BUCKET_BITS: u32 = 20;

/// Values in the order they were given, with a table of where tokens with the same first bits are: official tokens are
/// random, so a look-up reads about one entry.
#[derive(Debug, Clone)]
pub(crate) struct TokenIndex<T> {
    entries: Vec<(Token, T)>,
    /// Places of the entries; those of bucket b are `places[starts[b]..starts[b + 1]]`, sorted by token.
    places: Vec<u32>,
    starts: Vec<u32>,
    shift: u32,
}

impl<T> TokenIndex<T> {
    /// Takes the entries; gives back a token that is there twice.
    pub(crate) fn new(entries: Vec<(Token, T)>) -> Result<Self, Token> {
        let bits = (usize::BITS - entries.len().leading_zeros()).clamp(1, MAX_BUCKET_BITS);
        let shift = u128::BITS - bits;
        let mut starts = vec![0; (1 << bits) + 1];
        for (token, _) in &entries {
            starts[(token.0 >> shift) as usize + 1] += 1;
        }
        for bucket in 1..starts.len() {
            starts[bucket] += starts[bucket - 1];
        }
        let (mut places, mut free) = (vec![0; entries.len()], starts.clone());
        for (place, (token, _)) in entries.iter().enumerate() {
            let at = &mut free[(token.0 >> shift) as usize];
            places[*at as usize] = place as u32;
            *at += 1;
        }
        let token = |place: &u32| entries[*place as usize].0;
        for range in starts.windows(2).filter(|w| w[1] - w[0] > 1) {
            let bucket = &mut places[range[0] as usize..range[1] as usize];
            bucket.sort_unstable_by_key(token);
            if let Some(pair) = bucket.windows(2).find(|w| token(&w[0]) == token(&w[1])) {
                return Err(token(&pair[0]));
            }
        }
        Ok(Self { entries, places, starts, shift })
    }

    /// Place of a token's entry in the order they were given.
    pub(crate) fn place(&self, token: Token) -> Option<usize> {
        let bucket = (token.0 >> self.shift) as usize;
        let places = &self.places[self.starts[bucket] as usize..self.starts[bucket + 1] as usize];
        let found = places.binary_search_by_key(&token, |place| self.entries[*place as usize].0).ok()?;
        Some(places[found] as usize)
    }

    /// The value of a token.
    pub(crate) fn get(&self, token: Token) -> Option<&T> {
        Some(&self.entries[self.place(token)?].1)
    }

    /// [`Self::place`] with a look first at the entry after the one that was found last: lists of tokens often name entries
    /// one after the other. The outcome is the same whatever `next` says.
    pub(crate) fn place_from(&self, next: &mut usize, token: Token) -> Option<usize> {
        let follows = self.entries.get(*next).is_some_and(|(t, _)| *t == token);
        let found = if follows { *next } else { self.place(token)? };
        *next = found + 1;
        Some(found)
    }

    /// [`Self::get`] as [`Self::place_from`] does it.
    pub(crate) fn get_from(&self, next: &mut usize, token: Token) -> Option<&T> {
        Some(&self.entries[self.place_from(next, token)?].1)
    }

    /// All entries in the order they were given.
    pub(crate) fn entries(&self) -> &[(Token, T)] {
        &self.entries
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use std::collections::BTreeMap;

    proptest! {
        #[test]
        fn finds_what_a_map_finds_wherever_it_looks_first(
            random in proptest::collection::vec(any::<u128>(), 0..200),
            close in proptest::collection::vec(0_u128..50, 0..30),
            mut next in 0_usize..300,
        ) {
            let tokens: Vec<Token> = random.into_iter().chain(close).map(Token).collect();
            let expected: BTreeMap<Token, usize> = tokens.iter().copied().zip(0..).collect();
            let given = tokens.iter().copied().zip(0..).collect();
            let twice = TokenIndex::<usize>::new(given).err();
            prop_assert_eq!(twice.is_some(), expected.len() < tokens.len());
            prop_assert!(twice.is_none_or(|t| tokens.iter().filter(|other| **other == t).count() > 1));
            let mut entries: Vec<(Token, usize)> = expected.clone().into_iter().collect();
            entries.sort_by_key(|(_, i)| *i);
            let index = TokenIndex::new(entries).ok().unwrap();
            for token in tokens.iter().copied().chain((0..60).map(Token)) {
                prop_assert_eq!(index.get(token), expected.get(&token));
                prop_assert_eq!(index.get_from(&mut next, token), expected.get(&token));
            }
        }
    }
}
