//! Levels of detail in the manifest: behind the cells of a page.
//!
//! A chunk holds the levels of neighbouring cells: its number and its instances mostly go on from
//! the cell before that has as coarse a level.

use super::{Numbers, charge, put_ascending, take_ascending};
use crate::{
    codec::{
        CodecError,
        bytes::{Reader, Writer, put_varint, unzigzag, zigzag},
    },
    index::{CellEntry, CellLevel, MOST_LEVELS},
};

pub(super) fn put(w: &mut Writer, cells: &[CellEntry]) -> Result<(), CodecError> {
    let (mut numbers, mut deviations) = (Vec::new(), Vec::new());
    let mut before = LevelBefore::default();
    for c in cells {
        if c.levels.len() > MOST_LEVELS {
            return Err(CodecError::range("levels", c.levels.len(), "a cell has at most 32"));
        }
        put_varint(&mut numbers, c.levels.len() as u64);
        for (k, level) in c.levels.iter().enumerate() {
            let stored = level.deviation_m as f32;
            if f64::from(stored) != level.deviation_m {
                return Err(CodecError::range("deviation", level.deviation_m, "it must be an f32 value"));
            }
            deviations.push(stored.to_le_bytes());
            let (chunk, next) = before.of(k);
            put_varint(&mut numbers, level.triangles.into());
            put_varint(&mut numbers, zigzag(i64::from(level.chunk) - i64::from(*chunk)));
            put_varint(&mut numbers, zigzag(i64::from(level.instances.start) - i64::from(*next)));
            put_varint(&mut numbers, u64::from(level.instances.end.saturating_sub(level.instances.start)));
            (*chunk, *next) = (level.chunk, level.instances.end);
            put_ascending(&mut numbers, &level.bundles);
        }
    }
    let planes: Vec<u8> = (0..4).flat_map(|b| deviations.iter().map(move |d| d[b])).collect();
    w.section("levels", &numbers)?;
    w.section("deviations", &planes)
}

pub(super) fn take(r: &mut Reader<'_>, cells: &mut [CellEntry], decoded: &mut usize) -> Result<(), CodecError> {
    let mut numbers = Numbers::take(r, "levels")?;
    let mut before = LevelBefore::default();
    for c in &mut *cells {
        let count = numbers.count("levels", MOST_LEVELS)?;
        charge::<CellLevel>(decoded, "levels", count)?;
        c.levels.reserve_exact(count);
        for k in 0..count {
            let (chunk, next) = before.of(k);
            let triangles = numbers.next("level triangles")?;
            *chunk = moved(*chunk, numbers.next("level chunk")?, "level chunk")?;
            let start = moved(*next, numbers.next("level instances")?, "level instances")?;
            *next = start
                .checked_add(numbers.next("level instances")?)
                .ok_or_else(|| CodecError::range("level instances", start, "numbers have 32 bits"))?;
            let (chunk, instances) = (*chunk, start..*next);
            let bundles = take_ascending(&mut numbers, "level bundles", decoded)?;
            c.levels.push(CellLevel { deviation_m: 0.0, triangles, chunk, instances, bundles });
        }
    }
    numbers.finish("levels")?;
    let n = cells.iter().map(|c| c.levels.len()).sum::<usize>();
    let planes = r.section_of("deviations", n * 4)?;
    let levels = cells.iter_mut().flat_map(|c| &mut c.levels);
    for (i, level) in levels.enumerate() {
        level.deviation_m = f64::from(f32::from_le_bytes(std::array::from_fn(|b| planes[b * n + i])));
    }
    Ok(())
}

/// A number that is told by how far it lies from one before.
fn moved(from: u32, by: u32, field: &'static str) -> Result<u32, CodecError> {
    let to = i64::from(from) + unzigzag(u64::from(by));
    u32::try_from(to).map_err(|_| CodecError::range(field, to, "numbers have 32 bits"))
}

/// Chunk and end of instances of the last cell with such a level, level by level.
#[derive(Default)]
struct LevelBefore([(u32, u32); MOST_LEVELS]);

impl LevelBefore {
    fn of(&mut self, level: usize) -> (&mut u32, &mut u32) {
        let (chunk, next) = &mut self.0[level.min(MOST_LEVELS - 1)];
        (chunk, next)
    }
}
