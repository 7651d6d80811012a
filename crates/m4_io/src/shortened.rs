//! Shortens the parts of files that messages quote.

use std::fmt::{self, Display, Write as _};

/// Letters of a quotation at most.
const MAX_LETTERS: usize = 400;

/// What a message quotes of a file: whole where it is short, else its start and its end. Files are not trusted, and a damaged one may
/// hold a name of megabytes.
#[must_use]
pub fn shortened(part: impl Display) -> String {
    let mut out = Quotation::default();
    // writing to it does not fail
    let _ = write!(out, "{part}");
    out.finish()
}

/// The start of a text and its end, however long it is.
#[derive(Default)]
struct Quotation {
    start: String,
    end: String,
    letters: usize,
}

impl fmt::Write for Quotation {
    fn write_str(&mut self, text: &str) -> fmt::Result {
        for letter in text.chars() {
            self.letters += 1;
            if self.letters <= MAX_LETTERS / 2 {
                self.start.push(letter);
            } else {
                self.end.push(letter);
            }
        }
        if self.end.len() > 16 * MAX_LETTERS {
            self.end = last(&self.end, MAX_LETTERS / 2).to_owned();
        }
        Ok(())
    }
}

impl Quotation {
    fn finish(mut self) -> String {
        if self.letters <= MAX_LETTERS {
            self.start.push_str(&self.end);
        } else {
            self.start.push_str(" ... ");
            self.start.push_str(last(&self.end, MAX_LETTERS / 2));
        }
        self.start
    }
}

/// Returns the last characters of a text.
fn last(text: &str, letters: usize) -> &str {
    let from = text.char_indices().rev().nth(letters.saturating_sub(1));
    &text[from.map_or(0, |(at, _)| at)..]
}

#[cfg(test)]
mod tests {
    use super::shortened;

    #[test]
    fn short_text_stays_and_long_text_keeps_start_and_end() {
        for n in [0, 1, 3, 399, 400] {
            let text = "ü".repeat(n);
            assert_eq!(shortened(&text), text);
        }
        let long = format!("start{}end; do this", "9ü".repeat(1_000_000));
        let message = shortened(&long);
        assert!(message.starts_with("start9ü9ü") && message.ends_with("9üend; do this"), "{message}");
        assert_eq!(message.chars().count(), 405);
        // in pieces, as a formatter hands it over
        assert_eq!(shortened(format_args!("{}{}{}", &long[..8], &long[8..899], &long[899..])), message);
    }
}
