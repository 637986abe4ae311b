//! Two rooms of 4 x 3 x 6 m along x with a door at x = 4, and a window from the second outside at
//! x = 8.

use super::*;

fn two() -> Rooms {
    let room = |name: &str, x: f64| Cell {
        name: name.into(),
        boxes: vec![Aabb { min: DVec3::new(x, 0.0, 0.0), max: DVec3::new(x + 4.0, 3.0, 6.0) }],
    };
    let portal = |x: f64, cells| Portal {
        cells,
        kind: PortalKind::Door,
        corners: vec![
            DVec3::new(x, 0.0, 1.0),
            DVec3::new(x, 2.0, 1.0),
            DVec3::new(x, 2.0, 2.0),
            DVec3::new(x, 0.0, 2.0),
        ],
    };
    let portals = vec![portal(4.0, [Some(0), Some(1)]), portal(8.0, [Some(1), None])];
    Rooms::new(0.1, vec![room("a", 0.0), room("b", 4.0)], portals).unwrap()
}

fn applied(text: &str) -> Result<Rooms, OverrideError> {
    apply_overrides(&two(), Path::new("fix.toml"), text)
}

#[test]
fn an_empty_file_changes_nothing() {
    assert_eq!(applied("# nothing\n").unwrap(), two());
}

#[test]
fn rooms_are_renamed_and_merged_and_the_portals_between_them_go() {
    let r = applied("[[rename]]\nfrom = 'a'\nto = 'kitchen'\n").unwrap();
    assert_eq!(r.cells()[0].name, "kitchen");
    let r = applied("[[merge]]\ncells = ['a', 'b']\nname = 'a'\n").unwrap();
    assert_eq!((r.cells().len(), r.portals().len()), (1, 1));
    assert_eq!((r.cells()[0].boxes.len(), r.cells()[0].name.as_str()), (2, "a"));
    assert_eq!(r.portals()[0].cells, [Some(0), None]);
}

#[test]
fn a_split_makes_a_portal_of_the_cut_and_gives_portals_to_their_halves() {
    let r = applied("[[split]]\ncell = 'b'\nx = 6.0\nnames = ['west', 'east']\n").unwrap();
    assert_eq!(r.cells().iter().map(|c| c.name.as_str()).collect::<Vec<_>>(), ["a", "west", "east"]);
    assert_eq!(r.portals().len(), 3);
    assert_eq!(r.portals()[0].cells, [Some(0), Some(1)]);
    assert_eq!(r.portals()[1].cells, [Some(2), None]);
    let cut = &r.portals()[2];
    assert_eq!(cut.cells, [Some(1), Some(2)]);
    assert!((cut.normal() - DVec3::X).length() < 1e-9, "from the first into the second");
    assert!((cut.area_m2() - 18.0).abs() < 1e-9);
    // A window across the plane belongs to both halves.
    let r = applied("[[split]]\ncell = 'b'\nz = 1.5\nnames = ['north', 'south']\n").unwrap();
    assert_eq!(r.portals().len(), 5);
}

#[test]
fn portals_are_removed_and_added_turned_the_right_way() {
    let r = applied("[[remove_portal]]\ncells = ['b', 'a']\nat = [4.0, 1.0, 1.5]\n").unwrap();
    assert_eq!(r.portals().len(), 1);
    for order in ["[4,0,4],[4,0,5],[4,2,5],[4,2,4]", "[4,2,4],[4,2,5],[4,0,5],[4,0,4]"] {
        let r = applied(&format!("[[portal]]\ncells = ['a', 'b']\ncorners = [{order}]\n")).unwrap();
        assert!((r.portals()[2].normal() - DVec3::X).length() < 1e-9);
    }
    let r = applied("[[remove_cell]]\ncell = 'b'\n").unwrap();
    assert_eq!((r.cells().len(), r.portals().len()), (1, 1));
    assert_eq!(r.portals()[0].cells, [Some(0), None]);
}

#[test]
fn every_fault_names_its_line() {
    for (text, line, says) in [
        ("[[rename]]\nfrom = 'x'\nto = 'y'", 1, "no cell is named \"x\""),
        ("\n[[rename]]\nfrom = 'a'\nto = 'b'", 2, "taken"),
        ("[[rename]]\nfrom = 'a'\nto = 'c'\n\n[[rename]]\nfrom = 'a'\nto = 'd'", 5, "no cell is named"),
        ("[[rename]]\nfrom = 'a'\nfor = 'c'", 3, "unknown field"),
        ("[[split]]\ncell = 'a'\nnames = ['p', 'q']", 1, "either x or z"),
        ("[[split]]\ncell = 'a'\nx = 9\nnames = ['p', 'q']", 1, "misses the cell"),
        ("[[remove_portal]]\ncells = ['a', 'b']\nat = [9, 9, 9]", 1, "from `at`"),
        ("[[remove_portal]]\ncells = ['a', 'outside']\nat = [0, 0, 0]", 1, "no portal between"),
        ("[[portal]]\ncells = ['a', 'b']\ncorners = [[4,0,4],[4,0,5],[5,2,5],[4,2,4]]", 1, "flat, convex"),
        ("[[merge]]\ncells = ['a', 'outside']\nname = 'c'", 1, "outside is no cell"),
        ("[[merge]\ncells = []", 1, ""),
    ] {
        let e = applied(text).unwrap_err();
        assert_eq!(e.line, line, "{text}: {e}");
        assert!(e.to_string().starts_with(&format!("fix.toml:{line}: ")) && e.to_string().contains(says), "{e}");
    }
}
