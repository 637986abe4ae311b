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

/// The root holds the folders of the workspace, its documents and hidden files.
#[test]
fn the_root_holds_nothing_else() {
    let known = |name: &str| {
        name.starts_with('.')
            || ["README.md", "LICENSE-APACHE", "LICENSE-MIT", "CHANGELOG.md", "Cargo.toml", "Cargo.lock"]
                .contains(&name)
            || ["server", "client", "protocol", "deploy", "tests", "docs", "target", "out"].contains(&name)
    };
    for entry in std::fs::read_dir(root()).expect("readable") {
        let name = entry.expect("readable").file_name().to_string_lossy().into_owned();
        assert!(known(&name), "{name} does not belong into the root");
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
            let mut modules = text.match_indices("#[cfg(test)]\nmod ");
            let in_braces = |(at, start): &(usize, &str)| {
                text[at + start.len()..].lines().next().is_some_and(|line| line.ends_with('{'))
            };
            let code = modules.find(in_braces).map_or(text.as_str(), |(at, _)| &text[..at]).to_string();
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
            "levels",
            "render",
            "walk_volume",
            "floor_plans",
            "placement",
            "portal",
            "construct",
            "pack",
            "tree",
            "store",
            "tour",
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
            "tree",
            "composite",
            "gpu",
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
            // Drawing on the card and showing pictures know wgpu; windows and what is drawn over
            // pictures belong to the latter alone.
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

/// Crates whose files must not import each other in a circle.
const CRATES_WITHOUT_CIRCLES: &[&str] = &["client"];

#[test]
fn files_do_not_import_each_other_in_circles() {
    for name in CRATES_WITHOUT_CIRCLES {
        let folder = format!("{name}/src");
        let files = sources(&folder)
            .into_iter()
            .map(|(file, text)| (file.trim_start_matches(&folder).trim_start_matches('/').to_string(), text));
        let circles = imports::circles(&imports::graph(files));
        assert!(circles.is_empty(), "crate {name}: files import each other:\n{}", circles.join("\n"));
    }
}

#[test]
fn a_circle_of_files_is_found() {
    let file = |name: &str, text: &str| (name.to_string(), text.to_string());
    let circle = [
        file("lib.rs", "mod a;\nmod b;\n"),
        file("a.rs", "use crate::b::{\n    B,\n    C as D,\n};\npub struct A;\n"),
        file("b/mod.rs", "mod c;\npub use c::C;\npub struct B;\n"),
        file("b/c.rs", "pub struct C(super::super::a::A);\n"),
    ];
    let found = imports::circles(&imports::graph(circle.clone()));
    assert_eq!(found.len(), 1, "{found:?}");
    assert!(found[0].contains("a -> b::c (C)") && found[0].contains("b::c -> a (A)"), "{found:?}");
    // Without the import of `C`, which `b` only passes on, nothing leads back.
    let mut open = circle;
    open[1].1 = open[1].1.replace("    C as D,\n", "");
    assert_eq!(imports::circles(&imports::graph(open)), Vec::<String>::new());
}

/// The import graph of a crate's files, read from their text.
///
/// - A file imports another when it names an item that the other defines: in a `use` declaration,
///   or inline in a path that begins with `crate::`, `super::`, `self::` or the name of a child
///   module.
/// - `use` lists are expanded. A name that a file passes on with `use` or `pub use` counts for the
///   file that defines it, so a `mod.rs` that passes on its children's names imports nothing by
///   that.
/// - A declaration `mod child;` is no import. A path that ends in a module (`use crate::walker;`)
///   counts where the module's items are named.
/// - Comments, test files and test modules are left out; a module in braces belongs to its file.
///   Names that macros make and glob imports are not followed.
mod imports {
    use std::collections::{BTreeMap, BTreeSet};

    type Module = Vec<String>;
    /// Names that each module imports from each other module.
    pub type Graph = BTreeMap<Module, BTreeMap<Module, BTreeSet<String>>>;

    struct File {
        /// Absolute paths that the file names.
        paths: Vec<Vec<String>>,
        /// Names that the file brings into scope, with the absolute path of each.
        scope: BTreeMap<String, Vec<String>>,
    }

    fn module_of(file: &str) -> Module {
        let mut module: Module = file.trim_end_matches(".rs").split('/').map(str::to_string).collect();
        if module.last().is_some_and(|last| ["mod", "lib", "main"].contains(&last.as_str())) {
            module.pop();
        }
        module
    }

    /// The text without comments. Text in quotes that looks like a comment is cut as well, which
    /// can only hide an import behind it on the same line.
    fn without_comments(text: &str) -> String {
        text.lines().map(|l| l.split("//").next().unwrap_or_default()).collect::<Vec<_>>().join("\n")
    }

    /// The single paths of a `use` tree: `a::{b, c::D as E}` gives `a::b` and `a::c::D`, the
    /// latter named `E`.
    fn expand(tree: &str) -> Vec<(String, String)> {
        let tree = tree.trim();
        let Some(open) = tree.find('{') else {
            let (path, name) = tree.split_once(" as ").unwrap_or((tree, tree.rsplit("::").next().unwrap_or(tree)));
            return vec![(path.trim().to_string(), name.trim().to_string())];
        };
        let (prefix, list) = (&tree[..open], &tree[open + 1..tree.rfind('}').unwrap_or(tree.len())]);
        let (mut parts, mut depth, mut from) = (Vec::new(), 0, 0);
        for (at, c) in list.char_indices() {
            match c {
                '{' => depth += 1,
                '}' => depth -= 1,
                ',' if depth == 0 => {
                    parts.push(&list[from..at]);
                    from = at + 1;
                }
                _ => {}
            }
        }
        parts.push(&list[from..]);
        let parts = parts.into_iter().filter(|p| !p.trim().is_empty());
        let named = |(path, name): (String, String)| {
            let own = prefix.trim_end_matches("::").rsplit("::").next().unwrap_or_default();
            let name = if name == "self" { own.to_string() } else { name };
            (format!("{prefix}{path}"), name)
        };
        parts.flat_map(expand).map(named).collect()
    }

    /// The path from the crate's root; None for a path into another crate.
    fn absolute(module: &[String], path: &str, modules: &BTreeSet<Module>) -> Option<Vec<String>> {
        let mut segments: Vec<String> = path.split("::").map(|s| s.trim().to_string()).collect();
        if segments.last().is_some_and(|s| s == "self") {
            segments.pop();
        }
        let mut base = module.to_vec();
        match segments.first()?.as_str() {
            "crate" => return Some(segments.split_off(1)),
            "self" => drop(segments.remove(0)),
            "super" => {
                while segments.first().is_some_and(|s| s == "super") {
                    segments.remove(0);
                    base.pop();
                }
            }
            child => {
                let child = [module, &[child.to_string()]].concat();
                if !modules.contains(&child) {
                    return None;
                }
            }
        }
        Some([base, segments].concat())
    }

    /// Paths with `::` in code: maximal runs of identifiers.
    fn inline_paths(code: &str) -> BTreeSet<&str> {
        code.split(|c: char| !(c.is_alphanumeric() || c == '_' || c == ':'))
            .map(|p| p.trim_matches(':'))
            .filter(|p| p.contains("::"))
            .collect()
    }

    fn read(module: &[String], text: &str, modules: &BTreeSet<Module>) -> File {
        let text = without_comments(text);
        let mut file = File { paths: Vec::new(), scope: BTreeMap::new() };
        let mut rest = String::new();
        let mut declaration: Option<(String, bool)> = None;
        for line in text.lines() {
            if declaration.is_none() {
                let code = line.trim_start();
                let passed_on = code.starts_with("pub");
                let body = if passed_on { code.split_once(" use ").map(|(_, b)| b) } else { code.strip_prefix("use ") };
                match body {
                    Some(body) if !passed_on || code.find(" use ").is_some_and(|at| at < 12) => {
                        declaration = Some((body.to_string(), passed_on));
                    }
                    _ => {
                        rest.push_str(line);
                        rest.push('\n');
                        continue;
                    }
                }
            } else if let Some((body, _)) = &mut declaration {
                body.push_str(line);
            }
            let Some((body, passed_on)) = declaration.take_if(|(body, _)| body.contains(';')) else { continue };
            for (path, name) in expand(body.split(';').next().unwrap_or_default()) {
                let Some(path) = absolute(module, &path, modules) else { continue };
                if !passed_on {
                    file.paths.push(path.clone());
                }
                file.scope.insert(name, path);
            }
        }
        for path in inline_paths(&rest) {
            let (first, tail) = path.split_once("::").unwrap_or((path, ""));
            if let Some(known) = file.scope.get(first) {
                let tail = tail.split("::").map(str::to_string);
                let path = known.iter().cloned().chain(tail).collect();
                file.paths.push(path);
            } else if let Some(path) = absolute(module, path, modules) {
                file.paths.push(path);
            }
        }
        file
    }

    /// The module that defines what a path names, and the name; None if the path names a module.
    fn defined_in(path: &[String], files: &BTreeMap<Module, File>, depth: u32) -> Option<(Module, String)> {
        let mut module = Module::new();
        for (at, name) in path.iter().enumerate() {
            let child = [module.clone(), vec![name.clone()]].concat();
            if files.contains_key(&child) {
                module = child;
                continue;
            }
            let known = files.get(&module).and_then(|f| f.scope.get(name)).filter(|_| depth < 8);
            return match known {
                Some(known) => defined_in(&[known.as_slice(), &path[at + 1..]].concat(), files, depth + 1),
                None => Some((module, name.clone())),
            };
        }
        None
    }

    /// The graph of a crate's files, given by path below `src` and text.
    pub fn graph(sources: impl IntoIterator<Item = (String, String)>) -> Graph {
        let texts: BTreeMap<Module, String> =
            sources.into_iter().filter(|(file, _)| file != "main.rs").map(|(f, t)| (module_of(&f), t)).collect();
        let modules: BTreeSet<Module> = texts.keys().cloned().collect();
        let files: BTreeMap<Module, File> =
            texts.iter().map(|(m, text)| (m.clone(), read(m, text, &modules))).collect();
        let mut graph = Graph::new();
        for (module, file) in &files {
            for (other, name) in file.paths.iter().filter_map(|p| defined_in(p, &files, 0)) {
                if other != *module && files.contains_key(&other) {
                    graph.entry(module.clone()).or_default().entry(other).or_default().insert(name);
                }
            }
        }
        graph
    }

    /// Modules that a module reaches by imports.
    fn reached(graph: &Graph, from: &Module) -> BTreeSet<Module> {
        let (mut reached, mut open) = (BTreeSet::new(), vec![from]);
        while let Some(module) = open.pop() {
            for next in graph.get(module).into_iter().flat_map(BTreeMap::keys) {
                if reached.insert(next.clone()) {
                    open.push(next);
                }
            }
        }
        reached
    }

    /// A description of each group of modules that reach each other: every import inside of it.
    pub fn circles(graph: &Graph) -> Vec<String> {
        let reach: BTreeMap<&Module, BTreeSet<Module>> = graph.keys().map(|m| (m, reached(graph, m))).collect();
        let mut groups = BTreeSet::new();
        for (module, reached) in &reach {
            let group: BTreeSet<&Module> =
                reached.iter().filter(|other| reach.get(other).is_some_and(|r| r.contains(*module))).collect();
            if !group.is_empty() {
                groups.insert(group);
            }
        }
        let describe = |group: &BTreeSet<&Module>| {
            let edges = group.iter().flat_map(|m| graph[*m].iter().map(move |(other, names)| (m, other, names)));
            edges
                .filter(|(_, other, _)| group.contains(other))
                .map(|(module, other, names)| {
                    let names = names.iter().cloned().collect::<Vec<_>>().join(", ");
                    format!("  {} -> {} ({names})", module.join("::"), other.join("::"))
                })
                .collect::<Vec<_>>()
                .join("\n")
        };
        groups.iter().map(describe).collect()
    }
}
