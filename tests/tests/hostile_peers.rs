//! Peers that want a server or client no good: what they cannot take from others, and what of
//! theirs never reaches a log, a terminal or a page as it is.

#[path = "../../client/src/cache/fixture.rs"]
#[allow(dead_code, reason = "shared with other tests, which use the rest")]
mod fixture;
#[path = "streaming/host.rs"]
#[allow(dead_code, reason = "shared with other tests, which use the rest")]
mod host;

use fixture::{FIRST_CELL, street};
use host::{Host, Memory, PATIENCE, PICTURE, folder};
use ldi_client::{
    cache::Incomplete,
    stream::{ConnectConfig, ConnectError, Connection},
};
use ldi_protocol::{
    Pose,
    wire::{RefusalCode, Request},
};
use ldi_server::serve::{SelectViews, ServeConfig, planner::Views as _};
use ldi_tests::load::stranger::{self, Initials};
use std::{
    io::{Read, Write},
    net::{IpAddr, TcpStream, UdpSocket},
    sync::{Mutex, OnceLock},
    time::Duration,
};

/// A connection that is good for something.
fn walks(config: &ConnectConfig) -> Connection {
    let connection = Connection::connect(config.clone()).expect("an honest walker is let in");
    connection.fetch(Request::Number(FIRST_CELL)).expect("and gets chunks");
    connection
}

#[test]
fn handshakes_that_nobody_finishes_take_no_place_from_anyone() {
    let host = Host::start("unfinished", Memory::new(street(2, 16)));
    let server = host.server().quic();
    let mut initials = Initials::new(server).unwrap();
    // The walkers' own address, as somebody beside them or a forger has it, then another one.
    for from in [[127, 0, 0, 1], [127, 0, 0, 9]] {
        let socket = UdpSocket::bind((IpAddr::from(from), 0)).unwrap();
        for sent in 0..1_200 {
            socket.send_to(&initials.initial().unwrap(), server).unwrap();
            if sent % 16 == 0 {
                // So that the server's socket holds them all.
                std::thread::sleep(Duration::from_millis(2));
            }
        }
        walks(&host.config());
    }
}

#[test]
fn holders_of_the_token_come_in_beside_those_who_have_none() {
    let token_file = folder("beside-token").join("token");
    std::fs::write(&token_file, "open sesame\n").unwrap();
    let config = ServeConfig {
        token_file: Some(token_file),
        max_connections: 16,
        max_connections_per_address: 8,
        ..Default::default()
    };
    let host = Host::start_with("beside", Memory::new(street(2, 16)), config);
    let right = ConnectConfig { token: Some("open sesame".into()), ..host.config() };
    for _ in 0..25 {
        let e = Connection::connect(ConnectConfig { token: Some("wrong".into()), ..host.config() }).unwrap_err();
        assert!(matches!(e, ConnectError::Refused { code: RefusalCode::Token, .. }), "{e:?}");
    }
    let first = walks(&right);
    let server = host.server().quic();
    let silent = host.runtime.block_on(async {
        let endpoint = stranger::endpoint(IpAddr::from([127, 0, 0, 1])).unwrap();
        let mut come = tokio::task::JoinSet::new();
        for _ in 0..25 {
            let endpoint = endpoint.clone();
            come.spawn(async move { stranger::connect(&endpoint, server).await });
        }
        come.join_next().await;
        (endpoint, come)
    });
    let second = walks(&right);
    walks(&right);
    drop((first, second, silent));
}

/// A name that would forge a line of a log and clear a terminal.
const FORGED: &str = "guest\n2026-01-01 INFO access: admin came in\u{1b}[2J\u{202e}";

/// All that is logged, by any test of this file.
fn log() -> &'static Mutex<Vec<u8>> {
    static LOG: OnceLock<Mutex<Vec<u8>>> = OnceLock::new();
    LOG.get_or_init(|| {
        tracing_subscriber::fmt().with_writer(|| Log).with_ansi(false).try_init().expect("the only one here");
        Mutex::default()
    })
}

#[test]
fn a_chunk_that_a_client_reports_as_damaged_is_checked_and_logged_once() {
    let log = log();
    let mut street = street(2, 16);
    *street.chunks[FIRST_CELL as usize].last_mut().unwrap() ^= 1;
    let host = Host::start("reported", Memory::new(street));
    let connection = Connection::connect(ConnectConfig { name: "inspector".into(), ..host.config() }).unwrap();
    let index = connection.index().clone();
    let here = Pose { position: glam::DVec3::ZERO, yaw_deg: 0.0, pitch_deg: 0.0 };
    let camera = PICTURE.camera(&index.settings);
    connection.update_view(&here, &SelectViews::new(index, &camera).needed(&here));
    let end = connection.wait_until_complete(&[FIRST_CELL], PATIENCE);
    assert_eq!(end, Err(Incomplete::Damaged(vec![FIRST_CELL])), "as often as it was asked for");
    drop(connection);
    drop(host);
    let log = String::from_utf8(log.lock().unwrap().clone()).unwrap();
    let reports: Vec<&str> =
        log.lines().filter(|l| l.contains("reported a damaged chunk") && l.contains("inspector")).collect();
    assert_eq!(reports.len(), 1, "{log}");
    let chunk = format!("chunk={FIRST_CELL} ");
    assert!(reports[0].contains(&chunk) && reports[0].contains("it is damaged here, too"), "{reports:?}");
}

#[test]
fn a_name_stays_on_its_line() {
    let log = log();
    let host = Host::start("names", Memory::new(street(2, 16)));
    let connection = Connection::connect(ConnectConfig { name: FORGED.into(), ..host.config() }).unwrap();
    let walkers: serde_json::Value = serde_json::from_str(&host.get("/walkers.json").1).unwrap();
    let shown = walkers[0]["name"].as_str().unwrap().to_owned();
    assert!(shown.starts_with(r"guest\n2026") && !shown.contains(['\n', '\u{1b}', '\u{202e}']), "{shown:?}");
    drop(connection);
    drop(host);
    let log = String::from_utf8(log.lock().unwrap().clone()).unwrap();
    let named: Vec<&str> = log.lines().filter(|l| l.contains("admin came in")).collect();
    assert!(!named.is_empty() && named.iter().all(|l| l.contains("guest")), "{log}");
    assert!(!log.contains(['\u{1b}', '\u{202e}']), "{log:?}");
}

/// Keeps what is logged.
struct Log;

impl Write for Log {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        log().lock().unwrap().write(bytes)
    }
    fn flush(&mut self) -> std::io::Result<()> {
        Ok(())
    }
}

#[test]
fn what_a_server_says_is_shown_on_one_line() {
    let said = || "full\u{1b}]0;owned\u{7}\nldi-client: all is well".to_owned();
    for e in [
        ConnectError::Refused { code: RefusalCode::Protocol, message: said() },
        ConnectError::Protocol(said()),
        ConnectError::Lost(said()),
        ConnectError::Unreachable { address: "museum:4433".into(), reason: said() },
    ] {
        let shown = e.to_string();
        assert!(
            shown.contains(r"full\u{1b}]0;owned\u{7}\nldi-client") && !shown.contains(char::is_control),
            "{shown:?}"
        );
    }
}

/// Sends a request as it is, and returns all that comes until the server closes.
fn ask(host: &Host, request: &str) -> String {
    let mut stream = http(host);
    let _ = stream.write_all(request.as_bytes());
    let mut answer = String::new();
    let _ = stream.read_to_string(&mut answer);
    answer
}

fn http(host: &Host) -> TcpStream {
    let stream = TcpStream::connect(host.server().http().expect("HTTP is on")).unwrap();
    stream.set_read_timeout(Some(Duration::from_secs(60))).unwrap();
    stream
}

#[test]
fn pages_are_for_those_who_may_walk() {
    let token_file = folder("pages-token").join("token");
    std::fs::write(&token_file, "open sesame\n").unwrap();
    let config = ServeConfig { token_file: Some(token_file), ..Default::default() };
    let host = Host::start_with("pages", Memory::new(street(2, 16)), config);
    let get = |path: &str, authorization: &str| {
        let authorization = if authorization.is_empty() { "" } else { &format!("Authorization: {authorization}\r\n") };
        let head = format!("GET {path} HTTP/1.1\r\nHost: 127.0.0.1\r\nConnection: close\r\n{authorization}\r\n");
        ask(&host, &head).split_whitespace().nth(1).unwrap_or_default().to_owned()
    };
    for open in ["/healthz", "/readyz"] {
        assert_eq!(get(open, ""), "200", "{open}");
    }
    for closed in ["/", "/plan.json", "/walkers.json", "/metrics"] {
        // Basic: any user, and the token as the password.
        for wrong in ["", "Bearer sesame", "Basic b3BlbiBzZXNhbWU=", "Basic dXNlcjpzZXNhbWU=", "Basic ?"] {
            assert_eq!(get(closed, wrong), "401", "{closed} {wrong}");
        }
        for right in ["Bearer open sesame", "Basic dXNlcjpvcGVuIHNlc2FtZQ=="] {
            assert_eq!(get(closed, right), "200", "{closed} {right}");
        }
    }
}

#[test]
fn pages_are_answered_to_known_names_and_framed_by_nobody() {
    let config = ServeConfig { http_names: vec!["museum.example".into()], ..Default::default() };
    let host = Host::start_with("host-names", Memory::new(street(2, 16)), config);
    let get = |name: &str| ask(&host, &format!("GET / HTTP/1.1\r\nHost: {name}\r\nConnection: close\r\n\r\n"));
    for known in ["127.0.0.1", "127.0.0.1:8080", "[::1]:8080", "localhost:1", "LOCALHOST", "Museum.example:8080"] {
        assert!(get(known).starts_with("HTTP/1.1 200"), "{known}");
    }
    // A name of someone else that leads here would let their pages read ours.
    for foreign in ["evil.example", "evil.example:8080", "127.0.0.1.evil.example", "localhost.evil.example", "@"] {
        assert!(get(foreign).starts_with("HTTP/1.1 421"), "{foreign}: {}", get(foreign));
    }
    let page = get("localhost").to_ascii_lowercase();
    for header in [
        "frame-ancestors 'none'",
        "base-uri 'none'",
        "form-action 'none'",
        "x-content-type-options: nosniff",
        "referrer-policy: no-referrer",
    ] {
        assert!(page.contains(header), "{header}: {}", page.split("\r\n\r\n").next().unwrap_or_default());
    }
}

#[test]
fn slow_and_many_http_connections_end() {
    let host = Host::start("http-slow", Memory::new(street(2, 16)));
    // A head and a body that never end: the server closes, or this reads for a minute and fails.
    for begun in ["GET /healthz HTTP/1.1\r\nHost: localhost\r\nX-Slow: ", "GET /hea"] {
        let mut slow = http(&host);
        slow.write_all(begun.as_bytes()).unwrap();
        let end = slow.read_to_end(&mut Vec::new());
        assert!(!matches!(&end, Err(e) if e.kind() == std::io::ErrorKind::WouldBlock), "{begun:?}: {end:?}");
    }
    let body = "POST / HTTP/1.1\r\nHost: localhost\r\nContent-Length: 1000\r\n\r\nx";
    assert!(ask(&host, body).starts_with("HTTP/1.1 413"));
    let many: Vec<TcpStream> = (0..100).map(|_| http(&host)).collect();
    let healthz = "GET /healthz HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n";
    assert_eq!(ask(&host, healthz), "", "beyond the cap a connection is closed unanswered");
    drop(many);
    let answered = (0..200).any(|_| {
        std::thread::sleep(Duration::from_millis(20));
        ask(&host, healthz).starts_with("HTTP/1.1 200")
    });
    assert!(answered, "once the others are gone there is room");
}
