//! IFC files as scenes: units, axes, holes, colours, shared shapes, rooms, names.

use std::collections::BTreeSet;
use std::io::Write as _;

use glam::{DVec3, Vec3};
use ldi_protocol::Aabb;
use ldi_protocol::shade::linear_from_srgb;

use super::super::{LIMITS, Limits, OUTSIDE, Primitive, Scene, load, load_all, load_within};
use super::Folder;
use super::ifc_text::{MILLI, WALL_GUID, box_records, building, columns, doorway, file, spaces, wall};

fn scene(text: &str) -> Scene {
    scene_of(text, "")
}

/// The scene of a file with spaces as rooms.
fn with_rooms(text: &str) -> Scene {
    scene_of(text, "?rooms=spaces")
}

fn scene_of(text: &str, query: &str) -> Scene {
    let folder = Folder::new();
    let scene = load(&(folder.write("a.ifc", text) + query)).expect("loads");
    scene.check().expect("is sound");
    scene
}

/// Corners of an instance's triangles in the world.
fn corners(scene: &Scene, instance: usize) -> Vec<[DVec3; 3]> {
    let i = &scene.instances[instance];
    let primitives = &scene.meshes[i.mesh as usize].primitives;
    let world = |p: Vec3| i.world_from_mesh.transform_point3(p.as_dvec3());
    let of =
        |p: &Primitive| -> Vec<_> { p.triangles.iter().map(|t| t.map(|v| world(p.positions[v as usize]))).collect() };
    primitives.iter().flat_map(of).collect()
}

fn bounds(scene: &Scene, instance: usize) -> Aabb {
    Aabb::from_points(corners(scene, instance).as_flattened().iter().copied())
}

fn area(scene: &Scene, instance: usize) -> f64 {
    corners(scene, instance).iter().map(|[a, b, c]| (b - a).cross(c - a).length() / 2.0).sum()
}

/// Positions of the instances that show the element of this name.
fn instances(scene: &Scene, name: &str) -> Vec<usize> {
    let element = scene.elements.iter().find(|e| e.name == name).expect("is there");
    (0..scene.instances.len()).filter(|i| scene.instances[*i].node == element.node).collect()
}

fn near(a: &Aabb, min: [f64; 3], max: [f64; 3]) {
    let [min, max] = [min, max].map(DVec3::from);
    assert!(a.min.distance(min) < 1e-5 && a.max.distance(max) < 1e-5, "{a:?}, not {min} to {max}");
}

#[test]
fn millimetres_with_z_up_become_metres_with_y_up() {
    let s = scene(&file(&wall()));
    assert_eq!((s.instances.len(), s.triangles()), (1, 12));
    near(&bounds(&s, 0), [0.0, 0.0, -0.2], [4.0, 3.0, 0.0]);
    let metres = scene(&file(&wall()).replace(MILLI, "#6=IFCSIUNIT(*,.LENGTHUNIT.,$,.METRE.);"));
    near(&bounds(&metres, 0), [0.0, 0.0, -200.0], [4000.0, 3000.0, 0.0]);
}

#[test]
fn normals_point_out_of_the_wall() {
    let s = scene(&file(&wall()));
    let (i, p) = (&s.instances[0], &s.meshes[0].primitives[0]);
    let centre = DVec3::new(2.0, 1.5, -0.1);
    for t in &p.triangles {
        for v in t.map(|v| v as usize) {
            let normal = i.world_from_mesh.transform_vector3(p.normals[v].as_dvec3());
            let at = i.world_from_mesh.transform_point3(p.positions[v].as_dvec3());
            assert!(normal.dot(at - centre) > 0.05, "{at} {normal}");
        }
    }
}

#[test]
fn openings_are_cut_and_not_drawn() {
    let s = scene(&file(&(wall() + &doorway())));
    let [cut] = instances(&s, "north wall")[..] else { panic!("one shape") };
    // Both sides less the doorway, ends, top, what is left of the bottom, and the reveal.
    let want = 2.0 * (4.0 * 3.0 - 2.1) + 2.0 * 3.0 * 0.2 + 4.0 * 0.2 + 3.0 * 0.2 + (2.0 * 2.1 + 1.0) * 0.2;
    assert!((area(&s, cut) - want).abs() < 1e-3, "{} m2, not {want}", area(&s, cut));
    let whole = scene(&file(&wall()));
    assert!((area(&whole, 0) - want).abs() > 1.0);
    let classes: Vec<_> = s.elements.iter().map(|e| e.class.as_str()).collect();
    assert_eq!(classes, ["IfcWall", "IfcDoor"]);
}

#[test]
fn colours_of_styles_are_srgb() {
    let s = scene(&building());
    let [wall] = instances(&s, "north wall")[..] else { panic!("one shape") };
    let material = s.meshes[s.instances[wall].mesh as usize].primitives[0].material;
    assert_eq!(s.materials[material as usize].base_colour, [1.0, linear_from_srgb(0.5), 0.0, 1.0]);
    let [column] = instances(&s, "left")[..] else { panic!("one shape") };
    let other = s.meshes[s.instances[column].mesh as usize].primitives[0].material;
    assert_ne!(material, other);
}

#[test]
fn products_that_place_one_map_share_its_mesh() {
    let s = scene(&file(&columns()));
    let [left, right] = ["left", "right"].map(|n| instances(&s, n)[0]);
    assert_eq!((s.meshes.len(), s.instances.len()), (1, 2));
    near(&bounds(&s, left), [5.0, 0.0, -0.5], [5.3, 3.0, 0.0]);
    // Turned by 90 degrees: what was along x is along y, what was along y along -x.
    near(&bounds(&s, right), [6.5, 0.0, -0.3], [7.0, 3.0, 0.0]);
    let other = scene(
        &file(&columns())
            .replace("#122=IFCMAPPEDITEM(#110,#111)", "#122=IFCMAPPEDITEM(#110,#119)")
            .replace("#122=", "#119=IFCCARTESIANTRANSFORMATIONOPERATOR3D($,$,#12,2.,$);\n#122="),
    );
    near(&bounds(&other, instances(&other, "right")[0]), [6.0, 0.0, -0.6], [7.0, 6.0, 0.0]);
}

/// A wall whose doorway is cut shows another shape than its twin without one.
#[test]
fn what_is_cut_is_not_shared() {
    let twin = "#28=IFCCARTESIANPOINT((0.,9000.,0.));\n#29=IFCAXIS2PLACEMENT3D(#28,$,$);\n\
                #128=IFCLOCALPLACEMENT($,#29);\n#129=IFCWALL('ahOSvn6df7F8_7GcBWlRGQ',$,'twin',$,$,#128,#25,$,$);\n";
    let s = scene(&file(&(wall() + twin)));
    assert_eq!((s.meshes.len(), s.instances.len()), (1, 2));
    let s = scene(&file(&(wall() + twin + &doorway())));
    let [cut, twin] = ["north wall", "twin"].map(|n| instances(&s, n)[0]);
    assert_ne!(s.instances[cut].mesh, s.instances[twin].mesh);
    assert!(area(&s, cut) < area(&s, twin) - 1.0);
}

#[test]
fn far_files_keep_their_digits() {
    let far = "#15=IFCLOCALPLACEMENT($,#17);\n#16=IFCCARTESIANPOINT((500000000.,5000000000.,0.));\n\
               #17=IFCAXIS2PLACEMENT3D(#16,$,$);\n";
    let s = scene(&file(&wall()).replace("#15=IFCLOCALPLACEMENT($,#11);\n", far));
    let b = bounds(&s, 0);
    assert!(b.min.distance(DVec3::new(500_000.0, 0.0, -5_000_000.2)) < 1e-3, "{b:?}");
    assert!((b.size() - DVec3::new(4.0, 3.0, 0.2)).length() < 1e-4, "{b:?}");
}

#[test]
fn the_site_keeps_its_place() {
    let site = "#15=IFCLOCALPLACEMENT(#19,#11);\n#16=IFCCARTESIANPOINT((1000.,2000.,0.));\n\
                #17=IFCAXIS2PLACEMENT3D(#16,#13,#14);\n#19=IFCLOCALPLACEMENT($,#17);\n\
                #18=IFCSITE('bhOSvn6df7F8_7GcBWlRGQ',$,'site',$,$,#19,$,$,.ELEMENT.,$,$,$,$,$);\n";
    let s = scene(&file(&(wall() + &columns())).replace("#15=IFCLOCALPLACEMENT($,#11);\n", site));
    let [wall] = instances(&s, "north wall")[..] else { panic!("one shape") };
    near(&bounds(&s, wall), [0.8, 0.0, -6.0], [1.0, 3.0, -2.0]);
    assert_eq!((s.meshes.len(), s.instances.len()), (2, 3));
}

#[test]
fn names_and_identities_are_kept() {
    let s = scene(&building());
    let wall = s.elements.iter().find(|e| e.class == "IfcWall").expect("is there");
    assert_eq!((wall.name.as_str(), wall.guid.as_str()), ("north wall", WALL_GUID));
    assert_eq!(s.elements.len(), 4);
    assert!(s.instances.iter().all(|i| (i.node as usize) < s.elements.len()));
}

#[test]
fn limits_hold_for_shapes_and_records() {
    let folder = Folder::new();
    let path = folder.write("a.ifc", building());
    let needs = |limits: Limits, what: &str| {
        let said = load_within(&path, &limits).expect_err("refused").to_string();
        assert!(said.contains("a.ifc") && said.contains(what) && said.contains("at most"), "{said}");
    };
    needs(Limits { step_bytes: 100, ..LIMITS }, "bytes of STEP text");
    needs(Limits { step_records: 10, ..LIMITS }, "records");
    needs(Limits { unique_triangles: 20, ..LIMITS }, "triangles");
    needs(Limits { expanded_triangles: 50, ..LIMITS }, "triangles");
    needs(Limits { vertices: 20, ..LIMITS }, "vertices");
    needs(Limits { instances: 2, ..LIMITS }, "shapes");
}

#[test]
fn the_order_of_threads_changes_nothing() {
    let records: String = (0..40)
        .map(|k| {
            let at = 1000 + 20 * k;
            box_records(at, [f64::from(k) * 900.0, 0.0, 0.0], [300.0, 300.0 + f64::from(k), 3000.0])
                + &format!("#{}=IFCCOLUMN('{k:022}',$,'c{k}',$,$,#15,#{},$,$);\n", at + 7, at + 5)
        })
        .collect();
    let folder = Folder::new();
    let path = folder.write("a.ifc", file(&records));
    let once = load(&path).expect("loads");
    let pool = rayon::ThreadPoolBuilder::new().num_threads(5).build().expect("starts");
    let again = pool.install(|| load(&path)).expect("loads");
    assert_eq!(once.elements, again.elements);
    assert_eq!(once.instances, again.instances);
    let positions = |s: &Scene| s.meshes.iter().map(|m| m.primitives[0].positions.clone()).collect::<Vec<_>>();
    assert_eq!(positions(&once), positions(&again));
}

#[test]
fn spaces_are_rooms_and_holes_lead_from_one_to_the_other() {
    let text = file(&(wall() + &doorway() + &spaces()));
    let s = scene(&text);
    assert!(s.rooms.is_empty() && s.notes.iter().any(|n| n.why.contains("?rooms=spaces")), "{:?}", s.notes);
    let s = with_rooms(&text);
    let names: Vec<_> = s.rooms.iter().map(|r| r.name.as_str()).collect();
    assert_eq!(names, ["hall", "yard"]);
    near(&s.rooms[0].bounds, [0.0, 0.0, -3.2], [4.0, 3.0, -0.2]);
    assert_eq!(s.portals.len(), 1);
    let mut sides = s.portals[0].rooms.clone();
    sides.sort();
    assert_eq!(sides, ["hall", "yard"]);
    let opening = Aabb::from_points(s.portals[0].corners.iter().copied());
    near(&opening, [1.5, 0.0, -0.1], [2.5, 2.1, -0.1]);
    // Without the yard the hole leads outside.
    let one = file(&(wall() + &doorway() + &spaces())).replace("=IFCSPACE('7", "=IFCSPATIALZONE('7");
    let s = with_rooms(&one);
    assert_eq!(s.rooms.len(), 1);
    assert!(s.portals[0].rooms.contains(&OUTSIDE.to_owned()));
}

#[test]
fn looks_elements_and_rooms_stay_with_their_file() {
    let folder = Folder::new();
    let painted = "mtllib a.mtl\nusemtl blue\nv 5 0 0\nv 6 0 0\nv 6 2 0\nf 1 2 3\n";
    folder.write("a.mtl", "newmtl blue\nKd 0 0 1\n");
    let paths = [("a.obj", painted), ("b.ifc", &building()), ("c.ifc", &building())].map(|(n, t)| folder.write(n, t));
    let [a, b, c] = &paths;
    let s = load_all(&[a.clone(), format!("{b}?rooms=spaces"), format!("{c}?rooms=spaces")]).expect("loads");
    s.check().expect("is sound");
    let nodes: BTreeSet<u32> = s.instances.iter().map(|i| i.node).collect();
    assert_eq!(nodes.len(), 1 + 4 + 4);
    for e in &s.elements {
        assert!(nodes.contains(&e.node), "{e:?}");
    }
    assert!(s.elements.windows(2).all(|e| e[0].node < e[1].node));
    // The same building twice has the same looks, and its rooms have names of their own.
    let alone = load(&paths[1]).expect("loads");
    assert_eq!(s.materials.len(), 1 + alone.materials.len());
    let names: Vec<_> = s.rooms.iter().map(|r| r.name.as_str()).collect();
    assert_eq!(names, ["hall", "yard", "hall (c.ifc)", "yard (c.ifc)"]);
    assert!(s.portals[1].rooms.iter().all(|r| r.ends_with("(c.ifc)")), "{:?}", s.portals);
}

#[test]
fn files_of_one_project_lie_in_one_world() {
    let folder = Folder::new();
    let east = file(&wall()).replace("#12=IFCCARTESIANPOINT((0.,0.,0.))", "#12=IFCCARTESIANPOINT((9000.,0.,0.))");
    let paths = [folder.write("a.ifc", file(&wall())), folder.write("b.ifc", east)];
    let bounds = load_all(&paths).expect("loads").bounds();
    assert!(bounds.max.x > 13.0 - 1e-4 && bounds.min.x.abs() < 1e-6, "{bounds:?}");
}

#[test]
fn a_product_may_place_an_item_many_times() {
    let many: Vec<String> = (0..400).map(|_| "#112".to_owned()).collect();
    let s = scene(
        &file(&columns())
            .replace("'MappedRepresentation',(#112)", &format!("'MappedRepresentation',({})", many.join(","))),
    );
    assert_eq!(instances(&s, "right").len(), 1);
    assert!(!instances(&s, "left").is_empty());
}

#[test]
fn packed_files_are_read() {
    let folder = Folder::new();
    let mut zip = zip::ZipWriter::new(std::io::Cursor::new(Vec::new()));
    zip.start_file("model.IFC", zip::write::SimpleFileOptions::default()).expect("starts");
    zip.write_all(file(&wall()).as_bytes()).expect("fits");
    let path = folder.write("a.ifczip", zip.finish().expect("ends").into_inner());
    assert_eq!(load(&path).expect("loads").triangles(), 12);
}
