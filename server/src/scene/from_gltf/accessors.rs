//! Buffers, buffer views and accessors (glTF 2.0 section 3.6): typed arrays inside bytes.
//!
//! An accessor is checked once, when it becomes [`Elements`]: its type, and that its last byte
//! lies inside its view and its view inside its buffer, in checked 64-bit arithmetic. Since every
//! element then has bytes of its own in the file (strides are at least the element's size), a
//! forged count cannot ask for more memory than a small multiple of the file; only accessors
//! without a view, whose elements are zeros, can, and of those there may be [`MOST_ZEROS`].
//!
//! A buffer that cannot be read is a fault of what uses it. Compressed views and primitives are
//! decoded when the file has no plain bytes for them.

use std::borrow::Cow;
use std::collections::HashMap;
use std::sync::atomic::{AtomicU64, Ordering};

use gltf::json::Root;
use gltf::json::accessor::{ComponentType, Type};
use gltf::json::mesh::Semantic;
use gltf::json::validation::Checked;
use rayon::prelude::*;

use super::super::error::Fault;
use super::super::files::Files;
use super::super::limits::Limits;
use super::compressed::{self, DracoMesh};
use super::extensions::{Additions, Draco};

/// Elements of all accessors without bytes in the file, 12 bytes each.
const MOST_ZEROS: u64 = 4 << 20;

/// What an accessor is used for, and so what it may hold.
#[derive(Debug)]
pub(super) struct Use {
    what: &'static str,
    types: &'static [Type],
    components: &'static [ComponentType],
    /// Integers mean fractions of their largest value even if the accessor does not say so.
    fractions: bool,
}

/// Floats, and with `KHR_mesh_quantization` small integers (read whether or not the file declares
/// the extension).
const REAL: &[ComponentType] =
    &[ComponentType::F32, ComponentType::I8, ComponentType::U8, ComponentType::I16, ComponentType::U16];
/// Vertex positions.
pub(super) const POSITIONS: Use = Use { what: "positions", types: &[Type::Vec3], components: REAL, fractions: false };
/// Vertex normals.
pub(super) const NORMALS: Use = Use { what: "normals", types: &[Type::Vec3], components: REAL, fractions: false };
/// Texture coordinates.
pub(super) const UVS: Use =
    Use { what: "texture coordinates", types: &[Type::Vec2], components: REAL, fractions: false };
/// Vertex colours.
pub(super) const COLOURS: Use = Use {
    what: "colours",
    types: &[Type::Vec3, Type::Vec4],
    components: &[ComponentType::F32, ComponentType::U8, ComponentType::U16],
    fractions: true,
};
/// Vertex numbers.
pub(super) const INDICES: Use = Use {
    what: "indices",
    types: &[Type::Scalar],
    components: &[ComponentType::U8, ComponentType::U16, ComponentType::U32],
    fractions: false,
};

/// Joints that move a vertex, by their positions in the skin.
pub(super) const JOINTS: Use = Use {
    what: "joints",
    types: &[Type::Vec4],
    components: &[ComponentType::U8, ComponentType::U16, ComponentType::F32],
    fractions: false,
};
/// How much each joint moves a vertex.
pub(super) const WEIGHTS: Use = Use {
    what: "weights",
    types: &[Type::Vec4],
    components: &[ComponentType::F32, ComponentType::U8, ComponentType::U16],
    fractions: true,
};
/// Placements of joints when a mesh was bound to them, inverted.
pub(super) const MATRICES: Use =
    Use { what: "matrices", types: &[Type::Mat4], components: &[ComponentType::F32], fractions: false };
/// Translations or scales of instances.
pub(super) const VECTORS: Use =
    Use { what: "translations or scales", types: &[Type::Vec3], components: REAL, fractions: false };
/// Rotations of instances, as quaternions.
pub(super) const ROTATIONS: Use = Use {
    what: "rotations",
    types: &[Type::Vec4],
    components: &[ComponentType::F32, ComponentType::I8, ComponentType::I16],
    fractions: true,
};

/// The document and the bytes of its buffers.
#[derive(Debug)]
pub(super) struct Data<'a> {
    root: &'a Root,
    buffers: Vec<Result<Cow<'a, [u8]>, Fault>>,
    /// Decoded views by number.
    views: HashMap<usize, Result<Vec<u8>, Fault>>,
    strides: HashMap<usize, usize>,
    /// Decoded primitives by the numbers of mesh and primitive.
    draco: HashMap<(usize, usize), DracoMesh>,
    /// Elements of accessors without bytes so far.
    zeros: AtomicU64,
}

/// A checked accessor.
#[derive(Debug, Clone)]
pub(super) struct Elements<'a> {
    /// Position in the document's accessors.
    pub(super) index: usize,
    /// Number of elements.
    pub(super) count: usize,
    /// Components of an element.
    pub(super) width: usize,
    component: ComponentType,
    normalized: bool,
    dense: Option<Strided<'a>>,
    patch: Option<Patch<'a>>,
}

/// Equal pieces of bytes at equal distances.
#[derive(Debug, Clone, Copy)]
struct Strided<'a> {
    bytes: &'a [u8],
    stride: usize,
    size: usize,
    count: usize,
}

/// Elements that a sparse accessor replaces.
#[derive(Debug, Clone)]
struct Patch<'a> {
    indices: Strided<'a>,
    values: Strided<'a>,
}

impl<'a> Strided<'a> {
    fn iter(self) -> impl Iterator<Item = &'a [u8]> {
        (0..self.count).map(move |i| &self.bytes[i * self.stride..][..self.size])
    }
}

impl<'a> Data<'a> {
    /// Reads all buffers, and decodes what is compressed and has no plain bytes.
    pub(super) fn load(
        root: &'a Root,
        additions: &Additions,
        bin: Option<Cow<'a, [u8]>>,
        files: &mut Files,
        limits: &Limits,
    ) -> Result<Self, Fault> {
        let mut bin = bin;
        let mut read = |(i, buffer): (usize, &gltf::json::Buffer)| {
            let place = format!("buffer {i}");
            let bytes = match &buffer.uri {
                Some(uri) => Cow::Owned(files.read_uri(uri, &place)?),
                None if i == 0 => {
                    bin.take().ok_or_else(|| Fault::broken(&place, "has no uri, and the file no BIN chunk"))?
                }
                None => return Err(Fault::broken(place, "has no uri; only buffer 0 may be the BIN chunk")),
            };
            let declared = buffer.byte_length.0;
            if declared > bytes.len() as u64 {
                return Err(Fault::broken(
                    place,
                    format!("byteLength is {declared}, but only {} bytes are there", bytes.len()),
                ));
            }
            Ok(bytes)
        };
        let buffers = root.buffers.iter().enumerate().map(&mut read).collect();
        let (views, strides, draco) = Default::default();
        let mut out = Self { root, buffers, views, strides, draco, zeros: AtomicU64::new(0) };
        out.decode_views(additions, limits)?;
        out.decode_primitives(additions, limits)?;
        Ok(out)
    }

    fn buffer(&self, buffer: usize) -> Result<&[u8], Fault> {
        match self.buffers.get(buffer) {
            Some(Ok(bytes)) => Ok(bytes),
            Some(Err(fault)) => Err(fault.clone()),
            None => Err(Fault::broken(format!("buffer {buffer}"), "does not exist")),
        }
    }

    /// Decodes views of meshoptimizer whose buffer has no bytes of its own.
    fn decode_views(&mut self, additions: &Additions, limits: &Limits) -> Result<(), Fault> {
        let mut packed = Vec::new();
        let mut sum = 0u64;
        for (i, view) in additions.buffer_views.iter().enumerate() {
            let Some(m) = view.meshopt() else { continue };
            let plain = self.root.buffer_views.get(i).map(|v| v.buffer.value());
            if plain.is_some_and(|b| matches!(self.buffers.get(b), Some(Ok(_)))) {
                continue;
            }
            sum = sum.saturating_add(m.count.saturating_mul(m.byte_stride));
            if sum > limits.file_bytes {
                return Err(Fault::too_large("bufferViews", "or more bytes once decoded", sum, limits.file_bytes));
            }
            packed.push((i, m));
        }
        let decode = |&(i, m): &(usize, &super::extensions::Meshopt)| {
            let place = format!("bufferView {i}");
            let end = m.byte_offset.checked_add(m.byte_length);
            let encoded = self.buffer(m.buffer).map_err(|f| f.within(&place)).and_then(|bytes| {
                end.filter(|end| *end <= bytes.len() as u64)
                    .map(|end| &bytes[m.byte_offset as usize..end as usize])
                    .ok_or_else(|| Fault::broken(&place, format!("its compressed bytes leave buffer {}", m.buffer)))
            });
            (i, encoded.and_then(|encoded| compressed::meshopt_view(m, encoded, &place)))
        };
        let views = packed.par_iter().map(decode).collect();
        self.strides = packed.iter().map(|(i, m)| (*i, m.byte_stride as usize)).collect();
        self.views = views;
        Ok(())
    }

    /// Decodes primitives of Draco whose accessors have no bytes.
    fn decode_primitives(&mut self, additions: &Additions, limits: &Limits) -> Result<(), Fault> {
        let mut packed: Vec<((usize, usize), &Draco)> = Vec::new();
        for (m, (mesh, added)) in self.root.meshes.iter().zip(&additions.meshes).enumerate() {
            for (p, (primitive, added)) in mesh.primitives.iter().zip(&added.primitives).enumerate() {
                let positions = primitive.attributes.get(&Checked::Valid(Semantic::Positions)).map(|i| i.value());
                let accessor = positions.and_then(|i| self.root.accessors.get(i));
                let has_bytes = accessor.is_some_and(|a| a.buffer_view.is_some());
                packed.extend(added.draco().filter(|_| !has_bytes).map(|d| ((m, p), d)));
            }
        }
        let vertices = AtomicU64::new(0);
        let decode = |&((m, p), draco): &((usize, usize), &Draco)| {
            let place = format!("mesh {m}, primitive {p}");
            let divisor = |name: &str| self.divisor(m, p, name);
            let encoded = self.view(draco.buffer_view, &place)?.0;
            let so_far = vertices.load(Ordering::Relaxed);
            if so_far > limits.vertices {
                return Err(Fault::too_large(place, "or more vertices in all meshes", so_far, limits.vertices));
            }
            let mesh = compressed::draco_mesh(draco, divisor, encoded, limits, &place)?;
            vertices.fetch_add(mesh.vertices as u64, Ordering::Relaxed);
            Ok(((m, p), mesh))
        };
        self.draco = packed.par_iter().map(decode).collect::<Result<_, Fault>>()?;
        Ok(())
    }

    /// What integers of a primitive's attribute are fractions of; 1 where they are themselves.
    fn divisor(&self, mesh: usize, primitive: usize, name: &str) -> f32 {
        let attributes = &self.root.meshes[mesh].primitives[primitive].attributes;
        let named = attributes.iter().find(|(semantic, _)| match semantic {
            Checked::Valid(semantic) => compressed::name_of(semantic) == name,
            Checked::Invalid => false,
        });
        let Some(accessor) = named.and_then(|(_, i)| self.root.accessors.get(i.value())) else { return 1.0 };
        let fractions = accessor.normalized || name.starts_with("COLOR_") || name.starts_with("WEIGHTS_");
        match accessor.component_type.as_ref() {
            Checked::Valid(component) if fractions => largest(component.0),
            _ => 1.0,
        }
    }

    /// A decoded primitive.
    pub(super) fn draco(&self, mesh: usize, primitive: usize) -> Option<&DracoMesh> {
        self.draco.get(&(mesh, primitive))
    }

    /// Bytes of a buffer view, and its stride.
    pub(super) fn view(&self, view: usize, place: &str) -> Result<(&[u8], Option<usize>), Fault> {
        let v = (self.root.buffer_views.get(view))
            .ok_or_else(|| Fault::broken(place, format!("bufferView {view} does not exist")))?;
        match self.views.get(&view) {
            Some(Ok(bytes)) => return Ok((bytes, self.strides.get(&view).copied())),
            Some(Err(fault)) => return Err(fault.clone().within(place)),
            None => {}
        }
        let fault = |problem: String| Fault::broken(format!("{place}, bufferView {view}"), problem);
        let buffer = v.buffer.value();
        let bytes = self.buffer(buffer).map_err(|f| f.within(format!("{place}, bufferView {view}")))?;
        // The declared length, not the real one, which padding may exceed.
        let available = self.root.buffers[buffer].byte_length.0;
        let (offset, length) = (v.byte_offset.map_or(0, |o| o.0), v.byte_length.0);
        if offset.checked_add(length).is_none_or(|end| end > available) {
            return Err(fault(format!("{length} bytes from {offset} on leave buffer {buffer} of {available} bytes")));
        }
        // The range was just found inside a slice, so it fits a usize.
        Ok((&bytes[offset as usize..][..length as usize], v.byte_stride.map(|s| s.0)))
    }

    fn strided(&self, view: usize, offset: u64, count: u64, size: usize, place: &str) -> Result<Strided<'_>, Fault> {
        let (bytes, stride) = self.view(view, place)?;
        // Some writers put 0 for no stride.
        let stride = stride.filter(|s| *s > 0).unwrap_or(size);
        if stride < size {
            return Err(Fault::broken(
                place,
                format!("byteStride {stride} is below the element size of {size} bytes, so elements overlap"),
            ));
        }
        let end = match count.checked_sub(1) {
            None => Some(offset),
            Some(last) => last.checked_mul(stride as u64).and_then(|b| b.checked_add(offset)?.checked_add(size as u64)),
        };
        if end.is_none_or(|end| end > bytes.len() as u64) {
            let problem = format!(
                "{count} elements of {size} bytes from {offset} on leave bufferView {view} of {} bytes",
                bytes.len()
            );
            return Err(Fault::broken(place, problem));
        }
        Ok(Strided { bytes: &bytes[offset as usize..], stride, size, count: count as usize })
    }

    /// Checks an accessor for a use; `count_limit` bounds its elements.
    pub(super) fn elements(&self, index: usize, usage: &Use, count_limit: u64) -> Result<Elements<'_>, Fault> {
        let what = usage.what;
        let place = format!("accessor {index} ({what})");
        let a = self.root.accessors.get(index).ok_or_else(|| Fault::broken(&place, "does not exist"))?;
        let (Checked::Valid(kind), Checked::Valid(component)) = (a.type_, a.component_type.as_ref()) else {
            return Err(Fault::broken(place, "type or componentType is none of glTF's"));
        };
        let component = component.0;
        if !usage.types.contains(&kind) || !usage.components.contains(&component) {
            return Err(Fault::broken(place, format!("{kind:?} of {component:?} cannot hold {what}")));
        }
        let count = a.count.0;
        if count > count_limit {
            return Err(Fault::too_large(place, "elements", count, count_limit));
        }
        let width = kind.multiplicity();
        let size = width * component.size();
        let dense = match a.buffer_view {
            Some(view) => Some(self.strided(view.value(), a.byte_offset.map_or(0, |o| o.0), count, size, &place)?),
            None => {
                let zeros = count.saturating_add(self.zeros.fetch_add(count, Ordering::Relaxed));
                if zeros > MOST_ZEROS {
                    return Err(Fault::too_large(place, "or more elements without bytes", zeros, MOST_ZEROS));
                }
                None
            }
        };
        let patch = match &a.sparse {
            Some(sparse) => Some(self.patch(sparse, count, size, &place)?),
            None => None,
        };
        let normalized = a.normalized || usage.fractions;
        Ok(Elements { index, count: count as usize, width, component, normalized, dense, patch })
    }

    /// An attribute of a decoded primitive.
    pub(super) fn draco_elements<'d>(
        mesh: &'d DracoMesh,
        name: &str,
        index: usize,
        usage: &Use,
    ) -> Result<Option<Elements<'d>>, Fault> {
        let Some((width, bytes)) = mesh.attributes.get(name) else { return Ok(None) };
        if !usage.types.iter().any(|t| t.multiplicity() == *width) {
            let problem = format!("{width} components cannot hold {}", usage.what);
            return Err(Fault::broken(format!("Draco attribute {name}"), problem));
        }
        Ok(Some(Elements::plain(index, mesh.vertices, *width, ComponentType::F32, bytes)))
    }

    /// The vertex numbers of a decoded primitive.
    pub(super) fn draco_indices(mesh: &DracoMesh) -> Elements<'_> {
        Elements::plain(0, mesh.indices.len() / 4, 1, ComponentType::U32, &mesh.indices)
    }

    fn patch(
        &self,
        sparse: &gltf::json::accessor::sparse::Sparse,
        count: u64,
        size: usize,
        place: &str,
    ) -> Result<Patch<'_>, Fault> {
        let n = sparse.count.0;
        if n > count {
            return Err(Fault::broken(place, format!("sparse replaces {n} of {count} elements")));
        }
        let Checked::Valid(index_type) = sparse.indices.component_type.as_ref() else {
            return Err(Fault::broken(place, "sparse indices have no integer component type"));
        };
        let place_of = |part: &str| format!("{place}, sparse {part}");
        let (i, v) = (&sparse.indices, &sparse.values);
        let indices =
            self.strided(i.buffer_view.value(), i.byte_offset.0, n, index_type.0.size(), &place_of("indices"))?;
        let values = self.strided(v.buffer_view.value(), v.byte_offset.0, n, size, &place_of("values"))?;
        let mut smallest = 0;
        for (k, bytes) in indices.iter().enumerate() {
            let at = unsigned(bytes);
            if u64::from(at) >= count || u64::from(at) < smallest {
                return Err(Fault::broken(
                    place_of("indices"),
                    format!("element {k} is {at}, out of range or not increasing"),
                ));
            }
            smallest = u64::from(at) + 1;
        }
        Ok(Patch { indices, values })
    }
}

/// A little-endian unsigned integer of one, two or four bytes.
fn unsigned(bytes: &[u8]) -> u32 {
    bytes.iter().rev().fold(0, |n, &b| (n << 8) | u32::from(b))
}

/// The number of which normalized integers are fractions.
fn largest(component: ComponentType) -> f32 {
    match component {
        ComponentType::I8 => 127.0,
        ComponentType::U8 => 255.0,
        ComponentType::I16 => 32_767.0,
        ComponentType::U16 => 65_535.0,
        ComponentType::U32 | ComponentType::F32 => 1.0,
    }
}

/// One component as a number (glTF 2.0 section 3.11 for normalized integers).
fn real(bytes: &[u8], component: ComponentType, normalized: bool) -> f32 {
    let value = match component {
        ComponentType::I8 => f32::from(bytes[0] as i8),
        ComponentType::U8 => f32::from(bytes[0]),
        ComponentType::I16 => f32::from(i16::from_le_bytes([bytes[0], bytes[1]])),
        ComponentType::U16 => f32::from(u16::from_le_bytes([bytes[0], bytes[1]])),
        ComponentType::U32 => unsigned(bytes) as f32,
        ComponentType::F32 => return f32::from_bits(unsigned(bytes)),
    };
    if normalized { (value / largest(component)).max(-1.0) } else { value }
}

impl<'a> Elements<'a> {
    /// Elements that lie one behind the other.
    fn plain(index: usize, count: usize, width: usize, component: ComponentType, bytes: &'a [u8]) -> Self {
        let size = width * component.size();
        let dense = Some(Strided { bytes, stride: size, size, count });
        Self { index, count, width, component, normalized: false, dense, patch: None }
    }

    /// What messages call this accessor.
    fn place(&self, element: usize) -> String {
        format!("accessor {}, element {element}", self.index)
    }

    /// All elements as vectors of `N` numbers, `N` being [`Self::width`], each passed through `f`.
    /// Numbers that are not finite are for the caller to mend.
    pub(super) fn vectors<const N: usize, T>(&self, f: impl Fn([f32; N]) -> T) -> Vec<T> {
        let vector = |bytes: &[u8]| -> [f32; N] {
            let size = self.component.size();
            std::array::from_fn(|k| real(&bytes[k * size..][..size], self.component, self.normalized))
        };
        let mut out = Vec::with_capacity(self.count);
        match self.dense {
            // Floats, nearly always: without a branch per component.
            Some(d) if self.component == ComponentType::F32 => {
                for bytes in d.iter() {
                    let words = bytes.as_chunks::<4>().0;
                    out.push(f(std::array::from_fn(|k| f32::from_le_bytes(words[k]))));
                }
            }
            Some(d) => out.extend(d.iter().map(|bytes| f(vector(bytes)))),
            None => out.extend((0..self.count).map(|_| f([0.0; N]))),
        }
        if let Some(patch) = &self.patch {
            for (at, bytes) in patch.indices.iter().zip(patch.values.iter()) {
                out[unsigned(at) as usize] = f(vector(bytes));
            }
        }
        out
    }

    /// All elements as vertex numbers below `vertices`.
    pub(super) fn indices(&self, vertices: usize) -> Result<Vec<u32>, Fault> {
        let mut out: Vec<u32> = match self.dense {
            Some(d) if self.component == ComponentType::U16 => {
                d.iter().map(|b| u32::from(u16::from_le_bytes([b[0], b[1]]))).collect()
            }
            Some(d) => d.iter().map(unsigned).collect(),
            None => vec![0; self.count],
        };
        if let Some(patch) = &self.patch {
            for (at, bytes) in patch.indices.iter().zip(patch.values.iter()) {
                out[unsigned(at) as usize] = unsigned(bytes);
            }
        }
        match out.iter().position(|&v| v as usize >= vertices) {
            None => Ok(out),
            Some(i) => Err(Fault::broken(self.place(i), format!("vertex {} of {vertices}", out[i]))),
        }
    }
}
