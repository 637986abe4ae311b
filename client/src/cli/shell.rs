//! What shells and readers of manuals are given: completions and man pages of `ldi-client`.

use super::{failure::Failure, input::check_folder};
use clap::Command;
use clap_complete::Shell;
use ldi_protocol::said::is_lasting;
use std::{io::Write as _, path::Path};

/// Name of the program.
const NAME: &str = "ldi-client";

/// Writes completions of the program's `command` to standard output; a reader that has gone is no
/// failure.
pub fn completions(shell: Shell, mut command: Command) -> Result<(), Failure> {
    let mut text = Vec::new();
    clap_complete::generate(shell, &mut command, NAME, &mut text);
    let _ = std::io::stdout().lock().write_all(&text);
    Ok(())
}

/// Writes a page for the program and one for each command into a folder.
pub fn man(folder: &Path, command: Command) -> Result<(), Failure> {
    check_folder(folder, "-o")?;
    let failed = |e: std::io::Error| Failure {
        code: if is_lasting(&e) { 42 } else { 1 },
        error: anyhow::Error::new(e).context(format!("-o {}: give a folder that can be written", folder.display())),
    };
    std::fs::create_dir_all(folder).map_err(failed)?;
    clap_mangen::generate_to(command, folder).map_err(failed)?;
    println!("{}: pages of {NAME}; read them with: man {}/{NAME}.1", folder.display(), folder.display());
    Ok(())
}
