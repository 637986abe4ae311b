//! `ldi-bench`: sweeps over settings, as tables, plots and a page. Rows are kept as JSON, from
//! which everything else is made.

pub mod colours;
pub mod decode;
pub mod docs;
pub mod matrix;
pub mod matrix_page;
pub mod numerics;
pub mod numerics_page;
pub mod occlusion;
pub mod placement;
pub mod placement_page;
pub mod portals;
pub mod portals_page;
pub mod searches;
pub mod speed_error;
pub mod speed_error_page;
pub mod streaming;
pub mod tree;
pub mod video;
