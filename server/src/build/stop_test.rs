//! Whole builds that stop at a change to the file system: the next run goes on, and the bytes in
//! the end are those of a build that never stopped.

use super::{
    small_builds::{Folder, options},
    *,
};
use crate::store::{tests::faults, verify};
use std::{fs, path::Path};

/// A floor of four metres with a tent on it.
const SCENE: &str = "o floor\nv -2 0 -2\nv 2 0 -2\nv 2 0 2\nv -2 0 2\nf 1 4 3 2\n\
    o tent\nv -1 0 -1\nv 0 1 -1\nv 1 0 -1\nf 5 7 6\n";

/// All files below a folder but the report, which tells how long things took.
fn files(folder: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut out = BTreeMap::new();
    for entry in fs::read_dir(folder).unwrap().map(|e| e.unwrap().path()) {
        if entry.is_dir() {
            out.extend(files(&entry).into_iter().map(|(p, b)| (entry.join(p), b)));
        } else if entry.file_name().is_some_and(|n| n != "report.json") {
            out.insert(entry.clone(), fs::read(&entry).unwrap());
        }
    }
    out.into_iter().map(|(p, b)| (p.strip_prefix(folder).unwrap_or(&p).to_owned(), b)).collect()
}

#[test]
fn a_build_that_stops_anywhere_goes_on_to_the_same_bytes() {
    let folder = Folder::new("stop");
    let scene = folder.write("tent.obj", SCENE);
    let straight = folder.0.join("straight");
    let changes = faults::changes_of(&straight, || drop(build(&options(vec![scene.clone()], &straight), &()).unwrap()));
    let expected = files(&straight);
    assert!(changes >= 40 && expected.len() >= 4, "{changes} changes, {:?}", expected.keys());
    // At each change, as on a full disk and as after a kill.
    for (at, for_good) in (0..changes).flat_map(|at| [(at, false), (at, true)]) {
        let output = folder.0.join("stopped");
        let stopped = faults::failing_at(&output, at, for_good, || build(&options(vec![scene.clone()], &output), &()));
        let place = format!("change {at} of {changes}, for good: {for_good}");
        if let Ok(found) = Dataset::open(&output) {
            assert_eq!(verify(&output).unwrap().faults, [], "{place}");
            drop(found);
        } else {
            let error = stopped.err().unwrap_or_else(|| panic!("{place}: no dataset, and no error"));
            assert!(error.to_string().contains("stopped"), "{place}: {error} names no file");
        }
        build(&options(vec![scene.clone()], &output), &())
            .unwrap_or_else(|e| panic!("{place}: it does not go on: {e}"));
        assert!(files(&output) == expected, "{place}: other bytes");
        fs::remove_dir_all(&output).unwrap();
    }
}
