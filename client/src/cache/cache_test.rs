//! Accounts, eviction and joining, checked after every step.

use super::{
    fixture::{BUNDLE, FIRST_CELL, LDI, Street, TEXTURE, street},
    *,
};
use ldi_protocol::index::ChunkKind;
use proptest::prelude::*;
use std::collections::BTreeSet;

const CELLS: u32 = 6;

fn empty(cap_bytes: u64) -> (Cache, Street) {
    let street = street(CELLS, 16);
    (Cache::new(Arc::new(street.index.clone()), cap_bytes), street)
}

fn put(cache: &Cache, street: &Street, chunk: u32) -> Inserted {
    let done = cache.insert(chunk, &street.chunks[chunk as usize]).unwrap();
    cache.check().unwrap();
    done
}

fn decoded(street: &Street, chunk: u32) -> u64 {
    u64::from(street.index.chunks[chunk as usize].decoded_bytes)
}

#[test]
fn what_is_put_in_is_at_hand() {
    let (cache, street) = empty(1 << 30);
    assert!(cache.cell(0).is_none());
    for chunk in 0..street.chunks.len() as u32 {
        assert!(!cache.holds(chunk));
        assert_eq!(put(&cache, &street, chunk), Inserted::Held);
        assert_eq!(put(&cache, &street, chunk), Inserted::Duplicate);
        assert!(cache.holds(chunk));
    }
    assert_eq!(cache.cell(1).unwrap().instances.len(), 2);
    assert_eq!(cache.bundle(BUNDLE).unwrap().clusters.len(), 1);
    assert_eq!(cache.ldi(0).unwrap().layers.len(), 2);
    assert!(cache.texture(0).unwrap().levels.iter().all(Option::is_some));
    assert!(cache.cell(99).is_none() && cache.ldi(99).is_none() && cache.texture(9).is_none());
    assert_eq!(cache.usage().bytes, street.index.chunks.iter().map(|c| u64::from(c.decoded_bytes)).sum::<u64>());
}

#[test]
fn a_cache_of_a_first_picture_goes_on_with_the_whole_index() {
    let street = street(CELLS, 16).with_tree();
    let whole = Arc::new(street.index.clone());
    let root = whole.tree.as_ref().unwrap().root_chunk;
    let mut few = street.index.clone();
    (few.cells, few.points, few.placements, few.images) = (vec![], vec![], vec![], vec![]);
    (few.textures, few.materials) = (vec![], vec![]);
    for (number, chunk) in (0u32..).zip(&mut few.chunks) {
        if number != root {
            (chunk.kind, chunk.stored_bytes, chunk.decoded_bytes) = (ChunkKind::Page, 0, 0);
        }
    }
    let cache = Cache::new(Arc::new(few), 1 << 30);
    assert!(!cache.index().is_whole());
    assert!(matches!(cache.insert(FIRST_CELL, &street.chunks[FIRST_CELL as usize]), Err(DecodeError::Unreferenced)));
    assert_eq!(put(&cache, &street, root), Inserted::Held);
    cache.pin([root]);
    let held = cache.brood(root).unwrap();
    cache.complete(whole.clone());
    cache.check().unwrap();
    assert!(cache.index().is_whole() && Arc::ptr_eq(cache.index(), &whole));
    assert!(Arc::ptr_eq(&held, &cache.brood(root).unwrap()) && cache.is_pinned(root));
    for chunk in (0..root).rev() {
        assert_eq!(put(&cache, &street, chunk), Inserted::Held);
    }
    assert_eq!(cache.held().len(), street.chunks.len());
    assert_eq!(cache.cell(1).unwrap().instances.len(), 2);
    assert_eq!(cache.ldi(0).unwrap().layers.len(), 2);
}

#[test]
fn parts_join_in_any_order() {
    let street = street(CELLS, 16);
    let whole = {
        let cache = Cache::new(Arc::new(street.index.clone()), 1 << 30);
        for chunk in LDI.into_iter().chain(TEXTURE) {
            put(&cache, &street, chunk);
        }
        (cache.ldi(0).unwrap(), cache.texture(0).unwrap())
    };
    let cache = Cache::new(Arc::new(street.index.clone()), 1 << 30);
    put(&cache, &street, LDI[1]);
    assert!(cache.ldi(0).is_none(), "no LDI without its first layer");
    put(&cache, &street, TEXTURE[1]);
    let partial = cache.texture(0).unwrap();
    assert!(partial.levels[0].is_some() && partial.levels[1].is_none());
    put(&cache, &street, LDI[0]);
    put(&cache, &street, TEXTURE[0]);
    assert_eq!((cache.ldi(0).unwrap(), cache.texture(0).unwrap()), whole);
    assert!(partial.levels[1].is_none(), "a frame keeps what it holds");
}

#[test]
fn the_least_recently_used_goes_first_and_the_pinned_stays() {
    let street = street(CELLS, 16);
    // Even cells have the same size.
    let [a, b, c] = [0, 2, 4].map(|i| FIRST_CELL + i);
    let size = decoded(&street, a);
    assert_eq!([size; 2], [b, c].map(|x| decoded(&street, x)));
    let cache = Cache::new(Arc::new(street.index.clone()), 2 * size);
    put(&cache, &street, a);
    cache.pin([b]);
    put(&cache, &street, b);
    cache.pin([b]);
    cache.cell(0);
    cache.pin([]);
    cache.cell(2);
    // b was used last, a goes.
    assert_eq!(put(&cache, &street, c), Inserted::Held);
    assert!(!cache.holds(a) && cache.holds(b) && cache.holds(c));
    assert_eq!(cache.take_evicted(Instant::now()), [a]);
    assert!(cache.take_evicted(Instant::now()).is_empty());
    // Both are pinned: no room.
    cache.pin([b, c]);
    assert_eq!(put(&cache, &street, a), Inserted::NoRoom);
    assert!(cache.holds(b) && cache.holds(c));
    assert_eq!(cache.usage().evictions, 1);
}

#[test]
fn what_is_dear_to_bring_stays_longer_and_ages_too() {
    let street = street(CELLS, 16);
    let worth = |c: u32| f64::from(street.index.chunks[c as usize].stored_bytes) / decoded(&street, c) as f64;
    // Noise does not compress; cells of one square do.
    let (dear, cells) = (TEXTURE[1], [0, 2, 4].map(|i| FIRST_CELL + i));
    assert!(cells.iter().all(|c| worth(*c) < worth(dear)));
    let cache = Cache::new(Arc::new(street.index.clone()), decoded(&street, dear) + decoded(&street, cells[0]));
    put(&cache, &street, dear);
    cache.pin([]);
    put(&cache, &street, cells[0]);
    cache.pin([]);
    // The newer, cheaper one goes.
    put(&cache, &street, cells[1]);
    assert!(cache.holds(dear) && !cache.holds(cells[0]));
    // Not for ever: cheap ones that are used one after another wear it out.
    let rounds = (0..1000).take_while(|round| {
        cache.pin([]);
        put(&cache, &street, cells[round % 3]);
        cache.holds(dear)
    });
    let rounds = rounds.count();
    assert!((1..900).contains(&rounds), "{rounds} rounds");
}

#[test]
fn touching_protects() {
    let street = street(CELLS, 16);
    let [a, b, c] = [0, 2, 4].map(|i| FIRST_CELL + i);
    let cache = Cache::new(Arc::new(street.index.clone()), 2 * decoded(&street, a));
    put(&cache, &street, a);
    cache.pin([]);
    put(&cache, &street, b);
    cache.pin([]);
    cache.touch([a]);
    put(&cache, &street, c);
    assert!(cache.holds(a) && !cache.holds(b));
}

#[test]
fn damaged_and_foreign_bytes_are_refused_and_change_nothing() {
    let (cache, street) = empty(1 << 30);
    assert!(cache.insert(FIRST_CELL, b"not a cell").is_err());
    assert!(cache.insert(9999, b"").is_err());
    // A whole chunk of another kind, and of the same kind for another place.
    assert!(cache.insert(FIRST_CELL, &street.chunks[LDI[0] as usize]).is_err());
    assert!(cache.insert(TEXTURE[0], &street.chunks[TEXTURE[1] as usize]).is_err());
    cache.check().unwrap();
    assert_eq!(cache.usage().bytes, 0);
}

/// A server that announces less than a chunk takes would make the cap worthless.
#[test]
fn chunks_that_take_more_memory_than_announced_are_refused() {
    let (_, street) = empty(1 << 30);
    for chunk in 0..street.chunks.len() as u32 {
        let mut index = street.index.clone();
        index.chunks[chunk as usize].decoded_bytes -= 1;
        let cache = Cache::new(Arc::new(index), 1 << 30);
        // Deeper layers are judged once the first is there.
        let refused = cache.insert(chunk, &street.chunks[chunk as usize]).is_err()
            || chunk == LDI[1] && cache.insert(LDI[0], &street.chunks[LDI[0] as usize]).is_ok() && {
                cache.ldi(0).is_some_and(|l| l.layers.len() == 1)
            };
        assert!(refused, "chunk {chunk}");
    }
}

#[test]
fn waiting_ends_when_the_last_chunk_comes_or_will_not_come() {
    let (cache, street) = empty(1 << 30);
    let cache = Arc::new(cache);
    let short = Duration::from_millis(20);
    let wanted = [FIRST_CELL, LDI[0]];
    assert_eq!(cache.wait(&wanted, short), Err(Incomplete::Timeout(wanted.to_vec())));
    put(&cache, &street, FIRST_CELL);
    let waiting = {
        let cache = cache.clone();
        std::thread::spawn(move || cache.wait(&wanted, Duration::from_secs(20)))
    };
    put(&cache, &street, LDI[0]);
    assert_eq!(waiting.join().unwrap(), Ok(()));
    cache.mark_damaged(LDI[1]);
    assert_eq!(cache.wait(&[LDI[0], LDI[1]], short), Err(Incomplete::Damaged(vec![LDI[1]])));
    assert_eq!(cache.missing(LDI), [LDI[1]]);
    cache.set_disconnected(Some("gone".into()));
    assert_eq!(cache.wait(&[BUNDLE], Duration::from_secs(20)), Err(Incomplete::Disconnected("gone".into())));
}

#[test]
fn a_view_beyond_the_cap_says_so_and_the_refusal_is_told_once_in_a_while() {
    let street = street(CELLS, 16);
    let cap_bytes = decoded(&street, FIRST_CELL);
    let cache = Cache::new(Arc::new(street.index.clone()), cap_bytes);
    let view = [FIRST_CELL, FIRST_CELL + 2];
    cache.pin(view);
    put(&cache, &street, view[0]);
    assert_eq!(put(&cache, &street, view[1]), Inserted::NoRoom);
    assert_eq!(cache.wait(&view, Duration::from_secs(20)), Err(Incomplete::NoRoom { cap_bytes }));
    let now = Instant::now();
    assert_eq!(cache.take_evicted(now), [view[1]]);
    assert_eq!(put(&cache, &street, view[1]), Inserted::NoRoom);
    assert!(cache.take_evicted(now).is_empty(), "not at once again");
    assert_eq!(cache.take_evicted(now + REFUSAL_INTERVAL), [view[1]]);
}

#[test]
fn bytes_are_useful_when_a_frame_used_them() {
    let (cache, street) = empty(1 << 30);
    let stored = |c: u32| street.chunks[c as usize].len() as u64;
    put(&cache, &street, LDI[0]);
    put(&cache, &street, FIRST_CELL);
    assert_eq!(cache.usage().useful_bytes, 0);
    cache.ldi(0);
    cache.ldi(0);
    assert_eq!(cache.usage().useful_bytes, stored(LDI[0]));
    put(&cache, &street, LDI[1]);
    cache.ldi(0);
    assert_eq!(cache.usage().useful_bytes, stored(LDI[0]) + stored(LDI[1]));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]
    #[test]
    fn accounts_hold_whatever_happens(
        cap in 0u64..40_000,
        steps in proptest::collection::vec((0u8..4, 0u32..11, 0u32..11), 1..60),
    ) {
        let (cache, street) = empty(cap);
        let mut held = BTreeSet::new();
        for (what, a, b) in steps {
            match what {
                0 | 1 => {
                    if cache.insert(a, &street.chunks[a as usize]).unwrap() == Inserted::Held {
                        held.insert(a);
                    }
                }
                2 => cache.pin([a, b]),
                _ => cache.touch([a, b]),
            }
            if let Err(e) = cache.check() {
                prop_assert!(false, "{e}");
            }
            for gone in cache.take_evicted(Instant::now()) {
                held.remove(&gone);
            }
            // What the server believes is what is there.
            prop_assert_eq!(cache.held(), held.iter().copied().collect::<Vec<_>>());
            prop_assert!(cache.usage().peak_bytes <= cap);
        }
    }
}

#[test]
fn without_decoding_the_accounts_are_the_same_and_nothing_is_given_out() {
    let (decoding, street) = empty(1 << 30);
    let bare = Cache::without_decoding(decoding.index().clone(), 1 << 30);
    for chunk in 0..street.chunks.len() as u32 {
        put(&decoding, &street, chunk);
        assert_eq!(put(&bare, &street, chunk), Inserted::Held);
        assert_eq!(put(&bare, &street, chunk), Inserted::Duplicate);
    }
    assert_eq!(bare.usage(), decoding.usage());
    assert_eq!(bare.held(), decoding.held());
    assert!(bare.cell(0).is_none() && bare.ldi(0).is_none() && bare.texture(0).is_none());
}

#[test]
fn what_is_counted_as_used_counts_once_and_only_when_it_is_there() {
    let (cache, street) = empty(1 << 30);
    let stored = |c: u32| u64::from(street.index.chunks[c as usize].stored_bytes);
    put(&cache, &street, LDI[0]);
    cache.count_used([LDI[0], LDI[1], FIRST_CELL]);
    assert_eq!(cache.usage().useful_bytes, stored(LDI[0]));
    put(&cache, &street, LDI[1]);
    cache.count_used([LDI[0], LDI[1]]);
    cache.count_used([LDI[0], LDI[1]]);
    assert_eq!(cache.usage().useful_bytes, stored(LDI[0]) + stored(LDI[1]));
    // A frame that draws it finds nothing new.
    assert!(cache.ldi(0).is_some());
    assert_eq!(cache.usage().useful_bytes, stored(LDI[0]) + stored(LDI[1]));
}
