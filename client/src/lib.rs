//! The client: streams a dataset, draws the near geometry, warps the layered depth images of the
//! rest, and shows it in a window.

pub mod app;
pub mod cache;
pub mod calibrate;
pub mod composite;
pub mod engine;
pub mod frame;
pub mod gpu;
pub mod impostor;
mod memory;
pub mod metrics;
pub mod near;
pub mod report;
pub mod resident;
mod simd;
pub mod stream;
#[cfg(test)]
mod test_support;
pub mod tree;
pub mod warp;
