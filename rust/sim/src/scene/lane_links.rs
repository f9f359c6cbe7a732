//! Links between lanes for maps that have none: a lane follows another that ends where it begins.

use super::map::{LEVEL_M, Lane};
use crate::geom::{Point2, Real, Vector2};
use std::collections::BTreeMap;

/// A lane begins this near to the end of the one before it, metres.
const JOINT_M: Real = 0.5;
/// Cosine of the largest turn from one lane into the next.
const TURN_COS: Real = 0.5;
/// Most lanes that begin in one square of [`JOINT_M`]; further ones are not linked.
const MOST_AT_JOINT: usize = 32;

/// Fills in successors and predecessors where no lane has any.
pub fn link_lanes(lanes: &mut [Lane]) {
    if lanes.iter().any(|lane| !lane.successors.is_empty() || !lane.predecessors.is_empty()) {
        return;
    }
    let cell = |p: Point2| ((p.x / JOINT_M).floor() as i64, (p.y / JOINT_M).floor() as i64);
    let ends: Vec<_> = lanes.iter().map(|lane| ends_of(&lane.centreline)).collect();
    let mut starts: BTreeMap<(i64, i64), Vec<usize>> = BTreeMap::new();
    for (i, found) in ends.iter().enumerate() {
        let Some([(start, _), _]) = found else { continue };
        let here = starts.entry(cell(*start)).or_default();
        if here.len() < MOST_AT_JOINT {
            here.push(i);
        }
    }
    for (i, found) in ends.iter().enumerate() {
        let Some([_, (end, heading)]) = found else { continue };
        let (x, y) = cell(*end);
        let near = (x - 1..=x + 1).flat_map(|x| (y - 1..=y + 1).map(move |y| (x, y)));
        let mut followers: Vec<usize> = near.filter_map(|c| starts.get(&c)).flatten().copied().collect();
        followers.retain(|j| {
            let follows = |[(start, ahead), _]: [(Point2, Vector2); 2]| {
                (start - end).norm() <= JOINT_M && ahead.dot(heading) >= TURN_COS
            };
            let [last, first] = [lanes[i].elevation_m.last(), lanes[*j].elevation_m.first()];
            let level = last.zip(first).is_none_or(|(z, next)| (z - next).abs() <= LEVEL_M);
            *j != i && level && ends[*j].is_some_and(follows)
        });
        followers.sort_unstable();
        for j in followers {
            lanes[i].successors.push(j as u32);
            lanes[j].predecessors.push(i as u32);
        }
    }
}

/// First and last point of a line with the directions there.
fn ends_of(line: &[Point2]) -> Option<[(Point2, Vector2); 2]> {
    let direction = |a: Point2, b: Point2| (b - a).try_normalize(1e-6);
    let (first, last) = (*line.first()?, *line.last()?);
    let ahead = line.iter().find_map(|p| direction(first, *p))?;
    let arriving = line.iter().rev().find_map(|p| direction(*p, last))?;
    Some([(first, ahead), (last, arriving)])
}

#[cfg(test)]
mod tests {
    use super::*;

    fn lane(points: &[(Real, Real)]) -> Lane {
        let centreline = points.iter().map(|(x, y)| Point2::new(*x, *y)).collect();
        Lane { centreline, ..Lane::default() }
    }

    #[test]
    fn lanes_follow_where_one_ends_and_another_begins() {
        let mut lanes = [
            lane(&[(0.0, 0.0), (10.0, 0.0)]),
            lane(&[(10.3, 0.2), (20.0, 0.0)]),  // ahead
            lane(&[(10.0, 0.0), (15.0, 5.0)]),  // bends off
            lane(&[(10.0, 0.0), (0.0, 3.0)]),   // the other way
            lane(&[(10.6, 0.0), (30.0, 0.0)]),  // too far
            lane(&[(-9.0, 0.0), (-0.2, -0.3)]), // behind
        ];
        link_lanes(&mut lanes);
        let links: Vec<_> = lanes.iter().map(|l| (l.successors.clone(), l.predecessors.clone())).collect();
        assert_eq!(links[0], (vec![1, 2], vec![5]));
        assert_eq!((&links[1].1, &links[2].1, &links[5].0), (&vec![0], &vec![0], &vec![0]));
        assert_eq!((&links[3], &links[4]), (&(vec![], vec![]), &(vec![], vec![])));
    }

    #[test]
    fn links_that_a_file_has_stay() {
        let mut lanes = [lane(&[(0.0, 0.0), (10.0, 0.0)]), lane(&[(10.0, 0.0), (20.0, 0.0)])];
        lanes[1].predecessors = vec![1];
        link_lanes(&mut lanes);
        assert!(lanes[0].successors.is_empty());
    }

    #[test]
    fn many_lanes_at_one_place_take_little() {
        let mut lanes = vec![lane(&[(0.0, 0.0), (0.01, 0.0)]); 100_000];
        link_lanes(&mut lanes);
        assert!(lanes.iter().map(|l| l.successors.len()).max() <= Some(4 * MOST_AT_JOINT));
    }
}
