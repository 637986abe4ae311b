//! The reference: depth lists per pixel (Chang, Bishop, Lastra 1999, section 3.3).
//!
//! Every splat adds an entry to the list of each pixel that its wide form reaches. The nearest
//! entry that covers the pixel is the surface that shows; entries within their merge threshold of
//! it are of this surface, and their weighted mean is its colour. Slow, and without a z-buffer.

use super::{
    TreeOptions,
    pixel_mask::PixelMask,
    splat_projection::{Drawn, SplatProjection},
};
use crate::{frame::pack_rgb, resident::Resident, warp::FarFrame};
use ldi_protocol::{
    OutputCamera, Pose,
    shade::{linear_from_srgb8_table, srgb8_from_linear},
    tree::{Lens, Tree, cut},
};

/// An entry of a pixel's list.
#[derive(Clone, Copy)]
struct Entry {
    depth_m: f32,
    merge_m: f32,
    weight: f32,
    covers: bool,
    colour: [f32; 3],
}

/// Draws a tree without gap filling. Returns the picture and the mean length of non-empty lists.
pub fn draw(
    tree: &Tree,
    resident: &dyn Resident,
    pose: &Pose,
    camera: &OutputCamera,
    options: &TreeOptions,
) -> (FarFrame, f64) {
    let view = SplatProjection::new(pose, camera);
    let nodes = cut(tree, pose, &Lens::from(camera), &options.cut, |c| resident.brood(c).is_some());
    let wanted = PixelMask::all(camera.width, camera.height);
    let mut lists: Vec<Vec<Entry>> = vec![Vec::new(); camera.width as usize * camera.height as usize];
    let linear = linear_from_srgb8_table();
    for n in &nodes.nodes {
        let Some(brood) = resident.brood(n.home.0) else { continue };
        let mut found = Vec::new();
        let samples = &brood.nodes[usize::from(n.home.1)].samples;
        let drawn = Drawn { filtered: n.filtered, within: false };
        view.splats(tree, &tree.nodes[n.node as usize], drawn, samples, &wanted, &mut found);
        for splat in &found {
            for row in splat.rows[0]..=splat.rows[1] {
                for column in splat.columns[0]..=splat.columns[1] {
                    let Some((disparity, s, t)) = splat.at(column as f32 + 0.5, row as f32 + 0.5) else { continue };
                    lists[row as usize * camera.width as usize + column as usize].push(Entry {
                        depth_m: 1.0 / disparity,
                        merge_m: splat.merge_m,
                        weight: (1.0 - s.abs()) * (1.0 - t.abs()) * splat.coverage(),
                        covers: splat.covers(s, t),
                        colour: splat.rgb.map(|c| linear[usize::from(c)]),
                    });
                }
            }
        }
    }
    let mut out = FarFrame::new(camera.width, camera.height);
    out.clear();
    let (mut entries, mut filled) = (0usize, 0usize);
    for (packed, list) in out.packed.iter_mut().zip(&lists) {
        entries += list.len();
        filled += usize::from(!list.is_empty());
        if let Some((rgb, depth_m)) = blend(list) {
            *packed = FarFrame::pack(1.0 / depth_m, pack_rgb(rgb.map(srgb8_from_linear)));
        }
    }
    (out, entries as f64 / filled.max(1) as f64)
}

/// Colour and depth of the surface that a list shows; None if no entry covers the pixel.
fn blend(list: &[Entry]) -> Option<([f32; 3], f32)> {
    let front = list.iter().filter(|e| e.covers).map(|e| e.depth_m).min_by(f32::total_cmp)?;
    let (mut sum, mut weight) = ([0.0f32; 3], 0.0);
    for e in list.iter().filter(|e| (e.depth_m - front).abs() <= e.merge_m) {
        weight += e.weight;
        sum = std::array::from_fn(|k| sum[k] + e.colour[k] * e.weight);
    }
    Some((sum.map(|c| c / weight), front))
}
