//! How an error is told to people.

use std::{error::Error, io};

/// Whether what keeps a file from being read or written stays so: a full disk may be emptied, a folder that is not there does not come by itself.
pub fn is_lasting(e: &io::Error) -> bool {
    use io::ErrorKind as Kind;
    matches!(
        e.kind(),
        Kind::NotFound | Kind::PermissionDenied | Kind::NotADirectory | Kind::IsADirectory | Kind::AlreadyExists
    )
}

/// An error with its causes, each thing once: many an error says its cause in its own words.
pub fn said(error: &(dyn Error + 'static)) -> String {
    let mut text = error.to_string();
    let mut cause = error.source();
    while let Some(e) = cause {
        let more = e.to_string();
        if !text.contains(&more) {
            text = format!("{text}: {more}");
        }
        cause = e.source();
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Debug, thiserror::Error)]
    enum Trouble {
        #[error("{0}")]
        Plain(&'static str),
        #[error("walls.glb: {0}")]
        Repeats(#[source] Box<Trouble>),
        #[error("cannot be built")]
        Adds(#[source] Box<Trouble>),
    }

    #[test]
    fn a_cause_is_told_once() {
        let repeats = || Trouble::Repeats(Box::new(Trouble::Plain("no triangles")));
        assert_eq!(said(&Trouble::Plain("no triangles")), "no triangles");
        assert_eq!(said(&repeats()), "walls.glb: no triangles");
        assert_eq!(said(&Trouble::Adds(Box::new(repeats()))), "cannot be built: walls.glb: no triangles");
    }
}
