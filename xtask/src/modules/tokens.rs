//! Reads paths, attributes and items from the tokens of a file.

use proc_macro2::{Delimiter, TokenStream, TokenTree};

pub fn word(tokens: &[TokenTree], at: usize) -> Option<String> {
    match tokens.get(at)? {
        TokenTree::Ident(word) => Some(word.to_string()),
        _ => None,
    }
}

pub fn sign(tokens: &[TokenTree], at: usize, sign: char) -> bool {
    matches!(tokens.get(at), Some(TokenTree::Punct(p)) if p.as_char() == sign)
}

/// Whether `::` follows the first token, and then more of the path.
pub fn path_goes_on(tokens: &[TokenTree]) -> bool {
    sign(tokens, 1, ':') && sign(tokens, 2, ':') && !sign(tokens, 3, '<')
}

/// What is in the brackets of an attribute, and how many tokens it takes.
pub fn attribute(tokens: &[TokenTree]) -> Option<(TokenStream, usize)> {
    let at = if sign(tokens, 1, '!') { 2 } else { 1 };
    match tokens.get(at) {
        Some(TokenTree::Group(group))
            if sign(tokens, 0, '#') && group.delimiter() == Delimiter::Bracket =>
        {
            Some((group.stream(), at + 1))
        }
        _ => None,
    }
}

/// An attribute with the code of its strings in their place: `with = "crate::packed"`.
pub fn strings(attribute: TokenStream) -> TokenStream {
    let code = |token: TokenTree| -> TokenStream {
        match &token {
            TokenTree::Group(group) => strings(group.stream()),
            TokenTree::Literal(text) => {
                let text = text.to_string();
                let path = text.trim_matches('"');
                if path.starts_with("crate::") {
                    path.parse().unwrap_or_default()
                } else {
                    token.into()
                }
            }
            _ => token.into(),
        }
    };
    attribute.into_iter().map(code).collect()
}

/// How many tokens an item, a field or a statement takes, with the attributes that are left of it.
pub fn item(tokens: &[TokenTree]) -> usize {
    let mut at = 0;
    while let Some((_, length)) = attribute(&tokens[at..]) {
        at += length;
    }
    // Values end at a semicolon, other items at their braces, fields and arms at a comma.
    let (mut value, mut member) = (false, true);
    while at < tokens.len() {
        if let Some(word) = word(tokens, at) {
            value |= ["use", "static", "type", "let"].contains(&word.as_str());
            value |= word == "const" && word_is_name(tokens, at + 1);
            member &= !value
                && !["enum", "fn", "impl", "mod", "struct", "trait", "union"]
                    .contains(&word.as_str());
        }
        let braces =
            matches!(&tokens[at], TokenTree::Group(g) if g.delimiter() == Delimiter::Brace);
        let ends = sign(tokens, at, ';') || braces && !value || sign(tokens, at, ',') && member;
        at += 1;
        if ends {
            break;
        }
    }
    at
}

/// Whether a constant is named, in place of the function that `const fn` starts.
pub fn word_is_name(tokens: &[TokenTree], at: usize) -> bool {
    word(tokens, at)
        .is_some_and(|word| !["fn", "unsafe", "extern", "async"].contains(&word.as_str()))
}

/// Reads a path or a tree of paths (`a::{b, c as d}`), each with the name that it gives, up to what
/// ends it; how many tokens it took.
pub fn tree(
    tokens: &[TokenTree],
    prefix: &[String],
    paths: &mut Vec<(Vec<String>, String)>,
) -> usize {
    let mut path = prefix.to_vec();
    let mut at = 0;
    // `::a` starts at another crate.
    while sign(tokens, at, ':') {
        at += 1;
    }
    loop {
        match tokens.get(at) {
            Some(TokenTree::Ident(word)) => path.push(word.to_string()),
            Some(TokenTree::Punct(p)) if p.as_char() == '*' => path.push("*".to_owned()),
            Some(TokenTree::Group(group)) if group.delimiter() == Delimiter::Brace => {
                let inner: Vec<TokenTree> = group.stream().into_iter().collect();
                let mut from = 0;
                while from < inner.len() {
                    from += tree(&inner[from..], &path, paths) + 1;
                }
                return at + 1;
            }
            _ => return at,
        }
        at += 1;
        if !(sign(tokens, at, ':') && sign(tokens, at + 1, ':')) || sign(tokens, at + 2, '<') {
            break;
        }
        at += 2;
    }
    let mut name = path
        .iter()
        .rev()
        .find(|part| *part != "self")
        .cloned()
        .unwrap_or_default();
    if word(tokens, at).as_deref() == Some("as") {
        name = word(tokens, at + 1).unwrap_or_default();
        at += 2;
    }
    paths.push((path, name));
    at
}
