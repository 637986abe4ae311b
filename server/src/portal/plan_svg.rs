//! The floor plan as a picture: storey below storey, cells coloured and named, portals as lines.

use ldi_protocol::rooms::{Cell, PortalKind, Rooms};
use std::fmt::Write as _;

/// Widest drawing, pixels.
const WIDTH_PX: f64 = 1400.0;
/// Border around each storey, pixels.
const BORDER_PX: f64 = 40.0;
/// Cells whose floors lie within this height are drawn together, metres.
const STOREY_M: f64 = 1.8;

/// Colour of a kind of portal.
fn colour(kind: PortalKind) -> &'static str {
    match kind {
        PortalKind::Door => "#d00000",
        PortalKind::Window => "#0060d0",
        PortalKind::Hatch => "#008030",
        PortalKind::Gap => "#e08000",
        PortalKind::Given => "#a000a0",
    }
}

/// A colour of medium saturation as #rrggbb, which every program that draws SVG knows, unlike
/// hsl(): hue in degrees, lightness in percent (CSS Color 3, section 4.2.4).
fn hex(hue: f64, light_percent: f64) -> String {
    let light = light_percent / 100.0;
    let channel = |n: f64| {
        let k = (n + hue / 30.0).rem_euclid(12.0);
        let value = light - 0.7 * light.min(1.0 - light) * (k - 3.0).min(9.0 - k).clamp(-1.0, 1.0);
        (value * 255.0).round() as u8
    };
    format!("#{:02x}{:02x}{:02x}", channel(0.0), channel(8.0), channel(4.0))
}

fn escaped(text: &str) -> String {
    text.chars().fold(String::new(), |mut out, c| {
        match c {
            '<' => out.push_str("&lt;"),
            '>' => out.push_str("&gt;"),
            '&' => out.push_str("&amp;"),
            c if c.is_control() => out.push(' '),
            c => out.push(c),
        }
        out
    })
}

/// Draws the plan; x to the right, z downward.
pub fn plan_svg(rooms: &Rooms, title: &str) -> String {
    let cells = rooms.cells();
    let mut order: Vec<usize> = (0..cells.len()).collect();
    let floor_m = |c: usize| cells[c].bounds().min.y;
    order.sort_by(|a, b| floor_m(*a).total_cmp(&floor_m(*b)));
    let mut storeys: Vec<Vec<usize>> = Vec::new();
    for c in order {
        match storeys.last_mut() {
            Some(s) if floor_m(c) <= floor_m(s[0]) + STOREY_M => s.push(c),
            _ => storeys.push(vec![c]),
        }
    }
    let all = cells.iter().fold(ldi_protocol::Aabb::EMPTY, |b, c| b.union(c.bounds()));
    let size = if all.is_empty() { glam::DVec3::splat(10.0) } else { all.size() };
    let scale = ((WIDTH_PX - 2.0 * BORDER_PX) / size.x.max(1.0)).min(1200.0 / size.z.max(1.0));
    let storey_px = size.z * scale + 2.0 * BORDER_PX;
    let height = storey_px * storeys.len().max(1) as f64 + 60.0;
    let mut out = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{WIDTH_PX}\" height=\"{height:.0}\" font-family=\"sans-serif\">\n\
         <rect width=\"100%\" height=\"100%\" fill=\"white\"/>\n\
         <text x=\"{BORDER_PX}\" y=\"26\" font-size=\"18\">{}: {} cells, {} portals</text>\n",
        escaped(title),
        cells.len(),
        rooms.portals().len()
    );
    let mut x = BORDER_PX;
    for (kind, name) in [
        (PortalKind::Door, "door"),
        (PortalKind::Window, "window"),
        (PortalKind::Hatch, "hatch (dashed: outline)"),
        (PortalKind::Gap, "gap"),
        (PortalKind::Given, "given"),
    ] {
        let _ = writeln!(
            out,
            "<line x1=\"{x}\" y1=\"44\" x2=\"{}\" y2=\"44\" stroke=\"{}\" stroke-width=\"4\"/><text x=\"{}\" y=\"49\" font-size=\"13\">{name}</text>",
            x + 24.0,
            colour(kind),
            x + 30.0
        );
        x += 60.0 + 8.0 * name.len() as f64;
    }
    for (n, storey) in storeys.iter().enumerate() {
        let top = 60.0 + storey_px * n as f64;
        let at = |x: f64, z: f64| (BORDER_PX + (x - all.min.x) * scale, top + BORDER_PX + (z - all.min.z) * scale);
        let _ = writeln!(
            out,
            "<text x=\"{BORDER_PX}\" y=\"{:.1}\" font-size=\"15\">floor {:.2} m</text>",
            top + 25.0,
            floor_m(storey[0])
        );
        for &c in storey {
            draw_cell(&mut out, c, &cells[c], scale, &at);
        }
        for p in rooms.portals() {
            let here = p.cells.iter().flatten().any(|c| storey.contains(&(*c as usize)));
            if !here {
                continue;
            }
            let points: Vec<(f64, f64)> = p.corners.iter().map(|c| at(c.x, c.z)).collect();
            let text: Vec<String> = points.iter().map(|(x, y)| format!("{x:.1},{y:.1}")).collect();
            let style = if p.normal().y.abs() > 0.5 {
                "stroke-dasharray=\"5 3\" stroke-width=\"1.5\""
            } else {
                "stroke-width=\"3\""
            };
            let _ = writeln!(
                out,
                "<polygon points=\"{}\" fill=\"none\" stroke=\"{}\" {style}><title>{} - {}: {:.2} m²</title></polygon>",
                text.join(" "),
                colour(p.kind),
                escaped(rooms.name(p.cells[0])),
                escaped(rooms.name(p.cells[1])),
                p.area_m2()
            );
        }
        for &c in storey {
            let cell = &cells[c];
            let area = |b: &ldi_protocol::Aabb| b.size().x * b.size().z;
            let Some(b) = cell.boxes.iter().max_by(|a, b| area(a).total_cmp(&area(b))) else { continue };
            let (x, y) = at(b.centre().x, b.centre().z);
            let font = (b.size().x * scale / cell.name.len().max(4) as f64 * 1.5).clamp(7.0, 14.0);
            let _ = writeln!(
                out,
                "<text x=\"{x:.1}\" y=\"{y:.1}\" font-size=\"{font:.1}\" text-anchor=\"middle\">{}</text>",
                escaped(&cell.name)
            );
        }
        let (x, y) = (BORDER_PX, top + storey_px - 12.0);
        let _ = writeln!(
            out,
            "<line x1=\"{x}\" y1=\"{y:.1}\" x2=\"{:.1}\" y2=\"{y:.1}\" stroke=\"black\" stroke-width=\"2\"/><text x=\"{:.1}\" y=\"{:.1}\" font-size=\"12\">5 m</text>",
            x + 5.0 * scale,
            x + 5.0 * scale + 6.0,
            y + 4.0
        );
    }
    out.push_str("</svg>\n");
    out
}

fn draw_cell(out: &mut String, number: usize, cell: &Cell, scale: f64, at: &dyn Fn(f64, f64) -> (f64, f64)) {
    // Golden angles: neighbours in number differ in hue.
    let hue = (number as f64 * 137.508) % 360.0;
    let light = [72.0, 78.0, 84.0][number % 3];
    let _ = writeln!(out, "<g fill=\"{}\"><title>{}</title>", hex(hue, light), escaped(&cell.name));
    for b in &cell.boxes {
        let ((x, y), s) = (at(b.min.x, b.min.z), b.size() * scale);
        let _ =
            writeln!(out, "<rect x=\"{x:.1}\" y=\"{y:.1}\" width=\"{:.1}\" height=\"{:.1}\"/>", s.x + 0.3, s.z + 0.3);
    }
    out.push_str("</g>\n");
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;
    use ldi_protocol::Aabb;

    /// Red, green and blue of full lightness and others, worked out by hand from the definition.
    #[test]
    fn hues_are_colours() {
        assert_eq!([hex(0.0, 50.0), hex(120.0, 50.0), hex(240.0, 50.0)], ["#d92626", "#26d926", "#2626d9"]);
        assert_eq!([hex(60.0, 100.0), hex(200.0, 0.0)], ["#ffffff", "#000000"]);
        assert_eq!(hex(30.0, 80.0), "#f0cca8");
    }

    #[test]
    fn storeys_are_drawn_apart_and_names_are_escaped() {
        let cell = |name: &str, y: f64| Cell {
            name: name.into(),
            boxes: vec![Aabb { min: DVec3::new(0.0, y, 0.0), max: DVec3::new(4.0, y + 2.8, 3.0) }],
        };
        let rooms = Rooms::new(0.1, vec![cell("a<b", 0.0), cell("c", 3.0)], vec![]).unwrap();
        let svg = plan_svg(&rooms, "test");
        assert!(svg.contains("a&lt;b") && !svg.contains("a<b"));
        assert!(svg.contains("floor 0.00 m") && svg.contains("floor 3.00 m"));
        assert!(plan_svg(&Rooms::default(), "empty").contains("0 cells"));
    }
}
