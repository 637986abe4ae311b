//! A display without a screen, and a hand on its keyboard and mouse.

use std::{
    io::{BufRead as _, BufReader},
    path::{Path, PathBuf},
    process::{Child, Command, Stdio},
};

/// A program on the path.
fn find(name: &str) -> Option<PathBuf> {
    std::env::split_paths(&std::env::var_os("PATH")?).map(|d| d.join(name)).find(|p| p.is_file())
}

/// An X server of our own; stopped when dropped.
pub struct Display {
    server: Child,
    name: String,
}

impl Display {
    /// Starts one.
    ///
    /// # Errors
    /// What is absent on this machine.
    pub fn start(width: u32, height: u32) -> Result<Self, String> {
        for tool in ["Xvfb", "xdotool"] {
            find(tool).ok_or_else(|| format!("{tool} is not installed"))?;
        }
        // It picks a free number by itself and says it. Without -noreset it begins anew whenever
        // its last client leaves, as one does that only looks for drivers, and the next client
        // finds nobody for a moment.
        let mut server = Command::new("Xvfb")
            .args(["-displayfd", "1", "-nolisten", "tcp", "-noreset", "-screen", "0", &format!("{width}x{height}x24")])
            .stdout(Stdio::piped())
            .stderr(Stdio::null())
            .spawn()
            .map_err(|e| format!("Xvfb does not start: {e}"))?;
        let mut number = String::new();
        let read = server.stdout.take().map(|out| BufReader::new(out).read_line(&mut number));
        if !matches!(read, Some(Ok(n)) if n > 1) {
            let _ = server.kill();
            let _ = server.wait();
            return Err("Xvfb ended without a display".into());
        }
        Ok(Self { server, name: format!(":{}", number.trim()) })
    }

    /// A program that shows its windows here.
    pub fn show(&self, program: &mut Command, home: &Path) {
        program.env("DISPLAY", &self.name).env_remove("WAYLAND_DISPLAY").env_remove("WAYLAND_SOCKET");
        program.env("HOME", home).env("XDG_RUNTIME_DIR", home).env_remove("XDG_CONFIG_HOME").env_remove("LDI_TOKEN");
    }

    /// Keys and mouse, as `xdotool` takes them.
    pub fn hand(&self, arguments: &[&str]) -> String {
        let out = Command::new("xdotool").env("DISPLAY", &self.name).args(arguments).output().expect("xdotool runs");
        let said = String::from_utf8_lossy(&out.stdout).trim().to_owned();
        assert!(out.status.success(), "xdotool {arguments:?}: {said} {}", String::from_utf8_lossy(&out.stderr));
        said
    }
}

impl Drop for Display {
    fn drop(&mut self) {
        let _ = self.server.kill();
        let _ = self.server.wait();
    }
}
