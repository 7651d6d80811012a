//! A contact sheet: one HTML file with everything in it.

use super::{ClipReport, ClipState, Report};
use crate::layout::POSTER_FILE;
use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use std::fs;
use std::path::Path;

/// Largest poster that is put into the page, bytes.
const LARGEST: u64 = 1 << 20;

const STYLE: &str = "\
:root{color-scheme:light dark;--line:#8884;--weak:#888}\
body{font:15px/1.4 system-ui,sans-serif;margin:2rem;max-width:110rem}\
main{display:grid;grid-template-columns:repeat(auto-fill,minmax(21rem,1fr));gap:1rem}\
article{border:1px solid var(--line);border-radius:.5rem;padding:.75rem;overflow-wrap:anywhere}\
img,.none{width:100%;aspect-ratio:8/3;object-fit:contain;background:#8882;border-radius:.25rem;display:grid;place-items:center;color:var(--weak)}\
h2{font-size:1rem;margin:.5rem 0 .25rem}dl{display:grid;grid-template-columns:auto 1fr;gap:0 .75rem;margin:0}\
dt{color:var(--weak)}dd{margin:0}.state{float:right;font-weight:normal;padding:0 .5rem;border-radius:1rem;border:1px solid}\
.done{color:#1a7f37}.running{color:#0969da}.poison,.failed,.stale{color:#cf222e}.waiting,.interrupted{color:#9a6700}\
@media(prefers-color-scheme:dark){.done{color:#3fb950}.running{color:#58a6ff}.poison,.failed,.stale{color:#f85149}\
.waiting,.interrupted{color:#d29922}}";

/// The page. It loads nothing from anywhere; posters are read from the results and put into it.
#[must_use]
pub fn sheet(report: &Report, title: &str) -> String {
    let counts = ClipState::ALL.map(|s| (s.name(), report.counts.get(s.name()).copied().unwrap_or(0)));
    let counts: Vec<String> = counts
        .iter()
        .filter(|(_, n)| *n > 0)
        .map(|(name, n)| format!("<span class=\"{name}\">{n} {name}</span>"))
        .collect();
    let title = escape(title);
    let mut page = format!(
        "<!DOCTYPE html>\n<html lang=\"en\"><head><meta charset=\"utf-8\"><meta name=\"viewport\" content=\"width=device-width\">\n\
         <title>{title}</title><style>{STYLE}</style></head><body>\n<h1>{title}</h1>\n<p>{} clips: {}</p>\n",
        report.jobs,
        counts.join(", ")
    );
    if !report.reasons.is_empty() {
        page += "<details open><summary>Troubles</summary><ul>\n";
        for (reason, ids) in &report.reasons {
            page += &format!(
                "<li>{} &times; {}: {}</li>\n",
                ids.len(),
                escape(reason),
                escape(&ids.join(", "))
            );
        }
        page += "</ul></details>\n";
    }
    page += "<main>\n";
    for clip in &report.clips {
        page += &card(clip);
    }
    page + "</main></body></html>\n"
}

fn card(clip: &ClipReport) -> String {
    let state = clip.state.name();
    let picture = poster(clip).unwrap_or_else(|| format!("<div class=\"none\">{state}</div>"));
    let rows = [
        ("PSNR", clip.psnr_db.map(|p| format!("{p:.2} dB"))),
        ("splats", clip.splats.map(|n| n.to_string())),
        ("time", clip.seconds.map(|s| format!("{s:.1} s"))),
        (
            "memory",
            clip.peak_memory_bytes.map(|b| format!("{} MB", b / 1_000_000)),
        ),
        ("machine", clip.host.clone()),
        ("reason", clip.reason.clone()),
        ("input", Some(clip.input.clone())),
    ];
    let rows = rows.into_iter().filter_map(|(name, value)| Some((name, value?)));
    let rows: String = rows
        .map(|(name, value)| format!("<dt>{name}</dt><dd>{}</dd>", escape(&value)))
        .collect();
    format!(
        "<article>{picture}<h2>{} <span class=\"state {state}\">{state}</span></h2><dl>{rows}</dl></article>\n",
        escape(&clip.id)
    )
}

fn poster(clip: &ClipReport) -> Option<String> {
    let path = Path::new(&clip.output).join(POSTER_FILE);
    let small = clip.state == ClipState::Done && fs::metadata(&path).is_ok_and(|m| m.len() <= LARGEST);
    let bytes = small.then(|| fs::read(&path).ok()).flatten()?;
    let alt = escape(&format!("a frame of {} and its re-render", clip.id));
    Some(format!(
        "<img alt=\"{alt}\" src=\"data:image/jpeg;base64,{}\">",
        STANDARD.encode(bytes)
    ))
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
