//! Layouts in the background, and uploads to the GPU, over several frames.

use super::*;

/// A renderer with background layouts, its frame, and the number of uploaded bytes.
#[derive(Default)]
struct Beside(FrameRenderer, Frame, u64);

impl Beside {
    /// Renders a frame. Returns the number of waiting images, and whether an image is drawn.
    fn render(&mut self, data: &MemoryFeed, pose: &Pose) -> (usize, bool) {
        let Self(renderer, frame, brought) = self;
        let view = view_of(&data.index, pose, &CAMERA, Method::Auto, &mut StageMs::default());
        let all: Vec<u32> = view.needed(&data.index, &Sight::new(pose, &CAMERA, 1)).all().collect();
        data.wait_for(&all, Duration::ZERO).expect("memory does not fail");
        let options = WalkOptions { background_layout: true, ..options(Pace::Realtime) };
        let frame_stats = renderer.render(&data.index, data, &view, pose, &CAMERA, &options, StageMs::default(), frame);
        let frame_stats = frame_stats.expect("quads by z");
        *brought = frame_stats.uploaded_bytes;
        assert!(frame_stats.missing_chunks.is_empty());
        assert_eq!(frame_stats.is_complete(), frame_stats.waiting == 0);
        (frame_stats.waiting, frame.count(Source::Far) > 100)
    }

    fn wait_for_news(&self) {
        let begun = std::time::Instant::now();
        while !self.0.has_news() {
            assert!(begun.elapsed() < Duration::from_secs(60), "nothing was laid out");
            std::thread::sleep(Duration::from_millis(1));
        }
    }
}

const AHEAD: Pose = Pose { position: DVec3::new(0.05, 0.0, 0.0), yaw_deg: 0.0, pitch_deg: 0.0 };

#[test]
fn no_frame_waits_for_images_to_be_laid_out() {
    let mut data = scene();
    let mut renderer = Beside::default();
    assert_eq!(renderer.render(&data, &AHEAD), (1, false));
    renderer.wait_for_news();
    assert_eq!([(); 2].map(|()| renderer.render(&data, &AHEAD)), [(0, true); 2]);
    // Another layer arrives: until it is laid out the previous layout is drawn.
    let mut more = (*data.memory.ldis[&0]).clone();
    more.layers.push(more.layers[0].clone());
    data.memory.ldis.insert(0, Arc::new(more));
    assert_eq!(renderer.render(&data, &AHEAD), (1, true));
    renderer.wait_for_news();
    assert_eq!(renderer.render(&data, &AHEAD), (0, true));
}

#[test]
fn what_is_expected_is_laid_out_before_it_is_seen() {
    let data = scene();
    let away = Pose { yaw_deg: 180.0, ..AHEAD };
    let mut renderer = Beside::default();
    data.wait_for(&[2], Duration::ZERO).expect("memory does not fail");
    assert_eq!(renderer.render(&data, &away), (0, false));
    renderer.0.anticipate(Anticipated { images: vec![0], ..Anticipated::default() });
    assert_eq!(renderer.render(&data, &away), (0, false));
    renderer.wait_for_news();
    assert_eq!(renderer.render(&data, &AHEAD), (0, true));
}

/// [`scene`], the near square with a texture of 64 by 64 texels.
fn textured_scene() -> MemoryFeed {
    let mut data = scene();
    let rgba = (0..64 * 64).map(|i| [255, 4 * (i % 64) as u8, 4 * (i / 64) as u8, 255]).collect();
    let texture = Texture::from_base(MipLevel { width: 64, height: 64, rgba }, false);
    data.memory.textures.insert(0, Arc::new(texture));
    let index = &mut data.index;
    index.materials[0].texture = Some(0);
    let chunk = TextureChunk { chunk: index.chunks.len() as u32, first_level: 0, last_level: 6 };
    index.chunks.push(ChunkEntry { hash: ChunkHash([11; 32]), kind: ChunkKind::Texture, ..index.chunks[0] });
    index.textures.push(TextureEntry { width: 64, height: 64, chunks: vec![chunk] });
    data
}

/// Of the near square's texture level 0 is absent: at 2 m a pixel is 3.9 texels wide, a sample of
/// four 1.9.
#[test]
fn an_absent_level_is_missing_where_it_could_show() {
    let mut data = textured_scene();
    let index = &mut data.index;
    let coarse = TextureChunk { first_level: 1, ..index.textures[0].chunks[0] };
    let fine = TextureChunk { chunk: index.chunks.len() as u32, first_level: 0, last_level: 0 };
    index.chunks.push(index.chunks[coarse.chunk as usize]);
    index.textures[0].chunks = vec![coarse, fine];
    let mut texture = (*data.memory.textures[&0]).clone();
    texture.levels[0] = None;
    data.memory.textures.insert(0, Arc::new(texture));
    let mut missing = |density: i8, supersample| {
        data.index.cells[0].texel_density = vec![density];
        let options = WalkOptions { supersample, ..options(Pace::Realtime) };
        render(&data, &AHEAD, &options).1.missing_chunks
    };
    // 64 texels on 0.6 m.
    let density = (4.0 * f64::log2(64.0 / 0.6)) as i8;
    assert_eq!([1, 2].map(|n| missing(density, n)), [vec![], vec![fine.chunk]]);
    assert_eq!(missing(EVERY_LEVEL, 1), [fine.chunk]);
}

/// With a small upload budget the GPU gets a picture's data over several frames, and then draws
/// what the CPU draws; nothing is uploaded twice.
#[test]
fn no_picture_puts_more_onto_the_card_than_it_may() {
    const ALLOWED: u64 = 3000;
    let Some(mut on_card) = on_card() else { return };
    on_card.upload_budget_bytes = Some(ALLOWED);
    let data = textured_scene();
    let mut renderer = Beside(on_card, Frame::default(), 0);
    let (mut pictures, mut waited_for, mut brought, mut centres) = (0, Vec::new(), 0, Vec::new());
    loop {
        let (waiting, _) = renderer.render(&data, &AHEAD);
        centres.push(colour_at(&renderer.1, 31, 24));
        // Up to a row of the texture.
        assert!(renderer.2 <= ALLOWED + 255, "{} bytes in picture {pictures}", renderer.2);
        (pictures, brought) = (pictures + 1, brought + renderer.2);
        waited_for.push(waiting);
        if waiting == 0 {
            break;
        }
        renderer.wait_for_news();
    }
    assert!(brought > 5 * ALLOWED && pictures > 5, "{brought} bytes in {pictures} pictures");
    assert_eq!(waited_for[0], 2, "the image and the texture");
    assert!(waited_for.is_sorted_by(|a, b| a >= b), "{waited_for:?}");
    let [grey, red] = [centres[0], centres[centres.len() - 1]];
    assert!(red == [255, 0, 0] && grey[0] < 250, "as long as its texture is on the way: {centres:?}");
    let mut theirs = Beside::default();
    theirs.render(&data, &AHEAD);
    theirs.wait_for_news();
    assert_eq!(theirs.render(&data, &AHEAD), (0, true));
    assert!(differing(&renderer.1, &theirs.1) <= 8, "{}", differing(&renderer.1, &theirs.1));
    renderer.render(&data, &Pose { yaw_deg: 180.0, ..AHEAD });
    assert_eq!((renderer.render(&data, &AHEAD), renderer.2), ((0, true), 0));
}

#[test]
fn what_is_expected_is_on_the_card_before_it_is_seen() {
    let Some(mut on_card) = on_card() else { return };
    on_card.upload_budget_bytes = Some(3000);
    let data = textured_scene();
    let away = Pose { yaw_deg: 180.0, ..AHEAD };
    let view = view_of(&data.index, &AHEAD, &CAMERA, Method::Auto, &mut StageMs::default());
    data.wait_for(&view.needed(&data.index, &Sight::new(&AHEAD, &CAMERA, 1)).all().collect::<Vec<_>>(), Duration::ZERO)
        .expect("memory");
    let mut renderer = Beside(on_card, Frame::default(), 0);
    let mut brought = 0;
    for picture in 0.. {
        renderer.0.anticipate(Anticipated { images: view.images.clone(), cells: view.cells.clone() });
        assert_eq!(renderer.render(&data, &away).0, 0, "of what is seen nothing is missing");
        brought += renderer.2;
        if renderer.2 == 0 && brought > 0 {
            break;
        }
        assert!(picture < 60_000, "nothing was brought");
        if brought == 0 {
            std::thread::sleep(Duration::from_millis(1));
        }
    }
    assert_eq!((renderer.render(&data, &AHEAD), renderer.2), ((0, true), 0));
}

/// [`scene`] with a second view cell, around z = -1: its image is chunk 3, and everything looks as
/// from the first one.
fn two_view_cells() -> MemoryFeed {
    let mut data = scene();
    let index = &mut data.index;
    index.settings.grid = CELLS.into();
    let users = |z: [f64; 2]| Aabb { min: DVec3::new(-0.25, -0.25, z[0]), max: DVec3::new(0.25, 0.25, z[1]) };
    index.chunks.push(ChunkEntry { hash: ChunkHash([10; 32]), ..index.chunks[2] });
    index.images.push(ImageEntry { chunks: vec![3], ..index.images[0].clone() });
    index.placements[0].users = users([-0.5, 0.5]);
    index.placements.push(Placement {
        grid_point: Some(1),
        users: users([-2.5, -0.5]),
        images: 1..2,
        ..index.placements[0].clone()
    });
    let ahead = AngularRange { yaw_start_deg: 0.0, placement: Some(1) };
    index.points[0].position = DVec3::ZERO;
    index.points.push(GridPoint { position: DVec3::NEG_Z, bands: vec![vec![ahead]], ..index.points[0].clone() });
    let ldi = data.memory.ldis[&0].clone();
    data.memory.ldis.insert(1, ldi);
    data
}

#[test]
fn the_placement_before_stands_in_near_its_users_and_within_the_budget() {
    let at = |z: f64| Pose { position: DVec3::new(0.05, 0.0, z), ..AHEAD };
    let (begun, beyond, far_off) = (at(0.0), at(-0.6), at(-1.85));
    let mut data = two_view_cells();
    data.lost = BTreeSet::from([3]);
    let mut renderer = FrameRenderer::default();
    let mut frame = Frame::default();
    let mut paint = |data: &MemoryFeed, pose: &Pose| {
        let view = view_of(&data.index, pose, &CAMERA, Method::Auto, &mut StageMs::default());
        data.wait_for(
            &view.needed(&data.index, &Sight::new(pose, &CAMERA, 1)).all().collect::<Vec<_>>(),
            Duration::ZERO,
        )
        .expect("memory");
        let options = options(Pace::Realtime);
        let frame_stats =
            renderer.render(&data.index, data, &view, pose, &CAMERA, &options, StageMs::default(), &mut frame);
        let frame_stats = frame_stats.expect("quads by z");
        assert_eq!(frame_stats.is_complete(), frame_stats.missing_chunks.is_empty());
        (frame_stats.fallback, frame_stats.missing_chunks, frame.count(Source::Unpainted))
    };
    assert_eq!(paint(&data, &begun), (None, vec![], 0));
    assert_eq!(paint(&data, &beyond), (Some(0), vec![3], 0));
    let (fallback, missing, _) = paint(&data, &far_off);
    assert_eq!((fallback, missing), (None, vec![3]), "1.35 m from its users, a quarter of 5 m allowed");
    // All it replaces would be geometry: four triangles, and the budget is three.
    let culled = std::mem::take(&mut data.index.placements[0].culled);
    assert_eq!(paint(&data, &beyond).0, None);
    data.index.placements[0].culled = culled;
    assert_eq!(paint(&data, &beyond).0, Some(0));
    // Without images nothing says how far it may be used.
    let images = std::mem::replace(&mut data.index.placements[0].images, 0..0);
    assert_eq!(paint(&data, &beyond).0, None);
    data.index.placements[0].images = images;
    assert_eq!(paint(&data, &beyond).0, Some(0));
    // It has come: the view itself, which from now on is what stands in.
    data.lost.clear();
    assert_eq!(paint(&data, &beyond), (None, vec![], 0));
    data.state().0.retain(|c| *c != 2);
    data.lost = BTreeSet::from([2]);
    assert_eq!(paint(&data, &at(-0.45)), (Some(1), vec![2], 0));
}

#[test]
fn the_placement_before_stands_in_while_images_are_laid_out() {
    let data = two_view_cells();
    let mut renderer = Beside::default();
    assert_eq!(renderer.render(&data, &AHEAD), (1, false));
    renderer.wait_for_news();
    assert_eq!(renderer.render(&data, &AHEAD), (0, true));
    let beyond = Pose { position: DVec3::new(0.05, 0.0, -0.6), ..AHEAD };
    assert_eq!(renderer.render(&data, &beyond), (1, true));
    renderer.wait_for_news();
    assert_eq!(renderer.render(&data, &beyond), (0, true));
}
