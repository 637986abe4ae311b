//! What a frame's parts cost on this machine's processor, for `ldi-server build --for FILE`.
//!
//! Out: a [`ClientProfile`]. Three synthetic views are drawn repeatedly: a wall of few triangles,
//! the same wall of many triangles, and a warped image. Real scenes cost something else per
//! triangle, pixel and sample, as most triangles are hidden and images have holes. Only the ratios
//! to [`REFERENCE_NS`] count: they scale the profile `cpu`.

use crate::{
    frame::Frame,
    memory::{Memory, dataset, loose_cluster, plain_material},
    near::Rasterizer,
    warp::{FarFrame, PreparedLdi, WarpError, WarpOptions, analytic, warp},
};
use glam::{DVec3, Vec3};
use ldi_protocol::{
    OutputCamera, Pose,
    client_profile::ClientProfile,
    index::{DrawnCell, Index},
    ldi::Ldi,
    mesh::Material,
};
use std::time::{Duration, Instant};

const CAMERA: OutputCamera = OutputCamera { width: 1280, height: 720, fov_deg: 60.0 };
const AHEAD: Pose = Pose { position: DVec3::ZERO, yaw_deg: 0.0, pitch_deg: 0.0 };
/// Time for each of the three views.
const TIME_EACH: Duration = Duration::from_secs(5);
/// Draws of a view at least, whatever they take; the first is not counted.
const LEAST_DRAWS: usize = 4;
/// Distance of the wall, metres, and half its extents, which fill the picture.
const WALL_M: [f32; 3] = [4.0, 2.4, 1.4];
/// Patches along the two sides of each wall, of 16 x 8 squares of two triangles: 4 thousand and
/// half a million triangles in all.
const PATCHES: [[usize; 2]; 2] = [[4, 4], [50, 40]];
/// What the views cost on the two cores that the profile `cpu` was measured on, nanoseconds per
/// triangle, pixel and sample.
const REFERENCE_NS: [f64; 3] = [163.0, 5.1, 3.7];
/// Side of the warped image, samples.
const SIDE: u32 = 1024;

/// Measures this machine; takes some fifteen seconds.
///
/// # Errors
/// If the image cannot be warped.
pub fn measure(name: &str) -> Result<ClientProfile, WarpError> {
    let pixels = f64::from(CAMERA.width) * f64::from(CAMERA.height);
    let [few, many] = PATCHES.map(wall);
    let (few_s, many_s) = (draw_seconds(&few), draw_seconds(&many));
    let more = (many.0.scene.triangles - few.0.scene.triangles) as f64;
    let (warp_s, samples) = warp_seconds()?;
    let found = [(many_s - few_s) / more, few_s / pixels, warp_s / samples as f64];
    Ok(profile(name, found.map(|seconds| seconds * 1e9)))
}

/// The profile of a machine on which the views cost so much.
fn profile(name: &str, ns: [f64; 3]) -> ClientProfile {
    let known = ClientProfile::cpu();
    let [triangle, pixel, sample] = [0, 1, 2].map(|i| (ns[i] / REFERENCE_NS[i]).max(1e-3));
    ClientProfile {
        name: name.to_owned(),
        ns_per_triangle: known.ns_per_triangle * triangle,
        ns_per_pixel: known.ns_per_pixel * pixel,
        ns_per_sample: known.ns_per_sample * sample,
    }
}

/// A wall across the picture.
fn wall([across, down]: [usize; 2]) -> (Index, Memory) {
    let [z, half_width, half_height] = WALL_M;
    let (columns, rows) = (16 * across, 8 * down);
    let corner = |column: usize, row: usize| {
        let (x, y) = (column as f32 / columns as f32 * 2.0 - 1.0, row as f32 / rows as f32 * 2.0 - 1.0);
        Vec3::new(x * half_width, y * half_height, -z)
    };
    let patch = |k: usize| {
        let (first_column, first_row) = (16 * (k % across), 8 * (k / across));
        let cells = (0..8).flat_map(|row| (0..16).map(move |column| (first_column + column, first_row + row)));
        let triangles: Vec<[Vec3; 3]> = cells
            .flat_map(|(c, r)| {
                let [p, q, s, t] = [corner(c, r), corner(c + 1, r), corner(c + 1, r + 1), corner(c, r + 1)];
                [[p, q, s], [p, s, t]]
            })
            .collect();
        loose_cluster(0, &triangles)
    };
    let lit = Material { unlit: false, ..plain_material() };
    dataset(CAMERA, vec![lit], (0..across * down).map(patch).collect())
}

fn draw_seconds((index, memory): &(Index, Memory)) -> f64 {
    let cells = DrawnCell::all_full(0..index.cells.len() as u32);
    let (mut rasterizer, mut frame) = (Rasterizer::default(), Frame::default());
    median_seconds(|| {
        rasterizer.draw(index, memory, &cells, &CAMERA, &AHEAD, &mut frame);
    })
}

/// Seconds, and samples of the image.
fn warp_seconds() -> Result<(f64, usize), WarpError> {
    let image = image();
    let samples = image.samples();
    let prepared = PreparedLdi::new(&image);
    let pose = Pose { position: DVec3::new(0.1, 0.05, -0.1), yaw_deg: 3.0, pitch_deg: -2.0 };
    let (options, mut far, mut end) = (WarpOptions::default(), FarFrame::default(), Ok(()));
    let seconds = median_seconds(|| {
        far.reset(CAMERA.width, CAMERA.height);
        end = warp(&prepared, &pose, &CAMERA, &options, &mut far).map(|_| ());
    });
    end.map(|()| (seconds, samples))
}

/// Fences before a wall.
fn image() -> Ldi {
    let scene = analytic::Scene {
        surfaces: vec![
            analytic::Surface::Fence { z: -4.0, period: 0.8, solid: 0.3 },
            analytic::Surface::Fence { z: -6.0, period: 100.0, solid: 101.0 },
        ],
        wavelength_m: 0.7,
    };
    scene.ldi(analytic::ldi_camera(DVec3::ZERO, SIDE, SIDE, 66.0), 3)
}

fn median_seconds(mut draw: impl FnMut()) -> f64 {
    draw();
    let (start, mut seconds) = (Instant::now(), Vec::new());
    while seconds.len() < LEAST_DRAWS || start.elapsed() < TIME_EACH {
        let one = Instant::now();
        draw();
        seconds.push(one.elapsed().as_secs_f64());
    }
    seconds.sort_by(f64::total_cmp);
    seconds[seconds.len() / 2]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_machine_twice_as_fast_costs_half() {
        let cpu = ClientProfile::cpu();
        assert_eq!(profile("cpu", REFERENCE_NS), cpu);
        let fast = profile("fast", REFERENCE_NS.map(|ns| ns * 0.5));
        assert_eq!(fast.ns_per_triangle * 2.0, cpu.ns_per_triangle);
        assert_eq!(fast.most_triangles(1e6), cpu.most_triangles(1e6));
    }

    #[test]
    fn both_walls_fill_the_picture() {
        for patches in PATCHES {
            let (index, memory) = wall(patches);
            assert_eq!(index.scene.triangles, (256 * patches[0] * patches[1]) as u64);
            let cells = DrawnCell::all_full(0..index.cells.len() as u32);
            let mut frame = Frame::default();
            let stats = Rasterizer::default().draw(&index, &memory, &cells, &CAMERA, &AHEAD, &mut frame);
            assert_eq!(stats.triangles, index.scene.triangles);
            let open = frame.disparity.iter().filter(|d| **d <= 0.0).count();
            assert_eq!(open, 0, "of {} pixels", frame.len());
        }
        assert!(image().samples() > (SIDE * SIDE) as usize, "more than one layer");
    }
}
