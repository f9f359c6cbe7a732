//! Rows of points on the route ahead.

use super::columns::ROUTE;
use super::frame::Frame;
use super::view::View;
use crate::geom::Real;

const FACTOR: [Real; 4] = [
    1.0 / ROUTE[0].column.scale,
    1.0 / ROUTE[1].column.scale,
    1.0 / ROUTE[2].column.scale,
    1.0 / ROUTE[3].column.scale,
];

/// Fills [P, 4] and the mask [P] (or nothing, where there is no mask).
pub(super) fn write_route(
    view: &View<'_>,
    frame: &Frame,
    spacing_m: Real,
    out: &mut [Real],
    mask: &mut [Real],
) {
    let length = view.route.length_m();
    let (rows, _) = out.as_chunks_mut::<{ ROUTE.len() }>();
    for (p, row) in rows.iter_mut().enumerate() {
        let s = view.route_s_m + (p + 1) as Real * spacing_m;
        let there = s <= length;
        *row = if there {
            let at = view.route.at(s);
            frame.rotate([at.position.x - frame.x, at.position.y - frame.y, at.cos, at.sin], FACTOR)
        } else {
            [0.0; ROUTE.len()]
        };
        if let Some(m) = mask.get_mut(p) {
            *m = if there { 1.0 } else { 0.0 };
        }
    }
}
