//! What there is to know of a kind of driver, in one value that everything else reads.

use super::TrafficPolicy;
use crate::error::Result;
use crate::options::Table;

/// Makes a policy from its options as JSON, which stand at a path.
pub type Make = fn(path: &str, options: &str) -> Result<Box<dyn TrafficPolicy>>;

/// A kind of driver: its file declares one, a list names it, and configurations, images, tables and help texts read it.
#[derive(Debug, Clone, Copy)]
pub struct Kind {
    /// Name in configurations.
    pub name: &'static str,
    /// Name in legends and tables.
    pub title: &'static str,
    /// Whose colour it has in images: a driver that images tell apart, or `"other"`.
    pub style: &'static str,
    /// Its options; `None`: it takes none.
    pub options: Option<&'static Table>,
    /// Whether every batch has it under this name; others are made where somebody drives by them.
    pub always: bool,
    /// How it is made; `None`: not from options alone.
    pub make: Option<Make>,
}
