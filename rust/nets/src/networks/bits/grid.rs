//! The grid of goals in an agent's frame, and goals drawn from it.

use crate::inputs::features::row_offsets;
use crate::networks::planner::Asked;
use crate::sampling::noise::Noise;

/// Cells along a side of the goal grid.
pub(super) const SIDE: usize = 32;
/// Cells along a side of a map token.
pub(super) const CELLS_PER_TOKEN: usize = 4;
/// Channels of a cell: logit, place within it (2), cosine and sine of the heading there.
pub const CHANNELS: usize = 5;
/// Cells of a token.
pub const PER_TOKEN: usize = CELLS_PER_TOKEN * CELLS_PER_TOKEN;
/// Numbers of a goal: x, y, cosine and sine of the heading, whether its cell is on the border.
pub const GOAL: usize = 5;
/// Positions of goals are divided by this, metres.
const GOAL_SCALE_M: f32 = 20.0;

/// Side of a cell, metres.
const CELL_M: f32 = 2.0;
/// Cells behind the agent.
const BEHIND: f32 = 5.0;

/// The grid of goals in the agent's frame. Cells count along x, then along y.
#[derive(Debug, Clone, Copy)]
pub struct Grid;

impl Grid {
    /// Cell of a point, and the place within it in [0, 1); points outside go to the border.
    pub fn encode(x: f32, y: f32) -> (usize, [f32; 2]) {
        let side = SIDE as f32;
        let column = (x / CELL_M + BEHIND).clamp(0.0, side - 1e-5);
        let row = (y / CELL_M + side / 2.0).clamp(0.0, side - 1e-5);
        let cell = row.floor() as usize * SIDE + column.floor() as usize;
        (cell, [column - column.floor(), row - row.floor()])
    }

    /// Numbers of the goal at a place within a cell, heading along (cos, sin).
    pub fn goal(cell: usize, within: [f32; 2], [cos, sin]: [f32; 2]) -> [f32; GOAL] {
        let (row, column) = (cell / SIDE, cell % SIDE);
        let edge = |at: usize| at == 0 || at == SIDE - 1;
        let border = if edge(row) || edge(column) { 1.0 } else { 0.0 };
        let x = (column as f32 + within[0] - BEHIND) * CELL_M;
        let y = (row as f32 + within[1] - SIDE as f32 / 2.0) * CELL_M;
        [x / GOAL_SCALE_M, y / GOAL_SCALE_M, cos, sin, border]
    }
}

/// Index of a cell among the cells of all tokens, token by token.
pub fn by_token(cell: usize) -> usize {
    let (row, column) = (cell / SIDE, cell % SIDE);
    let token = row / CELLS_PER_TOKEN * (SIDE / CELLS_PER_TOKEN) + column / CELLS_PER_TOKEN;
    token * PER_TOKEN + row % CELLS_PER_TOKEN * CELLS_PER_TOKEN + column % CELLS_PER_TOKEN
}

/// A channel of a cell among an agent's numbers [tokens, CHANNELS, PER_TOKEN].
fn channel(of_agent: &[f32], cell: usize, channel: usize) -> f32 {
    let at = by_token(cell);
    of_agent[(at / PER_TOKEN * CHANNELS + channel) * PER_TOKEN + at % PER_TOKEN]
}

fn sigmoid(x: f32) -> f32 {
    (1.0 / (1.0 + libm::exp(-f64::from(x)))) as f32
}

/// Running sums of the cells' unnormalised probabilities.
fn cumulative(of_agent: &[f32]) -> Vec<f64> {
    let logits: Vec<f32> = (0..SIDE * SIDE).map(|cell| channel(of_agent, cell, 0)).collect();
    let greatest = logits.iter().fold(f32::NEG_INFINITY, |m, v| m.max(*v));
    let mut sum = 0.0;
    let next = |logit: &f32| {
        sum += libm::exp(f64::from(*logit) - f64::from(greatest));
        sum
    };
    logits.iter().map(next).collect()
}

/// The cell of a uniform number.
fn drawn(cumulative: &[f64], uniform: f64) -> usize {
    let wanted = uniform * cumulative.last().copied().unwrap_or_default();
    cumulative.partition_point(|c| *c <= wanted).min(cumulative.len() - 1)
}

/// Goals [N · R, GOAL] drawn from cells [R, tokens, CHANNELS · PER_TOKEN], sample by sample; a world's by its own seed.
pub(super) fn goals(cells: &[f32], asked: &Asked<'_>) -> Vec<f32> {
    let (rows, n, per_row) = (asked.rows.count(), asked.options.num_samples, SIDE * SIDE * CHANNELS);
    let mut goals = vec![0.0; n * rows * GOAL];
    let sizes = asked.rows.scene_sizes;
    for ((size, offset), seed) in sizes.iter().zip(row_offsets(sizes)).zip(asked.seeds) {
        let noise = Noise::new(*seed, 0);
        for agent in 0..*size {
            let row = offset + agent;
            let of_agent = &cells[row * per_row..][..per_row];
            let cumulative = cumulative(of_agent);
            for sample in 0..n {
                let cell = drawn(&cumulative, noise.uniform((sample * size + agent) as u64));
                let there = |c: usize| channel(of_agent, cell, c);
                let norm = (there(3) * there(3) + there(4) * there(4)).sqrt().max(1e-6);
                let within = [sigmoid(there(1)), sigmoid(there(2))];
                let goal = Grid::goal(cell, within, [there(3) / norm, there(4) / norm]);
                goals[(sample * rows + row) * GOAL..][..GOAL].copy_from_slice(&goal);
            }
        }
    }
    goals
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_are_the_tabulated_ones_and_give_points_back() {
        // tabulated in float64
        assert_eq!(Grid::encode(0.0, 0.0).0, 517);
        let (cell, [column, row]) = Grid::encode(12.34, -3.21);
        assert!(cell == 459 && (column - 0.17).abs() < 1e-5 && (row - 0.395).abs() < 1e-5);
        assert_eq!((Grid::encode(-30.0, 0.0).0, Grid::encode(100.0, 60.0).0), (512, 1023));
        for (x, y, want, on_border) in [
            (12.34, -3.21, [12.34, -3.21], 0.0),
            (-30.0, 4.0, [-10.0, 4.0], 1.0),
            (100.0, 60.0, [54.0, 32.0], 1.0),
        ] {
            let (cell, within) = Grid::encode(x, y);
            let [x, y, cos, sin, border] = Grid::goal(cell, within, [0.6, 0.8]);
            assert!((x * GOAL_SCALE_M - want[0]).abs() < 1e-4 && (y * GOAL_SCALE_M - want[1]).abs() < 1e-4);
            assert_eq!((cos, sin, border), (0.6, 0.8, on_border));
        }
    }

    #[test]
    fn every_cell_has_a_place_of_its_own_beside_those_of_its_token() {
        let mut places: Vec<usize> = (0..SIDE * SIDE).map(by_token).collect();
        assert_eq!((by_token(33), by_token(4), by_token(SIDE * 4)), (5, PER_TOKEN, 8 * PER_TOKEN));
        places.sort_unstable();
        assert!(places.into_iter().eq(0..SIDE * SIDE));
    }

    #[test]
    fn cells_are_drawn_by_their_probabilities() {
        let mut cells = vec![-40.0f32; SIDE * SIDE * CHANNELS];
        for (cell, p) in [(0, 0.1f64), (40, 0.55), (400, 0.35)] {
            let at = by_token(cell);
            cells[at / PER_TOKEN * CHANNELS * PER_TOKEN + at % PER_TOKEN] = p.ln() as f32;
        }
        let sums = cumulative(&cells);
        let noise = Noise::new(4, 2);
        let count = 100_000;
        let found: Vec<usize> = (0..count).map(|i| drawn(&sums, noise.uniform(i))).collect();
        for (cell, p) in [(0, 0.1), (40, 0.55), (400, 0.35), (500, 0.0)] {
            let got = found.iter().filter(|f| **f == cell).count() as f64;
            let sigma = (count as f64 * p * (1.0 - p)).sqrt();
            assert!((got - count as f64 * p).abs() <= 3.0 * sigma, "cell {cell}: {got}");
        }
    }
}
