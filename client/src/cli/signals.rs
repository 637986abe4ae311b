//! SIGINT and SIGTERM: the first signal ends a walk in order, the next one ends the process.

use std::{
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    time::{Duration, Instant},
};

/// Exit code of a process that SIGINT ended, by the shell's convention.
const INTERRUPTED: i32 = 130;

/// Signals within this time of the first count as the same one: a parent process (such as
/// `timeout`) may forward a signal that the terminal sends as well.
const SAME: Duration = Duration::from_millis(500);

/// Returns a flag that the first signal sets; `said` is then printed. The next signal ends the
/// process at once.
///
/// # Errors
/// If the system gives no signal handler or no thread.
pub fn stop_at_signal(said: &'static str) -> std::io::Result<Arc<AtomicBool>> {
    let stop = Arc::new(AtomicBool::new(false));
    let runtime = tokio::runtime::Builder::new_current_thread().enable_io().build()?;
    let entered = runtime.enter();
    let mut signals = Signals::listen()?;
    drop(entered);
    let flag = Arc::clone(&stop);
    std::thread::Builder::new().name("signals".into()).spawn(move || {
        runtime.block_on(async {
            signals.next().await;
            flag.store(true, Ordering::Relaxed);
            eprintln!("ldi-client: {said}");
            let first = Instant::now();
            while first.elapsed() < SAME {
                signals.next().await;
            }
            std::process::exit(INTERRUPTED);
        });
    })?;
    Ok(stop)
}

#[cfg(unix)]
struct Signals {
    terminate: tokio::signal::unix::Signal,
    interrupt: tokio::signal::unix::Signal,
}

#[cfg(unix)]
impl Signals {
    fn listen() -> std::io::Result<Self> {
        use tokio::signal::unix::{SignalKind, signal};
        Ok(Self { terminate: signal(SignalKind::terminate())?, interrupt: signal(SignalKind::interrupt())? })
    }
    async fn next(&mut self) {
        tokio::select! {
            _ = self.terminate.recv() => {}
            _ = self.interrupt.recv() => {}
        }
    }
}

#[cfg(not(unix))]
struct Signals;

#[cfg(not(unix))]
impl Signals {
    fn listen() -> std::io::Result<Self> {
        Ok(Self)
    }
    async fn next(&mut self) {
        // Without a handler Ctrl-C ends the process, as it would without this.
        let _ = tokio::signal::ctrl_c().await;
    }
}
