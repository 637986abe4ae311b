//! `ldi_zoo`: writes the generated scenes of the zoo, with a path file of their walked places.

use anyhow::{Context as _, Result};
use clap::{Parser, builder::PossibleValuesParser};
use ldi_tests::zoo;
use std::path::PathBuf;

/// Writes generated scenes that stand for what users bring: NAME.glb, and NAME.walked.json with a
/// pose at each place where people walk.
#[derive(Debug, Parser)]
#[command(
    name = "ldi_zoo",
    version,
    after_help = "\
Examples:
  ldi_zoo -o zoo
  ldi_zoo -o zoo mine stadium
  ldi-server render zoo/mine.glb --path zoo/mine.walked.json --size 640x360 --samples 4 -o zoo/mine"
)]
struct Cli {
    /// Scenes to write; all of them when none is named.
    #[arg(value_name = "NAME", value_parser = PossibleValuesParser::new(zoo::names()))]
    names: Vec<String>,
    /// Folder for the files.
    #[arg(short, long)]
    output: PathBuf,
}

fn main() -> Result<()> {
    let cli = Cli::parse();
    std::fs::create_dir_all(&cli.output).with_context(|| format!("cannot make {}", cli.output.display()))?;
    for name in zoo::names().filter(|k| cli.names.is_empty() || cli.names.iter().any(|n| n == k)) {
        let Some(specimen) = zoo::specimen(name) else { continue };
        zoo::write_glb(&specimen, &cli.output.join(format!("{name}.glb")))?;
        let path = cli.output.join(format!("{name}.walked.json"));
        std::fs::write(&path, zoo::walked_path(&specimen).to_string())
            .with_context(|| format!("cannot write {}", path.display()))?;
        println!("{name}: {} triangles, {} walked places", specimen.scene.triangles(), specimen.walked.len());
    }
    Ok(())
}
