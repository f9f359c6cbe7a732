//! Values by token.

use crate::token::Token;
use rayon::prelude::*;

/// Values in the order they were given, found by their tokens.
#[derive(Debug, Clone)]
pub(crate) struct TokenIndex<T> {
    entries: Vec<(Token, T)>,
    /// Places of the entries, sorted by token.
    places: Vec<u32>,
}

impl<T: Sync> TokenIndex<T> {
    /// Takes the entries; gives back a token that is there twice.
    pub(crate) fn new(entries: Vec<(Token, T)>) -> Result<Self, Token> {
        let mut places: Vec<u32> = (0..entries.len() as u32).collect();
        let token = |place: &u32| entries[*place as usize].0;
        places.par_sort_unstable_by_key(token);
        match places.windows(2).find(|w| token(&w[0]) == token(&w[1])) {
            Some(pair) => Err(token(&pair[0])),
            None => Ok(Self { entries, places }),
        }
    }

    /// Place of a token's entry in the order they were given.
    pub(crate) fn place(&self, token: Token) -> Option<usize> {
        let found = self.places.binary_search_by_key(&token, |place| self.entries[*place as usize].0).ok()?;
        Some(self.places[found] as usize)
    }

    /// The value of a token.
    pub(crate) fn get(&self, token: Token) -> Option<&T> {
        Some(&self.entries[self.place(token)?].1)
    }

    /// [`Self::get`] with a look first at the entry after the one that was found last: lists of tokens often name entries
    /// one after the other. The outcome is the same whatever `next` says.
    pub(crate) fn get_from(&self, next: &mut usize, token: Token) -> Option<&T> {
        let follows = self.entries.get(*next).is_some_and(|(t, _)| *t == token);
        let found = if follows { *next } else { self.place(token)? };
        *next = found + 1;
        Some(&self.entries[found].1)
    }

    /// All entries in the order they were given.
    pub(crate) fn entries(&self) -> &[(Token, T)] {
        &self.entries
    }
}

/// A token that is there twice.
pub(crate) fn find_twice(mut tokens: Vec<Token>) -> Option<Token> {
    tokens.par_sort_unstable();
    tokens.windows(2).find(|w| w[0] == w[1]).map(|w| w[0])
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
            prop_assert_eq!(find_twice(tokens.clone()).is_some(), expected.len() < tokens.len());
            let twice = find_twice(tokens.clone()).is_none_or(|t| tokens.iter().filter(|other| **other == t).count() > 1);
            prop_assert!(twice);
            let mut entries: Vec<(Token, usize)> = expected.clone().into_iter().collect();
            entries.sort_by_key(|(_, i)| *i);
            let index = TokenIndex::new(entries).ok().unwrap();
            for token in tokens.iter().copied().chain((0..60).map(Token)) {
                prop_assert_eq!(index.get(token), expected.get(&token));
                prop_assert_eq!(index.get_from(&mut next, token), expected.get(&token));
            }
            if let Some(token) = tokens.first() {
                prop_assert_eq!(TokenIndex::new(vec![(*token, 1), (*token, 2)]).err(), Some(*token));
            }
        }
    }
}
