//! The choice of the device that warps, and the result of the comparison.

use serde::Serialize;

/// The device that warps.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, clap::ValueEnum)]
#[serde(rename_all = "lowercase")]
pub enum WarpOn {
    /// The faster device.
    #[default]
    Auto,
    /// The CPU.
    Cpu,
    /// The GPU.
    Gpu,
}

/// Result of the calibration.
#[derive(Debug, Clone, Copy, PartialEq, Serialize)]
pub struct Calibration {
    /// Whether the GPU warps.
    pub on_card: bool,
    /// Milliseconds of the calibration image on the GPU; None if nothing was compared.
    pub card_ms: Option<f64>,
    /// Milliseconds on the CPU.
    pub processor_ms: Option<f64>,
}

impl std::fmt::Display for Calibration {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(if self.on_card { "the card" } else { "the processor" })?;
        match (self.card_ms, self.processor_ms) {
            (Some(card), Some(processor)) => {
                write!(f, " ({card:.1} ms on the card, {processor:.1} ms on the processor)")
            }
            _ => Ok(()),
        }
    }
}
