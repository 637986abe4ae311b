//! What the end-to-end tests and the demo share: running the real binaries, plots and the page.

pub mod page;
pub mod plot;
pub mod run;
