//! Line plots as SVG, readable in light and dark: colours come from the page's style sheet by
//! class.

use std::fmt::Write as _;

/// One line of a plot.
pub struct Series<'a> {
    /// Name in the legend.
    pub name: &'a str,
    /// (x, y), x ascending. Points that are not finite break the line.
    pub points: Vec<(f64, f64)>,
}

/// A plot with axes, ticks, a legend, and optionally a horizontal line that is not to be crossed.
pub struct Plot<'a> {
    /// Heading.
    pub title: &'a str,
    /// Name and unit of the horizontal axis.
    pub x: &'a str,
    /// Name and unit of the vertical axis.
    pub y: &'a str,
    /// At most four.
    pub series: Vec<Series<'a>>,
    /// A bound, with its name.
    pub bound: Option<(&'a str, f64)>,
}

const WIDTH: f64 = 640.0;
const HEIGHT: f64 = 260.0;
const LEFT: f64 = 64.0;
const RIGHT: f64 = 16.0;
const TOP: f64 = 44.0;
const BOTTOM: f64 = 40.0;

impl Plot<'_> {
    /// The plot as an `<svg>` element. The vertical axis starts at 0.
    pub fn svg(&self) -> String {
        let finite = |p: &&(f64, f64)| p.0.is_finite() && p.1.is_finite();
        let all = || self.series.iter().flat_map(|s| s.points.iter().filter(finite));
        let (x0, x1) = all().fold((f64::MAX, f64::MIN), |(a, b), p| (a.min(p.0), b.max(p.0)));
        if x0 > x1 {
            return format!("<p class=\"none\">{}: no data</p>", escape(self.title));
        }
        let x1 = if x1 > x0 { x1 } else { x0 + 1.0 };
        let top = all().map(|p| p.1).chain(self.bound.map(|b| b.1)).fold(0.0, f64::max);
        let step = tick_step(if top > 0.0 { top } else { 1.0 });
        let y1 = (top / step).ceil().max(1.0) * step;
        let px = |x: f64| LEFT + (x - x0) / (x1 - x0) * (WIDTH - LEFT - RIGHT);
        let py = |y: f64| HEIGHT - BOTTOM - y / y1 * (HEIGHT - TOP - BOTTOM);

        let mut s = open(self.title, HEIGHT);
        s += &levels(y1, step, py);
        let x_step = tick_step((x1 - x0) / 1.6);
        let mut x = (x0 / x_step).ceil() * x_step;
        while x <= x1 + x_step * 1e-6 {
            let _ = write!(
                s,
                "<text class=\"tick\" text-anchor=\"middle\" x=\"{:.1}\" y=\"{:.1}\">{}</text>",
                px(x),
                HEIGHT - BOTTOM + 16.0,
                number(x)
            );
            x += x_step;
        }
        s += &axes(self.x, self.y, HEIGHT);
        if let Some((name, y)) = self.bound {
            let _ = write!(
                s,
                "<line class=\"bound\" x1=\"{LEFT}\" x2=\"{:.1}\" y1=\"{1:.1}\" y2=\"{1:.1}\"/><text class=\"boundname\" x=\"{2:.1}\" y=\"{3:.1}\">{4}</text>",
                WIDTH - RIGHT,
                py(y),
                LEFT + 4.0,
                py(y) - 4.0,
                escape(name)
            );
        }
        let mut legend_x = WIDTH - RIGHT;
        for (i, series) in self.series.iter().enumerate().rev() {
            legend_x -= 7.0 * series.name.len() as f64 + 26.0;
            let _ = write!(
                s,
                "<line class=\"s{i}\" x1=\"{legend_x:.0}\" x2=\"{:.0}\" y1=\"28\" y2=\"28\"/><text class=\"legend\" x=\"{:.0}\" y=\"32\">{}</text>",
                legend_x + 14.0,
                legend_x + 18.0,
                escape(series.name)
            );
        }
        for (i, series) in self.series.iter().enumerate() {
            let mut path = String::new();
            let mut pen_down = false;
            for p in &series.points {
                if !finite(&p) {
                    pen_down = false;
                    continue;
                }
                let _ = write!(path, "{}{:.1} {:.1}", if pen_down { "L" } else { "M" }, px(p.0), py(p.1));
                pen_down = true;
            }
            let _ = write!(s, "<path class=\"s{i}\" d=\"{path}\"/>");
        }
        s + "</svg>"
    }
}

/// One point of a scatter plot.
pub struct Dot {
    /// What it is.
    pub name: String,
    /// Positive.
    pub x: f64,
    /// Vertical.
    pub y: f64,
    /// Colour, 0 to 3.
    pub series: usize,
}

/// Points over a logarithmic horizontal axis, less of both being better: those that nothing beats
/// in both are named and joined.
pub struct Scatter<'a> {
    /// Heading.
    pub title: &'a str,
    /// Name and unit of the horizontal axis.
    pub x: &'a str,
    /// Name and unit of the vertical axis.
    pub y: &'a str,
    /// The points.
    pub dots: Vec<Dot>,
}

impl Scatter<'_> {
    /// The plot as an `<svg>` element. The vertical axis starts at 0.
    pub fn svg(&self) -> String {
        const TALL: f64 = 380.0;
        let mut dots: Vec<&Dot> =
            self.dots.iter().filter(|d| d.x > 0.0 && d.x.is_finite() && d.y.is_finite()).collect();
        if dots.is_empty() {
            return format!("<p class=\"none\">{}: no data</p>", escape(self.title));
        }
        dots.sort_by(|a, b| a.x.total_cmp(&b.x).then(a.y.total_cmp(&b.y)));
        let (x0, x1) = (dots[0].x.log2().floor(), (dots[dots.len() - 1].x * 1.0001).log2().ceil());
        let top = dots.iter().map(|d| d.y).fold(0.0, f64::max);
        let step = tick_step(if top > 0.0 { top } else { 1.0 });
        let y1 = (top / step).ceil().max(1.0) * step;
        let px = |x: f64| LEFT + (x.log2() - x0) / (x1 - x0) * (WIDTH - LEFT - RIGHT);
        let py = |y: f64| TALL - BOTTOM - y / y1 * (TALL - TOP - BOTTOM);
        let mut s = open(self.title, TALL);
        s += &levels(y1, step, py);
        for power in x0 as i32..=x1 as i32 {
            let x = f64::from(power).exp2();
            let _ = write!(
                s,
                "<text class=\"tick\" text-anchor=\"middle\" x=\"{:.1}\" y=\"{:.1}\">{}</text>",
                px(x),
                TALL - BOTTOM + 16.0,
                number(x)
            );
        }
        s += &axes(self.x, self.y, TALL);
        // Fastest first: a point is in front if it errs less than all before.
        let (mut least, mut line) = (f64::INFINITY, String::new());
        let mut named: Vec<[f64; 2]> = Vec::new();
        for d in &dots {
            let (x, y) = (px(d.x), py(d.y));
            let front = d.y < least;
            let _ = write!(
                s,
                "<circle class=\"s{}\" cx=\"{x:.1}\" cy=\"{y:.1}\" r=\"{}\" fill=\"currentColor\"><title>{}: {}, {}</title></circle>",
                d.series.min(3),
                if front { 4 } else { 3 },
                escape(&d.name),
                number(d.x),
                number(d.y)
            );
            if front {
                least = d.y;
                let _ = write!(line, "{}{x:.1} {y:.1}", if line.is_empty() { "M" } else { "L" });
                // To the left of a point there is less below it than to the right.
                let (anchor, dx) = if x > WIDTH * 0.6 { ("end", -6.0) } else { ("start", 6.0) };
                // Names of neighbours go above each other.
                let mut at = y - 6.0;
                while named.iter().any(|[nx, ny]| (nx - x).abs() < 160.0 && (ny - at).abs() < 13.0) {
                    at -= 13.0;
                }
                named.push([x, at]);
                let _ = write!(
                    s,
                    "<text class=\"legend\" text-anchor=\"{anchor}\" x=\"{:.1}\" y=\"{:.1}\">{}</text>",
                    x + dx,
                    at,
                    escape(&d.name)
                );
            }
        }
        s + &format!("<path class=\"s0\" d=\"{line}\"/></svg>")
    }
}

/// The element's beginning, with its heading.
fn open(title: &str, height: f64) -> String {
    format!(
        "<svg class=\"plot\" viewBox=\"0 0 {WIDTH} {height}\" role=\"img\" aria-label=\"{0}\"><text class=\"title\" x=\"{LEFT}\" y=\"16\">{0}</text>",
        escape(title)
    )
}

/// Lines at every `step` of the vertical axis, from 0 to `top`; `py` gives their places.
fn levels(top: f64, step: f64, py: impl Fn(f64) -> f64) -> String {
    let mut s = String::new();
    for i in 0..=(top / step).round() as u32 {
        let y = f64::from(i) * step;
        let _ = write!(
            s,
            "<line class=\"grid\" x1=\"{LEFT}\" x2=\"{:.1}\" y1=\"{1:.1}\" y2=\"{1:.1}\"/><text class=\"tick\" text-anchor=\"end\" x=\"{2:.1}\" y=\"{3:.1}\">{4}</text>",
            WIDTH - RIGHT,
            py(y),
            LEFT - 6.0,
            py(y) + 4.0,
            number(y)
        );
    }
    s
}

/// The axes' names.
fn axes(x: &str, y: &str, height: f64) -> String {
    format!(
        "<text class=\"axis\" text-anchor=\"end\" x=\"{:.1}\" y=\"{:.1}\">{}</text><text class=\"axis\" x=\"4\" y=\"36\">{}</text>",
        WIDTH - RIGHT,
        height - 6.0,
        escape(x),
        escape(y)
    )
}

/// 1, 2 or 5 times a power of ten, so that three to seven ticks fit below `span`.
fn tick_step(span: f64) -> f64 {
    let raw = span / 4.0;
    let power = 10f64.powf(raw.log10().floor());
    let scaled = raw / power;
    power
        * if scaled < 1.5 {
            1.0
        } else if scaled < 3.5 {
            2.0
        } else if scaled < 7.5 {
            5.0
        } else {
            10.0
        }
}

/// A number for people: 1.5M, 200k, 12, 0.05.
pub fn number(v: f64) -> String {
    let a = v.abs();
    let trimmed =
        |s: String| if s.contains('.') { s.trim_end_matches('0').trim_end_matches('.').to_string() } else { s };
    if a >= 1e6 {
        format!("{}M", trimmed(format!("{:.2}", v / 1e6)))
    } else if a >= 1e4 {
        format!("{}k", trimmed(format!("{:.1}", v / 1e3)))
    } else if a >= 100.0 || a == 0.0 {
        format!("{v:.0}")
    } else {
        trimmed(format!("{v:.3}"))
    }
}

/// Text for HTML and SVG.
pub fn escape(s: &str) -> String {
    s.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plot(points: Vec<(f64, f64)>) -> String {
        Plot { title: "a < b", x: "s", y: "ms", series: vec![Series { name: "n", points }], bound: Some(("P", 8.0)) }
            .svg()
    }

    #[test]
    fn a_plot_spans_its_axes_and_escapes_text() {
        let svg = plot(vec![(0.0, 0.0), (10.0, 8.0)]);
        assert!(svg.contains("a &lt; b"));
        // From the origin of the axes to the right border, at the height of the bound's line.
        assert!(svg.contains(&format!("M{LEFT:.1} {:.1}L{:.1} {TOP:.1}", HEIGHT - BOTTOM, WIDTH - RIGHT)), "{svg}");
    }

    #[test]
    fn a_missing_value_breaks_the_line() {
        let svg = plot(vec![(0.0, 1.0), (1.0, f64::NAN), (2.0, 1.0)]);
        assert_eq!(svg.matches('M').count(), 2);
        assert_eq!(plot(vec![(0.0, 1.0), (1.0, 1.0), (2.0, 1.0)]).matches('M').count(), 1);
    }

    #[test]
    fn no_data_is_said() {
        assert!(plot(vec![]).contains("no data"));
    }

    #[test]
    fn what_is_beaten_in_both_is_not_named() {
        let dot = |name: &str, x: f64, y: f64| Dot { name: name.into(), x, y, series: 0 };
        let dots =
            vec![dot("slow best", 8.0, 0.1), dot("beaten", 4.0, 0.5), dot("fast", 1.0, 0.4), dot("bad", f64::NAN, 0.0)];
        let svg = Scatter { title: "t", x: "ms", y: "FLIP", dots }.svg();
        assert_eq!(svg.matches("<circle").count(), 3);
        let named: Vec<&str> =
            ["slow best", "beaten", "fast"].into_iter().filter(|n| svg.contains(&format!(">{n}</text>"))).collect();
        assert_eq!(named, ["slow best", "fast"]);
        assert!(Scatter { title: "t", x: "", y: "", dots: vec![] }.svg().contains("no data"));
    }

    #[test]
    fn numbers_are_short() {
        assert_eq!(
            ["0", "0.05", "12.5", "200", "135k", "1.35M"].map(String::from),
            [0.0, 0.05, 12.5, 200.0, 135e3, 1.35e6].map(number)
        );
    }
}
