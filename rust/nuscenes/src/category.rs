//! Categories of nuScenes as kinds of agents.

use ccdiff_sim::scene::AgentKind;

/// The kind of a nuScenes category; `None` for one that is not known.
///
/// Bicycles and motorcycles stand apart from other vehicles (reference.md#agents); animals move like pedestrians.
pub fn kind_of_category(category: &str) -> Option<AgentKind> {
    match category {
        "vehicle.bicycle" => return Some(AgentKind::Cyclist),
        "vehicle.motorcycle" => return Some(AgentKind::Motorcycle),
        _ => {}
    }
    match category.split('.').next()? {
        "vehicle" => Some(AgentKind::Vehicle),
        "human" | "animal" => Some(AgentKind::Pedestrian),
        "movable_object" | "static_object" => Some(AgentKind::Static),
        _ => None,
    }
}
