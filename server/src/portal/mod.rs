//! Stage 5: rooms (row C1 of Rafferty et al. 1998): cells and portals, annotated or found.
//!
//! In: a scene and its caster. Out: [`Rooms`](ldi_protocol::rooms::Rooms): cells as unions of
//! boxes, portals as convex polygons.
//!
//! ```text
//!   scene -> storeys -> basins -> openings -> volumes <-> leaks -> Rooms -> overrides -> plan (SVG)
//!            free space  necks     polygons    3D cells    gaps              corrections
//!   scene's annotations ------------------------------------------^
//!   Rooms -> members (cells of the octree in each) -> zones, images (what a build shows beyond portals); semicircle (the same as of 1998); excess (where the grid takes over)
//! ```
//!
//! What keeps culling conservative. All of space is divided: what is no cell is the outside, which
//! is a place like any other. Cells can see each other only where their borders are open, and
//! every open place of a border has to lie in a portal:
//! 1. where the free space is narrow: doors and windows, found by the watershed, their polygon by
//!    flooding the plane with rays;
//! 2. where storeys are stacked and no surface lies between: hatches, straight from the lines that
//!    also find the floors;
//! 3. everything else (gaps above walls, hatches in walls, missing walls, what 1 and 2 took too
//!    small): rays are cast from all rooms in all directions, and where one changes cells beside
//!    all portals a gap is added, or the two cells are joined.
//!
//! The third is a sample, not a proof: the share of rays that still leak is measured with other
//! rays and reported ([`Statistics::leaking_rays`]).

mod annotated;
mod basins;
mod check;
mod columns;
mod compare;
mod excess;
mod find;
mod floors;
mod hull;
mod images;
mod joints;
mod leaks;
mod members;
mod openings;
mod overrides;
mod plan_svg;
mod seen;
mod semicircle;
mod storeys;
mod volumes;
mod zones;

pub use annotated::annotated_rooms;
pub use check::{JOINT_M, Miss, SightCheck, check_sight, random_poses};
pub use compare::{Comparison, compare};
pub use excess::over_budget;
pub use find::{FoundRooms, Statistics, find_rooms};
pub use images::{NEAR_M, PortalPlans, PortalStatistics, plan_portals};
pub use members::cells_of_rooms;
pub use overrides::{OverrideError, apply_overrides};
pub use plan_svg::plan_svg;
pub(crate) use semicircle::EVERYWHERE;
pub use semicircle::{Semicircle, SemicircleStatistics, SidePlan, plan_semicircles};

#[cfg(test)]
mod tests;
