//! Errors that end a walk.

use super::{evaluation::EvaluationError, render_backend::RenderError, save::SaveError};
use std::path::PathBuf;

/// A walk failed.
#[derive(Debug, thiserror::Error)]
pub enum WalkError {
    /// The connection is lost.
    #[error("the connection was lost at pose {pose}: {reason}; start the walk again")]
    Disconnected {
        /// Index of the pose.
        pose: usize,
        /// The cause.
        reason: String,
    },
    /// A picture could not be written.
    #[error(transparent)]
    Save(#[from] SaveError),
    /// The ground truth cannot be used.
    #[error(transparent)]
    Judge(#[from] EvaluationError),
    /// The options contradict each other, or the GPU fails.
    #[error(transparent)]
    Paint(#[from] RenderError),
    /// The folder of the frames could not be made.
    #[error("{path}: {source}; give -o a folder that can be written")]
    Folder {
        /// The folder.
        path: PathBuf,
        /// The cause.
        source: std::io::Error,
    },
}
