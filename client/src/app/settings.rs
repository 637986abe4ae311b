//! User settings (F3), kept in a file between visits.

use super::user_file;
use crate::engine::Appearance;
use ldi_protocol::index::Index;
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// Range of the frame time, milliseconds.
pub const FRAME_MS: std::ops::RangeInclusive<f64> = 5.0..=200.0;
/// Range of the mouse speed, relative to the default.
pub const LOOK: std::ops::RangeInclusive<f64> = 0.2..=5.0;
/// Range of the field of view, degrees. The dataset's own bounds it as well.
pub const FOV_DEG: std::ops::RangeInclusive<f64> = 30.0..=120.0;
/// Range of the eye above or below the dataset's eye height, metres: within the walk volume.
pub const RAISE_M: std::ops::RangeInclusive<f64> = -0.45..=0.35;
/// Range of the walking speed, m/s.
pub const SPEED_M_PER_S: std::ops::RangeInclusive<f64> = 0.2..=20.0;
/// Share of textured triangles below which a scene has few textures. A judgement.
const FEW_TEXTURES: f64 = 0.3;

/// Whether pictures are shaded by their depths.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Shading {
    /// Where the scene has few textures.
    #[default]
    Auto,
    /// Always.
    On,
    /// Never.
    Off,
}

/// Whether a scene has few textures. The part of an index that comes first does not tell.
pub fn has_few_textures(index: &Index) -> bool {
    index.is_whole() && textured_share(index) < FEW_TEXTURES
}

/// Share of the triangles that have textures, by the materials of each cell.
fn textured_share(index: &Index) -> f64 {
    let textured = |m: &&u32| index.materials.get(**m as usize).is_some_and(|m| m.texture.is_some());
    let (mut all, mut with) = (0.0, 0.0);
    for cell in index.cells.iter().filter(|c| !c.materials.is_empty()) {
        let triangles = f64::from(cell.triangles);
        all += triangles;
        with += triangles * cell.materials.iter().filter(textured).count() as f64 / cell.materials.len() as f64;
    }
    if all > 0.0 { with / all } else { 0.0 }
}

/// The settings.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[serde(default)]
pub struct UserSettings {
    /// Intended frame time while moving, milliseconds.
    pub frame_ms: f64,
    /// Whether resting pictures get four samples per pixel.
    pub fine: bool,
    /// Shading by depths.
    pub shading: Shading,
    /// Whether the sky has a horizon.
    pub horizon: bool,
    /// Largest horizontal field of view, degrees.
    pub fov_deg: f64,
    /// Height of the eye above the dataset's eye height, metres.
    pub raise_m: f64,
    /// Walking speed, m/s.
    pub speed_m_per_s: f64,
    /// Mouse speed, relative to the default.
    pub look: f64,
    /// Whether the vertical axis of the mouse is inverted.
    pub inverted: bool,
    /// Whether the window fills the screen.
    pub full_screen: bool,
    /// Whether F2 goes through the views for developers.
    pub developer: bool,
}

impl Default for UserSettings {
    fn default() -> Self {
        Self {
            frame_ms: 16.7,
            fine: true,
            shading: Shading::Auto,
            horizon: true,
            fov_deg: *FOV_DEG.end(),
            raise_m: 0.0,
            speed_m_per_s: super::walker::WALK_M_PER_S,
            look: 1.0,
            inverted: false,
            full_screen: false,
            developer: false,
        }
    }
}

impl UserSettings {
    /// Turn in degrees for a mouse movement in counts: left and up are positive.
    pub fn turn_deg(&self, (dx, dy): (f64, f64), deg_per_count: f64) -> (f64, f64) {
        let k = self.look * deg_per_count;
        (-dx * k, if self.inverted { dy * k } else { -dy * k })
    }

    /// Changes of finished pictures of a scene that has few textures, or many.
    pub fn appearance(&self, few_textures: bool) -> Appearance {
        let depth_shading = match self.shading {
            Shading::Auto => few_textures,
            Shading::On => true,
            Shading::Off => false,
        };
        Appearance { depth_shading, horizon: self.horizon }
    }

    /// The settings with every number within its range; a number that is none takes its default.
    fn bounded(self) -> Self {
        let number = |value: f64, range: std::ops::RangeInclusive<f64>, default: f64| match value.is_finite() {
            true => value.clamp(*range.start(), *range.end()),
            false => default,
        };
        let d = Self::default();
        Self {
            frame_ms: number(self.frame_ms, FRAME_MS, d.frame_ms),
            fov_deg: number(self.fov_deg, FOV_DEG, d.fov_deg),
            raise_m: number(self.raise_m, RAISE_M, d.raise_m),
            speed_m_per_s: number(self.speed_m_per_s, SPEED_M_PER_S, d.speed_m_per_s),
            look: number(self.look, LOOK, d.look),
            ..self
        }
    }
}

/// The settings' file.
#[derive(Debug)]
pub struct SettingsFile {
    /// None: nothing is kept.
    file: Option<PathBuf>,
    /// The settings in the file.
    saved: UserSettings,
    /// A frame time of the command line. It is not kept, unless the user changes it.
    given_ms: Option<f64>,
}

impl SettingsFile {
    /// The default file, in the user's configuration folder. None without a home folder.
    pub fn default_path() -> Option<PathBuf> {
        user_file::in_configuration("settings.json")
    }

    /// Reads the settings. Without a file they have their defaults. The message tells why a file
    /// was not used: it is then left as it is.
    pub fn load(file: Option<PathBuf>) -> (Self, UserSettings, Option<String>) {
        let read = |file: &Path| -> Result<UserSettings, String> {
            let Some(text) = user_file::read(file)? else { return Ok(UserSettings::default()) };
            let settings: UserSettings =
                serde_json::from_str(&text).map_err(|e| format!("{}: {e}; mend or remove it", file.display()))?;
            Ok(settings.bounded())
        };
        match file.as_deref().map_or(Ok(UserSettings::default()), read) {
            Ok(settings) => (Self { file, saved: settings.clone(), given_ms: None }, settings, None),
            Err(e) => {
                let settings = UserSettings::default();
                (Self { file: None, saved: settings.clone(), given_ms: None }, settings, Some(e))
            }
        }
    }

    /// Applies a frame time of the command line to the settings.
    pub fn give_frame_ms(&mut self, ms: Option<f64>, settings: &mut UserSettings) {
        self.given_ms = ms;
        settings.frame_ms = ms.unwrap_or(settings.frame_ms);
    }

    /// Writes the settings if they have changed.
    ///
    /// # Errors
    /// If the file cannot be written.
    pub fn save(&mut self, settings: &UserSettings) -> Result<(), String> {
        let frame_ms = if self.given_ms == Some(settings.frame_ms) { self.saved.frame_ms } else { settings.frame_ms };
        let settings = UserSettings { frame_ms, ..settings.clone() };
        let Some(file) = self.file.as_deref().filter(|_| settings != self.saved) else { return Ok(()) };
        let text = serde_json::to_string_pretty(&settings).map_err(|e| e.to_string())?;
        self.saved = settings;
        user_file::replace(file, &(text + "\n")).map_err(|e| format!("the settings are not kept: {e}"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::test_support::{dataset, plain_material, quad_cluster};
    use glam::Vec3;
    use ldi_protocol::OutputCamera;

    #[test]
    fn the_mouse_turns_as_chosen() {
        let mut s = UserSettings::default();
        assert_eq!(s.turn_deg((10.0, 5.0), 0.1), (-1.0, -0.5));
        (s.look, s.inverted) = (2.0, true);
        assert_eq!(s.turn_deg((10.0, 5.0), 0.1), (-2.0, 1.0));
    }

    #[test]
    fn settings_come_back() {
        let folder = std::env::temp_dir().join(format!("ldi-settings-{}", std::process::id()));
        let path = folder.join("settings.json");
        let (mut file, mut settings, said) = SettingsFile::load(Some(path.clone()));
        assert_eq!((&settings, said), (&UserSettings::default(), None));
        file.save(&settings).expect("nothing to write");
        assert!(!path.exists(), "settings that nobody changed are not written");
        (settings.fov_deg, settings.shading, settings.developer) = (50.0, Shading::Off, true);
        file.save(&settings).expect("written");
        assert_eq!(SettingsFile::load(Some(path.clone())).1, settings);
        // A frame time of the command line is not kept.
        file.give_frame_ms(Some(33.0), &mut settings);
        settings.fine = false;
        file.save(&settings).expect("written");
        let kept = SettingsFile::load(Some(path.clone())).1;
        assert_eq!((settings.frame_ms, kept.frame_ms, kept.fine), (33.0, 16.7, false));
        // Of a newer client, with numbers that nothing can be drawn with.
        std::fs::write(&path, r#"{ "frame_ms": 0, "look": 1e9, "later": [1], "inverted": true }"#).expect("written");
        let (_, settings, said) = SettingsFile::load(Some(path.clone()));
        let want = UserSettings { frame_ms: 5.0, look: 5.0, inverted: true, ..UserSettings::default() };
        assert_eq!((settings, said), (want, None));
        // A file that is none is neither used nor overwritten.
        std::fs::write(&path, "no settings").expect("written");
        let (mut file, mut settings, said) = SettingsFile::load(Some(path.clone()));
        assert!(said.is_some_and(|e| e.contains("settings.json") && e.contains("remove")));
        settings.fine = false;
        file.save(&settings).expect("nothing to do");
        assert_eq!(std::fs::read_to_string(&path).expect("readable"), "no settings");
        std::fs::remove_dir_all(&folder).expect("removed");
    }

    #[test]
    fn scenes_with_few_textures_are_shaded() {
        let quad = |material| quad_cluster(material, [Vec3::ZERO, Vec3::X, Vec3::X + Vec3::Y, Vec3::Y]);
        let textured = ldi_protocol::mesh::Material { texture: Some(0), ..plain_material() };
        let camera = OutputCamera { width: 64, height: 36, fov_deg: 60.0 };
        let share = |materials, clusters| textured_share(&dataset(camera, materials, clusters).0);
        assert_eq!(share(vec![plain_material()], vec![quad(0)]), 0.0);
        assert_eq!(share(vec![textured], vec![quad(0)]), 1.0);
        let shaded = |shading, few| UserSettings { shading, ..UserSettings::default() }.appearance(few).depth_shading;
        assert!(shaded(Shading::Auto, true) && !shaded(Shading::Auto, false));
        assert!(shaded(Shading::On, false) && !shaded(Shading::Off, true));
    }
}
