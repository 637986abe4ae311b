//! Gamepads: converts sticks and buttons to an [`Intent`].
//!
//! Uses Linux's joystick interface (`/dev/input/js0`, kernel documentation "Linux Joystick
//! support"): records of eight bytes with time in milliseconds (u32), value (i16), kind and number
//! (u8), in native byte order. All axes span -32,767 to 32,767, and the state of every axis and
//! button is sent first. A thread of its own reads the device, and searches for one while there is
//! none.
//!
//! Pads with analogue triggers have one trigger axis between the sticks' axes. It is recognized by
//! its rest position at the end of the range.

use super::walker::Intent;
use std::{
    io::Read,
    path::{Path, PathBuf},
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::Duration,
};

/// Bytes of a record.
const RECORD: usize = 8;
/// Interval between searches for a pad.
const LOOK_EVERY: Duration = Duration::from_secs(2);
/// Device files that are tried.
const DEVICES: [&str; 4] = ["/dev/input/js0", "/dev/input/js1", "/dev/input/js2", "/dev/input/js3"];
/// Dead zone of a stick. Larger: slow movements are lost; smaller: worn sticks drift.
const DEAD_ZONE: f64 = 0.15;
/// Position at which a trigger counts as pressed.
const PRESSED: f64 = 0.5;
/// Largest number of buttons and of axes.
const MOST: usize = 32;
/// Buttons by number, as the kernel orders them (its gamepad specification; south is A or cross).
const SOUTH: usize = 0;
/// X; on PlayStation pads triangle.
const X: usize = 2;
/// Y; on PlayStation pads square.
const Y: usize = 3;
/// Left and right.
const SHOULDERS: [usize; 2] = [4, 5];
/// Across and down.
const LEFT_STICK: [usize; 2] = [0, 1];
/// The right stick of pads with analogue triggers, and of others.
const RIGHT_STICK: [[usize; 2]; 2] = [[3, 4], [2, 3]];
/// Left and right trigger, if analogue.
const TRIGGERS: [usize; 2] = [2, 5];

/// A button that acts once per press.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PadPress {
    /// [`X`]: a screenshot.
    Shot,
    /// [`Y`]: the map.
    Map,
}

/// State of a pad.
#[derive(Debug, Clone, PartialEq, Default)]
pub struct Pad {
    axes: [f64; MOST],
    buttons: [bool; MOST],
    /// Whether the triggers are analogue.
    triggers: bool,
    presses: Vec<PadPress>,
}

impl Pad {
    /// Applies a record. Unknown kinds and numbers are ignored.
    pub fn record(&mut self, record: &[u8; RECORD]) {
        /// Marks records of the initial state.
        const INITIAL: u8 = 0x80;
        let value = i16::from_ne_bytes([record[4], record[5]]);
        let (kind, number) = (record[6], usize::from(record[7]));
        if number >= MOST {
            return;
        }
        match kind & !INITIAL {
            1 => {
                let down = value != 0;
                let was_down = std::mem::replace(&mut self.buttons[number], down);
                let pressed = down && !was_down && kind & INITIAL == 0;
                match number {
                    X if pressed => self.presses.push(PadPress::Shot),
                    Y if pressed => self.presses.push(PadPress::Map),
                    _ => {}
                }
            }
            2 => {
                self.axes[number] = (f64::from(value) / f64::from(i16::MAX)).max(-1.0);
                if kind & INITIAL != 0 && number == TRIGGERS[0] {
                    self.triggers = value < -i16::MAX / 2;
                }
            }
            _ => {}
        }
    }

    /// The intent of sticks and held buttons: the left stick walks, the right stick turns, right
    /// trigger or A runs, shoulder buttons fly down and up.
    pub fn intent(&self) -> Intent {
        let look = RIGHT_STICK[usize::from(!self.triggers)];
        let [right, back] = stick(LEFT_STICK.map(|k| self.axes[k]));
        let [turn, tilt] = stick(look.map(|k| self.axes[k]));
        let held = |k: usize| if self.buttons[k] { 1.0 } else { 0.0 };
        Intent {
            forward: -back,
            right,
            up: held(SHOULDERS[1]) - held(SHOULDERS[0]),
            // Quadratic response: fine near the middle, fast at the end.
            turn: -turn * turn.abs(),
            tilt: -tilt * tilt.abs(),
            run: self.buttons[SOUTH] || self.triggers && self.axes[TRIGGERS[1]] > PRESSED,
        }
    }

    /// Takes the presses since the last call.
    pub fn presses(&mut self) -> Vec<PadPress> {
        std::mem::take(&mut self.presses)
    }
}

/// Removes a stick's dead zone, which is a disc, so that small circles stay circles.
fn stick(at: [f64; 2]) -> [f64; 2] {
    let length = at[0].hypot(at[1]);
    if length <= DEAD_ZONE {
        return [0.0; 2];
    }
    let scale = ((length - DEAD_ZONE) / (1.0 - DEAD_ZONE)).min(1.0) / length;
    at.map(|v| v * scale)
}

/// The pad to use.
#[derive(Debug, Clone, PartialEq, Eq)]
pub enum GamepadAt {
    /// The first pad found, now or later.
    Any,
    /// This file.
    File(PathBuf),
    /// No pad.
    Nowhere,
}

/// The pad in use, if any.
#[derive(Debug, Clone, Default)]
pub struct Gamepad {
    pad: Arc<Mutex<Pad>>,
}

impl Gamepad {
    /// Starts the search for a pad. `changed` is called on another thread after every press or
    /// movement. Without a thread there is no pad.
    pub fn watch(at: GamepadAt, changed: impl Fn() + Send + 'static) -> Self {
        let gamepad = Self::default();
        let pad = gamepad.pad.clone();
        if let GamepadAt::File(file) = &at
            && let Err(e) = std::fs::metadata(file)
        {
            tracing::warn!("no gamepad at {} yet: {e}", file.display());
        }
        let files: Vec<PathBuf> = match at {
            GamepadAt::Nowhere => return gamepad,
            GamepadAt::File(file) => vec![file],
            GamepadAt::Any if cfg!(target_os = "linux") => DEVICES.iter().map(PathBuf::from).collect(),
            GamepadAt::Any => return gamepad,
        };
        let body = move || {
            loop {
                files.iter().for_each(|file| follow(file, &pad, &changed));
                std::thread::sleep(LOOK_EVERY);
            }
        };
        // The thread blocks in a read until the program ends.
        if let Err(e) = std::thread::Builder::new().name("gamepad".into()).spawn(body) {
            tracing::warn!("no gamepad: {e}");
        }
        gamepad
    }

    /// The pad's state.
    pub fn pad(&self) -> MutexGuard<'_, Pad> {
        lock(&self.pad)
    }
}

fn lock(pad: &Mutex<Pad>) -> MutexGuard<'_, Pad> {
    pad.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Reads a pad until it is unplugged, then releases everything.
fn follow(file: &Path, pad: &Mutex<Pad>, changed: &impl Fn()) {
    let Ok(mut source) = std::fs::File::open(file) else { return };
    tracing::info!("a gamepad: {}", file.display());
    let mut record = [0; RECORD];
    while source.read_exact(&mut record).is_ok() {
        lock(pad).record(&record);
        changed();
    }
    tracing::info!("the gamepad {} is gone", file.display());
    *lock(pad) = Pad::default();
    changed();
}

#[cfg(test)]
mod tests {
    use super::*;

    fn record(value: i16, kind: u8, number: u8) -> [u8; RECORD] {
        let [a, b] = value.to_ne_bytes();
        [1, 2, 3, 4, a, b, kind, number]
    }

    /// Initial state of such a pad: everything at rest, triggers at their end.
    fn with_triggers() -> Pad {
        let mut pad = Pad::default();
        for axis in 0..8 {
            pad.record(&record(if axis == 2 || axis == 5 { -i16::MAX } else { 300 }, 0x82, axis));
        }
        (0..11).for_each(|button| pad.record(&record(0, 0x81, button)));
        pad
    }

    #[test]
    fn a_pad_at_rest_asks_for_nothing() {
        assert_eq!(with_triggers().intent(), Intent::default());
        let mut odd = with_triggers();
        odd.record(&record(i16::MAX, 2, 200));
        odd.record(&record(1, 7, 0));
        assert_eq!(odd, with_triggers(), "numbers and kinds that no pad has");
    }

    #[test]
    fn sticks_walk_and_turn_whether_or_not_there_are_triggers() {
        let mut pad = with_triggers();
        [0, 4].into_iter().for_each(|axis| pad.record(&record(0, 2, axis)));
        pad.record(&record(i16::MIN, 2, 1));
        pad.record(&record(i16::MAX, 2, 3));
        assert_eq!(pad.intent(), Intent { forward: 1.0, turn: -1.0, ..Intent::default() });
        pad.record(&record(i16::MAX, 2, 5));
        pad.record(&record(1, 1, 5));
        assert_eq!(pad.intent(), Intent { forward: 1.0, turn: -1.0, run: true, up: 1.0, ..Intent::default() });

        let mut plain = Pad::default();
        (0..6).for_each(|axis| plain.record(&record(0, 0x82, axis)));
        plain.record(&record(i16::MAX, 2, 2));
        plain.record(&record(-i16::MAX, 2, 3));
        // Both axes at their ends: diagonal movement is no faster than along an axis.
        let half = 0.5;
        let asked = plain.intent();
        assert!((asked.turn + half).abs() < 1e-9 && (asked.tilt - half).abs() < 1e-9, "{asked:?}");
    }

    #[test]
    fn slow_steps_begin_at_the_dead_zone() {
        let mut pad = with_triggers();
        let mut forward = |share: f64| {
            pad.record(&record((-share * f64::from(i16::MAX)) as i16, 2, 1));
            pad.intent().forward
        };
        assert_eq!(forward(DEAD_ZONE - 0.01), 0.0);
        assert!((0.0..0.02).contains(&forward(DEAD_ZONE + 0.01)));
        assert!((forward(0.575) - 0.5).abs() < 0.01);
    }

    #[test]
    fn a_press_counts_once_and_not_when_it_was_held_before() {
        let mut pad = with_triggers();
        pad.record(&record(1, 0x81, 3));
        assert_eq!(pad.presses(), []);
        pad.record(&record(0, 1, 3));
        for _ in 0..2 {
            pad.record(&record(1, 1, 3));
        }
        pad.record(&record(1, 1, 2));
        assert_eq!(pad.presses(), [PadPress::Map, PadPress::Shot]);
        assert_eq!(pad.presses(), []);
    }
}
