//! Contact between the plans of one scene, and departures from the road, in tensors (rivals.md#trafficsim).

use crate::batch::Batch;
use crate::collision::every_other;
use crate::torch::to_vec;
use ccdiff_sim::geom::Point2;
use tch::{Kind, Tensor};

/// Circles along a body.
const CIRCLES: i64 = 5;
/// Squared distance below which two circles are on the same spot, m²: the penalty is 1, without a gradient.
const SAME_SPOT_M2: f64 = 1e-12;

/// Penalties in [0, 1] of pairs of rows, [P, T]: 1 − d/R for the least distance d of two circles and the sum R of their radii,
/// 0 where none touch. From x, y and headings [R, T] in one frame, lengths and widths [R].
fn penalties(
    [x, y, heading]: [&Tensor; 3],
    [length, width]: &[Tensor; 2],
    [first, second]: [&Tensor; 2],
) -> Tensor {
    let radius = width * 0.5;
    let reach = (length * 0.5 - &radius).clamp_min(0.0).unsqueeze(1);
    let offsets = reach * Tensor::linspace(-1.0, 1.0, CIRCLES, (Kind::Float, radius.device()));
    let centre = |at: &Tensor, along: Tensor| at.unsqueeze(2) + along.unsqueeze(2) * offsets.unsqueeze(1);
    let (x, y) = (centre(x, heading.cos()), centre(y, heading.sin()));
    let between = |c: &Tensor| c.index_select(0, first).unsqueeze(3) - c.index_select(0, second).unsqueeze(2);
    let squared = between(&x).square() + between(&y).square();
    let distance = squared.amin([2i64, 3].as_slice(), false).clamp_min(SAME_SPOT_M2).sqrt();
    let radii = (radius.index_select(0, first) + radius.index_select(0, second)).unsqueeze(1);
    (1f64 - distance / radii).clamp_min(0.0)
}

/// Unordered pairs of rows of the same scene.
pub(super) struct Pairs {
    first: Tensor,
    second: Tensor,
    /// 1 / N² of each pair's scene of N rows.
    share: Tensor,
    num_scenes: usize,
}

impl Pairs {
    /// Of a batch; `None` where no scene has two rows.
    pub(super) fn new(batch: &Batch) -> Option<Self> {
        let (mut first, mut second, mut share, mut offset) = (Vec::new(), Vec::new(), Vec::new(), 0i64);
        for size in &batch.scene_sizes {
            let n = *size as i64;
            for i in 0..n {
                for j in i + 1..n {
                    first.push(offset + i);
                    second.push(offset + j);
                    share.push(1.0 / (n * n) as f32);
                }
            }
            offset += n;
        }
        let put = |v: &[i64]| Tensor::from_slice(v).to_device(batch.device);
        (!first.is_empty()).then(|| Self {
            first: put(&first),
            second: put(&second),
            share: Tensor::from_slice(&share).to_device(batch.device),
            num_scenes: batch.scene_sizes.len(),
        })
    }

    /// Penalties [P, steps] of plans [R, T, 6] in the rows' own frames.
    fn of_plans(&self, batch: &Batch, states: &Tensor) -> Tensor {
        let states = every_other(states, 1);
        let [x, y, heading] = poses(batch).map(|c| c.unsqueeze(1));
        let (ahead, left) = (states.select(2, 0), states.select(2, 1));
        let (cos, sin) = (heading.cos(), heading.sin());
        let x = x + &cos * &ahead - &sin * &left;
        let y = y + &sin * &ahead + &cos * &left;
        let heading = heading + states.select(2, 3);
        penalties([&x, &y, &heading], &batch.sizes(), [&self.first, &self.second])
    }

    /// Share of pairs in contact, each counted once at most: (1/N²) Σ_{i≠j} min(1, Σ_t penalty), mean over scenes.
    ///
    /// Differs from the paper, as we recall its formula: the least of 1 and the sum, not the larger one.
    pub(super) fn once(&self, batch: &Batch, states: &Tensor) -> Tensor {
        let sums = self.of_plans(batch, states).sum_dim_intlist([1i64].as_slice(), false, Kind::Float);
        (sums.clamp_max(1.0) * &self.share).sum(Kind::Float) * (2.0 / self.num_scenes as f64)
    }

    /// Mean penalty over pairs and looked-at steps.
    pub(super) fn mean(&self, batch: &Batch, states: &Tensor) -> Tensor {
        self.of_plans(batch, states).mean(Kind::Float)
    }
}

/// Poses now, scene frame: x, y, heading, each [R].
fn poses(batch: &Batch) -> [Tensor; 3] {
    let pose = |c: usize| {
        batch.column(|s, row| {
            let pose = s.poses[row];
            [pose.position.x, pose.position.y, pose.heading_rad][c]
        })
    };
    [0, 1, 2].map(pose)
}

/// Departures from the road: of each of eight points round a footprint that is off the road, 1 less its distance to the nearest of
/// the others that is on it, over the diagonal; mean over points, the looked-at steps and the rows that move. Zero without a road.
///
/// As in the guidance's objective, points off the road are held fixed, and footprints wholly off it count nothing.
pub(super) fn off_road(batch: &Batch, states: &Tensor, moving_mps: f64) -> Tensor {
    let states = every_other(states, 1);
    let [length, width] = batch.sizes().map(|size| size.view([-1, 1, 1]));
    let points = |signs: [f32; 8]| Tensor::from_slice(&signs).to_device(states.device());
    let along = &length * 0.5 * points([-1.0, 0.0, 1.0, 1.0, 1.0, 0.0, -1.0, -1.0]);
    let aside = &width * 0.5 * points([-1.0, -1.0, -1.0, 0.0, 1.0, 1.0, 1.0, 0.0]);
    let at = |c: i64| states.select(2, c).unsqueeze(2);
    let (cos, sin) = (at(3).cos(), at(3).sin());
    let x = at(0) + &cos * &along - &sin * &aside;
    let y = at(1) + &sin * &along + &cos * &aside;
    let is_on = on_road(batch, &x, &y);
    let apart = |v: &Tensor| v.unsqueeze(2) - v.detach().unsqueeze(3);
    let squared =
        (apart(&x).square() + apart(&y).square()).masked_fill(&is_on.logical_not().unsqueeze(2), 1e12);
    let distance = squared.amin([3i64].as_slice(), false).clamp_min(SAME_SPOT_M2).sqrt();
    let diagonal = (length.square() + width.square()).sqrt();
    let off = (1f64 - distance / diagonal).clamp_min(0.0) * is_on.logical_not();
    let moving = batch.speed_mps().abs().gt(moving_mps).to_kind(Kind::Float);
    let of_row = off.mean_dim([1i64, 2].as_slice(), false, Kind::Float);
    (of_row * &moving).sum(Kind::Float) / moving.sum(Kind::Float).clamp_min(1.0)
}

/// Whether points [R, steps, 8] in the rows' frames are on the road of their scene; everywhere without a road.
fn on_road(batch: &Batch, x: &Tensor, y: &Tensor) -> Tensor {
    let [own_x, own_y, heading] = poses(batch).map(|c| c.view([-1, 1, 1]));
    let (cos, sin) = (heading.cos(), heading.sin());
    let [x_m, y_m] = [own_x + &cos * x - &sin * y, own_y + &sin * x + &cos * y].map(|v| to_vec(&v));
    let per_row = (x_m.len() / batch.num_rows()).max(1);
    let roads = batch.scene_sizes.iter().zip(&batch.roads).flat_map(|(size, road)| vec![road; *size]);
    let mut is_on = vec![true; x_m.len()];
    for (row, road) in roads.enumerate() {
        let Some(road) = road else { continue };
        for at in row * per_row..(row + 1) * per_row {
            is_on[at] = road.contains(Point2::new(x_m[at], y_m[at]));
        }
    }
    Tensor::from_slice(&is_on).view_as(x).to_device(x.device())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::batch::tests::cars;
    use ccdiff_sim::geom::{Polygon, Region};
    use std::f32::consts::FRAC_PI_2;
    use std::sync::Arc;

    /// Penalty of a second car at a pose against one at the origin, both 4.5 m by 2 m, and its gradient.
    fn penalty(second: [f32; 3], length: f32, width: f32) -> (f64, [f64; 3]) {
        let pose = Tensor::from_slice(&[[0f32; 3], second].concat()).view([2, 3, 1]).set_requires_grad(true);
        let [x, y, heading] = [0, 1, 2].map(|c| pose.select(1, c));
        let sizes = [[4.5f32, length], [2.0, width]].map(|size| Tensor::from_slice(&size));
        let [first, second] = [0i64, 1].map(|row| Tensor::from_slice(&[row]));
        let found = penalties([&x, &y, &heading], &sizes, [&first, &second]).sum(Kind::Float);
        found.backward();
        let gradient = pose.grad();
        (found.double_value(&[]), [0, 1, 2].map(|c| gradient.double_value(&[1, c, 0])))
    }

    #[test]
    fn penalties_of_pairs_have_the_tabulated_values_and_gradients() {
        // tabulated in float64
        for (pose, want) in [
            ([4.0, 0.0, 0.0], 0.25),
            ([4.5, 0.0, 0.0], 0.0),
            ([4.8, 0.0, 0.0], 0.0),
            ([0.0, 1.5, 0.0], 0.25),
            ([1.8, 1.2, FRAC_PI_2], 0.723_866),
            ([2.5, 2.5, FRAC_PI_2], 0.116_117),
            ([3.2, 1.0, 0.6], 0.517_848),
        ] {
            let (got, _) = penalty(pose, 4.5, 2.0);
            assert!((got - want).abs() < 1e-5, "{pose:?}: {got}");
        }
        let (same, gradient) = penalty([0.0; 3], 4.5, 2.0);
        assert!((same - 1.0).abs() < 1e-6 && gradient == [0.0; 3]);
        assert!((penalty([0.0, 2.2, 0.0], 10.0, 2.5).0 - 0.022_222).abs() < 1e-5, "a truck beside");
        for (pose, want) in [
            ([4.0, 0.0, 0.0], [-0.5, 0.0, 0.0]),
            ([3.2, 1.0, 0.6], [-0.4762, -0.1525, -0.1787]),
            ([1.8, 1.2, FRAC_PI_2], [-0.4979, 0.0453, -0.6224]),
        ] {
            let (_, got) = penalty(pose, 4.5, 2.0);
            assert!(got.iter().zip(want).all(|(g, w)| (g - w).abs() < 1e-3), "{pose:?}: {got:?}");
        }
    }

    #[test]
    fn a_footprint_partly_off_the_road_has_the_tabulated_loss_and_is_pushed_back() {
        let corner = |x, y| Point2::new(x, y);
        let exterior = vec![corner(-50.0, -50.0), corner(50.0, -50.0), corner(50.0, 0.5), corner(-50.0, 0.5)];
        let road = Region::new(&[Polygon::from_exterior(exterior)]).unwrap();
        let numbers = |v: &[f32], size: &[i64]| Tensor::from_slice(v).view(size);
        let mut batch = Batch::new(vec![cars(&[5.0])], tch::Device::Cpu).unwrap();
        batch.roads = vec![Some(Arc::new(road))];
        let loss = |y: f32| {
            let states = numbers(&[0.0, y, 5.0, 0.0, 0.0, 0.0].repeat(2), &[1, 2, 6]).set_requires_grad(true);
            let loss = off_road(&batch, &states, 0.5);
            loss.backward();
            (loss.double_value(&[]), states.grad().double_value(&[0, 1, 1]))
        };
        // two corners are 1 m from a point on the road, the middle of the side 2 m: of a diagonal of sqrt(20) m
        let (found, push) = loss(0.0);
        let diagonal = 20f64.sqrt();
        assert!(
            (found - (2.0 * (1.0 - 1.0 / diagonal) + 1.0 - 2.0 / diagonal) / 8.0).abs() < 1e-5,
            "{found}"
        );
        assert!(push > 0.0, "descent moves it to the right, back to the road: {push}");
        assert_eq!(
            (loss(-5.0), loss(9.0)),
            ((0.0, 0.0), (0.0, 0.0)),
            "wholly on the road, and wholly off it"
        );
    }
}
