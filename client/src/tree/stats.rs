//! Statistics of drawing the tree.

/// Statistics of a drawing.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct TreeStats {
    /// Visited samples.
    pub samples: u64,
    /// Samples of the displayed cut.
    pub shown: u64,
    /// Whether the sample limit prevented refinement.
    pub limited: bool,
    /// Splats drawn.
    pub splats: u64,
    /// Pixels that the first pass painted.
    pub painted: u64,
    /// Pixels that gap filling painted.
    pub gaps_filled: u64,
    /// Absent chunks that would refine the picture.
    pub missing: Vec<u32>,
    /// Pixels of the frame taken from the tree.
    pub given: u64,
    /// Milliseconds, including the underlay.
    pub ms: f64,
}
