//! The window, driven by a real keyboard and mouse on a display without a screen; and whom it
//! trusts.

#[path = "window/display.rs"]
mod display;

use display::Display;
use glam::DVec3;
use ldi_client::stream::{ConnectConfig, Connection};
use ldi_protocol::{floor_plan::FloorPlan, index::Index, wire::Picture};
use ldi_server::store::Dataset;
use ldi_tests::{
    fixture::{Fixture, made_once, shared_scene},
    run::{self, Server},
};
use serde_json::Value;
use std::{
    path::{Path, PathBuf},
    process::{Child, Command, Stdio},
    time::{Duration, Instant},
};

/// Nothing here is timed; this only ends a test that hangs.
const PATIENCE: Duration = Duration::from_secs(120);
/// In a room, looking at its open door three metres ahead.
const BEGIN: &str = "--start=-10,1.6,-6.75,-90";
/// Size of the window.
const SIZE: (u32, u32) = (640, 360);

fn fixture() -> &'static Fixture {
    Fixture::get(Path::new(env!("CARGO_TARGET_TMPDIR")))
}

fn folder(name: &str) -> PathBuf {
    ldi_tests::fixture::empty_folder(Path::new(env!("CARGO_TARGET_TMPDIR")), name)
}

/// An open window, and what it says happens.
struct Walk {
    client: Child,
    events: PathBuf,
    log: PathBuf,
}

impl Walk {
    fn open(display: &Display, server: &str, dir: &Path, more: &[&str]) -> Self {
        let (events, log) = (dir.join("events.jsonl"), dir.join("log"));
        let mut c = run::command("ldi-client").expect("built");
        c.args(["connect", server, "--size", &format!("{}x{}", SIZE.0, SIZE.1), "--events"]).arg(&events);
        // No test sees what another one received.
        c.arg("--disk-cache").arg(dir.join("disk")).arg("--shots").arg(dir.join("shots")).args(more);
        display.show(&mut c, dir);
        let errors = std::fs::File::create(&log).expect("writable");
        let client = c.stdout(Stdio::null()).stderr(errors).spawn().expect("starts");
        Self { client, events, log }
    }

    fn all(&self) -> Vec<Value> {
        let text = std::fs::read_to_string(&self.events).unwrap_or_default();
        // The last line may be half written.
        text.lines().filter_map(|l| serde_json::from_str(l).ok()).collect()
    }

    /// The newest event of this name.
    fn last(&self, event: &str) -> Option<Value> {
        self.all().into_iter().rfind(|e| e["event"] == event)
    }

    fn wait<T>(&mut self, what: &str, mut found: impl FnMut(&Self) -> Option<T>) -> T {
        let until = Instant::now() + PATIENCE;
        loop {
            if let Some(found) = found(self) {
                return found;
            }
            let ended = self.client.try_wait().expect("known");
            let log = || std::fs::read_to_string(&self.log).unwrap_or_default();
            assert!(ended.is_none(), "the window closed ({ended:?}) before {what}: {}", log());
            assert!(Instant::now() < until, "{what} did not happen: {:?}\n{}", self.all(), log());
            std::thread::sleep(Duration::from_millis(50));
        }
    }

    fn wait_for(&mut self, event: &str) -> Value {
        self.wait(event, |w| w.last(event))
    }

    fn count(&self, event: &str) -> usize {
        self.all().iter().filter(|e| e["event"] == event).count()
    }

    /// The newest screenshot, once there is one, and where it lies; it shows more than a few plain
    /// surfaces.
    fn shot(&mut self) -> (PathBuf, image::RgbImage) {
        let path = PathBuf::from(self.wait_for("screenshot")["path"].as_str().expect("a path"));
        let picture = image::open(&path).expect("a picture").into_rgb8();
        let colours: std::collections::BTreeSet<_> = picture.pixels().map(|p| p.0).collect();
        assert!(colours.len() > 20, "{} colours", colours.len());
        (path, picture)
    }

    fn position(&self) -> DVec3 {
        position(&self.last("pose").expect("a pose"))
    }

    fn yaw(&self) -> f64 {
        self.last("pose").expect("a pose")["yaw"].as_f64().expect("a number")
    }
}

impl Drop for Walk {
    fn drop(&mut self) {
        let _ = self.client.kill();
        let _ = self.client.wait();
    }
}

fn position(event: &Value) -> DVec3 {
    serde_json::from_value(event["position"].clone()).expect("three numbers")
}

/// The display, or None with the reason said.
fn display() -> Option<Display> {
    match Display::start(SIZE.0, SIZE.1) {
        Ok(display) => Some(display),
        Err(reason) => {
            println!("SKIPPED: {reason}");
            None
        }
    }
}

/// The place farthest from `from`.
fn far_place(places: impl Iterator<Item = DVec3>, from: DVec3) -> DVec3 {
    places.max_by(|a, b| a.distance(from).total_cmp(&b.distance(from))).expect("a volume")
}

/// Middles of the walk volume's columns that are clear of walls, on the storey of an eye.
fn clear_places(index: &Index, eye_y: f64) -> impl Iterator<Item = DVec3> + '_ {
    let eye_height_m = index.settings.eye_height_m.expect("on foot");
    let off = move |p: &&FloorPlan| (p.floor_m + eye_height_m - eye_y).abs();
    let plan = index.plans.iter().min_by(|a, b| off(a).total_cmp(&off(b))).expect("a floor plan");
    let middles = index.volume.iter().flat_map(|v| v.boxes()).map(|b| b.centre());
    let is_clear = move |p: &DVec3| plan.place_near([p.x, p.z], 0.0, 0.45, |_| true).is_some();
    middles.filter(move |p| (p.y - eye_y).abs() < 0.5).filter(is_clear)
}

/// Clicks on an open map, which goes there: within a pixel or two of it.
fn click_on_map(display: &Display, walk: &mut Walk, map: &Value, target: DVec3) {
    let number = |v: &Value| v.as_f64().expect("a number");
    let scale = number(&map["px_per_m"]);
    let px = |v: f64, axis: usize| number(&map["area_px"][axis]) + (v - number(&map["corner"][axis])) * scale;
    display.hand(&["mousemove", &px(target.x, 0).round().to_string(), &px(target.z, 1).round().to_string()]);
    // A hand rests before it presses: the pointer's place is known by then.
    std::thread::sleep(Duration::from_millis(300));
    display.hand(&["click", "1"]);
    let told = position(&walk.wait_for("teleport"));
    walk.wait("the new place", |w| (w.position().distance(told) < 0.7).then_some(()));
    let off = DVec3::new(told.x - target.x, 0.0, told.z - target.z).length();
    assert!(off < 3.0 / scale + 0.01, "{told} instead of {target}");
}

#[test]
fn a_visit_with_keyboard_and_mouse() {
    let Some(display) = display() else { return };
    let f = fixture();
    let dir = folder("visit");
    let served = Server::start(&f.dataset).expect("serves");
    let mut walk = Walk::open(&display, &served.quic, &dir, &["--accept-new", BEGIN]);
    walk.wait_for("first_complete_picture");
    let window = display.hand(&["search", "--name", "house"]);
    let window = window.lines().last().expect("a window");
    display.hand(&["windowfocus", window]);
    // The pointer is captured by a click and turns the head: to the right with the mouse.
    display.hand(&["mousemove", "320", "180", "click", "1"]);
    walk.wait_for("captured");
    let (begin, yaw) = (walk.wait_for("pose"), walk.yaw());
    display.hand(&["mousemove_relative", "60", "0"]);
    walk.wait("a turn", |w| (w.yaw() != yaw).then_some(()));
    let turned = (walk.yaw() - yaw + 540.0).rem_euclid(360.0) - 180.0;
    assert!((-60.0..0.0).contains(&turned), "{turned}");
    display.hand(&["mousemove_relative", "--", "-60", "0"]);
    // Walking, until the eye has gone half a metre.
    display.hand(&["keydown", "w"]);
    walk.wait("walking", |w| (w.position().distance(position(&begin)) > 0.5).then_some(()));
    display.hand(&["keyup", "w"]);
    display.hand(&["key", "Escape"]);
    walk.wait_for("released");
    // A screenshot: as large as the window, neither sky alone nor one colour, with its pose beside
    // it.
    display.hand(&["key", "F12"]);
    let (path, picture) = walk.shot();
    assert_eq!(picture.dimensions(), SIZE);
    let sky = picture.pixels().filter(|p| p.0 == [198, 214, 235]).count();
    assert!(sky * 10 < picture.pixels().count() * 9, "{sky} pixels of sky");
    let beside = std::fs::read_to_string(path.with_extension("path.json")).expect("a pose beside it");
    let pose = ldi_protocol::path::parse(&beside).expect("a path file").poses[0].pose;
    assert!(pose.position.distance(walk.position()) < 0.7, "{pose:?}");
    // The map; a click on it goes there.
    let index = Dataset::open(&f.dataset).expect("opens").index().clone();
    let volume = index.volume.as_ref().expect("a volume");
    display.hand(&["key", "m"]);
    let map = walk.wait_for("map");
    // Somebody else comes in, is shown, and leaves.
    let shown = |walk: &mut Walk, n: u64| {
        walk.wait("others on the map", |w| w.last("others").filter(|e| e["shown"] == n));
    };
    shown(&mut walk, 0);
    let picture = Picture { width: 64, height: 36, fov_deg: None };
    let mut config = ConnectConfig { name: "guide".into(), ..ConnectConfig::new(served.quic.clone(), picture) };
    config.fingerprint = Some(served.fingerprint.parse().expect("a fingerprint"));
    let other = Connection::connect(config).expect("connects");
    other.send_pose(&pose);
    shown(&mut walk, 1);
    drop(other);
    shown(&mut walk, 0);
    let target = far_place(clear_places(&index, walk.position().y), walk.position());
    click_on_map(&display, &mut walk, &map, target);
    // Nobody has left the volume.
    for pose in walk.all().iter().filter(|e| e["event"] == "pose") {
        assert!(volume.contains(position(pose)), "{pose}");
    }
    display.hand(&["key", "F1"]);
    walk.wait_for("figures");
    display.hand(&["key", "ctrl+q"]);
    let status = walk.client.wait().expect("ends");
    assert!(status.success(), "{status}: {}", std::fs::read_to_string(&walk.log).unwrap_or_default());
    assert!(walk.last("closed").is_some() && walk.count("lost") == 0, "{:?}", walk.all());
    // Trusted from then on.
    let known = std::fs::read_to_string(dir.join(".config/ldi/known_hosts")).expect("remembered");
    assert_eq!(known.trim(), format!("{} {}", served.quic, served.fingerprint));
}

/// Filling the window costs as much as drawing a small picture: it is filled for pictures, and
/// otherwise only as often as figures are written.
#[test]
fn a_window_at_rest_rests_and_ends_when_it_is_asked_to() {
    let Some(display) = display() else { return };
    let f = fixture();
    let dir = folder("rest");
    let served = Server::start(&f.dataset).expect("serves");
    let mut walk = Walk::open(&display, &served.quic, &dir, &["--fingerprint", &served.fingerprint, BEGIN]);
    walk.wait_for("first_complete_picture");
    let window = display.hand(&["search", "--name", "house"]);
    display.hand(&["windowfocus", window.lines().last().expect("a window")]);
    display.hand(&["key", "r"]);
    walk.wait_for("recording");
    let begin = walk.position();
    display.hand(&["keydown", "w"]);
    walk.wait("walking", |w| (w.position().distance(begin) > 0.5).then_some(()));
    display.hand(&["keyup", "w"]);
    std::thread::sleep(Duration::from_secs(4));
    let asked = Command::new("kill").arg(walk.client.id().to_string()).status().expect("kill is there");
    assert!(asked.success());
    let status = walk.client.wait().expect("ends");
    assert!(status.success(), "{status}: {}", std::fs::read_to_string(&walk.log).unwrap_or_default());
    // What was being recorded is saved.
    let path = walk.last("recorded").expect("recorded")["path"].as_str().expect("a path").to_owned();
    let recorded = ldi_protocol::path::parse(&std::fs::read_to_string(path).expect("is there")).expect("a path file");
    assert!(recorded.poses.last().expect("poses").pose.position.distance(begin) > 0.4, "{recorded:?}");
    let closed = walk.last("closed").expect("closed");
    let number = |v: &Value| v.as_f64().expect("a number");
    let (pictures, shown) = (number(&closed["counts"]["pictures"]), number(&closed["counts"]["shown"]));
    let written = 20.0 + 10.0 * number(&closed["t_ms"]) / 1e3;
    assert!(pictures > 0.0 && (pictures / 2.0..pictures + written).contains(&shown), "{closed}");
}

#[test]
fn a_card_draws_for_the_window() {
    let Some(display) = display() else { return };
    let f = fixture();
    let dir = folder("card");
    let served = Server::start(&f.dataset).expect("serves");
    let more = ["--renderer", "gpu", "--warp-on", "gpu", "--fingerprint", &served.fingerprint, BEGIN];
    let mut walk = Walk::open(&display, &served.quic, &dir, &more);
    assert_eq!(walk.wait_for("window")["drawn_by"], walk.wait_for("window")["adapter"]);
    walk.wait_for("first_complete_picture");
    let window = display.hand(&["search", "--name", "house"]);
    display.hand(&["windowfocus", window.lines().last().expect("a window")]);
    display.hand(&["key", "F12"]);
    walk.shot();
    display.hand(&["key", "ctrl+q"]);
    let status = walk.client.wait().expect("ends");
    assert!(status.success(), "{status}: {}", std::fs::read_to_string(&walk.log).unwrap_or_default());
}

#[test]
fn views_places_and_walks_are_at_hand() {
    let Some(display) = display() else { return };
    let f = fixture();
    let dir = folder("kept");
    let served = Server::start(&f.dataset).expect("serves");
    let places = dir.join("places").join("house.path.json");
    let file = places.to_str().expect("UTF-8");
    let settings = dir.join("settings.json");
    std::fs::write(&settings, r#"{ "developer": true }"#).expect("writable");
    let settings = settings.to_str().expect("UTF-8");
    let more = ["--fingerprint", &served.fingerprint, "--bookmarks", file, "--settings", settings, BEGIN];
    let mut walk = Walk::open(&display, &served.quic, &dir, &more);
    walk.wait_for("first_complete_picture");
    let window = display.hand(&["search", "--name", "house"]);
    // A key that is down when the window gets the keyboard was pressed for something else.
    display.hand(&["keydown", "F2"]);
    display.hand(&["windowfocus", window.lines().last().expect("a window")]);
    display.hand(&["key", "F1"]);
    walk.wait_for("figures");
    display.hand(&["keyup", "F2", "key", "F1"]);
    assert_eq!(walk.count("view"), 0, "{:?}", walk.all());
    for shows in ["near", "far", "sources"] {
        display.hand(&["key", "F2"]);
        walk.wait(shows, |w| (w.last("view")?["shows"] == shows).then_some(()));
    }
    display.hand(&["key", "shift+F2"]);
    walk.wait("the view before", |w| (w.last("view")?["shows"] == "far").then_some(()));
    display.hand(&["key", "F3"]);
    assert_eq!(walk.wait_for("settings")["open"], true);
    display.hand(&["key", "F3"]);
    // A place is kept, a walk is recorded.
    let begin = walk.position();
    display.hand(&["key", "ctrl+1"]);
    assert_eq!(walk.wait_for("bookmark")["kept"], true);
    display.hand(&["key", "r"]);
    walk.wait_for("recording");
    display.hand(&["keydown", "w"]);
    walk.wait("walking", |w| (w.position().distance(begin) > 0.5).then_some(()));
    display.hand(&["keyup", "w"]);
    std::thread::sleep(Duration::from_millis(500));
    display.hand(&["key", "r"]);
    let recorded = walk.wait_for("recorded");
    let path = PathBuf::from(recorded["path"].as_str().expect("a path"));
    let read = |path: &Path| std::fs::read_to_string(path).expect("readable");
    let poses = ldi_protocol::path::parse(&read(&path)).expect("a path file").poses;
    let end = poses[poses.len() - 1].pose.position;
    assert!(poses.len() > 3 && end.distance(begin) > 0.5, "{poses:?}");
    // To the place, and along the walk again.
    display.hand(&["key", "1"]);
    walk.wait("the place", |w| (w.position().distance(begin) < 0.05).then_some(()));
    display.hand(&["key", "p"]);
    walk.wait("a replay", |w| (w.last("replay")?["running"] == true).then_some(()));
    walk.wait("its end", |w| (w.last("replay")?["running"] == false).then_some(()));
    walk.wait("the walk's end", |w| (w.position().distance(end) < 0.2).then_some(()));
    assert_eq!(ldi_protocol::path::parse(&read(&places)).expect("a path file").poses.len(), 1);
    drop(walk);
    // The same from the command line.
    let more = ["--fingerprint", &served.fingerprint, "--replay", path.to_str().expect("UTF-8")];
    let mut walk = Walk::open(&display, &served.quic, &dir, &more);
    walk.wait("a replay", |w| (w.last("replay")?["running"] == false).then_some(()));
    walk.wait("the walk's end", |w| (w.position().distance(end) < 0.2).then_some(()));
    let (code, said) = blind(&dir, &[&served.quic, "--replay", file, "--fingerprint", "ab"]);
    assert!(code == Some(2) && !said.contains("cannot be walked"), "{said}");
    let (code, said) = blind(&dir, &[&served.quic, "--replay", "/absent.path.json"]);
    assert!(code == Some(42) && said.contains("/absent.path.json"), "{said}");
}

/// The window gets the keyboard.
fn focus(display: &Display) {
    let window = display.hand(&["search", "--name", "house"]);
    display.hand(&["windowfocus", window.lines().last().expect("a window")]);
}

#[test]
fn settings_links_and_the_last_place_come_back() {
    let Some(display) = display() else { return };
    let f = fixture();
    let dir = folder("back");
    let served = Server::start(&f.dataset).expect("serves");
    let trusted = ["--fingerprint", &served.fingerprint];
    let mut walk = Walk::open(&display, &served.quic, &dir, &[trusted[0], trusted[1], BEGIN]);
    walk.wait_for("first_complete_picture");
    focus(&display);
    display.hand(&["key", "h"]);
    assert_eq!(walk.wait_for("help")["open"], true);
    display.hand(&["key", "Escape"]);
    walk.wait("closed help", |w| (w.last("help")?["open"] == false).then_some(()));
    // Views for developers are off until the settings say otherwise.
    display.hand(&["key", "F2"]);
    display.hand(&["key", "F11"]);
    assert_eq!(walk.wait_for("full_screen")["on"], true);
    let kept = std::fs::read_to_string(dir.join(".config/ldi/settings.json")).expect("kept");
    assert_eq!(serde_json::from_str::<Value>(&kept).expect("JSON")["full_screen"], true);
    display.hand(&["key", "F11"]);
    walk.wait("a window", |w| (w.last("full_screen")?["on"] == false).then_some(()));
    assert_eq!(walk.count("view"), 0, "{:?}", walk.all());
    display.hand(&["key", "ctrl+c"]);
    let link = walk.wait_for("link")["text"].as_str().expect("a link").to_owned();
    assert!(link.starts_with(&format!("ldi://{}#-10.", served.quic)), "{link}");
    let (place, yaw) = (walk.position(), walk.yaw());
    assert_eq!(walk.count("last_place"), 0, "a first visit");
    display.hand(&["key", "ctrl+q"]);
    assert!(walk.client.wait().expect("ends").success());
    // The link opens the same view.
    let mut walk = Walk::open(&display, &link, &dir, &trusted);
    walk.wait_for("first_complete_picture");
    assert!(walk.position().distance(place) < 0.05 && (walk.yaw() - yaw).abs() < 0.01, "{:?}", walk.all());
    assert_eq!(walk.count("start_moved"), 0);
    drop(walk);
    // Without a start the last place is offered.
    let mut walk = Walk::open(&display, &served.quic, &dir, &trusted);
    walk.wait_for("last_place");
    focus(&display);
    display.hand(&["key", "0"]);
    walk.wait("the last place", |w| (w.position().distance(place) < 0.05).then_some(()));
    drop(walk);
    // A start where nobody can stand.
    let mut walk = Walk::open(&display, &served.quic, &dir, &[trusted[0], trusted[1], "--start=500,1.6,0"]);
    let moved = walk.wait_for("start_moved");
    assert!(moved["by_m"].as_f64().is_some_and(|m| m > 400.0), "{moved}");
    let said = walk.wait("a warning", |w| std::fs::read_to_string(&w.log).ok().filter(|l| l.contains("moved")));
    assert!(said.contains("nobody can stand"), "{said}");
}

/// A record of Linux's joystick interface: time, value, kind, number.
fn joystick(value: i16, kind: u8, number: u8) -> [u8; 8] {
    let [a, b] = value.to_ne_bytes();
    [0, 0, 0, 0, a, b, kind, number]
}

#[test]
#[cfg(target_os = "linux")]
fn a_gamepad_walks() {
    use std::io::Write as _;
    let Some(display) = display() else { return };
    let f = fixture();
    let dir = folder("pad");
    // A pipe tells what a pad's device file would.
    let pipe = dir.join("js0");
    assert!(Command::new("mkfifo").arg(&pipe).status().expect("mkfifo is there").success());
    let served = Server::start(&f.dataset).expect("serves");
    let more = ["--fingerprint", &served.fingerprint, "--gamepad", pipe.to_str().expect("UTF-8"), BEGIN];
    let mut walk = Walk::open(&display, &served.quic, &dir, &more);
    walk.wait_for("first_complete_picture");
    let window = display.hand(&["search", "--name", "house"]);
    display.hand(&["windowfocus", window.lines().last().expect("a window")]);
    let mut pad = std::fs::OpenOptions::new().write(true).open(&pipe).expect("somebody reads it");
    let mut say = |records: &[[u8; 8]]| pad.write_all(&records.concat()).expect("read");
    let (axis, button, first) = (2, 1, 0x80);
    let at_rest: Vec<_> =
        (0..8).map(|n| joystick(if n == 2 || n == 5 { -32767 } else { 0 }, axis | first, n)).collect();
    say(&at_rest);
    let (begin, yaw) = (walk.position(), walk.yaw());
    say(&[joystick(-32767, axis, 1)]);
    walk.wait("walking", |w| (w.position().distance(begin) > 0.5).then_some(()));
    say(&[joystick(0, axis, 1), joystick(32767, axis, 3)]);
    walk.wait("a turn to the right", |w| ((w.yaw() - yaw + 540.0).rem_euclid(360.0) - 180.0 < -5.0).then_some(()));
    say(&[joystick(0, axis, 3), joystick(1, button, 3)]);
    assert_eq!(walk.wait_for("map")["open"], true);
    say(&[joystick(0, button, 3), joystick(1, button, 3)]);
    walk.wait("the map's end", |w| (w.last("map")?["open"] == false).then_some(()));
    say(&[joystick(1, button, 2)]);
    walk.wait_for("screenshot");
    // Unplugged while a stick is held: the walker stops.
    say(&[joystick(-32767, axis, 1)]);
    drop(pad);
    walk.wait("standing", |w| {
        let before = w.position();
        std::thread::sleep(Duration::from_millis(700));
        (w.position() == before).then_some(())
    });
}

/// From a room of a real building through two doors, with the keys alone; then by the map to the
/// other end of the storey.
#[test]
fn three_rooms_of_the_clinic() {
    let Some(scene) = shared_scene("clinic.glb") else {
        println!("SKIPPED: clinic.glb is not among the shared scenes here");
        return;
    };
    let Some(display) = display() else { return };
    let made = made_once(Path::new(env!("CARGO_TARGET_TMPDIR")), "clinic", |dir| {
        let mut c = run::command("ldi-server").expect("built");
        c.arg("build").arg(&scene).args(["--budget", "400000", "--size", "320x180", "-o"]).arg(dir.join("clinic.ldi"));
        run::run(c).expect("builds");
    });
    let dataset = made.join("clinic.ldi");
    let dir = folder("clinic");
    let served = Server::start(&dataset).expect("serves");
    // In line with two doors, whose walls stand at these z; looking along -z.
    let (begin, walls) = ("--start=-17.2,1.65,20,0", [18.2, 16.7]);
    let mut walk = Walk::open(&display, &served.quic, &dir, &["--fingerprint", &served.fingerprint, begin]);
    walk.wait_for("first_complete_picture");
    let window = display.hand(&["search", "--name", "clinic"]);
    display.hand(&["windowfocus", window.lines().last().expect("a window")]);
    display.hand(&["key", "F12"]);
    walk.shot();
    display.hand(&["keydown", "w"]);
    walk.wait("the third room", |w| (w.position().z < walls[1] - 0.5).then_some(()));
    display.hand(&["keyup", "w"]);
    let poses: Vec<DVec3> = walk.all().iter().filter(|e| e["event"] == "pose").map(position).collect();
    for room in [walls[0]..f64::INFINITY, walls[1]..walls[0], f64::NEG_INFINITY..walls[1]] {
        assert!(poses.iter().any(|p| room.contains(&p.z)), "{room:?}: {poses:?}");
    }
    // Straight through the doors: no wall was slid along, none walked through.
    assert!(poses.iter().all(|p| (p.x + 17.2).abs() < 0.3), "{poses:?}");
    let index = Dataset::open(&dataset).expect("opens").index().clone();
    display.hand(&["key", "m"]);
    let map = walk.wait_for("map");
    let target = far_place(clear_places(&index, walk.position().y), walk.position());
    click_on_map(&display, &mut walk, &map, target);
    display.hand(&["key", "F1"]);
    walk.wait_for("figures");
    display.hand(&["key", "ctrl+q"]);
    let status = walk.client.wait().expect("ends");
    assert!(status.success(), "{status}: {}", std::fs::read_to_string(&walk.log).unwrap_or_default());
}

#[test]
fn a_lost_server_is_found_again() {
    let Some(display) = display() else { return };
    let f = fixture();
    let dir = folder("lost");
    let served = Server::start(&f.dataset).expect("serves");
    let mut walk = Walk::open(&display, &served.quic, &dir, &["--fingerprint", &served.fingerprint]);
    walk.wait_for("first_complete_picture");
    let address = served.quic.clone();
    drop(served);
    walk.wait_for("lost");
    let again = Server::start_at(&f.dataset, &address).expect("serves at the same address");
    walk.wait("a second connection", |w| (w.count("connected") == 2).then_some(()));
    assert_eq!(again.quic, address);
}

/// `connect` without a display: no window ever opens.
fn blind(dir: &Path, arguments: &[&str]) -> (Option<i32>, String) {
    let mut c: Command = run::command("ldi-client").expect("built");
    c.arg("connect").args(arguments).env_remove("DISPLAY").env_remove("WAYLAND_DISPLAY").env_remove("WAYLAND_SOCKET");
    c.env("HOME", dir).env_remove("XDG_CONFIG_HOME").env_remove("LDI_TOKEN").stdin(Stdio::null());
    let out = c.output().expect("runs");
    (out.status.code(), String::from_utf8_lossy(&out.stderr).into_owned())
}

#[test]
fn strangers_are_asked_about_and_changed_ones_refused() {
    let f = fixture();
    let dir = folder("trust");
    let served = Server::start(&f.dataset).expect("serves");
    let file = dir.join("known");
    let file = file.to_str().expect("UTF-8");
    let (code, said) = blind(&dir, &[&served.quic, "--known-hosts", file]);
    assert_eq!(code, Some(2), "{said}");
    let typed = format!("ldi-client connect {} --fingerprint {}", served.quic, served.fingerprint);
    assert!(said.contains(&typed) && said.contains("--accept-new"), "{said}");
    assert!(!Path::new(file).exists());
    let old = "ab".repeat(32);
    std::fs::write(file, format!("# the hall\n{} {old}\n", served.quic)).expect("writable");
    let (code, said) = blind(&dir, &[&served.quic, "--known-hosts", file, "--accept-new"]);
    assert_eq!(code, Some(42), "{said}");
    for part in [file, "line 2", &old, &served.fingerprint] {
        assert!(said.contains(part), "{part}: {said}");
    }
    let (code, said) = blind(&dir, &["127.0.0.1:9", "--known-hosts", file]);
    assert!(code == Some(1) && said.contains("ldi-server serve"), "{said}");
    // A fingerprint that was given stands above the file. Then there is only no display.
    let (code, said) = blind(&dir, &[&served.quic, "--known-hosts", file, "--fingerprint", &served.fingerprint]);
    assert_eq!(code, Some(42), "{said}");
    assert!(said.contains("DISPLAY") && said.contains("ldi-client walk") && !said.contains(".rs"), "{said}");
}

#[test]
#[cfg(all(target_os = "linux", target_env = "gnu"))]
fn walking_without_a_window_loads_nothing_of_a_display() {
    let f = fixture();
    let dir = folder("headless");
    let served = Server::start(&f.dataset).expect("serves");
    let mut c = run::command("ldi-client").expect("built");
    c.args(["walk", &served.quic, "--fingerprint", &served.fingerprint, "--size", "160x90", "--path"]).arg(&f.poses);
    c.arg("-o").arg(dir.join("frames")).arg("--report").arg(dir.join("walk.json"));
    // The loader says which libraries it opens, later ones too.
    c.env("LD_DEBUG", "files").env("LD_DEBUG_OUTPUT", dir.join("loader"));
    run::run(c).expect("walks");
    let files = std::fs::read_dir(&dir).expect("readable").map(|e| e.expect("readable").path());
    let said: String = files
        .filter(|p| p.file_name().is_some_and(|n| n.to_string_lossy().starts_with("loader.")))
        .map(|p| std::fs::read_to_string(p).expect("readable"))
        .collect();
    assert!(said.contains("libc.so"), "the loader says what it loads");
    for library in ["libX11", "libxcb", "libwayland", "libvulkan", "libGL", "libEGL", "libxkbcommon"] {
        assert!(!said.contains(library), "{library} was loaded");
    }
}
