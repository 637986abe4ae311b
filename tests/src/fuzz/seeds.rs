//! Valid inputs of the targets. Chunks and pages come twice: as a build writes them, and with their
//! sections uncompressed, so that changes reach what is inside.

use super::{
    gltf_file::GltfFile,
    street::{Street, TEXTURE, street},
};
use glam::{DAffine3, DVec3, Vec2, Vec3};
use ldi_protocol::{
    Aabb, Pose, ViewBasis,
    codec::{self, ColourMode, cell::ClusterSteps, texture::TextureLevels},
    index::{ChunkHash, Index},
    ldi::{DisparityCodes, LINK_DOWN, LINK_RIGHT, Ldi, LdiCamera, LdiLayer, Segment, Sliver, SliverCorner},
    manifest::{self, Encoded, Root},
    mesh::{CellGeometry, Cluster, ClusterInstance, ClusterRef},
    room_index::{BuiltImages, RoomIndex},
    rooms::{Cell, Portal, PortalKind, Rooms},
    texture::MipLevel,
    tree::{Brood, NodeSamples, TreeSample, WHOLE},
    volume::WalkVolume,
    wire::{
        self, Answer, ClientMessage, Hello, Other, Picture, PoseDatagram, RefusalCode, Request, ServerMessage,
        StreamHeader, StreamKind, Urgency, Welcome,
    },
};
use std::sync::LazyLock;

/// zstd levels of encodings: uncompressed, and small.
const LEVELS: [i32; 2] = [0, 9];

/// Each of several things at both levels.
fn at_levels<T>(things: &[T], encode: impl Fn(&T, i32) -> Vec<u8>) -> Vec<Vec<u8>> {
    LEVELS.into_iter().flat_map(|level| things.iter().map(|t| encode(t, level)).collect::<Vec<_>>()).collect()
}

/// A layer of every pixel that `code` gives a disparity, linked wherever it may be but in every
/// fifth column and row.
fn layer(side: u32, code: impl Fn(u32, u32) -> Option<u16>) -> LdiLayer {
    let mut out = LdiLayer::default();
    for row in 0..side {
        let columns: Vec<u32> = (0..side).filter(|c| code(*c, row).is_some()).collect();
        if columns.is_empty() {
            continue;
        }
        let (first, count) = (out.column.len() as u32, columns.len() as u16);
        out.segments.push(Segment { row: row as u16, column_base: 0, first, count });
        for column in columns {
            let goes_on = |c: u32, r: u32| c < side && r < side && code(c, r).is_some();
            let right = goes_on(column + 1, row) && column % 5 != 4;
            let down = goes_on(column, row + 1) && row % 5 != 4;
            out.column.push(column as u8);
            out.disparity.extend(code(column, row));
            out.rgb.push([(column * 9) as u8, (row * 7) as u8, (column * row) as u8]);
            out.links.push((u8::from(right) * LINK_RIGHT) | (u8::from(down) * LINK_DOWN));
        }
    }
    out.with_half_ends()
}

/// Two slanted walls, a checkered layer behind them, one sliver.
fn image(side: u32) -> Ldi {
    let wall = |c: u32, r: u32| (c / 3 + r / 4) % 5 != 4;
    let near = layer(side, |c, r| wall(c, r).then_some((900 - 3 * c - r) as u16));
    let behind = layer(side, |c, r| (c + r).is_multiple_of(3).then_some((200 + c) as u16));
    let corner = |u, v| SliverCorner { u: u * Sliver::PARTS, v: v * Sliver::PARTS, disparity: 300 };
    let (half, words) = (side as i32 / 2, side.div_ceil(64) as usize);
    let camera = LdiCamera {
        cop: DVec3::new(1.0, 2.0, 3.0),
        basis: ViewBasis::from_yaw_pitch(33.0, -12.0),
        pixels_per_unit: f64::from(side),
        left: -half,
        top: -half,
        width: side,
        height: side,
    };
    Ldi {
        camera,
        codes: DisparityCodes { smallest: 0.001, step: 0.001, largest_code: 1000 },
        layers: vec![near, behind],
        sky: vec![0b1001; words * side as usize],
        slivers: vec![Sliver { corners: [corner(1, 1), corner(2, 1), corner(1, 2), corner(2, 2)], rgb: [9, 99, 200] }],
    }
}

/// Samples along a side of [`FIRST_IMAGE`].
const SIDE: u32 = 24;

/// What deeper layers are decoded into.
pub(super) static FIRST_IMAGE: LazyLock<Ldi> = LazyLock::new(|| {
    let bytes = codec::ldi::encode_first(&image(SIDE), ColourMode::LOSSLESS, 1).expect("encodes");
    codec::ldi::decode_first(&bytes).expect("decodes")
});

const LOSSY: ColourMode = ColourMode { green_step: 5, red_blue_step: 7, exact_contexts: 1 };

pub(super) fn ldi_first() -> Vec<Vec<u8>> {
    let images = [(image(SIDE), ColourMode::LOSSLESS), (image(9), LOSSY), (image(70), ColourMode::LOSSLESS)];
    at_levels(&images, |(image, mode), level| codec::ldi::encode_first(image, *mode, level).expect("encodes"))
}

pub(super) fn ldi_deeper() -> Vec<Vec<u8>> {
    at_levels(&[ColourMode::LOSSLESS, LOSSY], |mode, level| {
        codec::ldi::encode_deeper(&image(SIDE), *mode, level).expect("encodes").expect("has deeper layers")
    })
}

fn cluster(corners: usize) -> Cluster {
    let corner = |k: usize| Vec3::new((k % 4) as f32, (k / 4) as f32 * 0.5, (k % 3) as f32);
    Cluster {
        material: 1,
        positions: (0..corners).map(corner).collect(),
        origin: DVec3::new(10.0, 0.0, -4.0),
        normals: (0..corners).map(|k| if k % 2 == 0 { Vec3::Z } else { Vec3::Y }).collect(),
        uvs: (0..corners).map(|k| Vec2::new(k as f32 * 0.25, 1.0)).collect(),
        colours: (0..corners).map(|k| [1.0, k as f32 / corners as f32, 0.5]).collect(),
        triangles: (2..corners as u16).map(|k| [0, k - 1, k]).collect(),
    }
}

pub(super) fn cell() -> Vec<Vec<u8>> {
    let at = |cluster, x: f64| ClusterInstance { cluster, world_from_mesh: DAffine3::from_translation(DVec3::X * x) };
    let shared = ClusterRef::Shared { chunk: 7, cluster: 1 };
    let instances = vec![at(ClusterRef::Own(0), 0.0), at(shared, 1.5), at(ClusterRef::Own(1), 1.5)];
    let cells = [
        CellGeometry { clusters: vec![cluster(40), cluster(5)], instances },
        CellGeometry { clusters: vec![], instances: vec![at(shared, 2.0)] },
    ];
    at_levels(&cells, |cell, level| {
        let steps = vec![ClusterSteps { position_log2: -14, uv_log2: -8 }; cell.clusters.len()];
        codec::cell::encode(cell, &steps, level).expect("encodes")
    })
}

pub(super) fn texture() -> Vec<Vec<u8>> {
    let levels = |alpha: u8| TextureLevels {
        width: 16,
        height: 12,
        first_level: 0,
        levels: [(16, 12), (8, 6)]
            .map(|(width, height)| MipLevel {
                width,
                height,
                rgba: (0..width * height).map(|k| [(k * 3) as u8, (k / 5) as u8, 70, alpha]).collect(),
            })
            .into(),
    };
    let mut all = at_levels(&[(levels(255), ColourMode::LOSSLESS), (levels(90), LOSSY)], |(levels, mode), level| {
        codec::texture::encode(levels, *mode, level).expect("encodes")
    });
    let picture = super::gltf_file::png();
    all.push(codec::texture::encode_picture(2, 2, 2, false, &picture).expect("encodes"));
    all
}

pub(super) fn tree() -> Vec<Vec<u8>> {
    let sample = |k: u32| TreeSample {
        face: (k / 64) as u8,
        row: (k % 64 / 8) as u8,
        column: (k % 8) as u8,
        covers: if k.is_multiple_of(7) { 0x3330 } else { WHOLE },
        depth: (40 + k % 8) as u16,
        slope: [1, -1],
        rgb: [(k * 5) as u8, 90, (k / 3) as u8],
        filtered: k.is_multiple_of(4),
    };
    let node = |count: u32| NodeSamples { samples: (0..count).map(sample).collect() };
    let brood = Brood { nodes: vec![node(130), node(0), node(20)] };
    at_levels(&[brood], |brood, level| {
        let mut out = vec![brood.nodes.len() as u8];
        for node in &brood.nodes {
            let unfiltered = node.samples.iter().filter(|s| !s.filtered).count();
            out.extend([node.samples.len(), unfiltered].map(|n| (n as u16).to_le_bytes()).as_flattened());
        }
        out.extend(codec::tree::encode(brood, level).expect("encodes"));
        out
    })
}

/// Two rooms with a door between them and a window.
pub(super) static ROOMS: LazyLock<Rooms> = LazyLock::new(|| {
    let cell = |name: &str, x: f64| Cell {
        name: name.into(),
        boxes: vec![Aabb { min: DVec3::new(x, -2.0, -60.0), max: DVec3::new(x + 4.0, 3.0, 10.0) }],
    };
    let portal = |cells, x: f64, kind| Portal {
        cells,
        kind,
        corners: [[0.0, 1.0], [0.0, 2.0], [2.0, 2.0], [2.0, 1.0]].map(|[y, z]| DVec3::new(x, y, z)).into(),
    };
    let portals =
        vec![portal([Some(0), Some(1)], 4.0, PortalKind::Door), portal([Some(1), None], 8.0, PortalKind::Window)];
    Rooms::new(0.1, vec![cell("hall", 0.0), cell("kitchen", 4.0)], portals).expect("sound")
});

fn volume() -> WalkVolume {
    let cut = Aabb { min: DVec3::new(-2.0, -1.0, -50.0), max: DVec3::new(10.0, 4.0, 8.0) };
    let runs = |k: usize| match k % 3 {
        0 => vec![],
        1 => vec![[3, 9]],
        _ => vec![[1, 4], [20, 300]],
    };
    WalkVolume::new(cut.min, 2.0, 0.01, [6, 20], &(0..120).map(runs).collect::<Vec<_>>(), &cut).expect("sound")
}

/// A dataset's index with pages of every kind.
fn index() -> Index {
    let Street { mut index, .. } = street(4, 16).with_tree();
    let cells = index.cells.len() as u32;
    index.rooms = Some(RoomIndex {
        rooms: ROOMS.clone(),
        near_m: 0.5,
        cells_of: vec![(0..cells).collect(), vec![1, 3], vec![0]],
        placements: vec![[0..0, 0..0]; 2],
        built: BuiltImages::Ours,
        sides: vec![],
        by_grid: vec![],
    });
    index.volume = Some(volume());
    index
}

fn encoded(level: i32) -> Encoded {
    manifest::encode_at(&index(), level).expect("encodes")
}

/// The root whose pages the target takes.
pub(super) static PAGES_ROOT: LazyLock<Root> =
    LazyLock::new(|| manifest::decode_root(&encoded(9).root).expect("decodes"));

pub(super) fn manifest_root() -> Vec<Vec<u8>> {
    at_levels(&[()], |(), level| {
        let mut root = encoded(level).root;
        root.truncate(root.len() - 32);
        root
    })
}

pub(super) fn manifest_pages() -> Vec<Vec<u8>> {
    at_levels(&[()], |(), level| {
        let pages = encoded(level).pages;
        pages.iter().flat_map(|p| [&(p.len() as u32).to_le_bytes()[..], p].concat()).collect()
    })
}

pub(super) fn walk_volume() -> Vec<Vec<u8>> {
    let mut packed = serde_json::to_value(volume()).expect("encodes");
    let fields = packed.as_object_mut().expect("an object");
    let tokens = serde_json::from_value::<Vec<u8>>(fields.remove("tokens").expect("there")).expect("bytes");
    let tokens = zstd::bulk::decompress(&tokens, 1 << 20).expect("decompresses");
    vec![[packed.to_string().as_bytes(), &[0], &tokens].concat()]
}

fn body<M: wire::Message>(message: &M) -> Vec<u8> {
    wire::encode(message).expect("encodes").split_off(4)
}

pub(super) fn client_message() -> Vec<Vec<u8>> {
    let hello = Hello {
        version: wire::VERSION,
        token: Some("open sesame".into()),
        picture: Picture { width: 1280, height: 720, fov_deg: Some(60.0) },
        cache_bytes: 1 << 30,
        prefetch_m: 10.0,
        name: "walker".into(),
        manifests: vec![ChunkHash([7; 32])],
        portals: Default::default(),
        far: Default::default(),
        dataset: Some("house".into()),
        early: true,
        replacements: true,
    };
    let all = [
        ClientMessage::Hello(hello),
        ClientMessage::Want { chunks: vec![1, 2, 300, 70_000] },
        ClientMessage::Drop { chunks: vec![0] },
        ClientMessage::Have { chunks: (0..100).collect() },
        ClientMessage::Decoding { waiting_bytes: 1 << 20, bytes_per_s: 9 },
        ClientMessage::Whole,
        ClientMessage::Others { shown: true },
        ClientMessage::Bye,
    ];
    all.iter().map(body).collect()
}

pub(super) fn server_message() -> Vec<Vec<u8>> {
    let welcome = Welcome {
        version: wire::VERSION,
        dataset: ChunkHash([3; 32]),
        root_bytes: 5000,
        pages: 12,
        walker: 4,
        others: true,
        next_certificate: Some(ChunkHash([9; 32])),
    };
    let other = Other { walker: 2, name: "guest".into(), position: [1.0, 2.0, 3.0], yaw_deg: 90.0 };
    let all = [
        ServerMessage::Welcome(welcome),
        ServerMessage::Refused { code: RefusalCode::Token, message: "wrong token".into() },
        ServerMessage::Unavailable { chunks: vec![4, 5] },
        ServerMessage::Others { walkers: vec![other] },
        ServerMessage::Replaced,
    ];
    all.iter().map(body).collect()
}

pub(super) fn request() -> Vec<Vec<u8>> {
    [Request::Number(70_000), Request::Name(ChunkHash([5; 32]))].iter().map(body).collect()
}

pub(super) fn answer() -> Vec<Vec<u8>> {
    [Answer::Chunk { number: 9, bytes: 1 << 20 }, Answer::Error { message: "no such chunk".into() }]
        .iter()
        .map(body)
        .collect()
}

pub(super) fn pose_datagram() -> Vec<Vec<u8>> {
    let pose = Pose { position: DVec3::new(1.0, 1.6, -3.0), yaw_deg: 90.0, pitch_deg: -10.0 };
    vec![PoseDatagram { sequence: 77, sent_us: 1 << 40, pose }.encode().to_vec()]
}

pub(super) fn stream_header() -> Vec<Vec<u8>> {
    let header = |kind| StreamHeader { kind, urgency: Urgency::Now, number: TEXTURE[0], bytes: 4000 };
    [StreamKind::Page, StreamKind::Chunk].map(|kind| header(kind).encode().to_vec()).into()
}

fn texts(all: &[&str]) -> Vec<Vec<u8>> {
    all.iter().map(|t| t.as_bytes().to_vec()).collect()
}

pub(super) fn path_file() -> Vec<Vec<u8>> {
    texts(&[
        r#"{ "speed": 2, "fps": 5, "closed": true, "waypoints": [[0, 0, 5], [0, 1, -6], [3, 0, 0]] }"#,
        r#"{ "eye_height": 1.6, "poses": [
            { "t": 0, "position": [1, 1.6, 2], "yaw": 0 },
            { "t": 0.5, "position": [1, 1.6, 1e2], "yaw": -720.5, "pitch": 12 }] }"#,
    ])
}

pub(super) fn rooms_json() -> Vec<Vec<u8>> {
    vec![serde_json::to_vec(&*ROOMS).expect("encodes")]
}

pub(super) fn room_overrides() -> Vec<Vec<u8>> {
    texts(&[
        "[[rename]]\nfrom = \"hall\"\nto = \"lobby\"\n\n[[remove_cell]]\ncell = \"kitchen\"\n",
        "[[split]]\ncell = \"hall\"\nz = -20.5\nnames = [\"north\", \"south\"]\n",
        "[[merge]]\ncells = [\"hall\", \"kitchen\"]\nname = \"living\"\n",
        "[[remove_portal]]\ncells = [\"hall\", \"kitchen\"]\nat = [4.0, 1.0, 1.5]\n\n\
         [[portal]]\ncells = [\"hall\", \"kitchen\"]\ncorners = [[4, 0, 1], [4, 0, 2], [4, 2, 2], [4, 2, 1]]\n",
    ])
}

/// The square, alone and with two rooms and a portal.
fn squares() -> [GltfFile; 2] {
    let extras = serde_json::json!({
        "ldi_cells": [{ "name": "hall", "min": [0, 0, 0], "max": [4, 3, 6] },
                      { "name": "attic", "min": [4, 0, 0], "max": [8, 3, 6] }],
        "ldi_portals": [{ "rooms": ["hall", "attic"], "corners": [[4, 0, 1], [4, 0, 2], [4, 2, 2], [4, 2, 1]] }]
    });
    [GltfFile::square(), GltfFile::square().with("/scenes/0/extras", extras)]
}

pub(super) fn glb() -> Vec<Vec<u8>> {
    squares().iter().map(GltfFile::glb).collect()
}

pub(super) fn gltf() -> Vec<Vec<u8>> {
    use base64::{Engine as _, engine::general_purpose::STANDARD};
    squares().iter().map(|s| s.gltf(&format!("data:;base64,{}", STANDARD.encode(&s.bin)))).collect()
}

pub(super) fn obj() -> Vec<Vec<u8>> {
    texts(&[
        "o a\nv 0 0 0 1 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 1\nvn 0 0 1\nusemtl m\n\
         f 1/1/1 2/2/1 3/1/1 -1/2/1\ng b\nf -4 -3 -2\n",
        "# comment\nv 0 0 0\nv 1e0 0 0\nv 0 1 \\\n 0\nf 1 2 3\ns off\nl 1 2\n",
    ])
}

pub(super) fn mtl() -> Vec<Vec<u8>> {
    texts(&["newmtl a\nKd 0.5 0.25 1\nKa 0 0 0\nd 0.5\nillum 1\n\nnewmtl b\nKd 1 1 1\nTr 0.25\n"])
}

pub(super) fn ply() -> Vec<Vec<u8>> {
    let header = |format: &str| {
        format!(
            "ply\nformat {format} 1.0\ncomment x\nelement vertex 3\nproperty float x\nproperty float y\n\
             property float z\nproperty uchar red\nproperty uchar green\nproperty uchar blue\nelement face 1\n\
             property list uchar int vertex_indices\nend_header\n"
        )
    };
    let ascii = header("ascii") + "0 0 0 255 0 0\n1 0 0 0 255 0\n0 1 0 0 0 255\n3 0 1 2\n";
    let mut binary = header("binary_little_endian").into_bytes();
    for p in [[0f32, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]] {
        binary.extend(p.map(f32::to_le_bytes).as_flattened());
        binary.extend([1, 2, 3]);
    }
    binary.push(3);
    binary.extend([0i32, 1, 2].map(i32::to_le_bytes).as_flattened());
    vec![ascii.into_bytes(), binary]
}

pub(super) fn stl() -> Vec<Vec<u8>> {
    let text = "solid a\nfacet normal 0 0 1\nouter loop\nvertex 0 0 0\nvertex 1 0 0\nvertex 0 1 0\nendloop\nendfacet\n";
    let mut binary = vec![b' '; 80];
    binary.extend(2u32.to_le_bytes());
    for z in [0f32, 1.0] {
        binary.extend([0; 12]);
        binary
            .extend([[0.0, 0.0, z], [1.0, 0.0, z], [0.0, 1.0, z]].as_flattened().iter().flat_map(|x| x.to_le_bytes()));
        binary.extend([0; 2]);
    }
    vec![text.into(), binary]
}

/// A square of positions, normals and texture coordinates by the EdgeBreaker method.
pub(super) fn draco() -> Vec<Vec<u8>> {
    use base64::{Engine as _, engine::general_purpose::STANDARD};
    let square = "RFJBQ08CAgEBAAAABAICAgAAAR//ARH/ARH/ARED/wAAAAAAAQAAAQAJAwAAAgEBCQMAAQMBAwkCAAICAQEBAAMDATABEAMAKIKY\
                  AAAAAAD/BwAAAACAvwAAgL8AAAAAAAAAQAsGAwEBAQEBQAEA/wAAAH8AAAD/AkRACAUBAQADAwEwARADACSCJgACAAAAAQEgAAAA\
                  AP8DAAAAAAAAAAAAAAAAgD8K";
    vec![STANDARD.decode(square).expect("is base64")]
}

/// Positions of the square, and its indices, each after how it is coded.
pub(super) fn meshopt() -> Vec<Vec<u8>> {
    let points = [[0f32, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]];
    let points = ::meshopt::encode_vertex_buffer(&points).expect("encodes");
    let corners = ::meshopt::encode_index_buffer(&[0, 1, 2, 0, 2, 3], 4).expect("encodes");
    let sequence = ::meshopt::encode_index_sequence(&[0, 1, 2, 0, 2, 3], 4).expect("encodes");
    vec![
        [&[0, 3, 4, 0][..], &points].concat(),
        [&[1, 2, 6, 0][..], &corners].concat(),
        [&[2, 2, 6, 0][..], &sequence].concat(),
    ]
}

pub(super) fn picture() -> Vec<Vec<u8>> {
    let mut all: Vec<Vec<u8>> = super::picture_files::pictures().into_iter().map(|(_, bytes)| bytes).collect();
    all.push(super::gltf_file::png());
    all
}

/// The first scene of OBJ in a gzip file without compression, and in a zip archive.
pub(super) fn packed() -> Vec<Vec<u8>> {
    let text = obj().remove(0);
    let mut crc = u32::MAX;
    for byte in &text {
        crc ^= u32::from(*byte);
        for _ in 0..8 {
            crc = if crc & 1 == 1 { (crc >> 1) ^ 0xedb8_8320 } else { crc >> 1 };
        }
    }
    let (crc, length) = (!crc, text.len() as u32);
    let mut gzip = vec![0x1f, 0x8b, 8, 0, 0, 0, 0, 0, 0, 0xff, 1];
    gzip.extend((length as u16).to_le_bytes());
    gzip.extend((!(length as u16)).to_le_bytes());
    gzip.extend(&text);
    gzip.extend([crc, length].map(u32::to_le_bytes).as_flattened());
    // Version, flags, method, time and date, checksum, sizes, lengths of the name and of more.
    let fields = |out: &mut Vec<u8>| {
        out.extend([20, 0, 0, 0, 0, 0, 0, 0, 33, 0]);
        out.extend([crc, length, length].map(u32::to_le_bytes).as_flattened());
        out.extend([5, 0, 0, 0]);
    };
    let mut zip = b"PK\x03\x04".to_vec();
    fields(&mut zip);
    zip.extend(b"a.obj");
    zip.extend(&text);
    let directory = zip.len() as u32;
    zip.extend(b"PK\x01\x02\x14\0");
    fields(&mut zip);
    zip.extend([0; 14]);
    zip.extend(b"a.obj");
    let size = zip.len() as u32 - directory;
    zip.extend(b"PK\x05\x06\0\0\0\0\x01\0\x01\0");
    zip.extend([size, directory].map(u32::to_le_bytes).as_flattened());
    zip.extend([0; 2]);
    vec![gzip, zip]
}

pub(super) fn known_hosts() -> Vec<Vec<u8>> {
    let print = "0123456789abcdef".repeat(4);
    vec![format!("# servers\n\nmuseum:4433 {print}\n[::1]:9   {print}\nhall:1 {print}").into_bytes()]
}

pub(super) fn serve_config() -> Vec<Vec<u8>> {
    texts(&[
        "listen = '0.0.0.0:4433'\nhttp = 'off'\ncongestion = 'bbr'\nmax_connections = 8\nshow_walkers = false\n",
        "http = '[::1]:80'\nhttp_names = ['museum.example']\nmessages_per_second = 5e2\nsend_window = 1000000\n\
         bytes_per_second_per_address = 20000.5\n",
    ])
}
