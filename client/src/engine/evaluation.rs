//! Evaluation of frames against ground truth rendered by `ldi-server render`.
//!
//! In: a finished frame, and `frame_NNNNN.png` and `frame_NNNNN.f32` of the same pose. Out: PSNR,
//! SSIM, FLIP and the share of holes; and the FLIP of another renderer's frame of that pose, over
//! the same pixels. Values that cannot be computed are null in the report.

use crate::{
    frame::{Frame, Source, pack_rgb},
    metrics::{FlipMap, MetricError, RgbImage, psnr_db, ssim},
};
use std::path::{Path, PathBuf};

/// Largest ground-truth picture that is opened, pixels. Exceeds every picture that the client can
/// draw.
const MAX_PIXELS: u64 = 1 << 28;

/// The ground truth cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum EvaluationError {
    /// The picture is absent, or is no PNG.
    #[error("{path}: {source}; render the truth with `ldi-server render --path` of the same path, --size and --every")]
    RgbImage {
        /// The file.
        path: PathBuf,
        /// The cause.
        source: image::ImageError,
    },
    /// The depth file cannot be read.
    #[error("{path}: {source}")]
    Depth {
        /// The file.
        path: PathBuf,
        /// The cause.
        source: std::io::Error,
    },
    /// The depth file's length does not match the picture.
    #[error("{path}: {found} bytes, {expected} expected for the walk's --size; render the truth anew")]
    DepthLength {
        /// The file.
        path: PathBuf,
        /// Its length, bytes.
        found: u64,
        /// Expected length: 4 bytes per pixel.
        expected: u64,
    },
    /// The pictures differ in size.
    #[error("{path}: {source}")]
    Metric {
        /// The truth's file.
        path: PathBuf,
        /// The cause.
        source: MetricError,
    },
}

/// Path of a pose's picture.
fn picture_path(folder: &Path, pose: usize) -> PathBuf {
    folder.join(format!("frame_{pose:05}.png"))
}

/// Number of these poses that have a picture in the folder.
pub fn pictures_of(folder: &Path, poses: impl Iterator<Item = usize>) -> usize {
    poses.filter(|pose| picture_path(folder, *pose).exists()).count()
}

/// The ground truth of one pose, or another renderer's picture of it.
#[derive(Debug)]
pub struct Truth {
    path: PathBuf,
    picture: RgbImage,
    /// Eye-space depth in metres, infinite for sky; None when it was rendered without `--depth`.
    depth_m: Option<Vec<f32>>,
}

/// Scores of a frame.
#[derive(Debug, Clone, Copy, PartialEq, Default)]
pub struct Scores {
    /// PSNR, decibels.
    pub psnr_db: Option<f64>,
    /// SSIM; None for pictures smaller than its window.
    pub ssim: Option<f64>,
    /// Mean FLIP.
    pub flip: Option<f64>,
    /// Mean FLIP over warped pixels; None if there are none.
    pub flip_far: Option<f64>,
    /// Mean FLIP of the baseline's frame; None without a baseline.
    pub flip_baseline: Option<f64>,
    /// Mean FLIP of the baseline's frame over the pixels that this frame warped.
    pub flip_baseline_far: Option<f64>,
    /// Share of hole pixels in the finished frame.
    pub hole_fraction: Option<f64>,
    /// Share of hole pixels before averaging and filling.
    pub hole_before_fill: Option<f64>,
}

impl Truth {
    /// Reads the ground truth of pose `index`; None if the folder has no picture of it.
    pub fn load(folder: &Path, index: usize) -> Result<Option<Self>, EvaluationError> {
        let path = picture_path(folder, index);
        if !path.exists() {
            return Ok(None);
        }
        let failed = |source| EvaluationError::RgbImage { path: path.clone(), source };
        let mut reader = image::ImageReader::open(&path).map_err(|e| failed(e.into()))?;
        reader.limits({
            let mut limits = image::Limits::default();
            limits.max_alloc = Some(MAX_PIXELS * 4);
            limits
        });
        let rgb = reader.decode().map_err(failed)?.into_rgb8();
        let picture = RgbImage::new(rgb.width(), rgb.height(), rgb.into_raw())
            .map_err(|source| EvaluationError::Metric { path: path.clone(), source })?;
        let depth_m = read_depth(&path.with_extension("f32"), &picture)?;
        Ok(Some(Self { path, picture, depth_m }))
    }

    /// The picture as a frame whose pixels came from `source`, without depth.
    pub fn into_frame(self, source: Vec<Source>) -> Frame {
        let (width, height) = self.picture.size();
        let mut frame = Frame::new(width, height);
        for (colour, rgb) in frame.colour.iter_mut().zip(self.picture.rgb().chunks_exact(3)) {
            *colour = pack_rgb([rgb[0], rgb[1], rgb[2]]);
        }
        if source.len() == frame.len() {
            frame.source = source;
        }
        frame
    }

    /// Scores a frame. `full`: the frame before averaging, a whole multiple of its size.
    /// `baseline`: another renderer's picture.
    pub fn evaluate(&self, frame: &Frame, full: &Frame, baseline: Option<&Self>) -> Result<Scores, EvaluationError> {
        let failed = |source| EvaluationError::Metric { path: self.path.clone(), source };
        let test = RgbImage::new(frame.width, frame.height, frame.to_rgb8()).map_err(failed)?;
        let flip = FlipMap::new(&self.picture, &test).map_err(failed)?;
        let far = |i: usize| matches!(frame.source[i], Source::Far | Source::Tree);
        let compared = |other: &Self| {
            FlipMap::new(&self.picture, &other.picture)
                .map_err(|source| EvaluationError::Metric { path: other.path.clone(), source })
        };
        let baseline = baseline.map(compared).transpose()?;
        Ok(Scores {
            psnr_db: Some(psnr_db(&self.picture, &test).map_err(failed)?),
            ssim: ssim(&self.picture, &test).map_err(failed)?,
            flip: Some(flip.mean()),
            flip_far: flip.mean_where(far),
            flip_baseline: baseline.as_ref().map(FlipMap::mean),
            flip_baseline_far: baseline.and_then(|b| b.mean_where(far)),
            hole_fraction: self.depth_m.as_ref().map(|depth| hole_fraction(frame, depth, frame.width)),
            hole_before_fill: self.depth_m.as_ref().map(|depth| hole_fraction(full, depth, frame.width)),
        })
    }
}

fn read_depth(path: &Path, picture: &RgbImage) -> Result<Option<Vec<f32>>, EvaluationError> {
    if !path.exists() {
        return Ok(None);
    }
    let failed = |source| EvaluationError::Depth { path: path.to_owned(), source };
    let expected = 4 * u64::from(picture.size().0) * u64::from(picture.size().1);
    let found = std::fs::metadata(path).map_err(failed)?.len();
    if found != expected {
        return Err(EvaluationError::DepthLength { path: path.to_owned(), found, expected });
    }
    let bytes = std::fs::read(path).map_err(failed)?;
    Ok(Some(bytes.chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect()))
}

/// Share of pixels where the ground truth has a surface and the frame shows no known one:
/// unpainted, sky, or filled.
fn hole_fraction(frame: &Frame, depth_m: &[f32], truth_width: u32) -> f64 {
    let factor = (frame.width / truth_width.max(1)).max(1) as usize;
    let width = frame.width as usize;
    let holes = frame
        .source
        .iter()
        .enumerate()
        .filter(|(i, source)| {
            let truth = (i / width / factor) * truth_width as usize + i % width / factor;
            matches!(source, Source::Unpainted | Source::Sky | Source::Filled)
                && depth_m.get(truth).is_some_and(|d| d.is_finite())
        })
        .count();
    holes as f64 / frame.len().max(1) as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn holes_are_surfaces_of_the_truth_that_nothing_known_shows() {
        let mut frame = Frame::new(4, 2);
        frame.source = vec![
            Source::Near,
            Source::Far,
            Source::Filled,
            Source::Unpainted,
            Source::Sky,
            Source::Sky,
            Source::Filled,
            Source::Near,
        ];
        let inf = f32::INFINITY;
        let depth = [1.0, 1.0, 1.0, 1.0, inf, 1.0, inf, inf];
        assert_eq!(hole_fraction(&frame, &depth, 4), 3.0 / 8.0);
        // Twice supersampled: each truth pixel stands for four.
        assert_eq!(hole_fraction(&frame, &[1.0, inf], 2), 2.0 / 8.0);
    }

    #[test]
    fn the_baseline_is_judged_over_the_pixels_that_the_frame_warped() {
        let picture = |rgb: &dyn Fn(usize) -> [u8; 3]| Truth {
            path: PathBuf::from("frame_00000.png"),
            picture: RgbImage::new(64, 16, (0..64 * 16).flat_map(rgb).collect()).expect("its size"),
            depth_m: None,
        };
        let truth = picture(&|_| [90; 3]);
        // Wrong on the right; the frame warped the left.
        let baseline = picture(&|i| if i % 64 < 32 { [90; 3] } else { [250, 20, 20] });
        let mut frame = picture(&|_| [90; 3])
            .into_frame((0..64 * 16).map(|i| if i % 64 < 16 { Source::Far } else { Source::Near }).collect());
        let full = frame.clone();
        let left = truth.evaluate(&frame, &full, Some(&baseline)).expect("one size");
        assert_eq!((left.flip, left.flip_far), (Some(0.0), Some(0.0)));
        frame.source.reverse();
        let right = truth.evaluate(&frame, &full, Some(&baseline)).expect("one size");
        let (all, left, right) = (left.flip_baseline, left.flip_baseline_far, right.flip_baseline_far);
        assert!(left < Some(0.01) && all > Some(0.1) && right > all, "{left:?} {all:?} {right:?}");
        assert!(truth.evaluate(&frame, &full, None).expect("one size").flip_baseline_far.is_none());
    }

    #[test]
    fn a_truth_of_another_size_is_refused_by_name() {
        let folder = std::env::temp_dir().join(format!("ldi-judge-{}", std::process::id()));
        std::fs::create_dir_all(&folder).expect("a folder");
        let png = folder.join("frame_00003.png");
        image::save_buffer(&png, &[9; 12 * 11 * 3], 12, 11, image::ColorType::Rgb8).expect("written");
        assert!(Truth::load(&folder, 2).expect("absent is no error").is_none());
        let truth = Truth::load(&folder, 3).expect("readable").expect("there");
        let scores = truth.evaluate(&Frame::new(12, 11), &Frame::new(12, 11), None).expect("same size");
        assert!(scores.psnr_db.is_some_and(|p| p < 10.0) && scores.hole_fraction.is_none());
        assert!(scores.flip_baseline.is_none());
        let other =
            truth.evaluate(&Frame::new(11, 12), &Frame::new(11, 12), None).expect_err("another size").to_string();
        assert!(other.contains("frame_00003.png") && other.contains("--size"), "{other}");
        std::fs::write(folder.join("frame_00003.f32"), [0; 8]).expect("written");
        assert!(matches!(Truth::load(&folder, 3), Err(EvaluationError::DepthLength { found: 8, expected: 528, .. })));
        std::fs::remove_dir_all(&folder).expect("removed");
    }
}
