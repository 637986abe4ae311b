//! Progress of long work on stderr: a bar with rate and remaining time, a plain line every so
//! often, or a JSON object per line.

use super::args::{ProgressArgs, ProgressForm};
use crate::build::Progress;
use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};
use serde_json::{Value, json};
use std::io::IsTerminal as _;
use std::sync::Mutex;
use std::time::{Duration, Instant};

/// Seconds between plain lines: often enough to see that it lives, rarely enough to keep a log
/// readable.
const PLAIN_INTERVAL: Duration = Duration::from_secs(10);
/// Seconds between JSON lines, for a program that shows them.
const JSON_INTERVAL: Duration = Duration::from_secs(1);

/// Progress on stderr.
#[derive(Debug)]
pub struct Stderr {
    /// None: quiet.
    form: Option<ProgressForm>,
    state: Mutex<State>,
}

#[derive(Debug)]
struct State {
    form: Option<ProgressForm>,
    bar: Option<ProgressBar>,
    name: String,
    steps: u64,
    done: u64,
    /// Of these, what an earlier build had done.
    skipped: u64,
    started: Instant,
    said: Instant,
    /// The last note, until it is said.
    unsaid: Option<String>,
}

impl Stderr {
    /// In the form that was asked for; else a bar on a terminal and plain lines elsewhere.
    pub fn new(asked: &ProgressArgs) -> Self {
        let usual = if std::io::stderr().is_terminal() { ProgressForm::Bar } else { ProgressForm::Plain };
        Self::of((!asked.quiet).then(|| asked.progress.unwrap_or(usual)))
    }

    fn of(form: Option<ProgressForm>) -> Self {
        let now = Instant::now();
        let state = State {
            form,
            bar: None,
            name: String::new(),
            steps: 0,
            done: 0,
            skipped: 0,
            started: now,
            said: now,
            unsaid: None,
        };
        Self { form, state: Mutex::new(state) }
    }

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
        let took = self.started.elapsed();
        match self.form {
            _ if self.name.is_empty() => {}
            Some(ProgressForm::Json) => eprintln!("{}", self.summary_json(took)),
            Some(_) => eprintln!("{}", self.summary(took)),
            None => {}
        }
        self.name.clear();
    }

    fn go_on(&mut self, steps: u64) {
        self.done += steps;
        if let Some(bar) = &self.bar {
            bar.set_position(self.done);
            if self.done == self.skipped {
                // Time left is told by what takes time.
                bar.reset_eta();
            }
        } else if self.is_time() {
            self.said = Instant::now();
            let took = self.started.elapsed();
            match self.form {
                Some(ProgressForm::Json) => eprintln!("{}", self.progress_json(took)),
                _ => eprintln!("{}", self.progress(took)),
            }
        }
    }

    /// Whether the next line is due.
    fn is_time(&self) -> bool {
        let interval = match self.form {
            Some(ProgressForm::Json) => JSON_INTERVAL,
            Some(_) => PLAIN_INTERVAL,
            None => return false,
        };
        self.said.elapsed() >= interval
    }

    fn progress_json(&self, took: Duration) -> Value {
        let Self { name, done, steps, skipped, .. } = self;
        let per_s = done.saturating_sub(*skipped) as f64 / took.as_secs_f64();
        let left_s = (per_s > 0.0).then(|| steps.saturating_sub(*done) as f64 / per_s);
        json!({ "event": "progress", "stage": name, "done": done, "steps": steps, "skipped": skipped, "left_s": left_s })
    }

    fn summary_json(&self, took: Duration) -> Value {
        let Self { name, steps, skipped, unsaid, .. } = self;
        let seconds = took.as_secs_f64();
        json!({ "event": "end", "stage": name, "steps": steps, "skipped": skipped, "seconds": seconds, "note": unsaid })
    }

    /// How far a stage of known steps is. What an earlier build left tells nothing of the time
    /// that the rest takes.
    fn progress(&self, took: Duration) -> String {
        let Self { name, done, steps, skipped, .. } = self;
        let made = done.saturating_sub(*skipped);
        if made == 0 {
            return format!("{name}: {done} of {steps}");
        }
        let rate = made as f64 / took.as_secs_f64();
        let left = steps.saturating_sub(*done) as f64 / rate;
        let before = if *skipped > 0 { format!(" ({skipped} made before)") } else { String::new() };
        format!("{name}: {done} of {steps}{before}, {rate:.2} per second, {left:.0} s left")
    }

    /// What remains of a stage: a short one has had no other moment to say what it found.
    fn summary(&self, took: Duration) -> String {
        let count = match (self.steps, self.skipped) {
            (0, _) => String::new(),
            (steps, 0) => format!(" ({steps})"),
            (steps, skipped) => format!(" ({steps}, {skipped} of them made before)"),
        };
        let note = self.unsaid.as_ref().map_or_else(String::new, |n| format!("; {n}"));
        format!("{}{count}: {:.1} s{note}", self.name, took.as_secs_f64())
    }
}

impl Progress for Stderr {
    fn stage(&self, name: &str, steps: u64) {
        self.with(|s| {
            s.end();
            let now = Instant::now();
            (s.name, s.steps, s.done, s.skipped) = (name.into(), steps, 0, 0);
            (s.started, s.said, s.unsaid) = (now, now, None);
            if self.form == Some(ProgressForm::Json) {
                eprintln!("{}", json!({ "event": "begin", "stage": name, "steps": steps }));
            }
            if self.form == Some(ProgressForm::Bar) {
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
            } else if s.is_time() {
                s.said = Instant::now();
                match s.form {
                    Some(ProgressForm::Json) => {
                        eprintln!("{}", json!({ "event": "note", "stage": s.name, "note": what }));
                    }
                    _ => eprintln!("{}: {what}", s.name),
                }
                s.unsaid = None;
            }
        });
    }

    fn advance(&self, steps: u64) {
        self.with(|s| s.go_on(steps));
    }

    fn skip(&self, steps: u64) {
        self.with(|s| {
            s.skipped += steps;
            s.go_on(steps);
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stage_that_was_too_short_to_say_what_it_found_says_so_at_its_end() {
        let progress = Stderr::of(Some(ProgressForm::Plain));
        let summary = || {
            let mut found = String::new();
            progress.with(|s| found = s.summary(Duration::from_millis(1_230)));
            found
        };
        progress.stage("clusters", 20);
        assert_eq!(summary(), "clusters (20): 1.2 s");
        progress.skip(5);
        progress.advance(5);
        let ten_s = Duration::from_secs(10);
        let mut said = String::new();
        progress.with(|s| said = s.progress(ten_s));
        assert_eq!(said, "clusters: 10 of 20 (5 made before), 0.50 per second, 20 s left");
        progress.stage("clusters", 20);
        progress.note("budget: 8000 of 20000 triangles");
        assert_eq!(summary(), "clusters (20): 1.2 s; budget: 8000 of 20000 triangles");
        progress.stage("grid", 0);
        assert_eq!(summary(), "grid: 1.2 s", "another stage's note is not its own");
        progress.with(|s| s.said -= PLAIN_INTERVAL);
        progress.note("round 1");
        assert_eq!(summary(), "grid: 1.2 s", "it was said already");
    }

    #[test]
    fn lines_for_programs_are_json() {
        let progress = Stderr::of(Some(ProgressForm::Json));
        progress.stage("images", 20);
        progress.skip(4);
        progress.advance(6);
        progress.note("half");
        let ten_s = Duration::from_secs(12);
        let (mut there, mut end) = (Value::Null, Value::Null);
        progress.with(|s| (there, end) = (s.progress_json(ten_s), s.summary_json(ten_s)));
        let (done, steps, skipped) = (10, 20, 4);
        assert_eq!(
            there,
            json!({ "event": "progress", "stage": "images", "done": done, "steps": steps, "skipped": skipped, "left_s": 20.0 })
        );
        assert_eq!((&end["seconds"], &end["note"]), (&json!(12.0), &json!("half")));
    }

    #[test]
    fn who_is_quiet_says_nothing() {
        let quiet = ProgressArgs { quiet: true, progress: None };
        let progress = Stderr::new(&quiet);
        progress.stage("images", 20);
        progress.with(|s| s.said -= PLAIN_INTERVAL);
        let mut due = true;
        progress.with(|s| due = s.is_time());
        assert!(!due && progress.form.is_none());
    }
}
