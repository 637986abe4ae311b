//! What construction needs of a ray caster: rays against the culled subset only, planes, colours.
//!
//! A trait, so that the tests can judge construction on analytic scenes in f64, without triangles.

use crate::render::{Caster, CellSet, Hit, Ray, RayFootprint};
use glam::DVec3;
use ldi_protocol::CellRuns;

/// What a surface is like where a ray hit it.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Facet {
    /// Unit normal of the geometry (not interpolated) in the world, of either sign; zero if it has
    /// none.
    pub normal: DVec3,
    /// Number of the surface: equal for all hits on one primitive of one instance. Two surfaces
    /// may, rarely, share one.
    pub surface: u32,
}

/// What a ray meets first when nothing is transparent.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum Met {
    /// Nothing.
    Nothing,
    /// A cell that stays.
    Stays,
    /// A cell of the subset, at this depth, metres.
    Replaced(f64),
}

/// Casts rays at the culled subset. Cells that are not culled are transparent to it.
///
/// Directions have component 1 along the image's forward axis, so a hit's `t` is its depth in
/// metres. A hit's `triangle` names a plane: hits of one number lie in one plane (analytic scenes:
/// on one smooth patch).
pub trait SubsetCaster: Sync {
    /// Whether hits of one `triangle` share one plane; otherwise only one smooth patch.
    const PLANAR: bool = true;
    /// The nearest hit of each ray within its `[t_min, t_max]`; both slices have one length.
    fn trace(&self, rays: &[Ray], hits: &mut [Option<Hit>]);
    /// What each ray meets first of everything, cells that stay too; both slices have one length.
    fn meet(&self, rays: &[Ray], met: &mut [Met]);
    /// Whether the first that each ray meets of everything is a cell that stays; both slices have
    /// one length.
    fn hide(&self, rays: &[Ray], hidden: &mut [bool]) {
        let mut met = vec![Met::Nothing; rays.len()];
        self.meet(rays, &mut met);
        hidden.iter_mut().zip(met).for_each(|(hidden, met)| *hidden = met == Met::Stays);
    }
    /// The plane and the surface at a hit.
    fn facet(&self, ray: &Ray, hit: &Hit) -> Facet;
    /// Colour at a hit in linear light, textures filtered over the footprint.
    fn shade(&self, ray: &Ray, hit: &Hit, footprint: &RayFootprint) -> [f32; 3];
}

/// A [`Caster`] that sees only some cells. Made `with_mips`, or textures alias.
pub(super) struct Subset<'a> {
    pub caster: &'a Caster,
    pub cells: CellSet,
    /// All others.
    pub staying: CellSet,
    /// The cells.
    pub culled: &'a CellRuns,
}

impl<'a> Subset<'a> {
    /// Of some cells.
    pub fn of(caster: &'a Caster, culled: &'a CellRuns) -> Self {
        let cells = caster.cell_set(culled);
        Self { caster, staying: caster.cells_besides(&cells), cells, culled }
    }
}

impl SubsetCaster for Subset<'_> {
    fn trace(&self, rays: &[Ray], hits: &mut [Option<Hit>]) {
        self.caster.trace_batch(rays, &self.cells, hits);
    }

    fn meet(&self, rays: &[Ray], met: &mut [Met]) {
        let mut hits = vec![None; rays.len()];
        self.caster.trace_batch(rays, &CellSet::all(), &mut hits);
        for (met, hit) in met.iter_mut().zip(hits) {
            let replaced = |h: &Hit| self.culled.contains(self.caster.cell_of(h.triangle));
            *met = match hit {
                None => Met::Nothing,
                Some(h) if replaced(&h) => Met::Replaced(h.t),
                Some(_) => Met::Stays,
            };
        }
    }

    /// Some hit of what stays is found sooner than the nearest of all, and then it is a short way
    /// on which what is replaced may come first.
    fn hide(&self, rays: &[Ray], hidden: &mut [bool]) {
        // Depths of two hits are compared in f32.
        const BEYOND: f64 = 1.0 + 1e-5;
        let mut hits = vec![None; rays.len()];
        self.caster.trace_any(rays, &self.staying, &mut hits);
        hidden.iter_mut().zip(&hits).for_each(|(hidden, hit)| *hidden = hit.is_some());
        let before = |(number, hit): (usize, &Option<Hit>)| {
            hit.map(|h| (number, Ray { t_max: rays[number].t_max.min(h.t * BEYOND), ..rays[number] }))
        };
        let (numbers, before): (Vec<usize>, Vec<Ray>) = hits.iter().enumerate().filter_map(before).unzip();
        let mut hits = vec![None; before.len()];
        self.caster.trace_any(&before, &self.cells, &mut hits);
        for (number, _) in numbers.into_iter().zip(hits).filter(|(_, hit)| hit.is_some()) {
            let mut met = [Met::Nothing];
            self.meet(&rays[number..=number], &mut met);
            hidden[number] = met == [Met::Stays];
        }
    }

    fn facet(&self, ray: &Ray, hit: &Hit) -> Facet {
        let s = self.caster.surface(hit, ray);
        // Odd multipliers spread (instance, primitive) over 32 bits; two surfaces that collide may
        // be linked over a step.
        let surface = s.source.instance.wrapping_mul(0x9E37_79B1) ^ s.source.primitive.wrapping_mul(0x85EB_CA6B);
        Facet { normal: s.geometric_normal, surface }
    }

    fn shade(&self, ray: &Ray, hit: &Hit, footprint: &RayFootprint) -> [f32; 3] {
        self.caster.shade(hit, ray, Some(footprint))
    }
}
