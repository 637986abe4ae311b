//! Chains of simplified meshes of every part.
//!
//! Vertices that agree in position, and in texture coordinates and colour where these count, are
//! one while a part is simplified; afterwards every corner takes that of them whose normal agrees
//! best with its triangle. So creases do not stop simplification, and stay creases. Simplified
//! meshes have vertices of the primitive, with its normals. Where these would light a triangle
//! otherwise than what it stands for, as at the flange of a beam whose fillet is gone, corners
//! have the normals of the surface beside them.

use super::{
    deviation::{self, Corners},
    parts::Part,
};
use crate::octree::Clusters;
use crate::scene::{Mesh, Primitive, Scene};
use glam::{DVec3, Vec3};
use ldi_protocol::{Aabb, mesh::Alpha};
use meshopt::{SimplifyOptions, VertexDataAdapter};
use rayon::prelude::*;
use std::collections::{HashMap, HashSet};

/// Parts of fewer triangles stay as they are.
const FEWEST: usize = 8;
/// The library may err by this share of the part's size for the first mesh of a chain: at 1280x720
/// and half a pixel for eyes about two sizes away; nearer ones see the part in full ...
const FIRST_ERROR: f64 = 1.0 / 1024.0;
/// ... and by this many times as much for each that follows. Smaller: a cell takes fewer triangles
/// for what it may deviate, and more of them are stored.
const ERROR_STEP: f64 = 1.5;
/// A mesh joins the chain if it has at most this share of the triangles of the one before.
const WORTH: f64 = 0.8;
/// Where topology stops simplification, vertices within cells of a grid become one, in meshes that
/// are at most this many deviations in size. Faces may turn over by that, which shows in nothing
/// but their light, as both sides are drawn.
const SLOPPY_SIZE: f64 = 64.0;
/// What texture coordinates and colours count beside positions, both relative to their extent.
const ATTRIBUTE_WEIGHT: f32 = 1.0;
/// What a mesh covers less than the part counts as deviation: one that covers nothing is drawn
/// from 1 plus so many times as far as its deviation allows. A pipe of one pixel in width lies
/// within half a pixel of a line, and would vanish. Smaller: thin things leave holes; larger: more
/// triangles are drawn far away.
const UNCOVERED_WEIGHT: f64 = 4.0;
/// Corners keep the primitive's normals where these turn by no more than this from the surface, as
/// a cosine. Smaller: lights differ; larger: more vertices are stored.
const SAME_NORMAL: f32 = 0.99;
/// Where the normal of a corner is compared: this much of the way to the triangle's centre. Smaller:
/// still on the fillet of a beam; larger: corners of one triangle are no longer told apart.
const INSET: f64 = 0.4;
/// Deviations are told apart down to this share of what the library estimates ...
const FLOOR_SHARE: f64 = 0.25;
/// ... and of the part's size: a flat surface in other triangles is not looked at more closely.
const FLOOR_SIZE: f64 = 1e-4;

/// A simplified mesh of a part.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct Coarse {
    /// Bound on how far it lies from the part, in mesh units, more if it covers less than the part;
    /// grows along the chain.
    pub deviation: f64,
    /// Vertex numbers of the primitive.
    pub triangles: Vec<[u32; 3]>,
    /// Corners, numbered through all triangles and ascending, that have another normal than their
    /// vertex; unit length.
    pub turned: Vec<(u32, Vec3)>,
}

/// The chain of every part, fine to coarse, without the part itself.
pub(super) fn chains(scene: &Scene, clusters: &Clusters, parts: &[Part]) -> Vec<Vec<Coarse>> {
    let mut of_mesh: Vec<Vec<u32>> = vec![Vec::new(); scene.meshes.len()];
    parts.iter().zip(0u32..).for_each(|(part, number)| of_mesh[part.mesh as usize].push(number));
    let mut chains = vec![Vec::new(); parts.len()];
    let made: Vec<Vec<Vec<Coarse>>> = of_mesh
        .par_iter()
        .zip(&scene.meshes)
        .map(|(of, mesh)| {
            let borders = Borders::of(mesh, clusters, of.iter().map(|p| &parts[*p as usize]));
            of.par_iter().map(|p| chain(scene, clusters, &parts[*p as usize], &borders)).collect()
        })
        .collect();
    for (of, made) in of_mesh.into_iter().zip(made) {
        of.into_iter().zip(made).for_each(|(part, chain)| chains[part as usize] = chain);
    }
    chains
}

/// A position by its bits; both zeros are one.
fn place(v: Vec3) -> [u32; 3] {
    v.to_array().map(|x| (x + 0.0).to_bits())
}

/// Where clusters of a mesh meet.
struct Borders {
    /// Clusters that use a position, for positions that several use.
    shared: HashMap<[u32; 3], Vec<u32>>,
}

impl Borders {
    /// Of a mesh and its parts. None where every part is the whole mesh.
    fn of<'a>(mesh: &Mesh, clusters: &Clusters, mut parts: impl Iterator<Item = &'a Part> + Clone) -> Self {
        let number = parts.clone().next().map(|p| p.mesh as usize);
        let of_mesh = number.map(|m| clusters.of_mesh[m].clone()).unwrap_or_default();
        let mut shared = HashMap::new();
        if !parts.all(|p| p.clusters.len() == of_mesh.len()) {
            let mut users: HashMap<[u32; 3], Vec<u32>> = HashMap::new();
            for number in of_mesh {
                let cluster = &clusters.clusters[number as usize];
                let primitive = &mesh.primitives[cluster.primitive as usize];
                for t in &cluster.triangles {
                    for v in primitive.triangles[*t as usize] {
                        let of = users.entry(place(primitive.positions[v as usize])).or_default();
                        // Clusters come one after the other.
                        if of.last() != Some(&number) {
                            of.push(number);
                        }
                    }
                }
            }
            shared = users.into_iter().filter(|(_, of)| of.len() > 1).collect();
        }
        Self { shared }
    }

    /// Whether something else than the part meets it there.
    fn meets(&self, part: &Part, place: &[u32; 3]) -> bool {
        let others = |of: &Vec<u32>| of.iter().any(|c| part.clusters.binary_search(c).is_err());
        self.shared.get(place).is_some_and(others)
    }
}

/// Vertices of a part, welded.
struct Welded {
    /// Per welded vertex, the vertices of the primitive that it stands for.
    wedges: Vec<Vec<u32>>,
    positions: Vec<[f32; 3]>,
    /// Texture coordinates and colours, `attribute_count` numbers per vertex.
    attributes: Vec<f32>,
    attribute_count: usize,
    locked: Vec<bool>,
    /// Three per triangle.
    indices: Vec<u32>,
}

impl Welded {
    fn of(p: &Primitive, triangles: &[[u32; 3]], textured: bool, locked: impl Fn(&[u32; 3]) -> bool) -> Self {
        let mut number: HashMap<([u32; 3], [u32; 5]), u32> = HashMap::new();
        let colours = !p.colours.is_empty();
        let attribute_count = if textured { 2 } else { 0 } + if colours { 3 } else { 0 };
        let mut w = Self {
            wedges: Vec::new(),
            positions: Vec::new(),
            attributes: Vec::new(),
            attribute_count,
            locked: Vec::new(),
            indices: Vec::with_capacity(triangles.len() * 3),
        };
        // Relative to the part, so that single precision is enough far from zero.
        let origin = triangles.first().map_or(Vec3::ZERO, |t| p.positions[t[0] as usize]);
        for &v in triangles.as_flattened() {
            let at = v as usize;
            let mut values = [0.0f32; 5];
            if textured {
                values[..2].copy_from_slice(&p.uvs[at].to_array());
            }
            if colours {
                values[2..].copy_from_slice(&p.colours[at]);
            }
            let place = place(p.positions[at]);
            let new = *number.entry((place, values.map(f32::to_bits))).or_insert_with(|| {
                w.positions.push((p.positions[at] - origin).to_array());
                w.attributes.extend(&values[if textured { 0 } else { 2 }..if colours { 5 } else { 2 }]);
                w.locked.push(locked(&place));
                w.wedges.push(Vec::new());
                w.wedges.len() as u32 - 1
            });
            let wedges = &mut w.wedges[new as usize];
            if !wedges.contains(&v) {
                wedges.push(v);
            }
            w.indices.push(new);
        }
        w.level_attributes();
        w
    }

    /// Brings every attribute to an extent of 1.
    fn level_attributes(&mut self) {
        for k in 0..self.attribute_count {
            let values = || self.attributes.iter().skip(k).step_by(self.attribute_count).copied();
            let (low, high) = values().fold((f32::INFINITY, f32::NEG_INFINITY), |(l, h), x| (l.min(x), h.max(x)));
            let scale = if high > low { 1.0 / (high - low) } else { 0.0 };
            let of = self.attributes.iter_mut().skip(k).step_by(self.attribute_count);
            of.for_each(|x| *x = (*x - low) * scale);
        }
    }

    fn adapter(&self) -> Option<VertexDataAdapter<'_>> {
        VertexDataAdapter::new(bytemuck::cast_slice(&self.positions), 12, 0).ok()
    }

    /// The fewest triangles that lie within about `error` of all of these, in mesh units, and the
    /// library's estimate of how near.
    fn simplified(&self, error: f64) -> Option<(Vec<u32>, f64)> {
        let vertices = self.adapter()?;
        let mut estimate = 0.0f32;
        let indices = meshopt::simplify_with_attributes_and_locks(
            &self.indices,
            &vertices,
            &self.attributes,
            &[ATTRIBUTE_WEIGHT; 5][..self.attribute_count],
            self.attribute_count * size_of::<f32>(),
            &self.locked,
            0,
            error as f32,
            SimplifyOptions::ErrorAbsolute,
            Some(&mut estimate),
        );
        Some((indices, f64::from(estimate)))
    }

    /// The same, whatever happens to topology.
    fn clustered(&self, error: f64) -> Option<(Vec<u32>, f64)> {
        let vertices = self.adapter()?;
        let scale = f64::from(meshopt::simplify_scale(&vertices));
        let mut estimate = 0.0f32;
        let indices = meshopt::simplify_sloppy_with_locks(
            &self.indices,
            &vertices,
            &self.locked,
            0,
            (error / scale) as f32,
            Some(&mut estimate),
        );
        Some((indices, f64::from(estimate) * scale))
    }

    /// Triangles of welded vertices as triangles of the primitive's.
    fn unwelded(&self, p: &Primitive, indices: &[u32]) -> Vec<[u32; 3]> {
        let corner = |v: u32| Vec3::from_array(self.positions[v as usize]).as_dvec3();
        let triangle = |t: &[u32; 3]| {
            let [a, b, c] = t.map(corner);
            let normal = (b - a).cross(c - a).normalize_or_zero();
            t.map(|v| {
                let agrees = |v: &u32| p.normals[*v as usize].as_dvec3().dot(normal);
                // The first of equals.
                let of = self.wedges[v as usize].iter();
                of.copied().reduce(|a, b| if agrees(&b) > agrees(&a) { b } else { a }).unwrap_or(0)
            })
        };
        let (triangles, _) = indices.as_chunks::<3>();
        triangles.iter().filter(|[a, b, c]| a != b && b != c && c != a).map(triangle).collect()
    }
}

fn corners(p: &Primitive, t: &[u32; 3]) -> Corners {
    t.map(|v| p.positions[v as usize].as_dvec3())
}

fn chain(scene: &Scene, clusters: &Clusters, part: &Part, borders: &Borders) -> Vec<Coarse> {
    let p = &scene.meshes[part.mesh as usize].primitives[part.primitive as usize];
    let material = &scene.materials[p.material as usize];
    if material.alpha != Alpha::Opaque {
        return Vec::new();
    }
    let of_part = part.clusters.iter().flat_map(|c| &clusters.clusters[*c as usize].triangles);
    let full: Vec<[u32; 3]> = of_part.map(|t| p.triangles[*t as usize]).collect();
    if full.len() < FEWEST {
        return Vec::new();
    }
    let textured = material.texture.is_some() && !p.uvs.is_empty();
    let welded = Welded::of(p, &full, textured, |place| borders.meets(part, place));
    let full = Surface::new(p, full);
    let size = Aabb::from_points(full.corners.iter().flatten().copied()).size().length();
    let full_area = full.area();
    let mut chain: Vec<Coarse> = Vec::new();
    let (mut last, mut deviation) = (full.triangles.len(), 0.0f64);
    let mut error = FIRST_ERROR * size;
    while error < size && last > 1 {
        let few = |triangles: &Vec<[u32; 3]>| !triangles.is_empty() && triangles.len() as f64 <= WORTH * last as f64;
        let measure = |triangles: Vec<[u32; 3]>, estimate: f64| {
            let floor = (FLOOR_SHARE * estimate).max(FLOOR_SIZE * size).max(deviation);
            let coarse = Surface::new(p, triangles);
            let uncovered = (1.0 - coarse.area() / full_area).max(0.0);
            (bound(&full, &coarse, floor).max(estimate), uncovered, coarse.triangles)
        };
        let found = welded.simplified(error).map(|(i, e)| (welded.unwelded(p, &i), e)).filter(|f| few(&f.0));
        let found = found.map(|(triangles, estimate)| measure(triangles, estimate)).or_else(|| {
            let (indices, estimate) = welded.clustered(error)?;
            let triangles = Some(welded.unwelded(p, &indices)).filter(few)?;
            Some(measure(triangles, estimate)).filter(|(deviation, ..)| size <= SLOPPY_SIZE * deviation)
        });
        error *= ERROR_STEP;
        let Some((bound, uncovered, triangles)) = found.filter(|(deviation, ..)| *deviation < size) else { continue };
        let turned = turned(p, &full, &triangles);
        let coarse = Coarse { deviation: bound * (1.0 + UNCOVERED_WEIGHT * uncovered), triangles, turned };
        // A finer mesh that is no nearer is of no use.
        while chain.last().is_some_and(|c| c.deviation >= coarse.deviation) {
            chain.pop();
        }
        last = coarse.triangles.len();
        deviation = deviation.max(bound);
        chain.push(coarse);
    }
    chain
}

/// Corners of a simplified mesh that their vertices' normals would light otherwise than the surface
/// is lit beside them, with its normal there; see [`Coarse::turned`].
fn turned(p: &Primitive, full: &Surface, triangles: &[[u32; 3]]) -> Vec<(u32, Vec3)> {
    // Normals that a vertex got, so that neighbours share them.
    let mut new: HashMap<u32, Vec<Vec3>> = HashMap::new();
    let mut out = Vec::new();
    for (number, vertices) in (0u32..).zip(triangles) {
        let corners = corners(p, vertices);
        let centre = (corners[0] + corners[1] + corners[2]) / 3.0;
        let facing = (corners[1] - corners[0]).cross(corners[2] - corners[0]).as_vec3();
        let own = vertices.map(|v| p.normals[v as usize].normalize_or_zero());
        let mean = (own[0] + own[1] + own[2]) / 3.0;
        for k in 0..3 {
            let Some(surface) = full.normal_at(p, corners[k].lerp(centre, INSET)) else { continue };
            // What lies nearest may be the other side of a sheet.
            let surface = if surface.dot(facing) < 0.0 { -surface } else { surface };
            let is_same = |n: &Vec3| n.dot(surface) >= SAME_NORMAL;
            if is_same(&own[k].lerp(mean, INSET as f32).normalize_or_zero()) {
                continue;
            }
            let of_vertex = new.entry(vertices[k]).or_default();
            let normal = of_vertex.iter().copied().find(is_same).unwrap_or_else(|| {
                of_vertex.push(surface);
                surface
            });
            out.push((3 * number + k as u32, normal));
        }
    }
    out
}

/// Triangles of a primitive, as distances from them need them.
struct Surface {
    /// Vertex numbers of the primitive.
    triangles: Vec<[u32; 3]>,
    corners: Vec<Corners>,
    /// Where the corners of each triangle are, in any order of the three.
    places: Vec<[[u32; 3]; 3]>,
    has: HashSet<[[u32; 3]; 3]>,
    tree: deviation::SurfaceTree,
}

impl Surface {
    fn new(p: &Primitive, triangles: Vec<[u32; 3]>) -> Self {
        let places_of = |t: &[u32; 3]| {
            let mut of = t.map(|v| place(p.positions[v as usize]));
            of.sort_unstable();
            of
        };
        let corners: Vec<Corners> = triangles.iter().map(|t| corners(p, t)).collect();
        let places: Vec<_> = triangles.iter().map(places_of).collect();
        let (has, tree) = (places.iter().copied().collect(), deviation::SurfaceTree::new(&corners));
        Self { triangles, corners, places, has, tree }
    }

    /// Unit normal, as it is lit, where the surface lies nearest to a place.
    fn normal_at(&self, p: &Primitive, place: DVec3) -> Option<Vec3> {
        let (number, weights) = self.tree.surface_at(place)?;
        let of = self.triangles[number as usize].map(|v| p.normals[v as usize].as_dvec3());
        let normal = of[0] * weights[0] + of[1] * weights[1] + of[2] * weights[2];
        normal.try_normalize().map(|n| n.as_vec3())
    }

    /// In square mesh units. Over all directions a closed convex surface covers a quarter of it, on
    /// the mean (Cauchy's formula).
    fn area(&self) -> f64 {
        self.corners.iter().map(|[a, b, c]| 0.5 * (*b - *a).cross(*c - *a).length()).sum()
    }

    /// The triangles that are not in another.
    fn beyond(&self, other: &Self) -> Vec<Corners> {
        let of = self.places.iter().zip(&self.corners);
        of.filter(|(places, _)| !other.has.contains(*places)).map(|(_, c)| *c).collect()
    }
}

/// Bound on how far two surfaces lie apart. Triangles that are in both need no look.
fn bound(full: &Surface, coarse: &Surface, floor: f64) -> f64 {
    let to = deviation::one_way(&full.beyond(coarse), &coarse.tree, floor);
    deviation::one_way(&coarse.beyond(full), &full.tree, floor.max(to)).max(to)
}

/// Centre of a triangle, for the order of pieces.
pub(super) fn centre(p: &Primitive, t: &[u32; 3]) -> DVec3 {
    let [a, b, c] = corners(p, t);
    (a + b + c) / 3.0
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A strip of quads along x, all normals up but those of its ends.
    fn strip(ends: Vec3) -> Primitive {
        let mut p = Primitive::default();
        for x in 0..=10u32 {
            for z in [0.0, 1.0] {
                p.positions.push(Vec3::new(x as f32, 0.0, z));
                p.normals.push(if x == 0 || x == 10 { ends } else { Vec3::Y });
            }
        }
        p.triangles =
            (0..10).flat_map(|x| [[2 * x, 2 * x + 1, 2 * x + 2], [2 * x + 1, 2 * x + 3, 2 * x + 2]]).collect();
        p
    }

    #[test]
    fn corners_take_the_normals_of_the_surface_that_they_stand_for() {
        // Its ends are lit as a beam's fillets.
        let p = strip(Vec3::new(1.0, 1.0, 0.0).normalize());
        let full = Surface::new(&p, p.triangles.clone());
        let up: Vec<(u32, Vec3)> = (0..6).map(|corner| (corner, Vec3::Y)).collect();
        assert_eq!(turned(&p, &full, &[[0, 1, 20], [1, 21, 20]]), up);
        // Nothing is new where nothing is gained.
        let p = strip(Vec3::Y);
        assert_eq!(turned(&p, &Surface::new(&p, p.triangles.clone()), &[[0, 1, 20], [1, 21, 20]]), []);
    }

    #[test]
    fn round_things_stay_round() {
        const SIDES: u32 = 48;
        let mut p = Primitive::default();
        for i in 0..SIDES {
            let (sin, cos) = (std::f32::consts::TAU * i as f32 / SIDES as f32).sin_cos();
            for z in [0.0, 3.0] {
                p.positions.push(Vec3::new(cos, sin, z));
                p.normals.push(Vec3::new(cos, sin, 0.0));
            }
        }
        let sides = |step: u32| -> Vec<[u32; 3]> {
            let quad = |i: u32| {
                let (a, b) = (2 * i, 2 * ((i + step) % SIDES));
                [[a, b, a + 1], [b, b + 1, a + 1]]
            };
            (0..SIDES).step_by(step as usize).flat_map(quad).collect()
        };
        p.triangles = sides(1);
        let full = Surface::new(&p, p.triangles.clone());
        assert_eq!(turned(&p, &full, &sides(6)), []);
        let covered = Surface::new(&p, sides(6)).area() / full.area();
        assert!((0.97..0.99).contains(&covered), "{covered}");
    }
}
