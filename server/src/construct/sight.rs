//! Where eyes see replaced cells at all, and from where they see what others do not.
//!
//! Cells that stay are drawn from any eye, and hide what lies behind them: on the clinic at a
//! tenth of its triangles more than four fifths of what the faces of a near box could hold is
//! behind walls that are drawn anyway. So before images are made, rays go out from places where
//! eyes stand, in all directions that they look in and through everything there is. Where the
//! first thing they meet is replaced, or is nothing, the eye needs the image. The image is made
//! there alone, with a margin.
//!
//! ```text
//!   eye ──────────── wall (stays) ░░░░ hidden: no sample, no ray
//!      ╲─── door ─────────────── far wall (replaced): needed
//! ```
//!
//! From one eye to the next little changes, and much in the end: many eyes with few rays each find
//! more than few eyes with many. What they met also says which of them the construction images are
//! best made from, and in which part of their pictures: each piece of surface from one.
//!
//! In: a caster, places where eyes stand, the directions they look in. Out: a [`Survey`] for a
//! placement; of that the [`Face`] of each image, from which it is cut into tiles; for each tile
//! the pixels to look at ([`Looked`]) and, knowing the central image, the cameras.

use super::{
    caster::{Met, SubsetCaster},
    sample::{Sample, Tolerance},
    sums::Sums,
    tiles::{Tile, tiles},
    view::{ConstructionCamera, Rig, View, Window},
};
use crate::placement::{Gaze, ImagePlan};
use crate::render::Ray;
use glam::{DVec3, Vec3};
use ldi_protocol::{portal_view::Cone, sky::SkyMap};
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::ops::Range;

/// Side of the squares in which a construction camera looks or does not, pixels of it (two of the
/// image's). By judgement.
pub(super) const SQUARE: usize = 16;
/// It looks this many of its pixels around what rays met: as far as the next ray.
const AROUND: f64 = 12.0;
/// Side of the blocks of the image that are kept or left out, pixels. By judgement: half a square,
/// so that borders follow what is seen.
pub(super) const BLOCK: usize = 16;
/// What is seen is kept with this many pixels around it: eyes between those tried see a little
/// further around things.
const MARGIN: f64 = 16.0;
/// A direction is a place this far away, metres.
const FAR_AWAY_M: f64 = 1e12;
/// Most construction cameras of an image. By judgement; those that bring most come first.
const MOST_CAMERAS: usize = 192;
/// Side of a piece of surface, pixels: a square of the raster. Half of it found no more on the
/// test scenes.
const PIECE: f64 = 32.0;
/// Two hits this much apart in depth, relatively, are different pieces. By judgement: smaller
/// takes slanted surfaces to pieces, larger takes what stands before a wall for the wall.
const PIECE_DEPTH: f64 = 0.1;
/// So many cameras see each piece, if eyes do: what one of them sees of it, through a slit, may be
/// another part than what the next one does.
const CAMERAS_PER_PIECE: u8 = 2;
/// A hit that differs from the plane of the central sample in its place by at most this many steps
/// of disparity is held: one output pixel for the worst eye.
const HELD_STEPS: f32 = 8.0;

/// Squares of an eye's picture in which it sees something new, from the corner of its camera's
/// window.
#[derive(Debug, Clone)]
pub(super) struct Open(Sums);

impl Open {
    /// Whether the pixel of the camera is in such a square.
    #[inline]
    pub fn holds(&self, column: usize, row: usize) -> bool {
        self.any(column..column + 1, row..row + 1)
    }

    /// Whether one of the pixels is in such a square; the ranges are not empty.
    #[inline]
    pub fn any(&self, columns: Range<usize>, rows: Range<usize>) -> bool {
        let squares = |r: Range<usize>| r.start / SQUARE..(r.end - 1) / SQUARE + 1;
        self.0.count(squares(columns), squares(rows)) > 0
    }
}

/// Pixels of the image that someone may look at; of blocks from the corner of its window.
#[derive(Debug, Clone)]
pub(super) struct Looked {
    blocks: Vec<bool>,
    columns: usize,
}

impl Looked {
    /// Columns of a row that are looked at, as runs.
    pub fn runs(&self, row: usize, width: usize) -> impl Iterator<Item = Range<usize>> + '_ {
        let first = row / BLOCK * self.columns;
        let line = &self.blocks[first..first + self.columns];
        let mut at = 0;
        std::iter::from_fn(move || {
            let start = at + line[at..].iter().position(|b| *b)?;
            let end = start + line[start..].iter().take_while(|b| **b).count();
            at = end;
            Some(start * BLOCK..(end * BLOCK).min(width))
        })
    }

    fn everything(window: &Window) -> Self {
        let columns = (window.width as usize).div_ceil(BLOCK);
        Self { blocks: vec![true; columns * (window.height as usize).div_ceil(BLOCK)], columns }
    }
}

/// What eyes see around them of what is replaced: the first thing on each of many rays.
pub struct Survey {
    eyes: Vec<(DVec3, Vec<Hit>)>,
    /// Half the angle between rays.
    half_angle: f64,
    /// Rays cast.
    pub rays: u64,
}

/// Something replaced, or sky, that an eye sees.
struct Hit {
    /// Of unit length.
    direction: Vec3,
    /// Metres; infinite for sky.
    distance: f32,
}

impl Survey {
    /// Casts rays from a placement's eyes in all directions that they look in, or only `through` a
    /// polygon unless it is empty. None: eyes may be anywhere.
    pub fn of<C: SubsetCaster>(caster: &C, eyes: &[DVec3], gaze: &Gaze, through: &[DVec3]) -> Option<Self> {
        let survey = |(number, eye): (usize, &DVec3)| {
            let (mut hits, mut count) = (Vec::new(), 0);
            let batches: Box<dyn Iterator<Item = Vec<Ray>>> = match through {
                [] => Box::new(gaze.rays(*eye, number)),
                polygon => Box::new(std::iter::once(gaze.rays_through(*eye, number, polygon))),
            };
            for rays in batches {
                let mut met = vec![Met::Nothing; rays.len()];
                caster.meet(&rays, &mut met);
                count += rays.len() as u64;
                hits.extend(rays.iter().zip(met).filter_map(|(ray, met)| {
                    let distance = match met {
                        Met::Stays => return None,
                        Met::Nothing => f32::INFINITY,
                        Met::Replaced(distance) => distance as f32,
                    };
                    Some(Hit { direction: ray.direction.as_vec3(), distance })
                }));
            }
            ((*eye, hits), count)
        };
        let (seen, rays): (Vec<(DVec3, Vec<Hit>)>, Vec<u64>) = eyes.par_iter().enumerate().map(survey).unzip();
        (!eyes.is_empty()).then(|| Self { eyes: seen, half_angle: gaze.half_angle(), rays: rays.iter().sum() })
    }

    /// Where eyes see sky. Images hold it as well, pixel by pixel, but only what is theirs: the
    /// one that owns a direction may be cut before it, as a box's faces stand at different
    /// distances.
    ///
    /// A window is a few squares, and few of the survey's rays go through it: from what they met
    /// on, sky grows as long as rays find more of it, `through` a polygon unless it is empty. Also
    /// returns their number. `lookouts`: more places of eyes, of which those near one that saw sky
    /// are asked what is beside it. Between two jambs far behind each other some of it is seen
    /// from a strip of places a few centimetres wide.
    pub fn sky<C: SubsetCaster>(&self, caster: &C, lookouts: &[DVec3], through: &[DVec3]) -> (SkyMap, u64) {
        let places: Vec<DVec3> = self.eyes.iter().map(|(eye, _)| *eye).chain(lookouts.iter().copied()).collect();
        let look = Outlook { caster, places: &places, through };
        let mut squares = vec![false; SkyMap::SQUARES as usize];
        // Who saw it.
        let mut seer = vec![0; squares.len()];
        for (number, (_, hits)) in self.eyes.iter().enumerate() {
            for hit in hits.iter().filter(|hit| !hit.distance.is_finite()) {
                let square = SkyMap::square(hit.direction.as_dvec3()) as usize;
                (squares[square], seer[square]) = (true, number);
            }
        }
        if !squares.contains(&true) {
            return (SkyMap::default(), 0);
        }
        squares.chunks_mut((SkyMap::SIDE * SkyMap::SIDE) as usize).for_each(close_gaps);
        let others: Vec<usize> = (0..self.eyes.len()).step_by(self.eyes.len().div_ceil(SKY_EYES)).collect();
        let mut asked = squares.clone();
        let mut fresh: Vec<usize> = (0..squares.len()).filter(|s| squares[*s]).collect();
        let mut rays = 0;
        while !fresh.is_empty() {
            let mut next: Vec<(usize, usize)> = Vec::new();
            for square in &fresh {
                for beside in beside(*square).filter(|s| !std::mem::replace(&mut asked[*s], true)) {
                    next.push((beside, seer[*square]));
                }
            }
            // Only where the eye that saw its neighbour does not see it others are asked.
            let ask = |(square, first): &(usize, usize)| {
                let mut asked = 0;
                let mut ask = |places: &[usize]| {
                    asked += places.len() as u64;
                    look.sees_sky(*square, places)
                };
                let seen = ask(&[*first]).or_else(|| ask(&others));
                let seen = seen.or_else(|| ask(&look.nearest(*first, self.eyes.len()..places.len())));
                (seen, asked)
            };
            let found: Vec<(Option<usize>, u64)> = next.par_iter().map(ask).collect();
            fresh.clear();
            for ((square, _), (eye, count)) in next.into_iter().zip(found) {
                rays += count;
                if let Some(eye) = eye {
                    (squares[square], seer[square]) = (true, eye);
                    fresh.push(square);
                }
            }
        }
        (SkyMap::of(&squares), rays)
    }
}

/// Places that are asked whether they see sky.
struct Outlook<'a, C> {
    caster: &'a C,
    places: &'a [DVec3],
    /// See [`Survey::sky`].
    through: &'a [DVec3],
}

impl<C: SubsetCaster> Outlook<'_, C> {
    /// The first of some places from which sky is seen through the middle of a square.
    fn sees_sky(&self, square: usize, places: &[usize]) -> Option<usize> {
        let direction = SkyMap::middle(square as u32).normalize();
        let passes =
            |place: &usize| self.through.is_empty() || is_through(self.places[*place], direction, self.through);
        let places: Vec<usize> = places.iter().copied().filter(passes).collect();
        let rays: Vec<Ray> = places.iter().map(|place| Gaze::ray(self.places[*place], direction)).collect();
        let mut met = vec![Met::Stays; rays.len()];
        self.caster.meet(&rays, &mut met);
        met.iter().position(|m| *m == Met::Nothing).map(|k| places[k])
    }

    /// Up to [`LOOKOUTS`] of some places, those nearest to another.
    fn nearest(&self, to: usize, of: Range<usize>) -> Vec<usize> {
        let apart = |place: &usize| self.places[*place].distance_squared(self.places[to]);
        let mut of: Vec<usize> = of.collect();
        if of.len() > LOOKOUTS {
            of.select_nth_unstable_by(LOOKOUTS, |a, b| apart(a).total_cmp(&apart(b)).then(a.cmp(b)));
            of.truncate(LOOKOUTS);
            of.sort_unstable();
        }
        of
    }
}

/// Whether a ray goes through a flat convex polygon, from either side.
fn is_through(from: DVec3, direction: DVec3, polygon: &[DVec3]) -> bool {
    Cone::over(from, polygon).is_some_and(|cone| cone.normals.iter().all(|n| n.dot(direction) >= 0.0))
}

/// Eyes that are asked whether they see sky beside what is known to be sky. By judgement.
const SKY_EYES: usize = 64;
/// And so many lookouts, about those within 0.4 m of the eye that sees sky beside it. By judgement.
const LOOKOUTS: usize = 64;

/// The squares of a [`SkyMap`] around one, on its face.
fn beside(square: usize) -> impl Iterator<Item = usize> {
    let side = SkyMap::SIDE as usize;
    let (column, row) = (square % side, square / side % side);
    let all = (0..9).map(|k| (k % 3, k / 3)).filter(|k| *k != (1, 1));
    let inside = move |at: usize, step: usize| (1..=side).contains(&(at + step));
    all.filter(move |(c, r)| inside(column, *c) && inside(row, *r)).map(move |(c, r)| square + c + r * side - 1 - side)
}

/// Rays lie a few squares of a [`SkyMap`] apart; gaps up to twice this many between them are sky
/// as well.
const SKY_GAP: usize = 2;

/// Morphological closing of a face of a [`SkyMap`] by a square.
fn close_gaps(face: &mut [bool]) {
    let side = SkyMap::SIDE as usize;
    // A square is set if any (or, eroding, all) within reach along a row or column are.
    let mut pass = |across: bool, grow: bool| {
        let before = face.to_vec();
        for at in 0..face.len() {
            let (place, step) = if across { (at % side, 1) } else { (at / side, side) };
            let (back, ahead) = (place.min(SKY_GAP), (side - 1 - place).min(SKY_GAP));
            let mut reach = (at - back * step..=at + ahead * step).step_by(step);
            face[at] = if grow { reach.any(|i| before[i]) } else { reach.all(|i| before[i]) };
        }
    };
    [(true, true), (false, true), (true, false), (false, false)]
        .into_iter()
        .for_each(|(across, grow)| pass(across, grow));
}

/// What an eye sees of a face.
#[derive(Debug, Clone, Copy)]
pub(super) struct Glimpse {
    /// Absolute coordinates in the image, and disparity there; 0 is sky.
    pub at: [f64; 3],
    /// How far what the ray stands for reaches there, to each side and up and down.
    pub half: [f64; 2],
    /// Absolute coordinates in the eye's own picture, at full scale.
    pub ray: [f64; 2],
    /// How far what it stands for reaches there.
    pub ray_half: [f64; 2],
}

/// What eyes see of a face: each eye's offset from the centre of projection (right, up, forward),
/// and its glimpses.
pub(super) struct Face(Vec<(DVec3, Vec<Glimpse>)>);

impl Face {
    /// The part of a survey that is a planned image's to show; the rig's window is the whole of it.
    pub fn of(survey: &Survey, plan: &ImagePlan, rig: &Rig) -> Self {
        let eyes = survey.eyes.par_iter().map(|(eye, hits)| {
            let offset = rig.lens.in_basis(*eye - rig.cop);
            (offset, hits.iter().filter_map(|hit| Glimpse::of(hit, offset, survey.half_angle, plan, rig)).collect())
        });
        Self(eyes.collect())
    }

    /// Each eye's offset, and what it sees.
    pub fn eyes(&self) -> impl Iterator<Item = (&DVec3, &[Glimpse])> {
        self.0.iter().map(|(offset, glimpses)| (offset, &glimpses[..]))
    }

    /// Its tiles, of at most so many pixels each.
    pub fn tiles(&self, rig: &Rig, most_pixels: usize) -> Vec<Tile> {
        tiles(&rig.window, self.0.iter().flat_map(|(_, glimpses)| glimpses), most_pixels)
    }
}

impl Glimpse {
    /// None: the image does not hold it.
    fn of(hit: &Hit, offset: DVec3, half_angle: f64, plan: &ImagePlan, rig: &Rig) -> Option<Self> {
        let ray = rig.lens.in_basis(hit.direction.as_dvec3());
        // Toward the side there is no end to the plane.
        const SIDEWAYS: f64 = 1e-3;
        if ray.z < SIDEWAYS {
            return None;
        }
        // A disc across a ray, of radius r at p, reaches r |grad x/z| to either side of x/z, and
        // likewise y/z.
        let s = rig.lens.pixels_per_unit;
        let on_plane = |p: DVec3| [p.x / p.z * s, -p.y / p.z * s];
        let reach = |p: DVec3, radius: f64| [p.x, p.y].map(|x| radius / p.z * (x / p.z).hypot(1.0) * s);
        let sky = !hit.distance.is_finite();
        let p = if sky { ray } else { offset + ray * f64::from(hit.distance) };
        if p.z <= 0.0 || !plan.owns(if sky { ray * FAR_AWAY_M } else { p }) {
            return None;
        }
        let [u, v] = on_plane(p);
        let radius = half_angle * if sky { 1.0 } else { f64::from(hit.distance) };
        let glimpse = Self {
            at: [u, v, if sky { 0.0 } else { 1.0 / p.z }],
            half: reach(p, radius),
            ray: on_plane(ray),
            ray_half: reach(ray, half_angle),
        };
        let held = rig.in_reach(u, v, glimpse.at[2]) && glimpse.touches(&rig.window);
        held.then_some(glimpse)
    }

    /// Whether what it shows may be needed in a window.
    fn touches(&self, window: &Window) -> bool {
        let (across, down) = blocks_of(window, BLOCK, self);
        !across.is_empty() && !down.is_empty()
    }
}

/// What eyes see of an image.
pub(super) struct Sight {
    /// The pixels to look at.
    pub looked: Looked,
    /// None: eyes may be anywhere.
    pictures: Option<Vec<Picture>>,
}

/// What one eye sees.
struct Picture {
    camera: ConstructionCamera,
    /// Squares of the camera's window per row.
    columns: usize,
    rows: usize,
    glimpses: Vec<Glimpse>,
}

impl Sight {
    /// What is seen of the rig's window, which is cut to it. Without a face everything is looked
    /// at. None: nobody sees anything.
    pub fn of(face: Option<&Face>, rig: &mut Rig) -> Option<Self> {
        let Some(face) = face else { return Some(Self { looked: Looked::everything(&rig.window), pictures: None }) };
        let pictures: Vec<Picture> =
            face.0.par_iter().filter_map(|(offset, glimpses)| Picture::of(rig, *offset, glimpses)).collect();
        let looked = looked_at(&rig.window, pictures.iter().flat_map(|p| &p.glimpses));
        let (looked, window) = cropped(looked, &rig.window)?;
        rig.window = window;
        Some(Self { looked, pictures: Some(pictures) })
    }

    /// Rounds of cameras that together see every piece of surface that eyes see and the central
    /// image does not hold, twice where they can: always the eye that sees the most pieces that
    /// are still open. Where eyes may be anywhere: the corners of the users' box.
    pub fn cameras(self, rig: &Rig, central: &[Sample], tolerance: &Tolerance) -> Vec<Vec<View>> {
        let Some(pictures) = self.pictures else { return rig.corner_cameras() };
        // Per eye, its pieces and what shows them.
        let mut pieces: Vec<BTreeMap<[i32; 3], Vec<&Glimpse>>> = pictures
            .par_iter()
            .map(|picture| {
                let mut pieces: BTreeMap<[i32; 3], Vec<&Glimpse>> = BTreeMap::new();
                for seen in picture.glimpses.iter().filter(|s| !held(rig, central, tolerance, s)) {
                    pieces.entry(piece(seen)).or_default().push(seen);
                }
                pieces
            })
            .collect();
        let is_open = |cameras_of: &BTreeMap<[i32; 3], u8>, piece: &[i32; 3]| {
            cameras_of.get(piece).is_none_or(|cameras| *cameras < CAMERAS_PER_PIECE)
        };
        let mut gains: Vec<usize> = pieces.iter().map(BTreeMap::len).collect();
        let mut cameras_of: BTreeMap<[i32; 3], u8> = BTreeMap::new();
        let mut views = Vec::new();
        while views.len() < MOST_CAMERAS {
            // Gains only shrink: the largest is up to date once recounting leaves it the largest.
            // Of equals the first.
            let (best, gain) = loop {
                let best = (0..gains.len()).rev().max_by_key(|i| gains[*i]);
                let Some(best) = best else { break (0, 0) };
                let fresh = pieces[best].keys().filter(|k| is_open(&cameras_of, k)).count();
                if fresh == gains[best] {
                    break (best, fresh);
                }
                gains[best] = fresh;
            };
            if gain == 0 {
                break;
            }
            let new: Vec<_> =
                std::mem::take(&mut pieces[best]).into_iter().filter(|(k, _)| is_open(&cameras_of, k)).collect();
            new.iter().for_each(|(piece, _)| *cameras_of.entry(*piece).or_default() += 1);
            views.extend(pictures[best].view(new.into_iter().flat_map(|(_, seen)| seen)));
            gains[best] = 0;
        }
        // A few at a time: what one finds, the next need not trace.
        views.chunks(4).map(<[View]>::to_vec).collect()
    }
}

/// Whether the central image holds what is seen.
fn held(rig: &Rig, central: &[Sample], tolerance: &Tolerance, seen: &Glimpse) -> bool {
    let [u, v, d] = seen.at;
    let (column, row) = (u.floor() as i64 - i64::from(rig.window.left), v.floor() as i64 - i64::from(rig.window.top));
    let Some(at) = rig.window.index(column, row) else { return true };
    let s = &central[at];
    if s.disparity <= 0.0 {
        return f64::from(s.disparity) == d;
    }
    let (cu, cv) = rig.window.centre(at);
    let there = s.disparity + s.gradient[0] * (u - cu) as f32 + s.gradient[1] * (v - cv) as f32;
    (there - d as f32).abs() <= HELD_STEPS * tolerance.step
}

/// Hits with one such number show one piece of surface.
fn piece(seen: &Glimpse) -> [i32; 3] {
    let [u, v, d] = seen.at;
    let depth = if d > 0.0 { (d.ln() / PIECE_DEPTH).floor() as i32 } else { i32::MIN };
    [(u / PIECE).floor() as i32, (v / PIECE).floor() as i32, depth]
}

impl Picture {
    /// What an eye sees of the rig's window; None: nothing.
    fn of(rig: &Rig, offset: DVec3, glimpses: &[Glimpse]) -> Option<Self> {
        let within = |g: &&Glimpse| g.touches(&rig.window);
        let glimpses: Vec<Glimpse> = glimpses.iter().filter(within).copied().collect();
        if glimpses.is_empty() {
            return None;
        }
        let camera = rig.camera_at(offset)?;
        let (columns, rows) = (camera.window.width as usize, camera.window.height as usize);
        Some(Self { camera, columns: columns.div_ceil(SQUARE), rows: rows.div_ceil(SQUARE), glimpses })
    }

    /// The camera cut to some glimpses and what is around them.
    fn view<'a>(&self, some: impl Iterator<Item = &'a Glimpse>) -> Option<View> {
        let (columns, rows, scale) = (self.columns, self.rows, self.camera.scale);
        let mut wide = vec![false; columns * rows];
        let (mut c, mut r) = ([usize::MAX, 0], [usize::MAX, 0]);
        for glimpse in some {
            let (at, half) = (glimpse.ray.map(|x| x * scale), glimpse.ray_half.map(|h| h * scale + AROUND));
            let (across, down) = blocks_around(&self.camera.window, SQUARE, at, half);
            if across.is_empty() || down.is_empty() {
                continue;
            }
            (c, r) = ([c[0].min(across.start), c[1].max(across.end)], [r[0].min(down.start), r[1].max(down.end)]);
            down.for_each(|row| wide[row * columns..][across.clone()].fill(true));
        }
        if c[0] >= c[1] {
            return None;
        }
        let squares = (r[0]..r[1]).flat_map(|row| &wide[row * columns + c[0]..row * columns + c[1]]);
        let open = Open(Sums::new(&squares.copied().collect::<Vec<_>>(), c[1] - c[0]));
        let mut camera = self.camera;
        camera.window = part(&camera.window, c, r, SQUARE);
        Some(View { camera, open: Some(open) })
    }
}

/// Columns and rows of squares of a window, from and to, as a window.
fn part(w: &Window, columns: [usize; 2], rows: [usize; 2], side: usize) -> Window {
    let span =
        |x: [usize; 2], limit: u32| ((x[0] * side) as i32, ((x[1] * side) as u32).min(limit) - (x[0] * side) as u32);
    let ((left, width), (top, height)) = (span(columns, w.width), span(rows, w.height));
    Window { left: w.left + left, top: w.top + top, width, height }
}

/// Blocks of a window, from its corner, that a rectangle of half sides `half` around a place
/// touches; beside the window: empty ranges.
fn blocks_around(window: &Window, side: usize, at: [f64; 2], half: [f64; 2]) -> (Range<usize>, Range<usize>) {
    let span = |x: f64, half: f64, first: i32, size: u32| {
        let place = |x: f64| ((x - f64::from(first)) / side as f64).floor();
        let n = (size as usize).div_ceil(side) as f64;
        (place(x - half).clamp(0.0, n) as usize)..((place(x + half) + 1.0).clamp(0.0, n) as usize)
    };
    (span(at[0], half[0], window.left, window.width), span(at[1], half[1], window.top, window.height))
}

/// The blocks of a window that hold something seen, and a margin.
pub(super) fn blocks_of(window: &Window, side: usize, seen: &Glimpse) -> (Range<usize>, Range<usize>) {
    blocks_around(window, side, [seen.at[0], seen.at[1]], seen.half.map(|h| h + MARGIN))
}

/// The blocks that hold what is seen, and a margin.
fn looked_at<'a>(window: &Window, seen: impl Iterator<Item = &'a Glimpse>) -> Looked {
    let columns = (window.width as usize).div_ceil(BLOCK);
    let mut blocks = vec![false; columns * (window.height as usize).div_ceil(BLOCK)];
    for glimpse in seen {
        let (across, down) = blocks_of(window, BLOCK, glimpse);
        down.for_each(|row| blocks[row * columns..][across.clone()].fill(true));
    }
    Looked { blocks, columns }
}

/// The smallest window around what is looked at; None if nothing is.
fn cropped(looked: Looked, window: &Window) -> Option<(Looked, Window)> {
    let Looked { blocks, columns } = looked;
    let (c, r) = Sums::new(&blocks, columns).tight(0..columns, 0..blocks.len() / columns)?;
    let window = part(window, [c.start, c.end], [r.start, r.end], BLOCK);
    let blocks = r.flat_map(|row| &blocks[row * columns..][c.clone()]).copied().collect();
    Some((Looked { blocks, columns: c.len() }, window))
}
