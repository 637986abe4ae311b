//! The page beside a load test's report: figures, plots, and how to run it again. Self-contained.

use super::Seen;
use crate::{
    page::STYLE,
    plot::{Plot, Series, escape, number},
};
use hdrhistogram::Histogram;
use serde_json::Value;
use std::fmt::Write as _;

/// The page of a report; `command` as typed.
pub fn html(report: &Value, seen: &Seen, command: &str) -> String {
    let f = |v: &Value| v.as_f64().unwrap_or(f64::NAN);
    let shown = |v: &Value, unit: &str| {
        v.as_f64().map_or("-".into(), |v| format!("{} {unit}", number((v * 10.0).round() / 10.0)))
    };
    let percent = |v: &Value| v.as_f64().map_or("-".into(), |v| format!("{:.2}%", 100.0 * v));
    let title = format!("{} walkers for {} s", report["walkers"], report["seconds"]);
    let mut h = String::from(
        "<!doctype html><html lang=\"en\"><meta charset=\"utf-8\"><meta name=\"viewport\" content=\"width=device-width\">",
    );
    let _ = write!(h, "<title>{title}</title><style>{STYLE}</style><main><h1>{title}</h1>");
    let link = report["link"]["spec"].as_str().map_or("the network as it is".into(), |l| format!("the link {l}"));
    let _ = write!(
        h,
        "<p class=\"lead\">Scenario {}, over {}, {}. A frame is incomplete when any chunk of its view is missing; a chunk's latency runs from the first frame that misses it until it is at hand.</p><section class=\"tiles\">",
        escape(report["options"]["scenario"].as_str().unwrap_or_default()),
        escape(&link),
        if report["options"]["decoding"] == true { "decoding" } else { "without decoding" }
    );
    let settled = &report["after_first_second"];
    for (value, name, note) in [
        (
            report["connected"].to_string(),
            "connected",
            format!("{} dropped, {} refused", report["dropped"], report["refused"]),
        ),
        (
            percent(&report["incomplete_fraction"]),
            "frames incomplete",
            format!("{} after each walker's first second", percent(&settled["incomplete_fraction"])),
        ),
        (
            shown(&report["chunk_ms"]["near"]["p99"], "ms"),
            "near chunks, p99",
            format!(
                "p50 {}, at most {}",
                shown(&report["chunk_ms"]["near"]["p50"], "ms"),
                shown(&report["chunk_ms"]["near"]["max"], "ms")
            ),
        ),
        (
            shown(&report["chunk_ms"]["far"]["p99"], "ms"),
            "far chunks, p99",
            format!(
                "p50 {}, at most {}",
                shown(&report["chunk_ms"]["far"]["p50"], "ms"),
                shown(&report["chunk_ms"]["far"]["max"], "ms")
            ),
        ),
        (
            shown(&report["mbit_per_s_per_walker"]["mean"], "Mbit/s"),
            "per walker",
            format!(
                "{} MB in all, {} of them for no view",
                number(f(&report["bytes_total"]) / 1e6),
                percent(&report["wasted_fraction"])
            ),
        ),
        (
            report["ratio_to_raw_quic"].as_f64().map_or("-".into(), |r| format!("{r:.2}")),
            "of a bare QUIC transfer's bytes per processor second",
            format!(
                "{} of the server's time, {} MB resident",
                shown(&report["server_cpu_s"], "s"),
                number(f(&report["server_rss_bytes"]) / 1e6)
            ),
        ),
    ] {
        let _ = write!(
            h,
            "<div><b>{}</b><span>{}</span><small>{}</small></div>",
            escape(&value),
            escape(name),
            escape(&note)
        );
    }
    h.push_str("</section>");
    if let Some(manners) = report["hostile"]["manners"].as_object() {
        h.push_str("<h2>Hostile connections beside them</h2><table><tr><th>manner</th><th>came in</th><th>thrown out</th><th>turned away</th><th>MB received</th></tr>");
        for (manner, toll) in manners {
            let _ = write!(
                h,
                "<tr><th>{}</th><td>{}</td><td>{}</td><td>{}</td><td>{}</td></tr>",
                escape(manner),
                toll["came_in"],
                toll["thrown_out"],
                toll["turned_away"],
                number(f(&toll["bytes"]) / 1e6)
            );
        }
        h.push_str("</table>");
    }
    let slopes = &report["server_per_hour"];
    if slopes.is_object() {
        let _ = write!(
            h,
            "<h2>Growth of the server</h2><p>Slopes of the least-squares line over {} samples in {}, per hour. Over \
             less than some minutes they show how memory settles, not whether it grows.</p><table>",
            slopes["samples"],
            shown(&slopes["seconds"], "s")
        );
        for (field, unit, scale) in [
            ("rss_bytes", "MB resident", 1e-6),
            ("anonymous_bytes", "MB of its own", 1e-6),
            ("descriptors", "descriptors", 1.0),
            ("threads", "threads", 1.0),
        ] {
            let value = number((f(&slopes[field]) * scale * 100.0).round() / 100.0);
            let _ = write!(h, "<tr><th>{unit}</th><td>{}</td></tr>", escape(&value));
        }
        h.push_str("</table>");
    }
    h.push_str("<h2>Plots</h2><div class=\"plots\">");
    for plot in plots(report, seen) {
        let _ = write!(h, "<figure>{}</figure>", plot.svg());
    }
    h.push_str("</div>");
    if let Some(reasons) = report["reasons"].as_object().filter(|r| !r.is_empty()) {
        h.push_str("<h2>Not measured</h2><table>");
        for (field, reason) in reasons {
            let _ = write!(
                h,
                "<tr><th>{}</th><td>{}</td></tr>",
                escape(field),
                escape(reason.as_str().unwrap_or_default())
            );
        }
        h.push_str("</table>");
    }
    let _ = write!(h, "<h2>How to run it again</h2><pre>{}</pre></main></html>", escape(command));
    h
}

fn plots(report: &Value, seen: &Seen) -> Vec<Plot<'static>> {
    let rows = report["by_second"].as_array().map(Vec::as_slice).unwrap_or_default();
    let series = |name, of: &dyn Fn(&Value) -> Option<f64>| Series {
        name,
        points: rows.iter().enumerate().map(|(i, row)| (i as f64, of(row).unwrap_or(f64::NAN))).collect(),
    };
    let curve = |name, h: &Histogram<u64>| Series {
        name,
        points: (0..=1000)
            .filter(|_| !h.is_empty())
            .map(|i| (f64::from(i) / 10.0, h.value_at_quantile(f64::from(i) / 1000.0) as f64 * 1e-3))
            .collect(),
    };
    let share = |r: &Value| {
        let frames = r["frames"].as_f64().filter(|n| *n > 0.0)?;
        Some(100.0 * r["incomplete"].as_f64()? / frames)
    };
    vec![
        Plot {
            title: "Incomplete frames, second by second",
            x: "second",
            y: "%",
            series: vec![series("incomplete", &share)],
            bound: None,
        },
        Plot {
            title: "Latency of chunks after each walker's first second",
            x: "percentile",
            y: "ms",
            series: vec![curve("near", &seen.latencies.settled[0]), curve("far", &seen.latencies.settled[1])],
            bound: None,
        },
        Plot {
            title: "Latency of chunks, the first second included",
            x: "percentile",
            y: "ms",
            series: vec![curve("near", &seen.latencies.near), curve("far", &seen.latencies.far)],
            bound: None,
        },
        Plot {
            title: "Received by all walkers",
            x: "second",
            y: "Mbit/s",
            series: vec![series("received", &|r| Some(r["bytes"].as_f64()? * 8e-6))],
            bound: None,
        },
        Plot {
            title: "The server's processors in use",
            x: "second",
            y: "cores",
            series: vec![series("cores", &|r| r["server_cpu_s"].as_f64())],
            bound: None,
        },
        Plot {
            title: "The server's memory",
            x: "second",
            y: "MB resident",
            series: vec![series("resident", &|r| Some(r["server_rss_bytes"].as_f64()? * 1e-6))],
            bound: None,
        },
        Plot {
            title: "The server's descriptors and threads",
            x: "second",
            y: "number",
            series: vec![
                series("descriptors", &|r| r["server_descriptors"].as_f64()),
                series("threads", &|r| r["server_threads"].as_f64()),
            ],
            bound: None,
        },
    ]
}
