//! The audit in a dataset with rooms: of a pose's list, by rays that go from room to room.
//!
//! For random rays of the picture: which portals a ray crosses, in which order, is found by
//! intersecting each polygon with the line, where `select` clips cones. In every room on its way
//! that is geometry, each cell that the ray meets must be drawn; the first portal into a room that
//! is not must have an image for this eye, whose window holds what is beyond, at a footprint
//! within its bound.

use super::{AuditedPose, Random, check_deviation, footprint, holds, triangles_in};
use glam::DVec3;
use ldi_protocol::{Aabb, Pose, index::Index, ldi::LdiCamera, room_index::RoomIndex, rooms::CellId, select::DrawList};
use std::collections::BTreeSet;

/// Rays of a pose.
const RAYS: usize = 48;
/// Rooms on a ray's way that are looked at.
const MOST_ROOMS: usize = 64;
/// Points beyond a portal at which windows and footprints are looked at, per ray.
const POINTS: usize = 2;

/// Checks one pose with its list.
#[expect(clippy::too_many_arguments, reason = "the audit's own, and what is special about rooms")]
pub(super) fn check(
    index: &Index,
    rooms: &RoomIndex,
    list: &DrawList,
    recounted: &[u64],
    cameras: &[Option<LdiCamera>],
    (number, kind): (u64, &'static str),
    pose: &Pose,
    random: &mut Random,
) -> AuditedPose {
    let camera = &index.settings.camera;
    let triangles = triangles_in(index, recounted, &list.cells);
    let mut faults = Vec::new();
    if triangles > index.settings.budget {
        faults.push(format!("{triangles} triangles, budget {}", index.settings.budget));
    }
    if list.dropped > 0 {
        faults.push(format!(
            "{} cells are left to the LDI tree: rooms that have to be geometry exceed the budget",
            list.dropped
        ));
    }
    let deviation_px = check_deviation(index, &list.cells, pose.position, &mut faults);
    let mut audit = Walk { index, rooms, cameras, pose, list, footprint_px: 0.0, faults: BTreeSet::new() };
    let basis = pose.basis();
    for _ in 0..RAYS {
        let mut across = || random.unit() * 2.0 - 1.0;
        let ray = basis.forward
            + basis.right * (across() * camera.half_tan_x())
            + basis.up * (across() * camera.half_tan_y());
        audit.ray(ray, random);
    }
    let footprint_px = audit.footprint_px;
    faults.extend(audit.faults);
    AuditedPose {
        index: number,
        kind,
        position: pose.position.to_array(),
        yaw_deg: pose.yaw_deg,
        pitch_deg: pose.pitch_deg,
        grid_point: None,
        placement: list.portals.first().map(|p| p.placement),
        triangles,
        footprint_px,
        deviation_px,
        faults,
    }
}

struct Walk<'a> {
    index: &'a Index,
    rooms: &'a RoomIndex,
    cameras: &'a [Option<LdiCamera>],
    pose: &'a Pose,
    list: &'a DrawList,
    footprint_px: f64,
    faults: BTreeSet<String>,
}

impl Walk<'_> {
    fn ray(&mut self, ray: DVec3, random: &mut Random) {
        let rooms = &self.rooms.rooms;
        let eye = self.pose.position;
        let (mut room, mut from) = (rooms.cell_at(eye), 0.0);
        for _ in 0..MOST_ROOMS {
            let ahead = rooms.portals_of(room).iter().filter_map(|p| {
                let portal = &rooms.portals()[*p as usize];
                let side = usize::from(portal.cells[0] != room);
                portal.crossed(side, eye, ray).filter(|t| *t > from).map(|t| (t, *p, side))
            });
            let next = ahead.min_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
            if self.list.dropped == 0 {
                self.meets(room, ray, [from, next.map_or(f64::INFINITY, |n| n.0)]);
            }
            let Some((t, portal, side)) = next else { return };
            if let Some(shown) = self.list.portals.iter().find(|p| (p.portal, p.side) == (portal, side)) {
                let placement = shown.placement;
                self.image(placement, ray, t, random);
                return;
            }
            room = rooms.portals()[portal as usize].cells[1 - side];
            from = t;
            if !self.list.rooms.contains(&room) && self.list.dropped == 0 {
                self.faults.insert(format!("beyond portal {portal} nothing is drawn and no image shows it"));
                return;
            }
        }
    }

    /// Every cell of a room that a part of the ray meets is drawn.
    fn meets(&mut self, room: CellId, ray: DVec3, [from, to]: [f64; 2]) {
        for cell in self.rooms.cells(room) {
            let b = &self.index.cells[*cell as usize].bounds;
            if is_met(b, self.pose.position, ray, [from, to]) && !self.list.cells.iter().any(|c| c.cell == *cell) {
                self.faults.insert(format!(
                    "cell {cell} of room {} is in the picture and not drawn",
                    self.rooms.rooms.name(room)
                ));
            }
        }
    }

    fn image(&mut self, placement: u32, ray: DVec3, t: f64, random: &mut Random) {
        let (index, pose) = (self.index, self.pose);
        let Some(p) = index.placements.get(placement as usize) else { return };
        // Images of 1998 promise nothing of what they hold, nor of their samples' size.
        if !self.rooms.placements.iter().flatten().any(|of_portal| of_portal.contains(&placement)) {
            return;
        }
        if !p.users.inflated(1e-6).contains(pose.position) {
            self.faults.insert("the eye is not among the placement's users".into());
        }
        for _ in 0..POINTS {
            let q = pose.position + ray * (t + random.unit().powi(2) * 30.0);
            let images = p.images.clone().map(|i| i as usize).filter(|i| holds(p, &index.images[*i], q));
            let mut held = false;
            for number in images {
                held = true;
                if let Some(ldi) = self.cameras.get(number).and_then(Option::as_ref) {
                    let found = footprint(index, ldi, pose, &pose.basis(), q);
                    self.footprint_px = self.footprint_px.max(found);
                    if found > p.footprint_px * (1.0 + 1e-6)
                        || p.footprint_px > index.settings.max_footprint_px * (1.0 + 1e-9)
                    {
                        self.faults.insert(format!("footprint {found} px, bound {} px", p.footprint_px));
                    }
                }
            }
            if !held {
                self.faults.insert(format!("what is beyond a portal of placement {placement} is in no image"));
            }
        }
    }
}

/// Whether a part of a line passes through the inside of a box.
fn is_met(b: &Aabb, eye: DVec3, ray: DVec3, [mut from, mut to]: [f64; 2]) -> bool {
    for k in 0..3 {
        let (a, c) = ((b.min[k] - eye[k]) / ray[k], (b.max[k] - eye[k]) / ray[k]);
        if ray[k] == 0.0 {
            if eye[k] <= b.min[k] || eye[k] >= b.max[k] {
                return false;
            }
            continue;
        }
        (from, to) = (from.max(a.min(c)), to.min(a.max(c)));
    }
    from + 1e-9 < to
}
