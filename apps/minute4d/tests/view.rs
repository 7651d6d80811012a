//! The page of a run and its server, from outside.

use crate::common::{Running, Scratch, write_capture};
use m4_io::scene::safetensors;
use m4_viewer::page;
use m4_viewer::payload::decode;
use serde_json::Value;
use std::fs;
use std::io::{BufRead, BufReader, Read, Write};
use std::net::{Ipv4Addr, TcpListener, TcpStream};
use std::process::{ChildStdout, Stdio};
use std::time::Duration;

fn with_capture() -> Scratch {
    let dir = Scratch::new();
    write_capture(&dir.path("capture"), false);
    dir
}

fn start(dir: &Scratch, line: &str) -> (Running, BufReader<ChildStdout>) {
    let mut child = dir
        .command(line)
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    let stdout = BufReader::new(child.stdout.take().unwrap());
    (Running(child), stdout)
}

/// The next event of that name on standard output.
fn event_of(stdout: &mut BufReader<ChildStdout>, name: &str) -> Value {
    loop {
        let mut line = String::new();
        assert!(stdout.read_line(&mut line).unwrap() > 0, "no event {name}");
        let event: Value = serde_json::from_str(&line).unwrap();
        if event["event"] == name {
            return event;
        }
    }
}

/// Port and token of an address that the program printed.
struct Place {
    port: u16,
    token: String,
}

impl Place {
    fn of(url: &str) -> Self {
        let rest = url.trim().strip_prefix("http://127.0.0.1:").unwrap();
        let (port, token) = rest.split_once("/?token=").unwrap();
        Self {
            port: port.parse().unwrap(),
            token: token.to_owned(),
        }
    }

    fn send(&self, target: &str) -> TcpStream {
        let mut stream = TcpStream::connect((Ipv4Addr::LOCALHOST, self.port)).unwrap();
        stream
            .set_read_timeout(Some(Duration::from_secs(60)))
            .unwrap();
        let host = format!("127.0.0.1:{}", self.port);
        write!(
            stream,
            "GET {target} HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n\r\n"
        )
        .unwrap();
        stream
    }

    /// Status and body of an answer to a request with the token.
    fn ask(&self, path: &str) -> (u16, Vec<u8>) {
        let mut all = Vec::new();
        self.send(&format!("{path}?token={}", self.token))
            .read_to_end(&mut all)
            .unwrap();
        let end = all.windows(4).position(|w| w == b"\r\n\r\n").unwrap();
        let head = String::from_utf8(all[..end].to_vec()).unwrap();
        (
            head.split(' ').nth(1).unwrap().parse().unwrap(),
            all[end + 4..].to_vec(),
        )
    }

    fn page(&self) -> page::Contents {
        let (status, html) = self.ask("/");
        assert_eq!(status, 200);
        page::read(std::str::from_utf8(&html).unwrap()).unwrap()
    }

    fn listen(&self, events: &str) -> BufReader<TcpStream> {
        BufReader::new(self.send(events))
    }
}

/// The data of the next event; `None` when the stream ends.
fn next_event(stream: &mut BufReader<TcpStream>) -> Option<Value> {
    loop {
        let mut line = String::new();
        if stream.read_line(&mut line).unwrap_or(0) == 0 {
            return None;
        }
        if let Some(data) = line.strip_prefix("data: ") {
            return Some(serde_json::from_str(data).unwrap());
        }
    }
}

#[test]
fn run_writes_a_page_with_its_scene() {
    let dir = with_capture();
    dir.succeed("train capture -o out --iterations 60");
    let file = dir.path("out/viewer.html");
    let html = fs::read_to_string(&file).unwrap();
    let record = dir.json("out/run.json");
    assert_eq!(record["files"]["viewer.html"]["bytes"], html.len());
    assert!(record["stages"]["viewer"]["seconds"].as_f64().unwrap() > 0.0);
    let held = page::read(&html).unwrap();
    let scene = safetensors::read(&dir.path("out/scene.safetensors"))
        .unwrap()
        .scene;
    let splats = decode(&held.payload.unwrap()).unwrap();
    // invisible ones are left out
    assert!(splats.n() <= scene.splats.n() && splats.n() > scene.splats.n() / 2);
    assert_eq!(held.manifest.cameras.len(), 6);
    assert_eq!(held.frames.unwrap().index.offsets.len(), 7);
    assert!(held.manifest.live.is_none() && held.manifest.safe.radius > 0.0);

    // another scene: the page of the old one must not stay
    dir.succeed("train capture -o out --iterations 30 --force --no-viewer");
    assert!(!file.exists());
    assert!(dir.json("out/run.json")["files"]["viewer.html"].is_null());
    let again = dir.succeed("train capture -o out --iterations 30 --resume");
    assert!(
        file.exists(),
        "asked for later, it is made of the scene that is there"
    );
    assert!(
        again.stderr.contains("train: already done") && again.stderr.contains("viewer.html"),
        "{}",
        again.stderr
    );
}

#[test]
fn view_shows_the_scene_and_its_replacement() {
    let dir = with_capture();
    dir.succeed("train capture -o out --iterations 30 --no-viewer");
    dir.succeed("train capture -o other --iterations 40 --no-viewer");

    #[cfg_attr(not(unix), expect(unused_mut, reason = "waited for on Unix alone"))]
    let (mut running, mut stdout) = start(&dir, "view out --no-open");
    let mut url = String::new();
    stdout.read_line(&mut url).unwrap();
    let place = Place::of(&url);

    let first = place.page();
    let live = first.manifest.live.clone().unwrap();
    assert_eq!(
        first.frames.unwrap().index.offsets.len(),
        7,
        "the frames of the capture it was made of"
    );
    let mut events = place.listen(&live.events);
    let heard: Vec<Value> = (0..2).map(|_| next_event(&mut events).unwrap()).collect();
    assert_eq!(
        (&heard[0]["event"], &heard[0]["iteration"]),
        (&"metrics".into(), &30.into())
    );
    assert_eq!(
        (&heard[1]["event"], &heard[1]["ok"]),
        (&"end".into(), &true.into())
    );

    // a broken file is not shown, a whole one is
    let scene = dir.path("out/scene.safetensors");
    fs::write(&scene, b"not a scene").unwrap();
    std::thread::sleep(Duration::from_millis(1500));
    assert_eq!(
        place.page().payload,
        first.payload,
        "the scene before stays"
    );
    fs::copy(dir.path("other/scene.safetensors"), dir.path("out/new")).unwrap();
    fs::rename(dir.path("out/new"), &scene).unwrap();
    let event = next_event(&mut events).unwrap();
    assert_eq!(
        (&event["event"], &event["version"]),
        (&"scene".into(), &2.into())
    );
    let (status, answer) = place.ask("/scene");
    assert_eq!(status, 200);
    let second = place.page().payload.unwrap();
    assert_ne!(Some(&second), first.payload.as_ref());
    assert!(answer.ends_with(&second));

    #[cfg(unix)]
    {
        running.signal("-INT");
        assert_eq!(running.0.wait().unwrap().code(), Some(0));
    }
}

#[test]
fn view_rejects_bad_arguments_and_broken_scenes() {
    let dir = with_capture();
    dir.write("broken.safetensors", b"not a scene");
    fs::create_dir(dir.path("empty")).unwrap();
    dir.refused(
        "view broken.safetensors --no-open",
        65,
        &["broken.safetensors"],
    );
    dir.refused(
        "view nowhere --no-open",
        66,
        &["no scene or run", "nowhere"],
    );
    dir.refused("view empty --no-open", 66, &["no scene or run"]);
    dir.succeed("train capture -o out --iterations 20 --no-viewer");
    let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
    let port = listener.local_addr().unwrap().port().to_string();
    let words = ["in use", "--port", &port];
    dir.refused(&format!("view out --no-open --port {port}"), 75, &words);
}

#[test]
fn training_with_a_live_page_gives_identical_bits() {
    let dir = with_capture();
    dir.succeed("train capture -o alone --iterations 1500");
    let line = "train capture -o seen --iterations 1500 --view --no-open --json";
    let (mut running, mut stdout) = start(&dir, line);
    let url = event_of(&mut stdout, "view")["url"]
        .as_str()
        .unwrap()
        .to_owned();
    let reader = std::thread::spawn(move || {
        stdout
            .lines()
            .map_while(Result::ok)
            .collect::<Vec<String>>()
    });
    let place = Place::of(&url);
    let mut events = place.listen(&place.page().manifest.live.unwrap().events);
    let heard: Vec<Value> = std::iter::from_fn(|| next_event(&mut events)).collect();
    assert_eq!(
        running.0.wait().unwrap().code(),
        Some(0),
        "without a terminal it ends by itself"
    );
    let last: Value = serde_json::from_str(reader.join().unwrap().last().unwrap()).unwrap();
    assert_eq!((&last["event"], &last["ok"]), (&"end".into(), &true.into()));

    let names: Vec<&str> = heard.iter().map(|e| e["event"].as_str().unwrap()).collect();
    let first_scene = names.iter().position(|n| *n == "scene").unwrap();
    assert!(
        first_scene + 2 < names.len(),
        "a scene while it trained: {names:?}"
    );
    assert_eq!(
        &names[names.len() - 2..],
        ["scene", "end"],
        "the result, then the end"
    );
    let metrics = heard.iter().rfind(|e| e["event"] == "metrics").unwrap();
    assert_eq!(
        (&metrics["iteration"], &metrics["iterations"]),
        (&1500.into(), &1500.into())
    );
    assert!(
        dir.read("alone/scene.safetensors") == dir.read("seen/scene.safetensors"),
        "the scenes differ"
    );
    let mut pages = ["alone", "seen"].map(|run| {
        let html = String::from_utf8(dir.read(&format!("{run}/viewer.html"))).unwrap();
        page::read(&html).unwrap()
    });
    for page in &mut pages {
        page.manifest.title.clear();
    }
    assert!(pages[0] == pages[1], "the pages differ");
}

#[test]
fn view_accepts_a_bare_scene_file_and_a_checkpoint() {
    let dir = with_capture();
    dir.succeed("train capture -o out --iterations 20 --no-viewer");
    let (_running, mut stdout) = start(&dir, "view out/scene.safetensors --no-open --json");
    let event = event_of(&mut stdout, "result");
    let page = Place::of(event["result"]["url"].as_str().unwrap()).page();
    assert!(page.payload.is_some() && page.frames.is_none());
    assert_eq!(page.manifest.title, "scene");

    // a folder in which training continues: no scene yet, a checkpoint
    fs::create_dir(dir.path("out/checkpoints")).unwrap();
    fs::rename(
        dir.path("out/scene.safetensors"),
        dir.path("out/checkpoints/0000020.safetensors"),
    )
    .unwrap();
    let (_running, mut stdout) = start(&dir, "view out --no-open --json");
    let event = event_of(&mut stdout, "result");
    assert_eq!(
        Place::of(event["result"]["url"].as_str().unwrap())
            .page()
            .payload,
        page.payload
    );

    // a folder in which a replacement was interrupted after it was complete
    fs::create_dir(dir.path("replaced")).unwrap();
    fs::rename(dir.path("out"), dir.path("replaced/.minute4d-run-done")).unwrap();
    let (_running, mut stdout) = start(&dir, "view replaced --no-open --json");
    let event = event_of(&mut stdout, "result");
    assert_eq!(
        Place::of(event["result"]["url"].as_str().unwrap())
            .page()
            .payload,
        page.payload
    );
}
