//! Two rooms side by side, 4 m each along x, with a door of 1 x 2 m between them.

use super::*;
use proptest::prelude::*;

fn room(name: &str, x: f64) -> Cell {
    Cell { name: name.into(), boxes: vec![Aabb { min: DVec3::new(x, 0.0, 0.0), max: DVec3::new(x + 4.0, 3.0, 6.0) }] }
}

fn door() -> Portal {
    let at = |y: f64, z: f64| DVec3::new(4.0, y, z);
    // From the first room into the second: the normal is +x.
    let corners = vec![at(0.0, 1.0), at(2.0, 1.0), at(2.0, 2.0), at(0.0, 2.0)];
    Portal { cells: [Some(0), Some(1)], kind: PortalKind::Door, corners }
}

fn two() -> Rooms {
    Rooms::new(0.1, vec![room("a", 0.0), room("b", 4.0)], vec![door()]).unwrap()
}

#[test]
fn a_portal_points_from_its_first_cell_into_its_second() {
    let r = two();
    assert!((r.portals()[0].normal() - DVec3::X).length() < 1e-12);
    assert!((r.portals()[0].area_m2() - 2.0).abs() < 1e-12);
    assert_eq!(r.portals()[0].beyond(Some(1)), Some(Some(0)));
    assert_eq!(r.portals()[0].beyond(None), None);
    assert_eq!(r.portals_of(Some(1)), [0]);
    assert!(r.portals_of(None).is_empty());
}

#[test]
fn distances_to_a_portal_are_those_to_its_polygon() {
    let p = door();
    for (at, distance) in
        [([5.0, 1.0, 1.5], 1.0), ([4.0, 1.0, 4.0], 2.0), ([7.0, 6.0, 1.5], 5.0), ([4.0, 1.9, 1.1], 0.0)]
    {
        assert!((p.distance_m(DVec3::from(at)) - distance).abs() < 1e-12, "{at:?}");
    }
}

#[test]
fn points_near_a_border_may_be_on_both_sides() {
    let r = two();
    assert_eq!(r.cell_at(DVec3::new(3.0, 1.0, 3.0)), Some(0));
    assert_eq!(r.cells_near(DVec3::new(3.0, 1.0, 3.0), 0.1), [Some(0)]);
    assert_eq!(r.cells_near(DVec3::new(4.05, 1.0, 3.0), 0.1), [Some(0), Some(1)]);
    assert_eq!(r.cells_near(DVec3::new(3.0, 2.95, 3.0), 0.1), [Some(0), None]);
    assert_eq!(r.cells_near(DVec3::new(-3.0, 1.0, 3.0), 0.1), [None]);
    assert_eq!((r.name(Some(1)), r.name(None)), ("b", "outside"));
}

#[test]
fn what_is_written_reads_back() {
    let r = two();
    let json = serde_json::to_vec(&r).unwrap();
    assert_eq!(Rooms::from_json(&json).unwrap(), r);
}

#[test]
fn faults_are_found() {
    let good = serde_json::to_string(&two()).unwrap();
    for (from, to) in [
        ("\"a\"", "\"b\""),
        ("\"a\"", "\"\""),
        ("\"margin_m\":0.1", "\"margin_m\":-1"),
        ("\"cells\":[0,1]", "\"cells\":[0,0]"),
        ("\"cells\":[0,1]", "\"cells\":[0,2]"),
        ("\"door\"", "\"flap\""),
        ("[4.0,2.0,2.0]", "[5.0,2.0,2.0]"),
        ("[4.0,2.0,2.0]", "[4.0,0.1,1.1]"),
        ("[4.0,3.0,6.0]", "[-4.0,3.0,6.0]"),
        ("[4.0,3.0,6.0]", "[4e9,3.0,6.0]"),
    ] {
        let bad = good.replacen(from, to, 1);
        assert_ne!(bad, good, "{from} is in the text");
        assert!(Rooms::from_json(bad.as_bytes()).is_err(), "{to}");
    }
    let corners = vec![DVec3::ZERO; MAX_CORNERS + 1];
    assert!(Rooms::new(0.1, vec![room("a", 0.0)], vec![Portal { cells: [Some(0), None], corners, ..door() }]).is_err());
}

proptest! {
    #[test]
    fn damaged_text_never_panics(at in 0usize..600, byte in any::<u8>()) {
        let mut json = serde_json::to_vec(&two()).unwrap();
        let n = json.len();
        json[at % n] = byte;
        let _ = Rooms::from_json(&json);
    }
}
