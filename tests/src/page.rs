//! The page a demo run leaves: what was drawn as geometry, what came from images, the truth beside
//! it, and the plots.
//!
//! In: the reports of `build` and `walk`, and frames on disk. Out: one `index.html` that refers to
//! the pictures beside it and needs no network.

use crate::plot::{Plot, Series, escape, number};
use serde_json::Value;
use std::fmt::Write as _;

/// Bytes of a triangle in a file without instances: half a vertex of position, normal and texture
/// coordinates, 32 bytes, and three indices of 4 bytes.
const BYTES_PER_TRIANGLE: u32 = 28;

/// What the page shows.
pub struct Page<'a> {
    /// Heading: the scene's name.
    pub scene: &'a str,
    /// Report of `ldi-server build`.
    pub build: &'a Value,
    /// Report of `ldi-client walk`.
    pub walk: &'a Value,
    /// The same with `--method levels`; null: not walked so.
    pub levels: &'a Value,
    /// Bytes of the scene's file.
    pub scene_bytes: u64,
    /// The commands that were run, as typed, and their seconds.
    pub commands: &'a [(String, f64)],
}

impl Page<'_> {
    /// The page's HTML.
    pub fn html(&self) -> String {
        let summary = &self.walk["summary"];
        let frames = self.walk["frames"].as_array().map(Vec::as_slice).unwrap_or_default();
        let f = |path: &str| at(summary, path).as_f64().unwrap_or(f64::NAN);
        let mut h = String::from(
            "<!doctype html><html lang=\"en\"><meta charset=\"utf-8\"><meta name=\"viewport\" content=\"width=device-width\">",
        );
        let _ = write!(
            h,
            "<title>A walk through {0}</title><style>{1}</style><main><h1>A walk through {0}</h1>",
            escape(self.scene),
            STYLE
        );
        self.comparison(&mut h, frames);
        self.figures(&mut h, &f);
        viewer(&mut h, frames);
        self.plots(&mut h, frames, f("budget_triangles"));
        self.build_table(&mut h);
        h.push_str("<h2>How to run it again</h2><pre>");
        for (command, seconds) in self.commands {
            let _ = writeln!(h, "{}   <i># {seconds:.1} s</i>", escape(command));
        }
        let _ = write!(h, "</pre></main><script>{SCRIPT}</script></html>");
        h
    }

    /// One picture to drag between geometry, images and truth.
    fn comparison(&self, h: &mut String, frames: &[Value]) {
        let Some(frame) = frames.get(most_of_both(frames)) else { return };
        let file = file_of(frame);
        let _ = write!(
            h,
            "<p class=\"lead\">Drag the two borders: left what is drawn as geometry, in the middle what is warped from \
             layered depth images that came over the network, right the truth by 16 rays per pixel.</p>\
             <div class=\"compare\" id=\"compare\"><img src=\"truth/{file}.png\" alt=\"truth\">\
             <img class=\"far\" src=\"frames/{file}.far.png\" alt=\"what is warped from images\">\
             <img class=\"near\" src=\"frames/{file}.near.png\" alt=\"what is drawn as geometry\">\
             <span>geometry</span><span>images</span><span>truth</span></div>\
             <p class=\"borders\"><label>geometry up to <input id=\"a\" type=\"range\" min=\"0\" max=\"100\" value=\"33\"></label>\
             <label>images up to <input id=\"b\" type=\"range\" min=\"0\" max=\"100\" value=\"67\"></label></p>"
        );
    }

    /// Four figures, and then the error.
    fn figures(&self, h: &mut String, f: &dyn Fn(&str) -> f64) {
        h.push_str("<section class=\"tiles\">");
        let instances = self.build["scene"]["instances"].as_f64().unwrap_or(f64::NAN);
        tile(h, number(f("scene_triangles")), "triangles in the scene", format!("in {} instances", number(instances)));
        tile(
            h,
            number(f("max_triangles")),
            "triangles in the worst frame",
            format!("budget {}, exceeded in {} frames", number(f("budget_triangles")), number(f("budget_violations"))),
        );
        let levels = |path: &str| at(&self.levels["summary"], path).as_f64();
        let alone = levels("frame_ms.p50").map_or(String::new(), |ms| {
            let most = levels("max_triangles").map_or("-".into(), number);
            format!("; levels of detail alone: {ms:.0} ms with up to {most} triangles")
        });
        tile(
            h,
            format!("{:.0} ms", f("frame_ms.p50")),
            "per frame, without a graphics card",
            format!(
                "drawing everything in view: {:.0} ms, {:.1} times as long{alone}",
                f("all_geometry_frame_ms.p50"),
                f("speedup")
            ),
        );
        tile(
            h,
            format!("{:.1} MB", f("bytes_total") / 1e6),
            "received for the walk",
            format!(
                "the scene's file has {:.1} MB, and {} MB with its instances written out ({BYTES_PER_TRIANGLE} bytes per triangle)",
                self.scene_bytes as f64 / 1e6,
                number(f("scene_triangles") * f64::from(BYTES_PER_TRIANGLE) / 1e6)
            ),
        );
        h.push_str("</section><section class=\"tiles\">");
        let summary = &self.walk["summary"];
        tile(
            h,
            format!("{:.4}", f("mean_flip")),
            "mean FLIP against truth",
            match summary["flip_over_baseline"].as_object() {
                Some(ratio) => {
                    let r = |key: &str| ratio.get(key).and_then(Value::as_f64).unwrap_or(f64::NAN);
                    format!(
                        "{:.2} times that of drawing everything at one sample per pixel, over the {} frames with images; worst frame {:.2}, far pixels {:.2}",
                        r("mean"),
                        number(r("frames")),
                        r("worst"),
                        r("far_by_pixel")
                    )
                }
                None => "no frame used images".into(),
            },
        );
        tile(
            h,
            format!("{:.0}%", 100.0 * f("far_fraction_mean")),
            "of the pixels from images",
            format!("{} samples warped per frame", number(f("samples_warped_mean"))),
        );
        tile(
            h,
            format!("{:.3}%", 100.0 * f("hole_fraction_max")),
            "holes, worst frame",
            format!(
                "mean {:.4}%, before filling {:.4}%",
                100.0 * f("hole_fraction_mean"),
                100.0 * f("hole_before_fill_mean")
            ),
        );
        h.push_str("</section>");
    }

    fn plots(&self, h: &mut String, frames: &[Value], budget: f64) {
        let series = |name, of: &dyn Fn(&Value) -> Option<f64>| Series {
            name,
            points: frames
                .iter()
                .map(|f| (f["index"].as_f64().unwrap_or(f64::NAN), of(f).unwrap_or(f64::NAN)))
                .collect(),
        };
        // The report counts bytes from the start of the walk.
        let bytes: Vec<(f64, f64)> = frames
            .iter()
            .map(|f| (f["t_s"].as_f64().unwrap_or(f64::NAN), f["bytes_received"].as_f64().unwrap_or(f64::NAN) / 1e6))
            .collect();
        h.push_str("<h2>Along the path</h2><div class=\"plots\">");
        for plot in [
            Plot {
                title: "Triangles per frame",
                x: "pose",
                y: "triangles",
                series: vec![series("drawn as geometry", &|f| f["triangles"].as_f64())],
                bound: Some(("budget P", budget)),
            },
            Plot {
                title: "Milliseconds per frame",
                x: "pose",
                y: "ms",
                series: vec![
                    series("frame", &|f| f["ms"]["total"].as_f64()),
                    series("near", &|f| f["ms"]["near"].as_f64()),
                    series("warp", &|f| f["ms"]["warp"].as_f64()),
                ],
                bound: None,
            },
            Plot {
                title: "Received over the walk",
                x: "seconds along the path",
                y: "MB",
                series: vec![Series { name: "received", points: bytes }],
                bound: None,
            },
            Plot {
                title: "Error against truth",
                x: "pose",
                y: "FLIP",
                series: vec![
                    series("ours", &|f| f["flip"].as_f64()),
                    series("all geometry, 1 ray", &|f| f["flip_baseline"].as_f64()),
                ],
                bound: None,
            },
        ] {
            let _ = write!(h, "<figure>{}</figure>", plot.svg());
        }
        h.push_str("</div>");
    }

    fn build_table(&self, h: &mut String) {
        let b = self.build;
        h.push_str("<h2>The dataset</h2><table>");
        let mut row = |name: &str, value: String| {
            let _ = write!(h, "<tr><th>{}</th><td>{}</td></tr>", escape(name), escape(&value));
        };
        let n = |v: &Value| v.as_f64().map_or("-".into(), number);
        row("grid points", n(&b["grid"]["points"]));
        row("layered depth images", n(&b["ldis"]));
        row("samples", format!("{} ({} pruned)", n(&b["samples"]["total"]), n(&b["samples"]["pruned"])));
        row("bytes per sample", b["bytes_per_sample"].as_f64().map_or("-".into(), |v| format!("{v:.2}")));
        for (name, key) in [
            ("bytes in all", "total"),
            ("images", "ldi"),
            ("geometry", "geometry"),
            ("textures", "textures"),
            ("manifest", "manifest"),
        ] {
            row(name, format!("{} MB", b["bytes"][key].as_f64().map_or("-".into(), |v| number(v / 1e6))));
        }
        row("images per second while building", b["ldis_per_s"].as_f64().map_or("-".into(), |v| format!("{v:.2}")));
        row("rays per second", n(&b["rays_per_s"]));
        row(
            "largest footprint promised",
            b["guarantee"]["max_footprint_px"].as_f64().map_or("-".into(), |v| format!("{v:.2} px")),
        );
        let skipped = b["skipped"].as_array().map(Vec::as_slice).unwrap_or_default();
        for s in skipped {
            row(&format!("skipped: {}", s["what"].as_str().unwrap_or("")), s["why"].as_str().unwrap_or("").into());
        }
        h.push_str("</table>");
    }
}

fn viewer(h: &mut String, frames: &[Value]) {
    let rows: Vec<Value> = frames
        .iter()
        .map(|f| {
            let file = file_of(f);
            let note = format!(
                "pose {}: {} triangles, {} samples warped, FLIP {} (all geometry at one sample per pixel: {}), footprint at most {} px",
                f["index"],
                number(f["triangles"].as_f64().unwrap_or(f64::NAN)),
                number(f["samples_warped"].as_f64().unwrap_or(0.0)),
                fixed(f["flip"].as_f64()),
                fixed(f["flip_baseline"].as_f64()),
                fixed(f["footprint_max_px"].as_f64()),
            );
            serde_json::json!({ "file": file, "note": note })
        })
        .collect();
    let json = Value::from(rows).to_string().replace('<', "\\u003c");
    let first = most_of_both(frames);
    let _ = write!(
        h,
        "<h2>Frames</h2><p><input id=\"at\" type=\"range\" min=\"0\" max=\"{}\" value=\"{first}\" aria-label=\"frame\"><output id=\"note\"></output></p><div class=\"views\">\
         <figure><img id=\"ours\" alt=\"our frame\"><figcaption>What the walker sees</figcaption></figure>\
         <figure><img id=\"truth\" alt=\"truth\"><figcaption>Truth: every triangle, 16 rays per pixel</figcaption></figure>\
         <figure><img id=\"near\" alt=\"geometry\"><figcaption>Drawn as geometry</figcaption></figure>\
         <figure><img id=\"far\" alt=\"images\"><figcaption>Warped from layered depth images</figcaption></figure></div>\
         <script>const frames={json};</script>",
        frames.len().saturating_sub(1)
    );
}

/// A figure with its name and a note.
fn tile(h: &mut String, value: String, name: &str, note: String) {
    let (value, name, note) = (escape(&value), escape(name), escape(&note));
    let _ = write!(h, "<div><b>{value}</b><span>{name}</span><small>{note}</small></div>");
}

/// The frame where geometry and images both show most: the first whose lesser part is the largest.
fn most_of_both(frames: &[Value]) -> usize {
    let lesser = |i: &usize| {
        let far = frames[*i]["far_fraction"].as_f64().unwrap_or(0.0);
        far.min(1.0 - far)
    };
    (0..frames.len()).rev().max_by(|a, b| lesser(a).total_cmp(&lesser(b))).unwrap_or(0)
}

fn file_of(frame: &Value) -> String {
    format!("frame_{:05}", frame["index"].as_u64().unwrap_or_default())
}

/// A value by a path with dots.
fn at(value: &Value, path: &str) -> Value {
    path.split('.').fold(value.clone(), |v, key| v[key].clone())
}

fn fixed(v: Option<f64>) -> String {
    v.map_or("-".into(), |v| format!("{v:.3}"))
}

/// The style sheet of all pages; plots take their colours from it.
pub const STYLE: &str = "\
:root{color-scheme:light dark;--fg:#1c2330;--bg:#fbfbfa;--dim:#667085;--line:#d9dde3;--card:#fff;--s0:#2563c9;--s1:#c2570c;--s2:#13795b;--s3:#8e3fb0;--bound:#c0243a}\
@media(prefers-color-scheme:dark){:root{--fg:#e6e9ef;--bg:#14171c;--dim:#98a2b3;--line:#2d333d;--card:#1b1f26;--s0:#6ea3ff;--s1:#f59e55;--s2:#4fc79a;--s3:#cf8cf0;--bound:#ff6b7d}}\
body{margin:0;background:var(--bg);color:var(--fg);font:16px/1.5 system-ui,sans-serif}main{max-width:1180px;margin:auto;padding:24px 20px 60px}\
h1{margin:0 0 4px;font-size:28px}h2{margin:36px 0 10px;font-size:19px}.lead{color:var(--dim);max-width:70ch;margin:0 0 20px}\
.tiles{display:grid;grid-template-columns:repeat(auto-fit,minmax(180px,1fr));gap:12px}.tiles div{background:var(--card);border:1px solid var(--line);border-radius:8px;padding:12px 14px;display:flex;flex-direction:column}\
.tiles b{font-size:22px}.tiles small{color:var(--dim)}.views,.plots{display:grid;grid-template-columns:repeat(auto-fit,minmax(min(100%,480px),1fr));gap:14px}\
figure{margin:0;background:var(--card);border:1px solid var(--line);border-radius:8px;overflow:hidden}figcaption{padding:6px 12px;color:var(--dim);font-size:14px}img{display:block;width:100%;background:#8884}\
.compare{position:relative;border-radius:8px;overflow:hidden;cursor:ew-resize;touch-action:pan-y;user-select:none}.compare img{pointer-events:none}.compare .far,.compare .near{position:absolute;inset:0;height:100%;background:#000}\
.compare .near{clip-path:inset(0 calc(100% - var(--a)) 0 0);background:var(--bg)}.compare .far{clip-path:inset(0 calc(100% - var(--b)) 0 0)}.compare{--a:33%;--b:67%}\
.compare span{position:absolute;top:8px;padding:2px 10px;border-radius:999px;background:#000a;color:#fff;font-size:14px;transform:translateX(-50%)}\
.compare span:nth-of-type(1){left:calc(var(--a)/2)}.compare span:nth-of-type(2){left:calc((var(--a) + var(--b))/2)}.compare span:nth-of-type(3){left:calc((var(--b) + 100%)/2)}\
.compare::before,.compare::after{content:'';position:absolute;z-index:1;top:0;bottom:0;width:3px;margin-left:-1px;background:#fff;box-shadow:0 0 4px #000}.compare::before{left:var(--a)}.compare::after{left:var(--b)}\
.borders{display:flex;flex-wrap:wrap;gap:4px 24px;color:var(--dim);font-size:14px}.tiles+.tiles{margin-top:12px}\
input[type=range]{width:min(100%,480px);vertical-align:middle;margin-right:12px}output{color:var(--dim);font-size:14px}\
svg.plot{display:block;padding:10px;width:calc(100% - 20px)}svg text{fill:var(--dim);font:12px system-ui,sans-serif}svg .title{fill:var(--fg);font-weight:600;font-size:13px}\
svg .grid{stroke:var(--line)}svg path,svg line.s0,svg line.s1,svg line.s2,svg line.s3{fill:none;stroke-width:1.8}.s0{stroke:var(--s0);color:var(--s0)}.s1{stroke:var(--s1);color:var(--s1)}.s2{stroke:var(--s2);color:var(--s2)}.s3{stroke:var(--s3);color:var(--s3)}\
svg .bound{stroke:var(--bound);stroke-dasharray:5 4}svg .boundname{fill:var(--bound)}\
table{border-collapse:collapse}th,td{text-align:left;padding:4px 18px 4px 0;border-bottom:1px solid var(--line);font-weight:400;vertical-align:top}th{color:var(--dim)}\
pre{overflow-x:auto;background:var(--card);border:1px solid var(--line);border-radius:8px;padding:12px}pre i{color:var(--dim)}";

const SCRIPT: &str = "\
const at=document.getElementById('at');function show(){const f=frames[+at.value];if(!f)return;\
for(const[id,src]of[['ours','frames/'+f.file+'.png'],['truth','truth/'+f.file+'.png'],['near','frames/'+f.file+'.near.png'],['far','frames/'+f.file+'.far.png']])document.getElementById(id).src=src;\
document.getElementById('note').textContent=f.note}at.addEventListener('input',show);show();\
const box=document.getElementById('compare'),[a,b]=['a','b'].map(id=>document.getElementById(id));if(box){let held=null;\
const place=()=>{box.style.setProperty('--a',a.value+'%');box.style.setProperty('--b',b.value+'%')};\
const drag=e=>{if(!held)return;const r=box.getBoundingClientRect();held.value=100*(e.clientX-r.left)/r.width;keep(held)};\
const keep=moved=>{if(+a.value>+b.value)(moved===a?b:a).value=moved.value;place()};\
box.addEventListener('pointerdown',e=>{const r=box.getBoundingClientRect(),x=100*(e.clientX-r.left)/r.width;held=Math.abs(x-a.value)<=Math.abs(x-b.value)&&!(x>+b.value)?a:b;box.setPointerCapture(e.pointerId);drag(e)});\
box.addEventListener('pointermove',drag);box.addEventListener('pointerup',()=>held=null);box.addEventListener('pointercancel',()=>held=null);\
for(const i of[a,b])i.addEventListener('input',()=>keep(i));place()}";

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    #[test]
    fn received_bytes_are_those_of_the_last_frame_not_their_sum() {
        let frame = |t: f64, bytes: u64| json!({ "index": t, "t_s": t, "bytes_received": bytes });
        let walk =
            json!({ "summary": {}, "frames": [frame(0.0, 9_000_000), frame(1.0, 9_500_000), frame(2.0, 9_900_000)] });
        let html =
            Page { scene: "s", build: &json!({}), walk: &walk, levels: &Value::Null, scene_bytes: 0, commands: &[] }
                .html();
        let plot = html
            .split("aria-label=\"Received over the walk\"")
            .nth(1)
            .and_then(|p| p.split("</svg>").next())
            .expect("there");
        assert!(plot.contains(">10<") && !plot.contains(">20<"), "{plot}");
    }

    #[test]
    fn the_page_shows_every_frame_and_survives_missing_figures() {
        let walk = json!({
            "summary": {
                "frames": 2, "mean_flip": 0.05, "budget_triangles": 1000,
                "flip_over_baseline": { "frames": 1, "mean": 1.25, "worst": 1.5, "far": 3.0, "far_by_pixel": 2.0 }
            },
            "frames": [ { "index": 0, "triangles": 10, "flip": 0.05 }, { "index": 7, "triangles": 20, "flip": null, "far_fraction": 0.1 } ]
        });
        let page = Page {
            scene: "a<b",
            build: &json!({ "scene": { "instances": 3 } }),
            walk: &walk,
            levels: &json!({ "summary": { "frame_ms": { "p50": 77.0 }, "max_triangles": 9 } }),
            scene_bytes: 2_000_000,
            commands: &[("ldi-server x".into(), 1.0)],
        };
        let html = page.html();
        assert!(html.contains("frame_00000") && html.contains("frame_00007"));
        assert!(html.contains("a&lt;b") && !html.contains("a<b"));
        assert!(html.contains("1.25 times") && html.contains("levels of detail alone: 77 ms"));
        assert!(html.contains("in 3 instances") && html.contains("file has 2.0 MB"));
        assert!(html.contains("frames/frame_00007.near.png"), "where both geometry and images show");
        assert!(html.contains("value=\"1\" aria-label=\"frame\""), "it begins with the frame that shows an image");
    }
}
