//! Progress of long work: a bar with rate and remaining time on a terminal, a plain line every so often elsewhere.

use crate::build::Progress;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use std::io::IsTerminal as _;
use std::sync::Mutex;
use std::time::{Duration, Instant};

/// Seconds between plain lines: often enough to see that it lives, rarely enough to keep a log readable.
const PLAIN_INTERVAL: Duration = Duration::from_secs(10);

/// Progress on stderr.
#[derive(Debug)]
pub struct Stderr {
    terminal: bool,
    state: Mutex<State>,
}

#[derive(Debug)]
struct State {
    bar: Option<ProgressBar>,
    name: String,
    steps: u64,
    done: u64,
    started: Instant,
    said: Instant,
    /// The last note, until it is said.
    unsaid: Option<String>,
}

impl Default for Stderr {
    fn default() -> Self {
        let now = Instant::now();
        let state = State { bar: None, name: String::new(), steps: 0, done: 0, started: now, said: now, unsaid: None };
        Self { terminal: std::io::stderr().is_terminal(), state: Mutex::new(state) }
    }
}

impl Stderr {
    /// Ends the last stage.
    pub fn finish(&self) {
        self.with(|s| s.end());
    }

    fn with(&self, f: impl FnOnce(&mut State)) {
        // A panic elsewhere must not hide behind one here.
        f(&mut self.state.lock().unwrap_or_else(std::sync::PoisonError::into_inner));
    }
}

impl State {
    fn end(&mut self) {
        if let Some(bar) = self.bar.take() {
            bar.finish_and_clear();
        }
        if !self.name.is_empty() {
            eprintln!("{}", self.summary(self.started.elapsed()));
        }
        self.name.clear();
    }

    /// What remains of a stage: a short one has had no other moment to say what it found.
    fn summary(&self, took: Duration) -> String {
        let count = if self.steps > 0 { format!(" ({})", self.steps) } else { String::new() };
        let note = self.unsaid.as_ref().map_or_else(String::new, |n| format!("; {n}"));
        format!("{}{count}: {:.1} s{note}", self.name, took.as_secs_f64())
    }
}

impl Progress for Stderr {
    fn stage(&self, name: &str, steps: u64) {
        self.with(|s| {
            s.end();
            let now = Instant::now();
            (s.name, s.steps, s.done, s.started, s.said, s.unsaid) = (name.into(), steps, 0, now, now, None);
            if self.terminal {
                let bar = ProgressBar::with_draw_target((steps > 0).then_some(steps), ProgressDrawTarget::stderr());
                let template = if steps > 0 {
                    "{msg} [{bar:30}] {pos}/{len} {per_sec} {eta} left"
                } else {
                    "{msg} {spinner} {elapsed}"
                };
                if let Ok(style) = ProgressStyle::with_template(template) {
                    bar.set_style(style);
                }
                bar.set_message(name.to_string());
                bar.enable_steady_tick(Duration::from_millis(200));
                s.bar = Some(bar);
            }
        });
    }

    fn note(&self, what: &str) {
        self.with(|s| {
            s.unsaid = Some(what.into());
            if let Some(bar) = &s.bar {
                bar.set_message(format!("{}: {what}", s.name));
            } else if s.said.elapsed() >= PLAIN_INTERVAL {
                s.said = Instant::now();
                eprintln!("{}: {what}", s.name);
                s.unsaid = None;
            }
        });
    }

    fn advance(&self, steps: u64) {
        self.with(|s| {
            s.done += steps;
            if let Some(bar) = &s.bar {
                bar.set_position(s.done);
            } else if s.said.elapsed() >= PLAIN_INTERVAL && s.done > 0 {
                s.said = Instant::now();
                let rate = s.done as f64 / s.started.elapsed().as_secs_f64();
                let left = s.steps.saturating_sub(s.done) as f64 / rate;
                eprintln!("{}: {} of {}, {rate:.2} per second, {left:.0} s left", s.name, s.done, s.steps);
            }
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stage_that_was_too_short_to_say_what_it_found_says_so_at_its_end() {
        let progress = Stderr { terminal: false, ..Stderr::default() };
        let summary = || {
            let mut found = String::new();
            progress.with(|s| found = s.summary(Duration::from_millis(1_230)));
            found
        };
        progress.stage("clusters", 20);
        assert_eq!(summary(), "clusters (20): 1.2 s");
        progress.note("budget: 8000 of 20000 triangles");
        assert_eq!(summary(), "clusters (20): 1.2 s; budget: 8000 of 20000 triangles");
        progress.stage("grid", 0);
        assert_eq!(summary(), "grid: 1.2 s", "another stage's note is not its own");
        progress.with(|s| s.said -= PLAIN_INTERVAL);
        progress.note("round 1");
        assert_eq!(summary(), "grid: 1.2 s", "it was said already");
    }
}
