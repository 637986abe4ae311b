//! Bookmarked poses: Ctrl and a digit stores one, the digit alone moves the eye there. Digit 0 is
//! the place where the last visit ended.
//!
//! One path file per scene holds the poses, with the digits as times, so that it can be rendered or
//! walked as well.

use super::user_file;
use ldi_protocol::{Pose, path};
use std::{collections::BTreeMap, path::PathBuf};

/// The digit of the place where the last visit ended.
pub const LAST_PLACE: u8 = 0;

/// The bookmarks of one scene.
#[derive(Debug)]
pub struct Bookmarks {
    file: PathBuf,
    /// Poses by digit, 0 to 9.
    places: BTreeMap<u8, Pose>,
}

impl Bookmarks {
    /// The default file: named after the scene, in the user's configuration folder. None without a
    /// home folder.
    pub fn default_file(scene: &str) -> Option<PathBuf> {
        let letter = |c: char| if c.is_alphanumeric() || c == '-' { c } else { '_' };
        let name: String = scene.chars().map(letter).take(80).collect();
        user_file::in_configuration(format!("bookmarks/{name}.path.json"))
    }

    /// Reads the bookmarks. An absent file holds none.
    ///
    /// # Errors
    /// If the file is no path file.
    pub fn load(file: PathBuf) -> Result<Self, String> {
        let Some(text) = user_file::read(&file)? else { return Ok(Self { file, places: BTreeMap::new() }) };
        let described = |e: &dyn std::fmt::Display| format!("{}: {e}; mend or remove it", file.display());
        let walk = path::parse(&text).map_err(|e| described(&e))?;
        let place = |p: &path::TimedPose| (0.0..=9.0).contains(&p.t_s).then_some((p.t_s as u8, p.pose));
        let places = walk.poses.iter().filter_map(place).collect();
        Ok(Self { file, places })
    }

    /// The pose of a digit.
    pub fn get(&self, digit: u8) -> Option<Pose> {
        self.places.get(&digit).copied()
    }

    /// Stores a pose and writes the file.
    ///
    /// # Errors
    /// If the file cannot be written. The pose is kept until the window is closed.
    pub fn set(&mut self, digit: u8, pose: Pose) -> Result<(), String> {
        self.places.insert(digit, pose);
        let poses = self.places.iter().map(|(digit, pose)| path::TimedPose { t_s: f64::from(*digit), pose: *pose });
        let walk = path::Walk { fps: 1.0, speed: 1.4, eye_height: None, poses: poses.collect() };
        user_file::replace(&self.file, &(walk.to_json() + "\n")).map_err(|e| format!("the bookmark is not kept: {e}"))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;

    #[test]
    fn places_come_back_and_can_be_walked() {
        let folder = std::env::temp_dir().join(format!("ldi-bookmarks-{}", std::process::id()));
        let file = folder.join("deeper").join("house.path.json");
        let pose = |x: f64| Pose { position: DVec3::new(x, 1.6, -x), yaw_deg: 10.0 * x, pitch_deg: -x };
        let mut bookmarks = Bookmarks::load(file.clone()).expect("none yet");
        assert_eq!(bookmarks.get(3), None);
        for (digit, x) in [(7, 1.0), (3, 2.0), (7, 3.0)] {
            bookmarks.set(digit, pose(x)).expect("kept");
        }
        let again = Bookmarks::load(file.clone()).expect("read");
        assert_eq!((again.get(3), again.get(7), again.get(1)), (Some(pose(2.0)), Some(pose(3.0)), None));
        let text = std::fs::read_to_string(&file).expect("text");
        assert_eq!(path::parse(&text).expect("a path file").poses.len(), 2);
        std::fs::write(&file, "no path").expect("written");
        let e = Bookmarks::load(file.clone()).expect_err("not JSON");
        assert!(e.contains("house.path.json"), "{e}");
        std::fs::remove_dir_all(&folder).expect("removed");
    }

    #[test]
    fn names_of_scenes_become_names_of_files() {
        let Some(file) = Bookmarks::default_file("builtin:house?triangles=5&seed=1/../x") else { return };
        let name = file.file_name().expect("a name").to_string_lossy().into_owned();
        assert_eq!(name, "builtin_house_triangles_5_seed_1____x.path.json");
    }
}
