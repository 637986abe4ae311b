//! Hard numerical cases: for each a bound, why it holds, what it is judged by, and the worst that
//! was seen.
//!
//! In: how many random cases, and a seed. Out: a [`Case`] each. The warp's kernels are judged by
//! its f64 matrix, whole pictures by analytic scenes and by the f64 reference, codes by exact
//! arithmetic, doors by what must not pass them.

use glam::DVec3;
use ldi_client::warp::{
    FarFrame, Order, PreparedLdi, Stamp, Transformed, WarpMatrix, WarpOptions, Warped,
    analytic::{Scene, Surface, ldi_camera},
    reference, transformed, warp,
};
use ldi_protocol::{
    OutputCamera, Pose, ViewBasis,
    ldi::{DisparityCodes, Ldi, LdiCamera, LdiLayer, Segment},
    path,
};
use ldi_server::construct::parallax_bound;
use serde::Serialize;

/// A hard case.
#[derive(Debug, Clone, Serialize)]
pub struct Case {
    /// What is tried.
    pub name: &'static str,
    /// What may not exceed [`Self::bound`], with its unit.
    pub what: &'static str,
    /// The bound.
    pub bound: f64,
    /// Why it is this.
    pub why: &'static str,
    /// What it is judged by.
    pub oracle: &'static str,
    /// Random cases that counted.
    pub cases: u64,
    /// The worst seen.
    pub worst: f64,
}

impl Case {
    /// Whether the bound was kept, over at least one case.
    pub fn holds(&self) -> bool {
        self.cases > 0 && self.worst <= self.bound
    }
}

/// SplitMix64: a small generator of well-known quality, so that a seed means the same everywhere.
#[derive(Debug, Clone)]
struct Random(u64);

impl Random {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }
    fn unit(&mut self) -> f64 {
        (self.next() >> 11) as f64 / (1u64 << 53) as f64
    }
    fn between(&mut self, from: f64, to: f64) -> f64 {
        from + (to - from) * self.unit()
    }
    /// Evenly spread logarithms.
    fn scale(&mut self, from: f64, to: f64) -> f64 {
        self.between(from.ln(), to.ln()).exp()
    }
    fn sign(&mut self) -> f64 {
        if self.next() & 1 == 0 { 1.0 } else { -1.0 }
    }
    fn vector(&mut self, most: f64) -> DVec3 {
        DVec3::new(self.between(-most, most), self.between(-most, most), self.between(-most, most))
    }
}

const PICTURE: OutputCamera = OutputCamera { width: 1280, height: 720, fov_deg: 60.0 };
/// Pictures of whole scenes: small, as there are many.
const SMALL: OutputCamera = OutputCamera { width: 160, height: 120, fov_deg: 60.0 };
/// The promise of the warp's kernels (`client/src/warp/transform.rs`), pixels.
const KERNEL_PX: f64 = 1.0 / 64.0;
const KERNEL_WHY: &str = "X is rounded to 24 bits, about x 2^-23, and 1/W magnifies: for samples within 4,096 pixels of the picture's origin and footprints up to 4 pixels";

/// An image of random disparities between `far` and `near` m: `rows` full rows of `columns`.
fn noise(random: &mut Random, (columns, rows): (u32, u32), [near, far]: [f64; 2]) -> Ldi {
    let camera = LdiCamera {
        cop: DVec3::ZERO,
        basis: ViewBasis::from_yaw_pitch(random.between(-180.0, 180.0), random.between(-80.0, 80.0)),
        pixels_per_unit: random.scale(200.0, 2000.0),
        left: -(columns as i32 / 2) + random.between(-500.0, 500.0) as i32,
        top: -(rows as i32 / 2) + random.between(-500.0, 500.0) as i32,
        width: columns,
        height: rows,
    };
    let codes =
        DisparityCodes { smallest: 1.0 / far, step: (1.0 / near - 1.0 / far) / 65_534.0, largest_code: u16::MAX };
    let mut layer = LdiLayer::default();
    for row in 0..rows {
        for base in (0..columns).step_by(256) {
            let count = (columns - base).min(256);
            layer.segments.push(Segment {
                row: row as u16,
                column_base: base as u16,
                first: layer.len() as u32,
                count: count as u16,
            });
            for column in 0..count {
                layer.column.push(column as u8);
                // Far ones are as likely as near ones.
                layer.disparity.push(codes.code(1.0 / random.scale(near, far)));
                layer.rgb.push([128; 3]);
                layer.links.push(0);
            }
        }
    }
    let words = (columns as usize).div_ceil(64) * rows as usize;
    Ldi { camera, codes, layers: vec![layer.with_half_ends()], sky: vec![0; words], slivers: vec![] }
}

/// The worst of what was seen: NaN is worse than anything.
fn worse(worst: f64, error: f64) -> f64 {
    if error.is_nan() { f64::INFINITY } else { worst.max(error) }
}

/// Judges what the kernels make of images by f64: how many cases counted, and the worst `error`,
/// which is told the exact sample and its footprint. `shift` moves both the image and the eye.
fn kernels(
    random: &mut Random,
    cases: u64,
    size: (u32, u32),
    range_m: [f64; 2],
    shift: DVec3,
    mut eye: impl FnMut(&mut Random, &LdiCamera) -> DVec3,
    error: impl Fn(&Transformed, &Warped, f64) -> f64,
) -> (u64, f64) {
    let (mut counted, mut worst) = (0, 0.0);
    let most_rounds = 20 * cases / u64::from(size.0 * size.1) + 20;
    for round in 0..most_rounds {
        if counted >= cases {
            break;
        }
        let mut ldi = noise(random, size, range_m);
        let towards = eye(random, &ldi.camera);
        let (yaw, pitch) = yaw_pitch(&ldi.camera.basis);
        let pose = Pose {
            position: towards,
            yaw_deg: yaw + random.between(-25.0, 25.0),
            pitch_deg: (pitch + random.between(-15.0, 15.0)).clamp(-89.0, 89.0),
        };
        let matrix = WarpMatrix::new(&ldi.camera, &pose, &PICTURE);
        ldi.camera.cop += shift;
        let moved = Pose { position: pose.position + shift, ..pose };
        for s in transformed(&PreparedLdi::new(&ldi), &moved, &PICTURE, round % 2 == 1) {
            let Some(exact) = matrix.warp(s.u, s.v, f64::from(s.disparity)) else { continue };
            let Some(footprint) = matrix.footprint(s.u, s.v, f64::from(s.disparity)) else { continue };
            if exact.x.abs() > 4096.0 || exact.y.abs() > 4096.0 || footprint > 4.0 {
                continue;
            }
            counted += 1;
            worst = worse(worst, error(&s, &exact, footprint));
        }
    }
    (counted, worst)
}

fn yaw_pitch(basis: &ViewBasis) -> (f64, f64) {
    let f = basis.forward;
    ((-f.x).atan2(-f.z).to_degrees(), f.y.clamp(-1.0, 1.0).asin().to_degrees())
}

/// A case of the kernels' promise.
fn kernel_case(
    name: &'static str,
    seed: u64,
    cases: u64,
    (size, range_m, shift): ((u32, u32), [f64; 2], DVec3),
    eye: impl FnMut(&mut Random, &LdiCamera) -> DVec3,
) -> Case {
    let off = |s: &Transformed, exact: &Warped, _| (f64::from(s.x) - exact.x).hypot(f64::from(s.y) - exact.y);
    let (counted, worst) = kernels(&mut Random(seed), cases, size, range_m, shift, eye, off);
    Case {
        name,
        what: "distance from where it belongs, px",
        bound: KERNEL_PX,
        why: KERNEL_WHY,
        oracle: "the warp's matrix in f64",
        cases: counted,
        worst,
    }
}

/// All cases.
pub fn run(cases: u64, seed: u64) -> Vec<Case> {
    let block = (256, 64);
    let usual = (block, [1.0, 200.0], DVec3::ZERO);
    let at = |e: DVec3, c: &LdiCamera| c.basis.right * e.x + c.basis.up * e.y + c.basis.forward * e.z;
    let mut out = vec![
        kernel_case("eye at the centre of projection", seed, cases, usual, |_, _| DVec3::ZERO),
        kernel_case("eye in the image's plane of projection", seed + 1, cases, usual, move |r, c| {
            at(DVec3::new(r.between(-0.5, 0.5), r.between(-0.5, 0.5), 0.0), c)
        }),
        kernel_case("eye behind the centre of projection", seed + 2, cases, usual, move |r, c| {
            at(DVec3::new(r.between(-0.5, 0.5), r.between(-0.5, 0.5), -r.between(0.0, 3.0)), c)
        }),
        kernel_case("eye ahead, samples cross its plane", seed + 3, cases, usual, move |r, c| {
            at(DVec3::new(r.between(-0.5, 0.5), r.between(-0.5, 0.5), r.between(0.0, 30.0)), c)
        }),
        kernel_case("rows of 8,192 samples", seed + 4, cases, ((8192, 4), [1.0, 200.0], DVec3::ZERO), |r, _| {
            r.vector(0.4)
        }),
        kernel_case(
            "a million metres from the origin",
            seed + 5,
            cases,
            (block, [1.0, 200.0], DVec3::splat(1e6)),
            |r, _| r.vector(0.4),
        ),
        kernel_case(
            "ten million metres from the origin",
            seed + 6,
            cases,
            (block, [1.0, 200.0], DVec3::new(1e7, -1e7, 1e7)),
            |r, _| r.vector(0.4),
        ),
        kernel_case("near and far a million apart", seed + 7, cases, (block, [1.0, 1e6], DVec3::ZERO), |r, _| {
            r.vector(0.4)
        }),
    ];
    out.push(footprints(cases, seed + 8));
    out.push(disparities(cases, seed + 9));
    for (i, place) in Place::ALL.into_iter().enumerate() {
        out.push(orders(place, cases, seed + 10 + i as u64));
    }
    out.push(crossing(cases, seed + 20));
    out.extend(quantization(cases, seed + 21));
    out.push(double_walls(cases, seed + 23));
    out.extend(doors(cases, seed + 24));
    out
}

/// A case of what else the kernels tell of each sample, from eyes around the centre.
fn relative_case(
    [name, why, oracle]: [&'static str; 3],
    (seed, cases, bound): (u64, u64, f64),
    error: impl Fn(&Transformed, &Warped, f64) -> f64,
) -> Case {
    let eye = |r: &mut Random, _: &LdiCamera| r.vector(0.7);
    let (cases, worst) = kernels(&mut Random(seed), cases, (256, 64), [1.0, 200.0], DVec3::ZERO, eye, error);
    Case { name, what: "relative error", bound, why, oracle, cases, worst }
}

fn footprints(cases: u64, seed: u64) -> Case {
    let texts = [
        "footprints, at grazing angles too",
        "sides of stamps are whole pixels; the discriminant of a nearly round footprint loses half of 24 bits",
        "largest singular value of the exact Jacobian in f64",
    ];
    relative_case(texts, (seed, cases, 1e-3), |s, _, footprint| {
        // Far below a pixel nothing depends on it.
        if footprint > 0.01 { (f64::from(s.footprint) / footprint - 1.0).abs() } else { 0.0 }
    })
}

fn disparities(cases: u64, seed: u64) -> Case {
    let texts = [
        "disparities after the warp",
        "five roundings of 2^-24 in W, and its cancellation at footprints up to 4",
        "the warp's matrix in f64",
    ];
    relative_case(texts, (seed, cases, 2f64.powi(-18)), |s, exact, _| {
        (f64::from(s.warped_disparity) / exact.disparity - 1.0).abs()
    })
}

/// Where the epipole lies.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Place {
    Inside,
    Edge,
    Corner,
    FarOutside,
    Infinity,
}

impl Place {
    const ALL: [Self; 5] = [Self::Inside, Self::Edge, Self::Corner, Self::FarOutside, Self::Infinity];

    fn name(self) -> &'static str {
        match self {
            Self::Inside => "epipole inside the image",
            Self::Edge => "epipole on an edge",
            Self::Corner => "epipole on a corner",
            Self::FarOutside => "epipole far outside",
            Self::Infinity => "epipole at infinity",
        }
    }

    /// An eye whose epipole lies there, ahead of the centre or behind it.
    fn eye(self, random: &mut Random, camera: &LdiCamera) -> DVec3 {
        let (w, h) = (f64::from(camera.width), f64::from(camera.height));
        let direction = match self {
            Self::Inside => camera.ray(random.between(0.0, w), random.between(0.0, h)),
            Self::Edge if random.next() & 1 == 0 => {
                camera.ray(if random.next() & 1 == 0 { 0.0 } else { w }, random.between(0.0, h))
            }
            Self::Edge => camera.ray(random.between(0.0, w), if random.next() & 1 == 0 { 0.0 } else { h }),
            Self::Corner => {
                camera.ray(if random.next() & 1 == 0 { 0.0 } else { w }, if random.next() & 1 == 0 { 0.0 } else { h })
            }
            Self::FarOutside => {
                camera.ray(random.sign() * random.scale(1e4, 1e7), random.sign() * random.scale(1e4, 1e7))
            }
            Self::Infinity => {
                camera.basis.right * random.between(-1.0, 1.0) + camera.basis.up * random.between(-1.0, 1.0)
            }
        };
        direction.normalize_or_zero() * random.sign() * random.between(0.1, 1.2)
    }
}

/// A wall behind bars and a sphere.
fn occluders() -> Scene {
    let wall =
        Surface::Rectangle { point: DVec3::new(0.0, 0.0, -20.0), across: DVec3::X, up: DVec3::Y, half: [80.0; 2] };
    let fence = Surface::Fence { z: -8.0, period: 1.0, solid: 0.3 };
    let sphere = Surface::Sphere { centre: DVec3::new(0.5, 0.2, -12.0), radius: 2.0 };
    Scene { surfaces: vec![wall, fence, sphere], wavelength_m: 4.0 }
}

fn frame_stats(ldi: &PreparedLdi, pose: &Pose, options: &WarpOptions) -> FarFrame {
    let mut frame = FarFrame::new(SMALL.width, SMALL.height);
    // One pixel is drawn in any order, every stamp by depth.
    warp(ldi, pose, &SMALL, options, &mut frame).map_or_else(|_| FarFrame::new(SMALL.width, SMALL.height), |_| frame)
}

fn orders(place: Place, cases: u64, seed: u64) -> Case {
    let random = &mut Random(seed);
    // As many samples as pixels per angle.
    let camera = LdiCamera { pixels_per_unit: SMALL.focal_px(), ..ldi_camera(DVec3::ZERO, 280, 210, 90.0) };
    let ldi = PreparedLdi::new(&occluders().ldi(camera, 4));
    let (mut pixels, mut wrong) = (0, 0);
    while pixels < cases {
        let pose = Pose {
            position: place.eye(random, &camera),
            yaw_deg: random.between(-10.0, 10.0),
            pitch_deg: random.between(-8.0, 8.0),
        };
        let one = WarpOptions { stamp: Stamp::OnePixel, ..WarpOptions::default() };
        let by_depth = frame_stats(&ldi, &pose, &one);
        let in_order = frame_stats(&ldi, &pose, &WarpOptions { order: Order::Epipole, ..one });
        for i in 0..by_depth.packed.len() {
            pixels += 1;
            wrong += u64::from(match (by_depth.get(i), in_order.get(i)) {
                (Some((_, a)), Some((_, b))) => (a - b).abs() > 0.1 * a.max(b),
                (None, None) => false,
                _ => true,
            });
        }
    }
    Case {
        name: place.name(),
        what: "share of pixels that show another surface",
        bound: 1e-4,
        why: "the order is exact along each line through the epipole; where the picture is coarser than the image, two lines meet in a pixel",
        oracle: "the z-buffer",
        cases: pixels,
        worst: wrong as f64 / pixels as f64,
    }
}

/// Walls that pass through or close by the eye.
fn crossing(cases: u64, seed: u64) -> Case {
    let random = &mut Random(seed);
    let (mut pixels, mut wrong) = (0, 0);
    while pixels < cases {
        let across = DVec3::new(random.between(0.2, 1.0), 0.0, random.between(-1.0, 1.0)).normalize();
        let point = DVec3::new(0.0, 0.0, -random.between(1.0, 5.0));
        let wall = Surface::Rectangle { point, across, up: DVec3::Y, half: [30.0; 2] };
        let ldi = Scene { surfaces: vec![wall], wavelength_m: 4.0 }.ldi(ldi_camera(DVec3::ZERO, 96, 72, 90.0), 1);
        // A hair to a metre beside it, looking along it: it passes by the eye, from ahead to
        // behind.
        let beside = random.sign() * random.scale(1e-4, 1.0);
        let eye = point + across * random.between(-0.5, 0.5) + across.cross(DVec3::Y) * beside;
        let along = across * random.sign();
        let yaw_deg = (-along.x).atan2(-along.z).to_degrees() + random.between(-40.0, 40.0);
        let pose = Pose { position: eye, yaw_deg, pitch_deg: random.between(-20.0, 20.0) };
        let fast = frame_stats(
            &PreparedLdi::new(&ldi),
            &pose,
            &WarpOptions { keep_all_tiles: true, ..WarpOptions::default() },
        );
        let exact = reference::warp(&ldi, &pose, &SMALL, Stamp::Quads);
        // Nothing to see is no case.
        if fast.painted() + exact.painted() == 0 {
            continue;
        }
        for i in 0..fast.packed.len() {
            pixels += 1;
            wrong += u64::from(match (fast.get(i), exact.get(i)) {
                (Some((_, a)), Some((_, b))) => !(a > 0.0 && a.is_finite()) || (a - b).abs() > 0.1 * a.max(b),
                (None, None) => false,
                _ => true,
            });
        }
    }
    Case {
        name: "micro-quads that cross the eye's plane",
        what: "share of pixels painted otherwise",
        bound: 5e-4,
        why: "a quad with a corner at or behind the plane is left out; which ones touch it is decided in f32, and centres within rounding of an edge go either way",
        oracle: "the f64 reference",
        cases: pixels,
        worst: wrong as f64 / pixels as f64,
    }
}

/// How far rounded codes move samples: with as many codes as wanted, and where 16 bits are too few.
fn quantization(cases: u64, seed: u64) -> [Case; 2] {
    let random = &mut Random(seed);
    let mut worst = [0.0f64; 2];
    let mut counted = [0u64; 2];
    for round in 0..u64::MAX {
        if counted.iter().all(|n| *n >= cases) || round > 400 * cases {
            break;
        }
        let few = round % 2 == 1;
        let near = random.scale(0.5, 20.0);
        let far = near * if few { 1e6 } else { random.scale(2.0, 100.0) };
        let reach = near * random.between(0.02, 0.5);
        let corners = std::array::from_fn(|i| {
            let side = |bit: usize| if i >> bit & 1 == 0 { -reach } else { reach };
            DVec3::new(side(0), side(1), side(2))
        });
        let bound = parallax_bound(&corners, near, &PICTURE);
        let span = 1.0 / near - 1.0 / far;
        let wanted = (span / (0.125 / bound)).ceil().max(1.0);
        let given = if few { wanted.min(255.0) } else { wanted.min(65_534.0) };
        if !few && given < wanted {
            continue;
        }
        let codes = DisparityCodes { smallest: 1.0 / far, step: span / given, largest_code: given as u16 + 1 };
        let camera = LdiCamera { pixels_per_unit: PICTURE.focal_px(), ..ldi_camera(DVec3::ZERO, 2048, 2048, 90.0) };
        let pose = Pose {
            position: random.vector(reach),
            yaw_deg: random.between(-40.0, 40.0),
            pitch_deg: random.between(-30.0, 30.0),
        };
        let matrix = WarpMatrix::new(&camera, &pose, &PICTURE);
        for _ in 0..64 {
            let (u, v) = (random.between(0.0, 2048.0), random.between(0.0, 2048.0));
            let disparity = 1.0 / random.scale(near, far);
            let rounded = codes.disparity(codes.code(disparity));
            let (Some(a), Some(b)) = (matrix.warp(u, v, disparity), matrix.warp(u, v, rounded)) else { continue };
            let seen = a.x >= 0.0 && a.x <= f64::from(PICTURE.width) && a.y >= 0.0 && a.y <= f64::from(PICTURE.height);
            if seen {
                counted[usize::from(few)] += 1;
                // As a share of what half a step may be.
                let most = 0.5 * codes.step * bound;
                worst[usize::from(few)] = worse(worst[usize::from(few)], (a.x - b.x).hypot(a.y - b.y) / most);
            }
        }
    }
    let case = |name, why, i: usize| Case {
        name,
        what: "error as a share of what is promised",
        // The bound is on the derivative; over half a step it changes by a thousandth.
        bound: 1.01,
        why,
        oracle: "the exact disparity, warped in f64",
        cases: counted[i],
        worst: worst[i],
    };
    [
        case(
            "disparity codes, a sixteenth of a pixel promised",
            "codes are half a step off at most, steps are an eighth of a pixel by the bound on parallax",
            0,
        ),
        case(
            "disparity codes, too few for the span (near and far a million apart)",
            "steps are as fine as the codes allow; the error that is reported is half of one times the bound on parallax",
            1,
        ),
    ]
}

/// Two walls, a thousandth to a millionth of their distance apart.
fn double_walls(cases: u64, seed: u64) -> Case {
    let random = &mut Random(seed);
    let (mut pixels, mut wrong) = (0u64, 0u64);
    for _ in 0..10_000 {
        if pixels >= cases {
            break;
        }
        let depth = random.scale(2.0, 50.0);
        let gap = depth * random.scale(1e-6, 1e-3);
        let wall = |z: f64| Surface::Rectangle {
            point: DVec3::new(0.0, 0.0, -z),
            across: DVec3::X,
            up: DVec3::Y,
            half: [1e3; 2],
        };
        let mut ldi = Scene { surfaces: vec![wall(depth), wall(depth + gap)], wavelength_m: 1e9 }
            // Large enough that no eye looks past its border, where one wall would end before the
            // other.
            .ldi(ldi_camera(DVec3::ZERO, 96, 96, 130.0), 2);
        // Codes as a scene with other things in it has them: the gap is a few steps, or less than
        // one.
        let codes = DisparityCodes { smallest: 0.25 / depth, step: 1.5 / depth / 65_534.0, largest_code: u16::MAX };
        for layer in &mut ldi.layers {
            layer.disparity.iter_mut().for_each(|c| *c = codes.code(ldi.codes.disparity(*c)));
        }
        let apart = ldi.layers[0].disparity.first() > ldi.layers.get(1).and_then(|l| l.disparity.first());
        ldi.codes = codes;
        for (layer, rgb) in ldi.layers.iter_mut().zip([[200, 0, 0], [0, 0, 200]]) {
            layer.rgb.fill(rgb);
        }
        if !apart {
            continue;
        }
        let pose = Pose {
            position: DVec3::new(random.between(-0.2, 0.2), random.between(-0.2, 0.2), random.between(-0.3, 0.3))
                * depth,
            yaw_deg: random.between(-10.0, 10.0),
            pitch_deg: random.between(-10.0, 10.0),
        };
        let frame = frame_stats(&PreparedLdi::new(&ldi), &pose, &WarpOptions::default());
        for (colour, _) in (0..frame.packed.len()).filter_map(|i| frame.get(i)) {
            pixels += 1;
            wrong += u64::from(colour & 255 < 100);
        }
    }
    Case {
        name: "thin double walls, one code apart or more",
        what: "share of pixels that show the wall behind",
        bound: 0.0,
        why: "W is the same affine function for both, rounded alike: of two codes at one place the nearer stays nearer",
        oracle: "the scene",
        cases: pixels,
        worst: wrong as f64 / pixels.max(1) as f64,
    }
}

/// What must not get in.
fn doors(cases: u64, seed: u64) -> [Case; 2] {
    let random = &mut Random(seed);
    let sound = noise(random, (16, 4), [1.0, 10.0]);
    let bad = [f64::NAN, f64::INFINITY, f64::NEG_INFINITY];
    let mut passed = 0u64;
    for _ in 0..cases {
        let mut ldi = sound.clone();
        let value = bad[(random.next() % 3) as usize];
        let c = &mut ldi.camera;
        match random.next() % 15 {
            0 => c.cop.x = value,
            1 => c.cop.y = value,
            2 => c.cop.z = value,
            3 => c.basis.right.x = value,
            4 => c.basis.right.y = value,
            5 => c.basis.right.z = value,
            6 => c.basis.up.x = value,
            7 => c.basis.up.y = value,
            8 => c.basis.up.z = value,
            9 => c.basis.forward.x = value,
            10 => c.basis.forward.y = value,
            11 => c.basis.forward.z = value,
            12 => c.pixels_per_unit = value,
            13 => ldi.codes.smallest = value,
            _ => ldi.codes.step = value,
        }
        passed += u64::from(ldi.check().is_ok());
    }
    let mut walked = 0u64;
    let tries = cases.min(100_000);
    for _ in 0..tries {
        // JSON has no infinity; numbers too large for f64, and words, are what a file can hold of
        // it. A position may be too far off besides; angles are periodic.
        let values = ["1e999", "-1e999", "NaN", "Infinity", "null", "1e300"];
        let place = (random.next() % 5) as usize;
        let choices = if place < 3 { values.len() } else { values.len() - 1 };
        let mut numbers = ["0", "1.6", "0", "0", "0"];
        numbers[place] = values[random.next() as usize % choices];
        let [x, y, z, yaw, pitch] = numbers;
        let file = format!(r#"{{"poses":[{{"t":0,"position":[{x},{y},{z}],"yaw":{yaw},"pitch":{pitch}}}]}}"#);
        walked += u64::from(path::parse(&file).is_ok());
    }
    let case = |name, oracle, cases, worst: u64| Case {
        name,
        what: "accepted",
        bound: 0.0,
        why: "everything from a file or the network is checked before it is used",
        oracle,
        cases,
        worst: worst as f64,
    };
    [
        case("images with NaN or infinity in their cameras or codes", "none is sound", cases, passed),
        case("path files with numbers that are none", "none is a path", tries, walked),
    ]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_bound_holds() {
        let all = run(30_000, 7);
        assert!(all.len() >= 20);
        for case in &all {
            assert!(case.holds(), "{}: {} > {} over {} cases", case.name, case.worst, case.bound, case.cases);
            assert!(case.cases >= 30_000, "{}: {} cases only", case.name, case.cases);
        }
        // Kernels that do not round would not be f32.
        assert!(all.iter().take(8).all(|c| c.worst > 1e-7), "{all:?}");
    }

    #[test]
    fn what_is_no_number_breaks_a_bound() {
        assert_eq!(worse(worse(1.0, f64::NAN), 2.0), f64::INFINITY);
        assert_eq!(worse(1.0, 0.5), 1.0);
    }

    #[test]
    fn a_case_without_cases_does_not_hold() {
        let case = Case { name: "", what: "", bound: 1.0, why: "", oracle: "", cases: 0, worst: 0.0 };
        assert!(!case.holds() && Case { cases: 1, ..case.clone() }.holds());
        assert!(!Case { cases: 1, worst: f64::NAN, ..case }.holds());
    }
}
