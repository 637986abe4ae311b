//! Found rooms against annotated ones.
//!
//! Two cells match if each is what overlaps the other most and they share half of their union. Two
//! portals match if their centres lie within [`CENTRE_M`], they face the same way, their areas
//! agree within a factor of [`AREA`], and their cells match. Each counts once: `found` pairs,
//! `missed` ones of the annotation, `invented` ones of what was found.

use ldi_protocol::Aabb;
use ldi_protocol::rooms::{CellId, Rooms};
use serde::Serialize;

/// Share of the union that matching cells have in common, at least.
const OVERLAP: f64 = 0.5;
/// Farthest that centres of matching portals lie apart, metres.
const CENTRE_M: f64 = 0.3;
/// Largest ratio of the areas of matching portals.
const AREA: f64 = 1.4;

/// What was found of what is annotated.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct Comparison {
    /// Pairs of cells: (annotated, found).
    pub cells_found: Vec<(String, String)>,
    /// Annotated cells without a match.
    pub cells_missed: Vec<String>,
    /// Found cells without a match.
    pub cells_invented: Vec<String>,
    /// Pairs of portals, by their positions: (annotated, found).
    pub portals_found: Vec<(u32, u32)>,
    /// Annotated portals without a match.
    pub portals_missed: Vec<u32>,
    /// Found portals without a match.
    pub portals_invented: Vec<u32>,
    /// Of matching portals: largest distance of a corner of the annotation to the found polygon's
    /// plane or outline, metres.
    pub corner_error_max_m: f64,
}

fn common_m3(a: &[Aabb], b: &[Aabb]) -> f64 {
    let one = |a: &Aabb, b: &Aabb| {
        let size = a.max.min(b.max) - a.min.max(b.min);
        size.max(glam::DVec3::ZERO).element_product()
    };
    a.iter().map(|a| b.iter().map(|b| one(a, b)).sum::<f64>()).sum()
}

/// Compares `found` with `annotated`.
pub fn compare(annotated: &Rooms, found: &Rooms) -> Comparison {
    let volume = |r: &Rooms| -> Vec<f64> {
        r.cells().iter().map(|c| c.boxes.iter().map(|b| b.size().element_product()).sum()).collect()
    };
    let (va, vf) = (volume(annotated), volume(found));
    let shares: Vec<Vec<f64>> = annotated
        .cells()
        .iter()
        .zip(&va)
        .map(|(a, va)| {
            let share = |(f, vf): (&ldi_protocol::rooms::Cell, &f64)| {
                let common = common_m3(&a.boxes, &f.boxes);
                common / (va + vf - common)
            };
            found.cells().iter().zip(&vf).map(share).collect()
        })
        .collect();
    let mut out = Comparison::default();
    let mut match_of: Vec<Option<u32>> = vec![None; annotated.cells().len()];
    let mut taken = vec![false; found.cells().len()];
    for (a, row) in shares.iter().enumerate() {
        let Some(f) = (0..row.len()).max_by(|x, y| row[*x].total_cmp(&row[*y])) else { continue };
        let best_for_f = (0..shares.len()).max_by(|x, y| shares[*x][f].total_cmp(&shares[*y][f]));
        if row[f] >= OVERLAP && best_for_f == Some(a) {
            match_of[a] = Some(f as u32);
            taken[f] = true;
            out.cells_found.push((annotated.cells()[a].name.clone(), found.cells()[f].name.clone()));
        }
    }
    let name = |r: &Rooms, c: usize| r.cells()[c].name.clone();
    out.cells_missed = (0..match_of.len()).filter(|a| match_of[*a].is_none()).map(|a| name(annotated, a)).collect();
    out.cells_invented = (0..taken.len()).filter(|f| !taken[*f]).map(|f| name(found, f)).collect();
    let mut used = vec![false; found.portals().len()];
    for (i, a) in annotated.portals().iter().enumerate() {
        let cell = |c: CellId| c.map_or(Some(None), |c| match_of[c as usize].map(Some));
        let wanted = [cell(a.cells[0]), cell(a.cells[1])];
        let same = |f: &ldi_protocol::rooms::Portal| {
            let has = |w: Option<CellId>| w.is_some_and(|w| f.cells.contains(&w));
            let ratio = f.area_m2() / a.area_m2();
            f.centre().distance(a.centre()) <= CENTRE_M
                && f.normal().dot(a.normal()).abs() > 0.9
                && (1.0 / AREA..=AREA).contains(&ratio)
                && wanted.iter().all(|w| has(*w))
        };
        let match_at = (0..used.len()).find(|f| !used[*f] && same(&found.portals()[*f]));
        match match_at {
            Some(f) => {
                used[f] = true;
                let error = a.corners.iter().map(|c| found.portals()[f].distance_m(*c)).fold(0.0, f64::max);
                out.corner_error_max_m = out.corner_error_max_m.max(error);
                out.portals_found.push((i as u32, f as u32));
            }
            None => out.portals_missed.push(i as u32),
        }
    }
    out.portals_invented = (0..used.len() as u32).filter(|f| !used[*f as usize]).collect();
    out
}
