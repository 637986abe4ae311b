//! The server: builds datasets from scenes and serves them. Folders are stages; a module imports only from stages before it.

pub mod octree;
pub mod scene;
