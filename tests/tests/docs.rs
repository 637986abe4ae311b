//! Generated documentation is up to date, and no link leads nowhere.

use ldi_tests::bench::docs;
use std::path::{Path, PathBuf};

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).parent().expect("the workspace is one up").to_path_buf()
}

#[test]
fn generated_pages_are_up_to_date() {
    let stale = docs::stale(&root()).expect("generated");
    assert!(stale.is_empty(), "run `ldi-bench docs` in the project's folder: {stale:?}");
}

fn pages(folder: &Path, found: &mut Vec<PathBuf>) {
    for entry in std::fs::read_dir(folder).expect("readable") {
        let path = entry.expect("readable").path();
        if path.is_dir() {
            pages(&path, found);
        } else if path.extension().is_some_and(|e| e == "md") {
            found.push(path);
        }
    }
}

/// All pages with their texts.
fn all() -> Vec<(PathBuf, String)> {
    let mut found = vec![root().join("README.md"), root().join("CHANGELOG.md")];
    pages(&root().join("docs"), &mut found);
    let read = |page: PathBuf| {
        let text = std::fs::read_to_string(&page).expect("readable");
        (page, text)
    };
    found.into_iter().map(read).collect()
}

#[test]
fn files_that_pages_name_exist() {
    let folders = ["server/", "client/", "protocol/", "tests/", "deploy/", "docs/"];
    for (page, text) in all() {
        let names = text.split('`').filter(|n| folders.iter().any(|f| n.starts_with(f)));
        for name in names.filter(|n| !n.contains([' ', '\n', '*']) && !n.contains("PAGE")) {
            assert!(root().join(name).exists(), "{}: {name}", page.display());
        }
    }
}

#[test]
fn links_of_pages_lead_somewhere() {
    for (page, text) in all() {
        let links = text.split("](").skip(1).filter_map(|rest| rest.split(')').next());
        for link in links.filter(|l| !l.contains("://") && !l.starts_with('#')) {
            let file = link.split('#').next().unwrap_or_default();
            let target = page.parent().expect("a folder").join(file);
            assert!(target.exists(), "{}: {link}", page.display());
        }
    }
}
