//! A map expansion file (version 1.3) of one location, parsed once and shared by all its scenes.

use crate::arcline::{ArcLinePath, discretise};
use crate::error::{NuscenesError, Result};
use crate::file;
use crate::index::TokenIndex;
use crate::record::{Record, Source, Text, elements, members, parse, token};
use crate::report::{MapReport, layer_counts};
use crate::stream::BYTE_ORDER_MARK;
use crate::token::Token;
use ccdiff_sim::scene::LaneKind;
use rayon::prelude::*;
use serde::Deserialize;
use std::collections::BTreeMap;
use std::fmt::Display;
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

/// Reads the map of a location.
///
/// # Errors
/// Unreadable files, invalid JSON, references to nodes, polygons or lines that do not exist, damaged centre lines.
pub(crate) fn read_map(path: &Path, location: &str) -> Result<(GlobalMap, MapReport)> {
    let bytes = file::read(path).map_err(|e| NuscenesError::from_io(path, "map expansion", e))?;
    let file = MapText::new(&bytes, path)?;
    let assembler = Assembler::new(&file, path)?;
    let mut report = MapReport { location: location.to_owned(), ..MapReport::default() };
    let lanes = assembler.lanes(&mut report)?;
    let map = GlobalMap {
        drivable_area: assembler.drivable_area(&mut report)?,
        ped_crossings: assembler.areas("ped_crossing", &mut report)?,
        walkways: assembler.areas("walkway", &mut report)?,
        stop_lines: assembler.areas("stop_line", &mut report)?,
        carpark_areas: assembler.areas("carpark_area", &mut report)?,
        road_dividers: assembler.dividers("road_divider", &mut report)?,
        lane_dividers: assembler.dividers("lane_divider", &mut report)?,
        lane_bounds: lanes.iter().map(GlobalLane::bounds).collect(),
        lanes,
    };
    report.layers = layer_counts!(map);
    Ok((map, report))
}

/// The layers of a map file as they are written.
struct MapText<'a> {
    layers: BTreeMap<String, Text<'a>>,
}

impl<'a> MapText<'a> {
    fn new(bytes: &'a [u8], path: &'a Path) -> Result<Self> {
        let text = bytes.strip_prefix(BYTE_ORDER_MARK).unwrap_or(bytes);
        let source = Source { path, offset: (bytes.len() - text.len()) as u64 };
        Ok(Self { layers: members((text, source))? })
    }

    /// The records of a layer made into something, in parallel; nothing where there is no such layer.
    fn rows<T, F, const N: usize>(
        &self,
        layer: &str,
        names: &'static [&'static str; N],
        make: F,
    ) -> Result<Vec<T>>
    where
        T: Send,
        F: Fn(&Record<'a, N>) -> Result<T> + Sync,
    {
        let Some(layer) = self.layers.get(layer) else { return Ok(Vec::new()) };
        let parse = |(text, source): Text<'a>| make(&Record::new(text, names, source)?);
        elements(*layer)?.into_par_iter().with_min_len(256).map(parse).collect()
    }

    /// The members of a layer that is an object by token.
    fn by_token(&self, layer: &str) -> Result<BTreeMap<String, Text<'a>>> {
        self.layers.get(layer).map_or(Ok(BTreeMap::new()), |layer| members(*layer))
    }
}

/// The paths of a lane.
fn arcline_paths(paths: Text<'_>) -> Result<Vec<ArcLinePath>> {
    let path = |(text, source)| {
        let row = Record::new(text, &["start_pose", "shape", "radius", "segment_length"], source)?;
        Ok(ArcLinePath {
            start_pose: row.parse(0)?,
            shape: row.text(1)?,
            radius: row.parse(2)?,
            segment_length: row.parse(3)?,
        })
    };
    elements(paths)?.into_iter().map(path).collect()
}

/// Resolves tokens to geometry.
struct Assembler<'a> {
    file: &'a MapText<'a>,
    path: &'a Path,
    nodes: TokenIndex<[f64; 2]>,
    /// Outer ring and, where there are any, holes, as they are written.
    polygons: TokenIndex<(Text<'a>, Option<Text<'a>>)>,
    /// Node lists as they are written.
    lines: TokenIndex<Text<'a>>,
}

fn note(report: &mut MapReport, count: usize, words: &str) {
    if count > 0 {
        report.notes.push(format!("{count} {words}"));
    }
}

impl<'a> Assembler<'a> {
    fn new(file: &'a MapText<'a>, path: &'a Path) -> Result<Self> {
        let nodes = file.rows("node", &["token", "x", "y"], |row| {
            let (token, x, y) = (row.token(0)?, row.parse::<f64>(1)?, row.parse::<f64>(2)?);
            if x.abs() < 1e6 && y.abs() < 1e6 {
                return Ok((token, [x, y]));
            }
            let got = format!("{x:?}, {y:?}");
            Err(NuscenesError::value(path, token, "node x, y", got, "metres within 1000 km"))
        })?;
        let polygons = file.rows("polygon", &["token", "exterior_node_tokens", "holes"], |row| {
            let holes = if row.has(2) { Some(row.raw(2)?) } else { None };
            Ok((row.token(0)?, (row.raw(1)?, holes)))
        })?;
        let lines = file.rows("line", &["token", "node_tokens"], |row| Ok((row.token(0)?, row.raw(1)?)))?;
        let twice = |what| move |token: Token| NuscenesError::duplicate(path, what, token);
        Ok(Self {
            file,
            path,
            nodes: TokenIndex::new(nodes).map_err(twice("node token"))?,
            polygons: TokenIndex::new(polygons).map_err(twice("polygon token"))?,
            lines: TokenIndex::new(lines).map_err(twice("line token"))?,
        })
    }

    fn dangling(&self, token: impl Display, field: &str, got: Token, table: &str) -> NuscenesError {
        NuscenesError::dangling(self.path, token, field, got, table)
    }

    /// The points of a list of node tokens, without repetitions.
    fn points(&self, owner: Token, list: Text<'a>) -> Result<Vec<[f64; 2]>> {
        let tokens = elements(list)?;
        let mut points: Vec<[f64; 2]> = Vec::with_capacity(tokens.len());
        let mut next = 0;
        for text in tokens {
            let token = token(text)?;
            let point = self.nodes.get_from(&mut next, token);
            points.push(*point.ok_or_else(|| self.dangling(owner, "node_tokens", token, "node"))?);
        }
        points.dedup();
        Ok(points)
    }

    /// A ring without its closing point.
    fn ring(&self, owner: Token, text: Text<'a>) -> Result<Vec<[f64; 2]>> {
        let mut ring = self.points(owner, text)?;
        if ring.len() > 1 && ring.first() == ring.last() {
            ring.pop();
        }
        Ok(ring)
    }

    /// The polygon of a token; `None` where it has fewer than three corners.
    fn polygon(&self, owner: &str, token: Token) -> Result<Option<GlobalPolygon>> {
        let found = self.polygons.get(token);
        let (exterior, holes) =
            *found.ok_or_else(|| self.dangling(owner, "polygon_token", token, "polygon"))?;
        let exterior = self.ring(token, exterior)?;
        if exterior.len() < 3 {
            return Ok(None);
        }
        let mut rings = Vec::new();
        for (text, source) in holes.map_or(Ok(Vec::new()), elements)? {
            rings.push(self.ring(token, Record::new(text, &["node_tokens"], source)?.raw(0)?)?);
        }
        rings.retain(|ring| ring.len() >= 3);
        let holes = rings.into_iter().map(GlobalLine::new).collect();
        Ok(Some(GlobalPolygon { bounds: Bounds::of(&exterior), exterior, holes }))
    }

    fn drivable_area(&self, report: &mut MapReport) -> Result<Vec<GlobalPolygon>> {
        let areas = self
            .file
            .rows("drivable_area", &["token", "polygon_tokens"], |row| Ok((row.text(0)?, row.raw(1)?)))?;
        let mut polygons = Vec::new();
        let mut flat = 0;
        for (owner, tokens) in areas {
            let made: Vec<Option<GlobalPolygon>> = elements(tokens)?
                .into_par_iter()
                .map(|token| self.polygon(&owner, Token::from_text(&parse::<String>(token)?)))
                .collect::<Result<_>>()?;
            flat += made.iter().filter(|p| p.is_none()).count();
            polygons.extend(made.into_iter().flatten());
        }
        note(report, flat, "drivable_area polygons with fewer than three corners left out");
        Ok(polygons)
    }

    fn areas(&self, layer: &str, report: &mut MapReport) -> Result<Vec<GlobalPolygon>> {
        let rows = self.file.rows(layer, &["token", "polygon_token"], |row| {
            if row.has(1) { self.polygon(&row.text(0)?, row.token(1)?) } else { Ok(None) }
        })?;
        let flat = rows.iter().filter(|p| p.is_none()).count();
        note(report, flat, &format!("{layer} records without an area left out"));
        Ok(rows.into_iter().flatten().collect())
    }

    fn dividers(&self, layer: &str, report: &mut MapReport) -> Result<Vec<GlobalLine>> {
        let mut lines = self.file.rows(layer, &["token", "line_token"], |row| {
            let token = row.token(1)?;
            let nodes = self.lines.get(token);
            let nodes = nodes
                .ok_or_else(|| self.dangling(row.text(0).unwrap_or_default(), "line_token", token, "line"))?;
            let points = self.points(token, *nodes)?;
            Ok(GlobalLine::new(points))
        })?;
        let before = lines.len();
        lines.retain(|line| line.points.len() >= 2);
        note(report, before - lines.len(), &format!("{layer} records of fewer than two points left out"));
        Ok(lines)
    }

    /// A lane without links; no centre line where the data has none.
    fn lane(
        &self,
        row: &Record<'a, 2>,
        kind: LaneKind,
        paths: &BTreeMap<String, Text<'a>>,
    ) -> Result<GlobalLane> {
        let id = row.text(0)?;
        let paths = paths.get(&id).map_or(Ok(Vec::new()), |text| arcline_paths(*text))?;
        let centreline = discretise(&paths, CENTRELINE_SPACING_M)
            .map_err(|fault| NuscenesError::value(self.path, &id, fault.field, fault.got, fault.expected))?;
        let polygon = if row.has(1) { self.polygon(&id, row.token(1)?)? } else { None };
        let (successors, predecessors) = (Vec::new(), Vec::new());
        Ok(GlobalLane { id, kind, centreline, polygon, successors, predecessors })
    }

    fn lanes(&self, report: &mut MapReport) -> Result<Vec<GlobalLane>> {
        let paths = self.file.by_token("arcline_path_3")?;
        let mut lanes = Vec::new();
        for (layer, kind) in [("lane", LaneKind::Lane), ("lane_connector", LaneKind::Connector)] {
            let names = &["token", "polygon_token"];
            lanes.extend(self.file.rows(layer, names, |row| self.lane(row, kind, &paths))?);
        }
        let before = lanes.len();
        lanes.retain(|lane| !lane.centreline.is_empty());
        note(report, before - lanes.len(), "lanes without a centre line left out");
        let without_area = lanes.iter().filter(|lane| lane.polygon.is_none()).count();
        note(report, without_area, "lanes without a polygon");
        let mut index: BTreeMap<String, u32> = BTreeMap::new();
        for (i, lane) in lanes.iter().enumerate() {
            if index.insert(lane.id.clone(), i as u32).is_some() {
                return Err(NuscenesError::duplicate(self.path, "lane token", &lane.id));
            }
        }
        let lost = link(&mut lanes, &index, &self.links()?);
        note(report, lost, "links to lanes that are not there left out");
        Ok(lanes)
    }

    fn links(&self) -> Result<BTreeMap<String, Links>> {
        self.file.layers.get("connectivity").map_or(Ok(BTreeMap::new()), |text| parse(*text))
    }
}

/// Neighbours of a lane in the file.
#[derive(Deserialize, Default)]
struct Links {
    #[serde(default)]
    incoming: Vec<String>,
    #[serde(default)]
    outgoing: Vec<String>,
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
