//! Mesh primitives (glTF 2.0 section 3.7): plans first, then triangles.
//!
//! Planning visits every primitive of the file, checks its accessors and adds up what it will
//! need, so that the limits are compared before the first vertex is allocated (many primitives may
//! share one accessor, and each decodes its own copy). Decoding then runs in parallel; results
//! keep file order, and so does the choice of which error is reported.
//!
//! Points and lines have no surface. Their primitives stay as empty ones, so that (mesh,
//! primitive) means the same here as in the file.

use glam::{Affine2, Vec2, Vec3};
use gltf::json::Root;
use gltf::json::mesh::{Mode, Semantic};
use gltf::json::validation::Checked;
use rayon::prelude::*;

use super::super::error::Fault;
use super::super::limits::Limits;
use super::super::model::{Mesh, Primitive};
use super::super::normals;
use super::super::repair;
use super::accessors::{COLOURS, Data, Elements, INDICES, JOINTS, NORMALS, POSITIONS, UVS, Use, WEIGHTS};
use super::compressed;
use super::materials::MaterialPlan;
use super::shapes::{self, Deform, Influences, Shape};

/// Everything about a primitive but its vertices.
#[derive(Debug)]
struct Plan<'a> {
    mesh: usize,
    primitive: usize,
    material: u32,
    geometry: Option<Geometry<'a>>,
}

#[derive(Debug)]
struct Geometry<'a> {
    mode: Mode,
    positions: Elements<'a>,
    normals: Option<Elements<'a>>,
    uvs: Uvs<'a>,
    colours: Option<Elements<'a>>,
    indices: Option<Elements<'a>>,
    targets: Vec<Target<'a>>,
    /// Joints and weights, in sets of four.
    influences: Vec<(Elements<'a>, Elements<'a>)>,
}

/// A morph target.
#[derive(Debug)]
struct Target<'a> {
    positions: Option<Elements<'a>>,
    normals: Option<Elements<'a>>,
}

/// What the shapes of a mesh need besides its own attributes.
#[derive(Debug, Default, Clone, Copy)]
struct Needs {
    targets: bool,
    joints: bool,
}

/// Where the base colour texture's coordinates come from.
#[derive(Debug)]
enum Uvs<'a> {
    /// No texture, no coordinates.
    None,
    /// A texture, but no coordinates: all (0, 0), as GPUs read an absent attribute.
    Absent,
    /// As stored.
    Stored(Elements<'a>),
    /// Transformed (`KHR_texture_transform`).
    Moved(Elements<'a>, Affine2),
}

/// Checked plans of all primitives of a document.
#[derive(Debug)]
pub(super) struct Plans<'a> {
    plans: Vec<Plan<'a>>,
    names: Vec<String>,
    /// Triangles per shape.
    pub(super) triangles: Vec<u64>,
}

/// What decoding changed or left out, counted over all primitives.
#[derive(Debug, Default, Clone, Copy)]
pub(super) struct Changes {
    /// Primitives of points or lines, or without positions.
    pub(super) without_surface: usize,
    /// Primitives that got flat normals.
    pub(super) without_normals: usize,
    /// Vertices whose stored normal had no length or was not finite.
    pub(super) normals_repaired: usize,
    /// Texture coordinates that are not finite.
    pub(super) uvs_placed: usize,
    /// Triangles with a corner that is not finite.
    pub(super) unplaced: usize,
    /// Vertices at the end of lists that are no whole triangle.
    pub(super) left_over: usize,
    /// Primitives with a textured material and no texture coordinates.
    pub(super) without_uvs: usize,
    /// Vertices whose colour left [0, 1].
    pub(super) colours_clamped: usize,
    /// Vertices whose colour had an alpha below 1.
    pub(super) colour_alpha: usize,
}

/// Checks all primitives and adds up their sizes.
pub(super) fn plan<'a>(
    root: &Root,
    data: &'a Data<'_>,
    materials: &MaterialPlan,
    shapes: &[Shape],
    limits: &Limits,
    changes: &mut Changes,
) -> Result<Plans<'a>, Fault> {
    let mut out = Plans { plans: Vec::new(), names: Vec::new(), triangles: Vec::new() };
    let mut needs = vec![Needs::default(); root.meshes.len()];
    for shape in shapes {
        let Some(deform) = &shape.deform else { continue };
        needs[shape.mesh].targets |= !deform.weights().is_empty();
        needs[shape.mesh].joints |= matches!(deform, Deform::Skin { .. });
    }
    let mut copies = vec![0u64; root.meshes.len()];
    shapes.iter().for_each(|s| copies[s.mesh] += 1);
    let (mut all_vertices, mut all_triangles) = (0u64, 0u64);
    for (m, mesh) in root.meshes.iter().enumerate() {
        let mut mesh_triangles = 0;
        for (p, primitive) in mesh.primitives.iter().enumerate() {
            let place = format!("mesh {m}, primitive {p}");
            let material = materials.of_primitive(primitive.material.map(|i| i.value()), &place)?;
            let from = Source { data, mesh: m, primitive: p, material, needs: needs[m] };
            let geometry = plan_geometry(primitive, &from, materials, limits).map_err(|f| f.within(&place))?;
            if let Some(g) = &geometry {
                let (triangles, left_over) = g.triangles();
                changes.left_over += left_over;
                changes.without_normals += usize::from(g.normals.is_none());
                changes.without_uvs += usize::from(matches!(g.uvs, Uvs::Absent));
                let mut vertices = g.positions.count as u64;
                if g.normals.is_none() {
                    vertices += 3 * triangles;
                }
                all_vertices = all_vertices.saturating_add(vertices.saturating_mul(copies[m]));
                mesh_triangles += triangles;
                all_triangles = all_triangles.saturating_add(triangles.saturating_mul(copies[m]));
                if all_vertices > limits.vertices {
                    return Err(Fault::too_large(
                        place,
                        "or more vertices in all meshes",
                        all_vertices,
                        limits.vertices,
                    ));
                }
                if all_triangles > limits.unique_triangles {
                    return Err(Fault::too_large(
                        place,
                        "or more triangles in all meshes",
                        all_triangles,
                        limits.unique_triangles,
                    ));
                }
            } else {
                changes.without_surface += 1;
            }
            out.plans.push(Plan { mesh: m, primitive: p, material: material as u32, geometry });
        }
        let name = mesh.name.clone().unwrap_or_else(|| format!("mesh {m}"));
        out.names.push(name);
        out.triangles.push(mesh_triangles);
    }
    let of_copies = shapes.iter().skip(root.meshes.len()).map(|s| out.triangles[s.mesh]).collect::<Vec<_>>();
    out.triangles.extend(of_copies);
    Ok(out)
}

/// Which primitive is planned, and what for.
struct Source<'a, 'd> {
    data: &'a Data<'d>,
    mesh: usize,
    primitive: usize,
    material: usize,
    needs: Needs,
}

fn plan_geometry<'a>(
    primitive: &gltf::json::mesh::Primitive,
    from: &Source<'a, '_>,
    materials: &MaterialPlan,
    limits: &Limits,
) -> Result<Option<Geometry<'a>>, Fault> {
    let Checked::Valid(mode) = primitive.mode else {
        return Err(Fault::broken("mode", "is none of glTF's"));
    };
    let data = from.data;
    let draco = data.draco(from.mesh, from.primitive);
    let named = |semantic: &Semantic| primitive.attributes.get(&Checked::Valid(semantic.clone())).map(|i| i.value());
    if named(&Semantic::Positions).is_none() {
        return Ok(None);
    }
    if matches!(mode, Mode::Points | Mode::Lines | Mode::LineLoop | Mode::LineStrip) {
        return Ok(None);
    }
    let attribute = |semantic: Semantic, usage: &Use| -> Result<Option<Elements<'a>>, Fault> {
        let Some(index) = named(&semantic) else { return Ok(None) };
        if let Some(mesh) = draco
            && let Some(elements) = Data::draco_elements(mesh, &compressed::name_of(&semantic), index, usage)?
        {
            return Ok(Some(elements));
        }
        data.elements(index, usage, limits.vertices).map(Some)
    };
    let Some(positions) = attribute(Semantic::Positions, &POSITIONS)? else { return Ok(None) };
    let vertices = positions.count;
    let as_many = |e: Elements<'a>| match e.count == vertices {
        true => Ok(e),
        false => {
            let problem = format!("{} elements, but accessor {} (positions) has {vertices}", e.count, positions.index);
            Err(Fault::broken(format!("accessor {}", e.index), problem))
        }
    };
    let per_vertex = |semantic: Semantic, usage: &Use| attribute(semantic, usage)?.map(as_many).transpose();
    let normals = per_vertex(Semantic::Normals, &NORMALS)?;
    let colours = per_vertex(Semantic::Colors(0), &COLOURS)?;
    let uvs = match materials.uv_source(from.material) {
        None => Uvs::None,
        Some(source) => match (per_vertex(Semantic::TexCoords(source.set), &UVS)?, source.transform) {
            (None, _) => Uvs::Absent,
            (Some(e), None) => Uvs::Stored(e),
            (Some(e), Some(transform)) => Uvs::Moved(e, transform),
        },
    };
    // A strip of n + 2 indices has n triangles, so three per triangle bound every mode.
    let indices = match (draco, &primitive.indices) {
        (Some(mesh), _) => Some(Data::draco_indices(mesh)),
        (None, None) => None,
        (None, Some(i)) => Some(data.elements(i.value(), &INDICES, 3 * limits.unique_triangles)?),
    };
    let mut targets = Vec::new();
    if from.needs.targets {
        for target in primitive.targets.iter().flatten() {
            let delta = |index: Option<gltf::json::Index<gltf::json::Accessor>>, usage: &Use| {
                index.map(|i| as_many(data.elements(i.value(), usage, limits.vertices)?)).transpose()
            };
            targets.push(Target {
                positions: delta(target.positions, &POSITIONS)?,
                normals: delta(target.normals, &NORMALS)?,
            });
        }
    }
    let mut influences = Vec::new();
    if from.needs.joints {
        for set in 0..MOST_JOINT_SETS {
            let joints = per_vertex(Semantic::Joints(set), &JOINTS)?;
            let Some(pair) = joints.zip(per_vertex(Semantic::Weights(set), &WEIGHTS)?) else { break };
            influences.push(pair);
        }
    }
    // What Draco holds are triangles whatever the mode says.
    let mode = if draco.is_some() { Mode::Triangles } else { mode };
    Ok(Some(Geometry { mode, positions, normals, uvs, colours, indices, targets, influences }))
}

/// Sets of four joints that move a vertex: no writer has more than two.
const MOST_JOINT_SETS: u32 = 4;

impl Geometry<'_> {
    /// Triangles once unrolled, and vertices that are left over.
    fn triangles(&self) -> (u64, usize) {
        let n = self.indices.as_ref().map_or(self.positions.count, |i| i.count);
        match self.mode {
            Mode::Triangles => (n as u64 / 3, n % 3),
            _ if n >= 3 => (n as u64 - 2, 0),
            _ => (0, n),
        }
    }

    fn decode(&self, deform: Option<&Deform>) -> Result<(Primitive, Changes), Fault> {
        let mut changes = Changes::default();
        let vertices = self.positions.count;
        let corners = match &self.indices {
            Some(indices) => indices.indices(vertices)?,
            None => (0..vertices as u32).collect(),
        };
        let mut out = Primitive {
            positions: self.positions.vectors(Vec3::from_array),
            normals: self.normals.as_ref().map(|e| e.vectors(Vec3::from_array)).unwrap_or_default(),
            triangles: unroll(self.mode, corners),
            uvs: match &self.uvs {
                Uvs::None => Vec::new(),
                Uvs::Absent => vec![Vec2::ZERO; vertices],
                Uvs::Stored(e) => e.vectors(Vec2::from_array),
                Uvs::Moved(e, transform) => e.vectors(|uv| transform.transform_point2(Vec2::from_array(uv))),
            },
            ..Primitive::default()
        };
        if let Some(deform) = deform {
            self.deform(&mut out, deform)?;
        }
        changes.uvs_placed = repair::place_uvs(&mut out.uvs);
        if let Some(colours) = &self.colours {
            let with_alpha = match colours.width {
                3 => colours.vectors(|[r, g, b]| [r, g, b, 1.0]),
                _ => colours.vectors(|c: [f32; 4]| c),
            };
            changes.colour_alpha = with_alpha.iter().filter(|c| c[3] < 1.0).count();
            changes.colours_clamped =
                with_alpha.iter().filter(|c| !c[..3].iter().all(|x| (0.0..=1.0).contains(x))).count();
            out.colours = with_alpha.into_iter().map(|[r, g, b, _]| repair::clamp_colour([r, g, b])).collect();
        }
        changes.unplaced = repair::drop_unplaced(&mut out).triangles;
        match &self.normals {
            Some(_) => changes.normals_repaired = normals::repair(&mut out),
            None => normals::flatten(&mut out),
        }
        Ok((out, changes))
    }

    /// Moves the vertices of a shape.
    fn deform(&self, out: &mut Primitive, deform: &Deform) -> Result<(), Fault> {
        let add = |to: &mut [Vec3], delta: &Option<Elements<'_>>, weight: f32| {
            let deltas = delta.as_ref().map(|e| e.vectors(Vec3::from_array)).unwrap_or_default();
            to.iter_mut().zip(deltas).for_each(|(to, delta)| *to += delta * weight);
        };
        for (target, &weight) in self.targets.iter().zip(deform.weights()).filter(|(_, w)| **w != 0.0) {
            add(&mut out.positions, &target.positions, weight);
            add(&mut out.normals, &target.normals, weight);
        }
        let Deform::Skin { joints, origin, .. } = deform else { return Ok(()) };
        let influences: Influences =
            self.influences.iter().map(|(j, w)| (j.vectors(|v| v), w.vectors(|v| v))).collect();
        if shapes::pose(&mut out.positions, &mut out.normals, &influences, joints, *origin)? {
            out.triangles.iter_mut().for_each(|t| t.swap(1, 2));
        }
        Ok(())
    }
}

/// Triangles of a list, strip or fan, wound as glTF 2.0 section 3.7.2.1 says.
fn unroll(mode: Mode, v: Vec<u32>) -> Vec<[u32; 3]> {
    match mode {
        Mode::TriangleStrip => {
            (0..v.len().saturating_sub(2)).map(|i| [v[i], v[i + 1 + i % 2], v[i + 2 - i % 2]]).collect()
        }
        Mode::TriangleFan => (0..v.len().saturating_sub(2)).map(|i| [v[i + 1], v[i + 2], v[0]]).collect(),
        _ => v.as_chunks::<3>().0.to_vec(),
    }
}

impl Plans<'_> {
    /// Decodes all primitives of all shapes.
    pub(super) fn decode(self, shapes: &[Shape], changes: &mut Changes) -> Result<Vec<Mesh>, Fault> {
        let Self { plans, names, .. } = self;
        let mut first_of = vec![0; names.len() + 1];
        plans.iter().for_each(|p| first_of[p.mesh + 1] += 1);
        (0..names.len()).for_each(|m| first_of[m + 1] += first_of[m]);
        let plans_of = |shape: &Shape| &plans[first_of[shape.mesh]..first_of[shape.mesh + 1]];
        let jobs: Vec<(&Shape, &Plan<'_>)> =
            shapes.iter().flat_map(|shape| plans_of(shape).iter().map(move |plan| (shape, plan))).collect();
        let decode = |(shape, plan): &(&Shape, &Plan<'_>)| match &plan.geometry {
            Some(geometry) => geometry
                .decode(shape.deform.as_ref())
                .map_err(|f| f.within(format!("mesh {}, primitive {}", plan.mesh, plan.primitive))),
            None => Ok(Default::default()),
        };
        let decoded: Vec<Result<(Primitive, Changes), Fault>> = jobs.par_iter().map(decode).collect();
        let mut decoded = jobs.iter().zip(decoded);
        let mut meshes = Vec::with_capacity(shapes.len());
        for shape in shapes {
            let count = plans_of(shape).len();
            let mut mesh = Mesh { name: names[shape.mesh].clone(), primitives: Vec::with_capacity(count) };
            for ((_, plan), result) in decoded.by_ref().take(count) {
                let (primitive, change) = result?;
                changes.normals_repaired += change.normals_repaired;
                changes.uvs_placed += change.uvs_placed;
                changes.unplaced += change.unplaced;
                changes.colours_clamped += change.colours_clamped;
                changes.colour_alpha += change.colour_alpha;
                mesh.primitives.push(Primitive { material: plan.material, ..primitive });
            }
            meshes.push(mesh);
        }
        Ok(meshes)
    }
}
