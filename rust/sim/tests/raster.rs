//! Bird's-eye rasters against slow tests of every pixel.

mod common;

use ccdiff_sim::geom::{Point2, Pose2};
use ccdiff_sim::observe::{BevConfig, ObservationConfig};
use ccdiff_sim::scene::AgentKind;
use ccdiff_sim::world::{Autoreset, WorldConfig};
use common::{Batch, actions, city};

const BEV: BevConfig = BevConfig { size_px: 60, metres_per_px: 0.5, lights: false };

fn config() -> WorldConfig {
    WorldConfig {
        autoreset: Autoreset::SameStep,
        traffic: "idm".into(),
        observation: ObservationConfig { bev: Some(BEV), ..ObservationConfig::default() },
        ..WorldConfig::default()
    }
}

/// The centre of a pixel in the scene frame.
fn centre(ego: &Pose2, row: usize, column: usize) -> Point2 {
    let ahead = 45.0 - (row as f32 + 0.5);
    let left = 30.0 - (column as f32 + 0.5);
    ego.to_outer(Point2::new(ahead * 0.5, left * 0.5))
}

#[test]
fn channels_show_what_is_at_the_centres_of_their_pixels() {
    let mut batch = Batch::new(vec![city(40)], config(), 1, 1);
    batch.reset_all(3);
    let plane = 60 * 60;
    for t in 0..40 {
        batch.step(&actions(t, 2)).unwrap();
        let status = batch.world.status(0).unwrap();
        let scene = batch.world.prepared(status.scene_idx).unwrap();
        let states = status.states;
        let ego = states.pose(0);
        let others: Vec<usize> = (1..states.len()).filter(|j| states.active[*j]).collect();
        let near = |a: usize, at: Point2, margin_m: f32| {
            let mut footprint = scene.footprints[a];
            footprint.half_length_m += margin_m;
            footprint.half_width_m += margin_m;
            let probe = ccdiff_sim::state::Footprint::new(1e-3, 1e-3);
            let there = Pose2::new(at.x, at.y, 0.0);
            footprint.at(&states.pose(a)).overlaps(&probe.at(&there))
        };
        for row in 0..60 {
            for column in 0..60 {
                let (p, at) = (centre(&ego, row, column), row * 60 + column);
                let own = batch.bev[4 * plane + at] == 255;
                assert!(!own || near(0, p, 0.05));
                assert!(own || !near(0, p, -0.05));
                let byte = batch.bev[3 * plane + at];
                let inside = others.iter().find(|j| near(**j, p, -0.05));
                if let Some(j) = inside {
                    let expected = match scene.kinds[*j] {
                        AgentKind::Vehicle | AgentKind::Motorcycle => 255,
                        AgentKind::Pedestrian | AgentKind::Cyclist => 170,
                        AgentKind::Static => 85,
                    };
                    assert_eq!(byte, expected);
                } else if byte != 0 {
                    assert!(others.iter().any(|j| near(*j, p, 0.4)));
                }
            }
        }
        let ahead_of_ego = batch.bev[2 * plane + 41 * 60 + 30];
        assert!(status.elapsed_steps > 5 || ahead_of_ego == 255, "the route begins at the agent");
        // the channels of lines and of the route hold no other bytes than theirs
        assert!(batch.bev[plane..3 * plane].iter().all(|b| [0, 128, 255].contains(b)));
    }
}
