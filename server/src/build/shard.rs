//! A share of a build's images, made beside other processes that make the other shares.
//!
//! In: a build and which share. Out: the images of the share, kept in the output folder as those of
//! a build that was stopped. The same build without a share finds them there and writes the
//! dataset, so that its bytes are those of one process.
//!
//! Every process plans for itself, which takes the same time in each; images are shared out by
//! placement, in turn.

use super::{
    BuildError, BuildOptions, Clock, Progress, Represent, images, key,
    planning::{Planned, plan},
};
use crate::placement::PlacementPlan;
use crate::store::DatasetWriter;
use std::str::FromStr;

/// Most shares.
const MOST: u32 = 10_000;

/// Which share of how many.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Shard {
    /// From 1.
    number: u32,
    of: u32,
}

impl FromStr for Shard {
    type Err = String;
    fn from_str(s: &str) -> Result<Self, String> {
        let numbers = s.split_once('/').and_then(|(number, of)| Some((number.parse().ok()?, of.parse().ok()?)));
        let found = numbers.filter(|(number, of)| (1..=*of).contains(number) && *of <= MOST);
        let shard = found.map(|(number, of)| Self { number, of });
        shard.ok_or_else(|| format!("a share is needed as 1/4 to 4/4, of at most {MOST}"))
    }
}

impl std::fmt::Display for Shard {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}/{}", self.number, self.of)
    }
}

/// What is there after a share was made.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ShardFigures {
    /// Placements of the whole build.
    pub placements: usize,
    /// Placements of this share.
    pub share: usize,
    /// Placements of the whole build whose images are not there yet.
    pub missing: usize,
}

/// Makes a share of the images and keeps them in the output folder.
///
/// # Errors
/// As [`super::build`]; also if what is built depends on images.
pub fn build_shard(options: &BuildOptions, shard: Shard, progress: &dyn Progress) -> Result<ShardFigures, BuildError> {
    if matches!(options.represent, Represent::Smaller | Represent::Tree { .. } | Represent::Cache) {
        return Err(BuildError::NoShares { why: "only the grid and portals have images to share" });
    }
    let mut clock = Clock::default();
    let writer = DatasetWriter::open_beside_others(&options.output)?;
    let Planned { scene, settings, plan, caster, grid_alone, .. } = plan(options, &mut clock, progress)?;
    if grid_alone.is_some() {
        return Err(BuildError::NoShares { why: "--represent auto compares rooms and the grid by images of both" });
    }
    let caster = caster.with_mips();
    let scene_key = key::scene_key(&scene);
    let mine = |(n, _): &(usize, &PlacementPlan)| n % shard.of as usize + 1 == shard.number as usize;
    let share: Vec<PlacementPlan> = plan.plans.iter().enumerate().filter(mine).map(|(_, p)| p.clone()).collect();
    let deadline = options.time_limit.map(|limit| clock.start + limit);
    progress.stage("layered depth images of the share, by placement", share.len() as u64);
    let colour = options.colour;
    images::construct_all(&caster, &share, &settings, colour, &scene_key, &writer, deadline, progress)?;
    let is_there = |plan: &&PlacementPlan| writer.holds(&key::images_key(&scene_key, &settings, plan));
    let missing = plan.plans.len() - plan.plans.iter().filter(is_there).count();
    Ok(ShardFigures { placements: plan.plans.len(), share: share.len(), missing })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shares_are_numbered_from_one() {
        assert_eq!("2/3".parse(), Ok(Shard { number: 2, of: 3 }));
        for wrong in ["", "1", "0/2", "3/2", "-1/2", "1/0", "a/b", "1/2/3", "1/99999"] {
            assert!(wrong.parse::<Shard>().is_err_and(|e| e.contains("1/4")), "{wrong}");
        }
    }
}
