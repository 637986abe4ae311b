//! An end with a message before the kernel kills the program for want of memory.
//!
//! In: what the system says of its control groups and of the machine. Out: whether less is left
//! than what the program may take until the next look. The kernel's own end (SIGKILL) says nothing
//! and cannot be caught, so the program ends itself a little earlier.

use std::{
    fmt,
    path::{Path, PathBuf},
    thread,
    time::Duration,
};

/// Free memory below which the program ends, bytes. More: memory that could be used is not; less:
/// the kernel is faster.
const LEAST_FREE: u64 = 16 << 20;
/// The same as a share of the limit.
const LEAST_FREE_SHARE: f64 = 0.01;
/// Bytes per second that a program can fill at most, for the time until the next look. Higher:
/// more looks.
const FILLED_PER_SECOND: f64 = 8e9;
/// Shortest and longest time between two looks.
const LOOKS: (Duration, Duration) = (Duration::from_millis(1), Duration::from_millis(200));
/// Limits from here on are none: version 1 writes the largest number of pages.
const NO_LIMIT: u64 = 1 << 60;

/// What limits the memory of the program: its control groups from the innermost to the outermost,
/// and the machine.
#[derive(Debug)]
pub(super) struct MemoryWatch {
    groups: Vec<Group>,
    meminfo: PathBuf,
}

/// A control group with its files.
#[derive(Debug)]
struct Group {
    folder: PathBuf,
    /// Names of the files with limit and use, and the prefix of the counts of cached pages.
    files: (&'static str, &'static str, &'static str),
}

/// Memory of which too little is left.
#[derive(Debug, PartialEq, Eq)]
pub(super) struct Shortage {
    /// None: the machine.
    group: Option<PathBuf>,
    limit: u64,
    used: u64,
}

impl fmt::Display for Shortage {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let mb = |bytes: u64| bytes.div_ceil(1_000_000);
        let (used, limit) = (mb(self.used), mb(self.limit));
        match &self.group {
            Some(group) => write!(f, "{used} MB of the {limit} MB of the control group {} are in use", group.display()),
            None => write!(f, "{used} MB of the machine's {limit} MB are in use"),
        }
    }
}

impl MemoryWatch {
    /// Reads which groups the process is in. `root` is `/`, another folder in tests.
    fn at(root: &Path) -> Self {
        let groups = std::fs::read_to_string(root.join("proc/self/cgroup")).unwrap_or_default();
        let groups = groups.lines().flat_map(|line| groups_of(root, line)).collect();
        Self { groups, meminfo: root.join("proc/meminfo") }
    }

    /// The memory of which too little is left, or the time until the next look. Files that cannot
    /// be read limit nothing.
    fn look(&self) -> Result<Duration, Shortage> {
        let meminfo = std::fs::read_to_string(&self.meminfo).unwrap_or_default();
        let swap = kib(&meminfo, "SwapFree").unwrap_or(0) * 1024;
        let groups = self.groups.iter().filter_map(|group| Some((Some(group), group.used(swap)?)));
        let machine = machine(&meminfo).map(|used| (None, used));
        let mut wait = LOOKS.1;
        for (group, (used, limit)) in groups.chain(machine) {
            let free = limit.saturating_sub(used);
            let least = LEAST_FREE.max((limit as f64 * LEAST_FREE_SHARE) as u64);
            if free <= least {
                return Err(Shortage { group: group.map(|g| g.folder.clone()), limit, used });
            }
            wait = wait.min(Duration::from_secs_f64((free - least) as f64 / FILLED_PER_SECOND));
        }
        Ok(wait.max(LOOKS.0))
    }
}

/// Looks as long as the program runs, and calls `end` when too little is left.
///
/// # Errors
/// No thread can be started.
pub(super) fn watch(end: impl FnOnce(Shortage) + Send + 'static) -> std::io::Result<()> {
    let watch = MemoryWatch::at(Path::new("/"));
    let look = move || loop {
        match watch.look() {
            Ok(wait) => thread::sleep(wait),
            Err(shortage) => return end(shortage),
        }
    };
    thread::Builder::new().name("memory".into()).spawn(look).map(drop)
}

/// The groups of a line of `/proc/self/cgroup` that have files here: the named one and all around
/// it. In a container the mount may begin at the process's own group.
fn groups_of(root: &Path, line: &str) -> Vec<Group> {
    let mut parts = line.splitn(3, ':').skip(1);
    let (Some(controllers), Some(path)) = (parts.next(), parts.next()) else { return Vec::new() };
    let (mounts, files): (&[&str], _) = match controllers {
        "" => (&["sys/fs/cgroup", "sys/fs/cgroup/unified"], ("memory.max", "memory.current", "")),
        c if c.split(',').any(|c| c == "memory") => {
            (&["sys/fs/cgroup/memory"], ("memory.limit_in_bytes", "memory.usage_in_bytes", "total_"))
        }
        _ => return Vec::new(),
    };
    let inside = |mount: &str| {
        let mount = root.join(mount);
        let own = mount.join(path.trim_start_matches('/'));
        let chain = own.ancestors().take_while(|folder| folder.starts_with(&mount)).map(Path::to_path_buf);
        chain.filter(|folder| folder.join(files.0).is_file()).collect::<Vec<_>>()
    };
    mounts.iter().flat_map(|mount| inside(mount)).map(|folder| Group { folder, files }).collect()
}

impl Group {
    /// Bytes in use that the kernel cannot take back, and the limit with what may still be swapped
    /// out of the machine's `swap` bytes; None without a limit.
    fn used(&self, swap: u64) -> Option<(u64, u64)> {
        let read = |name: &str| std::fs::read_to_string(self.folder.join(name)).ok();
        let (limit, used, prefix) = self.files;
        let limit: u64 = read(limit)?.trim().parse().ok().filter(|limit| *limit < NO_LIMIT)?;
        let used: u64 = read(used)?.trim().parse().ok()?;
        let stat = read("memory.stat")?;
        let cached = |name: &str| {
            let mut found = stat.lines().filter_map(|l| l.strip_prefix(prefix)?.strip_prefix(name));
            found.find_map(|l| l.trim().parse::<u64>().ok()).unwrap_or(0)
        };
        // Files of version 2; "max" is no number.
        let number = |name: &str| read(name)?.trim().parse::<u64>().ok();
        let swappable = number("memory.swap.max")
            .map_or(swap, |most| most.saturating_sub(number("memory.swap.current").unwrap_or(0)).min(swap));
        let kept = used.saturating_sub(cached("inactive_file ") + cached("active_file "));
        Some((kept, limit.saturating_add(swappable)))
    }
}

/// Bytes of the machine that are in use and cannot be taken back, and all that it has, with swap.
fn machine(meminfo: &str) -> Option<(u64, u64)> {
    let kib = |name| kib(meminfo, name);
    let total = kib("MemTotal")? + kib("SwapTotal").unwrap_or(0);
    let free = kib("MemAvailable")? + kib("SwapFree").unwrap_or(0);
    Some((total.saturating_sub(free) * 1024, total * 1024))
}

/// A number of `/proc/meminfo`, in KiB.
fn kib(meminfo: &str, name: &str) -> Option<u64> {
    let line = meminfo.lines().find_map(|l| l.strip_prefix(name)?.strip_prefix(':'))?;
    line.trim().trim_end_matches("kB").trim().parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    const MB: u64 = 1_000_000;

    /// A system with these files.
    fn system(name: &str, files: &[(&str, String)]) -> MemoryWatch {
        let root = std::env::temp_dir().join(format!("ldi-memory-{}-{name}", std::process::id()));
        let _ = std::fs::remove_dir_all(&root);
        for (path, text) in files {
            let path = root.join(path);
            std::fs::create_dir_all(path.parent().expect("within the root")).expect("writable");
            std::fs::write(path, text).expect("writable");
        }
        MemoryWatch::at(&root)
    }

    fn meminfo(total_mb: u64, available_mb: u64) -> (&'static str, String) {
        let text =
            format!("MemTotal: {} kB\nMemFree: 1 kB\nMemAvailable: {} kB\n", total_mb * 1000, available_mb * 1000);
        ("proc/meminfo", text)
    }

    /// Version 2 with a limit at the outer group.
    fn unified(used: u64, cached: u64, inner_limit: &str) -> [(&'static str, String); 8] {
        [
            ("proc/self/cgroup", "0::/office/house".into()),
            meminfo(64_000, 60_000),
            ("sys/fs/cgroup/office/memory.max", (1_000 * MB).to_string()),
            ("sys/fs/cgroup/office/memory.current", used.to_string()),
            ("sys/fs/cgroup/office/memory.stat", format!("anon 5\ninactive_file {cached}\nactive_file 7\n")),
            ("sys/fs/cgroup/office/house/memory.max", inner_limit.into()),
            ("sys/fs/cgroup/office/house/memory.current", used.to_string()),
            ("sys/fs/cgroup/office/house/memory.stat", String::new()),
        ]
    }

    #[test]
    fn a_group_and_those_around_it_limit_what_the_program_may_take() {
        // Half is free: the time until it could be filled.
        let wait = system("half", &unified(500 * MB, 0, "max\n")).look().unwrap();
        assert!(wait > Duration::from_millis(50) && wait < Duration::from_millis(70), "{wait:?}");
        // The outer group is full, the inner one has no limit.
        let full = system("outer", &unified(990 * MB, 0, "max\n")).look().unwrap_err();
        assert!(full.group.as_ref().is_some_and(|g| g.ends_with("office")) && full.limit == 1_000 * MB, "{full:?}");
        assert!(full.to_string().starts_with("990 MB of the 1000 MB of the control group /"), "{full}");
        // The inner one is full.
        let full = system("inner", &unified(90 * MB, 0, "100000000\n")).look().unwrap_err();
        assert!(full.group.is_some_and(|g| g.ends_with("office/house")));
        // It could still be swapped out, if it may.
        let mut swapping = unified(990 * MB, 0, "max\n").to_vec();
        swapping[1].1 += "SwapTotal: 900000 kB\nSwapFree: 900000 kB\n";
        assert!(system("swap", &swapping).look().is_ok());
        swapping.push(("sys/fs/cgroup/office/memory.swap.max", "0\n".into()));
        assert!(system("no-swap", &swapping).look().is_err());
        // What the kernel can take back is free.
        assert!(system("cached", &unified(990 * MB, 400 * MB, "max\n")).look().is_ok());
    }

    #[test]
    fn the_first_version_of_groups_is_read_too() {
        let group = |used: u64, limit: u64| {
            [
                ("proc/self/cgroup", "5:cpu,cpuacct:/\n4:memory:/not/mounted/here\n0::/\n".into()),
                ("sys/fs/cgroup/memory/memory.limit_in_bytes", limit.to_string()),
                ("sys/fs/cgroup/memory/memory.usage_in_bytes", used.to_string()),
                ("sys/fs/cgroup/memory/memory.stat", format!("inactive_file 9\ntotal_inactive_file {}\n", 50 * MB)),
            ]
        };
        let full = system("first", &group(545 * MB, 500 * MB)).look().unwrap_err();
        assert_eq!((full.used, full.limit), (495 * MB, 500 * MB));
        assert!(system("first-free", &group(245 * MB, 500 * MB)).look().is_ok());
        // As it is written where there is no limit.
        assert_eq!(system("first-none", &group(545 * MB, 9_223_372_036_854_771_712)).look(), Ok(LOOKS.1));
    }

    #[test]
    fn the_machine_itself_may_be_full_and_nothing_readable_limits_nothing() {
        let full = system("machine", &[meminfo(8_000, 60)]).look().unwrap_err();
        assert!(full.group.is_none() && full.to_string().contains("of the machine's"), "{full}");
        assert!(system("roomy", &[meminfo(8_000, 4_000)]).look().is_ok());
        assert_eq!(system("nothing", &[]).look(), Ok(LOOKS.1));
    }
}
