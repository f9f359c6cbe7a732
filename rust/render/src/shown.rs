//! What an image of a scene's log or of a running world shows, taken at one moment.

use crate::agents::AgentBox;
use crate::camera::Camera;
use crate::drawing::{Drawing, render};
use crate::error::Result;
use crate::image::Image;
use crate::layers::MapLayers;
use crate::lines::Line;
use crate::palette::{DrawStyle, Rgb, Theme};
use ccdiff_sim::geom::{Point2, Pose2, Real};

/// What the middle of an image follows.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Centre {
    /// An agent, by its index in the scene.
    Agent(usize),
    /// A fixed point of the scene frame, metres.
    Point(Point2),
}

/// What of a scene or world an image shows, and how large.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Frame {
    /// What is in the middle; `None`: the ego of a log, the first slot's agent of a world.
    pub centre: Option<Centre>,
    /// Metres across the image's width.
    pub span_m: Real,
    /// Width, pixels.
    pub width: u32,
    /// Height, pixels.
    pub height: u32,
    /// Whether the heading of the agent in the middle points to the top; else north does.
    pub heading_up: bool,
    /// Whether the rest of the route of the ego or the first slot is drawn.
    pub route: bool,
    /// Whether the scene's name, time, a speed, names of agents, a scale bar and a legend are written.
    pub labels: bool,
    /// Ground and colours.
    pub theme: Theme,
}

/// What an image shows: [`Self::of_log`], [`Self::of_world`].
#[derive(Debug)]
pub struct Shown {
    pub(crate) frame: Frame,
    pub(crate) middle: Pose2,
    pub(crate) boxes: Vec<AgentBox>,
    pub(crate) collisions: Vec<Point2>,
    pub(crate) trails: Vec<(Vec<Point2>, DrawStyle)>,
    pub(crate) route: Vec<Point2>,
    pub(crate) caption: String,
    pub(crate) names: Vec<String>,
    pub(crate) legend: Vec<(Rgb, String)>,
}

impl Shown {
    /// Nothing but the map.
    pub(crate) fn new(frame: Frame, middle: Pose2) -> Self {
        Self {
            frame,
            middle,
            boxes: Vec::new(),
            collisions: Vec::new(),
            trails: Vec::new(),
            route: Vec::new(),
            caption: String::new(),
            names: Vec::new(),
            legend: Vec::new(),
        }
    }

    /// Draws it on a map.
    ///
    /// # Errors
    /// Those of [`render`].
    pub fn render(&self, map: &MapLayers) -> Result<Image> {
        let frame = &self.frame;
        let camera = Camera::over(self.middle.position, frame.span_m, frame.width, frame.height);
        let camera = if frame.heading_up { camera.heading_up(self.middle.heading_rad) } else { camera };
        let trails = self.trails.iter().map(|(points, driver)| Line { points, driver: *driver });
        let drawing = Drawing {
            map: Some(map),
            route: &self.route,
            trails: &trails.collect::<Vec<_>>(),
            boxes: &self.boxes,
            names: &self.names,
            collisions: &self.collisions,
            caption: &self.caption,
            scale_bar: frame.labels,
            legend: &self.legend,
            theme: frame.theme,
            ..Drawing::default()
        };
        render(&drawing, &camera)
    }
}
