//! What the images of a plan will take, found out by making a few of them.
//!
//! In: the placements of a plan. Out: a [`Forecast`]. The placements that are made for it are kept
//! like all others, so that nothing is done twice.

use super::{BuildError, Progress, choose::pixels_of, images};
use crate::placement::PlacementPlan;
use crate::render::Caster;
use crate::store::DatasetWriter;
use ldi_protocol::codec::ColourProfile;
use ldi_protocol::index::BuildSettings;
use serde::Serialize;
use std::time::Instant;

/// Placements that are made to tell. More tell better and later.
const SAMPLED: usize = 6;
/// Of fewer placements nothing is forecast: they are made at once.
const LEAST_PLACEMENTS: usize = 3 * SAMPLED;

/// What images are made from and with.
pub(super) struct Work<'a> {
    pub caster: &'a Caster,
    pub settings: &'a BuildSettings,
    pub colour: ColourProfile,
    pub scene_key: &'a [u8; 32],
    pub writer: &'a DatasetWriter,
    pub deadline: Option<Instant>,
    pub progress: &'a dyn Progress,
}

/// What the images of a plan are expected to take.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Forecast {
    /// Placements.
    pub placements: usize,
    /// Placements that were made to tell.
    pub sampled: usize,
    /// Seconds for all images, those included.
    pub seconds: f64,
    /// Stored bytes of all images.
    pub bytes: u64,
    /// Geometry budget, triangles.
    pub budget: u64,
}

impl Forecast {
    /// Makes the images of a few placements of all sizes. None: there are few, or an earlier build
    /// left the sampled ones, whose time is not known.
    pub(super) fn of(work: &Work<'_>, plans: &[PlacementPlan]) -> Result<Option<Self>, BuildError> {
        if plans.len() < LEAST_PLACEMENTS {
            return Ok(None);
        }
        let pixels = |p: &PlacementPlan| p.images.iter().map(pixels_of).sum::<u64>();
        let mut by_size: Vec<&PlacementPlan> = plans.iter().collect();
        by_size.sort_by_key(|p| pixels(p));
        // The middle of each of as many equal parts.
        let sampled: Vec<PlacementPlan> =
            (0..SAMPLED).map(|k| by_size[(2 * k + 1) * plans.len() / (2 * SAMPLED)].clone()).collect();
        let Work { caster, settings, colour, scene_key, writer, deadline, progress } = *work;
        progress.stage("what the images will take, by placement", sampled.len() as u64);
        let made = images::construct_all(caster, &sampled, settings, colour, scene_key, writer, deadline, progress)?;
        let figures = &made.figures;
        if figures.made < figures.images || figures.unmade > 0 {
            return Ok(None);
        }
        let bytes: u64 = made.entries().map(|e| u64::from(e.stored_bytes)).sum();
        let of = |plans: &mut dyn Iterator<Item = &PlacementPlan>| plans.map(pixels).sum::<u64>().max(1) as f64;
        let whole = of(&mut plans.iter()) / of(&mut sampled.iter());
        // Threads share the work evenly over many placements, over few only in part.
        let threads = rayon::current_num_threads() as f64;
        let seconds = figures.step_seconds.iter().sum::<f64>() / threads;
        Ok(Some(Self {
            placements: plans.len(),
            sampled: sampled.len(),
            seconds: seconds.min(figures.seconds) * whole,
            bytes: (bytes as f64 * whole) as u64,
            budget: settings.budget,
        }))
    }

    /// In words, with ways to make it shorter that were not taken yet: whether there are a
    /// corridor and a time limit already.
    pub fn said(&self, along: bool, limited: bool) -> String {
        let time = match self.seconds {
            s if s < 100.0 => format!("{s:.0} seconds"),
            s if s < 6000.0 => format!("{:.0} minutes", s / 60.0),
            s => format!("{:.1} hours", s / 3600.0),
        };
        let mut more = String::new();
        if self.seconds > LONG_S {
            let ways = [
                (!limited).then(|| "--time-limit 10m ends earlier with a dataset that works".to_owned()),
                Some(format!("--budget {} takes fewer and smaller images", 2 * self.budget)),
                (!along).then(|| "--along PATH.json takes only those of a tour".to_owned()),
            ];
            more = format!("; {}", ways.into_iter().flatten().collect::<Vec<_>>().join(", "));
        }
        format!(
            "the images of {} placements will take about {time} and {:.0} MB{more}",
            self.placements,
            self.bytes as f64 / 1e6
        )
    }
}

/// From here on ways to make it shorter are named, seconds.
const LONG_S: f64 = 300.0;
