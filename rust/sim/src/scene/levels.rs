//! Levels: roads that pass over each other, told apart by elevation.
//!
//! A scene has levels where two heights at one place are farther apart than [`LEVEL_M`]. What is never as far apart at any
//! place, a hill for instance, is flat, and its elevations are left out: nothing pays for them.

use super::map::{Elevations, HIGHEST_M, LEVEL_M, Lane, Map};
use super::road_area::{RoadParts, road_area};
use crate::geom::{Point2, Polygon, Real};
use std::borrow::Borrow;
use std::ops::Range;

/// Heights within a square of this side are of one place, metres.
const PLACE_M: Real = 6.0;
/// Roads of neighbouring levels both reach beyond the bound between them by this, metres.
const OVERLAP_M: Real = 0.5;
/// Lines are looked at every so many metres, at so many places at most.
const SPACING_M: f64 = 2.0;
const MOST_PLACES: f64 = 1e6;

/// Whether a range of elevations reaches to within half a level of one.
fn reaches([low, high]: [Real; 2], elevation_m: Real) -> bool {
    low - 0.5 * LEVEL_M <= elevation_m && elevation_m <= high + 0.5 * LEVEL_M
}

impl Lane {
    /// Runs of points of the centre line, as indices, that are on the level of an elevation; all points without one.
    pub(crate) fn on_level(&self, elevation_m: Option<Real>) -> impl Iterator<Item = Range<usize>> {
        let is_on = |z: &Real| elevation_m.is_none_or(|level| (z - level).abs() <= LEVEL_M);
        let known = !self.elevation_m.is_empty();
        let all = (!known).then_some(0..self.centreline.len());
        all.into_iter().chain(runs(&self.elevation_m, is_on))
    }

    /// Elevation of the centre line at an arc length, clamped to its ends, metres; `None` where it is not known.
    pub(crate) fn height(&self, s_m: Real) -> Option<Real> {
        let mut last = *self.elevation_m.first()?;
        let mut left_m = s_m;
        for (ends, z) in self.centreline.windows(2).zip(&self.elevation_m[1..]) {
            let length_m = (ends[1] - ends[0]).norm();
            if left_m < length_m {
                return Some(last + (z - last) * (left_m / length_m).max(0.0));
            }
            (left_m, last) = (left_m - length_m, *z);
        }
        Some(last)
    }
}

impl Map {
    /// The map without the parts of areas and lines that belong to other levels than that of an elevation. Lanes are all
    /// there, see [`Lane::elevation_m`]; those of other levels have no surface.
    pub fn on_level(&self, elevation_m: Real) -> Self {
        fn kept<T: Clone>(layer: &[T], ranges: &[[Real; 2]], elevation_m: Real) -> Vec<T> {
            let is_kept = |i: usize| ranges.get(i).is_none_or(|range| reaches(*range, elevation_m));
            layer.iter().enumerate().filter(|(i, _)| is_kept(*i)).map(|(_, part)| part.clone()).collect()
        }
        let ranges = &self.elevation_m;
        let lane = |lane: &Lane| match lane.on_level(Some(elevation_m)).next() {
            Some(_) => lane.clone(),
            None => Lane { polygon: Polygon::default(), ..lane.clone() },
        };
        Self {
            drivable_area: kept(&self.drivable_area, &ranges.drivable_area, elevation_m),
            lanes: self.lanes.iter().map(lane).collect(),
            road_dividers: kept(&self.road_dividers, &ranges.road_dividers, elevation_m),
            lane_dividers: kept(&self.lane_dividers, &ranges.lane_dividers, elevation_m),
            ped_crossings: kept(&self.ped_crossings, &ranges.ped_crossings, elevation_m),
            walkways: kept(&self.walkways, &ranges.walkways, elevation_m),
            stop_lines: kept(&self.stop_lines, &ranges.stop_lines, elevation_m),
            carpark_areas: kept(&self.carpark_areas, &ranges.carpark_areas, elevation_m),
            elevation_m: Elevations::default(),
            lights: self.lights.clone(),
        }
    }
}

/// Runs of two values or more that fit.
fn runs(values: &[Real], fits: impl Fn(&Real) -> bool) -> Vec<Range<usize>> {
    let (mut found, mut from) = (Vec::new(), 0);
    for at in 0..=values.len() {
        if !values.get(at).is_some_and(&fits) {
            if at >= from + 2 {
                found.push(from..at);
            }
            from = at + 1;
        }
    }
    found
}

/// Elevations between the levels of a scene, rising, from the lines of its roads with the heights of their points, and from
/// places of its tracks; none where it is flat.
///
/// As few as will do: each lies between all the heights that it parts, by half a metre at least.
pub fn level_bounds<'a>(
    lines: impl Iterator<Item = (&'a [Point2], &'a [Real])> + Clone,
    tracks: impl Iterator<Item = (Point2, Real)> + Clone,
) -> Vec<Real> {
    let pieces = lines.flat_map(|(line, heights)| line.windows(2).zip(heights.windows(2)));
    let all = pieces.clone().flat_map(|(_, heights)| heights).copied().chain(tracks.clone().map(|(_, z)| z));
    let [low, high] = range_of(all);
    if high - low <= LEVEL_M || low == high {
        return Vec::new();
    }
    let length_m: f64 = pieces.clone().map(|(ends, _)| f64::from((ends[1] - ends[0]).norm())).sum();
    let spacing_m = (length_m / MOST_PLACES).max(SPACING_M);
    let places = pieces.flat_map(|(ends, heights)| {
        let (way, rise) = (ends[1] - ends[0], heights[1] - heights[0]);
        let count = (f64::from(way.norm()) / spacing_m).ceil().max(1.0) as usize;
        let at = move |i: usize| i as Real / count as Real;
        (0..=count).map(move |i| (ends[0] + way * at(i), heights[0] + rise * at(i)))
    });
    bounds_between(places.chain(tracks))
}

fn bounds_between(places: impl Iterator<Item = (Point2, Real)>) -> Vec<Real> {
    let cell = |v: Real| (v / PLACE_M).floor() as i64;
    let mut heights: Vec<_> = places.map(|(p, z)| ((cell(p.x), cell(p.y)), z)).collect();
    heights.sort_unstable_by(|a, b| a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)));
    let of_one_place = heights.windows(2).filter(|pair| pair[0].0 == pair[1].0);
    let mut gaps: Vec<[Real; 2]> =
        of_one_place.map(|pair| [pair[0].1, pair[1].1]).filter(|[low, high]| high - low > LEVEL_M).collect();
    gaps.sort_unstable_by(|a, b| a[1].total_cmp(&b[1]).then(a[0].total_cmp(&b[0])));
    let (mut bounds, mut common) = (Vec::new(), None::<[Real; 2]>);
    for gap in gaps {
        common = Some(match common {
            Some([low, high]) if high - gap[0].max(low) >= 2.0 * OVERLAP_M => [low.max(gap[0]), high],
            Some([low, high]) => {
                bounds.push(0.5 * (low + high));
                gap
            }
            None => gap,
        });
    }
    bounds.extend(common.map(|[low, high]| 0.5 * (low + high)));
    bounds
}

/// Elevations of what a road is made of, metres, in the order of [`RoadParts`].
#[derive(Debug, Clone, Copy, Default)]
pub struct PartElevations<'a> {
    /// Of each point of each edge.
    pub edges: &'a [Vec<Real>],
    /// Of each surface.
    pub surfaces: &'a [[Real; 2]],
    /// Of each seed.
    pub seeds: &'a [Real],
}

/// Makes the road of each level from its own parts, between bounds of [`level_bounds`]: polygons, and the range of
/// elevations of each. Lanes have elevations.
pub fn road_areas(
    parts: RoadParts<'_>,
    heights: PartElevations<'_>,
    bounds: &[Real],
) -> (Vec<Polygon>, Vec<[Real; 2]>) {
    let ends = [-HIGHEST_M, HIGHEST_M];
    let bounds: Vec<Real> = ends[..1].iter().chain(bounds).chain(&ends[1..]).copied().collect();
    let (mut areas, mut ranges) = (Vec::new(), Vec::new());
    for level in bounds.windows(2) {
        let is_on = |z: &Real| level[0] - OVERLAP_M <= *z && *z <= level[1] + OVERLAP_M;
        let edges: Vec<Vec<Point2>> = parts
            .edges
            .iter()
            .zip(heights.edges)
            .flat_map(|(edge, heights)| runs(heights, is_on).into_iter().map(|run| edge[run].to_vec()))
            .collect();
        let lane_pieces = |lane: &Lane| {
            let piece =
                |run: Range<usize>| Lane { centreline: lane.centreline[run].to_vec(), ..lane.clone() };
            runs(&lane.elevation_m, is_on).into_iter().map(piece).collect::<Vec<_>>()
        };
        let lanes: Vec<Lane> = parts.lanes.iter().flat_map(lane_pieces).collect();
        let surfaces = parts.surfaces.iter().zip(heights.surfaces);
        let surfaces = surfaces.filter(|(_, range)| range[0] <= level[1] && level[0] <= range[1]);
        let surfaces: Vec<Polygon> = surfaces.map(|(surface, _)| surface.clone()).collect();
        let seeds = parts.seeds.iter().zip(heights.seeds).filter(|(_, z)| is_on(z));
        let seeds: Vec<Point2> = seeds.map(|(seed, _)| *seed).collect();
        let parts = RoadParts { edges: &edges, lanes: &lanes, surfaces: &surfaces, seeds: &seeds };
        areas.extend(road_area(parts));
        ranges.resize(areas.len(), [level[0], level[1]]);
    }
    (areas, ranges)
}

/// Cuts a line where it passes a bound between levels: its pieces, with their elevations.
pub fn cut_by_level(line: &[Point2], heights: &[Real], bounds: &[Real]) -> Vec<(Vec<Point2>, [Real; 2])> {
    let level = |z: Real| bounds.partition_point(|bound| *bound < z);
    let (mut pieces, mut from) = (Vec::new(), 0);
    for at in 1..line.len() {
        if at + 1 == line.len() || level(heights[at]) != level(heights[from]) {
            pieces.push((line[from..=at].to_vec(), range_of(&heights[from..=at])));
            from = at;
        }
    }
    pieces
}

/// Least and greatest of some heights.
pub fn range_of(heights: impl IntoIterator<Item = impl Borrow<Real>>) -> [Real; 2] {
    let none = [Real::INFINITY, Real::NEG_INFINITY];
    heights.into_iter().fold(none, |[low, high], z| [low.min(*z.borrow()), high.max(*z.borrow())])
}
