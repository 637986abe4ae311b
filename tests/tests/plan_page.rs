//! The plan page in a real browser, as wide as a desk and as a phone. Skipped where there is none.

use ldi_tests::{
    fixture::Fixture,
    run::{self, Server},
};
use std::path::{Path, PathBuf};
use std::process::Command;

/// A browser that draws without a display, on a folder of its own; None where there is none.
fn browser(dir: &Path, size: (u32, u32)) -> Option<Command> {
    let mut c = Command::new("chromium");
    Command::new("chromium").arg("--version").output().ok().filter(|o| o.status.success())?;
    c.args(["--headless", "--no-sandbox", "--disable-gpu", "--no-first-run", "--disable-background-networking"]);
    c.args(["--disable-component-update", "--disable-sync", "--hide-scrollbars", "--virtual-time-budget=4000"]);
    c.arg(format!("--user-data-dir={}", dir.join("profile").display()));
    c.arg(format!("--window-size={},{}", size.0, size.1));
    Some(c)
}

fn folder(name: &str) -> PathBuf {
    ldi_tests::fixture::empty_folder(Path::new(env!("CARGO_TARGET_TMPDIR")), name)
}

#[test]
fn the_page_shows_walls_and_how_to_connect() {
    let dir = folder("plan-page");
    let Some(mut dump) = browser(&dir, (1200, 800)) else {
        println!("SKIPPED: there is no chromium here");
        return;
    };
    let served = Server::start(&Fixture::get(Path::new(env!("CARGO_TARGET_TMPDIR"))).dataset).expect("serves");
    let page = format!("http://{}/", served.http);
    dump.args(["--dump-dom", &page]);
    let dom = String::from_utf8(run::run(dump).expect("loads").stdout).expect("UTF-8");
    let command = format!("ldi-client connect {}</pre>", served.quic);
    for part in [&*command, "<h1 id=\"name\">house.glb</h1>", "data:image/png;base64,", "storey", "triangles in"] {
        assert!(dom.contains(part), "{part} is not on the page:\n{dom:.3000}");
    }
    // The technical layers are not drawn until one asks for them.
    assert!(dom.contains("<g id=\"cells\" style=\"display: none;\"></g>"));
    for size in [(1200, 800), (500, 900)] {
        let picture = dir.join(format!("{}.png", size.0));
        let mut shot = browser(&dir, size).expect("there is one");
        shot.arg(format!("--screenshot={}", picture.display())).arg(&page);
        run::run(shot).expect("draws");
        let picture = image::open(&picture).expect("a picture").to_rgb8();
        let like = |wanted: [u8; 3]| {
            let near = |p: &image::Rgb<u8>| p.0.iter().zip(wanted).all(|(a, b)| a.abs_diff(b) <= 12);
            picture.pixels().filter(|p| near(p)).count() as f64 / f64::from(size.0 * size.1)
        };
        let (floors, walls) = (like([250, 248, 242]), like([33, 40, 48]) + like([84, 94, 105]));
        assert!(floors > 0.05 && walls > 0.002, "{size:?}: {floors} of floor, {walls} of walls");
    }
    std::fs::remove_dir_all(dir).expect("removed");
}
