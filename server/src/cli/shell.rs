//! What shells and readers of manuals are given: completions and man pages of `ldi-server`.

use super::Failure;
use super::args::Cli;
use super::outputs::{cannot_write, make_folder, print};
use clap::CommandFactory as _;
use clap_complete::Shell;
use std::path::Path;

/// Name of the program.
const NAME: &str = "ldi-server";

/// Writes completions to standard output.
pub(super) fn completions(shell: Shell) -> Result<(), Failure> {
    let mut text = Vec::new();
    clap_complete::generate(shell, &mut Cli::command(), NAME, &mut text);
    print(String::from_utf8_lossy(&text).trim_end())
}

/// Writes a page for the program and one for each command into a folder.
pub(super) fn man(folder: &Path) -> Result<(), Failure> {
    make_folder(folder)?;
    clap_mangen::generate_to(Cli::command(), folder).map_err(|e| cannot_write(&folder.join("ldi-server.1"), e))?;
    print(&format!("{}: pages of {NAME}; read them with: man {}/{NAME}.1", folder.display(), folder.display()))
}
