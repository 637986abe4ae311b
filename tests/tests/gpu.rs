//! `--renderer gpu` from end to end: the same pictures as the processor's, and what is said where
//! there is no driver.

use ldi_tests::{
    fixture::Fixture,
    run::{self, Server},
};
use serde_json::Value;
use std::{
    path::{Path, PathBuf},
    process::{Command, Output},
};

/// What the pictures of a card and of the processor may differ by.
const ALIKE_DB: f64 = 45.0;

fn fixture() -> &'static Fixture {
    Fixture::get(Path::new(env!("CARGO_TARGET_TMPDIR")))
}

/// A walk of the fixture into `dir`/`name`.
fn walk(served: &Server, dir: &Path, name: &str, more: &[&str]) -> Command {
    let mut c = run::command("ldi-client").expect("built");
    c.args(["walk", &served.quic, "--fingerprint", &served.fingerprint, "--size", "320x180", "--pace", "wait"]);
    c.arg("--path").arg(&fixture().poses).arg("-o").arg(dir.join(name));
    c.arg("--report").arg(dir.join(name).with_extension("json")).args(more);
    c
}

fn report(dir: &Path, name: &str) -> Value {
    let text = std::fs::read_to_string(dir.join(name).with_extension("json")).expect("a report");
    serde_json::from_str(&text).expect("JSON")
}

fn said(out: &Output) -> String {
    String::from_utf8_lossy(&out.stderr).into_owned()
}

fn folder(name: &str) -> PathBuf {
    ldi_tests::fixture::empty_folder(Path::new(env!("CARGO_TARGET_TMPDIR")), name)
}

#[test]
fn a_card_draws_what_the_processor_draws() {
    let (f, dir) = (fixture(), folder("card"));
    let served = Server::start(&f.dataset).expect("serves");
    for (number, fine) in [(0, &["--supersample", "1"]), (1, &["--supersample", "2"])] {
        let (on_processor, on_card) = (format!("processor-{number}"), format!("card-{number}"));
        run::run(walk(&served, &dir, &on_processor, fine)).expect("the processor draws");
        let mut c = walk(&served, &dir, &on_card, fine);
        c.args(["--renderer", "gpu", "--warp-on", "gpu", "--truth"]).arg(dir.join(&on_processor));
        let out = c.output().expect("runs");
        if out.status.code() == Some(42) && said(&out).contains("--renderer cpu") {
            println!("SKIPPED: {}", said(&out).trim());
            return;
        }
        assert!(out.status.success(), "{}", said(&out));
        let (cpu, gpu) = (report(&dir, &on_processor), report(&dir, &on_card));
        assert_eq!((&cpu["options"]["renderer"], &gpu["options"]["renderer"]), (&"cpu".into(), &"gpu".into()));
        assert_eq!(gpu["options"]["gpu"]["calibration"]["on_card"], true);
        // What is drawn does not depend on who does it; the processor warps less of it, as it
        // leaves out what near geometry hides.
        let counts = |r: &Value, name: &str| -> Vec<u64> {
            r["frames"].as_array().expect("frames").iter().map(|f| f[name].as_u64().expect("a number")).collect()
        };
        let warped = |r: &Value| counts(r, "samples_warped");
        let held = |r: &Value| -> Vec<u64> {
            warped(r).into_iter().zip(counts(r, "samples_culled")).map(|(w, c)| w + c).collect()
        };
        for name in ["triangles", "missing_chunks"] {
            assert_eq!(counts(&cpu, name), counts(&gpu, name), "{name}");
        }
        assert_eq!(held(&cpu), held(&gpu));
        assert!(warped(&cpu).iter().zip(warped(&gpu)).all(|(c, g)| *c <= g));
        assert!(warped(&gpu).iter().any(|n| *n > 1000), "some frame shows images");
        let least = gpu["summary"]["min_psnr_db"].as_f64().expect("a truth was given");
        assert!(least >= ALIKE_DB, "{least} dB");
        println!("{}: at least {least:.1} dB alike, {fine:?}", gpu["options"]["gpu"]["adapter"]);
    }
    // The other way round the report's figure falls: pictures of other poses are not alike.
    let shifted = dir.join("processor-0");
    std::fs::copy(shifted.join("frame_00000.png"), shifted.join("frame_00001.png")).expect("copied");
    let mut c = walk(&served, &dir, "other", &["--renderer", "gpu", "--truth"]);
    c.arg(&shifted);
    run::run(c).expect("draws");
    assert!(report(&dir, "other")["summary"]["min_psnr_db"].as_f64().expect("a truth") < ALIKE_DB);
    std::fs::remove_dir_all(&dir).expect("removed");
}

/// Hides all drivers of Vulkan from a command.
#[cfg(target_os = "linux")]
fn without_drivers(mut c: Command) -> Output {
    let none = "/nonexistent";
    c.env("VK_ICD_FILENAMES", none).env("VK_DRIVER_FILES", none).output().expect("runs")
}

#[test]
#[cfg(target_os = "linux")]
fn without_a_driver_it_says_what_to_install_or_draws_on_the_processor() {
    let (f, dir) = (fixture(), folder("no-driver"));
    let served = Server::start(&f.dataset).expect("serves");
    let out = without_drivers(walk(&served, &dir, "card", &["--renderer", "gpu"]));
    assert_eq!(out.status.code(), Some(42), "{}", said(&out));
    for part in ["mesa-vulkan-drivers", "--renderer cpu"] {
        assert!(said(&out).contains(part), "{part}: {}", said(&out));
    }
    let out = without_drivers(walk(&served, &dir, "any", &["--renderer", "auto"]));
    assert!(out.status.success(), "{}", said(&out));
    assert_eq!(report(&dir, "any")["options"]["renderer"], "cpu");
    let out = walk(&served, &dir, "both", &["--renderer", "gpu", "--warp-on", "gpu", "--stamp", "ewa"]).output();
    let out = out.expect("runs");
    assert_eq!(out.status.code(), Some(2), "{}", said(&out));
    assert!(said(&out).contains("ewa"), "{}", said(&out));
    std::fs::remove_dir_all(&dir).expect("removed");
}
