//! The server from outside: responses and events.

use crate::contents::{manifest_of, scene};
use m4_viewer::Manifest;
use m4_viewer::page;
use m4_viewer::payload::{decode, encode};
use m4_viewer::server::{Hub, Metrics, ServeError, Server};
use std::io::{BufRead, BufReader, ErrorKind, Read, Write};
use std::net::{Ipv4Addr, TcpListener, TcpStream};
use std::sync::Arc;
use std::time::Duration;

fn shown(n_static: usize) -> (Manifest, Vec<u8>) {
    let scene = scene(n_static, 3);
    let payload = encode(&scene, 4.0);
    (manifest_of(&scene, &payload), payload.bytes)
}

struct Place {
    port: u16,
    token: String,
}

impl Place {
    fn of(server: &Server) -> Self {
        let rest = server.url().strip_prefix("http://127.0.0.1:").unwrap();
        let (port, token) = rest.split_once("/?token=").unwrap();
        Self {
            port: port.parse().unwrap(),
            token: token.to_owned(),
        }
    }

    fn host(&self) -> String {
        format!("127.0.0.1:{}", self.port)
    }

    fn send(&self, method: &str, target: &str, host: &str) -> TcpStream {
        let mut stream = TcpStream::connect((Ipv4Addr::LOCALHOST, self.port)).unwrap();
        stream
            .set_read_timeout(Some(Duration::from_secs(20)))
            .unwrap();
        write!(
            stream,
            "{method} {target} HTTP/1.1\r\nHost: {host}\r\nConnection: close\r\n\r\n"
        )
        .unwrap();
        stream
    }

    fn ask(&self, method: &str, target: &str, host: &str) -> (u16, String, Vec<u8>) {
        let mut all = Vec::new();
        self.send(method, target, host)
            .read_to_end(&mut all)
            .unwrap();
        let end = all.windows(4).position(|w| w == b"\r\n\r\n").unwrap();
        let head = String::from_utf8(all[..end].to_vec()).unwrap();
        let status = head.split(' ').nth(1).unwrap().parse().unwrap();
        (status, head.to_lowercase(), all[end + 4..].to_vec())
    }

    fn status(&self, target: &str) -> u16 {
        self.ask("GET", target, &self.host()).0
    }

    fn with_token(&self, path: &str) -> String {
        format!("{path}?token={}", self.token)
    }

    /// An open stream of events, for a page that shows `version`.
    fn listen(&self, version: u64) -> BufReader<TcpStream> {
        let target = format!("/events?token={}&seen={version}", self.token);
        BufReader::new(self.send("GET", &target, &self.host()))
    }
}

fn next_event(stream: &mut BufReader<TcpStream>) -> serde_json::Value {
    loop {
        let mut line = String::new();
        assert!(stream.read_line(&mut line).unwrap() > 0, "the stream ended");
        if let Some(data) = line.strip_prefix("data: ") {
            return serde_json::from_str(data).unwrap();
        }
    }
}

fn serve() -> (Arc<Hub>, Server, Place) {
    let hub = Hub::waiting("a test");
    let server = Server::start(Arc::clone(&hub), 0).unwrap();
    let place = Place::of(&server);
    (hub, server, place)
}

#[test]
fn only_the_right_token_and_host_get_in() {
    let (hub, _server, place) = serve();
    let (manifest, payload) = shown(20);
    hub.show(manifest, payload);
    for path in [
        "/",
        "/scene",
        "/events",
        "/etc/passwd",
        "/../Cargo.toml",
        "/%2e%2e/Cargo.toml",
    ] {
        assert_eq!(place.status(path), 403, "{path}");
        let wrong = "0".repeat(place.token.len());
        assert_eq!(
            place.status(&format!("{path}?token={wrong}")),
            403,
            "{path}"
        );
        let (status, head, body) = place.ask("GET", &place.with_token(path), "example.com");
        assert_eq!(status, 403, "{path}");
        assert!(body.len() < 200 && head.contains("no-store"));
        let rebound = format!("example.com:{}", place.port);
        assert_eq!(
            place.ask("GET", &place.with_token(path), &rebound).0,
            403,
            "{path}"
        );
    }
    let by_name = format!("localhost:{}", place.port);
    assert_eq!(
        place.ask("GET", &place.with_token("/scene"), &by_name).0,
        200
    );
}

#[test]
fn server_serves_only_page_and_scene() {
    let (hub, _server, place) = serve();
    let (manifest, payload) = shown(20);
    hub.show(manifest, payload);
    let nowhere = [
        "/etc/passwd",
        "/../Cargo.toml",
        "/%2e%2e/Cargo.toml",
        "//",
        "/scene/",
        "/index.html",
        "/..",
    ];
    for path in nowhere {
        assert_eq!(place.status(&place.with_token(path)), 404, "{path}");
    }
    for method in ["POST", "PUT", "DELETE", "OPTIONS"] {
        let (status, _, _) = place.ask(method, &place.with_token("/"), &place.host());
        assert_eq!(status, 405, "{method}");
    }
}

#[test]
fn served_page_holds_the_newest_scene_and_the_event_address() {
    let (hub, server, place) = serve();
    assert_eq!(
        place.status(&place.with_token("/scene")),
        404,
        "there is none yet"
    );
    let (_, _, html) = place.ask("GET", &place.with_token("/"), &place.host());
    assert_eq!(
        page::read(std::str::from_utf8(&html).unwrap())
            .unwrap()
            .payload,
        None
    );

    let (manifest, payload) = shown(20);
    hub.show(manifest.clone(), payload.clone());
    let (status, head, html) = place.ask("GET", &place.with_token("/"), &place.host());
    assert_eq!(status, 200);
    for words in [
        "text/html",
        "no-store",
        "nosniff",
        "default-src 'none'",
        "no-referrer",
        "frame-ancestors 'none'",
    ] {
        assert!(head.contains(words), "{words} is not in {head}");
    }
    let back = page::read(std::str::from_utf8(&html).unwrap()).unwrap();
    assert_eq!(back.payload.as_ref(), Some(&payload));
    let live = back.manifest.live.unwrap();
    assert_eq!(live.token, place.token);
    assert!(live.events.ends_with("&seen=1"), "{}", live.events);
    let (_, head, answer) = place.ask("GET", &live.scene, &place.host());
    assert!(head.contains("application/octet-stream"));
    let end = 4 + u32::from_le_bytes(answer[..4].try_into().unwrap()) as usize;
    let told: Manifest = serde_json::from_slice(&answer[4..end]).unwrap();
    assert_eq!(told.splats, manifest.splats);
    assert_eq!(decode(&answer[end..]).unwrap().n(), 23);
    drop(server);
    assert!(
        TcpStream::connect((Ipv4Addr::LOCALHOST, place.port)).is_err(),
        "the server has ended"
    );
}

#[test]
fn pages_hear_of_scenes_metrics_and_the_end() {
    let (hub, _server, place) = serve();
    let metrics = |iteration| Metrics {
        iteration,
        iterations: 100,
        loss: 0.25,
        psnr: f64::NAN,
        splats: 7,
    };
    hub.metrics(&metrics(50));
    let mut early = place.listen(0);
    assert_eq!(
        next_event(&mut early)["iteration"],
        50,
        "earlier state is sent"
    );
    assert_eq!(hub.listeners(), 1);
    for splats in [5, 6] {
        let (manifest, payload) = shown(splats);
        hub.show(manifest, payload);
        let event = next_event(&mut early);
        assert_eq!(
            (&event["event"], &event["version"]),
            (&"scene".into(), &(splats - 4).into())
        );
    }
    hub.metrics(&metrics(100));
    hub.end(true);
    hub.end(true);
    let event = next_event(&mut early);
    assert_eq!(
        (&event["event"], &event["iteration"], &event["psnr"]),
        (&"metrics".into(), &100.into(), &serde_json::Value::Null)
    );
    let event = next_event(&mut early);
    assert_eq!(
        (&event["event"], &event["ok"]),
        (&"end".into(), &true.into())
    );

    let mut late = place.listen(2);
    let events: Vec<_> = (0..3)
        .map(|_| next_event(&mut late)["event"].clone())
        .collect();
    assert_eq!(
        events,
        ["metrics", "metrics", "end"],
        "the scene was in its page"
    );
    hub.metrics(&metrics(10));
    hub.end(false);
    for stream in [&mut early, &mut late] {
        assert_eq!(next_event(stream)["iteration"], 10);
        assert_eq!(next_event(stream)["ok"], false);
    }
}

#[test]
fn a_port_in_use_is_an_error() {
    let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).unwrap();
    let port = listener.local_addr().unwrap().port();
    let error = Server::start(Hub::waiting("x"), port).unwrap_err();
    assert!(
        matches!(error, ServeError::InUse(p) if p == port),
        "{error}"
    );
    assert!(error.to_string().contains(m4_core::advice::PORT));
}

#[test]
fn nothing_listens_beyond_this_machine() {
    let (_hub, _server, place) = serve();
    // another address of the loopback network reaches a listener on all addresses, not this one
    assert!(TcpStream::connect(("127.0.0.2", place.port)).is_err());
}

#[test]
fn idle_connections_take_a_limited_number_of_files() {
    let (_hub, _server, place) = serve();
    let idle: Vec<TcpStream> = (0..100)
        .map(|_| TcpStream::connect((Ipv4Addr::LOCALHOST, place.port)).unwrap())
        .collect();
    let mut late = place.send("GET", &place.with_token("/"), &place.host());
    late.set_read_timeout(Some(Duration::from_millis(700)))
        .unwrap();
    let mut start = [0; 15];
    let waiting = late.read(&mut start).unwrap_err();
    assert!(
        matches!(waiting.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut),
        "{waiting}"
    );
    drop(idle);
    late.set_read_timeout(Some(Duration::from_secs(20)))
        .unwrap();
    late.read_exact(&mut start).unwrap();
    assert_eq!(&start, b"HTTP/1.1 200 OK");
}
