//! The warp alone: each stamp over views of one dataset, beside only transforming their samples.
//!
//!     cargo bench -p ldi-tests --bench warp
//!     LDI_BENCH_DATASET=house.ldi LDI_BENCH_PATH=house.path.json cargo bench -p ldi-tests --bench warp
//!
//! Without these two the built-in house at a tenth of its triangles is built first, and looked at
//! from everywhere. Samples per second are those of tiles that may reach the picture. What the
//! pictures are worth is no matter of this bench: `ldi-bench speed-error`.

use divan::{Bencher, counter::ItemsCount};
use ldi_client::{
    cache::Cache,
    engine::{Method, view_of},
    report::StageMs,
    resident::Resident as _,
    warp::{FarFrame, ImageInView, PreparedLdi, Stamp, WarpOptions, transform_only, warp_images},
};
use ldi_protocol::{
    OutputCamera, Pose,
    codec::ColourProfile,
    index::{BuildSettings, CELLS, Index},
    need::Sight,
    path,
};
use ldi_server::{
    build::{self, BuildOptions, Represent},
    store::Dataset,
};
use std::{
    path::{Path, PathBuf},
    sync::{Arc, LazyLock},
};

const CAMERA: OutputCamera = OutputCamera { width: 1280, height: 720, fov_deg: 60.0 };
/// Views that are warped one after another: one is no scene.
const VIEWS: usize = 6;
/// Threads of the warp: one, and the two for which the project's figures are.
const THREADS: [usize; 2] = [1, 2];

/// A pose and the images that its view shows.
struct View {
    pose: Pose,
    images: Vec<PreparedLdi>,
}

static SCENE: LazyLock<Vec<View>> = LazyLock::new(|| {
    let given = std::env::var_os("LDI_BENCH_DATASET").zip(std::env::var_os("LDI_BENCH_PATH"));
    let (dataset, path) = given.map_or_else(|| (house(), None), |(d, p)| (PathBuf::from(d), Some(PathBuf::from(p))));
    let dataset = Dataset::open(&dataset).expect("a dataset");
    let poses = path.map_or_else(|| scattered(dataset.index()), |p| along(&p));
    let views: Vec<View> = poses.iter().map(|pose| view(&dataset, pose)).filter(|v| !v.images.is_empty()).collect();
    assert!(!views.is_empty(), "no view of this dataset shows an image");
    let step = views.len().div_ceil(VIEWS);
    views.into_iter().step_by(step).collect()
});

/// Builds the built-in house.
fn house() -> PathBuf {
    let output = Path::new(env!("CARGO_TARGET_TMPDIR")).join("bench-house");
    let options = BuildOptions {
        scenes: vec!["builtin:house?triangles=100000".into()],
        output: output.clone(),
        settings: BuildSettings {
            budget: 10_000,
            optimize_budget: 0,
            camera: CAMERA,
            max_footprint_px: 2.0,
            max_deviation_px: 0.5,
            pitch_deg: 60.0,
            density: 1.0,
            colour: "high".into(),
            grid: CELLS.into(),
            eye_height_m: Some(1.6),
        },
        colour: ColourProfile::High,
        represent: Represent::Grid,
        starts: Vec::new(),
        along: None,
        time_limit: None,
        budget: build::BudgetRule::Given,
    };
    build::build(&options, &()).expect("the house can be built");
    output
}

/// Poses of a path, evenly spaced.
fn along(path: &Path) -> Vec<Pose> {
    let walk = path::read(std::fs::File::open(path).expect("a path file"), |_| ()).expect("a path");
    walk.evenly_spaced(60).into_iter().map(|i| walk.poses[i].pose).collect()
}

/// Poses in the walk volume, looking around.
fn scattered(index: &Index) -> Vec<Pose> {
    let volume = index.volume.as_ref().expect("a walk volume").sampler();
    // Golden-ratio steps spread evenly however many there are.
    let at = |n: u32, k: u32| (f64::from(n) * (0.618_033_988_75 + 0.1 * f64::from(k))).fract();
    let pose = |n| {
        let position = volume.point([0, 1, 2, 3].map(|k| at(n, k)))?;
        Some(Pose { position, yaw_deg: 360.0 * at(n, 4), pitch_deg: 0.0 })
    };
    (1..40).filter_map(pose).collect()
}

fn view(dataset: &Dataset, pose: &Pose) -> View {
    let index = dataset.index();
    let view = view_of(index, pose, &CAMERA, Method::Auto, &mut StageMs::default());
    let cache = Cache::new(Arc::clone(index), u64::MAX);
    for chunk in view.needed(index, &Sight::new(pose, &CAMERA, 1)).all() {
        cache.insert(chunk, &dataset.chunk(chunk).expect("readable")).expect("intact");
    }
    let images = view.images.iter().filter_map(|i| cache.ldi(*i)).map(|ldi| PreparedLdi::new(&ldi)).collect();
    View { pose: *pose, images }
}

/// Warps all views, once per iteration.
#[divan::bench(args = [Stamp::OnePixel, Stamp::TwoByTwo, Stamp::Footprint, Stamp::Quads], consts = THREADS)]
fn warp<const THREADS: usize>(bencher: Bencher<'_, '_>, stamp: Stamp) {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(THREADS).build().expect("threads");
    // The same samples as in `transform_alone`.
    let options = WarpOptions { stamp, keep_hidden: true, ..WarpOptions::default() };
    let shown: Vec<(Pose, Vec<ImageInView<'_>>)> =
        SCENE.iter().map(|v| (v.pose, v.images.iter().map(ImageInView::from).collect())).collect();
    let (mut far, mut spare) = (FarFrame::default(), FarFrame::default());
    let mut all = || -> u64 {
        let one = |(pose, images): &(Pose, Vec<ImageInView<'_>>)| {
            far.reset(CAMERA.width, CAMERA.height);
            warp_images(images, &[], pose, &CAMERA, &options, &mut far, &mut spare).expect("fits").samples_warped
        };
        pool.install(|| shown.iter().map(one).sum())
    };
    let samples = all();
    bencher.counter(ItemsCount::new(samples)).bench_local(all);
}

/// What arithmetic alone takes: nothing is painted.
#[divan::bench(consts = THREADS)]
fn transform_alone<const THREADS: usize>(bencher: Bencher<'_, '_>) {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(THREADS).build().expect("threads");
    let options = WarpOptions { stamp: Stamp::OnePixel, ..WarpOptions::default() };
    let mut far = FarFrame::default();
    far.reset(CAMERA.width, CAMERA.height);
    let mut all = || -> u64 {
        let mut one = |view: &View| -> u64 {
            view.images.iter().map(|i| transform_only(i, &view.pose, &CAMERA, &options, &mut far).samples_warped).sum()
        };
        pool.install(|| SCENE.iter().map(&mut one).sum())
    };
    let samples = all();
    bencher.counter(ItemsCount::new(samples)).bench_local(all);
}

fn main() {
    // Before anything is timed.
    let images: usize = SCENE.iter().map(|v| v.images.len()).sum();
    println!("{} views of {images} images, {}x{}", SCENE.len(), CAMERA.width, CAMERA.height);
    divan::main();
}
