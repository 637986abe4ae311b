//! The composite: near geometry, warped images and sky become one picture.
//!
//! In: a [`Frame`] that the rasterizer has drawn near geometry into, and what stands for everything else
//! ([`Far`]). Out: the same frame, finished, and [`CompositeStats`].
//!
//! 1. **By depth** ([`composite`]): cells that were not culled can lie beside or behind the LDI's samples, so the two are
//!    merged by disparity. Near geometry wins within one quantization step of the image's disparity codes, as nearly as those
//!    know where the far surface is, and not beyond: a rug of the images must stay above the floor of the geometry.
//! 2. **Seams** (`seams`): gaps of one pixel within a surface, where images of it or near geometry meet, are closed.
//! 3. **Sky**: a pixel that nothing reached is sky where no image knows of anything else in its direction. Sky lies at infinity, so
//!    the lookup is a rotation. Without an LDI nothing was culled, and what is left is sky.
//!    Where all images are there, sky grows into openings that it borders on (`grow`).
//! 4. **Under it** (`under`): where pixels are left, or data is missing, the LDI tree shows through.
//! 5. **Fill** (`fill`, optional): remaining holes take the colour of the nearest farther surface, of sky around them, or of the last frame, and are marked
//!    [`Source::Filled`].
//! 6. **Smoothing** (`smooth`, optional): the 3 x 3 kernel of Aliaga and Lastra's system, over far pixels.
//! 7. **Averaging** ([`downsample()`]): a supersampled frame is averaged in linear light.
//!
//! All stages run on the current rayon pool by rows; their results do not depend on its size.

mod downsample;
mod hole_fill;
mod seams;
mod sky_fill;
mod smooth;
mod tree_underlay;

pub use downsample::downsample;
pub use hole_fill::Fill;
pub use sky_fill::fill_sky;
pub use tree_underlay::{ImageGaps, pixels_for_tree, underlay_tree};

use crate::{
    frame::{Frame, SKY, Source},
    warp::FarFrame,
};
use glam::DVec3;
use ldi_protocol::{
    OutputCamera, Pose, camera::ViewBasis, index::ImageEntry, ldi::Ldi, portal_view::Cone, sky::SkyMap,
};
use rayon::prelude::*;
use seams::Seam;

/// What stands for the cells that were not drawn.
#[derive(Debug, Clone, Copy)]
pub enum Far<'a> {
    /// Nothing was culled: what the near geometry leaves is sky.
    Nothing,
    /// Something was culled and its image is not there: what the near geometry leaves stays unpainted.
    Missing,
    /// Warped images.
    Images {
        /// The warps' common result.
        picture: &'a FarFrame,
        /// All images of the placement that are in view, absent ones too.
        images: &'a [FarImage<'a>],
        /// Where the placement's eyes see sky, also beside its images.
        sky: Option<&'a SkyMap>,
    },
    /// Warped images of portals: what near geometry leaves open is seen through one of them, or is sky.
    Portals {
        /// The warps' common result.
        picture: &'a FarFrame,
        /// All portals whose images show what lies beyond.
        portals: &'a [FarPortal<'a>],
        /// Whether all else was drawn, so that where no portal is there is sky.
        complete: bool,
    },
}

/// A portal that takes part in a frame.
#[derive(Debug, Clone, Copy)]
pub struct FarPortal<'a> {
    /// What is seen of it from the eye.
    pub cones: &'a [Cone],
    /// The images in view, absent ones too.
    pub images: &'a [FarImage<'a>],
    /// Where its eyes see sky through it, also beside its images.
    pub sky: &'a SkyMap,
}

/// An image that takes part in a frame.
#[derive(Debug, Clone, Copy)]
pub enum FarImage<'a> {
    /// It was warped; its sky bits, camera and disparity codes count. It may hold less than the window it was planned for, left, right, bottom,
    /// top as tangents: nobody was found to look at the rest, so nothing is known of it.
    Here(&'a Ldi, [f64; 4]),
    /// It is not there: what lies in its window is unknown.
    Absent(&'a ImageEntry),
}

impl<'a> FarImage<'a> {
    /// The image of an entry, if it is resident.
    pub fn new(entry: &'a ImageEntry, ldi: Option<&'a Ldi>) -> Self {
        ldi.map_or(Self::Absent(entry), |ldi| Self::Here(ldi, entry.window))
    }
}

/// Settings of the composite.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct CompositeOptions<'a> {
    /// What holes show.
    pub fill: Fill,
    /// Colours of the last frame, for [`Fill::Last`]; without them, or of another size, holes stay.
    pub last: &'a [u32],
    /// Smooth far pixels with a 3 x 3 kernel.
    pub smooth: bool,
}

/// Pixels by origin after the composite.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct CompositeStats {
    /// Pixels of the frame.
    pub pixels: u64,
    /// From near geometry.
    pub near: u64,
    /// From a warped image.
    pub far: u64,
    /// From the LDI tree.
    pub tree: u64,
    /// Known sky.
    pub sky: u64,
    /// Reached by nothing that is known, before the fill.
    pub hole_before_fill: u64,
    /// Filled by extrapolation.
    pub filled: u64,
    /// Left unpainted.
    pub unpainted: u64,
}

impl CompositeStats {
    /// A count as a fraction of the pixels.
    pub fn fraction(&self, count: u64) -> f64 {
        if self.pixels == 0 { 0.0 } else { count as f64 / self.pixels as f64 }
    }

    /// Whether what is left is worth filling. `known`: an image or the tree was there, so that it is gaps in that.
    pub fn is_worth_filling(&self, known: bool) -> bool {
        known && self.unpainted > 0 && self.unpainted * FILL_UP_TO < self.pixels
    }

    fn add(mut self, other: Self) -> Self {
        self.pixels += other.pixels;
        self.near += other.near;
        self.far += other.far;
        self.tree += other.tree;
        self.sky += other.sky;
        self.hole_before_fill += other.hole_before_fill;
        self.filled += other.filled;
        self.unpainted += other.unpainted;
        self
    }
}

/// Rows per task: few enough to balance, many enough to cost nothing.
const ROWS_PER_TASK: usize = 16;

/// Holes are filled while they are less than one pixel in this many: where half the picture is missing, extrapolating it
/// would cost more than drawing it and show nothing true.
const FILL_UP_TO: u64 = 2;

/// Merges `far` into `frame`, which holds the near geometry of the same pose and camera, and fills what is left.
///
/// A far picture of another size than the frame counts as missing.
pub fn composite(
    frame: &mut Frame,
    far: Far<'_>,
    pose: &Pose,
    camera: &OutputCamera,
    options: &CompositeOptions<'_>,
) -> CompositeStats {
    let mut stats = merge(frame, far, pose, camera);
    let here = |images: &[FarImage<'_>]| images.iter().any(|i| matches!(i, FarImage::Here(..)));
    let known = match far {
        Far::Images { images, .. } => here(images),
        Far::Portals { portals, .. } => portals.iter().any(|p| here(p.images)),
        Far::Nothing | Far::Missing => false,
    };
    finish(frame, known, &mut stats, options);
    stats
}

/// The first half of [`composite()`]: near, far and sky.
pub fn merge(frame: &mut Frame, far: Far<'_>, pose: &Pose, camera: &OutputCamera) -> CompositeStats {
    let far = match far {
        Far::Images { picture, .. } | Far::Portals { picture, .. }
            if (picture.width, picture.height) != (frame.width, frame.height) =>
        {
            Far::Missing
        }
        other => other,
    };
    if frame.is_empty() {
        return CompositeStats::default();
    }
    let merge = match far {
        Far::Images { picture, images, sky } => {
            let all = Group { faces: faces(images, pose, camera), sky, cones: None };
            Some(Merge::new(picture, vec![all], true, pose, camera))
        }
        Far::Portals { picture, portals, complete } => {
            let groups = portals.iter().map(|p| Group {
                faces: faces(p.images, pose, camera),
                sky: Some(p.sky),
                cones: Some(p.cones),
            });
            Some(Merge::new(picture, groups.collect(), complete, pose, camera))
        }
        Far::Nothing | Far::Missing => None,
    };
    if let Some(merge) = merge {
        return merge.into_frame(frame);
    }
    let nothing = matches!(far, Far::Nothing);
    let rows = by_rows(frame, |_, mut row| {
        if nothing {
            row.rest_is_sky();
        }
        row.count()
    });
    rows.into_iter().fold(CompositeStats::default(), CompositeStats::add)
}

/// What `of_row` says of each row, by its number.
fn by_rows<T: Send>(frame: &mut Frame, of_row: impl Fn(usize, Row<'_>) -> T + Sync) -> Vec<T> {
    let width = frame.width as usize;
    let planes = frame.colour.par_chunks_mut(width).zip(frame.disparity.par_chunks_mut(width));
    let rows = planes.zip(frame.source.par_chunks_mut(width)).enumerate().with_min_len(ROWS_PER_TASK);
    rows.map(|(number, ((colour, disparity), source))| of_row(number, Row { colour, disparity, source })).collect()
}

/// The second half: fill and smoothing. `known`: an image or the tree was there, so that holes are gaps in it.
pub fn finish(frame: &mut Frame, known: bool, stats: &mut CompositeStats, options: &CompositeOptions<'_>) {
    if stats.is_worth_filling(known) {
        stats.filled = match options.fill {
            Fill::Surface => hole_fill::fill(frame),
            Fill::Last if options.last.len() == frame.len() => hole_fill::from_last(frame, options.last),
            Fill::Off | Fill::Last => 0,
        };
        stats.unpainted -= stats.filled;
    }
    if options.smooth && stats.far > 0 {
        smooth::smooth(frame);
    }
}

/// One row of the frame.
struct Row<'a> {
    colour: &'a mut [u32],
    disparity: &'a mut [f32],
    source: &'a mut [Source],
}

impl Row<'_> {
    fn rest_is_sky(&mut self) {
        for (source, colour) in self.source.iter_mut().zip(&mut *self.colour) {
            if *source == Source::Unpainted {
                (*source, *colour) = (Source::Sky, SKY);
            }
        }
    }

    fn count(&self) -> CompositeStats {
        let mut by_source = [0u64; 6];
        for s in &*self.source {
            by_source[*s as usize] += 1;
        }
        CompositeStats {
            pixels: self.source.len() as u64,
            near: by_source[Source::Near as usize],
            far: by_source[Source::Far as usize],
            tree: by_source[Source::Tree as usize],
            sky: by_source[Source::Sky as usize],
            hole_before_fill: by_source[Source::Unpainted as usize],
            filled: by_source[Source::Filled as usize],
            unpainted: by_source[Source::Unpainted as usize],
        }
    }
}

/// Merges rows of warped images.
struct Merge<'a> {
    picture: &'a FarFrame,
    groups: Vec<Group<'a>>,
    /// Whether a direction that is in no group is sky.
    complete: bool,
    world: Directions,
}

/// Images that together hold what is replaced in some directions.
struct Group<'a> {
    faces: Vec<Face<'a>>,
    sky: Option<&'a SkyMap>,
    /// The cones around those directions; None: all.
    cones: Option<&'a [Cone]>,
}

impl Group<'_> {
    fn holds(&self, direction: DVec3) -> bool {
        let within = |cone: &Cone| cone.normals.iter().all(|n| n.dot(direction) >= 0.0);
        self.cones.is_none_or(|cones| cones.iter().any(within))
    }

    /// As [`Merge::is_sky`], of this group alone.
    fn is_sky(&self, row: usize, column: usize, direction: DVec3) -> bool {
        if self.faces.iter().any(|f| f.misses(row, column)) {
            return false;
        }
        if self.sky.is_some_and(|s| s.holds(direction)) {
            return true;
        }
        let mut held = false;
        for face in &self.faces {
            match face.knows(row, column) {
                Knows::Sky => return true,
                Knows::Nothing => held = true,
                Knows::Beside => {}
            }
        }
        !held
    }
}

/// Directions of output pixels' centres in some frame: affine in column and row.
pub struct Directions {
    /// At pixel (0, 0).
    first: [f64; 3],
    per_column: [f64; 3],
    per_row: [f64; 3],
}

impl Directions {
    /// `local` takes a direction in the world to the frame.
    fn new(pose: &Pose, camera: &OutputCamera, local: impl Fn(DVec3) -> [f64; 3]) -> Self {
        let basis = pose.basis();
        let at = |u: f64, v: f64| local(camera.ray(&basis, u, v));
        let (first, right, below) = (at(0.5, 0.5), at(1.5, 0.5), at(0.5, 1.5));
        Self {
            first,
            per_column: std::array::from_fn(|i| right[i] - first[i]),
            per_row: std::array::from_fn(|i| below[i] - first[i]),
        }
    }

    fn of(&self, row: usize, column: usize) -> [f64; 3] {
        let (row, column) = (row as f64, column as f64);
        std::array::from_fn(|i| self.first[i] + self.per_row[i] * row + self.per_column[i] * column)
    }
}

/// Parts of one plane as seen from one centre: where directions of output pixels meet them is found once for all.
struct Face<'a> {
    basis: ViewBasis,
    /// Centre of projection, and pixels per unit at distance 1, of images that are there; None: what is absent.
    camera: Option<(DVec3, f64)>,
    /// In the images' frame: right, down, forward.
    directions: Directions,
    /// Eye's depth in the images' frame, m; 0 for absent ones.
    eye_depth_m: f64,
    /// Largest step of the images' disparity codes; 0 for absent ones.
    step: f64,
    /// The images that are there, and the windows they were planned for.
    here: Vec<(&'a Ldi, [f64; 4])>,
    /// Windows of those that are not.
    absent: Vec<[f64; 4]>,
}

/// How well the disparities of images of one plane are known: one step of their codes moves a disparity d of the picture at a column and a row by
/// step (d eye depth + forward), where forward is affine in both.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CodeStep {
    /// Component of a pixel's direction along the plane's normal: at pixel (0, 0), per column, per row.
    pub forward: [f64; 3],
    /// The eye's depth as the plane sees it, m.
    pub eye_depth_m: f64,
    /// Step of the codes, 1/m.
    pub step: f64,
}

/// The steps of those images that are there.
pub fn code_steps(images: &[FarImage<'_>], pose: &Pose, camera: &OutputCamera) -> Vec<CodeStep> {
    faces(images, pose, camera).iter().filter(|f| f.step > 0.0).map(Face::code_step).collect()
}

fn faces<'a>(images: &[FarImage<'a>], pose: &Pose, camera: &OutputCamera) -> Vec<Face<'a>> {
    let mut faces: Vec<Face<'a>> = Vec::new();
    for image in images {
        let (basis, of) = match image {
            FarImage::Here(ldi, _) => (ldi.camera.basis, Some((ldi.camera.cop, ldi.camera.pixels_per_unit))),
            FarImage::Absent(entry) => (entry.basis, None),
        };
        let at = faces.iter().position(|f| f.basis == basis && f.camera == of).unwrap_or_else(|| {
            faces.push(Face::new(basis, of, pose, camera));
            faces.len() - 1
        });
        let face = &mut faces[at];
        match *image {
            FarImage::Here(ldi, window) => {
                face.step = face.step.max(ldi.codes.step);
                face.here.push((ldi, window));
            }
            FarImage::Absent(entry) => face.absent.push(entry.window),
        }
    }
    faces
}

impl<'a> Merge<'a> {
    fn new(picture: &'a FarFrame, groups: Vec<Group<'a>>, complete: bool, pose: &Pose, camera: &OutputCamera) -> Self {
        Self { picture, groups, complete, world: Directions::new(pose, camera, |w| w.to_array()) }
    }

    /// Merges by depth, closes seams and finds sky.
    fn into_frame(self, frame: &mut Frame) -> CompositeStats {
        let reached = by_rows(frame, |number, mut row| self.by_depth(number, &mut row));
        let open: Vec<u64> = reached.iter().map(|r| u64::from(frame.width) - r.iter().sum::<u64>()).collect();
        let [mut near, mut far] = [0, 1].map(|of| reached.iter().map(|r| r[of]).sum::<u64>());
        let seams = if far > 0 { seams::find(frame, &open) } else { Vec::new() };
        for Seam { at, of } in seams {
            (frame.colour[at], frame.disparity[at]) = (frame.colour[of], frame.disparity[of]);
            frame.source[at] = frame.source[of];
            *(if frame.source[of] == Source::Near { &mut near } else { &mut far }) += 1;
        }
        let sky = by_rows(frame, |number, mut row| if open[number] > 0 { self.sky_row(number, &mut row) } else { 0 });
        let (pixels, sky) = (frame.len() as u64, sky.iter().sum());
        let unpainted = pixels - near - far - sky;
        let stats = CompositeStats { pixels, near, far, sky, ..CompositeStats::default() };
        CompositeStats { hole_before_fill: unpainted, unpainted, ..stats }
    }

    /// Merges a row by depth; returns how many of its pixels are near geometry, and how many the images'.
    fn by_depth(&self, row: usize, pixels: &mut Row<'_>) -> [u64; 2] {
        let width = pixels.colour.len();
        let first = row * width;
        if self.picture.is_untouched() {
            return [pixels.source.iter().filter(|s| **s == Source::Near).count() as u64, 0];
        }
        let (mut near_count, mut far_count) = (0u32, 0u32);
        let far = &self.picture.packed[first..first + width];
        let planes = pixels.colour.iter_mut().zip(&mut *pixels.disparity).zip(&mut *pixels.source);
        for (column, (packed, ((colour, disparity), source))) in far.iter().zip(planes).enumerate() {
            let is_near = *source == Source::Near;
            let Some((far_colour, far_disparity)) = FarFrame::unpack(*packed) else {
                near_count += u32::from(is_near);
                continue;
            };
            if is_near && (*disparity >= far_disparity || self.near_wins(row, column, *disparity, far_disparity)) {
                near_count += 1;
                continue;
            }
            far_count += 1;
            (*colour, *disparity, *source) = (far_colour, far_disparity, Source::Far);
        }
        [near_count, far_count].map(u64::from)
    }

    /// Turns unpainted pixels whose directions are known to be sky into sky; returns how many.
    fn sky_row(&self, row: usize, pixels: &mut Row<'_>) -> u64 {
        let mut sky = 0;
        for (column, (source, colour)) in pixels.source.iter_mut().zip(&mut *pixels.colour).enumerate() {
            if *source == Source::Unpainted && self.is_sky(row, column) {
                (*source, *colour) = (Source::Sky, SKY);
                sky += 1;
            }
        }
        sky
    }

    /// Whether sky is known in a pixel's direction: an image holds some, the placement's eyes see it, or none could hold anything. An image that is
    /// not there may hold a surface. Of several portals all must agree; where none is, there is sky if everything else was drawn.
    fn is_sky(&self, row: usize, column: usize) -> bool {
        let direction = DVec3::from_array(self.world.of(row, column));
        let mut any = false;
        for group in self.groups.iter().filter(|g| g.holds(direction)) {
            any = true;
            if !group.is_sky(row, column, direction) {
                return false;
            }
        }
        any || self.complete
    }

    /// Whether a triangle behind the far surface is as near as the far surface's disparity is known.
    fn near_wins(&self, row: usize, column: usize, near: f32, far: f32) -> bool {
        let step =
            self.groups.iter().flat_map(|g| &g.faces).map(|f| f.step(row, column, far)).fold(0.0, f64::max) as f32;
        far - near <= step
    }
}

impl Face<'_> {
    fn new(basis: ViewBasis, of: Option<(DVec3, f64)>, pose: &Pose, camera: &OutputCamera) -> Self {
        let local = |w: DVec3| [w.dot(basis.right), -w.dot(basis.up), w.dot(basis.forward)];
        Self {
            basis,
            camera: of,
            directions: Directions::new(pose, camera, local),
            eye_depth_m: of.map_or(0.0, |(cop, _)| (pose.position - cop).dot(basis.forward)),
            step: 0.0,
            here: Vec::new(),
            absent: Vec::new(),
        }
    }

    /// See [`CodeStep`].
    fn code_step(&self) -> CodeStep {
        let Directions { first, per_column, per_row } = &self.directions;
        CodeStep { forward: [first[2], per_column[2], per_row[2]], eye_depth_m: self.eye_depth_m, step: self.step }
    }

    /// How far one step of the images' disparity codes moves the disparity of a far surface in the picture.
    fn step(&self, row: usize, column: usize, far: f32) -> f64 {
        let [.., forward] = self.directions.of(row, column);
        // d2 = d1 / W and W = depth2 / depth1, so that a step in d1 becomes step * d2 * depth1 in d2, and
        // d2 * depth1 = d2 (eye depth + forward / d2).
        (self.step * (f64::from(far) * self.eye_depth_m + forward)).max(0.0)
    }

    /// Where a pixel's direction meets the plane at distance 1: right and down; None behind it.
    fn meets(&self, row: usize, column: usize) -> Option<(f64, f64)> {
        let [right, down, forward] = self.directions.of(row, column);
        (forward > 0.0).then(|| (right / forward, down / forward))
    }

    /// Whether an image that is not there would hold a pixel's direction.
    fn misses(&self, row: usize, column: usize) -> bool {
        !self.absent.is_empty()
            && self.meets(row, column).is_some_and(|(x, y)| self.absent.iter().any(|w| within(w, x, y)))
    }

    /// What the images that are there say of a pixel's direction.
    fn knows(&self, row: usize, column: usize) -> Knows {
        let (Some((_, pixels_per_unit)), Some((x, y))) = (self.camera, self.meets(row, column)) else {
            return Knows::Beside;
        };
        // Saturating conversions: far outside stays outside.
        let (column, row) = ((x * pixels_per_unit).floor() as i64, (y * pixels_per_unit).floor() as i64);
        let mut held = false;
        for (ldi, window) in &self.here {
            let (left, top) = (i64::from(ldi.camera.left), i64::from(ldi.camera.top));
            match ldi.is_sky(column.saturating_sub(left), row.saturating_sub(top)) {
                Some(true) => return Knows::Sky,
                Some(false) => held = true,
                None => held = held || within(window, x, y),
            }
        }
        if held { Knows::Nothing } else { Knows::Beside }
    }
}

/// Whether a window, left, right, bottom, top as tangents, holds a place on the plane at distance 1, right and down.
fn within([l, r, b, t]: &[f64; 4], x: f64, y: f64) -> bool {
    x >= *l && x <= *r && -y >= *b && -y <= *t
}

/// What images say of a direction in which they show nothing.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Knows {
    /// Someone sees sky there.
    Sky,
    /// They hold the direction, and nothing was found there.
    Nothing,
    /// They do not hold the direction: what is replaced lies inside their windows, or in another's.
    Beside,
}

#[cfg(test)]
mod tests;
