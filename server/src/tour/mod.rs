//! Makes a tour: a walk through the walk volume that visits rooms, storeys and the open.
//!
//! In: a [`WalkVolume`], rays at what stands in it, a length and a seed. Out: a [`Walk`] whose
//! poses all lie in the volume, clear of walls, at eye height.
//!
//! ```text
//!   ground    spots half a metre apart where a walker stands; whether a body passes between two
//!     v
//!   route     where to go next: what is new, far in sight and not far to walk
//!     v
//!   motion    poses along the route: looking ahead, slow in turns, at rest where much is seen
//! ```
//!
//! Spots are looked at as the route comes near them, so that cost grows with the length of the tour
//! and not with the scene. The same input gives the same tour.

mod dataset;
mod ground;
mod motion;
mod route;

#[cfg(test)]
mod tests;

pub use dataset::near_geometry;

use crate::{
    render::Caster,
    store::{REPLACE, StoreError},
};
use ldi_protocol::{codec::CodecError, path::Walk, volume::WalkVolume};

/// What a tour is like.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct TourOptions {
    /// Length, seconds.
    pub seconds: f64,
    /// Another seed gives another tour.
    pub seed: u64,
    /// Eye height above floors, metres; None: flying.
    pub eye_height_m: Option<f64>,
}

/// Why there is no tour.
#[derive(Debug, thiserror::Error)]
pub enum TourError {
    /// No place of the walk volume is clear of what stands in it.
    #[error(
        "no place in the walk volume is clear enough to walk from: look at it by `ldi-server inspect DATASET --plan plan.svg`, or name one by --start X,Y,Z"
    )]
    Nowhere,
    /// The dataset is of a version without walk volumes.
    #[error("the dataset holds no walk volume; build it again")]
    NoVolume,
    /// The dataset cannot be read.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// A cell's geometry cannot be decoded.
    #[error("chunk {chunk}: {source}; {REPLACE}")]
    Chunk {
        /// Its number.
        chunk: u32,
        /// What is wrong.
        source: CodecError,
    },
}

/// Makes a tour. The caster is one of the scene of the volume.
///
/// # Errors
/// If nobody can stand anywhere.
pub fn tour(caster: &Caster, volume: &WalkVolume, options: &TourOptions) -> Result<Walk, TourError> {
    let ground = ground::Ground::new(caster, volume, options.eye_height_m);
    let stops = route::route(&ground, options.seconds * motion::SPEED_M_S, options.seed).ok_or(TourError::Nowhere)?;
    let poses = motion::poses(&stops, options.seconds, &|eye| volume.contains(eye));
    Ok(Walk { fps: motion::FPS, speed: motion::SPEED_M_S, eye_height: options.eye_height_m, poses })
}
