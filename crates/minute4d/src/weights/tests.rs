//! The store, and fetching from servers on this machine.

use super::{Condition, Entry, Network, Origin, Record, Store, WeightsError, add, fetch, find};
use crate::Category;
use m4_core::{Progress, Silent};
use m4_testkit::{Server, StopAtPoll};
use std::fs;
use std::io::{Cursor, Write};
use std::path::PathBuf;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread;
use std::time::{Duration, Instant};
use tempfile::TempDir;

const WEIGHTS: &[u8] = b"numbers that a network learned";
const SHA256: &str = "965a21c985560d261c0b3cc963282a0d3fbe1b5e2fa2c1cfd4c91bbc6431185b";
const COMMIT: &str = "0123456789abcdef0123456789abcdef01234567";

fn entry() -> Entry {
    Entry {
        name: "little",
        file: "little.pt",
        megabytes: 0,
        bytes: Some(WEIGHTS.len() as u64),
        sha256: Some(SHA256),
        licence: "MIT",
        commercial: true,
        used_for: "tests",
        without: "tests work",
        origin: Origin::HuggingFace {
            repository: "someone/little",
            revision: "main",
            path: "little.pt",
        },
    }
}

/// The same without a published checksum.
fn unknown() -> Entry {
    Entry {
        bytes: None,
        sha256: None,
        ..entry()
    }
}

/// An answer of HTTP with these lines. It says that the server closes the connection: without
/// that, a client keeps it for its next request, which may meet the end of the connection.
fn answer(status: u16, lines: &[&str], body: &[u8]) -> Vec<u8> {
    let mut head = format!(
        "HTTP/1.1 {status} Status\r\nConnection: close\r\nContent-Length: {}\r\n",
        body.len()
    );
    for line in lines {
        head += line;
        head += "\r\n";
    }
    [head.as_bytes(), b"\r\n", body].concat()
}

/// The whole file, or what is missing of it.
fn file(request: &str, etag: &str) -> Vec<u8> {
    let etag_line = format!("ETag: {etag}");
    let range = request.lines().find_map(|line| {
        line.to_ascii_lowercase()
            .strip_prefix("range: bytes=")?
            .strip_suffix('-')?
            .parse::<usize>()
            .ok()
    });
    match range {
        Some(start) if request.contains(etag) => {
            let end = WEIGHTS.len();
            let range = format!("Content-Range: bytes {start}-{}/{end}", end - 1);
            answer(206, &[&etag_line, &range], &WEIGHTS[start..])
        }
        _ => answer(200, &[&etag_line], WEIGHTS),
    }
}

/// A folder with a store.
struct Place {
    dir: TempDir,
    store: Store,
}

impl Place {
    fn new() -> Self {
        let dir = TempDir::new().unwrap();
        let store = Store::at(dir.path().join("store"));
        Self { dir, store }
    }

    fn path(&self, name: &str) -> PathBuf {
        self.dir.path().join(name)
    }

    /// The part that has arrived of `entry`.
    fn part(&self) -> PathBuf {
        self.path("store/.fetch/little/part")
    }

    fn assert_nothing_installed(&self) {
        assert_eq!(self.store.installed(&entry()), None);
        assert!(!self.path("store/little").exists());
    }

    fn fetch(&self, entry: &Entry, server: &Server) -> Result<Record, WeightsError> {
        fetch(entry, &self.store, &network(server), false, &Silent)
    }

    fn refused(&self, entry: &Entry, server: &Server) -> WeightsError {
        let error = self.fetch(entry, server).unwrap_err();
        self.assert_nothing_installed();
        error
    }
}

fn network(server: &Server) -> Network {
    Network {
        hugging_face: server.url(),
        token: Some("secret".to_owned()),
        offline: false,
        proxy: None,
        connect: Duration::from_secs(30),
        silence: Duration::from_secs(30),
        pause: Duration::from_millis(1),
        free_bytes: |_| None,
    }
}

#[test]
fn a_whole_file_is_installed_and_not_fetched_again() {
    let place = Place::new();
    let server = Server::start(|request| Some(file(request, "\"one\"")));
    let record = place.fetch(&entry(), &server).unwrap();
    assert!(
        record.published && record.licence == "MIT" && record.sha256 == SHA256,
        "{record:?}"
    );
    assert_eq!(
        record.source,
        "https://huggingface.co/someone/little/resolve/main/little.pt"
    );
    let requests = server.requests();
    assert!(
        requests[0].starts_with("GET /someone/little/resolve/main/little.pt HTTP/1.1"),
        "{requests:?}"
    );
    let path = place.store.require(&entry()).unwrap();
    assert_eq!(fs::read(&path).unwrap(), WEIGHTS);
    assert_eq!(place.store.record(&entry()).unwrap(), record);
    assert_eq!(place.store.verify(&entry()).unwrap(), Condition::Published);
    assert!(!place.part().exists());
    // it is not fetched again, unless it is damaged; a fetch that fails leaves it as it is
    assert_eq!(place.fetch(&entry(), &server).unwrap(), record);
    assert_eq!(server.requests().len(), 1);
    let damaged = b"numbers that a network unlearnt";
    fs::write(&path, damaged).unwrap();
    assert!(matches!(
        place.store.verify(&entry()).unwrap(),
        Condition::Damaged { .. }
    ));
    let gone = Server::start(|_| Some(answer(404, &[], b"")));
    place.fetch(&entry(), &gone).unwrap_err();
    assert_eq!(fs::read(&path).unwrap(), damaged);
    place.fetch(&entry(), &server).unwrap();
    assert_eq!(fs::read(&path).unwrap(), WEIGHTS);
}

#[test]
fn a_broken_connection_is_taken_up_where_it_broke() {
    let place = Place::new();
    // three bytes more with each connection
    let server = Server::start(|request| {
        let mut answer = file(request, "\"one\"");
        let head = answer.windows(4).position(|w| w == b"\r\n\r\n").unwrap() + 4;
        answer.truncate(head + 3);
        Some(answer)
    });
    let record = place.fetch(&entry(), &server).unwrap();
    assert_eq!(record.sha256, SHA256);
    let requests = server.requests();
    assert_eq!(requests.len(), WEIGHTS.len().div_ceil(3));
    let second = requests[1].to_ascii_lowercase();
    assert!(
        second.contains("range: bytes=3-") && second.contains("if-range: \"one\""),
        "{second}"
    );
}

#[test]
fn a_later_call_continues_and_a_changed_file_starts_again() {
    let place = Place::new();
    let broken = Server::start(|request| {
        let mut answer = file(request, "\"one\"");
        answer.pop();
        // the rest never comes
        (!request.contains("bytes=")).then_some(answer)
    });
    let stop = StopWithPart(place.part(), WEIGHTS.len() as u64 - 1);
    let error = fetch(&entry(), &place.store, &network(&broken), false, &stop).unwrap_err();
    assert_eq!(error.category(), Category::Stopped, "{error}");
    assert!(error.to_string().contains("is kept"), "{error}");
    place.assert_nothing_installed();
    assert_eq!(
        fs::read(place.part()).unwrap(),
        WEIGHTS[..WEIGHTS.len() - 1]
    );
    // at another address, what has arrived is not believed; the same one has a file of another tag
    let server = Server::start(|request| Some(file(request, "\"two\"")));
    place.fetch(&entry(), &server).unwrap();
    assert!(!server.requests()[0].contains("bytes="));
    let network = network(&broken);
    fs::remove_dir_all(place.path("store/little")).unwrap();
    fetch(&entry(), &place.store, &network, false, &stop).unwrap_err();
    let record = place.path("store/.fetch/little/part.json");
    let text = fs::read_to_string(&record).unwrap();
    fs::write(&record, text.replace(&broken.url(), &server.url())).unwrap();
    place.fetch(&entry(), &server).unwrap();
    assert!(server.requests()[1].contains("bytes=29-"));
    assert_eq!(fs::read(place.store.path(&entry())).unwrap(), WEIGHTS);
}

/// Stops when so many bytes have arrived.
struct StopWithPart(PathBuf, u64);

impl Progress for StopWithPart {
    fn update(&self, _: &str, _: usize, _: usize, _: &str) {}

    fn warn(&self, _: &str) {}

    fn cancelled(&self) -> bool {
        fs::metadata(&self.0).is_ok_and(|part| part.len() >= self.1)
    }
}

#[test]
fn bytes_that_were_not_published_are_refused() {
    let place = Place::new();
    let changed = Server::start(|_| Some(answer(200, &[], b"numbers that a network l3arned")));
    let error = place.refused(&entry(), &changed);
    assert!(matches!(error, WeightsError::Damaged(_)), "{error}");
    assert!(error.to_string().contains(SHA256), "{error}");
    assert!(!place.part().exists(), "wrong bytes are not kept");
    let shorter = Server::start(|_| Some(answer(200, &[], &WEIGHTS[1..])));
    let error = place.refused(&entry(), &shorter).to_string();
    assert!(error.contains("30 bytes was expected"), "{error}");
    let larger = Server::start(|_| Some(answer(200, &[], &[0; 1 << 20])));
    let error = place.refused(&entry(), &larger).to_string();
    assert!(
        error.contains("is larger than what was published"),
        "{error}"
    );
    let empty = Server::start(|_| Some(answer(200, &[], b"")));
    let error = place.refused(&unknown(), &empty).to_string();
    assert!(error.contains("an empty file"), "{error}");
}

/// Of a file without a known checksum the host's counts, which it says before it leads elsewhere.
#[test]
fn the_checksum_of_the_host_is_compared_and_its_token_stays_there() {
    let place = Place::new();
    // what the other host says of the file does not count
    let store = Server::start(|request| {
        let mut answer = file(request, "\"elsewhere\"");
        let line = format!("X-Linked-ETag: \"{}\"\r\n", "1".repeat(64));
        let end = answer.windows(2).position(|w| w == b"\r\n").unwrap() + 2;
        answer.splice(end..end, line.into_bytes());
        Some(answer)
    });
    let served = move |sha256: String| {
        let location = format!("Location: {}/file", store.url());
        let tag = format!("X-Linked-ETag: \"{sha256}\"");
        let commit = format!("X-Repo-Commit: {COMMIT}");
        let server = Server::start(move |request| {
            let lines = [location.as_str(), &tag, &commit];
            Some(match request.contains("/moved") {
                true => answer(302, &lines, b"moved"),
                false => answer(307, &["Location: /moved?x=y"], b""),
            })
        });
        (server, store.requests())
    };
    let (wrong, _) = served("0".repeat(64));
    let error = place.refused(&unknown(), &wrong);
    assert!(matches!(error, WeightsError::Damaged(_)), "{error}");
    let (server, _) = served(SHA256.to_owned());
    let record = place.fetch(&unknown(), &server).unwrap();
    assert!(record.published, "{record:?}");
    assert_eq!(record.commit.as_deref(), Some(COMMIT));
    assert_eq!(place.store.verify(&unknown()).unwrap(), Condition::AsAdded);
    let authorised = |requests: &[String]| {
        let has = |request: &String| request.to_ascii_lowercase().contains("bearer secret");
        requests.iter().map(has).collect::<Vec<_>>()
    };
    assert_eq!(authorised(&server.requests()), [true, true]);
    let (_, elsewhere) = served(String::new());
    assert_eq!(authorised(&elsewhere), [false, false]);
}

#[test]
fn without_any_checksum_the_first_bytes_are_trusted() {
    let place = Place::new();
    let server = Server::start(|_| Some(answer(200, &[], WEIGHTS)));
    let record = place.fetch(&unknown(), &server).unwrap();
    assert!(!record.published && record.sha256 == SHA256, "{record:?}");
    assert_eq!(place.fetch(&unknown(), &server).unwrap(), record);
    assert_eq!(server.requests().len(), 1);
    // another file from there is not, until the user removes the first one's record
    let path = place.store.path(&unknown());
    fs::remove_file(&path).unwrap();
    let other = Server::start(|_| Some(answer(200, &[], b"numbers of another network")));
    let error = place.fetch(&unknown(), &other).unwrap_err();
    assert!(matches!(error, WeightsError::Damaged(_)), "{error}");
    assert!(
        error.to_string().contains(SHA256) && error.to_string().contains("remove"),
        "{error}"
    );
    assert!(!path.exists() && !place.part().exists());
    let mine = place.path("mine.pt");
    fs::write(&mine, b"what the user wants").unwrap();
    add(&unknown(), &place.store, &mine, false).unwrap();
    fs::remove_dir_all(place.path("store/little")).unwrap();
    place.fetch(&unknown(), &other).unwrap();
}

#[test]
fn refusals_of_the_host_say_what_to_do() {
    let place = Place::new();
    for (status, category, words) in [
        (
            401,
            Category::NoInput,
            &["HF_TOKEN", "accept the terms"][..],
        ),
        (403, Category::NoInput, &["HF_TOKEN"]),
        (404, Category::NoInput, &["not at http://127.0.0.1", "404"]),
        (418, Category::TryAgain, &["HTTP 418"]),
    ] {
        let server = Server::start(move |_| Some(answer(status, &[], b"no")));
        let error = place.refused(&entry(), &server);
        assert_eq!(error.category(), category, "{error}");
        for word in words {
            assert!(
                error.to_string().contains(word),
                "{word:?} is not in {error}"
            );
        }
        assert_eq!(server.requests().len(), 1, "{status} lasts");
    }
    let around = Server::start(|_| Some(answer(302, &["Location: /again"], b"")));
    let error = place.refused(&entry(), &around).to_string();
    assert!(error.contains("too many redirections"), "{error}");
}

#[test]
fn a_busy_host_is_asked_again_but_not_for_ever() {
    let place = Place::new();
    let calls = AtomicUsize::new(0);
    let busy = Server::start(move |request| {
        Some(match calls.fetch_add(1, Ordering::SeqCst) {
            0 => answer(429, &["Retry-After: 1"], b""),
            1 => answer(503, &[], b""),
            _ => file(request, "\"one\""),
        })
    });
    let start = Instant::now();
    place.fetch(&entry(), &busy).unwrap();
    assert!(start.elapsed() >= Duration::from_secs(1), "Retry-After");
    fs::remove_dir_all(place.path("store/little")).unwrap();
    let closed = Server::start(|_| Some(answer(503, &[], b"")));
    let error = place.refused(&entry(), &closed);
    assert_eq!(error.category(), Category::TryAgain, "{error}");
    assert_eq!(closed.requests().len(), 5);
    let patient = Server::start(|_| Some(answer(429, &["Retry-After: 86400"], b"")));
    let error = place.refused(&entry(), &patient).to_string();
    assert!(error.contains("asks to wait 86400 s"), "{error}");
}

#[test]
fn a_silent_host_is_given_up_and_a_stop_does_not_wait_for_it() {
    let place = Place::new();
    let silent = Server::start(|_| None);
    let mut network = network(&silent);
    network.silence = Duration::from_millis(100);
    let error = fetch(&entry(), &place.store, &network, false, &Silent).unwrap_err();
    assert!(error.to_string().contains("does not answer"), "{error}");
    assert_eq!(silent.requests().len(), 5);
    network.silence = Duration::from_secs(600);
    let start = Instant::now();
    let error = fetch(
        &entry(),
        &place.store,
        &network,
        false,
        &StopAtPoll::after(4),
    )
    .unwrap_err();
    assert_eq!(error.category(), Category::Stopped, "{error}");
    assert!(start.elapsed() < Duration::from_secs(60));
    place.assert_nothing_installed();
}

#[test]
fn a_full_disk_and_no_network_are_told_before_anything_is_downloaded() {
    let place = Place::new();
    let server = Server::start(|request| Some(file(request, "\"one\"")));
    let full = Network {
        free_bytes: |_| Some(1_000_000),
        ..network(&server)
    };
    let error = fetch(&entry(), &place.store, &full, false, &Silent).unwrap_err();
    assert_eq!(error.category(), Category::CannotWrite, "{error}");
    assert!(error.to_string().contains("1 MB are free"), "{error}");
    assert!(!place.part().exists());
    let offline = Network {
        offline: true,
        ..network(&server)
    };
    let error = fetch(&entry(), &place.store, &offline, false, &Silent).unwrap_err();
    assert!(
        error.to_string().contains("HF_HUB_OFFLINE") && error.to_string().contains("/little.pt"),
        "{error}"
    );
    assert_eq!(server.requests().len(), 1);
    place.assert_nothing_installed();
}

#[cfg(target_os = "linux")]
#[test]
fn a_disk_that_fills_up_leaves_nothing_behind() {
    let place = Place::new();
    let server = Server::start(|request| Some(file(request, "\"one\"")));
    fs::create_dir_all(place.part().parent().unwrap()).unwrap();
    // where every write fails for lack of room
    std::os::unix::fs::symlink("/dev/full", place.part()).unwrap();
    let error = place.refused(&entry(), &server);
    assert_eq!(error.category(), Category::CannotWrite, "{error}");
    assert!(matches!(error, WeightsError::Write { .. }), "{error}");
    fs::remove_file(place.part()).unwrap();
    place.fetch(&entry(), &server).unwrap();
}

#[test]
fn a_proxy_is_asked_for_the_host_and_gets_no_token() {
    let place = Place::new();
    let proxy = Server::start(|_| Some(answer(502, &[], b"")));
    let network = Network {
        hugging_face: "https://weights.invalid".to_owned(),
        proxy: Some(ureq::Proxy::new(&proxy.url()).unwrap()),
        ..network(&proxy)
    };
    fetch(&entry(), &place.store, &network, false, &Silent).unwrap_err();
    place.assert_nothing_installed();
    let requests = proxy.requests();
    assert!(
        requests[0].starts_with("CONNECT weights.invalid:443 "),
        "{requests:?}"
    );
    assert!(!requests.concat().contains("secret"), "{requests:?}");
}

#[test]
fn of_two_at_once_one_waits_for_the_other() {
    let place = Place::new();
    let server = Server::start(|request| {
        thread::sleep(Duration::from_millis(200));
        Some(file(request, "\"one\""))
    });
    let records: Vec<Record> = thread::scope(|scope| {
        let fetches: Vec<_> = (0..2)
            .map(|_| scope.spawn(|| place.fetch(&entry(), &server).unwrap()))
            .collect();
        fetches.into_iter().map(|f| f.join().unwrap()).collect()
    });
    assert_eq!(records[0], records[1]);
    assert_eq!(server.requests().len(), 1);
    assert_eq!(place.store.verify(&entry()).unwrap(), Condition::Published);
}

fn zipped(members: &[&str]) -> Vec<u8> {
    let mut archive = zip::ZipWriter::new(Cursor::new(Vec::new()));
    for name in members {
        let options = zip::write::SimpleFileOptions::default();
        archive.start_file(*name, options).unwrap();
        archive.write_all(WEIGHTS).unwrap();
    }
    archive.finish().unwrap().into_inner()
}

#[test]
fn a_member_of_an_archive_is_installed() {
    let place = Place::new();
    let archive = |bytes: Vec<u8>| {
        let server = Server::start(move |_| Some(answer(200, &[], &bytes)));
        let entry = Entry {
            origin: Origin::Archive {
                url: server.url().leak(),
                member: "little.pt",
            },
            ..entry()
        };
        (server, entry)
    };
    let cut = &zipped(&["models/little.pt"])[..40];
    for (bytes, word) in [
        (
            zipped(&["models/other.pt"]),
            "0 files in it are named little.pt",
        ),
        (zipped(&["a/little.pt", "b/little.pt"]), "2 files in it"),
        (cut.to_vec(), "cannot be used for little"),
    ] {
        let (server, entry) = archive(bytes);
        let error = place.refused(&entry, &server);
        assert!(matches!(error, WeightsError::Damaged(_)), "{error}");
        assert!(error.to_string().contains(word), "{error}");
        assert!(!place.part().exists());
    }
    let (server, entry) = archive(zipped(&["models/little.pt", "models/other.pt"]));
    let record = place.fetch(&entry, &server).unwrap();
    assert!(record.source.contains("little.pt in it"), "{record:?}");
    assert_eq!(fs::read(place.store.path(&entry)).unwrap(), WEIGHTS);
}

#[test]
fn a_file_of_the_users_is_checked_too() {
    let place = Place::new();
    let path = place.path("mine.pt");
    fs::write(&path, b"something else").unwrap();
    let error = add(&entry(), &place.store, &path, false).unwrap_err();
    assert!(error.to_string().contains("mine.pt"), "{error}");
    assert_eq!(place.store.installed(&entry()), None);
    fs::write(&path, WEIGHTS).unwrap();
    assert!(add(&entry(), &place.store, &path, false).unwrap().published);
    assert!(path.is_file(), "the user's file stays");
    assert!(matches!(
        add(&entry(), &place.store, &place.path("none"), false),
        Err(WeightsError::Read { .. })
    ));
}

#[test]
fn licences_are_accepted_first() {
    let place = Place::new();
    let server = Server::start(|request| Some(file(request, "\"one\"")));
    let bound = Entry {
        commercial: false,
        ..entry()
    };
    let error = place.refused(&bound, &server);
    assert!(
        error.to_string().contains(m4_core::advice::LICENCE),
        "{error}"
    );
    assert!(server.requests().is_empty());
    let path = place.path("mine.pth");
    fs::write(&path, b"a checkpoint").unwrap();
    assert!(add(find("tapip3d").unwrap(), &place.store, &path, true).is_ok());
}
