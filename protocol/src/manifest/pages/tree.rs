//! The LDI tree in the manifest: one page for what it is, pages of nodes.

use super::{Numbers, charge, put_numbers, take_numbers};
use crate::{
    codec::{
        CodecError,
        bytes::{Reader, Writer, put_varint, unzigzag, zigzag},
    },
    tree::{Tree, TreeNode},
};
use glam::DVec3;

/// The tree but its nodes.
pub(super) fn put_head(w: &mut Writer, tree: &Tree) -> Result<(), CodecError> {
    put_numbers(w, "tree cube", [tree.origin.x, tree.origin.y, tree.origin.z, tree.edge_m])?;
    let mut numbers = Vec::new();
    put_varint(&mut numbers, tree.root_chunk.into());
    put_varint(&mut numbers, tree.pinned_levels.into());
    w.section("tree", &numbers)
}

pub(super) fn take_head(r: &mut Reader<'_>) -> Result<Tree, CodecError> {
    let cube = take_numbers(r, "tree cube", 4)?;
    let mut numbers = Numbers::take(r, "tree")?;
    let root_chunk = numbers.next("root chunk")?;
    let pinned_levels = numbers.count("pinned levels", 255)? as u8;
    numbers.finish("tree")?;
    let origin = DVec3::new(cube[0], cube[1], cube[2]);
    Ok(Tree { origin, edge_m: cube[3], root_chunk, pinned_levels, nodes: Vec::new() })
}

/// Numbers of nodes: differences to the node before where they grow slowly.
pub(super) fn put_nodes(w: &mut Writer, nodes: &[TreeNode]) -> Result<(), CodecError> {
    let mut numbers = Vec::new();
    let mut last = [0i64; 5];
    for n in nodes {
        put_varint(&mut numbers, n.level.into());
        put_varint(&mut numbers, n.children.into());
        let now = [n.first_child.into(), n.chunk.into(), n.cell[0].into(), n.cell[1].into(), n.cell[2].into()];
        for k in 0..5 {
            // Nodes without children have 0 in both; that says nothing of the next.
            let grows = k > 1 || n.children > 0;
            put_varint(&mut numbers, zigzag(if grows { now[k] - last[k] } else { 0 }));
            last[k] = if grows { now[k] } else { last[k] };
        }
        put_varint(&mut numbers, n.samples.into());
        put_varint(&mut numbers, n.unfiltered.into());
    }
    w.section("tree nodes", &numbers)
}

pub(super) fn take_nodes(r: &mut Reader<'_>, n: usize, decoded: &mut usize) -> Result<Vec<TreeNode>, CodecError> {
    charge::<TreeNode>(decoded, "page count", n)?;
    let mut numbers = Numbers::take(r, "tree nodes")?;
    let mut last = [0i64; 5];
    let mut nodes = Vec::with_capacity(n);
    for _ in 0..n {
        let level = numbers.count("tree level", 255)? as u8;
        let children = numbers.count("tree children", 8)? as u8;
        let mut now = [0; 5];
        for k in 0..5 {
            now[k] = last[k] + unzigzag(numbers.next("tree nodes")?.into());
            last[k] = if k > 1 || children > 0 { now[k] } else { last[k] };
        }
        let out_of_range = |_| CodecError::mismatch("tree nodes", "a number out of range");
        let cell = |k: usize| u16::try_from(now[k]).map_err(out_of_range);
        let number = |k: usize| if children > 0 { u32::try_from(now[k]).map_err(out_of_range) } else { Ok(0) };
        nodes.push(TreeNode {
            level,
            children,
            first_child: number(0)?,
            chunk: number(1)?,
            cell: [cell(2)?, cell(3)?, cell(4)?],
            samples: numbers.next("tree nodes")?,
            unfiltered: numbers.next("tree nodes")?,
        });
    }
    numbers.finish("tree nodes")?;
    Ok(nodes)
}
