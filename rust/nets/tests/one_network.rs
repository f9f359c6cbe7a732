//! A network is its file, a line and its weights: here a module, in the crate a file, a line of `networks::NETWORKS`, and one of
//! `ccdiff_models::kinds` with its loss if it is to be trained.

use ccdiff_nets::config::ModelConfig;
use ccdiff_nets::inputs::features::Window;
use ccdiff_nets::networks::planner::PlanOptions;
use ccdiff_sim::geom::Pose2;
use std::collections::BTreeMap;
use std::path::Path;

mod cruise {
    use ccdiff_nets::compute::backend::Backend;
    use ccdiff_nets::compute::cpu::Cpu;
    use ccdiff_nets::guidance::Guide;
    use ccdiff_nets::networks::cpu_planner::on_cpu;
    use ccdiff_nets::networks::planner::{Asked, Proposed, Proposes};
    use ccdiff_nets::{ModelConfig, NetworkKind, Result};

    pub(crate) const CRUISE: NetworkKind =
        NetworkKind { one_plan: true, ..NetworkKind::of("cruise", "Cruise", on_cpu::<Cruise<Cpu>>) };

    /// Accelerations and yaw rates by one linear layer from the speed.
    #[derive(Debug)]
    struct Cruise<B: Backend>(B::Linear, ModelConfig);

    impl<B: Backend> Proposes<B> for Cruise<B> {
        fn new(p: &B::Path<'_>, config: &ModelConfig) -> Self {
            Self(B::linear(&B::sub(p, "head"), 1, 2 * config.num_knots() as i64), config.clone())
        }

        fn config(&self) -> &ModelConfig {
            &self.1
        }

        fn propose(&self, batch: &B::Batch<'_>, asked: &Asked<'_>, _: Guide<'_, '_>) -> Result<Proposed> {
            let knots = B::apply(&self.0, &B::placed(batch, B::plain(batch).standard_speed(&self.1)));
            Ok((B::numbers(&knots).repeat(asked.options.num_samples), None))
        }
    }
}

#[test]
fn a_new_network_plans_from_its_weights_and_names_what_they_lack() {
    let config = ModelConfig { kind: "cruise".into(), map: None, ..ModelConfig::fast() };
    let (h, knots) = (config.history_steps, config.num_knots());
    // two vehicles far apart at 5 and 10 m/s
    let speeds = [5.0, 10.0];
    let x_m = |at: usize| 200.0 * (at / h) as f32 + 0.1 * speeds[at / h] * (at % h) as f32;
    let window = Window {
        num_steps: h,
        poses: (0..2 * h).map(|at| Pose2::new(x_m(at), 0.0, 0.0)).collect(),
        speed_mps: (0..2 * h).map(|at| speeds[at / h]).collect(),
        valid: vec![true; 2 * h],
        length_m: vec![4.5; 2],
        width_m: vec![2.0; 2],
        ..Window::default()
    };
    // 1 m/s² straight on
    let n = &config.normalisation;
    let action = [(1.0 - n.action_mean[0]) / n.action_std[0], -n.action_mean[1] / n.action_std[1]];
    let bias = (0..2 * knots).map(|i| action[i % 2] as f32).collect();
    let mut tensors = BTreeMap::from([("head.weight".into(), (vec![2 * knots, 1], vec![0.0; 2 * knots]))]);
    let made = |tensors| (cruise::CRUISE.on_cpu)(Path::new("cruise"), &config, tensors);
    let lacks = made(tensors.clone()).unwrap_err().to_string();
    assert!(lacks.contains("head.bias"), "{lacks}");
    tensors.insert("head.bias".into(), (vec![2 * knots], bias));
    let features = (cruise::CRUISE.features)(&window, None, &config).unwrap();
    let plans = made(tensors).unwrap().draw(&[features], &[7], &PlanOptions::default(), None).unwrap();
    for (row, speed) in speeds.iter().enumerate() {
        let end = &plans.states[((row + 1) * config.horizon_steps - 1) * 6..];
        let gained = 0.1 * config.horizon_steps as f32;
        assert!((end[2] - speed - gained).abs() < 1e-3, "{end:?}");
    }
}
