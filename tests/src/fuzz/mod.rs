//! Fuzz targets: every decoder of bytes that come from somebody else.
//!
//! [`TARGETS`] is the one list. `tests/tests/fuzz.rs` runs each target on its seeds, on the files
//! of `tests/corpus/NAME/` and on seeded changes of the seeds; `tests/fuzz` runs the same
//! functions under libFuzzer. To add a target, write a function here, give it seeds and add it to
//! the list.

pub mod mutate;
mod seeds;
mod targets;

pub use targets::tidy;

#[path = "../../../server/src/scene/tests/gltf_file.rs"]
#[allow(dead_code, reason = "shared with the server's tests, which use the rest")]
mod gltf_file;
#[path = "../../../server/src/scene/tests/picture_files.rs"]
mod picture_files;
#[path = "../../../client/src/cache/fixture.rs"]
#[allow(dead_code, missing_docs, reason = "shared with the client's tests, which use the rest")]
pub mod street;

/// A decoder with its valid inputs.
#[derive(Debug, Clone, Copy)]
pub struct Target {
    /// Name, also of its folder in `tests/corpus`.
    pub name: &'static str,
    /// Valid inputs, which the decoder accepts.
    pub seeds: fn() -> Vec<Vec<u8>>,
    /// Decodes an input and returns whether it was accepted.
    ///
    /// # Panics
    /// If what was accepted breaks a promise of the decoder.
    pub run: fn(&[u8]) -> bool,
    /// Most bytes that one input may hold in memory, beyond [`BYTES_PER_BYTE`] for each of its own.
    pub most_bytes: usize,
}

impl Target {
    /// The target of this name.
    ///
    /// # Panics
    /// If there is none.
    pub fn named(name: &str) -> &'static Self {
        TARGETS.iter().find(|t| t.name == name).unwrap_or_else(|| panic!("no target is called {name}"))
    }
}

/// Memory that each byte of an input may take: parsed JSON is the largest.
pub const BYTES_PER_BYTE: usize = 400;

/// Memory of decoders whose output grows with their input only.
const SMALL: usize = 4 << 20;
/// Memory of chunks: rANS and zstd give many samples or texels from few bytes, up to the limits of
/// `docs/reference/format.md` (2^24 samples, 2^26 texels).
const CHUNK: usize = 1 << 30;
/// Memory of the manifest's pages, decoded twice as the client does: for the first picture, then
/// whole. With the stored pages it stays below 700 MB.
const PAGES: usize = 600 << 20;

/// Memory of geometry decoders: they may give 16 MiB whatever they get, held twice meanwhile, and
/// what they need for it.
const GEOMETRY: usize = 512 << 20;
/// Memory of picture decoders: several floats for each channel of a million pixels.
const PICTURE: usize = 128 << 20;
/// Memory of archives: 16 MiB come out of any, and grow into a list of twice that.
const UNPACKED: usize = 128 << 20;

const fn target(name: &'static str, seeds: fn() -> Vec<Vec<u8>>, run: fn(&[u8]) -> bool, most_bytes: usize) -> Target {
    Target { name, seeds, run, most_bytes }
}

/// All targets.
pub static TARGETS: [Target; 29] = [
    target("ldi_first", seeds::ldi_first, targets::ldi_first, CHUNK),
    target("ldi_deeper", seeds::ldi_deeper, targets::ldi_deeper, CHUNK),
    target("cell", seeds::cell, targets::cell, CHUNK),
    target("texture", seeds::texture, targets::texture, CHUNK),
    target("tree", seeds::tree, targets::tree, SMALL),
    target("manifest_root", seeds::manifest_root, targets::manifest_root, SMALL),
    target("manifest_pages", seeds::manifest_pages, targets::manifest_pages, PAGES),
    target("walk_volume", seeds::walk_volume, targets::walk_volume, PAGES),
    target("client_message", seeds::client_message, targets::client_message, SMALL),
    target("server_message", seeds::server_message, targets::server_message, SMALL),
    target("request", seeds::request, targets::request, SMALL),
    target("answer", seeds::answer, targets::answer, SMALL),
    target("pose_datagram", seeds::pose_datagram, targets::pose_datagram, SMALL),
    target("stream_header", seeds::stream_header, targets::stream_header, SMALL),
    target("path_file", seeds::path_file, targets::path_file, CHUNK),
    target("rooms_json", seeds::rooms_json, targets::rooms_json, SMALL),
    target("room_overrides", seeds::room_overrides, targets::room_overrides, SMALL),
    target("glb", seeds::glb, targets::glb, SMALL),
    target("gltf", seeds::gltf, targets::gltf, SMALL),
    target("obj", seeds::obj, targets::obj, SMALL),
    target("mtl", seeds::mtl, targets::mtl, SMALL),
    target("ply", seeds::ply, targets::ply, SMALL),
    target("stl", seeds::stl, targets::stl, SMALL),
    target("draco", seeds::draco, targets::draco, GEOMETRY),
    target("meshopt", seeds::meshopt, targets::meshopt, GEOMETRY),
    target("picture", seeds::picture, targets::picture, PICTURE),
    target("packed", seeds::packed, targets::packed, UNPACKED),
    target("known_hosts", seeds::known_hosts, targets::known_hosts, SMALL),
    target("serve_config", seeds::serve_config, targets::serve_config, SMALL),
];
