//! A least recently used cache of objects on the GPU, complete or being uploaded, by key.

use super::{
    device::GpuDevice,
    transfer::{Transfer, UploadBudget},
};
use std::{collections::HashMap, hash::Hash};

/// Number of frames without use after which an incomplete upload is dropped. Smaller: anticipated
/// objects are uploaded repeatedly; larger: memory of objects that are not needed.
pub const PATIENCE: u64 = 60;

struct Item<T> {
    what: T,
    bytes: u64,
    /// The rest of the upload; None once it is complete.
    on_its_way: Option<Transfer>,
    /// The frame that used it last.
    used: u64,
}

/// The objects, and their limit.
pub struct GpuLru<K, T> {
    held: HashMap<K, Item<T>>,
    frame: u64,
    /// Bytes that are kept; the current frame may exceed them.
    pub kept_bytes: u64,
}

impl<K: Copy + Eq + Hash, T> GpuLru<K, T> {
    pub fn new(kept_bytes: u64) -> Self {
        Self { held: HashMap::new(), frame: 0, kept_bytes }
    }

    /// Starts a frame. Removes objects that are no longer `valid`, incomplete ones that were not
    /// used for long, and, beyond the limit, those that the previous frame did not use.
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

    /// Marks an object as used, and continues its upload within the budget. `make` returns the
    /// object, its bytes and its transfer. Returns whether it is complete.
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

    /// A complete object.
    pub fn get(&self, key: K) -> Option<&T> {
        self.held.get(&key).filter(|i| i.on_its_way.is_none()).map(|i| &i.what)
    }

    /// Whether an object is complete or being uploaded.
    pub fn has(&self, key: K) -> bool {
        self.held.contains_key(&key)
    }

    /// Whether `bytes` fit beside everything that this frame has used so far.
    pub fn has_room(&self, bytes: u64) -> bool {
        let wanted: u64 = self.held.values().filter(|i| i.used == self.frame).map(|i| i.bytes).sum();
        wanted + bytes <= self.kept_bytes
    }

    /// Bytes on the GPU, including incomplete objects.
    pub fn bytes(&self) -> u64 {
        self.held.values().map(|i| i.bytes).sum()
    }

    pub fn clear(&mut self) {
        self.held.clear();
    }
}
