//! `ldi-load` against a small server: the report's fields, its sums, its exit codes.

#[path = "../../client/src/cache/fixture.rs"]
#[allow(dead_code, reason = "shared with other tests, which use the rest")]
mod fixture;
#[path = "streaming/host.rs"]
#[allow(dead_code, reason = "shared with other tests, which use the rest")]
mod host;

use fixture::street;
use host::{Host, Memory, folder};
use ldi_tests::run;
use serde_json::Value;
use std::{path::Path, process::Output};

/// Along the street and back; it does not end where it begins.
const PATH: &str = r#"{ "speed": 20, "waypoints": [[0, 0, 5], [0, 0, -60]] }"#;

fn load(host: &Host, folder: &Path, more: &[&str]) -> Output {
    let path = folder.join("street.path.json");
    std::fs::write(&path, PATH).expect("writable");
    let mut c = run::command("ldi-load").expect("built");
    c.arg(host.server().quic().to_string()).args(["--fingerprint", host.server().fingerprint()]);
    c.arg("--path").arg(path).arg("--report").arg(folder.join("load.json")).args(more);
    c.output().expect("runs")
}

#[test]
fn two_walkers_for_two_seconds_leave_a_whole_report() {
    let host = Host::start("load", Memory::new(street(12, 64)));
    let folder = folder("load-report");
    let pid = std::process::id().to_string();
    let link = "delay=2ms,jitter=1ms,loss=1%,seed=4";
    let out = load(&host, &folder, &["--walkers", "2", "--seconds", "2", "--server-pid", &pid, "--link", link]);
    assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
    let text = std::fs::read_to_string(folder.join("load.json")).expect("a report");
    let r: Value = serde_json::from_str(&text).expect("JSON");

    assert_eq!((&r["walkers"], &r["connected"], &r["dropped"]), (&2.into(), &2.into(), &0.into()));
    assert_eq!(r["seconds"], 2.0);
    for kind in ["near", "far"] {
        let [p50, p99, max] = ["p50", "p99", "max"].map(|q| r["chunk_ms"][kind][q].as_f64().expect("a latency"));
        assert!(0.0 <= p50 && p50 <= p99 && p99 <= max && max > 0.0, "{kind}: {p50} {p99} {max}");
    }
    for share in ["incomplete_fraction", "wasted_fraction"] {
        let share = r[share].as_f64().expect("a share");
        assert!((0.0..=1.0).contains(&share), "{share}");
    }
    assert!(r["frames_incomplete"].as_u64() > Some(0), "the first frame misses everything");
    let n = |v: &Value| v.as_u64().expect("a count");
    assert!(n(&r["frames"]) > n(&r["frames_incomplete"]), "and at some time all is there");
    let stored = n(&r["chunk_bytes"]);
    assert!(n(&r["bytes_total"]) > stored && stored > 0);
    assert!(n(&r["chunks"]["first_needed"]) >= 10, "{}", r["chunks"]);
    let rate = |q: &str| r["mbit_per_s_per_walker"][q].as_f64().expect("a rate");
    assert!(rate("min") > 0.0 && rate("min") <= rate("mean") && rate("mean") <= rate("max"));
    for direction in ["up", "down"] {
        let l = &r["link"][direction];
        assert_eq!(n(&l["sent"]), n(&l["delivered"]) + n(&l["lost"]) + n(&l["dropped"]), "{direction}");
        assert!(n(&l["sent"]) > 0);
    }
    assert!(r["server_rss_bytes"].as_u64() > Some(1_000_000), "{}", r["server_rss_bytes"]);
    assert!(r["server_cpu_s"].is_number());
    for slope in ["rss_bytes", "anonymous_bytes", "descriptors", "threads"] {
        assert!(r["server_per_hour"][slope].is_number(), "{slope}: {}", r["server_per_hour"]);
    }
    assert!(n(&r["by_second"][1]["server_descriptors"]) > 3 && n(&r["by_second"][1]["server_threads"]) > 1);
    // What so short a run cannot tell is null, and a reason says why.
    for field in ["bytes_per_server_cpu_s", "raw_quic_bytes_per_server_cpu_s"] {
        assert!(r[field].is_number() || r["reasons"][field].is_string(), "{field}");
    }
    let page = std::fs::read_to_string(folder.join("load.html")).expect("a page");
    assert!(page.contains("2 walkers for 2") && page.contains("<svg") && page.contains("ldi-load"));
    assert!(page.contains("Growth of the server") && page.contains("descriptors"));
}

#[test]
fn without_the_server_s_process_its_cost_is_null_with_a_reason() {
    let host = Host::start("load-alone", Memory::new(street(4, 16)));
    let folder = folder("load-alone-report");
    let more = ["--walkers", "1", "--seconds", "0.5", "--no-raw", "--decode", "off", "--scenario", "spin"];
    let out = load(&host, &folder, &more);
    assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
    let text = std::fs::read_to_string(folder.join("load.json")).expect("a report");
    let r: Value = serde_json::from_str(&text).expect("JSON");
    for field in [
        "server_rss_bytes",
        "server_per_hour",
        "server_cpu_s",
        "bytes_per_server_cpu_s",
        "raw_quic_bytes_per_server_cpu_s",
    ] {
        assert!(r[field].is_null() && r["reasons"][field].is_string(), "{field}: {}", r[field]);
    }
    assert_eq!(r["options"]["decoding"], false);
    assert!(r["chunks"]["received"].as_u64() > Some(0));
}

/// They come and go, and the walker gets what it needs.
#[test]
fn hostile_connections_are_counted_beside_a_walker_who_lacks_nothing() {
    let host = Host::start("load-hostile", Memory::new(street(12, 64)));
    let folder = folder("load-hostile-report");
    let more = ["--walkers", "1", "--seconds", "2", "--no-raw", "--hostile", "8"];
    let out = load(&host, &folder, &more);
    assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
    let text = std::fs::read_to_string(folder.join("load.json")).expect("a report");
    let r: Value = serde_json::from_str(&text).expect("JSON");
    assert_eq!((&r["connected"], &r["dropped"]), (&1.into(), &0.into()));
    assert!(
        r["chunks"]["unfinished_at_the_end"] == 0 && r["chunks"]["received"].as_u64() > Some(10),
        "{}",
        r["chunks"]
    );
    let toll = |manner: &str, field: &str| r["hostile"]["manners"][manner][field].as_u64().expect("a count");
    for manner in ["silent", "slow", "flooding", "malformed"] {
        assert!(toll(manner, "came_in") >= 2, "{manner}: {}", r["hostile"]);
    }
    assert!(toll("malformed", "thrown_out") >= 2, "{}", r["hostile"]);
    assert_eq!(toll("slow", "thrown_out"), 0, "nothing that it does is forbidden");
    assert!(toll("flooding", "bytes") > toll("silent", "bytes"), "{}", r["hostile"]);
    let page = std::fs::read_to_string(folder.join("load.html")).expect("a page");
    assert!(page.contains("malformed"));
}

#[test]
fn hostile_connections_come_without_walkers_too() {
    let host = Host::start("load-alone-hostile", Memory::new(street(2, 16)));
    let folder = folder("load-alone-hostile-report");
    let pid = std::process::id().to_string();
    let more = ["--walkers", "0", "--seconds", "2", "--no-raw", "--hostile", "2", "--hostile-as", "malformed"];
    let out = load(&host, &folder, &[&more[..], &["--server-pid", &pid]].concat());
    assert!(out.status.success(), "{}", String::from_utf8_lossy(&out.stderr));
    let text = std::fs::read_to_string(folder.join("load.json")).expect("a report");
    let r: Value = serde_json::from_str(&text).expect("JSON");
    assert!(r["incomplete_fraction"].is_null() && r["reasons"]["incomplete_fraction"].is_string());
    assert_eq!(r["hostile"]["manners"].as_object().map(|m| m.len()), Some(1));
    // The server is looked at for as long as they stay.
    assert!(r["by_second"][1]["server_rss_bytes"].as_u64() > Some(0), "{}", r["by_second"]);
    let out = load(&host, &folder, &["--walkers", "0", "--seconds", "1"]);
    let said = String::from_utf8_lossy(&out.stderr).into_owned();
    assert!(out.status.code() == Some(2) && said.contains("--hostile"), "{said}");
}

#[test]
fn the_door_opens_as_for_the_client() {
    let host = Host::start("load-door", Memory::new(street(2, 16)));
    let folder = folder("load-door-report");
    let quic = host.server().quic().to_string();
    let end = |arguments: &[&str]| {
        let mut c = run::command("ldi-load").expect("built");
        c.args(["--walkers", "1", "--seconds", "1", "--no-raw", "--report"]).arg(folder.join("r.json"));
        let out = c.args(arguments).output().expect("runs");
        (out.status.code(), String::from_utf8_lossy(&out.stderr).into_owned())
    };
    let (code, said) = end(&[&quic, "--random", "1"]);
    assert!(code == Some(2) && said.contains(host.server().fingerprint()), "{code:?} {said}");
    let known = ["--fingerprint", host.server().fingerprint()];
    let (code, said) = end(&[&[&quic, "--link", "loss=2"][..], &known, &["--random", "1"]].concat());
    assert!(code == Some(2) && said.contains("for example rate=20mbit"), "{code:?} {said}");
    let mut c = run::command("ldi-load").expect("built");
    c.args([&quic, "--walkers", "1", "--random", "1", "--seconds", "1", "--report"])
        .arg(folder.join("r.html"))
        .args(known);
    let out = c.output().expect("runs");
    let said = String::from_utf8_lossy(&out.stderr).into_owned();
    assert!(out.status.code() == Some(2) && said.contains("name it .json"), "{said}");
    let (code, said) = end(&[&[&quic, "--server-pid", "4294967295"][..], &known, &["--random", "1"]].concat());
    assert!(code == Some(2) && said.contains("no such process"), "{code:?} {said}");
    let (code, said) = end(&[&[quic.as_str()][..], &known, &["--path", "/nowhere.json"]].concat());
    assert!(code == Some(42) && said.contains("/nowhere.json"), "{code:?} {said}");
    assert!(!folder.join("r.json").exists() && !folder.join("r.tmp").exists());
}
