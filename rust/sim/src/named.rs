//! Enums with names.

/// An enum from a list `Variant = "name",`, with the name of each and all of them in order.
macro_rules! named {
    ($(#[$about:meta])+ pub enum $enum:ident { $($(#[$doc:meta])+ $variant:ident = $name:literal,)+ }) => {
        $(#[$about])+
        #[derive(Debug, Clone, Copy, PartialEq, Eq)]
        #[repr(u8)]
        pub enum $enum { $($(#[$doc])+ $variant,)+ }

        impl $enum {
            /// All in order.
            pub const ALL: [Self; [$($name),+].len()] = [$(Self::$variant),+];

            /// Name in Python and in files.
            pub fn name(self) -> &'static str {
                match self { $(Self::$variant => $name),+ }
            }
        }
    };
}

pub(crate) use named;
