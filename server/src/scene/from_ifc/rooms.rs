//! Rooms of `IfcSpace`, and openings between them.
//!
//! A room is an upright box here, so spaces of another shape are left out, and what is in none is
//! the outside. Every hole in a wall or slab (`IfcOpeningElement`) that touches a room becomes a
//! portal: a rectangle in the middle of the hole's depth, between the rooms before and behind it;
//! doors and windows that stand in no such hole as well.
//!
//! Spaces end at plaster, ceilings and where a drawing needs them to. What lies between two of them
//! is the outside to culling, and an opening that is no hole, such as a missing wall, is no portal.
//! So rooms are made of spaces only where the user asks for them, and can be judged by rays.

use std::collections::BTreeSet;

use glam::DVec3;
use ldi_protocol::Aabb;

use super::super::annotations::OUTSIDE;
use super::super::limits::Limits;
use super::super::model::{Note, PortalAnnotation, RoomAnnotation};

/// The part of space that an `IfcSpace`, an opening, a door or a window takes.
#[derive(Debug, Clone)]
pub(super) struct Volume {
    /// Number of the record.
    pub(super) record: u32,
    /// Name, else GUID.
    pub(super) name: String,
    /// Bounds in the file's world, Z up, metres.
    pub(super) bounds: Aabb,
    /// Volume that its surface encloses, cubic metres.
    pub(super) cubic_m: f64,
}

/// Spaces, and what may lead from one to another.
#[derive(Debug, Default)]
pub(super) struct Volumes {
    pub(super) spaces: Vec<Volume>,
    pub(super) openings: Vec<Volume>,
    /// Doors and windows.
    pub(super) fillings: Vec<Volume>,
}

/// Rooms and openings that an IFC file names.
#[derive(Debug, Default)]
pub(super) struct Found {
    pub(super) rooms: Vec<RoomAnnotation>,
    pub(super) portals: Vec<PortalAnnotation>,
    pub(super) notes: Vec<Note>,
}

/// Least part of its bounds that a box fills. Smaller values take rooms with corners cut off, whose
/// walls then lie within the room; larger ones leave out rooms with a chimney in a corner.
const BOX_SHARE: f64 = 0.97;
/// How far before an opening its room is looked for, metres: past plaster and frames.
const BEFORE_M: f64 = 0.2;
/// Shortest side of an opening that is a portal, metres; less are holes for pipes.
const LEAST_M: f64 = 0.05;

/// No rooms, and a note of how to have them.
pub(super) fn none_of(volumes: &Volumes) -> Found {
    let mut found = Found::default();
    if !volumes.spaces.is_empty() {
        let what = format!("{} spaces", volumes.spaces.len());
        found.notes.push(Note { what, why: "no rooms are made of them without FILE?rooms=spaces".into() });
    }
    found
}

/// Rooms of spaces that are upright boxes, and portals between them.
pub(super) fn of(volumes: &Volumes, limits: &Limits) -> Found {
    let mut found = Found::default();
    let mut names = BTreeSet::from([OUTSIDE.to_owned()]);
    let is_box = |v: &&Volume| v.bounds.size().min_element() > LEAST_M && fills_its_bounds(v);
    for space in volumes.spaces.iter().filter(is_box) {
        let numbered = |n: u32| if n < 2 { space.name.clone() } else { format!("{} ({n})", space.name) };
        let name = (1..).map(numbered).find(|name| !names.contains(name)).unwrap_or_default();
        names.insert(name.clone());
        found.rooms.push(RoomAnnotation { name, bounds: space.bounds });
    }
    let (read, all) = (found.rooms.len(), volumes.spaces.len());
    if read < all {
        let what = format!("{} of {all} spaces", all - read);
        found.notes.push(Note { what, why: "no upright boxes, so they are no rooms".into() });
    }
    let standing = volumes.fillings.iter().filter(|f| !volumes.openings.iter().any(|o| holds(&o.bounds, &f.bounds)));
    for opening in volumes.openings.iter().chain(standing) {
        found.portals.extend(portal(&found.rooms, &opening.bounds));
    }
    if found.rooms.len().max(found.portals.len()) as u64 > limits.rooms {
        let what = format!("{} rooms and {} openings", found.rooms.len(), found.portals.len());
        let why = format!("more than {} are not read", limits.rooms);
        return Found { notes: vec![Note { what, why }], ..Found::default() };
    }
    found
}

fn fills_its_bounds(volume: &Volume) -> bool {
    let size = volume.bounds.size();
    volume.cubic_m >= BOX_SHARE * size.x * size.y * size.z
}

/// Whether the middle of a box lies in another.
fn holds(outer: &Aabb, inner: &Aabb) -> bool {
    outer.contains(inner.centre())
}

/// The portal of an opening with these bounds; None where both sides are one place.
fn portal(rooms: &[RoomAnnotation], bounds: &Aabb) -> Option<PortalAnnotation> {
    let (size, centre) = (bounds.size(), bounds.centre());
    // Through a wall or slab the opening is shortest.
    let across = (0..3).min_by(|a, b| size[*a].total_cmp(&size[*b]))?;
    let [u, v] = [(across + 1) % 3, (across + 2) % 3];
    if size[u].min(size[v]) < LEAST_M {
        return None;
    }
    let step = DVec3::AXES[across] * (size[across] / 2.0 + BEFORE_M);
    let side = |p: DVec3| rooms.iter().find(|r| r.bounds.contains(p));
    let [before, behind] = [side(centre - step), side(centre + step)];
    if before.map(|r| &r.name) == behind.map(|r| &r.name) {
        return None;
    }
    let corner =
        |su: f64, sv: f64| centre + DVec3::AXES[u] * (su * size[u] / 2.0) + DVec3::AXES[v] * (sv * size[v] / 2.0);
    let corners = vec![corner(-1.0, -1.0), corner(1.0, -1.0), corner(1.0, 1.0), corner(-1.0, 1.0)];
    let name = |room: Option<&RoomAnnotation>| room.map_or_else(|| OUTSIDE.to_owned(), |r| r.name.clone());
    Some(PortalAnnotation { rooms: [name(before), name(behind)], corners })
}
