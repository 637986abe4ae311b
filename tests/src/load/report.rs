//! What a load test leaves: the fields of the contract, and what explains them. What could not be
//! measured is null, and `reasons` says why.

use super::{Load, Seen, soak, walker::Outcome};
use hdrhistogram::Histogram;
use ldi_client::stream::LinkCounts;
use serde_json::{Map, Value, json};

/// Less processor time than this is too coarse to divide by: it is told in hundredths of a second.
const LEAST_CPU_S: f64 = 0.2;

/// The report.
pub fn report(load: &Load, seen: &Seen) -> Value {
    let inside: Vec<&Outcome> = seen.walkers.iter().filter(|w| w.refused.is_none()).collect();
    let sum = |of: &dyn Fn(&Outcome) -> u64| inside.iter().map(|w| of(w)).sum::<u64>();
    let mut reasons = Map::new();
    let mut known = |name: &str, value: Option<Value>, reason: &str| {
        value.unwrap_or_else(|| {
            reasons.insert(name.into(), reason.into());
            Value::Null
        })
    };
    let bytes_total = sum(&|w| w.stats.bytes_total);
    let rates: Vec<f64> = inside.iter().map(|w| w.stats.bytes_total as f64 * 8e-6 / w.seconds.max(1e-3)).collect();
    let fraction = |part: u64, of: u64| (of > 0).then(|| json!(part as f64 / of as f64));

    let no_pid = "no --server-pid: the server's process is not known";
    let no_slope = if load.server.is_some() { "fewer than two seconds after all came in" } else { no_pid };
    let cpu_s = seen.server.last().map(|s| s.cpu_s);
    let rss = seen.server.iter().map(|s| s.rss_bytes).max();
    let per_cpu = cpu_s.filter(|s| *s >= LEAST_CPU_S).map(|s| bytes_total as f64 / s);
    let short = format!("the server used less than {LEAST_CPU_S} s of processor time, which is told in hundredths");
    let raw = seen.raw.as_ref().ok().filter(|r| r.server_cpu_s >= LEAST_CPU_S);
    let raw_per_cpu = raw.map(|r| r.bytes as f64 / r.server_cpu_s);
    let raw_reason = match &seen.raw {
        Err(e) => e.clone(),
        Ok(_) => "the transfer took too little processor time".into(),
    };
    let failures: Vec<String> = seen
        .walkers
        .iter()
        .filter_map(|w| w.refused.as_ref().map(ToString::to_string).or_else(|| w.lost.clone()))
        .take(10)
        .collect();
    let mut report = json!({
        "walkers": load.walkers,
        "seconds": load.seconds,
        "connected": inside.len(),
        "dropped": inside.iter().filter(|w| w.lost.is_some()).count(),
        "chunk_ms": {
            "near": latency(&seen.latencies.near),
            "far": latency(&seen.latencies.far),
        },
        "incomplete_fraction": known("incomplete_fraction", fraction(sum(&|w| w.incomplete), sum(&|w| w.frames)), "no frame was due"),
        "bytes_total": bytes_total,
        "mbit_per_s_per_walker": {
            "mean": known("mbit_per_s_per_walker", (!rates.is_empty()).then(|| json!(rates.iter().sum::<f64>() / rates.len() as f64)), "nobody came in"),
            "min": rates.iter().copied().reduce(f64::min),
            "max": rates.iter().copied().reduce(f64::max),
        },
        "wasted_fraction": known("wasted_fraction", fraction(sum(&|w| w.stats.wasted_bytes), bytes_total), "no byte came"),
        "server_rss_bytes": known("server_rss_bytes", rss.map(Value::from), no_pid),
        "server_per_hour": known("server_per_hour", soak::slopes(&seen.server, load.ramp_s), no_slope),
        "server_cpu_s": known("server_cpu_s", cpu_s.map(Value::from), no_pid),
        "bytes_per_server_cpu_s": known("bytes_per_server_cpu_s", per_cpu.map(Value::from), if cpu_s.is_none() { no_pid } else { &short }),
        "raw_quic_bytes_per_server_cpu_s": known("raw_quic_bytes_per_server_cpu_s", raw_per_cpu.map(Value::from), &raw_reason),
    });
    let more = json!({
        "ratio_to_raw_quic": per_cpu.zip(raw_per_cpu).map(|(ours, raw)| ours / raw),
        "raw_quic": seen.raw.as_ref().ok().map(|r| json!({
            "bytes": r.bytes, "seconds": r.seconds, "server_cpu_s": r.server_cpu_s, "connections": 1,
        })),
        "server_rss_bytes_before": rss.map(|_| seen.server_before.rss_bytes),
        "server_rss_bytes_per_walker": rss.map(|now| now.saturating_sub(seen.server_before.rss_bytes) / load.walkers.max(1) as u64),
        "server_anonymous_bytes_before": rss.map(|_| seen.server_before.anonymous_bytes),
        "server_anonymous_bytes": seen.server.iter().map(|s| s.anonymous_bytes).max(),
        "hostile": (load.hostile > 0).then(|| hostile(load, seen)),
        "load_cpu_s": seen.load_cpu_s,
        "refused": seen.walkers.len() - inside.len(),
        "failures": failures,
        "frames": sum(&|w| w.frames),
        "frames_incomplete": sum(&|w| w.incomplete),
        "frames_skipped": sum(&|w| w.skipped),
        "after_first_second": {
            "frames": sum(&|w| w.settled_frames),
            "incomplete_fraction": fraction(sum(&|w| w.settled_incomplete), sum(&|w| w.settled_frames)),
            "chunk_ms": { "near": latency(&seen.latencies.settled[0]), "far": latency(&seen.latencies.settled[1]) },
        },
        "chunks": {
            "received": sum(&|w| w.stats.chunks),
            "first_needed": sum(&|w| w.first_needed),
            "at_hand_in_advance": sum(&|w| w.in_advance),
            "left_behind": sum(&|w| w.left_behind),
            "unfinished_at_the_end": sum(&|w| w.unfinished),
            "damaged": sum(&|w| w.stats.damaged),
            "duplicates": sum(&|w| w.stats.duplicates),
            "given_up_undecoded": sum(&|w| w.stats.abandoned),
            "broken_off": sum(&|w| w.stats.broken_off),
        },
        "chunk_bytes": sum(&|w| w.stats.chunk_bytes),
        "wasted_bytes": sum(&|w| w.stats.wasted_bytes),
        "cache_peak_bytes": { "max": inside.iter().map(|w| w.cache_peak_bytes).max() },
        "connect_ms": { "max": inside.iter().map(|w| w.connect_ms).reduce(f64::max) },
        "link": load.config.link.map(|spec| json!({ "spec": spec.to_string(), "up": link(&inside, 0), "down": link(&inside, 1) })),
        "options": {
            "server": load.config.server,
            "scenario": format!("{:?}", load.scenario).to_lowercase(),
            "ramp_s": load.ramp_s,
            "decoding": load.config.decoding,
            "cache_bytes": load.config.cache_bytes,
            "prefetch_m": load.config.prefetch_m,
            "size": format!("{}x{}", load.config.picture.width, load.config.picture.height),
            "random_seed": if let super::track::Route::Random(seed) = load.route { Some(seed) } else { None },
        },
        "by_second": by_second(load, &inside, seen),
    });
    if let (Value::Object(report), Value::Object(more)) = (&mut report, more) {
        report.extend(more);
        report.insert("reasons".into(), Value::Object(reasons));
    }
    report
}

/// By manner: connections that stood, were ended by the server, never stood; and what they
/// received.
fn hostile(load: &Load, seen: &Seen) -> Value {
    let manners = seen.hostile.iter().map(|(manner, t)| {
        let toll =
            json!({ "came_in": t.came_in, "thrown_out": t.thrown_out, "turned_away": t.turned_away, "bytes": t.bytes });
        (format!("{manner:?}").to_lowercase(), toll)
    });
    json!({ "connections": load.hostile, "manners": Value::Object(manners.collect()) })
}

/// Nothing measured is null, not 0.
fn latency(h: &Histogram<u64>) -> Value {
    let ms = |us: u64| (!h.is_empty()).then_some(us as f64 * 1e-3);
    json!({
        "count": h.len(),
        "p50": ms(h.value_at_quantile(0.5)),
        "p90": ms(h.value_at_quantile(0.9)),
        "p99": ms(h.value_at_quantile(0.99)),
        "max": ms(h.max()),
    })
}

fn link(walkers: &[&Outcome], direction: usize) -> Value {
    let mut c = LinkCounts::default();
    walkers.iter().filter_map(|w| w.stats.link).for_each(|l| c += l[direction]);
    json!({ "sent": c.sent, "delivered": c.delivered, "lost": c.lost, "dropped": c.dropped, "bytes": c.bytes })
}

/// Whole seconds, and what began of the last one.
fn by_second(load: &Load, walkers: &[&Outcome], seen: &Seen) -> Vec<Value> {
    let seconds = (load.ramp_s + load.seconds).ceil() as usize;
    let cpu = |i: usize| seen.server.get(i).map(|s| s.cpu_s);
    (0..seconds)
        .map(|i| {
            let all = || walkers.iter().filter_map(|w| w.by_second.get(i));
            json!({
                "frames": all().map(|s| s.frames).sum::<u64>(),
                "incomplete": all().map(|s| s.incomplete).sum::<u64>(),
                "bytes": all().map(|s| s.bytes).sum::<u64>(),
                "server_cpu_s": cpu(i).map(|c| c - if i == 0 { 0.0 } else { cpu(i - 1).unwrap_or_default() }),
                "server_rss_bytes": seen.server.get(i).map(|s| s.rss_bytes),
                "server_anonymous_bytes": seen.server.get(i).map(|s| s.anonymous_bytes),
                "server_descriptors": seen.server.get(i).map(|s| s.descriptors),
                "server_threads": seen.server.get(i).map(|s| s.threads),
            })
        })
        .collect()
}
