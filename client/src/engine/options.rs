//! Options of a walk.

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

/// The representation of distant geometry.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, clap::ValueEnum)]
#[serde(rename_all = "lowercase")]
pub enum Method {
    /// The representation that the dataset offers: images where a placement names one, geometry
    /// elsewhere.
    Auto,
    /// All cells in the frustum as geometry in full.
    Geometry,
    /// All cells in the frustum as geometry at their levels of detail, whatever the budget.
    Levels,
    /// Flat portal textures: the central reference image of each portal.
    Texture,
    /// Flat portal textures: the nearest reference image of each portal.
    #[value(skip)]
    Textures,
    /// The nearest reference image of each portal, warped.
    Warp1,
    /// The two nearest reference images of each portal, warped.
    Warp2,
    /// Layered depth images: in a dataset with rooms those merged from reference images of portals,
    /// otherwise those of the grid.
    Ldi,
    /// Layered depth images of the grid.
    Grid,
    /// Layered depth images of portals, made for zones of eye positions.
    Portals,
    /// Layered depth images of portals, even where geometry would fit the budget.
    #[value(skip)]
    PortalsEverywhere,
    /// The LDI tree.
    Tree,
    /// Geometry, and distant parts as images cached from previous frames.
    Cache,
}

impl Method {
    /// What the selection shows. The portal images of 1998 are shown wherever they exist, as in the
    /// paper.
    pub fn show(self) -> Show {
        let (images, everywhere) = match self {
            Self::Texture => (PortalImages::Texture, true),
            Self::Textures => (PortalImages::Textures, true),
            Self::Warp1 => (PortalImages::Reference, true),
            Self::Warp2 => (PortalImages::TwoReferences, true),
            Self::Ldi => (PortalImages::Layered, true),
            Self::Portals => (PortalImages::Zones, false),
            Self::PortalsEverywhere => (PortalImages::Zones, true),
            Self::Auto | Self::Geometry | Self::Levels | Self::Grid | Self::Tree | Self::Cache => {
                (PortalImages::Offered, false)
            }
        };
        let far = match self {
            Self::Geometry | Self::Cache => FarBy::Geometry,
            Self::Levels => FarBy::Levels,
            Self::Tree => FarBy::Tree,
            _ => FarBy::Offered,
        };
        Show { far, portals: ShowPortals { images, everywhere } }
    }
}

/// Whether invisible samples are rejected by groups before the warp.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, clap::ValueEnum)]
#[serde(rename_all = "lowercase")]
pub enum Cull {
    /// Chosen by the client; currently the same as `on`.
    Auto,
    /// Tiles of samples outside the picture are rejected.
    On,
    /// All samples are warped, to measure the gain of culling.
    Off,
}

/// Whether frames wait for the network.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize, clap::ValueEnum)]
#[serde(rename_all = "lowercase")]
pub enum Pace {
    /// Frames never wait: each pose is drawn when it is due, from the data that is resident. Every
    /// Nth frame is kept.
    Realtime,
    /// Each frame waits for all its data. Only poses 0, N, 2N, ... are drawn.
    Wait,
}

/// Changes of a finished picture that make it easier to read. None of them is measured: a walk
/// without a window has none.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Appearance {
    /// Ambient occlusion and outlines.
    pub depth_shading: bool,
    /// A sky with a horizon.
    pub horizon: bool,
}

/// Settings of a walk.
#[derive(Debug, Clone, Serialize)]
pub struct WalkOptions {
    /// Output columns.
    pub width: u32,
    /// Output rows.
    pub height: u32,
    /// Representation of distant geometry.
    pub method: Method,
    /// With [`Method::Cache`]: largest displacement that a cached image may show, pixels.
    pub cache_error_px: f64,
    /// Reconstruction of warped samples.
    #[serde(serialize_with = "by_name_stamp")]
    pub stamp: Stamp,
    /// Visibility among warped samples.
    #[serde(serialize_with = "by_name_order")]
    pub order: Order,
    /// Rejection of samples by groups.
    pub cull: Cull,
    /// Content of holes.
    pub fill: Fill,
    /// Smooth warped pixels with a 3 x 3 kernel.
    pub smooth: bool,
    /// Time for the LDI tree per frame, milliseconds; None for its finest samples without a limit.
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
    /// Colours of the picture.
    pub shows: DisplayMode,
    /// Changes of the finished picture. Not part of a report, as measured walks have none.
    #[serde(skip)]
    pub appearance: Appearance,
    /// Images are laid out by the layout worker, and frames show them when they are ready. Pictures
    /// of at most half the dataset's resolution show images at half resolution, where the footprint
    /// bound still holds. Without this option the frame that needs an image lays it out.
    #[serde(rename = "beside")]
    pub background_layout: bool,
    /// Frames that are compared with all geometry; 0 skips the comparison.
    pub baseline_frames: usize,
}

fn by_name_stamp<S: serde::Serializer>(stamp: &Stamp, s: S) -> Result<S::Ok, S::Error> {
    s.serialize_str(stamp.name())
}

fn by_name_order<S: serde::Serializer>(order: &Order, s: S) -> Result<S::Ok, S::Error> {
    s.serialize_str(order.name())
}
