//! The audit of all promises, and what `plan` answers.
//!
//! In: a dataset's index, triangles per cell counted again over the scene, the cameras of its
//! images, a number of poses. Out: an [`AuditReport`]. Nothing here uses what the planner
//! computed: cells are tested by another formula (middle and half size against unnormalized
//! planes, where the renderer takes supports of unit normals), levels of detail are chosen by the
//! deviation that shows in the picture, and footprints are measured by finite differences at
//! points of the replaced cells. Triangles of cells in full are the caller's own count, those of
//! levels the index's, which `verify` compares with their chunks.
//!
//! Poses: random ones, anywhere in the walk volume and looking anywhere within the built pitch;
//! and adversarial ones, which seek trouble on borders ([`Adversary`]), found by bisection.

mod levels;
mod rooms;

pub use levels::{LevelAudit, audit_levels};

use glam::DVec3;
use ldi_protocol::{
    Aabb, Pose, ViewBasis,
    index::{CellEntry, DrawnCell, ImageEntry, Index, Placement},
    ldi::LdiCamera,
    rooms::CellId,
    select::{draw_list, placement_of, select, was_made},
    volume::WalkVolume,
};
use rayon::prelude::*;
use serde::Serialize;
use std::collections::BTreeMap;

/// What the audit found.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct AuditReport {
    /// Random poses looked at.
    pub poses: u64,
    /// Poses that broke a promise, adversarial ones included.
    pub violations: u64,
    /// Largest number of triangles drawn, adversarial poses included.
    pub max_triangles: u64,
    /// Largest footprint measured, adversarial poses included, output pixels.
    pub max_footprint_px: f64,
    /// Largest deviation that a drawn level of detail may show, output pixels.
    pub max_deviation_px: f64,
    /// Adversarial poses, by name of [`Adversary`].
    pub adversarial: BTreeMap<&'static str, Tally>,
    /// Poses that broke a promise, then those with the most triangles; at most [`WORST`].
    pub worst_poses: Vec<AuditedPose>,
}

impl AuditReport {
    /// All poses looked at.
    pub fn all_poses(&self) -> u64 {
        self.poses + self.adversarial.values().map(|t| t.poses).sum::<u64>()
    }
}

/// Adversarial poses of one kind.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct Tally {
    /// How many.
    pub poses: u64,
    /// How many broke a promise.
    pub violations: u64,
    /// Largest number of triangles drawn.
    pub max_triangles: u64,
    /// Largest footprint measured, output pixels.
    pub max_footprint_px: f64,
}

/// One pose of the audit.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct AuditedPose {
    /// Number of the pose; adversarial ones come after the random ones.
    pub index: u64,
    /// `random`, or the name of an [`Adversary`].
    pub kind: &'static str,
    /// Eye, metres.
    pub position: [f64; 3],
    /// Degrees.
    pub yaw_deg: f64,
    /// Degrees.
    pub pitch_deg: f64,
    /// Grid point.
    pub grid_point: Option<u32>,
    /// Placement.
    pub placement: Option<u32>,
    /// Triangles drawn, counted again.
    pub triangles: u64,
    /// Largest footprint measured, output pixels; 0 without an image.
    pub footprint_px: f64,
    /// Largest deviation that a drawn level of detail may show, output pixels.
    pub deviation_px: f64,
    /// What is wrong; empty when all promises are kept.
    pub faults: Vec<String>,
}

/// What `plan` answers for a pose.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct PlanRow {
    /// Number of the pose.
    pub index: u64,
    /// Grid point.
    pub grid_point: Option<u32>,
    /// Placement.
    pub placement: Option<u32>,
    /// Cells that its image replaces.
    pub culled_cells: Vec<u32>,
    /// Cells drawn as geometry, near to far.
    pub drawn_cells: Vec<u32>,
    /// Their levels of detail; 0: in full.
    pub drawn_levels: Vec<u8>,
    /// Triangles in them.
    pub triangles: u64,
    /// The image's footprint bound, output pixels; None without an image.
    pub footprint_px: Option<f64>,
    /// Rooms drawn as geometry, by number; null is the outside. Empty in a dataset without rooms.
    pub rooms: Vec<CellId>,
    /// Portals beyond which images show, nearest first: [portal, side, placement].
    pub portals: Vec<[u32; 3]>,
    /// Cells left out because the budget was used up.
    pub dropped: u32,
}

/// How many poses a report lists.
pub const WORST: usize = 16;
/// Points of replaced cells at which a pose's footprint is measured.
const FOOTPRINT_POINTS: usize = 64;

/// What `select` answers for a pose, for a picture as planned.
pub fn plan_row(index: &Index, number: u64, pose: &Pose) -> PlanRow {
    let camera = &index.settings.camera;
    let list = draw_list(index, pose, (camera.half_tan_x(), camera.half_tan_y()));
    let placement = list.selection.placement.and_then(|p| index.placements.get(p as usize));
    let of_portals = list.portals.iter().filter_map(|p| index.placements.get(p.placement as usize));
    let placements = placement.into_iter().chain(of_portals);
    PlanRow {
        index: number,
        grid_point: list.selection.grid_point,
        placement: list.selection.placement,
        culled_cells: placement.map(|p| p.culled.iter().collect()).unwrap_or_default(),
        drawn_levels: list.cells.iter().map(|c| c.level).collect(),
        drawn_cells: list.cell_numbers(),
        triangles: list.triangles,
        footprint_px: placements.map(|p| p.footprint_px).reduce(f64::max),
        portals: list.portals.iter().map(|p| [p.portal, p.side as u32, p.placement]).collect(),
        rooms: list.rooms,
        dropped: list.dropped,
    }
}

/// Kinds of adversarial poses.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Adversary {
    /// On the border of an angular range of its grid point, or a hair beside it.
    RangeBorder,
    /// On the border of a pitch band, or a hair beside it.
    BandBorder,
    /// Looking as far up or down as was built for, or so that the upper or lower edge of the
    /// picture is vertical.
    Pole,
    /// Between two eyes, where the grid point changes.
    PointBorder,
    /// Where turning the head changes what is selected: the rim of a reverse frustum in the
    /// paper's grid.
    DirectionBorder,
    /// As far from its grid point as the volume or the next point allows: the rim of a star-shape.
    Rim,
    /// A side of the planning frustum touches the corner of a cell.
    CellCorner,
}

impl Adversary {
    /// All kinds.
    pub const ALL: [Self; 7] = [
        Self::RangeBorder,
        Self::BandBorder,
        Self::Pole,
        Self::PointBorder,
        Self::DirectionBorder,
        Self::Rim,
        Self::CellCorner,
    ];

    /// Its name in reports.
    pub fn name(self) -> &'static str {
        match self {
            Self::RangeBorder => "range border",
            Self::BandBorder => "band border",
            Self::Pole => "pole",
            Self::PointBorder => "point border",
            Self::DirectionBorder => "direction border",
            Self::Rim => "rim",
            Self::CellCorner => "cell corner",
        }
    }
}

/// How many poses an audit looks at.
#[derive(Debug, Clone, Copy)]
pub struct AuditSize {
    /// Random ones.
    pub random: u64,
    /// Adversarial ones, of all kinds together.
    pub adversarial: u64,
}

/// Cells in a run that is tested against a picture as one first: the octree's order makes runs
/// compact.
const RUN: usize = 64;

/// Audits a dataset over poses drawn from `seed`.
///
/// `recounted`: triangles per cell, counted by the caller over the scene's own triangles (not the
/// index's numbers). `camera_of`: the LDI camera of an image, None where it is empty. A dataset
/// without a walk volume has no poses and passes.
pub fn audit(
    index: &Index,
    recounted: &[u64],
    camera_of: &(dyn Fn(u32) -> Option<LdiCamera> + Sync),
    size: AuditSize,
    seed: u64,
) -> AuditReport {
    let mut report = AuditReport::default();
    let Some(volume) = index.volume.as_ref().filter(|v| !v.is_empty()) else { return report };
    let sampler = volume.sampler();
    let cameras: Vec<Option<LdiCamera>> = (0..index.images.len() as u32).into_par_iter().map(camera_of).collect();
    let runs: Vec<Aabb> =
        index.cells.chunks(RUN).map(|cells| cells.iter().fold(Aabb::EMPTY, |all, c| all.union(c.bounds))).collect();
    // Bounded batches, folded in order: the same report from any number of threads.
    let poses = size.random.saturating_add(size.adversarial);
    for first in (0..poses).step_by(4096) {
        let batch: Vec<AuditedPose> = (first..poses.min(first + 4096))
            .into_par_iter()
            .filter_map(|i| {
                let mut random =
                    Random(seed.wrapping_mul(0x2545_f491_4f6c_dd1d) ^ i.wrapping_mul(0x9e37_79b9_7f4a_7c15));
                let mut eye = || sampler.point(std::array::from_fn(|_| random.unit()));
                let (position, other) = (eye()?, eye()?);
                let pitch_deg = (random.unit() * 2.0 - 1.0) * index.settings.pitch_deg;
                let mut pose = Pose { position, yaw_deg: random.unit() * 360.0, pitch_deg };
                let mut kind = "random";
                if let Some(k) = i.checked_sub(size.random) {
                    let adversary = Adversary::ALL[k as usize % Adversary::ALL.len()];
                    kind = adversary.name();
                    pose = adversarial(index, volume, adversary, pose, other, &mut random);
                }
                Some(check(index, recounted, &runs, &cameras, (i, kind), &pose, &mut random))
            })
            .collect();
        for p in batch {
            let broken = u64::from(!p.faults.is_empty());
            if p.index < size.random {
                report.poses += 1;
            } else {
                let tally = report.adversarial.entry(p.kind).or_default();
                tally.poses += 1;
                tally.violations += broken;
                tally.max_triangles = tally.max_triangles.max(p.triangles);
                tally.max_footprint_px = tally.max_footprint_px.max(p.footprint_px);
            }
            report.violations += broken;
            report.max_triangles = report.max_triangles.max(p.triangles);
            report.max_footprint_px = report.max_footprint_px.max(p.footprint_px);
            report.max_deviation_px = report.max_deviation_px.max(p.deviation_px);
            report.worst_poses.push(p);
        }
        report.worst_poses.sort_by(|a, b| {
            a.faults
                .is_empty()
                .cmp(&b.faults.is_empty())
                .then(b.triangles.cmp(&a.triangles))
                .then(a.index.cmp(&b.index))
        });
        report.worst_poses.truncate(WORST);
    }
    report
}

/// A pose that seeks trouble, made from a random one and another eye of the volume.
fn adversarial(
    index: &Index,
    volume: &WalkVolume,
    kind: Adversary,
    mut pose: Pose,
    other: DVec3,
    random: &mut Random,
) -> Pose {
    let limit = index.settings.pitch_deg;
    let eye = pose.position;
    let nudge = [0.0, 1e-9, -1e-9][random.below(3)];
    match kind {
        Adversary::RangeBorder => {
            let ranges: Vec<f64> = select(index, &pose)
                .grid_point
                .map(|g| index.points[g as usize].bands.iter().flatten().map(|r| r.yaw_start_deg).collect())
                .unwrap_or_default();
            if !ranges.is_empty() {
                pose.yaw_deg = ranges[random.below(ranges.len())] + nudge;
            }
        }
        Adversary::BandBorder => {
            if let Some(border) = index.pitch_bands_deg.get(random.below(index.pitch_bands_deg.len())) {
                pose.pitch_deg = (border + nudge).clamp(-limit, limit);
            }
        }
        Adversary::Pole => {
            let upright = 90.0 - index.settings.square_half_tan().atan().to_degrees();
            let pitch = if random.unit() < 0.5 { limit } else { upright.min(limit) };
            pose.pitch_deg = if random.unit() < 0.5 { pitch } else { -pitch };
        }
        Adversary::PointBorder => {
            let at = |position| select(index, &Pose { position, ..pose }).grid_point;
            let toward = (other - eye) * (8.0 / (other - eye).length().max(8.0));
            let from = at(eye);
            if at(eye + toward) != from {
                let [low, high] = border(|t| at(eye + toward * t) == from);
                pose.position = eye + toward * if random.unit() < 0.5 { low } else { high };
            }
        }
        Adversary::DirectionBorder => {
            let turn = (random.unit() * 2.0 - 1.0) * 90.0;
            let at = |yaw_deg| select(index, &Pose { yaw_deg, ..pose });
            let (yaw, from) = (pose.yaw_deg, at(pose.yaw_deg));
            if at(yaw + turn) != from {
                let [low, high] = border(|t| at(yaw + turn * t) == from);
                pose.yaw_deg = yaw + turn * if random.unit() < 0.5 { low } else { high };
            }
        }
        Adversary::Rim => {
            if let Some(point) = select(index, &pose).grid_point {
                let away = (eye - index.points[point as usize].position).normalize_or_zero() * 16.0;
                let stays = |position| {
                    volume.contains(position) && select(index, &Pose { position, ..pose }).grid_point == Some(point)
                };
                pose.position = eye + away * border(|t| stays(eye + away * t))[0];
            }
        }
        Adversary::CellCorner => {
            let Some(cell) = index.cells.get(random.below(index.cells.len())) else { return pose };
            let corners = cell.bounds.corners();
            let to = corners[random.below(corners.len())] - eye;
            let ahead = (-to.x).atan2(-to.z).to_degrees();
            let turn = if random.unit() < 0.5 { 120.0 } else { -120.0 };
            let t = index.settings.square_half_tan();
            let inside = |yaw: f64| {
                let basis = ViewBasis::from_yaw_pitch(yaw, pose.pitch_deg);
                to.dot(basis.right).abs() <= t * to.dot(basis.forward)
            };
            let [low, high] = border(|s| inside(ahead + turn * s));
            pose.yaw_deg = ahead + turn * if random.unit() < 0.5 { low } else { high };
        }
    }
    // Between two eyes there may be a wall.
    if !volume.contains(pose.position) {
        pose.position = eye;
    }
    pose
}

/// Two neighbouring values in 0 ..= 1 around a change: `holds` at the first, unless it nowhere
/// does, and not at the second.
fn border(holds: impl Fn(f64) -> bool) -> [f64; 2] {
    let (mut low, mut high) = (0.0, 1.0);
    for _ in 0..48 {
        let middle = (low + high) * 0.5;
        *(if holds(middle) { &mut low } else { &mut high }) = middle;
    }
    [low, high]
}

/// Triangles of cells as counted again; as the index says of levels, and where nobody counted.
fn triangles_in(index: &Index, recounted: &[u64], cells: &[DrawnCell]) -> u64 {
    let counted = |c: &DrawnCell| recounted.get(c.cell as usize).filter(|_| c.level == 0).copied();
    let listed = |c: &DrawnCell| index.mesh_of(*c).map_or(0, |m| m.triangles.into());
    cells.iter().map(|c| counted(c).unwrap_or_else(|| listed(c))).sum()
}

/// The deviation that a level of a cell may show in the picture's corners, output pixels.
fn deviation_px(index: &Index, entry: &CellEntry, deviation_m: f64, eye: DVec3) -> f64 {
    let camera = &index.settings.camera;
    let apart = (eye.max(entry.bounds.min).min(entry.bounds.max)).distance(eye);
    let corner2 = 1.0 + camera.half_tan_x().powi(2) + camera.half_tan_y().powi(2);
    if deviation_m == 0.0 { 0.0 } else { deviation_m * camera.focal_px() * corner2 / apart }
}

/// The coarsest level of a cell that shows no more deviation than is promised.
fn coarsest(index: &Index, cell: u32, eye: DVec3) -> DrawnCell {
    let entry = &index.cells[cell as usize];
    let is_good = |m: f64| deviation_px(index, entry, m, eye) <= index.settings.max_deviation_px * (1.0 - 1e-12);
    let level = entry.levels.iter().take_while(|l| is_good(l.deviation_m)).count() as u8;
    DrawnCell { cell, level }
}

/// The largest deviation that drawn levels may show, output pixels, and whether it is as promised.
fn check_deviation(index: &Index, cells: &[DrawnCell], eye: DVec3, faults: &mut Vec<String>) -> f64 {
    let of = |c: &DrawnCell| {
        let m = index.mesh_of(*c).map_or(0.0, |m| m.deviation_m);
        deviation_px(index, &index.cells[c.cell as usize], m, eye)
    };
    let largest = cells.iter().map(of).fold(0.0, f64::max);
    let promised = index.settings.max_deviation_px;
    if largest > promised * (1.0 + 1e-9) {
        faults.push(format!("a deviation of {largest} px, promised {promised} px"));
    }
    largest
}

/// Checks one pose.
fn check(
    index: &Index,
    recounted: &[u64],
    runs: &[Aabb],
    cameras: &[Option<LdiCamera>],
    (number, kind): (u64, &'static str),
    pose: &Pose,
    random: &mut Random,
) -> AuditedPose {
    let camera = &index.settings.camera;
    let (tx, ty) = (camera.half_tan_x(), camera.half_tan_y());
    let list = draw_list(index, pose, (tx, ty));
    if let Some(rooms) = &index.rooms
        && list.selection.grid_point.is_none()
    {
        return rooms::check(index, rooms, &list, recounted, cameras, (number, kind), pose, random);
    }
    let basis = pose.basis();
    let selection = select(index, pose);
    let placement = selection.placement.and_then(|p| index.placements.get(p as usize));
    let mut faults = Vec::new();
    if selection.grid_point.is_none() && !index.points.is_empty() {
        faults.push("no grid point".to_string());
    }
    let square = tx.max(ty);
    let mut triangles = 0;
    let in_picture = |b: &Aabb| in_view(b, pose.position, &basis, tx.min(square), ty.min(square));
    let run_shows: Vec<bool> = runs.iter().map(in_picture).collect();
    for run in (0..runs.len()).filter(|run| run_shows[*run]) {
        for (cell, entry) in (run * RUN..).zip(&index.cells[run * RUN..]).take(RUN) {
            let cell = cell as u32;
            if in_picture(&entry.bounds)
                && in_view(&entry.bounds, pose.position, &basis, square, square)
                && !placement.is_some_and(|p| p.culled.contains(cell))
            {
                triangles += triangles_in(index, recounted, &[coarsest(index, cell, pose.position)]);
            }
        }
    }
    // Where all else comes from the tree the nearest cells are drawn; what a build had no time for
    // is promised no more than that.
    let named = selection.grid_point.and_then(|g| placement_of(index, g, pose));
    let unmade = named.and_then(|p| index.placements.get(p as usize)).is_some_and(|p| !was_made(p));
    let by_tree = index.walks_by_tree() || unmade;
    if by_tree {
        triangles = triangles_in(index, recounted, &list.cells);
    }
    if triangles > index.settings.budget {
        faults.push(format!("{triangles} triangles, budget {}", index.settings.budget));
    }
    if list.dropped > 0 && !by_tree {
        faults.push(format!("{} cells dropped", list.dropped));
    }
    let deviation_px = check_deviation(index, &list.cells, pose.position, &mut faults);
    let mut footprint_px = 0.0;
    if let Some(p) = placement {
        if !p.users.inflated(1e-6).contains(pose.position) {
            faults.push("the eye is not among the placement's users".to_string());
        }
        let images = &index.images[p.images.start as usize..p.images.end as usize];
        let before = |i: &ImageEntry, q: DVec3| (q - p.cop).dot(i.basis.forward) < i.plane_distance;
        if images.iter().any(|i| !before(i, pose.position)) {
            faults.push("the eye is beyond an image plane".to_string());
        }
        let beyond =
            |i: &ImageEntry, b: &Aabb| -b.support(-i.basis.forward) >= p.cop.dot(i.basis.forward) + i.plane_distance;
        // Faces that nobody looks at have no image: what lies beyond them alone is in no picture.
        let stray = |b: &Aabb| in_picture(b) && !images.iter().any(|i| beyond(i, b));
        let mut shown = p.culled.iter().map(|c| c as usize).filter(|c| run_shows[c / RUN]);
        if shown.any(|c| stray(&index.cells[c].bounds)) {
            faults.push("a replaced cell in the picture reaches before all image planes".to_string());
        }
        match largest_footprint(index, p, cameras, pose, &basis, random) {
            Some(largest) => footprint_px = largest,
            None => faults.push("a point of a replaced cell is in the picture, but in no image".to_string()),
        }
        if footprint_px > p.footprint_px * (1.0 + 1e-6)
            || p.footprint_px > index.settings.max_footprint_px * (1.0 + 1e-9)
        {
            faults.push(format!("footprint {footprint_px} px, bound {} px", p.footprint_px));
        }
    }
    AuditedPose {
        index: number,
        kind,
        position: pose.position.to_array(),
        yaw_deg: pose.yaw_deg,
        pitch_deg: pose.pitch_deg,
        grid_point: selection.grid_point,
        placement: selection.placement,
        triangles,
        footprint_px,
        deviation_px,
        faults,
    }
}

/// The four-plane box test by middle and half size, with unnormalized planes.
fn in_view(b: &Aabb, eye: DVec3, basis: &ViewBasis, tx: f64, ty: f64) -> bool {
    let (c, h) = (b.centre() - eye, b.size() * 0.5);
    [
        basis.right + basis.forward * tx,
        basis.forward * tx - basis.right,
        basis.up + basis.forward * ty,
        basis.forward * ty - basis.up,
    ]
    .iter()
    .all(|n| n.dot(c) + n.abs().dot(h) >= -1e-12 * (1.0 + c.length()))
}

/// The largest footprint at points of replaced cells that lie in the picture; None if one of them
/// lies in no image.
fn largest_footprint(
    index: &Index,
    p: &Placement,
    cameras: &[Option<LdiCamera>],
    pose: &Pose,
    basis: &ViewBasis,
    random: &mut Random,
) -> Option<f64> {
    let camera = &index.settings.camera;
    let (tx, ty) = (camera.half_tan_x(), camera.half_tan_y());
    let mut largest = 0.0f64;
    let replaced = p.culled.len();
    for _ in 0..FOOTPRINT_POINTS {
        let Some(cell) = p.culled.nth(random.below(replaced)) else { break };
        let b = &index.cells[cell as usize].bounds;
        // Corners and inner points alike.
        let at = DVec3::new(random.unit(), random.unit(), random.unit());
        let q = b.min + b.size() * if random.unit() < 0.5 { at.round() } else { at };
        let v = q - pose.position;
        let z = v.dot(basis.forward);
        if z > 0.0 && v.dot(basis.right).abs() <= tx * z && v.dot(basis.up).abs() <= ty * z {
            let mut held = false;
            for number in p.images.clone().map(|i| i as usize).filter(|i| holds(p, &index.images[*i], q)) {
                held = true;
                if let Some(ldi) = cameras.get(number).and_then(Option::as_ref) {
                    largest = largest.max(footprint(index, ldi, pose, basis, q));
                }
            }
            if !held {
                return None;
            }
        }
    }
    Some(largest)
}

/// Whether an image's window holds a point beyond its plane, to within rounding.
fn holds(p: &Placement, image: &ImageEntry, q: DVec3) -> bool {
    let v = q - p.cop;
    let z = v.dot(image.basis.forward);
    let (x, y) = (v.dot(image.basis.right), v.dot(image.basis.up));
    let [l, r, b, t] = image.window;
    let slack = 1e-6 * v.length();
    z >= image.plane_distance - slack
        && x >= l * z - slack
        && x <= r * z + slack
        && y >= b * z - slack
        && y <= t * z + slack
}

/// Largest singular value of d(u2, v2) / d(u1, v1) at fixed disparity, by central differences.
fn footprint(index: &Index, ldi: &LdiCamera, pose: &Pose, basis: &ViewBasis, q: DVec3) -> f64 {
    let focal = index.settings.camera.focal_px();
    let step = (q - ldi.cop).dot(ldi.basis.forward) / ldi.pixels_per_unit;
    let project = |q: DVec3| {
        let v = q - pose.position;
        let z = v.dot(basis.forward);
        (v.dot(basis.right) / z * focal, v.dot(basis.up) / z * focal)
    };
    const H: f64 = 1e-4;
    let column = |side: DVec3| {
        let (a, b) = (project(q + side * (step * H)), project(q - side * (step * H)));
        ((a.0 - b.0) / (2.0 * H), (a.1 - b.1) / (2.0 * H))
    };
    let (a, b) = (column(ldi.basis.right), column(ldi.basis.up));
    let (m, n, k) = (a.0 * a.0 + a.1 * a.1, b.0 * b.0 + b.1 * b.1, a.0 * b.0 + a.1 * b.1);
    ((m + n + ((m - n).powi(2) + 4.0 * k * k).sqrt()) * 0.5).sqrt()
}

/// SplitMix64 (Steele, Lea and Flood 2014).
struct Random(u64);

impl Random {
    /// A whole number from 0 up to, but without, `n`; 0 if there is none.
    fn below(&mut self, n: usize) -> usize {
        ((self.unit() * n as f64) as usize).min(n.saturating_sub(1))
    }

    fn unit(&mut self) -> f64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
    }
}
