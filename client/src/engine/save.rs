//! Pictures on disk: frames and debug views.

use super::display_mode::DisplayMode;
use crate::frame::Frame;
use image::{
    ExtendedColorType, ImageEncoder,
    codecs::png::{CompressionType, FilterType, PngEncoder},
};
use std::{
    fs,
    io::BufWriter,
    path::{Path, PathBuf},
};

/// A picture could not be written.
#[derive(Debug, thiserror::Error)]
#[error("{path}: {source}; check that the folder is writable and the disk not full")]
pub struct SaveError {
    path: PathBuf,
    source: image::ImageError,
}

/// Writes RGB bytes as PNG.
pub(crate) fn save_rgb(path: &Path, width: u32, height: u32, rgb: &[u8]) -> Result<(), SaveError> {
    let failed = |source: image::ImageError| SaveError { path: path.to_owned(), source };
    let file = fs::File::create(path).map_err(|e| failed(e.into()))?;
    // Fast compression: a walk writes hundreds of pictures while it runs.
    PngEncoder::new_with_quality(BufWriter::new(file), CompressionType::Fast, FilterType::Adaptive)
        .write_image(rgb, width, height, ExtendedColorType::Rgb8)
        .map_err(failed)
}

/// Writes `frame_NNNNN.png`.
pub fn save_frame(folder: &Path, index: usize, frame: &Frame) -> Result<(), SaveError> {
    save_rgb(&folder.join(format!("frame_{index:05}.png")), frame.width, frame.height, &frame.to_rgb8())
}

/// Writes `frame_NNNNN.near.png` (geometry), `.far.png` (images) and `.source.png` (orange
/// geometry, blue images, green the LDI tree, pink filled, red unpainted, sky in its own colour).
pub fn save_debug_views(folder: &Path, index: usize, frame: &Frame) -> Result<(), SaveError> {
    for (name, shows) in [("near", DisplayMode::Near), ("far", DisplayMode::Far), ("source", DisplayMode::Sources)] {
        let mut view = frame.clone();
        shows.recolour(&mut view);
        save_rgb(&folder.join(format!("frame_{index:05}.{name}.png")), view.width, view.height, &view.to_rgb8())?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frame::{Source, pack_rgb};

    #[test]
    fn pictures_come_back_and_views_show_their_part() {
        let folder = std::env::temp_dir().join(format!("ldi-save-{}", std::process::id()));
        fs::create_dir_all(&folder).expect("a folder");
        let mut frame = Frame::new(2, 1);
        frame.colour = vec![pack_rgb([10, 20, 30]), pack_rgb([200, 100, 50])];
        frame.source = vec![Source::Near, Source::Far];
        save_frame(&folder, 7, &frame).expect("written");
        save_debug_views(&folder, 7, &frame).expect("written");
        let read = |name: &str| image::open(folder.join(name)).expect("a picture").into_rgb8().into_raw();
        assert_eq!(read("frame_00007.png"), [10, 20, 30, 200, 100, 50]);
        assert_eq!(read("frame_00007.near.png"), [10, 20, 30, 24, 24, 28]);
        assert_eq!(read("frame_00007.far.png"), [24, 24, 28, 200, 100, 50]);
        let sources = read("frame_00007.source.png");
        assert!(sources[0] > sources[2] && sources[5] > sources[3], "{sources:?}");
        let error = save_frame(&folder.join("absent"), 1, &frame).expect_err("no such folder").to_string();
        assert!(error.contains("frame_00001.png"), "{error}");
        fs::remove_dir_all(&folder).expect("removed");
    }
}
