//! The page, the plots and the table of a placement sweep.

use super::placement::{Row, Sweep, TABLE_1};
use crate::page::STYLE;
use crate::plot::{Plot, Series, escape, number};
use std::fmt::Write as _;

/// Plots with their file names, without `.svg`.
pub fn plots(rows: &[Row]) -> Vec<(String, String)> {
    let mut out = Vec::new();
    let (scenes, grids) = (distinct(rows, |r| &r.scene), distinct(rows, |r| &r.grid));
    for grid in &grids {
        for (what, name, of) in [
            ("images", "13-images", (|r: &Row| r.images as f64) as fn(&Row) -> f64),
            ("megapixels", "13-megapixels", |r| r.megapixels),
            ("placements", "13-placements", |r| r.placements as f64),
        ] {
            // Four lines are what one can tell apart.
            for (part, some) in scenes.chunks(4).enumerate() {
                let series: Vec<(String, Vec<(f64, f64)>)> = some
                    .iter()
                    .map(|scene| {
                        let points = rows.iter().filter(|r| &r.scene == scene && &r.grid == grid);
                        let value = |r: &Row| (r.budget_percent, if r.error.is_none() { of(r) } else { f64::NAN });
                        (short(scene), points.map(value).collect())
                    })
                    .collect();
                let title = format!("Figure 13: {what} against budget, --grid {grid}");
                let svg = plot(&title, "budget, % of the scene's triangles", what, &series, None);
                out.push((format!("figure-{name}-{grid}-{part}"), svg));
            }
        }
    }
    for r in rows.iter().filter(|r| r.error.is_none()) {
        let name = format!("{}-{}-{}", file_name(&r.scene), r.grid, r.budget_percent);
        let of = format!("{} at {}%, --grid {}", short(&r.scene), r.budget_percent, r.grid);
        if !r.along_path.is_empty() {
            let line = |k: usize| r.along_path.iter().enumerate().map(|(i, t)| (i as f64, t[k] as f64)).collect();
            let series = [("all in view".to_string(), line(0)), ("drawn".to_string(), line(1))];
            let title = format!("Figure 14: triangles along the path, {of}");
            let svg = plot(&title, "frame of the path", "triangles", &series, Some(("P", r.budget as f64)));
            out.push((format!("figure-14-{name}"), svg));
        }
        for (figure, title, x, y, of_bin, histogram) in [
            ("15", "images per grid point", "images", "grid points", 1.0, &r.images_per_point),
            ("16", "closeness to Popt", "off by at least, %", "placements", 1.0, &r.popt_closeness),
        ] {
            let steps = histogram.iter().enumerate().flat_map(|(i, n)| {
                let (x, y) = (i as f64 * of_bin, f64::from(*n));
                [(x, y), (x + of_bin, y)]
            });
            let series = [(y.to_string(), steps.collect())];
            let svg = plot(&format!("Figure {figure}: {title}, {of}"), x, y, &series, None);
            out.push((format!("figure-{figure}-{name}"), svg));
        }
    }
    out
}

fn plot(title: &str, x: &str, y: &str, series: &[(String, Vec<(f64, f64)>)], bound: Option<(&str, f64)>) -> String {
    let series = series.iter().map(|(name, points)| Series { name, points: points.clone() }).collect();
    Plot { title, x, y, series, bound }.svg()
}

/// An `<svg>` of a page as a file of its own.
pub fn standalone(svg: &str) -> String {
    svg.replacen("<svg ", "<svg xmlns=\"http://www.w3.org/2000/svg\" ", 1).replacen(
        '>',
        &format!("><style>{}</style>", STYLE.replace(":root", "svg")),
        1,
    )
}

/// The page.
pub fn page(sweep: &Sweep, rows: &[Row], plots: &[(String, String)], command: &str) -> String {
    let mut h = format!(
        "<!doctype html><html lang=\"en\"><meta charset=\"utf-8\"><meta name=\"viewport\" content=\"width=device-width\">\
         <title>Image placement against budget</title><style>{STYLE}</style><main><h1>Image placement against budget</h1>\
         <p class=\"lead\">Plans for {} x {} pictures of 60 degrees, free look of {} degrees up and down, footprint at most 2 px. Each plan is audited over {} random and {} \
         adversarial poses. An image is a face of a near box, or with --grid paper one quadrilateral, as planned; when it is made, parts that no eye sees are left out and the rest is cut into tiles of at most 4 million pixels.</p>",
        sweep.size.0, sweep.size.1, sweep.pitch_deg, sweep.audit.random, sweep.audit.adversarial
    );
    h.push_str("<h2>Plans</h2><table><tr>");
    for head in [
        "scene",
        "grid",
        "budget",
        "P",
        "points",
        "placements",
        "images",
        "Mpx",
        "s",
        "within 2% of Popt",
        "most triangles",
        "footprint, px",
        "broken",
    ] {
        let _ = write!(h, "<th>{head}</th>");
    }
    h.push_str("</tr>");
    for r in rows {
        let _ = write!(
            h,
            "<tr><td>{}</td><td>{}</td><td>{}%</td><td>{}</td>",
            escape(&short(&r.scene)),
            r.grid,
            r.budget_percent,
            number(r.budget as f64)
        );
        match (&r.error, &r.audit) {
            (Some(why), _) => {
                let _ = write!(h, "<td colspan=\"9\">{}</td>", escape(why));
            }
            (None, audit) => {
                let found = audit.as_ref();
                for cell in [
                    r.points.to_string(),
                    r.placements.to_string(),
                    r.images.to_string(),
                    number(r.megapixels.round()),
                    format!("{:.1}", r.seconds),
                    format!("{:.0}%", 100.0 * r.within_two_percent),
                    found.map_or("-".into(), |a| number(a.max_triangles as f64)),
                    found.map_or("-".into(), |a| format!("{:.2}", a.max_footprint_px)),
                    found.map_or("-".into(), |a| format!("{} of {}", a.violations, a.all_poses())),
                ] {
                    let _ = write!(h, "<td>{cell}</td>");
                }
            }
        }
        h.push_str("</tr>");
    }
    h.push_str("</table>");
    let compared: Vec<_> = TABLE_1
        .iter()
        .flat_map(|t| {
            rows.iter()
                .filter(|r| is_builtin(&r.scene, t.scene) && r.budget_percent == t.budget_percent)
                .map(move |r| (t, r))
        })
        .collect();
    if !compared.is_empty() {
        h.push_str(
            "<h2>Against Table 1 of Aliaga and Lastra (1999)</h2><p class=\"lead\">Their models are not ours; the built-in scenes have their kind and size. Theirs: yaw only, no bound \
             on the error of images.</p><table><tr><th>model</th><th>budget</th><th>their images</th><th>grid</th><th>our placements</th><th>our images</th><th>Mpx</th><th>their images / ours</th></tr>",
        );
        for (t, r) in compared {
            let _ = write!(
                h,
                "<tr><td>{}</td><td>{}%</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td><td>{}</td></tr>",
                t.scene,
                t.budget_percent,
                t.images,
                r.grid,
                r.placements,
                r.images,
                number(r.megapixels.round()),
                if r.error.is_none() {
                    format!("{:.1}", f64::from(t.images) / r.images.max(1) as f64)
                } else {
                    "-".into()
                }
            );
        }
        h.push_str("</table>");
    }
    h.push_str("<h2>Plots</h2><div class=\"plots\">");
    for (_, svg) in plots {
        let _ = write!(h, "<figure>{svg}</figure>");
    }
    let _ = write!(h, "</div><h2>How to run it again</h2><pre>{}</pre></main></html>", escape(command));
    h
}

/// The rows as comma-separated values, one header line.
pub fn csv(rows: &[Row]) -> String {
    let mut out = String::from(
        "scene,grid,budget_percent,triangles,budget,optimize_budget,points,placements,images,megapixels,seconds,within_two_percent,max_triangles,max_footprint_px,poses,violations,error\n",
    );
    for r in rows {
        let a = r.audit.as_ref();
        let quoted = |s: &str| format!("\"{}\"", s.replace('"', "\"\""));
        let _ = writeln!(
            out,
            "{},{},{},{},{},{},{},{},{},{:.1},{:.2},{:.4},{},{:.4},{},{},{}",
            quoted(&r.scene),
            r.grid,
            r.budget_percent,
            r.triangles,
            r.budget,
            r.optimize_budget,
            r.points,
            r.placements,
            r.images,
            r.megapixels,
            r.seconds,
            r.within_two_percent,
            a.map_or(0, |a| a.max_triangles),
            a.map_or(0.0, |a| a.max_footprint_px),
            a.map_or(0, |a| a.all_poses()),
            a.map_or(0, |a| a.violations),
            quoted(r.error.as_deref().unwrap_or("")),
        );
    }
    out
}

fn distinct<'a>(rows: &'a [Row], of: impl Fn(&'a Row) -> &'a String) -> Vec<String> {
    let mut out: Vec<String> = Vec::new();
    for name in rows.iter().map(of) {
        if !out.contains(name) {
            out.push(name.clone());
        }
    }
    out
}

fn is_builtin(scene: &str, name: &str) -> bool {
    scene.strip_prefix("builtin:").is_some_and(|s| s.split('?').next() == Some(name))
}

/// A scene's name for people: without folder and ending.
fn short(scene: &str) -> String {
    match scene.strip_prefix("builtin:") {
        Some(s) => s.split('?').next().unwrap_or(s).to_string(),
        None => {
            std::path::Path::new(scene).file_stem().map_or_else(|| scene.into(), |s| s.to_string_lossy().into_owned())
        }
    }
}

/// A scene's name within a file name.
fn file_name(scene: &str) -> String {
    short(scene).chars().map(|c| if c.is_ascii_alphanumeric() { c } else { '-' }).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use ldi_server::placement::{AuditReport, AuditSize};

    fn rows() -> Vec<Row> {
        let row = |budget_percent, images| Row {
            scene: "builtin:pipes?triangles=1000000".into(),
            grid: "cells".into(),
            budget_percent,
            images,
            placements: 7,
            images_per_point: vec![0, 3, 2],
            popt_closeness: vec![4, 1],
            along_path: vec![[900, 100], [800, 90]],
            audit: Some(AuditReport { poses: 11, violations: 0, ..AuditReport::default() }),
            ..Row::default()
        };
        let mut all = vec![row(15.0, 100), row(25.0, 47)];
        all.push(Row { error: Some("needs <more>, \"12\"".into()), ..row(1.0, 0) });
        all
    }

    #[test]
    fn the_page_compares_with_the_paper_and_says_what_failed() {
        let rows = rows();
        let sweep = Sweep {
            scenes: vec![],
            budgets_percent: vec![],
            grids: vec![],
            size: (512, 384),
            pitch_deg: 0.0,
            audit: AuditSize { random: 10, adversarial: 1 },
        };
        let plots = plots(&rows);
        let html = page(&sweep, &rows, &plots, "ldi-bench placement");
        assert!(html.contains("<td>893</td>") && html.contains("<td>8.9</td>"), "893 images against 100");
        assert!(html.contains("<td>282</td>") && html.contains("<td>6.0</td>"), "282 images against 47");
        assert!(html.contains("needs &lt;more&gt;"));
        assert!(
            plots.iter().any(|p| p.0 == "figure-14-pipes-cells-15") && plots.iter().all(|p| !p.0.contains("cells-1."))
        );
        let lines = csv(&rows);
        assert_eq!(lines.lines().count(), 4);
        assert!(lines.contains("\"needs <more>, \"\"12\"\"\""));
    }

    #[test]
    fn a_plot_is_a_file_of_its_own() {
        let svg = standalone(&plots(&rows())[0].1);
        assert!(svg.starts_with("<svg xmlns=") && svg.matches("<style>").count() == 1);
        assert!(svg.find("<style>") < svg.find("<text"));
    }
}
