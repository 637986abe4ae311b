//! What the server and the client agree on: spaces, cameras, bounds, layered depth images, mesh and
//! texture chunks, the dataset's index, codecs, wire messages and `select`.
//!
//! Pure: no I/O, no async, no GPU, no unsafe code. Conventions that hold everywhere:
//!
//! - Right-handed world, Y up, metres. An eye with yaw 0 and pitch 0 looks along -Z; positive yaw
//!   turns left (counter-clockwise seen from above), positive pitch looks up. Angles are in
//!   degrees at the doors.
//! - Pixel centres lie at +0.5; rows count downward.
//! - World positions are f64; chunks store values relative to their own origin.
//! - Disparity is 1 / depth along the camera's forward axis, in 1/m; 0 is the sky.
//! - Colours are 8-bit sRGB; filtering and blending happen in linear light ([`shade`]).
#![forbid(unsafe_code)]
#![warn(missing_docs)]

pub mod bounds;
pub mod camera;
pub mod cell_runs;
pub mod client_profile;
pub mod codec;
pub mod floor_plan;
pub mod index;
pub mod ldi;
pub mod manifest;
pub mod mesh;
pub mod need;
pub mod path;
pub mod portal_view;
pub mod room_index;
pub mod rooms;
pub mod said;
pub mod select;
pub mod shade;
pub mod sky;
pub mod stroll;
pub mod texture;
pub mod tree;
pub mod volume;
pub mod wire;

pub use bounds::Aabb;
pub use camera::{OutputCamera, Pose, ViewBasis};
pub use cell_runs::CellRuns;
