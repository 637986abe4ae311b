//! Every message survives the trip; every other byte string gives an error and nothing else.

use super::*;
use crate::{Pose, room_index::PortalImages};
use glam::DVec3;
use proptest::prelude::*;

fn hello() -> Hello {
    Hello {
        version: VERSION,
        token: Some("secret".into()),
        picture: Picture { width: 1280, height: 720, fov_deg: Some(60.0) },
        cache_bytes: 1 << 30,
        prefetch_m: 10.0,
        name: "test".into(),
        manifests: vec![ChunkHash([3; 32]); MAX_MANIFESTS],
        portals: ShowPortals { images: PortalImages::TwoReferences, everywhere: true },
        far: FarBy::Tree,
        dataset: Some("house".into()),
        early: true,
        replacements: true,
    }
}

fn trip<M: Message + PartialEq + std::fmt::Debug>(m: M) {
    let bytes = encode(&m).unwrap();
    let length = frame_length(bytes[..4].try_into().unwrap(), M::LIMIT).unwrap();
    assert_eq!(length, bytes.len() - 4);
    assert_eq!(decode::<M>(&bytes[4..]).unwrap(), m);
    // Every truncation is an error, never half a message.
    for cut in 4..bytes.len() {
        assert!(decode::<M>(&bytes[4..cut]).is_err(), "{} bytes of {m:?}", cut - 4);
    }
    let mut longer = bytes[4..].to_vec();
    longer.push(0);
    assert!(decode::<M>(&longer).is_err());
}

#[test]
fn messages_survive_the_trip() {
    trip(ClientMessage::Hello(hello()));
    trip(ClientMessage::Want { chunks: vec![0, 7, u32::MAX] });
    trip(ClientMessage::Damaged { chunks: vec![3] });
    trip(ClientMessage::Drop { chunks: vec![] });
    trip(ClientMessage::Decoding { waiting_bytes: u32::MAX, bytes_per_s: 0 });
    trip(ClientMessage::Whole);
    trip(ClientMessage::Others { shown: true });
    trip(ClientMessage::Bye);
    let many = Hello { manifests: vec![ChunkHash([3; 32]); MAX_MANIFESTS + 1], ..hello() };
    assert!(matches!(encode(&ClientMessage::Hello(many)), Err(WireError::OutOfRange { field: "manifests", .. })));
    trip(ServerMessage::Welcome(Welcome {
        version: VERSION,
        dataset: ChunkHash([9; 32]),
        root_bytes: 5,
        pages: 3,
        walker: 1,
        others: true,
        next_certificate: Some(ChunkHash([8; 32])),
    }));
    trip(ServerMessage::Refused { code: RefusalCode::Token, message: "no".into() });
    trip(Request::Name(ChunkHash([200; 32])));
    trip(Answer::Chunk { number: 3, bytes: 10 });
}

/// A client of before knows nothing of portals or of what is far, and one of later may know more
/// than this server.
#[test]
fn a_wish_may_be_absent_and_an_unknown_one_is_refused() {
    let bytes = encode(&ClientMessage::Hello(hello())).unwrap();
    let body = &bytes[4..];
    let at = |what: &[u8]| body.windows(what.len()).position(|w| w == what).expect("it is in the message");
    for wish in [&b"two_references"[..], b"tree"] {
        let mut unknown = body.to_vec();
        unknown[at(wish)] = b'x';
        assert!(decode::<ClientMessage>(&unknown).is_err());
    }
    // The name of the field damaged: one that nobody knows, and none of this name.
    let without = |field: &[u8]| {
        let mut absent = body.to_vec();
        absent[at(field)] = b'x';
        match decode(&absent).unwrap() {
            ClientMessage::Hello(heard) => heard,
            other => panic!("{other:?}"),
        }
    };
    assert_eq!(without(b"portals"), Hello { portals: ShowPortals::default(), ..hello() });
    assert_eq!(without(b"far"), Hello { far: FarBy::default(), ..hello() });
    assert_eq!(without(b"dataset"), Hello { dataset: None, ..hello() });
    assert_eq!(without(b"replacements"), Hello { replacements: false, ..hello() });
}

#[test]
fn the_longest_list_fits_a_frame_and_a_longer_one_is_refused() {
    let longest = ClientMessage::Have { chunks: vec![u32::MAX; MAX_LIST] };
    assert!(encode(&longest).is_ok());
    let longer = ClientMessage::Have { chunks: vec![0; MAX_LIST + 1] };
    assert!(matches!(encode(&longer), Err(WireError::OutOfRange { field: "chunks", .. })));
}

#[test]
fn a_map_full_of_walkers_fits_a_frame_and_walkers_nowhere_are_refused() {
    let other = Other {
        walker: u64::MAX,
        name: "\u{10348}".repeat(MAX_NAME_CHARS),
        position: [1e9, -1e9, 0.5],
        yaw_deg: 360.0,
    };
    let with = |f: &dyn Fn(&mut Vec<Other>)| {
        let mut walkers = vec![other.clone(); MAX_OTHERS];
        f(&mut walkers);
        encode(&ServerMessage::Others { walkers })
    };
    trip(ServerMessage::Others { walkers: vec![other.clone()] });
    trip(ServerMessage::Replaced);
    assert!(with(&|_| {}).is_ok());
    assert!(with(&|w| w.push(other.clone())).is_err());
    assert!(with(&|w| w[5].position[1] = f64::NAN).is_err());
    assert!(with(&|w| w[5].position[2] = 1.1e9).is_err());
    assert!(with(&|w| w[5].yaw_deg = f32::NAN).is_err());
    assert!(with(&|w| w[5].yaw_deg = -1.0).is_err());
    assert!(with(&|w| w[5].name.push('x')).is_err());
}

/// A server of before does not say whether it tells of others: then it does not.
#[test]
fn a_server_that_says_nothing_of_others_does_not_tell() {
    let welcome = Welcome {
        version: VERSION,
        dataset: ChunkHash([9; 32]),
        root_bytes: 5,
        pages: 3,
        walker: 1,
        others: true,
        next_certificate: None,
    };
    let bytes = encode(&ServerMessage::Welcome(welcome.clone())).unwrap();
    let mut absent = bytes[4..].to_vec();
    let at = absent.windows(6).position(|w| w == b"others").expect("it is in the message");
    absent[at] = b'x';
    assert_eq!(decode::<ServerMessage>(&absent).unwrap(), ServerMessage::Welcome(Welcome { others: false, ..welcome }));
}

#[test]
fn a_forged_length_is_refused_before_anything_is_allocated() {
    assert!(matches!(frame_length([255; 4], MAX_CLIENT_FRAME), Err(WireError::FrameTooLong { .. })));
    // A list that announces 4 billion entries in five bytes.
    let mut forged = rmp_serde::to_vec_named(&ClientMessage::Want { chunks: vec![] }).unwrap();
    forged.pop();
    forged.extend([0xdd, 255, 255, 255, 255]);
    assert!(decode::<ClientMessage>(&forged).is_err());
}

#[test]
fn values_out_of_range_are_refused() {
    let with = |f: &dyn Fn(&mut Hello)| {
        let mut h = hello();
        f(&mut h);
        encode(&ClientMessage::Hello(h))
    };
    assert!(with(&|h| h.picture.fov_deg = Some(f64::NAN)).is_err());
    assert!(with(&|h| h.picture.width = 0).is_err());
    assert!(with(&|h| h.prefetch_m = -1.0).is_err());
    assert!(with(&|h| h.token = Some("x".repeat(MAX_TEXT + 1))).is_err());
    assert!(with(&|_| {}).is_ok());
}

#[test]
fn a_newer_pose_is_recognised_across_the_wrap() {
    let p = |sequence| PoseDatagram {
        sequence,
        sent_us: 0,
        pose: Pose { position: DVec3::ZERO, yaw_deg: 0.0, pitch_deg: 0.0 },
    };
    assert!(p(5).is_newer_than(4) && !p(4).is_newer_than(5) && !p(4).is_newer_than(4));
    assert!(p(0).is_newer_than(u32::MAX) && !p(u32::MAX).is_newer_than(0));
}

proptest! {
    #[test]
    fn random_bytes_never_panic(bytes in proptest::collection::vec(any::<u8>(), 0..300)) {
        let _ = decode::<ClientMessage>(&bytes);
        let _ = decode::<ServerMessage>(&bytes);
        let _ = decode::<Request>(&bytes);
        let _ = decode::<Answer>(&bytes);
        let _ = PoseDatagram::decode(&bytes);
        if let Ok(b) = <[u8; 12]>::try_from(&bytes[..bytes.len().min(12)]) {
            let _ = StreamHeader::decode(&b);
        }
    }

    #[test]
    fn damaged_messages_never_panic(at in 0usize..200, to in any::<u8>()) {
        let mut bytes = encode(&ClientMessage::Hello(hello())).unwrap().split_off(4);
        let at = at % bytes.len();
        bytes[at] = to;
        if let Ok(m) = decode::<ClientMessage>(&bytes) {
            prop_assert!(m.validate().is_ok());
        }
    }

    #[test]
    fn poses_survive_exactly(x in -1e9f64..1e9, yaw in -1e6f64..1e6, pitch in -90.0f64..=90.0, sequence: u32, sent_us: u64) {
        let p = PoseDatagram {
            sequence,
            sent_us,
            pose: Pose { position: DVec3::new(x, -x, 0.5), yaw_deg: yaw, pitch_deg: pitch },
        };
        prop_assert_eq!(PoseDatagram::decode(&p.encode()).unwrap(), p);
        for at in 0..5 {
            let mut bytes = p.encode();
            bytes[16 + 8 * at..24 + 8 * at].copy_from_slice(&f64::NAN.to_le_bytes());
            prop_assert!(PoseDatagram::decode(&bytes).is_err());
        }
    }

    #[test]
    fn stream_headers_survive(number: u32, bytes in 0..=MAX_CHUNK_BYTES, urgency in 0usize..5, page: bool) {
        let kind = if page { StreamKind::Page } else { StreamKind::Chunk };
        let h = StreamHeader { kind, urgency: Urgency::ALL[urgency], number, bytes };
        prop_assert_eq!(StreamHeader::decode(&h.encode()).unwrap(), h);
    }
}
