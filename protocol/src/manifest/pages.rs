//! Pages of the manifest: lists of entries, field by field, as zstd sections.
//!
//! Floating-point numbers are stored exactly, byte 0 of all of them first, then byte 1 and so on;
//! counts and numbers are LEB128. Ascending lists (bundles, materials, culled cells) are runs: gap
//! to the run, length of the run less one. Culled subsets are boxes of Morton-ordered cells, so
//! their runs are long.

mod levels;
mod plans;
mod rooms;
mod tree;

use super::{PageEntry, PageKind, VERSION};
use crate::{
    Aabb, CellRuns, ViewBasis,
    codec::{
        CodecError,
        bytes::{Reader, Writer, put_varint, unzigzag, zigzag},
    },
    index::{
        AngularRange, CellEntry, ChunkEntry, ChunkHash, ChunkKind, GridPoint, ImageEntry, Index, Placement,
        TextureChunk, TextureEntry,
    },
    mesh::Material,
    sky::SkyMap,
};
use glam::DVec3;
use std::ops::Range;

const MAGIC: [u8; 3] = *b"LDP";
/// Longest section of a page, raw bytes.
const MAX_SECTION: usize = SECTION_BYTES;
/// Raw bytes of all sections of all pages together. Larger: a forged manifest costs a reader more.
/// Smaller: large scenes do not fit.
const SECTION_BYTES: usize = 64 << 20;
/// Bytes in memory of all entries and lists that pages decode to. Few bytes expand to many: a run
/// of numbers to a list, an empty band of a grid point to a vector.
const DECODED_BYTES: usize = 192 << 20;

/// What the pages of one index may still hold.
pub(super) struct Room {
    /// Raw bytes of sections.
    pub bytes: usize,
    /// Bytes in memory of entries and lists.
    pub decoded: usize,
    /// Rooms and portals so far: rules tie them together, so the index gets them once all pages
    /// are read.
    pub rooms: rooms::Draft,
}

impl Room {
    /// For a whole index.
    pub fn of_index() -> Self {
        Self { bytes: SECTION_BYTES, decoded: DECODED_BYTES, rooms: rooms::Draft::default() }
    }

    /// What is done when all pages are read.
    pub fn finish(self, index: &mut Index) -> Result<(), CodecError> {
        index.rooms = self.rooms.finish()?;
        Ok(())
    }
}

/// Appends the entries of a page.
fn append<T>(list: &mut Vec<T>, mut page: Vec<T>) {
    // The first page is not copied: it may be most of what fits.
    if list.is_empty() { *list = page } else { list.append(&mut page) }
}

/// Takes `count` values of type `T` from the bytes that entries and lists may still have in memory.
fn charge<T>(decoded: &mut usize, field: &'static str, count: usize) -> Result<(), CodecError> {
    let left = count.checked_mul(size_of::<T>()).and_then(|bytes| decoded.checked_sub(bytes));
    *decoded = left.ok_or_else(|| CodecError::range(field, count, "all pages together decode to at most 192 MiB"))?;
    Ok(())
}

/// Longest packed material, raw bytes: thirteen fields of at most nine bytes, and their lists.
const MATERIAL_BYTES: usize = 256;
const KINDS: [ChunkKind; 7] = [
    ChunkKind::Page,
    ChunkKind::Cell,
    ChunkKind::Bundle,
    ChunkKind::Ldi,
    ChunkKind::Texture,
    ChunkKind::Tree,
    ChunkKind::Levels,
];

/// Entries of [`PageKind::Rooms`].
pub(super) fn room_count(index: &Index) -> usize {
    index.rooms.as_ref().map_or(0, rooms::count)
}

/// Encodes a range of the entries of one kind.
pub(super) fn encode(index: &Index, kind: PageKind, range: Range<usize>, level: i32) -> Result<Vec<u8>, CodecError> {
    let mut w = Writer::new(level)?;
    w.raw(&MAGIC);
    w.u8(VERSION);
    w.u8(kind as u8);
    w.varint(range.start as u64);
    w.varint(range.len() as u64);
    match kind {
        PageKind::Chunks => put_chunks(&mut w, &index.chunks[range])?,
        PageKind::Cells => put_cells(&mut w, &index.cells[range])?,
        PageKind::Materials => put_packed(&mut w, "materials", &index.materials[range])?,
        PageKind::Textures => put_textures(&mut w, &index.textures[range])?,
        PageKind::Points => put_points(&mut w, &index.points[range])?,
        PageKind::Placements => put_placements(&mut w, &index.placements[range], &index.images)?,
        PageKind::Volume => put_packed(&mut w, "walk volume", &index.volume)?,
        PageKind::Tree => index.tree.iter().try_for_each(|t| tree::put_head(&mut w, t))?,
        PageKind::TreeNodes => index.tree.iter().try_for_each(|t| tree::put_nodes(&mut w, &t.nodes[range.clone()]))?,
        PageKind::Rooms => index.rooms.iter().try_for_each(|r| rooms::put_rooms(&mut w, r, range.clone()))?,
        PageKind::Portals => index.rooms.iter().try_for_each(|r| rooms::put_portals(&mut w, r, range.clone()))?,
        PageKind::Plans => plans::put(&mut w, &index.plans[range])?,
    }
    Ok(w.bytes)
}

/// Decodes a page and appends its entries; takes from `room` what they hold.
pub(super) fn decode_into(
    index: &mut Index,
    entry: &PageEntry,
    bytes: &[u8],
    room: &mut Room,
) -> Result<(), CodecError> {
    let mut r = Reader::with_room(bytes, room.bytes);
    r.magic("manifest page", MAGIC, VERSION)?;
    let head = (r.u8("page kind")?, r.varint("page first", u64::MAX)?, r.varint("page count", u64::MAX)?);
    if head != (entry.kind as u8, entry.first.into(), entry.count.into()) {
        return Err(CodecError::mismatch("page", "it holds other entries than the root lists"));
    }
    let n = entry.count as usize;
    let decoded = &mut room.decoded;
    match entry.kind {
        PageKind::Chunks => append(&mut index.chunks, take_chunks(&mut r, n, decoded)?),
        PageKind::Cells => append(&mut index.cells, take_cells(&mut r, n, decoded)?),
        PageKind::Materials => {
            charge::<Material>(decoded, "materials", n)?;
            let materials: Vec<Material> = take_packed(&mut r, "materials", n.saturating_mul(MATERIAL_BYTES))?;
            if materials.len() != n {
                return Err(CodecError::mismatch("materials", format!("{} instead of {n}", materials.len())));
            }
            append(&mut index.materials, materials);
        }
        PageKind::Textures => append(&mut index.textures, take_textures(&mut r, n, decoded)?),
        PageKind::Points => append(&mut index.points, take_points(&mut r, n, decoded)?),
        PageKind::Placements => {
            let (placements, images) = take_placements(&mut r, n, index.images.len(), decoded)?;
            append(&mut index.placements, placements);
            append(&mut index.images, images);
        }
        PageKind::Volume => index.volume = take_packed(&mut r, "walk volume", MAX_SECTION)?,
        PageKind::Tree => index.tree = Some(tree::take_head(&mut r)?),
        PageKind::TreeNodes => match &mut index.tree {
            Some(t) => append(&mut t.nodes, tree::take_nodes(&mut r, n, decoded)?),
            None => return Err(CodecError::mismatch("tree nodes", "there are nodes without a tree")),
        },
        PageKind::Rooms => rooms::take_rooms(&mut r, n, &mut room.rooms, decoded)?,
        PageKind::Portals => rooms::take_portals(&mut r, n, &mut room.rooms, decoded)?,
        PageKind::Plans => append(&mut index.plans, plans::take(&mut r, n, decoded)?),
    }
    room.bytes = r.room();
    r.finish("manifest page")
}

fn put_packed<T: serde::Serialize + ?Sized>(w: &mut Writer, field: &'static str, v: &T) -> Result<(), CodecError> {
    let bytes = rmp_serde::to_vec(v).map_err(|e| CodecError::mismatch(field, e.to_string()))?;
    w.section(field, &bytes)
}

fn take_packed<T: serde::de::DeserializeOwned>(
    r: &mut Reader<'_>,
    field: &'static str,
    most_bytes: usize,
) -> Result<T, CodecError> {
    let bytes = r.section(field, most_bytes.min(MAX_SECTION))?;
    rmp_serde::from_slice(&bytes).map_err(|e| CodecError::mismatch(field, e.to_string()))
}

fn put_numbers(w: &mut Writer, field: &'static str, numbers: impl IntoIterator<Item = f64>) -> Result<(), CodecError> {
    let bytes: Vec<[u8; 8]> = numbers.into_iter().map(f64::to_le_bytes).collect();
    let planes: Vec<u8> = (0..8).flat_map(|k| bytes.iter().map(move |b| b[k])).collect();
    w.section(field, &planes)
}

fn take_numbers(r: &mut Reader<'_>, field: &'static str, n: usize) -> Result<Vec<f64>, CodecError> {
    if n > MAX_SECTION / 8 {
        return Err(CodecError::range(field, n, "more than a page may hold"));
    }
    let bytes = r.section_of(field, n * 8)?;
    Ok((0..n).map(|i| f64::from_le_bytes(std::array::from_fn(|k| bytes[k * n + i]))).collect())
}

/// Numbers of one section of LEB128.
struct Numbers(Vec<u8>, usize);

impl Numbers {
    fn take(r: &mut Reader<'_>, field: &'static str) -> Result<Self, CodecError> {
        Ok(Self(r.section(field, MAX_SECTION)?, 0))
    }
    fn next(&mut self, field: &'static str) -> Result<u32, CodecError> {
        let mut r = Reader::new(&self.0[self.1..]);
        let v = r.varint(field, u32::MAX.into())?;
        self.1 = self.0.len() - r.remaining();
        Ok(v as u32)
    }
    /// A count of things that each take at least one more byte here or elsewhere in the page.
    fn count(&mut self, field: &'static str, max: usize) -> Result<usize, CodecError> {
        let n = self.next(field)? as usize;
        if n <= max { Ok(n) } else { Err(CodecError::range(field, n, "more than a page may hold")) }
    }
    fn finish(self, field: &'static str) -> Result<(), CodecError> {
        Reader::new(&self.0[self.1..]).finish(field)
    }
}

/// Appends an ascending list as runs.
fn put_ascending(out: &mut Vec<u8>, list: &[u32]) {
    put_runs(out, list.iter().copied().collect::<CellRuns>().runs());
}

/// Appends runs: their number, then of each the gap before it and its length less one.
fn put_runs(out: &mut Vec<u8>, runs: &[[u32; 2]]) {
    put_varint(out, runs.len() as u64);
    let mut next = 0u64;
    for [first, last] in runs {
        put_varint(out, u64::from(*first) - next);
        put_varint(out, u64::from(last - first));
        next = u64::from(*last) + 1;
    }
}

/// Reads an ascending list; `decoded` counts down what lists may have in memory.
fn take_ascending(n: &mut Numbers, field: &'static str, decoded: &mut usize) -> Result<Vec<u32>, CodecError> {
    let before = *decoded;
    let runs = take_runs(n, field, decoded)?;
    // The runs are dropped, the list stays.
    *decoded = before;
    charge::<u32>(decoded, field, runs.len())?;
    // A list that grows would hold up to twice its numbers.
    let mut out = Vec::with_capacity(runs.len());
    out.extend(runs.iter());
    Ok(out)
}

/// Reads runs; `decoded` counts down what they may have in memory.
fn take_runs(n: &mut Numbers, field: &'static str, decoded: &mut usize) -> Result<CellRuns, CodecError> {
    let count = n.next(field)?;
    let mut runs: Vec<[u32; 2]> = Vec::new();
    let mut next = 0u64;
    for _ in 0..count {
        let first = next + u64::from(n.next(field)?);
        let last = first + u64::from(n.next(field)?);
        next = last + 1;
        if next > u64::from(u32::MAX) {
            return Err(CodecError::range(field, next, "numbers have 32 bits"));
        }
        charge::<[u32; 2]>(decoded, field, 1)?;
        runs.push([first as u32, last as u32]);
    }
    runs.shrink_to_fit();
    CellRuns::of_runs(runs).ok_or_else(|| CodecError::mismatch(field, "runs that touch"))
}

/// Runs of squares: their number, then of each the gap before it and its length less one.
fn put_sky(out: &mut Vec<u8>, sky: &SkyMap) {
    put_varint(out, sky.runs().len() as u64);
    let mut next = 0;
    for [first, length] in sky.runs() {
        put_varint(out, u64::from(first - next));
        put_varint(out, u64::from(length - 1));
        next = first + length;
    }
}

fn take_sky(n: &mut Numbers, decoded: &mut usize) -> Result<SkyMap, CodecError> {
    let count = n.count("sky runs", SkyMap::SQUARES as usize)?;
    charge::<[u32; 2]>(decoded, "sky runs", count)?;
    let mut runs = Vec::new();
    let mut next = 0u32;
    for _ in 0..count {
        let first = next.saturating_add(n.next("sky")?);
        let length = n.next("sky")?.saturating_add(1);
        next = first.saturating_add(length);
        runs.push([first, length]);
    }
    SkyMap::of_runs(runs).ok_or_else(|| CodecError::mismatch("sky", "runs of squares that touch or leave the cube"))
}

fn put_chunks(w: &mut Writer, chunks: &[ChunkEntry]) -> Result<(), CodecError> {
    w.section("chunk hashes", chunks.iter().map(|c| c.hash.0).collect::<Vec<_>>().as_flattened())?;
    let kinds: Vec<u8> = chunks.iter().map(|c| KINDS.iter().position(|k| *k == c.kind).unwrap_or(0) as u8).collect();
    w.section("chunk kinds", &kinds)?;
    let mut sizes = Vec::new();
    for c in chunks {
        put_varint(&mut sizes, c.stored_bytes.into());
        put_varint(&mut sizes, c.decoded_bytes.into());
    }
    w.section("chunk sizes", &sizes)
}

fn take_chunks(r: &mut Reader<'_>, n: usize, decoded: &mut usize) -> Result<Vec<ChunkEntry>, CodecError> {
    charge::<ChunkEntry>(decoded, "page count", n)?;
    let hashes = r.section_of("chunk hashes", n * 32)?;
    let kinds = r.section_of("chunk kinds", n)?;
    let mut sizes = Numbers::take(r, "chunk sizes")?;
    let mut chunks = Vec::with_capacity(n);
    for (hash, kind) in hashes.as_chunks().0.iter().zip(kinds) {
        chunks.push(ChunkEntry {
            hash: ChunkHash(*hash),
            stored_bytes: sizes.next("chunk sizes")?,
            decoded_bytes: sizes.next("chunk sizes")?,
            kind: *KINDS
                .get(usize::from(kind))
                .ok_or_else(|| CodecError::range("chunk kind", kind, "there are seven kinds"))?,
        });
    }
    sizes.finish("chunk sizes")?;
    Ok(chunks)
}

fn put_cells(w: &mut Writer, cells: &[CellEntry]) -> Result<(), CodecError> {
    let mut planes: Vec<[u8; 4]> = Vec::with_capacity(cells.len() * 6);
    for k in 0..6 {
        for c in cells {
            let exact = [c.bounds.min, c.bounds.max][k / 3][k % 3];
            let stored = exact as f32;
            if f64::from(stored) != exact {
                return Err(CodecError::range("cell bounds", exact, "they must be f32 values"));
            }
            planes.push(stored.to_le_bytes());
        }
    }
    let transposed: Vec<u8> = (0..4).flat_map(|b| planes.iter().map(move |p| p[b])).collect();
    w.section("cell bounds", &transposed)?;
    let mut numbers = Vec::new();
    for c in cells {
        put_varint(&mut numbers, c.triangles.into());
        put_varint(&mut numbers, c.chunk.into());
        put_ascending(&mut numbers, &c.bundles);
        put_ascending(&mut numbers, &c.materials);
        c.texel_density.iter().for_each(|d| put_varint(&mut numbers, d.cast_unsigned().into()));
    }
    w.section("cells", &numbers)?;
    levels::put(w, cells)
}

fn take_cells(r: &mut Reader<'_>, n: usize, decoded: &mut usize) -> Result<Vec<CellEntry>, CodecError> {
    charge::<CellEntry>(decoded, "page count", n)?;
    let bytes = r.section_of("cell bounds", n * 24)?;
    let bound = |k: usize, i: usize| f64::from(f32::from_le_bytes(std::array::from_fn(|b| bytes[(b * 6 + k) * n + i])));
    let mut numbers = Numbers::take(r, "cells")?;
    let mut cells = Vec::with_capacity(n);
    for i in 0..n {
        let corner = |k| DVec3::new(bound(k, i), bound(k + 1, i), bound(k + 2, i));
        let (triangles, chunk) = (numbers.next("cell triangles")?, numbers.next("cell chunk")?);
        let bundles = take_ascending(&mut numbers, "cell bundles", decoded)?;
        let materials = take_ascending(&mut numbers, "cell materials", decoded)?;
        charge::<u8>(decoded, "texel density", materials.len())?;
        let mut density = |_: &u32| {
            let code = numbers.next("texel density")?;
            let code = u8::try_from(code).map_err(|_| CodecError::range("texel density", code, "0 to 255"))?;
            Ok(code.cast_signed())
        };
        let texel_density = materials.iter().map(&mut density).collect::<Result<_, CodecError>>()?;
        let bounds = Aabb { min: corner(0), max: corner(3) };
        cells.push(CellEntry { bounds, triangles, chunk, bundles, materials, texel_density, levels: Vec::new() });
    }
    numbers.finish("cells")?;
    levels::take(r, &mut cells, decoded)?;
    Ok(cells)
}

fn put_textures(w: &mut Writer, textures: &[TextureEntry]) -> Result<(), CodecError> {
    let mut numbers = Vec::new();
    for t in textures {
        put_varint(&mut numbers, t.width.into());
        put_varint(&mut numbers, t.height.into());
        put_varint(&mut numbers, t.chunks.len() as u64);
        for c in &t.chunks {
            put_varint(&mut numbers, c.chunk.into());
            put_varint(&mut numbers, c.first_level.into());
            put_varint(&mut numbers, c.last_level.into());
        }
    }
    w.section("textures", &numbers)
}

fn take_textures(r: &mut Reader<'_>, n: usize, decoded: &mut usize) -> Result<Vec<TextureEntry>, CodecError> {
    charge::<TextureEntry>(decoded, "page count", n)?;
    let mut numbers = Numbers::take(r, "textures")?;
    let mut textures = Vec::with_capacity(n);
    for _ in 0..n {
        let (width, height) = (numbers.next("texture width")?, numbers.next("texture height")?);
        let count = numbers.count("texture chunks", 32)?;
        charge::<TextureChunk>(decoded, "texture chunks", count)?;
        let chunks = (0..count)
            .map(|_| {
                Ok(TextureChunk {
                    chunk: numbers.next("texture chunk")?,
                    first_level: numbers.count("texture level", 255)? as u8,
                    last_level: numbers.count("texture level", 255)? as u8,
                })
            })
            .collect::<Result<_, CodecError>>()?;
        textures.push(TextureEntry { width, height, chunks });
    }
    numbers.finish("textures")?;
    Ok(textures)
}

fn put_points(w: &mut Writer, points: &[GridPoint]) -> Result<(), CodecError> {
    put_numbers(
        w,
        "point positions",
        points.iter().flat_map(|p| [p.position.x, p.position.y, p.position.z, p.radius]),
    )?;
    let (mut numbers, mut yaws, mut last) = (Vec::new(), Vec::new(), 0i64);
    for p in points {
        put_varint(&mut numbers, p.level.into());
        put_varint(&mut numbers, p.bands.len() as u64);
        for band in &p.bands {
            put_varint(&mut numbers, band.len() as u64);
            for range in band {
                yaws.push(range.yaw_start_deg);
                // 0 is no placement; the others are differences to the one before, which is mostly
                // near.
                put_varint(&mut numbers, range.placement.map_or(0, |k| 1 + zigzag(i64::from(k) - last)));
                last = range.placement.map_or(last, i64::from);
            }
        }
    }
    w.section("point bands", &numbers)?;
    put_numbers(w, "yaw starts", yaws)
}

fn take_points(r: &mut Reader<'_>, n: usize, decoded: &mut usize) -> Result<Vec<GridPoint>, CodecError> {
    charge::<GridPoint>(decoded, "page count", n)?;
    let places = take_numbers(r, "point positions", n * 4)?;
    let mut numbers = Numbers::take(r, "point bands")?;
    let (mut points, mut ranges, mut last) = (Vec::with_capacity(n), 0usize, 0i64);
    for place in places.as_chunks::<4>().0 {
        let level = numbers.count("point level", 255)? as u8;
        let count = numbers.count("bands", 1024)?;
        charge::<Vec<AngularRange>>(decoded, "bands", count)?;
        let bands = (0..count)
            .map(|_| {
                let count = numbers.count("ranges", MAX_SECTION)?;
                charge::<AngularRange>(decoded, "ranges", count)?;
                let mut band = Vec::with_capacity(count);
                for _ in 0..count {
                    let code = u64::from(numbers.next("range placement")?);
                    let placement = match code.checked_sub(1).map(|z| last + unzigzag(z)) {
                        None => None,
                        Some(k) => Some(
                            u32::try_from(k)
                                .map_err(|_| CodecError::range("range placement", k, "it is not negative"))?,
                        ),
                    };
                    last = placement.map_or(last, i64::from);
                    band.push(AngularRange { yaw_start_deg: 0.0, placement });
                }
                ranges += count;
                Ok(band)
            })
            .collect::<Result<_, CodecError>>()?;
        let [x, y, z, radius] = *place;
        points.push(GridPoint { position: DVec3::new(x, y, z), level, radius, bands });
    }
    numbers.finish("point bands")?;
    let yaws = take_numbers(r, "yaw starts", ranges)?;
    points.iter_mut().flat_map(|p| p.bands.iter_mut().flatten()).zip(yaws).for_each(|(r, yaw)| r.yaw_start_deg = yaw);
    Ok(points)
}

/// Numbers of a placement: centre of projection, users, footprint.
const PLACEMENT_NUMBERS: usize = 10;
/// Numbers of an image: basis, plane distance, window, stretch.
const IMAGE_NUMBERS: usize = 15;
/// Most images of a placement.
const MAX_IMAGES: usize = 4096;

/// Placements and, behind them, their images.
fn put_placements(w: &mut Writer, placements: &[Placement], all: &[ImageEntry]) -> Result<(), CodecError> {
    let (mut rows, mut numbers, mut culled, mut sky) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
    for p in placements {
        // 0: a portal's.
        put_varint(&mut numbers, p.grid_point.map_or(0, |g| 1 + u64::from(g)));
        put_varint(&mut numbers, p.images.len() as u64);
        put_runs(&mut culled, p.culled.runs());
        put_sky(&mut sky, &p.sky);
        let vectors = [p.cop, p.users.min, p.users.max];
        rows.push(std::array::from_fn(|k| if k < 9 { vectors[k / 3][k % 3] } else { p.footprint_px }));
    }
    put_rows::<PLACEMENT_NUMBERS>(w, "placement numbers", &rows)?;
    w.section("placements", &numbers)?;
    w.section("culled cells", &culled)?;
    w.section("sky", &sky)?;
    let images = match (placements.first(), placements.last()) {
        (Some(first), Some(last)) => &all[first.images.start as usize..last.images.end as usize],
        _ => &[],
    };
    let (mut rows, mut numbers) = (Vec::new(), Vec::new());
    for i in images {
        for list in [&i.chunks, &i.samples_by_layer] {
            put_varint(&mut numbers, list.len() as u64);
            list.iter().for_each(|&v| put_varint(&mut numbers, v.into()));
        }
        let b = [i.basis.right, i.basis.up, i.basis.forward];
        let rest = [i.plane_distance, i.window[0], i.window[1], i.window[2], i.window[3], i.stretch_p99_px];
        rows.push(std::array::from_fn(|k| if k < 9 { b[k / 3][k % 3] } else { rest[k - 9] }));
    }
    put_rows::<IMAGE_NUMBERS>(w, "image numbers", &rows)?;
    w.section("images", &numbers)
}

/// Rows of numbers, field by field: like numbers stand beside each other.
fn put_rows<const N: usize>(w: &mut Writer, field: &'static str, rows: &[[f64; N]]) -> Result<(), CodecError> {
    put_numbers(w, field, (0..N).flat_map(|k| rows.iter().map(move |row| row[k])))
}

fn take_rows<const N: usize>(r: &mut Reader<'_>, field: &'static str, n: usize) -> Result<Vec<[f64; N]>, CodecError> {
    let values = take_numbers(r, field, n.saturating_mul(N))?;
    Ok((0..n).map(|i| std::array::from_fn(|k| values[k * n + i])).collect())
}

/// Placements and images of a page; the images are numbered from `first_image` on.
fn take_placements(
    r: &mut Reader<'_>,
    n: usize,
    first_image: usize,
    decoded: &mut usize,
) -> Result<(Vec<Placement>, Vec<ImageEntry>), CodecError> {
    let vector = |row: &[f64], k: usize| DVec3::new(row[3 * k], row[3 * k + 1], row[3 * k + 2]);
    charge::<Placement>(decoded, "page count", n)?;
    let rows = take_rows::<PLACEMENT_NUMBERS>(r, "placement numbers", n)?;
    let mut numbers = Numbers::take(r, "placements")?;
    let mut culled = Numbers::take(r, "culled cells")?;
    let mut sky = Numbers::take(r, "sky")?;
    let mut placements = Vec::with_capacity(n);
    let mut total = 0;
    for row in &rows {
        let grid_point = numbers.next("placement point")?.checked_sub(1);
        let first = first_image + total;
        total += numbers.count("placement images", MAX_IMAGES)?;
        placements.push(Placement {
            grid_point,
            cop: vector(row, 0),
            users: Aabb { min: vector(row, 1), max: vector(row, 2) },
            footprint_px: row[9],
            culled: take_runs(&mut culled, "culled cells", decoded)?,
            images: first as u32..(first_image + total) as u32,
            sky: take_sky(&mut sky, decoded)?,
        });
    }
    numbers.finish("placements")?;
    culled.finish("culled cells")?;
    sky.finish("sky")?;
    charge::<ImageEntry>(decoded, "placement images", total)?;
    let rows = take_rows::<IMAGE_NUMBERS>(r, "image numbers", total)?;
    let mut numbers = Numbers::take(r, "images")?;
    let mut images = Vec::with_capacity(total);
    for row in &rows {
        let mut list = |field| -> Result<Vec<u32>, CodecError> {
            let count = numbers.count(field, 255)?;
            charge::<u32>(decoded, field, count)?;
            (0..count).map(|_| numbers.next(field)).collect()
        };
        images.push(ImageEntry {
            chunks: list("image chunks")?,
            samples_by_layer: list("image samples")?,
            basis: ViewBasis { right: vector(row, 0), up: vector(row, 1), forward: vector(row, 2) },
            plane_distance: row[9],
            window: [row[10], row[11], row[12], row[13]],
            stretch_p99_px: row[14],
        });
    }
    numbers.finish("images")?;
    Ok((placements, images))
}
