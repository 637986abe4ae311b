//! What the program writes for others: completions, man pages, and its costs for builds.

use super::{
    failure::Failure,
    input::{check_file, check_folder},
};
use clap::Command;
use clap_complete::Shell;
use ldi_client::calibrate::measure;
use ldi_protocol::{client_profile::ClientProfile, said::is_lasting};
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

/// Measures this machine and writes its profile.
pub fn calibrate(file: &Path, name: Option<&str>) -> Result<(), Failure> {
    check_file(file, "-o")?;
    let of_file = || file.file_stem().map_or_else(|| NAME.into(), |stem| stem.to_string_lossy().into_owned());
    eprintln!("drawing and warping for some fifteen seconds; leave the machine alone");
    let profile = measure(&name.map_or_else(of_file, str::to_owned)).map_err(Failure::permanent)?;
    let failed = |e: std::io::Error| Failure {
        code: if is_lasting(&e) { 42 } else { 1 },
        error: anyhow::Error::new(e).context(format!("-o {}: give a file that can be written", file.display())),
    };
    let text = serde_json::to_string_pretty(&profile).map_err(Failure::permanent)?;
    std::fs::write(file, text + "\n").map_err(failed)?;
    let ClientProfile { ns_per_triangle, ns_per_pixel, ns_per_sample, .. } = profile;
    println!(
        "{}: {ns_per_triangle:.1} ns per triangle, {ns_per_pixel:.1} per pixel, {ns_per_sample:.1} per sample; \
         ldi-server build SCENE -o DATASET --for {}",
        file.display(),
        file.display()
    );
    Ok(())
}
