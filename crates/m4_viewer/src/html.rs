//! Templates of pages, and text in them.

/// Fills a template with what `value` says instead of each `{{name}}`.
pub fn fill(template: &str, value: impl Fn(&str) -> String) -> String {
    let (mut text, mut rest) = (String::new(), template);
    while let Some((before, (name, after))) = rest
        .split_once("{{")
        .and_then(|(before, after)| Some((before, after.split_once("}}")?)))
    {
        text += before;
        text += &value(name);
        rest = after;
    }
    text + rest
}

/// Returns text that means nothing but itself, in elements and in attributes.
pub fn escape(text: &str) -> String {
    // The ampersand first: the others bring in their own.
    text.replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('>', "&gt;")
        .replace('"', "&quot;")
        .replace('\'', "&#39;")
}

/// Returns the relative address of a file: the parts of its path, encoded.
pub fn address<'a>(parts: impl IntoIterator<Item = &'a str>) -> String {
    let encode = |part: &str| -> String {
        part.bytes()
            .map(|byte| match byte {
                b'a'..=b'z' | b'A'..=b'Z' | b'0'..=b'9' | b'-' | b'_' | b'.' | b'~' => {
                    char::from(byte).to_string()
                }
                byte => format!("%{byte:02X}"),
            })
            .collect()
    };
    let parts: Vec<String> = parts.into_iter().map(encode).collect();
    // A part with a colon would read as a scheme, but for its encoding.
    parts.join("/")
}

#[cfg(test)]
mod tests {
    use super::{address, escape, fill};

    #[test]
    fn values_are_put_in_once_and_unknown_braces_stay() {
        let text = fill("<{{a}}> {{b}} {{", |name| format!("[{name}] {{{{a}}}}"));
        assert_eq!(text, "<[a] {{a}}> [b] {{a}} {{");
    }

    #[test]
    fn text_and_addresses_end_nowhere_early() {
        assert_eq!(
            escape("<a href=\"x\">'&"),
            "&lt;a href=&quot;x&quot;&gt;&#39;&amp;"
        );
        assert_eq!(
            address(["my clips", "a:b#1?\"é", "viewer.html"]),
            "my%20clips/a%3Ab%231%3F%22%C3%A9/viewer.html"
        );
    }
}
