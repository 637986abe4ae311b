//! What a build would take: the plan and its audit, without an image.

use super::{
    BudgetChoice, BuildError, BuildOptions, Clock, Planned, Progress, RoomFigures, draft_index, plan, planned_camera,
};
use crate::octree;
use crate::pack;
use crate::placement::{self, AuditReport, AuditSize, ImagePlan, PlacementStatistics};
use crate::scene::Note;
use crate::walk_volume::WalkReport;
use ldi_protocol::index::Index;
use serde::Serialize;

/// A dataset before any image is made.
#[derive(Debug)]
pub struct Draft {
    /// As the dataset's would be, but without chunks.
    pub index: Index,
    /// The images to make, in the index's order.
    pub images: Vec<ImagePlan>,
    /// Triangles per cell, counted over the scene.
    pub counts: Vec<u64>,
    /// What placement found.
    pub statistics: PlacementStatistics,
    /// Where people walk.
    pub walk: WalkReport,
    /// Rooms; None without.
    pub rooms: Option<RoomFigures>,
    /// How the budget was found; None if it was given, or nothing was to be placed.
    pub budget: Option<BudgetChoice>,
    /// What of the scene was left out or changed.
    pub notes: Vec<Note>,
    /// Seconds per stage.
    pub seconds: Vec<(&'static str, f64)>,
}

impl DryRun {
    /// In words, for people.
    pub fn said(&self) -> String {
        let images = match (self.images, &self.no_images) {
            (0, Some(why)) => format!("no images: {why}"),
            (images, _) => format!(
                "{images} images of {:.0} megapixels at {} placements; `build` makes a few of them first and says what \
                 all will take",
                self.megapixels, self.placements
            ),
        };
        let choice = self.budget_choice.iter().map(|c| c.said() + "\n").collect::<String>();
        let promises = match self.audit.violations {
            0 => "all promises hold".to_owned(),
            violations => format!("{violations} promises are broken"),
        };
        format!(
            "{choice}{} triangles, at most {} of a budget of {} in a frame\n{images}\n{promises} in {} poses; planned in {:.0} s",
            self.triangles,
            self.audit.max_triangles,
            self.budget,
            self.audit.poses,
            self.seconds.iter().map(|s| s.1).sum::<f64>()
        )
    }
}

impl Draft {
    /// Audits the plan; poses from seed 1.
    pub fn audit(&self, size: AuditSize) -> AuditReport {
        let camera_of = |image: u32| self.images.get(image as usize).map(planned_camera);
        placement::audit(&self.index, &self.counts, &camera_of, size, 1)
    }

    /// Pixels of all images; what nobody sees of them costs little.
    pub fn pixels(&self) -> f64 {
        self.images.iter().map(ImagePlan::pixels).sum()
    }
}

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
    /// Why there are none; None if there are, or nothing is known.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub no_images: Option<String>,
    /// Rooms, and where the grid takes over; None without.
    pub rooms: Option<RoomFigures>,
    /// How the budget was found; None if it was given.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub budget_choice: Option<BudgetChoice>,
    /// Where people walk.
    pub walk: WalkReport,
    /// Seconds per stage.
    pub seconds: Vec<(&'static str, f64)>,
    /// What of the scene was left out or changed.
    pub skipped: Vec<Note>,
    /// The audit of the plan: triangles counted over the scene, footprints of the images to be.
    pub audit: AuditReport,
}

/// Plans a build and audits the plan; also the plan's index. Nothing is written.
///
/// # Errors
/// As [`draft`].
pub fn dry_run(
    options: &BuildOptions,
    size: AuditSize,
    progress: &dyn Progress,
) -> Result<(DryRun, Index), BuildError> {
    let draft = draft(options, progress)?;
    progress.stage("audit", 0);
    let start = std::time::Instant::now();
    let audit = draft.audit(size);
    let mut seconds = draft.seconds.clone();
    seconds.push(("audit", start.elapsed().as_secs_f64()));
    let figures = DryRun {
        triangles: draft.index.scene.triangles,
        budget: draft.index.settings.budget,
        points: draft.index.points.len(),
        placements: draft.index.placements.len(),
        images: draft.images.len(),
        megapixels: draft.pixels() / 1e6,
        no_images: draft.statistics.nothing_to_do,
        rooms: draft.rooms,
        budget_choice: draft.budget,
        walk: draft.walk,
        skipped: draft.notes,
        seconds,
        audit,
    };
    Ok((figures, draft.index))
}

/// Plans a build.
///
/// # Errors
/// As [`super::build`]; also if a triangle is in no cell, in two, or outside of its cell.
pub fn draft(options: &BuildOptions, progress: &dyn Progress) -> Result<Draft, BuildError> {
    let mut clock = Clock::default();
    let Planned { scene, clusters, octree, levels, settings, plan, walk, rooms, budget, .. } =
        plan(options, &mut clock, progress)?;
    let geometry = pack::pack_geometry(&scene, &clusters, &octree, &levels, 0)?;
    let ranges: Vec<_> = (0..octree.cells.len()).map(|c| octree.ranges(&scene, &clusters, c)).collect();
    let bounds: Vec<_> = geometry.cells.iter().map(|c| c.bounds).collect();
    let counts = octree::recount(&scene, &ranges, &bounds)?;
    let images: Vec<ImagePlan> = plan.plans.iter().flat_map(|p| p.images.iter().cloned()).collect();
    let index = draft_index(options, &scene, &settings, &plan, geometry.cells, rooms.as_ref().map(|(r, _)| &r.index));
    let statistics = plan.statistics;
    let rooms = rooms.map(|(r, _)| r.figures);
    let notes = scene.notes.clone();
    Ok(Draft { index, images, counts, statistics, walk, rooms, budget, notes, seconds: clock.laps })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::placement::{Adversary, test_scenes};
    use glam::DVec3;
    use ldi_protocol::CellRuns;
    use ldi_protocol::codec::ColourProfile;

    fn audited(d: &Draft, change: impl FnOnce(&mut Index)) -> AuditReport {
        let mut index = d.index.clone();
        change(&mut index);
        let (images, counts) = (d.images.clone(), d.counts.clone());
        let d = Draft {
            index,
            images,
            counts,
            statistics: d.statistics.clone(),
            walk: d.walk.clone(),
            rooms: None,
            budget: None,
            notes: vec![],
            seconds: vec![],
        };
        d.audit(AuditSize { random: 500, adversarial: 1_400 })
    }

    #[test]
    fn a_budget_for_a_client_is_chosen_and_told() {
        let profile = ldi_protocol::client_profile::ClientProfile::cpu();
        let scenes = vec!["builtin:house?triangles=20000".into()];
        let mut options = crate::build::small_builds::options(scenes, std::path::Path::new(""));
        options.represent = crate::build::Represent::Grid;
        options.budget = crate::build::BudgetRule::For { profile: profile.clone(), bytes_per_scene_byte: 4.0 };
        let d = draft(&options, &()).unwrap();
        let choice = d.budget.expect("it was chosen");
        let camera = options.settings.camera;
        let most = profile.most_triangles(f64::from(camera.width) * f64::from(camera.height));
        assert_eq!((choice.chosen, d.index.settings.budget, d.index.settings.optimize_budget), (most, most, most));
        assert_eq!((choice.trials.len(), d.images.len()), (1, 0));
        assert!(choice.most_bytes >= 4 * 28 * d.index.scene.unique_triangles, "{choice:?}");
        let said = choice.said();
        assert!(said.contains("cpu") && said.contains("no images; taken"), "{said}");
    }

    #[test]
    fn the_audit_passes_a_plan_and_finds_every_promise_that_is_broken() {
        let options = BuildOptions {
            represent: crate::build::Represent::Grid,
            starts: Vec::new(),
            along: None,
            time_limit: None,
            budget: crate::build::BudgetRule::Given,
            scenes: vec!["builtin:house?triangles=20000".into()],
            output: "".into(),
            settings: test_scenes::settings(6_000),
            colour: ColourProfile::Lossless,
        };
        let d = draft(&options, &()).unwrap();
        let kept = audited(&d, |_| {});
        assert_eq!((kept.violations, kept.poses, kept.all_poses()), (0, 500, 1_900));
        assert!(Adversary::ALL.iter().all(|k| kept.adversarial[k.name()].poses == 200), "{:?}", kept.adversarial);

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
        let all = CellRuns::below(d.index.cells.len() as u32);
        assert!(
            faults(audited(&d, |i| i.placements.iter_mut().for_each(|p| p.culled = all.clone())))
                .contains("before all image planes")
        );
        // Every eye takes the placement of a cell beside its own.
        let moved = faults(audited(&d, |i| i.points.iter_mut().for_each(|p| p.position += DVec3::X * 9.0)));
        assert!(moved.contains("cells dropped"), "{moved}");
        let narrow = faults(audited(&d, |i| i.images.iter_mut().for_each(|i| i.window = i.window.map(|t| t * 0.5))));
        assert!(narrow.contains("in no image"), "{narrow}");
    }
}
