//! Widths of comments and Markdown, and sizes of files: what rustfmt does not look at.

use anyhow::{Context, Result, bail};
use std::path::Path;
use std::process::Command;

/// Most columns of a line of prose, those of rustfmt's code.
const COLUMNS: usize = 100;
/// Most lines of code of a source file, without its tests.
const SOURCE_LINES: usize = 400;
/// Most lines of code of a file of tests.
const TEST_LINES: usize = 600;

/// Lines of prose in `text` that are too wide, by number. Code, tables, headings, links and single
/// words may be wider.
pub fn wide_lines(text: &str, markdown: bool) -> Vec<usize> {
    let mut fenced = false;
    let mut wide = Vec::new();
    for (i, line) in text.lines().enumerate() {
        let prose = if markdown { Some(line) } else { comment(line) };
        let Some(prose) = prose else {
            fenced = false;
            continue;
        };
        let words = prose.trim();
        if words.starts_with("```") || words.starts_with("~~~") {
            fenced = !fenced;
        }
        let free = ["|", "#", "[", "<", "!["]
            .iter()
            .any(|start| words.starts_with(start));
        let one_word = !words.trim_start_matches(['-', '*', ' ']).contains(' ');
        if !fenced && !free && !one_word && line.chars().count() > COLUMNS && !is_code_span(words) {
            wide.push(i + 1);
        }
    }
    wide
}

/// The text of a line that is a comment.
fn comment(line: &str) -> Option<&str> {
    let text = line.trim_start();
    ["///", "//!", "//"]
        .iter()
        .find_map(|start| text.strip_prefix(start))
}

/// Whether a line is one span of code, which cannot be broken, with a few letters around it.
fn is_code_span(words: &str) -> bool {
    let outside: String = words.split('`').step_by(2).collect();
    words.contains('`') && outside.trim().split(' ').count() <= 2
}

/// Lines of code of a source file: neither blank nor comments; with `tests` those of test modules
/// at its end, too.
pub fn lines_of_code(text: &str, tests: bool) -> usize {
    let end = match text.find("\n#[cfg(test)]") {
        Some(end) if !tests => end,
        _ => text.len(),
    };
    text[..end]
        .lines()
        .filter(|line| !line.trim().is_empty() && comment(line).is_none())
        .count()
}

/// Checks all tracked Rust, Markdown and TypeScript files under `root`.
///
/// # Errors
///
/// The lines that are too wide and the files that are too long.
pub fn check(root: &Path) -> Result<()> {
    let listed = Command::new("git")
        .args(["ls-files", "*.rs", "*.md", "*.ts"])
        .current_dir(root)
        .output();
    let listed = listed.context("cannot start git")?;
    let mut faults = Vec::new();
    for file in String::from_utf8_lossy(&listed.stdout).lines() {
        let path = root.join(file);
        if file.starts_with("third-party") || !path.is_file() {
            continue;
        }
        let text = std::fs::read_to_string(&path).with_context(|| format!("cannot read {file}"))?;
        let markdown = file.ends_with(".md");
        faults.extend(
            wide_lines(&text, markdown)
                .into_iter()
                .map(|line| format!("{file}:{line}: too wide")),
        );
        let tests = ["/tests/", "/published/"]
            .iter()
            .any(|folder| file.contains(folder))
            || file.ends_with("tests.rs");
        let (lines, most) = match tests {
            true => (lines_of_code(&text, true), TEST_LINES),
            false => (lines_of_code(&text, false), SOURCE_LINES),
        };
        if !markdown && lines > most {
            faults.push(format!("{file}: {lines} lines of code, {most} at most"));
        }
    }
    if faults.is_empty() {
        Ok(())
    } else {
        bail!("{}", faults.join("\n"))
    }
}

#[cfg(test)]
mod tests {
    use super::{lines_of_code, wide_lines};

    #[test]
    fn prose_is_narrow_and_the_rest_is_free() {
        let long = "word ".repeat(25);
        let code = format!(
            "let x = \"{long}\"; // {long}\n/// {long}\n///\n/// ```text\n/// {long}\n/// ```\n// {long}\n"
        );
        assert_eq!(
            wide_lines(&code, false),
            [2, 7],
            "code, trailing comments and diagrams are free"
        );
        let page = format!(
            "# {long}\n{long}\n| {long} |\n- `{long}`\n```\n{long}\n```\n{}\n",
            "x".repeat(130)
        );
        assert_eq!(wide_lines(&page, true), [2]);
    }

    #[test]
    fn code_is_counted_without_comments_and_tests() {
        let text = "//! A file.\n\nfn a() {\n    // why\n}\n\n#[cfg(test)]\nmod tests {\n}\n";
        assert_eq!(
            (lines_of_code(text, false), lines_of_code(text, true)),
            (2, 5)
        );
    }
}
