//! A driver is its file and one line: here a module and a list, in the crate `drivers/creeping.rs` and a line of
//! `drivers::KINDS`.

mod common;

use ccdiff_sim::drivers::{self, Kind};
use ccdiff_sim::world::WorldConfig;
use common::{Batch, actions, city};

mod creeping {
    use ccdiff_sim::drivers::{AgentMotion, DriverModel, Kind, PlanState, WorldView};
    use ccdiff_sim::geom::{Point2, Pose2, Real, Vector2};
    use ccdiff_sim::options::{self, within};

    pub(crate) const KIND: Kind = Kind {
        name: "creeping",
        title: "creeping",
        style: "other",
        options: Some(&CreepingConfig::TABLE),
        always: false,
        make: Some(|path, text| Ok(Box::new(Creeping(options::read(path, text)?)))),
    };

    ccdiff_sim::options! {
        /// How vehicles creep.
        #[derive(Clone, Copy)]
        #[serde(deny_unknown_fields, default)]
        pub struct CreepingConfig {
            /// Their speed.
            speed_mps: Real = 1.0, unit "m/s", range within(0.0, 100.0).open_below();
        }
    }

    struct Creeping(CreepingConfig);

    impl DriverModel for Creeping {
        fn name(&self) -> &str {
            KIND.name
        }

        fn act(&self, world: &WorldView<'_>, _: Option<&PlanState>, agent_idx: usize) -> AgentMotion {
            let pose = world.states.pose(agent_idx);
            let velocity = Vector2::new(pose.cos, pose.sin) * self.0.speed_mps;
            let position = Point2::from(pose.position.coords + velocity * world.dt_s);
            AgentMotion::Place(Pose2 { position, ..pose }, velocity)
        }
    }
}

const KINDS: [&[Kind]; 2] = [drivers::KINDS, &[creeping::KIND]];

#[test]
fn a_new_driver_is_made_from_checked_options_and_drives_the_traffic() {
    let kind = KINDS.concat().into_iter().find(|kind| kind.name == "creeping").unwrap();
    let make = |options: &str| kind.make.unwrap()(kind.name, options);
    let wrong = make(r#"{"speed_mps": 0}"#).err().unwrap().to_string();
    assert!(wrong.starts_with("config: creeping.speed_mps is 0, expected a number in"), "{wrong}");
    let drivers = vec![(kind.name.to_owned(), make(r#"{"speed_mps": 2}"#).unwrap())];
    let config = WorldConfig { traffic: kind.name.into(), ..WorldConfig::default() };
    let mut batch = Batch::with_drivers(vec![city(12)], config, 1, 1, drivers);
    batch.reset_all(0);
    batch.step(&actions(0, 2)).unwrap();
    let status = batch.world.status(0).unwrap();
    let driven =
        (1..status.states.len()).filter(|a| batch.world.driver_name(status.drivers[*a]).0 == kind.name);
    let speeds: Vec<f32> = driven.map(|a| status.states.speed_mps[a]).collect();
    assert!(!speeds.is_empty() && speeds.iter().all(|speed| (speed - 2.0).abs() < 1e-5), "{speeds:?}");
}
