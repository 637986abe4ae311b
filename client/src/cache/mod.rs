//! The cache of decoded objects, bounded in bytes.
//!
//! In: chunks as they arrive ([`Cache::insert`], on the decoding threads), and the needs of each
//! view ([`Cache::pin`]). Out: objects for the renderer ([`Resident`]), missing chunks, and evicted
//! chunks, which are reported to the server.
//!
//! - The unit of arrival is the chunk, the unit of eviction the object: a cell, a bundle, an LDI
//!   with all its layers, a texture with all its levels. An object is usable once its first chunk
//!   has arrived, and is replaced as a whole when more arrive: a frame keeps the version it holds.
//! - Sizes are the decoded bytes stated in the index. Their sum never exceeds the capacity. Objects
//!   that are cheapest to fetch again per byte of memory are evicted first, with ageing
//!   (GreedyDual-Size, Cao and Irani 1997, in place of the least recently used order of Aliaga and
//!   Lastra 1999, section 6). Objects that the current view needs are pinned. Data around the eye
//!   counts as used ([`Cache::touch`]), so that eviction does not undo the server's prefetching.
//! - A chunk that does not fit beside the pinned objects is refused. The frame is drawn without it,
//!   and says so.

mod decode;
mod error;
#[cfg(test)]
pub(crate) mod fixture;
mod object_table;
mod state;
mod usage;

pub use error::{DecodeError, Incomplete};
pub use usage::Usage;

use crate::resident::Resident;
use ldi_protocol::{index::Index, ldi::Ldi, mesh::CellGeometry, texture::Texture, tree::Brood};
use object_table::{ObjectKind, ObjectTable, Part};
use state::{CacheState, Value};
use std::{
    sync::{Arc, Condvar, Mutex, MutexGuard, OnceLock, PoisonError},
    time::{Duration, Instant},
};

/// Shortest interval at which refused chunks are reported to the server, which would send them
/// again at once.
const REFUSAL_INTERVAL: Duration = Duration::from_secs(1);

/// Outcome of inserting a chunk.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Inserted {
    /// The chunk is held now.
    Held,
    /// The chunk was held before.
    Duplicate,
    /// The pinned objects leave no room.
    NoRoom,
}

/// A cache. All methods may be called from any thread; decoding happens without the lock.
#[derive(Debug)]
pub struct Cache {
    first: Scope,
    /// The complete index, if `first` is a partial one.
    whole: OnceLock<Scope>,
    decoding: bool,
    inner: Mutex<CacheState>,
    changed: Condvar,
}

/// An index and its objects.
#[derive(Debug)]
struct Scope {
    index: Arc<Index>,
    table: ObjectTable,
}

impl Scope {
    fn new(index: Arc<Index>) -> Self {
        Self { table: ObjectTable::new(&index), index }
    }
}

impl Cache {
    /// An empty cache with a capacity of `cap_bytes` decoded bytes.
    pub fn new(index: Arc<Index>, cap_bytes: u64) -> Self {
        let first = Scope::new(index);
        let inner = CacheState::new(first.table.objects.len(), first.index.chunks.len(), cap_bytes);
        Self { first, whole: OnceLock::new(), decoding: true, inner: Mutex::new(inner), changed: Condvar::new() }
    }

    /// A cache that only counts objects, without decoding: for load tests.
    pub fn without_decoding(index: Arc<Index>, cap_bytes: u64) -> Self {
        Self { decoding: false, ..Self::new(index, cap_bytes) }
    }

    /// The index, as far as it is known.
    pub fn index(&self) -> &Arc<Index> {
        &self.scope().index
    }

    /// Replaces a partial index ([`ldi_protocol::manifest::early`]) by the complete one, once. Held
    /// objects stay.
    pub fn complete(&self, index: Arc<Index>) {
        let scope = Scope::new(index);
        let mut inner = self.lock();
        // Objects of the LDI tree come first and have the same numbers in both indices.
        inner.extend(scope.table.objects.len());
        let _ = self.whole.set(scope);
    }

    /// The current index. Read before taking the lock, so that there are never fewer objects than
    /// it lists.
    fn scope(&self) -> &Scope {
        self.whole.get().unwrap_or(&self.first)
    }

    fn lock(&self) -> MutexGuard<'_, CacheState> {
        // Every change is complete before anything can panic.
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Decodes and adds a verified chunk.
    ///
    /// # Errors
    /// If the bytes do not match the index.
    pub fn insert(&self, chunk: u32, bytes: &[u8]) -> Result<Inserted, DecodeError> {
        let parts = self.scope().table.parts(chunk);
        if parts.is_empty() {
            return Err(DecodeError::Unreferenced);
        }
        let mut result = Inserted::Duplicate;
        for part in parts {
            match self.insert_part(*part, chunk, bytes)? {
                Inserted::NoRoom => return Ok(Inserted::NoRoom),
                Inserted::Held => result = Inserted::Held,
                Inserted::Duplicate => {}
            }
        }
        Ok(result)
    }

    fn insert_part(&self, part: Part, chunk: u32, bytes: &[u8]) -> Result<Inserted, DecodeError> {
        let entry = &self.scope().table.objects[part.object as usize];
        let levels = match entry.kind {
            ObjectKind::Texture(t) if self.decoding => Some(decode::texture_levels(self.index(), t, part.part, bytes)?),
            _ => None,
        };
        loop {
            let (old, version) = {
                let inner = self.lock();
                let object = &inner.objects[part.object as usize];
                if object.present >> part.part & 1 == 1 {
                    return Ok(Inserted::Duplicate);
                }
                (object.value.clone(), object.version)
            };
            let new = match (&entry.kind, &levels) {
                _ if !self.decoding => Value::Undecoded,
                (ObjectKind::Texture(t), Some(levels)) => {
                    decode::texture(&old, &self.index().textures[*t as usize], levels)
                }
                (ObjectKind::Ldi(p), _) => decode::ldi(self.index(), *p, &old, part.part, bytes)?,
                (ObjectKind::Brood(nodes), _) => decode::brood(self.index(), chunk, nodes.clone(), bytes)?,
                (ObjectKind::Cell(c), _) => decode::cell(self.index(), *c, bytes)?,
                (ObjectKind::Levels, _) => decode::levels(self.index(), chunk, bytes)?,
                (ObjectKind::Bundle | ObjectKind::Texture(_), _) => decode::bundle(self.index(), chunk, bytes)?,
            };
            if let Some(done) = self.install(part, chunk, new, version) {
                return Ok(done);
            }
        }
    }

    /// Stores a joined object. None if another part was joined in the meantime.
    fn install(&self, part: Part, chunk: u32, new: Value, version: u64) -> Option<Inserted> {
        let mut inner = self.lock();
        if inner.objects[part.object as usize].version != version {
            return None;
        }
        let entry = self.index().chunks[chunk as usize];
        let bytes = u64::from(entry.decoded_bytes);
        if !inner.make_room(&self.scope().table, bytes, part.object) {
            let view = inner.view;
            inner.refused.insert(chunk, view);
            self.changed.notify_all();
            return Some(Inserted::NoRoom);
        }
        inner.store(part.object, new, part.part, bytes, u64::from(entry.stored_bytes));
        self.changed.notify_all();
        Some(Inserted::Held)
    }

    /// Starts a new view: pins its needs, and unpins those of the last view.
    pub fn pin(&self, chunks: impl IntoIterator<Item = u32, IntoIter: Clone>) {
        let mut inner = self.lock();
        inner.pin(&self.scope().table, chunks.into_iter());
    }

    /// Whether the current view needs a chunk.
    pub fn is_pinned(&self, chunk: u32) -> bool {
        let inner = self.lock();
        self.scope().table.parts(chunk).iter().any(|p| inner.is_pinned(p.object))
    }

    /// Marks held chunks as used.
    pub fn touch(&self, chunks: impl IntoIterator<Item = u32>) {
        let mut inner = self.lock();
        for chunk in chunks {
            for part in self.scope().table.parts(chunk) {
                inner.use_now(part.object);
            }
        }
    }

    /// Marks held chunks as used by a frame, without returning them.
    pub fn count_used(&self, chunks: impl IntoIterator<Item = u32>) {
        let mut inner = self.lock();
        for chunk in chunks {
            for part in self.scope().table.parts(chunk) {
                let object = &mut inner.objects[part.object as usize];
                let fresh = object.present & !object.used & 1 << part.part;
                object.used |= fresh;
                if fresh != 0 {
                    inner.usage.useful_bytes += u64::from(self.index().chunks[chunk as usize].stored_bytes);
                }
            }
        }
    }

    /// Excludes a chunk that was not received over the network from [`Usage::useful_bytes`].
    pub fn count_elsewhere(&self, chunk: u32) {
        let mut inner = self.lock();
        for part in self.scope().table.parts(chunk) {
            let object = &mut inner.objects[part.object as usize];
            object.used |= object.present & 1 << part.part;
        }
    }

    /// Whether a chunk is held.
    pub fn holds(&self, chunk: u32) -> bool {
        self.lock().holds(&self.scope().table, chunk)
    }

    /// All held chunks, ascending.
    pub fn held(&self) -> Vec<u32> {
        let inner = self.lock();
        (0..self.index().chunks.len() as u32).filter(|c| inner.holds(&self.scope().table, *c)).collect()
    }

    /// The chunks of `chunks` that are not held, including damaged ones.
    pub fn missing(&self, chunks: impl IntoIterator<Item = u32>) -> Vec<u32> {
        let inner = self.lock();
        chunks.into_iter().filter(|c| !inner.holds(&self.scope().table, *c)).collect()
    }

    /// Gives up a chunk that repeatedly arrived damaged.
    pub fn mark_damaged(&self, chunk: u32) {
        if let Some(flag) = self.lock().damaged.get_mut(chunk as usize) {
            *flag = true;
        }
        self.changed.notify_all();
    }

    /// Number of chunks given up.
    pub fn damaged(&self) -> usize {
        self.lock().damaged.iter().filter(|d| **d).count()
    }

    /// Whether a chunk was given up.
    pub fn is_damaged(&self, chunk: u32) -> bool {
        self.lock().damaged.get(chunk as usize).copied().unwrap_or(false)
    }

    /// Sets the reason why nothing will arrive any more. None: a connection is established.
    pub fn set_disconnected(&self, reason: Option<String>) {
        self.lock().disconnected = reason;
        self.changed.notify_all();
    }

    /// The reason why nothing will arrive any more; None while a connection is up.
    pub fn disconnected(&self) -> Option<String> {
        self.lock().disconnected.clone()
    }

    /// Waits until all of `chunks` are held, or cannot arrive.
    ///
    /// # Errors
    /// See [`Incomplete`]. Damaged chunks are an error only after all others have arrived.
    pub fn wait(&self, chunks: &[u32], timeout: Duration) -> Result<(), Incomplete> {
        let deadline = Instant::now() + timeout;
        let mut inner = self.lock();
        loop {
            let missing: Vec<u32> = chunks.iter().copied().filter(|c| !inner.holds(&self.scope().table, *c)).collect();
            let (damaged, coming): (Vec<u32>, Vec<u32>) =
                missing.into_iter().partition(|c| inner.damaged.get(*c as usize).copied().unwrap_or(true));
            if coming.is_empty() {
                return if damaged.is_empty() { Ok(()) } else { Err(Incomplete::Damaged(damaged)) };
            }
            if coming.iter().any(|c| inner.refused.get(c) == Some(&inner.view)) {
                return Err(Incomplete::NoRoom { cap_bytes: inner.usage.cap_bytes });
            }
            if let Some(reason) = &inner.disconnected {
                return Err(Incomplete::Disconnected(reason.clone()));
            }
            let left = deadline.saturating_duration_since(Instant::now());
            if left.is_zero() {
                return Err(Incomplete::Timeout(coming));
            }
            inner = self.changed.wait_timeout(inner, left).unwrap_or_else(PoisonError::into_inner).0;
        }
    }

    /// Takes the chunks evicted since the last call, ascending. Refused ones are included only at
    /// intervals.
    pub fn take_evicted(&self, now: Instant) -> Vec<u32> {
        let mut inner = self.lock();
        let mut out = std::mem::take(&mut inner.evicted);
        if inner.refusals_told.is_none_or(|t| now.duration_since(t) >= REFUSAL_INTERVAL) && !inner.refused.is_empty() {
            inner.refusals_told = Some(now);
            out.extend(std::mem::take(&mut inner.refused).into_keys());
        }
        out.retain(|c| !inner.holds(&self.scope().table, *c));
        out.sort_unstable();
        out.dedup();
        out
    }

    /// The current usage.
    pub fn usage(&self) -> Usage {
        self.lock().usage
    }

    /// Checks the invariants: byte counts equal the sums of what is held, within the capacity; the
    /// eviction order lists exactly the unpinned objects that hold data.
    ///
    /// # Errors
    /// Describes the first violation.
    pub fn check(&self) -> Result<(), String> {
        self.lock().check(&self.scope().table, self.index())
    }

    fn object<T>(&self, number: Option<u32>, pick: impl Fn(&Value) -> Option<T>) -> Option<T> {
        let number = number?;
        let mut inner = self.lock();
        let object = &mut inner.objects[number as usize];
        let found = pick(&object.value)?;
        let fresh = object.present & !object.used;
        object.used |= fresh;
        if fresh != 0 {
            let chunks = &self.scope().table.objects[number as usize].chunks;
            inner.usage.useful_bytes += (0..chunks.len())
                .filter(|p| fresh >> p & 1 == 1)
                .map(|p| u64::from(self.index().chunks[chunks[p] as usize].stored_bytes))
                .sum::<u64>();
        }
        inner.use_now(number);
        Some(found)
    }
}

impl Resident for Cache {
    fn cell(&self, cell: u32) -> Option<Arc<CellGeometry>> {
        self.bundle(self.index().cells.get(cell as usize)?.chunk)
    }
    fn bundle(&self, chunk: u32) -> Option<Arc<CellGeometry>> {
        let number = *self.scope().table.geometry_of_chunk.get(chunk as usize)?;
        self.object(number, |v| if let Value::Geometry(g) = v { Some(g.clone()) } else { None })
    }
    fn texture(&self, texture: u32) -> Option<Arc<Texture>> {
        let number = *self.scope().table.of_texture.get(texture as usize)?;
        self.object(number, |v| if let Value::Texture(t) = v { Some(t.clone()) } else { None })
    }
    fn ldi(&self, image: u32) -> Option<Arc<Ldi>> {
        let number = *self.scope().table.of_image.get(image as usize)?;
        self.object(number, |v| if let Value::Ldi(l) = v { Some(l.clone()) } else { None })
    }
    fn brood(&self, chunk: u32) -> Option<Arc<Brood>> {
        let number = *self.scope().table.brood_of_chunk.get(chunk as usize)?;
        self.object(number, |v| if let Value::Brood(b) = v { Some(b.clone()) } else { None })
    }
}

#[cfg(test)]
#[path = "cache_test.rs"]
mod tests;
