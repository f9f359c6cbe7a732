//! The schema of an observation row.

use super::bev::{BevChannel, BevConfig};
use super::column::ObservationColumn;
use super::columns::{self, AGENTS, EGO, MAP, ROUTE};
use super::map_segments::MAX_SEGMENTS;
use crate::error::{Result, SimError};
use crate::geom::Real;
use crate::options;
use crate::options::within;
use serde::Serialize;

options! {
    /// Choice of rows and columns of the observation.
    #[derive(Clone)]
    #[serde(deny_unknown_fields, default)]
    pub struct ObservationConfig {
        /// Nearest agents that are seen, K rows.
        num_neighbors: usize = 12, range within(0.0, 512.0);
        /// Points of the route ahead, P rows.
        num_route_points: usize = 10, range within(0.0, 256.0);
        /// Distance from one route point to the next.
        route_spacing_m: Real = 4.0, unit "m", range within(0.0, 1000.0).open_below();
        /// Nearest segments of map lines, N rows; egos learn faster without.
        num_map_segments: usize = 0, range within(0.0, MAX_SEGMENTS as f64);
        /// Agents farther than this are not seen.
        radius_m: Real = 60.0, unit "m", range within(0.0, 1000.0).open_below();
        /// Whether masks are part of the row.
        masks: bool = true;
        /// Columns of `ego`; `None`, or `"default"` in the list: all but those on request.
        ego_columns: Option<Vec<String>> = None;
        /// Columns of `agents`, in the same way.
        agent_columns: Option<Vec<String>> = None;
        /// Columns of `map`, in the same way.
        map_columns: Option<Vec<String>> = None;
        /// Bird's-eye raster beside the row; `None`: none.
        bev: Option<BevConfig> = None;
    }
}

/// Whether an entry holds quantities or tells which rows are there.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum EntryKind {
    /// Scaled quantities.
    Values,
    /// 1 where the row of the entry before it is there, else 0.
    Mask,
}

/// A part of the row.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Entry {
    /// Key in the dictionary form.
    pub name: &'static str,
    /// Shape in the dictionary form.
    pub shape: Vec<usize>,
    /// First float in the flat row.
    pub offset: usize,
    /// Values or mask.
    pub kind: EntryKind,
    /// Columns, the last axis of values; empty for masks.
    pub columns: Vec<ObservationColumn>,
}

/// The bird's-eye raster beside the row.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Raster {
    /// Channels, rows, columns.
    pub shape: [usize; 3],
    /// The channels.
    pub channels: &'static [BevChannel],
}

/// The schema: entries one after the other, `size` floats in all.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct Layout {
    /// Entries in the order of the row.
    pub entries: Vec<Entry>,
    /// Floats of a row, D.
    pub size: usize,
    /// The raster, where there is one.
    pub bev: Option<Raster>,
    #[serde(skip)]
    pub(crate) config: ObservationConfig,
    /// Chosen columns of `ego`, `agents` and `map` as indices of the full lists.
    #[serde(skip)]
    pub(crate) chosen: [Vec<usize>; 3],
}

/// Stands for all columns but those on request.
const DEFAULT: &str = "default";

fn columns_of<W>(table: &[columns::Entry<W>]) -> Vec<ObservationColumn> {
    table.iter().map(|entry| entry.column.clone()).collect()
}

fn choose(field: &'static str, all: &[ObservationColumn], names: Option<&Vec<String>>) -> Result<Vec<usize>> {
    let usual = || (0..all.len()).filter(|i| all[*i].in_default).collect::<Vec<_>>();
    let Some(names) = names else { return Ok(usual()) };
    let index = |name: &String| {
        if name == DEFAULT {
            return Ok(usual());
        }
        all.iter().position(|c| c.name == name).map(|i| vec![i]).ok_or_else(|| {
            let names: Vec<_> = all.iter().map(|c| c.name).collect();
            SimError::config(field, format!("{name:?}"), format!("some of {names:?}"))
        })
    };
    Ok(names.iter().map(index).collect::<Result<Vec<_>>>()?.concat())
}

impl Layout {
    /// Schema of a configuration.
    ///
    /// # Errors
    /// [`SimError::Config`] for counts, distances and column names out of range.
    pub fn new(config: &ObservationConfig) -> Result<Self> {
        let c = config;
        options::check("observation", config)?;
        let raster = |b: BevConfig| Raster {
            shape: [b.channels().len(), b.size_px, b.size_px],
            channels: b.channels(),
        };
        let [ego, agent, map] = [columns_of(EGO), columns_of(AGENTS), columns_of(MAP)];
        let chosen = [
            choose("observation.ego_columns", &ego, c.ego_columns.as_ref())?,
            choose("observation.agent_columns", &agent, c.agent_columns.as_ref())?,
            choose("observation.map_columns", &map, c.map_columns.as_ref())?,
        ];
        let pick =
            |all: &[ObservationColumn], which: &[usize]| which.iter().map(|i| all[*i].clone()).collect();
        let mut layout = Self {
            entries: Vec::new(),
            size: 0,
            bev: c.bev.map(raster),
            config: config.clone(),
            chosen: chosen.clone(),
        };
        layout.push("ego", None, pick(&ego, &chosen[0]));
        layout.push("route", Some(("route_mask", c.num_route_points)), columns_of(&ROUTE));
        layout.push("agents", Some(("agents_mask", c.num_neighbors)), pick(&agent, &chosen[1]));
        layout.push("map", Some(("map_mask", c.num_map_segments)), pick(&map, &chosen[2]));
        if layout.size == 0 {
            return Err(SimError::config("observation", "nothing", "at least one number"));
        }
        Ok(layout)
    }

    fn push(
        &mut self,
        name: &'static str,
        rows: Option<(&'static str, usize)>,
        columns: Vec<ObservationColumn>,
    ) {
        let width = columns.len();
        let shape = rows.map_or_else(|| vec![width], |(_, n)| vec![n, width]);
        let size: usize = shape.iter().product();
        if size == 0 {
            return;
        }
        self.entries.push(Entry { name, shape, offset: self.size, kind: EntryKind::Values, columns });
        self.size += size;
        if let Some((mask, n)) = rows.filter(|_| self.config.masks) {
            let entry = Entry {
                name: mask,
                shape: vec![n],
                offset: self.size,
                kind: EntryKind::Mask,
                columns: Vec::new(),
            };
            self.entries.push(entry);
            self.size += n;
        }
    }

    /// The schema with the factors of a style after all else, each with its range.
    pub(crate) fn with_style(mut self, ranges: impl Iterator<Item = (&'static str, [Real; 2])>) -> Self {
        let column = |(name, [low, high]): (&'static str, [Real; 2])| ObservationColumn {
            name,
            unit: "",
            scale: 1.0,
            low,
            high,
            doc: "factor of this weight of the reward",
            in_default: false,
        };
        self.push("style", None, ranges.map(column).collect());
        self
    }

    /// The entry of a name.
    pub fn entry(&self, name: &str) -> Option<&Entry> {
        self.entries.iter().find(|e| e.name == name)
    }
}

/// All columns of `ego`, `agents` and `map`, those on request included.
pub fn all_columns() -> [(&'static str, Vec<ObservationColumn>); 3] {
    [("ego", columns_of(EGO)), ("agents", columns_of(AGENTS)), ("map", columns_of(MAP))]
}
