//! The LDI tree as a piece of a build: made once, and found by later runs with the same input.

use super::{BuildError, key};
use crate::pack::Chunk;
use crate::render::Caster;
use crate::store::DatasetWriter;
use crate::tree::{self, BuiltTree, Depth, Places, TreeFigures};
use ldi_protocol::{Aabb, index::ChunkKind, tree::Tree};
use serde::{Deserialize, Serialize};

/// What is kept of a tree besides the bytes of its chunks.
#[derive(Serialize, Deserialize)]
struct Kept {
    tree: Tree,
    figures: TreeFigures,
    /// Stored and decoded bytes of each chunk.
    chunks: Vec<(u32, u64)>,
}

/// What a tree is made from.
pub(super) struct TreeInput<'a> {
    pub caster: &'a Caster,
    pub bounds: &'a Aabb,
    pub places: &'a Places,
    pub scene_key: &'a [u8; 32],
    /// Number of its first chunk.
    pub first_chunk: u32,
}

impl TreeInput<'_> {
    /// Builds the tree unless an earlier run has. None: no eye sees any surface.
    pub fn tree(
        &self,
        depth: Depth,
        writer: &DatasetWriter,
        heard: &dyn Fn(&str),
    ) -> Result<Option<BuiltTree>, BuildError> {
        let key = key::tree_key(self.scene_key, &(depth, self.first_chunk, self.bounds), self.places);
        if let Some(found) = writer.cached(&key).and_then(|piece| unpack(&piece)) {
            heard("kept from an earlier run");
            return Ok(Some(found));
        }
        let built = tree::build_tree(self.caster, self.bounds, self.places, depth, self.first_chunk, heard)?;
        if let Some(built) = &built {
            writer.store(&key, &pack(built))?;
        }
        Ok(built)
    }
}

fn pack(built: &BuiltTree) -> Vec<u8> {
    let sizes = built.chunks.iter().map(|c| (c.bytes.len() as u32, c.decoded_bytes as u64));
    let kept = Kept { tree: built.tree.clone(), figures: built.figures.clone(), chunks: sizes.collect() };
    // Plain data: serialization does not fail.
    let head = rmp_serde::to_vec(&kept).unwrap_or_default();
    let mut out = (head.len() as u64).to_le_bytes().to_vec();
    out.extend(head);
    out.extend(built.chunks.iter().flat_map(|c| &c.bytes));
    out
}

fn unpack(piece: &[u8]) -> Option<BuiltTree> {
    let (length, rest) = piece.split_first_chunk::<8>()?;
    let (head, mut rest) = rest.split_at_checked(usize::try_from(u64::from_le_bytes(*length)).ok()?)?;
    let Kept { tree, figures, chunks: sizes } = rmp_serde::from_slice(head).ok()?;
    let mut chunks = Vec::new();
    for (stored, decoded) in sizes {
        let (bytes, after) = rest.split_at_checked(stored as usize)?;
        chunks.push(Chunk {
            kind: ChunkKind::Tree,
            bytes: bytes.to_vec(),
            decoded_bytes: usize::try_from(decoded).ok()?,
        });
        rest = after;
    }
    rest.is_empty().then_some(BuiltTree { tree, chunks, figures })
}

#[cfg(test)]
mod tests {
    use super::super::{BuildOptions, Progress, Represent, build};
    use ldi_protocol::{
        OutputCamera,
        codec::ColourProfile,
        index::{BuildSettings, CELLS},
    };
    use std::{sync::Mutex, time::Duration};

    /// Remembers what it is told.
    #[derive(Default)]
    struct Notes(Mutex<Vec<String>>);
    impl Progress for Notes {
        fn stage(&self, _: &str, _: u64) {}
        fn advance(&self, _: u64) {}
        fn note(&self, what: &str) {
            self.0.lock().expect("no test panics while it holds the lock").push(what.into());
        }
    }

    /// A build without time for images keeps its tree for the one that goes on.
    #[test]
    fn the_tree_is_made_once() {
        let output = std::env::temp_dir().join(format!("ldi-kept-tree-{}", std::process::id()));
        let _ = std::fs::remove_dir_all(&output);
        let options = BuildOptions {
            scenes: vec!["builtin:house?triangles=3000&seed=1".into()],
            output: output.clone(),
            settings: BuildSettings {
                budget: 1500,
                optimize_budget: 0,
                camera: OutputCamera { width: 64, height: 36, fov_deg: 60.0 },
                max_footprint_px: 2.0,
                max_deviation_px: 0.5,
                pitch_deg: 60.0,
                density: 1.0,
                colour: "high".into(),
                grid: CELLS.into(),
                eye_height_m: Some(1.6),
            },
            budget: crate::build::BudgetRule::Given,
            colour: ColourProfile::High,
            represent: Represent::Grid,
            starts: Vec::new(),
            along: None,
            time_limit: Some(Duration::ZERO),
        };
        let built = || {
            let notes = Notes::default();
            let built = build(&options, &notes).expect("builds");
            let notes = notes.0.into_inner().expect("no test panics while it holds the lock");
            (built.written.hash, notes.iter().any(|n| n == "kept from an earlier run"))
        };
        let (first, second) = (built(), built());
        assert_eq!((first.1, second.1), (false, true));
        assert_eq!(first.0, second.0);
        std::fs::remove_dir_all(&output).expect("removed");
    }
}
