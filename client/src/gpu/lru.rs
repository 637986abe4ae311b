//! What lies on the card, or is on its way there, by key. What was used longest ago leaves first.

use super::{
    device::GpuDevice,
    transfer::{Transfer, UploadBudget},
};
use std::{collections::HashMap, hash::Hash};

/// Frames for which nobody may want what is on its way before it is given up: what is foreseen comes and goes with every step.
pub const PATIENCE: u64 = 60;

struct Item<T> {
    what: T,
    bytes: u64,
    /// None: it is there.
    on_its_way: Option<Transfer>,
    /// The frame that wanted it last.
    used: u64,
}

/// See the module.
pub struct GpuLru<K, T> {
    held: HashMap<K, Item<T>>,
    frame: u64,
    /// Bytes that stay, or those of the frame if they are more.
    pub kept_bytes: u64,
}

impl<K: Copy + Eq + Hash, T> GpuLru<K, T> {
    pub fn new(kept_bytes: u64) -> Self {
        Self { held: HashMap::new(), frame: 0, kept_bytes }
    }

    /// A frame begins: what is no longer `valid` leaves, what nobody has wanted for long if it is not there yet, and what the frame before did not want if there is no room.
    pub fn begin_frame(&mut self, valid: impl Fn(&T) -> bool) {
        let last = self.frame;
        self.held.retain(|_, i| valid(&i.what) && (i.on_its_way.is_none() || i.used + PATIENCE >= last));
        self.frame += 1;
        let mut bytes = self.bytes();
        if bytes <= self.kept_bytes {
            return;
        }
        let mut oldest: Vec<(u64, K)> =
            self.held.iter().filter(|(_, i)| i.used < last).map(|(key, i)| (i.used, *key)).collect();
        oldest.sort_unstable_by_key(|(used, _)| *used);
        for (_, key) in oldest {
            if bytes <= self.kept_bytes {
                break;
            }
            bytes -= self.held.remove(&key).map_or(0, |i| i.bytes);
        }
    }

    /// The frame wants this: sends on what of it is not there, as much as is allowed. `make` gives what it is, its bytes and what must be sent. Returns whether all of it is there.
    pub fn upload(
        &mut self,
        key: K,
        card: &GpuDevice,
        budget: &mut UploadBudget,
        make: impl FnOnce() -> (T, u64, Transfer),
    ) -> bool {
        let item = self.held.entry(key).or_insert_with(|| {
            let (what, bytes, transfer) = make();
            Item { what, bytes, on_its_way: Some(transfer), used: 0 }
        });
        item.used = self.frame;
        item.on_its_way.take_if(|t| t.push(card, budget));
        item.on_its_way.is_none()
    }

    /// What is there.
    pub fn get(&self, key: K) -> Option<&T> {
        self.held.get(&key).filter(|i| i.on_its_way.is_none()).map(|i| &i.what)
    }

    /// Whether it is there or on its way.
    pub fn has(&self, key: K) -> bool {
        self.held.contains_key(&key)
    }

    /// Whether so many bytes more can stay, besides what this frame has wanted so far.
    pub fn has_room(&self, bytes: u64) -> bool {
        let wanted: u64 = self.held.values().filter(|i| i.used == self.frame).map(|i| i.bytes).sum();
        wanted + bytes <= self.kept_bytes
    }

    /// Bytes on the card, those on their way included: their room is taken.
    pub fn bytes(&self) -> u64 {
        self.held.values().map(|i| i.bytes).sum()
    }

    pub fn clear(&mut self) {
        self.held.clear();
    }
}
