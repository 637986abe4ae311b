//! Server and client over loopback, in one process: what is needed arrives, once; what is wrong
//! stays with whom it is wrong.

#[path = "../../client/src/cache/fixture.rs"]
mod fixture;
#[path = "streaming/host.rs"]
#[allow(dead_code, reason = "shared with other tests, which use the rest")]
mod host;
#[path = "streaming/stranger.rs"]
mod stranger;

use bytes::Bytes;
use fixture::{FIRST_CELL, LDI, STEP_M, Street, street};
use host::{Host, Memory, PATIENCE, PICTURE, folder};
use ldi_client::{
    cache::Incomplete,
    engine::{Method, view_of},
    report::StageMs,
    resident::Resident,
    stream::{ConnectConfig, ConnectError, Connection, Fingerprint, MAX_RETRIES, OtherWalkers},
};
use ldi_protocol::{
    Pose,
    codec::ColourProfile,
    index::{BuildSettings, CELLS, ChunkHash, ChunkKind, Index},
    need::{Needed, Sight},
    select::{CellGroups, FarBy, Show, select},
    wire::{RefusalCode, Request},
};
use ldi_server::{
    build::{self, BuildOptions, Represent},
    serve::{ChunkSource, GUESSED_FINER, SelectViews, ServeConfig, planner::Views},
    store::{Dataset, StoreError},
};
use std::{collections::BTreeSet, sync::Arc, time::Duration};

/// A walker on the street's axis.
fn pose(z: f64, yaw_deg: f64) -> Pose {
    Pose { position: glam::DVec3::new(0.0, 0.0, z), yaw_deg, pitch_deg: 0.0 }
}

fn needs(connection: &Connection, pose: &Pose) -> Needed {
    let index = connection.index().clone();
    let camera = PICTURE.camera(&index.settings);
    SelectViews::new(index, &camera).needed(pose)
}

/// Walks to a pose and waits for all it needs. Returns what that was.
fn stand(connection: &Connection, pose: &Pose) -> Result<Vec<u32>, Incomplete> {
    let needed = needs(connection, pose);
    connection.update_view(pose, &needed);
    let all: Vec<u32> = needed.all().collect();
    connection.wait_until_complete(&all, PATIENCE).map(|()| all)
}

/// The same without ever asking: the server has to send it by itself.
fn stand_unasked(connection: &Connection, pose: &Pose) -> Result<Vec<u32>, Incomplete> {
    let needed = needs(connection, pose);
    connection.update_view(pose, &needed);
    let all: Vec<u32> = needed.all().collect();
    connection.cache().wait(&all, PATIENCE).map(|()| all)
}

#[test]
fn a_walk_gets_everything_it_needs_and_nothing_twice() {
    let host = Host::start("walk", Memory::new(street(8, 64)));
    let connection = host.connect();
    let mut needed = BTreeSet::new();
    for (z, yaw) in [(0.0, 0.0), (-1.5 * STEP_M, 90.0), (-2.5 * STEP_M, 180.0), (0.0, 0.0)] {
        let all = stand(&connection, &pose(z, yaw)).unwrap();
        needed.extend(all);
        connection.cache().check().unwrap();
    }
    assert_eq!(connection.cache().held(), needed.iter().copied().collect::<Vec<_>>());
    assert!(needed.contains(&LDI[1]), "the walk uses the LDI");
    assert_eq!(select(connection.index(), &pose(0.0, 0.0)).placement, Some(0));
    assert_eq!(connection.cache().ldi(0).unwrap().layers.len(), 2);
    let stats = connection.stats();
    assert_eq!((stats.chunks as usize, stats.duplicates, stats.damaged), (needed.len(), 0, 0), "{stats:?}");
    assert!(stats.bytes_total > stats.chunk_bytes, "{stats:?}");
    let used = u64::from(connection.index().chunks[LDI[0] as usize].stored_bytes)
        + u64::from(connection.index().chunks[LDI[1] as usize].stored_bytes);
    assert_eq!(stats.wasted_bytes, stats.chunk_bytes - used, "only the LDI was drawn");
}

#[test]
fn who_shows_no_images_is_sent_none() {
    let host = Host::start("no-images", Memory::new(street(8, 64).with_tree()));
    for far in [FarBy::Geometry, FarBy::Tree] {
        let show = Show { far, ..Show::default() };
        let connection = Connection::connect(ConnectConfig { show, prefetch_m: 10.0, ..host.config() }).unwrap();
        let index = connection.index().clone();
        let views = SelectViews::showing(index.clone(), Arc::default(), &PICTURE.camera(&index.settings), show);
        for pose in [pose(0.0, 0.0), pose(-1.5 * STEP_M, 90.0), pose(-2.5 * STEP_M, 180.0), pose(0.0, 0.0)] {
            let needed = views.needed(&pose);
            connection.update_view(&pose, &needed);
            let all: Vec<u32> = needed.all().collect();
            // Unasked: the server has to know what is shown.
            connection.cache().wait(&all, PATIENCE).unwrap();
        }
        let held = connection.cache().held();
        assert!(!held.iter().any(|c| LDI.contains(c)), "{far:?}: {held:?}");
    }
}

/// Forecasts look only at what lacks something: they find what a look at everything finds, and
/// that is what the client draws, wherever it takes from what is far.
#[test]
fn what_is_lacking_is_what_is_needed_and_absent() {
    let folder = folder("lacking");
    let options = BuildOptions {
        scenes: vec!["builtin:house?triangles=20000".into()],
        output: folder.join("house"),
        settings: BuildSettings {
            budget: 6_000,
            optimize_budget: 0,
            grid: CELLS.into(),
            colour: "high".into(),
            eye_height_m: Some(1.6),
            ..street(1, 16).index.settings
        },
        colour: ColourProfile::High,
        represent: Represent::Grid,
        starts: Vec::new(),
        along: None,
        time_limit: None,
        budget: build::BudgetRule::Given,
    };
    build::build(&options, &()).unwrap();
    let index = Dataset::open(&options.output).unwrap().index().clone();
    let camera = PICTURE.camera(&index.settings);
    let methods = [Method::Auto, Method::Geometry, Method::Tree];
    let views =
        methods.map(|m| SelectViews::showing(index.clone(), CellGroups::of(&index.cells).into(), &camera, m.show()));
    let volume = index.volume.as_ref().unwrap().sampler();
    let mut random =
        (1u64..).map(|i| f64::from((i.wrapping_mul(0x9E37_79B9_7F4A_7C15) >> 40) as u32) / f64::from(1u32 << 24));
    let mut next = || random.next().unwrap();
    let mut found = [[0, 0]; 3];
    // Cells that poses need where all is geometry, and where the tree shows what is far.
    let (mut all_cells, mut near_cells) = (0, 0);
    let mut guessed_finer = 0;
    let cells = |method: usize, pose: &Pose| -> BTreeSet<u32> {
        let is_cell = |c: &u32| index.chunks[*c as usize].kind == ChunkKind::Cell;
        views[method].needed(pose).all().filter(is_cell).collect()
    };
    for round in 0..60 {
        let (method, shown, found) = (methods[round % 3], &views[round % 3], &mut found[round % 3]);
        let poses: Vec<Pose> = (0..25)
            .map(|_| Pose {
                position: volume.point([next(), next(), next(), next()]).unwrap(),
                yaw_deg: next() * 360.0,
                pitch_deg: next() * 100.0 - 50.0,
            })
            .collect();
        // From hardly anything to nearly everything.
        let absent: Vec<bool> = index.chunks.iter().map(|_| next() * 60.0 > round as f64).collect();
        let absent = |chunk: u32| absent[chunk as usize];
        for (pose, lacking) in poses.iter().zip(shown.lacking(&poses, &absent)) {
            let (all, near) = (cells(1, pose), cells(2, pose));
            assert!(near.is_subset(&all), "the tree is behind the nearest cells: {near:?}, {all:?}");
            (all_cells, near_cells) = (all_cells + all.len(), near_cells + near.len());
            let needed = shown.needed(pose);
            let view = view_of(&index, pose, &camera, method, &mut StageMs::default());
            assert_eq!(needed, view.needed(&index, &Sight::new(pose, &camera, 1)), "{method:?} at {pose:?}");
            // Guesses see as much of the scene, and its textures a little finer.
            let finer = Sight::new(pose, &camera, 1).finer(GUESSED_FINER);
            let Needed { base, now, fine } = view.needed(&index, &finer);
            guessed_finer += fine.iter().filter(|c| !needed.fine.contains(c)).count();
            let sorted = |mut list: Vec<u32>| {
                list.sort_unstable();
                list
            };
            let expected = sorted(now.into_iter().chain(fine).filter(|c| absent(*c)).collect());
            // The base layer is on its way before anything else, named or not; of the tree it may
            // name a chunk without samples in view, and before it cells in view beyond the budget.
            let beyond = |c: &u32| match index.chunks[*c as usize].kind {
                ChunkKind::Tree => true,
                ChunkKind::Cell => method == Method::Tree && all.contains(c),
                ChunkKind::Bundle | ChunkKind::Levels | ChunkKind::Texture => method == Method::Tree,
                _ => false,
            };
            let surplus = |c: &u32| beyond(c) && !expected.contains(c);
            let lacking = lacking.into_iter().filter(|c| !base.contains(c) && !surplus(c)).collect();
            assert_eq!(sorted(lacking), expected, "{method:?}, round {round}, {pose:?}");
            for chunk in expected {
                found[usize::from(index.chunks[chunk as usize].kind == ChunkKind::Ldi)] += 1;
            }
        }
    }
    let [offered, geometry, tree] = found;
    assert!(offered.iter().all(|n| *n > 100), "geometry, images: {offered:?}");
    assert!(geometry[0] > 100 && tree[0] > 100 && geometry[1] + tree[1] == 0, "{geometry:?}, {tree:?}");
    assert!(near_cells > 100 && near_cells < all_cells, "{near_cells} of {all_cells}");
    assert!(guessed_finer > 0, "some texture is finer in a guess");
}

#[test]
fn a_small_cache_evicts_and_gets_it_again() {
    let street = street(8, 16);
    // Room for the LDI, the texture and a cell or two.
    let size = |c: u32| u64::from(street.index.chunks[c as usize].decoded_bytes);
    let cache_bytes = (0..FIRST_CELL + 3).map(size).sum();
    let host = Host::start("small", Memory::new(street));
    let connection = Connection::connect(ConnectConfig { cache_bytes, ..host.config() }).unwrap();
    for round in 0..3 {
        for z in [-3.5, -5.5, -7.5] {
            // Looking back along the street: all cells behind, no LDI.
            let here = pose(z * STEP_M, 0.0);
            let needed = needs(&connection, &here);
            let all: Vec<u32> = needed.all().collect();
            connection.update_view(&here, &needed);
            let end = connection.wait_until_complete(&all, PATIENCE);
            assert!(end.is_ok() || matches!(end, Err(Incomplete::NoRoom { .. })), "round {round}, z {z}: {end:?}");
            connection.cache().check().unwrap();
            assert!(connection.cache().usage().peak_bytes <= cache_bytes);
        }
    }
}

#[test]
fn a_damaged_chunk_is_given_up_and_the_walk_goes_on() {
    let mut street = street(4, 16);
    let damaged = FIRST_CELL;
    let chunk = &mut street.chunks[damaged as usize];
    *chunk.last_mut().unwrap() ^= 1;
    let host = Host::start("damaged", Memory::new(street));
    let connection = host.connect();
    assert_eq!(stand(&connection, &pose(0.0, 0.0)), Err(Incomplete::Damaged(vec![damaged])));
    assert_eq!(connection.stats().damaged, u64::from(MAX_RETRIES) + 1);
    assert!(connection.cache().ldi(0).is_some() && connection.cache().cell(0).is_none());
    assert!(stand(&connection, &pose(-1.5 * STEP_M, 0.0)).is_ok());
}

#[test]
fn a_resumed_walk_streams_nothing_again() {
    let host = Host::start("resume", Memory::new(street(4, 32)));
    let first = host.connect();
    let here = pose(0.0, 0.0);
    stand(&first, &here).unwrap();
    let kept = first.kept();
    drop(first);
    let second = Connection::connect(ConnectConfig { resume: Some(kept), ..host.config() }).unwrap();
    stand(&second, &here).unwrap();
    // A later view brings what is new, and only that.
    let new = stand(&second, &pose(-2.5 * STEP_M, 180.0)).unwrap();
    let stats = second.stats();
    assert_eq!((stats.chunks, stats.duplicates), (0, 0), "{new:?} {stats:?}");
}

#[test]
fn a_walker_gets_the_dataset_that_it_names() {
    let memory = |cells| Arc::new(Memory::new(street(cells, 16))) as Arc<dyn ChunkSource>;
    let mut host = Host::start("several", Memory::new(street(2, 16)));
    let named = |name: Option<&str>| ConnectConfig { dataset: name.map(str::to_owned), ..host.config() };
    // One alone needs no name, and has one.
    let only = Connection::connect(named(None)).unwrap();
    assert_eq!(Connection::connect(named(Some("street"))).unwrap().index(), only.index());
    let refusal = |name: Option<&str>, config: ConnectConfig| match Connection::connect(config) {
        Err(ConnectError::Refused { code: RefusalCode::Dataset, message }) => message,
        other => panic!("{name:?}: {other:?}"),
    };
    let message = refusal(Some("museum"), named(Some("museum\n")));
    assert!(message.contains(r"'museum\n'") && message.contains("street"), "{message}");
    host.offer([("house".to_owned(), memory(2)), ("museum".to_owned(), memory(3))].into());
    let named = |name: Option<&str>| ConnectConfig { dataset: name.map(str::to_owned), ..host.config() };
    let message = refusal(None, named(None));
    assert!(message.contains("HOST/NAME") && message.contains("house, museum"), "{message}");
    let (house, museum) = (named(Some("house")), named(Some("museum")));
    let (house, museum) = (Connection::connect(house).unwrap(), Connection::connect(museum).unwrap());
    assert_eq!((house.index().cells.len(), museum.index().cells.len()), (2, 3));
    // Each has its page, and people meet in one dataset only.
    stand(&house, &pose(0.0, 0.0)).unwrap();
    stand(&museum, &pose(0.0, 0.0)).unwrap();
    let json = |path: &str| serde_json::from_str::<serde_json::Value>(&host.get(path).1).unwrap();
    assert_eq!(json("/house/walkers.json")[0]["dataset"], "house");
    assert_eq!(json("/museum/walkers.json").as_array().map(Vec::len), Some(1));
    assert_eq!(json("/museum/plan.json")["cells"].as_array().map(Vec::len), Some(3));
    assert_eq!(json("/museum/connect.json")["name"], "museum");
    assert_eq!(json("/readyz")["datasets"].as_array().map(Vec::len), Some(2));
    let listed = json("/datasets.json");
    assert_eq!((&listed[0]["name"], &listed[1]["name"]), (&"house".into(), &"museum".into()));
    assert!(host.get("/").1.contains("datasets.json") && host.get("/house/").1.contains("plan.json"));
    assert!(host.get("/house").0.contains("location: /house/"), "{}", host.get("/house").0);
    for wrong in ["/plan.json", "/church/", "/church/plan.json"] {
        let (head, body) = host.get(wrong);
        assert!(head.starts_with("HTTP/1.1 404") && body.contains("house, museum"), "{wrong}: {head} {body}");
    }
}

/// Waits until something is so.
fn until(what: &str, so: impl Fn() -> bool) {
    let begin = std::time::Instant::now();
    while !so() {
        assert!(begin.elapsed() < PATIENCE, "{what} did not happen");
        std::thread::sleep(Duration::from_millis(1));
    }
}

/// A street of so many cells that its pages take seconds over the link below; the tree's are among
/// the last of the manifest.
fn long_street() -> Street {
    street(6000, 16).with_tree()
}

#[test]
fn a_walk_begins_before_the_whole_manifest_is_there() {
    let host = Host::start("early", Memory::new(long_street()));
    let whole = host.connect();
    assert!(whole.index().is_whole());
    let link = Some("rate=2mbit,delay=5ms,seed=1".parse().unwrap());
    let early = Connection::connect(ConnectConfig { early: true, link, ..host.config() }).unwrap();
    assert!(!early.index().is_whole() && early.index().cells.is_empty());
    // The base layer, by number, while pages come.
    let here = pose(5.0, 0.0);
    let base = early.index().tree.as_ref().unwrap().root_chunk;
    assert_eq!(stand_unasked(&early, &here).unwrap(), [base]);
    assert!(!early.index().is_whole(), "{} bytes for a first picture", early.received_bytes());
    assert!(early.cache().brood(base).is_some());
    // Then everything, under the same numbers, and what is held stays.
    until("the whole index", || early.index().is_whole());
    assert_eq!(early.index(), whole.index());
    assert!(early.cache().holds(base));
    let all = stand_unasked(&early, &here).unwrap();
    assert!(all.contains(&LDI[1]) && all.contains(&FIRST_CELL));
    let stats = early.stats();
    assert_eq!((stats.chunks as usize, stats.duplicates, stats.damaged), (all.len(), 0, 0), "{stats:?}");
    early.cache().check().unwrap();
}

/// Nothing of such a dataset is early, and everything comes all the same.
#[test]
fn an_early_walk_without_a_tree_waits_for_the_manifest() {
    let host = Host::start("early-none", Memory::new(street(4, 16)));
    let connection = Connection::connect(ConnectConfig { early: true, ..host.config() }).unwrap();
    assert!(connection.index().is_whole());
    stand_unasked(&connection, &pose(0.0, 0.0)).unwrap();
}

#[test]
fn a_connection_lost_early_leaves_nothing_and_a_whole_one_its_manifest() {
    let host = Host::start("early-resume", Memory::new(long_street()));
    let link = Some("rate=2mbit,delay=5ms,seed=1".parse().unwrap());
    let early = Connection::connect(ConnectConfig { early: true, link, ..host.config() }).unwrap();
    assert!(!early.index().is_whole());
    let kept = early.kept();
    drop(early);
    let again = Connection::connect(ConnectConfig { resume: Some(kept), ..host.config() }).unwrap();
    stand(&again, &pose(5.0, 0.0)).unwrap();
    let (kept, first) = (again.kept(), again.received_bytes());
    drop(again);
    // Whoever has the manifest in memory is not sent it again.
    let third = Connection::connect(ConnectConfig { resume: Some(kept), early: true, ..host.config() }).unwrap();
    assert!(third.index().is_whole());
    stand(&third, &pose(5.0, 0.0)).unwrap();
    let bytes = third.received_bytes();
    assert!(bytes < 20_000 && bytes * 10 < first, "{bytes} bytes, {first} before");
}

#[test]
fn requests_by_number_and_by_name_are_answered() {
    let street = street(4, 16);
    let (bytes, name) = (street.chunks[FIRST_CELL as usize].clone(), street.index.chunks[FIRST_CELL as usize].hash);
    let host = Host::start("requests", Memory::new(street));
    let connection = host.connect();
    assert_eq!(connection.fetch(Request::Name(name)).unwrap(), (FIRST_CELL, bytes.clone()));
    assert_eq!(connection.fetch(Request::Number(FIRST_CELL)).unwrap(), (FIRST_CELL, bytes));
    for wrong in [Request::Number(9999), Request::Name(ChunkHash([7; 32]))] {
        assert!(matches!(connection.fetch(wrong), Err(ConnectError::Protocol(_))));
    }
    // Asking for what does not exist costs nothing else.
    connection.request(&[9999]);
    stand(&connection, &pose(0.0, 0.0)).unwrap();
}

#[test]
fn an_address_gets_no_more_than_its_bytes_per_second() {
    // The least that the settings take: a tenth of a second's worth are seven of these chunks.
    const LIMIT: f64 = 10_000.0;
    let config = ServeConfig { bytes_per_second_per_address: LIMIT, ..Default::default() };
    let host = Host::start_with("allowance", Memory::new(street(4, 16)), config);
    let connections = [host.connect(), host.connect()];
    let started = std::time::Instant::now();
    let mut bytes = 0;
    for round in 0..30 {
        let chunk = connections[round % 2].fetch(Request::Number(FIRST_CELL)).unwrap().1;
        bytes += chunk.len();
    }
    // Never more, however fast or slow this machine is: a tenth of a second's worth goes at once,
    // and one chunk before it is counted.
    let most = LIMIT * (started.elapsed().as_secs_f64() + 0.1) + (bytes / 30) as f64;
    assert!(bytes as f64 <= most, "{bytes} bytes, {most} at most");
    assert!(bytes as f64 > 0.3 * LIMIT, "{bytes} bytes are no test of the limit");
    stand(&connections[0], &pose(0.0, 0.0)).unwrap();
}

#[test]
fn who_asks_for_everything_gets_two_megabytes_per_second() {
    let host = Host::start("asking", Memory::new(street(2, 512)));
    let asking = host.connect();
    let started = std::time::Instant::now();
    let (mut bytes, mut largest) = (0, 0);
    while bytes < 3_000_000 {
        let chunk = asking.fetch(Request::Number(LDI[0])).unwrap().1;
        (bytes, largest) = (bytes + chunk.len(), largest.max(chunk.len()));
    }
    // Never more, however fast or slow this machine is: half a second's worth goes at once, and
    // one chunk before it is counted.
    let most = 2e6 * (started.elapsed().as_secs_f64() + 0.5) + largest as f64;
    assert!(bytes as f64 <= most, "{bytes} bytes, {most} at most");
}

/// What a client's map knows of the others, once it is `expected`: walkers by name, and where they
/// are along the street.
fn others_become(others: &OtherWalkers, expected: Option<&[(&str, f64)]>) {
    let seen = || {
        let list = others.list()?;
        Some(list.into_iter().map(|o| (o.name, o.position[2], o.yaw_deg)).collect::<Vec<_>>())
    };
    let wanted = expected.map(|e| e.iter().map(|(n, z)| ((*n).to_owned(), *z, 90.0)).collect());
    let deadline = std::time::Instant::now() + PATIENCE;
    while seen() != wanted {
        assert!(std::time::Instant::now() < deadline, "{:?} instead of {wanted:?}", seen());
        std::thread::sleep(Duration::from_millis(20));
    }
}

#[test]
fn who_wants_to_know_is_told_where_the_others_are() {
    let mut host = Host::start("others", Memory::new(street(2, 16)));
    let named = |name: &str| ConnectConfig { name: name.into(), ..host.config() };
    let (watching, passing) = (named("watching"), named("passing"));
    let others = watching.others.clone();
    others.set_wanted(true);
    let watcher = Connection::connect(watching.clone()).unwrap();
    watcher.send_pose(&pose(0.0, 0.0));
    others_become(&others, Some(&[]));
    let passer = Connection::connect(passing.clone()).unwrap();
    passer.send_pose(&pose(-1.0, 90.0));
    others_become(&others, Some(&[("passing", -1.0)]));
    passer.send_pose(&pose(-2.0, 90.0));
    others_become(&others, Some(&[("passing", -2.0)]));
    // Who did not ask is told nothing, and neither is who asks no longer.
    assert_eq!(passing.others.list(), None);
    others.set_wanted(false);
    others_become(&others, None);
    others.set_wanted(true);
    others_become(&others, Some(&[("passing", -2.0)]));
    drop(passer);
    others_become(&others, Some(&[]));
    // What was known is forgotten with the line, and asked for again by the next one.
    drop(watcher);
    others_become(&others, None);
    let _watcher = Connection::connect(watching.clone()).unwrap();
    others_become(&others, Some(&[]));
    host.stop();
    others_become(&others, None);
}

#[test]
fn a_server_may_keep_walkers_to_itself() {
    let config = ServeConfig { show_walkers: false, ..Default::default() };
    let host = Host::start_with("alone", Memory::new(street(2, 16)), config);
    let config = host.config();
    config.others.set_wanted(true);
    let watcher = Connection::connect(config.clone()).unwrap();
    let passer = host.connect();
    passer.send_pose(&pose(-1.0, 90.0));
    stand(&watcher, &pose(0.0, 0.0)).unwrap();
    std::thread::sleep(Duration::from_secs(1));
    assert_eq!(config.others.list(), None);
}

#[test]
fn the_door_opens_for_the_right_ones_only() {
    let token_file = folder("door-token").join("token");
    std::fs::write(&token_file, "open sesame\n").unwrap();
    let config = ServeConfig { token_file: Some(token_file), max_connections: 2, ..Default::default() };
    let host = Host::start_with("door", Memory::new(street(2, 16)), config);
    let right = ConnectConfig { token: Some("open sesame".into()), ..host.config() };
    let end = |change: &dyn Fn(&mut ConnectConfig)| {
        let mut config = right.clone();
        change(&mut config);
        // Whoever was turned away leaves its place a moment later.
        (0..200)
            .map(|_| Connection::connect(config.clone()))
            .find(|end| {
                let busy = matches!(end, Err(ConnectError::Busy));
                std::thread::sleep(Duration::from_millis(if busy { 20 } else { 0 }));
                !busy
            })
            .expect("places become free again")
    };
    for token in [None, Some("wrong".to_owned())] {
        let e = end(&|c| c.token = token.clone()).unwrap_err();
        assert!(matches!(e, ConnectError::Refused { code: RefusalCode::Token, .. }), "{e:?}");
        assert_eq!(e.exit_code(), 42);
    }
    let e = end(&|c| c.fingerprint = None).unwrap_err();
    assert_eq!(e, ConnectError::UnknownServer { fingerprint: host.server().fingerprint().into() });
    assert_eq!(e.exit_code(), 2);
    let e = end(&|c| c.fingerprint = Some(Fingerprint([1; 32]))).unwrap_err();
    assert!(matches!(e, ConnectError::Fingerprint { .. }), "{e:?}");
    let e = end(&|c| {
        c.server = "127.0.0.1:9".into();
        c.timeout = Duration::from_millis(300);
    })
    .unwrap_err();
    assert!(matches!(e, ConnectError::Unreachable { .. }), "{e:?}");
    let first = end(&|_| {}).unwrap();
    let second = end(&|_| {}).unwrap();
    assert_eq!(Connection::connect(right.clone()).unwrap_err(), ConnectError::Busy);
    drop((first, second));
}

#[test]
fn garbage_and_sloth_harm_only_their_own_connection() {
    let mut host = Host::start("strangers", Memory::new(street(8, 256)));
    let address = host.server().quic();
    let victim = host.connect();
    // One that never reads, one per kind of nonsense.
    let slow = host.runtime.block_on(stranger::reads_nothing(address));
    for nonsense in stranger::Nonsense::ALL {
        let end = host.runtime.block_on(stranger::sends(address, nonsense));
        assert!(end, "the server ends a connection that sends {nonsense:?}");
    }
    host.runtime.block_on(stranger::sends_bad_datagrams_and_requests(address));
    stand(&victim, &pose(0.0, 0.0)).unwrap();
    host.stop();
    drop(slow);
}

#[test]
fn who_breaks_rules_again_and_again_is_let_in_no_more() {
    let host = Host::start("barred", Memory::new(street(2, 16)));
    let address = host.server().quic();
    let inside = host.connect();
    assert_eq!(host.runtime.block_on(stranger::floods_with_poses(address)), Some(RefusalCode::Rate as u64));
    let came_in = host.runtime.block_on(async {
        tokio::time::timeout(PATIENCE, stranger::comes_again(address)).await.expect("the door is closed in the end")
    });
    assert!((20..40).contains(&came_in), "{came_in} times");
    // Those of another address are not concerned, inside or new.
    stand(&inside, &pose(0.0, 0.0)).unwrap();
    stand(&host.connect(), &pose(0.0, 0.0)).unwrap();
}

#[test]
fn who_lists_more_than_anybody_holds_is_read_slowly() {
    let host = Host::start("lists", Memory::new(street(2, 16)));
    let address = host.server().quic();
    // As much as a hundred seconds allow may come at once; three seconds more take three seconds.
    let took = host.runtime.block_on(async {
        tokio::time::timeout(PATIENCE, stranger::lists(address, 2_060_000)).await.expect("it is read in the end")
    });
    assert!(took >= Duration::from_millis(2_900), "{took:?}");
    stand(&host.connect(), &pose(0.0, 0.0)).unwrap();
}

#[test]
fn a_server_that_stops_says_so() {
    let mut host = Host::start("stop", Memory::new(street(2, 16)));
    let connection = host.connect();
    host.stop();
    let end = connection.wait_until_complete(&[FIRST_CELL], PATIENCE);
    assert_eq!(end, Err(Incomplete::Disconnected("the connection ended: the server stops".into())));
}

#[test]
fn the_page_shows_plan_and_walkers() {
    let host = Host::start("page", Memory::new(street(4, 16)));
    // Nothing has happened, and that is said.
    assert!(host.get("/metrics").1.contains("\nldi_connections_total 0\n"));
    let connection = Connection::connect(ConnectConfig { name: "the visitor".into(), ..host.config() }).unwrap();
    stand(&connection, &pose(-3.0, 0.0)).unwrap();
    for path in ["/healthz", "/readyz"] {
        assert!(host.get(path).0.starts_with("HTTP/1.1 200"), "{path}");
    }
    let page = host.get("/").1;
    assert!(page.contains("<svg") && !page.contains("http://") | page.contains("http://www.w3.org"));
    let plan: serde_json::Value = serde_json::from_str(&host.get("/plan.json").1).unwrap();
    assert_eq!(plan["cells"].as_array().unwrap().len(), 4);
    assert_eq!(plan["points"].as_array().unwrap().len(), 1);
    // The image plane stands 10 m before the centre of projection at z = 5.
    assert_eq!(plan["images"][0][1], -5.0);
    let connect: serde_json::Value = serde_json::from_str(&host.get("/connect.json").1).unwrap();
    let address = format!("{}:{}", connect["addresses"][0].as_str().unwrap(), connect["port"]);
    assert_eq!((address, &connect["token"]), (host.config().server, &false.into()), "{connect}");
    for part in ["ldi-client connect", "--token-file", "Technical layers", "viewport"] {
        assert!(page.contains(part), "{part}");
    }
    let walkers: serde_json::Value = serde_json::from_str(&host.get("/walkers.json").1).unwrap();
    assert_eq!(walkers[0]["name"], "the visitor");
    assert_eq!(walkers[0]["position"][2], -3.0);
    assert!(host.get("/metrics").1.contains("ldi_chunks_total"));
    assert!(host.get("/nothing").0.starts_with("HTTP/1.1 404"));
}

/// A dataset with a page that cannot be read.
struct Torn {
    dataset: Memory,
    page: u32,
}

impl ChunkSource for Torn {
    fn index(&self) -> &Arc<Index> {
        self.dataset.index()
    }
    fn root(&self) -> &[u8] {
        self.dataset.root()
    }
    fn pages(&self) -> u32 {
        self.dataset.pages()
    }
    fn page(&self, number: u32) -> Result<Bytes, StoreError> {
        match number == self.page {
            true => Err(StoreError::NoSuch { what: "page", number }),
            false => self.dataset.page(number),
        }
    }
    fn chunk(&self, number: u32) -> Result<Bytes, StoreError> {
        self.dataset.chunk(number)
    }
}

#[test]
fn a_page_that_cannot_be_read_ends_the_walk_with_that_reason() {
    // The cells' page: not among those of a first picture.
    let torn = || Torn { dataset: Memory::new(street(2, 16).with_tree()), page: 1 };
    let host = Host::start("torn", torn());
    let reason = "page 1 of the manifest cannot be read; tell whoever runs the server";
    let e = Connection::connect(host.config()).unwrap_err();
    assert_eq!(e, ConnectError::Lost(reason.into()));
    let early = Connection::connect(ConnectConfig { early: true, ..host.config() });
    match early {
        Err(e) => assert_eq!(e, ConnectError::Lost(reason.into())),
        Ok(connection) => {
            let ended = connection.cache().wait(&[FIRST_CELL], PATIENCE).unwrap_err();
            assert!(matches!(&ended, Incomplete::Disconnected(e) if e.contains(reason)), "{ended}");
        }
    }
}
