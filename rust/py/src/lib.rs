//! The Python module `ccdiff_env._native`: a translation, no arithmetic. It needs no torch.

mod causal;
mod drivers;
mod egos;
mod enter;
mod logged_batch;
mod map_queries;
mod metrics;
mod networks;
mod planner;
mod python_driver;
mod render;
mod scene;
mod scene_map;
mod schemas;
mod step_arrays;
mod swift;
mod traffic_batch;
mod world;
mod world_plans;
mod world_state;

#[pyo3::pymodule]
mod _native {
    #[pymodule_export]
    use crate::{
        causal::{causal_pairs, causal_rank},
        drivers::{driver_kinds, drivers},
        egos::EgoNetwork,
        logged_batch::traffic_batch_from_log,
        map_queries::{map_lane_ahead, map_road_distance},
        metrics::NativeMotion,
        networks::{guidance_preset, load_network, needs_torch},
        planner::PyPlanner,
        render::{render_arrays, render_legend, render_look},
        scene::{PyScene, load_gpudrive, load_nuscenes},
        scene_map::complete_map,
        schemas::{check_options, schema},
        swift::swift_bins,
        world::{PyVecWorld, PyWorldStatus},
    };
    #[pymodule_export]
    use ccdiff_bridge::PyTrajectoryModel;

    use crate::traffic_batch::ROUTE_SPACING_M;
    use ccdiff_nuscenes::EGO_AXLE_TO_CENTRE_M;
    use ccdiff_sim::causal::graph::GraphThresholds;
    use ccdiff_sim::scene::LEVEL_M;
    use pyo3::prelude::*;

    #[pymodule_init]
    fn constants(module: &Bound<'_, PyModule>) -> PyResult<()> {
        ccdiff_nets::guidance::connect(ccdiff_bridge::call_cost);
        let GraphThresholds { ttc_s, distance_m } = GraphThresholds::PAPER;
        module.add("GRAPH_THRESHOLDS", (ttc_s, distance_m))?;
        module.add("EGO_AXLE_TO_CENTRE_M", EGO_AXLE_TO_CENTRE_M)?;
        module.add("LEVEL_M", LEVEL_M)?;
        module.add("ROUTE_SPACING_M", ROUTE_SPACING_M)
    }

    /// A number that `_models` compares with its own: how the simulator within was compiled.
    #[pyfunction]
    fn build_mark() -> u64 {
        ccdiff_sim::build_mark()
    }

    /// Holds all later work of the process to the instructions that every processor has; the bits stay the same.
    #[pyfunction]
    fn hold_to_base() {
        ccdiff_sim::hold_to_base();
    }
}
