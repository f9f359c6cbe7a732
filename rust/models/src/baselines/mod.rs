//! How the paper's rivals of CCDiff learn (rivals.md), one file each. All plan in the same action knots and see the same inputs
//! through one trunk; the networks are those of `ccdiff-nets`.

mod bits;
mod contact;
mod cvae;
mod distributions;
mod simnet;
