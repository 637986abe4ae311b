//! `select`: from a pose to what is drawn. A pure function over the [`Index`], so that the server
//! plans with exactly what the client renders with (Aliaga and Lastra 1999, Figure 12).
//!
//! In a dataset with rooms: pose -> its room -> portals ([`portals`]); where that exceeds the
//! budget, and in a dataset without rooms: pose -> closest grid point (in the reverse frustum, or
//! anywhere: [`CELLS`]) -> pitch band -> angular range -> placement or none -> cells in view that
//! the placement does not replace. The build counts for every grid point what these steps can draw
//! for any of its users; [`draw_list`] keeps the budget for all other poses too.

mod groups;
mod portals;

pub use groups::{CellGroups, SomeCells};
pub use portals::ShownPortal;

use crate::{
    Aabb, Pose,
    camera::Frustum,
    index::{AngularRange, BuildSettings, CELLS, CellEntry, DrawnCell, Index, Placement},
    room_index::ShowPortals,
    rooms::CellId,
    tree::{CutOptions, Lens, cut},
};
use glam::DVec3;
use serde::{Deserialize, Serialize};

/// Samples may lie before their image's plane by this share of its distance: depths are rounded.
const PLANE_SLACK: f64 = 1e-3;

/// Share of the budget for far cells that fill much of the picture, where not all cells in view
/// fit into it. Larger: less of what is near is geometry; 0: hills behind a town are as soft as
/// the town.
const WIDE_SHARE: f64 = 0.1;

/// So near is a direction beside another, degrees: less than a picture's pixel, more than rounding.
const BESIDE_DEG: f64 = 1e-3;

/// An eye this close to a placement's users is one of them, metres: rounding.
const USERS_SLACK_M: f64 = 1e-6;

/// Where a client takes what is far from.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum FarBy {
    /// What the dataset offers: images, or the LDI tree, within the budget.
    #[default]
    Offered,
    /// Geometry: every cell in view in full, whatever its triangles.
    Geometry,
    /// Geometry: every cell in view at its level of detail, whatever its triangles.
    Levels,
    /// The LDI tree, behind the nearest cells that the budget allows.
    Tree,
}

impl FarBy {
    /// Whether it comes from the LDI tree, in this dataset.
    pub fn is_tree(self, index: &Index) -> bool {
        match self {
            Self::Offered => index.walks_by_tree(),
            Self::Geometry | Self::Levels => false,
            Self::Tree => true,
        }
    }
}

/// What a client shows: decides what a pose needs.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Hash)]
pub struct Show {
    /// What is far.
    pub far: FarBy,
    /// Portals, in a dataset with rooms.
    pub portals: ShowPortals,
}

/// What a pose sees.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Selection {
    /// The closest grid point inside the reverse frustum; None without a grid.
    pub grid_point: Option<u32>,
    /// The placement of the pose's angular range, if its images were made for this eye. None draws
    /// geometry alone, as far as the budget goes.
    pub placement: Option<u32>,
}

/// The frusta that a cell must touch to be drawn: the planning square and the picture itself.
/// Testing both makes the drawn cells a subset of those counted at the grid point, plane by plane.
#[derive(Debug, Clone, Copy)]
pub struct DrawFrusta {
    square: Frustum,
    picture: Frustum,
    /// The planned picture, where this one is larger: what images show.
    planned: Option<Frustum>,
}

/// A picture is larger than planned if a side of it is so many times as large: images show half of
/// one of the squares in which directions are planned more than is asked, 16 of 1280 pixels.
const LARGER: f64 = 1.02;

impl DrawFrusta {
    /// Frusta of a pose under the build's settings. The build promises the budget for pictures
    /// within the planning square, which is widened for others.
    pub fn new(settings: &BuildSettings, pose: &Pose, picture_half_tan: (f64, f64)) -> Self {
        let basis = pose.basis();
        let t = settings.square_half_tan();
        let (across, up) = (t.max(picture_half_tan.0), t.max(picture_half_tan.1));
        let (x, y) = (settings.camera.half_tan_x(), settings.camera.half_tan_y());
        let is_larger = picture_half_tan.0 > x * LARGER || picture_half_tan.1 > y * LARGER;
        Self {
            planned: is_larger.then(|| Frustum::new(pose.position, &basis, x, y)),
            square: Frustum::new(pose.position, &basis, across, up),
            picture: Frustum::new(pose.position, &basis, picture_half_tan.0, picture_half_tan.1),
        }
    }
    /// Whether a cell with these bounds is drawn (unless it is culled).
    pub fn admit(&self, b: &Aabb) -> bool {
        self.square.may_intersect(b) && self.picture.may_intersect(b)
    }

    /// Whether images may lack some of what the picture shows of a cell that they replace: what is
    /// beside the planned picture they were not made for.
    fn images_may_lack(&self, b: &Aabb) -> bool {
        self.planned.is_some_and(|planned| b.corners().iter().any(|corner| !planned.contains(*corner)))
    }

    /// The images of a placement whose cones beyond their planes the picture may touch, those
    /// nearest to the line of sight first.
    fn images_in_view(&self, index: &Index, placement: u32, pose: &Pose) -> Vec<u32> {
        images_within(index, placement, pose, &self.picture.normals)
    }
}

/// The images of a placement whose cones beyond their planes a cone with these inward normals at
/// the eye may touch, those nearest to the line of sight first.
fn images_within(index: &Index, placement: u32, pose: &Pose, normals: &[DVec3]) -> Vec<u32> {
    let Some(cop) = index.placements.get(placement as usize).map(|p| p.cop) else { return Vec::new() };
    let sight = pose.basis().forward;
    let mut found: Vec<(f64, u32)> = Vec::new();
    for (number, image) in index.images_of(placement).filter(|(_, i)| !i.chunks.is_empty()) {
        let b = &image.basis;
        let [l, r, below, above] = image.window;
        let rays = [(l, below), (r, below), (l, above), (r, above)].map(|(x, y)| b.forward + b.right * x + b.up * y);
        // The cone is the set of all (near corner + t * some ray), t >= 0: wholly outside a plane
        // if its near corners and its rays are.
        let nearest = image.plane_distance * (1.0 - PLANE_SLACK);
        let outside =
            |n: &DVec3| rays.iter().all(|ray| n.dot(cop + *ray * nearest - pose.position) < 0.0 && n.dot(*ray) <= 0.0);
        if !normals.iter().any(outside) {
            let middle: DVec3 = rays.iter().sum();
            found.push((-middle.normalize().dot(sight), number));
        }
    }
    found.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    found.into_iter().map(|f| f.1).collect()
}

/// Selects the grid point and the placement of a pose.
///
/// The grid point is the closest P with `eye in P + forward square frustum(direction)`, or simply
/// the closest one when the dataset was built with view cells; ties go to the smaller number. An
/// eye that is not among a placement's users is not shown its images: they may lack what it sees.
pub fn select(index: &Index, pose: &Pose) -> Selection {
    let basis = pose.basis();
    let t = index.settings.square_half_tan();
    let any = index.settings.grid == CELLS;
    let mut best: Option<(f64, u32)> = None;
    for (i, p) in index.points.iter().enumerate() {
        let v = pose.position - p.position;
        let d2 = v.length_squared();
        if best.is_some_and(|(b, _)| d2 >= b) {
            continue;
        }
        let z = v.dot(basis.forward);
        if any || (z >= 0.0 && v.dot(basis.right).abs() <= t * z && v.dot(basis.up).abs() <= t * z) {
            best = Some((d2, i as u32));
        }
    }
    let grid_point = best.map(|b| b.1);
    let placement = grid_point.and_then(|g| placement_of(index, g, pose)).filter(|p| serves(index, *p, pose.position));
    Selection { grid_point, placement }
}

/// Whether the images of a placement were made for an eye here.
fn serves(index: &Index, placement: u32, eye: DVec3) -> bool {
    let Some(entry) = index.placements.get(placement as usize) else { return false };
    was_made(entry) && entry.users.inflated(USERS_SLACK_M).contains(eye)
}

/// Whether the images of a placement were made: one that a build had no time for names cells to
/// replace and nothing to show instead.
pub fn was_made(placement: &Placement) -> bool {
    !placement.images.is_empty() || placement.culled.is_empty()
}

/// Whether an eye was planned for: it lies in the walk volume, or the images of its direction were
/// made for it. Others see near geometry over the LDI tree.
pub fn is_planned(index: &Index, pose: &Pose) -> bool {
    let selection = select(index, pose);
    let named = selection.grid_point.and_then(|g| placement_of(index, g, pose));
    match &index.volume {
        // A placement that was not made in time serves nobody.
        Some(volume) if volume.contains(pose.position) => named == selection.placement,
        _ => selection.placement.is_some(),
    }
}

/// What to draw as geometry for a pose.
#[derive(Debug, Clone, PartialEq)]
pub struct DrawList {
    /// Grid point and placement.
    pub selection: Selection,
    /// Cells to draw, near to far, each at the coarsest level that its distance allows.
    pub cells: Vec<DrawnCell>,
    /// Images of the placement that the picture may show something of, those nearest to the line
    /// of sight first.
    pub images: Vec<u32>,
    /// Triangles in them; never more than the budget.
    pub triangles: u64,
    /// Cells in view that were left out, farthest first, because the budget was used up. Always 0
    /// for eyes of the walk volume that look within the built range of pitch, in pictures within
    /// the planning square.
    pub dropped: u32,
    /// What lies in view nearer than this is in `cells`, metres from the eye: infinite where
    /// nothing was left out, 0 where images show some of it.
    pub complete_m: f64,
    /// Chunks that refine the LDI tree to this view, coarse ones first; empty where the tree is
    /// only what lies under images.
    pub tree: Vec<u32>,
    /// Rooms whose cells are drawn, in the order in which they are seen; empty in a dataset
    /// without rooms.
    pub rooms: Vec<CellId>,
    /// Portals whose images show what lies beyond, nearest first.
    pub portals: Vec<ShownPortal>,
}

impl DrawList {
    /// Numbers of the cells to draw, near to far.
    pub fn cell_numbers(&self) -> Vec<u32> {
        self.cells.iter().map(|c| c.cell).collect()
    }
}

/// The cells that a pose draws: those in view that its placement does not replace, and in pictures
/// larger than planned, as far as they fit the budget, those that its images may lack.
/// `picture_half_tan`: tangents of half the picture's horizontal and vertical field of view.
pub fn draw_list(index: &Index, pose: &Pose, picture_half_tan: (f64, f64)) -> DrawList {
    draw_list_showing(index, pose, picture_half_tan, Show::default())
}

/// The same with a wish for what is shown. Images of portals that the dataset was not built with
/// count as absent: geometry is drawn, as far as the budget goes.
pub fn draw_list_showing(index: &Index, pose: &Pose, picture_half_tan: (f64, f64), show: Show) -> DrawList {
    draw_list_of(index, &CellGroups::default(), pose, picture_half_tan, show)
}

/// The same list, found by groups of the index's cells: for whoever asks for many.
pub fn draw_list_of(
    index: &Index,
    groups: &CellGroups,
    pose: &Pose,
    picture_half_tan: (f64, f64),
    show: Show,
) -> DrawList {
    let nothing = Selection { grid_point: None, placement: None };
    if matches!(show.far, FarBy::Geometry | FarBy::Levels) {
        let detail = if show.far == FarBy::Levels { index.settings.deviation_per_metre() } else { 0.0 };
        return cells_in_view(index, groups, nothing, pose, picture_half_tan, detail);
    }
    if show.far.is_tree(index) {
        let list = grid_list(index, groups, nothing, pose, picture_half_tan);
        return DrawList { tree: tree_chunks(index, pose, picture_half_tan), ..list };
    }
    let Some(rooms) = &index.rooms else {
        return grid_list(index, groups, select(index, pose), pose, picture_half_tan);
    };
    // The grid, if it was made for this eye.
    let by_grid = || {
        let grid = grid_list(index, groups, select(index, pose), pose, picture_half_tan);
        (grid.dropped == 0).then_some(grid)
    };
    let is_asked_for = show.portals == ShowPortals::default() && rooms.is_by_grid(pose.position);
    if is_asked_for && let Some(grid) = by_grid() {
        return grid;
    }
    let list = portals::draw_list(index, rooms, pose, picture_half_tan, show.portals);
    if list.dropped == 0 || index.points.is_empty() {
        return list;
    }
    // The rooms are too much for the budget.
    by_grid().unwrap_or(list)
}

/// Triangles of what rooms have to draw as geometry: above the budget the grid takes over. None in
/// a dataset without rooms.
pub fn least_by_rooms(index: &Index, pose: &Pose, picture_half_tan: (f64, f64)) -> Option<u64> {
    let rooms = index.rooms.as_ref()?;
    Some(portals::least(index, rooms, pose, picture_half_tan))
}

/// What a pose draws with a placement of the grid that need not be its own: for a stand-in while
/// that one's images are on their way. `dropped` may be above 0 for eyes that are not among the
/// placement's users, and footprints above the bound.
pub fn draw_list_by(index: &Index, placement: u32, pose: &Pose, picture_half_tan: (f64, f64)) -> DrawList {
    let grid_point = index.placements.get(placement as usize).and_then(|p| p.grid_point);
    let selection = Selection { grid_point, placement: Some(placement) };
    grid_list(index, &CellGroups::default(), selection, pose, picture_half_tan)
}

/// The list by grid points.
fn grid_list(
    index: &Index,
    groups: &CellGroups,
    selection: Selection,
    pose: &Pose,
    picture_half_tan: (f64, f64),
) -> DrawList {
    let detail = index.settings.deviation_per_metre();
    let list = cells_in_view(index, groups, selection, pose, picture_half_tan, detail);
    let mut list = within_budget(index, pose.position, list);
    add_what_images_lack(index, groups, &mut list, pose, picture_half_tan);
    list
}

/// Adds cells that a placement replaces and its images may lack, the nearest first, as far as they
/// fit the budget.
fn add_what_images_lack(
    index: &Index,
    groups: &CellGroups,
    list: &mut DrawList,
    pose: &Pose,
    picture_half_tan: (f64, f64),
) {
    let frusta = DrawFrusta::new(&index.settings, pose, picture_half_tan);
    let Some(placement) = list.selection.placement.filter(|_| frusta.planned.is_some()) else { return };
    let Some(Placement { culled, .. }) = index.placements.get(placement as usize) else { return };
    let distance_m = |cell: u32| index.cells[cell as usize].bounds.distance(pose.position);
    let lacking =
        groups.runs(index.cells.len(), |b| frusta.admit(b)).flatten().map(|cell| cell as u32).filter(|cell| {
            let bounds = &index.cells[*cell as usize].bounds;
            culled.contains(*cell) && frusta.admit(bounds) && frusta.images_may_lack(bounds)
        });
    let lacking =
        lacking.map(|cell| (distance_m(cell), DrawnCell { cell, level: level_at(index, cell, pose.position) }));
    for drawn in near_to_far(lacking.collect()) {
        let triangles = list.triangles + u64::from(index.cells[drawn.cell as usize].triangles_at(drawn.level));
        if triangles > index.settings.budget {
            break;
        }
        list.triangles = triangles;
        list.cells.push(drawn);
    }
    list.cells = near_to_far(list.cells.iter().map(|c| (distance_m(c.cell), *c)).collect());
}

/// The same without the budget: all cells in view that the placement does not replace, each at the
/// coarsest level whose deviation is at most `deviation_per_metre` of its distance.
fn cells_in_view(
    index: &Index,
    groups: &CellGroups,
    selection: Selection,
    pose: &Pose,
    picture_half_tan: (f64, f64),
    deviation_per_metre: f64,
) -> DrawList {
    let culled =
        selection.placement.and_then(|p| index.placements.get(p as usize)).map_or(&[][..], |p| p.culled.runs());
    let frusta = DrawFrusta::new(&index.settings, pose, picture_half_tan);
    let mut culled = culled.iter().peekable();
    let mut seen: Vec<(f64, DrawnCell)> = Vec::new();
    let mut triangles = 0;
    for cell in groups.runs(index.cells.len(), |b| frusta.admit(b)).flatten() {
        let (entry, cell) = (&index.cells[cell], cell as u32);
        // Both lists ascend.
        while culled.next_if(|[_, last]| *last < cell).is_some() {}
        if culled.peek().is_some_and(|[first, _]| *first <= cell) || !frusta.admit(&entry.bounds) {
            continue;
        }
        let distance_m = entry.bounds.distance(pose.position);
        let level = entry.level_within(distance_m * deviation_per_metre);
        seen.push((distance_m, DrawnCell { cell, level }));
        triangles += u64::from(entry.triangles_at(level));
    }
    let cells = near_to_far(seen);
    let images = selection.placement.map_or_else(Vec::new, |p| frusta.images_in_view(index, p, pose));
    let complete_m = if selection.placement.is_some() { 0.0 } else { f64::INFINITY };
    let (tree, rooms, portals) = (Vec::new(), Vec::new(), Vec::new());
    DrawList { selection, cells, images, triangles, dropped: 0, complete_m, tree, rooms, portals }
}

/// Cells that a pose draws where all else comes from the LDI tree, near to far, were the budget
/// `share` times as large.
pub fn cells_before_tree(
    index: &Index,
    groups: &CellGroups,
    pose: &Pose,
    picture_half_tan: (f64, f64),
    share: f64,
) -> Vec<DrawnCell> {
    let nothing = Selection { grid_point: None, placement: None };
    let budget = (index.settings.budget as f64 * share) as u64;
    let detail = index.settings.deviation_per_metre();
    within(index, budget, pose.position, cells_in_view(index, groups, nothing, pose, picture_half_tan, detail)).cells
}

/// Of some cells and images, those that a pose draws, in no order. As [`draw_list_of`] finds them
/// in a dataset with grid points, or where all that is far is geometry, but for cells that would
/// be left out because the budget is used up. For whoever has all others already and asks for many
/// poses. `images`: per image of the index, whether it is one of them.
pub fn draws_among(
    index: &Index,
    groups: &CellGroups,
    (cells, images): (&SomeCells, &[bool]),
    pose: &Pose,
    picture_half_tan: (f64, f64),
    far: FarBy,
) -> (Vec<DrawnCell>, Vec<u32>) {
    let placement = if far == FarBy::Offered { select(index, pose).placement } else { None };
    let entry = placement.and_then(|p| index.placements.get(p as usize));
    let frusta = DrawFrusta::new(&index.settings, pose, picture_half_tan);
    let mut drawn = Vec::new();
    groups.each_of(
        cells,
        |bounds| frusta.admit(bounds),
        |cell| {
            let bounds = &index.cells[cell].bounds;
            let is_culled = entry.is_some_and(|e| e.culled.contains(cell as u32));
            if (!is_culled || frusta.images_may_lack(bounds)) && frusta.admit(bounds) {
                let level = if far == FarBy::Geometry { 0 } else { level_at(index, cell as u32, pose.position) };
                drawn.push(DrawnCell { cell: cell as u32, level });
            }
        },
    );
    let wanted = |image: &u32| images.get(*image as usize) == Some(&true);
    let mut shown = Vec::new();
    if let (Some(placement), Some(entry)) = (placement, entry)
        && entry.images.clone().any(|i| wanted(&i))
    {
        shown = frusta.images_in_view(index, placement, pose);
        shown.retain(wanted);
    }
    (drawn, shown)
}

/// The level of detail at which an eye draws a cell: the coarsest that its distance allows. The
/// count that a placement was planned with is that of the closest of its eyes, so no less.
pub fn level_at(index: &Index, cell: u32, eye: DVec3) -> u8 {
    let Some(entry) = index.cells.get(cell as usize) else { return 0 };
    entry.level_within(entry.bounds.distance(eye) * index.settings.deviation_per_metre())
}

/// Cells (distance, cell), near to far.
fn near_to_far(mut cells: Vec<(f64, DrawnCell)>) -> Vec<DrawnCell> {
    cells.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    cells.into_iter().map(|c| c.1).collect()
}

/// The list without cells that exceed the budget.
fn within_budget(index: &Index, eye: DVec3, list: DrawList) -> DrawList {
    within(index, index.settings.budget, eye, list)
}

/// The same for any budget: the farthest cells go, but [`WIDE_SHARE`] of it is for those of them
/// that fill most of the picture per triangle: hills, walls and seas behind a town. A larger
/// budget draws all that a smaller one draws.
fn within(index: &Index, budget: u64, eye: DVec3, mut list: DrawList) -> DrawList {
    if list.triangles <= budget {
        return list;
    }
    let share = |of: u64| (of as f64 * WIDE_SHARE) as u64;
    let (for_wide, largest) = (share(budget), share(index.settings.budget));
    let triangles_of = |c: DrawnCell| u64::from(index.cells[c.cell as usize].triangles_at(c.level));
    let mut beyond: Vec<(f64, DrawnCell)> = Vec::new();
    while list.triangles > budget - for_wide {
        let Some(cell) = list.cells.pop() else { break };
        let entry = &index.cells[cell.cell as usize];
        list.triangles -= triangles_of(cell);
        beyond.push((-picture_per_triangle(&entry.bounds, triangles_of(cell), eye), cell));
    }
    beyond.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    let (mut wide, mut is_full) = (0, false);
    for (_, cell) in beyond {
        let triangles = triangles_of(cell);
        // What comes after the first that does not fit is left out, small or not: or else larger
        // budgets would draw other cells.
        is_full |= triangles <= largest && wide + triangles > for_wide;
        if triangles <= largest && !is_full {
            wide += triangles;
            list.cells.push(cell);
        } else {
            list.complete_m = list.complete_m.min(index.cells[cell.cell as usize].bounds.distance(eye));
            list.dropped += 1;
        }
    }
    list.triangles += wide;
    let distance = |c: &DrawnCell| index.cells[c.cell as usize].bounds.distance(eye);
    list.cells = near_to_far(list.cells.iter().map(|c| (distance(c), *c)).collect());
    list
}

/// About how much of the picture a cell fills per triangle: the mean area of its box's outline
/// over all directions, as seen from the eye. Only its order means something.
fn picture_per_triangle(bounds: &Aabb, triangles: u64, eye: DVec3) -> f64 {
    let size = bounds.size();
    let outline = 0.5 * (size.x * size.y + size.y * size.z + size.z * size.x);
    outline / (bounds.centre().distance_squared(eye) * triangles.max(1) as f64).max(1e-9)
}

/// The nearest cells in view that the budget allows: what is drawn as geometry where all else
/// comes from the LDI tree.
#[derive(Debug, Clone, PartialEq, Eq, Default)]
pub struct Nearest {
    /// Near to far.
    pub cells: Vec<u32>,
    /// Triangles in them; never more than the budget.
    pub triangles: u64,
    /// Cells in view beyond them.
    pub dropped: u32,
}

/// The nearest cells in view, up to the first that would exceed the budget. `picture_half_tan` as
/// of [`draw_list`].
pub fn nearest_cells(
    cells: &[CellEntry],
    settings: &BuildSettings,
    pose: &Pose,
    picture_half_tan: (f64, f64),
) -> Nearest {
    let frusta = DrawFrusta::new(settings, pose, picture_half_tan);
    let mut in_view: Vec<(f64, u32)> = (0u32..)
        .zip(cells)
        .filter(|(_, c)| frusta.admit(&c.bounds))
        .map(|(n, c)| (c.bounds.distance(pose.position), n))
        .collect();
    let detail = settings.deviation_per_metre();
    in_view.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    let mut nearest = Nearest { dropped: in_view.len() as u32, ..Nearest::default() };
    for (distance_m, cell) in in_view {
        let entry = &cells[cell as usize];
        let triangles = nearest.triangles + u64::from(entry.triangles_at(entry.level_within(distance_m * detail)));
        if triangles > settings.budget {
            break;
        }
        nearest.triangles = triangles;
        nearest.cells.push(cell);
        nearest.dropped -= 1;
    }
    nearest
}

/// Chunks of all nodes that a view of the planned picture's pixels descends to.
fn tree_chunks(index: &Index, pose: &Pose, (half_tan_x, half_tan_y): (f64, f64)) -> Vec<u32> {
    let Some(tree) = &index.tree else { return Vec::new() };
    let lens = Lens { half_tan_x, half_tan_y, focal_px: index.settings.camera.focal_px() };
    let mut homes: Vec<(u8, u32)> = cut(tree, pose, &lens, &CutOptions::default(), |_| true)
        .nodes
        .iter()
        .map(|n| (tree.nodes[n.node as usize].level, n.home.0))
        .collect();
    homes.sort_unstable();
    homes.dedup();
    homes.into_iter().map(|h| h.1).collect()
}

/// The placement that a grid point names for the direction of a pose.
pub fn placement_of(index: &Index, grid_point: u32, pose: &Pose) -> Option<u32> {
    let ranges = ranges_of(index, grid_point, pose)?;
    let yaw = pose.yaw_deg.rem_euclid(360.0);
    let after = ranges.partition_point(|r| r.yaw_start_deg <= yaw);
    let range = if after == 0 { ranges.last() } else { ranges.get(after - 1) };
    range.and_then(|r| r.placement)
}

/// The angular ranges of a grid point at the pitch of a pose; None outside the built range.
fn ranges_of<'a>(index: &'a Index, grid_point: u32, pose: &Pose) -> Option<&'a [AngularRange]> {
    let band = band_of(&index.pitch_bands_deg, pose.pitch_deg)?;
    index.points[grid_point as usize].bands.get(band).map(Vec::as_slice)
}

/// Yaws just before and just after each at which the grid point of a pose names another placement,
/// degrees, in pairs: from one pair to the next the placement stays.
pub fn yaws_of_placements(index: &Index, pose: &Pose) -> Vec<f64> {
    let ranges = select(index, pose).grid_point.and_then(|g| ranges_of(index, g, pose)).unwrap_or_default();
    ranges.iter().flat_map(|r| [r.yaw_start_deg - BESIDE_DEG, r.yaw_start_deg + BESIDE_DEG]).collect()
}

/// The pitch band of a direction; None outside the built range.
pub fn band_of(borders_deg: &[f64], pitch_deg: f64) -> Option<usize> {
    let (first, last) = (borders_deg.first()?, borders_deg.last()?);
    if pitch_deg < *first || pitch_deg > *last {
        return None;
    }
    Some(borders_deg.partition_point(|b| *b <= pitch_deg).clamp(1, borders_deg.len() - 1) - 1)
}

#[cfg(test)]
mod tests;
