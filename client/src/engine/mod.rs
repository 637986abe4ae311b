//! The walk: poses along a path, each turned into a frame, judged and reported.
//!
//! In: a [`Feed`] (a connection with its cache; memory in tests), a path, options. Out: numbered pictures in a folder and a
//! [`Report`](crate::report::Report). After Aliaga and Lastra 1999, Figure 12: per frame select the grid point and the
//! angular range, draw what is not culled, warp the image of what is, compose by depth.
//!
//! - [`painter`](Painter): one frame from resident data; never waits.
//! - `stand_in`: what shows while a view is on its way. `layouts`: images laid out for the warp. `landing`: what goes to a card with which picture. `hand`: who draws, the processor or a graphics card.
//! - `walk`: paces frames, asks the feed for what they need, keeps every Nth.
//! - `baseline`: the same poses with all geometry, for the speedup.
//! - `judge`: kept frames against the truth. `save`: pictures on disk. `views`: the same frame in other colours.

mod baseline;
mod feed;
mod hand;
mod judge;
mod landing;
mod layouts;
mod options;
mod painter;
mod save;
mod stand_in;
#[cfg(test)]
mod tests;
mod views;
mod walk;
mod workshop;

pub use feed::{Feed, LOST_FOR, Traffic};
pub use hand::{PaintError, Renderer};
pub use judge::{JudgeError, Truth, Verdict, pictures_of};
pub use landing::Ahead;
pub use options::{Cull, Method, Pace, WalkOptions};
pub use painter::{Painted, Painter, View, view_of};
pub(crate) use save::save_rgb;
pub use save::{SaveError, save_debug_views, save_frame};
pub use views::Shows;
pub use walk::{Progress, WalkError, WalkJob, run};
