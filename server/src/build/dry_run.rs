//! What a build would take: the plan and its audit, without an image.

use super::{BuildError, BuildOptions, Clock, Planned, Progress, images::Images, index_of, plan, planned_camera};
use crate::octree;
use crate::pack;
use crate::placement::{self, AuditReport, AuditSize, ImagePlan};
use ldi_protocol::index::Index;
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

/// Plans a build and audits the plan over poses. Nothing is written.
///
/// # Errors
/// As [`super::build`]; also if a triangle is in no cell, in two, or outside of its cell.
pub fn dry_run(options: &BuildOptions, size: AuditSize, progress: &dyn Progress) -> Result<DryRun, BuildError> {
    let mut clock = Clock::default();
    let Draft { index, images, counts } = draft(options, &mut clock, progress)?;
    progress.stage("audit", 0);
    let camera_of = |image: u32| images.get(image as usize).map(planned_camera);
    let audit = placement::audit(&index, &counts, &camera_of, size, 1);
    clock.lap("audit");
    Ok(DryRun {
        triangles: index.scene.triangles,
        budget: index.settings.budget,
        points: index.points.len(),
        placements: index.placements.len(),
        images: images.len(),
        megapixels: images.iter().map(ImagePlan::pixels).sum::<f64>() / 1e6,
        seconds: clock.laps,
        audit,
    })
}

/// A dataset before any image is made.
struct Draft {
    index: Index,
    images: Vec<ImagePlan>,
    /// Triangles per cell, counted over the scene.
    counts: Vec<u64>,
}

fn draft(options: &BuildOptions, clock: &mut Clock, progress: &dyn Progress) -> Result<Draft, BuildError> {
    let Planned { scene, clusters, octree, settings, plan } = plan(options, clock, progress)?;
    let geometry = pack::pack_geometry(&scene, &clusters, &octree, 0)?;
    let ranges: Vec<_> = (0..octree.cells.len()).map(|c| octree.ranges(&scene, &clusters, c)).collect();
    let bounds: Vec<_> = geometry.cells.iter().map(|c| c.bounds).collect();
    let counts = octree::recount(&scene, &ranges, &bounds)?;
    let images: Vec<ImagePlan> = plan.plans.iter().flat_map(|p| p.images.iter().cloned()).collect();
    let (placements, entries) = Images::none_of(&plan.plans).placements(&plan.plans, 0);
    let index = index_of(options, &scene, settings, plan, (geometry.cells, vec![]), vec![], (placements, entries));
    Ok(Draft { index, images, counts })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::placement::{ADVERSARIES, test_scenes};
    use glam::DVec3;
    use ldi_protocol::codec::ColourMode;

    struct Silent;
    impl Progress for Silent {
        fn stage(&self, _: &str, _: u64) {}
        fn advance(&self, _: u64) {}
    }

    fn audited(d: &Draft, change: impl FnOnce(&mut Index)) -> AuditReport {
        let mut index = d.index.clone();
        change(&mut index);
        let size = AuditSize { random: 500, adversarial: 1_400 };
        placement::audit(&index, &d.counts, &|i| d.images.get(i as usize).map(planned_camera), size, 1)
    }

    #[test]
    fn the_audit_passes_a_plan_and_finds_every_promise_that_is_broken() {
        let options = BuildOptions {
            scene: "builtin:house?triangles=20000".into(),
            output: "".into(),
            settings: test_scenes::settings(6_000),
            colour: ColourMode::LOSSLESS,
        };
        let d = draft(&options, &mut Clock::default(), &Silent).unwrap();
        let kept = audited(&d, |_| {});
        assert_eq!((kept.violations, kept.poses, kept.all_poses()), (0, 500, 1_900));
        assert!(ADVERSARIES.iter().all(|k| kept.adversarial[k].poses == 200), "{:?}", kept.adversarial);

        let faults = |r: AuditReport| {
            assert!(r.violations > 0);
            r.worst_poses.into_iter().flat_map(|p| p.faults).collect::<Vec<_>>().join("; ")
        };
        let below = kept.max_triangles - 1;
        assert!(faults(audited(&d, |i| i.settings.budget = below)).contains("triangles, budget"));
        let tight = kept.max_footprint_px * 0.9;
        assert!(
            faults(audited(&d, |i| i.placements.iter_mut().for_each(|p| p.footprint_px = tight))).contains("footprint")
        );
        let all: Vec<u32> = (0..d.index.cells.len() as u32).collect();
        assert!(
            faults(audited(&d, |i| i.placements.iter_mut().for_each(|p| p.culled = all.clone())))
                .contains("before all image planes")
        );
        // Every eye takes the placement of a cell beside its own.
        let moved = faults(audited(&d, |i| i.points.iter_mut().for_each(|p| p.position += DVec3::X * 9.0)));
        assert!(moved.contains("not among the placement's users"), "{moved}");
        let narrow = faults(audited(&d, |i| i.images.iter_mut().for_each(|i| i.window = i.window.map(|t| t * 0.5))));
        assert!(narrow.contains("in no image"), "{narrow}");
    }
}
