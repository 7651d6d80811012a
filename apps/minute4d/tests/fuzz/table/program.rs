//! Readers of the program and its batches: settings, records of runs, manifests, records of jobs.

use super::alone;
use crate::reader::{Around, Outcome, Reader};
use minute4d::m4_kernels::SimdLevel;
use minute4d::settings::{Layers, Settings};
use minute4d_cli::batch::{
    Arguments, ClipReport, Job, JobRecord, Manifest, Outcome as JobOutcome, Report, VERSION,
};
use minute4d_cli::run::record::{
    self, Device, GEOMETRY_FORMAT, GeometryRecord, Input, RunRecord, Status,
};
use serde::Serialize;
use std::path::Path;

pub fn rows() -> Vec<Reader> {
    vec![
        alone("program-settings", "a.toml", settings, |p| {
            let read = Layers::default().file(p).and_then(|layers| layers.finish());
            Outcome::of(read, |_| None)
        }),
        below("program-run-record", "run.json", runs, |p| {
            usable(RunRecord::read(p))
        }),
        below(
            "program-geometry-record",
            "geometry.json",
            geometries,
            |p| usable(GeometryRecord::read(p)),
        ),
        alone("batch-manifest", "jobs.jsonl", manifests, |p| {
            Outcome::of(Manifest::read(p), |read| {
                let same = read.jobs.iter().map(|job| job.id.to_lowercase());
                let mut ids: Vec<String> = same.collect();
                ids.sort_unstable();
                ids.dedup();
                (ids.len() < read.jobs.len()).then(|| "two jobs of one name".to_owned())
            })
        }),
        below("batch-record", ".state/clip.json", records, report),
        below("batch-result-mark", "clip/batch.json", marks, report),
    ]
}

/// A reader of a folder in which the bytes are `file`.
fn below(
    name: &'static str,
    file: &str,
    seeds: fn() -> Vec<Vec<u8>>,
    call: impl Fn(&Path) -> Outcome + Send + Sync + 'static,
) -> Reader {
    Reader {
        given: String::new(),
        around: Around::Nothing,
        ..alone(name, file, seeds, call)
    }
}

fn json(value: &impl Serialize) -> Vec<u8> {
    serde_json::to_vec_pretty(value).unwrap_or_else(|e| panic!("a valid value: {e}"))
}

fn settings() -> Vec<Vec<u8>> {
    let text = |s: Settings| {
        s.to_toml()
            .unwrap_or_else(|e| panic!("valid settings: {e}"))
    };
    vec![
        text(Settings::fast()).into_bytes(),
        text(Settings::faithful()).into_bytes(),
        b"[train]\niterations = 3\n".to_vec(),
    ]
}

fn input() -> Input {
    Input {
        path: "a clip.mp4".to_owned(),
        blake3: "00".repeat(32),
    }
}

fn runs() -> Vec<Vec<u8>> {
    let device = Device::here(SimdLevel::best(), None);
    let record = RunRecord::begin(input(), &Settings::fast(), device);
    vec![json(
        &record.unwrap_or_else(|e| panic!("a valid record: {e}")),
    )]
}

fn geometries() -> Vec<Vec<u8>> {
    let record = GeometryRecord {
        format: GEOMETRY_FORMAT.to_owned(),
        version: record::VERSION,
        minute4d: "0.1.0".to_owned(),
        status: Status::Finished,
        input: input(),
        key: "00".repeat(32),
        settings: serde_json::Value::Null,
        found: None,
        seconds: 1.5,
        peak_memory_bytes: Some(1 << 20),
        warnings: vec!["blurred".to_owned()],
    };
    vec![json(&record)]
}

fn manifest(results: &str) -> Manifest {
    let job = |id: &str| Job {
        id: id.to_owned(),
        input: format!("/clips/{id}.mp4"),
        blake3: "00".repeat(32),
        output: format!("{results}/{id}"),
    };
    Manifest {
        results: results.to_owned(),
        run: Arguments {
            settings: "[train]\niterations = 3\n".to_owned(),
            arguments: vec!["--device".to_owned(), "cpu".to_owned()],
        },
        jobs: vec![job("clip"), job("other")],
    }
}

fn manifests() -> Vec<Vec<u8>> {
    vec![super::written("jobs.jsonl", |p| {
        manifest("/results").write(p, false)
    })]
}

/// What is seen of a batch whose results are in `folder`.
fn report(folder: &Path) -> Outcome {
    let read = Report::read(&manifest(&folder.to_string_lossy()));
    // What cannot be understood counts as absent, or as not ours.
    let understood = |clip: &ClipReport| {
        let of_batch = |reason: &String| reason.starts_with("its result is of");
        clip.host.is_some() || clip.reason.as_ref().is_some_and(of_batch)
    };
    if read
        .as_ref()
        .is_ok_and(|report| !report.clips.iter().any(understood))
    {
        return Outcome::Refused("nothing that can be used".to_owned());
    }
    Outcome::of(read, |report| {
        let sum: usize = report.counts.values().sum();
        if sum != report.jobs {
            return Some(format!("{sum} clips in all states, {} in all", report.jobs));
        }
        let _ = report.table(false);
        None
    })
}

/// A record that is damaged is none: the stage starts again.
fn usable<T, E: std::fmt::Display>(read: Result<Option<T>, E>) -> Outcome {
    match read {
        Ok(None) => Outcome::Refused("no record that can be used".to_owned()),
        read => Outcome::of(read, |_| None),
    }
}

fn records() -> Vec<Vec<u8>> {
    let manifest = manifest("/results");
    let record = |outcome| JobRecord {
        version: VERSION,
        id: "clip".to_owned(),
        key: manifest.jobs[0].key(&manifest.run),
        outcome,
        reason: "exit code 65".to_owned(),
        code: Some(65),
        seconds: 12.5,
        host: "node".to_owned(),
    };
    [JobOutcome::Failed, JobOutcome::Retryable]
        .map(|outcome| json(&record(outcome)))
        .to_vec()
}

fn marks() -> Vec<Vec<u8>> {
    let manifest = manifest("/results");
    vec![json(&serde_json::json!({
        "format": "minute4d-batch-result",
        "version": VERSION,
        "id": "clip",
        "key": manifest.jobs[0].key(&manifest.run),
        "host": "node",
    }))]
}
