//! The server: builds datasets from scenes and serves them.
//!
//! Folders are stages; a module imports only from stages before it: [`scene`] -> [`octree`] ->
//! [`levels`] -> [`render`] -> [`walk_volume`] -> [`floor_plans`] -> [`placement`] -> [`portal`] ->
//! [`construct`] -> [`pack`] -> [`tree`] -> [`store`] -> [`tour`] -> [`plan`] -> [`serve`];
//! [`build`] joins them, [`cli`] is the command line.

pub mod build;
pub mod cli;
pub mod construct;
pub mod floor_plans;
pub mod levels;
pub mod octree;
pub mod pack;
pub mod placement;
pub mod plan;
pub mod portal;
pub mod render;
pub mod scene;
pub mod serve;
pub mod store;
pub mod tour;
pub mod tree;
pub mod walk_volume;
