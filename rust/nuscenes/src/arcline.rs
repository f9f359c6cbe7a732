//! Lane centre lines of the map expansion: chains of paths, each of three segments that are arcs or straight.

/// Paths longer than this are damaged data, metres.
const MAX_PATH_M: f64 = 1e5;
/// Points nearer than this to the one before are left out (the joints of paths are in the data twice), metres.
const MIN_SPACING_M: f64 = 1e-2;

/// One path of `arcline_path_3`.
#[derive(serde::Deserialize)]
pub(crate) struct ArcLinePath {
    /// x, y, yaw in the global frame.
    pub(crate) start_pose: [f64; 3],
    /// L, S or R for each segment.
    pub(crate) shape: String,
    /// Radius of the arcs, metres.
    pub(crate) radius: f64,
    /// Length of each segment, metres.
    pub(crate) segment_length: [f64; 3],
}

/// Why a path cannot be followed: field, value, and the rule that it breaks.
pub(crate) type PathFault = (&'static str, String, &'static str);

impl ArcLinePath {
    pub(crate) fn check(&self) -> Result<(), PathFault> {
        let fault = |field, got, expected| Err((field, got, expected));
        if self.curvatures_1pm().is_none() {
            return fault("shape", format!("{:?}", self.shape), "three letters of L, S, R");
        }
        if !(self.radius > 0.0 && self.radius.is_finite()) {
            return fault("radius", self.radius.to_string(), "a positive number of metres");
        }
        let lengths = self.segment_length;
        if !(lengths.iter().all(|l| *l >= 0.0) && lengths.iter().sum::<f64>() < MAX_PATH_M) {
            return fault("segment_length", format!("{lengths:?}"), "metres, not negative, 100 km at most");
        }
        if !self.start_pose.iter().all(|v| v.abs() < 1e6) {
            return fault("start_pose", format!("{:?}", self.start_pose), "x, y in metres and yaw");
        }
        Ok(())
    }

    /// Pieces that a path is cut into, of about `spacing_m` each.
    pub(crate) fn num_pieces(&self, spacing_m: f64) -> usize {
        ((self.segment_length.iter().sum::<f64>() / spacing_m).ceil() as usize).max(1)
    }

    /// Signed curvature of each segment, 1/metre, left positive.
    fn curvatures_1pm(&self) -> Option<[f64; 3]> {
        let mut curvatures = [0.0; 3];
        let mut letters = self.shape.bytes();
        for curvature in &mut curvatures {
            *curvature = match letters.next()? {
                b'L' => 1.0 / self.radius,
                b'R' => -1.0 / self.radius,
                b'S' => 0.0,
                _ => return None,
            };
        }
        letters.next().is_none().then_some(curvatures)
    }

    /// The segments, one behind the other.
    fn segments(&self, curvatures_1pm: [f64; 3]) -> [Segment; 3] {
        let [mut x, mut y, mut yaw] = self.start_pose;
        [0, 1, 2].map(|i| {
            let (sin, cos) = yaw.sin_cos();
            let (curvature_1pm, length_m) = (curvatures_1pm[i], self.segment_length[i]);
            let segment = Segment { x, y, sin, cos, curvature_1pm, length_m };
            [x, y] = segment.at(length_m);
            yaw += curvature_1pm * length_m;
            segment
        })
    }
}

/// An arc or a straight line.
struct Segment {
    x: f64,
    y: f64,
    sin: f64,
    cos: f64,
    curvature_1pm: f64,
    length_m: f64,
}

impl Segment {
    /// Position `along_m` from its start.
    fn at(&self, along_m: f64) -> [f64; 2] {
        // the chord of the arc, in the frame of its start
        let (forward, sideways) = if self.curvature_1pm.abs() < 1e-6 {
            (along_m, 0.0)
        } else {
            let (sin, cos) = (self.curvature_1pm * along_m).sin_cos();
            (sin / self.curvature_1pm, (1.0 - cos) / self.curvature_1pm)
        };
        [
            self.x + (self.cos * forward - self.sin * sideways),
            self.y + (self.sin * forward + self.cos * sideways),
        ]
    }
}

/// Position `distance_m` along some segments.
fn position_along(segments: &[Segment; 3], distance_m: f64) -> [f64; 2] {
    let mut left_m = distance_m;
    for segment in &segments[..2] {
        if left_m <= segment.length_m {
            return segment.at(left_m);
        }
        left_m -= segment.length_m;
    }
    segments[2].at(left_m.min(segments[2].length_m))
}

/// Points of a centre line about `spacing_m` apart, ends of paths included, which have been checked. Empty where all have
/// no length.
///
/// # Reference
/// Same curve and same number of points per path as the devkit's `discretize_lane`, joints once.
pub(crate) fn discretise(paths: &[ArcLinePath], spacing_m: f64) -> Vec<[f64; 2]> {
    let mut points: Vec<[f64; 2]> = Vec::new();
    for path in paths {
        let Some(curvatures) = path.curvatures_1pm() else { continue };
        let length: f64 = path.segment_length.iter().sum();
        let (segments, count) = (path.segments(curvatures), path.num_pieces(spacing_m));
        points.reserve(count + 1);
        for i in 0..=count {
            let point = position_along(&segments, length * i as f64 / count as f64);
            let near = |p: &[f64; 2]| (p[0] - point[0]).hypot(p[1] - point[1]) < MIN_SPACING_M;
            if !points.last().is_some_and(near) {
                points.push(point);
            }
        }
    }
    if points.len() < 2 {
        points.clear();
    }
    points
}

#[cfg(test)]
mod tests {
    use super::*;

    fn path(shape: &str, radius: f64, segment_length: [f64; 3]) -> ArcLinePath {
        ArcLinePath { start_pose: [1.0, 2.0, 0.0], shape: shape.into(), radius, segment_length }
    }

    #[test]
    fn quarter_turns_end_where_geometry_says() {
        let quarter = 10.0 * std::f64::consts::FRAC_PI_2;
        let points = discretise(&[path("LSR", 10.0, [quarter, 5.0, quarter])], 1.0);
        let end = points[points.len() - 1];
        assert!((end[0] - 21.0).abs() < 1e-9 && (end[1] - 27.0).abs() < 1e-9, "{end:?}");
        let steps = points.windows(2).map(|w| (w[1][0] - w[0][0]).hypot(w[1][1] - w[0][1]));
        assert!(steps.into_iter().all(|s| (0.9..1.0 + 1e-9).contains(&s)));
    }

    #[test]
    fn faults_name_the_field() {
        let fault = |p: ArcLinePath| p.check().err().unwrap().0;
        assert_eq!(fault(path("LXL", 1.0, [1.0; 3])), "shape");
        assert_eq!(fault(path("LS", 1.0, [1.0; 3])), "shape");
        assert_eq!(fault(path("LSL", 0.0, [1.0; 3])), "radius");
        assert_eq!(fault(path("LSL", 1.0, [1.0, -1.0, 0.0])), "segment_length");
        assert_eq!(fault(path("LSL", 1.0, [1e9, 0.0, 0.0])), "segment_length");
        assert!(discretise(&[path("LSL", 1.0, [0.0; 3])], 1.0).is_empty());
    }
}
