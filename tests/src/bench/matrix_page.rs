//! The table and the page of the matrix of scenes and settings.

use super::matrix::{Dominated, Figures, Row, Setting, dominated};
use crate::{
    page::STYLE,
    plot::{Dot, Scatter, escape, number},
};
use std::fmt::Write as _;

const COLUMNS: [&str; 18] = [
    "scene",
    "setting",
    "build, s",
    "build, MB of memory",
    "images",
    "budget",
    "dataset, MB",
    "x scene's file",
    "walk, MB",
    "first picture, ms",
    "frame, ms",
    "walks, ms",
    "p99, ms",
    "FLIP",
    "x baseline",
    "worst frame",
    "holes, % at most",
    "over budget",
];

/// The cells of a row, in the order of the columns.
fn cells(row: &Row) -> Vec<String> {
    let mb = |bytes: u64| format!("{:.2}", bytes as f64 / 1e6);
    let mut cells = vec![row.scene.name.clone(), row.setting.name().to_owned()];
    let Some(f) = &row.figures else {
        let error = row.error.as_deref().unwrap_or_default();
        cells.push(error.lines().next_back().unwrap_or_default().to_owned());
        return cells;
    };
    cells.extend([
        format!("{:.1}", f.build_s),
        f.build_peak_bytes.map_or("-".into(), |b| format!("{:.0}", b as f64 / 1e6)),
        f.images.to_string(),
        f.budget.to_string(),
        mb(f.dataset_bytes),
        format!("{:.2}", f.dataset_bytes as f64 / row.scene.bytes.max(1) as f64),
        mb(f.walk_bytes),
        f.first_picture_ms.map_or("-".into(), |ms| format!("{ms:.0}")),
        format!("{:.1}", f.frame_ms),
        format!("{:.1} to {:.1}", f.frame_ms_range[0], f.frame_ms_range[1]),
        format!("{:.1}", f.frame_ms_p99),
        format!("{:.4}", f.flip),
        format!("{:.3}", f.flip_ratio[0]),
        format!("{:.3}", f.flip_ratio[1]),
        format!("{:.3}", f.holes_max * 100.0),
        f.violations.to_string(),
    ]);
    cells
}

/// A line for a terminal.
pub fn line(row: &Row) -> String {
    match &row.figures {
        None => format!("{} {}: {}", row.scene.name, row.setting.name(), cells(row)[2]),
        Some(f) => format!(
            "{} {}: built in {:.1} s, {:.2} MB, {:.1} ms per frame, FLIP {:.4} ({:.3} times the baseline's), {:.2} MB walked",
            row.scene.name,
            row.setting.name(),
            f.build_s,
            f.dataset_bytes as f64 / 1e6,
            f.frame_ms,
            f.flip,
            f.flip_ratio[0],
            f.walk_bytes as f64 / 1e6
        ),
    }
}

/// What is said of a default that something beats.
pub fn sentence(d: &Dominated) -> String {
    format!("{}: the default is dominated by {}, which is better in {}", d.scene, d.by.name(), d.better.join(" and "))
}

/// Comma-separated values.
pub fn csv(rows: &[Row]) -> String {
    let quoted = |cells: &[String]| {
        let cell =
            |c: &String| if c.contains([',', '"']) { format!("\"{}\"", c.replace('"', "\"\"")) } else { c.clone() };
        cells.iter().map(cell).collect::<Vec<_>>().join(",") + "\n"
    };
    let head = quoted(&COLUMNS.map(str::to_owned));
    rows.iter().fold(head, |all, row| all + &quoted(&cells(row)))
}

/// The page: dominated defaults first, then a table and two plots per scene.
pub fn html(rows: &[Row], command: &str) -> String {
    let mut h = format!(
        "<!doctype html><html lang=\"en\"><meta charset=\"utf-8\"><meta name=\"viewport\" content=\"width=device-width\">\
         <title>Scenes and settings</title><style>{STYLE}main{{max-width:1500px}}td,th{{white-space:nowrap;padding-right:12px;font-size:13px}}\
         .wide{{overflow-x:auto}}.default{{font-weight:600}}</style><main><h1>Scenes and settings</h1>\
         <p class=\"lead\">Every scene built without options and with each single method, and walked along its path. \
         Baseline: one filtered ray per pixel; truth: 16.</p><p><code>{}</code></p>",
        escape(command)
    );
    let beaten = dominated(rows);
    h.push_str("<h2>Dominated defaults</h2>");
    if beaten.is_empty() {
        h.push_str("<p>None: no setting is better than the default in time, error and bytes at once.</p>");
    }
    for d in &beaten {
        let _ = write!(h, "<p>{}</p>", escape(&sentence(d)));
    }
    let mut scenes: Vec<&str> = rows.iter().map(|r| r.scene.name.as_str()).collect();
    scenes.dedup();
    for scene in scenes {
        let own: Vec<&Row> = rows.iter().filter(|r| r.scene.name == scene).collect();
        let (triangles, bytes) = (own[0].scene.triangles, own[0].scene.bytes);
        let _ = write!(
            h,
            "<h2>{}</h2><p>{} triangles, {:.2} MB</p>",
            escape(scene),
            number(triangles as f64),
            bytes as f64 / 1e6
        );
        h.push_str("<div class=\"wide\"><table><tr>");
        for c in &COLUMNS[1..] {
            let _ = write!(h, "<th>{}</th>", escape(c));
        }
        h.push_str("</tr>");
        for row in &own {
            let class = if row.setting == Setting::Default { " class=\"default\"" } else { "" };
            let _ = write!(h, "<tr{class}>");
            let cells = cells(row);
            let last = cells.len() - 1;
            for (i, c) in cells.iter().enumerate().skip(1) {
                let span = if row.figures.is_none() && i == last { " colspan=\"15\"" } else { "" };
                let _ = write!(h, "<td{span}>{}</td>", escape(c));
            }
            h.push_str("</tr>");
        }
        h.push_str("</table></div><div class=\"plots\">");
        for (x, of) in [
            ("milliseconds per frame", (|f: &Figures| f.frame_ms) as fn(&Figures) -> f64),
            ("megabytes of the walk", |f| f.walk_bytes as f64 / 1e6),
        ] {
            let dot = |r: &&Row| {
                let f = r.figures.as_ref()?;
                let series = usize::from(r.setting != Setting::Default);
                Some(Dot { name: r.setting.name().into(), x: of(f), y: f.flip, series })
            };
            let dots = own.iter().filter_map(dot).collect();
            let plot = Scatter { title: &format!("FLIP over {x}"), x, y: "FLIP", dots };
            let _ = write!(h, "<figure>{}</figure>", plot.svg());
        }
        h.push_str("</div>");
    }
    h + "</main></html>\n"
}

#[cfg(test)]
mod tests {
    use super::{super::matrix::tests::row, *};

    #[test]
    fn the_page_lists_dominated_defaults_first_and_errors_in_their_row() {
        let failed =
            Row { figures: None, error: Some("a\nno <rooms>".into()), ..row("hall", Setting::Portals, [1.0; 3]) };
        let rows =
            [row("hall", Setting::Default, [9.0, 0.1, 9.0]), row("hall", Setting::Tree, [1.0, 0.1, 9.0]), failed];
        let page = html(&rows, "ldi-bench matrix hall.glb");
        let at = |what: &str| page.find(what).unwrap_or_else(|| panic!("{what} is not in {page}"));
        assert!(at("dominated by tree, which is better in time") < at("<table>"));
        assert!(page.contains("no &lt;rooms&gt;") && page.matches("<svg").count() == 2);
        let table = csv(&rows);
        let columns = |line: &str| line.split(',').count();
        let lines: Vec<&str> = table.lines().collect();
        assert_eq!((lines.len(), columns(lines[1])), (4, COLUMNS.len()));
    }
}
