//! Commands that are printed for people to paste into a shell.

use std::ffi::OsStr;

/// A word as a shell reads it: quoted where it has to be. What is not UTF-8 in it is lost, as wherever it is printed.
pub fn quoted(word: impl AsRef<OsStr>) -> String {
    let word = word.as_ref().to_string_lossy();
    let plain = |letter: char| letter.is_ascii_alphanumeric() || "_-./=+:,@%".contains(letter);
    if !word.is_empty() && word.chars().all(plain) {
        return word.into_owned();
    }
    format!("'{}'", word.replace('\'', r"'\''"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_shell_reads_quoted_words_as_they_were() {
        let words = ["runs/a-1_b.c", "two words", "it's", "", "$HOME", "läuft"];
        for word in words {
            let printed =
                std::process::Command::new("sh").args(["-c", &format!("printf %s {}", quoted(word))]).output();
            assert_eq!(String::from_utf8(printed.unwrap().stdout).unwrap(), word);
        }
        assert_eq!(quoted("runs/a-1_b.c"), "runs/a-1_b.c");
    }
}
