//! Several files as one scene.

use glam::{DVec3, Vec3};

use super::super::{LIMITS, Limits, Scene, SceneError, load, load_all, load_all_within};
use super::Folder;

const SQUARE: &str = "o square\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3 4\n";
const TRIANGLE: &str = "o triangle\nv 5 0 0\nv 6 0 0\nv 6 2 0\nf 1 2 3\n";
/// Both in one file.
const BOTH: &str = "o square\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3 4\n\
                    o triangle\nv 5 0 0\nv 6 0 0\nv 6 2 0\nf 5 6 7\n";

/// All but the names.
fn content(s: &Scene) -> String {
    let meshes: Vec<_> = s.meshes.iter().map(|m| (&m.name, &m.primitives)).collect();
    format!("{meshes:?} {:?} {:?} {:?}", s.instances, s.materials, s.notes)
}

#[test]
fn two_files_give_what_one_file_of_both_gives() {
    let folder = Folder::new();
    let [a, b, both] = [("a.obj", SQUARE), ("b.obj", TRIANGLE), ("c.obj", BOTH)].map(|(n, t)| folder.write(n, t));
    let joined = load_all(&[a.clone(), b.clone()]).expect("loads");
    joined.check().expect("is sound");
    let one = load(&both).expect("loads");
    assert_eq!(joined.name, "a.obj + b.obj");
    let notes = |s: &Scene| s.notes.iter().map(|n| n.why.clone()).collect::<Vec<_>>();
    // Each file's missing normals give a note of their own.
    assert_eq!((notes(&joined).len(), notes(&one).len()), (2, 1));
    let silent = |s: Scene| Scene { notes: Vec::new(), ..s };
    let (joined, one) = (silent(joined), silent(one));
    assert_eq!(content(&joined), content(&one));
    let turned = silent(load_all(&[b, a]).expect("loads"));
    assert_ne!(content(&turned), content(&one));
}

#[test]
fn one_file_is_as_ever() {
    let folder = Folder::new();
    let path = folder.write("a.obj", SQUARE);
    let (one, all) = (load(&path).expect("loads"), load_all(&[path]).expect("loads"));
    assert_eq!((content(&one), &one.name), (content(&all), &all.name));
}

#[test]
fn each_file_has_units_and_axes_of_its_own() {
    let folder = Folder::new();
    let [a, b] = [("a.obj", SQUARE), ("b.obj", TRIANGLE)].map(|(n, t)| folder.write(n, t));
    let s = load_all(&[a, format!("{b}?unit=cm&up=z")]).expect("loads");
    let world = |i: usize, v: usize| {
        let i = &s.instances[i];
        i.world_from_mesh.transform_point3(s.meshes[i.mesh as usize].primitives[0].positions[v].as_dvec3())
    };
    assert_eq!(world(0, 1), Vec3::X.as_dvec3());
    assert!(world(1, 2).distance(DVec3::new(0.06, 0.0, -0.02)) < 1e-9, "{}", world(1, 2));
}

#[test]
fn an_error_names_its_file() {
    let folder = Folder::new();
    let good = folder.write("good.obj", SQUARE);
    let bad = folder.write("bad.obj", SQUARE.replace("f 1 2 3 4", "f 1 2 9"));
    for order in [[good.clone(), bad.clone()], [bad.clone(), good.clone()]] {
        let said = load_all(&order).expect_err("refused").to_string();
        assert!(said.contains("bad.obj") && said.contains("line 6") && !said.contains("good.obj"), "{said}");
    }
    let gone = folder.path().join("gone.glb").display().to_string();
    let said = load_all(&[good, gone]).expect_err("refused").to_string();
    assert!(said.contains("gone.glb"), "{said}");
    assert!(load_all(&[]).is_err());
}

#[test]
fn limits_hold_for_all_files_together() {
    let folder = Folder::new();
    let [a, b] = [("a.obj", SQUARE), ("b.obj", TRIANGLE)].map(|(n, t)| folder.write(n, t));
    let files = [a, b];
    for enough in [Limits { unique_triangles: 3, ..LIMITS }, Limits { vertices: 9, ..LIMITS }] {
        load_all_within(&files, &enough).expect("fits");
        let less = Limits { unique_triangles: enough.unique_triangles - 1, vertices: enough.vertices - 1, ..enough };
        match load_all_within(&files, &less) {
            Err(SceneError::TooLarge { file, remedy, .. }) => {
                assert!(file.contains("b.obj") && remedy.contains("files before it"), "{file} {remedy}");
            }
            other => panic!("{other:?}"),
        }
    }
}
