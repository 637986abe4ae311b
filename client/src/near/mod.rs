//! Near geometry: a software rasterizer for the clusters of the drawn cells.
//!
//! In: the cells that the selection draws, near to far, and their resident data. Out: colour and
//! disparity of the nearest surface at every pixel centre, [`Source::Near`] where there is one, and
//! counts.
//!
//! # Theory
//!
//! Edge functions after Pineda ("A Parallel Algorithm for Polygon Rasterization", SIGGRAPH 1988);
//! attributes by homogeneous planes after Olano and Greer ("Triangle Scan Conversion using 2D
//! Homogeneous Coordinates", 1997), so that they are perspective-correct and need no clipping;
//! visibility first and shading after it, once per visible pixel (Burns and Hunt, "The Visibility
//! Buffer", JCGT 2013). The depth buffer holds disparity: it is linear in the image and compares
//! directly with the warp's.
//!
//! # Practice
//!
//! 1. `gather`: cells to draws (cluster, placement), in the order of the cells. Absent data is
//!    counted.
//! 2. `triangle_setup`: vertices to eye space in f64, outcodes, clipping at the near plane only,
//!    edges and disparity plane of each triangle. Triangles are listed per band of
//!    `triangle_setup::BAND_ROWS` rows. Batches bound the memory, and objects hidden by previous
//!    batches are rejected (`horizon`).
//! 3. `raster`: bands in parallel. Within a band triangles are drawn in the order of the draws,
//!    those with an alpha test last, so that fewer tests are made. The picture does not depend on
//!    the number of threads. The first of equally near triangles wins.
//! 4. `shade`: bands in parallel; colours of the visible pixels, eight neighbours at a time
//!    (`shade_simd`), from the triangles' `attributes`.
//!
//! Coverage: a pixel belongs to the triangle that contains its centre; on an edge, to the triangle
//! on whose left or top side the edge lies. Both triangles of an edge evaluate the same expression
//! with opposite signs, so a shared edge leaves neither gap nor overlap. Vertices are transformed
//! in f64 from exact mesh positions, so that clusters of one mesh meet bit for bit. Both faces are
//! drawn.

mod alpha;
mod attributes;
pub(crate) mod gather;
mod horizon;
mod lane_math;
mod raster;
mod shade;
mod shade_simd;
mod stats;
#[cfg(test)]
mod tests;
mod triangle_setup;

pub(crate) use attributes::ABSENT_TEXEL;
pub use stats::NearStats;
pub use triangle_setup::NEAR_PLANE_M;

use crate::{
    frame::{Frame, Source},
    resident::Resident,
};
use gather::Gathered;
use ldi_protocol::{
    OutputCamera, Pose,
    index::{DrawnCell, Index},
};
use rayon::prelude::*;

/// Largest picture side, pixels: the records of the rasterizer keep columns and rows in 16 bits.
pub const MAX_SIDE_PX: u32 = 16_384;

/// Triangles of the first batch; each batch is twice as large as the previous one, since more is
/// hidden. Smaller: the first batch hides little.
const FIRST_BATCH_TRIANGLES: usize = 1 << 14;
/// Triangles of the largest batch. Larger: more memory; smaller: more synchronisation.
const LARGEST_BATCH_TRIANGLES: usize = 1 << 18;
/// Triangles per task of a batch. Larger: less balance between threads; smaller: more overhead.
const TASK_TRIANGLES: usize = 1 << 13;

/// The rasterizer, with buffers reused between frames.
#[derive(Debug, Default)]
pub struct Rasterizer {
    ids: Vec<u32>,
    tasks: Vec<triangle_setup::Task>,
    horizon: horizon::Horizon,
    blocks: gather::BlockCache,
}

impl Rasterizer {
    /// Draws `cells` into `frame`, which is resized and cleared. Pixels without a triangle stay
    /// unpainted.
    ///
    /// `cells` are positions in `index.cells`, nearer ones first, which rejects more and decides
    /// between coplanar triangles. Cells beyond the index are ignored.
    pub fn draw(
        &mut self,
        index: &Index,
        resident: &dyn Resident,
        cells: &[DrawnCell],
        camera: &OutputCamera,
        pose: &Pose,
        frame: &mut Frame,
    ) -> NearStats {
        self.draw_gathered(gather::gather(index, resident, cells), (camera, pose), frame)
    }

    /// Draws what was gathered, as [`draw`](Self::draw).
    pub(crate) fn draw_gathered(
        &mut self,
        mut scene: Gathered<'_>,
        (camera, pose): (&OutputCamera, &Pose),
        frame: &mut Frame,
    ) -> NearStats {
        frame.reset(camera.width.min(MAX_SIDE_PX), camera.height.min(MAX_SIDE_PX));
        self.ids.clear();
        self.ids.resize(frame.len(), triangle_setup::NO_TRIANGLE);
        scene.hold_blocks(&mut self.blocks);
        if frame.is_empty() {
            return scene.stats;
        }
        let projection = triangle_setup::Projection::new(camera, pose);
        let band_pixels = frame.width as usize * triangle_setup::BAND_ROWS;
        self.horizon.reset(projection.width, projection.height);
        for batch in scene.batches(FIRST_BATCH_TRIANGLES, LARGEST_BATCH_TRIANGLES) {
            let tasks = scene.tasks(batch, TASK_TRIANGLES);
            if self.tasks.len() < tasks.len() {
                self.tasks.resize_with(tasks.len(), triangle_setup::Task::default);
            }
            let active = &mut self.tasks[..tasks.len()];
            let horizon = &self.horizon;
            active.par_iter_mut().zip(tasks).for_each(|(task, range)| task.fill(&scene, range, &projection, horizon));
            let active = &*active;
            frame
                .disparity
                .par_chunks_mut(band_pixels)
                .zip(self.ids.par_chunks_mut(band_pixels))
                .enumerate()
                .with_max_len(1)
                .for_each(|(band, (disparity, ids))| {
                    let mut target = raster::Band::new(band, projection.width, disparity, ids);
                    for masked in [false, true] {
                        for task in active {
                            target.draw(task, masked, &scene, &projection);
                        }
                    }
                });
            self.horizon.update(&frame.disparity, projection.width);
        }
        frame
            .colour
            .par_chunks_mut(band_pixels)
            .zip(frame.source.par_chunks_mut(band_pixels))
            .zip(self.ids.par_chunks(band_pixels))
            .enumerate()
            .with_max_len(1)
            .for_each(|(band, ((colour, source), ids))| {
                shade::shade_band(&scene, &projection, band * triangle_setup::BAND_ROWS, ids, colour);
                for (s, id) in source.iter_mut().zip(ids) {
                    if *id != triangle_setup::NO_TRIANGLE {
                        *s = Source::Near;
                    }
                }
            });
        scene.stats
    }
}
