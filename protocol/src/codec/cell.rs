//! Cell and bundle chunks: a [`CellGeometry`] to bytes and back.
//!
//! - Positions lie on a lattice of mesh space whose step is a power of two, the same for all
//!   clusters of a mesh ([`position_step_log2`]): neighbouring clusters, wherever they are stored,
//!   share their border vertices exactly, and decoding is exact in f32. Normals are octahedral, 12
//!   bits a coordinate (Meyer et al. 2010): at most 0.04 degrees off, so light is off by less than
//!   a third of an 8-bit code. Texture coordinates lie on a lattice of 1/16 texel
//!   ([`uv_step_log2`]).
//! - Vertices are numbered in the order of first use, so that most indices say "the next new
//!   vertex", and each plane is delta-coded along that order. Planes of equal meaning are joined
//!   over the chunk's clusters, cut into bytes by significance, and compressed as zstd sections
//!   ([`planes`](super::planes)).
//! - Instances share transforms: most clusters of a mesh instance carry the same one.
//!
//! Triangles keep their order and their winding; vertices no triangle uses are dropped. Encoding
//! what was decoded gives the same bytes again.

use super::{
    CodecError,
    bytes::{Reader, Writer, put_varint, unzigzag, zigzag},
    instances::{decode_instances, encode_instances},
    normal::{normal_of, octahedral},
    planes::{PlaneReader, PlaneWriter},
};
use crate::mesh::{CellGeometry, Cluster, MAX_CLUSTER_TRIANGLES};
use glam::{DVec3, Vec2, Vec3};

/// Version of cell and bundle chunks.
pub const VERSION: u8 = 2;
/// Most clusters in a chunk.
pub const MAX_CLUSTERS: usize = 1 << 16;
/// Most instances in a cell.
pub const MAX_INSTANCES: usize = 1 << 20;
/// Most vertices in a chunk: bounds what a forged chunk can make a reader allocate, to about 200
/// MB.
pub const MAX_VERTICES: usize = 1 << 22;

const MAGIC: [u8; 3] = *b"CEL";
/// Offsets within a cluster stay below this, so that f32 holds them exactly.
const MAX_OFFSET: i64 = 1 << 24;
/// Lattice numbers of origins stay below this, so that f64 holds them exactly.
const MAX_ORIGIN: i64 = 1 << 52;
/// Range of the logarithms of steps.
const STEPS_LOG2: std::ops::RangeInclusive<i64> = -64..=32;

/// Quantizer steps of one cluster, as powers of two.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ClusterSteps {
    /// Positions: step 2^k in mesh units; the same for all clusters of a mesh.
    pub position_log2: i8,
    /// Texture coordinates: step 2^k. A cluster whose coordinates span more than 2^24 steps gets a
    /// larger one.
    pub uv_log2: i8,
}

/// Step of a mesh's positions from its extent (longest edge of its mesh-space box) and the largest
/// scale of its instances: 0.1 mm in the world, but never finer than 2^-20 nor coarser than 2^-14
/// of the extent. Coarser shows on close inspection; finer is more than the picture can show and
/// costs a byte per vertex and axis every 8 steps of the exponent.
pub fn position_step_log2(extent: f64, largest_scale: f64) -> i8 {
    let wanted = 1e-4 / largest_scale.max(f64::MIN_POSITIVE);
    let step = wanted.clamp(extent * 2f64.powi(-20), (extent * 2f64.powi(-14)).max(extent * 2f64.powi(-20)));
    // Rounded down, except where that would be finer than 2^-20 of the extent: positions must fit
    // 24 bits.
    if step > 0.0 && step.is_finite() { step.log2().floor().clamp(-64.0, 32.0) as i8 } else { -14 }
}

/// Step of texture coordinates for a texture whose longer side has this many texels: at most 1/16
/// texel.
pub fn uv_step_log2(side: u32) -> i8 {
    -(side.max(1).next_power_of_two().ilog2() as i8) - 4
}

/// Encodes a cell or a bundle; `steps` has one entry per cluster. `level` is zstd's, 1 to 19.
///
/// # Errors
/// If a value is not finite, a cluster is too large for its step, or a limit of the format is
/// exceeded.
pub fn encode(geometry: &CellGeometry, steps: &[ClusterSteps], level: i32) -> Result<Vec<u8>, CodecError> {
    let g = geometry;
    if steps.len() != g.clusters.len() {
        return Err(CodecError::mismatch("steps", "there must be one entry per cluster"));
    }
    check_limit("clusters", g.clusters.len(), MAX_CLUSTERS)?;
    check_limit("instances", g.instances.len(), MAX_INSTANCES)?;
    let mut table = Vec::new();
    let mut planes = Planes::default();
    for (cluster, steps) in g.clusters.iter().zip(steps) {
        encode_cluster(cluster, steps, &mut table, &mut planes)?;
    }
    check_limit("vertices", planes.vertices, MAX_VERTICES)?;
    let mut w = Writer::new(level)?;
    w.raw(&MAGIC);
    w.u8(VERSION);
    w.varint(g.clusters.len() as u64);
    w.section("cluster table", &table)?;
    planes.positions.finish(&mut w, "positions")?;
    planes.normals.finish(&mut w, "normals")?;
    planes.uvs.finish(&mut w, "texture coordinates")?;
    planes.colours.finish(&mut w, "colours")?;
    planes.indices.finish(&mut w, "indices")?;
    encode_instances(&mut w, &g.instances)?;
    Ok(w.bytes)
}

/// Decodes a cell or a bundle. Every index is in range within the chunk and every number finite;
/// whether materials and shared clusters exist is for [`crate::manifest::check_cell`] to say,
/// which knows the index.
///
/// # Errors
/// If anything is missing, out of range or left over.
pub fn decode(bytes: &[u8]) -> Result<CellGeometry, CodecError> {
    let mut r = Reader::new(bytes);
    r.magic("cell geometry", MAGIC, VERSION)?;
    let count = r.count("clusters", MAX_CLUSTERS)?;
    // The longest entry of the table takes 60 bytes.
    let table = r.section("cluster table", count * 64)?;
    let mut table = Reader::new(&table);
    let heads = (0..count).map(|_| ClusterHead::read(&mut table)).collect::<Result<Vec<_>, _>>()?;
    table.finish("cluster table")?;
    let sum = |f: &dyn Fn(&ClusterHead) -> usize| heads.iter().map(f).sum::<usize>();
    let vertices = sum(&|h| h.vertices);
    check_limit("vertices", vertices, MAX_VERTICES)?;
    let mut positions = PlaneReader::new(&mut r, "positions", vertices)?;
    let mut normals = PlaneReader::new(&mut r, "normals", vertices)?;
    let mut uvs =
        PlaneReader::new(&mut r, "texture coordinates", sum(&|h| if h.uv.is_some() { h.vertices } else { 0 }))?;
    let mut colours = PlaneReader::new(&mut r, "colours", sum(&|h| if h.colour.is_some() { h.vertices } else { 0 }))?;
    let mut indices = PlaneReader::new(&mut r, "indices", sum(&|h| h.triangles * 3))?;
    let clusters = heads
        .iter()
        .map(|h| {
            Ok(Cluster {
                material: h.material,
                positions: h.positions(&mut positions)?,
                origin: h.origin(),
                normals: h.normals(&mut normals)?,
                uvs: h.uvs(&mut uvs)?,
                colours: h.colours(&mut colours)?,
                triangles: h.triangles(&mut indices)?,
            })
        })
        .collect::<Result<Vec<_>, CodecError>>()?;
    let instances = decode_instances(&mut r, count)?;
    r.finish("cell geometry")?;
    Ok(CellGeometry { clusters, instances })
}

/// Bytes that a cell or bundle takes in memory, for [`crate::index::ChunkEntry::decoded_bytes`].
pub fn decoded_bytes(geometry: &CellGeometry) -> usize {
    let cluster = |c: &Cluster| {
        size_of::<Cluster>()
            + size_of_val(&c.positions[..])
            + size_of_val(&c.normals[..])
            + size_of_val(&c.uvs[..])
            + size_of_val(&c.colours[..])
            + size_of_val(&c.triangles[..])
    };
    geometry.clusters.iter().map(cluster).sum::<usize>() + size_of_val(&geometry.instances[..])
}

fn check_limit(field: &'static str, value: usize, max: usize) -> Result<(), CodecError> {
    if value <= max {
        Ok(())
    } else {
        Err(CodecError::range(field, value, "more than a chunk may hold; split the cell"))
    }
}

/// The planes of all clusters of a chunk, while encoding.
#[derive(Default)]
struct Planes {
    positions: PlaneWriter<3>,
    normals: PlaneWriter<2>,
    uvs: PlaneWriter<2>,
    colours: PlaneWriter<3>,
    indices: PlaneWriter<1>,
    vertices: usize,
}

/// What the table says of a cluster.
struct ClusterHead {
    material: u32,
    vertices: usize,
    triangles: usize,
    position_log2: i8,
    origin: [i64; 3],
    uv: Option<(i8, [i64; 2])>,
    /// What a stored colour of 65,535 stands for.
    colour: Option<f32>,
}

fn encode_cluster(
    c: &Cluster,
    steps: &ClusterSteps,
    table: &mut Vec<u8>,
    planes: &mut Planes,
) -> Result<(), CodecError> {
    let n = c.positions.len();
    let optional = |len: usize| len == 0 || len == n;
    if c.normals.len() != n || !optional(c.uvs.len()) || !optional(c.colours.len()) {
        return Err(CodecError::mismatch("cluster", "its vertex arrays differ in length"));
    }
    if c.triangles.is_empty() || c.triangles.len() > MAX_CLUSTER_TRIANGLES {
        return Err(CodecError::range("triangles", c.triangles.len(), "a cluster has 1 to 256"));
    }
    // Old vertex of each new one, in the order of first use.
    let mut order: Vec<u16> = Vec::new();
    let mut renumbered = vec![u16::MAX; n];
    for &v in c.triangles.as_flattened() {
        let new = renumbered
            .get_mut(usize::from(v))
            .ok_or_else(|| CodecError::range("indices", v, "no such vertex in the cluster"))?;
        planes.indices.push([if *new == u16::MAX {
            *new = order.len() as u16;
            order.push(v);
            0
        } else {
            order.len() as i64 - i64::from(*new)
        }]);
    }
    let used = || order.iter().map(|&v| usize::from(v));
    put_varint(table, c.material.into());
    put_varint(table, order.len() as u64);
    put_varint(table, c.triangles.len() as u64);
    put_varint(table, u64::from(!c.uvs.is_empty()) | u64::from(!c.colours.is_empty()) << 1);

    put_varint(table, zigzag(steps.position_log2.into()));
    let per_unit = 2f64.powi(-i32::from(steps.position_log2));
    let lattice = used().map(|v| (c.origin + c.positions[v].as_dvec3()).to_array().map(|x| (x * per_unit).round()));
    push_lattice(lattice, table, &mut planes.positions, "positions")?;
    planes.normals.restart();
    used().for_each(|v| planes.normals.push_delta(octahedral(c.normals[v])));
    if !c.uvs.is_empty() {
        let (mut low, mut high) = (Vec2::INFINITY, Vec2::NEG_INFINITY);
        used().for_each(|v| (low, high) = (low.min(c.uvs[v]), high.max(c.uvs[v])));
        let span = f64::from((high - low).max_element());
        let finest = (span / (MAX_OFFSET - 2) as f64).log2().ceil();
        let log2 = f64::from(steps.uv_log2).max(finest).clamp(-64.0, 32.0) as i8;
        put_varint(table, zigzag(log2.into()));
        let per_unit = 2f64.powi(-i32::from(log2));
        let lattice = used().map(|v| c.uvs[v].as_dvec2().to_array().map(|x| (x * per_unit).round()));
        push_lattice(lattice, table, &mut planes.uvs, "texture coordinates")?;
    }
    if !c.colours.is_empty() {
        let brightest = used().flat_map(|v| c.colours[v]).fold(1.0, f32::max);
        if !brightest.is_finite() {
            return Err(CodecError::range("colours", brightest, "they must be finite"));
        }
        table.extend(brightest.to_le_bytes());
        planes.colours.restart();
        for v in used() {
            planes.colours.push_delta(c.colours[v].map(|x| (x.max(0.0) / brightest * 65_535.0).round() as i64));
        }
    }
    planes.vertices += order.len();
    Ok(())
}

/// Writes the smallest lattice number per axis to the table and the offsets from it to the planes.
fn push_lattice<const N: usize>(
    lattice: impl Iterator<Item = [f64; N]> + Clone,
    table: &mut Vec<u8>,
    planes: &mut PlaneWriter<N>,
    field: &'static str,
) -> Result<(), CodecError> {
    let (mut low, mut high) = ([f64::INFINITY; N], [f64::NEG_INFINITY; N]);
    for p in lattice.clone() {
        for k in 0..N {
            (low[k], high[k]) = (low[k].min(p[k]), high[k].max(p[k]));
        }
        if let Some(x) = p.iter().find(|x| x.is_nan() || x.abs() >= MAX_ORIGIN as f64) {
            return Err(CodecError::range(field, x, "not finite, or too far out for the quantizer step"));
        }
    }
    if let Some(k) = (0..N).find(|&k| high[k] - low[k] >= MAX_OFFSET as f64) {
        return Err(CodecError::range(
            field,
            high[k] - low[k],
            "a cluster spans at most 2^24 steps; use a larger step",
        ));
    }
    low.iter().for_each(|&l| put_varint(table, zigzag(l as i64)));
    planes.restart();
    lattice.for_each(|p| planes.push_delta(std::array::from_fn(|k| (p[k] - low[k]) as i64)));
    Ok(())
}

impl ClusterHead {
    fn read(r: &mut Reader<'_>) -> Result<Self, CodecError> {
        let material = r.varint("material", u32::MAX.into())? as u32;
        let vertices = r.count("vertices", MAX_CLUSTER_TRIANGLES * 3)?;
        let triangles = r.count("triangles", MAX_CLUSTER_TRIANGLES)?;
        if triangles == 0 || vertices == 0 {
            return Err(CodecError::range("triangles", 0, "a cluster has at least one"));
        }
        let flags = r.varint("cluster flags", 3)?;
        let position_log2 = read_step(r, "position step")?;
        let origin = read_lattice_origin(r, "cluster origin")?;
        let uv = match flags & 1 {
            0 => None,
            _ => Some((read_step(r, "texture coordinate step")?, read_lattice_origin(r, "texture coordinate origin")?)),
        };
        let colour = if flags & 2 == 0 { None } else { Some(f32::from_bits(r.u32("colour scale")?)) };
        if colour.is_some_and(|c| !c.is_finite() || c <= 0.0) {
            return Err(CodecError::range("colour scale", "not positive", "it must be positive and finite"));
        }
        Ok(Self { material, vertices, triangles, position_log2, origin, uv, colour })
    }

    fn origin(&self) -> DVec3 {
        DVec3::from(self.origin.map(|k| k as f64 * 2f64.powi(self.position_log2.into())))
    }

    fn positions(&self, planes: &mut PlaneReader<3>) -> Result<Vec<Vec3>, CodecError> {
        let step = 2f32.powi(self.position_log2.into());
        planes.restart();
        (0..self.vertices).map(|_| Ok(Vec3::from(offset(planes.next_delta()?)?.map(|k| k as f32 * step)))).collect()
    }

    fn normals(&self, planes: &mut PlaneReader<2>) -> Result<Vec<Vec3>, CodecError> {
        planes.restart();
        (0..self.vertices).map(|_| Ok(normal_of(planes.next_delta()?))).collect()
    }

    fn uvs(&self, planes: &mut PlaneReader<2>) -> Result<Vec<Vec2>, CodecError> {
        let Some((log2, origin)) = self.uv else { return Ok(Vec::new()) };
        let step = 2f64.powi(log2.into());
        planes.restart();
        (0..self.vertices)
            .map(|_| {
                let k = offset(planes.next_delta()?)?;
                Ok(Vec2::from(std::array::from_fn(|i| ((origin[i] + k[i]) as f64 * step) as f32)))
            })
            .collect()
    }

    fn colours(&self, planes: &mut PlaneReader<3>) -> Result<Vec<[f32; 3]>, CodecError> {
        let Some(brightest) = self.colour else { return Ok(Vec::new()) };
        planes.restart();
        (0..self.vertices)
            .map(|_| {
                let k = planes.next_delta()?;
                if let Some(k) = k.iter().find(|k| !(0..=65_535).contains(*k)) {
                    return Err(CodecError::range("colours", k, "they have 16 bits"));
                }
                Ok(k.map(|k| k as f32 / 65_535.0 * brightest))
            })
            .collect()
    }

    fn triangles(&self, planes: &mut PlaneReader<1>) -> Result<Vec<[u16; 3]>, CodecError> {
        let mut fresh = 0;
        let mut next = || {
            let [back] = planes.next()?;
            let v = fresh - back;
            if !(0..=fresh).contains(&v) || v >= self.vertices as i64 {
                return Err(CodecError::range("indices", v, "no such vertex in the cluster"));
            }
            fresh += i64::from(back == 0);
            Ok(v as u16)
        };
        (0..self.triangles).map(|_| Ok([next()?, next()?, next()?])).collect()
    }
}

fn read_step(r: &mut Reader<'_>, field: &'static str) -> Result<i8, CodecError> {
    let log2 = unzigzag(r.varint(field, 255)?);
    if STEPS_LOG2.contains(&log2) {
        Ok(log2 as i8)
    } else {
        Err(CodecError::range(field, log2, "its logarithm is -64 to 32"))
    }
}

fn read_lattice_origin<const N: usize>(r: &mut Reader<'_>, field: &'static str) -> Result<[i64; N], CodecError> {
    let mut origin = [0; N];
    for o in &mut origin {
        *o = unzigzag(r.varint(field, zigzag(MAX_ORIGIN))?);
    }
    Ok(origin)
}

/// Checks the range of offsets within a cluster.
fn offset<const N: usize>(k: [i64; N]) -> Result<[i64; N], CodecError> {
    match k.iter().find(|k| !(0..MAX_OFFSET).contains(*k)) {
        None => Ok(k),
        Some(bad) => Err(CodecError::range("lattice offset", bad, "it is 0 to 2^24 - 1")),
    }
}

#[cfg(test)]
#[path = "cell_test.rs"]
mod tests;
