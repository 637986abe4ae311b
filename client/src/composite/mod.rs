//! The composite: merges near geometry, warped images and sky to one picture.
//!
//! In: a [`Frame`] with near geometry, and the representation of everything else ([`Far`]). Out:
//! the finished frame, and [`CompositeStats`].
//!
//! 1. **Depth** ([`composite`]): cells that were not culled can lie beside or behind the LDI's
//!    samples, so that both are merged by disparity. Near geometry wins within one quantization
//!    step of the image's disparity codes, the uncertainty of the far surface, and not beyond: a
//!    rug of the image must stay above the floor of the geometry.
//! 2. **Seams** (`seams`): closes gaps of one pixel within a surface, where its images or near
//!    geometry meet.
//! 3. **Sky**: an open pixel is sky if no image contains anything else in its direction. Sky lies
//!    at infinity, so that the lookup is a rotation. Without culling, all open pixels are sky.
//!    Where all images are present, sky also fills openings that it borders on (`sky_fill`).
//! 4. **Underlay** (`tree_underlay`): open pixels, and pixels with missing data, show the LDI tree.
//! 5. **Hole filling** (`hole_fill`, optional): remaining holes take the colour of the nearest
//!    farther surface, of sky around them, or of the previous frame, and are marked
//!    [`Source::Filled`].
//! 6. **Smoothing** (`smooth`, optional): the 3 x 3 kernel of Aliaga and Lastra's system, over far
//!    pixels.
//! 7. **Averaging** ([`downsample()`]): a supersampled frame is averaged in linear light.
//!
//! The window then changes the finished picture: [`paint_sky`] gives the sky a horizon before the
//! averaging, [`DepthShading`] adds ambient occlusion and outlines after it.
//!
//! All stages run by rows on the current rayon pool; their results do not depend on its size.

mod ambient_occlusion;
mod depth_lens;
mod depth_shading;
mod downsample;
mod hole_fill;
mod seams;
mod sky_fill;
mod sky_gradient;
mod smooth;
mod tree_underlay;

pub use depth_lens::DepthLens;
pub use depth_shading::DepthShading;
pub use downsample::downsample;
pub use hole_fill::Fill;
pub use sky_fill::fill_sky;
pub use sky_gradient::paint_sky;
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

/// The representation of cells that were not drawn.
#[derive(Debug, Clone, Copy)]
pub enum Far<'a> {
    /// Nothing was culled: open pixels are sky.
    Nothing,
    /// Something was culled and its image is absent: open pixels stay unpainted.
    Missing,
    /// Warped images.
    Images {
        /// The combined warp of all images.
        picture: &'a FarFrame,
        /// All images of the placement in view, including absent ones.
        images: &'a [FarImage<'a>],
        /// Where the placement's eyes see sky, also outside of its images.
        sky: Option<&'a SkyMap>,
    },
    /// Warped images of portals: open pixels are seen through a portal, or are sky.
    Portals {
        /// The combined warp of all images.
        picture: &'a FarFrame,
        /// All portals that images show.
        portals: &'a [FarPortal<'a>],
        /// Whether everything else was drawn, so that directions without a portal are sky.
        complete: bool,
    },
}

/// A portal that images show in this frame.
#[derive(Debug, Clone, Copy)]
pub struct FarPortal<'a> {
    /// The visible part of the portal, as seen from the eye.
    pub cones: &'a [Cone],
    /// Its images in view, including absent ones.
    pub images: &'a [FarImage<'a>],
    /// Where its eyes see sky through it, also outside of its images.
    pub sky: &'a SkyMap,
}

/// An image of this frame.
#[derive(Debug, Clone, Copy)]
pub enum FarImage<'a> {
    /// A warped image: its sky bits, camera and disparity codes apply. Its planned window (left,
    /// right, bottom, top as tangents) may be larger than its content: nothing is known of the
    /// rest.
    Here(&'a Ldi, [f64; 4]),
    /// An absent image: the content of its window is unknown.
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
    /// Content of holes.
    pub fill: Fill,
    /// Colours of the previous frame, for [`Fill::Last`]. Without them, or with another size, holes
    /// stay.
    pub last: &'a [u32],
    /// Whether far pixels are smoothed with a 3 x 3 kernel.
    pub smooth: bool,
}

/// Pixels by source after the composite.
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
    /// Pixels without known content, before filling.
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

    /// Whether the remaining holes are to be filled. `known`: whether an image or the tree was
    /// present.
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

/// Rows per task. Smaller: more overhead; larger: less balance between threads.
const ROWS_PER_TASK: usize = 16;

/// Holes are filled while they are less than one pixel in this many. Larger pieces are missing
/// data, which extrapolation cannot show.
const FILL_UP_TO: u64 = 2;

/// Merges `far` into `frame`, which holds the near geometry of the same pose and camera, and fills
/// holes.
///
/// A far picture of another size counts as missing.
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

/// The first half of [`composite()`]: near geometry, images and sky.
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

/// Applies `of_row` to every row, in parallel.
fn by_rows<T: Send>(frame: &mut Frame, of_row: impl Fn(usize, Row<'_>) -> T + Sync) -> Vec<T> {
    let width = frame.width as usize;
    let planes = frame.colour.par_chunks_mut(width).zip(frame.disparity.par_chunks_mut(width));
    let rows = planes.zip(frame.source.par_chunks_mut(width)).enumerate().with_min_len(ROWS_PER_TASK);
    rows.map(|(number, ((colour, disparity), source))| of_row(number, Row { colour, disparity, source })).collect()
}

/// The second half of [`composite()`]: filling and smoothing. `known`: whether an image or the tree
/// was present, so that holes are gaps in it.
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
    /// Whether directions in no group are sky.
    complete: bool,
    world: Directions,
}

/// Images that together replace the cells in some directions.
struct Group<'a> {
    faces: Vec<Face<'a>>,
    sky: Option<&'a SkyMap>,
    /// The cones of those directions; None: all directions.
    cones: Option<&'a [Cone]>,
}

impl Group<'_> {
    fn holds(&self, direction: DVec3) -> bool {
        let within = |cone: &Cone| cone.normals.iter().all(|n| n.dot(direction) >= 0.0);
        self.cones.is_none_or(|cones| cones.iter().any(within))
    }

    /// As [`Merge::is_sky`], for this group alone.
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

/// Directions of pixel centres in a local frame: affine in column and row.
pub struct Directions {
    /// Direction at pixel (0, 0).
    first: [f64; 3],
    per_column: [f64; 3],
    per_row: [f64; 3],
}

impl Directions {
    /// `local` converts a world direction to the frame.
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

/// Images on one plane with one centre: the intersection of pixel directions with the plane is
/// shared.
struct Face<'a> {
    basis: ViewBasis,
    /// Centre of projection, and pixels per unit at distance 1; None for absent images.
    camera: Option<(DVec3, f64)>,
    /// In the images' frame: right, down, forward.
    directions: Directions,
    /// Depth of the eye in the images' frame, m; 0 for absent images.
    eye_depth_m: f64,
    /// Largest step of the images' disparity codes; 0 for absent images.
    step: f64,
    /// Present images, and their planned windows.
    here: Vec<(&'a Ldi, [f64; 4])>,
    /// Windows of absent images.
    absent: Vec<[f64; 4]>,
}

/// Precision of the disparities of images on one plane: one step of their codes moves a disparity d
/// of the picture by step (d eye depth + forward), where forward is affine in column and row.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct CodeStep {
    /// Component of a pixel's direction along the plane's normal: at pixel (0, 0), per column, per
    /// row.
    pub forward: [f64; 3],
    /// Depth of the eye relative to the plane, m.
    pub eye_depth_m: f64,
    /// Step of the codes, 1/m.
    pub step: f64,
}

impl CodeStep {
    /// Bounds the error of a disparity d of a picture, 1/m: the first plus the second times d.
    pub fn error(&self, camera: &OutputCamera) -> [f64; 2] {
        let [first, per_column, per_row] = self.forward;
        let (w, h) = (f64::from(camera.width), f64::from(camera.height));
        let corners = [[0.0, 0.0], [w, 0.0], [0.0, h], [w, h]];
        let forward = corners.map(|[x, y]| (first + per_column * x + per_row * y).abs());
        // Half a step is the error of a rounded code.
        [0.5 * self.step * forward.into_iter().fold(0.0, f64::max), 0.5 * self.step * self.eye_depth_m.abs()]
    }
}

/// Code steps of the present images.
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

    /// Merges a row by depth. Returns the numbers of near and far pixels.
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

    /// Turns unpainted pixels of known sky into sky. Returns their number.
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

    /// Whether a pixel's direction is known to be sky: an image contains sky there, the placement's
    /// eyes see sky, or no image could contain anything. An absent image may contain a surface. All
    /// portals of a direction must agree; without a portal it is sky if everything else was drawn.
    /// not there may hold a surface. Of several portals all must agree; where none is, there is sky
    /// if everything else was drawn.
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

    /// Whether a triangle behind the far surface lies within the precision of the far disparity.
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

    /// Change of a far disparity in the picture for one step of the images' codes.
    fn step(&self, row: usize, column: usize, far: f32) -> f64 {
        let [.., forward] = self.directions.of(row, column);
        // d2 = d1 / W and W = depth2 / depth1, so that a step in d1 becomes step * d2 * depth1 in
        // d2, and d2 * depth1 = d2 (eye depth + forward / d2).
        (self.step * (f64::from(far) * self.eye_depth_m + forward)).max(0.0)
    }

    /// Intersection of a pixel's direction with the plane at distance 1: right and down; None
    /// behind it.
    fn meets(&self, row: usize, column: usize) -> Option<(f64, f64)> {
        let [right, down, forward] = self.directions.of(row, column);
        (forward > 0.0).then(|| (right / forward, down / forward))
    }

    /// Whether an absent image would contain a pixel's direction.
    fn misses(&self, row: usize, column: usize) -> bool {
        !self.absent.is_empty()
            && self.meets(row, column).is_some_and(|(x, y)| self.absent.iter().any(|w| within(w, x, y)))
    }

    /// What the present images contain in a pixel's direction.
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

/// Whether a window (left, right, bottom, top as tangents) contains a point of the plane at
/// distance 1.
fn within([l, r, b, t]: &[f64; 4], x: f64, y: f64) -> bool {
    x >= *l && x <= *r && -y >= *b && -y <= *t
}

/// Content of images in a direction without a sample.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Knows {
    /// An eye sees sky there.
    Sky,
    /// The images contain the direction, and no surface or sky was found there.
    Nothing,
    /// The images do not contain the direction.
    Beside,
}

#[cfg(test)]
mod tests;
