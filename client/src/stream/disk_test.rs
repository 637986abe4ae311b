use super::*;
use std::time::Duration;

fn folder(name: &str) -> PathBuf {
    let folder = std::env::temp_dir().join(format!("ldi-disk-{name}-{}", std::process::id()));
    let _ = fs::remove_dir_all(&folder);
    folder
}

fn chunk(i: u32, bytes: usize) -> (ChunkHash, Vec<u8>) {
    let bytes: Vec<u8> = i.to_le_bytes().into_iter().cycle().take(bytes).collect();
    (ChunkHash(*blake3::hash(&bytes).as_bytes()), bytes)
}

#[test]
fn what_was_kept_is_read_again_by_another_and_nothing_else_is() {
    let folder = folder("kept");
    let (name, bytes) = chunk(1, 1000);
    let cache = DiskCache::open(&folder, 1 << 20).unwrap();
    assert!(!cache.has(&name, 1000) && cache.load(&name, 1000).is_none());
    cache.store(&name, &bytes);
    let other = DiskCache::open(&folder, 1 << 20).unwrap();
    assert!(other.has(&name, 1000) && !other.has(&name, 999));
    assert_eq!(other.load(&name, 1000), Some(bytes));
    assert_eq!(other.bytes(), 1000, "nothing unfinished is left");
    assert_eq!(parse_name(&name.to_string()), Some(name));
    assert_eq!([parse_name("ab"), parse_name(&"zz".repeat(32)), parse_name(&"+1".repeat(32))], [None, None, None]);
    let _ = fs::remove_dir_all(folder);
}

#[test]
fn a_damaged_file_is_removed_and_can_be_kept_anew() {
    let folder = folder("damaged");
    let cache = DiskCache::open(&folder, 1 << 20).unwrap();
    let (name, bytes) = chunk(7, 500);
    let path = cache.path_of(&name);
    let damages: [fn(&mut Vec<u8>); 3] = [|b| b[250] ^= 1, |b| b.truncate(499), |b| b.push(0)];
    for damage in damages {
        cache.store(&name, &bytes);
        let mut wrong = bytes.clone();
        damage(&mut wrong);
        fs::write(&path, &wrong).unwrap();
        assert_eq!(cache.load(&name, 500), None);
        assert!(!path.exists());
    }
    cache.store(&name, &bytes);
    assert_eq!(cache.load(&name, 500), Some(bytes));
    let _ = fs::remove_dir_all(folder);
}

#[test]
fn the_cap_is_kept_and_the_least_recently_used_go() {
    let folder = folder("cap");
    let cap = 100_000;
    let cache = DiskCache::open(&folder, cap).unwrap();
    let old = SystemTime::now() - Duration::from_secs(1000);
    for i in 0..100 {
        let (name, bytes) = chunk(i, 5_000);
        cache.store(&name, &bytes);
        assert!(cache.bytes() <= cap, "{} bytes after {i}", cache.bytes());
        // Modification times of a file system may be coarse: told apart by hand.
        File::open(cache.path_of(&name)).unwrap().set_modified(old + Duration::from_secs(u64::from(i))).unwrap();
        // The first one is used all the time.
        let (first, _) = chunk(0, 5_000);
        assert!(cache.load(&first, 5_000).is_some(), "after {i}");
    }
    assert!(cache.bytes() > cap / 2);
    let kept: Vec<u32> = (0..100).filter(|i| cache.has(&chunk(*i, 5_000).0, 5_000)).collect();
    let recent = 100 - (kept.len() as u32 - 1)..100;
    assert_eq!(kept[1..], recent.collect::<Vec<_>>(), "the rest are the newest");
    let (name, large) = chunk(200, 100_001);
    cache.store(&name, &large);
    assert!(!cache.has(&name, 100_001), "larger than the cap");
    assert!(DiskCache::open(&folder, 20_000).unwrap().bytes() <= 20_000, "a smaller cap");
    let _ = fs::remove_dir_all(folder);
}

/// Four clients store, load and evict the same chunks at once: whatever is loaded is right, nothing
/// unfinished is left, and the cap holds within what the module says.
#[test]
fn clients_share_a_folder() {
    let folder = folder("shared");
    let (cap, clients) = (200_000u64, 4u64);
    std::thread::scope(|scope| {
        for client in 0..clients {
            let folder = &folder;
            scope.spawn(move || {
                let cache = DiskCache::open(folder, cap).unwrap();
                for i in 0..300u64 {
                    let (name, bytes) = chunk(((i * (2 * client + 1)) % 97) as u32, 4_000);
                    match cache.load(&name, 4_000) {
                        Some(found) => assert_eq!(found, bytes),
                        None => cache.store(&name, &bytes),
                    }
                }
            });
        }
    });
    let cache = DiskCache { cap_bytes: u64::MAX, ..DiskCache::open(&folder, u64::MAX).unwrap() };
    assert!(cache.entries().iter().all(|e| e.bytes == 4_000 && e.path.extension().is_none()), "{:?}", cache.entries());
    let bytes = cache.bytes();
    assert!(bytes > 0 && bytes <= cap + clients * (cap / 16 + 4_000), "{bytes}");
    let _ = fs::remove_dir_all(folder);
}
