//! The grid of tokens: a change of speed in half a second, and the yaw rate at its end.

/// Bins on each axis; the middle one is round 0.
pub const BINS: usize = 21;
/// Number of tokens.
pub const NUM_TOKENS: usize = BINS * BINS;
/// Steps that a token is held for.
pub const TOKEN_STEPS: usize = 5;

/// A symmetric axis of bins, finer near 0: the greater half of the centres, and the outer edge.
#[derive(Debug, Clone, Copy)]
pub(crate) struct Axis {
    half: [f32; BINS / 2],
    last: f32,
}

/// Changes of speed, m/s.
pub(crate) const SPEED: Axis =
    Axis { half: [0.08, 0.18, 0.30, 0.45, 0.65, 0.90, 1.20, 1.60, 2.10, 3.00], last: 4.0 };
/// Yaw rates, rad/s.
pub(crate) const YAW_RATE: Axis =
    Axis { half: [0.008, 0.020, 0.040, 0.065, 0.10, 0.15, 0.21, 0.29, 0.38, 0.50], last: 0.6 };

impl Axis {
    /// Outer edge of a bin `away` from the middle one.
    fn edge(&self, away: usize) -> f32 {
        let centre = |k: usize| if k == 0 { 0.0 } else { self.half[k - 1] };
        if away < BINS / 2 { 0.5 * (centre(away) + centre(away + 1)) } else { self.last }
    }

    /// The bin that holds a value; those beyond the grid go to its border.
    pub(crate) fn bin(&self, value: f32) -> usize {
        let away = (0..BINS / 2).take_while(|k| value.abs() > self.edge(*k)).count();
        if value < 0.0 { BINS / 2 - away } else { BINS / 2 + away }
    }

    /// A value of a bin, evenly drawn by `share` in [0, 1) between its edges.
    pub(crate) fn value(&self, bin: usize, share: f32) -> f32 {
        let away = bin.abs_diff(BINS / 2);
        if away == 0 {
            return (2.0 * share - 1.0) * self.edge(0);
        }
        let (inner, outer) = (self.edge(away - 1), self.edge(away));
        let value = inner + share * (outer - inner);
        if bin < BINS / 2 { -value } else { value }
    }
}

/// Bins of a change of speed (m/s in half a second) and a yaw rate (rad/s).
pub fn token_of(speed_change_mps: f32, yaw_rate_radps: f32) -> [usize; 2] {
    [SPEED.bin(speed_change_mps), YAW_RATE.bin(yaw_rate_radps)]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn values_drawn_from_a_bin_are_in_it_and_mirrored_ones_in_the_mirrored_bin() {
        for axis in [SPEED, YAW_RATE] {
            for (bin, share) in (0..BINS).flat_map(|bin| [0.01, 0.5, 0.99].map(|share| (bin, share))) {
                let value = axis.value(bin, share);
                assert_eq!(axis.bin(value), bin);
                assert_eq!(axis.bin(-value), BINS - 1 - bin);
                let mirrored = axis.value(BINS - 1 - bin, if bin == BINS / 2 { 1.0 - share } else { share });
                assert!((mirrored + value).abs() < 1e-6);
            }
            assert_eq!((axis.bin(1e3), axis.bin(-1e3)), (BINS - 1, 0));
        }
        // edges half-way between centres
        assert_eq!(token_of(0.039, -0.0041), [10, 9]);
        assert_eq!(token_of(0.041, 0.0039), [11, 10]);
    }
}
