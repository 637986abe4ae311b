//! How large the picture is drawn inside: as large as the time for a frame allows, at most as the window.
//!
//! In: the milliseconds of each frame. Out: a share of the window's sides. Pure.

/// Smallest share of the window's sides: below, pictures say too little.
const SMALLEST: f64 = 0.375;
/// Shares are multiples of this: every change costs memory and is seen.
const STEP: f64 = 1.0 / 16.0;
/// Above this share of the goal a frame is too slow.
const TOO_SLOW: f64 = 1.15;
/// Below this share of the goal, for [`CALM`] frames in a row, there is room for more: one step of the side costs at most a
/// third more, at the smallest sizes.
const ROOM: f64 = 0.7;
/// See [`ROOM`]. Fewer: sizes swing; more: the picture stays coarse long after a turn.
const CALM: u32 = 12;

/// Adapts the size.
#[derive(Debug, Clone, PartialEq)]
pub struct DynamicResolution {
    goal_ms: f64,
    share: f64,
    calm: u32,
    slow: u32,
    exhausted: bool,
}

impl DynamicResolution {
    /// Frames are to take `goal_ms`. Begins with half of the window's sides.
    pub fn new(goal_ms: f64) -> Self {
        Self { goal_ms, share: 0.5, calm: 0, slow: 0, exhausted: false }
    }

    /// A frame at the present size took so long.
    pub fn record_frame(&mut self, ms: f64) {
        let ratio = ms / self.goal_ms;
        if ratio > TOO_SLOW {
            self.calm = 0;
            self.slow += 1;
            // One slow frame, as when an image is laid out, is no reason.
            if self.slow >= 2 {
                self.slow = 0;
                self.exhausted |= self.share <= SMALLEST;
                // At most the pixels cost: the share falls with the root, by a third at once at most.
                self.share *= ratio.sqrt().recip().max(0.67);
            }
        } else {
            self.slow = 0;
            self.calm = if ratio < ROOM { self.calm + 1 } else { 0 };
            if self.calm >= CALM {
                self.calm = 0;
                // What was given up last comes back first.
                if !std::mem::take(&mut self.exhausted) {
                    self.share += STEP;
                }
            }
        }
        self.share = self.share.clamp(SMALLEST, 1.0);
    }

    /// The time that frames are to take, milliseconds.
    pub fn goal_ms(&self) -> f64 {
        self.goal_ms
    }

    /// Frames are to take another time from now on.
    pub fn set_goal(&mut self, goal_ms: f64) {
        self.goal_ms = goal_ms;
    }

    /// Share of the window's sides.
    pub fn share(&self) -> f64 {
        ((self.share / STEP).round() * STEP).clamp(SMALLEST, 1.0)
    }

    /// Whether even the smallest pictures take too long: what else can be cheaper should be.
    pub fn is_exhausted(&self) -> bool {
        self.exhausted
    }

    /// Columns and rows for a window.
    pub fn size(&self, window_px: [u32; 2]) -> [u32; 2] {
        window_px.map(|n| ((f64::from(n) * self.share()).round() as u32).max(1))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Frames of a machine that takes `fixed` and, at the window's size, `pixels` milliseconds more.
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
        settle(&mut s, 4.0, 40.0, 100);
        let ms = 4.0 + 40.0 * s.share() * s.share();
        assert!((0.5..=TOO_SLOW).contains(&(ms / 16.0)), "{ms} ms at {}", s.share());
        // What no size can mend stays at the smallest.
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
