//! What can be wrong with a scene, said so that it can be put right.

use std::fmt::Display;

/// Why a scene could not be loaded. Every message names the file, the place in it and the remedy.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum SceneError {
    /// The file could not be read at all.
    #[error("{file}: cannot be read: {problem}; {remedy}")]
    Unreadable {
        /// The scene file.
        file: String,
        /// What the system said.
        problem: String,
        /// What to do.
        remedy: String,
        /// Whether it stays so until somebody does that.
        permanent: bool,
    },
    /// The file breaks its own format, or holds values that no scene can have.
    #[error("{file}: {place}: {problem}; {remedy}")]
    Invalid {
        /// The scene file.
        file: String,
        /// Where in the file: `accessor 12, element 3`, `line 40`.
        place: String,
        /// What is wrong there.
        problem: String,
        /// What to do.
        remedy: String,
    },
    /// The file asks for more than [`super::Limits`] allows; nothing was allocated for it.
    #[error("{file}: {place}: {problem}; {remedy}")]
    TooLarge {
        /// The scene file.
        file: String,
        /// Where in the file.
        place: String,
        /// What was found and what is allowed.
        problem: String,
        /// What to do.
        remedy: String,
    },
    /// The file is well formed, but uses something that is not read here.
    #[error("{file}: {place}: {problem}; {remedy}")]
    Unsupported {
        /// The scene file.
        file: String,
        /// Where in the file.
        place: String,
        /// What is not supported.
        problem: String,
        /// What to do.
        remedy: String,
    },
    /// A built-in scene was asked for in a way that it does not know.
    #[error("builtin:{name}: {problem}; {remedy}")]
    Builtin {
        /// Name after `builtin:`.
        name: String,
        /// What is wrong.
        problem: String,
        /// What to do.
        remedy: String,
    },
}

impl SceneError {
    /// Whether trying again cannot help (exit status 42): everything but a file that is there and
    /// could not be read.
    pub fn is_permanent(&self) -> bool {
        !matches!(self, Self::Unreadable { permanent: false, .. })
    }
}

/// The same without the file's name, which only the outermost caller knows.
#[derive(Debug, Clone)]
pub(super) struct Fault {
    kind: FaultKind,
    place: String,
    problem: String,
    remedy: String,
}

#[derive(Debug, Clone, Copy)]
enum FaultKind {
    Invalid,
    TooLarge,
    Unsupported,
}

/// What to do about a file that is broken in a way only its writer can mend.
pub(super) const RE_EXPORT: &str = "export the file again, or ask a validator of the format what wrote it wrongly";

impl Fault {
    /// A broken file.
    pub(super) fn invalid(place: impl Into<String>, problem: impl Into<String>, remedy: impl Into<String>) -> Self {
        Self { kind: FaultKind::Invalid, place: place.into(), problem: problem.into(), remedy: remedy.into() }
    }

    /// A broken file whose only remedy is to write it again.
    pub(super) fn broken(place: impl Into<String>, problem: impl Into<String>) -> Self {
        Self::invalid(place, problem, RE_EXPORT)
    }

    /// More than a limit.
    pub(super) fn too_large(place: impl Into<String>, what: &str, found: impl Display, limit: impl Display) -> Self {
        Self {
            kind: FaultKind::TooLarge,
            place: place.into(),
            problem: format!("{found} {what}, at most {limit} are read"),
            remedy: "split the scene or simplify it".into(),
        }
    }

    /// Something not read here.
    pub(super) fn unsupported(place: impl Into<String>, problem: impl Into<String>, remedy: impl Into<String>) -> Self {
        Self { kind: FaultKind::Unsupported, place: place.into(), problem: problem.into(), remedy: remedy.into() }
    }

    /// The same fault, its place prefixed with where the enclosing thing stands.
    pub(super) fn within(mut self, outer: impl Display) -> Self {
        self.place = format!("{outer}, {}", self.place);
        self
    }

    /// The same fault with another remedy besides.
    pub(super) fn or(mut self, remedy: &str) -> Self {
        self.remedy = format!("{}, or {remedy}", self.remedy);
        self
    }

    /// Whether a limit was passed, so that reading on would pass it again.
    pub(super) fn is_of_size(&self) -> bool {
        matches!(self.kind, FaultKind::TooLarge)
    }

    /// All of several faults as one: the first with its remedy, the others in short. None of none.
    pub(super) fn together(faults: Vec<Self>) -> Option<Self> {
        /// Others beyond these are counted.
        const MOST: usize = 8;
        let mut all = faults.into_iter();
        let mut first = all.next()?;
        let others: Vec<String> = all.map(|f| f.in_short()).collect();
        if !others.is_empty() {
            let mut listed = others[..others.len().min(MOST)].join("; ");
            if others.len() > MOST {
                listed.push_str(&format!("; and {} more", others.len() - MOST));
            }
            first.problem = format!("{} ({} more faults: {listed})", first.problem, others.len());
        }
        Some(first)
    }

    /// Where it is.
    pub(super) fn place(&self) -> &str {
        &self.place
    }

    /// Place and problem, for a note.
    pub(super) fn in_short(&self) -> String {
        format!("{}: {}", self.place, self.problem)
    }

    /// The public error.
    pub(super) fn in_file(self, file: &str) -> SceneError {
        let Self { kind, place, problem, remedy } = self;
        let file = file.to_owned();
        match kind {
            FaultKind::Invalid => SceneError::Invalid { file, place, problem, remedy },
            FaultKind::TooLarge => SceneError::TooLarge { file, place, problem, remedy },
            FaultKind::Unsupported => SceneError::Unsupported { file, place, problem, remedy },
        }
    }
}
