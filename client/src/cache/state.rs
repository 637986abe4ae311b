//! The state of the cache: held objects, byte counts and eviction order. No locks, no decoding.

use super::{Usage, object_table::ObjectTable};
use ldi_protocol::{
    index::{ChunkEntry, Index},
    ldi::Ldi,
    mesh::CellGeometry,
    texture::Texture,
    tree::Brood,
};
use std::{
    collections::{BTreeMap, BTreeSet},
    sync::Arc,
    time::Instant,
};

/// Content of an object.
#[derive(Debug, Clone, Default)]
pub(super) enum Value {
    #[default]
    Empty,
    Geometry(Arc<CellGeometry>),
    Ldi(Arc<Ldi>),
    /// Deeper layers of an LDI whose first layer has not arrived.
    WaitingLayers(Vec<u8>),
    Texture(Arc<Texture>),
    Brood(Arc<Brood>),
    /// Counted only, without decoding.
    Undecoded,
}

#[derive(Debug, Default)]
pub(super) struct Object {
    pub value: Value,
    /// Bit mask of held parts.
    pub present: u32,
    /// Bit mask of parts that a frame has used.
    pub used: u32,
    /// Decoded bytes of the held parts.
    pub bytes: u64,
    /// Stored bytes of the held parts: the cost of fetching them again.
    pub stored: u64,
    /// The clock at the last use, plus the object's value.
    credit: f64,
    /// View in which it was last used.
    used_in: u64,
    /// Version, so that a join outside of the lock detects a concurrent change.
    pub version: u64,
}

impl Object {
    /// Rank by credit, then last use. Bit patterns of non-negative floats sort like their values.
    fn rank(&self) -> (u64, u64) {
        (self.credit.to_bits(), self.used_in)
    }

    /// Marks a use: the credit becomes the clock plus stored bytes per decoded byte
    /// (GreedyDual-Size, Cao and Irani 1997).
    fn use_in(&mut self, view: u64, clock: f64) {
        self.used_in = view;
        self.credit = clock + self.stored as f64 / self.bytes.max(1) as f64;
    }
}

#[derive(Debug)]
pub(super) struct CacheState {
    pub objects: Vec<Object>,
    /// [`CacheState::pins`] when each object was pinned last. Separate from the objects, as every
    /// frame scans it.
    pinned_in: Vec<u64>,
    /// Unpinned objects that hold data, by [`Object::rank`], the first to be evicted first. Pinned
    /// objects are left out, as their rank changes with every frame.
    order: BTreeSet<((u64, u64), u32)>,
    /// Objects that the current view needs, and their chunks.
    pinned: Vec<u32>,
    pinned_chunks: Vec<u32>,
    /// Credit of the last evicted object: the ageing of GreedyDual-Size.
    clock: f64,
    /// Number of views so far.
    pub view: u64,
    /// Number of views whose needs differ from the previous ones.
    pins: u64,
    pub usage: Usage,
    pub damaged: Vec<bool>,
    pub evicted: Vec<u32>,
    /// Refused chunks, with the view in which they arrived.
    pub refused: BTreeMap<u32, u64>,
    pub refusals_told: Option<Instant>,
    pub disconnected: Option<String>,
}

impl CacheState {
    /// An empty state.
    pub fn new(objects: usize, chunks: usize, cap_bytes: u64) -> Self {
        Self {
            objects: std::iter::repeat_with(Object::default).take(objects).collect(),
            pinned_in: vec![0; objects],
            order: BTreeSet::new(),
            pinned: Vec::new(),
            pinned_chunks: Vec::new(),
            clock: 0.0,
            view: 1,
            pins: 1,
            usage: Usage { cap_bytes, ..Usage::default() },
            damaged: vec![false; chunks],
            evicted: Vec::new(),
            refused: BTreeMap::new(),
            refusals_told: None,
            disconnected: None,
        }
    }

    pub fn holds(&self, table: &ObjectTable, chunk: u32) -> bool {
        let parts = table.parts(chunk);
        !parts.is_empty() && parts.iter().all(|p| self.objects[p.object as usize].present >> p.part & 1 == 1)
    }

    /// Starts a view that needs these chunks. Fast if they are those of the last view.
    pub fn pin(&mut self, table: &ObjectTable, chunks: impl Iterator<Item = u32> + Clone) {
        self.view += 1;
        if chunks.clone().eq(self.pinned_chunks.iter().copied()) {
            return;
        }
        self.pinned_chunks.clear();
        self.pinned_chunks.extend(chunks.clone());
        let last = self.pins;
        self.pins += 1;
        let before = std::mem::take(&mut self.pinned);
        for number in chunks.flat_map(|c| table.parts(c)).map(|p| p.object) {
            let pinned_in = std::mem::replace(&mut self.pinned_in[number as usize], self.pins);
            if pinned_in == self.pins {
                continue;
            }
            let object = &self.objects[number as usize];
            if pinned_in != last && object.present != 0 {
                self.order.remove(&(object.rank(), number));
            }
            self.pinned.push(number);
        }
        for number in before {
            if self.pinned_in[number as usize] != self.pins {
                let object = &mut self.objects[number as usize];
                object.use_in(self.view - 1, self.clock);
                if object.present != 0 {
                    self.order.insert((object.rank(), number));
                }
            }
        }
    }

    /// Extends the number of objects; chunks may belong to the new ones.
    pub fn extend(&mut self, objects: usize) {
        self.objects.resize_with(objects, Object::default);
        self.pinned_in.resize(objects, 0);
        // A value that no view needs.
        self.pinned_chunks = vec![u32::MAX];
    }

    /// Whether the current view needs an object.
    pub fn is_pinned(&self, number: u32) -> bool {
        self.pinned_in[number as usize] == self.pins
    }

    /// Marks an object as used.
    pub fn use_now(&mut self, number: u32) {
        let is_pinned = self.is_pinned(number);
        let object = &mut self.objects[number as usize];
        let old = object.rank();
        object.use_in(self.view, self.clock);
        let new = object.rank();
        if is_pinned {
            return;
        }
        let listed = object.present != 0;
        if old != new {
            self.order.remove(&(old, number));
        }
        if listed {
            self.order.insert((new, number));
        }
    }

    /// Stores a part of an object. Room must have been made.
    pub fn store(&mut self, number: u32, value: Value, part: u8, bytes: u64, stored: u64) {
        let object = &mut self.objects[number as usize];
        self.usage.objects += usize::from(object.present == 0);
        object.value = value;
        object.version += 1;
        object.present |= 1 << part;
        object.bytes += bytes;
        object.stored += stored;
        self.usage.bytes += bytes;
        self.usage.peak_bytes = self.usage.peak_bytes.max(self.usage.bytes);
        self.use_now(number);
    }

    /// Evicts objects of least credit until `bytes` fit. False, without evictions, if pinned
    /// objects and `keep` leave no room.
    pub fn make_room(&mut self, table: &ObjectTable, bytes: u64, keep: u32) -> bool {
        let mut free = self.usage.cap_bytes - self.usage.bytes;
        let mut victims = Vec::new();
        for &(_, number) in &self.order {
            if free >= bytes {
                break;
            }
            let object = &self.objects[number as usize];
            if number != keep {
                free += object.bytes;
                victims.push(number);
            }
        }
        if free < bytes {
            return false;
        }
        for number in victims {
            self.evict(table, number);
        }
        true
    }

    fn evict(&mut self, table: &ObjectTable, number: u32) {
        let object = &mut self.objects[number as usize];
        self.order.remove(&(object.rank(), number));
        self.usage.objects -= 1;
        self.clock = self.clock.max(object.credit);
        self.usage.bytes -= object.bytes;
        self.usage.evictions += 1;
        let chunks = &table.objects[number as usize].chunks;
        self.evicted.extend((0..chunks.len()).filter(|p| object.present >> p & 1 == 1).map(|p| chunks[p]));
        *object = Object { used_in: object.used_in, version: object.version + 1, ..Object::default() };
    }

    /// See [`super::Cache::check`].
    pub fn check(&self, table: &ObjectTable, index: &Index) -> Result<(), String> {
        let mut sum = 0;
        for (number, (object, entry)) in (0u32..).zip(self.objects.iter().zip(&table.objects)) {
            let sum_of = |size: fn(&ChunkEntry) -> u32| -> u64 {
                let present = (0..entry.chunks.len()).filter(|p| object.present >> p & 1 == 1);
                present.map(|p| u64::from(size(&index.chunks[entry.chunks[p] as usize]))).sum()
            };
            let (bytes, stored) = (sum_of(|c| c.decoded_bytes), sum_of(|c| c.stored_bytes));
            if bytes != object.bytes {
                return Err(format!("object {number}: parts {bytes} bytes, account {}", object.bytes));
            }
            if stored != object.stored {
                return Err(format!("object {number}: parts take {stored} stored bytes, account {}", object.stored));
            }
            let is_pinned = self.is_pinned(number);
            if self.order.contains(&(object.rank(), number)) != (object.present != 0 && !is_pinned) {
                return Err(format!(
                    "object {number}: present {:b}, pinned {is_pinned}, order disagrees",
                    object.present
                ));
            }
            if self.pinned.contains(&number) != is_pinned {
                return Err(format!("object {number}: pinned {is_pinned}, the list of those disagrees"));
            }
            if matches!(object.value, Value::Empty) != (object.present == 0) {
                return Err(format!("object {number}: present {:b}, value disagrees", object.present));
            }
            sum += bytes;
        }
        let held = self.objects.iter().filter(|o| o.present != 0).count();
        if self.usage.objects != held {
            return Err(format!("{} objects counted, {held} held", self.usage.objects));
        }
        if sum != self.usage.bytes || sum > self.usage.cap_bytes {
            return Err(format!("{sum} bytes held, account {}, cap {}", self.usage.bytes, self.usage.cap_bytes));
        }
        Ok(())
    }
}
