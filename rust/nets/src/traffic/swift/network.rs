//! The network of swift traffic: agents pass one small network, the greatest of each feature stays, two layers follow, then the
//! logits of the bins of speed change, and of those of yaw rate given the first.

use super::SWIFT;
use super::seen::{EGO, OTHER, OWN, Rows, WHO};
use crate::compute::weights::{Entry, Weights, broken, field};
use crate::error::Result;
use crate::kernels::{Packed, linear};
use crate::networks::tokens::grid::{BINS, SPEED, YAW_RATE};
use crate::sampling::noise::Noise;
use ccdiff_sim::geom::Real;
use std::collections::BTreeMap;
use std::path::Path;

/// Widest layer of a file.
const MOST_WIDTH: usize = 1024;

/// Network and the memory that it works in.
#[derive(Debug, Clone)]
pub(super) struct Network {
    others: [Packed; 2],
    trunk: [Packed; 2],
    speed: Packed,
    turning: Packed,
    /// What a bin of speed adds to the features of turning, [[`BINS`], width].
    by_speed: Vec<Real>,
    yaw_rate: Packed,
    /// Criticality of worlds and that of the network, both rising.
    dial: Vec<[Real; 2]>,
}

/// What was computed of some rows; memory that is used again.
#[derive(Debug, Default)]
pub(super) struct Hidden {
    x: Vec<Real>,
    a: Vec<Real>,
    b: Vec<Real>,
    speed: Vec<Real>,
    turning: Vec<Real>,
    cumulative: Vec<Real>,
}

impl Network {
    /// From header and tensors of a file.
    pub(super) fn new(
        path: &Path,
        header: &serde_json::Value,
        tensors: BTreeMap<String, Entry>,
    ) -> Result<Self> {
        let kind: String = field(path, header, "kind")?;
        if kind != SWIFT.name {
            return Err(broken(path, "kind", format!("{kind:?}"), format!("{:?}", SWIFT.name)));
        }
        let dial: Vec<[Real; 2]> = field(path, header, "dial")?;
        let rises = dial.windows(2).all(|w| w[1][0] > w[0][0] && w[1][1] >= w[0][1]);
        let (first, fits) = (dial.first().copied(), dial.iter().flatten().all(|x| (0.0..=100.0).contains(x)));
        if first != Some([0.0, 0.0]) || !rises || !fits {
            return Err(broken(
                path,
                "dial",
                format!("{dial:?}"),
                "rising pairs up to 100, the first of them 0, 0",
            ));
        }
        let width = |name: &str| {
            let found = tensors.get(&format!("{name}.bias")).map_or(1, |(_, numbers)| numbers.len());
            found.clamp(1, MOST_WIDTH)
        };
        let [near, far, first, second, turning] =
            ["others.0", "others.1", "trunk.0", "trunk.1", "turning"].map(width);
        let weights = Weights::new(path, tensors);
        let layer = |name, inputs, outputs| weights.layer(name, inputs, outputs);
        let network = Self {
            others: [layer("others.0", OTHER, near), layer("others.1", near, far)],
            trunk: [layer("trunk.0", OWN + 2 * EGO + 1 + far, first), layer("trunk.1", first, second)],
            speed: layer("speed", second, BINS),
            turning: layer("turning", second, turning),
            by_speed: weights.take("by_speed", &[BINS, turning]).unwrap_or_default().to_vec(),
            yaw_rate: layer("yaw_rate", turning, BINS),
            dial,
        };
        weights.finish().map(|()| network)
    }

    /// The network's criticality for one of worlds; beyond the table it goes on evenly.
    pub(super) fn strength(&self, criticality: Real) -> Real {
        let [low, high] =
            match self.dial.windows(2).find(|w| criticality <= w[1][0]).or(self.dial.windows(2).last()) {
                Some(w) => [w[0], w[1]],
                None => [[0.0, 0.0], [1.0, 1.0]],
            };
        low[1] + (criticality - low[0]) / (high[0] - low[0]) * (high[1] - low[1])
    }

    /// Features and logits of rows at strengths [n]. Unguided vehicles are not told which agent is the ego.
    pub(super) fn see(&self, rows: &mut Rows, strengths: &[Real], hidden: &mut Hidden) {
        let far = self.others[1].columns;
        let Hidden { x, a, b, speed, turning, .. } = hidden;
        let mut others = rows.others.chunks_exact_mut(OTHER);
        for (seen, strength) in rows.seen.iter().zip(strengths) {
            let told = |other: &mut [Real]| other[WHO] = other[WHO].min(0.0);
            others.by_ref().take(*seen).filter(|_| *strength <= 0.0).for_each(told);
        }
        linear(&rows.others, &self.others[0], true, a);
        linear(a, &self.others[1], true, b);
        x.clear();
        let mut found = b.chunks_exact(far);
        let mut greatest = vec![0.0; far];
        for (i, strength) in strengths.iter().enumerate() {
            greatest.fill(0.0);
            for other in found.by_ref().take(rows.seen[i]) {
                greatest.iter_mut().zip(other).for_each(|(g, x)| *g = if *x > *g { *x } else { *g });
            }
            let ego = &rows.ego[i * EGO..][..EGO];
            let told = if *strength > 0.0 { 1.0 } else { 0.0 };
            x.extend_from_slice(&rows.own[i * OWN..][..OWN]);
            x.extend(ego.iter().map(|e| e * told));
            x.push(*strength);
            x.extend(ego.iter().map(|e| e * strength));
            x.extend_from_slice(&greatest);
        }
        linear(x, &self.trunk[0], true, a);
        linear(a, &self.trunk[1], true, b);
        linear(b, &self.speed, false, speed);
        linear(b, &self.turning, false, turning);
    }

    /// A change of speed (m/s in half a second) and a yaw rate (rad/s) of a row, by four random words.
    pub(super) fn draw(
        &self,
        row: usize,
        noise: Noise,
        draw: usize,
        temperature: Real,
        hidden: &mut Hidden,
    ) -> [Real; 2] {
        let words = noise.block(draw as u64).map(|w| (w >> 8) as Real / (1u32 << 24) as Real);
        let Hidden { a, b, speed, turning, cumulative, .. } = hidden;
        let bin = drawn(&speed[row * BINS..][..BINS], words[0], temperature, cumulative);
        let width = self.turning.columns;
        let add = |(t, s): (&Real, &Real)| if t + s > 0.0 { t + s } else { 0.0 };
        a.clear();
        a.extend(turning[row * width..][..width].iter().zip(&self.by_speed[bin * width..]).map(add));
        linear(a, &self.yaw_rate, false, b);
        let turn = drawn(b, words[2], temperature, cumulative);
        [SPEED.value(bin, words[1]), YAW_RATE.value(turn, words[3])]
    }
}

/// The bin that a share of the probabilities of logits falls into.
fn drawn(logits: &[Real], share: Real, temperature: Real, cumulative: &mut Vec<Real>) -> usize {
    let greatest = logits.iter().fold(Real::NEG_INFINITY, |m, v| if *v > m { *v } else { m });
    let mut sum = 0.0;
    cumulative.clear();
    cumulative.extend(logits.iter().map(|logit| {
        sum += libm::expf((logit - greatest) / temperature);
        sum
    }));
    cumulative.iter().take_while(|c| **c <= share * sum).count().min(BINS - 1)
}
