//! What leaves a full cache, compared on one walk: how many bytes come again.
//!
//! Each frame needs its chunks; what is missing is fetched, and what the frame does not need makes
//! room. Sizes are decoded bytes, what comes again counts in stored bytes. The unit here is the
//! chunk; the client's cache evicts whole objects (an image with its layers).
//!
//! - **lru**: least recently used first, as the client does (Aliaga and Lastra 1999, section 6).
//! - **cost-aware**: GreedyDual-Size (Cao and Irani 1997): each chunk has the credit clock +
//!   stored / decoded bytes when used; the smallest credit goes, and becomes the clock. Keeps what
//!   is expensive to bring again for its size.
//! - **clairvoyant**: the one whose next use is farthest (Belady 1966); optimal where all sizes
//!   are equal, a good lower bound elsewhere.

use super::rehearsal::Script;
use std::collections::BTreeMap;

/// Which chunk goes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Eviction {
    /// The least recently used.
    Lru,
    /// The cheapest to bring again for its size, aged.
    CostAware,
    /// The one needed last.
    Clairvoyant,
}

impl Eviction {
    /// All.
    pub const ALL: [Self; 3] = [Self::Lru, Self::CostAware, Self::Clairvoyant];
}

/// What a walk fetched.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Fetched {
    /// Stored bytes of everything fetched.
    pub bytes: u64,
    /// Those of chunks that had been held before.
    pub again: u64,
    /// Frames that need more than the cache holds.
    pub too_large: usize,
}

#[derive(Debug, Clone, Copy)]
struct Held {
    /// Frame of the last use.
    used: usize,
    credit: f64,
}

/// Walks with a cache of so many decoded bytes.
pub fn replay(script: &Script, cap_bytes: u64, eviction: Eviction) -> Fetched {
    let chunks = &script.index.chunks;
    let mut uses: Vec<Vec<usize>> = vec![Vec::new(); chunks.len()];
    for (frame, needed) in script.needs.iter().enumerate() {
        needed.all().for_each(|c| uses[c as usize].push(frame));
    }
    let size = |c: u32| u64::from(chunks[c as usize].decoded_bytes);
    let stored = |c: u32| u64::from(chunks[c as usize].stored_bytes);
    let next_use = |c: u32, after: usize| {
        let of = &uses[c as usize];
        of.get(of.partition_point(|f| *f <= after)).copied().unwrap_or(usize::MAX)
    };
    let mut held: BTreeMap<u32, Held> = BTreeMap::new();
    let mut held_before = vec![false; chunks.len()];
    let (mut bytes, mut clock) = (0u64, 0.0f64);
    let mut out = Fetched::default();
    for (frame, needed) in script.needs.iter().enumerate() {
        let credit = |c: u32, clock: f64| clock + stored(c) as f64 / size(c).max(1) as f64;
        for c in needed.all() {
            if let Some(h) = held.get_mut(&c) {
                *h = Held { used: frame, credit: credit(c, clock) };
            }
        }
        for c in needed.all() {
            if held.contains_key(&c) {
                continue;
            }
            while bytes + size(c) > cap_bytes {
                let idle = held.iter().filter(|(_, h)| h.used < frame);
                let victim = match eviction {
                    Eviction::Lru => idle.min_by_key(|(n, h)| (h.used, **n)),
                    Eviction::CostAware => idle.min_by(|a, b| a.1.credit.total_cmp(&b.1.credit).then(a.0.cmp(b.0))),
                    Eviction::Clairvoyant => idle.max_by_key(|(n, _)| (next_use(**n, frame), **n)),
                };
                let Some((&number, h)) = victim else { break };
                if eviction == Eviction::CostAware {
                    clock = h.credit;
                }
                held.remove(&number);
                bytes -= size(number);
            }
            out.bytes += stored(c);
            if std::mem::replace(&mut held_before[c as usize], true) {
                out.again += stored(c);
            }
            if bytes + size(c) > cap_bytes {
                // Drawn without it; it is tried again in the next frame that needs it.
                out.too_large += 1;
                break;
            }
            bytes += size(c);
            held.insert(c, Held { used: frame, credit: credit(c, clock) });
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::load::rehearsal::tests::index;
    use ldi_protocol::{Pose, need::Needed};
    use std::{collections::BTreeSet, sync::Arc};

    /// A walk whose frames need one chunk each.
    fn script(frames: &[u32]) -> Script {
        let need = |c: &u32| Arc::new(Needed { base: vec![], now: vec![*c], fine: vec![] });
        let pose = Pose { position: glam::DVec3::ZERO, yaw_deg: 0.0, pitch_deg: 0.0 };
        let poses = (0..frames.len()).map(|i| (i as f64 / 60.0, pose)).collect();
        Script { index: index(8), poses, needs: frames.iter().map(need).collect() }
    }

    /// The fewest fetches that any choice of victims leads to.
    fn fewest(frames: &[u32], held: &BTreeSet<u32>, room: usize) -> usize {
        let Some((first, rest)) = frames.split_first() else { return 0 };
        if held.contains(first) {
            return fewest(rest, held, room);
        }
        let mut with = held.clone();
        with.insert(*first);
        if with.len() <= room {
            return 1 + fewest(rest, &with, room);
        }
        let without = |v: &u32| {
            let mut left = with.clone();
            left.remove(v);
            1 + fewest(rest, &left, room)
        };
        held.iter().map(without).min().unwrap_or(0)
    }

    #[test]
    fn the_clairvoyant_fetches_as_few_as_any_choice_would_and_the_others_no_fewer() {
        let mut state = 7u64;
        let mut worse = 0;
        for _ in 0..60 {
            let frames: Vec<u32> = (0..14)
                .map(|_| {
                    state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
                    (state >> 40) as u32 % 5
                })
                .collect();
            let script = script(&frames);
            let one = u64::from(script.index.chunks[0].decoded_bytes);
            let stored = u64::from(script.index.chunks[0].stored_bytes);
            let fetches = |e| replay(&script, 3 * one, e).bytes / stored;
            let best = fewest(&frames, &BTreeSet::new(), 3) as u64;
            assert_eq!(fetches(Eviction::Clairvoyant), best, "{frames:?}");
            assert!(fetches(Eviction::Lru) >= best && fetches(Eviction::CostAware) >= best);
            worse += u32::from(fetches(Eviction::Lru) > best);
        }
        assert!(worse > 10, "the walks tell them apart: {worse}");
    }

    #[test]
    fn a_cache_that_holds_all_fetches_each_once_and_one_too_small_says_so() {
        let script = script(&[0, 1, 2, 0, 1, 2]);
        for e in Eviction::ALL {
            let all = replay(&script, u64::MAX, e);
            assert_eq!((all.bytes, all.again, all.too_large), (300_000, 0, 0));
            assert_eq!(replay(&script, 1, e).too_large, 6);
        }
    }
}
