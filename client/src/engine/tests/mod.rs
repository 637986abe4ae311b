//! Walks through a dataset in memory: no network, no server.

use super::*;
use crate::{
    cache::{Cache, Incomplete, fixture::street},
    composite::Fill,
    frame::{Frame, Source, unpack_rgb},
    gpu::{Gpu, GpuError},
    report::StageMs,
    resident::Resident,
    test_support::{Memory, dataset, plain_material, quad_cluster},
    warp::{Order, Stamp},
};
use glam::{DVec3, Vec3};
use ldi_protocol::{
    Aabb, OutputCamera, Pose, ViewBasis,
    index::{
        AngularRange, CELLS, ChunkEntry, ChunkHash, ChunkKind, DrawnCell, EVERY_LEVEL, GridPoint, ImageEntry, Index,
        Placement, TextureChunk, TextureEntry,
    },
    ldi::{DisparityCodes, LINK_DOWN, LINK_RIGHT, Ldi, LdiCamera, LdiLayer, Segment},
    mesh::{CellGeometry, Material},
    need::{Needed, Sight},
    path::{self, Walk},
    texture::{MipLevel, Texture},
    tree::Brood,
};
use std::{
    collections::BTreeSet,
    path::PathBuf,
    sync::{
        Arc, Mutex,
        atomic::{AtomicBool, Ordering},
    },
    time::Duration,
};

mod background_layout;

const CAMERA: OutputCamera = OutputCamera { width: 64, height: 48, fov_deg: 60.0 };
/// Stored bytes of every chunk.
const CHUNK_BYTES: u64 = 1000;

/// Chunks become resident when they are wanted and waited for.
struct MemoryFeed {
    index: Index,
    memory: Memory,
    /// Chunks that never arrive.
    lost: BTreeSet<u32>,
    /// Chunks that fit; the oldest goes when another comes.
    room: usize,
    /// Whether chunks arrive before anyone waits for them.
    pushes: bool,
    /// Waits after which the server is gone.
    gone_after: Option<usize>,
    /// Looks after which nothing is pushed any more, and how long the line is down then; None: it
    /// is up.
    dead_after: Option<(usize, Option<Duration>)>,
    looks: Mutex<usize>,
    /// Whether all waits are in vain though the line is up.
    starves: bool,
    waits: Mutex<usize>,
    state: Mutex<(Vec<u32>, u64)>,
}

impl MemoryFeed {
    fn new(index: Index, memory: Memory) -> Self {
        Self {
            index,
            memory,
            lost: BTreeSet::new(),
            room: 100,
            pushes: true,
            gone_after: None,
            dead_after: None,
            looks: Mutex::default(),
            starves: false,
            waits: Mutex::default(),
            state: Mutex::default(),
        }
    }
    /// How long the line is down, if nothing is pushed any more.
    fn dead(&self) -> Option<Option<Duration>> {
        let (after, down) = self.dead_after?;
        (*self.looks.lock().expect("no test panics while it holds the lock") > after).then_some(down)
    }
    fn state(&self) -> std::sync::MutexGuard<'_, (Vec<u32>, u64)> {
        self.state.lock().expect("no test panics while it holds the lock")
    }
}

impl Resident for MemoryFeed {
    fn cell(&self, cell: u32) -> Option<Arc<CellGeometry>> {
        self.holds(self.index.cells[cell as usize].chunk).then(|| self.memory.cell(cell))?
    }
    fn bundle(&self, chunk: u32) -> Option<Arc<CellGeometry>> {
        self.memory.bundle(chunk)
    }
    fn texture(&self, texture: u32) -> Option<Arc<Texture>> {
        self.memory.texture(texture)
    }
    fn ldi(&self, image: u32) -> Option<Arc<Ldi>> {
        self.holds(*self.index.images[image as usize].chunks.first()?).then(|| self.memory.ldi(image))?
    }
    fn brood(&self, chunk: u32) -> Option<Arc<Brood>> {
        self.memory.brood(chunk)
    }
}

impl DataSource for MemoryFeed {
    fn index(&self) -> &Index {
        &self.index
    }
    fn dataset_hash(&self) -> String {
        "00".repeat(32)
    }
    fn update_view(&self, _: &Pose, needed: &Needed) {
        *self.looks.lock().expect("no test panics while it holds the lock") += 1;
        if self.pushes && self.dead().is_none() {
            assert_eq!(self.wait_for(&needed.all().collect::<Vec<_>>(), Duration::ZERO), Ok(()));
        }
    }
    fn request(&self, _: &[u32]) {}
    fn wait_for(&self, chunks: &[u32], _: Duration) -> Result<(), Incomplete> {
        let mut waits = self.waits.lock().expect("no test panics while it holds the lock");
        *waits += 1;
        if self.gone_after.is_some_and(|n| *waits > n) {
            return Err(Incomplete::Disconnected("the server is gone".into()));
        }
        if self.starves {
            return Err(Incomplete::Timeout(chunks.to_vec()));
        }
        let mut state = self.state();
        for chunk in chunks.iter().filter(|c| !self.lost.contains(c)) {
            if !state.0.contains(chunk) {
                state.0.push(*chunk);
                state.1 += CHUNK_BYTES;
            }
        }
        let surplus = state.0.len().saturating_sub(self.room);
        state.0.drain(..surplus);
        Ok(())
    }
    fn lost_reason(&self, patience: Duration) -> Option<String> {
        self.dead()?.filter(|down| *down > patience).map(|_| "the server is gone".into())
    }
    fn holds(&self, chunk: u32) -> bool {
        self.state().0.contains(&chunk)
    }
    fn traffic(&self) -> Traffic {
        let bytes = self.state().1;
        Traffic {
            elapsed_s: 1.0,
            bytes,
            wasted_bytes: 0,
            mbit_per_s_p99_1s: 1.0,
            cache_peak_bytes: 7,
            damaged_chunks: 0,
            chunks: bytes / CHUNK_BYTES,
        }
    }
}

fn quad(z: f32, half: f32, material: u32) -> ldi_protocol::mesh::Cluster {
    quad_cluster(
        material,
        [Vec3::new(-half, -half, z), Vec3::new(half, -half, z), Vec3::new(half, half, z), Vec3::new(-half, half, z)],
    )
}

fn coloured(base_colour: [f32; 4]) -> Material {
    Material { base_colour, ..plain_material() }
}

/// A red square at 2 m, a green one at 10 m, its image from the origin, and a grid point that uses
/// it when looking along -Z.
fn scene() -> MemoryFeed {
    let materials = vec![coloured([1.0, 0.0, 0.0, 1.0]), coloured([0.0, 1.0, 0.0, 1.0])];
    let (mut index, mut memory) = dataset(CAMERA, materials, vec![quad(-2.0, 0.3, 0), quad(-10.0, 3.0, 1)]);
    index.settings.budget = 3;
    let basis = ViewBasis::from_yaw_pitch(0.0, 0.0);
    // Pixels of the far square: |x| <= 3 at 10 m, 80 per unit: 48 x 48 centred.
    let camera =
        LdiCamera { cop: DVec3::ZERO, basis, pixels_per_unit: 80.0, left: -24, top: -24, width: 48, height: 48 };
    let layer = LdiLayer {
        segments: (0..48).map(|row| Segment { row, column_base: 0, first: u32::from(row) * 48, count: 48 }).collect(),
        column: (0..48 * 48).map(|i| (i % 48) as u8).collect(),
        disparity: vec![1; 48 * 48],
        rgb: vec![[0, 0, 255]; 48 * 48],
        links: (0..48 * 48)
            .map(|i| if i % 48 < 47 { LINK_RIGHT } else { 0 } | if i / 48 < 47 { LINK_DOWN } else { 0 })
            .collect(),
        ends: vec![],
        slopes: vec![],
    }
    .with_half_ends();
    let ldi = Ldi {
        camera,
        codes: DisparityCodes { smallest: 0.1, step: 0.001, largest_code: 2 },
        layers: vec![layer],
        sky: vec![0; 48],
        slivers: vec![],
    };
    memory.ldis.insert(0, Arc::new(ldi));
    index.chunks.push(ChunkEntry { hash: ChunkHash([9; 32]), stored_bytes: 1, decoded_bytes: 1, kind: ChunkKind::Ldi });
    for chunk in &mut index.chunks {
        chunk.stored_bytes = CHUNK_BYTES as u32;
    }
    index.pitch_bands_deg = vec![-60.0, 60.0];
    let range = |yaw_start_deg, placement| AngularRange { yaw_start_deg, placement };
    index.points.push(GridPoint {
        position: DVec3::new(0.0, 0.0, 0.5),
        level: 0,
        radius: 2.0,
        bands: vec![vec![range(0.0, Some(0)), range(90.0, None), range(270.0, Some(0))]],
    });
    index.placements.push(Placement {
        grid_point: Some(0),
        cop: DVec3::new(0.0, 0.0, 0.5),
        culled: [1].into_iter().collect(),
        footprint_px: 1.5,
        users: Aabb { min: DVec3::splat(-2.5), max: DVec3::splat(2.5) },
        images: 0..1,
        sky: Default::default(),
    });
    index.images.push(ImageEntry {
        basis,
        plane_distance: 5.0,
        window: [-0.3, 0.3, -0.3, 0.3],
        stretch_p99_px: 1.0,
        chunks: vec![2],
        samples_by_layer: vec![48 * 48],
    });
    MemoryFeed::new(index, memory)
}

fn options(pace: Pace) -> WalkOptions {
    WalkOptions {
        width: CAMERA.width,
        height: CAMERA.height,
        method: Method::Auto,
        cache_error_px: 2.0,
        stamp: Stamp::Quads,
        order: Order::Z,
        cull: Cull::Auto,
        fill: Fill::Surface,
        smooth: false,
        frame_ms: None,
        supersample: 1,
        pace,
        every: 2,
        cache_bytes: None,
        debug_views: true,
        shows: DisplayMode::Scene,
        appearance: Appearance::default(),
        background_layout: false,
        baseline_frames: 2,
    }
}

/// Five poses, a tenth of a metre apart, 10 ms apart.
fn five_poses() -> Walk {
    let poses: Vec<String> = (0..5)
        .map(|i| format!(r#"{{"t":{},"position":[{},0,0],"yaw":0}}"#, f64::from(i) * 0.01, f64::from(i) * 0.1 - 0.2))
        .collect();
    path::parse(&format!(r#"{{"poses":[{}]}}"#, poses.join(","))).expect("a path")
}

fn folder(name: &str) -> PathBuf {
    let folder = std::env::temp_dir().join(format!("ldi-walk-{name}-{}", std::process::id()));
    // Left over from a run that was killed.
    let _ = std::fs::remove_dir_all(&folder);
    folder
}

fn colour_at(frame: &Frame, x: u32, y: u32) -> [u8; 3] {
    unpack_rgb(frame.colour[(y * frame.width + x) as usize])
}

fn render(data: &MemoryFeed, pose: &Pose, options: &WalkOptions) -> (Frame, FrameStats, View) {
    let mut ms = StageMs::default();
    let view = view_of(&data.index, pose, &CAMERA, options.method, &mut ms);
    data.wait_for(
        &view.needed(&data.index, &Sight::new(pose, &CAMERA, options.supersample)).all().collect::<Vec<_>>(),
        Duration::ZERO,
    )
    .expect("memory does not fail");
    let mut frame = Frame::default();
    let frame_stats = FrameRenderer::default()
        .render(&data.index, data, &view, pose, &CAMERA, options, ms, &mut frame)
        .expect("quads by z");
    (frame, frame_stats, view)
}

#[test]
fn near_and_far_come_together() {
    let data = scene();
    let ahead = Pose { position: DVec3::new(0.05, 0.0, 0.0), yaw_deg: 0.0, pitch_deg: 0.0 };
    for supersample in [1, 2] {
        let options = WalkOptions { supersample, ..options(Pace::Wait) };
        let (frame, frame_stats, view) = render(&data, &ahead, &options);
        assert_eq!((frame.width, frame.height), (CAMERA.width, CAMERA.height));
        assert_eq!(
            (view.selection.placement, view.cells, view.triangles_in_frustum),
            (Some(0), DrawnCell::all_full([0]), 4)
        );
        assert_eq!((frame_stats.triangles, frame_stats.missing_chunks.len()), (2, 0));
        // The image is blue where the geometry is green: what is blue came from the warp.
        assert_eq!(
            (colour_at(&frame, 31, 24), colour_at(&frame, 18, 24), colour_at(&frame, 2, 2)),
            ([255, 0, 0], [0, 0, 255], [198, 214, 235])
        );
        assert_eq!(frame.count(Source::Unpainted), 0);
    }
    let geometry = WalkOptions { method: Method::Geometry, ..options(Pace::Wait) };
    let (frame, frame_stats, view) = render(&data, &ahead, &geometry);
    assert_eq!((view.selection.placement, view.cells, frame_stats.triangles), (None, DrawnCell::all_full(0..2), 4));
    assert_eq!((colour_at(&frame, 18, 24), frame_stats.warp.is_none()), ([0, 255, 0], true));
}

/// A painter on a card, or None with the reason on the screen where this machine has none that
/// could.
fn on_card() -> Option<FrameRenderer> {
    match Gpu::open() {
        Err(e @ (GpuError::NoAdapter(_) | GpuError::Lacking { .. })) => {
            eprintln!("SKIPPED: {e}");
            None
        }
        opened => Some(FrameRenderer::on(opened.expect("an adapter that draws"))),
    }
}

/// All changes of finished pictures.
const SHADED: Appearance = Appearance { depth_shading: true, horizon: true };
const SHADOWS: Appearance = Appearance { depth_shading: true, horizon: false };

/// Measured walks have neither shadows nor a horizon; the window has both, in scene colours alone.
#[test]
fn pictures_change_their_appearance_only_if_they_are_asked_to() {
    let data = scene();
    let pose = Pose { position: DVec3::new(0.13, 0.0, 0.0), yaw_deg: 4.0, pitch_deg: 0.0 };
    let rendered =
        |appearance, shows| render(&data, &pose, &WalkOptions { appearance, shows, ..options(Pace::Wait) }).0;
    let plain = rendered(Appearance::default(), DisplayMode::Scene);
    let shaded = rendered(SHADED, DisplayMode::Scene);
    let sky = |frame: &Frame| (0..frame.len()).filter(|i| frame.colour[*i] == crate::frame::SKY).count();
    assert!(sky(&plain) > 500 && sky(&shaded) < 100, "{} {}", sky(&plain), sky(&shaded));
    let surfaces = |i: &usize| matches!(plain.source[*i], Source::Near | Source::Far);
    let darker = (0..plain.len()).filter(surfaces).filter(|i| plain.colour[*i] != shaded.colour[*i]).count();
    let all = (0..plain.len()).filter(surfaces).count();
    assert!(darker > 20 && darker < all / 2, "{darker} of {all}: outlines, and not all of a flat square");
    assert!(plain.disparity == shaded.disparity && plain.source == shaded.source);
    let depth = |appearance| rendered(appearance, DisplayMode::Depth);
    assert!(depth(Appearance::default()) == depth(SHADED));
}

/// How many pixels of two pictures are more than a code apart.
fn differing(a: &Frame, b: &Frame) -> usize {
    let off = |(a, b): &(&u32, &u32)| {
        unpack_rgb(**a).into_iter().zip(unpack_rgb(**b)).map(|(a, b)| a.abs_diff(b)).max().unwrap_or(0) > 1
    };
    a.colour.iter().zip(&b.colour).filter(off).count()
}

/// A card joins a frame that lacks nothing; what is missing, debug views and what only the
/// processor does are the processor's. The pictures are the same.
#[test]
fn a_card_joins_what_it_drew() {
    let Some(mut on_card) = on_card() else { return };
    let data = scene();
    let background_layout = Pose { position: DVec3::new(0.13, 0.0, 0.0), yaw_deg: 4.0, pitch_deg: 0.0 };
    let plain = options(Pace::Wait);
    let cases = [
        (plain.clone(), true, true),
        (WalkOptions { supersample: 2, ..plain.clone() }, true, true),
        (WalkOptions { fill: Fill::Off, ..plain.clone() }, true, true),
        (WalkOptions { appearance: SHADED, ..plain.clone() }, true, true),
        // The card's pictures get their sky after the averaging.
        (WalkOptions { appearance: SHADOWS, supersample: 2, ..plain.clone() }, true, true),
        (WalkOptions { method: Method::Geometry, ..plain.clone() }, true, true),
        (WalkOptions { fill: Fill::Last, ..plain.clone() }, true, false),
        (WalkOptions { smooth: true, ..plain.clone() }, true, false),
        (WalkOptions { stamp: Stamp::Ewa, ..plain.clone() }, true, false),
        (WalkOptions { shows: DisplayMode::Depth, ..plain.clone() }, true, false),
        (plain, false, false),
    ];
    for (number, (options, whole, joins)) in cases.into_iter().enumerate() {
        let mut ms = StageMs::default();
        let view = view_of(&data.index, &background_layout, &CAMERA, options.method, &mut ms);
        // All, or the near square alone.
        data.state().0 = if whole { vec![0, 1, 2] } else { vec![0] };
        let frame_stats = |renderer: &mut FrameRenderer| {
            let mut frame = Frame::default();
            let done =
                renderer.render(&data.index, &data, &view, &background_layout, &CAMERA, &options, ms, &mut frame);
            (done.expect("painted"), frame, renderer.unknown_fractions())
        };
        let (theirs, ours) = (frame_stats(&mut on_card), frame_stats(&mut FrameRenderer::default()));
        assert_eq!((theirs.0.on_card, ours.0.on_card), (joins, false), "case {number}");
        assert_eq!(theirs.0.missing_chunks, ours.0.missing_chunks, "case {number}");
        assert_eq!(theirs.2, ours.2, "case {number}: what nothing known reached");
        let differ = differing(&theirs.1, &ours.1);
        // Of some hundred along edges.
        assert!(differ <= 8, "case {number}: {differ} pixels");
        assert!(ours.1.count(Source::Near) > 100, "case {number}");
    }
}

/// What the upper half of the image does not show is sky, as it borders on sky; but not while a
/// deeper layer may hold it.
#[test]
fn sky_grows_where_all_layers_are_there() {
    let mut data = scene();
    let mut ldi = (*data.memory.ldis[&0]).clone();
    let LdiLayer { mut segments, mut column, mut disparity, mut rgb, mut links, .. } = ldi.layers.remove(0);
    let left = 24 * 48;
    segments.truncate(24);
    column.truncate(left);
    disparity.truncate(left);
    rgb.truncate(left);
    links.truncate(left);
    links[left - 48..].iter_mut().for_each(|l| *l &= !LINK_DOWN);
    let half = LdiLayer { segments, column, disparity, rgb, links, ends: vec![], slopes: vec![] };
    ldi.layers.push(half.with_half_ends());
    assert_eq!(ldi.check(), Ok(()));
    data.memory.ldis.insert(0, Arc::new(ldi));
    let ahead = Pose { position: DVec3::new(0.05, 0.0, 0.0), yaw_deg: 0.0, pitch_deg: 0.0 };
    let options = WalkOptions { fill: Fill::Off, ..options(Pace::Wait) };
    let (frame, frame_stats, _) = render(&data, &ahead, &options);
    assert_eq!((frame.count(Source::Unpainted), frame_stats.missing_chunks.len()), (0, 0));
    assert_eq!((colour_at(&frame, 18, 20), colour_at(&frame, 18, 28)), ([0, 0, 255], [198, 214, 235]));
    data.index.images[0].chunks.push(0);
    data.index.images[0].samples_by_layer.push(1);
    let (frame, frame_stats, _) = render(&data, &ahead, &options);
    assert!(frame.count(Source::Unpainted) > 50 && !frame_stats.missing_chunks.is_empty());
}

#[test]
fn views_show_images_in_other_colours() {
    let data = scene();
    let ahead = Pose { position: DVec3::new(0.05, 0.0, 0.0), yaw_deg: 0.0, pitch_deg: 0.0 };
    let shown = |shows: DisplayMode| {
        let (frame, ..) = render(&data, &ahead, &WalkOptions { shows, ..options(Pace::Wait) });
        // A pixel of geometry, one of the image's first layer.
        [colour_at(&frame, 31, 24), colour_at(&frame, 18, 24)]
    };
    assert_eq!(shown(DisplayMode::Scene), [[255, 0, 0], [0, 0, 255]]);
    assert_eq!(shown(DisplayMode::Layers), [[85, 0, 0], crate::warp::debug_colours::LAYER_COLOURS[0]]);
    let [_, footprint] = shown(DisplayMode::Footprints);
    assert!(footprint[2] > footprint[0], "below a pixel: {footprint:?}");
    assert!(shown(DisplayMode::Age)[1].iter().all(|c| *c > 240), "just laid out");
    assert_eq!(shown(DisplayMode::Ends)[1], [40; 3], "amid a surface");
}

#[test]
fn what_is_absent_is_named_and_not_called_sky() {
    let mut data = scene();
    data.lost = BTreeSet::from([2]);
    let ahead = Pose { position: DVec3::ZERO, yaw_deg: 0.0, pitch_deg: 0.0 };
    let (frame, frame_stats, _) = render(&data, &ahead, &options(Pace::Wait));
    assert_eq!(frame_stats.missing_chunks, vec![2]);
    // All of its window that the near square leaves.
    assert_eq!((frame.source[24 * 64 + 18], frame.source[2 * 64 + 2]), (Source::Unpainted, Source::Sky));
    assert!(frame.count(Source::Unpainted) > 500);
    let mut data = scene();
    data.lost = BTreeSet::from([0]);
    let (frame, frame_stats, _) = render(&data, &ahead, &options(Pace::Wait));
    assert_eq!((frame_stats.missing_chunks, frame.count(Source::Near)), (vec![0], 0));
}

#[test]
fn a_walk_writes_numbered_frames_and_counts() {
    let (data, path) = (scene(), five_poses());
    for pace in [Pace::Wait, Pace::Realtime] {
        let folder = folder(if pace == Pace::Wait { "wait" } else { "realtime" });
        let options = options(pace);
        // First walk: no truth. Its frames are the truth of the second.
        let job = WalkJob { path: &path, options: &options, folder: &folder, truth: None, baseline: None, stop: None };
        let mut lines = Vec::new();
        let (summary, frames) =
            run(&data, &job, FrameRenderer::default(), &mut |p| lines.push(p.done)).expect("a walk");
        assert_eq!(frames.iter().map(|f| f.index).collect::<Vec<_>>(), vec![0, 2, 4]);
        assert_eq!(lines.len(), if pace == Pace::Wait { 3 } else { 5 });
        for name in [
            "frame_00000.png",
            "frame_00002.png",
            "frame_00004.near.png",
            "frame_00004.far.png",
            "frame_00004.source.png",
        ] {
            assert!(folder.join(name).exists(), "{name}");
        }
        assert!(!folder.join("frame_00001.png").exists());
        assert_eq!((summary.frames, summary.budget_violations, summary.max_triangles), (3, 0, 2));
        assert_eq!((summary.mean_flip, summary.hole_fraction_mean), (None, None));
        assert_eq!(
            (summary.cache_peak_bytes, summary.revisit_bytes, summary.all_geometry_bytes),
            (7, 0, Some(2 * CHUNK_BYTES))
        );
        assert!((summary.bytes_per_metre.expect("it moved") - summary.bytes_total as f64 / 0.4).abs() < 1e-6);
        let truth = folder.with_extension("truth");
        let job = WalkJob { folder: &truth, truth: Some(&folder), baseline: Some(&folder), ..job };
        let (summary, frames) = run(&data, &job, FrameRenderer::default(), &mut |_| {}).expect("a walk");
        assert_eq!(summary.min_psnr_db, Some(crate::metrics::LARGEST_DB));
        assert!(frames.iter().all(|f| f.flip.is_some_and(|e| e < 1e-6) && f.method == "grid"));
        assert!(summary.far_fraction_mean > 0.1 && summary.mean_flip_far.is_some());
        assert!(frames.iter().all(|f| f.flip_baseline.is_some_and(|e| e < 1e-6) && f.flip_baseline_far.is_some()));
        std::fs::remove_dir_all(&folder).expect("removed");
        std::fs::remove_dir_all(&truth).expect("removed");
    }
}

#[test]
fn a_walk_that_is_stopped_reports_the_frames_so_far() {
    let (data, path) = (scene(), five_poses());
    for after in [0, 2] {
        let stop = AtomicBool::new(after == 0);
        let folder = folder(&format!("stopped{after}"));
        let options = options(Pace::Realtime);
        let job =
            WalkJob { path: &path, options: &options, folder: &folder, truth: None, baseline: None, stop: Some(&stop) };
        let progress = &mut |p: Progress| stop.store(p.done == after, Ordering::Relaxed);
        let (summary, frames) = run(&data, &job, FrameRenderer::default(), progress).expect("a walk");
        // Every second pose is kept; and nothing is measured beside the walk.
        assert_eq!(frames.iter().map(|f| f.index).collect::<Vec<_>>(), if after == 0 { vec![] } else { vec![0] });
        assert_eq!((summary.frames, summary.all_geometry_bytes), (frames.len(), None));
        std::fs::remove_dir_all(&folder).expect("removed");
    }
}

#[test]
fn a_walk_whose_server_is_gone_reports_the_frames_so_far() {
    let (path, folder) = (five_poses(), folder("gone"));
    let options = WalkOptions { baseline_frames: 5, ..options(Pace::Wait) };
    let job = WalkJob { path: &path, options: &options, folder: &folder, truth: None, baseline: None, stop: None };
    let walked = |waits| {
        let data = MemoryFeed { gone_after: Some(waits), pushes: false, ..scene() };
        run(&data, &job, FrameRenderer::default(), &mut |_| {})
    };
    // One wait for each pose, of which every second is drawn.
    let (summary, frames) = walked(2).expect("a report");
    assert_eq!(frames.iter().map(|f| f.index).collect::<Vec<_>>(), [0, 2]);
    let lost = summary.lost.expect("it ended early");
    assert!(lost.contains("pose 4") && lost.contains("the server is gone"), "{lost}");
    assert_eq!((summary.frames, summary.all_geometry_bytes), (2, None));
    assert!(matches!(walked(0), Err(WalkError::Disconnected { pose: 0, .. })), "nothing to report");
    std::fs::remove_dir_all(&folder).expect("removed");
}

/// A walk that does not wait keeps what one that waits promises: it says when nothing came any more
/// of what frames lacked.
#[test]
fn a_walk_in_real_time_says_that_its_server_is_gone() {
    let (path, folder) = (five_poses(), folder("gone-realtime"));
    let options = WalkOptions { baseline_frames: 0, every: 1, ..options(Pace::Realtime) };
    let job = WalkJob { path: &path, options: &options, folder: &folder, truth: None, baseline: None, stop: None };
    let walked = |looks, down: Option<u64>| {
        // Only the chunks of the last view have room, so that each frame lacks something when none
        // comes.
        let dead_after = Some((looks, down.map(Duration::from_secs)));
        let data = MemoryFeed { dead_after, ..scene() };
        let forget = &mut |_| data.state().0.clear();
        run(&data, &job, FrameRenderer::default(), forget)
    };
    let (summary, frames) = walked(2, Some(31)).expect("a report");
    let lost = summary.lost.expect("it ended early");
    assert!(lost.contains("pose 2") && lost.contains("the server is gone"), "{lost}");
    assert_eq!(frames.len(), 2);
    // A line that may come back is waited for, until the walk is over.
    let (summary, frames) = walked(2, Some(29)).expect("a report");
    let lost = summary.lost.expect("it did not come back");
    assert!(lost.contains("pose 4") && lost.contains("the server is gone"), "{lost}");
    assert_eq!((frames.len(), summary.frames_incomplete), (5, 3));
    let (summary, _) = walked(5, Some(31)).expect("a report");
    assert_eq!((summary.lost, summary.frames_incomplete), (None, 0));
    // A line that is up, over which nothing comes.
    let (summary, _) = walked(0, None).expect("a report");
    assert!(summary.lost.expect("nothing came").contains("no chunk has come"));
    assert!(matches!(walked(0, Some(31)), Err(WalkError::Disconnected { pose: 0, .. })), "nothing to report");
    std::fs::remove_dir_all(&folder).expect("removed");
}

/// A server that keeps the line up and sends nothing is not waited for at every pose.
#[test]
fn a_walk_that_no_chunk_reaches_ends_at_its_first_pose() {
    let (path, folder) = (five_poses(), folder("starved"));
    let options = WalkOptions { baseline_frames: 0, ..options(Pace::Wait) };
    let job = WalkJob { path: &path, options: &options, folder: &folder, truth: None, baseline: None, stop: None };
    let data = MemoryFeed { pushes: false, starves: true, ..scene() };
    let ended = run(&data, &job, FrameRenderer::default(), &mut |_| {});
    assert!(
        matches!(&ended, Err(WalkError::Disconnected { pose: 0, reason }) if reason.contains("no chunk has come")),
        "{ended:?}"
    );
    std::fs::remove_dir_all(&folder).expect("removed");
}

#[test]
fn chunks_that_come_again_are_counted() {
    let mut data = scene();
    // Room for one chunk only: each frame drops what the next one needs.
    (data.room, data.pushes) = (1, false);
    let (path, folder) = (five_poses(), folder("revisit"));
    let options = WalkOptions { baseline_frames: 0, debug_views: false, ..options(Pace::Wait) };
    let (summary, _) = run(
        &data,
        &WalkJob { path: &path, options: &options, folder: &folder, truth: None, baseline: None, stop: None },
        FrameRenderer::default(),
        &mut |_| {},
    )
    .expect("a walk");
    assert_eq!(summary.frames_incomplete, 3);
    // The first frame has the cell, the second the image in its place, the third the cell again:
    // one that comes back.
    assert_eq!((summary.revisit_bytes, summary.bytes_total), (CHUNK_BYTES, 4 * CHUNK_BYTES));
    assert_eq!(summary.ms_first_frame, Some(1000.0));
    assert_eq!((summary.ms_full_quality, summary.all_geometry_bytes, summary.speedup), (None, None, None));
    std::fs::remove_dir_all(&folder).expect("removed");
}

#[test]
fn a_picture_of_a_first_index_shows_the_tree_and_without_its_root_takes_nothing_for_sky() {
    let street = street(4, 16).with_tree();
    let root = street.index.tree.as_ref().expect("a tree").root_chunk;
    let mut first = street.index.clone();
    (first.cells, first.points, first.placements, first.images) = (vec![], vec![], vec![], vec![]);
    first.chunks.iter_mut().take(root as usize).for_each(|c| c.kind = ChunkKind::Page);
    // Before the tree's one sample, of 2 m; turned away from it; and while it is on its way.
    for (yaw_deg, held, seen) in [(0.0, true, true), (180.0, true, false), (0.0, false, false)] {
        let cache = Cache::new(Arc::new(first.clone()), 1 << 30);
        if held {
            cache.insert(root, &street.chunks[root as usize]).expect("sound");
        }
        let pose = Pose { position: DVec3::new(-57.0, -55.0, -58.0), yaw_deg, pitch_deg: 0.0 };
        let (index, mut ms, mut out) = (cache.index(), StageMs::default(), Frame::default());
        let view = view_of(index, &pose, &CAMERA, Method::Auto, &mut ms);
        assert_eq!(view.needed(index, &Sight::new(&pose, &CAMERA, 1)).all().collect::<Vec<_>>(), [root]);
        let options = options(Pace::Realtime);
        let frame_stats = FrameRenderer::default().render(index, &cache, &view, &pose, &CAMERA, &options, ms, &mut out);
        let frame_stats = frame_stats.expect("a picture");
        assert!(!frame_stats.is_complete());
        assert_eq!(out.count(Source::Tree) > 20, seen, "{} pixels of the tree", out.count(Source::Tree));
        assert_eq!(out.count(Source::Sky) > 0, held, "only the tree knows where nothing is");
    }
}
