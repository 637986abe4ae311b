//! The page, the plots and the table of speed against error.

use super::{
    colours::ColourRow,
    speed_error::{Drawn, Found, Job, Row},
};
use crate::page::STYLE;
use crate::plot::{Dot, Scatter, escape, number};
use std::fmt::Write as _;

/// What a setting is called: `quads 2x, smooth`.
fn name(r: &Row) -> String {
    let s = &r.setting;
    let mut name = s.drawn.name().to_string();
    for (on, what) in [
        (s.supersample > 1, " 2x2 supersampled"),
        (s.epipole, ", epipole"),
        (s.smooth, ", smooth"),
        (s.fill == ldi_client::composite::Fill::Off, ", no fill"),
        (s.fill == ldi_client::composite::Fill::Last, ", last frame"),
        (s.unclipped, ", unclipped"),
    ] {
        name += if on { what } else { "" };
    }
    name
}

/// A number, or nothing where there is none.
fn known(v: f64, text: impl Fn(f64) -> String) -> String {
    if v.is_finite() { text(v) } else { "-".into() }
}

/// Columns after the setting: heading, value.
type Column = (&'static str, fn(&Row) -> String);
const COLUMNS: [Column; 18] = [
    ("threads", |r| r.setting.threads.to_string()),
    ("warp ms", |r| known(r.warp_ms, |v| format!("{v:.2}"))),
    ("hidden", |r| known(r.hidden, |v| format!("{:.0}%", 100.0 * v))),
    ("without them ms", |r| known(r.warp_hidden_ms, |v| format!("{v:.2}"))),
    ("frame ms", |r| format!("{:.1}", r.frame_ms)),
    ("Msamples", |r| format!("{:.2}", r.samples / 1e6)),
    ("Msamples/s", |r| known(r.msamples_per_s, |v| format!("{v:.0}"))),
    ("of compute", |r| known(r.of_compute, |v| format!("{:.0}%", 100.0 * v))),
    ("of memory", |r| known(r.of_memory, |v| format!("{:.0}%", 100.0 * v))),
    ("PSNR dB", |r| format!("{:.2}", r.psnr_db)),
    ("SSIM", |r| format!("{:.4}", r.ssim)),
    ("FLIP", |r| format!("{:.4}", r.flip)),
    ("FLIP / 1 ray", |r| format!("{:.2}", r.flip_over_baseline)),
    ("far / 1 ray", |r| known(r.flip_far_over_baseline, |v| format!("{v:.2}"))),
    ("worst / 1 ray", |r| format!("{:.2}", r.worst_over_baseline)),
    ("holes", |r| format!("{:.3}%", 100.0 * r.holes)),
    ("before fill", |r| format!("{:.3}%", 100.0 * r.holes_before_fill)),
    ("orders differ", |r| r.orders_differ.map_or(String::new(), |d| format!("{:.4}%", 100.0 * d))),
];

/// What a row says, on one line.
pub fn line(r: &Row) -> String {
    format!(
        "{} x{} {} on {} threads: warp {:.2} ms, frame {:.1} ms, FLIP {:.4} ({:.2} x), far {:.2} x, holes {:.3}%",
        r.scene,
        r.density,
        name(r),
        r.setting.threads,
        r.warp_ms,
        r.frame_ms,
        r.flip,
        r.flip_over_baseline,
        r.flip_far_over_baseline,
        100.0 * r.holes
    )
}

/// The table as CSV.
pub fn csv(rows: &[Row]) -> String {
    let mut out = String::from("scene,density,setting");
    COLUMNS.iter().for_each(|(head, _)| {
        let _ = write!(out, ",{head}");
    });
    for r in rows {
        let _ = write!(out, "\n{},{},\"{}\"", r.scene, r.density, name(r));
        COLUMNS.iter().for_each(|(_, of)| {
            let _ = write!(out, ",{}", of(r));
        });
    }
    out + "\n"
}

/// Columns of the colour profiles: heading, value.
type ColourColumn = (&'static str, fn(&ColourRow) -> String);
const COLOUR_COLUMNS: [ColourColumn; 8] = [
    ("images", |r| r.images.to_string()),
    ("Msamples", |r| format!("{:.2}", r.samples as f64 / 1e6)),
    ("bytes per sample", |r| format!("{:.3}", r.bytes_per_sample)),
    ("of colours", |r| format!("{:.3}", r.colour_bytes_per_sample)),
    ("decoded Msamples/s", |r| format!("{:.0}", r.decoded_msamples_per_s)),
    ("dB lost", |r| format!("{:.3}", r.db_lost)),
    ("FLIP / exact", |r| format!("{:.3}", r.flip_ratio)),
    ("far FLIP / exact", |r| format!("{:.3}", r.flip_far_ratio)),
];

/// The colour profiles as CSV.
pub fn colours_csv(rows: &[ColourRow]) -> String {
    let mut out = String::from("scene,density,profile");
    COLOUR_COLUMNS.iter().for_each(|(head, _)| {
        let _ = write!(out, ",{head}");
    });
    for r in rows {
        let _ = write!(out, "\n{},{},{}", r.scene, r.density, r.profile);
        COLOUR_COLUMNS.iter().for_each(|(_, of)| {
            let _ = write!(out, ",{}", of(r));
        });
    }
    out + "\n"
}

/// Rows by scene, in order.
fn by_scene(rows: &[Row]) -> impl Iterator<Item = &[Row]> {
    rows.chunk_by(|a, b| a.scene == b.scene)
}

/// Plots with their file names, without `.svg`: per scene the error over all and over far pixels,
/// against time.
pub fn plots(rows: &[Row]) -> Vec<(String, String)> {
    let mut out = Vec::new();
    for of_scene in by_scene(rows) {
        let scene = &of_scene[0].scene;
        let most = of_scene.iter().map(|r| r.setting.threads).max().unwrap_or(1);
        for (kind, title, y, of) in [
            ("all", "all pixels", "mean FLIP", (|r: &Row| r.flip) as fn(&Row) -> f64),
            ("far", "pixels from images", "mean FLIP", |r| r.flip_far),
        ] {
            let dots = of_scene
                .iter()
                .filter(|r| r.setting.threads == most && !r.setting.unclipped)
                .filter(|r| kind == "all" || matches!(r.setting.drawn, Drawn::Images(_)))
                .map(|r| Dot {
                    name: if r.density == 1.0 { name(r) } else { format!("{} at density {}", name(r), r.density) },
                    x: if kind == "all" { r.frame_ms } else { r.warp_ms },
                    y: of(r),
                    series: usize::from(r.setting.supersample > 1) + 2 * usize::from(r.density > 1.0),
                })
                .collect();
            let x = if kind == "all" { "frame, ms" } else { "warp, ms" };
            let title = format!("{scene}, {title}: error against time");
            out.push((format!("{scene}-{kind}"), Scatter { title: &title, x, y, dots }.svg()));
        }
    }
    out
}

/// The page.
pub fn page(job: &Job, found: &Found, plots: &[(String, String)], command: &str) -> String {
    let mut h = format!(
        "<!doctype html><html lang=\"en\"><meta charset=\"utf-8\"><meta name=\"viewport\" content=\"width=device-width\">\
         <title>Speed against error</title><style>{STYLE}main{{max-width:1500px}}td,th{{white-space:nowrap;padding-right:12px;font-size:13px}}.wide{{overflow-x:auto}}</style><main><h1>Speed against error</h1>\
         <p class=\"lead\">{} x {} pictures, up to {} views per scene of those that show images. A time is the median over views of the median of {} repetitions; pictures are judged \
         against 16 rays per pixel, and beside drawing everything with one ray per pixel. <i>of compute</i>: time of transforming the same samples without painting, over the warp's. <i>of memory</i>: time of moving the same bytes once \
         through memory, over the warp's.</p>",
        job.size.0, job.size.1, job.frames, job.repeat
    );
    for l in &found.limits {
        let _ = write!(h, "<p>Memory, {} threads: {} GB/s read.</p>", l.threads, number(l.memory_gb_per_s));
    }
    for of_scene in by_scene(&found.rows) {
        let scene = &of_scene[0].scene;
        let _ = write!(h, "<h2>{}</h2><div class=\"plots\">", escape(scene));
        for (_, svg) in plots
            .iter()
            .filter(|(name, _)| name.strip_prefix(scene.as_str()).is_some_and(|rest| rest == "-all" || rest == "-far"))
        {
            let _ = write!(h, "<figure>{svg}</figure>");
        }
        h.push_str("</div><div class=\"wide\"><table><tr><th>density</th><th>setting</th>");
        COLUMNS.iter().for_each(|(head, _)| {
            let _ = write!(h, "<th>{head}</th>");
        });
        for r in of_scene {
            let _ = write!(h, "</tr><tr><td>x{}</td><td>{}</td>", r.density, escape(&name(r)));
            COLUMNS.iter().for_each(|(_, of)| {
                let _ = write!(h, "<td>{}</td>", of(r));
            });
        }
        h.push_str("</tr></table></div>");
        let colours: Vec<&ColourRow> = found.colours.iter().filter(|r| r.scene == *scene).collect();
        if colours.is_empty() {
            continue;
        }
        h.push_str("<h3>Colour profiles</h3><p>The images of the views, coded in each profile.</p><div class=\"wide\"><table><tr><th>density</th><th>profile</th>");
        COLOUR_COLUMNS.iter().for_each(|(head, _)| {
            let _ = write!(h, "<th>{head}</th>");
        });
        for r in colours {
            let _ = write!(h, "</tr><tr><td>x{}</td><td>{}</td>", r.density, r.profile);
            COLOUR_COLUMNS.iter().for_each(|(_, of)| {
                let _ = write!(h, "<td>{}</td>", of(r));
            });
        }
        h.push_str("</tr></table></div>");
    }
    let _ = write!(h, "<h2>Command</h2><pre>{}</pre></main>", escape(command));
    h
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bench::speed_error::Setting;
    use ldi_client::{composite::Fill, warp::Stamp};

    fn row(scene: &str, drawn: Drawn, warp_ms: f64, flip: f64) -> Row {
        let setting = Setting {
            drawn,
            epipole: false,
            unclipped: false,
            supersample: 1,
            smooth: false,
            fill: Fill::Surface,
            threads: 2,
        };
        Row {
            scene: scene.into(),
            density: 1.0,
            setting,
            frames: 1,
            samples: 1e6,
            warp_ms,
            hidden: 0.5,
            warp_hidden_ms: warp_ms / 2.0,
            frame_ms: warp_ms + 10.0,
            msamples_per_s: 1e3 / warp_ms,
            of_compute: 0.5,
            of_memory: 0.25,
            psnr_db: 30.0,
            ssim: 0.9,
            flip,
            flip_far: flip,
            flip_over_baseline: 1.0,
            flip_far_over_baseline: 1.0,
            worst_over_baseline: 1.0,
            holes: 0.0,
            holes_before_fill: 0.0,
            orders_differ: None,
        }
    }

    #[test]
    fn every_row_is_in_the_table_and_every_scene_has_its_plots() {
        let rows = [
            row("a<b", Drawn::Images(Stamp::OnePixel), 1.0, 0.2),
            row("a<b", Drawn::Images(Stamp::Quads), 5.0, 0.05),
            row("c", Drawn::Levels, 4.0, 0.1),
        ];
        let table = csv(&rows);
        assert_eq!(table.lines().count(), 4);
        let columns = table.lines().map(|l| l.split(',').count()).collect::<Vec<_>>();
        assert!(columns.iter().all(|c| *c == columns[0]), "{columns:?}");
        let plots = plots(&rows);
        assert_eq!(plots.iter().map(|p| p.0.as_str()).collect::<Vec<_>>(), ["a<b-all", "a<b-far", "c-all", "c-far"]);
        let job = Job {
            scenes: vec![],
            datasets: vec![],
            output: ".".into(),
            budget_percent: 10.0,
            densities: vec![1.0],
            size: (64, 48),
            frames: 1,
            repeat: 1,
            threads: vec![2],
            stamps: vec![],
        };
        let profile = ColourRow {
            scene: "c".into(),
            density: 1.0,
            profile: "high",
            images: 2,
            samples: 2_000_000,
            bytes_per_sample: 0.5,
            colour_bytes_per_sample: 0.3,
            decoded_msamples_per_s: 20.0,
            db_lost: 0.01,
            flip_ratio: 1.01,
            flip_far_ratio: 1.02,
        };
        let table = colours_csv(std::slice::from_ref(&profile));
        let columns = table.lines().map(|l| l.split(',').count()).collect::<Vec<_>>();
        assert!(columns.len() == 2 && columns[0] == columns[1], "{columns:?}");
        let page =
            page(&job, &Found { rows: rows.to_vec(), limits: vec![], colours: vec![profile] }, &plots, "ldi-bench x");
        assert!(page.contains("a&lt;b") && !page.contains("<h2>a<b") && page.contains("levels"));
        assert_eq!(page.matches("<figure>").count(), 4);
        assert_eq!(page.matches("Colour profiles").count(), 1, "only of the scene that has them");
    }
}
