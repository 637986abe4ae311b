//! The keyboard: keys that are down, and the intent they express.

use super::walker::Intent;
use winit::keyboard::KeyCode;

/// The action of a key while it is down.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum Act {
    Forward,
    Back,
    Left,
    Right,
    TurnLeft,
    TurnRight,
    Up,
    Down,
    Run,
}

/// Keys are identified by position, so that all keyboard layouts use the same places.
fn act(key: KeyCode) -> Option<Act> {
    Some(match key {
        KeyCode::KeyW | KeyCode::ArrowUp => Act::Forward,
        KeyCode::KeyS | KeyCode::ArrowDown => Act::Back,
        KeyCode::KeyA => Act::Left,
        KeyCode::KeyD => Act::Right,
        KeyCode::ArrowLeft => Act::TurnLeft,
        KeyCode::ArrowRight => Act::TurnRight,
        KeyCode::KeyE => Act::Up,
        KeyCode::KeyQ => Act::Down,
        KeyCode::ShiftLeft | KeyCode::ShiftRight => Act::Run,
        _ => return None,
    })
}

/// The keys that are down.
#[derive(Debug, Clone, Default)]
pub struct Keys {
    down: Vec<KeyCode>,
}

impl Keys {
    /// Records a key's state. Returns whether the key moves the walker.
    pub fn set(&mut self, key: KeyCode, pressed: bool) -> bool {
        if act(key).is_none() {
            return false;
        }
        self.down.retain(|k| *k != key);
        if pressed {
            self.down.push(key);
        }
        true
    }

    /// Releases all keys, when the window loses the keyboard and gets no more events.
    pub fn release(&mut self) {
        self.down.clear();
    }

    /// The intent of all keys that are down. Opposite keys cancel.
    pub fn intent(&self) -> Intent {
        let is = |a: Act| if self.down.iter().any(|k| act(*k) == Some(a)) { 1.0 } else { 0.0 };
        Intent {
            forward: is(Act::Forward) - is(Act::Back),
            right: is(Act::Right) - is(Act::Left),
            up: is(Act::Up) - is(Act::Down),
            turn: is(Act::TurnLeft) - is(Act::TurnRight),
            tilt: 0.0,
            run: is(Act::Run) > 0.0,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn keys_add_up_to_an_intent() {
        let mut keys = Keys::default();
        assert!(keys.set(KeyCode::KeyW, true) && keys.set(KeyCode::ArrowUp, true) && !keys.set(KeyCode::KeyM, true));
        assert_eq!(keys.intent(), Intent { forward: 1.0, ..Intent::default() });
        // The second key with the same action is still down.
        keys.set(KeyCode::KeyW, false);
        keys.set(KeyCode::ShiftLeft, true);
        assert_eq!(keys.intent(), Intent { forward: 1.0, run: true, ..Intent::default() });
        keys.set(KeyCode::KeyS, true);
        assert_eq!(keys.intent().forward, 0.0);
        keys.release();
        assert_eq!(keys.intent(), Intent::default());
    }
}
