//! The budget, where none was asked for: the largest that the client's profile allows, or less if
//! images then pay.
//!
//! In, a profile's largest budget; out, the plan of the budget that is taken, and what was tried.
//! Where geometry with its levels keeps the largest budget from everywhere, that is all: no image
//! would make a frame faster. Else smaller budgets are planned, each at most half of the one
//! before: frames become faster, images more. The last one is taken whose images are expected to
//! take no more bytes than some times the scene's, and no more than a few minutes.

use super::{BuildError, Progress};
use crate::placement::{ImagePlan, PlacementError, PlacementResult};
use ldi_protocol::{
    client_profile::{ClientProfile, LEAST_BUDGET},
    index::GridPoint,
};
use serde::Serialize;
use std::time::Instant;

/// Stored bytes to expect per pixel of a planned image: the clinic took 0.01, black_forest 0.18.
/// More: smaller budgets are given up sooner.
const BYTES_PER_PIXEL: f64 = 0.05;
/// Pixels of planned images to expect of two cores per second: black_forest took 1.4 million,
/// west_riverside_mep some ten million. Fewer: smaller budgets are given up sooner.
const PIXELS_PER_S: f64 = 5e6;
/// Longest that images may be expected to take, seconds.
const LONGEST_S: f64 = 300.0;
/// After a plan of more view cells no smaller budget is planned: it has more still, and takes
/// longer to plan. Counted, so that the choice does not depend on the machine.
const MOST_VIEW_CELLS: usize = 100;
/// If no more view cells than this share have images, most frames would not be faster with a
/// smaller budget.
const FEW: f64 = 0.25;
/// Each budget is this share of the one before.
const STEP: f64 = 0.4;

/// How the budget is found.
#[derive(Debug, Clone, PartialEq)]
pub enum BudgetRule {
    /// As the settings say.
    Given,
    /// A share of the scene's triangles, above 0 and at most 1.
    Share(f64),
    /// By what a client's work costs.
    For {
        /// The client.
        profile: ClientProfile,
        /// Bytes of images per byte of the scene, at most.
        bytes_per_scene_byte: f64,
    },
}

/// A budget that was planned.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct BudgetTrial {
    /// Triangles per frame.
    pub budget: u64,
    /// Images.
    pub images: usize,
    /// View cells.
    pub view_cells: usize,
    /// Share of them that have images, 0 to 1.
    pub share_with_images: f64,
    /// Their pixels, millions.
    pub megapixels: f64,
    /// Bytes to expect of them.
    pub bytes_expected: u64,
    /// Seconds that they are expected to take.
    pub seconds_expected: f64,
    /// Seconds of planning.
    pub planning_s: f64,
    /// Why it was taken or not.
    pub why: String,
}

/// How the budget was found.
#[derive(Debug, Clone, PartialEq, Serialize)]
pub struct BudgetChoice {
    /// The client that it is for.
    pub profile: ClientProfile,
    /// The budget.
    pub chosen: u64,
    /// Milliseconds that the client is expected to take for a frame that uses it all.
    pub longest_frame_ms: f64,
    /// Bytes of images that the scene is worth.
    pub most_bytes: u64,
    /// What was planned, largest first.
    pub trials: Vec<BudgetTrial>,
}

impl BudgetChoice {
    /// In words: the choice and a line per budget that was planned.
    pub fn said(&self) -> String {
        let (client, chosen, ms) = (&self.profile.name, self.chosen, self.longest_frame_ms);
        let mut lines = vec![format!(
            "budget for a {client} client: {chosen} triangles per frame; a frame that uses it all takes about {ms:.0} ms"
        )];
        for t in &self.trials {
            let images = match t.images {
                0 => "no images".to_owned(),
                n => {
                    format!("{n} images, about {:.0} MB in {:.0} s", t.bytes_expected as f64 / 1e6, t.seconds_expected)
                }
            };
            let mark = if t.budget == self.chosen { "taken" } else { "not taken" };
            lines.push(format!("  {:>9}: {images}; {mark}: {}", t.budget, t.why));
        }
        lines.join("\n")
    }
}

/// Plans budgets by `place`, from the largest for pictures of so many pixels down, until one is
/// taken.
///
/// # Errors
/// As `place` for the largest budget; that smaller ones cannot be kept only ends the search.
pub(super) fn choose<P>(
    profile: &ClientProfile,
    (pixels, most_bytes): (f64, u64),
    place: &dyn Fn(u64) -> Result<(P, Size), PlacementError>,
    progress: &dyn Progress,
) -> Result<(P, BudgetChoice), BuildError> {
    let most = profile.most_triangles(pixels);
    let mut choice =
        BudgetChoice { profile: profile.clone(), chosen: most, longest_frame_ms: 0.0, most_bytes, trials: Vec::new() };
    let (mut plan, first) = tried(most, place)?;
    choice.trials.push(first);
    while let Some(last) = choice.trials.last_mut() {
        progress.note(&format!("budget of {}: {} images", last.budget, last.images));
        let smaller = ((last.budget as f64 * STEP) as u64).max(LEAST_BUDGET);
        if let Some(why) = last.reason_to_stop(most_bytes) {
            last.why = why;
            break;
        }
        match tried(smaller, place) {
            Ok((found, trial)) if !exceeds(trial.megapixels, most_bytes) => {
                last.why = "a smaller one makes frames faster".into();
                choice.chosen = smaller;
                choice.trials.push(trial);
                plan = found;
            }
            Ok((_, mut trial)) => {
                last.why = "the smallest whose images are worth it".into();
                trial.why = "its images cost too much".into();
                choice.trials.push(trial);
                break;
            }
            Err(e) => {
                last.why = format!("a budget of {smaller} cannot be kept: {e}");
                break;
            }
        }
    }
    let has_images = choice.trials.iter().any(|t| t.budget == choice.chosen && t.images > 0);
    choice.longest_frame_ms = profile.frame_ms(pixels, choice.chosen, has_images);
    Ok((plan, choice))
}

impl BudgetTrial {
    /// Why no smaller budget is planned; None: one is.
    fn reason_to_stop(&self, most_bytes: u64) -> Option<String> {
        if self.images == 0 {
            return Some("geometry with its levels of detail stays within it from everywhere".into());
        }
        if self.share_with_images < FEW {
            return Some(format!("images are needed in {:.0}% of the places only", 100.0 * self.share_with_images));
        }
        if self.budget == LEAST_BUDGET {
            return Some("no smaller budget is tried".into());
        }
        if self.view_cells > MOST_VIEW_CELLS {
            return Some("planning a smaller one would take long".into());
        }
        // Pixels of images grow about as fast as budgets fall.
        exceeds(self.megapixels / STEP, most_bytes).then(|| "images of a smaller one cost too much".into())
    }
}

/// Whether images of so many planned pixels take too many bytes, or too long.
fn exceeds(megapixels: f64, most_bytes: u64) -> bool {
    megapixels * 1e6 * BYTES_PER_PIXEL > most_bytes as f64 || megapixels * 1e6 / PIXELS_PER_S > LONGEST_S
}

/// What a plan's images come to.
pub(super) struct Size {
    images: usize,
    pixels: f64,
    view_cells: usize,
    with_images: usize,
}

impl Size {
    pub fn of(plan: &PlacementResult) -> Self {
        let images = || plan.plans.iter().flat_map(|p| &p.images);
        let has_images = |p: &&GridPoint| p.bands.iter().flatten().any(|range| range.placement.is_some());
        Self {
            images: images().count(),
            pixels: images().map(ImagePlan::pixels).sum::<f64>().max(0.0),
            view_cells: plan.points.len(),
            with_images: plan.points.iter().filter(has_images).count(),
        }
    }
}

/// Plans a budget.
fn tried<P>(
    budget: u64,
    place: &dyn Fn(u64) -> Result<(P, Size), PlacementError>,
) -> Result<(P, BudgetTrial), PlacementError> {
    let start = Instant::now();
    let (plan, Size { images, pixels, view_cells, with_images }) = place(budget)?;
    let trial = BudgetTrial {
        budget,
        images,
        view_cells,
        share_with_images: with_images as f64 / view_cells.max(1) as f64,
        megapixels: pixels / 1e6,
        bytes_expected: (pixels * BYTES_PER_PIXEL) as u64,
        seconds_expected: pixels / PIXELS_PER_S,
        planning_s: start.elapsed().as_secs_f64(),
        why: String::new(),
    };
    Ok((plan, trial))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Images of so many megapixels, for one of `cells` view cells.
    fn images(megapixels: f64, view_cells: usize) -> Result<((), Size), PlacementError> {
        let images = usize::from(megapixels > 0.0);
        Ok(((), Size { images, pixels: megapixels * 1e6, view_cells, with_images: view_cells.div_ceil(9) }))
    }

    fn chosen(most_bytes: u64, place: impl Fn(u64) -> Result<((), Size), PlacementError>) -> BudgetChoice {
        let profile = ClientProfile::cpu();
        let ((), choice) = choose(&profile, (1280.0 * 720.0, most_bytes), &place, &()).unwrap();
        assert!(choice.trials.iter().all(|t| !t.why.is_empty()), "{choice:?}");
        assert_eq!(choice.trials.iter().filter(|t| t.budget == choice.chosen).count(), 1, "{choice:?}");
        choice
    }

    #[test]
    fn the_smallest_budget_whose_images_are_worth_it_is_taken() {
        let megabyte = 1_000_000;
        // 2.5 million keep it all.
        let found = chosen(megabyte, |_| images(0.0, 1));
        assert_eq!((found.chosen, found.trials.len()), (2_500_000, 1));
        assert_eq!(found.longest_frame_ms, found.profile.frame_ms(1280.0 * 720.0, 2_500_000, false));
        // Images of few places.
        assert_eq!(chosen(megabyte, |_| images(1.0, 9)).trials.len(), 1);
        // More view cells than are planned anew.
        assert_eq!(
            chosen(100 * megabyte, |_| images(1.0, 101).map(|(p, s)| (p, Size { with_images: 101, ..s }))).trials.len(),
            1
        );
        // The next one's are expected to be too large, so that it is not planned.
        assert_eq!(chosen(megabyte, |_| images(19.0, 2)).trials.len(), 1);
        // They grow faster than expected: planned, not taken.
        let found = chosen(megabyte, |b| images(if b > 2_000_000 { 4.0 } else { 21.0 }, 2));
        assert_eq!((found.chosen, found.trials.len()), (2_500_000, 2));
        // All the way down.
        let found = chosen(100 * megabyte, |_| images(4.0, 2));
        let budgets: Vec<u64> = found.trials.iter().map(|t| t.budget).collect();
        assert_eq!((found.chosen, budgets), (200_000, vec![2_500_000, 1_000_000, 400_000, 200_000]));
        // A budget that cannot be kept ends the search.
        let found = chosen(100 * megabyte, |b| match b < 500_000 {
            true => Err(PlacementError::Setting { name: "budget", value: 1.0, must: "larger" }),
            false => images(4.0, 2),
        });
        assert_eq!(found.chosen, 1_000_000);
        assert!(found.said().contains("cannot be kept"), "{}", found.said());
    }
}
