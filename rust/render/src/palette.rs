//! Every colour of the images, in one place; those of the map are the replay page's (`ground.js`, light).
//!
//! Agents are coloured by who drives them. The hues follow the colour-blind safe set of Okabe and Ito (2008),
//! darkened or lightened to stand out on a light map; red is kept for collisions, and kinds of agents differ by
//! shape (box, slim box, disc, crossed box), so that no meaning hangs on hue alone.

/// Red, green, blue, 0 to 255.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Rgb(pub u8, pub u8, pub u8);

/// Who moves an agent.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
#[repr(u8)]
pub enum DrawStyle {
    /// The ego, whoever drives it.
    Ego = 0,
    /// An agent other than the ego that takes actions from outside.
    External = 1,
    /// The CCDiff policy.
    Ccdiff = 2,
    /// The CCDiff policy guided towards a collision or near miss.
    Adversary = 3,
    /// The intelligent driver model.
    Idm = 4,
    /// The logged track.
    Replay = 5,
    /// Constant velocity.
    ConstantVelocity = 6,
    /// Any other model.
    Other = 7,
}

impl DrawStyle {
    /// All drivers, in the order of their numbers.
    pub const ALL: [Self; 8] = [
        Self::Ego,
        Self::External,
        Self::Ccdiff,
        Self::Adversary,
        Self::Idm,
        Self::Replay,
        Self::ConstantVelocity,
        Self::Other,
    ];

    /// The name used in Python and in legends.
    pub fn name(self) -> &'static str {
        ["ego", "external", "ccdiff", "adversary", "idm", "replay", "constant_velocity", "other"]
            [self as usize]
    }

    /// What it is called in words.
    pub fn title(self) -> &'static str {
        let titles =
            ["ego", "policy", "CCDiff", "guided", "IDM", "log", "constant velocity", "another model"];
        titles[self as usize]
    }

    /// The driver of a number, as [`DrawStyle::ALL`] counts them.
    pub fn from_number(number: u8) -> Option<Self> {
        Self::ALL.get(usize::from(number)).copied()
    }

    /// Fill colour of the agents it drives.
    pub fn colour(self) -> Rgb {
        match self {
            Self::Ego => Rgb(0x00, 0x57, 0xB8),
            Self::External => Rgb(0x4F, 0xB3, 0xE8),
            Self::Ccdiff => Rgb(0x00, 0x9E, 0x73),
            Self::Adversary => Rgb(0xE6, 0x8A, 0x00),
            Self::Idm => Rgb(0xEB, 0xD5, 0x3A),
            Self::Replay => Rgb(0x8C, 0x96, 0xA3),
            Self::ConstantVelocity => Rgb(0xC2, 0x6F, 0xA4),
            Self::Other => Rgb(0x7D, 0x6F, 0xD0),
        }
    }
}

/// Ground that is no layer of the map.
pub const GROUND: Rgb = Rgb(0xEE, 0xF0, 0xEC);
/// Drivable area.
pub const DRIVABLE: Rgb = Rgb(0xD3, 0xD7, 0xDD);
/// Edge of the drivable area.
pub const KERB: Rgb = Rgb(0xA9, 0xB0, 0xBA);
/// Walkways.
pub const WALKWAY: Rgb = Rgb(0xE3, 0xDD, 0xD0);
/// Car parks.
pub const CARPARK: Rgb = Rgb(0xC8, 0xCE, 0xD6);
/// Ground of pedestrian crossings.
pub const CROSSING: Rgb = Rgb(0xD2, 0xD6, 0xDB);
/// Stripes of pedestrian crossings.
pub const STRIPE: Rgb = Rgb(0xF7, 0xF8, 0xFA);
/// Stop areas.
pub const STOP: Rgb = Rgb(0xD5, 0x9C, 0x8F);
/// Centre lines of lanes and connectors.
pub const CENTRE_LINE: Rgb = Rgb(0x8F, 0x98, 0xA4);
/// Lines between lanes of one direction.
pub const LANE_DIVIDER: Rgb = Rgb(0x6D, 0x76, 0x82);
/// Lines between directions of traffic.
pub const ROAD_DIVIDER: Rgb = Rgb(0x96, 0x65, 0x0A);
/// Obstacles that never move.
pub const STATIC: Rgb = Rgb(0x8A, 0x76, 0x63);
/// Collisions: outline of agents and marks.
pub const COLLISION: Rgb = Rgb(0xD6, 0x1F, 0x2C);
/// Arrows of the causal graph.
pub const ARROW: Rgb = Rgb(0x5A, 0x2D, 0x82);
/// Outlines and text.
pub const INK: Rgb = Rgb(0x25, 0x2B, 0x33);
/// Halo round the ego, heading notches, panels behind text.
pub const PAPER: Rgb = Rgb(0xFF, 0xFF, 0xFF);

/// Names and colours of everything in an image, for documentation: drivers first, then the map and the marks.
pub fn legend() -> Vec<(&'static str, Rgb)> {
    let drivers = DrawStyle::ALL.iter().map(|d| (d.name(), d.colour()));
    let rest = [
        ("static obstacle", STATIC),
        ("collision", COLLISION),
        ("causal arrow", ARROW),
        ("ground", GROUND),
        ("drivable area", DRIVABLE),
        ("walkway", WALKWAY),
        ("car park", CARPARK),
        ("crossing", STRIPE),
        ("stop area", STOP),
        ("centre line", CENTRE_LINE),
        ("lane divider", LANE_DIVIDER),
        ("road divider", ROAD_DIVIDER),
    ];
    drivers.chain(rest).collect()
}
