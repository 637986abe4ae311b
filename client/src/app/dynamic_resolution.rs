//! Dynamic resolution: the picture's size is the largest that the frame time allows, at most the
//! window's.
//!
//! In: the milliseconds of each frame. Out: a share of the window's sides. Pure.

/// Smallest share of the window's sides, a multiple of [`STEP`]. Smaller: moving pictures fall into
/// blocks; larger: they stutter on slow machines. A judgement.
const SMALLEST: f64 = 0.625;
/// Granularity of shares. Smaller: buffers are allocated again for changes that are not visible.
const STEP: f64 = 1.0 / 16.0;
/// A frame above this multiple of the goal is too slow.
const TOO_SLOW: f64 = 1.15;
/// Below this share of the goal, for [`CALM`] frames in a row, the picture grows by a step. Larger:
/// the next size may be too slow; smaller: pictures stay smaller than necessary.
const ROOM: f64 = 0.7;
/// See [`ROOM`]. Fewer: the size oscillates; more: the picture stays coarse long after a turn.
const CALM: u32 = 12;

/// The controller of the picture's size.
#[derive(Debug, Clone, PartialEq)]
pub struct DynamicResolution {
    goal_ms: f64,
    share: f64,
    calm: u32,
    slow: u32,
    exhausted: bool,
}

impl DynamicResolution {
    /// Starts at the smallest share of the window's sides. `goal_ms`: intended frame time.
    pub fn new(goal_ms: f64) -> Self {
        Self { goal_ms, share: SMALLEST, calm: 0, slow: 0, exhausted: false }
    }

    /// Records the time of a frame at the current size.
    pub fn record_frame(&mut self, ms: f64) {
        let ratio = ms / self.goal_ms;
        if ratio > TOO_SLOW {
            self.calm = 0;
            self.slow += 1;
            // A single slow frame does not count.
            if self.slow >= 2 {
                self.slow = 0;
                self.exhausted |= self.share <= SMALLEST;
                // Cost is at most proportional to pixels, so that the share follows the square
                // root. One step shrinks it by at most a third.
                self.share *= ratio.sqrt().recip().max(0.67);
            }
        } else {
            self.slow = 0;
            self.calm = if ratio < ROOM { self.calm + 1 } else { 0 };
            if self.calm >= CALM {
                self.calm = 0;
                // The cheaper stamp is given up before the picture grows.
                if !std::mem::take(&mut self.exhausted) {
                    self.share += STEP;
                }
            }
        }
        self.share = self.share.clamp(SMALLEST, 1.0);
    }

    /// Intended frame time, milliseconds.
    pub fn goal_ms(&self) -> f64 {
        self.goal_ms
    }

    /// Changes the intended frame time.
    pub fn set_goal(&mut self, goal_ms: f64) {
        self.goal_ms = goal_ms;
    }

    /// Share of the window's sides.
    pub fn share(&self) -> f64 {
        ((self.share / STEP).round() * STEP).clamp(SMALLEST, 1.0)
    }

    /// Whether the smallest picture is still too slow, so that a cheaper stamp should be used.
    pub fn is_exhausted(&self) -> bool {
        self.exhausted
    }

    /// Size of the picture for a window.
    pub fn size(&self, window_px: [u32; 2]) -> [u32; 2] {
        window_px.map(|n| ((f64::from(n) * self.share()).round() as u32).max(1))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Simulates frames that take `fixed` ms plus `pixels` ms at the window's size.
    fn settle(scale: &mut DynamicResolution, fixed: f64, pixels: f64, frames: u32) -> Vec<[u32; 2]> {
        let frame = |s: &mut DynamicResolution| {
            s.record_frame(fixed + pixels * s.share() * s.share());
            s.size([1280, 720])
        };
        (0..frames).map(|_| frame(scale)).collect()
    }

    #[test]
    fn fast_machines_fill_the_window_and_slow_ones_keep_the_time() {
        let mut s = DynamicResolution::new(16.0);
        assert_eq!(settle(&mut s, 2.0, 6.0, 200).last(), Some(&[1280, 720]));
        settle(&mut s, 4.0, 20.0, 100);
        let ms = 4.0 + 20.0 * s.share() * s.share();
        assert!((0.5..=TOO_SLOW).contains(&(ms / 16.0)), "{ms} ms at {}", s.share());
        // If no size is fast enough, the smallest is used.
        settle(&mut s, 100.0, 1.0, 100);
        assert_eq!(s.share(), SMALLEST);
    }

    #[test]
    fn sizes_do_not_swing() {
        for pixels in 5..120 {
            let mut s = DynamicResolution::new(16.0);
            settle(&mut s, 3.0, f64::from(pixels), 400);
            let mut later = settle(&mut s, 3.0, f64::from(pixels), 400);
            later.dedup();
            assert_eq!(later.len(), 1, "{pixels} ms: {later:?}");
        }
    }

    #[test]
    fn one_slow_frame_is_no_reason() {
        let mut s = DynamicResolution::new(16.0);
        settle(&mut s, 2.0, 6.0, 200);
        s.record_frame(120.0);
        settle(&mut s, 2.0, 6.0, 1);
        assert_eq!(s.share(), 1.0);
    }
}
