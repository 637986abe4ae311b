//! A small house, poses in it, and a dataset of it: made once for all tests of a build.

use crate::run;
use std::{
    path::{Path, PathBuf},
    sync::OnceLock,
    time::{Duration, Instant},
};

/// Geometry budget of the dataset: about a third of the house.
pub const BUDGET: &str = "8500";
/// Its images are the grid's: by default the house would be walked by its rooms, which fit the
/// budget nearly everywhere.
pub const REPRESENT: [&str; 2] = ["--represent", "grid"];
/// Picture that it is made for.
pub const SIZE: &str = "320x180";

/// The files.
pub struct Fixture {
    /// The house, as glTF.
    pub scene: PathBuf,
    /// Five poses: middle of a room, a doorway, looks up and down.
    pub poses: PathBuf,
    /// The dataset.
    pub dataset: PathBuf,
}

/// An empty folder of this process below `tmp`.
///
/// # Panics
/// If it cannot be made.
pub fn empty_folder(tmp: &Path, name: &str) -> PathBuf {
    let dir = tmp.join(format!("{name}-{}", std::process::id()));
    let _ = std::fs::remove_dir_all(&dir);
    std::fs::create_dir_all(&dir).expect("the target folder is writable");
    dir
}

/// A folder below `tmp` that `make` filled, once for this very build of the server: each test may
/// run in a process of its own, and all but the first wait.
///
/// # Panics
/// If it cannot be made, or is not done after ten minutes.
pub fn made_once(tmp: &Path, name: &str, make: impl FnOnce(&Path)) -> PathBuf {
    let exe = run::bin_dir().expect("known").join("ldi-server");
    let made = std::fs::metadata(exe).and_then(|m| m.modified()).expect("built");
    let age = made.duration_since(std::time::UNIX_EPOCH).expect("after 1970").as_millis();
    let dir = tmp.join(format!("{name}-{age}"));
    let ready = dir.join("ready");
    std::fs::create_dir_all(tmp).expect("writable");
    if std::fs::create_dir(&dir).is_ok() {
        make(&dir);
        std::fs::write(&ready, b"").expect("writable");
    }
    let until = Instant::now() + Duration::from_secs(600);
    while !ready.exists() {
        assert!(Instant::now() < until, "{} was never finished: remove it and run again", dir.display());
        std::thread::sleep(Duration::from_millis(100));
    }
    dir
}

/// A file of the shared scenes, which lie beside the project or where `LDI_SHARED` says; None
/// where they are not.
pub fn shared_scene(file: &str) -> Option<PathBuf> {
    let beside = || Path::new(env!("CARGO_MANIFEST_DIR")).join("../../shared");
    let shared = std::env::var_os("LDI_SHARED").map_or_else(beside, PathBuf::from);
    Some(shared.join("scenes").join(file)).filter(|f| f.is_file())
}

impl Fixture {
    /// The fixture below `tmp`, the folder that cargo gives to tests.
    ///
    /// # Panics
    /// If it cannot be made.
    pub fn get(tmp: &Path) -> &'static Self {
        static FIXTURE: OnceLock<Fixture> = OnceLock::new();
        FIXTURE.get_or_init(|| Self::find_or_make(tmp))
    }

    fn find_or_make(tmp: &Path) -> Self {
        let dir = made_once(tmp, &format!("fixture-{BUDGET}"), |dir| Self::in_folder(dir).make());
        Self::in_folder(&dir)
    }

    fn in_folder(dir: &Path) -> Self {
        Self { scene: dir.join("house.glb"), poses: dir.join("poses.json"), dataset: dir.join("dataset") }
    }

    fn make(&self) {
        let mut c = run::command("ldi-server").expect("built");
        c.args(["scene", "house", "--triangles", "25000", "--seed", "1", "-o"]).arg(&self.scene);
        run::run(c).expect("writes a scene");
        let mut c = run::command("ldi-server").expect("built");
        c.arg("build").arg(&self.scene).arg("-o").arg(&self.dataset);
        c.args(["--budget", BUDGET, "--size", SIZE]).args(REPRESENT);
        run::run(c).expect("builds");
        // Middle of a room, a doorway, and a look up and down.
        let pose = |p: [f64; 3], yaw: f64, pitch: f64| serde_json::json!({ "t": 0.0, "position": p, "yaw": yaw, "pitch": pitch });
        let file = serde_json::json!({ "poses": [
            pose([-10.0, 1.6, -6.75], -90.0, 0.0), pose([-7.5, 1.6, -6.75], -90.0, 0.0), pose([-5.0, 1.6, -6.75], -120.0, 30.0),
            pose([0.0, 1.5, 2.2], 180.0, -30.0), pose([0.3, 1.7, -2.2], 45.0, 10.0)
        ] });
        std::fs::write(&self.poses, file.to_string()).expect("writable");
    }
}
