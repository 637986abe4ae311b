//! Ray casting: what rays hit, what colour that is, and ground-truth pictures made of both.
//!
//! In: a [`Scene`](crate::scene::Scene) and, where rays must see only some of it, its
//! [`Octree`](crate::octree::Octree). Out: [`Hit`]s and colours ([`Caster`]); pictures and depth
//! maps of a walk.
//!
//! Nothing is culled: both faces of every triangle are hit, `double_sided` or not, and normals are
//! never flipped, so that every renderer that draws both faces shows the same. Results do not
//! depend on threads, on the order of rays in a batch, or on the instruction set of the machine.
//!
//! Measured, M rays/s of CPU time on one thread of a busy two-core machine (primary rays at
//! 1280x720 in blocks of 8 x 8):
//!
//! | scene | triangles | batches | single | incoherent | shading |
//! |---|---|---|---|---|---|
//! | building | 1.35M | 17-21 | 3.3-3.5 | 2.2-2.3 | 45-51 |
//! | furnished rooms, textured | 0.15M | 17 | 5.8 | 4.4 | 19 |
//! | forest, alpha-masked | 1.08M | 2.2-2.3 | 0.8 | 0.6 | 13 |

mod alpha;
mod bvh;
mod caster;
mod cell_set;
mod geometry;
mod lanes;
mod packet;
mod place;
mod ray;
mod shading;
mod single;
#[cfg(test)]
pub(crate) mod test_scenes;
mod triangles;
mod truth;

pub use caster::Caster;
pub use cell_set::CellSet;
pub use geometry::TriangleSource;
pub use ray::{Hit, Ray, RayFootprint};
pub use shading::SurfacePoint;
pub use truth::{Frame, MAX_SAMPLES, MAX_SIDE, RenderError, RenderOptions, render_frame, render_path};
