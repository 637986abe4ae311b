//! `ldi-server serve`: streams a dataset to walkers over QUIC and shows its plan over HTTP.
//!
//! In: datasets by name ([`ChunkSource`]) and settings ([`ServeConfig`]). Out: to each walker, chunks
//! in the order in which it will need them; to a browser, health, metrics and a page with the plan
//! from above.
//!
//! - [`planner`]: what to send next; pure, time comes in.
//! - [`session`]: one connection; [`control`]: its messages; [`push`]: chunks on their way;
//!   [`requests`]: chunks by number or name.
//! - [`source`]: where bytes come from; [`offer`]: what newcomers get; [`views`]: what a pose
//!   needs; [`walkers`]: who is connected.
//! - [`admission`]: who is let in; [`transport`], [`identity`], [`limits`], [`config`]. [`veno`]:
//!   congestion control; [`meter`]: what the link delivers.
//! - [`http`], [`plan`]: health, metrics and the page.
//!
//! `docs/reference/protocol.md` describes what travels.

mod addresses;
mod admission;
mod config;
mod control;
mod error;
mod http;
mod identity;
mod limits;
mod meter;
mod offer;
mod plan;
pub mod planner;
mod push;
mod requests;
mod server;
mod session;
mod source;
mod transport;
mod veno;
mod views;
mod walkers;

pub use config::{ConfigError, Congestion, HttpAt, ServeConfig};
pub use error::ServeError;
pub use identity::{Identity, IdentityError, state_folder};
pub use meter::Meter;
pub use offer::NamedSources;
pub use push::{FINISH_BELOW, send_window};
pub use server::{Datasets, Server, check, serve};
pub use source::ChunkSource;
pub use views::{GUESSED_FINER, SelectViews};
