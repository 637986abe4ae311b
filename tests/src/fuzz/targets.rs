//! The functions of [`super::TARGETS`].

use super::{
    gltf_file::GltfFile,
    seeds::{FIRST_IMAGE, PAGES_ROOT, ROOMS},
};
use ldi_client::stream::{Fingerprint, KnownHosts};
use ldi_protocol::{
    codec::{self, ColourMode},
    index::ChunkHash,
    manifest, path,
    rooms::Rooms,
    volume::WalkVolume,
    wire::{self, Answer, ClientMessage, Message, PoseDatagram, Request, ServerMessage, StreamHeader},
};
use ldi_server::{
    portal::apply_overrides,
    scene::{self, LIMITS, Limits},
    serve::ServeConfig,
};
use std::{
    path::{Path, PathBuf},
    sync::LazyLock,
};

/// Images up to this number of samples are encoded again and compared.
const COMPARED: usize = 1 << 14;

pub(super) fn ldi_first(bytes: &[u8]) -> bool {
    let Ok(ldi) = codec::ldi::decode_first(bytes) else { return false };
    if ldi.layers.iter().all(|l| l.len() < COMPARED) && ldi.sky.len() < COMPARED {
        let again = codec::ldi::encode_first(&ldi, ColourMode::LOSSLESS, 1).expect("what decodes encodes");
        assert_eq!(codec::ldi::decode_first(&again).expect("and decodes"), ldi);
    }
    true
}

pub(super) fn ldi_deeper(bytes: &[u8]) -> bool {
    let mut ldi = FIRST_IMAGE.clone();
    match codec::ldi::decode_deeper(bytes, &mut ldi) {
        Ok(()) => {
            ldi.check().expect("a decoded image is sound");
            true
        }
        Err(_) => {
            assert!(ldi == *FIRST_IMAGE, "a refused chunk changed the image");
            false
        }
    }
}

pub(super) fn cell(bytes: &[u8]) -> bool {
    let Ok(geometry) = codec::cell::decode(bytes) else { return false };
    for cluster in &geometry.clusters {
        let vertices = cluster.positions.len();
        assert!(cluster.triangles.iter().flatten().all(|i| (*i as usize) < vertices));
        assert!(cluster.positions.iter().all(|p| p.is_finite()));
    }
    true
}

pub(super) fn texture(bytes: &[u8]) -> bool {
    let Ok(texture) = codec::texture::decode(bytes) else { return false };
    for level in &texture.levels {
        assert_eq!(level.rgba.len(), level.width as usize * level.height as usize);
    }
    true
}

/// Number of nodes, samples and unfiltered samples of each as u16, then the chunk.
pub(super) fn tree(bytes: &[u8]) -> bool {
    let Some((count, rest)) = bytes.split_first() else { return false };
    let Some((listed, chunk)) = rest.split_at_checked(usize::from(count % 9) * 4) else { return false };
    let number = |b: &[u8]| u32::from(u16::from_le_bytes([b[0], b[1]]));
    let nodes: Vec<(u32, u32)> = listed.chunks_exact(4).map(|b| (number(&b[..2]), number(&b[2..]))).collect();
    let Ok(brood) = codec::tree::decode(chunk, &nodes) else { return false };
    assert_eq!(brood.nodes.len(), nodes.len());
    assert_eq!(codec::tree::decode(&codec::tree::encode(&brood, 1).expect("encodes"), &nodes).expect("decodes"), brood);
    true
}

/// A root without its checksum, which is computed here.
pub(super) fn manifest_root(body: &[u8]) -> bool {
    let checksum = blake3::hash(body);
    manifest::decode_root(&[body, checksum.as_bytes()].concat()).is_ok()
}

/// Pages, each after its length as u32, for the root of the seeds, whose hashes are computed here.
pub(super) fn manifest_pages(bytes: &[u8]) -> bool {
    let mut root = PAGES_ROOT.clone();
    let (mut rest, mut pages) = (bytes, Vec::new());
    for entry in &mut root.pages {
        let Some((length, after)) = rest.split_first_chunk::<4>() else { return false };
        let Some((page, after)) = after.split_at_checked(u32::from_le_bytes(*length) as usize) else { return false };
        rest = after;
        (entry.hash, entry.stored_bytes) = (ChunkHash(blake3::hash(page).into()), page.len() as u32);
        pages.push(Some(page));
    }
    let early = manifest::early(&root, &pages);
    let pages: Vec<&[u8]> = pages.into_iter().flatten().collect();
    let Ok(index) = manifest::assemble(&root, &pages) else { return false };
    assert!(early.is_ok(), "the whole is sound, but not its first pages");
    manifest::validate(&index).expect("an assembled index is sound");
    true
}

/// The head of a walk volume's packed form as JSON, a zero byte, and its tokens, which are
/// compressed here.
pub(super) fn walk_volume(bytes: &[u8]) -> bool {
    let Some(end) = bytes.iter().position(|b| *b == 0) else { return false };
    let Ok(mut packed) = serde_json::from_slice::<serde_json::Value>(&bytes[..end]) else { return false };
    let Ok(tokens) = zstd::bulk::compress(&bytes[end + 1..], 1) else { return false };
    let Some(fields) = packed.as_object_mut() else { return false };
    fields.insert("tokens".into(), tokens.into());
    let Ok(volume) = serde_json::from_value::<WalkVolume>(packed) else { return false };
    let again = serde_json::to_value(&volume).expect("encodes");
    assert_eq!(serde_json::from_value::<WalkVolume>(again).expect("decodes"), volume);
    true
}

fn message<M: Message + PartialEq + std::fmt::Debug>(body: &[u8]) -> bool {
    let Ok(message) = wire::decode::<M>(body) else { return false };
    // Numbers take other forms, so an encoding at the limit may exceed it.
    if let Ok(frame) = wire::encode(&message) {
        assert_eq!(wire::decode::<M>(&frame[4..]).expect("what is encoded decodes"), message);
    }
    true
}

pub(super) fn client_message(body: &[u8]) -> bool {
    message::<ClientMessage>(body)
}
pub(super) fn server_message(body: &[u8]) -> bool {
    message::<ServerMessage>(body)
}
pub(super) fn request(body: &[u8]) -> bool {
    message::<Request>(body)
}
pub(super) fn answer(body: &[u8]) -> bool {
    message::<Answer>(body)
}

pub(super) fn pose_datagram(bytes: &[u8]) -> bool {
    let Ok(datagram) = PoseDatagram::decode(bytes) else { return false };
    assert_eq!(datagram.encode(), bytes);
    true
}

pub(super) fn stream_header(bytes: &[u8]) -> bool {
    let Some(head) = bytes.first_chunk() else { return false };
    let Ok(header) = StreamHeader::decode(head) else { return false };
    assert_eq!(&header.encode(), head);
    true
}

pub(super) fn path_file(bytes: &[u8]) -> bool {
    let Ok(walk) = path::read(bytes, |_| ()) else { return false };
    for timed in &walk.poses {
        assert!(timed.t_s.is_finite() && timed.pose.position.is_finite());
        assert!(timed.pose.yaw_deg.is_finite() && timed.pose.pitch_deg.abs() <= 90.0);
    }
    true
}

pub(super) fn rooms_json(text: &[u8]) -> bool {
    let Ok(rooms) = Rooms::from_json(text) else { return false };
    let again = serde_json::to_vec(&rooms).expect("encodes");
    assert_eq!(Rooms::from_json(&again).expect("decodes").portals().len(), rooms.portals().len());
    true
}

pub(super) fn room_overrides(bytes: &[u8]) -> bool {
    let Ok(text) = std::str::from_utf8(bytes) else { return false };
    apply_overrides(&ROOMS, Path::new("rooms.json"), text).is_ok()
}

/// Small enough that no input asks for much.
const SMALL_SCENES: Limits = Limits { vertices: 1 << 14, unique_triangles: 1 << 14, image_pixels: 1 << 18, ..LIMITS };

/// A folder of this process, in memory where there is such a place.
static FOLDER: LazyLock<PathBuf> = LazyLock::new(|| {
    let memory = Path::new("/dev/shm");
    let parent = if memory.is_dir() { memory.to_owned() } else { std::env::temp_dir() };
    let folder = parent.join(format!("ldi-fuzz-{}", std::process::id()));
    std::fs::create_dir_all(&folder).expect("writable");
    folder
});

/// Removes the files that targets wrote.
pub fn tidy() {
    let _ = std::fs::remove_dir_all(&*FOLDER);
}

fn file(name: &str, bytes: &[u8]) -> PathBuf {
    let path = FOLDER.join(name);
    std::fs::write(&path, bytes).expect("writable");
    path
}

fn loads(path: &Path) -> bool {
    let Ok(scene) = scene::load_within(&path.display().to_string(), &SMALL_SCENES) else { return false };
    let vertices = |p: &scene::Primitive| p.positions.len();
    for primitive in scene.meshes.iter().flat_map(|m| &m.primitives) {
        assert!(primitive.positions.iter().all(|p| p.is_finite()));
        assert!(primitive.triangles.iter().flatten().all(|i| (*i as usize) < vertices(primitive)));
    }
    assert!(scene.instances.iter().all(|i| (i.mesh as usize) < scene.meshes.len()));
    true
}

pub(super) fn glb(bytes: &[u8]) -> bool {
    loads(&file("scene.glb", bytes))
}
pub(super) fn gltf(bytes: &[u8]) -> bool {
    loads(&file("scene.gltf", bytes))
}
pub(super) fn obj(bytes: &[u8]) -> bool {
    loads(&file("scene.obj", bytes))
}
pub(super) fn ply(bytes: &[u8]) -> bool {
    loads(&file("scene.ply", bytes))
}

pub(super) fn stl(bytes: &[u8]) -> bool {
    loads(&file("scene.stl", bytes))
}
/// A scene in a gzip file or zip archive, told apart by its first bytes.
pub(super) fn packed(bytes: &[u8]) -> bool {
    loads(&file("scene.obj.gz", bytes))
}

/// A square whose file has these bytes besides and members changed.
fn square_with(bytes: &[u8], members: impl FnOnce(&mut serde_json::Value, u64)) -> bool {
    let (mut square, view) = GltfFile::square().append(bytes);
    members(&mut square.json, view as u64);
    loads(&file("scene.glb", &square.glb()))
}

/// A Draco stream that holds the primitive.
pub(super) fn draco(bytes: &[u8]) -> bool {
    square_with(bytes, |json, view| {
        let attributes = serde_json::json!({ "POSITION": 0, "NORMAL": 1, "TEXCOORD_0": 2 });
        let draco = serde_json::json!({ "bufferView": view, "attributes": attributes });
        let primitive = &mut json["meshes"][0]["primitives"][0];
        primitive["attributes"] = serde_json::json!({ "POSITION": 0, "NORMAL": 1, "TEXCOORD_0": 2 });
        primitive["extensions"] = serde_json::json!({ "KHR_draco_mesh_compression": draco });
        json["accessors"][0].as_object_mut().expect("an object").remove("bufferView");
    })
}

/// Mode and filter (one byte), stride in words (one byte), count (two bytes), then the stream of a
/// view, which holds the positions and, as far as it fits, the indices.
pub(super) fn meshopt(bytes: &[u8]) -> bool {
    let Some((&[kind, stride, low, high], stream)) = bytes.split_first_chunk() else { return false };
    square_with(stream, |json, view| {
        let mode = ["ATTRIBUTES", "TRIANGLES", "INDICES"][usize::from(kind % 3)];
        let filter = ["NONE", "OCTAHEDRAL", "QUATERNION", "EXPONENTIAL", "COLOR"][usize::from(kind / 3 % 5)];
        let count = u16::from_le_bytes([low, high]);
        let stride = if mode == "ATTRIBUTES" { 4 * u32::from(stride) } else { u32::from(stride) };
        let offset = json["bufferViews"][view as usize]["byteOffset"].clone();
        let of = serde_json::json!({
            "buffer": 0, "byteOffset": offset, "byteLength": stream.len(), "byteStride": stride,
            "count": count, "mode": mode, "filter": filter
        });
        let length = u32::from(count) * stride;
        let extensions = serde_json::json!({ "EXT_meshopt_compression": of });
        let at = if mode == "ATTRIBUTES" { 0 } else { 4 };
        json["bufferViews"][at] = serde_json::json!({ "buffer": 1, "byteLength": length, "extensions": extensions });
        json["buffers"].as_array_mut().expect("a list").push(serde_json::json!({ "byteLength": length }));
    })
}

/// A picture that the square shows.
pub(super) fn picture(bytes: &[u8]) -> bool {
    square_with(bytes, |json, view| json["images"][0] = serde_json::json!({ "bufferView": view }))
}

/// Materials of an OBJ file that is as it should be.
pub(super) fn mtl(bytes: &[u8]) -> bool {
    file("looks.mtl", bytes);
    let text = "mtllib looks.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 0\nusemtl a\nf 1/1 2/1 3/1\n";
    loads(&file("looks.obj", text.as_bytes()))
}

pub(super) fn known_hosts(bytes: &[u8]) -> bool {
    let Ok(known) = KnownHosts::load(&file("known_hosts", bytes)) else { return false };
    let _ = known.check("museum:4433", Fingerprint([1; 32]));
    let _ = known.other("museum", Fingerprint([1; 32]));
    true
}

pub(super) fn serve_config(bytes: &[u8]) -> bool {
    ServeConfig::from_file(&file("serve.toml", bytes)).is_ok_and(|c| c.validate().is_ok())
}
