//! Phase "reward" of a tick: rewards, info columns and endings.

use crate::events::{ANTICIPATION_S, leader};
use crate::geom::{Pose2, Real, Vector2};
use crate::stage::PreparedScene;
use crate::world::buffers::StepBuffers;
use crate::world::config::{Consequence, WorldConfig};
use crate::world::episode::{Episode, Phase};
use crate::world::reward_columns::{Earlier, NUM_COLUMNS, StepFacts, TTC_HORIZON_S};
use crate::world::tick::World;
use crate::world::tick::reward;
use crate::world::tick::surroundings::log_distance;
use crate::world::tick::tow;

/// An agent is late only farther from its goal than this, and with nobody nearer ahead than the second, metres.
const LATE_BEFORE_M: Real = 3.0;
const LATE_BEHIND_M: Real = 8.0;
/// Braking with which an agent waits in yellow, m/s².
const CALM_MPS2: Real = 2.0;
/// The time that is left counts as at least this, seconds.
const LEAST_TIME_S: Real = 1.0;

/// What the events of a step do to an agent.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
struct Outcome {
    ends: bool,
    /// It stands still from now on.
    stands: bool,
    /// It leaves the world, where its episode ends.
    leaves: bool,
}

impl Outcome {
    /// What follows all events of a step. Where episodes end at the goal, an agent without an accident leaves there.
    fn of([collided, off_road, ran_red, reached]: [bool; 4], config: &WorldConfig) -> Self {
        use Consequence::{Remove, Stop, Terminate};
        let at_goal = reached && config.terminate_at_goal;
        let events = [
            (collided, config.on_collision),
            (off_road, config.on_off_road),
            (ran_red, config.on_red_light),
            (at_goal, Terminate),
        ];
        let any = |of: &[Consequence]| events.iter().any(|(happened, after)| *happened && of.contains(after));
        Self {
            ends: any(&[Terminate, Remove]),
            stands: any(&[Stop, Terminate, Remove]),
            leaves: at_goal && !collided && !off_road || any(&[Remove]),
        }
    }
}

/// How much slower the agent of a slot is than reaches the goal in time where nobody is ahead and no light holds it, m/s.
fn lag_mps(e: &Episode, scene: &PreparedScene, slot_idx: usize, a: usize, time_left_s: Real) -> Real {
    let (s_m, route) = (e.route_s_m[a], &scene.routes[a].path);
    let left_m = e.slots[slot_idx].progress.ahead_m(s_m);
    let lag_mps = left_m / time_left_s - e.states.speed_mps[a];
    let is_free = || {
        let front_m = s_m + scene.footprints[a].half_length_m;
        let speed_mps = e.states.speed_mps[a].max(0.0);
        let (lights, red) = (&scene.routes[a].lights, Real::MAX);
        scene.scene.map.waits_at(lights, front_m, speed_mps, e.step_idx, [red, CALM_MPS2]).is_none()
            && leader(&e.states, &scene.footprints, route, s_m, a, ANTICIPATION_S)
                .is_none_or(|l| l.gap_m > LATE_BEHIND_M)
    };
    if left_m > LATE_BEFORE_M && lag_mps > 0.0 && is_free() { lag_mps } else { 0.0 }
}

impl World {
    /// Rewards and info columns of a step; those of earlier steps of the decision lie in `out`, zero for the first one.
    pub(super) fn reward(&mut self, config: &WorldConfig, is_first: bool, out: &mut StepBuffers<'_>) -> bool {
        let e = &mut self.episode;
        let left_steps = e.steps_left(&self.scene, config);
        let (at_end, time_left_s) = (left_steps == 0, (left_steps as Real * config.dt_s).max(LEAST_TIME_S));
        let alive = e.slots.iter().filter(|s| s.alive).filter_map(|s| s.agent_idx);
        self.scratch.least_times.find(&e.states, &self.scene.footprints, alive, TTC_HORIZON_S);
        for c in 0..e.slots.len() {
            let Some(a) = e.slots[c].agent_idx.filter(|_| e.slots[c].alive) else { continue };
            let columns = &mut out.columns[c * NUM_COLUMNS..(c + 1) * NUM_COLUMNS];
            let earlier = (!is_first).then(|| Earlier::of(out.reward[c], columns));
            let (log_distance_m, s_m) = (log_distance(e, &self.scene, a), e.route_s_m[a]);
            let is_priced = config.reward.lagging != 0.0;
            let lag_mps = if is_priced { lag_mps(e, &self.scene, c, a, time_left_s) } else { 0.0 };
            let slot = &mut e.slots[c];
            let had_reached = slot.progress.reached;
            let from_route_m = self.scratch.from_route_m[c];
            let progress_m = slot.progress.advance(&e.states, a, s_m, from_route_m, config.dt_s, at_end);
            let (contact, reached) = (self.scratch.contacts[c], slot.progress.reached && !had_reached);
            let ran_red = !self.scene.scene.map.lights.is_empty() && self.active_before[a] && {
                let ahead = |pose: &Pose2| {
                    let half_m = self.scene.footprints[a].half_length_m;
                    pose.position + Vector2::new(pose.cos, pose.sin) * half_m
                };
                let (from, to) = (ahead(&self.scratch.before[a]), ahead(&e.states.pose(a)));
                self.scene.scene.map.runs_red(from, to, e.states.elevation_m(a), e.step_idx)
            };
            let outcome = Outcome::of([contact.is_some(), slot.off_road, ran_red, reached], config);
            out.terminated[c] = outcome.ends;
            out.truncated[c] = at_end && !outcome.ends;
            let ended = out.terminated[c] || out.truncated[c];
            let facts = StepFacts {
                contact,
                ttc_s: self.scratch.least_times.of(a),
                log_distance_m,
                progress_m,
                reached,
                ran_red,
                lag_mps,
                terminated: out.terminated[c],
                timed_out: out.truncated[c],
            };
            slot.stopped |= outcome.stands;
            let reward = reward::score(&e.states, a, slot, facts, config, columns);
            slot.statistics.add(reward, columns);
            out.reward[c] = earlier.map_or(reward, |earlier| earlier.join(reward, columns));
            if ended {
                slot.alive = false;
                slot.ended_at = Some(e.elapsed_steps);
                // an agent that ends by an accident stays in the others' way
                slot.stopped = true;
                e.states.active[a] &= !outcome.leaves;
            }
        }
        e.contacts.clone_from(&self.scratch.touched);
        tow::leave(e, &self.scene);
        let done = e.slots.iter().all(|s| !s.alive);
        if done {
            self.end();
        }
        done
    }

    /// Ends the world's episode and keeps the metrics of its slots.
    pub(super) fn end(&mut self) {
        self.episode.phase = Phase::Ended;
        self.ended.clear();
        self.ended.extend(self.episode.slots.iter().map(|s| s.metrics()));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn events_and_consequences_decide_who_ends_stands_and_leaves() {
        let config =
            |on_collision, on_off_road| WorldConfig { on_collision, on_off_road, ..WorldConfig::default() };
        let usual = config(Consequence::Terminate, Consequence::Stop);
        let of = |collided, off_road, reached, config: &WorldConfig| {
            let o = Outcome::of([collided, off_road, false, reached], config);
            (o.ends, o.stands, o.leaves)
        };
        assert_eq!(of(false, false, false, &usual), (false, false, false));
        assert_eq!(of(true, false, false, &usual), (true, true, false));
        assert_eq!(of(false, true, false, &usual), (false, true, false));
        assert_eq!(of(false, false, true, &usual), (true, true, true));
        // an accident at the goal stays in the way
        assert_eq!(of(true, false, true, &usual), (true, true, false));
        let gone = config(Consequence::Ignore, Consequence::Remove);
        assert_eq!(of(true, false, false, &gone), (false, false, false));
        assert_eq!(of(true, true, false, &gone), (true, true, true));
        let open = WorldConfig { terminate_at_goal: false, ..gone };
        assert_eq!(of(false, false, true, &open), (false, false, false));
    }
}
