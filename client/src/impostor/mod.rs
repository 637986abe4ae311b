//! Hierarchical image caching (Shade, Lischinski, Salesin, DeRose, Snyder 1996): distant geometry
//! is drawn from images of previous frames.
//!
//! In: the cells of a dataset, resident data, a pose. Out: colour and disparity of the nearest
//! surface at every pixel. Nothing is precomputed: a BSP tree (`bsp`) over the cells' boxes is
//! built when the dataset is known. A node whose appearance will stay valid for some time is drawn
//! to an image (`image`), which replaces it as long as no corner of its box is displaced by more
//! than some pixels (`safety_zone`).
//!
//! As in the paper each frame first decides for every visible node: draw its cached image, its
//! geometry, or its children; then it draws. Changes against the paper:
//! - Of the images worth making, those that save the most are made first, for at most
//!   [`ImpostorSettings::spare_ms`] or [`ImpostorSettings::spare_share`] of additional time: no
//!   frame stalls.
//! - Images and geometry are composited by depth per pixel instead of back to front, as near
//!   geometry may intersect the images' planes.
//! - Image planes face the eye instead of being parallel to the picture, so that turning the head
//!   costs nothing.

mod bsp;
mod costs;
mod image;
mod safety_zone;

use crate::{
    frame::Frame,
    near::{NearStats, Rasterizer, gather::gather_within},
    resident::Resident,
};
use bsp::{Bsp, Content, Object};
use costs::Costs;
use glam::DVec3;
use image::{Framing, ImpostorImage};
use ldi_protocol::{
    Aabb, OutputCamera, Pose,
    index::{CellEntry, DrawnCell, Index},
    select::DrawFrusta,
};
use safety_zone::{EyeMotion, both};
use std::{collections::BTreeMap, time::Instant};

/// Settings of image caching.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ImpostorSettings {
    /// Largest displacement of a corner of a node's box, pixels.
    pub error_px: f64,
    /// Additional time of a frame for making images, milliseconds.
    pub spare_ms: f64,
    /// Additional time as a share of the previous frame's time, if that is more, so that slow
    /// scenes get images as well. The default is a judgement.
    pub spare_share: f64,
    /// Capacity for images, bytes.
    pub bytes: usize,
    /// Largest number of triangles of a leaf with several cells. Smaller: images cost more than the
    /// geometry they replace.
    pub leaf_triangles: u64,
    /// Margin around a node in its image, as a share of the node's size per side, so that no cracks
    /// open between nodes (the paper: 17 percent in all).
    pub inflated: f64,
}

impl Default for ImpostorSettings {
    fn default() -> Self {
        Self {
            error_px: 2.0,
            spare_ms: 8.0,
            spare_share: 0.25,
            bytes: 512 << 20,
            leaf_triangles: 4096,
            inflated: 0.085,
        }
    }
}

/// Statistics of cached images in a frame.
#[derive(Debug, Clone, Copy, Default, PartialEq)]
pub struct ImpostorStats {
    /// Images drawn.
    pub images: u32,
    /// Images made.
    pub made: u32,
    /// Milliseconds for geometry.
    pub near_ms: f64,
    /// Milliseconds for drawing images.
    pub images_ms: f64,
    /// Milliseconds for making images.
    pub made_ms: f64,
    /// Memory of all cached images, bytes.
    pub bytes: usize,
}

/// Cached images of the nodes of a dataset.
#[derive(Debug, Default)]
pub struct Impostors {
    /// Settings.
    pub settings: ImpostorSettings,
    nodes: Nodes,
    cached: BTreeMap<u32, Cached>,
    costs: Costs,
    eye_motion: EyeMotion,
    frame: u64,
    /// Time of the previous frame without making images, milliseconds.
    drew_ms: f64,
    rasterizer: Rasterizer,
    drawing: Frame,
    neighbours: Frame,
}

/// The tree of a dataset.
#[derive(Debug, Default)]
struct Nodes {
    /// Number of cells and triangles that the tree was built for.
    of: (usize, u64),
    tree: Bsp,
    parents: Vec<u32>,
    /// Inflated boxes of the nodes.
    inflated: Vec<Aabb>,
    /// Estimated number of other nodes' triangles in the inflated boxes.
    around: Vec<u64>,
}

#[derive(Debug)]
struct Cached {
    picture: ImpostorImage,
    /// Zone in which its source images are valid.
    parts: Aabb,
    /// Its safety zone within `parts`.
    zone: Aabb,
    /// Frame in which it was last drawn.
    used: u64,
}

/// Inputs of a frame.
struct FrameInputs<'a> {
    index: &'a Index,
    resident: &'a dyn Resident,
    camera: &'a OutputCamera,
    pose: &'a Pose,
    frusta: DrawFrusta,
    eye_motion: EyeMotion,
    angle: f64,
}

impl FrameInputs<'_> {
    /// Whether a cell is resident with all its geometry and textures, at any level.
    fn has(&self, cell: u32) -> bool {
        let entry = &self.index.cells[cell as usize];
        let texture = |material: &u32| self.index.materials.get(*material as usize)?.texture;
        self.resident.cell(cell).is_some()
            && entry.bundles.iter().all(|b| self.resident.bundle(*b).is_some())
            && entry.materials.iter().filter_map(texture).all(|t| self.resident.texture(t).is_some())
    }
}

/// The decision for each node of a frame.
#[derive(Debug, Default)]
struct DrawPlan {
    /// Leaves drawn as geometry.
    geometry: Vec<u32>,
    /// Nodes drawn from images.
    images: Vec<u32>,
    /// Images worth making.
    candidates: Vec<Candidate>,
}

#[derive(Debug, Clone, Copy)]
struct Candidate {
    node: u32,
    framing: Framing,
    /// Zone in which its source images are valid.
    parts: Aabb,
    /// Its safety zone within `parts`.
    zone: Aabb,
    /// Expected number of frames of use.
    life: f64,
    /// Expected time of making it.
    ms: f64,
    /// Time saved per frame.
    saved_ms: f64,
}

impl Candidate {
    /// Time saved over its life, minus the time of making it (the paper's amortized cost compared
    /// with that of its content).
    fn gain_ms(&self) -> f64 {
        self.saved_ms * self.life - self.ms
    }
}

/// The unbounded box.
const ANYWHERE: Aabb = Aabb { min: DVec3::NEG_INFINITY, max: DVec3::INFINITY };

fn ms_since(start: Instant) -> f64 {
    start.elapsed().as_secs_f64() * 1e3
}

impl Nodes {
    fn new(index: &Index, settings: &ImpostorSettings) -> Self {
        let objects: Vec<Object> =
            index.cells.iter().map(|c| Object { bounds: c.bounds, triangles: c.triangles.into() }).collect();
        let tree = Bsp::new(&objects, settings.leaf_triangles);
        let mut parents = vec![0; tree.nodes.len()];
        for (number, node) in (0u32..).zip(&tree.nodes) {
            if let Content::Inner(children) = node.content {
                children.iter().for_each(|c| parents[*c as usize] = number);
            }
        }
        let inflated = |b: &Aabb| {
            let by = b.size() * settings.inflated;
            Aabb { min: b.min - by, max: b.max + by }
        };
        let inflated: Vec<Aabb> = tree.nodes.iter().map(|n| inflated(&n.bounds)).collect();
        let of = (index.cells.len(), index.scene.triangles);
        let mut nodes = Self { of, tree, parents, inflated, around: Vec::new() };
        nodes.around = (0..nodes.inflated.len() as u32).map(|n| nodes.triangles_around(index, n)).collect();
        nodes
    }

    fn children(&self, node: u32) -> Option<[u32; 2]> {
        match self.tree.nodes[node as usize].content {
            Content::Inner(children) => Some(children),
            Content::Leaf(_) => None,
        }
    }

    /// Number of other nodes' triangles in a node's inflated box, assuming a uniform distribution
    /// in cells.
    fn triangles_around(&self, index: &Index, node: u32) -> u64 {
        let bounds = &self.inflated[node as usize];
        let cells = self.cells_around(index, node);
        let within = |c: &CellEntry| f64::from(c.triangles) * share(&c.bounds, bounds);
        cells.iter().map(|c| within(&index.cells[*c as usize])).sum::<f64>().ceil() as u64
    }

    /// Cells outside of a node that touch its inflated box.
    fn cells_around(&self, index: &Index, but: u32) -> Vec<u32> {
        let bounds = &self.inflated[but as usize];
        let mut found = Vec::new();
        let mut open = vec![0];
        while let Some(node) = open.pop() {
            let n = &self.tree.nodes[node as usize];
            if node == but || !n.bounds.intersects(bounds) {
                continue;
            }
            match &n.content {
                Content::Inner(children) => open.extend(children),
                Content::Leaf(cells) => {
                    found.extend(cells.iter().filter(|c| index.cells[**c as usize].bounds.intersects(bounds)));
                }
            }
        }
        found
    }
}

/// Share of a box that lies in another, 0 to 1; for a flat one, of its area.
fn share(of: &Aabb, within: &Aabb) -> f64 {
    let (size, part) = (of.size(), both(of, within).size());
    (0..3).map(|k| if size[k] > 0.0 { (part[k] / size[k]).max(0.0) } else { 1.0 }).product()
}

impl Impostors {
    /// Draws the visible cells into `frame`, which is resized and cleared: as geometry, or from
    /// images. `may_make`: the previous frame was complete, so that images made now stay valid.
    pub fn draw(
        &mut self,
        (index, resident): (&Index, &dyn Resident),
        (camera, pose): (&OutputCamera, &Pose),
        may_make: bool,
        frame: &mut Frame,
    ) -> (NearStats, ImpostorStats) {
        if self.nodes.of != (index.cells.len(), index.scene.triangles) {
            (self.nodes, self.cached) = (Nodes::new(index, &self.settings), BTreeMap::new());
        }
        self.frame += 1;
        self.eye_motion = self.eye_motion.then(pose.position);
        let inputs = FrameInputs {
            index,
            resident,
            camera,
            pose,
            frusta: DrawFrusta::new(&index.settings, pose, (camera.half_tan_x(), camera.half_tan_y())),
            eye_motion: self.eye_motion,
            angle: self.settings.error_px / camera.focal_px(),
        };
        let mut drawn = ImpostorStats::default();
        let start = Instant::now();
        let mut plan = self.plan(&inputs, may_make);
        if !plan.candidates.is_empty() {
            drawn.made = self.make_best(std::mem::take(&mut plan.candidates), &inputs);
            if drawn.made > 0 {
                plan = self.plan(&inputs, false);
            }
        }
        drawn.made_ms = ms_since(start);
        let start = Instant::now();
        let cells = self.cells_of(&plan.geometry, &inputs);
        let stats = self.rasterizer.draw(index, resident, &DrawnCell::all_full(cells), camera, pose, frame);
        drawn.near_ms = ms_since(start);
        self.costs.drew_geometry(drawn.near_ms, stats.triangles);
        let start = Instant::now();
        drawn.images = self.draw_images(&plan.images, &inputs, frame);
        drawn.images_ms = ms_since(start);
        self.drew_ms = drawn.near_ms + drawn.images_ms;
        drawn.bytes = self.evict();
        (stats, drawn)
    }

    /// Whether a node's image is valid for an eye.
    fn is_valid(&self, node: u32, eye: DVec3, angle: f64) -> bool {
        self.cached.get(&node).is_some_and(|c| {
            let framing = &c.picture.framing;
            let error = framing.plane.error(&self.nodes.inflated[node as usize], eye);
            error.is_some_and(|e| e <= angle) && framing.is_sharp(eye) && c.parts.contains(eye)
        })
    }

    /// The first traversal of the paper: decides on every node.
    fn plan(&self, inputs: &FrameInputs<'_>, may_make: bool) -> DrawPlan {
        let nodes = &self.nodes.tree.nodes;
        let mut plan = DrawPlan::default();
        let eye = inputs.pose.position;
        let valid: Vec<bool> = (0..nodes.len() as u32).map(|n| self.is_valid(n, eye, inputs.angle)).collect();
        // Cost of each node's content, visible and in total, milliseconds. Children come after
        // their parents.
        let mut contents = vec![[0.0; 2]; nodes.len()];
        let mut as_drawn = contents.clone();
        for (number, node) in nodes.iter().enumerate().rev().filter(|_| may_make) {
            let seen = |ms: f64| [ms, if inputs.frusta.admit(&node.bounds) { ms } else { 0.0 }];
            contents[number] = match node.content {
                Content::Leaf(_) => seen(self.costs.geometry_ms(node.triangles)),
                Content::Inner([a, b]) => [0, 1].map(|k| as_drawn[a as usize][k] + as_drawn[b as usize][k]),
            };
            let image = self.cached.get(&(number as u32)).filter(|_| valid[number]);
            as_drawn[number] =
                image.map_or(contents[number], |c| seen(self.costs.image_ms(c.picture.framing.pixels())));
        }
        let mut open = if nodes.is_empty() { Vec::new() } else { vec![0u32] };
        while let Some(node) = open.pop() {
            if !inputs.frusta.admit(&nodes[node as usize].bounds) {
                continue;
            }
            if valid[node as usize] {
                plan.images.push(node);
                continue;
            }
            match self.nodes.children(node) {
                Some(children) => open.extend(children),
                None => plan.geometry.push(node),
            }
            if may_make && self.costs.are_known() {
                plan.candidates.extend(self.candidate(node, inputs, contents[node as usize]));
            }
        }
        plan
    }

    /// A candidate for an image of a node, if it is worth making.
    fn candidate(&self, node: u32, inputs: &FrameInputs<'_>, contents_ms: [f64; 2]) -> Option<Candidate> {
        let bounds = &self.nodes.inflated[node as usize];
        let framing = Framing::new(bounds, inputs.pose.position, inputs.camera)?;
        let parts = self.parts_zone(node, inputs);
        let zone = both(&framing.plane.safety_zone(bounds, inputs.angle)?, &parts);
        let life = inputs.eye_motion.life_span(&zone);
        let shown_ms = self.costs.image_ms(framing.pixels());
        let [all_ms, seen_ms] = contents_ms;
        let around_ms = self.costs.geometry_ms(self.nodes.around[node as usize]);
        let ms = all_ms + around_ms + self.costs.making_ms(framing.pixels());
        let saved_ms = seen_ms - shown_ms;
        let candidate = Candidate { node, framing, parts, zone, life, ms, saved_ms };
        (candidate.gain_ms() > 0.0).then_some(candidate)
    }

    /// Whether a node's image can be part of another: the eye must be in its safety zone.
    fn is_part(&self, node: u32, inputs: &FrameInputs<'_>) -> bool {
        let eye = inputs.pose.position;
        self.cached.get(&node).is_some_and(|c| c.zone.contains(eye)) && self.is_valid(node, eye, inputs.angle)
    }

    /// The zone in which all source images of a node's image are valid.
    fn parts_zone(&self, node: u32, inputs: &FrameInputs<'_>) -> Aabb {
        let mut zone = ANYWHERE;
        self.parts_of(node, inputs, &mut |below, is_image| {
            if let Some(cached) = self.cached.get(&below).filter(|_| is_image) {
                zone = both(&zone, &cached.zone);
            }
        });
        zone
    }

    /// The sources of a node's image: images and leaves below it.
    fn parts_of(&self, node: u32, inputs: &FrameInputs<'_>, visit: &mut impl FnMut(u32, bool)) {
        let mut open = vec![node];
        while let Some(below) = open.pop() {
            match self.nodes.children(below) {
                _ if below != node && self.is_part(below, inputs) => visit(below, true),
                Some(children) => open.extend(children),
                None => visit(below, false),
            }
        }
    }

    /// Visible cells of leaves, near to far.
    fn cells_of(&self, leaves: &[u32], inputs: &FrameInputs<'_>) -> Vec<u32> {
        let mut cells = Vec::new();
        leaves.iter().for_each(|leaf| self.nodes.tree.objects_of(*leaf, &mut |cell| cells.push(cell)));
        cells.retain(|c| inputs.frusta.admit(&inputs.index.cells[*c as usize].bounds));
        near_to_far(inputs.index, &mut cells, inputs.pose.position);
        cells
    }

    fn draw_images(&mut self, nodes: &[u32], inputs: &FrameInputs<'_>, frame: &mut Frame) -> u32 {
        let start = Instant::now();
        let mut pixels = 0;
        for node in nodes {
            if let Some(image) = self.cached.get_mut(node) {
                image.used = self.frame;
                pixels += image.picture.draw(inputs.camera, inputs.pose, frame);
            }
        }
        self.costs.drew_images(ms_since(start), pixels);
        nodes.len() as u32
    }

    /// Makes the images that save the most, none of them above or below another.
    fn make_best(&mut self, mut candidates: Vec<Candidate>, inputs: &FrameInputs<'_>) -> u32 {
        candidates.sort_by(|a, b| {
            let gain = |c: &Candidate| c.gain_ms() / c.ms;
            gain(b).total_cmp(&gain(a)).then(a.node.cmp(&b.node))
        });
        // Additional time of the frame: measured for making, estimated for savings.
        let mut longer_ms = 0.0;
        let spare_ms = self.settings.spare_ms.max(self.settings.spare_share * self.drew_ms);
        let mut made: Vec<u32> = Vec::new();
        for candidate in candidates {
            if longer_ms + candidate.ms - candidate.saved_ms > spare_ms {
                continue;
            }
            let related = |other: &u32| {
                let is_above = |mut node: u32, other: u32| {
                    while node > other {
                        node = self.nodes.parents[node as usize];
                    }
                    node == other
                };
                is_above(candidate.node, *other) || is_above(*other, candidate.node)
            };
            let start = Instant::now();
            if !made.iter().any(related)
                && let Some(picture) = self.make(&candidate, inputs)
            {
                longer_ms += ms_since(start) - candidate.saved_ms;
                self.cached.insert(
                    candidate.node,
                    Cached { picture, parts: candidate.parts, zone: candidate.zone, used: self.frame },
                );
                made.push(candidate.node);
            }
        }
        made.len() as u32
    }

    /// Makes the image of a node, from other images if possible. None if some of its content is
    /// absent.
    fn make(&mut self, candidate: &Candidate, inputs: &FrameInputs<'_>) -> Option<ImpostorImage> {
        let start = Instant::now();
        let Candidate { node, framing, .. } = candidate;
        let (mut own, mut images) = (Vec::new(), Vec::new());
        self.parts_of(*node, inputs, &mut |below, is_image| match is_image {
            true => images.push(below),
            false => self.nodes.tree.objects_of(below, &mut |cell| own.push(cell)),
        });
        let inflated = self.nodes.inflated[*node as usize];
        if !own.iter().all(|cell| inputs.has(*cell)) {
            return None;
        }
        // Absent cells around it are not visible, and cause no cracks.
        let mut around = self.nodes.cells_around(inputs.index, *node);
        around.retain(|cell| inputs.has(*cell));
        let (camera, pose) = (&framing.camera, &framing.pose);
        [&mut own, &mut around].into_iter().for_each(|cells| near_to_far(inputs.index, cells, inputs.pose.position));
        let (index, resident) = (inputs.index, inputs.resident);
        let stats = self.rasterizer.draw(index, resident, &DrawnCell::all_full(own), camera, pose, &mut self.drawing);
        let gathered = gather_within(index, resident, &DrawnCell::all_full(around), &inflated);
        let neighbours = self.rasterizer.draw_gathered(gathered, (camera, pose), &mut self.neighbours);
        let triangles = stats.triangles + neighbours.triangles;
        framing.bring_in(&inflated, &self.neighbours, &mut self.drawing);
        for image in images {
            if let Some(cached) = self.cached.get(&image) {
                cached.picture.draw(camera, pose, &mut self.drawing);
            }
        }
        self.costs.made_image(ms_since(start), triangles, framing.pixels());
        Some(ImpostorImage::new(*framing, &self.drawing))
    }

    /// Evicts images that were not drawn for longest, until the rest fits. Returns its bytes.
    fn evict(&mut self) -> usize {
        let mut bytes: usize = self.cached.values().map(|c| c.picture.bytes()).sum();
        while bytes > self.settings.bytes {
            let Some((&oldest, cached)) = self.cached.iter().min_by_key(|(_, c)| c.used) else { break };
            bytes -= cached.picture.bytes();
            self.cached.remove(&oldest);
        }
        bytes
    }
}

fn near_to_far(index: &Index, cells: &mut [u32], eye: DVec3) {
    cells.sort_by_cached_key(|c| (index.cells[*c as usize].bounds.distance(eye).to_bits(), *c));
}

#[cfg(test)]
mod tests;
