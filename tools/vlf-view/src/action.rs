//! What keys do. Keys have the names that browsers give them (W3C UI Events, `code`), which the window
//! library uses, too: one table for the window, the browser and the help.

/// A movement that lasts as long as its key is held.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Way {
    /// Where the walker looks.
    Ahead,
    /// Away from it.
    Back,
    /// Sideways.
    Left,
    /// Sideways.
    Right,
    /// Along the scene's up.
    Up,
    /// Against it.
    Down,
    /// Not a way: faster.
    Hurry,
}

/// What happens once, when a key goes down.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Action {
    /// Half a stop more light.
    Brighter,
    /// Half a stop less.
    Darker,
    /// The exposure from what is seen.
    AutoExposure,
    /// The next tone curve.
    NextCurve,
    /// The next method.
    NextMethod,
    /// Walls stop the walker, or no longer.
    Collide,
    /// Figures in the picture, or no longer.
    Overlay,
    /// The keys in the picture, or no longer.
    Help,
    /// Back to the first view.
    Reset,
    /// Goes to a saved view.
    Recall(u8),
    /// Saves the view.
    Save(u8),
    /// Takes what is newer on disk than what is shown.
    TakeNext,
    /// Writes a picture to disk.
    Screenshot,
    /// Copies the camera.
    CopyCamera,
    /// The mouse looks around without a button.
    Capture,
    /// All of the screen, or no longer.
    FullScreen,
    /// Lets the mouse go, else ends.
    Leave,
}

/// What a key does.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Meaning {
    /// Something for as long as it is down.
    Held(Way),
    /// Something when it goes down.
    Once(Action),
}

/// Keys that are held.
const HELD: [(&[&str], Way); 7] = [
    (&["KeyW", "ArrowUp"], Way::Ahead),
    (&["KeyS", "ArrowDown"], Way::Back),
    (&["KeyA", "ArrowLeft"], Way::Left),
    (&["KeyD", "ArrowRight"], Way::Right),
    (&["KeyE", "Space"], Way::Up),
    (&["KeyQ", "KeyC"], Way::Down),
    (&["ShiftLeft", "ShiftRight"], Way::Hurry),
];

/// Other keys: their codes, what they do, and how the help has them.
const ONCE: [(&[&str], Action, &str); 15] = [
    (&["Equal", "NumpadAdd"], Action::Brighter, "+       brighter, half a stop"),
    (&["Minus", "NumpadSubtract"], Action::Darker, "-       darker, half a stop"),
    (&["KeyX"], Action::AutoExposure, "X       exposure from what is seen"),
    (&["KeyT"], Action::NextCurve, "T       tone curve: shoulder, Reinhard, plain"),
    (&["KeyM"], Action::NextMethod, "M       method: field, trace, difference"),
    (&["KeyK"], Action::Collide, "K       walls stop the walker"),
    (&["KeyI"], Action::Overlay, "I       figures: frame, cache, light"),
    (&["KeyR", "Home"], Action::Reset, "R       first view"),
    (&["KeyN"], Action::TakeNext, "N       take what is newer on disk"),
    (&["KeyP"], Action::Screenshot, "P       screenshot, PNG and EXR"),
    (&["KeyJ"], Action::CopyCamera, "J       copy the camera (vlf render --camera)"),
    (&["KeyF", "F11"], Action::FullScreen, "F       full screen"),
    (&["Tab"], Action::Capture, "Tab     let the mouse look; so does a click"),
    (&["F1", "Slash"], Action::Help, "F1, ?   this help"),
    (&["Escape"], Action::Leave, "Esc     let the mouse go; then: end"),
];

/// What a key does. `code` is the place of the key; `saves` says whether Ctrl or Shift is down.
pub fn meaning(code: &str, saves: bool) -> Option<Meaning> {
    let digit = code.strip_prefix("Digit").or(code.strip_prefix("Numpad"));
    if let Some(Ok(digit @ 0..=9)) = digit.map(str::parse::<u8>) {
        return Some(Meaning::Once(if saves {
            Action::Save(digit)
        } else {
            Action::Recall(digit)
        }));
    }
    let held = HELD.iter().find(|(codes, _)| codes.contains(&code));
    let once = || ONCE.iter().find(|(codes, ..)| codes.contains(&code));
    held.map(|(_, way)| Meaning::Held(*way))
        .or_else(|| once().map(|(_, action, _)| Meaning::Once(*action)))
}

/// What a character does wherever its key is on the keyboard.
pub fn meaning_of_text(text: &str) -> Option<Action> {
    match text {
        "?" => Some(Action::Help),
        "+" => Some(Action::Brighter),
        "-" => Some(Action::Darker),
        _ => None,
    }
}

/// What the keys do, a line each.
pub fn help() -> String {
    let first = "\
W A S D walk; arrows, too
E, Q    up and down; space and C, too
Shift   hurry
Drag    look around
Wheel   walking speed
0 to 9  saved views; Ctrl or Shift saves";
    ONCE.iter().fold(first.to_owned(), |all, (.., line)| all + "\n" + line)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_key_has_two_meanings_and_each_is_in_the_help() {
        let held = HELD.iter().flat_map(|(codes, _)| *codes);
        let mut codes: Vec<_> = held.chain(ONCE.iter().flat_map(|(codes, ..)| *codes)).collect();
        assert!(codes.iter().all(|code| meaning(code, false).is_some()));
        let count = codes.len();
        codes.sort_unstable();
        codes.dedup();
        assert_eq!(codes.len(), count);
        assert_eq!(help().lines().count(), 6 + ONCE.len());
    }

    #[test]
    fn digits_recall_and_save() {
        assert_eq!(meaning("Digit7", false), Some(Meaning::Once(Action::Recall(7))));
        assert_eq!(meaning("Numpad0", true), Some(Meaning::Once(Action::Save(0))));
        for odd in ["Digit", "Digit10", "Digit-1", "", "keyw", "NumpadEnter", "Digit٣"] {
            assert_eq!(meaning(odd, false), None, "{odd}");
        }
    }
}
