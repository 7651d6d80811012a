//! Reports of batches that never ran.

use super::{ClipReport, ClipState, Report, page};
use std::fs;

fn clip(id: &str, state: ClipState, reason: Option<&str>, output: &str) -> ClipReport {
    ClipReport {
        id: id.to_owned(),
        input: format!("/clips/{id}.mp4"),
        state,
        reason: reason.map(str::to_owned),
        code: None,
        seconds: Some(2.5),
        splats: Some(10),
        psnr_db: Some(30.123),
        peak_memory_bytes: Some(5_000_000),
        host: Some("h<1>".to_owned()),
        output: output.to_owned(),
    }
}

#[test]
fn status_counts_add_up_and_failures_have_reasons() {
    let clips = vec![
        clip("a", ClipState::Done, None, "/r/a"),
        clip("b7", ClipState::Failed, Some("/clips/b7.mp4 is empty"), "/r/b7"),
        clip("c9", ClipState::Failed, Some("/clips/c9.mp4 is empty"), "/r/c9"),
        clip("d", ClipState::Waiting, None, "/r/d"),
    ];
    let report = Report::of(clips);
    assert_eq!(report.counts.values().sum::<usize>(), report.jobs);
    assert_eq!(report.seconds, 2.5);
    let table = report.table(false);
    assert!(
        table.contains("4 clips: 1 done, 1 waiting, 2 failed")
            && table.contains("30.12")
            && table.contains("b7.mp4 is empty"),
        "{table}"
    );
    let troubles = report.table(true);
    assert!(troubles.lines().any(|l| l.starts_with("b7")) && !troubles.lines().any(|l| l.starts_with("a ")));
}

#[test]
fn the_page_holds_everything_and_escapes_it() {
    let dir = tempfile::tempdir().unwrap();
    fs::write(dir.path().join("poster.jpg"), [0xff, 0xd8, 0xff]).unwrap();
    let output = dir.path().to_str().unwrap();
    let clips = vec![
        clip("a", ClipState::Done, None, output),
        clip("b", ClipState::Failed, Some("<script>alert('{{id}}')</script>"), output),
    ];
    let page = page(&Report::of(clips), "my \"clips\" {{clips}}");
    assert_eq!(page.matches("data:image/jpeg;base64,/9j/").count(), 1);
    assert!(!page.contains("<script") && page.contains("&lt;script&gt;alert(&#39;{{id}}&#39;)"), "{page}");
    assert!(
        page.contains("my &quot;clips&quot; {{clips}}") && page.contains("h&lt;1&gt;") && page.contains("30.12 dB")
    );
    assert!(!page.contains("http"), "it loads nothing");
}
