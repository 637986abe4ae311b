//! Which pixels of a layer hold a sample.
//!
//! Samples lie in row-major order, so occupancy is a list of runs of neighbouring columns. It is
//! written as three streams: runs per row, gap before each run, length of each run less one, all
//! LEB128. A dense layer is one run per row and costs next to nothing; a sparse one costs about
//! two bytes per run before zstd.

use super::{
    CodecError,
    bytes::{Reader, Writer, put_varint},
};
use crate::ldi::{LdiLayer, Segment};

/// Samples in neighbouring columns of one row; samples are numbered through in the order of runs.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) struct Run {
    pub row: u32,
    pub column: u32,
    pub count: u32,
}

/// Joins a layer's segments into runs. Fails on a layer whose arrays contradict each other.
pub(super) fn runs_of_layer(layer: &LdiLayer, width: u32, height: u32) -> Result<Vec<Run>, CodecError> {
    let bad = |reason: &str| CodecError::mismatch("segments", reason);
    let n = layer.disparity.len();
    if layer.column.len() != n || layer.rgb.len() != n || layer.links.len() != n || layer.ends.len() != n {
        return Err(bad("the layer's arrays differ in length"));
    }
    let mut runs: Vec<Run> = Vec::new();
    let mut next = 0;
    for s in &layer.segments {
        let (first, count) = (s.first as usize, usize::from(s.count));
        if first != next || count == 0 || count > 256 || first + count > n || u32::from(s.row) >= height {
            return Err(bad("a segment is out of order or out of range"));
        }
        next += count;
        for &offset in &layer.column[first..next] {
            let (row, column) = (u32::from(s.row), u32::from(s.column_base) + u32::from(offset));
            if column >= width {
                return Err(bad("a sample lies beyond the right border"));
            }
            match runs.last_mut() {
                Some(r) if r.row == row && r.column + r.count == column => r.count += 1,
                Some(r) if (r.row, r.column + r.count) > (row, column) => {
                    return Err(bad("samples are not in row-major order"));
                }
                _ => runs.push(Run { row, column, count: 1 }),
            }
        }
    }
    if next == n { Ok(runs) } else { Err(bad("they do not cover all samples")) }
}

/// The segments and column offsets of runs.
pub(super) fn segments_of_runs(runs: &[Run], samples: usize) -> (Vec<Segment>, Vec<u8>) {
    let mut segments: Vec<Segment> = Vec::new();
    let mut columns = Vec::with_capacity(samples);
    for run in runs {
        let end = run.column + run.count;
        let mut column = run.column;
        while column < end {
            let base = column & !255;
            let stop = end.min(base + 256);
            let (row, column_base, count) = (run.row as u16, base as u16, (stop - column) as u16);
            match segments.last_mut() {
                Some(s) if s.row == row && s.column_base == column_base => s.count += count,
                _ => segments.push(Segment { row, column_base, first: columns.len() as u32, count }),
            }
            columns.extend((column..stop).map(|c| (c - base) as u8));
            column = stop;
        }
    }
    (segments, columns)
}

/// The occupancy streams of all layers of a chunk.
#[derive(Default)]
pub(super) struct OccupancyWriter {
    runs_per_row: Vec<u8>,
    gaps: Vec<u8>,
    lengths: Vec<u8>,
}

impl OccupancyWriter {
    /// Appends one layer.
    pub fn layer(&mut self, runs: &[Run], height: u32) {
        let mut rest = runs;
        for row in 0..height {
            let (here, later) = rest.split_at(rest.partition_point(|r| r.row == row));
            rest = later;
            put_varint(&mut self.runs_per_row, here.len() as u64);
            let mut end = 0;
            for r in here {
                put_varint(&mut self.gaps, u64::from(r.column - end));
                put_varint(&mut self.lengths, u64::from(r.count - 1));
                end = r.column + r.count;
            }
        }
    }
    /// Writes the three sections.
    pub fn finish(self, w: &mut Writer) -> Result<(), CodecError> {
        w.section("runs per row", &self.runs_per_row)?;
        w.section("run gaps", &self.gaps)?;
        w.section("run lengths", &self.lengths)
    }
}

/// Reads the runs of every layer; `samples` gives how many samples each must hold.
pub(super) fn read_occupancy(
    r: &mut Reader<'_>,
    (width, height): (u32, u32),
    samples: &[usize],
) -> Result<Vec<Vec<Run>>, CodecError> {
    let total: usize = samples.iter().sum();
    // A LEB128 number below 2^14 takes at most two bytes, and a run holds at least one sample.
    let per_row = r.section("runs per row", samples.len() * height as usize * 2)?;
    let gaps = r.section("run gaps", total * 2)?;
    let lengths = r.section("run lengths", total * 2)?;
    let (mut per_row, mut gaps, mut lengths) = (Reader::new(&per_row), Reader::new(&gaps), Reader::new(&lengths));
    let mut layers = Vec::with_capacity(samples.len());
    for &n in samples {
        let mut runs = Vec::new();
        let mut left = n;
        for row in 0..height {
            let mut end = 0;
            for k in 0..per_row.count("runs per row", left.min(width as usize))? {
                let gap = gaps.count("run gaps", (width - end) as usize)? as u32;
                if gap == 0 && k > 0 {
                    return Err(CodecError::range("run gaps", 0, "runs of one row must not touch"));
                }
                let column = end + gap;
                let free = ((width - column) as usize).min(left);
                if free == 0 {
                    return Err(CodecError::mismatch("run lengths", "a run reaches past its row or its layer"));
                }
                let count = lengths.count("run lengths", free - 1)? as u32 + 1;
                left -= count as usize;
                end = column + count;
                runs.push(Run { row, column, count });
            }
        }
        if left > 0 {
            return Err(CodecError::mismatch("run lengths", format!("{left} samples of a layer have no place")));
        }
        layers.push(runs);
    }
    per_row.finish("runs per row")?;
    gaps.finish("run gaps")?;
    lengths.finish("run lengths")?;
    Ok(layers)
}
