//! Writes docs/observation.md from the layout.

use ccdiff_sim::observe::{Layout, ObservationConfig};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let layout = Layout::new(&ObservationConfig::default())?;
    std::fs::write(concat!(env!("CARGO_MANIFEST_DIR"), "/../../docs/observation.md"), layout.to_markdown())?;
    Ok(())
}
