//! Scenes in gzip files and zip archives.
//!
//! A compressed file states its own size, and may lie: what comes out of it is counted, and may
//! exceed what went in by [`RATIO`] only beyond [`FREE_BYTES`]. Archives within archives are not
//! opened.

use std::collections::HashMap;
use std::fmt;
use std::io::{Cursor, Read};

use flate2::read::MultiGzDecoder;
use zip::ZipArchive;

use super::error::Fault;

/// Bytes that come out of any file without a look at its size.
const FREE_BYTES: u64 = 16 << 20;
/// Bytes that come out for each byte beyond that: meshes as text, the most repetitive files, shrink
/// to a fifteenth.
const RATIO: u64 = 32;
/// Entries of an archive: its list is kept in memory.
const MOST_ENTRIES: usize = 65_536;
/// Endings of scene files.
const SCENES: [&str; 6] = [".gltf", ".glb", ".obj", ".ply", ".stl", ".ifc"];

const REMEDY: &str = "unpack the file and name the scene in it";

/// Whether bytes start as a gzip file does.
pub(super) fn is_gzip(bytes: &[u8]) -> bool {
    bytes.starts_with(b"\x1f\x8b\x08")
}

/// Whether bytes start as a zip archive does.
pub(super) fn is_zip(bytes: &[u8]) -> bool {
    bytes.starts_with(b"PK\x03\x04") || bytes.starts_with(b"PK\x05\x06")
}

/// Most bytes that may come out of `packed` bytes.
fn allowance(packed: u64, left: u64) -> u64 {
    (FREE_BYTES + packed.saturating_mul(RATIO)).min(left)
}

fn read_within(from: impl Read, most: u64, place: &str) -> Result<Vec<u8>, Fault> {
    let mut out = Vec::new();
    // One byte more than allowed tells that there is more.
    from.take(most + 1)
        .read_to_end(&mut out)
        .map_err(|e| Fault::invalid(place, format!("cannot be unpacked: {e}"), "copy or pack the file again"))?;
    match out.len() as u64 <= most {
        true => Ok(out),
        false => Err(Fault::too_large(place, "or more bytes once unpacked", out.len(), most)),
    }
}

/// Unpacks a gzip file, of at most `left` bytes.
pub(super) fn gunzip(bytes: &[u8], left: u64) -> Result<Vec<u8>, Fault> {
    read_within(MultiGzDecoder::new(bytes), allowance(bytes.len() as u64, left), "gzip")
}

/// An open archive.
pub(super) struct Archive {
    zip: ZipArchive<Cursor<Vec<u8>>>,
    /// Entries by their names in lower case, with forward slashes.
    names: HashMap<String, usize>,
    /// Folder of the scene in the archive, ending in a slash, or empty.
    folder: String,
}

impl fmt::Debug for Archive {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Archive").field("folder", &self.folder).finish_non_exhaustive()
    }
}

impl Archive {
    /// Opens an archive; returns it with the name of the only scene in it.
    pub(super) fn open(bytes: Vec<u8>) -> Result<(Self, String), Fault> {
        let unreadable = |e: zip::result::ZipError| {
            Fault::invalid("zip archive", format!("cannot be read: {e}"), "copy or pack the archive again")
        };
        let zip = ZipArchive::new(Cursor::new(bytes)).map_err(unreadable)?;
        if zip.len() > MOST_ENTRIES {
            return Err(Fault::too_large("zip archive", "entries", zip.len(), MOST_ENTRIES));
        }
        let mut names = HashMap::new();
        let mut scenes = Vec::new();
        for (i, name) in zip.file_names().enumerate() {
            let Ok(name) = name else { continue };
            let plain = name.replace('\\', "/");
            let lower = plain.to_lowercase();
            if lower.split('/').any(|part| part == "__macosx") {
                continue;
            }
            if SCENES.iter().any(|end| lower.ends_with(end)) {
                scenes.push(plain);
            }
            names.entry(lower).or_insert(i);
        }
        let holds = |end: &str| names.keys().any(|n| n.ends_with(end));
        let foreign = [
            (".usdc", "a USDZ file", "open it in Blender, or convert it by usd2gltf, to glTF (.glb)"),
            (".usda", "a USDZ file", "open it in Blender, or convert it by usd2gltf, to glTF (.glb)"),
            (".usd", "a USDZ file", "open it in Blender, or convert it by usd2gltf, to glTF (.glb)"),
            (".model", "a 3MF file", "open it in a slicer or MeshLab and export it as STL or OBJ"),
            ("document.xml", "a zip archive, as FreeCAD (.FCStd) and offices write", REMEDY),
            (".dae", "a zip archive with a COLLADA file", "unpack it, open it in Blender and export it as glTF (.glb)"),
            (".fbx", "a zip archive with an FBX file", "unpack it, open it in Blender and export it as glTF (.glb)"),
        ];
        match &scenes[..] {
            [scene] => {
                let folder = scene.rsplit_once('/').map(|(folder, _)| format!("{}/", folder.to_lowercase()));
                Ok((Self { zip, names, folder: folder.unwrap_or_default() }, scene.clone()))
            }
            [] => Err(match foreign.iter().find(|f| holds(f.0)) {
                Some((_, what, remedy)) => Fault::unsupported("file", format!("it is {what}"), *remedy),
                None => Fault::unsupported("file", "it is a zip archive without a scene file in it", REMEDY),
            }),
            [_, ..] => {
                let listed = super::files::listed(&scenes);
                let problem = format!("it is a zip archive with {} scene files: {listed}", scenes.len());
                Err(Fault::unsupported("file", problem, "unpack it and name one of them"))
            }
        }
    }

    /// Whether there is an entry of this name.
    pub(super) fn holds(&self, name: &str) -> bool {
        self.names.contains_key(&format!("{}{}", self.folder, name.to_lowercase()))
    }

    /// Reads the entry of this name, of at most `left` bytes; None where there is none.
    pub(super) fn read(&mut self, name: &str, left: u64) -> Option<Result<Vec<u8>, Fault>> {
        let at = *self.names.get(&format!("{}{}", self.folder, name.to_lowercase()))?;
        let place = format!("zip archive, {}", super::files::shown(name));
        let entry = match self.zip.by_index(at) {
            Ok(entry) => entry,
            Err(e) => return Some(Err(Fault::invalid(place, format!("cannot be unpacked: {e}"), REMEDY))),
        };
        let most = allowance(entry.compressed_size(), left);
        if entry.size() > most {
            return Some(Err(Fault::too_large(place, "bytes once unpacked", entry.size(), most)));
        }
        Some(read_within(entry, most, &place))
    }
}
