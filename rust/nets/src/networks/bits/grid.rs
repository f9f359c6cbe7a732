//! The grid of goals in an agent's frame, and goals drawn from it.

use crate::config::MapConfig;
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

/// Where a grid of goals lies in the agent's frame. Cells count along x, then along y.
#[derive(Debug, Clone, Copy)]
pub struct Grid {
    cell_m: f32,
    /// Cells behind the agent.
    behind: f32,
}

impl Grid {
    /// The grid over a raster.
    pub fn new(map: &MapConfig) -> Self {
        let cell_px = map.size_px as f32 / SIDE as f32;
        Self { cell_m: cell_px * map.metres_per_px, behind: map.agent_column_px as f32 / cell_px }
    }

    /// Cell of a point, and the place within it in [0, 1); points outside go to the border.
    pub fn encode(self, x: f32, y: f32) -> (usize, [f32; 2]) {
        let side = SIDE as f32;
        let column = (x / self.cell_m + self.behind).clamp(0.0, side - 1e-5);
        let row = (y / self.cell_m + side / 2.0).clamp(0.0, side - 1e-5);
        let cell = row.floor() as usize * SIDE + column.floor() as usize;
        (cell, [column - column.floor(), row - row.floor()])
    }

    /// Numbers of the goal at a place within a cell, heading along (cos, sin).
    pub fn goal(self, cell: usize, within: [f32; 2], [cos, sin]: [f32; 2]) -> [f32; GOAL] {
        let (row, column) = (cell / SIDE, cell % SIDE);
        let edge = |at: usize| at == 0 || at == SIDE - 1;
        let border = if edge(row) || edge(column) { 1.0 } else { 0.0 };
        let x = (column as f32 + within[0] - self.behind) * self.cell_m;
        let y = (row as f32 + within[1] - SIDE as f32 / 2.0) * self.cell_m;
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

/// Running sums of the cells' unnormalised probabilities, zero off the road where there is any: `road` above zero on pixels.
fn cumulative(of_agent: &[f32], road: Option<&[f32]>) -> Vec<f64> {
    let cells = SIDE * SIDE;
    let logits: Vec<f32> = (0..cells).map(|cell| channel(of_agent, cell, 0)).collect();
    let greatest = logits.iter().fold(f32::NEG_INFINITY, |m, v| m.max(*v));
    let mut p: Vec<f64> = logits.iter().map(|l| libm::exp(f64::from(*l) - f64::from(greatest))).collect();
    if let Some(road) = road {
        let size = road.len().isqrt();
        let px = size / SIDE;
        let mut is_road = vec![false; cells];
        for (at, pixel) in road.iter().enumerate() {
            is_road[at / size / px * SIDE + at % size / px] |= *pixel > 0.0;
        }
        let kept = |p: &[f64]| p.iter().zip(&is_road).map(|(p, on)| if *on { *p } else { 0.0 }).collect();
        let masked: Vec<f64> = kept(&p);
        if masked.iter().any(|p| *p > 0.0) {
            p = masked;
        }
    }
    let mut sum = 0.0;
    for p in &mut p {
        sum += *p;
        *p = sum;
    }
    p
}

/// The cell of a uniform number.
fn drawn(cumulative: &[f64], uniform: f64) -> usize {
    let wanted = uniform * cumulative.last().copied().unwrap_or_default();
    cumulative.partition_point(|c| *c <= wanted).min(cumulative.len() - 1)
}

/// Goals [N · R, GOAL] drawn from cells [R, tokens, CHANNELS · PER_TOKEN], sample by sample; a world's by its own seed.
pub(super) fn goals(cells: &[f32], road: Option<&[f32]>, map: &MapConfig, asked: &Asked<'_>) -> Vec<f32> {
    let (grid, rows, n) = (Grid::new(map), asked.rows.count(), asked.options.num_samples);
    let (per_row, pixels) = (SIDE * SIDE * CHANNELS, map.size_px * map.size_px);
    let mut goals = vec![0.0; n * rows * GOAL];
    let sizes = asked.rows.scene_sizes;
    for ((size, offset), seed) in sizes.iter().zip(row_offsets(sizes)).zip(asked.seeds) {
        let noise = Noise::new(*seed, 0);
        for agent in 0..*size {
            let row = offset + agent;
            let of_agent = &cells[row * per_row..][..per_row];
            let cumulative = cumulative(of_agent, road.map(|road| &road[row * pixels..][..pixels]));
            for sample in 0..n {
                let cell = drawn(&cumulative, noise.uniform((sample * size + agent) as u64));
                let there = |c: usize| channel(of_agent, cell, c);
                let norm = (there(3) * there(3) + there(4) * there(4)).sqrt().max(1e-6);
                let within = [sigmoid(there(1)), sigmoid(there(2))];
                let goal = grid.goal(cell, within, [there(3) / norm, there(4) / norm]);
                goals[(sample * rows + row) * GOAL..][..GOAL].copy_from_slice(&goal);
            }
        }
    }
    goals
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::ModelConfig;

    fn grid() -> Grid {
        Grid::new(ModelConfig::fast().map.as_ref().unwrap())
    }

    #[test]
    fn cells_are_the_tabulated_ones_and_give_points_back() {
        // tabulated in float64
        assert_eq!(grid().encode(0.0, 0.0).0, 517);
        let (cell, [column, row]) = grid().encode(12.34, -3.21);
        assert!(cell == 459 && (column - 0.17).abs() < 1e-5 && (row - 0.395).abs() < 1e-5);
        assert_eq!((grid().encode(-30.0, 0.0).0, grid().encode(100.0, 60.0).0), (512, 1023));
        for (x, y, want, on_border) in [
            (12.34, -3.21, [12.34, -3.21], 0.0),
            (-30.0, 4.0, [-10.0, 4.0], 1.0),
            (100.0, 60.0, [54.0, 32.0], 1.0),
        ] {
            let (cell, within) = grid().encode(x, y);
            let [x, y, cos, sin, border] = grid().goal(cell, within, [0.6, 0.8]);
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
    fn cells_are_drawn_by_their_probabilities_and_never_off_the_road() {
        let mut cells = vec![-40.0f32; SIDE * SIDE * CHANNELS];
        let p = [0.1f64, 0.0, 0.55, 0.35];
        // the last is off the road
        for (cell, p) in [(0, p[0]), (40, p[2]), (400, p[3]), (500, 9.0)] {
            let at = by_token(cell);
            cells[at / PER_TOKEN * CHANNELS * PER_TOKEN + at % PER_TOKEN] = p.ln() as f32;
        }
        let size = 2 * SIDE;
        let mut road = vec![1.0; size * size];
        let pixels =
            |cell: usize| [0, 1, size, size + 1].map(|d| cell / SIDE * 2 * size + cell % SIDE * 2 + d);
        for at in pixels(500) {
            road[at] = 0.0;
        }
        // a cell is on the road if a pixel of it is
        road[pixels(400)[3]] = 0.0;
        let sums = cumulative(&cells, Some(&road));
        let noise = Noise::new(4, 2);
        let count = 100_000;
        let found: Vec<usize> = (0..count).map(|i| drawn(&sums, noise.uniform(i))).collect();
        for (cell, p) in [(0, 0.1), (40, 0.55), (400, 0.35), (500, 0.0)] {
            let got = found.iter().filter(|f| **f == cell).count() as f64;
            let sigma = (count as f64 * p * (1.0 - p)).sqrt();
            assert!((got - count as f64 * p).abs() <= 3.0 * sigma, "cell {cell}: {got}");
        }
        // no road at all: anywhere
        assert_eq!(cumulative(&cells, Some(&vec![0.0; size * size])), cumulative(&cells, None));
    }
}
