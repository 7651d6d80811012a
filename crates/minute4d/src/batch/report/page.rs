//! The HTML report: the template `page.html` with images and metrics.

use super::{ClipReport, ClipState, Report};
use crate::batch::layout::POSTER_FILE;
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use std::fs;
use std::path::Path;

/// Largest poster that is put into the page, bytes.
const LARGEST: u64 = 1 << 20;

/// The page. It loads nothing from anywhere; posters are read from the results and put into it.
#[must_use]
pub fn page(report: &Report, title: &str) -> String {
    fill(include_str!("page.html"), |name| match name {
        "title" => escape(title),
        "counts" => escape(&report.sums()),
        "clips" => report.clips.iter().map(card).collect(),
        _ => String::new(),
    })
}

/// A template with what `value` says instead of each `{{name}}`.
fn fill(template: &str, value: impl Fn(&str) -> String) -> String {
    let (mut text, mut rest) = (String::new(), template);
    while let Some((before, (name, after))) =
        rest.split_once("{{").and_then(|(before, after)| Some((before, after.split_once("}}")?)))
    {
        text += before;
        text += &value(name);
        rest = after;
    }
    text + rest
}

fn card(clip: &ClipReport) -> String {
    let state = clip.state.name();
    let rows = [
        ("PSNR", clip.psnr_db.map(|p| format!("{p:.2} dB"))),
        ("splats", clip.splats.map(|n| n.to_string())),
        ("time", clip.seconds.map(|s| format!("{s:.1} s"))),
        ("memory", clip.peak_memory_bytes.map(|b| format!("{} MB", b / 1_000_000))),
        ("machine", clip.host.clone()),
        ("reason", clip.reason.clone()),
        ("input", Some(clip.input.clone())),
    ];
    let row = |(name, value): (&str, Option<String>)| Some(format!("<dt>{name}</dt><dd>{}</dd>", escape(&value?)));
    fill(include_str!("clip.html"), |name| match name {
        "image" => poster(clip).unwrap_or_else(|| format!("<div class=\"none\">{state}</div>")),
        "id" => escape(&clip.id),
        "state" => state.to_owned(),
        "rows" => rows.clone().into_iter().filter_map(row).collect(),
        _ => String::new(),
    })
}

fn poster(clip: &ClipReport) -> Option<String> {
    let path = Path::new(&clip.output).join(POSTER_FILE);
    let small = clip.state == ClipState::Done && fs::metadata(&path).is_ok_and(|m| m.len() <= LARGEST);
    let bytes = small.then(|| fs::read(&path).ok()).flatten()?;
    let alt = escape(&format!("a frame of {} and its re-render", clip.id));
    Some(format!("<img alt=\"{alt}\" src=\"data:image/jpeg;base64,{}\">", STANDARD.encode(bytes)))
}

/// Text that means nothing but itself.
fn escape(text: &str) -> String {
    let mut out = String::with_capacity(text.len());
    for c in text.chars() {
        match c {
            '&' => out += "&amp;",
            '<' => out += "&lt;",
            '>' => out += "&gt;",
            '"' => out += "&quot;",
            '\'' => out += "&#39;",
            c => out.push(c),
        }
    }
    out
}
