//! Images of a running world: who stands where, trails, the route ahead, collisions of agents with a slot.

use crate::agents::AgentBox;
use crate::log::{caption, is_parked, legend_of, name_of};
use crate::palette::DrawStyle;
use crate::shown::{Centre, Frame, Shown};
use ccdiff_sim::geom::{Point2, Pose2, Real};
use ccdiff_sim::scene::AgentKind;
use ccdiff_sim::world::VecWorld;
use std::collections::VecDeque;

/// Who is parked in the log and no faster than this is parked, metres per second.
const STANDS_MPS: Real = 0.1;

/// Where the agents of each world were in the last steps.
#[derive(Debug)]
pub struct Trails {
    num_steps: usize,
    worlds: Vec<Trail>,
}

/// Past positions [T][A] of one world, oldest first; `None` where an agent was absent.
pub type Trail = VecDeque<Vec<Option<Point2>>>;

impl Trails {
    /// Trails of so many steps.
    pub fn new(num_worlds: usize, num_steps: usize) -> Self {
        Self { num_steps, worlds: vec![Trail::new(); num_worlds] }
    }

    /// Those of a world.
    pub fn of(&self, world_idx: usize) -> Option<&Trail> {
        self.worlds.get(world_idx)
    }

    /// Drops what is known of a world's past.
    pub fn forget(&mut self, world_idx: usize) {
        self.worlds[world_idx].clear();
    }

    /// Begins with the log that leads up to an episode.
    ///
    /// # Errors
    /// As [`VecWorld::status`].
    pub fn restart(&mut self, world: &VecWorld, world_idx: usize) -> ccdiff_sim::Result<()> {
        let status = world.status(world_idx)?;
        let scene = world.scene(status.scene_idx)?;
        let past = |t: usize| {
            let at = |a| scene.is_valid(a, t).then(|| scene.tracks.position[scene.at(a, t)]);
            (0..scene.num_agents()).map(at).collect()
        };
        let first = (status.step_idx + 1).saturating_sub(self.num_steps);
        self.worlds[world_idx] = (first..=status.step_idx).map(past).collect();
        Ok(())
    }

    /// Takes the present of every world that went on.
    ///
    /// # Errors
    /// As [`VecWorld::status`].
    pub fn follow(
        &mut self,
        world: &VecWorld,
        active: Option<&[bool]>,
        was_reset: &[bool],
    ) -> ccdiff_sim::Result<()> {
        for (i, was_reset) in was_reset.iter().enumerate() {
            if active.is_some_and(|active| !active[i]) {
                continue;
            }
            if *was_reset {
                self.restart(world, i)?;
                continue;
            }
            let states = world.status(i)?.states;
            let trail = &mut self.worlds[i];
            if trail.len() >= self.num_steps {
                trail.pop_front();
            }
            trail
                .push_back((0..states.len()).map(|a| states.active[a].then(|| states.position(a))).collect());
        }
        Ok(())
    }
}

/// Points of one agent up to now, after its last absence.
fn trail_of(trail: &Trail, agent_idx: usize) -> Vec<Point2> {
    let newest_first = trail.iter().rev().map(|row| row.get(agent_idx).copied().flatten());
    let mut points: Vec<Point2> = newest_first.take_while(Option::is_some).flatten().collect();
    points.reverse();
    points
}

/// The stretch of a route from the point nearest to an agent to the one nearest to its goal.
fn route_ahead(points: &[Point2], from: Point2, goal: Point2) -> &[Point2] {
    let nearest = |points: &[Point2], to: Point2| {
        let by_distance = |i: &usize, j: &usize| {
            (points[*i] - to).norm_squared().total_cmp(&(points[*j] - to).norm_squared())
        };
        (0..points.len()).min_by(by_distance).unwrap_or(0)
    };
    let ahead = &points[nearest(points, from)..];
    &ahead[..(nearest(ahead, goal) + 1).min(ahead.len())]
}

impl Shown {
    /// What a world shows. `look` tells how a kind of driver is drawn, and its title.
    ///
    /// # Errors
    /// As [`VecWorld::status`].
    pub fn of_world(
        world: &VecWorld,
        world_idx: usize,
        trail: Option<&Trail>,
        frame: Frame,
        look: impl Fn(&str) -> (DrawStyle, &'static str),
    ) -> ccdiff_sim::Result<Self> {
        let status = world.status(world_idx)?;
        let scene = world.scene(status.scene_idx)?;
        let (ego, slots) = (status.ego, status.slot_agents());
        let states = status.states;
        let focus = slots.iter().enumerate().find_map(|(c, a)| Some((c, (*a)?)));
        let middle = match (frame.centre, focus) {
            (Some(Centre::Point(p)), _) => Pose2::new(p.x, p.y, std::f32::consts::FRAC_PI_2),
            (Some(Centre::Agent(a)), _) | (None, Some((_, a))) => states.pose(a),
            (None, None) => Pose2::new(0.0, 0.0, 0.0),
        };
        let is_guided = |a: usize, name: &str| {
            let plan = world.explain(world_idx, Some(name)).ok().flatten();
            plan.is_some_and(|p| p.agents.iter().zip(&p.guided).any(|(b, on)| *b == a && *on))
        };
        let looks: Vec<(DrawStyle, &str)> = (0..states.len())
            .map(|a| {
                let (name, kind) = world.driver_name(status.drivers[a]);
                match look(kind) {
                    _ if is_guided(a, name) => (DrawStyle::Adversary, DrawStyle::Adversary.title()),
                    _ if ego == Some(a) => (DrawStyle::Ego, DrawStyle::Ego.title()),
                    look => look,
                }
            })
            .collect();
        let contacts = status.contacts();
        let pairs = contacts.iter().map(|(of_i, of_j)| (of_j.partner as usize, of_i.partner as usize));
        let of_slots = |(i, j): &(usize, usize)| slots.contains(&Some(*i)) || slots.contains(&Some(*j));
        let in_contact: Vec<(usize, usize)> = pairs.filter(of_slots).collect();
        let there = (0..states.len()).filter(|a| states.active[*a]);
        let boxes = there.clone().map(|a| AgentBox {
            pose: states.pose(a),
            length_m: scene.agents[a].length_m,
            width_m: scene.agents[a].width_m,
            kind: scene.agents[a].kind,
            driver: looks[a].0,
            collided: in_contact.iter().any(|(i, j)| *i == a || *j == a),
            parked: states.speed_mps[a] < STANDS_MPS && is_parked(scene, a),
            arrived: false,
        });
        let between = |(i, j): &(usize, usize)| {
            let (p, q) = (states.position(*i), states.position(*j));
            p + 0.5 * (q - p)
        };
        let movers = (0..states.len()).filter(|a| scene.agents[*a].kind != AgentKind::Static);
        let trails = trail.map(|trail| movers.map(|a| (trail_of(trail, a), looks[a].0)).collect());
        let route = focus.filter(|_| frame.route).and_then(|(c, a)| {
            let (points, goal) = status.slot_route(c)?;
            Some(route_ahead(&points, states.position(a), goal).to_vec())
        });
        let mut shown = Self {
            boxes: boxes.collect(),
            collisions: in_contact.iter().map(between).collect(),
            trails: trails.unwrap_or_default(),
            route: route.unwrap_or_default(),
            ..Self::new(frame, middle)
        };
        if frame.labels {
            let speed_mps = focus.map(|(_, a)| states.speed_mps[a]);
            shown.caption = caption(scene, status.elapsed_steps, speed_mps);
            shown.names = there.map(|a| name_of(ego, a)).collect();
            shown.legend = legend_of(scene, looks.iter().copied(), frame.theme);
        }
        Ok(shown)
    }
}
