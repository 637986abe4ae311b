//! Portal images of 1998: depth images from a semicircle, and one layered image merged from them
//! (Rafferty, Aliaga, Popescu and Lastra 1998, sections 3 and 4.1).
//!
//! In: a caster, a [`SidePlan`]. Out: a [`SideImages`]: single-layer depth images of what lies
//! beyond the portal, by rays through its polygon alone, and their merger.
//!
//! 1. The layered image has the camera of the central one, but a wide window: what eyes at the
//!    side see through the portal lies beside it for the central one.
//! 2. Every sample of the others, the nearest image first, is warped to it and meets what is in
//!    its place by the rules of `portal_merge`.
//! 3. The k-th nearest of a place goes to layer k; neighbours that continue each other's surface
//!    are linked, as in our own images, because the warp draws linked samples as quads.
//!
//! As in the paper nothing is cast again (our own images do that: `merge`): a merged sample moves
//! to the middle of its place. Its depth follows its plane there, unless that changes it by more
//! than the rules take for the same depth, as on surfaces along the line of sight; with the depth
//! kept everywhere slanted surfaces were rough, and errors larger than those of one image. Rays
//! meet everything beyond the portal's plane, cells that are drawn with the room before it
//! included: so one image serves as a texture too, and where both are there they agree in depth.

use super::{
    ConstructError, ConstructOptions,
    caster::{Subset, SubsetCaster},
    central::{Surveyor, pixel_ray},
    colour, ends,
    layers::{self, NO_CODES, RawLayer},
    portal_merge::{MergeFigures, Offer, merge_place},
    sample::{self, Prediction, Tolerance},
    view::{Rig, Window, parallax_bound},
};
use crate::{
    placement::ImagePlan,
    portal::SidePlan,
    render::{Caster, CellSet, Ray},
};
use glam::{DVec3, Vec3};
use ldi_protocol::{
    CellRuns,
    ldi::{END_BITS, Ldi, LdiLayer, SIDES, end_of},
    sky::SkyMap,
};
use rayon::prelude::*;

/// The images of one side of a portal.
#[derive(Debug, Clone, Default)]
pub struct SideImages {
    /// Reference images in the plan's order, of one layer each; without samples where nothing but
    /// sky lies beyond.
    pub references: Vec<Option<Ldi>>,
    /// The image merged from them.
    pub layered: Option<Ldi>,
    /// Directions in which some reference sees sky.
    pub sky: SkyMap,
    /// What became of samples in merging.
    pub merge: MergeFigures,
    /// Rays cast.
    pub rays: u64,
}

/// A reference image before coding.
struct Shot {
    rig: Rig,
    layer: RawLayer,
    /// Unit normals of the samples' surfaces.
    normals: Vec<Vec3>,
    /// Pixels whose rays meet nothing.
    open: Vec<u32>,
    rays: u64,
}

/// Makes the images of one side. `same_depth`: as of [`merge_place`]. The caster should have mips.
///
/// # Errors
/// As [`super::construct`].
pub fn construct_side(
    caster: &Caster,
    plan: &SidePlan,
    options: &ConstructOptions,
    same_depth: f64,
) -> Result<SideImages, ConstructError> {
    construct_side_of(
        &Subset { caster, cells: CellSet::all(), staying: CellSet::all(), culled: &CellRuns::default() },
        plan,
        options,
        same_depth,
    )
}

/// The same over anything that casts rays.
pub(super) fn construct_side_of<C: SubsetCaster>(
    caster: &C,
    plan: &SidePlan,
    options: &ConstructOptions,
    same_depth: f64,
) -> Result<SideImages, ConstructError> {
    let shots = plan.references.par_iter().map(|image| shoot(caster, image, plan, options));
    let shots: Vec<Shot> = shots.collect::<Result<_, _>>()?;
    let mut squares = vec![false; SkyMap::SQUARES as usize];
    for shot in &shots {
        for pixel in &shot.open {
            let (u, v) = shot.rig.window.centre(*pixel as usize);
            squares[SkyMap::square(shot.rig.lens.ray(u, v)) as usize] = true;
        }
    }
    let rig = rig_of(&plan.layered, plan, options)?;
    let (layered, merge) = merged(&shots, plan.central, rig, same_depth);
    Ok(SideImages {
        layered,
        merge,
        rays: shots.iter().map(|s| s.rays).sum(),
        references: shots.iter().map(encoded).collect(),
        sky: SkyMap::of(&squares),
    })
}

/// The rig of an image whose eyes all face the portal.
fn rig_of(image: &ImagePlan, plan: &SidePlan, options: &ConstructOptions) -> Result<Rig, ConstructError> {
    let mut rig = Rig::new(image, &options.output)?;
    // Depths along the axis differ from those of the central image by where the camera stands.
    let behind_m = (plan.layered.cop - image.cop).dot(image.basis.forward);
    let ahead_m = plan.ahead_m + behind_m;
    rig.user_offsets = rig.user_offsets.map(|e| DVec3::new(e.x, e.y, e.z.min(ahead_m)));
    rig.parallax_bound = parallax_bound(&rig.user_offsets, rig.near_m, &options.output);
    Ok(rig)
}

/// Takes a reference image: one ray per pixel of the portal's polygon, from the portal on.
fn shoot<C: SubsetCaster>(
    caster: &C,
    image: &ImagePlan,
    plan: &SidePlan,
    options: &ConstructOptions,
) -> Result<Shot, ConstructError> {
    let rig = rig_of(image, plan, options)?;
    rig.window.check(options.max_pixels)?;
    let tolerance = Tolerance { step: rig.step() as f32 };
    let width = rig.window.width as usize;
    let polygon = Outline::new(&plan.through, &rig);
    type Line = (Vec<Prediction>, Vec<Vec3>, Vec<u32>, u64);
    let line = |row: usize| -> Line {
        let pixels: Vec<u32> = (0..width)
            .map(|column| row * width + column)
            .filter(|p| polygon.holds(rig.window.centre(*p)))
            .map(|p| p as u32)
            .collect();
        let rays: Vec<Ray> = pixels.iter().map(|p| pixel_ray(&rig, *p as usize, rig.near_m, f64::INFINITY)).collect();
        let mut hits = vec![None; rays.len()];
        caster.trace(&rays, &mut hits);
        let mut surveyor = Surveyor::new(caster, &rig.lens);
        let (mut samples, mut normals, mut open) = (Vec::new(), Vec::new(), Vec::new());
        for ((pixel, ray), hit) in pixels.iter().zip(&rays).zip(&hits) {
            match hit {
                Some(hit) => {
                    samples.push((*pixel, surveyor.sample(ray, hit)));
                    normals.push(surveyor.facet(ray, hit).normal.as_vec3());
                }
                None => open.push(*pixel),
            }
        }
        (samples, normals, open, rays.len() as u64)
    };
    let lines: Vec<Line> = (0..rig.window.height as usize).into_par_iter().map(line).collect();
    let (mut layer, mut normals, mut open, mut rays) = (RawLayer::default(), Vec::new(), Vec::new(), 0);
    for (samples, of_line, sky, cast) in lines {
        layer.samples.extend(samples);
        normals.extend(of_line);
        open.extend(sky);
        rays += cast;
    }
    layer.links = layers::links(&layer.samples, rig.window.width, &tolerance);
    rays += ends::measure(caster, &rig, &mut layer, &tolerance);
    let mut layers = [layer];
    rays += colour::average(caster, &rig, &mut layers, &tolerance);
    let [layer] = layers;
    Ok(Shot { rig, layer, normals, open, rays })
}

/// A convex polygon in absolute image coordinates, a pixel larger than the portal.
struct Outline {
    /// Inward: a u + b v + c >= 0.
    sides: Vec<[f64; 3]>,
}

impl Outline {
    fn new(through: &[DVec3], rig: &Rig) -> Self {
        let place = |p: &DVec3| {
            let v = rig.lens.in_basis(*p - rig.cop);
            [v.x / v.z * rig.lens.pixels_per_unit, -v.y / v.z * rig.lens.pixels_per_unit]
        };
        let corners: Vec<[f64; 2]> = through.iter().map(place).collect();
        let n = corners.len();
        let middle = [0, 1].map(|k| corners.iter().map(|c| c[k]).sum::<f64>() / n.max(1) as f64);
        let side = |i: usize| {
            let (a, b) = (corners[i], corners[(i + 1) % n]);
            let (mut u, mut v) = (a[1] - b[1], b[0] - a[0]);
            let length = u.hypot(v).max(1e-12);
            let inward = if u * (middle[0] - a[0]) + v * (middle[1] - a[1]) < 0.0 { -length } else { length };
            (u, v) = (u / inward, v / inward);
            [u, v, 1.0 - u * a[0] - v * a[1]]
        };
        Self { sides: (0..n).map(side).collect() }
    }

    fn holds(&self, (u, v): (f64, f64)) -> bool {
        self.sides.iter().all(|[a, b, c]| a * u + b * v + c >= 0.0)
    }
}

/// A reference image as it is stored; None without samples.
fn encoded(shot: &Shot) -> Option<Ldi> {
    if shot.layer.samples.is_empty() {
        return None;
    }
    let mut sky = vec![0; (shot.rig.window.width as usize).div_ceil(64) * shot.rig.window.height as usize];
    shot.open.iter().for_each(|pixel| super::set_sky(&mut sky, *pixel, &shot.rig));
    let codes = layers::codes(&shot.rig, std::slice::from_ref(&shot.layer), std::iter::empty());
    let layers = vec![layers::encode(&shot.layer, shot.rig.window.width, &codes)];
    let ldi = Ldi { camera: shot.rig.ldi_camera(), codes, layers, sky, slivers: Vec::new() };
    debug_assert_eq!(ldi.check(), Ok(()));
    Some(ldi)
}

/// A sample on its way to the layered image.
struct Warped {
    /// Row and column in its whole window.
    place: (u32, u32),
    offer: Offer,
    sample: sample::Sample,
    /// How far its surface goes on, as measured: of central samples, which stay where they are.
    ends: Option<u16>,
}

/// Merges shots into one image; `rig` has its camera and the whole window.
fn merged(shots: &[Shot], central: usize, mut rig: Rig, same_depth: f64) -> (Option<Ldi>, MergeFigures) {
    let mut order: Vec<usize> = (0..shots.len()).collect();
    order.sort_by_key(|k| (k.abs_diff(central), *k));
    let mut figures = MergeFigures::default();
    let mut all: Vec<Warped> = Vec::new();
    for (rank, k) in order.iter().enumerate() {
        let shot = &shots[*k];
        let before = all.len();
        let samples = shot.layer.samples.par_iter().zip(&shot.normals);
        all.par_extend(
            samples
                .filter_map(|((pixel, s), n)| warped(shot, rank as u16, (*pixel, s, n.as_dvec3()), &rig, same_depth)),
        );
        if rank == 0 && all.len() - before == shot.layer.ends.len() {
            all[before..].iter_mut().zip(&shot.layer.ends).for_each(|(w, ends)| w.ends = Some(*ends));
        }
        figures.offered += shot.layer.samples.len() as u64;
        figures.outside += (shot.layer.samples.len() - (all.len() - before)) as u64;
    }
    // Stable: samples of one image stay in its order.
    all.par_sort_by_key(|w| (w.place, w.offer.image));
    let places: Vec<&[Warped]> = all.chunk_by(|a, b| a.place == b.place).collect();
    let of_place = |place: &&[Warped]| {
        let mut own = MergeFigures::default();
        let offers: Vec<Offer> = place.iter().map(|w| w.offer).collect();
        (merge_place(&offers, same_depth, &mut own), own)
    };
    let kept: Vec<(Vec<usize>, MergeFigures)> = places.par_iter().map(of_place).collect();
    let open: Vec<(u32, u32)> = shots.iter().flat_map(|s| sky_places(s, &rig)).collect();
    // Cut to what there is.
    let mut bounds = [u32::MAX, u32::MAX, 0, 0];
    for (row, column) in places.iter().filter_map(|p| Some(p.first()?.place)).chain(open.iter().copied()) {
        bounds = [bounds[0].min(row), bounds[1].min(column), bounds[2].max(row + 1), bounds[3].max(column + 1)];
    }
    let [top, left, bottom, right] = bounds;
    if places.is_empty() {
        return (None, figures);
    }
    let whole = rig.window;
    rig.window = Window {
        left: whole.left + left as i32,
        top: whole.top + top as i32,
        width: right - left,
        height: bottom - top,
    };
    let width = rig.window.width;
    let mut raw: Vec<RawLayer> = Vec::new();
    let mut measured: Vec<Vec<Option<u16>>> = Vec::new();
    for (place, (kept, own)) in places.iter().zip(kept) {
        figures.add(&own);
        for (k, at) in kept.into_iter().enumerate() {
            if k >= Ldi::MAX_LAYERS {
                figures.outside += 1;
                continue;
            }
            if raw.len() <= k {
                raw.push(RawLayer::default());
                measured.push(Vec::new());
            }
            let Warped { place: (row, column), sample, ends, .. } = &place[at];
            measured[k].push(*ends);
            raw[k].samples.push(((row - top) * width + (column - left), *sample));
            figures.kept += 1;
        }
    }
    let tolerance = Tolerance { step: rig.step() as f32 };
    raw.par_iter_mut().for_each(|l| {
        l.links = layers::links(&l.samples, width, &tolerance);
        l.ends = vec![0; l.samples.len()];
    });
    let codes = if raw.is_empty() { NO_CODES } else { layers::codes(&rig, &raw, std::iter::empty()) };
    let encode = |(l, measured): (&RawLayer, &Vec<Option<u16>>)| -> LdiLayer {
        with_measured_ends(layers::encode(l, width, &codes).with_half_ends(), measured)
    };
    let layers: Vec<LdiLayer> = raw.par_iter().zip(&measured).map(encode).collect();
    let mut sky = vec![0; (width as usize).div_ceil(64) * rig.window.height as usize];
    for (row, column) in open {
        super::set_sky(&mut sky, (row - top) * width + (column - left), &rig);
    }
    let ldi = Ldi { camera: rig.ldi_camera(), codes, layers, sky, slivers: Vec::new() };
    debug_assert_eq!(ldi.check(), Ok(()));
    (Some(ldi), figures)
}

/// The layer with the ends that are known, where nothing is linked.
fn with_measured_ends(mut layer: LdiLayer, measured: &[Option<u16>]) -> LdiLayer {
    let linked = layer.linked_sides();
    for ((ends, linked), known) in layer.ends.iter_mut().zip(linked).zip(measured) {
        let Some(known) = known else { continue };
        let open = (0..SIDES.len()).filter(|side| linked >> side & 1 == 0);
        *ends = open.map(|side| end_of(*known, side) << (side * END_BITS)).sum();
    }
    layer
}

/// A sample as the layered image's camera sees it; None beside its window.
fn warped(
    shot: &Shot,
    image: u16,
    (pixel, s, normal): (u32, &sample::Sample, DVec3),
    to: &Rig,
    same_depth: f64,
) -> Option<Warped> {
    let (u, v) = shot.rig.window.centre(pixel as usize);
    let (ray, depth_m) = (shot.rig.lens.ray(u, v), 1.0 / f64::from(s.disparity));
    let p = to.lens.in_basis(shot.rig.cop + ray * depth_m - to.cop);
    let disparity = 1.0 / p.z;
    if !(p.z > 0.0 && disparity.is_finite()) {
        return None;
    }
    let scale = to.lens.pixels_per_unit * disparity;
    let (column, row) = (
        (p.x * scale).floor() as i64 - i64::from(to.window.left),
        (-p.y * scale).floor() as i64 - i64::from(to.window.top),
    );
    let place = to.window.index(column, row)?;
    // A pixel's cone cuts the surface in z² / (f² |n . r|), r with component 1 along the axis.
    let f = shot.rig.lens.pixels_per_unit;
    let area_m2 = (depth_m / f).powi(2) / normal.dot(ray).abs();
    let ray = to.lens.ray(p.x * scale, -p.y * scale);
    let gradient = sample::gradient(&to.lens, normal, ray, disparity);
    let (u, v) = to.window.centre(place);
    let change = f64::from(gradient[0]) * (u - p.x * scale) + f64::from(gradient[1]) * (v + p.y * scale);
    let at_middle = if change.abs() <= same_depth * disparity { disparity + change } else { disparity };
    let sample = sample::Sample { disparity: at_middle as f32, gradient, ..*s };
    let offer = Offer { image, disparity: sample.disparity, area_m2: area_m2 as f32 };
    Some(Warped { place: (row as u32, column as u32), offer, sample, ends: None })
}

/// Places of the layered image whose directions a shot saw sky in: images are parallel, so that
/// only their scales differ.
fn sky_places<'a>(shot: &'a Shot, to: &'a Rig) -> impl Iterator<Item = (u32, u32)> + 'a {
    let scale = to.lens.pixels_per_unit / shot.rig.lens.pixels_per_unit;
    shot.open.iter().flat_map(move |pixel| {
        let (u, v) = shot.rig.window.centre(*pixel as usize);
        let span = |x: f64, first: i32, count: u32| {
            let (low, high) = (((x - 0.5) * scale).floor() as i64, ((x + 0.5) * scale).ceil() as i64);
            let inside = |k: i64| k.clamp(0, i64::from(count)) as u32;
            inside(low - i64::from(first))..inside(high - i64::from(first))
        };
        let columns = span(u, to.window.left, to.window.width);
        span(v, to.window.top, to.window.height).flat_map(move |row| columns.clone().map(move |column| (row, column)))
    })
}
