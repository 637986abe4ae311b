//! Small red pictures in all formats that are read, for tests and as seeds.

use base64::{Engine, engine::general_purpose::STANDARD};

/// Names and bytes; every texel is about (220, 20, 20).
pub(super) fn pictures() -> Vec<(&'static str, Vec<u8>)> {
    let coded = |name, text: &str| (name, STANDARD.decode(text).expect("is base64"));
    vec![
        coded("a.webp", "UklGRh4AAABXRUJQVlA4TBEAAAAvD8ADAAdQinKXov+BiOh/AAA="),
        coded("a.jp2", JPEG_2000),
        coded("a.gif", "R0lGODdhEAAQAIEAANwUFAAAAAAAAAAAACwAAAAAEAAQAEAIHQABCBxIsKDBgwgTKlzIsKHDhxAjSpxIsaLFgQEBADs="),
        coded(
            "a.ico",
            "AAABAAEAEBAAAAAAIABSAAAAFgAAAIlQTkcNChoKAAAADUlIRFIAAAAQAAAAEAgCAAAAkJFoNgAAABlJREFUeJxjvCMiwkAKYCJJ\
             9aiGUQ1DSgMATz0BJPRsugEAAAAASUVORK5CYII=",
        ),
        ("a.pcx", pcx()),
        ("a.tga", [&[0, 0, 2, 0, 0, 0, 0, 0, 0, 0, 0, 0, 2, 0, 2, 0, 24, 0][..], &[20, 20, 220].repeat(4)].concat()),
        ("run.tga", [&[0, 0, 10, 0, 0, 0, 0, 0, 0, 0, 0, 0, 2, 0, 2, 0, 24, 0][..], &[0x83, 20, 20, 220]].concat()),
        ("a.bmp", bmp()),
        ("a.ppm", [&b"P6 2 2 255\n"[..], &[220, 20, 20].repeat(4)].concat()),
        ("text.ppm", b"P3\n# a comment\n1 1\n255\n220 20 20\n".to_vec()),
        ("a.tif", tiff()),
        ("a.dds", dds()),
        ("a.ktx2", ktx2()),
    ]
}

const JPEG_2000: &str = "AAAADGpQICANCocKAAAAFGZ0eXBqcDIgAAAAAGpwMiAAAAAtanAyaAAAABZpaGRyAAAAEAAAABAAAwcHAAAAAAAPY29scgEAAAAA\
                         ABAAAACtanAyY/9P/1EALwAAAAAAEAAAABAAAAAAAAAAAAAAABAAAAAQAAAAAAAAAAAAAwcBAQcBAQcBAf9SAAwAAAABAAQEBAAB\
                         /1wAEEBASEhQSEhQSEhQSEhQ/2QAJQABQ3JlYXRlZCBieSBPcGVuSlBFRyB2ZXJzaW9uIDIuNS40/5AACgAAAAAAKQAB/5PPtAgD\
                         M8+0CAgfz7QICB+AgICAgICAgICAgID/2Q==";

fn words(values: &[u32]) -> Vec<u8> {
    values.iter().flat_map(|v| v.to_le_bytes()).collect()
}

/// Two rows of two texels in three planes, each row run-length coded.
fn pcx() -> Vec<u8> {
    let mut out = vec![0; 128];
    out[..4].copy_from_slice(&[10, 5, 1, 8]);
    // The last column and row, both 1.
    (out[8], out[10]) = (1, 1);
    // Planes, and bytes of a row in each.
    (out[65], out[66]) = (3, 2);
    out.extend([0xc2, 220, 0xc2, 20, 0xc2, 20].repeat(2));
    out
}

fn bmp() -> Vec<u8> {
    let row = [20, 20, 220, 20, 20, 220, 0, 0];
    let mut out = b"BM".to_vec();
    out.extend(words(&[54 + 16, 0, 54, 40, 2, 2]));
    out.extend([1, 0, 24, 0]);
    out.extend(words(&[0, 16, 2835, 2835, 0, 0]));
    out.extend(row.repeat(2));
    out
}

/// One strip of two by two texels.
fn tiff() -> Vec<u8> {
    let entry = |tag: u16, kind: u16, count: u32, value: u32| {
        let head = [tag, kind].map(u16::to_le_bytes).concat();
        [head, words(&[count, value])].concat()
    };
    // Columns, rows, bits (at 122), no compression, RGB, the strip (at 128), channels, its rows and
    // bytes.
    let entries = [
        entry(256, 3, 1, 2),
        entry(257, 3, 1, 2),
        entry(258, 3, 3, 122),
        entry(259, 3, 1, 1),
        entry(262, 3, 1, 2),
        entry(273, 4, 1, 128),
        entry(277, 3, 1, 3),
        entry(278, 3, 1, 2),
        entry(279, 4, 1, 12),
    ];
    let mut out = b"II*\0\x08\0\0\0".to_vec();
    out.extend((entries.len() as u16).to_le_bytes());
    out.extend(entries.concat());
    out.extend(words(&[0]));
    out.extend([8, 0].repeat(3));
    out.extend([220, 20, 20].repeat(4));
    out
}

/// Two by two texels of three bytes.
fn dds() -> Vec<u8> {
    let mut out = b"DDS ".to_vec();
    // Size, flags, rows, columns, bytes of a row.
    out.extend(words(&[124, 0x100f, 2, 2, 6, 0, 0]));
    out.extend([0; 44]);
    // The pixel format: RGB of 24 bits, and the masks of its channels.
    out.extend(words(&[32, 0x40, 0, 24, 0x00ff_0000, 0xff00, 0xff, 0]));
    out.extend(words(&[0x1000, 0, 0, 0, 0]));
    out.extend([20, 20, 220].repeat(4));
    out
}

/// One block of UASTC of a single colour.
fn ktx2() -> Vec<u8> {
    let mut out = b"\xabKTX 20\xbb\r\n\x1a\n".to_vec();
    // Format, type size, columns, rows, depth, layers, faces, levels, scheme.
    out.extend(words(&[0, 1, 4, 4, 0, 0, 1, 1, 0]));
    // Where the description of the format is, and its size; no keys and no global data.
    out.extend(words(&[104, 44, 0, 0, 0, 0, 0, 0]));
    out.extend([148u64.next_multiple_of(16), 16, 16].iter().flat_map(|n| n.to_le_bytes()));
    // Model 166 is UASTC, transfer 2 sRGB; a block has four columns and rows and sixteen bytes.
    out.extend(words(&[44, 0, 2 | 40 << 16]));
    out.extend([166, 1, 2, 0, 3, 3, 0, 0, 16, 0, 0, 0, 0, 0, 0, 0]);
    out.extend([0, 0, 127, 3, 0, 0, 0, 0]);
    out.extend(words(&[0, u32::MAX]));
    out.resize(160, 0);
    let solid: u128 = 0x17 | 220 << 5 | 20 << 13 | 20 << 21 | 255 << 29;
    out.extend(solid.to_le_bytes());
    out
}
