//! Workers whose clips come from a web server.

use super::Batch;
use crate::cloud::tests::server::Server;
use crate::manifest::Job;
use crate::report::{ClipState, Report};
use std::fs;
use std::time::Duration;

/// Jobs of a server in place of those of files.
fn of_server(batch: &mut Batch, server: &Server) {
    for job in &mut batch.manifest.jobs {
        server.put(&format!("{}.mp4", job.id), Some("one"), job.id.as_bytes());
        *job = Job {
            input: server.uri(&format!("{}.mp4", job.id)),
            blake3: None,
            etag: Some("\"one\"".to_owned()),
            ..job.clone()
        };
    }
}

#[test]
fn a_clip_of_a_store_is_fetched_checked_and_removed() {
    let server = Server::new();
    let mut batch = Batch::new(&["good", "changed", "gone", "again"]);
    of_server(&mut batch, &server);
    server.put("changed.mp4", Some("two"), b"changed");
    batch.manifest.jobs[2].input += ".none";
    // The clip is the last argument.
    let body = format!("cat \"$1\" >> {}; finish", batch.path("read").display());
    let (summary, _) = batch.work(&format!("[ $clip = again.mp4 ] && exit 75; {body}"), |_| {});
    assert_eq!((summary.done, summary.poison, summary.again), (1, 2, 1), "{summary:?}");
    assert_eq!(
        (&batch.state("changed")["code"], &batch.state("gone")["code"]),
        (&65.into(), &66.into())
    );
    assert_eq!(fs::read_to_string(batch.path("read")).unwrap(), "good");
    let input = batch.path("results/.work/.input");
    assert_eq!(
        fs::read(input.join("again.mp4")).unwrap(),
        b"again",
        "kept for the next worker"
    );
    assert!(!input.join("good.mp4").exists());

    server.asked();
    let (summary, _) = batch.work(&body, |_| {});
    assert_eq!(
        (summary.done, summary.done_before, summary.poison),
        (1, 1, 2),
        "{summary:?}"
    );
    assert!(server.asked().is_empty(), "it is not fetched twice");
    assert_eq!(fs::read_dir(input).unwrap().count(), 0);
}

#[test]
fn what_is_published_and_not_uploaded_is_tried_again() {
    let mut batch = Batch::new(&["a"]);
    // Nothing is uploaded to a web server, which is known without asking one.
    batch.manifest.upload = Some("http://127.0.0.1/results".to_owned());
    for calls in [1, 1] {
        let (summary, _) = batch.work("finish", |_| {});
        assert_eq!((summary.again, batch.calls()), (1, calls), "{summary:?}");
        assert!(summary.reasons[0].1.contains("not uploaded"), "{summary:?}");
        let state = batch.state("a");
        assert_eq!((&state["verdict"], &state["uploaded"]), (&"done".into(), &false.into()));
        assert!(batch.path("results/a/run.json").is_file());
    }
    let report = Report::read(&batch.manifest, Duration::from_secs(60)).unwrap();
    let clip = &report.clips[0];
    assert_eq!(clip.state, ClipState::Done);
    assert!(
        clip.reason.as_ref().is_some_and(|r| r.contains("not uploaded")),
        "{clip:?}"
    );
}
