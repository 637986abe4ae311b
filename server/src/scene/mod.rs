//! Stage 1: a scene, from a file or built in.
//!
//! In: a glTF/GLB, OBJ or PLY file, or `builtin:NAME?triangles=N&seed=S`. Out: a [`Scene`]: meshes once, instances as
//! references, materials and textures, all validated: finite values, indices in range, no cycles. What a later stage
//! reads here it may trust.

mod model;

pub use model::{Instance, Mesh, Note, Primitive, RoomAnnotation, PortalAnnotation, Scene, SceneTexture};
