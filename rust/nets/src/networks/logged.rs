//! Plans from logged histories.

use crate::error::{Result, require};
use crate::guidance::WorldGuidance;
use crate::inputs::features::{Window, vehicles};
use crate::networks::trajectory_model::{Plan, PlanInput, PlanOptions, TrajectoryModel};
use ccdiff_sim::geom::Region;
use ccdiff_sim::scene::{LaneIndex, Scene};
use ccdiff_sim::stage::Route;
use std::sync::Arc;

/// What is planned for: scenes at steps, and guided agents, for which contacts with all count.
#[derive(Debug)]
pub struct Logged<'a> {
    /// Scenes.
    pub scenes: &'a [Arc<Scene>],
    /// The step of each.
    pub steps: &'a [usize],
    /// Seed of the noise of each.
    pub seeds: &'a [u64],
    /// Agents of each that guidance moves; `None`: no guidance.
    pub guided: Option<Vec<Vec<usize>>>,
    /// Whether the network is told the routes of all vehicles.
    pub follow_route: bool,
}

impl Logged<'_> {
    /// Whether each vehicle of each scene is on a list; `None` without lists.
    fn listed(&self, lists: Option<&Vec<Vec<usize>>>) -> Option<Vec<Vec<bool>>> {
        let flags = |(scene, list): (&Arc<Scene>, &Vec<usize>)| {
            vehicles(scene).iter().map(|agent| list.contains(agent)).collect()
        };
        lists.map(|lists| self.scenes.iter().zip(lists).map(flags).collect())
    }

    /// Their plans.
    ///
    /// # Errors
    /// As [`TrajectoryModel::plan`], and [`crate::ModelError::Config`] for routes that the weights do not know.
    pub fn plans(&self, model: &mut TrajectoryModel, options: &PlanOptions) -> Result<Vec<Plan>> {
        let (history, points_m) = (model.config().history_steps, model.config().route_points_m.clone());
        let knows = !self.follow_route || !points_m.is_empty();
        require(knows, "follow_route", "True", "False: these weights were trained without routes")?;
        let maps: Vec<_> = self.scenes.iter().map(|s| model.map(s)).collect();
        let windows: Vec<Window> = self
            .scenes
            .iter()
            .zip(self.steps)
            .map(|(scene, step)| {
                let agents = vehicles(scene);
                let mut window = Window::from_scene(scene, *step, &agents, history);
                if self.follow_route {
                    let lanes = LaneIndex::new(&scene.map);
                    let routes: Vec<Route> =
                        agents.iter().map(|a| Route::new(scene, *a, lanes.as_ref())).collect();
                    window.tell_routes(&routes, &points_m);
                }
                window
            })
            .collect();
        let guided = self.listed(self.guided.as_ref());
        let guides = guided.is_some();
        let roads: Vec<Option<Region>> =
            self.scenes.iter().map(|s| guides.then(|| Region::new(&s.map.drivable_area)).flatten()).collect();
        let level = |scene: &Scene, agent: usize, step: usize| {
            Region::new(&scene.map.on_level(scene.tracks.elevation_m[scene.at(agent, step)]).drivable_area)
        };
        let of_levels = |(scene, step): (&Arc<Scene>, &usize)| -> Vec<Option<Region>> {
            let agents = if guides && scene.has_levels() { vehicles(scene) } else { Vec::new() };
            agents.iter().map(|a| level(scene, *a, *step)).collect()
        };
        let of_levels: Vec<_> = self.scenes.iter().zip(self.steps).map(of_levels).collect();
        let of_levels: Vec<Vec<_>> =
            of_levels.iter().map(|roads| roads.iter().map(Option::as_ref).collect()).collect();
        let worlds: Vec<PlanInput<'_>> = windows
            .iter()
            .enumerate()
            .map(|(k, window)| PlanInput {
                window,
                map: maps[k].as_ref(),
                seed: self.seeds[k],
                guide: guided.as_ref().map(|flags| WorldGuidance {
                    road: roads[k].as_ref(),
                    roads: (!of_levels[k].is_empty()).then_some(of_levels[k].as_slice()),
                    ..WorldGuidance::new(&flags[k])
                }),
            })
            .collect();
        model.plan(&worlds, options)
    }
}
