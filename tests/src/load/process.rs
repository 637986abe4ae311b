//! What the system says of a running process: processor time, memory, descriptors, threads. Linux
//! only; elsewhere nothing is known, and the report says so.

use std::{fs, path::PathBuf};

/// Clock ticks per second in `/proc/PID/stat`: USER_HZ, 100 on every Linux in use.
const TICKS_PER_S: f64 = 100.0;

/// A process by its number.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct Process(pub u32);

impl Process {
    /// This process.
    pub fn this() -> Self {
        Self(std::process::id())
    }

    fn file(self, name: &str) -> PathBuf {
        PathBuf::from(format!("/proc/{}/{name}", self.0))
    }

    /// Processor seconds so far, user and system, all threads; to a hundredth. None when there is
    /// no such process.
    pub fn cpu_s(self) -> Option<f64> {
        cpu_ticks(&fs::read_to_string(self.file("stat")).ok()?).map(|t| t as f64 / TICKS_PER_S)
    }

    /// Resident bytes now.
    pub fn rss_bytes(self) -> Option<u64> {
        number(&fs::read_to_string(self.file("status")).ok()?, "VmRSS:").map(|k| k * 1024)
    }
    /// Resident bytes of its own, without mapped files.
    pub fn anonymous_bytes(self) -> Option<u64> {
        number(&fs::read_to_string(self.file("status")).ok()?, "RssAnon:").map(|k| k * 1024)
    }
    /// Open file descriptors.
    pub fn descriptors(self) -> Option<u64> {
        Some(fs::read_dir(self.file("fd")).ok()?.count() as u64)
    }
    /// Threads.
    pub fn threads(self) -> Option<u64> {
        number(&fs::read_to_string(self.file("status")).ok()?, "Threads:")
    }
}

/// Bytes of memory that can be had without swapping.
pub fn available_bytes() -> Option<u64> {
    number(&fs::read_to_string("/proc/meminfo").ok()?, "MemAvailable:").map(|k| k * 1024)
}

/// utime + stime. The name before them is in brackets and may hold anything, brackets and blanks
/// too.
fn cpu_ticks(stat: &str) -> Option<u64> {
    let mut fields = stat.rsplit_once(')')?.1.split_whitespace().skip(11);
    let (user, system): (u64, u64) = (fields.next()?.parse().ok()?, fields.next()?.parse().ok()?);
    Some(user + system)
}

/// The number of a field, whatever its unit.
fn number(text: &str, field: &str) -> Option<u64> {
    text.lines().find_map(|l| l.strip_prefix(field))?.split_whitespace().next()?.parse().ok()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_name_with_brackets_does_not_shift_the_fields() {
        let stat = "7 (a) b (c) S 1 7 7 0 -1 4194304 100 0 0 0 250 31 0 0 20 0 1 0 5 6 7";
        assert_eq!(cpu_ticks(stat), Some(281));
        assert_eq!(cpu_ticks("7 (x) S 1"), None);
        assert_eq!(number("Name:\tx\nVmRSS:\t  12 kB\n", "VmRSS:"), Some(12));
    }

    #[test]
    #[cfg(target_os = "linux")]
    fn this_process_uses_something() {
        assert!(Process::this().rss_bytes().is_some_and(|b| b > 100_000));
        assert!(Process::this().cpu_s().is_some());
        assert!(Process::this().threads() >= Some(1) && Process::this().descriptors() >= Some(3));
        assert_eq!(Process(u32::MAX).cpu_s(), None);
    }
}
