//! What no view needs yet: the list of what may be needed soon, and whether the next of it has to
//! go.

use super::{
    ChunkState, Order, Planner,
    forecast::{Expected, rank_s},
    motion::Motion,
    schedule,
};
use ldi_protocol::need::PREFETCH_SHARE;
use std::time::Duration;

/// Stored bytes that may come into need at once: those of a view amid new images. Decides how far
/// ahead is looked.
const SURGE_BYTES: u64 = 6 << 20;
/// Expectations are made again after this time. Shorter: fresher guesses, more work per walker.
const FORESEE_EVERY: Duration = Duration::from_millis(80);

impl Planner {
    /// The next chunk ahead of need, if it has to go now.
    pub(super) fn ahead(&mut self, now: Duration) -> Option<Order> {
        let motion = self.motion.filter(|_| self.config.prefetch_m > 0.0)?;
        let full = self.flying_background >= self.config.max_background;
        if full || self.flying.len() > self.flying_background || self.due_at.is_some_and(|t| now < t) {
            return None;
        }
        if self.foreseen_at.is_none_or(|t| now >= t + FORESEE_EVERY) {
            self.foresee(&motion, now);
        }
        // Times count from the pose. Whoever stands may set off or turn at any moment, so that
        // these times stay as they are.
        let elapsed = if motion.moves() { now.saturating_sub(self.foreseen_from) } else { Duration::ZERO };
        let elapsed_s = elapsed.as_secs_f64();
        let (held, dropped_at, place) = (&self.held, &self.dropped_at, self.place.0);
        self.expected.retain(|e| {
            let c = e.chunk as usize;
            held[c] == ChunkState::Flying || held[c] == ChunkState::Absent && dropped_at[c] != place
        });
        let waiting: Vec<Expected> =
            self.expected.iter().filter(|e| self.held[e.chunk as usize] == ChunkState::Absent).copied().collect();
        let slack_s =
            schedule::slack_s(&waiting, elapsed_s, &self.capacity, self.flying_bytes, |chunk| self.bytes(chunk));
        match (waiting.first(), slack_s) {
            (Some(first), Some(slack_s)) if slack_s <= 0.0 => Some(self.send(first.chunk, first.urgency)),
            _ => {
                // Whoever stands foresees the same again, so there is nothing to wait for but news.
                let wait = Duration::from_secs_f64(slack_s.unwrap_or(1.0).clamp(5e-3, 1.0));
                self.due_at = Some(if motion.moves() { now + wait } else { Duration::MAX });
                None
            }
        }
    }

    /// Makes the list of what may be needed soon, within the client's cache.
    fn foresee(&mut self, motion: &Motion, now: Duration) {
        let within_s = self.capacity.horizon_s(SURGE_BYTES);
        let held = &self.held;
        let absent = |chunk: u32| held.get(chunk as usize).is_some_and(|h| *h != ChunkState::Held);
        let mut expected = self.foresight.expect(motion, within_s, self.config.prefetch_m, &absent);
        expected.retain(|e| absent(e.chunk));
        // A late chunk costs frames, whatever its size; one sent in vain costs its bytes.
        let worth = self.config.ahead_worth as f64;
        expected.retain(|e| {
            let bytes = self.bytes(e.chunk) as f64;
            e.probability * (bytes + worth) >= bytes
        });
        expected.sort_by(|a, b| rank_s(a).total_cmp(&rank_s(b)).then(a.chunk.cmp(&b.chunk)));
        let in_view = self.lists.iter().flat_map(|l| &l.chunks);
        let decoded = |chunk: u32| u64::from(self.index.chunks[chunk as usize].decoded_bytes);
        let taken: u64 = in_view.map(|c| decoded(*c)).sum();
        let mut left = ((self.config.cache_bytes as f64 * PREFETCH_SHARE) as u64).saturating_sub(taken);
        let fits = expected.iter().take_while(|e| {
            let rest = left.checked_sub(decoded(e.chunk));
            left = rest.unwrap_or(0);
            rest.is_some()
        });
        let count = fits.count();
        expected.truncate(count);
        self.expected = expected;
        self.foreseen_at = Some(now);
        self.foreseen_from = self.planned_at.unwrap_or(now);
        self.changed = true;
    }
}
