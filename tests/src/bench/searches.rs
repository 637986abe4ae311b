//! How far from the best are the near boxes that plans use? Ways to search, on the groups of real
//! plans.
//!
//! And how far are its groups of view cells? In: scenes, a budget. Out: per way the gap to the
//! best box, the boxes that it tried, the time. The best is what trying every box gives; groups in
//! which that takes too long are left out and counted.

use super::placement::usual_options;
use anyhow::{Context as _, Result};
use ldi_server::{
    build,
    placement::{Groupings, Search, SearchCase, SearchComparison},
};
use serde::Serialize;

/// The ways, the oracle last.
pub const SEARCHES: [Search; 9] = [
    Search::Descent,
    Search::LookAhead(2),
    Search::LookAhead(3),
    Search::Beam(2),
    Search::Beam(8),
    Search::Beam(32),
    Search::Annealing(300),
    Search::Annealing(3000),
    Search::Exhaustive,
];

/// How one way did over all groups of a scene in which every box was tried.
#[derive(Debug, Clone, Serialize)]
pub struct Row {
    /// Scene.
    pub scene: String,
    /// Budget, percent of its triangles.
    pub budget_percent: f64,
    /// The way.
    pub search: Search,
    /// Groups.
    pub cases: usize,
    /// Groups left out, as they have too many boxes.
    pub left_out: usize,
    /// Share of the groups in which it found the best box.
    pub best_found: f64,
    /// How much dearer its boxes are than the best, percent: mean.
    pub gap_mean_percent: f64,
    /// The largest.
    pub gap_worst_percent: f64,
    /// Boxes that it tried: mean.
    pub boxes_mean: f64,
    /// Milliseconds: mean.
    pub ms_mean: f64,
}

/// Compares all ways on up to `cases` groups of a scene's plan, those of few view cells.
///
/// # Errors
/// A scene that cannot be read, a budget that cannot be met.
pub fn run(scene: &str, budget_percent: f64, cases: usize) -> Result<(Vec<Row>, Vec<SearchCase>, Vec<Groupings>)> {
    let options = usual_options(scene, budget_percent)?;
    // Six view cells have 63 groups to fit and 203 partitions.
    let comparison = SearchComparison { searches: &SEARCHES, cases, steps: 3, most: 20_000, together: 6 };
    let (all, groupings) =
        build::compare_searches(&options, &comparison).with_context(|| format!("{scene} at {budget_percent}%"))?;
    let (whole, left_out): (Vec<SearchCase>, Vec<SearchCase>) =
        all.into_iter().partition(|c| c.found.last().is_some_and(|f| f.0 == Search::Exhaustive && f.1.complete));
    let rows = SEARCHES.iter().enumerate().map(|(way, search)| {
        let gaps: Vec<f64> = whole.iter().map(|c| gap_percent(c, way)).collect();
        let n = gaps.len().max(1) as f64;
        let mean = |of: &dyn Fn(&SearchCase) -> f64| whole.iter().map(of).sum::<f64>() / n;
        Row {
            scene: scene.into(),
            budget_percent,
            search: *search,
            cases: whole.len(),
            left_out: left_out.len(),
            best_found: gaps.iter().filter(|g| **g < 1e-6).count() as f64 / n,
            gap_mean_percent: gaps.iter().sum::<f64>() / n,
            gap_worst_percent: gaps.iter().copied().fold(0.0, f64::max),
            boxes_mean: mean(&|c| c.found[way].1.states as f64),
            ms_mean: mean(&|c| c.found[way].2 * 1e3),
        }
    });
    let rows = rows.collect();
    Ok((rows, [whole, left_out].concat(), groupings))
}

/// How much dearer than the best partition ways to group are, for people.
pub fn grouping_table(scene: &str, groupings: &[Groupings]) -> String {
    let mut out = format!("{scene}: {} sets of view cells; dearer than the best partition:\n", groupings.len());
    let ways: [(&str, fn(&Groupings) -> f64); 3] =
        [("each by itself", |g| g.apart), ("halved", |g| g.halved), ("halved, then joined", |g| g.joined)];
    for (name, cost) in ways {
        let gaps: Vec<f64> = groupings.iter().map(|g| (cost(g) / g.best - 1.0) * 100.0).collect();
        let found = gaps.iter().filter(|g| **g < 1e-6).count() as f64 / gaps.len().max(1) as f64;
        let mean = gaps.iter().sum::<f64>() / gaps.len().max(1) as f64;
        let worst = gaps.iter().copied().fold(0.0, f64::max);
        out += &format!("{name:22} best found {:4.0}%  gap mean {mean:7.2}%  worst {worst:7.2}%\n", 100.0 * found);
    }
    out
}

fn gap_percent(case: &SearchCase, way: usize) -> f64 {
    let best = case.found.last().map_or(f64::NAN, |f| f.1.cost);
    (case.found[way].1.cost / best - 1.0) * 100.0
}

/// A table for people, with fixed columns.
pub fn table(rows: &[Row]) -> String {
    let mut out = String::from(
        "scene                                    budget  search                  groups  best found  gap mean  gap worst   boxes        ms\n",
    );
    for r in rows {
        let search = format!("{:?}", r.search);
        out += &format!(
            "{:40} {:5}%  {:22} {:7} {:10.0}% {:8.2}% {:9.2}% {:7.0} {:9.2}\n",
            r.scene,
            r.budget_percent,
            search,
            r.cases,
            100.0 * r.best_found,
            r.gap_mean_percent,
            r.gap_worst_percent,
            r.boxes_mean,
            r.ms_mean
        );
    }
    out
}
