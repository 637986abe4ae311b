//! Valid files with bytes changed at random: anything may come out but a panic, and what loads is
//! well formed.

use std::panic::{AssertUnwindSafe, catch_unwind};

use super::super::files::Files;
use super::super::{LIMITS, Limits, import};
use super::Folder;
use super::gltf_file::GltfFile;

/// Knuth's 64-bit linear congruential generator; the upper bits are good enough to pick bytes.
struct Random(u64);

impl Random {
    fn below(&mut self, n: usize) -> usize {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        ((self.0 >> 33) as usize) % n
    }
}

/// Small enough that no mutation can ask for much.
const SMALL: Limits = Limits { vertices: 1 << 16, unique_triangles: 1 << 16, image_pixels: 1 << 20, ..LIMITS };

fn fuzz(name: &str, valid: &[u8], seed: u64, rounds: usize) {
    let folder = Folder::new();
    let path = folder.write(name, valid);
    let mut random = Random(seed);
    let (mut loaded, mut refused) = (0, 0);
    for round in 0..rounds {
        let mut bytes = valid.to_vec();
        for _ in 0..1 + random.below(4) {
            let at = random.below(bytes.len());
            match random.below(5) {
                0 => bytes[at] ^= 1 << random.below(8),
                1 => bytes[at] = random.below(256) as u8,
                // Digits make counts and references in text wrong, not unreadable.
                2 => bytes[at] = b'0' + random.below(10) as u8,
                3 => bytes[at] = [0, 0x7f, 0x80, 0xff][random.below(4)],
                _ if random.below(8) == 0 => bytes.truncate(at + 1),
                _ => {
                    let other = bytes[random.below(bytes.len())];
                    bytes[at] = other;
                }
            }
        }
        let (mut files, _) = Files::open(path.as_ref(), LIMITS.file_bytes).unwrap();
        let result = catch_unwind(AssertUnwindSafe(|| import(name, &bytes, &mut files, &SMALL)));
        match result.unwrap_or_else(|_| panic!("{name}, seed {seed}, round {round} panics")) {
            Err(_) => refused += 1,
            Ok(scene) => {
                loaded += 1;
                scene.check().unwrap_or_else(|e| panic!("{name}, seed {seed}, round {round}: {e}"));
            }
        }
    }
    // Both ways out were taken, so the mutations are neither harmless nor all fatal.
    assert!(loaded > rounds / 100 && refused > rounds / 100, "{loaded} loaded, {refused} refused");
}

#[test]
fn glb() {
    fuzz("square.glb", &GltfFile::square().glb(), 1, 6_000);
}

#[test]
fn glb_without_spaces_in_the_binary_part() {
    // The binary part alone, in a text file's data URI, so that its base64 is hit too.
    let file = GltfFile::square();
    let base64 = base64::Engine::encode(&base64::engine::general_purpose::STANDARD, &file.bin);
    fuzz("square.gltf", &file.gltf(&format!("data:;base64,{base64}")), 2, 3_000);
}

#[test]
fn obj() {
    let text = "o a\nv 0 0 0 1 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 1\nvn 0 0 1\nusemtl m\nf 1/1/1 2/2/1 3/1/1 -1/2/1\ng b\nf -4 -3 -2\n";
    fuzz("a.obj", text.as_bytes(), 3, 3_000);
}

#[test]
fn ply() {
    let header = |format| {
        format!(
            "ply\nformat {format} 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\nproperty uchar red\n\
             property uchar green\nproperty uchar blue\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n"
        )
    };
    let ascii = header("ascii") + "0 0 0 255 0 0\n1 0 0 0 255 0\n0 1 0 0 0 255\n3 0 1 2\n";
    fuzz("a.ply", ascii.as_bytes(), 4, 3_000);
    let mut binary = header("binary_big_endian").into_bytes();
    for p in [[0f32, 0., 0.], [1., 0., 0.], [0., 1., 0.]] {
        binary.extend(p.map(f32::to_be_bytes).as_flattened());
        binary.extend([1, 2, 3]);
    }
    binary.push(3);
    binary.extend([0i32, 1, 2].map(i32::to_be_bytes).as_flattened());
    fuzz("b.ply", &binary, 5, 3_000);
    let looks = "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\nelement face 1\n\
                 property list uchar int vertex_indices\nproperty list uchar float texcoord\nproperty int texnumber\nproperty uchar red\n\
                 property uchar green\nproperty uchar blue\nend_header\n0 0 0\n1 0 0\n0 1 0\n3 0 1 2 6 0 0 1 0 1 1 0 255 0 9\n";
    fuzz("c.ply", looks.as_bytes(), 6, 3_000);
}
