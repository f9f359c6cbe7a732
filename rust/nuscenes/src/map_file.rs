//! A map expansion file (version 1.3) of one location, parsed once and shared by all its scenes.

use crate::arcline::{ArcLinePath, discretise};
use crate::budget::{Budget, name};
use crate::error::{NuscenesError, Result};
use crate::file;
use crate::stream::{BYTE_ORDER_MARK, parse};
use crate::token::{Index, Token, index};
use ccdiff_sim::scene::LaneKind;
use rayon::prelude::*;
use serde::Deserialize;
use std::collections::BTreeMap;
use std::fmt::Display;
use std::path::{Path, PathBuf};

/// Points of centre lines are about this far apart, metres.
const CENTRELINE_SPACING_M: f64 = 1.0;
/// Points that the maps of a load may have in all; those of nuScenes have 275,000. Many records may name one polygon.
pub(crate) const MOST_POINTS: usize = 5_000_000;

/// Axis-aligned box, metres.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(crate) struct Bounds {
    pub(crate) min: [f64; 2],
    pub(crate) max: [f64; 2],
}

impl Bounds {
    /// Box round points; contains nothing when there are none.
    pub(crate) fn of<'a>(points: impl IntoIterator<Item = &'a [f64; 2]>) -> Self {
        let mut bounds = Self { min: [f64::INFINITY; 2], max: [f64::NEG_INFINITY; 2] };
        for point in points {
            for axis in 0..2 {
                bounds.min[axis] = bounds.min[axis].min(point[axis]);
                bounds.max[axis] = bounds.max[axis].max(point[axis]);
            }
        }
        bounds
    }

    pub(crate) fn touches(&self, other: &Self) -> bool {
        (0..2).all(|i| self.min[i] <= other.max[i] && other.min[i] <= self.max[i])
    }

    pub(crate) fn holds(&self, other: &Self) -> bool {
        (0..2).all(|i| self.min[i] <= other.min[i] && other.max[i] <= self.max[i])
    }

    pub(crate) fn grown(&self, margin_m: f64) -> Self {
        Self { min: self.min.map(|v| v - margin_m), max: self.max.map(|v| v + margin_m) }
    }
}

/// Rings in the global frame, metres; empty exterior where the data has none.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct GlobalPolygon {
    pub(crate) exterior: Vec<[f64; 2]>,
    pub(crate) holes: Vec<GlobalLine>,
    pub(crate) bounds: Bounds,
}

/// A line in the global frame, metres.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct GlobalLine {
    pub(crate) points: Vec<[f64; 2]>,
    pub(crate) bounds: Bounds,
}

impl GlobalLine {
    fn new(points: Vec<[f64; 2]>) -> Self {
        Self { bounds: Bounds::of(&points), points }
    }
}

/// A lane in the global frame.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct GlobalLane {
    pub(crate) id: String,
    pub(crate) kind: LaneKind,
    pub(crate) centreline: Vec<[f64; 2]>,
    pub(crate) polygon: Option<GlobalPolygon>,
    pub(crate) successors: Vec<u32>,
    pub(crate) predecessors: Vec<u32>,
}

impl GlobalLane {
    /// Box round centre line and polygon.
    fn bounds(&self) -> Bounds {
        Bounds::of(self.centreline.iter().chain(self.polygon.iter().flat_map(|p| &p.exterior)))
    }
}

/// The whole map of one location.
#[derive(Debug, Clone, PartialEq, Default)]
pub(crate) struct GlobalMap {
    pub(crate) drivable_area: Vec<GlobalPolygon>,
    pub(crate) lanes: Vec<GlobalLane>,
    /// Boxes round the lanes, which every scene looks through.
    pub(crate) lane_bounds: Vec<Bounds>,
    pub(crate) road_dividers: Vec<GlobalLine>,
    pub(crate) lane_dividers: Vec<GlobalLine>,
    pub(crate) ped_crossings: Vec<GlobalPolygon>,
    pub(crate) walkways: Vec<GlobalPolygon>,
    pub(crate) stop_lines: Vec<GlobalPolygon>,
    pub(crate) carpark_areas: Vec<GlobalPolygon>,
}

/// Where the map of a location lies.
pub(crate) fn map_path(dataroot: &Path, location: &str) -> PathBuf {
    dataroot.join("maps").join("expansion").join(format!("{location}.json"))
}

/// Reads the map of a location; its points are of a budget.
pub(crate) fn read_map(path: &Path, location: &str, points: &Budget) -> Result<(GlobalMap, Vec<String>)> {
    let bytes =
        file::read(path, file::MOST_BYTES).map_err(|e| NuscenesError::from_io(path, "map expansion", e))?;
    let text = bytes.strip_prefix(BYTE_ORDER_MARK).unwrap_or(&bytes);
    // serde would take an array for the layers in their order
    if text.trim_ascii_start().first() != Some(&b'{') {
        let (path, message) = (path.to_owned(), "expected an object of layers".into());
        return Err(NuscenesError::Json { path, offset: 0, message });
    }
    let file: MapFile = parse(text, path, (bytes.len() - text.len()) as u64)?;
    let assembler = Assembler::new(&file, path, points)?;
    let mut notes = Vec::new();
    let lanes = assembler.lanes(&file, &mut notes)?;
    let map = GlobalMap {
        drivable_area: assembler.drivable_area(&file.drivable_area, &mut notes)?,
        ped_crossings: assembler.areas("ped_crossing", &file.ped_crossing, &mut notes)?,
        walkways: assembler.areas("walkway", &file.walkway, &mut notes)?,
        stop_lines: assembler.areas("stop_line", &file.stop_line, &mut notes)?,
        carpark_areas: assembler.areas("carpark_area", &file.carpark_area, &mut notes)?,
        road_dividers: assembler.dividers("road_divider", &file.road_divider, &mut notes)?,
        lane_dividers: assembler.dividers("lane_divider", &file.lane_divider, &mut notes)?,
        lane_bounds: lanes.iter().map(GlobalLane::bounds).collect(),
        lanes,
    };
    Ok((map, notes.into_iter().map(|note| format!("{location}: {note}")).collect()))
}

/// The layers of a map file as they are written; those that are left out are empty.
#[derive(Deserialize, Default)]
#[serde(default)]
struct MapFile {
    node: Vec<NodeRow>,
    polygon: Vec<PolygonRow>,
    line: Vec<LineRow>,
    drivable_area: Vec<DrivableAreaRow>,
    ped_crossing: Vec<AreaRow>,
    walkway: Vec<AreaRow>,
    stop_line: Vec<AreaRow>,
    carpark_area: Vec<AreaRow>,
    road_divider: Vec<DividerRow>,
    lane_divider: Vec<DividerRow>,
    lane: Vec<AreaRow>,
    lane_connector: Vec<AreaRow>,
    arcline_path_3: BTreeMap<String, Vec<ArcLinePath>>,
    connectivity: BTreeMap<String, Links>,
}

#[derive(Deserialize)]
struct NodeRow {
    token: Token,
    x: f64,
    y: f64,
}

#[derive(Deserialize)]
struct PolygonRow {
    token: Token,
    exterior_node_tokens: Vec<Token>,
    holes: Option<Vec<Hole>>,
}

#[derive(Deserialize)]
struct Hole {
    node_tokens: Vec<Token>,
}

#[derive(Deserialize)]
struct LineRow {
    token: Token,
    node_tokens: Vec<Token>,
}

#[derive(Deserialize)]
struct DrivableAreaRow {
    token: String,
    polygon_tokens: Vec<Token>,
}

/// A lane, or an area of another layer.
#[derive(Deserialize)]
struct AreaRow {
    #[serde(deserialize_with = "name")]
    token: String,
    polygon_token: Option<Token>,
}

#[derive(Deserialize)]
struct DividerRow {
    token: String,
    line_token: Token,
}

/// Neighbours of a lane.
#[derive(Deserialize, Default)]
struct Links {
    #[serde(default)]
    incoming: Vec<String>,
    #[serde(default)]
    outgoing: Vec<String>,
}

/// Resolves tokens to geometry.
struct Assembler<'a> {
    path: &'a Path,
    points_left: &'a Budget,
    nodes: Index<[f64; 2]>,
    polygons: Index<&'a PolygonRow>,
    /// Tokens of the nodes of lines.
    lines: Index<&'a [Token]>,
}

fn note(notes: &mut Vec<String>, count: usize, words: &str) {
    if count > 0 {
        notes.push(format!("{count} {words}"));
    }
}

impl<'a> Assembler<'a> {
    fn new(file: &'a MapFile, path: &'a Path, points_left: &'a Budget) -> Result<Self> {
        if let Some(NodeRow { token, x, y }) =
            file.node.iter().find(|n| !(n.x.abs() < 1e6 && n.y.abs() < 1e6))
        {
            let got = format!("{x:?}, {y:?}");
            return Err(NuscenesError::value(path, token, "node x, y", got, "metres within 1000 km"));
        }
        let twice = |what| move |token: Token| NuscenesError::duplicate(path, what, token);
        Ok(Self {
            path,
            points_left,
            nodes: index(file.node.iter().map(|n| (n.token, [n.x, n.y]))).map_err(twice("node token"))?,
            polygons: index(file.polygon.iter().map(|p| (p.token, p))).map_err(twice("polygon token"))?,
            lines: index(file.line.iter().map(|l| (l.token, l.node_tokens.as_slice())))
                .map_err(twice("line token"))?,
        })
    }

    fn dangling(&self, token: impl Display, field: &str, got: Token, table: &str) -> NuscenesError {
        NuscenesError::dangling(self.path, token, field, got, table)
    }

    /// Takes points from the budget.
    fn take(&self, count: usize) -> Result<()> {
        if self.points_left.covers(count) {
            return Ok(());
        }
        let (path, most) = (self.path.to_owned(), MOST_POINTS);
        let what = format!("lanes, polygons and lines have more than {most} points in the maps to load");
        Err(NuscenesError::Data { path, what })
    }

    /// The points of a list of node tokens, without repetitions.
    fn points(&self, owner: Token, tokens: &[Token]) -> Result<Vec<[f64; 2]>> {
        self.take(tokens.len())?;
        let point = |token: &Token| {
            self.nodes.get(token).copied().ok_or_else(|| self.dangling(owner, "node_tokens", *token, "node"))
        };
        let mut points = tokens.iter().map(point).collect::<Result<Vec<_>>>()?;
        points.dedup();
        Ok(points)
    }

    /// A ring without its closing point.
    fn ring(&self, owner: Token, tokens: &[Token]) -> Result<Vec<[f64; 2]>> {
        let mut ring = self.points(owner, tokens)?;
        if ring.len() > 1 && ring.first() == ring.last() {
            ring.pop();
        }
        Ok(ring)
    }

    /// The polygon of a token; `None` where there is no token, or where it has fewer than three corners.
    fn polygon(&self, owner: &str, token: Option<Token>) -> Result<Option<GlobalPolygon>> {
        let Some(token) = token else { return Ok(None) };
        let found = self.polygons.get(&token);
        let row = found.ok_or_else(|| self.dangling(owner, "polygon_token", token, "polygon"))?;
        let exterior = self.ring(token, &row.exterior_node_tokens)?;
        if exterior.len() < 3 {
            return Ok(None);
        }
        let holes = row.holes.iter().flatten().map(|hole| self.ring(token, &hole.node_tokens));
        let mut rings = holes.collect::<Result<Vec<_>>>()?;
        rings.retain(|ring| ring.len() >= 3);
        let holes = rings.into_iter().map(GlobalLine::new).collect();
        Ok(Some(GlobalPolygon { bounds: Bounds::of(&exterior), exterior, holes }))
    }

    /// The polygons of tokens, each with its owner; those without an area are counted in a note.
    fn polygons<'r>(
        &self,
        tokens: impl ParallelIterator<Item = (&'r str, Option<Token>)>,
        left_out: &str,
        notes: &mut Vec<String>,
    ) -> Result<Vec<GlobalPolygon>> {
        let made = tokens.map(|(owner, token)| self.polygon(owner, token)).collect::<Result<Vec<_>>>()?;
        note(notes, made.iter().filter(|p| p.is_none()).count(), left_out);
        Ok(made.into_iter().flatten().collect())
    }

    fn drivable_area(&self, rows: &[DrivableAreaRow], notes: &mut Vec<String>) -> Result<Vec<GlobalPolygon>> {
        let tokens = rows
            .par_iter()
            .flat_map(|row| row.polygon_tokens.par_iter().map(|token| (row.token.as_str(), Some(*token))));
        self.polygons(tokens, "drivable_area polygons with fewer than three corners left out", notes)
    }

    fn areas(&self, layer: &str, rows: &[AreaRow], notes: &mut Vec<String>) -> Result<Vec<GlobalPolygon>> {
        let tokens = rows.par_iter().map(|row| (row.token.as_str(), row.polygon_token));
        self.polygons(tokens, &format!("{layer} records without an area left out"), notes)
    }

    fn dividers(&self, layer: &str, rows: &[DividerRow], notes: &mut Vec<String>) -> Result<Vec<GlobalLine>> {
        let line = |DividerRow { token, line_token }: &DividerRow| {
            let nodes = self.lines.get(line_token);
            let nodes = nodes.ok_or_else(|| self.dangling(token, "line_token", *line_token, "line"))?;
            Ok(GlobalLine::new(self.points(*line_token, nodes)?))
        };
        let mut lines = rows.par_iter().map(line).collect::<Result<Vec<_>>>()?;
        lines.retain(|line| line.points.len() >= 2);
        note(notes, rows.len() - lines.len(), &format!("{layer} records of fewer than two points left out"));
        Ok(lines)
    }

    /// A lane without links; no centre line where the data has none.
    fn lane(&self, row: &AreaRow, kind: LaneKind, file: &MapFile) -> Result<GlobalLane> {
        let id = row.token.clone();
        let paths = file.arcline_path_3.get(&id).map_or(&[][..], Vec::as_slice);
        for path in paths {
            path.check().map_err(|(field, got, expected)| {
                NuscenesError::value(self.path, &id, field, got, expected)
            })?;
            self.take(path.num_pieces(CENTRELINE_SPACING_M) + 1)?;
        }
        let centreline = discretise(paths, CENTRELINE_SPACING_M);
        let polygon = self.polygon(&id, row.polygon_token)?;
        let (successors, predecessors) = (Vec::new(), Vec::new());
        Ok(GlobalLane { id, kind, centreline, polygon, successors, predecessors })
    }

    fn lanes(&self, file: &MapFile, notes: &mut Vec<String>) -> Result<Vec<GlobalLane>> {
        let mut lanes = Vec::new();
        for (rows, kind) in [(&file.lane, LaneKind::Lane), (&file.lane_connector, LaneKind::Connector)] {
            let made = rows.par_iter().map(|row| self.lane(row, kind, file));
            lanes.extend(made.collect::<Result<Vec<_>>>()?);
        }
        let before = lanes.len();
        lanes.retain(|lane| !lane.centreline.is_empty());
        note(notes, before - lanes.len(), "lanes without a centre line left out");
        let without_area = lanes.iter().filter(|lane| lane.polygon.is_none()).count();
        note(notes, without_area, "lanes without a polygon");
        let mut index: BTreeMap<String, u32> = BTreeMap::new();
        for (i, lane) in lanes.iter().enumerate() {
            if index.insert(lane.id.clone(), i as u32).is_some() {
                return Err(NuscenesError::duplicate(self.path, "lane token", &lane.id));
            }
        }
        let lost = link(&mut lanes, &index, &file.connectivity);
        note(notes, lost, "links to lanes that are not there left out");
        Ok(lanes)
    }
}

/// Links lanes both ways, whichever side names the link; returns how many links lead nowhere.
fn link(
    lanes: &mut [GlobalLane],
    index: &BTreeMap<String, u32>,
    connectivity: &BTreeMap<String, Links>,
) -> usize {
    let mut lost = 0;
    let mut edges = Vec::new();
    for (token, links) in connectivity {
        let outgoing = links.outgoing.iter().map(|to| (token, to));
        for (from, to) in outgoing.chain(links.incoming.iter().map(|from| (from, token))) {
            match (index.get(from), index.get(to)) {
                (Some(from), Some(to)) => edges.push((*from, *to)),
                _ => lost += 1,
            }
        }
    }
    edges.sort_unstable();
    edges.dedup();
    for (from, to) in edges {
        lanes[from as usize].successors.push(to);
        lanes[to as usize].predecessors.push(from);
    }
    lost
}
