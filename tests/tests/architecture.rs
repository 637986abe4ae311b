//! Data flows one way: what each crate may depend on, and what each stage may import.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::process::Command;

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().expect("the workspace is one up").to_path_buf()
}

/// Names of all crates that `package` builds on.
fn dependencies(package: &str) -> BTreeSet<String> {
    let out = Command::new(env!("CARGO"))
        .args(["tree", "--offline", "--locked", "-e", "normal", "--prefix", "none", "-p", package])
        .current_dir(root())
        .output()
        .expect("cargo runs");
    assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
    String::from_utf8_lossy(&out.stdout)
        .lines()
        .filter_map(|l| l.split_whitespace().next())
        .map(str::to_string)
        .collect()
}

#[test]
fn the_protocol_is_pure() {
    let names = dependencies("ldi-protocol");
    assert!(names.contains("glam"), "cargo tree lists what is there: {names:?}");
    for banned in ["tokio", "quinn", "wgpu", "axum", "rayon", "memmap2"] {
        assert!(!names.contains(banned), "ldi-protocol depends on {banned}");
    }
    let lib = std::fs::read_to_string(root().join("protocol/src/lib.rs")).expect("readable");
    assert!(lib.contains("#![forbid(unsafe_code)]"));
    for (file, text) in sources("protocol/src") {
        for banned in ["std::fs", "std::net", "std::thread", "std::time::Instant", "async fn"] {
            assert!(!text.contains(banned), "{file} uses {banned}");
        }
    }
}

#[test]
fn neither_end_depends_on_the_other() {
    assert!(!dependencies("ldi-client").contains("ldi-server"));
    assert!(!dependencies("ldi-server").contains("ldi-client"));
}

/// Every Rust file below a folder of the workspace, by path, without its tests.
fn sources(folder: &str) -> Vec<(String, String)> {
    fn walk(dir: &Path, out: &mut Vec<PathBuf>) {
        for entry in std::fs::read_dir(dir).expect("readable").map(|e| e.expect("readable").path()) {
            if entry.is_dir() {
                walk(&entry, out);
            } else if entry.extension().is_some_and(|e| e == "rs") {
                out.push(entry);
            }
        }
    }
    let mut files = Vec::new();
    walk(&root().join(folder), &mut files);
    files.sort();
    let is_test = |p: &PathBuf| {
        let stem = p.file_stem().unwrap_or_default().to_string_lossy().into_owned();
        stem == "tests"
            || stem.ends_with("_test")
            || stem.ends_with("_tests")
            || stem == "test_support"
            || p.components().any(|c| c.as_os_str() == "tests")
    };
    files
        .into_iter()
        .filter(|p| !is_test(p))
        .map(|p| {
            let text = std::fs::read_to_string(&p).expect("readable");
            let code = text.split("#[cfg(test)]\nmod ").next().unwrap_or_default().to_string();
            (p.strip_prefix(root()).expect("below the root").display().to_string(), code)
        })
        .collect()
}

/// Asserts that a stage imports only from stages before it.
fn assert_one_way(folder: &str, stages: &[&str]) {
    for (file, text) in sources(folder) {
        let relative = file.trim_start_matches(folder).trim_start_matches('/');
        let stage = relative.split(['/', '.']).next().unwrap_or_default();
        let Some(own) = stages.iter().position(|s| *s == stage) else { continue };
        for (at, later) in stages.iter().enumerate().skip(own + 1) {
            let import = format!("crate::{later}");
            let found = text
                .match_indices(&import)
                .any(|(i, m)| !text[i + m.len()..].starts_with(|c: char| c.is_alphanumeric() || c == '_'));
            assert!(!found, "{file}: stage {own} ({stage}) imports from stage {at} ({later})");
        }
    }
}

#[test]
fn server_stages_import_backward_only() {
    assert_one_way(
        "server/src",
        &[
            "scene",
            "octree",
            "render",
            "walk_volume",
            "placement",
            "portal",
            "construct",
            "pack",
            "tree",
            "store",
            "plan",
            "serve",
            "build",
            "cli",
        ],
    );
}

#[test]
fn client_stages_import_backward_only() {
    assert_one_way(
        "client/src",
        &[
            "resident",
            "simd",
            "frame",
            "cache",
            "stream",
            "near",
            "impostor",
            "warp",
            "gpu",
            "tree",
            "composite",
            "metrics",
            "report",
            "engine",
            "app",
            "cli",
        ],
    );
}

#[test]
fn displays_and_graphics_cards_only_where_they_belong() {
    let mut users = BTreeSet::new();
    for folder in ["server/src", "client/src", "protocol/src", "tests/src"] {
        for (file, text) in sources(folder) {
            // Drawing on the card and showing pictures know wgpu; windows and what is drawn over pictures belong to the latter alone.
            for (library, stages) in [
                ("wgpu::", &["client/src/gpu/", "client/src/app/"][..]),
                ("winit::", &["client/src/app/"]),
                ("egui::", &["client/src/app/"]),
            ] {
                let found = text
                    .match_indices(library)
                    .any(|(i, _)| !text[..i].ends_with(|c: char| c.is_alphanumeric() || c == '_'));
                assert!(!found || stages.iter().any(|s| file.starts_with(s)), "{file} uses {library}");
                if found {
                    users.insert(library);
                }
            }
        }
    }
    assert_eq!(users.len(), 3, "the search finds what is there: {users:?}");
    let server = dependencies("ldi-server");
    for banned in ["wgpu", "winit", "egui"] {
        assert!(!server.contains(banned), "ldi-server depends on {banned}");
    }
}

#[test]
fn sockets_only_where_they_belong() {
    for folder in ["server/src", "client/src"] {
        for (file, text) in sources(folder) {
            let allowed = file.starts_with("server/src/serve") || file.starts_with("client/src/stream");
            for banned in ["quinn::", "UdpSocket", "TcpListener", "axum::"] {
                assert!(allowed || !text.contains(banned), "{file} uses {banned}");
            }
        }
    }
}

#[test]
fn unsafe_code_says_why() {
    for folder in ["server/src", "client/src", "tests/src"] {
        for (file, text) in sources(folder) {
            let blocks = text.matches("unsafe {").count() + text.matches("unsafe impl").count();
            assert!(
                text.matches("SAFETY:").count() >= blocks.min(1) && (blocks == 0 || text.contains("SAFETY:")),
                "{file}: unsafe without SAFETY"
            );
        }
    }
}
