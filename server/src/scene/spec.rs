//! `builtin:NAME[?triangles=N&seed=S]`: how a built-in scene is asked for;
//! `FILE[?up=z&unit=mm&missing=plain&rooms=spaces]`: a file with other axes or units than metres,
//! Y up, whose pictures are not all there, or whose spaces are rooms.

use super::error::SceneError;
use glam::{DAffine3, DMat3, DVec3};
use std::path::Path;

/// Prefix that tells a built-in scene from a file.
const PREFIX: &str = "builtin:";

/// A built-in scene and its parameters.
#[derive(Debug, Clone, PartialEq, Eq)]
pub struct BuiltinSpec {
    /// Which scene.
    pub name: String,
    /// Triangles wished for, instances counted; the scene's own choice without.
    pub triangles: Option<u64>,
    /// Seed of everything random; 0 without.
    pub seed: u64,
}

impl BuiltinSpec {
    /// Reads `text`; `None` if it does not start with `builtin:` and so names a file.
    ///
    /// # Errors
    /// An unknown or repeated parameter, or one that is no number.
    pub fn parse(text: &str) -> Option<Result<Self, SceneError>> {
        let rest = text.strip_prefix(PREFIX)?;
        let (name, query) = rest.split_once('?').unwrap_or((rest, ""));
        Some(Self::from_parts(name, query))
    }

    fn from_parts(name: &str, query: &str) -> Result<Self, SceneError> {
        let fault = |problem: String| SceneError::Builtin {
            name: name.to_owned(),
            problem,
            remedy: "write builtin:NAME?triangles=N&seed=S, N and S whole numbers".into(),
        };
        if name.is_empty() {
            return Err(fault("no name".into()));
        }
        let (mut triangles, mut seed) = (None, None);
        for pair in query.split('&').filter(|p| !p.is_empty()) {
            let (key, value) = pair.split_once('=').unwrap_or((pair, ""));
            let number = value.parse().map_err(|_| fault(format!("{key} is \"{value}\", no whole number")))?;
            let slot = match key {
                "triangles" => &mut triangles,
                "seed" => &mut seed,
                _ => return Err(fault(format!("unknown parameter \"{key}\""))),
            };
            if slot.replace(number).is_some() {
                return Err(fault(format!("{key} is given twice")));
            }
        }
        Ok(Self { name: name.to_owned(), triangles, seed: seed.unwrap_or(0) })
    }
}

/// A file, and how its coordinates become metres with Y up.
#[derive(Debug, Clone, PartialEq)]
pub struct FileSpec {
    /// Path.
    pub path: String,
    /// World from file; None where they are the same.
    pub world_from_file: Option<DAffine3>,
    /// Unit, where one is named.
    pub unit: Option<&'static str>,
    /// Z is up.
    pub is_z_up: bool,
    /// What cannot be read of pictures and material libraries is drawn in plain colours and noted,
    /// instead of refusing the scene.
    pub lenient: bool,
    /// Spaces of an IFC file become rooms.
    pub spaces_are_rooms: bool,
}

/// Metres of the units that a file may be in.
const UNITS: [(&str, f64); 5] = [("m", 1.0), ("cm", 0.01), ("mm", 0.001), ("in", 0.0254), ("ft", 0.3048)];

impl FileSpec {
    /// A file in metres with Y up.
    fn plain(path: String) -> Self {
        Self { path, world_from_file: None, unit: None, is_z_up: false, lenient: false, spaces_are_rooms: false }
    }

    /// Reads `text`; a file whose name holds a question mark is found as it is.
    ///
    /// # Errors
    /// An unknown or repeated parameter, or value.
    pub fn parse(text: &str) -> Result<Self, SceneError> {
        let (path, query) = match text.rsplit_once('?') {
            Some((path, query)) if !Path::new(text).exists() => (path, query),
            _ => {
                let path = text.to_owned();
                return Ok(Self::plain(path));
            }
        };
        let fault = |problem: String| SceneError::Invalid {
            file: path.to_owned(),
            place: format!("?{query}"),
            problem,
            remedy: "write FILE?up=y|z&unit=m|cm|mm|in|ft&missing=plain|refuse&rooms=spaces|none".into(),
        };
        let (mut up, mut unit, mut lenient, mut rooms) = (None, None, None, None);
        for pair in query.split('&').filter(|p| !p.is_empty()) {
            let (key, value) = pair.split_once('=').unwrap_or((pair, ""));
            let twice = match (key, value) {
                ("up", "y") => up.replace(false).is_some(),
                ("up", "z") => up.replace(true).is_some(),
                ("missing", "plain") => lenient.replace(true).is_some(),
                ("rooms", "spaces") => rooms.replace(true).is_some(),
                ("rooms", "none") => rooms.replace(false).is_some(),
                ("missing", "refuse") => lenient.replace(false).is_some(),
                ("unit", name) => match UNITS.iter().find(|u| u.0 == name) {
                    Some(named) => unit.replace(*named).is_some(),
                    None => return Err(fault(format!("there is no unit \"{name}\""))),
                },
                _ => return Err(fault(format!("unknown parameter \"{pair}\""))),
            };
            if twice {
                return Err(fault(format!("{key} is given twice")));
            }
        }
        // What was up and what was north: Z becomes Y, Y becomes -Z.
        let is_z_up = up.unwrap_or(false);
        let turn = if is_z_up { DMat3::from_cols(DVec3::X, -DVec3::Z, DVec3::Y) } else { DMat3::IDENTITY };
        let matrix = turn * unit.map_or(1.0, |(_, metres)| metres);
        let world_from_file = (matrix != DMat3::IDENTITY).then(|| DAffine3::from_mat3(matrix));
        Ok(Self {
            path: path.to_owned(),
            world_from_file,
            unit: unit.map(|(name, _)| name),
            is_z_up,
            lenient: lenient.unwrap_or(false),
            spaces_are_rooms: rooms.unwrap_or(false),
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn files_tell_their_axes_and_units() {
        let spec = |text| FileSpec::parse(text).unwrap();
        assert_eq!(spec("a/b.obj"), FileSpec::plain("a/b.obj".into()));
        assert!(spec("b.ifc?rooms=spaces").spaces_are_rooms && !spec("b.ifc?rooms=none").spaces_are_rooms);
        assert_eq!(spec("b.obj?up=y&unit=m").world_from_file, None);
        assert!(spec("b.obj?missing=plain").lenient && !spec("b.obj?missing=refuse").lenient);
        let turned = spec("b.obj?unit=mm&up=z");
        assert_eq!((turned.path.as_str(), turned.unit, turned.is_z_up), ("b.obj", Some("mm"), true));
        let world = turned.world_from_file.unwrap().transform_point3(DVec3::new(1000.0, 2000.0, 3000.0));
        assert!(world.distance(DVec3::new(1.0, 3.0, -2.0)) < 1e-12, "{world}");
        for text in [
            "a.obj?up=x",
            "a.obj?unit=parsec",
            "a.obj?up=z&up=z",
            "a.obj?scale=2",
            "a.obj?missing=",
            "a.obj?up",
            "a.obj?rooms=all",
        ] {
            let said = FileSpec::parse(text).unwrap_err().to_string();
            assert!(said.starts_with("a.obj: ?") && said.contains("FILE?up"), "{said}");
        }
    }

    #[test]
    fn parses_names_and_parameters() {
        let spec = |text| BuiltinSpec::parse(text).unwrap().unwrap();
        let want = |triangles, seed| BuiltinSpec { name: "pipes".into(), triangles, seed };
        assert_eq!(spec("builtin:pipes"), want(None, 0));
        assert_eq!(spec("builtin:pipes?triangles=1000000"), want(Some(1_000_000), 0));
        assert_eq!(spec("builtin:pipes?seed=7&triangles=12"), want(Some(12), 7));
        assert_eq!(BuiltinSpec::parse("pipes.glb"), None);
    }

    #[test]
    fn refuses_what_it_does_not_know() {
        for text in ["builtin:", "builtin:a?b=1", "builtin:a?seed=-1", "builtin:a?seed", "builtin:a?seed=1&seed=1"] {
            assert!(BuiltinSpec::parse(text).unwrap().is_err(), "{text}");
        }
    }
}
