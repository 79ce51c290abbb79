//! Text from files on its way to a terminal. Names in a scene, keys of a configuration, lines of a log can hold
//! anything; a terminal obeys control characters: they clear the screen, rename the window, hide what follows.

use std::borrow::Cow;
use std::fmt::Write;

/// The text with each control character written out, such as `\u{1b}`. Line feeds and tabs stay.
pub fn printable(text: &str) -> Cow<'_, str> {
    if !text.chars().any(is_harmful) {
        return Cow::Borrowed(text);
    }
    let mut plain = String::with_capacity(text.len() + 16);
    for character in text.chars() {
        if is_harmful(character) {
            // Writing to a string does not fail.
            let _ = write!(plain, "{}", character.escape_default());
        } else {
            plain.push(character);
        }
    }
    Cow::Owned(plain)
}

/// Control characters, and those that turn the direction of the text.
fn is_harmful(character: char) -> bool {
    let turns = matches!(character, '\u{200e}' | '\u{200f}' | '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}');
    turns || character.is_control() && character != '\n' && character != '\t'
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_terminal_is_given_no_orders() {
        let plain = "Mug-2: r\u{2032} \u{2014} 3 \u{d7} 4\n\tB\u{fc}cher";
        assert!(matches!(printable(plain), Cow::Borrowed(same) if same == plain));
        assert_eq!(printable("a\u{1b}[2Jb\rc\u{9b}d\u{0}"), "a\\u{1b}[2Jb\\rc\\u{9b}d\\u{0}");
        assert_eq!(printable("abc\u{202e}cba"), "abc\\u{202e}cba");
    }
}
