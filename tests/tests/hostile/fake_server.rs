//! A server that plays scripts instead of serving.

use crate::fixture::Street;
use ldi_client::stream::{ConnectConfig, Fingerprint};
use ldi_protocol::{
    manifest::{self, Encoded},
    wire::{self, ALPN, RefusalCode, ServerMessage, StreamHeader, StreamKind, Urgency, Welcome, code},
};
use ldi_tests::fuzz::{
    Target,
    mutate::{Random, mutated},
};
use quinn::{Connection, Endpoint, ServerConfig, VarInt};
use std::{
    net::SocketAddr,
    sync::{Arc, Mutex},
    time::Duration,
};
use tokio::runtime::Runtime;

/// One thing that a server does.
#[derive(Debug, Clone)]
pub enum Step {
    /// Bytes on the control stream.
    Control(Vec<u8>),
    /// A unidirectional stream with these bytes.
    Uni(Vec<u8>),
    /// One that is reset after them.
    Reset(Vec<u8>),
    /// One that never ends.
    Open(Vec<u8>),
    /// A datagram.
    Datagram(Vec<u8>),
    /// Nothing any more, for longer than a client waits.
    Stall,
    /// The end of the control stream.
    Finish,
    /// The end of the connection, with a reason.
    Close(Vec<u8>),
}

/// What a server says, and how it answers requests.
#[derive(Debug, Clone, Default)]
pub struct Script {
    steps: Vec<Step>,
    /// Answers to requests, in turn: whole streams.
    answers: Vec<Vec<u8>>,
    root: Vec<u8>,
    /// Kind, hash and stored bytes of each page.
    pages: Vec<(u8, [u8; 32], u64)>,
}

/// The stream that brings a page.
pub fn page_stream(number: u32, bytes: &[u8]) -> Step {
    stream(StreamKind::Page, number, bytes)
}

fn stream(kind: StreamKind, number: u32, bytes: &[u8]) -> Step {
    let header = StreamHeader { kind, urgency: Urgency::Now, number, bytes: bytes.len() as u32 };
    Step::Uni([&header.encode()[..], bytes].concat())
}

fn opening(root: &[u8], pages: u32) -> Vec<Step> {
    let welcome = ServerMessage::Welcome(Welcome {
        version: wire::VERSION,
        dataset: manifest::dataset_hash(root),
        root_bytes: root.len() as u32,
        pages,
        walker: 1,
        others: true,
        next_certificate: None,
    });
    let root = wire::frame(root, wire::MAX_ROOT_BYTES).expect("short");
    vec![Step::Control(wire::encode(&welcome).expect("encodes")), Step::Control(root)]
}

impl Script {
    /// What an honest server does for a dataset whose chunks are all wanted.
    pub fn honest(street: Street) -> Self {
        let Encoded { root, pages } = manifest::encode(&street.index).expect("encodes");
        let mut steps = opening(&root, pages.len() as u32);
        steps.extend((0..).zip(&pages).map(|(n, page)| page_stream(n, page)));
        steps.extend((0..).zip(&street.chunks).map(|(n, chunk)| stream(StreamKind::Chunk, n, chunk)));
        let answer = |(number, bytes): (u32, &Vec<u8>)| {
            let head = wire::Answer::Chunk { number, bytes: bytes.len() as u32 };
            [wire::encode(&head).expect("encodes"), bytes.clone()].concat()
        };
        let answers = (0..).zip(&street.chunks).skip(crate::FIRST_CELL as usize).take(1).map(answer).collect();
        let listed = manifest::decode_root(&root).expect("decodes").pages;
        let pages = listed.iter().map(|p| (p.kind as u8, p.hash.0, p.stored_bytes.into())).collect();
        Self { steps, answers, root, pages }
    }

    /// With one to three faults: changed bytes, steps that are missing, twice, out of order or
    /// never end, foreign messages, stalls and ends.
    pub fn broken(mut self, random: &mut Random) -> Self {
        for _ in 0..1 + random.below(3) {
            // Every second fault is where a conversation begins.
            let within = if random.below(2) == 0 { self.steps.len().min(8) } else { self.steps.len() };
            let at = random.below(within);
            match random.below(12) {
                0..=2 => match &mut self.steps[at] {
                    Step::Control(b) | Step::Uni(b) | Step::Reset(b) | Step::Open(b) => {
                        *b = mutated(std::slice::from_ref(b), random)
                    }
                    _ => {}
                },
                3 => drop(self.steps.remove(at)),
                4 => self.steps.insert(at, self.steps[at].clone()),
                5 => {
                    let other = random.below(self.steps.len());
                    self.steps.swap(at, other);
                }
                6 => {
                    if let Step::Uni(b) = &self.steps[at] {
                        let part = b[..random.below(b.len())].to_vec();
                        self.steps[at] = if random.below(2) == 0 { Step::Reset(part) } else { Step::Open(part) };
                    }
                }
                7 => self.steps.insert(at, Step::Stall),
                8 => {
                    let frame = *random.pick(&[u32::MAX, 65_537, 600_000, 1]);
                    self.steps.insert(at, Step::Control([&frame.to_le_bytes()[..], &[0xc1; 40]].concat()));
                }
                9 => {
                    let body = mutated(&(Target::named("server_message").seeds)(), random);
                    let frame = wire::frame(&body, 1 << 20).expect("short");
                    self.steps.insert(at, Step::Control(frame));
                }
                10 => self.steps.insert(at, Step::Datagram((0..random.below(900)).map(|k| k as u8).collect())),
                _ => {
                    let end = match random.below(3) {
                        0 => Step::Finish,
                        1 => Step::Close(b"\x1b[2J\ngone\x00".repeat(1 + random.below(30))),
                        _ => {
                            let message = "full\u{1b}]0;owned\u{7}\nldi-client: fine".to_owned();
                            let refused = ServerMessage::Refused { code: RefusalCode::Protocol, message };
                            Step::Control(wire::encode(&refused).expect("encodes"))
                        }
                    };
                    self.steps.insert(at, end);
                }
            }
            if self.steps.is_empty() {
                break;
            }
        }
        if random.below(2) == 0 {
            self.answers = vec![mutated(&self.answers, random)];
        }
        self
    }

    /// The number of the first page of a kind.
    pub fn page_of_kind(&self, kind: u8) -> usize {
        self.pages.iter().position(|p| p.0 == kind).expect("such a page")
    }

    /// Changes hashes and stored bytes in the root's list of pages, and what goes before the pages
    /// with it.
    pub fn forge(&mut self, change: impl Fn(&mut [([u8; 32], u64)])) {
        let mut entries: Vec<([u8; 32], u64)> = self.pages.iter().map(|p| (p.1, p.2)).collect();
        change(&mut entries);
        let mut root = self.root[..self.root.len() - 32].to_vec();
        for ((_, hash, bytes), (new_hash, new_bytes)) in self.pages.iter().zip(&entries) {
            let at = root.windows(32).position(|w| w == hash).expect("listed");
            let [mut old, mut new] = [hash.to_vec(), new_hash.to_vec()];
            crate::put(&mut old, *bytes);
            crate::put(&mut new, *new_bytes);
            root.splice(at..at + old.len(), new);
        }
        root.extend(blake3::hash(&root).as_bytes());
        let opening = opening(&root, self.pages.len() as u32);
        self.steps.splice(..opening.len(), opening);
        self.root = root;
    }

    /// Puts a step in place of another.
    pub fn replace(&mut self, step: Step, is_old: impl Fn(&Step) -> bool) {
        let old = self.steps.iter_mut().find(|s| is_old(s)).expect("such a step");
        *old = step;
    }
}

/// A server on a free port of the loopback.
pub struct FakeServer {
    runtime: Runtime,
    address: SocketAddr,
    fingerprint: Fingerprint,
    script: Arc<Mutex<Script>>,
}

impl FakeServer {
    pub fn start() -> Self {
        let runtime = tokio::runtime::Builder::new_multi_thread().worker_threads(1).enable_all().build().unwrap();
        let made = rcgen::generate_simple_self_signed(vec!["ldi-server".into()]).unwrap();
        let certificate = made.cert.der().clone();
        let fingerprint = Fingerprint(blake3::hash(&certificate).into());
        let key = rustls::pki_types::PrivatePkcs8KeyDer::from(made.signing_key.serialize_der());
        let provider = Arc::new(rustls::crypto::ring::default_provider());
        let mut tls = rustls::ServerConfig::builder_with_provider(provider)
            .with_protocol_versions(&[&rustls::version::TLS13])
            .unwrap()
            .with_no_client_auth()
            .with_single_cert(vec![certificate], key.into())
            .unwrap();
        tls.alpn_protocols = vec![ALPN.to_vec()];
        let tls = quinn::crypto::rustls::QuicServerConfig::try_from(tls).unwrap();
        let config = ServerConfig::with_crypto(Arc::new(tls));
        let script = Arc::new(Mutex::new(Script::default()));
        let played = script.clone();
        let address = runtime.block_on(async {
            let endpoint = Endpoint::server(config, SocketAddr::from(([127, 0, 0, 1], 0))).unwrap();
            let address = endpoint.local_addr().unwrap();
            tokio::spawn(async move {
                while let Some(incoming) = endpoint.accept().await {
                    let script = played.lock().unwrap().clone();
                    tokio::spawn(async move {
                        if let Ok(connection) = incoming.await {
                            play(connection, script).await;
                        }
                    });
                }
            });
            address
        });
        Self { runtime, address, fingerprint, script }
    }

    /// What the next client hears.
    pub fn plays(&self, script: Script) {
        *self.script.lock().unwrap() = script;
    }

    /// For a client that waits shortly.
    pub fn config(&self) -> ConnectConfig {
        let mut config = ConnectConfig::new(self.address.to_string(), crate::host::PICTURE);
        config.fingerprint = Some(self.fingerprint);
        config.timeout = Duration::from_millis(500);
        config
    }
}

impl Drop for FakeServer {
    fn drop(&mut self) {
        let runtime = tokio::runtime::Builder::new_current_thread().build().unwrap();
        std::mem::replace(&mut self.runtime, runtime).shutdown_background();
    }
}

async fn play(connection: Connection, script: Script) {
    let Ok((mut control, _said)) = connection.accept_bi().await else { return };
    let (answers, asked) = (script.answers, connection.clone());
    let answering = tokio::spawn(async move {
        let mut turn = answers.iter().cycle();
        while let Ok((mut send, mut recv)) = asked.accept_bi().await {
            let _ = recv.read_to_end(4096).await;
            let _ = send.write_all(turn.next().map_or(&[][..], |a| a)).await;
            let _ = send.finish();
        }
    });
    // Streams that stay open.
    let mut open = Vec::new();
    for step in script.steps {
        match step {
            Step::Control(bytes) => drop(control.write_all(&bytes).await),
            Step::Uni(bytes) | Step::Open(bytes) | Step::Reset(bytes) if connection.close_reason().is_some() => {
                drop(bytes);
                break;
            }
            Step::Uni(bytes) => {
                let Ok(mut stream) = connection.open_uni().await else { break };
                let _ = stream.write_all(&bytes).await;
                let _ = stream.finish();
            }
            Step::Reset(bytes) => {
                let Ok(mut stream) = connection.open_uni().await else { break };
                let _ = stream.write_all(&bytes).await;
                let _ = stream.reset(VarInt::from_u32(code::STALE));
            }
            Step::Open(bytes) => {
                let Ok(mut stream) = connection.open_uni().await else { break };
                let _ = stream.write_all(&bytes).await;
                open.push(stream);
            }
            Step::Datagram(bytes) => drop(connection.send_datagram(bytes.into())),
            Step::Stall => tokio::time::sleep(Duration::from_secs(1)).await,
            Step::Finish => drop(control.finish()),
            Step::Close(reason) => connection.close(VarInt::from_u32(9), &reason),
        }
    }
    connection.closed().await;
    answering.abort();
}
