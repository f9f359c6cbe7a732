//! A map expansion file (version 1.3) of one location, parsed once and shared by all its scenes.

use crate::arcline::{ArcLinePath, discretise};
use crate::error::{NuscenesError, Result};
use crate::report::MapReport;
use crate::token::Token;
use ccdiff_sim::scene::LaneKind;
use serde::Deserialize;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

/// Points of centre lines are about this far apart, metres.
const CENTRELINE_SPACING_M: f64 = 1.0;

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
    pub(crate) holes: Vec<Vec<[f64; 2]>>,
    pub(crate) bounds: Bounds,
}

/// A line in the global frame, metres.
#[derive(Debug, Clone, PartialEq)]
pub(crate) struct GlobalLine {
    pub(crate) points: Vec<[f64; 2]>,
    pub(crate) bounds: Bounds,
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
    /// Round centre line and polygon.
    pub(crate) bounds: Bounds,
}

/// The whole map of one location.
#[derive(Debug, Clone, PartialEq, Default)]
pub(crate) struct GlobalMap {
    pub(crate) drivable_area: Vec<GlobalPolygon>,
    pub(crate) lanes: Vec<GlobalLane>,
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

#[derive(Deserialize)]
struct NodeRow {
    token: Token,
    x: f64,
    y: f64,
}

#[derive(Deserialize)]
struct HoleRow {
    node_tokens: Vec<Token>,
}

#[derive(Deserialize)]
struct PolygonRow {
    token: Token,
    exterior_node_tokens: Vec<Token>,
    #[serde(default)]
    holes: Vec<HoleRow>,
}

#[derive(Deserialize)]
struct LineRow {
    token: Token,
    node_tokens: Vec<Token>,
}

#[derive(Deserialize)]
struct AreasRow {
    token: String,
    polygon_tokens: Vec<Token>,
}

#[derive(Deserialize)]
struct AreaRow {
    token: String,
    #[serde(default)]
    polygon_token: Option<Token>,
}

#[derive(Deserialize)]
struct DividerRow {
    token: String,
    line_token: Token,
}

#[derive(Deserialize, Default)]
struct Links {
    #[serde(default)]
    incoming: Vec<String>,
    #[serde(default)]
    outgoing: Vec<String>,
}

/// The layers that are read; the others (road segments, traffic lights …) are skipped.
#[derive(Deserialize)]
#[serde(default)]
#[derive(Default)]
struct MapRows {
    node: Vec<NodeRow>,
    polygon: Vec<PolygonRow>,
    line: Vec<LineRow>,
    drivable_area: Vec<AreasRow>,
    lane: Vec<AreaRow>,
    lane_connector: Vec<AreaRow>,
    ped_crossing: Vec<AreaRow>,
    walkway: Vec<AreaRow>,
    stop_line: Vec<AreaRow>,
    carpark_area: Vec<AreaRow>,
    road_divider: Vec<DividerRow>,
    lane_divider: Vec<DividerRow>,
    arcline_path_3: BTreeMap<String, Vec<ArcLinePath>>,
    connectivity: BTreeMap<String, Links>,
}

/// Reads the map of a location.
///
/// # Errors
/// Unreadable files, invalid JSON, references to nodes, polygons or lines that do not exist, damaged centre lines.
pub(crate) fn read_map(path: &Path, location: &str) -> Result<(GlobalMap, MapReport)> {
    let bytes = std::fs::read(path).map_err(|e| NuscenesError::from_io(path, "map expansion", e))?;
    parse_map(&bytes, path, location)
}

pub(crate) fn parse_map(bytes: &[u8], path: &Path, location: &str) -> Result<(GlobalMap, MapReport)> {
    // serde would take an array as a map without layers
    if let Some(at) = bytes.iter().position(|b| !b.is_ascii_whitespace()).filter(|at| bytes[*at] != b'{') {
        let message = format!("found {:?}, expected an object of layers", bytes[at] as char);
        return Err(NuscenesError::Json { path: path.to_owned(), offset: at as u64, message });
    }
    let rows: MapRows = serde_json::from_slice(bytes).map_err(|e| {
        let lines = bytes.split_inclusive(|b| *b == b'\n').take(e.line().saturating_sub(1));
        let offset = (lines.map(<[u8]>::len).sum::<usize>() + e.column()) as u64;
        NuscenesError::Json { path: path.to_owned(), offset, message: e.to_string() }
    })?;
    let assembler = Assembler::new(path, &rows)?;
    let mut report = MapReport { location: location.to_owned(), ..MapReport::default() };
    let map = GlobalMap {
        drivable_area: assembler.drivable_area(&rows.drivable_area, &mut report)?,
        ped_crossings: assembler.areas("ped_crossing", &rows.ped_crossing, &mut report)?,
        walkways: assembler.areas("walkway", &rows.walkway, &mut report)?,
        stop_lines: assembler.areas("stop_line", &rows.stop_line, &mut report)?,
        carpark_areas: assembler.areas("carpark_area", &rows.carpark_area, &mut report)?,
        road_dividers: assembler.dividers("road_divider", &rows.road_divider, &mut report)?,
        lane_dividers: assembler.dividers("lane_divider", &rows.lane_divider, &mut report)?,
        lanes: assembler.lanes(&rows, &mut report)?,
    };
    report.layers = [
        ("drivable_area", map.drivable_area.len()),
        ("lanes", map.lanes.len()),
        ("road_dividers", map.road_dividers.len()),
        ("lane_dividers", map.lane_dividers.len()),
        ("ped_crossings", map.ped_crossings.len()),
        ("walkways", map.walkways.len()),
        ("stop_lines", map.stop_lines.len()),
        ("carpark_areas", map.carpark_areas.len()),
    ]
    .map(|(name, count)| (name.to_owned(), count))
    .into();
    Ok((map, report))
}

/// Resolves tokens to geometry.
struct Assembler<'a> {
    path: &'a Path,
    nodes: Vec<(Token, [f64; 2])>,
    polygons: Vec<(Token, &'a PolygonRow)>,
    lines: Vec<(Token, &'a LineRow)>,
}

fn note(report: &mut MapReport, count: usize, words: &str) {
    if count > 0 {
        report.notes.push(format!("{count} {words}"));
    }
}

impl<'a> Assembler<'a> {
    fn new(path: &'a Path, rows: &'a MapRows) -> Result<Self> {
        if let Some(bad) = rows.node.iter().find(|n| !(n.x.abs() < 1e6 && n.y.abs() < 1e6)) {
            return Err(NuscenesError::Value {
                path: path.to_owned(),
                token: bad.token.to_string(),
                field: "node x, y",
                got: format!("{:?}, {:?}", bad.x, bad.y),
                expected: "metres within 1000 km",
            });
        }
        let mut nodes: Vec<_> = rows.node.iter().map(|n| (n.token, [n.x, n.y])).collect();
        nodes.sort_unstable_by_key(|(token, _)| *token);
        let mut polygons: Vec<_> = rows.polygon.iter().map(|p| (p.token, p)).collect();
        polygons.sort_unstable_by_key(|(token, _)| *token);
        let mut lines: Vec<_> = rows.line.iter().map(|l| (l.token, l)).collect();
        lines.sort_unstable_by_key(|(token, _)| *token);
        Ok(Self { path, nodes, polygons, lines })
    }

    fn dangling(
        &self,
        token: impl ToString,
        field: &'static str,
        got: Token,
        table: &'static str,
    ) -> NuscenesError {
        let (path, token, got) = (self.path.to_owned(), token.to_string(), got.to_string());
        NuscenesError::Dangling { path, token, field, got, table }
    }

    fn points(&self, owner: Token, tokens: &[Token]) -> Result<Vec<[f64; 2]>> {
        let mut points: Vec<[f64; 2]> = Vec::with_capacity(tokens.len());
        for token in tokens {
            let at = self.nodes.binary_search_by_key(token, |(t, _)| *t);
            let point = at.map_err(|_| self.dangling(owner, "node_tokens", *token, "node"))?;
            points.push(self.nodes[point].1);
        }
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

    /// The polygon of a token; `None` where it has fewer than three corners.
    fn polygon(&self, owner: &str, token: Token) -> Result<Option<GlobalPolygon>> {
        let at = self.polygons.binary_search_by_key(&token, |(t, _)| *t);
        let row = at.map_err(|_| self.dangling(owner, "polygon_token", token, "polygon"))?;
        let row = self.polygons[row].1;
        let exterior = self.ring(token, &row.exterior_node_tokens)?;
        if exterior.len() < 3 {
            return Ok(None);
        }
        let mut holes = Vec::new();
        for hole in &row.holes {
            let ring = self.ring(token, &hole.node_tokens)?;
            if ring.len() >= 3 {
                holes.push(ring);
            }
        }
        Ok(Some(GlobalPolygon { bounds: Bounds::of(&exterior), exterior, holes }))
    }

    fn drivable_area(&self, rows: &[AreasRow], report: &mut MapReport) -> Result<Vec<GlobalPolygon>> {
        let mut polygons = Vec::new();
        let mut flat = 0;
        for row in rows {
            for token in &row.polygon_tokens {
                match self.polygon(&row.token, *token)? {
                    Some(polygon) => polygons.push(polygon),
                    None => flat += 1,
                }
            }
        }
        note(report, flat, "drivable_area polygons with fewer than three corners left out");
        Ok(polygons)
    }

    fn areas(&self, layer: &str, rows: &[AreaRow], report: &mut MapReport) -> Result<Vec<GlobalPolygon>> {
        let mut polygons = Vec::new();
        for row in rows {
            if let Some(token) = row.polygon_token {
                polygons.extend(self.polygon(&row.token, token)?);
            }
        }
        note(report, rows.len() - polygons.len(), &format!("{layer} records without an area left out"));
        Ok(polygons)
    }

    fn dividers(&self, layer: &str, rows: &[DividerRow], report: &mut MapReport) -> Result<Vec<GlobalLine>> {
        let mut lines = Vec::new();
        for row in rows {
            let at = self.lines.binary_search_by_key(&row.line_token, |(t, _)| *t);
            let line = at.map_err(|_| self.dangling(&row.token, "line_token", row.line_token, "line"))?;
            let points = self.points(row.line_token, &self.lines[line].1.node_tokens)?;
            if points.len() >= 2 {
                lines.push(GlobalLine { bounds: Bounds::of(&points), points });
            }
        }
        note(report, rows.len() - lines.len(), &format!("{layer} records of fewer than two points left out"));
        Ok(lines)
    }

    fn lanes(&self, rows: &MapRows, report: &mut MapReport) -> Result<Vec<GlobalLane>> {
        let mut lanes = Vec::new();
        let mut index: BTreeMap<&str, u32> = BTreeMap::new();
        let (mut without_path, mut without_area) = (0, 0);
        let both = rows.lane.iter().map(|r| (r, LaneKind::Lane));
        for (row, kind) in both.chain(rows.lane_connector.iter().map(|r| (r, LaneKind::Connector))) {
            let paths = rows.arcline_path_3.get(&row.token).map_or(&[][..], Vec::as_slice);
            let centreline = discretise(paths, CENTRELINE_SPACING_M).map_err(|fault| {
                let (path, token) = (self.path.to_owned(), row.token.clone());
                let (field, got, expected) = (fault.field, fault.got, fault.expected);
                NuscenesError::Value { path, token, field, got, expected }
            })?;
            if centreline.is_empty() {
                without_path += 1;
                continue;
            }
            let polygon = match row.polygon_token {
                Some(token) => self.polygon(&row.token, token)?,
                None => None,
            };
            without_area += usize::from(polygon.is_none());
            if index.insert(&row.token, lanes.len() as u32).is_some() {
                let (path, got) = (self.path.to_owned(), row.token.clone());
                return Err(NuscenesError::Duplicate { path, what: "lane token", got });
            }
            let bounds = Bounds::of(centreline.iter().chain(polygon.iter().flat_map(|p| &p.exterior)));
            lanes.push(GlobalLane {
                id: row.token.clone(),
                kind,
                centreline,
                polygon,
                successors: Vec::new(),
                predecessors: Vec::new(),
                bounds,
            });
        }
        note(report, without_path, "lanes without a centre line left out");
        note(report, without_area, "lanes without a polygon");
        note(
            report,
            link(&mut lanes, &index, &rows.connectivity),
            "links to lanes that are not there left out",
        );
        Ok(lanes)
    }
}

/// Links lanes both ways, whichever side names the link; returns how many links lead nowhere.
fn link(
    lanes: &mut [GlobalLane],
    index: &BTreeMap<&str, u32>,
    connectivity: &BTreeMap<String, Links>,
) -> usize {
    let mut lost = 0;
    let mut edges = Vec::new();
    for (token, links) in connectivity {
        let outgoing = links.outgoing.iter().map(|to| (token, to));
        for (from, to) in outgoing.chain(links.incoming.iter().map(|from| (from, token))) {
            match (index.get(from.as_str()), index.get(to.as_str())) {
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
