//! `builtin:NAME[?triangles=N&seed=S]`: how a built-in scene is asked for.

use super::error::SceneError;

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

#[cfg(test)]
mod tests {
    use super::*;

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
