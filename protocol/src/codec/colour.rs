//! Colour planes of LDI layers and textures.
//!
//! G is predicted by the median-edge rule; R and B are predicted as differences to the *decoded*
//! G, so that in the near-lossless modes a channel's error is its own quantization only: less than
//! its step.
//!
//! Where the neighbourhood varies little, how little depends on the mode, all three are exact:
//! there an error lies over whole surfaces and is seen, and residuals are small and cheap; amid
//! detail errors differ from pixel to pixel, the eye averages them away, and most bits are saved.
//!
//! Holes: a row buffer keeps, per column, the last colour seen in it, however many rows above.
//! Where old values stand beside each other they are equal or nearly so, and then the median-edge
//! rule gives the left neighbour. A run starts from the sample above if the row above has one,
//! else from the end of the run before it, else from the row buffer.
//!
//! Contexts: for G how much the neighbourhood varies, in steps; for R and B the residual that G
//! (and R) just had, which tells edges that colour differences follow, and the variation of the
//! difference itself.

use super::{
    CodecError,
    bytes::Reader,
    residual::{Coder, median_edge},
    runs::Run,
};
use std::cell::Cell;

/// How exactly colours are kept amid detail: quantizer steps of the prediction residuals. One
/// mechanism, many settings.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct ColourMode {
    /// Step of G, 1 to 32. The error is less than that.
    pub green_step: u8,
    /// Step of R and B, 1 to 32.
    pub red_blue_step: u8,
    /// Contexts of G, from the smoothest on, in which all three are exact: 0 to 8.
    pub exact_contexts: u8,
}

impl ColourMode {
    /// Exact.
    pub const LOSSLESS: Self = Self::new(1, 1, GREEN as u8);
    /// Largest step.
    pub const MAX_STEP: u8 = 32;

    const fn new(green_step: u8, red_blue_step: u8, exact_contexts: u8) -> Self {
        Self { green_step, red_blue_step, exact_contexts }
    }

    /// Its three bytes, if they are within range.
    pub(super) fn bytes(self) -> Result<[u8; 3], CodecError> {
        for step in [self.green_step, self.red_blue_step] {
            if !(1..=Self::MAX_STEP).contains(&step) {
                return Err(CodecError::range("colour step", step, "it must be 1 to 32"));
            }
        }
        if usize::from(self.exact_contexts) > GREEN {
            return Err(CodecError::range("exact contexts", self.exact_contexts, "there are 8"));
        }
        Ok([self.green_step, self.red_blue_step, self.exact_contexts])
    }

    /// Reads what [`ColourMode::bytes`] gives.
    pub(super) fn read(r: &mut Reader<'_>) -> Result<Self, CodecError> {
        let mode = Self::new(r.u8("green step")?, r.u8("red and blue step")?, r.u8("exact contexts")?);
        mode.bytes().map(|_| mode)
    }
}

/// What colours may cost: a build's `--colour`. Each image gets the first mode of a ladder, from
/// exact on, with which it takes no more bytes than the profile grants.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ColourProfile {
    /// Exact, whatever it costs.
    Lossless,
    /// Exact as long as an image takes at most 0.95 bytes per sample; errors up to 3 codes in G
    /// and 7 in R and B.
    High,
    /// Exact as long as an image takes at most 0.55 bytes per sample; errors up to 15 codes in G
    /// and 23 in R and B.
    Compact,
}

impl ColourProfile {
    /// All profiles, the exact one first.
    pub const ALL: [Self; 3] = [Self::Lossless, Self::High, Self::Compact];
    /// Ever fewer bytes and larger errors; by judgement
    /// (docs/adr/0015-bytes-per-sample-profiles.md).
    const LADDER: [ColourMode; 11] = [
        ColourMode::LOSSLESS,
        ColourMode::new(2, 2, 2),
        ColourMode::new(2, 3, 1),
        ColourMode::new(3, 4, 1),
        ColourMode::new(3, 5, 1),
        ColourMode::new(4, 6, 1),
        ColourMode::new(4, 8, 1),
        ColourMode::new(6, 10, 1),
        ColourMode::new(8, 12, 1),
        ColourMode::new(12, 18, 1),
        ColourMode::new(16, 24, 1),
    ];

    /// The profile of this name: `lossless`, `high` or `compact`.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|p| p.name() == name)
    }

    /// Its name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Lossless => "lossless",
            Self::High => "high",
            Self::Compact => "compact",
        }
    }

    /// The modes to try, in order.
    pub fn modes(self) -> &'static [ColourMode] {
        match self {
            Self::Lossless => &Self::LADDER[..1],
            Self::High => &Self::LADDER[..7],
            Self::Compact => &Self::LADDER,
        }
    }

    /// Bytes that an image may take per sample before a mode with larger errors is tried: what
    /// indoor scenes take with exact colours and a textured one nearly, and half of what exact
    /// colours of a textured one take.
    pub fn bytes_per_sample(self) -> f64 {
        match self {
            Self::Lossless => f64::INFINITY,
            Self::High => 0.95,
            Self::Compact => 0.55,
        }
    }

    /// The mode of textures, which are drawn near the eye, where an error of one code is seen as
    /// FLIP 0.02: exact unless bytes come first.
    pub fn of_textures(self) -> ColourMode {
        if self == Self::Compact { ColourMode::new(3, 5, 1) } else { ColourMode::LOSSLESS }
    }
}

/// Contexts of G.
const GREEN: usize = 8;
/// Contexts of R and of B.
const OTHER: usize = 9;
/// Streams that `walk` uses.
pub(super) const STREAMS: usize = GREEN + 2 * OTHER;

/// Upper ends of the contexts of G: variation in codes. Finer gains less than a hundredth of a
/// byte, and each stream costs its tables; coarser mixes flat walls with foliage.
const GREEN_BORDERS: [i32; GREEN - 1] = [1, 3, 6, 11, 20, 36, 70];

/// One column of the row buffer: G, R - G, B - G as decoded.
type Decoded = [i32; 3];

/// A table by the sum of at most four absolute differences of 8-bit values, or of two of colour
/// differences.
type ByVariation = [u8; 1024];

/// Rows and contexts of a walk, shared by the layers of a chunk.
pub(super) struct Walker {
    mode: ColourMode,
    green_context: ByVariation,
    /// What the variation of a colour difference adds to the context of R and B: where colours are
    /// exact, and amid detail.
    other_context: [ByVariation; 2],
    /// What the residual just before, a byte, adds to it.
    residual_context: [u8; 256],
}

impl Walker {
    pub fn new(mode: ColourMode) -> Self {
        let by_variation = |context: &dyn Fn(i32) -> usize| std::array::from_fn(|v| context(v as i32) as u8);
        let by_step = |step: u8| by_variation(&|v| 3 * class(v, step.into()));
        Self {
            mode,
            green_context: by_variation(&|v| GREEN_BORDERS.partition_point(|b| v > *b)),
            other_context: [by_step(1), by_step(mode.red_blue_step)],
            residual_context: std::array::from_fn(|q| class(i32::from(q as u8 as i8).abs(), 1) as u8),
        }
    }

    /// Codes the colours of all samples. A decoder passes black ones and gets the colours; an
    /// encoder passes the colours and gets them as the decoder will.
    pub fn walk(&self, runs: &[Run], width: u32, rgb: &mut [[u8; 3]], coder: &mut impl Coder) {
        let ColourMode { green_step, red_blue_step, exact_contexts } = self.mode;
        if (green_step, red_blue_step) == (1, 1) || usize::from(exact_contexts) == GREEN {
            self.walk_as::<true>(runs, width, rgb, coder);
        } else {
            self.walk_as::<false>(runs, width, rgb, coder);
        }
    }

    fn walk_as<const LOSSLESS: bool>(&self, runs: &[Run], width: u32, rgb: &mut [[u8; 3]], coder: &mut impl Coder) {
        let steps = (i32::from(self.mode.green_step), i32::from(self.mode.red_blue_step));
        let exact = usize::from(self.mode.exact_contexts);
        let mut above: Vec<Decoded> = vec![[0; 3]; width as usize + 1];
        let mut last_row = vec![u32::MAX; width as usize];
        let mut next = 0;
        let (mut row, mut left) = (u32::MAX, [0; 3]);
        for run in runs {
            let columns = run.column as usize..(run.column + run.count) as usize;
            let mut corner = above[columns.start];
            let above_is_near = last_row[columns.start].wrapping_add(1) == run.row;
            if above_is_near || run.row != row {
                left = corner;
            }
            row = run.row;
            last_row[columns.clone()].fill(row);
            let samples = &mut rgb[next..next + columns.len()];
            next += columns.len();
            let above = Cell::from_mut(&mut above[columns.start..=columns.end]).as_slice_of_cells();
            let mut up = above[0].get();
            for (above, sample) in above.windows(2).zip(samples) {
                let up_right = above[1].get();
                let [red, green, blue] = sample.map(i32::from);
                let variation = (left[0] - corner[0]).abs() + (up[0] - corner[0]).abs() + (up[0] - up_right[0]).abs();
                let context = usize::from(self.green_context[variation as usize % 1024]);
                let detail = !LOSSLESS && context >= exact;
                let (green_step, other_step) = if detail { steps } else { (1, 1) };
                let predicted = median_edge(left[0], up[0], corner[0]);
                let (q_green, green) = coder.byte::<LOSSLESS>(context, green_step, predicted, green);
                let other = |i: usize, q: i32| {
                    let predicted = (green + median_edge(left[i], up[i], corner[i])).clamp(0, 255);
                    let variation = (left[i] - corner[i]).abs() + (up[i] - corner[i]).abs();
                    let context = self.other_context[usize::from(detail)][variation as usize % 1024];
                    (predicted, usize::from(context + self.residual_context[usize::from(q as u8)]))
                };
                let (predicted, context) = other(1, q_green);
                let (q_red, red) = coder.byte::<LOSSLESS>(GREEN + context, other_step, predicted, red);
                let (predicted, context) = other(2, q_red);
                let (_, blue) = coder.byte::<LOSSLESS>(GREEN + OTHER + context, other_step, predicted, blue);
                *sample = [red as u8, green as u8, blue as u8];
                corner = up;
                left = [green, red - green, blue - green];
                above[0].set(left);
                up = up_right;
            }
        }
    }
}

/// 0, 1 or 2 for none, little or more.
fn class(v: i32, step: i32) -> usize {
    usize::from(v > 0) + usize::from(v > 3 * step)
}
