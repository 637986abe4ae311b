//! Errors of the command line with their exit codes.

use ldi_client::{
    engine::{RenderError, WalkError},
    gpu::GpuError,
    stream::ConnectError,
};
use ldi_protocol::said::is_lasting;

/// An error with its exit code.
pub struct Failure {
    pub code: u8,
    pub error: anyhow::Error,
}

impl Failure {
    pub fn usage(message: impl Into<String>) -> Self {
        Self { code: 2, error: anyhow::anyhow!(message.into()) }
    }
    pub fn permanent(error: impl Into<anyhow::Error>) -> Self {
        Self { code: 42, error: error.into() }
    }
}

impl From<ConnectError> for Failure {
    fn from(e: ConnectError) -> Self {
        Self { code: e.exit_code(), error: e.into() }
    }
}

impl From<WalkError> for Failure {
    fn from(e: WalkError) -> Self {
        let code = match &e {
            WalkError::Folder { source, .. } if is_lasting(source) => 42,
            WalkError::Disconnected { .. } | WalkError::Save(_) | WalkError::Folder { .. } => 1,
            WalkError::Paint(RenderError::Warp(_)) => 2,
            WalkError::Paint(RenderError::Gpu(e)) => gpu_exit_code(e),
            WalkError::Judge(_) => 42,
        };
        Self { code, error: e.into() }
    }
}

/// A failed driver may work on a retry; one that lacks a feature will not.
fn gpu_exit_code(e: &GpuError) -> u8 {
    match e {
        GpuError::Failed { .. } => 1,
        GpuError::Stamp(_) | GpuError::Order(_) => 2,
        GpuError::NoAdapter(_) | GpuError::Lacking { .. } => 42,
    }
}

impl From<GpuError> for Failure {
    fn from(e: GpuError) -> Self {
        Self { code: gpu_exit_code(&e), error: e.into() }
    }
}
