//! The real binaries, from scene to walked frames, on a small built-in house.

use ldi_protocol::select::draw_list;
use ldi_server::store::Dataset;
use ldi_tests::fixture::{BUDGET, Fixture, REPRESENT, SIZE};
use ldi_tests::run::{self, Server};
use serde_json::Value;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::time::Duration;

/// A fresh folder for one test.
fn folder(name: &str) -> PathBuf {
    ldi_tests::fixture::empty_folder(Path::new(env!("CARGO_TARGET_TMPDIR")), name)
}

fn server(args: &[&str]) -> Command {
    let mut c = run::command("ldi-server").expect("built");
    c.args(args);
    c
}

fn json(path: &Path) -> Value {
    serde_json::from_str(&std::fs::read_to_string(path).expect("readable")).expect("JSON")
}

/// Exit code and stderr.
fn outcome(o: &Output) -> (Option<i32>, String) {
    (o.status.code(), String::from_utf8_lossy(&o.stderr).into_owned())
}

fn fixture() -> &'static Fixture {
    Fixture::get(Path::new(env!("CARGO_TARGET_TMPDIR")))
}

fn build_command(scene: &Path, dataset: &Path, more: &[&str]) -> Command {
    let mut c = server(&["build"]);
    c.arg(scene).arg("-o").arg(dataset).args(["--budget", BUDGET, "--size", SIZE]).args(REPRESENT).args(more);
    c
}

fn build(scene: &Path, dataset: &Path, more: &[&str]) {
    run::run(build_command(scene, dataset, more)).expect("builds");
}

/// Every file of a dataset but the report, by name.
fn dataset_bytes(dataset: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut files = BTreeMap::new();
    let mut folders = vec![dataset.to_path_buf()];
    while let Some(f) = folders.pop() {
        for path in std::fs::read_dir(f).expect("readable").map(|e| e.expect("readable").path()) {
            if path.is_dir() {
                folders.push(path);
            } else if !path.ends_with("report.json") {
                let name = path.strip_prefix(dataset).expect("inside").to_path_buf();
                files.insert(name, std::fs::read(&path).expect("readable"));
            }
        }
    }
    files
}

/// Copies every file of a dataset but the report; returns them.
fn copy_dataset(from: &Path, to: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let files = dataset_bytes(from);
    for (name, bytes) in &files {
        let file = to.join(name);
        std::fs::create_dir_all(file.parent().expect("has a folder")).expect("writable");
        std::fs::write(file, bytes).expect("writable");
    }
    files
}

fn assert_same_dataset(a: &Path, b: &Path) {
    let (a, b) = (dataset_bytes(a), dataset_bytes(b));
    assert_eq!(a.keys().collect::<Vec<_>>(), b.keys().collect::<Vec<_>>());
    for (name, bytes) in &a {
        assert!(*bytes == b[name], "{} differs", name.display());
    }
}

/// Walks the fixture's poses; returns the report.
fn walk(served: &Server, f: &Fixture, out: &Path, more: &[&str]) -> Value {
    run::run(walking(served, f, out, more)).expect("walks");
    json(&out.join("walk.json"))
}

fn walking(served: &Server, f: &Fixture, out: &Path, more: &[&str]) -> Command {
    let mut c = run::command("ldi-client").expect("built");
    c.args(["walk", &served.quic, "--fingerprint", &served.fingerprint, "--path"]).arg(&f.poses);
    c.args(["--size", SIZE, "--pace", "wait", "-o"])
        .arg(out.join("frames"))
        .arg("--report")
        .arg(out.join("walk.json"))
        .args(more);
    c
}

#[test]
fn a_walk_keeps_the_budget_and_looks_like_the_truth() {
    let f = fixture();
    let out = folder("walk");
    for (samples, extra, name) in [("16", "--depth", "truth"), ("1", "--mips", "baseline")] {
        let mut c = server(&["render"]);
        c.arg(&f.scene)
            .arg("--path")
            .arg(&f.poses)
            .args(["--size", SIZE, "--samples", samples, extra, "-o"])
            .arg(out.join(name));
        run::run(c).expect("renders");
    }
    let served = Server::start(&f.dataset).expect("serves");
    let (truth, baseline) = (out.join("truth"), out.join("baseline"));
    let [truth, baseline] = [&truth, &baseline].map(|p| p.to_str().expect("UTF-8"));
    let report = walk(&served, f, &out, &["--truth", truth, "--baseline", baseline]);
    let s = &report["summary"];
    assert_eq!(s["frames"], 5);
    assert_eq!(s["budget_violations"], 0);
    assert_eq!(s["frames_incomplete"], 0);
    assert!(s["max_triangles"].as_u64().expect("a count") <= BUDGET.parse::<u64>().expect("a number"));
    let frames = report["frames"].as_array().expect("frames");
    assert!(frames.iter().any(|f| f["placement"].is_u64()), "some pose uses an image");
    assert!(frames.iter().any(|f| f["samples_warped"].as_u64() > Some(0)), "some pose warps samples");
    let ratio = s["flip_over_baseline"]["mean"].as_f64().expect("a figure");
    assert!(ratio <= 1.5, "mean FLIP is {ratio} times that of all geometry at one sample per pixel");
    assert!(s["hole_fraction_max"].as_f64().expect("a figure") < 0.01, "{}", s["hole_fraction_max"]);
}

#[test]
fn a_walk_over_a_bad_link_draws_the_same_frames() {
    let f = fixture();
    let out = folder("link");
    let served = Server::start(&f.dataset).expect("serves");
    let pictures = |name: &str, more: &[&str]| {
        let out = out.join(name);
        std::fs::create_dir_all(&out).expect("writable");
        let report = walk(&served, f, &out, more);
        assert_eq!(report["summary"]["frames_incomplete"], 0, "{name}");
        let frame = |i: usize| std::fs::read(out.join(format!("frames/frame_{i:05}.png"))).expect("a picture");
        ((0..5).map(frame).collect::<Vec<_>>(), report)
    };
    let bad = "rate=60mbit,delay=4ms,jitter=3ms,loss=3%,queue=40ms,seed=5";
    let (clean, quick) = pictures("clean", &[]);
    let (lossy, slow) = pictures("lossy", &["--link", bad]);
    assert!(clean == lossy, "what arrives over a bad link is the same data");
    assert!(quick["options"]["link"].is_null());
    assert_eq!(slow["options"]["link"], "rate=60000kbit,delay=4ms,jitter=3ms,loss=3%,queue=40ms,seed=5");
    let lost = slow["link"]["down"]["lost"].as_u64().expect("a count");
    assert!(lost > 0 && slow["link"]["down"]["delivered"].as_u64() > Some(10 * lost), "{}", slow["link"]);

    let mut c = run::command("ldi-client").expect("built");
    c.args(["walk", &served.quic, "--link", "rate=20", "--size", SIZE, "--path"]).arg(&f.poses);
    let (code, said) = outcome(&c.arg("-o").arg(&out).arg("--report").arg(out.join("r.json")).output().expect("runs"));
    assert!(code == Some(2) && said.contains("for example rate=20mbit,delay=20ms"), "{code:?} {said}");
}

#[test]
fn a_folder_of_datasets_is_served_by_name() {
    let f = fixture();
    let out = folder("folder");
    let both = out.join("datasets");
    copy_dataset(&f.dataset, &both.join("house"));
    copy_dataset(&f.dataset, &both.join("annex"));
    // Neither of these is one.
    std::fs::create_dir_all(both.join("notes")).expect("writable");
    std::fs::write(both.join("readme.txt"), "plans of the house").expect("writable");
    let checked = server(&["serve", "--check"]).arg(&both).output().expect("runs");
    let said = String::from_utf8_lossy(&checked.stdout).into_owned();
    assert!(checked.status.success() && said.lines().count() == 2 && said.contains("annex: can be served"), "{said}");
    let served = Server::start(&both).expect("serves");
    let walk = |address: &str, report: &Path| {
        let mut c = run::command("ldi-client").expect("built");
        c.args(["walk", address, "--fingerprint", &served.fingerprint, "--size", SIZE, "--pace", "wait"]);
        c.args(["--every", "4"]).arg("--path").arg(&f.poses).arg("-o").arg(out.join("frames"));
        outcome(&c.arg("--report").arg(report).output().expect("runs"))
    };
    let (code, said) = walk(&served.quic, &out.join("none.json"));
    assert!(code == Some(42) && said.contains("annex, house"), "{code:?} {said}");
    let (code, said) = walk(&format!("{}/cellar", served.quic), &out.join("none.json"));
    assert!(code == Some(42) && said.contains("'cellar'") && said.contains("annex, house"), "{code:?} {said}");
    let report = out.join("walk.json");
    let (code, said) = walk(&format!("{}/house", served.quic), &report);
    assert_eq!(code, Some(0), "{said}");
    assert_eq!(json(&report)["summary"]["frames_incomplete"], 0);
}

/// The server ends in the middle of a walk and comes back at the same address: the walk waits for
/// it, and is sent the rest.
#[test]
fn a_walk_outlives_its_connection() {
    let f = fixture();
    let out = folder("outlives");
    let walking = |name: &str, server: &str, fingerprint: &str, link: &str| {
        let mut c = run::command("ldi-client").expect("built");
        c.args(["walk", server, "--fingerprint", fingerprint, "--path"]).arg(&f.poses).args(["--size", SIZE]);
        c.args(["--pace", "wait", "--link", link, "-o"]).arg(out.join(name)).arg("--report");
        c.arg(out.join(format!("{name}.json"))).stdout(Stdio::null()).stderr(Stdio::null());
        c
    };
    let served = Server::start(&f.dataset).expect("serves");
    let (at, fingerprint) = (served.quic.clone(), served.fingerprint.clone());
    let picture = |name: &str, pose: usize| out.join(name).join(format!("frame_{pose:05}.png"));
    run::run(walking("whole", &at, &fingerprint, "delay=1ms")).expect("walks");
    // Slow enough that there is a middle.
    let mut child = walking("broken", &at, &fingerprint, "rate=2mbit,delay=1ms").spawn().expect("starts");
    let ends = |child: &mut std::process::Child| child.try_wait().expect("known").is_some();
    while !picture("broken", 0).exists() {
        assert!(!ends(&mut child), "it ended before its first picture");
        std::thread::sleep(Duration::from_millis(5));
    }
    drop(served);
    assert!(!picture("broken", 4).exists(), "it was over before the server ended");
    std::thread::sleep(Duration::from_secs(1));
    assert!(!ends(&mut child), "it waits");
    let _again = Server::start_at(&f.dataset, &at).expect("serves again");
    assert!(child.wait().expect("ends").success());
    let report = json(&out.join("broken.json"));
    assert_eq!((&report["summary"]["frames"], &report["summary"]["frames_incomplete"]), (&5.into(), &0.into()));
    for pose in 0..5 {
        let [a, b] = ["whole", "broken"].map(|n| std::fs::read(picture(n, pose)).expect("a picture"));
        assert!(a == b, "pose {pose}");
    }
    // What was sent before the loss is not sent again: of the whole walk's bytes a second
    // handshake more.
    let bytes =
        |name: &str| json(&out.join(format!("{name}.json")))["summary"]["bytes_total"].as_f64().expect("a count");
    assert!(bytes("broken") < 1.2 * bytes("whole"), "{} of {}", bytes("broken"), bytes("whole"));
}

/// Ctrl-C reaches a client twice when what started it passes signals on: the walk ends once, with
/// its report.
#[test]
fn two_signals_at_once_leave_a_report() {
    let f = fixture();
    let out = folder("signals");
    let served = Server::start(&f.dataset).expect("serves");
    let mut walk = walking(&served, f, &out, &["--link", "rate=2mbit,delay=1ms"]);
    let mut child = walk.stdout(Stdio::null()).stderr(Stdio::null()).spawn().expect("starts");
    while !out.join("frames/frame_00000.png").exists() {
        assert!(child.try_wait().expect("known").is_none(), "it ended before its first picture");
        std::thread::sleep(Duration::from_millis(5));
    }
    let twice = format!("kill -INT {0}; sleep 0.02; kill -INT {0}", child.id());
    assert!(Command::new("sh").args(["-c", &twice]).status().expect("a shell").success());
    assert!(child.wait().expect("ends").success());
    let frames = json(&out.join("walk.json"))["summary"]["frames"].as_u64().expect("a count");
    assert!((1..5).contains(&frames), "{frames}: ended in the middle");
}

#[test]
fn one_thread_and_two_give_the_same_bytes() {
    let f = fixture();
    let out = folder("threads");
    build(&f.scene, &out.join("one"), &["--threads", "1"]);
    assert_same_dataset(&out.join("one"), &f.dataset);
    // The comparison can fail: another budget gives other bytes.
    let mut c = server(&["build"]);
    c.arg(&f.scene).arg("-o").arg(out.join("other")).args(["--budget", "9000", "--size", SIZE]).args(REPRESENT);
    run::run(c).expect("builds");
    assert!(dataset_bytes(&out.join("other")) != dataset_bytes(&f.dataset));
}

#[test]
fn a_build_that_is_killed_goes_on_and_gives_the_same_bytes() {
    let f = fixture();
    let out = folder("resume");
    let dataset = out.join("dataset");
    let all = json(&f.dataset.join("report.json"))["ldis"].as_u64().expect("a count") as usize;
    let pieces = || {
        let folders = std::fs::read_dir(dataset.join(".build")).into_iter().flatten().flatten();
        folders.filter_map(|f| std::fs::read_dir(f.path()).ok()).map(Iterator::count).sum::<usize>()
    };
    // While planning, and when some of the images are kept and some are not.
    for until in [0, 1, all / 3] {
        let mut child =
            build_command(&f.scene, &dataset, &[]).stderr(Stdio::null()).stdout(Stdio::null()).spawn().expect("starts");
        while pieces() < until {
            assert!(child.try_wait().expect("known").is_none(), "it ended with {} pieces", pieces());
            std::thread::sleep(Duration::from_millis(2));
        }
        child.kill().expect("can be killed");
        child.wait().expect("ends");
        assert!(pieces() >= until && pieces() < all, "{} of {all} pieces", pieces());
    }
    build(&f.scene, &dataset, &[]);
    assert_same_dataset(&dataset, &f.dataset);
}

#[test]
fn shares_of_a_build_give_the_bytes_of_one() {
    let f = fixture();
    let shared = folder("shares").join("dataset");
    let share = |which: &str| {
        let mut c = build_command(&f.scene, &shared, &["--shard", which]);
        c.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().expect("starts")
    };
    // At the same time, in a folder that is not there yet.
    let ends = ["1/3", "2/3", "3/3"].map(share).map(|child| child.wait_with_output().expect("ends"));
    let said = ends.each_ref().map(|end| String::from_utf8_lossy(&end.stdout).into_owned());
    for end in &ends {
        assert!(end.status.success(), "{}", outcome(end).1);
    }
    assert!(said.iter().any(|s| s.contains("all shares are there")), "{said:?}");
    assert!(!shared.join("manifest").exists(), "nobody has joined them yet");
    let joined = build_command(&f.scene, &shared, &[]).output().expect("runs");
    let (code, text) = outcome(&joined);
    assert_eq!(code, Some(0), "{text}");
    let images = text.lines().find(|l| l.starts_with("layered depth images")).expect("a stage");
    let all = images.split(" (").nth(1).and_then(|t| t.split(',').next()).expect("a number of placements");
    assert!(images.contains(&format!("({all}, {all} of them made before)")), "nothing is made again: {images}");
    let whole = folder("whole").join("dataset");
    build(&f.scene, &whole, &[]);
    assert_same_dataset(&whole, &shared);
    let (code, text) = outcome(&build_command(&f.scene, &shared, &["--shard", "4/3"]).output().expect("runs"));
    assert!(code == Some(2) && text.contains("1/4 to 4/4"), "{text}");
}

#[test]
fn eyes_that_nobody_planned_for_see_geometry_over_the_tree() {
    let f = fixture();
    let out = folder("unplanned");
    let poses = out.join("outside.json");
    // Above the roof, far beside the house, and inside as planned.
    let planned = json(&f.poses)["poses"][0].clone();
    let places = [([3.0, 14.0, 3.0], -60.0), ([-26.0, 9.0, -19.0], -10.0)];
    let mut all: Vec<Value> = (0..)
        .zip(places)
        .map(|(t, (position, pitch))| serde_json::json!({ "t": t, "position": position, "yaw": 200, "pitch": pitch }))
        .collect();
    all.push(serde_json::json!({ "t": 2, "position": planned["position"], "yaw": planned["yaw"], "pitch": planned["pitch"] }));
    std::fs::write(&poses, serde_json::json!({ "fps": 1, "poses": all }).to_string()).expect("writable");
    let served = Server::start(&f.dataset).expect("serves");
    let mut c = run::command("ldi-client").expect("built");
    c.args(["walk", &served.quic, "--fingerprint", &served.fingerprint, "--size", SIZE, "--pace", "wait"]);
    c.arg("--path").arg(&poses).arg("-o").arg(out.join("frames")).arg("--report").arg(out.join("walk.json"));
    let output = c.output().expect("runs");
    let (code, said) = outcome(&output);
    assert_eq!(code, Some(0), "{said}");
    assert!(said.contains("places that no image was made for"), "{said}");
    let report = json(&out.join("walk.json"));
    assert_eq!(report["summary"]["frames_unplanned"], 2);
    assert_eq!(report["summary"]["budget_violations"], 0);
    for (frame, unplanned) in report["frames"].as_array().expect("frames").iter().zip([true, true, false]) {
        assert_eq!(frame["unplanned"], unplanned, "{frame}");
        if unplanned {
            assert_eq!((&frame["samples_warped"], &frame["placement"]), (&0.into(), &Value::Null), "{frame}");
            assert!(frame["unpainted_fraction"].as_f64().expect("a number") < 0.005, "{frame}");
        }
    }
}

#[test]
fn a_build_that_ran_out_of_time_works_and_goes_on_to_the_same_bytes() {
    let f = fixture();
    let out = folder("time-limit");
    let dataset = out.join("dataset");
    build(&f.scene, &dataset, &["--time-limit", "0"]);
    let report = json(&dataset.join("report.json"));
    let unmade = report["placements_unmade"].as_u64().expect("a number");
    assert!(unmade > 0 && report["placements"] == unmade && report["guarantee"]["violations"] == 0, "{report}");
    let walked = |name: &str| {
        let served = Server::start(&dataset).expect("serves");
        let mut c = run::command("ldi-client").expect("built");
        c.args(["walk", &served.quic, "--fingerprint", &served.fingerprint, "--size", SIZE, "--pace", "wait"]);
        let report = out.join(name);
        c.arg("--path").arg(&f.poses).arg("-o").arg(out.join("frames")).arg("--report").arg(&report);
        run::run(c).expect("walks");
        json(&report)["summary"].clone()
    };
    let without = walked("without.json");
    assert!(without["frames_unplanned"].as_u64() > Some(0) && without["budget_violations"] == 0, "{without}");
    assert!(without["unpainted_fraction_max"].as_f64() < Some(0.005), "{without}");
    build(&f.scene, &dataset, &[]);
    assert_same_dataset(&dataset, &f.dataset);
    assert_eq!(walked("whole.json")["frames_unplanned"], 0);
    assert!(!dataset.join(".build").exists(), "pieces of images are kept only while some are missing");
}

/// Less memory than the scene takes: no abort, and no panic.
#[cfg(target_os = "linux")]
#[test]
fn a_build_without_memory_says_so() {
    let out = folder("memory");
    let build = run::show(
        server(&["build", "builtin:island?triangles=2000000", "--budget", "200000", "--threads", "2"]).arg("-o"),
    );
    let program = run::bin_dir().expect("known").join("ldi-server");
    let build = build.replacen("ldi-server", &program.display().to_string(), 1);
    for kib in [300_000, 800_000] {
        let mut c = Command::new("sh");
        c.arg("-c").arg(format!("ulimit -v {kib}; exec {build} {}", out.join("dataset").display()));
        let (code, said) = outcome(&c.output().expect("a shell"));
        assert_eq!(code, Some(42), "{kib} KiB: {said}");
        assert!(said.contains("out of memory") && said.contains("ulimit -v"), "{kib} KiB: {said}");
    }
}

/// A control group with less memory than the scene takes: no kill without a word.
#[cfg(target_os = "linux")]
#[test]
fn a_build_that_its_control_group_would_kill_says_so() {
    let out = folder("control-group");
    let Some(group) = ControlGroup::new(200 << 20) else {
        return eprintln!("skipped: no control group with a limit can be made here");
    };
    let build = run::show(
        server(&["build", "builtin:island?triangles=4000000", "--budget", "200000", "--threads", "2"]).arg("-o"),
    );
    let program = run::bin_dir().expect("known").join("ldi-server");
    let build = build.replacen("ldi-server", &program.display().to_string(), 1);
    let mut c = Command::new("sh");
    let join = group.folder.join("cgroup.procs");
    c.arg("-c").arg(format!("echo $$ > {} && exec {build} {}", join.display(), out.join("dataset").display()));
    let (code, said) = outcome(&c.output().expect("a shell"));
    assert_eq!(code, Some(42), "{said}");
    assert!(said.contains("of the control group") && said.contains("--memory-limit"), "{said}");
}

/// A control group of its own, removed at the end.
#[cfg(target_os = "linux")]
struct ControlGroup {
    folder: PathBuf,
}

#[cfg(target_os = "linux")]
impl ControlGroup {
    /// None: nothing may be made or limited here.
    fn new(bytes: u64) -> Option<Self> {
        let roots = [("/sys/fs/cgroup/memory", "memory.limit_in_bytes"), ("/sys/fs/cgroup", "memory.max")];
        roots.into_iter().find_map(|(root, limit)| {
            let folder = Path::new(root).join(format!("ldi-test-{}", std::process::id()));
            std::fs::create_dir(&folder).ok()?;
            let group = Self { folder };
            std::fs::write(group.folder.join(limit), bytes.to_string()).ok()?;
            // No escape by swapping; not there without swap.
            let _ = std::fs::write(group.folder.join("memory.swap.max"), "0");
            Some(group)
        })
    }
}

#[cfg(target_os = "linux")]
impl Drop for ControlGroup {
    fn drop(&mut self) {
        // Its last process may take a moment to be gone.
        for _ in 0..50 {
            if std::fs::remove_dir(&self.folder).is_ok() {
                return;
            }
            std::thread::sleep(Duration::from_millis(20));
        }
    }
}

/// The least there is: what does not lie in the file comes and goes all the time.
#[cfg(target_os = "linux")]
#[test]
fn a_build_within_a_memory_limit_gives_the_same_dataset() {
    let f = fixture();
    let dataset = folder("memory-limit").join("dataset");
    build(&f.scene, &dataset, &["--memory-limit", "20MB"]);
    assert_same_dataset(&dataset, &f.dataset);
}

#[test]
fn a_scene_without_rooms_is_left_to_the_grid() {
    let out = folder("no-rooms");
    let scene = out.join("pipes.glb");
    run::run({
        let mut c = server(&["scene", "pipes", "--triangles", "4000", "-o"]);
        c.arg(&scene);
        c
    })
    .expect("writes a scene");
    let mut c = server(&["build", "--budget", "50%", "--size", SIZE, "--represent", "portals", "--time-limit", "0"]);
    c.arg(&scene).arg("-o").arg(out.join("dataset"));
    let (code, said) = outcome(&c.output().expect("runs"));
    assert_eq!(code, Some(0), "{said}");
    assert!(said.contains("left to the grid"), "{said}");
}

#[test]
fn a_flipped_byte_is_named_and_the_walk_goes_on() {
    let f = fixture();
    let out = folder("flip");
    let damaged = out.join("dataset");
    copy_dataset(&f.dataset, &damaged);
    run::run(server(&["verify", damaged.to_str().expect("UTF-8")])).expect("a copy is whole");
    // A chunk that the walk needs: the first image of the placement that its first pose with
    // images uses.
    let dataset = Dataset::open(&damaged).expect("opens");
    let path = ldi_protocol::path::parse(&std::fs::read_to_string(&f.poses).expect("readable")).expect("a path");
    let half_tan = {
        let c = &dataset.index().settings.camera;
        (c.half_tan_x(), c.half_tan_y())
    };
    let image = path.poses.iter().find_map(|p| draw_list(dataset.index(), &p.pose, half_tan).images.first().copied());
    let chunk = dataset.index().images[image.expect("some pose uses images") as usize].chunks[0];
    let wanted = dataset.chunk(chunk).expect("there").to_vec();
    drop(dataset);
    let (pack, mut bytes, at) = dataset_bytes(&damaged)
        .into_iter()
        .filter(|(name, _)| name.to_string_lossy().starts_with("packs-"))
        .find_map(|(name, bytes)| {
            let at = bytes.windows(wanted.len()).position(|w| w == wanted)?;
            Some((name, bytes, at))
        })
        .expect("in some pack");
    bytes[at + wanted.len() / 2] ^= 0x10;
    std::fs::write(damaged.join(&pack), bytes).expect("writable");
    let verified = server(&["verify", damaged.to_str().expect("UTF-8")]).output().expect("runs");
    let (code, stderr) = outcome(&verified);
    let said = stderr + &String::from_utf8_lossy(&verified.stdout);
    assert_eq!(code, Some(42), "{said}");
    let fault = |l: &str| l.contains(&format!(" {chunk} ")) && l.contains(&format!("at byte {at}:"));
    assert!(said.lines().any(fault), "chunk {chunk} at {at}: {said}");
    let served = Server::start(&damaged).expect("serves what is whole");
    let (code, said) = outcome(&walking(&served, f, &out, &[]).output().expect("runs"));
    assert!(code == Some(42) && said.contains("1 chunks of the dataset are damaged"), "{code:?} {said}");
    let report = json(&out.join("walk.json"));
    assert_eq!((&report["summary"]["frames"], &report["summary"]["damaged_chunks"]), (&5.into(), &1.into()));
    assert!(report["summary"]["frames_incomplete"].as_u64() > Some(0), "{}", report["summary"]);
    assert!(report["summary"]["mean_triangles"].as_f64() > Some(0.0), "the rest is drawn");
}

/// Files of a dataset that is served are cut off and written again, as `cp` does it: what is in
/// them is lacking until they are whole.
#[test]
fn a_server_outlives_a_pack_that_is_cut_off() {
    let f = fixture();
    let out = folder("cut-off");
    let copy = out.join("dataset");
    let whole = copy_dataset(&f.dataset, &copy);
    let served = Server::start(&copy).expect("serves");
    let packs = || whole.iter().filter(|(name, _)| name.to_string_lossy().ends_with(".bin"));
    assert!(packs().count() > 0);
    packs().for_each(|(name, bytes)| std::fs::write(copy.join(name), &bytes[..bytes.len() / 3]).expect("writable"));
    // Ended before anybody waits for what does not come.
    let mut c = run::command("ldi-client").expect("built");
    c.args(["walk", &served.quic, "--fingerprint", &served.fingerprint, "--size", SIZE, "--path"]).arg(&f.poses);
    c.arg("-o").arg(out.join("lacking")).arg("--report").arg(out.join("lacking.json")).output().expect("runs");
    packs().for_each(|(name, bytes)| std::fs::write(copy.join(name), bytes).expect("writable"));
    let report = walk(&served, f, &out, &[]);
    assert_eq!((&report["summary"]["frames"], &report["summary"]["frames_incomplete"]), (&5.into(), &0.into()));
}

/// A server ends during a walk in real time, and another dataset comes at its address.
#[test]
fn a_walk_in_real_time_says_that_another_dataset_came() {
    let f = fixture();
    let out = folder("another");
    let other = out.join("other");
    let mut c = server(&["build", "--represent", "tree", "--budget", "50%"]);
    run::run({
        c.arg(&f.scene).arg("-o").arg(&other);
        c
    })
    .expect("builds");
    // The same places, slowly: there is time for a server to come and go.
    let mut poses = json(&f.poses);
    for (k, pose) in poses["poses"].as_array_mut().expect("poses").iter_mut().enumerate() {
        pose["t"] = (20 * k).into();
    }
    let path = out.join("slow.json");
    std::fs::write(&path, poses.to_string()).expect("writable");
    let served = Server::start(&f.dataset).expect("serves");
    let (at, fingerprint) = (served.quic.clone(), served.fingerprint.clone());
    let mut c = run::command("ldi-client").expect("built");
    c.args(["walk", &at, "--fingerprint", &fingerprint, "--size", SIZE, "--link", "rate=200kbit", "--path"]).arg(&path);
    c.arg("-o").arg(out.join("frames")).arg("--report").arg(out.join("walk.json"));
    let mut child = c.stdout(Stdio::null()).stderr(Stdio::null()).spawn().expect("starts");
    while !out.join("frames/frame_00000.png").exists() {
        assert!(child.try_wait().expect("known").is_none(), "it ended before its first picture");
        std::thread::sleep(Duration::from_millis(5));
    }
    drop(served);
    let _other = Server::start_at(&other, &at).expect("serves at the same address");
    assert_eq!(child.wait().expect("ends").code(), Some(1));
    let lost = json(&out.join("walk.json"))["summary"]["lost"].clone();
    assert!(lost.as_str().is_some_and(|l| l.contains("another dataset")), "{lost}");
}

#[test]
fn the_audit_finds_no_violation() {
    let f = fixture();
    let out = folder("audit");
    let mut c = server(&["verify"]);
    c.arg(&f.dataset).args(["--guarantee", "--poses", "20000", "--json"]).arg(out.join("audit.json"));
    run::run(c).expect("no violation");
    let audit = json(&out.join("audit.json"));
    assert_eq!(audit["violations"], 0);
    assert!(audit["max_triangles"].as_u64().expect("a count") > 0);
}

#[test]
fn a_dry_run_plans_audits_and_writes_only_its_report() {
    let f = fixture();
    let out = folder("dry");
    let report = out.join("plan.json");
    let mut c = server(&["build"]);
    c.arg(&f.scene).args(["--budget", BUDGET, "--size", SIZE, "--dry-run", "--poses", "2000", "--report"]).arg(&report);
    run::run(c).expect("every promise holds");
    let found = json(&report);
    assert_eq!((&found["audit"]["violations"], &found["audit"]["poses"]), (&0.into(), &2000.into()));
    assert_eq!(found["placements"], json(&f.dataset.join("report.json"))["placements"]);
    assert!(found["images"].as_u64() > Some(0) && found["megapixels"].as_f64() > Some(0.0), "{found}");
    assert_eq!(std::fs::read_dir(&out).expect("there").count(), 1);
}

#[test]
fn the_placement_bench_walks_the_path_beside_a_scene_and_leaves_a_page() {
    let f = fixture();
    let out = folder("bench");
    // As a path file lies beside a scene.
    std::fs::copy(&f.scene, out.join("house.glb")).expect("copied");
    std::fs::copy(&f.poses, out.join("house.path.json")).expect("copied");
    let mut c = run::command("ldi-bench").expect("built");
    c.arg("placement").arg(out.join("house.glb"));
    c.args(["--budgets", "40,100", "--size", SIZE, "--poses", "500", "-o"]).arg(out.join("bench"));
    run::run(c).expect("a page");
    let rows = json(&out.join("bench/placement.json"));
    let rows = rows.as_array().expect("rows");
    assert_eq!(rows.len(), 2);
    assert!(rows[0]["images"].as_u64() > Some(0) && rows[0]["audit"]["violations"] == 0, "{}", rows[0]);
    let path = rows[0]["along_path"].as_array().expect("poses");
    assert!(!path.is_empty() && path.iter().all(|t| t[1].as_u64() <= t[0].as_u64()), "{path:?}");
    assert_eq!((&rows[1]["images"], &rows[1]["points"]), (&0.into(), &0.into()), "all of it fits");
    for file in ["index.html", "placement.csv", "figure-13-images-cells-0.svg", "figure-14-house-cells-40.svg"] {
        assert!(std::fs::metadata(out.join("bench").join(file)).is_ok_and(|m| m.len() > 100), "{file}");
    }
}

#[test]
fn the_search_bench_compares_with_the_best_box() {
    let out = folder("searches");
    let mut c = run::command("ldi-bench").expect("built");
    c.args(["searches", "builtin:house?triangles=20000", "--budget", "20", "--cases", "3", "-o"]).arg(&out);
    run::run(c).expect("a table");
    let all = json(&out.join("searches.json"));
    let rows = all[0].as_array().expect("rows");
    assert_eq!(rows.len(), 9);
    for row in rows {
        assert_eq!(row["cases"].as_u64().zip(row["left_out"].as_u64()).map(|(a, b)| a + b), Some(3), "{row}");
        assert!(row["gap_mean_percent"].as_f64() >= Some(-1e-9), "nothing is better than the best: {row}");
    }
    assert_eq!((&rows[8]["search"], &rows[8]["best_found"]), (&"exhaustive".into(), &1.0.into()));
    let sets = all[2][0][1].as_array().expect("sets of view cells");
    assert!(!sets.is_empty());
    for set in sets {
        let [apart, halved, joined, best] =
            ["apart", "halved", "joined", "best"].map(|way| set[way].as_f64().expect("cost"));
        // Sums in another order.
        let at_most = |a: f64, b: f64| a <= b * (1.0 + 1e-9);
        assert!(best > 0.0 && at_most(best, joined) && at_most(joined, halved) && at_most(best, apart), "{set}");
    }
}

#[test]
fn the_audit_counts_over_the_scene_and_tells_another_scene() {
    let f = fixture();
    let audit = |scene: &std::ffi::OsStr| {
        let mut c = server(&["verify"]);
        c.arg(&f.dataset).args(["--guarantee", "--poses", "500", "--scene"]).arg(scene);
        outcome(&c.output().expect("runs"))
    };
    let (status, stderr) = audit(f.scene.as_os_str());
    assert_eq!(status, Some(0), "{stderr}");
    let (status, stderr) = audit("builtin:pipes?triangles=5000".as_ref());
    assert_eq!(status, Some(42), "{stderr}");
    assert!(stderr.contains("was not built from"), "{stderr}");
}

/// A client that makes images of what is far from frames before: fewer triangles, nearly the same
/// pictures.
#[test]
fn cached_images_stand_for_what_is_far() {
    let out = folder("cached");
    let dataset = out.join("island");
    let mut c =
        server(&["build", "builtin:island?triangles=300000", "--represent", "cache", "--budget", "300000", "-o"]);
    c.arg(&dataset).args(["--size", "320x240"]);
    run::run(c).expect("builds");
    let path = out.join("path.json");
    let waypoints = r#"{"eye_height": 1.6, "closed": false, "waypoints": [[120.0, 17.7, 0.0], [118.0, 17.8, 12.0]]}"#;
    std::fs::write(&path, waypoints).expect("writable");
    let served = Server::start(&dataset).expect("serves");
    let walk = |method: &str, more: &[&str]| {
        let mut c = run::command("ldi-client").expect("built");
        c.args(["walk", &served.quic, "--fingerprint", &served.fingerprint, "--size", "320x240", "--every", "6"]);
        c.arg("--path").arg(&path).args(["--pace", "wait", "--baseline-frames", "0", "--method", method, "-o"]);
        c.arg(out.join(method)).arg("--report").arg(out.join(format!("{method}.json"))).args(more);
        run::run(c).expect("walks");
        json(&out.join(format!("{method}.json")))["frames"].as_array().expect("frames").clone()
    };
    let plain = walk("geometry", &[]);
    let cached = walk("cache", &["--truth", out.join("geometry").to_str().expect("UTF-8")]);
    assert!(plain.len() == cached.len() && plain.len() > 60, "{}", plain.len());
    assert_eq!(cached[0]["method"], "geometry", "there is nothing to make images from");
    let mean = |frames: &[Value], field: &str| {
        frames.iter().map(|f| f[field].as_f64().expect("a number")).sum::<f64>() / frames.len() as f64
    };
    let settled = &cached[20..];
    assert!(settled.iter().all(|f| f["method"] == "cache" && f["missing_chunks"] == 0));
    assert!(mean(settled, "far_fraction") > 1e-3, "{}", mean(settled, "far_fraction"));
    assert!(mean(settled, "triangles") < 0.7 * mean(&plain[20..], "triangles"), "{}", mean(settled, "triangles"));
    let flip = mean(&cached, "flip");
    assert!(flip > 0.0 && flip < 0.03, "{flip}");
}

#[test]
fn exit_codes_tell_usage_from_bad_input() {
    let out = folder("codes");
    let bad = out.join("bad.glb");
    std::fs::write(&bad, b"glTF but not really").expect("writable");
    let code = |c: &mut Command| outcome(&c.output().expect("runs"));
    let (status, stderr) = code(server(&["build"]).arg(&bad).arg("-o").arg(out.join("d")));
    assert_eq!(status, Some(42), "{stderr}");
    assert!(stderr.contains("bad.glb"), "{stderr}");
    assert_eq!(code(server(&["build"]).arg(&bad)).0, Some(2));
    // Found out before anything is planned, and nothing is left behind.
    assert!(!out.join("d").exists());
    let (status, stderr) = code(server(&["build"]).arg(out.join("absent.glb")).arg("-o").arg(out.join("d")));
    assert_eq!(status, Some(42), "{stderr}");
    let (status, stderr) = code(server(&["build", "builtin:pipes?triangles=5000", "-o"]).arg(&out));
    assert_eq!(status, Some(42), "the folder holds other files: {stderr}");
    // What would be missed after the work is missed before it.
    let small = ["build", "builtin:pipes?triangles=5000", "-o"];
    let nowhere = out.join("nowhere").join("report.json");
    let (status, stderr) = code(server(&small).arg(out.join("g")).arg("--report").arg(&nowhere));
    assert_eq!(status, Some(42), "{stderr}");
    assert!(stderr.contains("cannot write") && !out.join("g").exists(), "{stderr}");
    let (status, stderr) = code(server(&small).arg(out.join("g")).arg("--rooms").arg(&nowhere));
    assert_eq!(status, Some(42), "{stderr}");
    assert!(stderr.contains("--rooms") && !out.join("g").exists(), "{stderr}");
    assert_eq!(code(&mut server(&["scene", "castle", "-o", "/dev/null"])).0, Some(2));
    assert_eq!(code(server(&["inspect"]).arg(&out)).0, Some(42));
    assert_eq!(
        code(server(&["build", "builtin:pipes?triangles=5000", "--fov", "40", "-o"]).arg(out.join("e"))).0,
        Some(2)
    );
    let f = fixture();
    let served = Server::start(&f.dataset).expect("serves");
    let mut c = run::command("ldi-client").expect("built");
    c.args(["walk", &served.quic, "--size", SIZE, "--path"]).arg(&f.poses).arg("-o").arg(out.join("f"));
    c.arg("--report").arg(out.join("r"));
    assert_eq!(code(&mut c).0, Some(2), "an unknown server without a fingerprint");
    let mut c = run::command("ldi-client").expect("built");
    c.args(["walk", &served.quic, "--fingerprint", &"ab".repeat(32), "--size", SIZE, "--path"]).arg(&f.poses);
    let (status, stderr) = code(c.arg("-o").arg(out.join("f")).arg("--report").arg(out.join("r")));
    assert!(status == Some(42) && stderr.contains("this client refuses the server"), "{stderr}");
    let mut c = run::command("ldi-client").expect("built");
    c.args(["walk", &served.quic, "--fingerprint", &served.fingerprint, "--size", SIZE, "--path"]).arg(&f.poses);
    let (status, stderr) = code(c.arg("-o").arg(&bad).arg("--report").arg(out.join("r")));
    assert!(status == Some(42) && stderr.contains("is a file; name another folder"), "{stderr}");
}

#[test]
fn messages_name_the_remedy() {
    let f = fixture();
    let out = folder("messages");
    let code = |c: &mut Command| outcome(&c.output().expect("runs"));
    let file = out.join("town.glb");
    std::fs::write(&file, b"glTF").expect("writable");
    let (status, stderr) = code(server(&["serve"]).arg(&file));
    let command = format!("ldi-server build {} -o {}", file.display(), out.join("town.ldi").display());
    assert!(status == Some(42) && stderr.contains(&command), "{stderr}");
    let in_the_way = format!("{} is a file", file.display());
    for place in [file.clone(), file.join("below")] {
        let mut c = server(&["render"]);
        c.arg(&f.scene).arg("--path").arg(&f.poses).args(["--size", SIZE, "--samples", "1", "-o"]).arg(&place);
        let (status, stderr) = code(&mut c);
        assert!(status == Some(42) && stderr.contains(&in_the_way), "{stderr}");
    }
    let (status, stderr) = code(&mut build_command(&f.scene, &file.join("below"), &[]));
    assert!(status == Some(42) && stderr.contains(&format!("{}, in which", file.display())), "{stderr}");
    // The same path in millimetres.
    let mut path = json(&f.poses);
    for pose in path["poses"].as_array_mut().expect("poses") {
        for metres in pose["position"].as_array_mut().expect("a position") {
            *metres = (metres.as_f64().expect("a number") * 1e3).into();
        }
    }
    let millimetres = out.join("mm.path.json");
    std::fs::write(&millimetres, path.to_string()).expect("writable");
    let planned =
        |poses: &Path| code(server(&["plan"]).arg(&f.dataset).arg("--poses").arg(poses).arg("-o").arg(out.join("p")));
    let (status, stderr) = planned(&millimetres);
    assert!(
        status == Some(0) && stderr.contains("mm.path.json: 100%") && stderr.contains("multiplied by 0.001"),
        "{stderr}"
    );
    assert!(!planned(&f.poses).1.contains("multiplied"));
    let mut c = build_command(&f.scene, &out.join("along"), &["--along"]);
    let (status, stderr) = code(c.arg(&millimetres));
    assert!(status == Some(42) && stderr.contains("--along") && stderr.contains("multiplied by 0.001"), "{stderr}");
}

#[test]
fn a_tour_of_a_dataset_lies_in_its_walk_volume() {
    let f = fixture();
    let path = folder("tour").join("tour.path.json");
    let mut c = server(&["tour", "--quiet", "--seconds", "30"]);
    c.arg(&f.dataset).arg("-o").arg(&path);
    let (code, stderr) = outcome(&c.output().expect("runs"));
    assert!(code == Some(0) && stderr.is_empty(), "{stderr}");
    let walk = ldi_protocol::path::parse(&std::fs::read_to_string(&path).expect("readable")).expect("a path");
    let dataset = Dataset::open(&f.dataset).expect("a dataset");
    let volume = dataset.index().volume.as_ref().expect("a walk volume");
    assert_eq!(walk.poses.len(), 1800);
    assert!(walk.poses.iter().all(|p| volume.contains(p.pose.position)));
    let metres: f64 = walk.poses.windows(2).map(|p| p[0].pose.position.distance(p[1].pose.position)).sum();
    assert!(metres > 10.0, "{metres}");
    let (code, stderr) = outcome(&c.arg("--fly").output().expect("runs"));
    assert!(code == Some(2) && stderr.contains("are for scenes"), "{stderr}");
}

#[test]
fn completions_and_man_pages_are_made() {
    let out = folder("manual");
    for program in ["ldi-server", "ldi-client"] {
        for shell in ["bash", "zsh", "fish"] {
            let mut c = run::command(program).expect("built");
            let text = c.args(["completions", shell]).output().expect("runs").stdout;
            let text = String::from_utf8(text).expect("text");
            assert!(text.contains(program) && text.contains("fingerprint") == (program == "ldi-client"), "{shell}");
        }
        let mut c = run::command(program).expect("built");
        assert!(c.args(["man", "-o"]).arg(&out).status().expect("runs").success());
        assert!(out.join(format!("{program}.1")).is_file());
    }
    let build = std::fs::read_to_string(out.join("ldi-server-build.1")).expect("readable");
    assert!(build.contains(".TH") && build.contains("max"), "{build}");
}

#[test]
fn culling_hidden_samples_is_measured() {
    let f = fixture();
    let text = std::fs::read_to_string(&f.poses).expect("readable");
    let walk = ldi_protocol::path::parse(&text).expect("a path");
    let rows = ldi_tests::bench::occlusion::run(&f.dataset, &walk, 12, (320, 180), &[16, 256]).expect("measured");
    let [fine, coarse, tiles] = &rows[..] else { panic!("two octrees and the tiles: {rows:?}") };
    assert!(fine.views > 0 && fine.msamples > 0.0, "{fine:?}");
    for r in &rows {
        assert!(r.culled <= r.culled_near && r.culled_near <= 1.0, "near geometry only hides more: {r:?}");
        assert!(r.hidden <= r.hidden_near, "{r:?}");
    }
    assert!(fine.culled_near >= coarse.culled_near, "large leaves are harder to hide: {rows:?}");
    assert_eq!(fine.hidden, coarse.hidden, "what is hidden is no matter of leaves");
    let (of_fine, of_coarse) = (fine.proposal.expect("an octree"), coarse.proposal.expect("an octree"));
    assert!(of_fine.culled >= of_coarse.culled && of_fine.lost <= of_fine.culled, "{rows:?}");
    assert_eq!(tiles.proposal, None);
}
