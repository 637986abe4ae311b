//! What a walk is asked to do.

use super::display_mode::DisplayMode;
use crate::{
    composite::Fill,
    warp::{Order, Stamp},
};
use ldi_protocol::{
    room_index::{PortalImages, ShowPortals},
    select::{FarBy, Show},
};
use serde::Serialize;

/// How far geometry is represented.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, clap::ValueEnum)]
#[serde(rename_all = "lowercase")]
pub enum Method {
    /// What the dataset offers: images where a placement names one, geometry elsewhere.
    Auto,
    /// Draw every cell in the frustum.
    Geometry,
    /// Portal textures: the central reference image painted onto each portal.
    Texture,
    /// The nearest of the reference images painted onto each portal.
    #[value(skip)]
    Textures,
    /// Beyond portals the nearest reference image, warped.
    Warp1,
    /// Beyond portals the two nearest reference images.
    Warp2,
    /// Layered depth images: of portals, merged from reference images, in a dataset with rooms; of the grid in others.
    Ldi,
    /// The same.
    Grid,
    /// Layered depth images at portals, made for boxes of eyes.
    Portals,
    /// The same wherever a portal has one, even where geometry would fit the budget.
    #[value(skip)]
    PortalsEverywhere,
    /// The tree of layered depth images.
    Tree,
    /// Geometry, and what is far from images that frames before have made.
    Cache,
}

impl Method {
    /// What it shows. Images of portals as of 1998 show wherever there are some, as they did then.
    pub fn show(self) -> Show {
        let (images, everywhere) = match self {
            Self::Texture => (PortalImages::Texture, true),
            Self::Textures => (PortalImages::Textures, true),
            Self::Warp1 => (PortalImages::Reference, true),
            Self::Warp2 => (PortalImages::TwoReferences, true),
            Self::Ldi => (PortalImages::Layered, true),
            Self::Portals => (PortalImages::Zones, false),
            Self::PortalsEverywhere => (PortalImages::Zones, true),
            Self::Auto | Self::Geometry | Self::Grid | Self::Tree | Self::Cache => (PortalImages::Offered, false),
        };
        let far = match self {
            Self::Geometry | Self::Cache => FarBy::Geometry,
            Self::Tree => FarBy::Tree,
            _ => FarBy::Offered,
        };
        Show { far, portals: ShowPortals { images, everywhere } }
    }
}

/// Whether samples that cannot be seen are rejected by groups before the warp.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, clap::ValueEnum)]
#[serde(rename_all = "lowercase")]
pub enum Cull {
    /// As it pays; today the same as `on`.
    Auto,
    /// Tiles of samples outside the picture are rejected.
    On,
    /// Every sample is warped: to measure what culling saves.
    Off,
}

/// How the walk treats the network.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, clap::ValueEnum)]
#[serde(rename_all = "lowercase")]
pub enum Pace {
    /// The walk does not wait: all poses are drawn when they are due from what is there; every Nth is kept.
    Realtime,
    /// Each frame complete; only poses 0, N, 2N, ... are drawn.
    Wait,
}

/// Settings of a walk.
#[derive(Debug, Clone, Serialize)]
pub struct WalkOptions {
    /// Output columns.
    pub width: u32,
    /// Output rows.
    pub height: u32,
    /// Representation of what is far.
    pub method: Method,
    /// With [`Method::Cache`]: how far off a cached image may show things, pixels.
    pub cache_error_px: f64,
    /// Reconstruction of warped samples.
    #[serde(serialize_with = "by_name_stamp")]
    pub stamp: Stamp,
    /// Visibility among warped samples.
    #[serde(serialize_with = "by_name_order")]
    pub order: Order,
    /// Rejection of samples by groups.
    pub cull: Cull,
    /// What holes show.
    pub fill: Fill,
    /// Smooth warped pixels with a 3 x 3 kernel.
    pub smooth: bool,
    /// Milliseconds that the LDI tree may take of a frame; None for as many as its finest samples in view take.
    pub frame_ms: Option<f64>,
    /// Samples per output pixel along each side: 1 or 2.
    pub supersample: u32,
    /// Pacing.
    pub pace: Pace,
    /// Every how many poses a frame is kept.
    pub every: usize,
    /// Cap on decoded bytes in the cache; None for the client's default.
    pub cache_bytes: Option<u64>,
    /// Write pictures of the parts of each frame.
    pub debug_views: bool,
    /// What pictures show.
    pub shows: DisplayMode,
    /// Images that have come are laid out on a thread of their own, and frames show them when they are ready; pictures of half the size that the dataset was made for, or smaller, show them at
    /// half their resolution, where samples cover no more pixels than was promised. Otherwise the frame that needs them lays them out as they are.
    #[serde(rename = "beside")]
    pub background_layout: bool,
    /// Frames of the all-geometry comparison; 0 skips it.
    pub baseline_frames: usize,
}

fn by_name_stamp<S: serde::Serializer>(stamp: &Stamp, s: S) -> Result<S::Ok, S::Error> {
    s.serialize_str(stamp.name())
}

fn by_name_order<S: serde::Serializer>(order: &Order, s: S) -> Result<S::Ok, S::Error> {
    s.serialize_str(order.name())
}
