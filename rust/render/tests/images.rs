//! What stands where in an image, and what is refused.

use ccdiff_render::{
    AgentBox, Camera, DrawStyle, Drawing, Line, MapLayers, RenderError, Rgb, Theme, look, palette, render,
    render_svg,
};
use ccdiff_sim::geom::{Point2, Polygon, Pose2, Real, Vector2};
use ccdiff_sim::scene::{AgentKind, Lane, LightState, Map};
use proptest::prelude::*;

fn points(xy: &[(Real, Real)]) -> Vec<Point2> {
    xy.iter().map(|(x, y)| Point2::new(*x, *y)).collect()
}

fn rectangle(x: (Real, Real), y: (Real, Real)) -> Polygon {
    Polygon { exterior: points(&[(x.0, y.0), (x.1, y.0), (x.1, y.1), (x.0, y.1)]), holes: vec![] }
}

/// Two roads, 14 m wide, that cross at the origin; a crossing and a stop area east of it.
fn crossroads() -> Map {
    let lane = |y: Real, towards: Real| Lane {
        centreline: (0..=160).map(|i| Point2::new(towards * (i as Real - 80.0), y)).collect(),
        polygon: rectangle((-80.0, 80.0), (y - 1.75, y + 1.75)),
        ..Lane::default()
    };
    Map {
        drivable_area: vec![rectangle((-80.0, 80.0), (-7.0, 7.0)), rectangle((-7.0, 7.0), (-80.0, 80.0))],
        lanes: vec![lane(-5.2, 1.0), lane(-1.8, 1.0), lane(1.8, -1.0), lane(5.2, -1.0)],
        road_dividers: vec![points(&[(-80.0, 0.0), (-12.0, 0.0)]), points(&[(15.0, 0.0), (80.0, 0.0)])],
        lane_dividers: vec![points(&[(-80.0, -3.5), (-12.0, -3.5)]), points(&[(15.0, 3.5), (80.0, 3.5)])],
        ped_crossings: vec![rectangle((9.0, 12.0), (-7.0, 7.0))],
        walkways: vec![rectangle((-80.0, -7.0), (7.0, 10.5)), rectangle((7.0, 80.0), (7.0, 10.5))],
        stop_lines: vec![rectangle((13.0, 15.0), (0.0, 7.0))],
        carpark_areas: vec![rectangle((20.0, 45.0), (-20.0, -7.0))],
        ..Map::default()
    }
}

fn car(x: Real, y: Real, heading_rad: Real, driver: DrawStyle) -> AgentBox {
    AgentBox {
        pose: Pose2::new(x, y, heading_rad),
        length_m: 4.6,
        width_m: 1.9,
        kind: AgentKind::Vehicle,
        driver,
        collided: false,
        parked: false,
        arrived: false,
    }
}

/// Colour of a point of the scene frame; the camera's own arithmetic, written again with f64 rotations. A colour that
/// nothing has for a point outside the image.
fn colour_at(image: &[u8], camera: &Camera, x: f64, y: f64) -> Rgb {
    let turn = std::f64::consts::FRAC_PI_2 - f64::from(camera.up_rad);
    let (dx, dy) = (x - f64::from(camera.centre.x), y - f64::from(camera.centre.y));
    let (right, up) = (dx * turn.cos() - dy * turn.sin(), dx * turn.sin() + dy * turn.cos());
    let scale = f64::from(camera.metres_per_pixel);
    let column = (f64::from(camera.width) / 2.0 + right / scale).floor();
    let row = (f64::from(camera.height) / 2.0 - up / scale).floor();
    let (width, height) = (f64::from(camera.width), f64::from(camera.height));
    let inside = (0.0..width).contains(&column) && (0.0..height).contains(&row);
    let found = inside.then(|| &image[3 * (row * width + column) as usize..][..3]);
    found.map_or(Rgb(1, 2, 3), |c| Rgb(c[0], c[1], c[2]))
}

fn north_up(span_m: Real) -> Camera {
    Camera::over(Point2::new(0.0, 0.0), span_m, 400, 300)
}

#[test]
fn the_ego_is_in_the_middle_and_the_road_and_the_ground_are_where_the_map_says() {
    let map = MapLayers::new(&crossroads()).unwrap();
    let boxes = [car(0.0, 0.0, 0.0, DrawStyle::Ego)];
    let drawing = Drawing { map: Some(&map), boxes: &boxes, ..Drawing::default() };
    for camera in [north_up(80.0), north_up(80.0).heading_up(0.7), north_up(40.0).heading_up(-2.5)] {
        for theme in Theme::ALL {
            let image = render(&Drawing { theme, ..drawing }, &camera).unwrap();
            assert_eq!(image.len(), 400 * 300 * 3);
            for (x, y, colour) in [
                (0.0, 0.0, DrawStyle::Ego.colour(theme)),
                (3.0, -10.0, theme.palette().drivable),
                (-10.0, -10.0, theme.palette().ground),
                (-10.0, 9.0, theme.palette().walkway),
            ] {
                assert_eq!(colour_at(&image, &camera, x, y), colour);
            }
        }
    }
}

#[test]
fn stop_lines_have_the_colour_of_their_light_and_the_width_of_what_they_forbid() {
    let shown = [LightState::Red, LightState::Yellow, LightState::Green, LightState::Unknown];
    let line = |(i, state): (usize, &LightState)| {
        let y = 10.0 - 5.0 * i as Real;
        ([Point2::new(-5.0, y), Point2::new(5.0, y)], *state)
    };
    let lights: Vec<_> = shown.iter().enumerate().map(line).collect();
    let palette = Theme::Light.palette();
    let colours = [palette.red_light, palette.yellow_light, palette.green_light, palette.ground];
    let image = render(&Drawing { lights: &lights, ..Drawing::default() }, &north_up(40.0)).unwrap();
    for ((([ends, _], _), half_m), colour) in lights.iter().zip([0.5, 0.35, 0.2, 0.0]).zip(colours) {
        let at = |x: f64, beside: f64| colour_at(&image, &north_up(40.0), x, f64::from(ends.y) + beside);
        assert_eq!(at(0.0, 0.0), colour);
        assert_eq!([at(0.0, half_m + 0.15), at(6.0, 0.0)], [palette.ground; 2]);
    }
}

#[test]
fn a_hole_in_the_drivable_area_shows_the_ground_unless_another_polygon_covers_it() {
    let ring = |half: Real| points(&[(-half, -half), (half, -half), (half, half), (-half, half)]);
    let holed = Polygon { exterior: ring(20.0), holes: vec![ring(10.0)] };
    let cover = rectangle((-10.0, 0.0), (-10.0, 10.0));
    let camera = north_up(60.0);
    for (areas, left) in [
        (vec![holed.clone()], palette::LIGHT.ground),
        (vec![holed.clone(), cover.clone()], palette::LIGHT.drivable),
    ] {
        let map = MapLayers::new(&Map { drivable_area: areas, ..Map::default() }).unwrap();
        let image = render(&Drawing { map: Some(&map), ..Drawing::default() }, &camera).unwrap();
        assert_eq!(colour_at(&image, &camera, -5.0, 0.0), left);
        assert_eq!(colour_at(&image, &camera, 5.0, 0.0), palette::LIGHT.ground);
        assert_eq!(colour_at(&image, &camera, 15.0, 0.0), palette::LIGHT.drivable);
    }
}

#[test]
fn no_seam_shows_between_areas_that_abut_at_any_angle() {
    for turn in [0.0, 0.3, 0.7, 1.2] {
        let at = |x: Real, y: Real| Pose2::new(0.37, 0.11, turn).to_outer(Point2::new(x, y));
        let half = |from: Real, to: Real| {
            Polygon::from_exterior(vec![at(from, -30.0), at(to, -30.0), at(to, 30.0), at(from, 30.0)])
        };
        let map = Map { drivable_area: vec![half(-30.0, 0.0), half(0.0, 30.0)], ..Map::default() };
        let map = MapLayers::new(&map).unwrap();
        let image = render(&Drawing { map: Some(&map), ..Drawing::default() }, &north_up(40.0)).unwrap();
        let Rgb(r, g, b) = palette::LIGHT.drivable;
        let off = image.chunks(3).filter(|c| **c != [r, g, b]).count();
        assert_eq!(off, 0, "{off} pixels at turn {turn}");
    }
}

#[test]
fn a_box_is_as_long_and_wide_as_the_agent_and_lies_along_its_heading() {
    let boxes = [AgentBox { length_m: 10.0, width_m: 4.0, ..car(0.0, 0.0, 0.6, DrawStyle::Ccdiff) }];
    let camera = north_up(40.0);
    let image = render(&Drawing { boxes: &boxes, ..Drawing::default() }, &camera).unwrap();
    let (s, c) = 0.6f64.sin_cos();
    let along = |f: f64, l: f64| colour_at(&image, &camera, f * c - l * s, f * s + l * c);
    for (f, l) in [(-4.6, 0.0), (0.0, 1.6), (0.0, -1.6), (-4.0, 1.4)] {
        assert_eq!(along(f, l), DrawStyle::Ccdiff.colour(Theme::Light), "inside at {f}, {l}");
    }
    for (f, l) in [(5.4, 0.0), (-5.4, 0.0), (0.0, 2.4), (0.0, -2.4)] {
        assert_eq!(along(f, l), palette::LIGHT.ground, "outside at {f}, {l}");
    }
}

#[test]
fn a_collided_agent_has_a_red_outline_and_keeps_its_colour() {
    let boxes = [AgentBox { collided: true, ..car(0.0, 0.0, 0.0, DrawStyle::Idm) }];
    let camera = north_up(20.0);
    let image = render(&Drawing { boxes: &boxes, ..Drawing::default() }, &camera).unwrap();
    assert_eq!(colour_at(&image, &camera, 0.0, 0.0), DrawStyle::Idm.colour(Theme::Light));
    assert_eq!(colour_at(&image, &camera, 0.0, 1.1), palette::LIGHT.collision);
}

#[test]
fn a_parked_vehicle_is_hollow_and_an_svg_has_the_same_marks() {
    let parked = AgentBox { parked: true, ..car(0.0, 0.0, 0.0, DrawStyle::Idm) };
    let boxes = [parked, car(8.0, 0.0, 0.0, DrawStyle::Ego)];
    let drawing = Drawing { boxes: &boxes, collisions: &[Point2::new(8.0, 0.0)], ..Drawing::default() };
    let camera = north_up(40.0);
    let image = render(&drawing, &camera).unwrap();
    let Rgb(inside, ..) = colour_at(&image, &camera, 0.0, 0.0);
    let (Rgb(full, ..), Rgb(ground, ..)) = (DrawStyle::Idm.colour(Theme::Light), palette::LIGHT.ground);
    let mixed = f32::from(ground) + look::PARKED_ALPHA * (f32::from(full) - f32::from(ground));
    assert!((f32::from(inside) - mixed).abs() < 2.0, "{inside}, not {mixed}");
    let svg = render_svg(&drawing, &camera).unwrap();
    let count = |what: &str| svg.matches(what).count();
    assert_eq!(count("fill=\"#947500\" fill-opacity=\"0.200\""), 1);
    assert_eq!(count("fill=\"#0654b2\" fill-opacity=\"1.000\""), 1);
    assert_eq!(count("stroke=\"#d61f2c\""), 1);
    assert!(svg.starts_with("<svg ") && svg.ends_with("</svg>\n") && svg.contains("fill=\"#eef0ec\""));
}

#[test]
fn the_ego_is_drawn_over_what_stands_in_the_same_place_whatever_the_order() {
    let (ego, other) = (car(0.0, 0.0, 0.0, DrawStyle::Ego), car(0.0, 0.0, 0.0, DrawStyle::Ccdiff));
    for boxes in [[ego, other], [other, ego]] {
        let image = render(&Drawing { boxes: &boxes, ..Drawing::default() }, &north_up(40.0)).unwrap();
        let found = colour_at(&image, &north_up(40.0), 0.0, 0.0);
        assert_eq!(found, DrawStyle::Ego.colour(Theme::Light));
    }
}

#[test]
fn a_trail_grows_stronger_towards_the_present() {
    let trail: Vec<Point2> = (0..=20).map(|i| Point2::new(i as Real - 20.0, 0.0)).collect();
    let trails = [Line { points: &trail, driver: DrawStyle::Ccdiff }];
    let camera = Camera::over(Point2::new(-10.0, 0.0), 40.0, 400, 300);
    let image = render(&Drawing { trails: &trails, ..Drawing::default() }, &camera).unwrap();
    let red = |x: f64| colour_at(&image, &camera, x, 0.0).0;
    assert!(red(-19.0) > red(-10.5) && red(-10.5) > red(-0.5));
    assert_ne!(colour_at(&image, &camera, -19.0, 0.0), palette::LIGHT.ground);
}

#[test]
fn routes_and_maps_that_are_not_finite_are_refused() {
    let nan = Real::NAN;
    let route = points(&[(0.0, 0.0), (nan, 1.0)]);
    let error = render(&Drawing { route: &route, ..Drawing::default() }, &north_up(50.0)).unwrap_err();
    assert!(error.to_string().starts_with("route 0 is"));
    let map = Map { walkways: vec![rectangle((0.0, nan), (0.0, 1.0))], ..Map::default() };
    assert_eq!(MapLayers::new(&map).unwrap_err(), RenderError::Map { layer: "walkways" });
}

#[test]
fn a_windscreen_shows_where_the_front_is() {
    let camera = north_up(20.0);
    for heading in [0.0, 1.3, -2.8] {
        let boxes = [car(0.0, 0.0, heading, DrawStyle::Idm)];
        let image = render(&Drawing { boxes: &boxes, ..Drawing::default() }, &camera).unwrap();
        let (s, c) = f64::from(heading).sin_cos();
        let Rgb(front, ..) = colour_at(&image, &camera, 0.8 * c, 0.8 * s);
        let Rgb(rear, ..) = colour_at(&image, &camera, -1.45 * c, -1.45 * s);
        let Rgb(body, ..) = DrawStyle::Idm.colour(Theme::Light);
        assert!(front < rear && rear < body, "{front} {rear} {body} at {heading}");
    }
}

#[test]
fn names_stand_above_their_agents_where_there_is_room_and_a_legend_in_its_corner() {
    let boxes = [car(0.0, 0.0, 0.0, DrawStyle::Ego)];
    let (names, legend) = ([String::from("ego")], [(Rgb(9, 8, 7), String::from("ego"))]);
    let changed = |drawing: &Drawing<'_>, camera: &Camera| {
        let bare = Drawing { boxes: &boxes, ..Drawing::default() };
        let (with, without) = (render(drawing, camera).unwrap(), render(&bare, camera).unwrap());
        let pixels = with.chunks(3).zip(without.chunks(3)).enumerate();
        let differ = pixels.filter(|(_, (a, b))| a != b).map(|(i, _)| (i % 400, i / 400));
        (with.clone(), differ.collect::<Vec<_>>())
    };
    let named = Drawing { boxes: &boxes, names: &names, ..Drawing::default() };
    let (_, at) = changed(&named, &north_up(80.0));
    assert!(!at.is_empty() && at.iter().all(|(x, y)| (180..220).contains(x) && (120..150).contains(y)));
    assert!(changed(&named, &north_up(200.0)).1.is_empty(), "two pixels a metre are no room");
    let explained = Drawing { boxes: &boxes, legend: &legend, ..Drawing::default() };
    let (image, at) = changed(&explained, &north_up(80.0));
    assert!(!at.is_empty() && at.iter().all(|(x, y)| *x > 300 && *y > 250));
    assert!(image.chunks(3).any(|c| c == [9, 8, 7]));
    let small = Camera { width: 40, height: 30, ..north_up(80.0) };
    assert_eq!(render(&explained, &small), render(&Drawing { legend: &[], ..explained }, &small));
}

/// Coordinates near and far, and now and then one that is no number.
fn coordinate() -> impl Strategy<Value = Real> {
    prop_oneof![8 => -60f32..60., 2 => -9e5f32..9e5, 1 => Just(Real::NAN), 1 => any::<f32>(), 2 => Just(0.0)]
}

/// Points, most of them usable.
fn line(most: usize) -> impl Strategy<Value = Vec<Point2>> {
    let near = (-200f32..200., -200f32..200.);
    let point = prop_oneof![60 => near, 1 => (coordinate(), coordinate())];
    prop::collection::vec(point.prop_map(|(x, y)| Point2::new(x, y)), 0..most)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(96))]

    #[test]
    fn whatever_comes_in_gives_an_image_or_an_error_and_the_same_one_twice(
        (a, b, c, d) in (line(9), line(9), line(9), line(9)),
        (x, y, turn, scale) in (coordinate(), coordinate(), -9f32..9., prop_oneof![4 => 1e-3f32..2., 1 => any::<f32>()]),
        (width, height) in (0u32..90, 0u32..90),
        sizes in prop::collection::vec((coordinate(), 1e-3f32..30., 0usize..5, 0usize..7), 0..6),
        text in "\\PC{0,12}",
    ) {
        let polygon = Polygon { exterior: a.clone(), holes: vec![b.clone()] };
        let map = Map {
            drivable_area: vec![polygon.clone()],
            ped_crossings: vec![polygon.clone()],
            lane_dividers: vec![c.clone()],
            road_dividers: vec![d.clone()],
            ..Map::default()
        };
        let layers = MapLayers::new(&map);
        let boxes: Vec<AgentBox> = sizes
            .iter()
            .map(|(x, l, kind, driver)| AgentBox {
                pose: Pose2::new(*x, 0.5 * x, turn),
                length_m: *l,
                width_m: 0.4 * l,
                kind: AgentKind::ALL[*kind],
                driver: DrawStyle::ALL[*driver],
                collided: *kind == 1,
                parked: *kind == 2,
                arrived: *kind == 3,
            })
            .collect();
        let lines = [Line { points: &a, driver: DrawStyle::Ccdiff }, Line { points: &d, driver: DrawStyle::Ego }];
        let names = vec![text.clone(); boxes.len()];
        let legend = vec![(Rgb(1, 2, 3), text.clone()); boxes.len()];
        let drawing = Drawing {
            map: layers.as_ref().ok(),
            lights: &[],
            route: &c,
            trails: &lines,
            samples: &lines,
            plans: &lines,
            boxes: &boxes,
            names: &names,
            collisions: &b,
            caption: &text,
            scale_bar: true,
            legend: &legend,
            theme: Theme::ALL[usize::from(width % 2 == 0)],
        };
        let camera =
            Camera { centre: Point2::new(x, y), up_rad: turn, metres_per_pixel: scale, width, height };
        let first = render(&drawing, &camera);
        prop_assert_eq!(&first, &render(&drawing, &camera));
        prop_assert_eq!(render_svg(&drawing, &camera).is_ok(), first.is_ok());
        if let Ok(image) = first {
            prop_assert_eq!(image.len(), (width * height * 3) as usize);
        }
    }

    #[test]
    fn moving_camera_and_agent_together_moves_nothing(x in -300f32..300., y in -300f32..300., h in -3f32..3.) {
        // Whole metres keep the differences exact.
        let shift = Vector2::new(x.round(), y.round());
        let shot = |by: Vector2| {
            let boxes = [AgentBox { pose: Pose2::new(by.x, by.y, h), ..car(0.0, 0.0, h, DrawStyle::Ego) }];
            let camera = Camera::over(Point2::from(by), 30.0, 96, 64);
            render(&Drawing { boxes: &boxes, ..Drawing::default() }, &camera).unwrap()
        };
        let (here, there) = (shot(Vector2::zeros()), shot(shift));
        let far = here.iter().zip(&there).filter(|(a, b)| a.abs_diff(**b) > 12).count();
        prop_assert!(far < 12, "{} bytes differ", far);
    }
}
