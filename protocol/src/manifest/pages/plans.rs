//! Floor plans in the manifest: the cells of each plan in a section of its own, as differences to
//! the row before.

use super::{Numbers, charge, put_rows, take_rows};
use crate::{
    codec::{
        CodecError,
        bytes::{Reader, Writer, put_varint},
    },
    floor_plan::{FloorPlan, MAX_CELLS, MAX_PLANS, MAX_SIDE, cell_count},
};

/// Numbers of a plan: heights of floor, lowest ground and step, corner, pitch.
const PLAN_NUMBERS: usize = 6;

pub(super) fn put(w: &mut Writer, plans: &[FloorPlan]) -> Result<(), CodecError> {
    let row = |p: &FloorPlan| [p.floor_m, p.ground_m, p.step_m, p.corner[0], p.corner[1], p.pitch_m];
    put_rows::<PLAN_NUMBERS>(w, "plan numbers", &plans.iter().map(row).collect::<Vec<_>>())?;
    let mut numbers = Vec::new();
    for p in plans {
        p.size.iter().for_each(|n| put_varint(&mut numbers, (*n).into()));
        put_varint(&mut numbers, p.relief.into());
    }
    w.section("plans", &numbers)?;
    for p in plans {
        let width = p.size[0] as usize;
        let above = std::iter::repeat_n(&0, width).chain(&p.cells);
        let steps: Vec<u8> = p.cells.iter().zip(above).map(|(v, above)| v.wrapping_sub(*above)).collect();
        w.section("plan cells", &steps)?;
    }
    Ok(())
}

pub(super) fn take(r: &mut Reader<'_>, n: usize, decoded: &mut usize) -> Result<Vec<FloorPlan>, CodecError> {
    if n > MAX_PLANS {
        return Err(CodecError::range("floor plans", n, "there are at most 32"));
    }
    let rows = take_rows::<PLAN_NUMBERS>(r, "plan numbers", n)?;
    let mut numbers = Numbers::take(r, "plans")?;
    let mut plans = Vec::with_capacity(n);
    let mut left = MAX_CELLS;
    for [floor_m, ground_m, step_m, x, z, pitch_m] in rows {
        let mut side = || numbers.count("plan size", MAX_SIDE as usize).map(|n| n as u32);
        let size = [side()?, side()?];
        let relief = numbers.count("plan kind", 1)? == 1;
        let count = cell_count(size).ok_or_else(|| CodecError::range("plan size", size[0], "1 to 4,096 a side"))?;
        left = left
            .checked_sub(count)
            .ok_or_else(|| CodecError::range("plan cells", count, "all plans together have at most 2^22"))?;
        let cells = Vec::new();
        plans.push(FloorPlan { floor_m, ground_m, step_m, corner: [x, z], pitch_m, size, relief, cells });
    }
    numbers.finish("plans")?;
    for p in &mut plans {
        let width = p.size[0] as usize;
        let count = width * p.size[1] as usize;
        charge::<u8>(decoded, "plan cells", count)?;
        p.cells = r.section_of("plan cells", count)?;
        for at in width..count {
            p.cells[at] = p.cells[at].wrapping_add(p.cells[at - width]);
        }
    }
    Ok(plans)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Sizes of floor plans are checked before their cells are decoded.
    #[test]
    fn forged_floor_plans_are_refused() {
        let forged = |plans: &[[u64; 3]], cells: &[usize]| {
            let mut w = Writer::new(9).unwrap();
            w.section("plan numbers", &vec![0; plans.len() * 48]).unwrap();
            let mut numbers = Vec::new();
            plans.iter().flatten().for_each(|n| put_varint(&mut numbers, *n));
            w.section("plans", &numbers).unwrap();
            cells.iter().for_each(|n| w.section("plan cells", &vec![0; *n]).unwrap());
            let mut room = 16 << 20;
            take(&mut Reader::new(&w.bytes), plans.len(), &mut room)
        };
        assert_eq!(forged(&[[3, 2, 1]], &[6]).map(|p| p[0].cells.len()), Ok(6));
        let side = u64::from(MAX_SIDE);
        for (plans, cells) in [
            (vec![[0, 2, 0]], vec![0]),
            (vec![[side + 1, 1, 0]], vec![MAX_SIDE as usize + 1]),
            (vec![[side, side, 0]], vec![]),
            (vec![[3, 2, 2]], vec![6]),
            (vec![[3, 2, 0]], vec![5]),
            (vec![[3, 2, 0]], vec![7]),
            (vec![[2048, 2048, 0], [1, 1, 0]], vec![MAX_CELLS, 1]),
            (vec![[1, 1, 0]; 33], vec![1; 33]),
        ] {
            assert!(forged(&plans, &cells).is_err(), "{plans:?} {cells:?}");
        }
    }
}
