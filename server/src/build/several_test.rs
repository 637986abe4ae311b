//! Builds of several files: what they are kept under, and what their nodes are.

use super::{
    small_builds::{Folder, options},
    *,
};
#[cfg(feature = "ifc")]
use crate::scene::SceneElement;
#[cfg(feature = "ifc")]
use crate::store::verify;
#[cfg(feature = "ifc")]
use std::fs;

/// A floor of four metres.
const FLOOR: &str = "o floor\nv -2 0 -2\nv 2 0 -2\nv 2 0 2\nv -2 0 2\nf 1 4 3 2\n";
const TENT: &str = "o tent\nv -1 0 -1\nv 0 1 -1\nv 1 0 -1\nf 1 3 2\n";
/// A wall of 1 x 0.2 x 1 m in metres.
#[cfg(feature = "ifc")]
const WALL: &str = "ISO-10303-21;\nHEADER;\nFILE_SCHEMA(('IFC4'));\nENDSEC;\nDATA;\n\
    #1=IFCPROJECT('0YvctVUKr0kugbFTf53O9L',$,'p',$,$,$,$,(#10),#5);\n\
    #5=IFCUNITASSIGNMENT((#6));\n#6=IFCSIUNIT(*,.LENGTHUNIT.,$,.METRE.);\n\
    #10=IFCGEOMETRICREPRESENTATIONCONTEXT($,'Model',3,1.E-5,#11,$);\n\
    #11=IFCAXIS2PLACEMENT3D(#12,$,$);\n#12=IFCCARTESIANPOINT((0.,0.,0.));\n#13=IFCDIRECTION((0.,0.,1.));\n\
    #15=IFCLOCALPLACEMENT($,#11);\n#22=IFCRECTANGLEPROFILEDEF(.AREA.,$,$,1.,0.2);\n\
    #23=IFCEXTRUDEDAREASOLID(#22,#11,#13,1.);\n#24=IFCSHAPEREPRESENTATION(#10,'Body','SweptSolid',(#23));\n\
    #25=IFCPRODUCTDEFINITIONSHAPE($,$,(#24));\n\
    #27=IFCWALL('1hOSvn6df7F8_7GcBWlRGQ',$,'north wall',$,$,#15,#25,$,$);\nENDSEC;\nEND-ISO-10303-21;\n";

#[test]
fn unfinished_work_is_kept_under_all_files() {
    let folder = Folder::new("several-key");
    let [floor, tent] = [("a.obj", FLOOR), ("b.obj", TENT)].map(|(n, t)| folder.write(n, t));
    let taller = folder.write("c.obj", &TENT.replace("v 0 1 -1", "v 0 2 -1"));
    let key = |files: &[&String]| {
        let files: Vec<String> = files.iter().map(|f| (*f).clone()).collect();
        key::scene_key(&scene::load_all(&files).unwrap())
    };
    let both = key(&[&floor, &tent]);
    assert_eq!(both, key(&[&floor, &tent]));
    for other in [&[&floor][..], &[&tent, &floor], &[&floor, &taller], &[&floor, &tent, &tent]] {
        assert_ne!(both, key(other), "{other:?}");
    }
}

#[test]
fn a_dataset_names_all_its_files() {
    let folder = Folder::new("several-names");
    let files = [("a.obj", FLOOR), ("b.obj", TENT)].map(|(n, t)| folder.write(n, t)).to_vec();
    let output = folder.0.join("dataset");
    build(&options(files, &output), &()).unwrap();
    let dataset = Dataset::open(&output).unwrap();
    assert_eq!((dataset.index().scene.name.as_str(), dataset.index().scene.triangles), ("a.obj + b.obj", 3));
    assert_eq!(dataset.elements().unwrap(), []);
}

#[cfg(feature = "ifc")]
#[test]
fn a_dataset_tells_what_its_nodes_are() {
    let folder = Folder::new("several-elements");
    let files = vec![folder.write("a.obj", FLOOR), folder.write("b.ifc", WALL)];
    let output = folder.0.join("dataset");
    build(&options(files, &output), &()).unwrap();
    let dataset = Dataset::open(&output).unwrap();
    let text = |t: &str| t.to_owned();
    let wall = SceneElement {
        node: 1,
        class: text("IfcWall"),
        name: text("north wall"),
        guid: text("1hOSvn6df7F8_7GcBWlRGQ"),
    };
    assert_eq!(dataset.elements().unwrap(), [wall]);
    let ranges = dataset.source_ranges().unwrap().unwrap();
    let of_wall: u32 = ranges.iter().flatten().filter(|r| r.node == 1).map(|r| r.count).sum();
    assert_eq!(of_wall, 12);
    assert_eq!(verify(&output).unwrap().faults, []);
    // Damage of the file is found.
    let file = fs::read_dir(&output).unwrap().map(|e| e.unwrap().path().join("elements")).find(|p| p.exists());
    let file = file.expect("is there");
    let mut bytes = fs::read(&file).unwrap();
    bytes[20] ^= 1;
    fs::write(&file, bytes).unwrap();
    let faults = verify(&output).unwrap().faults;
    assert_eq!((faults.len(), faults[0].kind.as_str()), (1, "elements"));
}
