//! The walk: poses along a path, each turned into a frame, judged and reported.
//!
//! In: a [`DataSource`] (a connection with its cache; memory in tests), a path, options. Out: numbered pictures in a folder and a
//! [`Report`](crate::report::Report). After Aliaga and Lastra 1999, Figure 12: per frame select the grid point and the
//! angular range, draw what is not culled, warp the image of what is, compose by depth.
//!
//! - [`renderer`](Painter): one frame from resident data; never waits.
//! - `fallback`: what shows while a view is on its way. `layouts`: images laid out for the warp. `uploads`: what goes to a card with which picture. `backend`: who draws, the processor or a graphics card.
//! - `walk`: paces frames, asks the feed for what they need, keeps every Nth.
//! - `baseline`: the same poses with all geometry, for the speedup.
//! - `judge`: kept frames against the truth. `save`: pictures on disk. `views`: the same frame in other colours.

mod baseline;
mod data_source;
mod display_mode;
mod evaluation;
mod fallback_view;
mod frame_renderer;
mod image_layouts;
mod layout_worker;
mod options;
mod render_backend;
mod save;
#[cfg(test)]
mod tests;
mod upload_queue;
mod walk_loop;

pub use data_source::{DataSource, LOST_FOR, Traffic};
pub use display_mode::DisplayMode;
pub use evaluation::{EvaluationError, Scores, Truth, pictures_of};
pub use frame_renderer::{FrameRenderer, FrameStats, View, view_of};
pub use options::{Cull, Method, Pace, WalkOptions};
pub use render_backend::{RenderError, Renderer};
pub(crate) use save::save_rgb;
pub use save::{SaveError, save_debug_views, save_frame};
pub use upload_queue::Anticipated;
pub use walk_loop::{Progress, WalkError, WalkJob, run};
