//! The same frames as video: what a server that renders every frame and streams pixels would send,
//! at which error.
//!
//! In: frames of a walk as PNG (`ldi-server render`), a truth for some of them under the same
//! names, encoders and their quality settings. Out: bits per second, mean FLIP and bytes of the
//! first frame of each, and what each needs for a given FLIP. `ffmpeg` encodes and decodes;
//! settings are those of an interactive stream: no frame waits for a later one, one key frame.

use anyhow::{Context as _, Result, bail, ensure};
use ldi_client::metrics::{FlipMap, RgbImage, psnr_db};
use rayon::prelude::*;
use serde::Serialize;
use std::{
    ffi::OsStr,
    fmt::Write as _,
    path::{Path, PathBuf},
    process::{Command, Stdio},
    time::Instant,
};

/// An encoder with its options.
#[derive(Debug, Clone, Copy, PartialEq, Eq, clap::ValueEnum)]
pub enum Encoder {
    /// H.264 at `veryfast`, as live services encode it.
    X264,
    /// H.264 at `slower`, with colours at full resolution.
    X264Best,
    /// The same with 10 bits per channel, which take rounding out of the comparison.
    X264Deep,
    /// AV1 (SVT) at preset 8.
    Av1,
    /// AV1 (libaom) in its real-time mode, with colours at full resolution and 10 bits.
    Av1Deep,
}

impl Encoder {
    fn name(self) -> &'static str {
        match self {
            Self::X264 => "x264 veryfast",
            Self::X264Best => "x264 slower, 4:4:4",
            Self::X264Deep => "x264 slower, 4:4:4, 10 bits",
            Self::Av1 => "SVT-AV1 preset 8",
            Self::Av1Deep => "AV1 (libaom) real time 8, 4:4:4, 10 bits",
        }
    }

    fn options(self) -> &'static [&'static str] {
        match self {
            Self::X264 => &["-c:v", "libx264", "-preset", "veryfast", "-tune", "zerolatency", "-pix_fmt", "yuv420p"],
            Self::X264Best => &["-c:v", "libx264", "-preset", "slower", "-tune", "zerolatency", "-pix_fmt", "yuv444p"],
            Self::X264Deep => {
                &["-c:v", "libx264", "-preset", "slower", "-tune", "zerolatency", "-pix_fmt", "yuv444p10le"]
            }
            // Low delay: prediction from the past alone.
            Self::Av1 => {
                &["-c:v", "libsvtav1", "-preset", "8", "-svtav1-params", "pred-struct=1", "-pix_fmt", "yuv420p"]
            }
            Self::Av1Deep => &["-c:v", "libaom-av1", "-usage", "realtime", "-cpu-used", "8", "-pix_fmt", "yuv444p10le"],
        }
    }
}

/// What to compare.
#[derive(Debug)]
pub struct Study {
    /// Folder of the frames, in the order of their names.
    pub frames: PathBuf,
    /// Folder of their truth: of every frame or of some.
    pub truth: PathBuf,
    /// Frames per second.
    pub fps: f64,
    /// Encoders.
    pub encoders: Vec<Encoder>,
    /// Constant rate factors, each encoder's own scale.
    pub crf: Vec<u32>,
    /// The FLIP to be had, if the bits for it are asked for.
    pub flip: Option<f64>,
    /// Folder for what is left.
    pub output: PathBuf,
}

/// One video.
#[derive(Debug, Clone, Serialize)]
pub struct Row {
    /// See [`Encoder`].
    pub encoder: String,
    /// Constant rate factor. None: the frames as they are, not encoded.
    pub crf: Option<u32>,
    /// Of the file.
    pub bytes: u64,
    /// Of the first frame alone: nothing shows before these are there.
    pub first_bytes: u64,
    /// Mean.
    pub mbit_per_s: f64,
    /// Over the judged frames.
    pub flip: f64,
    /// Over the judged frames.
    pub psnr_db: f64,
    /// Time to encode a frame, all cores.
    pub encode_ms: f64,
}

/// What an encoder needs for the FLIP that was asked for.
#[derive(Debug, Clone, Serialize)]
pub struct Needed {
    /// See [`Encoder`].
    pub encoder: String,
    /// Between the two settings around it. None: no setting is that good, or all are better.
    pub mbit_per_s: Option<f64>,
}

/// Everything.
#[derive(Debug, Clone, Serialize)]
pub struct Found {
    /// Frames, and those that were judged.
    pub frames: [usize; 2],
    /// Length of the video, seconds.
    pub seconds: f64,
    /// By encoder and setting.
    pub rows: Vec<Row>,
    /// For one FLIP.
    pub needed: Vec<Needed>,
}

/// Colours are rounded, not cut off, on their way to the encoder and back: the usual way darkens
/// everything by a level, which FLIP counts on every plain surface.
const EXACT_COLOURS: [&str; 2] = ["-sws_flags", "accurate_rnd+full_chroma_int+full_chroma_inp+bicubic"];

fn pictures(folder: &Path) -> Result<Vec<PathBuf>> {
    let entries = std::fs::read_dir(folder).with_context(|| format!("cannot read {}", folder.display()))?;
    let mut files: Vec<PathBuf> = entries.filter_map(|e| Some(e.ok()?.path())).collect();
    files.retain(|f| f.extension() == Some(OsStr::new("png")));
    files.sort();
    ensure!(!files.is_empty(), "{}: holds no PNG; make some with `ldi-server render`", folder.display());
    Ok(files)
}

fn load(file: &Path) -> Result<RgbImage> {
    let image = image::open(file).with_context(|| file.display().to_string())?.into_rgb8();
    Ok(RgbImage::new(image.width(), image.height(), image.into_raw())?)
}

/// Mean FLIP and PSNR of files against their truths.
fn judge(pairs: &[(PathBuf, PathBuf)]) -> Result<(f64, f64)> {
    let one = |(file, truth): &(PathBuf, PathBuf)| -> Result<(f64, f64)> {
        let (picture, truth) = (load(file)?, load(truth)?);
        Ok((FlipMap::new(&truth, &picture)?.mean(), psnr_db(&truth, &picture)?))
    };
    let all: Vec<(f64, f64)> = pairs.par_iter().map(one).collect::<Result<_>>()?;
    let mean = |of: &dyn Fn(&(f64, f64)) -> f64| all.iter().map(of).sum::<f64>() / all.len() as f64;
    Ok((mean(&|a| a.0), mean(&|a| a.1)))
}

fn ffmpeg(arguments: &[&OsStr]) -> Result<()> {
    let done = Command::new("ffmpeg")
        .args(["-y", "-hide_banner", "-loglevel", "error", "-nostdin"])
        .args(arguments)
        .stdout(Stdio::null())
        .output()
        .context("ffmpeg cannot be started; install it (Debian: apt install ffmpeg)")?;
    if !done.status.success() {
        bail!("ffmpeg failed: {}", String::from_utf8_lossy(&done.stderr).trim());
    }
    Ok(())
}

/// Encodes and judges everything; each row goes to `heard` when it is there.
///
/// # Errors
/// Folders that cannot be read, truths without frames, sizes that differ, and whatever ffmpeg says.
pub fn run(study: &Study, mut heard: impl FnMut(&Row)) -> Result<Found> {
    let frames = pictures(&study.frames)?;
    let truths = pictures(&study.truth)?;
    let place = |truth: &PathBuf| frames.iter().position(|f| f.file_name() == truth.file_name());
    let judged: Vec<(usize, PathBuf)> = truths.iter().filter_map(|t| Some((place(t)?, t.clone()))).collect();
    ensure!(!judged.is_empty(), "no truth in {} has the name of a frame", study.truth.display());
    std::fs::create_dir_all(&study.output).with_context(|| format!("cannot make {}", study.output.display()))?;
    let seconds = frames.len() as f64 / study.fps;
    let own: Vec<_> = judged.iter().map(|(k, t)| (frames[*k].clone(), t.clone())).collect();
    let (flip, psnr_db) = judge(&own)?;
    let bytes = frames.iter().filter_map(|f| Some(f.metadata().ok()?.len())).sum::<u64>();
    let mbit = |bytes: u64| bytes as f64 * 8e-6 / seconds;
    let size = |file: &Path| Ok::<_, anyhow::Error>(file.metadata().with_context(|| file.display().to_string())?.len());
    let row = Row {
        encoder: "PNG".into(),
        crf: None,
        bytes,
        first_bytes: size(&frames[0])?,
        mbit_per_s: mbit(bytes),
        flip,
        psnr_db,
        encode_ms: 0.0,
    };
    heard(&row);
    let mut rows = vec![row];
    let mut needed = Vec::new();
    let (fps, pattern) = (study.fps.to_string(), study.frames.join("*.png"));
    for encoder in &study.encoders {
        let mut own = Vec::new();
        for crf in &study.crf {
            let (file, first) = (study.output.join("video.mkv"), study.output.join("first.mkv"));
            let input = ["-framerate", &fps, "-pattern_type", "glob", "-i"].map(OsStr::new);
            let crf_text = crf.to_string();
            // One key frame, at the begin.
            let quality = ["-g", "100000", "-crf", &crf_text];
            let mut arguments = [&input[..], &[pattern.as_os_str()]].concat();
            arguments.extend(EXACT_COLOURS.iter().chain(encoder.options()).chain(&quality).map(OsStr::new));
            let start = Instant::now();
            ffmpeg(&[&arguments[..], &[file.as_os_str()]].concat())?;
            let encode_ms = start.elapsed().as_secs_f64() * 1e3 / frames.len() as f64;
            ffmpeg(&[&arguments[..], &["-frames:v", "1"].map(OsStr::new), &[first.as_os_str()]].concat())?;
            let (bytes, first_bytes) = (size(&file)?, size(&first)?);
            let decoded = study.output.join("decoded");
            let _ = std::fs::remove_dir_all(&decoded);
            std::fs::create_dir_all(&decoded).with_context(|| format!("cannot make {}", decoded.display()))?;
            let out = decoded.join("%06d.png");
            let mut back = vec![OsStr::new("-i"), file.as_os_str()];
            back.extend(EXACT_COLOURS.iter().chain(&["-pix_fmt", "rgb24", "-fps_mode", "passthrough"]).map(OsStr::new));
            back.push(out.as_os_str());
            ffmpeg(&back)?;
            // Numbered from 1 on.
            let pairs: Vec<_> =
                judged.iter().map(|(k, t)| (decoded.join(format!("{:06}.png", k + 1)), t.clone())).collect();
            let (flip, psnr_db) = judge(&pairs)?;
            std::fs::remove_dir_all(&decoded)?;
            std::fs::remove_file(&file)?;
            std::fs::remove_file(&first)?;
            let mbit_per_s = mbit(bytes);
            let row = Row {
                encoder: encoder.name().into(),
                crf: Some(*crf),
                bytes,
                first_bytes,
                mbit_per_s,
                flip,
                psnr_db,
                encode_ms,
            };
            heard(&row);
            own.push((flip, mbit_per_s));
            rows.push(row);
        }
        let mbit_per_s = study.flip.and_then(|flip| between(&own, flip));
        needed.push(Needed { encoder: encoder.name().into(), mbit_per_s });
    }
    Ok(Found { frames: [frames.len(), judged.len()], seconds, rows, needed })
}

/// The rate for an error, from pairs of error and rate: between the two neighbours in error,
/// evenly in the logarithm of the rate.
fn between(pairs: &[(f64, f64)], flip: f64) -> Option<f64> {
    let mut sorted = pairs.to_vec();
    sorted.sort_by(|a, b| a.0.total_cmp(&b.0));
    let above = sorted.iter().position(|p| p.0 >= flip)?;
    let (high, low) = (sorted[above], sorted[above.checked_sub(1)?]);
    let part = (flip - low.0) / (high.0 - low.0);
    Some((low.1.ln() * (1.0 - part) + high.1.ln() * part).exp())
}

/// A row as a line.
pub fn line(r: &Row) -> String {
    let crf = r.crf.map_or("-".into(), |c| c.to_string());
    let (encoder, first_kb) = (&r.encoder, r.first_bytes as f64 / 1e3);
    format!(
        "| {encoder} | {crf} | {:.2} | {:.4} | {:.1} | {:.1} | {first_kb:.0} |",
        r.mbit_per_s, r.flip, r.psnr_db, r.encode_ms
    )
}

/// The table.
pub fn table(found: &Found, flip: Option<f64>) -> String {
    let mut t = format!(
        "{} frames, {:.1} s, {} of them judged\n\n| encoder | crf | Mbit/s | FLIP | PSNR, dB | ms per frame | first frame, kB |\n|---|---|---|---|---|---|---|\n",
        found.frames[0], found.seconds, found.frames[1]
    );
    for r in &found.rows {
        let _ = writeln!(t, "{}", line(r));
    }
    if let Some(flip) = flip {
        for n in &found.needed {
            let rate = n.mbit_per_s.map_or("outside of these settings".into(), |m| format!("{m:.2} Mbit/s"));
            let _ = writeln!(t, "{} at FLIP {flip:.4}: {rate}", n.encoder);
        }
    }
    t
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rates_lie_between_their_neighbours() {
        let pairs = [(0.04, 1.0), (0.01, 16.0), (0.02, 4.0)];
        assert!((between(&pairs, 0.015).expect("inside") - 8.0).abs() < 1e-9);
        assert!((between(&pairs, 0.03).expect("inside") - 2.0).abs() < 1e-9);
        assert_eq!((between(&pairs, 0.005), between(&pairs, 0.05)), (None, None));
    }
}
