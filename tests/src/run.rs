//! Running the project's own binaries as a user would: from the directory of the running program.

use anyhow::{Context as _, Result, bail};
use std::io::{BufRead as _, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

/// Where the binaries of this build lie: beside the running program, or one up where that is a
/// test.
pub fn bin_dir() -> Result<PathBuf> {
    let exe = std::env::current_exe().context("the running program's own path is unknown")?;
    let dir = exe.parent().context("the running program has no folder")?;
    Ok(if dir.ends_with("deps") { dir.parent().unwrap_or(dir).to_path_buf() } else { dir.to_path_buf() })
}

/// A command of the project by name, `ldi-server` or `ldi-client`.
pub fn command(name: &str) -> Result<Command> {
    let path = bin_dir()?.join(name);
    if !path.is_file() {
        bail!("{} is not there: run `cargo build --release --bins` first", path.display());
    }
    Ok(Command::new(path))
}

/// Runs a command to its end; an error carries its stderr.
pub fn run(mut c: Command) -> Result<Output> {
    let shown = show(&c);
    let out = c.output().with_context(|| format!("cannot start {shown}"))?;
    if !out.status.success() {
        bail!("{shown}: {}\n{}", out.status, String::from_utf8_lossy(&out.stderr).trim());
    }
    Ok(out)
}

/// A command as one would type it, with paths relative to the working directory where they lie
/// below it.
pub fn show(c: &Command) -> String {
    let name = Path::new(c.get_program()).file_name().unwrap_or_default().to_string_lossy().into_owned();
    let quote =
        |a: std::borrow::Cow<'_, str>| if a.contains(['?', '&', ' ']) { format!("'{a}'") } else { a.into_owned() };
    c.get_args().fold(name, |s, a| s + " " + &quote(a.to_string_lossy()))
}

/// A running `ldi-server serve`; stopped when dropped.
pub struct Server {
    child: Child,
    /// QUIC address.
    pub quic: String,
    /// HTTP address.
    pub http: String,
    /// Fingerprint of its certificate.
    pub fingerprint: String,
}

impl Server {
    /// Serves a dataset on free ports of the loopback and waits, at most a minute, until it
    /// listens.
    pub fn start(dataset: &Path) -> Result<Self> {
        Self::start_at(dataset, "127.0.0.1:0")
    }

    /// The same at an address of the caller's choice.
    pub fn start_at(dataset: &Path, listen: &str) -> Result<Self> {
        let mut c = command("ldi-server")?;
        c.arg("serve").arg(dataset).args(["--listen", listen, "--http", "127.0.0.1:0"]);
        let shown = show(&c);
        let mut child =
            c.stdout(Stdio::piped()).stderr(Stdio::null()).spawn().with_context(|| format!("cannot start {shown}"))?;
        let stdout = child.stdout.take().context("no stdout")?;
        let (tx, rx) = std::sync::mpsc::channel();
        std::thread::spawn(move || {
            for line in BufReader::new(stdout).lines().map_while(Result::ok) {
                if tx.send(line).is_err() {
                    break;
                }
            }
        });
        let until = Instant::now() + Duration::from_secs(60);
        while let Ok(line) = rx.recv_timeout(until.saturating_duration_since(Instant::now())) {
            let field = |name: &str| line.split_whitespace().find_map(|w| w.strip_prefix(name)).map(str::to_string);
            if let (true, Some(quic), Some(http), Some(fingerprint)) =
                (line.starts_with("listening "), field("quic="), field("http="), field("fingerprint="))
            {
                return Ok(Self { child, quic, http, fingerprint });
            }
        }
        let _ = child.kill();
        let _ = child.wait();
        bail!("{shown}: it did not say that it listens; run it by hand to see why")
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        // Nothing can be lost: a served dataset is read only.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}
