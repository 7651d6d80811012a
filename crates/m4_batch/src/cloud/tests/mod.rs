//! Object stores: a web server that is really asked, and buckets in memory.

pub(crate) mod server;

use super::client::{Place, block_on, open};
use super::fetch::get;
use super::list::objects;
use super::upload::{send, upload};
use super::{CloudError, Wanted, check_upload, extension, fetch, find, is_uri};
use object_store::memory::InMemory;
use object_store::path::Path as ObjectPath;
use object_store::{ObjectStore, ObjectStoreExt};
use server::Server;
use std::cell::Cell;
use std::fs;
use std::path::Path;
use std::sync::Arc;

const NEVER: &dyn Fn() -> bool = &|| false;

/// A bucket in memory, as `s3://bucket/` and a prefix would name it.
fn bucket(prefix: &str) -> Place {
    Place {
        store: Arc::new(InMemory::new()),
        path: ObjectPath::parse(prefix).unwrap(),
        url: format!("s3://bucket/{prefix}").parse().unwrap(),
        is_bucket: true,
    }
}

fn run<T>(work: impl Future<Output = Result<T, object_store::Error>>) -> T {
    block_on("test", async { Ok(work.await.unwrap()) }).unwrap()
}

fn put(place: &Place, name: &str, content: &[u8]) {
    run(place
        .store
        .put(&ObjectPath::parse(name).unwrap(), content.to_vec().into()));
}

/// Every object with its size.
fn all(place: &Place) -> Vec<(String, u64)> {
    let listed = run(place
        .store
        .list_with_delimiter(Some(&ObjectPath::parse("out/a").unwrap())));
    let inner = run(place
        .store
        .list_with_delimiter(Some(&ObjectPath::parse("out/a/capture").unwrap())));
    let objects = listed.objects.into_iter().chain(inner.objects);
    let mut all: Vec<_> = objects.map(|o| (o.location.to_string(), o.size)).collect();
    all.sort();
    all
}

#[test]
fn uris_and_their_extensions_are_told_apart() {
    assert!(is_uri("s3://b/a.mp4") && is_uri("https://h/a") && !is_uri("/s3/a.mp4") && !is_uri("ftp://h/a"));
    assert_eq!(extension("s3://b/in/a.b.MP4"), "MP4");
    for none in [
        "s3://b/a",
        "s3://b/.mp4",
        "s3://b/a.",
        "s3://b.c/a",
        "s3://b/a.%2e%2e",
        "s3://b/a.muchtoolong",
    ] {
        assert_eq!(extension(none), "video", "{none}");
    }
}

#[test]
fn what_cannot_be_a_clip_is_refused_before_anybody_is_asked() {
    let said = |uri: &str| open(uri).map(|_| ()).unwrap_err().to_string();
    assert!(said("https://h/a.mp4?signature=x").contains("%3F"));
    assert!(said("https://me:secret@h/a.mp4").contains("credentials"));
    assert!(said("https://me@h/a.mp4").contains("credentials"));
    assert!(said("s3://").contains("cannot be used"), "{}", said("s3://"));
    let upload = check_upload("https://example.org/results").unwrap_err().to_string();
    assert!(upload.contains("web servers"), "{upload}");
    check_upload("s3://bucket/results").unwrap();
}

#[test]
fn a_file_of_a_web_server_is_planned_and_fetched() {
    let server = Server::new();
    server.put("in/a%20b.mp4", Some("one"), b"a clip");
    let uri = server.uri("in/a%20b.mp4");
    let found = find(&uri, false).unwrap();
    let [object] = found.as_slice() else {
        panic!("{found:?}");
    };
    assert_eq!((object.uri.as_str(), object.name.as_str()), (uri.as_str(), "a b"));
    assert_eq!((object.bytes, object.etag.as_str()), (6, "\"one\""));
    assert_eq!(server.asked(), ["HEAD /in/a%20b.mp4"]);

    let dir = tempfile::tempdir().unwrap();
    let (file, note) = (dir.path().join("in/a.mp4"), dir.path().join("in/.a.json"));
    let wanted = Wanted {
        uri: &object.uri,
        bytes: object.bytes,
        etag: &object.etag,
    };
    let again = || fetch(wanted, &file, &note, NEVER);
    again().unwrap();
    assert_eq!(fs::read(&file).unwrap(), b"a clip");
    assert_eq!(server.asked(), ["GET /in/a%20b.mp4"]);
    again().unwrap();
    assert!(server.asked().is_empty(), "it is here");
    // As a worker leaves it that dies, or a disk that is damaged.
    fs::write(&file, b"A clip").unwrap();
    fs::write(dir.path().join("in/.a.mp4.tmp-1"), b"half").unwrap();
    again().unwrap();
    assert_eq!(
        (fs::read(&file).unwrap(), server.asked().len()),
        (b"a clip".to_vec(), 1)
    );
    assert!(!dir.path().join("in/.a.mp4.tmp-1").exists());

    fs::remove_file(&note).unwrap();
    for (etag, body) in [
        (Some("two"), b"a clip".as_slice()),
        (Some("one"), b"a longer clip"),
        (None, b"a clip"),
    ] {
        server.put("in/a%20b.mp4", etag, body);
        let error = again().unwrap_err();
        assert!(
            matches!(error, CloudError::Changed { .. }),
            "{etag:?} {body:?}: {error}"
        );
    }
    assert!(!note.exists());
}

#[test]
fn what_a_web_server_does_not_have_is_named() {
    let server = Server::new();
    let gone = find(&server.uri("a.mp4"), false).unwrap_err();
    assert!(matches!(gone, CloudError::NotFound { .. }), "{gone}");
    server.put("b.mp4", None, b"x");
    let plain = find(&server.uri("b.mp4"), false).unwrap_err();
    assert!(matches!(plain, CloudError::NoEtag { .. }), "{plain}");
    let listed = find(&server.uri("in/"), true).unwrap_err().to_string();
    assert!(listed.contains("name each file"), "{listed}");
    let dir = tempfile::tempdir().unwrap();
    let fetched = |name: &str, stop: &dyn Fn() -> bool| {
        let uri = server.uri(name);
        let wanted = Wanted {
            uri: &uri,
            bytes: 1,
            etag: "x",
        };
        fetch(wanted, &dir.path().join("a"), &dir.path().join("n"), stop).unwrap_err()
    };
    let gone = fetched("a.mp4", NEVER);
    assert!(matches!(gone, CloudError::NotFound { .. }), "{gone}");
    let asked = Cell::new(0);
    let stopped = fetched("hang", &|| asked.replace(asked.get() + 1) > 1);
    assert!(matches!(stopped, CloudError::Stopped { .. }), "{stopped}");
}

#[test]
fn videos_under_a_prefix_are_found_and_nothing_else() {
    let place = bucket("clips/");
    for name in [
        "clips/b.mp4",
        "clips/a ü#.MOV",
        "clips/notes.txt",
        "clips/.c.mp4",
        "clips/in/d.mkv",
        "clips/.git/e.mkv",
        "clipsX/f.mp4",
        "g.mp4",
    ] {
        put(&place, name, b"video");
    }
    let found = |place: &Place, recursive: bool| -> Vec<String> {
        let objects = block_on("test", objects(place, recursive)).unwrap();
        assert!(objects.iter().all(|o| o.bytes == 5 && !o.etag.is_empty()));
        let mut uris: Vec<_> = objects.into_iter().map(|o| o.uri).collect();
        uris.sort();
        uris
    };
    let odd = "s3://bucket/clips/a%20%C3%BC%23.MOV";
    assert_eq!(found(&place, false), [odd, "s3://bucket/clips/b.mp4"]);
    assert_eq!(
        found(&place, true),
        [odd, "s3://bucket/clips/b.mp4", "s3://bucket/clips/in/d.mkv"]
    );
    // The URI leads back to the object.
    assert_eq!(open(odd).unwrap().path.as_ref(), "clips/a ü#.MOV");

    let at = |uri: &str| Place {
        store: Arc::clone(&place.store),
        path: open(uri).unwrap().path,
        url: uri.parse().unwrap(),
        is_bucket: true,
    };
    assert_eq!(found(&at(odd), false), [odd]);
    assert_eq!(found(&at("s3://bucket"), false), ["s3://bucket/g.mp4"]);
    let none = block_on("test", objects(&at("s3://bucket/none/"), true)).unwrap_err();
    assert!(matches!(none, CloudError::Nothing { .. }), "{none}");
    let prefix = block_on("test", objects(&at("s3://bucket/clips"), true)).unwrap_err();
    assert!(prefix.to_string().contains("ends with /"), "{prefix}");
}

#[test]
fn an_object_that_is_replaced_is_noticed() {
    let (place, dir) = (bucket("clips/"), tempfile::tempdir().unwrap());
    let path = ObjectPath::parse("clips/a.mp4").unwrap();
    let content: Vec<u8> = (0..3_000_000_u32).map(|i| (i % 251) as u8).collect();
    put(&place, "clips/a.mp4", &content);
    let etag = run(place.store.head(&path)).e_tag.unwrap();
    let wanted = Wanted {
        uri: "s3://bucket/clips/a.mp4",
        bytes: 3_000_000,
        etag: &etag,
    };
    let (file, note) = (dir.path().join("a.mp4"), dir.path().join("note"));
    let fetched = || block_on("test", get(place.store.as_ref(), &path, wanted, &file, &note, NEVER));
    fetched().unwrap();
    assert!(fs::read(&file).unwrap() == content);
    put(&place, "clips/a.mp4", &content);
    let error = fetched().unwrap_err();
    assert!(matches!(error, CloudError::Changed { .. }), "{error}");
}

fn write_result(folder: &Path, large: usize) {
    fs::create_dir_all(folder.join("capture")).unwrap();
    fs::write(folder.join("capture/transforms.json"), "{}").unwrap();
    fs::write(folder.join("scene.safetensors"), vec![7; large]).unwrap();
    fs::write(folder.join("viewer.html"), "").unwrap();
    fs::write(folder.join("run.json"), "{\"new\":1}").unwrap();
}

#[test]
fn a_result_is_copied_whole_and_its_record_comes_last() {
    let (place, dir) = (bucket("out/"), tempfile::tempdir().unwrap());
    // More than two parts.
    let large = 20_000_000;
    write_result(dir.path(), large);
    put(&place, "out/a/run.json", b"{}");

    let calls = Cell::new(0);
    let stop = || calls.replace(calls.get() + 1) > 4;
    let error = block_on("test", send(&place, dir.path(), "a", &stop)).unwrap_err();
    assert!(matches!(error, CloudError::Stopped { .. }), "{error}");
    let left = all(&place);
    assert!(
        !left.is_empty() && left.iter().all(|(name, _)| name != "out/a/run.json"),
        "a copy that is not whole has no record, not even an older one: {left:?}"
    );

    block_on("test", send(&place, dir.path(), "a", NEVER)).unwrap();
    let expected = [
        ("out/a/capture/transforms.json", 2),
        ("out/a/run.json", 9),
        ("out/a/scene.safetensors", large as u64),
        ("out/a/viewer.html", 0),
    ];
    assert_eq!(all(&place), expected.map(|(name, bytes)| (name.to_owned(), bytes)));
    let scene = ObjectPath::parse("out/a/scene.safetensors").unwrap();
    let back = run(async { place.store.get(&scene).await?.bytes().await });
    assert!(back.iter().all(|&b| b == 7));
}

/// Against a store that somebody runs, whose settings are in the environment (`docs/batch.md`): what is uploaded is listed, fetched
/// and replaced.
#[test]
#[ignore = "needs a bucket: M4_TEST_BUCKET=s3://bucket/prefix"]
fn a_bucket_of_a_real_store_does_what_one_in_memory_does() {
    let uri = std::env::var("M4_TEST_BUCKET").expect("M4_TEST_BUCKET=s3://bucket/prefix");
    let dir = tempfile::tempdir().unwrap();
    let result = dir.path().join("result");
    write_result(&result, 20_000_000);
    fs::write(result.join("clip ü.mp4"), vec![9; 9_000_000]).unwrap();
    upload(&result, &uri, "a", NEVER).unwrap();
    upload(&result, &uri, "a", NEVER).unwrap();
    let found = find(&format!("{uri}/a/"), false).unwrap();
    let [object] = found.as_slice() else {
        panic!("{found:?}");
    };
    assert_eq!((object.name.as_str(), object.bytes), ("clip ü", 9_000_000));
    assert_eq!(find(&format!("{uri}/"), true).unwrap(), found);
    let alone = find(&object.uri, false).unwrap();
    assert_eq!(alone[0].etag.trim_matches('"'), object.etag.trim_matches('"'));
    let fetched = |name: &str| {
        let wanted = Wanted {
            uri: &object.uri,
            bytes: object.bytes,
            etag: &object.etag,
        };
        fetch(
            wanted,
            &dir.path().join(name),
            &dir.path().join(format!(".{name}")),
            NEVER,
        )
    };
    fetched("one").unwrap();
    assert!(fs::read(dir.path().join("one")).unwrap() == vec![9; 9_000_000]);
    fs::write(result.join("clip ü.mp4"), vec![8; 9_000_000]).unwrap();
    upload(&result, &uri, "a", NEVER).unwrap();
    let changed = fetched("two").unwrap_err();
    assert!(matches!(changed, CloudError::Changed { .. }), "{changed}");
    let gone = find(&format!("{uri}/none.mp4"), false).unwrap_err();
    assert!(matches!(gone, CloudError::NotFound { .. }), "{gone}");
}
