//! Buffers, buffer views and accessors (glTF 2.0 section 3.6): typed arrays inside bytes.
//!
//! An accessor is checked once, when it becomes [`Elements`]: its type, and that its last byte
//! lies inside its view and its view inside its buffer, in checked 64-bit arithmetic. Since every
//! element then has bytes of its own in the file (strides are at least the element's size), a
//! forged count cannot ask for more memory than a small multiple of the file; only sparse
//! accessors without a view can, and those are bounded by the vertex limit beforehand.

use std::borrow::Cow;

use gltf::json::Root;
use gltf::json::accessor::{ComponentType, Type};
use gltf::json::validation::Checked;

use super::super::error::Fault;
use super::super::files::Files;

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

/// The document and the bytes of its buffers.
#[derive(Debug)]
pub(super) struct Data<'a> {
    root: &'a Root,
    buffers: Vec<Cow<'a, [u8]>>,
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
    /// Reads all buffers.
    pub(super) fn load(root: &'a Root, bin: Option<Cow<'a, [u8]>>, files: &mut Files) -> Result<Self, Fault> {
        let mut bin = bin;
        let mut buffers = Vec::new();
        for (i, buffer) in root.buffers.iter().enumerate() {
            let place = format!("buffer {i}");
            let bytes = match &buffer.uri {
                Some(uri) => Cow::Owned(files.read_uri(uri, &place)?),
                None if i == 0 => {
                    bin.take().ok_or_else(|| Fault::broken(&place, "has no uri, and the file no BIN chunk"))?
                }
                None => return Err(Fault::broken(&place, "has no uri; only buffer 0 may be the BIN chunk")),
            };
            let declared = buffer.byte_length.0;
            if declared > bytes.len() as u64 {
                return Err(Fault::broken(
                    place,
                    format!("byteLength is {declared}, but only {} bytes are there", bytes.len()),
                ));
            }
            buffers.push(bytes);
        }
        Ok(Self { root, buffers })
    }

    /// Bytes of a buffer view, and its stride.
    pub(super) fn view(&self, view: usize, place: &str) -> Result<(&[u8], Option<usize>), Fault> {
        let v = (self.root.buffer_views.get(view))
            .ok_or_else(|| Fault::broken(place, format!("bufferView {view} does not exist")))?;
        let fault = |problem: String| Fault::broken(format!("{place}, bufferView {view}"), problem);
        let buffer = v.buffer.value();
        let bytes = self.buffers.get(buffer).ok_or_else(|| fault(format!("buffer {buffer} does not exist")))?;
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
        let stride = stride.unwrap_or(size);
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
            None if a.sparse.is_some() => None,
            None => return Err(Fault::broken(place, "has neither bufferView nor sparse, so no values")),
        };
        let patch = match &a.sparse {
            Some(sparse) => Some(self.patch(sparse, count, size, &place)?),
            None => None,
        };
        let normalized = a.normalized || usage.fractions;
        Ok(Elements { index, count: count as usize, width, component, normalized, dense, patch })
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

/// One component as a number (glTF 2.0 section 3.11 for normalized integers).
fn real(bytes: &[u8], component: ComponentType, normalized: bool) -> f32 {
    let (value, largest) = match component {
        ComponentType::I8 => (f32::from(bytes[0] as i8), 127.0),
        ComponentType::U8 => (f32::from(bytes[0]), 255.0),
        ComponentType::I16 => (f32::from(i16::from_le_bytes([bytes[0], bytes[1]])), 32_767.0),
        ComponentType::U16 => (f32::from(u16::from_le_bytes([bytes[0], bytes[1]])), 65_535.0),
        ComponentType::U32 => (unsigned(bytes) as f32, 1.0),
        ComponentType::F32 => return f32::from_bits(unsigned(bytes)),
    };
    if normalized { (value / largest).max(-1.0) } else { value }
}

impl Elements<'_> {
    /// What messages call this accessor.
    fn place(&self, element: usize) -> String {
        format!("accessor {}, element {element}", self.index)
    }

    /// All elements as vectors of `N` numbers, `N` being [`Self::width`], each passed through `f`.
    pub(super) fn vectors<const N: usize, T>(&self, f: impl Fn([f32; N]) -> T) -> Result<Vec<T>, Fault> {
        let vector = |bytes: &[u8]| -> [f32; N] {
            let size = self.component.size();
            std::array::from_fn(|k| real(&bytes[k * size..][..size], self.component, self.normalized))
        };
        let checked = |element: usize, v: [f32; N]| match v.iter().all(|x| x.is_finite()) {
            true => Ok(f(v)),
            false => Err(Fault::broken(self.place(element), format!("{v:?} is not finite"))),
        };
        let mut out = Vec::with_capacity(self.count);
        match self.dense {
            // Floats, nearly always: without a branch per component.
            Some(d) if self.component == ComponentType::F32 => {
                for (i, bytes) in d.iter().enumerate() {
                    let words = bytes.as_chunks::<4>().0;
                    out.push(checked(i, std::array::from_fn(|k| f32::from_le_bytes(words[k])))?);
                }
            }
            Some(d) => {
                for (i, bytes) in d.iter().enumerate() {
                    out.push(checked(i, vector(bytes))?);
                }
            }
            None => out.extend((0..self.count).map(|_| f([0.0; N]))),
        }
        if let Some(patch) = &self.patch {
            for (at, bytes) in patch.indices.iter().zip(patch.values.iter()) {
                let at = unsigned(at) as usize;
                out[at] = checked(at, vector(bytes))?;
            }
        }
        Ok(out)
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
