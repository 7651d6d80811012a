//! Text on its way to a terminal or a pipe: what names and files brought in is made visible, and
//! what could not be delivered is remembered.

use std::borrow::Cow;
use std::io::{ErrorKind, Write};
use std::sync::OnceLock;

/// Returns the text with every character that acts on a terminal as a visible escape: controls but
/// line feed and tab, and those that reverse the order of letters. Results with exact names are
/// those of `--json`.
pub fn visible(text: &str) -> Cow<'_, str> {
    escaped(text, |c| c.escape_unicode().to_string())
}

/// The same on one line.
pub fn visible_line(text: &str) -> Cow<'_, str> {
    match visible(text) {
        line if line.contains('\n') => line.replace('\n', "\\n").into(),
        line => line,
    }
}

/// Returns a line of JSON with the characters of [`visible`] as escapes of JSON: serde writes those
/// above U+001F as they are.
pub fn visible_json(line: &str) -> Cow<'_, str> {
    escaped(line, |c| format!("\\u{:04x}", u32::from(c)))
}

fn escaped(text: &str, escape: impl Fn(char) -> String) -> Cow<'_, str> {
    if !text.contains(acts) {
        return text.into();
    }
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        match acts(c) {
            true => out += &escape(c),
            false => out.push(c),
        }
    }
    out.into()
}

fn acts(c: char) -> bool {
    let reverses = matches!(c, '\u{200e}' | '\u{200f}' | '\u{202a}'..='\u{202e}' | '\u{2066}'..='\u{2069}' | '\u{61c}');
    reverses || (c.is_control() && c != '\n' && c != '\t')
}

/// The first failure of standard output.
static LOST: OnceLock<String> = OnceLock::new();

/// Writes to standard output at once. A reader that closed the pipe wants no more; any other
/// failure is remembered for [`lost`].
pub fn to_stdout(text: &str) {
    let mut stdout = std::io::stdout().lock();
    delivered(
        stdout
            .write_all(text.as_bytes())
            .and_then(|()| stdout.flush()),
    );
}

/// Remembers the failure of a write to standard output.
pub fn delivered(written: std::io::Result<()>) {
    if let Err(error) = written
        && error.kind() != ErrorKind::BrokenPipe
    {
        LOST.get_or_init(|| format!("the result could not be written to standard output: {error}"));
    }
}

/// Returns why something written to standard output did not arrive, if so.
pub fn lost() -> Option<&'static str> {
    LOST.get().map(String::as_str)
}

/// Writes a line to stderr; a failure to do so is ignored.
pub fn to_stderr(line: &str) {
    let _ = writeln!(std::io::stderr().lock(), "{}", visible(line));
}

#[cfg(test)]
mod tests {
    use super::{visible, visible_json, visible_line};

    #[test]
    fn characters_that_act_on_a_terminal_become_visible_and_no_others() {
        let plain = "clip ü 日本 \"quoted\"\tand\nmore";
        assert_eq!(visible(plain), plain);
        let acting = "a\x1b[2Jb\r\x07\x7f\u{9b}31m\u{202e}gpj\u{2066}\0";
        let want = "a\\u{1b}[2Jb\\u{d}\\u{7}\\u{7f}\\u{9b}31m\\u{202e}gpj\\u{2066}\\u{0}";
        assert_eq!(visible(acting), want);
        assert_eq!(visible_line("a\nb\x1b"), "a\\nb\\u{1b}");
    }

    #[test]
    fn json_keeps_its_meaning() {
        let value = serde_json::json!({"name": "a\x1b\x7f\u{9b}\u{202e}ü\n"});
        let line = visible_json(&value.to_string()).into_owned();
        assert!(
            line.chars().all(|c| !c.is_control() && c != '\u{202e}'),
            "{line:?}"
        );
        assert_eq!(
            serde_json::from_str::<serde_json::Value>(&line).unwrap(),
            value
        );
    }
}
