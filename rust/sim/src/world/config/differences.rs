//! What is drawn for a slot and an episode beside its start: hidden differences and the style of its reward.

use crate::dynamics::Action;
use crate::error::{Result, SimError};
use crate::geom::Real;
use crate::geom::math::is_sound;
use crate::options;
use crate::options::{Range, within};
use crate::world::reward_columns::{COMPONENTS, NUM_COMPONENTS, RewardConfig, RewardForm};
use crate::world::rng::Rng;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Ranges of factors of weights of the reward, by name.
pub(crate) type Styles = BTreeMap<String, [Real; 2]>;

const SHARE: Range = within(0.0, 0.9);
/// Components that are no sums in a reward that is a product.
const FACTORS: [&str; 4] = ["comfort", "speed_limit", "lane_keeping", "jerk"];

options! {
    /// Unobserved changes of the dynamics, drawn for each agent with a slot and episode.
    #[derive(Clone, Copy)]
    #[serde(deny_unknown_fields, default)]
    pub struct Randomization {
        /// Accelerations are scaled by up to 1 ± this.
        acceleration_gain: Real = 0.0, range SHARE;
        /// The same for yaw rates or wheel angles.
        yaw_gain: Real = 0.0, range SHARE;
        /// Actions take effect up to this many steps late; until then the action is zero.
        delay_steps: usize = 0, range within(0.0, 100.0);
        /// Length and width are scaled by up to 1 ± this.
        size: Real = 0.0, range SHARE;
        /// Standard deviation of noise on numbers with a unit in observations, by their scales.
        noise: Real = 0.0, range within(0.0, 10.0);
    }
}

impl Randomization {
    /// Whether actions are changed.
    pub(crate) fn of_actions(&self) -> bool {
        self.acceleration_gain > 0.0 || self.yaw_gain > 0.0 || self.delay_steps > 0
    }
}

/// What was drawn for a slot.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
pub struct Drawn {
    /// Factors of the acceleration and of the yaw rate or wheel angle.
    pub gains: [Real; 2],
    /// Factor of length and width.
    pub size: Real,
    /// Factors of the weights of the reward, in the order of its components.
    pub style: [Real; NUM_COMPONENTS],
    /// Actions on their way, as many as there are steps of delay, in a ring.
    pub pending: Vec<Action>,
}

impl Drawn {
    /// Draws from a stream of the slot's own; factors of `style` by name are taken as they are.
    pub(crate) fn new(
        c: &Randomization,
        ranges: &Styles,
        style: &BTreeMap<String, Real>,
        mut rng: Rng,
    ) -> Self {
        let mut between = |low: Real, high: Real| low + (high - low) * rng.uniform();
        let gains = [c.acceleration_gain, c.yaw_gain].map(|x| between(1.0 - x, 1.0 + x));
        let size = between(1.0 - c.size, 1.0 + c.size);
        let style = COMPONENTS.map(|name| {
            let drawn = match ranges.get(name) {
                // added later: draws nothing where it is not asked for, so that what follows stays
                None if name == "red_light" => 1.0,
                range => {
                    let [low, high] = range.copied().unwrap_or([1.0; 2]);
                    between(low, high)
                }
            };
            style.get(name).copied().unwrap_or(drawn)
        });
        let pending = vec![Action::default(); rng.below(c.delay_steps + 1)];
        Self { gains, size, style, pending }
    }

    /// The action that takes effect when another one is given.
    pub(crate) fn delayed(&mut self, given: Action, elapsed_steps: usize) -> Action {
        let at = elapsed_steps % self.pending.len().max(1);
        self.pending.get_mut(at).map_or(given, |waiting| std::mem::replace(waiting, given))
    }

    /// A physical action times the gains.
    pub(crate) fn times_gains(&self, [first, second, third]: Action) -> Action {
        [first * self.gains[0], second * self.gains[1], third]
    }

    /// Whether an episode can go on with it.
    pub(crate) fn is_sound(&self) -> bool {
        let factors = self.gains.iter().chain(&self.style);
        factors.chain(self.pending.iter().flatten()).all(|x| is_sound(*x))
            && (0.01..=100.0).contains(&self.size)
    }
}

/// Places in the table of rewards of the components that a style names, in its order.
pub(crate) fn styled(ranges: &Styles) -> impl Iterator<Item = usize> {
    (0..NUM_COMPONENTS).filter(|i| ranges.contains_key(COMPONENTS[*i]))
}

/// Refuses styles of components that are not there or count nothing.
pub(crate) fn check_styles(ranges: &Styles, reward: &RewardConfig) -> Result<()> {
    let counts = |name: &str| {
        let in_form = reward.form == RewardForm::Sum || !FACTORS.contains(&name);
        in_form && reward.weight(name).is_some_and(|weight| weight != 0.0)
    };
    let Some(name) = ranges.keys().find(|name| !counts(name)) else { return Ok(()) };
    let known: Vec<_> = COMPONENTS.into_iter().filter(|name| counts(name)).collect();
    Err(SimError::config("style", name, format!("weights that are not 0: {}", known.join(", "))))
}

/// Refuses factors of a reset that are not those of the configuration's ranges.
pub(crate) fn check_style(style: &BTreeMap<String, Real>, ranges: &Styles) -> Result<()> {
    for (name, factor) in style {
        let (got, expected) = match ranges.get(name) {
            Some([low, high]) if (*low..=*high).contains(factor) => continue,
            Some([low, high]) => (format!("{name}: {factor}"), format!("{low} to {high}")),
            None => {
                let names: Vec<_> = ranges.keys().map(String::as_str).collect();
                (name.clone(), format!("some of the configuration's style: {}", names.join(", ")))
            }
        };
        return Err(SimError::config("options: style", got, expected));
    }
    Ok(())
}
