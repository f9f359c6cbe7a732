//! Times, lengths and strengths of what images and the replay page draw alike; the page reads them by name.

macro_rules! look {
    ($($(#[$doc:meta])+ $name:ident: $value:expr;)+) => {
        $($(#[$doc])+ pub const $name: f32 = $value;)+
        /// All of them by name.
        pub const LOOK: &[(&str, f32)] = &[$((stringify!($name), $name)),+];
    };
}

look! {
    /// How far back trails reach, seconds.
    TRAIL_S: 3.0;
    /// Parts of a trail, each stronger than the one before.
    TRAIL_PARTS: 6.0;
    /// Parts of a plan, each fainter than the one before.
    PLAN_PARTS: 4.0;
    /// Time for which a collision is marked, seconds.
    MARK_S: 1.0;
    /// Radius of that mark, metres and pixels on top.
    MARK_M: 3.0;
    /// The same, pixels.
    MARK_PX: 6.0;
    /// A vehicle that is never further than this from where it was first is parked, metres.
    PARKED_M: 0.5;
    /// How opaque parked vehicles are filled; their outline has their colour.
    PARKED_ALPHA: 0.2;
    /// How opaque the band of a path ahead is.
    PATH_ALPHA: 0.16;
    /// Length of a vehicle in an image, at least, pixels.
    LEAST_LENGTH_PX: 9.0;
    /// Dash, and the gap after it, of lines between lanes, metres.
    LANE_DASH_M: 3.0;
    /// Dash of centre lines, metres.
    CENTRE_DASH_M: 0.5;
    /// Gap after it, metres.
    CENTRE_GAP_M: 1.3;
    /// Width of the stop lines of lights that are red, metres: the wider, the more they forbid.
    RED_LIGHT_M: 1.0;
    /// The same of yellow ones.
    YELLOW_LIGHT_M: 0.7;
    /// The same of green ones.
    GREEN_LIGHT_M: 0.4;
    /// Stripe of a crossing, and the gap after it, metres.
    STRIPE_M: 0.55;
    /// Way between the arrows of a lane, metres.
    CHEVRON_GAP_M: 14.0;
    /// How far they reach back and aside, metres.
    CHEVRON_M: 0.55;
}
