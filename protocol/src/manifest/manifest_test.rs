//! Round trips of indices, broken rules, damage.

use super::*;
use crate::{
    Aabb, CellRuns, OutputCamera, ViewBasis,
    index::{
        AngularRange, CellEntry, CellLevel, ChunkEntry, ChunkKind, GridPoint, ImageEntry, Placement, TextureChunk,
        TextureEntry,
    },
    mesh::{Alpha, Material, Wrap},
    room_index::{BuiltImages, RoomIndex, SideImages},
    rooms::{Cell, Portal, PortalKind, Rooms},
    sky::SkyMap,
    tree::{Tree, TreeNode},
    volume::WalkVolume,
};
use glam::DVec3;
use proptest::prelude::*;

fn hash(i: usize) -> ChunkHash {
    ChunkHash(blake3::hash(&i.to_le_bytes()).into())
}

/// An index with `n` cells, one bundle, one texture of three levels, `n` placements of `n / 2 + 1`
/// points.
fn index(n: usize) -> Index {
    let bounds = Aabb { min: DVec3::splat(-1.5), max: DVec3::splat(2.25) };
    let kind = |i: usize| match i {
        0 => ChunkKind::Bundle,
        1 => ChunkKind::Texture,
        i if i < n + 2 => ChunkKind::Cell,
        i if i < 2 + 3 * n => ChunkKind::Ldi,
        i if i < 2 + 3 * n + 2 => ChunkKind::Tree,
        _ => ChunkKind::Levels,
    };
    // The last two hold levels of detail.
    let level_chunk = |k: usize| (2 + 3 * n + 2 + k) as u32;
    let chunks = (0..2 + 3 * n + 4)
        .map(|i| ChunkEntry {
            hash: hash(i),
            stored_bytes: 100 + i as u32,
            decoded_bytes: 1 << (i % 20),
            kind: kind(i),
        })
        .collect();
    let points = n / 2 + 1;
    let bands_deg = vec![-60.0, -20.0, 20.0, 60.0];
    Index {
        scene: SceneInfo { name: "test".into(), triangles: 7, unique_triangles: 5, instances: 2, bounds },
        settings: BuildSettings {
            budget: 1000,
            optimize_budget: 900,
            camera: OutputCamera { width: 1280, height: 720, fov_deg: 60.0 },
            max_footprint_px: 2.0,
            max_deviation_px: 0.5,
            pitch_deg: 60.0,
            density: 1.0,
            colour: "high".into(),
            grid: "paper".into(),
            eye_height_m: Some(1.6),
        },
        chunks,
        cells: (0..n)
            .map(|i| CellEntry {
                bounds: Aabb {
                    min: DVec3::splat(f64::from(i as f32 * 0.3 - 2.0)),
                    max: DVec3::splat(f64::from(i as f32 * 0.3)),
                },
                triangles: 17 * i as u32,
                chunk: 2 + i as u32,
                bundles: if i % 2 == 0 { vec![0] } else { vec![] },
                materials: vec![0, 1],
                texel_density: vec![-3, 40],
                levels: (0..(17 * i).min(i % 4))
                    .map(|k| CellLevel {
                        deviation_m: f64::from((k + 1) as f32 * 0.1),
                        triangles: (17 * i - k - 1) as u32,
                        chunk: level_chunk(k % 2),
                        instances: (i * k) as u32..(i * k + 3) as u32,
                        bundles: if k == 1 { vec![0] } else { vec![] },
                    })
                    .collect(),
            })
            .collect(),
        materials: vec![
            Material {
                base_colour: [0.1, 0.2, 0.3, 1.0],
                texture: Some(0),
                alpha: Alpha::Mask(0.5),
                unlit: false,
                double_sided: true,
                wrap: [Wrap::Repeat, Wrap::Clamp],
            };
            2
        ],
        textures: vec![TextureEntry {
            width: 4,
            height: 3,
            chunks: vec![
                TextureChunk { chunk: 1, first_level: 1, last_level: 2 },
                TextureChunk { chunk: 1, first_level: 0, last_level: 0 },
            ],
        }],
        pitch_bands_deg: bands_deg,
        points: (0..points)
            .map(|i| GridPoint {
                position: DVec3::new(i as f64 / 3.0, 1.0, -2.0),
                level: (i % 3) as u8,
                radius: 1.0 / 3.0 + i as f64,
                bands: (0..3)
                    .map(|b| {
                        (0..(i + b) % 4)
                            .map(|k| AngularRange {
                                yaw_start_deg: k as f64 * 77.7,
                                placement: (n > 0 && k != 1).then(|| ((i * 5 + k) % n.max(1)) as u32),
                            })
                            .collect()
                    })
                    .collect(),
            })
            .collect(),
        placements: (0..n)
            .map(|i| Placement {
                grid_point: (i + 1 < n || n < 2).then_some((i % points) as u32),
                cop: DVec3::new(0.1, 1.7, i as f64),
                culled: (0..n as u32).filter(|c| c % 7 < 4).collect(),
                footprint_px: 1.7,
                users: bounds,
                images: images_before(i)..images_before(i + 1),
                sky: SkyMap::of_runs((0..i as u32 % 3).map(|k| [9 + 700 * k, 1 + k * 300]).collect()).expect("apart"),
            })
            .collect(),
        images: (0..images_before(n) as usize)
            .map(|i| ImageEntry {
                basis: ViewBasis::from_yaw_pitch(i as f64 * 31.0, 10.0),
                plane_distance: 3.1 + i as f64,
                window: [-0.5, 0.25 + i as f64, -1.0 / 3.0, 0.1],
                stretch_p99_px: 0.1 * i as f64,
                chunks: vec![(2 + n + 2 * (i % n)) as u32, (3 + n + 2 * (i % n)) as u32],
                samples_by_layer: vec![100_000, 20_000, 17],
            })
            .collect(),
        volume: WalkVolume::of_box(&bounds).ok(),
        tree: Some(tree(2 + 3 * n as u32)),
        rooms: Some(rooms(n)),
        plans: (0..n.min(3)).map(|_| crate::floor_plan::tests::hall()).collect(),
    }
}

/// Two rooms and two portals; with enough placements the last of them is a portal's.
fn rooms(n: usize) -> RoomIndex {
    let room = |name: &str, x: f64| Cell {
        name: name.into(),
        boxes: vec![
            Aabb { min: DVec3::new(x, 0.0, 0.1), max: DVec3::new(x + 3.0, 2.5, 4.0) },
            Aabb { min: DVec3::new(x, 0.0, -1.0 / 3.0), max: DVec3::new(x + 1.0, 2.5, 0.1) },
        ],
    };
    let door = |x: f64| [(0.0, 1.0), (0.0, 2.0), (2.1, 2.0), (2.1, 1.0)].map(|(y, z)| DVec3::new(x, y, z)).to_vec();
    let portals = vec![
        Portal { cells: [Some(0), Some(1)], kind: PortalKind::Door, corners: door(3.0) },
        Portal { cells: [Some(1), None], kind: PortalKind::Given, corners: door(6.0) },
    ];
    let last = n as u32;
    let own = if n < 2 { last..last } else { last - 1..last };
    // Placements of reference images have one image: every third one has.
    let paper = n % 3 == 2;
    let side = SideImages { references: last.saturating_sub(1)..last, central: last.saturating_sub(1), layered: None };
    let layered = SideImages { layered: Some(side.central), ..side.clone() };
    let sides = [[SideImages::default(), layered], [side, SideImages::default()]];
    RoomIndex {
        rooms: Rooms::new(0.15, vec![room("kitchen", 0.0), room("hall \u{e4}", 3.0)], portals).expect("sound"),
        near_m: 1.25,
        cells_of: vec![(0..last).filter(|c| c % 3 < 2).collect(), vec![], (last / 2..last).collect()],
        placements: vec![[0..0, own], [0..0, 0..0]],
        built: if paper { BuiltImages::Both } else { BuiltImages::Ours },
        sides: if paper { sides.to_vec() } else { vec![] },
        by_grid: if n % 2 == 1 { vec![false, true, false] } else { vec![] },
    }
}

/// A root with two children, and the sky of two places.
fn tree(first_chunk: u32) -> Tree {
    let node = |cell: [u16; 3]| TreeNode {
        level: 1,
        cell,
        samples: 900,
        unfiltered: 17,
        first_child: 0,
        children: 0,
        chunk: 0,
    };
    let root = TreeNode { level: 0, first_child: 1, children: 2, chunk: first_chunk + 1, ..node([0; 3]) };
    Tree {
        origin: DVec3::new(-1.0 / 3.0, 2.0, 1e6),
        edge_m: 10.0 / 3.0,
        root_chunk: first_chunk,
        pinned_levels: 1,
        nodes: vec![root, node([1, 0, 0]), node([0, 1, 1])],
    }
}

/// Placements have no, one, two images in turn.
fn images_before(placement: usize) -> u32 {
    (0..placement as u32).map(|p| p % 3).sum()
}

fn decode(e: &Encoded) -> Result<Index, CodecError> {
    assemble(&decode_root(&e.root)?, &e.pages)
}

#[test]
fn an_index_comes_back_exactly() {
    for n in [0, 1, 3, 5, 2500] {
        let original = index(n);
        let encoded = encode(&original).unwrap();
        assert!(encoded.root.len() < 8000, "{} entries, root of {} bytes", n, encoded.root.len());
        assert_eq!(decode(&encoded).unwrap(), original);
        assert_eq!(encode(&original).unwrap(), encoded, "encoding is deterministic");
    }
}

/// The pages of a manifest as they arrive, in the order in which they are sent, and how many are
/// enough.
fn arriving(root: &Root, encoded: &Encoded, tree: Option<&Tree>) -> (Vec<u32>, usize, Vec<Option<Vec<u8>>>) {
    let (order, enough) = root.sending_order(tree);
    let mut sorted = order.clone();
    sorted.sort_unstable();
    assert!(sorted.into_iter().eq(0..encoded.pages.len() as u32), "every page once: {order:?}");
    (order, enough, vec![None; encoded.pages.len()])
}

#[test]
fn a_few_pages_are_enough_for_a_first_picture() {
    let original = index(2500);
    let encoded = encode(&original).unwrap();
    let root = decode_root(&encoded.root).unwrap();
    let (order, enough, mut pages) = arriving(&root, &encoded, original.tree.as_ref());
    // One page of chunks of eight, the volume, the tree's two.
    assert_eq!((enough, encoded.pages.len()), (4, 24));
    for (n, page) in order[..enough].iter().enumerate() {
        assert_eq!(early(&root, &pages).unwrap(), None, "{n} pages");
        pages[*page as usize] = Some(encoded.pages[*page as usize].clone());
    }
    let part = early(&root, &pages).unwrap().expect("enough");
    assert_eq!(part.tree.as_ref().unwrap().pinned_chunks().count(), 1);
    assert_eq!((&part.tree, &part.volume), (&original.tree, &original.volume));
    assert_eq!((&part.settings, &part.scene), (&original.settings, &original.scene));
    assert_eq!(part.chunks.len(), original.chunks.len());
    let pinned: Vec<u32> = part.tree.as_ref().unwrap().pinned_chunks().collect();
    for (number, (ours, theirs)) in (0u32..).zip(part.chunks.iter().zip(&original.chunks)) {
        let unknown = ours.kind == ChunkKind::Page && ours.stored_bytes == 0;
        assert!(if pinned.contains(&number) { ours == theirs } else { unknown }, "chunk {number}: {ours:?}");
    }
    assert!(!part.is_whole() && original.is_whole());
    assert!(part.cells.is_empty() && part.points.is_empty() && part.images.is_empty() && part.rooms.is_none());
    // A damaged page is no part of anything.
    let first = order[0] as usize;
    pages[first].as_mut().unwrap()[9] ^= 1;
    assert!(early(&root, &pages).is_err());
}

#[test]
fn without_a_tree_nothing_is_early() {
    let original = Index { tree: None, ..index(5) };
    let encoded = encode(&original).unwrap();
    let root = decode_root(&encoded.root).unwrap();
    let (_, enough, pages) = arriving(&root, &encoded, None);
    assert_eq!(enough, pages.len());
    let all: Vec<_> = encoded.pages.iter().cloned().map(Some).collect();
    assert_eq!(early(&root, &all).unwrap(), None);
}

#[test]
fn what_is_early_keeps_the_rules_too() {
    for damage in
        [|i: &mut Index| i.chunks[8].kind = ChunkKind::Ldi, |i: &mut Index| i.chunks[8].decoded_bytes = u32::MAX]
    {
        let mut original = index(2);
        assert_eq!(original.tree.as_ref().unwrap().root_chunk, 8);
        damage(&mut original);
        let pages = |kind, n| pages::encode(&original, kind, 0..n, LEVEL).unwrap();
        let stored: Vec<_> =
            [(PageKind::Chunks, 10), (PageKind::Volume, 1), (PageKind::Tree, 1), (PageKind::TreeNodes, 3)]
                .map(|(kind, n)| (kind, n, pages(kind, n)))
                .into();
        let mut root = decode_root(&encode(&index(2)).unwrap().root).unwrap();
        root.pages = stored
            .iter()
            .map(|(kind, n, bytes)| PageEntry {
                kind: *kind,
                first: 0,
                count: *n as u32,
                hash: ChunkHash(blake3::hash(bytes).into()),
                stored_bytes: bytes.len() as u32,
            })
            .collect();
        let held: Vec<_> = stored.into_iter().map(|(_, _, bytes)| Some(bytes)).collect();
        assert!(early(&root, &held).is_err());
    }
}

#[test]
fn unknown_stretch_and_no_volume_come_back() {
    let mut original = index(2);
    original.images[0].stretch_p99_px = f64::NAN;
    original.volume = None;
    original.tree = None;
    original.rooms = None;
    original.placements.iter_mut().for_each(|p| p.grid_point = Some(0));
    let out = decode(&encode(&original).unwrap()).unwrap();
    assert!(out.images[0].stretch_p99_px.is_nan());
    assert_eq!(out.volume, None);
    assert_eq!(out.tree, None);
    assert_eq!(out.rooms, None);
}

#[test]
fn bounds_that_are_not_f32_are_refused() {
    let mut i = index(2);
    i.cells[0].bounds.max.x = 0.1;
    assert!(matches!(encode(&i), Err(CodecError::Range { field: "cell bounds", .. })));
}

#[test]
fn every_broken_rule_is_named() {
    type Break = fn(&mut Index);
    let breaks: [(&str, Break); 46] = [
        ("chunk", |i| i.chunks[3].kind = ChunkKind::Page),
        ("cell", |i| i.cells[1].chunk = 0),
        ("tree", |i| i.tree.as_mut().unwrap().root_chunk = 0),
        ("tree", |i| i.tree.as_mut().unwrap().nodes[2].level = 7),
        ("cell", |i| i.cells[1].chunk = 9999),
        ("cell", |i| i.cells[0].bundles = vec![2]),
        ("cell", |i| i.cells[3].levels[0].chunk = 0),
        ("cell", |i| i.cells[3].levels[1].bundles = vec![2]),
        ("cell", |i| i.cells[3].levels.swap(0, 1)),
        ("cell", |i| i.cells[3].levels[0].triangles = 51),
        ("cell", |i| i.cells[3].levels[2].deviation_m = f64::INFINITY),
        ("cell", |i| i.cells[3].levels[0].instances = std::ops::Range { start: 2, end: 1 }),
        ("cell", |i| i.cells[0].materials = vec![1, 0]),
        ("cell", |i| i.cells[0].materials = vec![2]),
        ("cell", |i| i.cells[0].bounds.min.x = f64::NAN),
        ("material", |i| i.materials[0].texture = Some(1)),
        ("material", |i| i.materials[0].base_colour[2] = f32::INFINITY),
        ("texture", |i| i.textures[0].width = 0),
        ("texture", |i| i.textures[0].chunks.truncate(1)),
        ("texture", |i| i.textures[0].chunks.swap(0, 1)),
        ("pitch bands", |i| i.pitch_bands_deg.swap(0, 1)),
        ("grid point", |i| i.points[0].position.y = f64::NAN),
        ("grid point", |i| i.points[1].bands[1][0].placement = Some(99)),
        ("grid point", |i| i.points[1].bands[1][0].yaw_start_deg = 360.0),
        ("grid point", |i| i.points[1].bands[1][1].yaw_start_deg = 0.0),
        ("placement", |i| i.placements[2].grid_point = Some(50)),
        ("placement", |i| i.placements[2].culled = CellRuns::below(6)),
        ("placement", |i| i.placements[2].images.start += 1),
        ("placement", |i| i.placements[1].cop.x = f64::NAN),
        ("rooms", |i| i.rooms.as_mut().unwrap().cells_of[0] = vec![2, 1]),
        ("rooms", |i| i.rooms.as_mut().unwrap().cells_of[2] = vec![5]),
        ("rooms", |i| i.rooms.as_mut().unwrap().cells_of.truncate(2)),
        ("rooms", |i| i.rooms.as_mut().unwrap().near_m = f64::NAN),
        ("rooms", |i| i.rooms.as_mut().unwrap().placements[1][0] = 4..9),
        ("rooms", |i| i.rooms.as_mut().unwrap().placements[1][0] = 0..1),
        ("rooms", |i| i.rooms.as_mut().unwrap().placements.truncate(1)),
        ("rooms", |i| i.rooms.as_mut().unwrap().built = BuiltImages::Ours),
        ("rooms", |i| i.rooms.as_mut().unwrap().sides.truncate(1)),
        ("rooms", |i| i.rooms.as_mut().unwrap().sides[0][1].references.end += 1),
        ("rooms", |i| i.rooms.as_mut().unwrap().sides[0][1].central = 0),
        ("rooms", |i| i.rooms.as_mut().unwrap().sides[0][1].layered = Some(2)),
        ("rooms", |i| i.rooms.as_mut().unwrap().sides[0][0].layered = Some(4)),
        ("image", |i| i.images.push(i.images[0].clone())),
        ("image", |i| i.images[2].basis.up = DVec3::X),
        ("image", |i| i.images[2].window[3] = f64::INFINITY),
        ("image", |i| i.images[2].chunks = vec![1]),
    ];
    validate(&index(5)).unwrap();
    for (k, (wanted, damage)) in breaks.into_iter().enumerate() {
        let mut i = index(5);
        damage(&mut i);
        match validate(&i) {
            Err(CodecError::Mismatch { field, .. }) => assert_eq!(field, wanted, "rule {k}"),
            other => panic!("rule {k}, about a {wanted}: {other:?}"),
        }
        assert!(encode(&i).is_err());
    }
}

#[test]
fn every_flipped_bit_of_root_and_pages_is_noticed() {
    let encoded = encode(&index(4)).unwrap();
    for at in 0..encoded.root.len() {
        let mut damaged = encoded.clone();
        damaged.root[at] ^= 1 << (at % 8);
        assert!(decode(&damaged).is_err(), "root byte {at}");
        assert!(decode_root(&encoded.root[..at]).is_err(), "root cut at {at}");
    }
    let root = decode_root(&encoded.root).unwrap();
    for (k, page) in encoded.pages.iter().enumerate() {
        for at in (0..page.len()).step_by(3) {
            let mut pages = encoded.pages.clone();
            pages[k][at] ^= 1 << (at % 8);
            assert!(assemble(&root, &pages).is_err(), "page {k} byte {at}");
        }
    }
    assert!(assemble(&root, &encoded.pages[1..]).is_err());
}

#[test]
fn what_all_pages_hold_together_is_bounded() {
    let encoded = encode(&index(40)).unwrap();
    let root = decode_root(&encoded.root).unwrap();
    let with = |mut room: pages::Room| {
        let mut index = Index { chunks: vec![], cells: vec![], materials: vec![], textures: vec![], ..index(0) };
        (index.points, index.placements, index.images) = (vec![], vec![], vec![]);
        let pages = root.pages.iter().zip(&encoded.pages);
        let done = pages.map(|(e, p)| pages::decode_into(&mut index, e, p, &mut room)).find(Result::is_err);
        (done.is_none(), room)
    };
    let all = pages::Room::of_index();
    let room = |bytes, decoded| pages::Room { bytes, decoded, ..pages::Room::of_index() };
    let (fine, left) = with(pages::Room::of_index());
    let (bytes, decoded) = (all.bytes - left.bytes, all.decoded - left.decoded);
    assert!(fine && bytes > 1000 && decoded > bytes, "{bytes} bytes, {decoded} decoded");
    // What each page holds alone would fit.
    assert!(with(room(bytes, decoded)).0);
    assert!(!with(room(bytes - 1, decoded)).0);
    assert!(!with(room(bytes, decoded - 1)).0);
    // And nothing of that size is fetched.
    let mut huge = root.clone();
    huge.pages.iter_mut().for_each(|p| p.stored_bytes = 40 << 20);
    assert!(huge.check_pages().is_err() && root.check_pages().is_ok());
}

/// Damage that the hashes would catch, seen by the decoders alone: never a panic.
#[test]
fn forged_pages_never_panic() {
    let encoded = encode(&index(40)).unwrap();
    let root = decode_root(&encoded.root).unwrap();
    let empty = || Index {
        chunks: vec![],
        cells: vec![],
        materials: vec![],
        textures: vec![],
        points: vec![],
        placements: vec![],
        images: vec![],
        volume: None,
        tree: Some(Tree { nodes: vec![], ..tree(2) }),
        ..index(0)
    };
    for (entry, page) in root.pages.iter().zip(&encoded.pages) {
        for n in 0..page.len() {
            assert!(
                pages::decode_into(&mut empty(), entry, &page[..n], &mut pages::Room::of_index()).is_err(),
                "{:?} cut at {n}",
                entry.kind
            );
        }
        for k in 0..2000usize {
            let mut damaged = page.clone();
            damaged[k * 7919 % page.len()] ^= 1 + (k * 31 % 255) as u8;
            let _ = pages::decode_into(&mut empty(), entry, &damaged, &mut pages::Room::of_index());
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]
    #[test]
    fn any_set_of_cells_comes_back(culled in proptest::collection::vec(0u32..3000, 0..400)) {
        let mut original = index(3000);
        original.placements.truncate(1);
        original.images.clear();
        original.points.clear();
        original.points.push(GridPoint { position: DVec3::ZERO, level: 0, radius: 1.0, bands: vec![] });
        original.placements[0].culled = culled.into_iter().collect();
        original.rooms = None;
        prop_assert_eq!(decode(&encode(&original).unwrap()).unwrap(), original);
    }
    #[test]
    fn any_bytes_are_survived(bytes in proptest::collection::vec(any::<u8>(), 0..200)) {
        let mut root = b"LDM\x02".to_vec();
        root.extend(bytes);
        let checksum = blake3::hash(&root);
        root.extend(checksum.as_bytes());
        let _ = decode_root(&root);
    }
}
