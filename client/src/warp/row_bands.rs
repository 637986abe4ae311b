//! The warp's driver: cuts the output into bands of rows and runs the kernels. Each band draws its
//! share of all images, so that small images leave no thread idle.

use super::{
    FarFrame, ImageInView, Order, Stamp, WarpError, WarpMatrix, WarpOptions, WarpStats,
    cull::Reach,
    ewa::Means,
    occlusion::Before,
    occlusion_order::{Epipole, Streams, paint_tile},
    prepared::PreparedLdi,
    quad_raster::{Target, draw_tile},
    stamps::{own_rows, pixels_of_tile, stamp_tile},
    tiles::{Part, Tile},
    transform::{Largest, Scratch, TileTransform, Transformed, Wanted, Window, transform_tile},
};
use crate::simd::{Lanes, Portable};
use ldi_protocol::{OutputCamera, Pose};
use rayon::prelude::*;

/// What all bands share.
struct Job<'a> {
    images: &'a [Reaching<'a>],
    options: &'a WarpOptions,
    /// Whether samples are painted, or only transformed.
    paint: bool,
    before: Option<Before<'a>>,
}

/// Number of tiles that one thread tests against near geometry before it shares the work.
const TILES_AT_ONCE: usize = 32;

/// What of an image reaches the picture.
struct Reaching<'a> {
    matrix: WarpMatrix,
    tiles: Vec<Reach<'a>>,
    in_order: Option<(Epipole, &'a Streams)>,
    /// Samples of tiles hidden by near geometry.
    hidden: u64,
}

/// Warps an image into `into`, keeping the nearer of its pixels and the image's samples.
///
/// With order epipole the image's samples replace what is already there instead. Runs on the
/// current rayon pool; the result does not depend on the pool's size.
///
/// # Errors
///
/// When the order cannot draw the stamp.
pub fn warp(
    ldi: &PreparedLdi,
    pose: &Pose,
    camera: &OutputCamera,
    options: &WarpOptions,
    into: &mut FarFrame,
) -> Result<WarpStats, WarpError> {
    check(options)?;
    Ok(run(&[ImageInView::from(ldi)], &[], pose, camera, options, (pose, true), into))
}

/// Warps several images to one picture: within an image by the given order, between images by
/// depth. `spare`: a buffer.
///
/// `near`: disparities (1/m, row-major, 0 for none) of near geometry, or empty. Samples hidden by
/// it beyond rounding may be missing from the picture.
///
/// # Errors
///
/// When the order cannot draw the stamp.
pub fn warp_images(
    images: &[ImageInView<'_>],
    near: &[f32],
    pose: &Pose,
    camera: &OutputCamera,
    options: &WarpOptions,
    into: &mut FarFrame,
    spare: &mut FarFrame,
) -> Result<WarpStats, WarpError> {
    check(options)?;
    // In order, an image can only be painted onto an empty picture.
    let at_once = match options.order {
        Order::Z => images.len(),
        Order::Epipole => images.len().min(usize::from(into.is_untouched())),
    };
    let (together, singly) = images.split_at(at_once);
    let mut stats = run(together, near, pose, camera, options, (pose, true), into);
    for image in singly {
        spare.reset(camera.width, camera.height);
        stats.add(&run(&[*image], near, pose, camera, options, (pose, true), spare));
        into.take_nearer(spare);
    }
    Ok(stats)
}

/// Does everything that [`warp`] does for any stamp except painting, to measure the computation
/// alone.
pub fn transform_only(
    ldi: &PreparedLdi,
    pose: &Pose,
    camera: &OutputCamera,
    options: &WarpOptions,
    into: &mut FarFrame,
) -> WarpStats {
    let options = WarpOptions { order: Order::Z, ..*options };
    run(&[ImageInView::from(ldi)], &[], pose, camera, &options, (pose, false), into)
}

/// Warps images to a pose; with order epipole in that of the pose `order`, each over the previous
/// ones. See [`check`].
fn run(
    images: &[ImageInView<'_>],
    near: &[f32],
    pose: &Pose,
    camera: &OutputCamera,
    options: &WarpOptions,
    (order, paint): (&Pose, bool),
    into: &mut FarFrame,
) -> WarpStats {
    if (into.width, into.height) != (camera.width, camera.height) {
        into.reset(camera.width, camera.height);
    }
    let may_hide = paint && !options.keep_hidden && options.order == Order::Z;
    let before = may_hide.then(|| Before::new(near, options.stamp, camera));
    let reaching = images.par_iter().map(|ImageInView { laid_out: ldi, within }| {
        let matrix = WarpMatrix::new(&ldi.camera, pose, camera);
        let within = wanted(*within, camera);
        let in_order = (options.order == Order::Epipole).then(|| (Epipole::new(&ldi.camera, order), ldi.streams()));
        let mut tiles = match &in_order {
            Some((_, streams)) => streams.reaching(&matrix, within, options.keep_all_tiles),
            None => ldi.blocks.reaching(&ldi.parts, &matrix, within, options.keep_all_tiles),
        };
        if let Some((epipole, _)) = &in_order {
            epipole.sort_tiles(&mut tiles);
        }
        let mut hidden = 0;
        if let Some(before) = &before {
            let own = |tiles: &[Reach<'_>]| tiles.iter().map(|t| u64::from(t.tile.own)).sum::<u64>();
            hidden = own(&tiles);
            // Few images may have most of the tiles.
            tiles =
                tiles.into_par_iter().with_min_len(TILES_AT_ONCE).filter(|t| !before.near_hides(&t.within)).collect();
            hidden -= own(&tiles);
        }
        Reaching { matrix, tiles, in_order, hidden }
    });
    let reaching: Vec<Reaching<'_>> = reaching.collect();
    let clear = into.stale;
    into.stale = false;
    let width = into.width;
    let bands = cut(reaching.iter().flat_map(|i| &i.tiles), into.height, rayon::current_num_threads());
    let mut targets = Vec::with_capacity(bands.len());
    let mut rest = into.packed.as_mut_slice();
    for (first_row, rows) in bands {
        let (pixels, later) = rest.split_at_mut(rows as usize * width as usize);
        rest = later;
        targets.push(Target { pixels, window: Window { width, first_row, rows } });
    }
    let job = Job { images: &reaching, options, paint, before };
    let parts: Vec<WarpStats> = targets
        .into_par_iter()
        .map(|mut target| {
            if clear {
                target.pixels.fill(0);
            }
            dispatch(&job, &mut target)
        })
        .collect();
    let mut stats = WarpStats { bytes: picture_bytes(camera), ..WarpStats::default() };
    parts.iter().for_each(|p| stats.add(p));
    stats.samples_hidden += reaching.iter().map(|r| r.hidden).sum::<u64>();
    stats.samples = images.iter().map(|i| i.laid_out.samples as u64).sum();
    stats.samples_culled = stats.samples - stats.samples_warped;
    stats
}

/// Whether the order can draw the stamp.
fn check(options: &WarpOptions) -> Result<(), WarpError> {
    match (options.order, options.stamp) {
        (Order::Z, _) | (Order::Epipole, Stamp::OnePixel | Stamp::TwoByTwo) => Ok(()),
        (Order::Epipole, stamp) => Err(WarpError::OrderWithStamp(stamp)),
    }
}

/// The part of the picture to paint: left, top, right, bottom.
fn wanted(within: Option<[u32; 4]>, camera: &OutputCamera) -> [u32; 4] {
    let whole = [0, 0, camera.width, camera.height];
    within.map_or(whole, |w| std::array::from_fn(|k| w[k].min(whole[2 + k % 2])))
}

/// Bytes of a picture, cleared and written.
pub(crate) fn picture_bytes(camera: &OutputCamera) -> u64 {
    2 * u64::from(camera.width) * u64::from(camera.height) * size_of::<u64>() as u64
}

/// A tile that reaches the picture, for drawing on the GPU.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TileJob {
    /// Its part, and its place there.
    pub number: [u32; 2],
    /// X, Y and W on the output as functions of (u, v, 1, disparity), with u and v in LDI pixels
    /// from the tile's upper left corner.
    pub rows: [[f32; 4]; 3],
}

/// The tiles of an image that reach the picture, and the statistics known before the warp.
pub fn tile_jobs(
    ImageInView { laid_out: ldi, within }: &ImageInView<'_>,
    pose: &Pose,
    camera: &OutputCamera,
    options: &WarpOptions,
) -> (Vec<TileJob>, WarpStats) {
    let matrix = WarpMatrix::new(&ldi.camera, pose, camera);
    let tiles = ldi.blocks.reaching(&ldi.parts, &matrix, wanted(*within, camera), options.keep_all_tiles);
    let mut stats = WarpStats { samples: ldi.samples as u64, ..WarpStats::default() };
    tiles.iter().for_each(|t| stats.count_tile(t.part, t.tile, options.stamp));
    stats.samples_culled = stats.samples - stats.samples_warped;
    let job =
        |t: &Reach<'_>| TileJob { number: [t.number.0, t.number.1], rows: TileTransform::new(&matrix, t.tile).rows };
    (tiles.iter().map(job).collect(), stats)
}

/// The kernels' result for every sample, culled or not.
pub fn transformed(ldi: &PreparedLdi, pose: &Pose, camera: &OutputCamera, portable: bool) -> Vec<Transformed> {
    let matrix = WarpMatrix::new(&ldi.camera, pose, camera);
    let window = Window { width: camera.width, first_row: 0, rows: camera.height };
    let mut scratch = Scratch::default();
    let mut out = Vec::with_capacity(ldi.samples);
    for (part, tile) in ldi.parts.iter().flat_map(|part| part.tiles.iter().map(move |tile| (part, tile))) {
        transform_dispatch(&matrix, part, tile, (&window, portable), &mut scratch);
        for (row, samples) in own_rows(part, tile).enumerate() {
            out.extend(samples.map(|i| Transformed {
                u: f64::from(tile.column) + f64::from(part.column[tile.first + i]) + 0.5,
                v: f64::from(tile.row) + row as f64 + 0.5,
                disparity: part.disparity[tile.first + i],
                x: scratch.x[i],
                y: scratch.y[i],
                warped_disparity: scratch.disparity[i],
                footprint: scratch.footprint2[i].sqrt(),
            }));
        }
    }
    out
}

/// All that a tile's own samples become.
const ALL_OWN: Wanted = Wanted { halo: false, footprints: true, largest: false };

/// Transforms a tile with the best kernels of this machine.
fn transform_dispatch(
    matrix: &WarpMatrix,
    part: &Part,
    tile: &Tile,
    (window, portable): (&Window, bool),
    scratch: &mut Scratch,
) {
    #[cfg(target_arch = "x86_64")]
    if !portable && std::arch::is_x86_feature_detected!("avx2") {
        // SAFETY: AVX2 was detected.
        unsafe { transform_tile_avx2(matrix, part, tile, window, scratch) };
        return;
    }
    let _ = portable;
    transform_tile::<Portable>(matrix, part, tile, (window, ALL_OWN), scratch, &mut Largest::none());
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn transform_tile_avx2(matrix: &WarpMatrix, part: &Part, tile: &Tile, window: &Window, scratch: &mut Scratch) {
    transform_tile::<crate::simd::Avx2>(matrix, part, tile, (window, ALL_OWN), scratch, &mut Largest::none());
}

/// Warps single pixels to one pose in the order of another, to show that the order matters.
#[cfg(test)]
pub fn warp_in_order(ldi: &PreparedLdi, pose: &Pose, order: &Pose, camera: &OutputCamera, into: &mut FarFrame) {
    let options = WarpOptions { stamp: Stamp::OnePixel, order: Order::Epipole, ..WarpOptions::default() };
    run(&[ImageInView::from(ldi)], &[], pose, camera, &options, (order, true), into);
}

/// Cuts the rows into bands (first row, rows) with about equal numbers of samples, one for each
/// thread. More bands would balance better, but both sides of a border process the tiles that cross
/// it.
fn cut<'a>(tiles: impl Iterator<Item = &'a Reach<'a>>, height: u32, threads: usize) -> Vec<(u32, u32)> {
    let wanted = threads.max(1);
    let mut weight = vec![0.0f64; height as usize + 1];
    for t in tiles {
        // Spread evenly over the tile's rows, as a difference array.
        let per_row = f64::from(t.tile.own) / f64::from((t.within.to - t.within.from).max(1));
        weight[t.within.from.min(height) as usize] += per_row;
        weight[t.within.to.min(height) as usize] -= per_row;
    }
    let (mut rate, mut sum) = (0.0, 0.0);
    // Empty rows cost their clearing.
    let cumulative: Vec<f64> = weight[..height as usize]
        .iter()
        .map(|w| {
            rate += w;
            sum += rate.max(0.0) + 1.0;
            sum
        })
        .collect();
    let mut bands = Vec::with_capacity(wanted);
    let mut first = 0;
    for i in 1..=wanted {
        let target = sum * i as f64 / wanted as f64;
        let end = if i == wanted { height } else { cumulative.partition_point(|c| *c < target) as u32 };
        if end > first {
            bands.push((first, end - first));
            first = end;
        }
    }
    bands
}

/// Runs the best kernels of this machine.
fn dispatch(job: &Job<'_>, target: &mut Target<'_>) -> WarpStats {
    let pixels = job.paint && job.options.stamp == Stamp::OnePixel && job.options.order == Order::Z;
    #[cfg(target_arch = "x86_64")]
    if !job.options.portable && std::arch::is_x86_feature_detected!("avx2") {
        // SAFETY: AVX2 was detected.
        return unsafe {
            if pixels { draw_band_avx2::<true>(job, target) } else { draw_band_avx2::<false>(job, target) }
        };
    }
    if pixels { draw_band::<Portable, true>(job, target) } else { draw_band::<Portable, false>(job, target) }
}

#[cfg(target_arch = "x86_64")]
#[target_feature(enable = "avx2")]
fn draw_band_avx2<const PIXELS: bool>(job: &Job<'_>, target: &mut Target<'_>) -> WarpStats {
    draw_band::<crate::simd::Avx2, PIXELS>(job, target)
}

/// `PIXELS`: single pixels in depth order, in code of its own, so that no registers are kept for
/// the rest.
#[inline(always)]
fn draw_band<L: Lanes, const PIXELS: bool>(job: &Job<'_>, target: &mut Target<'_>) -> WarpStats {
    let (mut stats, mut scratch, mut largest) = (WarpStats::default(), Scratch::default(), Largest::<L>::none());
    for image in job.images {
        draw_image::<L, PIXELS>(image, job, target, (&mut scratch, &mut largest), &mut stats);
    }
    stats.footprint_max_px = largest.squared().sqrt();
    stats
}

/// The share of an image that a band holds.
#[inline(always)]
fn draw_image<L: Lanes, const PIXELS: bool>(
    image: &Reaching<'_>,
    job: &Job<'_>,
    target: &mut Target<'_>,
    (scratch, largest): (&mut Scratch, &mut Largest<L>),
    stats: &mut WarpStats,
) {
    let window = target.window;
    let (matrix, stamp) = (&image.matrix, if PIXELS { Stamp::OnePixel } else { job.options.stamp });
    // Only quads extend to samples of the next tiles.
    let (halo, footprints) = (stamp == Stamp::Quads, stamp == Stamp::Footprint);
    let here = |t: &&Reach<'_>| t.within.to > window.first_row && t.within.from < window.first_row + window.rows;
    // A tile that straddles bands is counted in its first one.
    let is_home = |t: &Reach<'_>| t.within.from >= window.first_row;
    let hides = |target: &Target<'_>, t: &Reach<'_>| job.before.as_ref().is_some_and(|b| b.hides(target, &t.within));
    let tiles = || image.tiles.iter().filter(here);
    if !PIXELS && let Some((epipole, streams)) = &image.in_order {
        for t in tiles() {
            paint_tile::<L>(target, matrix, epipole, streams, t, stamp, largest);
            if is_home(t) {
                stats.count_tile(t.part, t.tile, stamp);
            }
        }
        return;
    }
    for t in tiles() {
        if hides(target, t) {
            stats.samples_hidden += if is_home(t) { u64::from(t.tile.own) } else { 0 };
            continue;
        }
        if is_home(t) {
            stats.count_tile(t.part, t.tile, stamp);
        }
        let bound = t.within.silhouette.map(|s| s.largest_footprint(matrix, &window));
        let wanted = Wanted { halo, footprints, largest: !bound.is_some_and(|bound| largest.is_at_least(bound)) };
        if PIXELS {
            let seen_by = wanted.largest.then_some(&mut *largest);
            pixels_of_tile::<L>(target, (matrix, &TileTransform::new(matrix, t.tile)), (t.part, t.tile), seen_by);
            continue;
        }
        transform_tile::<L>(matrix, t.part, t.tile, (&window, wanted), scratch, largest);
        if !job.paint {
            continue;
        }
        let transform = TileTransform::new(matrix, t.tile);
        if stamp == Stamp::Quads {
            let home = is_home(t);
            let stretch = |side2| stats.stretch.count(side2, home);
            draw_tile::<L>(target, &transform, t.part, t.tile, scratch, stretch);
        } else {
            stamp_tile::<L>(target, &transform, t.part, t.tile, scratch, stamp);
        }
    }
    if stamp == Stamp::Ewa && job.paint {
        let mut means = Means::new(target);
        for t in tiles() {
            if hides(target, t) {
                continue;
            }
            let wanted = Wanted { halo, footprints, largest: false };
            transform_tile::<L>(matrix, t.part, t.tile, (&window, wanted), scratch, largest);
            means.add_tile(target, &TileTransform::new(matrix, t.tile), t.part, t.tile, scratch);
        }
        means.write(target);
    }
}
