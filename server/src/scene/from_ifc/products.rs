//! Products of an IFC file as meshes and instances.
//!
//! In: batches of triangulated shapes, one per item of a product's body, in a frame near the
//! geometry. Out: a mesh per shape in the item's own coordinates, where the reader knows them, so
//! that products which place the same item share it; else in coordinates about the shape's origin.
//! A shape is shared only after its vertices were compared, since what is cut out of one product
//! need not be cut out of the next.

use std::collections::HashMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use glam::{DAffine3, DMat4, DVec3, Vec3};
use ifc_lite_core::IfcType;
use ifc_lite_processing::{FrameEvent, MeshData, MeshFrame, ProcessingSink};
use ldi_protocol::Aabb;
use ldi_protocol::mesh::{Alpha, Material};
use ldi_protocol::shade::linear_from_srgb;

use super::super::error::Fault;
use super::super::limits::Limits;
use super::super::model::{Instance, Mesh, Primitive, Scene, SceneElement, WHITE};
use super::super::normals;
use super::super::repair;
use super::rooms::{Volume, Volumes};

/// How far vertices of two products may lie apart for both to share a mesh, metres. Larger values
/// move details, smaller ones part what single precision rounded.
const SAME_M: f64 = 2.0e-4;
/// Shapes that are kept of one item for comparison: products that cut it differently.
const MOST_VARIANTS: usize = 8;
/// Alpha below which a transparent material is not there.
const TRANSPARENT: f32 = 0.5;
/// Smallest determinant of a placement that has a usable inverse.
const LEAST_DETERMINANT: f64 = 1.0e-12;

/// What the batches came to.
#[derive(Debug, Default)]
pub(super) struct Collected {
    pub(super) scene: Scene,
    pub(super) volumes: Volumes,
    /// Triangles with a corner that is not finite.
    pub(super) unplaced: u64,
    /// Meshes with a texture, which is not read.
    pub(super) textured: u64,
    /// Shapes of products that are no surfaces.
    pub(super) undrawn: u64,
}

/// What two shapes have in common if they may be one mesh.
type Alike = (u128, u32, usize, usize);

/// Collects shapes as they are triangulated.
#[derive(Debug)]
pub(super) struct Products {
    limits: Limits,
    stop: Arc<AtomicBool>,
    fault: Option<Fault>,
    /// The file's world from the frame of the shapes.
    frame: MeshFrame,
    out: Collected,
    /// Meshes that further products may share.
    shared: HashMap<Alike, Vec<u32>>,
    materials: HashMap<[u32; 4], u32>,
    /// Node numbers of products by their records.
    nodes: HashMap<u32, u32>,
    vertices: u64,
    unique_triangles: u64,
    expanded_triangles: u64,
}

impl ProcessingSink for Products {
    fn on_frame(&mut self, event: &FrameEvent) {
        self.frame = event.frame;
    }

    fn on_batch(&mut self, shapes: &[MeshData], _: usize, _: usize) {
        for shape in shapes {
            if self.fault.is_none()
                && let Err(fault) = self.take(shape)
            {
                self.fault = Some(fault);
                self.stop.store(true, Ordering::Relaxed);
            }
        }
    }
}

impl Products {
    pub(super) fn new(limits: &Limits) -> Self {
        Self {
            limits: *limits,
            stop: Arc::default(),
            fault: None,
            frame: MeshFrame::RawIfc,
            out: Collected::default(),
            shared: HashMap::new(),
            materials: HashMap::new(),
            nodes: HashMap::new(),
            vertices: 0,
            unique_triangles: 0,
            expanded_triangles: 0,
        }
    }

    /// The flag that ends reading between batches.
    pub(super) fn stop(&self) -> Arc<AtomicBool> {
        Arc::clone(&self.stop)
    }

    /// All products; the fault that ended reading, if one did.
    pub(super) fn collected(mut self) -> Result<Collected, Fault> {
        if let Some(fault) = self.fault {
            return Err(fault);
        }
        if self.out.scene.materials.is_empty() {
            self.out.scene.materials.push(WHITE);
        }
        Ok(self.out)
    }

    fn take(&mut self, shape: &MeshData) -> Result<(), Fault> {
        /// Shapes of types, which their products place; 0 and 3 are those of products.
        const OF_TYPES: [u8; 2] = [1, 2];
        if OF_TYPES.contains(&shape.geometry_class) || shape.is_empty() {
            return Ok(());
        }
        let class = IfcType::from_str(&shape.ifc_type.to_ascii_uppercase());
        let volumes = &mut self.out.volumes;
        if class.is_subtype_of(IfcType::IfcSpace) {
            add_volume(&mut volumes.spaces, self.frame, shape);
        } else if class.is_subtype_of(IfcType::IfcOpeningElement) {
            add_volume(&mut volumes.openings, self.frame, shape);
        } else if class.is_subtype_of(IfcType::IfcDoor) || class.is_subtype_of(IfcType::IfcWindow) {
            add_volume(&mut volumes.fillings, self.frame, shape);
        }
        if !is_drawn(&class) {
            self.out.undrawn += 1;
            return Ok(());
        }
        self.out.textured += u64::from(shape.texture.is_some());
        self.draw(shape)
    }

    fn draw(&mut self, shape: &MeshData) -> Result<(), Fault> {
        let place = || format!("#{} {}", shape.express_id, shape.ifc_type);
        let (limits, triangles) = (self.limits, shape.indices.len() as u64 / 3);
        self.expanded_triangles += triangles;
        if self.expanded_triangles > limits.expanded_triangles {
            let most = limits.expanded_triangles;
            return Err(Fault::too_large(place(), "or more triangles", self.expanded_triangles, most));
        }
        if self.out.scene.instances.len() as u64 >= limits.instances {
            let found = self.out.scene.instances.len() + 1;
            return Err(Fault::too_large(place(), "or more shapes", found, limits.instances));
        }
        let material = self.material(shape.color);
        let own = placement(shape).filter(|p| p.matrix3.determinant().abs() > LEAST_DETERMINANT);
        let alike = shape
            .instance
            .as_ref()
            .filter(|_| own.is_some())
            .map(|i| (i.rep_identity, material, shape.positions.len(), shape.indices.len()));
        let world_from_mesh = own.unwrap_or_else(|| self.world_from_shape(shape));
        let mesh = match alike.and_then(|key| self.find(&key, shape, &world_from_mesh)) {
            Some(mesh) => mesh,
            None => {
                self.vertices += shape.positions.len() as u64 / 3;
                self.unique_triangles += triangles;
                if self.vertices > limits.vertices {
                    return Err(Fault::too_large(place(), "or more vertices", self.vertices, limits.vertices));
                }
                if self.unique_triangles > limits.unique_triangles {
                    let (found, most) = (self.unique_triangles, limits.unique_triangles);
                    return Err(Fault::too_large(place(), "or more triangles", found, most));
                }
                let primitive = self.primitive(shape, material, own.as_ref());
                if primitive.triangles.is_empty() {
                    return Ok(());
                }
                let mesh = self.out.scene.meshes.len() as u32;
                let name = format!("#{} {}", shape.express_id, shape.ifc_type);
                self.out.scene.meshes.push(Mesh { name, primitives: vec![primitive] });
                if let Some(key) = alike {
                    self.shared.entry(key).or_default().push(mesh);
                }
                mesh
            }
        };
        let node = self.node(shape);
        self.out.scene.instances.push(Instance { node, mesh, world_from_mesh });
        Ok(())
    }

    /// A mesh that looks like the shape where it is placed.
    fn find(&self, key: &Alike, shape: &MeshData, world_from_mesh: &DAffine3) -> Option<u32> {
        let variants = self.shared.get(key)?;
        let fits = |mesh: u32| {
            let there = &self.out.scene.meshes[mesh as usize].primitives[0];
            let corners = there.triangles.as_flattened();
            let same = |(at, p): (usize, &Vec3)| {
                let placed = world_from_mesh.transform_point3(p.as_dvec3());
                placed.distance_squared(self.world(shape, at)) <= SAME_M * SAME_M
            };
            corners == &shape.indices[..] && there.positions.iter().enumerate().all(same)
        };
        variants.iter().take(MOST_VARIANTS).copied().find(|m| fits(*m))
    }

    /// Vertex of a shape in the file's world.
    fn world(&self, shape: &MeshData, vertex: usize) -> DVec3 {
        let at = |k: usize| shape.origin[k] + f64::from(shape.positions[3 * vertex + k]);
        DVec3::from(self.frame.to_world([at(0), at(1), at(2)]))
    }

    /// The file's world from the shape's positions about its origin.
    fn world_from_shape(&self, shape: &MeshData) -> DAffine3 {
        let [x, y, z] = [DVec3::X, DVec3::Y, DVec3::Z].map(|v| self.frame.rotate_out_of_frame(v.into()).into());
        let origin = DVec3::from(self.frame.to_world(shape.origin));
        DAffine3::from_cols(x, y, z, origin)
    }

    /// The shape in its own coordinates, or about its origin.
    fn primitive(&mut self, shape: &MeshData, material: u32, own: Option<&DAffine3>) -> Primitive {
        let vectors = |values: &[f32]| values.as_chunks::<3>().0.iter().map(|v| Vec3::from(*v)).collect::<Vec<_>>();
        let (positions, normals) = match own {
            None => (vectors(&shape.positions), vectors(&shape.normals)),
            Some(world_from_item) => {
                let item_from_world = world_from_item.inverse();
                let count = shape.positions.len() / 3;
                let positions =
                    (0..count).map(|v| item_from_world.transform_point3(self.world(shape, v)).as_vec3()).collect();
                // Normals go by the inverse of the transpose, and its inverse is the transpose.
                let turn = world_from_item.matrix3.transpose();
                let normal = |n: Vec3| {
                    let world = DVec3::from(self.frame.rotate_out_of_frame(n.as_dvec3().into()));
                    (turn * world).normalize_or_zero().as_vec3()
                };
                (positions, vectors(&shape.normals).into_iter().map(normal).collect())
            }
        };
        let count = positions.len() as u32;
        let triangles = shape.indices.as_chunks::<3>().0.iter().copied();
        let triangles = triangles.filter(|t| t.iter().all(|v| *v < count)).collect();
        let mut out = Primitive { material, positions, normals, triangles, ..Primitive::default() };
        out.normals.resize(count as usize, Vec3::ZERO);
        self.out.unplaced += repair::drop_unplaced(&mut out).triangles as u64;
        normals::repair(&mut out);
        out
    }

    /// Position of a colour's material; colours are sRGB, as authoring tools write them.
    fn material(&mut self, colour: [f32; 4]) -> u32 {
        let [r, g, b, a] = colour.map(|c| if c.is_nan() { 1.0 } else { c.clamp(0.0, 1.0) });
        let materials = &mut self.out.scene.materials;
        *self.materials.entry([r, g, b, a].map(f32::to_bits)).or_insert_with(|| {
            let [r, g, b] = [r, g, b].map(linear_from_srgb);
            let alpha = if a < 1.0 { Alpha::Mask(TRANSPARENT) } else { Alpha::Opaque };
            materials.push(Material { base_colour: [r, g, b, a], alpha, ..WHITE });
            materials.len() as u32 - 1
        })
    }

    /// Number of the product's node; what it is is noted at its first shape.
    fn node(&mut self, shape: &MeshData) -> u32 {
        let elements = &mut self.out.scene.elements;
        *self.nodes.entry(shape.express_id).or_insert_with(|| {
            let node = elements.len() as u32;
            let text = |t: &Option<String>| t.clone().unwrap_or_default();
            let (name, guid) = (text(&shape.name), text(&shape.global_id));
            elements.push(SceneElement { node, class: shape.ifc_type.clone(), name, guid });
            node
        })
    }
}

/// World from the coordinates of the item that a shape shows, where it is placed whole.
fn placement(shape: &MeshData) -> Option<DAffine3> {
    let meta = shape.instance.as_ref().filter(|i| i.instanceable)?;
    let rows = |m: &[f64; 16]| DMat4::from_cols_array(m).transpose();
    let inner = [meta.local_transform.as_ref(), meta.canonical_transform.as_ref()];
    let matrix = inner.into_iter().flatten().fold(rows(&meta.transform), |m, inner| m * rows(inner));
    matrix.is_finite().then(|| DAffine3::from_mat4(matrix))
}

/// Whether a class is made of surfaces that people see.
fn is_drawn(class: &IfcType) -> bool {
    const UNDRAWN: [IfcType; 9] = [
        IfcType::IfcFeatureElement,
        IfcType::IfcVirtualElement,
        IfcType::IfcAnnotation,
        IfcType::IfcGrid,
        IfcType::IfcPositioningElement,
        IfcType::IfcPort,
        IfcType::IfcStructuralItem,
        IfcType::IfcStructuralActivity,
        IfcType::IfcSpatialElement,
    ];
    /// Spatial elements with surfaces: terrain.
    const GROUNDS: [IfcType; 2] = [IfcType::IfcSite, IfcType::IfcBuilding];
    let is = |kinds: &[IfcType]| kinds.iter().any(|k| class.is_subtype_of(k.clone()));
    is(&GROUNDS) || !is(&UNDRAWN)
}

/// Adds a shape to the volume of its product.
fn add_volume(volumes: &mut Vec<Volume>, frame: MeshFrame, shape: &MeshData) {
    let world = |v: u32| -> Option<DVec3> {
        let p = shape.positions.get(3 * v as usize..3 * v as usize + 3)?;
        let at = |k: usize| shape.origin[k] + f64::from(p[k]);
        Some(DVec3::from(frame.to_world([at(0), at(1), at(2)]))).filter(|p| p.is_finite())
    };
    let corners =
        shape.indices.as_chunks::<3>().0.iter().filter_map(|&[a, b, c]| Some([world(a)?, world(b)?, world(c)?]));
    let (mut bounds, mut cubic_m, mut first) = (Aabb::EMPTY, 0.0, None);
    for [a, b, c] in corners {
        // About a corner of its own, so that far-off volumes keep their digits.
        let o = *first.get_or_insert(a);
        cubic_m += (a - o).dot((b - o).cross(c - o)) / 6.0;
        bounds = [a, b, c].into_iter().fold(bounds, |bounds, p| bounds.grown_to(p));
    }
    match volumes.last_mut().filter(|v| v.record == shape.express_id) {
        Some(there) => {
            there.bounds = Aabb::from_points(bounds.corners().into_iter().chain(there.bounds.corners()));
            there.cubic_m += cubic_m.abs();
        }
        None => {
            let name = [&shape.name, &shape.global_id].into_iter().flatten().find(|n| !n.trim().is_empty());
            let name = name.cloned().unwrap_or_else(|| format!("#{}", shape.express_id));
            volumes.push(Volume { record: shape.express_id, name, bounds, cubic_m: cubic_m.abs() });
        }
    }
}
