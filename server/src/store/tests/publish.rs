//! What a build may write to, and what a stop at any moment leaves behind.

use super::*;
use std::os::unix::fs::symlink;

/// Folders that hold something with the name of a dataset's file, and are none.
#[test]
fn folders_of_others_are_refused_and_stay_as_they_are() {
    for name in [files::PACKS, files::WORK, files::MANIFEST, folder::MARKER] {
        let folder = Folder::new("foreign");
        fs::create_dir_all(&folder.0).unwrap();
        if name == files::MANIFEST || name == folder::MARKER {
            fs::write(folder.0.join(name), "of a ship").unwrap();
        } else {
            fs::create_dir(folder.0.join(name)).unwrap();
            fs::write(folder.0.join(name).join("letter.txt"), "dear").unwrap();
        }
        let before = contents(&folder.0);
        let error = sample().write(&folder.0).unwrap_err();
        assert!(error.permanent() && error.to_string().contains("name an empty or a new one"), "{name}: {error}");
        assert_eq!(contents(&folder.0), before, "{name}");
    }
}

/// Links are neither written through nor removed through.
#[test]
fn links_are_not_followed() {
    let (elsewhere, folder) = (Folder::new("elsewhere"), Folder::new("links"));
    fs::create_dir_all(&elsewhere.0).unwrap();
    symlink(&elsewhere.0, &folder.0).unwrap();
    for path in [folder.0.clone(), folder.0.join("")] {
        let error = sample().write(&path).unwrap_err();
        assert!(error.permanent() && error.to_string().contains("symbolic link"), "the folder itself: {error}");
    }
    fs::remove_file(&folder.0).unwrap();
    let written = sample().write(&folder.0).unwrap();
    let letters = elsewhere.0.join("letters");
    fs::create_dir(&letters).unwrap();
    fs::write(letters.join("pack-00007.bin"), "dear").unwrap();
    let data = DataFiles::new(&folder.0, &written.hash).folder().to_owned();
    for link in [data, folder.0.join(files::WORK)] {
        let _ = fs::remove_dir_all(&link);
        symlink(&letters, &link).unwrap();
        let error = sample().write(&folder.0).unwrap_err();
        assert!(error.to_string().contains("symbolic link"), "{}: {error}", link.display());
        assert_eq!(contents(&elsewhere.0).len(), 1, "{}", link.display());
        fs::remove_file(&link).unwrap();
    }
    // Files that are written anew replace a link, and a folder of packs that is one stays.
    let letter = letters.join("pack-00007.bin");
    for name in ["manifest", "manifest.part", "report.json", "report.json.part"] {
        let _ = fs::remove_file(folder.0.join(name));
        symlink(&letter, folder.0.join(name)).unwrap();
    }
    symlink(&letters, folder.0.join("packs-0123456789abcdef")).unwrap();
    fs::remove_file(folder.0.join("manifest")).unwrap();
    sample().write(&folder.0).unwrap();
    assert_eq!(fs::read(&letter).unwrap(), b"dear");
    assert!(folder.0.join("packs-0123456789abcdef").is_symlink());
    assert_eq!(verify(&folder.0).unwrap().faults, []);
}

/// Files of others in a dataset's folder outlive a build, wherever they lie.
#[test]
fn only_what_a_build_named_is_removed() {
    let folder = Folder::new("named");
    let mut sample = sample();
    let written = sample.write(&folder.0).unwrap();
    let data = DataFiles::new(&folder.0, &written.hash).folder().to_owned();
    fs::create_dir_all(folder.0.join(".build/ab")).unwrap();
    fs::create_dir_all(folder.0.join("packs-mine")).unwrap();
    let foreign = [
        folder.0.join("rooms.json"),
        folder.0.join("packs-mine/pack-00000.bin"),
        folder.0.join(".build/notes.txt"),
        folder.0.join(".build/ab/notes.txt"),
        data.join("notes.txt"),
        data.join("pack-1.bin"),
    ];
    foreign.iter().for_each(|f| fs::write(f, "mine").unwrap());
    sample.index.settings.budget = 5;
    sample.write(&folder.0).unwrap();
    for file in foreign {
        assert_eq!(fs::read(&file).unwrap(), b"mine", "{}", file.display());
    }
    assert!(!data.join("pack-00000.bin").exists() && !data.join("source").exists());
}

/// Makes of a dataset what earlier versions wrote.
fn make_old(dataset: &Path, hash: &ChunkHash) {
    fs::rename(DataFiles::new(dataset, hash).folder(), dataset.join("packs")).unwrap();
    fs::rename(dataset.join("packs/source"), dataset.join("source")).unwrap();
    fs::remove_file(dataset.join(folder::MARKER)).unwrap();
    fs::write(dataset.join("report.json"), json!({ "skipped": [] }).to_string()).unwrap();
}

#[test]
fn datasets_of_earlier_versions_are_read_and_not_written_to() {
    let folder = Folder::new("old");
    let sample = sample();
    let written = sample.write(&folder.0).unwrap();
    make_old(&folder.0, &written.hash);
    let dataset = Dataset::open(&folder.0).unwrap();
    assert_eq!(dataset.chunk(3).unwrap(), sample.chunks[3]);
    assert_eq!(dataset.source_ranges().unwrap().unwrap(), sample.ranges);
    assert_eq!(inspect(&dataset, true).unwrap()["report_found"], true);
    assert_eq!(verify(&folder.0).unwrap().faults, []);
    let before = contents(&folder.0);
    let error = sample.write(&folder.0).unwrap_err().to_string();
    assert!(error.contains("a dataset of an earlier version") && error.contains("remove the folder"), "{error}");
    assert_eq!(contents(&folder.0), before);
}

#[test]
fn a_build_that_gives_up_leaves_what_was_there() {
    let folder = Folder::new("give-up");
    DatasetWriter::open(&folder.0).unwrap().give_up();
    assert!(!folder.0.exists(), "made by the build");
    fs::create_dir_all(&folder.0).unwrap();
    DatasetWriter::open(&folder.0).unwrap().give_up();
    assert_eq!(fs::read_dir(&folder.0).unwrap().count(), 0, "not made by the build");
    sample().write(&folder.0).unwrap();
    let before = contents(&folder.0);
    DatasetWriter::open(&folder.0).unwrap().give_up();
    assert_eq!(contents(&folder.0), before);
}

#[test]
fn the_old_dataset_stays_until_the_new_one_is_whole() {
    let folder = Folder::new("stays");
    let mut sample = sample();
    let before = sample.write(&folder.0).unwrap();
    sample.index.settings.budget = 5;
    let result = DatasetWriter::open(&folder.0).unwrap().finish(
        &sample.index,
        |_, number| Err(StoreError::Chunk { number }),
        &sample.ranges,
        true,
        |_| json!({}),
    );
    assert!(result.is_err());
    assert_eq!(Dataset::open(&folder.0).unwrap().hash(), before.hash);
    assert_eq!(verify(&folder.0).unwrap().faults, []);
}

/// A whole build: pieces are kept, then the dataset is written from them.
fn build(sample: &Sample, path: &Path) -> Result<Written, StoreError> {
    let key = |k: usize| *blake3::hash(&sample.chunks[k]).as_bytes();
    let writer = DatasetWriter::open(path)?;
    for (k, chunk) in sample.chunks.iter().enumerate() {
        if writer.cached(&key(k)).is_none() {
            writer.store(&key(k), chunk)?;
        }
    }
    let chunk = |writer: &DatasetWriter, k: u32| {
        writer.cached(&key(k as usize)).map(Cow::Owned).ok_or(StoreError::Chunk { number: k })
    };
    writer.finish(&sample.index, chunk, &sample.ranges, true, |_| json!({ "skipped": [] }))
}

/// Everything in a folder, by its name there.
fn named_contents(folder: &Folder) -> Vec<(PathBuf, Vec<u8>)> {
    contents(&folder.0).into_iter().map(|(p, c)| (p.strip_prefix(&folder.0).unwrap().to_owned(), c)).collect()
}

/// Stops a build over `old`, if there is one, at every change it makes to the file system: one call
/// fails as on a full disk, or it and all that follow, as after a kill.
fn stopped_at_every_change(name: &str, old: Option<&Sample>, new: &Sample) {
    let straight = Folder::quick(&format!("{name}-straight"));
    let hash = build(new, &straight.0).unwrap().hash;
    let fresh = || {
        let folder = Folder::quick(name);
        let old = old.map(|o| build(o, &folder.0).unwrap().hash);
        (folder, old)
    };
    let changes = {
        let (folder, _) = fresh();
        faults::changes_of(&folder.0, || drop(build(new, &folder.0).unwrap()))
    };
    assert!(changes > 30, "{changes} changes: not all of them are counted");
    for (at, for_good) in (0..changes).flat_map(|at| [(at, false), (at, true)]) {
        let (folder, old) = fresh();
        let served = old.map(|_| Dataset::open(&folder.0).unwrap());
        let result = faults::failing_at(&folder.0, at, for_good, || build(new, &folder.0));
        let place = format!("{name}, change {at} of {changes}, for good: {for_good}: {:?}", result.as_ref().err());
        match (Dataset::open(&folder.0), old) {
            (Ok(found), _) if found.hash() == hash => {}
            (Ok(found), Some(old)) => assert!(found.hash() == old && result.is_err(), "{place}"),
            (Err(StoreError::NotADataset { .. }), None) => assert!(result.is_err(), "{place}"),
            (other, _) => panic!("{place}: {other:?}"),
        }
        if Dataset::open(&folder.0).is_ok() {
            assert_eq!(verify(&folder.0).unwrap().faults, [], "{place}");
        }
        build(new, &folder.0).unwrap_or_else(|e| panic!("{place}: it does not go on: {e}"));
        assert!(named_contents(&folder) == named_contents(&straight), "{place}: other bytes");
        if let Some(served) = served {
            (0..served.index().chunks.len()).for_each(|k| drop(served.chunk(k as u32).expect("still readable")));
        }
    }
}

#[test]
fn a_stop_at_any_change_leaves_the_old_or_the_new_dataset() {
    let (old, mut new) = (sample(), sample());
    new.index.settings.budget = 5;
    new.ranges[0].pop();
    stopped_at_every_change("stop-first", None, &new);
    stopped_at_every_change("stop-over", Some(&old), &new);
    stopped_at_every_change("stop-same", Some(&new), &new);
}

#[test]
fn a_full_disk_is_found_before_anything_is_written() {
    let folder = Folder::new("full");
    let (old, mut new) = (sample(), sample());
    old.write(&folder.0).unwrap();
    new.index.settings.budget = 5;
    let before = contents(&folder.0);
    let error = faults::with_free_bytes(&folder.0, 10_000, || new.write(&folder.0)).unwrap_err();
    assert!(!error.permanent() && error.to_string().contains("10000 bytes left"), "{error}");
    fs::remove_dir_all(folder.0.join(files::WORK)).unwrap();
    assert_eq!(contents(&folder.0), before);
    new.write(&folder.0).unwrap();
}

/// Files of an opened dataset that others change give errors for what is in them, and for nothing
/// else.
#[test]
fn files_that_change_under_a_reader_give_errors() {
    let folder = Folder::new("change");
    let sample = sample();
    let written = sample.write(&folder.0).unwrap();
    let dataset = Dataset::open(&folder.0).unwrap();
    let path = DataFiles::find(&folder.0, &written.hash).pack(0);
    let good = fs::read(&path).unwrap();
    let readable = || (0..6).filter(|k| dataset.chunk(*k).is_ok()).collect::<Vec<_>>();
    assert_eq!(readable(), [0, 1, 2, 3, 4, 5]);
    // As `cp` does it: the same file, cut off and written anew.
    fs::write(&path, &good[..good.len() - 1]).unwrap();
    assert_eq!(readable(), [0, 1, 2, 3, 4]);
    let error = dataset.chunk(5).unwrap_err();
    assert!(error.permanent() && error.to_string().contains("beyond the end of its pack"), "{error}");
    fs::write(&path, b"").unwrap();
    assert!(readable().is_empty());
    assert!(dataset.page(0).is_err());
    let mut flipped = good.clone();
    *flipped.last_mut().unwrap() ^= 1;
    fs::write(&path, &flipped).unwrap();
    assert_eq!(readable(), [0, 1, 2, 3, 4]);
    fs::write(&path, &good).unwrap();
    fs::remove_dir_all(&folder.0).unwrap();
    assert_eq!(readable(), [0, 1, 2, 3, 4, 5], "opened files outlive their names");
    assert!(matches!(dataset.chunk(6), Err(StoreError::NoSuch { .. })));
}

#[test]
fn a_damaged_report_is_named() {
    let folder = Folder::new("report");
    let mut sample = sample();
    sample.write(&folder.0).unwrap();
    let path = folder.0.join("report.json");
    let bytes = fs::read(&path).unwrap();
    for byte in 0..bytes.len() {
        let faults = faults_after_flip(&folder.0, "report.json", byte);
        assert_eq!((faults.len(), faults[0].kind.as_str()), (1, "report"), "byte {byte}");
    }
    let report: serde_json::Value = serde_json::from_slice(&bytes).unwrap();
    assert_eq!(report["skipped"][0]["what"], "portals");
    assert_eq!(report["blake3"].as_str().unwrap().len(), 64);
    // A stop between manifest and report leaves the report of the dataset before.
    sample.index.settings.budget = 5;
    sample.write(&folder.0).unwrap();
    fs::write(&path, &bytes).unwrap();
    assert_eq!(inspect(&Dataset::open(&folder.0).unwrap(), false).unwrap()["report_found"], false);
}
