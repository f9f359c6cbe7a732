//! Every colour of the images, in one place; they are the replay page's, on light and on dark ground.
//!
//! Agents are coloured by their drivers: CCDiff and networks by greens, attackers alone by orange.
//! Red is kept for collisions and for red lights, which are the widest; kinds of agents differ by
//! shape (box with a windscreen, slim box, disc, plain box), so that no meaning hangs on hue alone.

/// Red, green, blue, 0 to 255.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Rgb(pub u8, pub u8, pub u8);

/// The driver of an agent.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
#[repr(u8)]
pub enum DrawStyle {
    /// The ego, whatever drives it.
    Ego = 0,
    /// An agent other than the ego that takes actions from outside.
    External = 1,
    /// CCDiff.
    Ccdiff = 2,
    /// CCDiff guided towards a collision or near miss.
    Adversary = 3,
    /// The intelligent driver model.
    Idm = 4,
    /// The logged track.
    Replay = 5,
    /// Constant velocity.
    ConstantVelocity = 6,
    /// Any other model.
    Other = 7,
    /// A network other than those that denoise as CCDiff does.
    Network = 8,
}

impl DrawStyle {
    /// All drivers, in the order of their numbers.
    pub const ALL: [Self; 9] = [
        Self::Ego,
        Self::External,
        Self::Ccdiff,
        Self::Adversary,
        Self::Idm,
        Self::Replay,
        Self::ConstantVelocity,
        Self::Other,
        Self::Network,
    ];

    /// The name used in Python and in legends.
    pub fn name(self) -> &'static str {
        STYLES[self as usize].0
    }

    /// What it is called in words.
    pub fn title(self) -> &'static str {
        STYLES[self as usize].1
    }

    /// The driver of a number, as [`DrawStyle::ALL`] counts them.
    pub fn from_number(number: u8) -> Option<Self> {
        Self::ALL.get(usize::from(number)).copied()
    }

    /// Fill colour of the agents it drives.
    pub fn colour(self, theme: Theme) -> Rgb {
        let (_, _, light, dark) = STYLES[self as usize];
        match theme {
            Theme::Light => light,
            Theme::Dark => dark,
        }
    }
}

/// Name, title and colours on light and on dark ground of each, by number. Who sees no red or no
/// green tells any two apart: `tests/test_palette.py` measures it.
const STYLES: [(&str, &str, Rgb, Rgb); 9] = [
    ("ego", "ego", Rgb(0x06, 0x54, 0xB2), Rgb(0x3D, 0x89, 0xE3)),
    ("external", "policy", Rgb(0x4F, 0xB3, 0xE8), Rgb(0x94, 0xD7, 0xFF)),
    ("ccdiff", "CCDiff", Rgb(0x22, 0xA5, 0x76), Rgb(0x19, 0xBD, 0x8B)),
    ("adversary", "guided", Rgb(0xE6, 0x8A, 0x00), Rgb(0xF0, 0x9A, 0x18)),
    ("idm", "IDM", Rgb(0x94, 0x75, 0x00), Rgb(0xF5, 0xDF, 0x47)),
    ("replay", "log", Rgb(0x91, 0x96, 0xA0), Rgb(0xA1, 0xAB, 0xB3)),
    ("constant_velocity", "constant velocity", Rgb(0xAB, 0x46, 0x8B), Rgb(0xC1, 0x63, 0xA8)),
    ("other", "another model", Rgb(0x8F, 0x6A, 0xE6), Rgb(0xB8, 0xA7, 0xFF)),
    ("network", "network", Rgb(0x01, 0x53, 0x3D), Rgb(0x14, 0x7F, 0x72)),
];

/// Ground that images are drawn on.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Theme {
    /// Light ground.
    #[default]
    Light,
    /// Dark ground.
    Dark,
}

impl Theme {
    /// All themes.
    pub const ALL: [Self; 2] = [Self::Light, Self::Dark];

    /// The name used in Python and by the replay page.
    pub fn name(self) -> &'static str {
        match self {
            Self::Light => "light",
            Self::Dark => "dark",
        }
    }

    /// The colours of the map and the marks.
    pub fn palette(self) -> &'static Palette {
        match self {
            Self::Light => &LIGHT,
            Self::Dark => &DARK,
        }
    }
}

macro_rules! palette {
    ($($(#[$doc:meta])+ $field:ident $name:literal: $light:expr, $dark:expr;)+) => {
        /// Colours of the map and the marks on one ground.
        #[derive(Debug, Clone, Copy, PartialEq, Eq)]
        pub struct Palette {
            $($(#[$doc])+ pub $field: Rgb,)+
        }

        /// On light ground.
        pub const LIGHT: Palette = Palette { $($field: $light),+ };

        /// On dark ground.
        pub const DARK: Palette = Palette { $($field: $dark),+ };

        /// Names and colours of everything in an image, for documentation: drivers first, then the map and the marks.
        pub fn legend(theme: Theme) -> Vec<(&'static str, Rgb)> {
            let (palette, drivers) = (theme.palette(), DrawStyle::ALL.iter());
            let rest = [$(($name, palette.$field)),+];
            drivers.map(|d| (d.name(), d.colour(theme))).chain(rest).collect()
        }
    };
}

palette! {
    /// Obstacles that never move.
    obstacle "static obstacle": Rgb(0x76, 0x68, 0x69), Rgb(0x7F, 0x6D, 0x50);
    /// Collisions: outline of agents and marks.
    collision "collision": Rgb(0xD6, 0x1F, 0x2C), Rgb(0xFF, 0x5A, 0x5F);
    /// An ego that has reached its goal.
    goal "goal": Rgb(0x00, 0x78, 0x5A), Rgb(0x3E, 0xCF, 0xA8);
    /// Arrows of the causal graph, on the replay page.
    arrow "causal arrow": Rgb(0x6A, 0x32, 0x9F), Rgb(0xC7, 0x9B, 0xF2);
    /// Ground that is no layer of the map.
    ground "ground": Rgb(0xEE, 0xF0, 0xEC), Rgb(0x11, 0x15, 0x1A);
    /// Drivable area.
    drivable "drivable area": Rgb(0xD3, 0xD7, 0xDD), Rgb(0x2F, 0x37, 0x43);
    /// Edge of the drivable area.
    kerb "kerb": Rgb(0xA9, 0xB0, 0xBA), Rgb(0x56, 0x62, 0x71);
    /// Walkways.
    walkway "walkway": Rgb(0xE3, 0xDD, 0xD0), Rgb(0x21, 0x27, 0x2E);
    /// Car parks.
    carpark "car park": Rgb(0xC8, 0xCE, 0xD6), Rgb(0x28, 0x30, 0x3A);
    /// Stripes of pedestrian crossings.
    stripe "crossing": Rgb(0xF7, 0xF8, 0xFA), Rgb(0x5D, 0x69, 0x79);
    /// Stop areas.
    stop "stop area": Rgb(0xD5, 0x9C, 0x8F), Rgb(0x7D, 0x4A, 0x42);
    /// Stop lines of lights that are red.
    red_light "red light": Rgb(0xE0, 0x3A, 0x2E), Rgb(0xF0, 0x5A, 0x4A);
    /// Of those that are yellow.
    yellow_light "yellow light": Rgb(0xF2, 0xA9, 0x00), Rgb(0xF5, 0xC2, 0x42);
    /// Of those that are green.
    green_light "green light": Rgb(0x1E, 0xA3, 0x4A), Rgb(0x4C, 0xC9, 0x74);
    /// Centre lines of lanes and connectors.
    centre_line "centre line": Rgb(0x8F, 0x98, 0xA4), Rgb(0x4B, 0x57, 0x66);
    /// Lines between lanes of one direction.
    lane_divider "lane divider": Rgb(0x6D, 0x76, 0x82), Rgb(0x8B, 0x97, 0xA6);
    /// Lines between directions of traffic.
    road_divider "road divider": Rgb(0x96, 0x65, 0x0A), Rgb(0xB9, 0x8A, 0x26);
    /// Text.
    ink "ink": Rgb(0x1D, 0x24, 0x2C), Rgb(0xE8, 0xED, 0xF3);
    /// Panels behind text, and what keeps names apart from what is below.
    paper "paper": Rgb(0xFF, 0xFF, 0xFF), Rgb(0x0D, 0x11, 0x16);
    /// Outlines and windscreens of agents.
    outline "outline": Rgb(0x1D, 0x24, 0x2C), Rgb(0x0D, 0x11, 0x16);
}
