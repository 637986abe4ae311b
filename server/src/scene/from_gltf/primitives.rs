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
use super::accessors::{COLOURS, Data, Elements, INDICES, NORMALS, POSITIONS, UVS};
use super::materials::MaterialPlan;

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
    meshes: Vec<Mesh>,
    /// Triangles per mesh.
    pub(super) triangles: Vec<u64>,
}

/// What decoding changed or left out, counted over all primitives.
#[derive(Debug, Default, Clone, Copy)]
pub(super) struct Changes {
    /// Primitives of points or lines, or without positions.
    pub(super) without_surface: usize,
    /// Primitives that got flat normals.
    pub(super) without_normals: usize,
    /// Vertices whose stored normal had no length.
    pub(super) normals_repaired: usize,
    /// Primitives with a textured material and no texture coordinates.
    pub(super) without_uvs: usize,
    /// Vertices whose colour left [0, 1].
    pub(super) colours_clamped: usize,
    /// Vertices whose colour had an alpha below 1.
    pub(super) colour_alpha: usize,
    /// Primitives with morph targets.
    pub(super) morphs: usize,
}

/// Checks all primitives and adds up their sizes.
pub(super) fn plan<'a>(
    root: &Root,
    data: &'a Data<'_>,
    materials: &MaterialPlan,
    limits: &Limits,
    changes: &mut Changes,
) -> Result<Plans<'a>, Fault> {
    let mut out = Plans { plans: Vec::new(), meshes: Vec::new(), triangles: Vec::new() };
    let (mut all_vertices, mut all_triangles) = (0u64, 0u64);
    for (m, mesh) in root.meshes.iter().enumerate() {
        let mut mesh_triangles = 0;
        for (p, primitive) in mesh.primitives.iter().enumerate() {
            let place = format!("mesh {m}, primitive {p}");
            let material = materials.of_primitive(primitive.material.map(|i| i.value()), &place)?;
            let geometry = plan_geometry(primitive, data, materials, material, limits).map_err(|f| f.within(&place))?;
            changes.morphs += usize::from(primitive.targets.is_some());
            if let Some(g) = &geometry {
                let triangles = g.triangles().map_err(|f| f.within(&place))?;
                changes.without_normals += usize::from(g.normals.is_none());
                changes.without_uvs += usize::from(matches!(g.uvs, Uvs::Absent));
                all_vertices += g.positions.count as u64;
                if g.normals.is_none() {
                    all_vertices += 3 * triangles;
                }
                mesh_triangles += triangles;
                all_triangles += triangles;
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
        out.meshes.push(Mesh { name, primitives: Vec::with_capacity(mesh.primitives.len()) });
        out.triangles.push(mesh_triangles);
    }
    Ok(out)
}

fn plan_geometry<'a>(
    primitive: &gltf::json::mesh::Primitive,
    data: &'a Data<'_>,
    materials: &MaterialPlan,
    material: usize,
    limits: &Limits,
) -> Result<Option<Geometry<'a>>, Fault> {
    let Checked::Valid(mode) = primitive.mode else {
        return Err(Fault::broken("mode", "is none of glTF's"));
    };
    let attribute = |semantic| primitive.attributes.get(&Checked::Valid(semantic)).map(|i| i.value());
    let Some(positions) = attribute(Semantic::Positions) else { return Ok(None) };
    if matches!(mode, Mode::Points | Mode::Lines | Mode::LineLoop | Mode::LineStrip) {
        return Ok(None);
    }
    let positions = data.elements(positions, &POSITIONS, limits.vertices)?;
    let vertices = positions.count;
    let per_vertex = |index: Option<usize>, usage| match index {
        None => Ok(None),
        Some(i) => match data.elements(i, usage, limits.vertices)? {
            e if e.count == vertices => Ok(Some(e)),
            e => {
                let problem =
                    format!("{} elements, but accessor {} (positions) has {vertices}", e.count, positions.index);
                Err(Fault::broken(format!("accessor {i}"), problem))
            }
        },
    };
    let normals = per_vertex(attribute(Semantic::Normals), &NORMALS)?;
    let colours = per_vertex(attribute(Semantic::Colors(0)), &COLOURS)?;
    let uvs = match materials.uv_source(material) {
        None => Uvs::None,
        Some(source) => match (per_vertex(attribute(Semantic::TexCoords(source.set)), &UVS)?, source.transform) {
            (None, _) => Uvs::Absent,
            (Some(e), None) => Uvs::Stored(e),
            (Some(e), Some(transform)) => Uvs::Moved(e, transform),
        },
    };
    // A strip of n + 2 indices has n triangles, so three per triangle bound every mode.
    let indices = match &primitive.indices {
        None => None,
        Some(i) => Some(data.elements(i.value(), &INDICES, 3 * limits.unique_triangles)?),
    };
    Ok(Some(Geometry { mode, positions, normals, uvs, colours, indices }))
}

impl Geometry<'_> {
    /// Triangles once unrolled.
    fn triangles(&self) -> Result<u64, Fault> {
        let n = self.indices.as_ref().map_or(self.positions.count, |i| i.count) as u64;
        match self.mode {
            Mode::Triangles if n.is_multiple_of(3) => Ok(n / 3),
            Mode::Triangles => Err(Fault::broken("indices", format!("{n} vertices are no whole number of triangles"))),
            _ if n == 0 => Ok(0),
            _ if n >= 3 => Ok(n - 2),
            _ => Err(Fault::broken("indices", format!("{n} vertices are too few for a strip or fan"))),
        }
    }

    fn decode(&self) -> Result<(Primitive, Changes), Fault> {
        let mut changes = Changes::default();
        let vertices = self.positions.count;
        let corners = match &self.indices {
            Some(indices) => indices.indices(vertices)?,
            None => (0..vertices as u32).collect(),
        };
        let mut out = Primitive {
            positions: self.positions.vectors(Vec3::from_array)?,
            triangles: unroll(self.mode, corners),
            uvs: match &self.uvs {
                Uvs::None => Vec::new(),
                Uvs::Absent => vec![Vec2::ZERO; vertices],
                Uvs::Stored(e) => e.vectors(Vec2::from_array)?,
                Uvs::Moved(e, transform) => e.vectors(|uv| transform.transform_point2(Vec2::from_array(uv)))?,
            },
            ..Primitive::default()
        };
        if let Some(uv) = out.uvs.iter().position(|uv| !uv.is_finite()) {
            return Err(Fault::broken(format!("texture coordinate {uv}"), "leaves the range of f32 once transformed"));
        }
        if let Some(colours) = &self.colours {
            let with_alpha = match colours.width {
                3 => colours.vectors(|[r, g, b]| [r, g, b, 1.0])?,
                _ => colours.vectors(|c: [f32; 4]| c)?,
            };
            changes.colour_alpha = with_alpha.iter().filter(|c| c[3] < 1.0).count();
            changes.colours_clamped =
                with_alpha.iter().filter(|c| !c[..3].iter().all(|x| (0.0..=1.0).contains(x))).count();
            out.colours = with_alpha.into_iter().map(|[r, g, b, _]| [r, g, b].map(|x| x.clamp(0.0, 1.0))).collect();
        }
        match &self.normals {
            Some(stored) => {
                out.normals = stored.vectors(Vec3::from_array)?;
                changes.normals_repaired = normals::repair(&mut out);
            }
            None => normals::flatten(&mut out),
        }
        Ok((out, changes))
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
    /// Decodes all primitives.
    pub(super) fn decode(self, changes: &mut Changes) -> Result<Vec<Mesh>, Fault> {
        let Self { plans, mut meshes, .. } = self;
        let decode = |plan: &Plan<'_>| match &plan.geometry {
            Some(geometry) => {
                geometry.decode().map_err(|f| f.within(format!("mesh {}, primitive {}", plan.mesh, plan.primitive)))
            }
            None => Ok(Default::default()),
        };
        let decoded: Vec<Result<(Primitive, Changes), Fault>> = plans.par_iter().map(decode).collect();
        for (plan, result) in plans.iter().zip(decoded) {
            let (primitive, change) = result?;
            changes.normals_repaired += change.normals_repaired;
            changes.colours_clamped += change.colours_clamped;
            changes.colour_alpha += change.colour_alpha;
            meshes[plan.mesh].primitives.push(Primitive { material: plan.material, ..primitive });
        }
        Ok(meshes)
    }
}
