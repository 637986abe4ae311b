//! Compressed geometry: buffer views of meshoptimizer, primitives of Draco.
//!
//! In: the encoded bytes. Out: plain ones, as the accessors of an uncompressed file would find
//! them. Sizes are declared by the file and compared with the limits before a decoder allocates;
//! since few bytes may honestly stand for many equal values, each decoder may give
//! [`FREE_BYTES`] and [`RATIO`] times what it gets.
//!
//! Draco is read by `draco-core`: of the decoders in Rust the only one that is finished, bounded by
//! its caller, fuzzed and compared bit by bit with Google's, whose own in C++ needs CMake.
//! meshoptimizer's codec is its author's, by the crate `meshopt`.

use std::collections::HashMap;

use draco_core::{DecodeLimits, DecoderBuffer, MeshDecoder};
use gltf::json::mesh::Semantic;
use meshopt::{
    decode_filter_color, decode_filter_exp, decode_filter_oct, decode_filter_quat, decode_index_buffer,
    decode_index_sequence, decode_vertex_buffer,
};

use super::super::error::Fault;
use super::super::guard::guarded;
use super::super::limits::Limits;
use super::extensions::{Draco, Meshopt};

/// Bytes that come out of any encoding.
const FREE_BYTES: u64 = 16 << 20;
/// Bytes that come out for each byte that goes in beyond that. Regular grids reach some hundreds.
const RATIO: u64 = 1024;
/// Bytes of a decoded triangle or vertex, at least, by which counts follow from bytes.
const LEAST_BYTES: u64 = 12;

/// Attributes of a primitive that are decoded: more than any has.
const MOST_ATTRIBUTES: usize = 32;
/// Components of a vertex attribute of glTF.
const MOST_COMPONENTS: usize = 4;

const REMEDY: &str = "export again, without compression of meshes";

/// Most bytes that may come out of `packed` bytes.
fn allowance(packed: u64) -> u64 {
    FREE_BYTES.saturating_add(packed.saturating_mul(RATIO))
}

/// A vertex of `N` words of four bytes, as the codec writes it.
#[derive(Clone)]
struct Vertex<const N: usize>([u32; N]);

impl<const N: usize> Default for Vertex<N> {
    fn default() -> Self {
        Self([0; N])
    }
}

fn vertices<const N: usize>(encoded: &[u8], count: usize) -> Option<Vec<u8>> {
    let decoded = decode_vertex_buffer::<Vertex<N>>(encoded, count).ok()?;
    Some(decoded.iter().flat_map(|v| v.0).flat_map(u32::to_ne_bytes).collect())
}

/// Decodes vertices of a stride that is known when the program runs.
fn vertices_of(stride: usize, encoded: &[u8], count: usize) -> Option<Vec<u8>> {
    macro_rules! of_words {
        ($($words:literal)*) => {
            match stride / 4 {
                $($words => vertices::<$words>(encoded, count),)*
                _ => None,
            }
        };
    }
    of_words!(
        1 2 3 4 5 6 7 8 9 10 11 12 13 14 15 16 17 18 19 20 21 22 23 24 25 26 27 28 29 30 31 32
        33 34 35 36 37 38 39 40 41 42 43 44 45 46 47 48 49 50 51 52 53 54 55 56 57 58 59 60 61 62 63 64
    )
}

/// Undoes a filter in place, for components of `N` bytes; false for one that is not known.
fn unfilter(filter: &str, stride: usize, bytes: &mut [u8]) -> bool {
    fn quads<T: Copy, const N: usize>(
        bytes: &mut [u8],
        read: fn([u8; N]) -> T,
        write: fn(T) -> [u8; N],
        apply: impl FnOnce(&mut [[T; 4]]),
    ) {
        let components: Vec<T> = bytes.as_chunks::<N>().0.iter().map(|b| read(*b)).collect();
        let mut quads = components.as_chunks::<4>().0.to_vec();
        apply(&mut quads);
        for (out, value) in bytes.as_chunks_mut::<N>().0.iter_mut().zip(quads.as_flattened()) {
            *out = write(*value);
        }
    }
    match (filter, stride) {
        ("NONE", _) => {}
        ("OCTAHEDRAL", 4) => quads(bytes, i8::from_le_bytes, i8::to_le_bytes, decode_filter_oct),
        ("OCTAHEDRAL", 8) => quads(bytes, i16::from_le_bytes, i16::to_le_bytes, decode_filter_oct),
        ("QUATERNION", 8) => quads(bytes, i16::from_le_bytes, i16::to_le_bytes, decode_filter_quat),
        ("COLOR", 4) => quads(bytes, u8::from_le_bytes, u8::to_le_bytes, decode_filter_color),
        ("COLOR", 8) => quads(bytes, u16::from_le_bytes, u16::to_le_bytes, decode_filter_color),
        ("EXPONENTIAL", _) => {
            let read = |b: &[u8; 4]| [u32::from_le_bytes(*b)];
            let mut words: Vec<[u32; 1]> = bytes.as_chunks::<4>().0.iter().map(read).collect();
            decode_filter_exp(&mut words);
            for (out, word) in bytes.as_chunks_mut::<4>().0.iter_mut().zip(words) {
                *out = word[0].to_le_bytes();
            }
        }
        _ => return false,
    }
    true
}

/// Decodes a view. What the codec asserts about its arguments is checked here first.
pub(super) fn meshopt_view(m: &Meshopt, encoded: &[u8], place: &str) -> Result<Vec<u8>, Fault> {
    let fault = |problem: String| Fault::invalid(place, problem, REMEDY);
    let decoded = m.count.saturating_mul(m.byte_stride);
    if decoded > allowance(encoded.len() as u64) {
        return Err(fault(format!(
            "{} elements of {} bytes are more than {} compressed bytes can hold",
            m.count,
            m.byte_stride,
            encoded.len()
        )));
    }
    // Both are bounded by what was just compared.
    let (count, stride) = (m.count as usize, m.byte_stride as usize);
    let filter = m.filter.as_deref().unwrap_or("NONE");
    let unknown =
        || fault(format!("meshopt mode {:?} with stride {stride} and filter {filter:?} is not known", m.mode));
    let out = match (m.mode.as_str(), stride) {
        ("ATTRIBUTES", 4..=256) if stride.is_multiple_of(4) => {
            let mut out = vertices_of(stride, encoded, count);
            if let Some(bytes) = &mut out
                && !unfilter(filter, stride, bytes)
            {
                return Err(unknown());
            }
            out
        }
        ("TRIANGLES", 2) if count.is_multiple_of(3) => {
            decode_index_buffer::<u16>(encoded, count).ok().map(bytes_of_u16)
        }
        ("TRIANGLES", 4) if count.is_multiple_of(3) => {
            decode_index_buffer::<u32>(encoded, count).ok().map(bytes_of_u32)
        }
        ("INDICES", 2) => decode_index_sequence::<u16>(encoded, count).ok().map(bytes_of_u16),
        ("INDICES", 4) => decode_index_sequence::<u32>(encoded, count).ok().map(bytes_of_u32),
        _ => return Err(unknown()),
    };
    out.ok_or_else(|| fault("the meshopt stream is broken".into()))
}

fn bytes_of_u16(values: Vec<u16>) -> Vec<u8> {
    values.into_iter().flat_map(u16::to_le_bytes).collect()
}

fn bytes_of_u32(values: Vec<u32>) -> Vec<u8> {
    values.into_iter().flat_map(u32::to_le_bytes).collect()
}

/// A decoded primitive.
#[derive(Debug)]
pub(super) struct DracoMesh {
    /// Number of vertices.
    pub(super) vertices: usize,
    /// Vertex numbers, four bytes each.
    pub(super) indices: Vec<u8>,
    /// Attributes by their names in glTF: number of components, and values as f32.
    pub(super) attributes: HashMap<String, (usize, Vec<u8>)>,
}

/// Name of an attribute in glTF.
pub(super) fn name_of(semantic: &Semantic) -> String {
    match semantic {
        Semantic::Extras(name) => format!("_{name}"),
        Semantic::Positions => "POSITION".into(),
        Semantic::Normals => "NORMAL".into(),
        Semantic::Tangents => "TANGENT".into(),
        Semantic::Colors(set) => format!("COLOR_{set}"),
        Semantic::TexCoords(set) => format!("TEXCOORD_{set}"),
        Semantic::Joints(set) => format!("JOINTS_{set}"),
        Semantic::Weights(set) => format!("WEIGHTS_{set}"),
    }
}

/// Decodes a primitive. `divisor` gives what integers of an attribute are fractions of.
pub(super) fn draco_mesh(
    draco: &Draco,
    divisor: impl Fn(&str) -> f32,
    encoded: &[u8],
    limits: &Limits,
    place: &str,
) -> Result<DracoMesh, Fault> {
    let most = allowance(encoded.len() as u64);
    let bounds = DecodeLimits::default()
        .with_max_points(limits.vertices.min(most / LEAST_BYTES))
        .with_max_faces(limits.unique_triangles.min(most / LEAST_BYTES))
        .with_max_decoded_bytes(most);
    let fault = |problem: String| Fault::invalid(place, format!("the Draco stream is broken: {problem}"), REMEDY);
    if draco.attributes.len() > MOST_ATTRIBUTES {
        return Err(Fault::too_large(place, "Draco attributes", draco.attributes.len(), MOST_ATTRIBUTES));
    }
    guarded(place, || {
        let mut mesh = draco_core::Mesh::new();
        let mut buffer = DecoderBuffer::new(encoded).with_limits(bounds);
        MeshDecoder::new().decode(&mut buffer, &mut mesh).map_err(|e| fault(e.to_string()))?;
        let vertices = mesh.num_points();
        if mesh.faces().as_flattened().iter().any(|p| p.0 as usize >= vertices) {
            return Err(fault("a face names a vertex that does not exist".into()));
        }
        let indices = mesh.faces().as_flattened().iter().flat_map(|p| p.0.to_le_bytes()).collect();
        let mut attributes = HashMap::new();
        for (name, id) in &draco.attributes {
            let Some(attribute) = mesh.attribute_by_unique_id(*id) else {
                return Err(fault(format!("attribute {id} does not exist")));
            };
            let width = usize::from(attribute.num_components());
            if width > MOST_COMPONENTS {
                return Err(fault(format!("attribute {id} has {width} components")));
            }
            let divisor = divisor(name);
            let values = attribute.read_f32s(vertices, width).into_iter();
            attributes.insert(name.clone(), (width, values.flat_map(|x| (x / divisor).to_le_bytes()).collect()));
        }
        Ok(DracoMesh { vertices, indices, attributes })
    })
}

#[cfg(test)]
mod tests {
    use super::super::super::limits::LIMITS;
    use super::*;

    fn view(mode: &str, count: u64, byte_stride: u64, byte_length: usize, filter: Option<&str>) -> Meshopt {
        let (buffer, byte_offset, byte_length) = (0, 0, byte_length as u64);
        let (mode, filter) = (mode.into(), filter.map(Into::into));
        Meshopt { buffer, byte_offset, byte_length, byte_stride, count, mode, filter }
    }

    #[test]
    fn views_come_back_as_they_were() {
        let points: Vec<[u16; 4]> = (0..200u16).map(|k| [k, k / 3, 7, 0]).collect();
        let encoded = meshopt::encode_vertex_buffer(&points).expect("encodes");
        let m = view("ATTRIBUTES", 200, 8, encoded.len(), None);
        let plain: Vec<u8> = points.as_flattened().iter().flat_map(|x| x.to_le_bytes()).collect();
        assert_eq!(meshopt_view(&m, &encoded, "view 0").ok(), Some(plain));
        let corners: Vec<u32> = (0..100).flat_map(|k| [k, k + 1, k + 2]).collect();
        let encoded = meshopt::encode_index_buffer(&corners, 102).expect("encodes");
        let decoded =
            meshopt_view(&view("TRIANGLES", 300, 2, encoded.len(), None), &encoded, "view 0").expect("decodes");
        // The codec may turn a triangle's corners, in order.
        let decoded: Vec<u16> = decoded.as_chunks::<2>().0.iter().map(|b| u16::from_le_bytes(*b)).collect();
        let sorted = |t: [u32; 3]| {
            let mut t = t;
            t.sort_unstable();
            t
        };
        let got: Vec<_> = decoded.as_chunks::<3>().0.iter().map(|t| sorted(t.map(u32::from))).collect();
        assert_eq!(got, corners.as_chunks::<3>().0.iter().map(|t| sorted(*t)).collect::<Vec<_>>());
    }

    #[test]
    fn filters_are_undone() {
        let normals = [[0.0f32, 0.0, 1.0, 0.0], [0.6, 0.0, -0.8, 0.0]];
        let filtered: Vec<[i8; 4]> = meshopt::encode_filter_oct(&normals, 8);
        let encoded = meshopt::encode_vertex_buffer(&filtered).expect("encodes");
        let m = view("ATTRIBUTES", 2, 4, encoded.len(), Some("OCTAHEDRAL"));
        let bytes = meshopt_view(&m, &encoded, "view 0").expect("decodes");
        for (got, want) in bytes.as_chunks::<4>().0.iter().zip(normals) {
            for (g, w) in got.iter().zip(want).take(3) {
                assert!((f32::from(*g as i8) / 127.0 - w).abs() < 0.02, "{got:?}");
            }
        }
    }

    #[test]
    fn forged_views_are_refused() {
        for m in [
            view("ATTRIBUTES", 1 << 40, 256, 9, None),
            view("ATTRIBUTES", 4, 6, 9, None),
            view("ATTRIBUTES", 4, 0, 9, None),
            view("ATTRIBUTES", 4, 512, 9, None),
            view("ATTRIBUTES", 4, 12, 9, Some("OCTAHEDRAL")),
            view("TRIANGLES", 4, 2, 9, None),
            view("TRIANGLES", 3, 3, 9, None),
            view("INDICES", 3, 1, 9, None),
            view("SPLATS", 3, 4, 9, None),
            view("ATTRIBUTES", u64::MAX, u64::MAX, 9, None),
        ] {
            assert!(meshopt_view(&m, &[0xa0; 9], "view 0").is_err(), "{m:?}");
        }
        let draco = Draco { buffer_view: 0, attributes: [("POSITION".into(), 0)].into() };
        for bytes in [&b""[..], b"DRACO", &[b'D', b'R', b'A', b'C', b'O', 2, 2, 1, 1, 0, 0, 0xff, 0xff, 0xff, 0xff]] {
            assert!(draco_mesh(&draco, |_| 1.0, bytes, &LIMITS, "mesh 0").is_err());
        }
    }
}
