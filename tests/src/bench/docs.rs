//! Generated documentation: benchmark pages from JSON, the table of the README, the command
//! reference from `--help`.
//!
//! In: the project's root folder, and the binaries beside the running program. Out: texts by path.

use crate::run;
use anyhow::{Context as _, Result, bail, ensure};
use serde::Deserialize;
use std::{
    collections::BTreeMap,
    fmt::Write as _,
    path::{Path, PathBuf},
};

/// Folder of the studies, below the root.
const DATA: &str = "docs/benchmarks/data";
/// Pages of the benchmarks: file name without ending, heading, first sentence.
const PAGES: [(&str, &str, &str); 8] = [
    ("pictures", "Pictures", "Error and size of datasets, compared with drawing all geometry."),
    ("warp", "Warp", "Time and error of every way to warp, and hard numerical cases."),
    ("placement", "Placement", "Images, pixels and time against the budget, and audits of both promises."),
    ("tree", "LDI tree", "The tree under images, alone, and against images."),
    ("rooms", "Rooms", "Walks by rooms, what culling misses, and the methods of 1998."),
    ("streaming", "Streaming", "Walks over links, many walkers, hostile connections, caches."),
    ("client", "Client", "The window, graphics cards, second visits."),
    ("cached-images", "Cached images", "Images that the client makes, compared with geometry."),
];
/// The study that the README shows, and the lines around it.
const README: (&str, &str, &str) = ("README", "<!-- table: readme -->", "<!-- /table -->");
/// Programs of the command reference, in its order.
const PROGRAMS: [&str; 7] = ["ldi-server", "ldi-client", "ldi-load", "ldi-link", "ldi-demo", "ldi-bench", "ldi_zoo"];
/// The programs whose commands are listed with their options.
const WITH_COMMANDS: [&str; 2] = ["ldi-server", "ldi-client"];
/// Longest line of running text, characters.
const WIDTH: usize = 100;

/// One study: a table, and where its figures come from.
#[derive(Debug, Deserialize)]
#[serde(deny_unknown_fields)]
struct Study {
    page: String,
    order: u32,
    title: String,
    text: String,
    scene: String,
    commit: String,
    date: String,
    machine: String,
    command: Vec<String>,
    columns: Vec<String>,
    rows: Vec<Vec<String>>,
}

impl Study {
    fn table(&self) -> String {
        let row = |cells: &[String]| {
            cells.iter().fold("|".to_owned(), |line, c| format!("{line} {c} |")).replace("|  |", "| |")
        };
        let rule = format!("|{}\n", "---|".repeat(self.columns.len()));
        let rows = self.rows.iter().map(|r| row(r) + "\n").collect::<String>();
        row(&self.columns) + "\n" + &rule + &rows
    }

    fn section(&self) -> String {
        let source =
            format!("Scene: {}. Date: {}. Commit: {}. Machine: {}.", self.scene, self.date, self.commit, self.machine);
        let command = match &self.command[..] {
            [] => String::new(),
            lines => format!("```sh\n{}\n```\n\n", lines.join("\n")),
        };
        let (text, source) = (wrapped(&self.text), wrapped(&source));
        format!("## {}\n\n{text}\n\n{source}\n\n{command}{}", self.title, self.table())
    }
}

/// All generated files, by their path below the root.
///
/// # Errors
/// Data that cannot be read or has no page, a README without its marks, a program that is not
/// there.
pub fn generate(root: &Path) -> Result<BTreeMap<PathBuf, String>> {
    let studies = read_studies(&root.join(DATA))?;
    let mut files = BTreeMap::new();
    for (page, title, first) in PAGES {
        let sections: Vec<String> = studies.iter().filter(|s| s.page == page).map(Study::section).collect();
        ensure!(!sections.is_empty(), "{DATA}: no study of page '{page}'");
        let note = "Written by `ldi-bench docs`; [benchmarks](index.md) says how it was measured.";
        let head = wrapped(&format!("{first} {note}"));
        let text = format!("# {title}\n\n{head}\n\n{}", sections.join("\n"));
        files.insert(PathBuf::from(format!("docs/benchmarks/{page}.md")), text);
    }
    files.insert("README.md".into(), readme(root, &studies)?);
    files.insert("docs/user/commands.md".into(), commands()?);
    Ok(files)
}

/// The generated files that are absent or differ, by their path below the root.
///
/// # Errors
/// As [`generate`].
pub fn stale(root: &Path) -> Result<Vec<PathBuf>> {
    Ok(changed(root)?.into_keys().collect())
}

/// Writes the generated files that differ, and returns them.
///
/// # Errors
/// As [`generate`], and files that cannot be written.
pub fn write(root: &Path) -> Result<Vec<PathBuf>> {
    let changed = changed(root)?;
    for (file, text) in &changed {
        std::fs::write(root.join(file), text).with_context(|| format!("cannot write {}", file.display()))?;
    }
    Ok(changed.into_keys().collect())
}

fn changed(root: &Path) -> Result<BTreeMap<PathBuf, String>> {
    let mut files = generate(root)?;
    files.retain(|file, text| std::fs::read_to_string(root.join(file)).ok().as_ref() != Some(text));
    Ok(files)
}

fn read_studies(folder: &Path) -> Result<Vec<Study>> {
    let entries = std::fs::read_dir(folder)
        .with_context(|| format!("{}: run in the project's folder, or give --root", folder.display()))?;
    let mut studies = Vec::new();
    for entry in entries {
        let file = entry?.path();
        let text = std::fs::read_to_string(&file).with_context(|| file.display().to_string())?;
        let study: Study = serde_json::from_str(&text).with_context(|| file.display().to_string())?;
        let known = study.page == README.0 || PAGES.iter().any(|p| p.0 == study.page);
        ensure!(known, "{}: there is no page '{}'", file.display(), study.page);
        let columns = study.columns.len();
        ensure!(study.rows.iter().all(|r| r.len() == columns), "{}: each row has {columns} texts", file.display());
        studies.push(study);
    }
    studies.sort_by(|a, b| (a.order, &a.title).cmp(&(b.order, &b.title)));
    Ok(studies)
}

fn readme(root: &Path, studies: &[Study]) -> Result<String> {
    let text = std::fs::read_to_string(root.join("README.md")).context("README.md")?;
    let Some(study) = studies.iter().find(|s| s.page == README.0) else {
        bail!("{DATA}: no study of page '{}'", README.0)
    };
    let parts = text.split_once(README.1).and_then(|(before, rest)| Some((before, rest.split_once(README.2)?.1)));
    let Some((before, after)) = parts else { bail!("README.md lacks `{}` or `{}`", README.1, README.2) };
    Ok(format!("{before}{}\n\n{}\n{}{after}", README.1, study.table(), README.2))
}

fn commands() -> Result<String> {
    let head = "The text of `--help` of every program, written by `ldi-bench docs`. \
                The [guide](guide.md) says which to use for what.";
    let mut text = format!("# Commands\n\n{}\n", wrapped(head));
    for program in PROGRAMS {
        let help = help_of(program, None)?;
        write!(text, "\n## {program}\n\n```text\n{help}\n```\n")?;
        if !WITH_COMMANDS.contains(&program) {
            continue;
        }
        for command in listed_commands(&help) {
            write!(text, "\n### {program} {command}\n\n```text\n{}\n```\n", help_of(program, Some(command))?)?;
        }
    }
    Ok(text)
}

/// Names of the commands that a program's help lists.
fn listed_commands(help: &str) -> impl Iterator<Item = &str> {
    let list = help.split("\nCommands:\n").nth(1).and_then(|rest| rest.split("\n\n").next());
    let names = list.unwrap_or_default().lines().filter(|l| l.starts_with("  ") && !l.starts_with("   "));
    names.filter_map(|l| l.split_whitespace().next()).filter(|name| *name != "help")
}

fn help_of(program: &str, command: Option<&str>) -> Result<String> {
    let mut c = run::command(program)?;
    // Of a terminal: lines would be as long as it is wide.
    c.args(command).arg("--help").env_remove("COLUMNS");
    let out = run::run(c)?;
    let text = String::from_utf8(out.stdout).context("--help is UTF-8")?;
    Ok(text.lines().map(str::trim_end).collect::<Vec<_>>().join("\n").trim_end().to_owned())
}

/// Running text in lines of at most [`WIDTH`] characters.
fn wrapped(text: &str) -> String {
    let mut lines = vec![String::new()];
    for word in text.split_whitespace() {
        let line = lines.last_mut().filter(|l| l.is_empty() || l.chars().count() + 1 + word.chars().count() <= WIDTH);
        match line {
            Some(line) => {
                line.push_str(if line.is_empty() { "" } else { " " });
                line.push_str(word);
            }
            None => lines.push(word.to_owned()),
        }
    }
    lines.join("\n")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn text_is_wrapped_at_words() {
        let text = wrapped(&"word ".repeat(60));
        assert!(text.lines().all(|l| l.len() <= WIDTH), "{text}");
        assert_eq!(text.split_whitespace().count(), 60);
    }

    #[test]
    fn commands_are_found_in_help() {
        let help = "About\n\nCommands:\n  walk     Along a path,\n           on and on\n  connect  Freely\n  help     This\n\nOptions:\n  -h";
        assert_eq!(listed_commands(help).collect::<Vec<_>>(), ["walk", "connect"]);
    }
}
