//! Keys that do one thing when they are pressed.
//!
//! In: a key and its modifiers. Out: a command. Letters are found by what they write, digits by
//! their place: Shift and the keyboard's layout change what those write. Pure.

use super::bookmarks::LAST_PLACE;
use winit::keyboard::{Key, KeyCode, NamedKey, PhysicalKey};

/// A command of the user.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Command {
    /// Close the window.
    Leave,
    /// Copy a link to the view.
    CopyLink,
    /// Go to a kept place.
    GoTo(u8),
    /// Keep the place.
    Keep(u8),
    /// Show all keys, or hide them.
    Help,
    /// Show figures, or hide them.
    Figures,
    /// Show the next view for developers, or the previous one.
    NextView {
        /// Whether it is the previous one, not the next.
        back: bool,
    },
    /// Open or close the settings.
    Settings,
    /// Connect again, where the server has a new build of the dataset.
    Reconnect,
    /// Fill the screen, or stop it.
    FullScreen,
    /// Save a picture.
    Screenshot,
    /// Start a recording, or save it.
    Record,
    /// Replay the recorded walk, or stop it.
    Replay,
    /// Ignore walls, or respect them again.
    Walls,
    /// Open or close the map.
    Map,
    /// Show another storey on the map.
    Storey {
        /// Whether it is the one above, not the one below.
        up: bool,
    },
    /// Close what is open, or release the pointer.
    Escape,
}

/// The command of a pressed key. `control`: whether Control, or the Mac's command key, is down.
pub fn command(logical: &Key, physical: &PhysicalKey, control: bool, shift: bool) -> Option<Command> {
    if let Some(digit) = digit(physical) {
        return match control {
            true => (digit != LAST_PLACE).then_some(Command::Keep(digit)),
            false => Some(Command::GoTo(digit)),
        };
    }
    match (logical, control) {
        (Key::Character(c), true) => match c.to_lowercase().as_str() {
            "q" | "w" => Some(Command::Leave),
            "c" => Some(Command::CopyLink),
            _ => None,
        },
        (Key::Character(c), false) => match c.to_lowercase().as_str() {
            "h" | "?" => Some(Command::Help),
            "r" => Some(Command::Record),
            "p" => Some(Command::Replay),
            "g" => Some(Command::Walls),
            "m" => Some(Command::Map),
            _ => None,
        },
        (Key::Named(named), false) => match named {
            NamedKey::F1 => Some(Command::Figures),
            NamedKey::F2 => Some(Command::NextView { back: shift }),
            NamedKey::F3 => Some(Command::Settings),
            NamedKey::F5 => Some(Command::Reconnect),
            NamedKey::F11 => Some(Command::FullScreen),
            NamedKey::F12 => Some(Command::Screenshot),
            NamedKey::PageUp => Some(Command::Storey { up: true }),
            NamedKey::PageDown => Some(Command::Storey { up: false }),
            NamedKey::Escape => Some(Command::Escape),
            _ => None,
        },
        _ => None,
    }
}

/// The digit of a key, by its place.
fn digit(physical: &PhysicalKey) -> Option<u8> {
    const DIGITS: [KeyCode; 10] = [
        KeyCode::Digit0,
        KeyCode::Digit1,
        KeyCode::Digit2,
        KeyCode::Digit3,
        KeyCode::Digit4,
        KeyCode::Digit5,
        KeyCode::Digit6,
        KeyCode::Digit7,
        KeyCode::Digit8,
        KeyCode::Digit9,
    ];
    let PhysicalKey::Code(code) = physical else { return None };
    (0u8..).zip(DIGITS).find(|(_, c)| c == code).map(|(digit, _)| digit)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn letter(text: &str, code: KeyCode, control: bool) -> Option<Command> {
        command(&Key::Character(text.into()), &PhysicalKey::Code(code), control, false)
    }

    #[test]
    fn letters_are_found_by_what_they_write_and_digits_by_their_place() {
        assert_eq!(letter("h", KeyCode::KeyH, false), Some(Command::Help));
        assert_eq!(letter("?", KeyCode::Minus, false), Some(Command::Help), "on a German keyboard");
        assert_eq!(letter("M", KeyCode::Semicolon, false), Some(Command::Map));
        assert_eq!(letter("c", KeyCode::KeyC, true), Some(Command::CopyLink));
        assert_eq!((letter("c", KeyCode::KeyC, false), letter("m", KeyCode::KeyM, true)), (None, None));
        assert_eq!(letter("&", KeyCode::Digit1, false), Some(Command::GoTo(1)), "on a French keyboard");
        assert_eq!(letter("7", KeyCode::Digit7, true), Some(Command::Keep(7)));
        // The last place keeps itself.
        assert_eq!(letter("0", KeyCode::Digit0, true), None);
        assert_eq!(letter("0", KeyCode::Digit0, false), Some(Command::GoTo(0)));
    }

    #[test]
    fn function_keys_need_no_control() {
        let named = |key, control, shift| command(&Key::Named(key), &PhysicalKey::Code(KeyCode::F24), control, shift);
        assert_eq!(named(NamedKey::F11, false, false), Some(Command::FullScreen));
        assert_eq!(named(NamedKey::F2, false, true), Some(Command::NextView { back: true }));
        assert_eq!(named(NamedKey::F5, false, false), Some(Command::Reconnect));
        assert_eq!(named(NamedKey::F11, true, false), None);
    }
}
