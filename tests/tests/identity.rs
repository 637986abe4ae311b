//! The server's identity on disk: one per folder, whole or an error.

use ldi_server::serve::Identity;
use std::{collections::BTreeSet, fs, path::PathBuf};

fn folder(name: &str) -> PathBuf {
    let folder = std::env::temp_dir().join(format!("ldi-identity-{name}-{}", std::process::id()));
    let _ = fs::remove_dir_all(&folder);
    folder
}

#[test]
fn first_starts_at_once_give_one_identity() {
    let folder = folder("race");
    for round in 0..25 {
        let folder = folder.join(round.to_string());
        let starts: BTreeSet<String> = std::thread::scope(|scope| {
            let start = || Identity::in_folder(&folder).expect("an identity").fingerprint();
            let starts: Vec<_> = (0..8).map(|_| scope.spawn(start)).collect();
            starts.into_iter().map(|s| s.join().expect("no panic")).collect()
        });
        let kept = Identity::in_folder(&folder).expect("it stays").fingerprint();
        assert_eq!(starts, BTreeSet::from([kept]), "round {round}");
    }
    fs::remove_dir_all(&folder).unwrap();
}

#[test]
fn half_an_identity_is_an_error_that_names_the_other_half() {
    for (lost, named) in [("key.der", "certificate.der"), ("certificate.der", "key.der")] {
        let folder = folder(lost);
        let whole = Identity::in_folder(&folder).expect("an identity").fingerprint();
        let (file, aside) = (folder.join(lost), folder.join("aside"));
        fs::rename(&file, &aside).unwrap();
        let e = Identity::in_folder(&folder).expect_err("half an identity").to_string();
        assert!(e.contains(named) && e.contains(lost), "{e}");
        fs::rename(&aside, &file).unwrap();
        assert_eq!(Identity::in_folder(&folder).expect("whole again").fingerprint(), whole);
        fs::remove_dir_all(&folder).unwrap();
    }
}

#[cfg(unix)]
#[test]
fn a_key_that_others_may_read_is_refused() {
    use std::os::unix::fs::PermissionsExt as _;
    let folder = folder("mode");
    Identity::in_folder(&folder).expect("an identity");
    let key = folder.join("key.der");
    fs::set_permissions(&key, fs::Permissions::from_mode(0o644)).unwrap();
    let e = Identity::in_folder(&folder).expect_err("readable by all").to_string();
    assert!(e.contains("key.der") && e.contains("chmod 600"), "{e}");
    fs::remove_dir_all(&folder).unwrap();
}
