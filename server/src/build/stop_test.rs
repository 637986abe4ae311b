//! Whole builds that stop at a change to the file system: the next run goes on, and the bytes in
//! the end are those of a build that never stopped.

use super::*;
use crate::{
    placement::test_scenes,
    store::{tests::faults, verify},
};
use std::{fs, path::Path};

/// A floor of four metres with a tent on it.
const SCENE: &str = "o floor\nv -2 0 -2\nv 2 0 -2\nv 2 0 2\nv -2 0 2\nf 1 4 3 2\n\
    o tent\nv -1 0 -1\nv 0 1 -1\nv 1 0 -1\nf 5 7 6\n";

/// A folder that goes away with the test; in memory where there is such a place.
struct Folder(PathBuf);

impl Folder {
    fn new() -> Self {
        let memory = Path::new("/dev/shm");
        let parent = if memory.is_dir() { memory.to_owned() } else { std::env::temp_dir() };
        let path = parent.join(format!("ldi-stop-{}", std::process::id()));
        let _ = fs::remove_dir_all(&path);
        fs::create_dir_all(&path).unwrap();
        Self(path)
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}

fn options(scene: &Path, output: &Path) -> BuildOptions {
    BuildOptions {
        scenes: vec![scene.display().to_string()],
        output: output.to_owned(),
        settings: test_scenes::settings(100),
        budget_share: None,
        colour: ColourProfile::Lossless,
        represent: Represent::Tree { pitch_m: 0.25, side: 24 },
        starts: Vec::new(),
        along: None,
        time_limit: None,
    }
}

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
    let folder = Folder::new();
    let scene = folder.0.join("tent.obj");
    fs::write(&scene, SCENE).unwrap();
    let straight = folder.0.join("straight");
    let changes = faults::changes_of(&straight, || drop(build(&options(&scene, &straight), &()).unwrap()));
    let expected = files(&straight);
    assert!(changes >= 40 && expected.len() >= 4, "{changes} changes, {:?}", expected.keys());
    // At each change, as on a full disk and as after a kill.
    for (at, for_good) in (0..changes).flat_map(|at| [(at, false), (at, true)]) {
        let output = folder.0.join("stopped");
        let stopped = faults::failing_at(&output, at, for_good, || build(&options(&scene, &output), &()));
        let place = format!("change {at} of {changes}, for good: {for_good}");
        if let Ok(found) = Dataset::open(&output) {
            assert_eq!(verify(&output).unwrap().faults, [], "{place}");
            drop(found);
        } else {
            let error = stopped.err().unwrap_or_else(|| panic!("{place}: no dataset, and no error"));
            assert!(error.to_string().contains("stopped"), "{place}: {error} names no file");
        }
        build(&options(&scene, &output), &()).unwrap_or_else(|e| panic!("{place}: it does not go on: {e}"));
        assert!(files(&output) == expected, "{place}: other bytes");
        fs::remove_dir_all(&output).unwrap();
    }
}
