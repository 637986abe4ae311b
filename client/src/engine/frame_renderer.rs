//! Renders one frame in stages: plan, acquire, near, warp, merge, underlay, resolve.
//!
//! In: a pose and the data that is resident. Out: the picture, what was drawn, what was missing,
//! milliseconds per stage. The renderer never waits: absent data is left out of the picture and
//! named.

use super::{
    display_mode::DisplayMode,
    fallback_view::{FallbackView, absent_chunks},
    image_layouts::{ImageLayout, ImageLayouts, LayoutRequest},
    layout_worker::LayoutWorker,
    options::{Appearance, Cull, Method, WalkOptions},
    render_backend::{RenderBackend, RenderError},
    upload_queue::{Anticipated, PendingUploads, UploadQueue, UploadedOnly, upload_budget_bytes, upload_cells},
    view::{Drawable, LevelStats, View, drawable, ms_since},
};
use crate::{
    composite::{
        CodeStep, CompositeOptions, CompositeStats, DepthLens, DepthShading, Far, FarImage, FarPortal, Fill, ImageGaps,
        code_steps, downsample, fill_sky, finish, merge, paint_sky, pixels_for_tree, underlay_tree,
    },
    frame::{Frame, Source, supersampled},
    gpu::{Finishing, Gpu},
    impostor::{ImpostorStats, Impostors},
    report::StageMs,
    resident::Resident,
    tree::{ProgressivePainter, TreeStats},
    warp::{FarFrame, ImageInView, WarpOptions, WarpStats, painted_onto},
};
use ldi_protocol::{
    OutputCamera, Pose,
    index::{ImageEntry, Index},
    ldi::Ldi,
    need::Sight,
    portal_view::Cone,
    shade::SKY_SRGB,
};
use std::{sync::Arc, time::Instant};

/// Statistics of a frame: times, counts, and missing data.
#[derive(Debug, Clone, Default)]
pub struct FrameStats {
    /// Near triangles submitted.
    pub triangles: u64,
    /// Levels of detail of near geometry.
    pub levels: LevelStats,
    /// Statistics of the warp; None if nothing was warped.
    pub warp: Option<WarpStats>,
    /// Statistics of the LDI tree; None if it was not drawn.
    pub tree: Option<TreeStats>,
    /// Statistics of cached images; None with other methods.
    pub cached: Option<ImpostorStats>,
    /// Chunks that the view needs and that were not resident, including finer texture levels and
    /// deeper layers; ascending.
    pub missing_chunks: Vec<u32>,
    /// Whether the index was complete.
    pub whole: bool,
    /// Resident images, geometry chunks and textures that are still being laid out or uploaded.
    /// Parts that are ready are drawn.
    pub waiting: usize,
    /// Bytes of the scene that this frame uploaded to the GPU.
    pub uploaded_bytes: u64,
    /// The placement of the fallback view; None if the view itself was drawn.
    pub fallback: Option<u32>,
    /// Whether the GPU composited near geometry and images.
    pub on_card: bool,
    /// Time by stage. `total` does not include `prepare`.
    pub ms: StageMs,
}

impl FrameStats {
    /// Whether nothing is missing from the picture.
    pub fn is_complete(&self) -> bool {
        self.whole && self.missing_chunks.is_empty() && self.waiting == 0
    }
}

/// Renders frames and keeps buffers and layouts between them.
#[derive(Debug, Default)]
pub struct FrameRenderer {
    backend: RenderBackend,
    impostors: Impostors,
    /// Whether the previous frame was complete.
    was_complete: bool,
    far: FarFrame,
    full: Frame,
    /// Pixels filled by the GPU, which `full` does not show.
    filled_on_card: u64,
    tree: ProgressivePainter,
    shading: DepthShading,
    /// Measured tree samples per millisecond; 0 before the first measurement.
    tree_rate: f64,
    /// Colours of the previous frame, for [`Fill::Last`].
    last: Vec<u32>,
    layouts: ImageLayouts,
    fallback: FallbackView,
    /// Lays out images on its own thread. Created by the first frame that needs it; None also if
    /// the system gives no thread.
    layout_worker: Option<LayoutWorker>,
    uploads: UploadQueue,
    /// Whether geometry or textures of the last frame were still being uploaded.
    late: bool,
    ahead: Anticipated,
    /// Overrides the number of bytes that a frame may upload.
    #[cfg(test)]
    pub(super) upload_budget_bytes: Option<u64>,
    /// Whether portal images are drawn as flat textures.
    textures: bool,
}

/// An image of a frame: its number, its entry, and its layers that are resident or laid out.
type FrameImage<'a> = (u32, &'a ImageEntry, Option<Arc<Ldi>>);

/// The inputs of a frame, as its stages read them.
#[derive(Clone, Copy)]
struct FrameContext<'a> {
    index: &'a Index,
    /// Decoded data; after uploading, the part that can be drawn now.
    resident: &'a dyn Resident,
    /// The view of the pose.
    own: &'a View,
    /// The view that is drawn: `own` or its fallback.
    view: &'a View,
    pose: &'a Pose,
    /// The output's camera.
    camera: &'a OutputCamera,
    /// The supersampled frame's camera.
    full_camera: OutputCamera,
    options: &'a WalkOptions,
    warp_options: WarpOptions,
    /// Whether the layout worker lays out images.
    background_layout: bool,
    /// Whether images at half resolution are drawn.
    half: bool,
}

impl<'a> FrameContext<'a> {
    /// Whether the fallback view is drawn.
    fn is_fallback(&self) -> bool {
        !std::ptr::eq(self.own, self.view)
    }

    /// The images of the drawn view.
    fn images(&self) -> Vec<FrameImage<'a>> {
        let image = |i: &u32| Some((*i, self.index.images.get(*i as usize)?, self.resident.ldi(*i)));
        self.view.images.iter().filter_map(image).collect()
    }

    /// Whether painted pixels may hide missing data: cells beyond the budget may hide areas that no
    /// image shows.
    fn is_doubtful(&self, gaps: Gaps) -> bool {
        gaps.any || self.view.dropped > 0
    }
}

/// Whether data is missing from a frame.
#[derive(Debug, Clone, Copy)]
struct Gaps {
    /// From near geometry.
    near: bool,
    /// From near geometry, images or the index.
    any: bool,
}

/// A merged frame.
struct Merged {
    /// A bit per pixel that nothing reached, if the GPU merged.
    open: Option<Vec<u32>>,
    stats: CompositeStats,
    /// Whether an image or the tree was drawn.
    known: bool,
    /// Precision of the images' disparities.
    steps: Vec<CodeStep>,
}

/// The chunks of an image that are not there.
fn absent_layers<'a>(entry: &'a ImageEntry, ldi: Option<&Ldi>) -> &'a [u32] {
    match ldi {
        None => &entry.chunks,
        // Images are stored as one or two chunks: the first layer, and the rest.
        Some(ldi) if entry.chunks.len() > 1 && ldi.layers.len() < entry.samples_by_layer.len() => &entry.chunks[1..],
        Some(_) => &[],
    }
}

/// The rectangle of the picture that cones reach, with a margin: left, top, right, bottom.
fn rectangle(cones: &[Cone], pose: &Pose, camera: &OutputCamera) -> [u32; 4] {
    /// Margin in pixels: samples extend beyond their pixels, and a portal's plane may be slightly
    /// off its opening.
    const AROUND_PX: f64 = 6.0;
    let (basis, focal) = (pose.basis(), camera.focal_px());
    let (w, h) = (f64::from(camera.width), f64::from(camera.height));
    let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
    for edge in cones.iter().flat_map(|c| &c.edges) {
        let z = edge.dot(basis.forward);
        if z < 1e-3 {
            return [0, 0, camera.width, camera.height];
        }
        let p = [w * 0.5 + edge.dot(basis.right) / z * focal, h * 0.5 - edge.dot(basis.up) / z * focal];
        for k in 0..2 {
            (low[k], high[k]) = (low[k].min(p[k]), high[k].max(p[k]));
        }
    }
    // Saturating conversions.
    let from = low.map(|x| (x - AROUND_PX).floor().max(0.0) as u32);
    let to = [(high[0], camera.width), (high[1], camera.height)].map(|(x, n)| ((x + AROUND_PX).ceil() as u32).min(n));
    [from[0].min(to[0]), from[1].min(to[1]), to[0], to[1]]
}

impl FrameRenderer {
    /// Creates a renderer that uses a GPU.
    pub fn on(gpu: Gpu) -> Self {
        Self { backend: RenderBackend::on(gpu), ..Self::default() }
    }

    /// The GPU, if one is used.
    pub fn gpu(&self) -> Option<&Gpu> {
        self.backend.gpu()
    }

    /// Sets what the next frames may show. It is laid out and uploaded after everything that the
    /// frame itself needs.
    pub fn anticipate(&mut self, ahead: Anticipated) {
        self.ahead = ahead;
    }

    /// Whether another frame could show more without new data: layouts were finished, or uploads
    /// are in progress.
    pub fn has_news(&self) -> bool {
        self.late || self.uploads.is_under_way() || self.layout_worker.as_ref().is_some_and(LayoutWorker::has_finished)
    }

    /// The layout worker, started at first use.
    fn layout_worker(&mut self) -> Option<&LayoutWorker> {
        if self.layout_worker.is_none() {
            self.layout_worker = LayoutWorker::open()
                .map_err(|e| tracing::warn!("images are laid out by the frames that show them: {e}"))
                .ok();
        }
        self.layout_worker.as_ref()
    }

    /// Drops all state of the scene, before another one is drawn.
    pub fn forget_scene(&mut self) {
        let mut backend = std::mem::take(&mut self.backend);
        backend.forget();
        *self = Self { backend, ..Self::default() };
    }

    /// Renders a view into `out`, at the camera's size. The result has no disparities if the GPU
    /// composited it.
    ///
    /// # Errors
    ///
    /// If the options ask for an order that cannot draw the stamp, or the GPU fails.
    #[expect(clippy::too_many_arguments, reason = "each is another thing that a frame depends on")]
    pub fn render(
        &mut self,
        index: &Index,
        resident: &dyn Resident,
        view: &View,
        pose: &Pose,
        camera: &OutputCamera,
        options: &WalkOptions,
        ms: StageMs,
        out: &mut Frame,
    ) -> Result<FrameStats, RenderError> {
        let mut frame_stats = FrameStats { ms, whole: index.is_whole(), ..FrameStats::default() };
        self.last.clear();
        if options.fill == Fill::Last {
            std::mem::swap(&mut self.last, &mut self.full.colour);
        }
        let start = Instant::now();
        let plan = self.plan(index, resident, view, pose, camera, options);
        let ahead = std::mem::take(&mut self.ahead);
        let late = self.acquire(&plan, &ahead)?;
        let uploaded = UploadedOnly { resident, index, late: &late.chunks };
        let fallback = self.fallback_for(&FrameContext { resident: &uploaded, ..plan });
        let frame = FrameContext { resident: &uploaded, view: fallback.as_ref().unwrap_or(view), ..plan };
        frame_stats.fallback = fallback.as_ref().and_then(|v| v.selection.placement);
        let near_gaps = self.draw_near(&frame, start, &mut frame_stats)?;
        let mut images = frame.images();
        let wanted = self.list_missing(&frame, &images, &late, &mut frame_stats);
        self.lay_out(&frame, &mut images, wanted, &ahead, &mut frame_stats)?;
        let gaps = !frame_stats.whole || near_gaps || images.iter().any(|(.., l)| l.is_none());
        if fallback.is_none() && !gaps {
            self.fallback.remember_complete(frame.view);
        }
        self.warp(&frame, &images, &mut frame_stats)?;
        let start = Instant::now();
        let gaps = Gaps { near: near_gaps, any: gaps };
        let mut merged = self.merge(&frame, &images, gaps, &mut frame_stats)?;
        self.underlay(&frame, gaps, &mut merged, &mut frame_stats);
        self.resolve(&frame, merged, gaps.any && images.is_empty(), out)?;
        frame_stats.uploaded_bytes = self.backend.uploaded_bytes();
        frame_stats.ms.composite = ms_since(start) - frame_stats.tree.as_ref().map_or(0.0, |t| t.ms);
        self.was_complete = frame_stats.is_complete();
        let m = &mut frame_stats.ms;
        m.total = m.select + m.cull + m.near + m.warp + m.composite;
        Ok(frame_stats)
    }

    /// Plans a frame: its resolution, the layouts that it uses, and the options of its warp.
    fn plan<'a>(
        &mut self,
        index: &'a Index,
        resident: &'a dyn Resident,
        view: &'a View,
        pose: &'a Pose,
        camera: &'a OutputCamera,
        options: &'a WalkOptions,
    ) -> FrameContext<'a> {
        let full_camera = supersampled(camera, options.supersample);
        let background_layout = options.background_layout && self.layout_worker().is_some();
        // At half the dataset's resolution or less, images at half resolution keep the footprint
        // bound.
        let half = background_layout && 2.0 * full_camera.focal_px() <= index.settings.camera.focal_px() * (1.0 + 1e-6);
        if std::mem::replace(&mut self.textures, view.portal_images.is_texture()) != self.textures {
            // Flat textures use the same images with another layout.
            (self.layouts, self.uploads) = (ImageLayouts::default(), UploadQueue::default());
        }
        let warp_options = WarpOptions {
            stamp: options.stamp,
            order: options.order,
            keep_all_tiles: options.cull == Cull::Off,
            ..WarpOptions::default()
        };
        FrameContext {
            index,
            resident,
            own: view,
            view,
            pose,
            camera,
            full_camera,
            options,
            warp_options,
            background_layout,
            half,
        }
    }

    /// Uploads geometry, textures and images within the frame's budget. Returns the objects that
    /// are still being uploaded.
    fn acquire(&mut self, frame: &FrameContext<'_>, ahead: &Anticipated) -> Result<PendingUploads, RenderError> {
        let FrameContext { index, resident, view, full_camera, warp_options, .. } = frame;
        let allowed = upload_budget_bytes(frame.background_layout, frame.options.frame_ms.is_some());
        #[cfg(test)]
        let allowed = self.upload_budget_bytes.unwrap_or(allowed);
        self.backend.begin_frame(allowed);
        let late = match frame.background_layout {
            true => upload_cells(&mut self.backend, index, *resident, &view.cells, full_camera, false)?,
            false => PendingUploads::default(),
        };
        let made = self.layout_worker.as_ref().map(LayoutWorker::take_finished);
        made.into_iter().flatten().for_each(|layout| self.uploads.insert(layout));
        if frame.background_layout {
            let images = (&view.images[..], &ahead.images[..]);
            self.uploads.upload(&mut self.backend, &mut self.layouts, images, full_camera, warp_options)?;
            upload_cells(&mut self.backend, index, *resident, &ahead.cells, full_camera, true)?;
        }
        Ok(late)
    }

    /// The fallback view, if the frame's own view cannot be drawn completely.
    fn fallback_for(&self, frame: &FrameContext<'_>) -> Option<View> {
        let is_ready = |image| match frame.background_layout {
            true => self.layouts.get(image, frame.half).is_some(),
            false => frame.resident.ldi(image).is_some(),
        };
        let looks = (frame.pose, (frame.camera.half_tan_x(), frame.camera.half_tan_y()));
        self.fallback.view(frame.index, frame.resident, frame.own, looks, &is_ready)
    }

    /// Draws near geometry, and lists its missing chunks. Returns whether geometry is missing.
    fn draw_near(
        &mut self,
        frame: &FrameContext<'_>,
        start: Instant,
        frame_stats: &mut FrameStats,
    ) -> Result<bool, RenderError> {
        let FrameContext { index, resident, pose, full_camera, options, .. } = *frame;
        let Drawable { cells, lacking_textures, lacking_levels } = drawable(index, resident, &frame.view.cells);
        let near = if options.method == Method::Cache && lacking_textures.is_empty() {
            self.impostors.settings.error_px = options.cache_error_px * f64::from(options.supersample);
            let (scene, view) = ((index, resident), (&full_camera, pose));
            let (near, drawn) = self.impostors.draw(scene, view, self.was_complete, &mut self.full);
            (frame_stats.ms.near, frame_stats.ms.warp) = (drawn.near_ms, drawn.images_ms + drawn.made_ms);
            frame_stats.cached = Some(drawn);
            near
        } else {
            let near = self.backend.draw_near(index, resident, &cells, &full_camera, pose, &mut self.full)?;
            frame_stats.ms.near = ms_since(start);
            near
        };
        frame_stats.triangles = near.triangles;
        if options.method != Method::Cache {
            frame_stats.levels = LevelStats::of(index, &cells, frame.camera, pose);
        }
        let near_gaps = !near.missing_chunks.is_empty() || !lacking_textures.is_empty();
        let absent = near.missing_textures.iter().filter_map(|t| index.textures.get(*t as usize));
        let absent = absent.flat_map(|t| t.chunks.iter().map(|c| c.chunk));
        frame_stats.missing_chunks = near.missing_chunks;
        frame_stats.missing_chunks.extend(lacking_textures);
        frame_stats.missing_chunks.extend(lacking_levels);
        frame_stats.missing_chunks.extend(absent);
        if !near.coarse_textures.is_empty() {
            let seen = frame.view.needed(index, &Sight::new(pose, frame.camera, options.supersample)).fine;
            let entries = near.coarse_textures.iter().filter_map(|t| Some((*t, index.textures.get(*t as usize)?)));
            for (number, entry) in entries {
                let levels = resident.texture(number).map(|t| t.levels.iter().position(Option::is_some));
                let finest = levels.flatten().unwrap_or(usize::MAX);
                let absent = entry.chunks.iter().filter(|c| usize::from(c.last_level) < finest).map(|c| c.chunk);
                frame_stats.missing_chunks.extend(absent.filter(|c| seen.contains(c)));
            }
        }
        Ok(near_gaps)
    }

    /// Completes the list of missing chunks. Returns the layouts that the frame's own view waits
    /// for.
    fn list_missing(
        &mut self,
        frame: &FrameContext<'_>,
        images: &[FrameImage<'_>],
        late: &PendingUploads,
        frame_stats: &mut FrameStats,
    ) -> Vec<LayoutRequest> {
        let FrameContext { index, resident, own, half, .. } = *frame;
        for (_, entry, ldi) in images {
            frame_stats.missing_chunks.extend(absent_layers(entry, ldi.as_deref()));
        }
        let mut wanted: Vec<LayoutRequest> = Vec::new();
        if frame.is_fallback() {
            frame_stats.missing_chunks.extend(absent_chunks(index, resident, &own.cells));
            for (number, entry) in own.images.iter().filter_map(|i| Some((*i, index.images.get(*i as usize)?))) {
                let ldi = resident.ldi(number);
                frame_stats.missing_chunks.extend(absent_layers(entry, ldi.as_deref()));
                let want = ldi.map(|ldi| LayoutRequest { number, half, ldi });
                wanted.extend(want.filter(|w| frame.background_layout && !self.layouts.holds(w)));
            }
            frame_stats.waiting = wanted.len();
        }
        frame_stats.missing_chunks.sort_unstable();
        frame_stats.missing_chunks.dedup();
        // Chunks that are being uploaded are resident, and not missing.
        frame_stats.missing_chunks.retain(|c| !late.chunks.contains(c));
        self.late = !late.chunks.is_empty() || late.coarse > 0;
        frame_stats.waiting += late.chunks.len() + late.coarse;
        wanted
    }

    /// Lays out the frame's images, or requests their layouts and replaces `images` by the layers
    /// that are laid out.
    fn lay_out(
        &mut self,
        frame: &FrameContext<'_>,
        images: &mut [FrameImage<'_>],
        mut wanted: Vec<LayoutRequest>,
        ahead: &Anticipated,
        frame_stats: &mut FrameStats,
    ) -> Result<(), RenderError> {
        let FrameContext { index, resident, own, view, full_camera, warp_options, half, .. } = *frame;
        self.layouts.forget_all_but(|number| {
            images.iter().any(|(n, ..)| *n == number) || own.images.contains(&number) || ahead.images.contains(&number)
        });
        for (number, _, held) in images {
            let canvas = view.canvas(index, *number);
            if frame.background_layout && canvas.is_none() {
                let Some(ldi) = held.take() else { continue };
                let want = LayoutRequest { number: *number, half, ldi };
                // Until the layout is ready, an older one with fewer layers or at the other
                // resolution is shown.
                let shown = self.layouts.get(*number, half);
                *held = shown.map(|l| l.of.ldi.clone());
                if !self.layouts.holds(&want) {
                    wanted.push(want);
                    frame_stats.waiting += 1;
                }
                continue;
            }
            let Some(ldi) = held else { continue };
            let start = Instant::now();
            let paint = |ldi: &Ldi| canvas.and_then(|p| painted_onto(ldi, p.normal(), p.centre(), SKY_SRGB));
            let new = self.layouts.lay_out(*number, ldi, paint);
            if let Some(l) = self.layouts.get(*number, false) {
                self.backend.upload(&l.laid_out, &mut None, false, &full_camera, &warp_options)?;
            }
            frame_stats.ms.prepare += if new { ms_since(start) } else { 0.0 };
        }
        if let Some(layout_worker) = self.layout_worker.as_ref().filter(|_| frame.background_layout) {
            let resident =
                ahead.images.iter().filter_map(|n| Some(LayoutRequest { number: *n, half, ldi: resident.ldi(*n)? }));
            wanted.extend(resident.filter(|w| !self.layouts.holds(w)));
            wanted.retain(|w| !self.uploads.holds(w));
            layout_worker.set_requests(wanted, self.backend.warping_gpu_for(&full_camera, &warp_options).is_some());
        }
        Ok(())
    }

    /// Warps the images that are laid out.
    fn warp(
        &mut self,
        frame: &FrameContext<'_>,
        images: &[FrameImage<'_>],
        frame_stats: &mut FrameStats,
    ) -> Result<(), RenderError> {
        let FrameContext { view, pose, full_camera, options, warp_options, half, .. } = *frame;
        self.far.reset(full_camera.width, full_camera.height);
        let here = || images.iter().filter(|i| i.2.is_some()).map(|i| i.0);
        let recoloured = self.layouts.recoloured(here(), pose, &full_camera, options.shows);
        let layouts = recoloured.as_ref().unwrap_or(&self.layouts);
        let here: Vec<&ImageLayout> = here().filter_map(|number| layouts.get(number, half)).collect();
        if here.is_empty() {
            return Ok(());
        }
        let start = Instant::now();
        let mut shown: Vec<ImageInView<'_>> = Vec::with_capacity(here.len());
        let mut show = |wanted: &dyn Fn(u32) -> bool, within| {
            let wanted = here.iter().filter(|p| wanted(p.of.number));
            shown.extend(wanted.map(|p| ImageInView { laid_out: &p.laid_out, within }));
        };
        if view.portals.is_empty() {
            show(&|_| true, None);
        }
        for portal in &view.portals {
            show(&|n| portal.images.contains(&n), Some(rectangle(&portal.cones, pose, &full_camera)));
        }
        let stats = self.backend.warp(&shown, &self.full, pose, &full_camera, &warp_options, &mut self.far)?;
        frame_stats.warp = Some(stats);
        frame_stats.ms.warp = ms_since(start);
        Ok(())
    }

    /// Merges near geometry, warped images and sky.
    fn merge(
        &mut self,
        frame: &FrameContext<'_>,
        images: &[FrameImage<'_>],
        gaps: Gaps,
        frame_stats: &mut FrameStats,
    ) -> Result<Merged, RenderError> {
        let FrameContext { index, view, pose, full_camera, options, .. } = *frame;
        let shown: Vec<FarImage<'_>> =
            images.iter().map(|(_, entry, ldi)| FarImage::new(entry, ldi.as_deref())).collect();
        let of_portals: Vec<Vec<FarImage<'_>>> = view
            .portals
            .iter()
            .map(|p| images.iter().zip(&shown).filter(|((n, ..), _)| p.images.contains(n)).map(|(_, i)| *i).collect())
            .collect();
        let portals: Vec<FarPortal<'_>> = view
            .portals
            .iter()
            .zip(&of_portals)
            .filter_map(|(p, images)| {
                let sky = &index.placements.get(p.placement as usize)?.sky;
                Some(FarPortal { cones: &p.cones, images, sky })
            })
            .collect();
        let known = images.iter().any(|(.., l)| l.is_some());
        let doubtful = frame.is_doubtful(gaps);
        // The GPU composites complete frames in scene colours, without options that only the CPU
        // implements.
        let plain = options.shows == DisplayMode::Scene && options.fill != Fill::Last && !options.smooth;
        let steps = code_steps(&shown, pose, &full_camera);
        let open = match plain && !doubtful {
            true => self.backend.merge(&steps, &full_camera, &self.far)?,
            false => None,
        };
        frame_stats.on_card = open.is_some();
        match &open {
            Some(open) => self.full.reset_open(full_camera.width, full_camera.height, open),
            None => self.backend.read_back(&full_camera, &mut self.full, &mut self.far)?,
        }
        let far = match shown[..] {
            _ if !portals.is_empty() => {
                Far::Portals { picture: &self.far, portals: &portals, complete: view.dropped == 0 && !gaps.near }
            }
            // Dropped cells may lie anywhere, so that the remaining pixels are not known to be sky.
            _ if doubtful && images.is_empty() => Far::Missing,
            [] => Far::Nothing,
            _ => {
                let placement = view.selection.placement.and_then(|p| index.placements.get(p as usize));
                Far::Images { picture: &self.far, images: &shown, sky: placement.map(|p| &p.sky) }
            }
        };
        let mut stats = merge(&mut self.full, far, pose, &full_camera);
        let all_layers = images.iter().all(|(_, entry, ldi)| absent_layers(entry, ldi.as_deref()).is_empty());
        // Reference images of portals do not cover everything that an eye can see: their gaps are
        // no sky.
        if known && all_layers && !doubtful && !view.portal_images.is_paper() {
            fill_sky(&mut self.full, &mut stats);
        }
        Ok(Merged { open, stats, known, steps })
    }

    /// Adds the LDI tree to pixels that are open or doubtful.
    fn underlay(&mut self, frame: &FrameContext<'_>, gaps: Gaps, merged: &mut Merged, frame_stats: &mut FrameStats) {
        let Some(tree) = &frame.index.tree else { return };
        let doubt = match frame.is_doubtful(gaps) {
            true => ImageGaps::Missing {
                margin_m: 2.0 * tree.pitch_of(tree.pinned_levels.saturating_sub(1)) as f32,
                complete_m: if gaps.any { 0.0 } else { frame.view.complete_m as f32 },
            },
            false => ImageGaps::None,
        };
        frame_stats.tree = self.draw_tree_underlay(frame, doubt);
        if let Some(t) = &frame_stats.tree {
            (merged.stats.tree, merged.stats.unpainted) = (t.given, self.full.count(Source::Unpainted) as u64);
            merged.known = true;
            frame_stats.ms.warp += t.ms;
        }
    }

    /// Fills holes, and averages the frame into `out`. `unknown`: nothing stands for missing
    /// geometry.
    fn resolve(
        &mut self,
        frame: &FrameContext<'_>,
        mut merged: Merged,
        unknown: bool,
        out: &mut Frame,
    ) -> Result<(), RenderError> {
        let options = frame.options;
        // False colours have neither sky nor shadows.
        let appearance = if options.shows == DisplayMode::Scene { options.appearance } else { Appearance::default() };
        let shading = appearance.depth_shading.then(|| {
            let errors = merged.steps.iter().map(|s| s.error(&frame.full_camera));
            let noise = errors.fold([0.0f64; 2], |a, b| [a[0].max(b[0]), a[1].max(b[1])]);
            DepthLens::new(frame.camera, noise.map(|e| e as f32))
        });
        self.filled_on_card = 0;
        if let Some(open) = merged.open {
            let fill = options.fill == Fill::Surface && merged.stats.is_worth_filling(merged.known);
            let finishing = Finishing { fill, factor: options.supersample, shading };
            self.filled_on_card = self.backend.finish(&open, &self.full, &finishing, out)?;
            if appearance.horizon {
                paint_sky(out, frame.pose, frame.camera);
            }
            return Ok(());
        }
        let composite_options = CompositeOptions { fill: options.fill, last: &self.last, smooth: options.smooth };
        finish(&mut self.full, merged.known, &mut merged.stats, &composite_options);
        if unknown && frame.index.tree.is_none() && frame.view.dropped == 0 {
            // No data about these pixels exists: they are drawn as sky.
            self.full.paint_rest_as_sky();
        }
        if appearance.horizon {
            paint_sky(&mut self.full, frame.pose, &frame.full_camera);
        }
        options.shows.recolour(&mut self.full);
        if options.supersample > 1 {
            downsample(&self.full, options.supersample, out);
        } else {
            out.clone_from(&self.full);
        }
        if let Some(lens) = shading {
            self.shading.shade(out, &lens);
        }
        Ok(())
    }

    /// Draws the LDI tree into the pixels that need it. None if no pixel does.
    fn draw_tree_underlay(&mut self, frame: &FrameContext<'_>, doubt: ImageGaps) -> Option<TreeStats> {
        let start = Instant::now();
        let FrameContext { index, resident, pose, full_camera: ref camera, options, .. } = *frame;
        // Without the root chunk the tree cannot be drawn.
        let tree = index.tree.as_ref().filter(|t| resident.brood(t.root_chunk).is_some())?;
        let wanted = pixels_for_tree(&self.full, doubt);
        if wanted.is_empty() {
            return None;
        }
        let max_samples = match options.frame_ms {
            Some(ms) if self.tree_rate > 0.0 => (ms * self.tree_rate) as u64,
            _ => u64::MAX,
        };
        let (full, width) = (&self.full, self.full.width as usize);
        let no_gap = |row: usize, column: usize| full.source[row * width + column] != Source::Unpainted;
        let hides = &full.disparity;
        let (mut stats, picture) = self.tree.frame(tree, resident, pose, camera, max_samples, wanted, hides, &no_gap);
        stats.given = underlay_tree(&mut self.full, picture, doubt);
        stats.ms = ms_since(start);
        if stats.samples > 10_000 {
            let rate = stats.samples as f64 / stats.ms.max(0.1);
            self.tree_rate = if self.tree_rate > 0.0 { 0.8 * self.tree_rate + 0.2 * rate } else { rate };
        }
        Some(stats)
    }

    /// The last frame before averaging, as warp and rasterizer left it. After a frame that the GPU
    /// composited, only sky, tree and unpainted pixels have their own source; all others count as
    /// near geometry, and holes are not filled.
    pub fn full(&self) -> &Frame {
        &self.full
    }

    /// Shares of the full frame's pixels without known content, before and after filling.
    pub fn unknown_fractions(&self) -> (f64, f64) {
        let n = self.full.len().max(1) as f64;
        let unknown = (self.full.count(Source::Filled) + self.full.count(Source::Unpainted)) as f64;
        let filled = self.full.count(Source::Filled) as f64 + self.filled_on_card as f64;
        (unknown / n, (unknown - filled) / n)
    }
}
