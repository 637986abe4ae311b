//! The table, the plots and the CSV of portals.

use super::portals::{Found, FrameRow, MethodRows};
use crate::plot::{Dot, Plot, Scatter, Series};
use std::fmt::Write as _;

/// Samples of the layers 1, 2, 3 and 4 or more, percent: Figure 5 of Rafferty et al. 1998.
pub const FIGURE_5: [f64; 4] = [72.07, 19.40, 5.80, 2.73];

/// Shares of the first three layers and of all deeper ones, percent.
pub fn layer_shares(samples: &[u64]) -> [f64; 4] {
    let total = samples.iter().sum::<u64>().max(1) as f64;
    let share = |n: u64| n as f64 / total * 100.0;
    let of = |k: usize| samples.get(k).copied().unwrap_or(0);
    [share(of(0)), share(of(1)), share(of(2)), share(samples.iter().skip(3).sum())]
}

/// Share of the samples of shown images that clipping leaves out; NaN without images.
pub fn clipped(r: &MethodRows) -> f64 {
    let [drawn, left_out] = [0, 1].map(|k| r.frames.iter().map(|f| f.samples[k]).sum::<u64>() as f64);
    left_out / (drawn + left_out)
}

/// Whether a frame shows images by the layered method: over those frames methods are compared.
fn shows(found: &Found) -> Vec<bool> {
    let layered = found.methods.iter().find(|m| m.name == "layered image");
    layered.map_or_else(Vec::new, |m| m.frames.iter().map(|f| f.portals > 0).collect())
}

/// The frames of a method that show images.
fn with_images(r: &MethodRows, shows: &[bool]) -> MethodRows {
    let frames = r.frames.iter().zip(shows).filter(|(_, s)| **s).map(|(f, _)| *f).collect();
    MethodRows { name: r.name, frames }
}

fn known(v: f64, digits: usize) -> String {
    if v.is_finite() { format!("{v:.digits$}") } else { "-".into() }
}

/// The tables as text, in Markdown.
pub fn table(all: &[Found]) -> String {
    let mut out = String::new();
    for found in all {
        let shows = shows(found);
        let count = shows.iter().filter(|s| **s).count();
        let culling = found.methods.first().map_or(f64::NAN, |m| with_images(m, &shows).mean(|f| Some(f.ms)));
        let _ = write!(
            out,
            "\n{}: {} triangles, {} frames, {count} of them with images beyond portals; figures over those; {} threads\n\n\
             | method | ms mean | p99 | of culling | new images ms | triangles | samples | clipped | FLIP | over 1 ray | far, over 1 ray | PSNR dB | holes before fill |\n\
             |---|---|---|---|---|---|---|---|---|---|---|---|---|\n",
            found.scene,
            found.triangles,
            shows.len(),
            found.threads
        );
        for all_frames in &found.methods {
            let r = with_images(all_frames, &shows);
            let times = r.sorted(|f| Some(f.ms));
            let p99 = times.get((times.len() * 99 / 100).min(times.len().saturating_sub(1))).copied();
            let mean = r.mean(|f| Some(f.ms));
            let _ = writeln!(
                out,
                "| {} | {} | {} | {} | {} | {} | {} | {} | {} | {} | {} | {} | {} |",
                r.name,
                known(mean, 1),
                known(p99.unwrap_or(f64::NAN), 1),
                known(mean / culling, 2),
                known(r.mean(|f| Some(f.prepare_ms)), 1),
                known(r.mean(|f| Some(f.triangles as f64)), 0),
                known(r.mean(|f| Some(f.samples[0] as f64)), 0),
                known(clipped(&r) * 100.0, 1) + "%",
                known(r.mean(|f| f.flip), 4),
                known(r.mean(|f| f.flip) / r.mean(|f| f.flip_baseline), 2),
                known(r.mean(|f| f.flip_far) / r.mean(|f| f.flip_far_baseline), 2),
                known(r.mean(|f| f.psnr_db), 2),
                known(r.mean(|f| f.holes) * 100.0, 3) + "%"
            );
        }
        let shares = layer_shares(&found.layered_samples);
        let _ = write!(
            out,
            "\nlayered images, samples in layers 1, 2, 3, 4 and deeper: {} (1998: {})\n\
             images: {} references of {:.2} MB, {} layered of {:.2} MB, {} ours of {:.2} MB\n",
            shares.map(|s| format!("{s:.2}%")).join(", "),
            FIGURE_5.map(|s| format!("{s:.2}%")).join(", "),
            found.images[0],
            found.bytes[0] as f64 * 1e-6,
            found.images[1],
            found.bytes[1] as f64 * 1e-6,
            found.images[2],
            found.bytes[2] as f64 * 1e-6
        );
    }
    out
}

/// All frames as CSV.
pub fn csv(all: &[Found]) -> String {
    let mut out = String::from(
        "scene,method,frame,ms,select_ms,near_ms,warp_ms,prepare_ms,triangles,portals,samples_warped,samples_culled,psnr_db,flip,flip_baseline,flip_far,flip_far_baseline,holes_before_fill\n",
    );
    for (found, method) in all.iter().flat_map(|f| f.methods.iter().map(move |m| (f, m))) {
        for f in &method.frames {
            let some = |v: Option<f64>| v.map_or(String::new(), |v| v.to_string());
            let times = [f.ms, f.select_ms, f.near_ms, f.warp_ms, f.prepare_ms].map(|v| v.to_string()).join(",");
            let errors = [f.psnr_db, f.flip, f.flip_baseline, f.flip_far, f.flip_far_baseline, f.holes].map(some);
            let _ = writeln!(
                out,
                "\"{}\",{},{},{times},{},{},{},{},{}",
                found.scene,
                method.name,
                f.frame,
                f.triangles,
                f.portals,
                f.samples[0],
                f.samples[1],
                errors.join(",")
            );
        }
    }
    out
}

/// Figure 6, the methods that it leaves out, and speed against error, by name.
pub fn plots(found: &Found) -> Vec<(&'static str, String)> {
    let series = |names: &[&'static str], of: fn(&FrameRow) -> f64| -> Vec<Series<'_>> {
        let methods = names.iter().filter_map(|n| found.methods.iter().find(|m| m.name == *n));
        methods
            .map(|m| Series { name: m.name, points: m.frames.iter().map(|f| (f.frame as f64, of(f))).collect() })
            .collect()
    };
    let plot = |title, y, names: &[&'static str], of| {
        Plot { title, x: "frame", y, series: series(names, of), bound: None }.svg()
    };
    let paper = ["portal culling", "layered image", "one image", "one texture"];
    let others = ["layered image", "two images", "several textures", "ours"];
    let judged = |f: &FrameRow| f.flip.unwrap_or(f64::NAN);
    let shows = shows(found);
    let dots = found.methods.iter().map(|m| with_images(m, &shows)).map(|m| Dot {
        x: m.mean(|f| Some(f.ms)),
        y: m.mean(|f| f.flip),
        series: usize::from(m.frames.iter().any(|f| f.portals > 0)),
        name: m.name.to_string(),
    });
    let scatter = Scatter {
        title: "Speed against error, frames with images",
        x: "ms per frame",
        y: "FLIP",
        dots: dots.collect(),
    };
    // Judged frames alone, joined.
    let error = |names: &[&'static str]| {
        let mut series = series(names, judged);
        series.iter_mut().for_each(|s| s.points.retain(|p| p.1.is_finite()));
        Plot { title: "Error along the path", x: "frame", y: "FLIP", series, bound: None }.svg()
    };
    vec![
        ("figure6", plot("Figure 6: time along the path", "ms", &paper, |f| f.ms)),
        ("others", plot("Time along the path: other methods", "ms", &others, |f| f.ms)),
        ("error", error(&["layered image", "one image", "one texture", "ours"])),
        ("scatter", scatter.svg()),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frame(ms: f64, portals: usize, samples: [u64; 2], flip: Option<f64>) -> FrameRow {
        FrameRow {
            frame: 0,
            ms,
            select_ms: 0.0,
            near_ms: 0.0,
            warp_ms: 0.0,
            prepare_ms: 0.0,
            triangles: 7,
            portals,
            samples,
            psnr_db: flip.map(|f| 30.0 - f),
            flip,
            flip_far: flip,
            flip_far_baseline: flip,
            flip_baseline: flip.map(|f| f / 2.0),
            holes: flip,
        }
    }

    #[test]
    fn figures_are_taken_over_frames_with_images() {
        let layered = vec![frame(2.0, 1, [30, 70], Some(0.1)), frame(90.0, 0, [0, 0], None)];
        let culling = vec![frame(8.0, 0, [0, 0], Some(0.05)), frame(1.0, 0, [0, 0], None)];
        let found = Found {
            scene: "a".into(),
            triangles: 1,
            threads: 2,
            layered_samples: vec![70, 20, 5, 3, 2],
            bytes: [1, 2, 3],
            images: [4, 5, 6],
            rooms: serde_json::Value::Null,
            methods: vec![
                MethodRows { name: "portal culling", frames: culling },
                MethodRows { name: "layered image", frames: layered },
            ],
        };
        let text = table(std::slice::from_ref(&found));
        assert!(text.contains("| layered image | 2.0 | 2.0 | 0.25 | 0.0 | 7 | 30 | 70.0% | 0.1000 | 2.00 |"), "{text}");
        assert!(text.contains("70.00%, 20.00%, 5.00%, 5.00% (1998: 72.07%"), "{text}");
        assert_eq!(csv(std::slice::from_ref(&found)).lines().count(), 5);
        assert!(plots(&found).iter().all(|(_, svg)| svg.starts_with("<svg")));
    }
}
