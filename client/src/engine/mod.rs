//! The engine: renders frames along a path, evaluates and reports them.
//!
//! In: a [`DataSource`] (a connection with its cache; memory in tests), a path, options. Out:
//! numbered pictures in a folder and a [`Report`](crate::report::Report). After Aliaga and Lastra
//! 1999, Figure 12: per frame select the grid point and the angular range, draw the cells that are
//! not culled, warp the image of those that are, composite by depth.
//!
//! - `view`: selects what a pose draws. `frame_renderer`: one frame from resident data; never
//!   waits.
//! - `fallback_view`: the previous placement, while the current one is not ready.
//! - `image_layouts`: images laid out for the warp; `layout_worker`: the thread that lays them out;
//!   `upload_queue`: uploads to the GPU under a budget per frame.
//! - `render_backend`: runs each stage on the CPU or the GPU.
//! - `walk_loop`: paces frames, requests their data, keeps every Nth. `data_source`: its data.
//! - `baseline`: the same poses with all geometry, for the speedup.
//! - `evaluation`: kept frames against ground truth. `save`: pictures on disk.
//! - `display_mode`: false colours.

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
mod renderer_choice;
mod save;
#[cfg(test)]
mod tests;
mod upload_queue;
mod view;
mod walk_error;
mod walk_loop;

pub use data_source::{DataSource, LOST_FOR, Traffic};
pub use display_mode::DisplayMode;
pub use evaluation::{EvaluationError, Scores, Truth, pictures_of};
pub use frame_renderer::{FrameRenderer, FrameStats};
pub use options::{Appearance, Cull, Method, Pace, WalkOptions};
pub use render_backend::RenderError;
pub use renderer_choice::Renderer;
pub(crate) use save::save_rgb;
pub use save::{SaveError, save_debug_views, save_frame};
pub use upload_queue::Anticipated;
pub use view::{LevelStats, View, select_view, view_of};
pub use walk_error::WalkError;
pub use walk_loop::{Progress, WalkJob, run};
