//! Decoded objects at hand: what the renderer draws from, bounded in bytes.
//!
//! In: chunks as they arrive ([`Cache::insert`], on the decoding threads) and what each view needs ([`Cache::pin`]).
//! Out: objects to the renderer ([`Resident`]), what is missing, and what was evicted, for the server to know.
//!
//! - The unit of arrival is the chunk, the unit of eviction the object: a cell, a bundle, an LDI with all its layers, a texture
//!   with all its levels. An object is usable as soon as its first chunk is there, and is replaced as a whole when more
//!   arrives: a frame keeps the one that it holds.
//! - Accounts are in decoded bytes as the index states them, and never exceed the cap, not even for a moment. What is cheap to bring again for the memory that it
//!   takes goes first, and what is used ages by what has gone (GreedyDual-Size, Cao and Irani 1997; measured against the least recently used of Aliaga and Lastra 1999, section 6, in
//!   docs/streaming.md); what the current view needs is pinned and stays. What lies around the eye counts as used ([`Cache::touch`]), so that eviction does not undo the server's prefetching.
//! - A chunk that does not fit beside the pinned ones is refused. The frame is drawn without it and says so.

mod decode;
#[cfg(test)]
pub(crate) mod fixture;
mod object_table;
mod state;

use crate::resident::Resident;
use ldi_protocol::{codec::CodecError, index::Index, ldi::Ldi, mesh::CellGeometry, texture::Texture, tree::Brood};
use object_table::{ObjectKind, ObjectTable, Part};
use state::{CacheState, Value};
use std::{
    sync::{Arc, Condvar, Mutex, MutexGuard, OnceLock, PoisonError},
    time::{Duration, Instant},
};

/// A refused chunk is told to the server at most this often: it would be sent again at once.
const REFUSAL_INTERVAL: Duration = Duration::from_secs(1);

/// A chunk that arrived whole but is no object.
#[derive(Debug, thiserror::Error)]
pub enum DecodeError {
    /// The codec refuses it.
    #[error(transparent)]
    Codec(#[from] CodecError),
    /// Nothing in the index refers to it.
    #[error("nothing in the index refers to it")]
    Unreferenced,
}

/// What became of a chunk.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Inserted {
    /// It is at hand now.
    Held,
    /// It was there before.
    Duplicate,
    /// The pinned objects leave no room for it.
    NoRoom,
}

/// The state of the accounts.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub struct Usage {
    /// Decoded bytes held.
    pub bytes: u64,
    /// The most that was ever held.
    pub peak_bytes: u64,
    /// The cap.
    pub cap_bytes: u64,
    /// Objects held.
    pub objects: usize,
    /// Objects evicted so far.
    pub evictions: u64,
    /// Stored bytes of chunks that a frame has used since they arrived.
    pub useful_bytes: u64,
}

/// Why not everything is there.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
pub enum Incomplete {
    /// The time is up.
    #[error("{} chunks did not arrive in time, the first is {:?}", .0.len(), .0.first())]
    Timeout(Vec<u32>),
    /// These chunks are damaged on the server; everything else is there.
    #[error("{} chunks are damaged, the first is {}; check the dataset with `ldi-server verify`", .0.len(), .0.first().copied().unwrap_or_default())]
    Damaged(Vec<u32>),
    /// One view needs more than the cap.
    #[error("the view needs more decoded bytes than the cache may hold ({cap_bytes}); raise --cache-bytes")]
    NoRoom {
        /// The cap.
        cap_bytes: u64,
    },
    /// The connection is gone.
    #[error("{0}")]
    Disconnected(String),
}

/// See the module. All methods may be called from any thread; none holds the lock while it decodes.
#[derive(Debug)]
pub struct Cache {
    first: Scope,
    /// What follows if that is of a first picture only.
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
    /// An empty cache of at most `cap_bytes` decoded bytes.
    pub fn new(index: Arc<Index>, cap_bytes: u64) -> Self {
        let first = Scope::new(index);
        let inner = CacheState::new(first.table.objects.len(), first.index.chunks.len(), cap_bytes);
        Self { first, whole: OnceLock::new(), decoding: true, inner: Mutex::new(inner), changed: Condvar::new() }
    }

    /// One that keeps the accounts of what would be held, decodes nothing and gives nothing out: for load tests.
    pub fn without_decoding(index: Arc<Index>, cap_bytes: u64) -> Self {
        Self { decoding: false, ..Self::new(index, cap_bytes) }
    }

    /// The index whose chunks are held, as far as it is known.
    pub fn index(&self) -> &Arc<Index> {
        &self.scope().index
    }

    /// The whole index takes the place of that of a first picture ([`ldi_protocol::manifest::early`]); what is held stays. Once.
    pub fn complete(&self, index: Arc<Index>) {
        let scope = Scope::new(index);
        let mut inner = self.lock();
        // The tree's objects come first: those of both indices have the same numbers.
        inner.extend(scope.table.objects.len());
        let _ = self.whole.set(scope);
    }

    /// Whoever takes the lock asks for it first: objects are never fewer than the scope has.
    fn scope(&self) -> &Scope {
        self.whole.get().unwrap_or(&self.first)
    }

    fn lock(&self) -> MutexGuard<'_, CacheState> {
        // Every change is complete before anything can panic.
        self.inner.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Decodes a chunk whose hash was checked and takes it in.
    ///
    /// # Errors
    /// If the bytes are not what the index says of this chunk.
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
                (ObjectKind::Bundle | ObjectKind::Texture(_), _) => decode::bundle(self.index(), chunk, bytes)?,
            };
            if let Some(done) = self.install(part, chunk, new, version) {
                return Ok(done);
            }
        }
    }

    /// Puts a joined object in place. None when another part was joined meanwhile.
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

    /// Opens a new view: what it needs is pinned, what the last one needed no longer is.
    pub fn pin(&self, chunks: impl IntoIterator<Item = u32, IntoIter: Clone>) {
        let mut inner = self.lock();
        inner.pin(&self.scope().table, chunks.into_iter());
    }

    /// Whether the current view needs a chunk.
    pub fn is_pinned(&self, chunk: u32) -> bool {
        let inner = self.lock();
        self.scope().table.parts(chunk).iter().any(|p| inner.is_pinned(p.object))
    }

    /// Counts what is held of these as used now.
    pub fn touch(&self, chunks: impl IntoIterator<Item = u32>) {
        let mut inner = self.lock();
        for chunk in chunks {
            for part in self.scope().table.parts(chunk) {
                inner.use_now(part.object);
            }
        }
    }

    /// Counts what is held of these as used by a frame, without giving it out.
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

    /// A chunk did not come over the network: that frames use it is not counted among [`Usage::useful_bytes`].
    pub fn count_elsewhere(&self, chunk: u32) {
        let mut inner = self.lock();
        for part in self.scope().table.parts(chunk) {
            let object = &mut inner.objects[part.object as usize];
            object.used |= object.present & 1 << part.part;
        }
    }

    /// Whether a chunk is at hand.
    pub fn holds(&self, chunk: u32) -> bool {
        self.lock().holds(&self.scope().table, chunk)
    }

    /// All chunks at hand, ascending.
    pub fn held(&self) -> Vec<u32> {
        let inner = self.lock();
        (0..self.index().chunks.len() as u32).filter(|c| inner.holds(&self.scope().table, *c)).collect()
    }

    /// Those of `chunks` that are not at hand, damaged ones included.
    pub fn missing(&self, chunks: impl IntoIterator<Item = u32>) -> Vec<u32> {
        let inner = self.lock();
        chunks.into_iter().filter(|c| !inner.holds(&self.scope().table, *c)).collect()
    }

    /// A chunk came damaged so often that it is given up.
    pub fn mark_damaged(&self, chunk: u32) {
        if let Some(flag) = self.lock().damaged.get_mut(chunk as usize) {
            *flag = true;
        }
        self.changed.notify_all();
    }

    /// How many chunks were given up.
    pub fn damaged(&self) -> usize {
        self.lock().damaged.iter().filter(|d| **d).count()
    }

    /// Whether a chunk was given up.
    pub fn is_damaged(&self, chunk: u32) -> bool {
        self.lock().damaged.get(chunk as usize).copied().unwrap_or(false)
    }

    /// Nothing will arrive any more. None: a new connection is up.
    pub fn set_disconnected(&self, reason: Option<String>) {
        self.lock().disconnected = reason;
        self.changed.notify_all();
    }

    /// Why nothing will arrive any more; None while a connection is up.
    pub fn disconnected(&self) -> Option<String> {
        self.lock().disconnected.clone()
    }

    /// Waits until all of `chunks` are at hand, or will not come.
    ///
    /// # Errors
    /// [`Incomplete`]; damaged chunks are an error only after everything else has arrived.
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

    /// Chunks that left since the last call, ascending, for the server to know. Refused ones are told once in a while only.
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

    /// The accounts.
    pub fn usage(&self) -> Usage {
        self.lock().usage
    }

    /// What must hold after every call: accounts equal the sum of what is there, within the cap; the order lists exactly the
    /// objects that hold something and are not pinned.
    ///
    /// # Errors
    /// The first account that is off.
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
