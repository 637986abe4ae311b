//! Shapes on white paper, as SVG and as PNG.

use super::png;
use base64::Engine as _;
use font8x8::UnicodeFonts as _;
use glam::DVec2;
use ldi_protocol::floor_plan::FloorPlan;
use std::fmt::Write as _;

/// sRGB colour.
pub(super) type Ink = [u8; 3];

enum Shape {
    Rectangle {
        low: DVec2,
        high: DVec2,
        ink: Ink,
    },
    Frame {
        low: DVec2,
        high: DVec2,
        ink: Ink,
    },
    Dot {
        at: DVec2,
        radius: f64,
        ink: Ink,
    },
    /// A floor plan whose raster lies between two corners; drawn within a part of it.
    Picture {
        low: DVec2,
        high: DVec2,
        part: [DVec2; 2],
        plan: FloorPlan,
    },
    /// Left end of the base line.
    Text {
        at: DVec2,
        text: String,
        ink: Ink,
    },
}

/// A drawing; x to the right, y downward, pixels.
pub(super) struct Drawing {
    size: DVec2,
    shapes: Vec<Shape>,
}

fn hex(ink: Ink) -> String {
    format!("#{:02x}{:02x}{:02x}", ink[0], ink[1], ink[2])
}

impl Drawing {
    pub fn new(width: f64, height: f64) -> Self {
        Self { size: DVec2::new(width, height).ceil(), shapes: Vec::new() }
    }

    /// A filled rectangle. One that goes on to the right of the last one with its colour makes
    /// that one longer.
    pub fn rectangle(&mut self, low: DVec2, high: DVec2, ink: Ink) {
        if let Some(Shape::Rectangle { low: l, high: h, ink: i }) = self.shapes.last_mut()
            && *i == ink
            && (l.y - low.y).abs() < 1e-6
            && (h.y - high.y).abs() < 1e-6
            && (h.x - low.x).abs() < 1e-6
        {
            h.x = high.x;
            return;
        }
        self.shapes.push(Shape::Rectangle { low, high, ink });
    }

    pub fn frame(&mut self, low: DVec2, high: DVec2, ink: Ink) {
        self.shapes.push(Shape::Frame { low, high, ink });
    }

    pub fn dot(&mut self, at: DVec2, radius: f64, ink: Ink) {
        self.shapes.push(Shape::Dot { at, radius, ink });
    }

    /// A floor plan between two corners, cut to a part of that.
    pub fn picture(&mut self, low: DVec2, high: DVec2, part: [DVec2; 2], plan: FloorPlan) {
        self.shapes.push(Shape::Picture { low, high, part, plan });
    }

    pub fn text(&mut self, at: DVec2, text: &str, ink: Ink) {
        let text = text.chars().filter(|c| !c.is_control()).collect();
        self.shapes.push(Shape::Text { at, text, ink });
    }

    pub fn svg(&self) -> String {
        let mut out = format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{:.0}\" height=\"{:.0}\" font-family=\"sans-serif\" font-size=\"12\">\n\
             <rect width=\"100%\" height=\"100%\" fill=\"white\"/>\n",
            self.size.x, self.size.y
        );
        for shape in &self.shapes {
            // Writing into a string cannot fail.
            let _ = match shape {
                Shape::Rectangle { low, high, ink } => writeln!(
                    out,
                    "<rect x=\"{:.2}\" y=\"{:.2}\" width=\"{:.2}\" height=\"{:.2}\" fill=\"{}\"/>",
                    low.x,
                    low.y,
                    high.x - low.x,
                    high.y - low.y,
                    hex(*ink)
                ),
                Shape::Frame { low, high, ink } => writeln!(
                    out,
                    "<rect x=\"{:.2}\" y=\"{:.2}\" width=\"{:.2}\" height=\"{:.2}\" fill=\"none\" stroke=\"{}\"/>",
                    low.x,
                    low.y,
                    high.x - low.x,
                    high.y - low.y,
                    hex(*ink)
                ),
                Shape::Dot { at, radius, ink } => {
                    writeln!(
                        out,
                        "<circle cx=\"{:.2}\" cy=\"{:.2}\" r=\"{radius}\" fill=\"{}\"/>",
                        at.x,
                        at.y,
                        hex(*ink)
                    )
                }
                Shape::Picture { low, high, part: [from, to], plan } => {
                    let png = png::encode(plan.size, plan.picture().as_flattened()).unwrap_or_default();
                    // The part as a window onto the whole picture.
                    let (size, at) = (*to - *from, *low - *from);
                    writeln!(
                        out,
                        "<svg x=\"{:.2}\" y=\"{:.2}\" width=\"{:.2}\" height=\"{:.2}\"><image x=\"{:.2}\" y=\"{:.2}\" \
                         width=\"{:.2}\" height=\"{:.2}\" preserveAspectRatio=\"none\" \
                         href=\"data:image/png;base64,{}\"/></svg>",
                        from.x,
                        from.y,
                        size.x,
                        size.y,
                        at.x,
                        at.y,
                        high.x - low.x,
                        high.y - low.y,
                        base64::engine::general_purpose::STANDARD.encode(png)
                    )
                }
                Shape::Text { at, text, ink } => {
                    let text = text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;");
                    writeln!(out, "<text x=\"{:.2}\" y=\"{:.2}\" fill=\"{}\">{text}</text>", at.x, at.y, hex(*ink))
                }
            };
        }
        out.push_str("</svg>\n");
        out
    }

    pub fn png(&self) -> Result<Vec<u8>, image::ImageError> {
        let mut picture = image::RgbImage::from_pixel(self.size.x as u32, self.size.y as u32, image::Rgb([255; 3]));
        // Saturating conversions; pixels outside are left out.
        let mut fill = |low: DVec2, high: DVec2, ink: Ink| {
            let end = high.round().max(low.round() + 1.0);
            for y in low.y.round().max(0.0) as u32..(end.y.max(0.0) as u32).min(picture.height()) {
                for x in low.x.round().max(0.0) as u32..(end.x.max(0.0) as u32).min(picture.width()) {
                    picture.put_pixel(x, y, image::Rgb(ink));
                }
            }
        };
        for shape in &self.shapes {
            match shape {
                Shape::Rectangle { low, high, ink } => fill(*low, *high, *ink),
                Shape::Frame { low, high, ink } => {
                    fill(*low, DVec2::new(high.x, low.y + 1.0), *ink);
                    fill(DVec2::new(low.x, high.y - 1.0), *high, *ink);
                    fill(*low, DVec2::new(low.x + 1.0, high.y), *ink);
                    fill(DVec2::new(high.x - 1.0, low.y), *high, *ink);
                }
                Shape::Dot { at, radius, ink } => fill(*at - *radius, *at + *radius, *ink),
                Shape::Picture { low, high, part: [from, to], plan } => {
                    let px_per_cell = (high.x - low.x) / f64::from(plan.size[0].max(1));
                    // Coarser cells keep thin lines that single samples would miss.
                    let plan = plan.coarser((1.0 / px_per_cell.max(1e-6)).ceil().min(4096.0) as u32);
                    let colours = plan.picture();
                    let cell = (*high - *low) / DVec2::new(f64::from(plan.size[0]), f64::from(plan.size[1]));
                    for y in from.y.max(0.0) as u32..to.y.max(0.0) as u32 {
                        for x in from.x.max(0.0) as u32..to.x.max(0.0) as u32 {
                            let pixel = DVec2::new(f64::from(x), f64::from(y)) + 0.5;
                            let at = ((pixel - *low) / cell).floor();
                            let [i, k] = [at.x, at.y].map(|v| v.max(0.0) as u32);
                            let colour = colours.get((k * plan.size[0] + i) as usize);
                            if let Some([r, g, b, 255]) = colour.filter(|_| i < plan.size[0]) {
                                fill(pixel - 0.5, pixel + 0.5, [*r, *g, *b]);
                            }
                        }
                    }
                }
                Shape::Text { at, text, ink } => {
                    for (n, letter) in text.chars().enumerate() {
                        let glyph = font8x8::BASIC_FONTS.get(letter).unwrap_or([0; 8]);
                        for (row, bits) in glyph.iter().enumerate() {
                            for column in (0..8).filter(|c| bits >> c & 1 == 1) {
                                let corner = *at + DVec2::new((n * 8 + column) as f64, row as f64 - 8.0);
                                fill(corner, corner + 1.0, *ink);
                            }
                        }
                    }
                }
            }
        }
        let mut bytes = std::io::Cursor::new(Vec::new());
        picture.write_to(&mut bytes, image::ImageFormat::Png)?;
        Ok(bytes.into_inner())
    }
}
