//! What a build would take: the plan and its audit, without an image.

use super::{BuildError, BuildOptions, Clock, Planned, Progress, images::Images, index_of, plan, planned_camera};
use crate::octree;
use crate::pack;
use crate::placement::{self, AuditReport, ImagePlan};
use serde::Serialize;

/// Figures of a build that was planned only.
#[derive(Debug, Clone, Serialize)]
pub struct DryRun {
    /// Triangles of the scene, instances counted.
    pub triangles: u64,
    /// Geometry budget.
    pub budget: u64,
    /// Grid points in use.
    pub points: usize,
    /// Placements.
    pub placements: usize,
    /// Images to make.
    pub images: usize,
    /// Their pixels, millions; what nobody sees of them costs little.
    pub megapixels: f64,
    /// Seconds per stage.
    pub seconds: Vec<(&'static str, f64)>,
    /// The audit of the plan: triangles counted over the scene, footprints of the images to be.
    pub audit: AuditReport,
}

/// Plans a build and audits the plan over `poses` poses. Nothing is written.
///
/// # Errors
/// As [`super::build`]; also if a triangle is in no cell, in two, or outside of its cell.
pub fn dry_run(options: &BuildOptions, poses: u64, progress: &dyn Progress) -> Result<DryRun, BuildError> {
    let mut clock = Clock::default();
    let Planned { scene, clusters, octree, settings, plan } = plan(options, &mut clock, progress)?;
    progress.stage("audit", 0);
    let geometry = pack::pack_geometry(&scene, &clusters, &octree, 0)?;
    let ranges: Vec<_> = (0..octree.cells.len()).map(|c| octree.ranges(&scene, &clusters, c)).collect();
    let bounds: Vec<_> = geometry.cells.iter().map(|c| c.bounds).collect();
    let counts = octree::recount(&scene, &ranges, &bounds)?;
    let images: Vec<ImagePlan> = plan.plans.iter().flat_map(|p| p.images.iter().cloned()).collect();
    let (placements, entries) = Images::none_of(&plan.plans).placements(&plan.plans, 0);
    let index = index_of(options, &scene, settings, plan, (geometry.cells, vec![]), vec![], (placements, entries));
    let camera_of = |image: u32| images.get(image as usize).map(planned_camera);
    let audit = placement::audit(&index, &counts, &camera_of, poses, 1);
    clock.lap("audit");
    Ok(DryRun {
        triangles: scene.triangles(),
        budget: index.settings.budget,
        points: index.points.len(),
        placements: index.placements.len(),
        images: images.len(),
        megapixels: images.iter().map(ImagePlan::pixels).sum::<f64>() / 1e6,
        seconds: clock.laps,
        audit,
    })
}
