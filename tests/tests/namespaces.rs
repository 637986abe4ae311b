//! Server and client in network namespaces of their own, joined by links of every kind: the
//! kernel's sockets, buffers and offloads take part, which no link within a process has.

use ldi_tests::{
    fixture::{Fixture, SIZE},
    namespace, run,
    run::Server,
};
use serde_json::Value;
use std::{
    path::{Path, PathBuf},
    process::{Command, Stdio},
};

/// Links, and whether some packets never arrive.
const SCENARIOS: [(&str, &str, bool); 5] = [
    ("near", "rate=100mbit,delay=2500us", false),
    ("far", "rate=25mbit,delay=40ms", false),
    ("lossy", "rate=25mbit,delay=20ms,loss=2%,seed=3", true),
    ("unsteady", "rate=50mbit,delay=10ms,jitter=8ms,dup=2%", false),
    // It begins while the first frames arrive.
    ("dark", "rate=10mbit,delay=5ms,blackout=200ms:1500ms", true),
];

fn walk(server: &Server, at: &str, fixture: &Fixture, out: &Path) -> Command {
    let mut c = run::command("ldi-client").expect("built");
    c.args(["walk", at, "--fingerprint", &server.fingerprint, "--path"]).arg(&fixture.poses);
    c.args(["--size", SIZE, "--pace", "wait", "--report"]).arg(out.join("walk.json")).arg("-o").arg(out.join("frames"));
    c
}

fn pictures(out: &Path) -> Vec<Vec<u8>> {
    (0..5).map(|k| std::fs::read(out.join(format!("frames/frame_{k:05}.png"))).expect("a picture")).collect()
}

#[test]
fn a_walk_shows_the_same_pictures_behind_every_link() {
    if let Err(why) = namespace::available() {
        return eprintln!("skipped: {why:#}");
    }
    let tmp = Path::new(env!("CARGO_TARGET_TMPDIR"));
    let fixture = Fixture::get(tmp);
    let folder = |name: &str| -> PathBuf {
        let dir = tmp.join(format!("namespaces-{name}-{}", std::process::id()));
        let _ = std::fs::remove_dir_all(&dir);
        std::fs::create_dir_all(&dir).expect("writable");
        dir
    };
    let server = Server::start_at(&fixture.dataset, "0.0.0.0:0").expect("serves");
    let port = server.quic.rsplit_once(':').expect("a port").1;
    let here = folder("here");
    run::run(walk(&server, &format!("127.0.0.1:{port}"), fixture, &here)).expect("walks");
    for (name, link, loses) in SCENARIOS {
        let out = folder(name);
        let inside = walk(&server, &format!("{{host}}:{port}"), fixture, &out);
        let mut c = run::command("ldi-link").expect("built");
        c.arg(link).arg("--").arg(inside.get_program()).args(inside.get_args());
        let done = c.stdout(Stdio::null()).output().expect("runs");
        let said = String::from_utf8_lossy(&done.stderr);
        assert!(done.status.success(), "{name}: {said}");
        let report: Value =
            serde_json::from_slice(&std::fs::read(out.join("walk.json")).expect("a report")).expect("JSON");
        assert_eq!(report["summary"]["frames_incomplete"], 0, "{name}");
        assert!(pictures(&out) == pictures(&here), "{name}: other pictures");
        let counts = |way: &str| -> Vec<u64> {
            let line = said.lines().find(|l| l.starts_with(way)).expect("counts are said");
            line.split(|c: char| !c.is_ascii_digit()).filter_map(|n| n.parse().ok()).collect()
        };
        // Packets sent, lost, dropped; bytes delivered.
        let (up, down) = (counts("up:"), counts("down:"));
        assert!(down[0] > 100 && down[3] > 100_000 && up[0] > 10, "{name}: all went through the link: {said}");
        assert_eq!(up[1] + down[1] > 0, loses, "{name}: {said}");
    }
}

#[test]
fn a_command_that_fails_or_is_absent_is_told() {
    if let Err(why) = namespace::available() {
        return eprintln!("skipped: {why:#}");
    }
    let link = |command: &[&str]| {
        let out =
            run::command("ldi-link").expect("built").args(["delay=1ms", "--"]).args(command).output().expect("runs");
        (out.status.code(), String::from_utf8_lossy(&out.stderr).into_owned())
    };
    assert_eq!(link(&["sh", "-c", "exit 7"]).0, Some(7));
    let (code, said) = link(&["/no/such/program"]);
    assert!(code == Some(42) && said.contains("/no/such/program"), "{said}");
}
