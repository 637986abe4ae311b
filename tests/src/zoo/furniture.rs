//! Pieces that stand in rooms and gardens; each is one mesh about the middle of its foot, its back
//! toward -Z.

use super::kit::{Pattern, Shape, Shapes, Site, at};
use glam::DVec3;

/// Meshes of furniture, placed as often as one likes.
pub(super) struct Furniture {
    /// 1.2 by 0.8 m, 0.75 m high, laid.
    pub table: u32,
    /// 0.45 m square.
    pub chair: u32,
    /// 1.4 by 2 m.
    pub bed: u32,
    /// 2 by 0.85 m.
    pub sofa: u32,
    /// 1 by 0.35 m, 1.8 m high, full of books.
    pub shelf: u32,
    /// Floor lamp, 0.4 m wide.
    pub lamp: u32,
    /// 0.6 m wide.
    pub plant: u32,
    /// 1.4 by 0.7 m, 0.74 m high, with a screen.
    pub desk: u32,
    /// 1.2 by 0.6 m, 2 m high.
    pub wardrobe: u32,
    /// A tree 6 m high.
    pub tree: u32,
}

impl Furniture {
    pub fn new(site: &mut Site) -> Self {
        let wood = site.paint(Pattern::Wood, [0.8, 0.65, 0.5]);
        let dark = site.paint(Pattern::Wood, [0.35, 0.25, 0.2]);
        let cloth = site.paint(Pattern::Cloth, [0.75, 0.3, 0.25]);
        let linen = site.paint(Pattern::Cloth, [0.85, 0.85, 0.95]);
        let clay = site.plain([0.2, 0.45, 0.6]);
        let metal = site.plain([0.25, 0.26, 0.28]);
        let leaf = site.plain([0.13, 0.4, 0.12]);
        let glow = site.plain([0.95, 0.8, 0.5]);
        let books = [site.plain([0.6, 0.12, 0.1]), site.plain([0.1, 0.25, 0.5]), site.plain([0.75, 0.6, 0.15])];
        let mut add = |name: &str, shapes: Vec<Shape>| site.draft.mesh(name, shapes);
        let legs = |mut shape: Shape, x: f64, z: f64, high: f64, radius: f64| {
            for (sx, sz) in [(-1.0, -1.0), (1.0, -1.0), (1.0, 1.0), (-1.0, 1.0)] {
                let foot = at(x * sx, 0.0, z * sz);
                shape = shape.rod(foot, foot + DVec3::Y * high, radius, 8);
            }
            shape
        };

        let mut dishes = Shape::new(clay);
        for (x, z) in [(-0.4, -0.2), (0.4, -0.2), (-0.4, 0.2), (0.4, 0.2)] {
            dishes = dishes.with(plate().moved(glam::DAffine3::from_translation(at(x, 0.75, z))));
        }
        let top = Shape::new(wood).boxed(at(0.0, 0.73, 0.0), at(0.6, 0.02, 0.4));
        let table = add("table", vec![legs(top, 0.54, 0.34, 0.71, 0.035), dishes]);

        let seat = Shape::new(dark)
            .boxed(at(0.0, 0.44, 0.0), at(0.22, 0.02, 0.22))
            .boxed(at(0.0, 0.75, -0.2), at(0.22, 0.15, 0.015));
        let seat = legs(seat, 0.19, 0.19, 0.42, 0.02).rod(at(-0.19, 0.46, -0.2), at(-0.19, 0.6, -0.2), 0.015, 6).rod(
            at(0.19, 0.46, -0.2),
            at(0.19, 0.6, -0.2),
            0.015,
            6,
        );
        let chair = add("chair", vec![seat]);

        let frame = Shape::new(dark)
            .boxed(at(0.0, 0.2, 0.0), at(0.7, 0.12, 1.0))
            .boxed(at(0.0, 0.5, -0.98), at(0.7, 0.5, 0.03));
        let mattress = Shape::new(linen)
            .boxed(at(0.0, 0.42, 0.0), at(0.68, 0.1, 0.94))
            .blob(at(-0.33, 0.56, -0.7), at(0.28, 0.09, 0.2), 14, 8)
            .blob(at(0.33, 0.56, -0.7), at(0.28, 0.09, 0.2), 14, 8);
        let blanket = Shape::new(cloth).boxed(at(0.0, 0.45, 0.3), at(0.7, 0.1, 0.66));
        let bed = add("bed", vec![frame, mattress, blanket]);

        let mut body = Shape::new(cloth)
            .boxed(at(0.0, 0.22, 0.0), at(1.0, 0.18, 0.42))
            .boxed(at(0.0, 0.6, -0.32), at(1.0, 0.2, 0.1));
        for x in [-0.92, 0.92] {
            body = body.boxed(at(x, 0.45, 0.0), at(0.08, 0.15, 0.42));
        }
        let mut cushions = Shape::new(linen);
        for x in [-0.55, 0.0, 0.55] {
            cushions = cushions.blob(at(x, 0.42, 0.08), at(0.27, 0.08, 0.3), 12, 6).blob(
                at(x, 0.62, -0.16),
                at(0.24, 0.2, 0.09),
                12,
                6,
            );
        }
        let sofa = add("sofa", vec![body, cushions]);

        let mut boards = Shape::new(wood).boxed(at(0.0, 0.9, -0.16), at(0.5, 0.9, 0.01));
        for x in [-0.49, 0.49] {
            boards = boards.boxed(at(x, 0.9, 0.0), at(0.012, 0.9, 0.17));
        }
        let mut volumes = books.map(Shape::new);
        for row in 0..5 {
            let y = 0.05 + 0.42 * f64::from(row);
            boards = boards.boxed(at(0.0, y, 0.0), at(0.48, 0.012, 0.165));
            for b in 0..if row < 4 { 9 } else { 0 } {
                let high = 0.11 + 0.012 * f64::from((b * 7 + row * 3) % 5);
                let x = -0.42 + 0.1 * f64::from(b);
                let kind = ((b + row) % 3) as usize;
                volumes[kind] =
                    std::mem::take(&mut volumes[kind]).boxed(at(x, y + 0.013 + high, 0.0), at(0.034, high, 0.1));
            }
        }
        let shelf = add("shelf", [boards].into_iter().chain(volumes).collect());

        let foot = Shape::new(metal).lathe(
            &[(0.0, 0.0), (0.16, 0.0), (0.16, 0.03), (0.015, 0.05), (0.015, 1.45), (0.0, 1.45)],
            16,
            1,
            false,
        );
        let shade = Shape::new(glow).lathe(&[(0.0, 1.25), (0.2, 1.25), (0.12, 1.6), (0.0, 1.62)], 16, 1, false);
        let lamp = add("lamp", vec![foot, shade]);

        let pot = Shape::new(clay).lathe(
            &[(0.0, 0.0), (0.13, 0.0), (0.19, 0.32), (0.15, 0.32), (0.14, 0.26), (0.0, 0.26)],
            16,
            1,
            false,
        );
        let mut leaves = Shape::new(leaf);
        for k in 0..14 {
            let turn = glam::DQuat::from_rotation_y(2.4 * f64::from(k)) * glam::DQuat::from_rotation_z(0.6);
            let by = glam::DAffine3::from_rotation_translation(turn, at(0.0, 0.3 + 0.05 * f64::from(k), 0.0));
            leaves = leaves.with(Shape::new(0).blob(at(0.14, 0.1, 0.0), at(0.16, 0.02, 0.05), 6, 4).moved(by));
        }
        let plant = add("plant", vec![pot, leaves]);

        let mut office = Shape::new(wood)
            .boxed(at(0.0, 0.72, 0.0), at(0.7, 0.02, 0.35))
            .boxed(at(-0.66, 0.35, 0.0), at(0.03, 0.35, 0.33))
            .boxed(at(0.48, 0.35, 0.0), at(0.2, 0.35, 0.32));
        for y in [0.15, 0.38, 0.6] {
            office = office.boxed(at(0.48, y, 0.33), at(0.18, 0.09, 0.01));
        }
        let mut screen = Shape::new(metal)
            .boxed(at(0.0, 1.06, -0.15), at(0.3, 0.17, 0.015))
            .rod(at(0.0, 0.74, -0.15), at(0.0, 0.9, -0.15), 0.025, 10)
            .boxed(at(0.0, 0.75, -0.15), at(0.12, 0.01, 0.09))
            .boxed(at(0.0, 0.75, 0.12), at(0.22, 0.01, 0.07));
        for k in 0..6 {
            let (x, z) = (f64::from(k % 3) * 0.13 - 0.13, f64::from(k / 3) * 0.06 + 0.09);
            screen = screen.boxed(at(x, 0.765, z), at(0.055, 0.006, 0.022));
        }
        let mug = Shape::new(clay)
            .lathe(&[(0.0, 0.0), (0.04, 0.0), (0.04, 0.1), (0.033, 0.1), (0.033, 0.01), (0.0, 0.01)], 12, 1, false)
            .moved(glam::DAffine3::from_translation(at(0.45, 0.74, 0.1)));
        let desk = add("desk", vec![office, screen, mug]);

        let mut doors = Shape::new(wood);
        let mut knobs = Shape::new(metal);
        for x in [-0.3, 0.3] {
            doors = doors.boxed(at(x, 1.0, 0.29), at(0.28, 0.92, 0.02));
            for y in [0.55, 1.35] {
                doors = doors.boxed(at(x, y, 0.315), at(0.2, 0.34, 0.01));
            }
            knobs = knobs.blob(at(x * 0.12, 1.0, 0.34), at(0.03, 0.03, 0.03), 6, 4);
        }
        let case = Shape::new(dark).boxed(at(0.0, 1.0, -0.02), at(0.6, 1.0, 0.28));
        let wardrobe = add("wardrobe", vec![case, doors, knobs]);

        let trunk = Shape::new(dark).lathe(&[(0.0, 0.0), (0.2, 0.0), (0.1, 3.5), (0.0, 3.5)], 8, 1, false);
        let crown = Shape::new(leaf)
            .blob(at(0.0, 4.4, 0.0), at(1.6, 1.5, 1.6), 8, 5)
            .blob(at(0.9, 3.6, 0.4), at(1.0, 0.8, 1.0), 7, 4)
            .blob(at(-0.8, 3.7, -0.5), at(1.1, 0.9, 1.0), 7, 4)
            .shaded(|p| 0.75 + 0.25 * (p.x * 5.0).sin() * (p.z * 4.0 + p.y * 3.0).sin());
        let tree = add("tree", vec![trunk, crown]);

        Self { table, chair, bed, sofa, shelf, lamp, plant, desk, wardrobe, tree }
    }

    /// A table with four chairs: 1.2 m wide, 1.9 m deep, turned by quarter turns.
    pub fn dining(&self, site: &mut Site, middle: DVec3, quarter_turns: u32) {
        let yaw = 90.0 * f64::from(quarter_turns);
        let turn = glam::DQuat::from_rotation_y(yaw.to_radians());
        site.place(self.table, middle, yaw);
        for (x, z, back) in [(-0.3, -0.6, 0.0), (0.3, -0.6, 0.0), (-0.3, 0.6, 180.0), (0.3, 0.6, 180.0)] {
            site.place(self.chair, middle + turn * at(x, 0.0, z), yaw + back);
        }
    }

    /// A desk with a chair before it (at +Z), turned about Y.
    pub fn workplace(&self, site: &mut Site, middle: DVec3, yaw_deg: f64) {
        let turn = glam::DQuat::from_rotation_y(yaw_deg.to_radians());
        site.place(self.desk, middle, yaw_deg);
        site.place(self.chair, middle + turn * at(0.0, 0.0, 0.55), yaw_deg + 180.0);
    }
}

/// A plate with a bowl on it.
fn plate() -> Shape {
    Shape::new(0).lathe(
        &[(0.0, 0.0), (0.08, 0.0), (0.12, 0.02), (0.06, 0.02), (0.085, 0.06), (0.08, 0.06), (0.0, 0.03)],
        10,
        1,
        false,
    )
}
