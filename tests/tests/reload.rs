//! A server takes up a new dataset, token and certificate while walkers are inside.

#[path = "../../client/src/cache/fixture.rs"]
#[allow(dead_code, reason = "shared with other tests, which use the rest")]
mod fixture;
#[path = "streaming/host.rs"]
#[allow(dead_code, reason = "shared with other tests, which use the rest")]
mod host;

use fixture::{FIRST_CELL, street};
use host::{Host, Memory, PATIENCE, PICTURE, folder};
use ldi_client::stream::{ConnectConfig, ConnectError, ConnectProgress, Connection, Fingerprint, KnownHosts};
use ldi_protocol::wire::Request;
use ldi_server::serve::{ChunkSource, Datasets, Identity, NamedSources, ServeConfig};
use std::{
    net::SocketAddr,
    sync::{
        Arc,
        atomic::{AtomicU32, AtomicU64, Ordering::SeqCst},
    },
    time::{Duration, Instant},
};

/// A street of so many cells, as if on disk.
struct Changing {
    cells: AtomicU32,
    stamp: AtomicU64,
}

impl Datasets for Changing {
    fn open(&self) -> Result<NamedSources, String> {
        let dataset = Memory::new(street(self.cells.load(SeqCst), 16));
        Ok([("street".to_owned(), Arc::new(dataset) as Arc<dyn ChunkSource>)].into())
    }
    fn stamp(&self) -> u64 {
        self.stamp.load(SeqCst)
    }
}

fn walks(config: &ConnectConfig) -> Connection {
    let connection = Connection::connect(config.clone()).expect("let in");
    goes_on(&connection);
    connection
}

fn goes_on(connection: &Connection) {
    connection.fetch(Request::Number(FIRST_CELL)).expect("a chunk");
}

#[test]
fn walkers_inside_stay_and_newcomers_get_what_is_new() {
    let token_file = folder("reload-token").join("token");
    std::fs::write(&token_file, "first").unwrap();
    let settings = ServeConfig { token_file: Some(token_file.clone()), ..Default::default() };
    let mut host = Host::start_with("reload", Memory::new(street(2, 16)), settings);
    let first = ConnectConfig { token: Some("first".into()), ..host.config() };
    let inside = walks(&first);
    let ready = |host: &Host| serde_json::from_str::<serde_json::Value>(&host.get("/readyz").1).expect("JSON");
    assert_eq!(ready(&host)["dataset"], inside.dataset().to_string());
    assert!(ready(&host)["ready"] == true && ready(&host)["age_s"].is_u64());

    std::fs::write(&token_file, "second").unwrap();
    host.reload(Memory::new(street(3, 16)));
    goes_on(&inside);
    assert!(matches!(Connection::connect(first.clone()), Err(ConnectError::Refused { .. })));
    let newcomer = walks(&ConnectConfig { token: Some("second".into()), ..first });
    assert_ne!(newcomer.dataset(), inside.dataset());
    assert_eq!(ready(&host)["dataset"], newcomer.dataset().to_string());
    goes_on(&inside);
}

#[test]
fn walkers_inside_are_told_of_a_new_build() {
    let mut host = Host::start("told", Memory::new(street(2, 16)));
    let with =
        |progress: &Arc<ConnectProgress>, host: &Host| ConnectConfig { progress: progress.clone(), ..host.config() };
    let (first, second) = (Arc::<ConnectProgress>::default(), Arc::<ConnectProgress>::default());
    let inside = walks(&with(&first, &host));
    host.reload(Memory::new(street(2, 16)));
    goes_on(&inside);
    assert!(!first.is_replaced(), "the same build again");
    host.reload(Memory::new(street(3, 16)));
    let begin = Instant::now();
    while !first.is_replaced() {
        assert!(begin.elapsed() < PATIENCE, "nothing is told");
        std::thread::sleep(Duration::from_millis(10));
    }
    goes_on(&inside);
    let newcomer = walks(&with(&second, &host));
    assert!(newcomer.dataset() != inside.dataset() && !second.is_replaced());
    // Whoever connects again has the new build.
    drop(inside);
    walks(&with(&first, &host));
    assert!(!first.is_replaced());
}

#[test]
fn a_certificate_is_replaced_without_a_client_that_asks_again() {
    let mut host = Host::start("rotation", Memory::new(street(2, 16)));
    let file = folder("rotation-known").join("known_hosts");
    let known = || Arc::new(KnownHosts::load(&file).expect("readable"));
    let server = host.server().quic().to_string();
    let old: Fingerprint = host.server().fingerprint().parse().unwrap();
    let _ = std::fs::remove_file(&file);
    known().remember(&server, old).unwrap();
    let next = Identity::prepare_next(&host.identity()).unwrap().next.unwrap();
    host.reload(Memory::new(street(2, 16)));
    let config = ConnectConfig { known_hosts: Some(known()), ..host.config() };
    let inside = walks(&config);
    let learned = known().other(&server, old).expect("announced and remembered");
    assert_eq!(learned.0, *next.as_bytes());

    Identity::switch(&host.identity()).unwrap();
    host.reload(Memory::new(street(2, 16)));
    goes_on(&inside);
    assert_eq!(host.server().fingerprint(), learned.to_string());
    let old_only = ConnectConfig { fingerprint: Some(old), ..config.clone() };
    assert!(matches!(Connection::connect(old_only.clone()), Err(ConnectError::Fingerprint { .. })));
    walks(&ConnectConfig { next_fingerprint: Some(learned), ..old_only });
    assert_eq!(Fingerprint::pair(&format!("{old},{learned}")), Ok((old, Some(learned))));
}

/// The program's own loop, in this process: signals are sent to it as an operator would.
#[cfg(unix)]
#[test]
fn sighup_reloads_and_sigterm_stops() {
    let any = SocketAddr::from(([127, 0, 0, 1], 0));
    let free = std::net::UdpSocket::bind(any).unwrap().local_addr().unwrap();
    let identity = folder("sighup").join("identity");
    let settings = ServeConfig {
        listen: free,
        http: "off".to_owned().try_into().unwrap(),
        identity: Some(identity.clone()),
        ..Default::default()
    };
    let street = Arc::new(Changing { cells: AtomicU32::new(2), stamp: AtomicU64::new(0) });
    let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(1).enable_all().build().unwrap();
    let serving =
        runtime.spawn(ldi_server::serve::serve(street.clone(), (0, street.open().unwrap()), settings, &|_, _| {}));
    let begin = Instant::now();
    let connect = || {
        let mut config = ConnectConfig::new(free.to_string(), PICTURE);
        config.fingerprint = Some(Identity::in_folder(&identity).unwrap().fingerprint().parse().unwrap());
        loop {
            match Connection::connect(config.clone()) {
                Ok(connection) => return connection,
                Err(e) => assert!(begin.elapsed() < PATIENCE, "{e}"),
            }
        }
    };
    let signal = |name: &str| {
        let sent = std::process::Command::new("kill").args([name, &std::process::id().to_string()]).status();
        assert!(sent.unwrap().success());
    };
    let inside = connect();
    street.cells.store(3, SeqCst);
    signal("-HUP");
    let newcomer = loop {
        let newcomer = connect();
        if newcomer.dataset() != inside.dataset() {
            break newcomer;
        }
        assert!(begin.elapsed() < PATIENCE, "the new dataset is never offered");
    };
    goes_on(&inside);
    // Without a signal, too.
    street.cells.store(4, SeqCst);
    street.stamp.store(1, SeqCst);
    while connect().dataset() == newcomer.dataset() {
        assert!(begin.elapsed() < PATIENCE, "the change is never seen");
        std::thread::sleep(Duration::from_millis(50));
    }
    goes_on(&newcomer);
    signal("-TERM");
    let end = runtime.block_on(async { tokio::time::timeout(PATIENCE, serving).await });
    assert!(end.expect("in time").expect("no panic").is_ok());
}
