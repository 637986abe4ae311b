//! Rooms and portals in the manifest: pages of rooms with their cells, the outside last, and pages
//! of portals with their placements.

use super::{Numbers, charge, put_ascending, put_numbers, take_ascending, take_numbers};
use crate::{
    Aabb,
    codec::{
        CodecError,
        bytes::{Reader, Writer, put_varint},
    },
    room_index::{BuiltImages, MAX_PLACEMENTS, MAX_REFERENCES, RoomIndex, SideImages},
    rooms::{Cell, CellId, MAX_BOXES, MAX_CORNERS, MAX_NAME_BYTES, Portal, PortalKind, Rooms},
};
use glam::DVec3;
use std::ops::Range;

const KINDS: [PortalKind; 5] =
    [PortalKind::Door, PortalKind::Window, PortalKind::Hatch, PortalKind::Gap, PortalKind::Given];

/// What pages gave so far.
#[derive(Default)]
pub(in crate::manifest) struct Draft {
    margin_m: f64,
    near_m: f64,
    /// Rooms, then the outside without a name and boxes.
    cells: Vec<Cell>,
    cells_of: Vec<Vec<u32>>,
    portals: Vec<Portal>,
    placements: Vec<[Range<u32>; 2]>,
    built: BuiltImages,
    sides: Vec<[SideImages; 2]>,
    /// As many as rooms, or none.
    by_grid: Vec<bool>,
}

impl Draft {
    /// The rooms; None if no page held any.
    pub fn finish(mut self) -> Result<Option<RoomIndex>, CodecError> {
        let Some(outside) = self.cells.pop() else {
            let stray = !self.portals.is_empty();
            return if stray {
                Err(CodecError::mismatch("portals", "there are portals without rooms"))
            } else {
                Ok(None)
            };
        };
        if !outside.boxes.is_empty() || !outside.name.is_empty() {
            return Err(CodecError::mismatch("rooms", "the last of them is not the outside"));
        }
        let rooms = Rooms::new(self.margin_m, self.cells, self.portals)
            .map_err(|e| CodecError::mismatch("rooms", e.to_string()))?;
        Ok(Some(RoomIndex {
            rooms,
            near_m: self.near_m,
            cells_of: self.cells_of,
            placements: self.placements,
            built: self.built,
            sides: self.sides,
            by_grid: self.by_grid,
        }))
    }
}

/// Entries of the page kind: rooms and the outside.
pub(super) fn count(rooms: &RoomIndex) -> usize {
    rooms.cells_of.len()
}

pub(super) fn put_rooms(w: &mut Writer, rooms: &RoomIndex, range: Range<usize>) -> Result<(), CodecError> {
    put_numbers(w, "rooms' distances", [rooms.rooms.margin_m(), rooms.near_m])?;
    let cells = rooms.rooms.cells();
    let (mut numbers, mut names, mut boxes) = (Vec::new(), Vec::new(), Vec::new());
    let built = BuiltImages::ALL.iter().position(|b| *b == rooms.built).unwrap_or(0);
    // Where some rooms are the grid's each says so.
    let told = if rooms.by_grid.is_empty() { 0 } else { BuiltImages::ALL.len() };
    put_varint(&mut numbers, (built + told) as u64);
    for i in range {
        let (name, of_room) = cells.get(i).map_or(("", &[][..]), |c| (c.name.as_str(), c.boxes.as_slice()));
        put_varint(&mut numbers, name.len() as u64);
        names.extend(name.as_bytes());
        put_varint(&mut numbers, of_room.len() as u64);
        boxes.extend(of_room.iter().flat_map(|b| b.min.to_array().into_iter().chain(b.max.to_array())));
        if let Some(by_grid) = rooms.by_grid.get(i) {
            put_varint(&mut numbers, u64::from(*by_grid));
        }
        put_ascending(&mut numbers, &rooms.cells_of[i]);
    }
    w.section("rooms", &numbers)?;
    w.section("room names", &names)?;
    put_numbers(w, "room boxes", boxes)
}

pub(super) fn take_rooms(
    r: &mut Reader<'_>,
    n: usize,
    draft: &mut Draft,
    decoded: &mut usize,
) -> Result<(), CodecError> {
    charge::<(Cell, Vec<u32>, bool)>(decoded, "page count", n)?;
    let found = take_numbers(r, "rooms' distances", 2)?;
    let so_far = [draft.margin_m, draft.near_m];
    if !draft.cells.is_empty() && found.iter().zip(so_far).any(|(a, b)| a.to_bits() != b.to_bits()) {
        return Err(CodecError::mismatch("rooms' distances", "two pages disagree"));
    }
    (draft.margin_m, draft.near_m) = (found[0], found[1]);
    let mut numbers = Numbers::take(r, "rooms")?;
    let number = numbers.next("rooms' images")?;
    let kinds = BuiltImages::ALL.len() as u32;
    let told = number >= kinds;
    let built = *BuiltImages::ALL.get((number - if told { kinds } else { 0 }) as usize).ok_or_else(|| {
        CodecError::range(
            "rooms' images",
            number,
            "0 for ours, 1 for those of 1998, 2 for both; 3 more where rooms tell whether they are the grid's",
        )
    })?;
    if !draft.cells.is_empty() && (built != draft.built || told == draft.by_grid.is_empty()) {
        return Err(CodecError::mismatch("rooms' images", "two pages disagree"));
    }
    draft.built = built;
    let mut shape = Vec::new();
    let mut boxes = 0;
    for _ in 0..n {
        let name = numbers.count("room name", MAX_NAME_BYTES)?;
        let of_room = numbers.count("room boxes", MAX_BOXES - boxes)?;
        boxes += of_room;
        charge::<Aabb>(decoded, "room boxes", of_room)?;
        shape.push((name, of_room));
        if told {
            draft.by_grid.push(match numbers.next("the grid's rooms")? {
                n @ 0..=1 => n == 1,
                n => return Err(CodecError::range("the grid's rooms", n, "0 or 1")),
            });
        }
        draft.cells_of.push(take_ascending(&mut numbers, "room cells", decoded)?);
    }
    numbers.finish("rooms")?;
    let names = r.section_of("room names", shape.iter().map(|s| s.0).sum())?;
    let corners = take_numbers(r, "room boxes", 6 * boxes)?;
    let mut names = names.as_slice();
    let mut corners = corners.as_chunks::<6>().0;
    for (name, of_room) in shape {
        // Both hold exactly what the shape says.
        let (name, rest) = names.split_at(name);
        names = rest;
        let name = String::from_utf8(name.to_vec()).map_err(|_| CodecError::mismatch("room names", "not UTF-8"))?;
        let (of_room, rest) = corners.split_at(of_room);
        corners = rest;
        let boxes =
            of_room.iter().map(|&[a, b, c, d, e, f]| Aabb { min: DVec3::new(a, b, c), max: DVec3::new(d, e, f) });
        draft.cells.push(Cell { name, boxes: boxes.collect() });
    }
    Ok(())
}

pub(super) fn put_portals(w: &mut Writer, rooms: &RoomIndex, range: Range<usize>) -> Result<(), CodecError> {
    let (mut numbers, mut corners) = (Vec::new(), Vec::new());
    for number in range {
        let (portal, placements) = (&rooms.rooms.portals()[number], &rooms.placements[number]);
        // 0 is the outside.
        portal.cells.iter().for_each(|c| put_varint(&mut numbers, c.map_or(0, |c| 1 + u64::from(c))));
        put_varint(&mut numbers, KINDS.iter().position(|k| *k == portal.kind).unwrap_or(0) as u64);
        put_varint(&mut numbers, portal.corners.len() as u64);
        corners.extend(portal.corners.iter().flat_map(|c| c.to_array()));
        for side in placements {
            put_varint(&mut numbers, side.start.into());
            put_varint(&mut numbers, side.len() as u64);
        }
        for side in rooms.sides.get(number).into_iter().flatten() {
            let first = side.references.start;
            put_varint(&mut numbers, first.into());
            put_varint(&mut numbers, side.references.len() as u64);
            if !side.references.is_empty() {
                put_varint(&mut numbers, (side.central - first).into());
                // 0: none.
                put_varint(&mut numbers, side.layered.map_or(0, |l| 1 + u64::from(l)));
            }
        }
    }
    w.section("portals", &numbers)?;
    put_numbers(w, "portal corners", corners)
}

pub(super) fn take_portals(
    r: &mut Reader<'_>,
    n: usize,
    draft: &mut Draft,
    decoded: &mut usize,
) -> Result<(), CodecError> {
    charge::<(Portal, [Range<u32>; 2], [SideImages; 2])>(decoded, "page count", n)?;
    let mut numbers = Numbers::take(r, "portals")?;
    let mut lengths = Vec::new();
    for _ in 0..n {
        let mut room = || -> Result<CellId, CodecError> { Ok(numbers.next("portal rooms")?.checked_sub(1)) };
        let cells = [room()?, room()?];
        let kind = numbers.next("portal kind")?;
        let kind =
            *KINDS.get(kind as usize).ok_or_else(|| CodecError::range("portal kind", kind, "there are five kinds"))?;
        let corners = numbers.count("portal corners", MAX_CORNERS)?;
        charge::<DVec3>(decoded, "portal corners", corners)?;
        lengths.push(corners);
        let mut side = || -> Result<Range<u32>, CodecError> {
            let start = numbers.next("portal placements")?;
            Ok(start..start.saturating_add(numbers.count("portal placements", MAX_PLACEMENTS)? as u32))
        };
        draft.placements.push([side()?, side()?]);
        if draft.built != BuiltImages::Ours {
            draft.sides.push([take_side(&mut numbers)?, take_side(&mut numbers)?]);
        }
        draft.portals.push(Portal { cells, kind, corners: Vec::new() });
    }
    numbers.finish("portals")?;
    let corners = take_numbers(r, "portal corners", 3 * lengths.iter().sum::<usize>())?;
    let mut corners = corners.as_chunks::<3>().0;
    let first = draft.portals.len() - n;
    for (portal, length) in draft.portals[first..].iter_mut().zip(lengths) {
        let (own, rest) = corners.split_at(length);
        corners = rest;
        portal.corners = own.iter().map(|c| DVec3::from_array(*c)).collect();
    }
    Ok(())
}

/// The images of 1998 of one side of a portal; whether they exist is checked with the whole index.
fn take_side(numbers: &mut Numbers) -> Result<SideImages, CodecError> {
    let first = numbers.next("portal references")?;
    let count = numbers.count("portal references", MAX_REFERENCES)? as u32;
    let references = first..first.saturating_add(count);
    if count == 0 {
        return Ok(SideImages { references, central: 0, layered: None });
    }
    let central = first.saturating_add(numbers.next("central reference")?);
    Ok(SideImages { references, central, layered: numbers.next("layered image")?.checked_sub(1) })
}
