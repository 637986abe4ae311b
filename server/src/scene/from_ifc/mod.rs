//! Industry Foundation Classes in STEP text: IFC 2x3, 4 and 4.3 (ISO 16739, ISO 10303-21).
//!
//! In: the bytes of an `.ifc` file. Out: a [`Scene`] in metres, Y up, in the file's world frame, so
//! that several files of one project fit together: a mesh per item of a product's body, shared by
//! products that place the same item ([`products`]); the colours of styles and materials; rooms of
//! `IfcSpace` and the openings between them where the user asks for them ([`rooms`]); and what each
//! node is ([`SceneElement`]).
//!
//! Read by the crates `ifc-lite-core` (records) and `ifc-lite-processing` (shapes, openings cut out
//! of walls, styles). They run on threads with large stacks, since shapes nest, and behind
//! [`guarded`]; [`text`] bounds what a file may ask of them before they see it, and reading ends
//! between batches of products once the shapes exceed the limits. `docs/adr/0054` has the reasons.
//!
//! [`SceneElement`]: super::model::SceneElement

mod mapped;
mod products;
mod rooms;
mod text;

use glam::{DAffine3, DMat3, DVec3};
use ifc_lite_processing::{Batching, Features, ProcessingRequest, ProcessingResult, geometry_pool_builder, process};

use super::error::Fault;
use super::files::{Files, listed};
use super::guard::guarded;
use super::limits::Limits;
use super::model::{Note, Scene};
use products::Products;

/// Products that are triangulated before their sizes are compared with the limits. Larger numbers
/// let a hostile file take more memory; smaller ones leave processors idle.
const BATCH: usize = 256;

/// The scene's Y is up, the file's Z.
fn y_up_from_z_up() -> DAffine3 {
    DAffine3::from_mat3(DMat3::from_cols(DVec3::X, -DVec3::Z, DVec3::Y))
}

/// Whether bytes are an IFC file in STEP text, whatever its name ends in.
pub(super) fn is_ifc(bytes: &[u8]) -> bool {
    text::schema(bytes).is_some_and(|schema| schema.starts_with("IFC"))
}

/// Reads an IFC file.
pub(super) fn import(name: &str, bytes: &[u8], files: &Files, limits: &Limits) -> Result<Scene, Fault> {
    guarded("data", || text::check(bytes, limits))?;
    let (products, result) = guarded("file", || triangulated(bytes, limits))?;
    if let Some(record) = result.metadata.length_unit_refused {
        let place = format!("#{record}");
        return Err(Fault::invalid(place, "the length unit is no positive number of metres", "export the file again"));
    }
    let refused = result.stats.refused_input_elements;
    let failed_cuts = result.stats.total_csg_failures;
    let unread = result.stats.geometry_diagnostics.map(|d| d.unsupported_items_by_type).unwrap_or_default();
    let collected = products.collected()?;
    let mut scene = Scene { name: name.to_owned(), ..collected.scene };
    if scene.triangles() == 0 {
        let remedy = "export the building elements with their bodies, as the reference view does";
        return Err(Fault::invalid("file", "has no product with a body of surfaces", remedy));
    }
    let mut note = |count: u64, what: &str, why: &str| {
        if count > 0 {
            scene.notes.push(Note { what: format!("{count} {what}"), why: why.into() });
        }
    };
    note(collected.unplaced, "triangles with a corner that is not finite", "left out");
    note(collected.textured, "textured meshes", "drawn in plain colours");
    note(refused, "products with numbers too large to read", "left out");
    let kinds: Vec<String> = unread.iter().map(|k| format!("{} {}", k.count, k.reason)).collect();
    note(unread.iter().map(|k| k.count).sum(), &format!("items of bodies: {}", listed(&kinds)), "not read, or broken");
    note(failed_cuts, "openings or clippings that could not be cut", "the uncut shape, or a part of the cut, is drawn");
    note(collected.undrawn, "shapes of openings, annotations and the like", "they are no surfaces");
    let found = match files.spaces_are_rooms {
        true => rooms::of(&collected.volumes, limits),
        false => rooms::none_of(&collected.volumes),
    };
    scene.rooms = found.rooms;
    scene.portals = found.portals;
    scene.notes.extend(found.notes);
    scene.transform(&y_up_from_z_up());
    Ok(scene)
}

/// Triangulates all products, batch by batch.
fn triangulated(bytes: &[u8], limits: &Limits) -> Result<(Products, ProcessingResult), Fault> {
    let pool = geometry_pool_builder().num_threads(rayon::current_num_threads()).build();
    let pool = pool.map_err(|e| {
        Fault::invalid("file", format!("threads to read it cannot be started: {e}"), "free memory and try again")
    })?;
    // To the log, in whose form the user wants it, and not to standard error.
    ifc_lite_core::set_report_sink(|message| tracing::warn!("{message}"));
    let mut products = Products::new(limits);
    let request = ProcessingRequest::default()
        .batching(Batching::new(BATCH, BATCH))
        .features(Features::default().properties(false).presentation_layers(false))
        .retain_meshes(false)
        .cancel(products.stop());
    let result = pool.install(|| process(bytes, &request, &mut products));
    Ok((products, result))
}
