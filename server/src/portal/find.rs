//! Cells and portals of any scene, found: the steps in order.

use super::basins::{self, Basins, NONE};
use super::leaks::{self, Stand};
use super::openings::{self, Opening};
use super::storeys::{Ground, Storey};
use super::volumes::{self, Labelled, OUTSIDE, UNKNOWN, Volumes, id};
use crate::render::Caster;
use glam::DVec2;
use ldi_protocol::Aabb;
use ldi_protocol::rooms::{Cell, CellId, Portal, PortalKind, Rooms, RoomsError};
use serde::Serialize;
use std::collections::BTreeMap;
use std::time::Instant;

/// Places this close to a portal's plane belong to the side they lie on, metres.
const NEAR_PLANE_M: f64 = 0.7;
/// Margin of found rooms, in places of the raster.
pub(super) const MARGIN_PLACES: f64 = 1.5;
/// Rounds of looking for leaks.
const ROUNDS: u64 = 3;
/// Rays per round: for each m² so many, within bounds.
const RAYS_PER_M2: f64 = 500.0;
/// Rounds of joining rooms that have no border.
const JOINS: usize = 3;

/// What was found.
#[derive(Debug, Clone)]
pub struct FoundRooms {
    /// Cells and portals.
    pub rooms: Rooms,
    /// Figures.
    pub statistics: Statistics,
}

/// Figures of a search for rooms.
#[derive(Debug, Clone, Default, PartialEq, Serialize)]
pub struct Statistics {
    /// Edge of a place of the raster, metres.
    pub pitch_m: f64,
    /// Lowest level of each storey, metres.
    pub storeys_m: Vec<f64>,
    /// Cells.
    pub cells: usize,
    /// Portals by kind.
    pub portals: BTreeMap<String, usize>,
    /// Pairs of rooms that were joined, because sight between them has no plane.
    pub joined: usize,
    /// Rays of the last count.
    pub rays: usize,
    /// Of these, how many leave a cell beside all portals: what culling may miss.
    pub leaking_rays: usize,
    /// Why there are no cells.
    pub no_cells: Option<String>,
    /// Seconds per step.
    pub seconds: Vec<(&'static str, f64)>,
}

/// Finds the rooms of a scene within `bounds`: those of the scene, or, where a backdrop surrounds
/// it, of what people walk in. What lies beyond counts as outside.
///
/// # Errors
/// If what was found breaks a rule of [`Rooms::new`]: a fault of this program. A scene without
/// rooms gives none, with the reason.
pub fn find_rooms(caster: &Caster, bounds: &Aabb) -> Result<FoundRooms, RoomsError> {
    let mut statistics = Statistics::default();
    let nothing = |why: String, mut statistics: Statistics| {
        statistics.no_cells = Some(why);
        Ok(FoundRooms { rooms: Rooms::new(0.0, vec![], vec![])?, statistics })
    };
    let mut start = Instant::now();
    let mut lap = |statistics: &mut Statistics, what: &'static str| {
        statistics.seconds.push((what, start.elapsed().as_secs_f64()));
        start = Instant::now();
    };
    let ground = match Ground::new(caster, bounds) {
        Ok(ground) => ground,
        Err(why) => return nothing(why, statistics),
    };
    statistics.pitch_m = ground.raster.pitch_m;
    lap(&mut statistics, "surfaces");
    let storeys = ground.storeys(caster);
    statistics.storeys_m = storeys.iter().map(|s| s.base_m).collect();
    lap(&mut statistics, "free space");
    if storeys.is_empty() {
        return nothing("nowhere is a floor of 3 m² with head room".into(), statistics);
    }
    let mut basins: Vec<Basins> = storeys.iter().map(|s| basins::basins(&ground, s)).collect();
    lap(&mut statistics, "basins");
    let openings: Vec<Opening> = storeys
        .iter()
        .zip(&basins)
        .enumerate()
        .flat_map(|(n, (s, b))| openings::openings(caster, &ground, n, s, b))
        .collect();
    for (n, (s, b)) in storeys.iter().zip(&mut basins).enumerate() {
        let opens = |basin: u32| openings.iter().any(|o| o.storey == n && o.basins.contains(&basin));
        basins::drop_solids(caster, &ground, s, b, &opens);
    }
    lap(&mut statistics, "openings");
    let mut plan = Plan::new(&ground, &storeys, basins, openings);
    if plan.cells == 0 {
        // Solids have no places left, so they are no cells.
        return nothing("all free space is one with the outside: nothing narrow lies between".into(), statistics);
    }
    let found = plan.settle(caster, &mut statistics)?;
    lap(&mut statistics, "volumes and leaks");
    Ok(FoundRooms { rooms: found, statistics })
}

struct Plan<'a> {
    ground: &'a Ground,
    storeys: &'a [Storey],
    /// Labels per storey, where sight is free, and with walls.
    free: Vec<Vec<u32>>,
    filled: Vec<Vec<u32>>,
    openings: Vec<Portal>,
    cells: usize,
}

impl<'a> Plan<'a> {
    fn new(ground: &'a Ground, storeys: &'a [Storey], basins: Vec<Basins>, openings: Vec<Opening>) -> Self {
        let mut cells = 0;
        let mut label_of: Vec<Vec<u32>> = Vec::new();
        for b in &basins {
            let mut of_basin = |outside: &bool| {
                cells += u32::from(!outside);
                if *outside { OUTSIDE } else { cells - 1 }
            };
            label_of.push(b.outside.iter().map(&mut of_basin).collect());
        }
        let mut free: Vec<Vec<u32>> = basins
            .iter()
            .zip(&label_of)
            .map(|(b, labels)| b.of.iter().map(|b| if *b == NONE { UNKNOWN } else { labels[*b as usize] }).collect())
            .collect();
        let mut portals = Vec::new();
        for o in &openings {
            let labels = o.basins.map(|b| label_of[o.storey][b as usize]);
            straighten(ground, &mut free[o.storey], o, labels);
            portals.push(Portal { cells: labels.map(id), kind: o.kind, corners: o.corners.clone() });
        }
        let mut plan = Self { ground, storeys, free, filled: Vec::new(), openings: portals, cells: cells as usize };
        plan.renumber(&[]);
        plan
    }

    /// Joins cells, with each other or with the outside, and closes the gaps in their numbers.
    fn renumber(&mut self, joined: &[[u32; 2]]) {
        // The outside comes last.
        let outside = self.cells as u32;
        let mut root: Vec<u32> = (0..=outside).collect();
        let find = |root: &[u32], mut c: u32| {
            while root[c as usize] != c {
                c = root[c as usize];
            }
            c
        };
        for pair in joined {
            let [a, b] = pair.map(|label| find(&root, label.min(outside)));
            let (kept, gone) = if b == outside { (b, a) } else { (a, b) };
            root[gone as usize] = kept;
        }
        let mut places = vec![0u32; self.cells + 1];
        for label in self.free.iter().flatten().filter(|l| **l < OUTSIDE) {
            places[find(&root, *label) as usize] += 1;
        }
        let mut number = vec![UNKNOWN; self.cells + 1];
        number[outside as usize] = OUTSIDE;
        let mut cells = 0;
        for c in 0..self.cells {
            if places[c] > 0 {
                number[c] = cells;
                cells += 1;
            }
        }
        let new = |label: u32| if label < outside { number[find(&root, label) as usize] } else { label };
        self.free.iter_mut().flatten().for_each(|l| *l = new(*l));
        for p in &mut self.openings {
            p.cells = p.cells.map(|c| c.and_then(|c| id(new(c))));
        }
        self.openings.retain(|p| p.cells[0] != p.cells[1]);
        self.cells = cells as usize;
        self.filled = self.free.clone();
        self.filled.iter_mut().for_each(|l| volumes::fill(self.ground, l));
    }

    /// Volumes, hatches and gaps, until every room has a border.
    fn settle(&mut self, caster: &Caster, statistics: &mut Statistics) -> Result<Rooms, RoomsError> {
        for join in 0..=JOINS {
            let (volumes, hatches) = self.volumes();
            let sure: Vec<Portal> = self.openings.iter().chain(&hatches).cloned().collect();
            let mut portals = sure.clone();
            let stands = self.stands();
            let area_m2 = stands.len() as f64 * self.ground.raster.pitch_m.powi(2);
            let rays = (area_m2 * RAYS_PER_M2).clamp(100_000.0, 2_000_000.0) as usize;
            let look = |portals: &[Portal], round: u64| {
                leaks::leaks(caster, self.ground, &volumes, &stands, portals, rays, round << 40)
            };
            let (mut seen, mut joined) = (Vec::new(), Vec::new());
            for round in 0..ROUNDS {
                // All leaks again, so that what two rounds find of one gap becomes one portal.
                seen.extend(look(&portals, round));
                let gaps;
                (gaps, joined) = leaks::gaps(seen.clone());
                portals.truncate(sure.len());
                portals.extend(gaps);
            }
            let floor_m2 = self.floor_m2();
            joined.retain(|[a, b]| *b < OUTSIDE || unmeant_m2(&portals, id(*a)) > floor_m2[*a as usize]);
            if !joined.is_empty() && join < JOINS {
                statistics.joined += joined.len();
                self.renumber(&joined);
                continue;
            }
            let left = look(&portals, ROUNDS + 7);
            (statistics.rays, statistics.leaking_rays) = (rays, left.len());
            let mut cells: Vec<Cell> =
                (0..self.cells).map(|_| Cell { name: String::new(), boxes: Vec::new() }).collect();
            volumes.boxes(self.ground, &mut cells);
            return rooms(cells, portals, MARGIN_PLACES * self.ground.raster.pitch_m, statistics);
        }
        unreachable!("the last round returns")
    }

    fn volumes(&self) -> (Volumes, Vec<Portal>) {
        let labelled: Vec<Labelled> = self
            .storeys
            .iter()
            .zip(self.free.iter().zip(&self.filled))
            .map(|(storey, (free, filled))| Labelled { storey, free, filled })
            .collect();
        Volumes::new(self.ground, &labelled, self.cells)
    }

    /// Area of each cell in plan, all its storeys together.
    fn floor_m2(&self) -> Vec<f64> {
        let mut places = vec![0u32; self.cells];
        self.free.iter().flatten().filter(|l| **l < OUTSIDE).for_each(|l| places[*l as usize] += 1);
        places.into_iter().map(|n| f64::from(n) * self.ground.raster.pitch_m.powi(2)).collect()
    }

    /// Where somebody can stand in a room.
    fn stands(&self) -> Vec<Stand> {
        let mut out = Vec::new();
        for (s, free) in self.storeys.iter().zip(&self.free) {
            for place in (0..free.len()).filter(|p| free[*p] < OUTSIDE && s.real[*p]) {
                out.push(Stand { place, floor_m: f64::from(s.floor_m[place]) });
            }
        }
        out
    }
}

/// Area of all gaps between a cell and the outside: larger than its floor, it is a part of the
/// outside, as a terrace between columns is.
fn unmeant_m2(portals: &[Portal], cell: CellId) -> f64 {
    let gaps = portals.iter().filter(|p| p.kind == PortalKind::Gap && p.beyond(cell) == Some(None));
    gaps.map(Portal::area_m2).sum()
}

/// Gives places close to a portal's plane the label of the side they lie on: the flood's border is
/// ragged, the portal is not.
fn straighten(ground: &Ground, free: &mut [u32], o: &Opening, labels: [u32; 2]) {
    let along = DVec2::new(o.normal.y, -o.normal.x);
    let pitch = ground.raster.pitch_m;
    let around = ((NEAR_PLANE_M + o.reach_m[0].max(o.reach_m[1])) / pitch).ceil() as i64 + 1;
    let Some(middle) = ground.place(o.middle) else { return };
    let w = ground.width() as i64;
    let (i0, k0) = (middle as i64 % w, middle as i64 / w);
    for k in (k0 - around).max(0)..=(k0 + around).min(i64::from(ground.raster.size[1]) - 1) {
        for i in (i0 - around).max(0)..=(i0 + around).min(w - 1) {
            let p = (k * w + i) as usize;
            if !labels.contains(&free[p]) {
                continue;
            }
            let d = ground.middle(p) - o.middle;
            let (u, n) = (d.dot(along), d.dot(o.normal));
            if n.abs() <= NEAR_PLANE_M && u >= -o.reach_m[0] - 0.05 && u <= o.reach_m[1] + 0.05 {
                free[p] = labels[usize::from(n > 0.0)];
            }
        }
    }
}

/// Drops cells without a box, names the others, from below to above and along the plan.
fn rooms(
    cells: Vec<Cell>,
    mut portals: Vec<Portal>,
    margin_m: f64,
    statistics: &mut Statistics,
) -> Result<Rooms, RoomsError> {
    let mut order: Vec<usize> = (0..cells.len()).filter(|c| !cells[*c].boxes.is_empty()).collect();
    let key = |c: usize| {
        let b = cells[c].bounds();
        let m = b.centre();
        ((b.min.y / 1.5).round() as i64, (m.z / 2.0).round() as i64, (m.x * 100.0) as i64, c)
    };
    order.sort_by_key(|c| key(*c));
    let mut number = vec![None; cells.len()];
    for (n, c) in order.iter().enumerate() {
        number[*c] = Some(n as u32);
    }
    portals.retain_mut(|p| {
        let there = p.cells.iter().flatten().all(|c| number[*c as usize].is_some());
        p.cells = p.cells.map(|c| c.and_then(|c| number[c as usize]));
        there && ldi_protocol::rooms::is_flat_convex(&p.corners)
    });
    let named = order.iter().enumerate().map(|(n, c)| Cell { name: format!("room {}", n + 1), ..cells[*c].clone() });
    statistics.cells = order.len();
    for p in &portals {
        let name = match p.kind {
            PortalKind::Door => "door",
            PortalKind::Window => "window",
            PortalKind::Hatch => "hatch",
            PortalKind::Gap => "gap",
            PortalKind::Given => "given",
        };
        *statistics.portals.entry(name.into()).or_default() += 1;
    }
    Rooms::new(margin_m, named.collect(), portals)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::placement::test_scenes::{block, scene_of};
    use glam::DVec3;
    use ldi_protocol::Aabb;
    use std::sync::Arc;

    /// Three rooms of 4 by 4 m in a row, closed but for doors of 1 m between them.
    fn row(ground: &Ground, caster: &Caster, check: impl FnOnce(&mut Plan)) {
        let storeys = ground.storeys(caster);
        let basins: Vec<Basins> = storeys.iter().map(|s| basins::basins(ground, s)).collect();
        let openings = openings::openings(caster, ground, 0, &storeys[0], &basins[0]);
        check(&mut Plan::new(ground, &storeys, basins, openings));
    }

    #[test]
    fn a_room_that_joins_the_outside_is_outside() {
        let mut blocks = Vec::new();
        let mut add = |a: [f64; 3], b: [f64; 3]| blocks.push(block(&Aabb { min: DVec3::from(a), max: DVec3::from(b) }));
        add([-0.2, -0.2, -0.2], [12.6, 0.0, 4.2]);
        add([-0.2, 2.8, -0.2], [12.6, 3.0, 4.2]);
        add([-0.2, 0.0, -0.2], [12.6, 2.8, 0.0]);
        add([-0.2, 0.0, 4.0], [12.6, 2.8, 4.2]);
        add([-0.2, 0.0, 0.0], [0.0, 2.8, 4.0]);
        add([12.4, 0.0, 0.0], [12.6, 2.8, 4.0]);
        for x in [4.0, 8.2] {
            add([x, 0.0, 0.0], [x + 0.2, 2.8, 1.5]);
            add([x, 0.0, 2.5], [x + 0.2, 2.8, 4.0]);
            add([x, 2.1, 1.5], [x + 0.2, 2.8, 2.5]);
        }
        let caster = Caster::of_scene(Arc::new(scene_of(&blocks)), false);
        let ground = Ground::new(&caster, &caster.scene().bounds()).unwrap();
        row(&ground, &caster, |plan| {
            assert_eq!((plan.cells, plan.openings.len()), (3, 2));
            let label = |plan: &Plan, x: f64| plan.free[0][ground.place(DVec2::new(x, 2.0)).unwrap()];
            let [west, middle, east] = [2.0, 6.0, 10.0].map(|x| label(plan, x));
            assert!((plan.floor_m2()[middle as usize] - 16.0).abs() < 1.5, "{:?}", plan.floor_m2());
            // The western room is the outside's, and what joins it later is, too.
            plan.renumber(&[[west, OUTSIDE]]);
            assert_eq!((plan.cells, label(plan, 2.0)), (2, OUTSIDE));
            let [middle, east] = [middle, east].map(|old| old - u32::from(old > west));
            assert_eq!([label(plan, 6.0), label(plan, 10.0)], [middle, east]);
            let mut between: Vec<_> = plan.openings.iter().map(|p| p.cells).collect();
            between.iter_mut().for_each(|p| p.sort_unstable());
            between.sort_unstable();
            assert_eq!(between, [[None, Some(middle)], [Some(0), Some(1)]]);
            plan.renumber(&[[middle.min(east), middle.max(east)], [middle, OUTSIDE]]);
            assert_eq!((plan.cells, plan.openings.len(), label(plan, 10.0)), (0, 0, OUTSIDE));
        });
    }
}
