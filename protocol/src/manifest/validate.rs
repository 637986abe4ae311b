//! The rules of an index. Whatever passes here can be used without looking: every number names
//! something that exists and every value that arithmetic depends on is finite.

use crate::{
    Aabb, ViewBasis,
    codec::{CodecError, texture},
    floor_plan::{FloorPlan, MAX_CELLS, MAX_PLANS},
    index::{BuildSettings, CellEntry, ChunkEntry, ChunkKind, GridPoint, ImageEntry, Index, Placement, TextureEntry},
    ldi::Ldi,
    mesh::{Alpha, Material},
    texture::level_count,
    tree::Tree,
};

/// Longest chunk, stored or decoded: what a reader may be asked to hold at once.
const MAX_CHUNK_BYTES: u32 = 1 << 30;
/// Most levels of grid subdivision.
const MAX_LEVEL: u8 = 64;

/// Checks an index: chunk, cell, material, texture, point and placement numbers in range and of
/// the right kind; lists ascending; bounds, bases, radii and distances finite; yaw ranges in
/// [0, 360) and ascending; pitch bands ascending.
///
/// # Errors
/// The first broken rule, with the entry's number.
pub fn validate(index: &Index) -> Result<(), CodecError> {
    check_scene(index)?;
    each("chunk", &index.chunks, check_chunk)?;
    let is = |chunk: u32, kind: ChunkKind| index.has_chunk(chunk, kind);
    each("material", &index.materials, |m| check_material(m, index.textures.len()))?;
    each("texture", &index.textures, |t| {
        check_texture_levels(t)?;
        t.chunks.iter().try_for_each(|c| is(c.chunk, ChunkKind::Texture))
    })?;
    each("cell", &index.cells, |c| {
        check_box(&c.bounds)?;
        is(c.chunk, ChunkKind::Cell)?;
        ascending("bundles", &c.bundles, index.chunks.len())?;
        c.bundles.iter().try_for_each(|&b| is(b, ChunkKind::Bundle))?;
        for level in &c.levels {
            is(level.chunk, ChunkKind::Levels)?;
            ascending("bundles of a level", &level.bundles, index.chunks.len())?;
            level.bundles.iter().try_for_each(|&b| is(b, ChunkKind::Bundle))?;
        }
        check_levels(c)?;
        if c.texel_density.len() != c.materials.len() {
            return Err("texel densities: there must be one per material".into());
        }
        ascending("materials", &c.materials, index.materials.len())
    })?;
    let bands = &index.pitch_bands_deg;
    if bands.len() == 1 || bands.windows(2).any(|w| w[0] >= w[1]) || bands.iter().any(|b| !(-90.0..=90.0).contains(b)) {
        return Err(CodecError::mismatch("pitch bands", "borders must ascend within -90 to 90 degrees"));
    }
    each("grid point", &index.points, |p| check_point(p, bands.len().saturating_sub(1), index.placements.len()))?;
    each("placement", &index.placements, |p| check_placement(p, index.points.len(), index.cells.len()))?;
    check_images_of(&index.placements, index.images.len())?;
    each("image", &index.images, |i| {
        check_image(i)?;
        i.chunks.iter().try_for_each(|&c| is(c, ChunkKind::Ldi))
    })?;
    check_plans(&index.plans)?;
    index.rooms.iter().try_for_each(|r| {
        r.check(index.cells.len(), &index.placements).map_err(|why| CodecError::mismatch("rooms", why))
    })?;
    index.tree.iter().try_for_each(|t| check_tree(index, t, t.broods().map(|(chunk, _)| chunk)))
}

/// Plans are few, and their cells together too.
fn check_plans(plans: &[FloorPlan]) -> Result<(), CodecError> {
    each("floor plan", plans, |p| Ok(p.check()?))?;
    let cells: usize = plans.iter().map(|p| p.cells.len()).sum();
    if plans.len() > MAX_PLANS || cells > MAX_CELLS {
        return Err(CodecError::range("floor plans", plans.len(), "at most 32 with 2^22 cells in all"));
    }
    Ok(())
}

/// The index of a first picture ([`super::early()`]): what it has keeps the rules of [`validate`].
pub(super) fn validate_early(index: &Index) -> Result<(), CodecError> {
    check_scene(index)?;
    index.tree.iter().try_for_each(|t| {
        check_tree(index, t, t.pinned_chunks())?;
        let known = |c: &u32| index.chunks.get(*c as usize);
        each("chunk", &t.pinned_chunks().collect::<Vec<_>>(), |c| known(c).map_or(Ok(()), check_chunk))
    })
}

fn check_scene(index: &Index) -> Result<(), CodecError> {
    check_settings(&index.settings)?;
    let scene = &index.scene.bounds;
    let finite = scene.min.is_finite() && scene.max.is_finite();
    if !scene.is_empty() && !finite {
        return Err(CodecError::mismatch("scene bounds", "they are not finite"));
    }
    Ok(())
}

/// Levels grow coarser: `select` looks for the last one that is good enough.
fn check_levels(c: &CellEntry) -> Result<(), String> {
    let (mut deviation_m, mut triangles) = (0.0, c.triangles);
    for level in &c.levels {
        let is_coarser = level.deviation_m >= deviation_m && level.deviation_m.is_finite();
        if !is_coarser || level.triangles >= triangles || level.instances.start > level.instances.end {
            return Err("its levels do not get coarser one by one".into());
        }
        (deviation_m, triangles) = (level.deviation_m, level.triangles);
    }
    Ok(())
}

fn check_chunk(c: &ChunkEntry) -> Result<(), String> {
    if c.kind == ChunkKind::Page {
        return Err("pages are not in the chunk table".into());
    }
    let most = c.stored_bytes.max(c.decoded_bytes);
    if most > MAX_CHUNK_BYTES { Err(format!("{most} bytes; chunks have at most 2^30")) } else { Ok(()) }
}

/// The tree keeps its rules, and these chunks of it are there.
fn check_tree(index: &Index, tree: &Tree, mut chunks: impl Iterator<Item = u32>) -> Result<(), CodecError> {
    tree.check()
        .and_then(|()| chunks.try_for_each(|c| index.has_chunk(c, ChunkKind::Tree)))
        .map_err(|why| CodecError::mismatch("tree", why))
}

impl Index {
    /// There is such a chunk, and it is of this kind.
    fn has_chunk(&self, chunk: u32, kind: ChunkKind) -> Result<(), String> {
        match self.chunks.get(chunk as usize) {
            Some(c) if c.kind == kind => Ok(()),
            Some(c) => Err(format!("chunk {chunk} is of kind {:?}, not {kind:?}", c.kind)),
            None => Err(format!("there is no chunk {chunk}")),
        }
    }
}

/// Runs a check over entries and names the entry in the error.
fn each<T>(field: &'static str, entries: &[T], check: impl Fn(&T) -> Result<(), String>) -> Result<(), CodecError> {
    entries
        .iter()
        .enumerate()
        .try_for_each(|(i, e)| check(e).map_err(|reason| CodecError::mismatch(field, format!("number {i}: {reason}"))))
}

/// Every number is below `limit` and larger than the one before.
fn ascending(what: &str, list: &[u32], limit: usize) -> Result<(), String> {
    if list.windows(2).any(|w| w[0] >= w[1]) {
        return Err(format!("its {what} do not ascend"));
    }
    match list.last() {
        Some(&last) if last as usize >= limit => Err(format!("its {what} include {last}, but there are only {limit}")),
        _ => Ok(()),
    }
}

fn check_box(b: &Aabb) -> Result<(), String> {
    if b.min.is_finite() && b.max.is_finite() && !b.is_empty() {
        Ok(())
    } else {
        Err("its bounds are empty or not finite".into())
    }
}

fn check_settings(s: &BuildSettings) -> Result<(), CodecError> {
    let positive = |v: f64| v > 0.0 && v.is_finite();
    let c = &s.camera;
    let sides = 1..=65_536;
    let sees = c.fov_deg > 0.0 && c.fov_deg < 180.0;
    if !sides.contains(&c.width) || !sides.contains(&c.height) || !sees {
        return Err(CodecError::range(
            "camera",
            format!("{c:?}"),
            "it needs pixels and a field of view below 180 degrees",
        ));
    }
    if !positive(s.max_footprint_px) || !positive(s.density) || !(0.0..=90.0).contains(&s.pitch_deg) {
        return Err(CodecError::mismatch("settings", "footprint and density must be positive, pitch 0 to 90 degrees"));
    }
    if !(s.max_deviation_px >= 0.0 && s.max_deviation_px.is_finite()) {
        return Err(CodecError::range("deviation", s.max_deviation_px, "0 or more, finite"));
    }
    if s.eye_height_m.is_some_and(|h| !h.is_finite()) {
        return Err(CodecError::mismatch("settings", "the eye height is not finite"));
    }
    Ok(())
}

fn check_material(m: &Material, textures: usize) -> Result<(), String> {
    let cutoff = if let Alpha::Mask(cutoff) = m.alpha { cutoff } else { 0.0 };
    if !m.base_colour.iter().chain([&cutoff]).all(|x| x.is_finite()) {
        return Err("its colour or cutoff is not finite".into());
    }
    match m.texture {
        Some(t) if t as usize >= textures => Err(format!("there is no texture {t}")),
        _ => Ok(()),
    }
}

/// A texture's chunks hold every level once, coarse ones first.
fn check_texture_levels(t: &TextureEntry) -> Result<(), String> {
    let sides = 1..=texture::MAX_SIDE;
    if !sides.contains(&t.width) || !sides.contains(&t.height) {
        return Err(format!("{} x {} texels; sides are 1 to 16384", t.width, t.height));
    }
    let mut finest_so_far = level_count(t.width, t.height);
    for c in &t.chunks {
        if c.first_level > c.last_level || u32::from(c.last_level) + 1 != finest_so_far {
            return Err("its chunks do not follow each other from the coarsest level on".into());
        }
        finest_so_far = c.first_level.into();
    }
    if finest_so_far == 0 { Ok(()) } else { Err("its chunks leave out the finest levels".into()) }
}

fn check_point(p: &GridPoint, bands: usize, placements: usize) -> Result<(), String> {
    if !p.position.is_finite() || !p.radius.is_finite() || p.radius < 0.0 || p.level > MAX_LEVEL {
        return Err("its position, radius or level is out of range".into());
    }
    if p.bands.len() > bands {
        return Err(format!("{} pitch bands, but there are only {bands}", p.bands.len()));
    }
    for band in &p.bands {
        if band.iter().any(|r| !(0.0..360.0).contains(&r.yaw_start_deg)) {
            return Err("a yaw range starts outside 0 to 360 degrees".into());
        }
        if band.windows(2).any(|w| w[0].yaw_start_deg >= w[1].yaw_start_deg) {
            return Err("its yaw ranges do not ascend".into());
        }
        if let Some(k) = band.iter().filter_map(|r| r.placement).find(|&k| k as usize >= placements) {
            return Err(format!("there is no placement {k}"));
        }
    }
    Ok(())
}

fn check_placement(p: &Placement, points: usize, cells: usize) -> Result<(), String> {
    if let Some(point) = p.grid_point.filter(|g| *g as usize >= points) {
        return Err(format!("there is no grid point {point}"));
    }
    check_box(&p.users)?;
    if !p.cop.is_finite() || !p.footprint_px.is_finite() {
        return Err("its centre of projection or footprint is not finite".into());
    }
    match p.culled.last() {
        Some(last) if last as usize >= cells => {
            Err(format!("its culled cells include {last}, but there are only {cells}"))
        }
        _ => Ok(()),
    }
}

/// Placements own all images, in order.
fn check_images_of(placements: &[Placement], images: usize) -> Result<(), CodecError> {
    let mut next = 0;
    for p in placements {
        if p.images.start != next || p.images.end < next {
            return Err(CodecError::mismatch("placement", "its images do not follow those of the one before"));
        }
        next = p.images.end;
    }
    if next as usize == images {
        Ok(())
    } else {
        Err(CodecError::mismatch("image", format!("{images} images, but placements have {next}")))
    }
}

fn check_image(i: &ImageEntry) -> Result<(), String> {
    check_basis(&i.basis)?;
    let window = &i.window;
    if !i.plane_distance.is_finite() || i.stretch_p99_px.is_infinite() || window.iter().any(|w| !w.is_finite()) {
        return Err("its plane distance, window or stretch is not finite".into());
    }
    if i.chunks.len() > 2 || i.samples_by_layer.len() > Ldi::MAX_LAYERS {
        return Err("more than two chunks or 32 layers".into());
    }
    Ok(())
}

fn check_basis(b: &ViewBasis) -> Result<(), String> {
    let off = |v: f64, wanted: f64| (v - wanted).abs() <= 1e-6;
    let unit =
        off(b.right.length_squared(), 1.0) && off(b.up.length_squared(), 1.0) && off(b.forward.length_squared(), 1.0);
    let right_angles = off(b.right.dot(b.up), 0.0) && off(b.up.dot(b.forward), 0.0) && off(b.forward.dot(b.right), 0.0);
    if unit && right_angles { Ok(()) } else { Err("its basis is not orthonormal".into()) }
}
