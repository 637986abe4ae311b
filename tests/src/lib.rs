//! What the end-to-end tests, the demo and the benchmarks share: running the real binaries, plots,
//! pages, sweeps.

pub mod allocation;
pub mod args;
pub mod bench;
pub mod fixture;
pub mod fuzz;
pub mod load;
pub mod namespace;
pub mod page;
pub mod plot;
pub mod poses;
pub mod run;
pub mod zoo;
