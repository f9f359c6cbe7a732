//! An auxiliary loss of training: plans that drive into a neighbour's logged future (reference.md#training, an option there).
//!
//! Ours: the planned body is a rectangle with a gap kept free before its front, neighbours are rows of disks as in the
//! guidance (reference.md#guidance). The loss is how far the front has driven over them, which falls by braking
//! alone. What lies behind the middle of the body does not count: a vehicle that is hit from behind need not hurry.
//! The yaw rate takes no gradient: the loss teaches to brake, not to swerve.

use crate::batch::{Batch, Targets};
use crate::plan_space::PlanSpace;
use crate::unicycle;
use tch::{Kind, Tensor};

/// Disks of a neighbour's body.
const NUM_DISKS: i64 = 5;
/// Every `STRIDE`-th step is looked at.
const STRIDE: i64 = 2;
/// Overlap across the body from which a disk counts in full, metres.
const FULL_OVERLAP_M: f64 = 0.5;
/// Gap to be kept free before the front in the loss, metres.
const GAP_M: f64 = 1.0;
/// Overrun of a logged future that makes the rest of it no example, metres.
const LEAST_M: f64 = 0.05;

/// Logged futures of the joined neighbours of R rows, in the frames of the rows.
#[derive(Debug)]
pub(crate) struct Neighbours {
    /// Centres of the disks x, y, each [R, K - 1, steps, disks].
    centre: (Tensor, Tensor),
    /// Radii [R, K - 1, 1, 1].
    radius: Tensor,
    /// Whether the neighbour is joined and logged, [R, K - 1, steps, 1], 0 or 1.
    counts: Tensor,
    /// Half length and half width of the rows, each [R, 1, 1, 1].
    half: (Tensor, Tensor),
}

/// The looked-at steps.
pub(crate) fn every_other(t: &Tensor, dim: i64) -> Tensor {
    t.slice(dim, STRIDE - 1, None, STRIDE)
}

impl Neighbours {
    /// Neighbours of a batch; `None` where no two are joined.
    pub(crate) fn new(batch: &Batch, targets: &Targets) -> Option<Self> {
        let of = batch.neighbourhood();
        let (rows, slots) = (batch.num_rows() as i64, of.rows.size()[1]);
        if slots < 2 {
            return None;
        }
        let others = of.rows.narrow(1, 1, slots - 1).flatten(0, 1);
        let of_others = |t: &Tensor| {
            let mut size = vec![rows, slots - 1];
            size.extend(&t.size()[1..]);
            t.index_select(0, &others).view(size.as_slice())
        };
        let future = of_others(&every_other(&targets.states, 1));
        let edge = of.edges.narrow(1, 1, slots - 1).select(2, of.edges.size()[2] - 1);
        let at_now = |c: i64| edge.select(2, c).unsqueeze(2);
        let (cos, sin) = (at_now(2), at_now(3));
        let (x, y, yaw) = (future.select(3, 0), future.select(3, 1), future.select(3, 3));
        let turned = |a: &Tensor, b: &Tensor| (&cos * a - &sin * b, &sin * a + &cos * b);
        let ((x, y), (along_x, along_y)) = (turned(&x, &y), turned(&yaw.cos(), &yaw.sin()));
        let [length, width] = batch.sizes();
        let radius = of_others(&(&width * 0.5)).view([rows, slots - 1, 1, 1]);
        let reach = (of_others(&(&length * 0.5)).view([rows, slots - 1, 1, 1]) - &radius).clamp_min(0.0);
        let offsets = reach * Tensor::linspace(-1.0, 1.0, NUM_DISKS, (Kind::Float, width.device()));
        let is_edge = of.is_edge.narrow(1, 1, slots - 1).to_kind(Kind::Float).unsqueeze(2) * at_now(8);
        Some(Self {
            centre: (
                (x + at_now(0)).unsqueeze(3) + along_x.unsqueeze(3) * &offsets,
                (y + at_now(1)).unsqueeze(3) + along_y.unsqueeze(3) * &offsets,
            ),
            radius,
            counts: (of_others(&every_other(&targets.valid, 1)) * is_edge).unsqueeze(3),
            half: ((length * 0.5).view([-1, 1, 1, 1]), (width * 0.5).view([-1, 1, 1, 1])),
        })
    }

    /// How far the front of the rows' bodies, with a gap before it, has driven over a disk of a neighbour that is ahead
    /// of the middle of the body, metres, [R, steps]. A disk beside the body counts less, down to nothing where it does
    /// not touch; that share has no gradient.
    fn overrun_m(&self, states: &Tensor, gap_m: f64) -> Tensor {
        let of = |c: i64| every_other(states, 1).select(2, c).unsqueeze(1).unsqueeze(3);
        let (x, y) = (&self.centre.0 - of(0), &self.centre.1 - of(1));
        let (cos, sin) = (of(3).cos(), of(3).sin());
        let (along, aside) = (&cos * &x + &sin * &y, &cos * &y - &sin * &x);
        let ahead = along.gt(0.0).to_kind(Kind::Float);
        let overlap = (&self.half.1 + &self.radius - aside.abs()).clamp(0.0, FULL_OVERLAP_M);
        let share = overlap.detach() * ahead * &self.counts * (1.0 / FULL_OVERLAP_M);
        let overrun = ((&self.half.0 + &self.radius - along) + gap_m).clamp_min(0.0) * share;
        overrun.amax([1i64, 3].as_slice(), false)
    }

    /// Mean overrun of plans, each row weighted by `share` [R], metres. `knots` are normalised [R, knots, 2].
    pub(crate) fn loss(
        &self,
        space: &PlanSpace,
        knots: &Tensor,
        speed_mps: &Tensor,
        share: &Tensor,
    ) -> Tensor {
        let actions = space.actions(knots);
        let actions = Tensor::stack(&[actions.select(2, 0), actions.select(2, 1).detach()], 2);
        let states = unicycle::rollout(&actions, speed_mps, space.config().dt_s);
        (self.overrun_m(&states, GAP_M) * share.unsqueeze(1)).mean(Kind::Float)
    }

    /// Entries of `targets.valid` up to the first step at which the logged future itself drives into a neighbour, as
    /// futures of agents that were moved off their log may.
    pub(crate) fn examples(&self, targets: &Targets) -> Tensor {
        let hit = self.overrun_m(&targets.states, 0.0).gt(LEAST_M).to_kind(Kind::Float);
        let steps = targets.valid.size()[1];
        let whole = hit.repeat_interleave_self_int(STRIDE, 1, None);
        let missing = steps - whole.size()[1];
        let whole = whole.pad([0, missing], "constant", 0.0);
        &targets.valid * whole.cumsum(1, Kind::Float).lt(0.5).to_kind(Kind::Float)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::batch::tests::cars;
    use crate::config::ModelConfig;
    use crate::features::{EDGE_FEATURES, SceneFeatures};
    use tch::Device;

    const STEPS: i64 = 52;

    /// Two cars, 4 m by 2 m: row 0 at the origin, row 1 at an offset with a heading (both in row 0's frame), seen by
    /// row 0 alone. Row 1 goes straight on at a speed.
    fn pair(offset: [f32; 2], heading: f32, speed_mps: f32) -> (Batch, Targets) {
        let mut edges = vec![0f32; 4 * EDGE_FEATURES];
        edges[EDGE_FEATURES..EDGE_FEATURES + 4].copy_from_slice(&[
            offset[0],
            offset[1],
            heading.cos(),
            heading.sin(),
        ]);
        edges[2 * EDGE_FEATURES - 1] = 1.0;
        let drive = |v: f32| -> Vec<f32> {
            (1..=STEPS).flat_map(|t| [0.1 * t as f32 * v, 0.0, v, 0.0, 0.0, 0.0]).collect()
        };
        let scene = SceneFeatures {
            num_slots: 2,
            neighbours: vec![0, 1, 1, 1],
            is_edge: vec![false, true, false, false],
            edges,
            ..cars(&[10.0, speed_mps])
        };
        let batch = Batch::new(vec![scene], Device::Cpu).unwrap();
        let states = Tensor::from_slice(&[drive(10.0), drive(speed_mps)].concat()).view([2, STEPS, 6]);
        (batch, Targets { states, valid: Tensor::ones([2, STEPS], (Kind::Float, Device::Cpu)) })
    }

    fn overrun_m(offset: [f32; 2], heading: f32, speed_mps: f32) -> Vec<f32> {
        let (batch, targets) = pair(offset, heading, speed_mps);
        let neighbours = Neighbours::new(&batch, &targets).unwrap();
        let overrun = neighbours.overrun_m(&targets.states, 0.0);
        Vec::<f32>::try_from(overrun.get(0)).unwrap()
    }

    #[test]
    fn the_overrun_is_that_of_the_front_over_what_is_ahead() {
        // row 0 drives at 10 m/s, the other stands 15 m ahead: bumpers 11 m apart, contact after 1.1 s
        for (k, d) in overrun_m([15.0, 0.0], 0.0, 0.0).iter().enumerate() {
            let x = 0.2 * 10.0 * (k + 1) as f32;
            if x < 14.0 {
                assert!((d - (x - 11.0).max(0.0)).abs() < 2e-3, "after {x} m: {d}");
            } else if x > 16.0 {
                assert_eq!(*d, 0.0, "all of it is behind the middle");
            }
        }
        assert!(overrun_m([60.0, 0.0], std::f32::consts::PI, 10.0).iter().any(|d| *d > 0.5), "oncoming");
        assert!(overrun_m([15.0, 2.2], 0.0, 0.0).iter().all(|d| *d == 0.0), "in the next lane");
        let grazed = overrun_m([15.0, 1.75], 0.0, 0.0)[5];
        assert!((grazed - 0.5).abs() < 0.01, "half of the metre, {grazed}");
        // hit from behind after 0.4 s; the other's foremost disk passes the middle after 1 s
        assert!(overrun_m([-6.0, 0.0], 0.0, 15.0)[..4].iter().all(|d| *d == 0.0));
        // a crossing car that gets in the way: 20 m ahead, 20 m to the right, at the same speed
        let crossing = overrun_m([20.0, -20.0], std::f32::consts::FRAC_PI_2, 10.0);
        assert!(crossing[..7].iter().all(|d| *d == 0.0) && crossing[7..10].iter().any(|d| *d > 0.5));
    }

    #[test]
    fn the_loss_brakes_and_does_not_steer() {
        let config = ModelConfig { map: None, ..ModelConfig::fast() };
        let space = PlanSpace::new(&config, Device::Cpu);
        let (batch, targets) = pair([25.0, 0.6], 0.1, 3.0);
        let neighbours = Neighbours::new(&batch, &targets).unwrap();
        let knots = Tensor::zeros([2, 13, 2], (Kind::Float, Device::Cpu)).set_requires_grad(true);
        let share = Tensor::from_slice(&[1f32, 1.0]);
        let loss = neighbours.loss(&space, &knots, &batch.speed_mps(), &share);
        assert!(loss.double_value(&[]) > 0.0);
        loss.backward();
        let gradient = knots.grad();
        assert!(gradient.get(0).select(1, 0).get(0).double_value(&[]) > 0.0, "less acceleration, less loss");
        assert_eq!(gradient.select(2, 1).abs().max().double_value(&[]), 0.0, "the yaw rate");
        assert_eq!(gradient.get(1).abs().max().double_value(&[]), 0.0, "who is hit from behind");
        let none = neighbours.loss(&space, &knots, &batch.speed_mps(), &Tensor::from_slice(&[0f32, 1.0]));
        assert_eq!(none.double_value(&[]), 0.0, "a row's share");
    }

    #[test]
    fn a_future_that_drives_into_a_neighbour_is_an_example_up_to_there() {
        let (batch, targets) = pair([15.0, 0.0], 0.0, 0.0);
        let counts = Neighbours::new(&batch, &targets).unwrap().examples(&targets);
        // bumpers meet at 1.1 s; the step before the first one looked at with contact goes too
        assert_eq!(counts.get(0).sum(Kind::Float).double_value(&[]), 10.0);
        assert_eq!(counts.get(1).sum(Kind::Float).double_value(&[]), STEPS as f64);
        let alone = Batch::new(vec![cars(&[10.0])], Device::Cpu).unwrap();
        assert!(Neighbours::new(&alone, &targets).is_none());
    }
}
