//! Rooms and portals, as a glTF scene's `extras` hold them.
//!
//! The form, in world coordinates (metres, Y up), beside whatever else the extras hold:
//!
//! ```json
//! "scenes": [{ "nodes": [0], "extras": {
//!     "ldi_cells":   [{ "name": "hall", "min": [0, 0, 0], "max": [4, 3, 6] }],
//!     "ldi_portals": [{ "rooms": ["hall", "kitchen"], "corners": [[4, 0, 1], [4, 0, 2], [4, 2, 2], [4, 2, 1]] }]
//! } }]
//! ```
//!
//! [`SceneExtras`] is both read here and written by the exporter of the built-in scenes. A portal
//! is a flat, convex polygon, its corners in order around it (either way), between two different
//! rooms of the list, or between one of them and [`OUTSIDE`].

use std::collections::BTreeSet;

use glam::DVec3;
use ldi_protocol::Aabb;
use serde::{Deserialize, Serialize};

use super::error::{Fault, RE_EXPORT};
use super::files::shown;
use super::limits::Limits;
use super::model::{PortalAnnotation, RoomAnnotation, Scene};

/// What a portal calls the space that is in no room. No room may have this name.
pub const OUTSIDE: &str = "outside";

/// How far a portal's corners may lie out of its plane, as a part of its size: exporters write f32.
const FLATNESS: f64 = 1.0e-3;

/// The part of a glTF scene's `extras` that is read here.
#[derive(Debug, Clone, Default, PartialEq, Serialize, Deserialize)]
pub struct SceneExtras {
    /// Rooms.
    #[serde(default)]
    pub ldi_cells: Vec<CellExtra>,
    /// Openings between them.
    #[serde(default)]
    pub ldi_portals: Vec<PortalExtra>,
}

/// A room: a named box.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct CellExtra {
    /// Name, unique in the scene.
    pub name: String,
    /// Smallest corner, world, metres.
    pub min: [f64; 3],
    /// Largest corner, world, metres.
    pub max: [f64; 3],
}

/// An opening: a convex polygon between two rooms.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct PortalExtra {
    /// Names of the two rooms; one may be [`OUTSIDE`].
    pub rooms: [String; 2],
    /// Corners in order, world, metres.
    pub corners: Vec<[f64; 3]>,
}

impl From<&Scene> for SceneExtras {
    fn from(scene: &Scene) -> Self {
        let cell = |r: &RoomAnnotation| CellExtra {
            name: r.name.clone(),
            min: r.bounds.min.to_array(),
            max: r.bounds.max.to_array(),
        };
        let portal = |p: &PortalAnnotation| PortalExtra {
            rooms: p.rooms.clone(),
            corners: p.corners.iter().map(|c| c.to_array()).collect(),
        };
        Self {
            ldi_cells: scene.rooms.iter().map(cell).collect(),
            ldi_portals: scene.portals.iter().map(portal).collect(),
        }
    }
}

/// Reads and checks the annotations in a scene's extras. Extras that are no object belong to
/// somebody else.
pub(super) fn from_extras(
    json: &str,
    place: &str,
    limits: &Limits,
) -> Result<(Vec<RoomAnnotation>, Vec<PortalAnnotation>), Fault> {
    if !json.trim_start().starts_with('{') {
        return Ok((Vec::new(), Vec::new()));
    }
    let extras: SceneExtras = serde_json::from_str(json)
        .map_err(|e| Fault::broken(format!("{place}, extras"), format!("ldi_cells or ldi_portals malformed: {e}")))?;
    checked(extras, place, limits)
}

fn checked(
    extras: SceneExtras,
    place: &str,
    limits: &Limits,
) -> Result<(Vec<RoomAnnotation>, Vec<PortalAnnotation>), Fault> {
    for (what, found) in [("rooms", extras.ldi_cells.len()), ("portals", extras.ldi_portals.len())] {
        if found as u64 > limits.rooms {
            return Err(Fault::too_large(place, what, found, limits.rooms));
        }
    }
    let mut names = BTreeSet::from([OUTSIDE.to_owned()]);
    let mut rooms = Vec::with_capacity(extras.ldi_cells.len());
    for (i, cell) in extras.ldi_cells.into_iter().enumerate() {
        let fault = |problem: String| Fault::broken(format!("{place}, ldi_cells[{i}]"), problem);
        let bounds = Aabb { min: DVec3::from(cell.min), max: DVec3::from(cell.max) };
        let inside = |p: DVec3| p.abs().cmple(DVec3::splat(limits.coordinate_m)).all();
        if !inside(bounds.min) || !inside(bounds.max) || !bounds.min.cmplt(bounds.max).all() {
            return Err(fault("min must be below max on every axis, and both within the world's limits".into()));
        }
        if !names.insert(cell.name.clone()) {
            return Err(fault(format!("the name {} is taken", shown(&cell.name))));
        }
        rooms.push(RoomAnnotation { name: cell.name, bounds });
    }
    let mut portals = Vec::with_capacity(extras.ldi_portals.len());
    for (i, portal) in extras.ldi_portals.into_iter().enumerate() {
        let fault = |problem: String| Fault::invalid(format!("{place}, ldi_portals[{i}]"), problem, RE_EXPORT);
        if let Some(unknown) = portal.rooms.iter().find(|r| !names.contains(*r)) {
            return Err(fault(format!("no cell is named {}", shown(unknown))));
        }
        if portal.rooms[0] == portal.rooms[1] {
            return Err(fault("both rooms are the same".into()));
        }
        let corners: Vec<DVec3> = portal.corners.into_iter().map(DVec3::from).collect();
        if corners.len() as u64 > limits.portal_corners {
            return Err(fault(format!("{} corners, at most {} are read", corners.len(), limits.portal_corners)));
        }
        if !is_flat_convex(&corners) {
            return Err(fault("corners must be a flat, convex polygon in order".into()));
        }
        portals.push(PortalAnnotation { rooms: portal.rooms, corners });
    }
    Ok((rooms, portals))
}

/// Whether the polygon has an area, lies in a plane, and never turns back.
fn is_flat_convex(corners: &[DVec3]) -> bool {
    let n = corners.len();
    if n < 3 || !corners.iter().all(|c| c.is_finite()) {
        return false;
    }
    let edge = |i: usize| corners[(i + 1) % n] - corners[i % n];
    // Newell's normal, relative to the first corner so that far-off polygons do not lose it.
    let normal = (0..n).map(|i| (corners[i] - corners[0]).cross(corners[(i + 1) % n] - corners[0])).sum::<DVec3>();
    let size = Aabb::from_points(corners.iter().copied()).size().max_element();
    let Some(normal) = normal.try_normalize() else { return false };
    let flat = corners.iter().all(|c| (*c - corners[0]).dot(normal).abs() <= FLATNESS * size);
    let convex = (0..n).all(|i| edge(i).cross(edge(i + 1)).dot(normal) >= -FLATNESS * size * size);
    // A star turns the same way at every corner, but more than once round.
    let turn: f64 = (0..n).map(|i| edge(i).angle_between(edge(i + 1))).sum();
    flat && convex && (turn - std::f64::consts::TAU).abs() < 0.1
}

#[cfg(test)]
mod tests {
    use super::super::limits::LIMITS;
    use super::*;

    const HOUSE: &str = r#"{"author": "x",
        "ldi_cells": [{"name": "a", "min": [0,0,0], "max": [4,3,6]}, {"name": "b", "min": [4,0,0], "max": [9,3,6]}],
        "ldi_portals": [{"rooms": ["a", "b"], "corners": [[4,0,1],[4,0,2],[4,2,2],[4,2,1]]}]}"#;

    #[test]
    fn reads_rooms_and_portals() {
        let (rooms, portals) = from_extras(HOUSE, "scene 0", &LIMITS).unwrap();
        assert_eq!(rooms.len(), 2);
        assert_eq!(rooms[1].bounds.max, DVec3::new(9.0, 3.0, 6.0));
        assert_eq!(portals[0].rooms, ["a", "b"]);
        assert_eq!(portals[0].corners[2], DVec3::new(4.0, 2.0, 2.0));
    }

    #[test]
    fn portals_may_lead_outside_but_no_room_may_be_there() {
        let (_, portals) =
            from_extras(&HOUSE.replace("[\"a\", \"b\"]", "[\"a\", \"outside\"]"), "scene 0", &LIMITS).unwrap();
        assert_eq!(portals[0].rooms[1], OUTSIDE);
        assert!(from_extras(&HOUSE.replace("\"b\"", "\"outside\""), "scene 0", &LIMITS).is_err());
    }

    #[test]
    fn what_is_written_reads_back() {
        let (rooms, portals) = from_extras(HOUSE, "scene 0", &LIMITS).unwrap();
        let scene = Scene { rooms, portals, ..Scene::default() };
        let json = serde_json::to_string(&SceneExtras::from(&scene)).unwrap();
        let again = from_extras(&json, "scene 0", &LIMITS).unwrap();
        assert_eq!(again, (scene.rooms, scene.portals));
    }

    #[test]
    fn foreign_extras_are_left_alone() {
        for json in ["null", "12", "\"text\"", "[1]", "{\"a\": {}}"] {
            assert_eq!(from_extras(json, "scene 0", &LIMITS).unwrap(), (vec![], vec![]), "{json}");
        }
    }

    #[test]
    fn faults_are_found() {
        for (from, to) in [
            ("\"b\", \"min\": [4,0,0]", "\"a\", \"min\": [4,0,0]"),
            ("[9,3,6]", "[3,3,6]"),
            ("[9,3,6]", "[9e99,3,6]"),
            ("[\"a\", \"b\"]", "[\"a\", \"c\"]"),
            ("[\"a\", \"b\"]", "[\"a\", \"a\"]"),
            ("[[4,0,1],[4,0,2],[4,2,2],[4,2,1]]", "[[4,0,1],[4,0,2]]"),
            ("[[4,0,1],[4,0,2],[4,2,2],[4,2,1]]", "[[4,0,1],[4,2,2],[4,0,2],[4,2,1]]"),
            ("[4,2,2]", "[5,2,2]"),
            ("[4,2,2]", "[4,0.1,1.1]"),
            ("[4,2,2]", "[4,2]"),
        ] {
            let json = HOUSE.replacen(from, to, 1);
            assert_ne!(json, HOUSE);
            assert!(from_extras(&json, "scene 0", &LIMITS).is_err(), "{to}");
        }
    }

    #[test]
    fn pentagons_are_convex_and_pentagrams_are_not() {
        let corner = |k: usize| {
            let a = std::f64::consts::TAU * k as f64 / 5.0;
            DVec3::new(a.cos(), a.sin(), 7.0)
        };
        assert!(is_flat_convex(&[0, 1, 2, 3, 4].map(corner)));
        assert!(is_flat_convex(&[4, 3, 2, 1, 0].map(corner)));
        assert!(!is_flat_convex(&[0, 2, 4, 1, 3].map(corner)));
    }
}
