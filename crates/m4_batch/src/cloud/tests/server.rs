//! A web server of a few files, for tests.

use std::collections::HashMap;
use std::io::{BufRead, BufReader, Write};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex};
use std::thread::{self, JoinHandle};
use std::time::Duration;

/// What it has.
#[derive(Clone)]
pub(crate) struct Served {
    /// Without quotes; a file may have none.
    pub(crate) etag: Option<&'static str>,
    pub(crate) body: Vec<u8>,
}

#[derive(Default)]
struct Shared {
    files: Mutex<HashMap<String, Served>>,
    asked: Mutex<Vec<String>>,
    ended: AtomicBool,
}

/// It ends with the test. `/hang` is never answered.
pub(crate) struct Server {
    address: SocketAddr,
    shared: Arc<Shared>,
    thread: Option<JoinHandle<()>>,
}

impl Server {
    pub(crate) fn new() -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = listener.local_addr().unwrap();
        let shared = Arc::new(Shared::default());
        let of_thread = Arc::clone(&shared);
        let thread = thread::spawn(move || {
            while let Ok((stream, _)) = listener.accept() {
                if of_thread.ended.load(Ordering::SeqCst) {
                    return;
                }
                let shared = Arc::clone(&of_thread);
                thread::spawn(move || answer(stream, &shared));
            }
        });
        Self {
            address,
            shared,
            thread: Some(thread),
        }
    }

    pub(crate) fn uri(&self, name: &str) -> String {
        format!("http://{}/{name}", self.address)
    }

    pub(crate) fn put(&self, name: &str, etag: Option<&'static str>, body: &[u8]) {
        let served = Served {
            etag,
            body: body.to_vec(),
        };
        self.shared.files.lock().unwrap().insert(format!("/{name}"), served);
    }

    /// What it was asked since the last time, such as `GET /a.mp4`.
    pub(crate) fn asked(&self) -> Vec<String> {
        std::mem::take(&mut self.shared.asked.lock().unwrap())
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        self.shared.ended.store(true, Ordering::SeqCst);
        let _ = TcpStream::connect(self.address);
        if let Some(thread) = self.thread.take() {
            thread.join().unwrap();
        }
    }
}

/// One request; a client that goes away is none of the server's business.
fn answer(mut stream: TcpStream, shared: &Shared) {
    let Ok(reading) = stream.try_clone() else { return };
    let mut lines = BufReader::new(reading).lines().map_while(Result::ok);
    let first = lines.next().unwrap_or_default();
    while lines.next().is_some_and(|line| !line.is_empty()) {}
    let mut words = first.split(' ');
    let (method, path) = (words.next().unwrap_or_default(), words.next().unwrap_or_default());
    shared.asked.lock().unwrap().push(format!("{method} {path}"));
    while path == "/hang" && !shared.ended.load(Ordering::SeqCst) {
        thread::sleep(Duration::from_millis(20));
    }
    let served = shared.files.lock().unwrap().get(path).cloned();
    let (head, body) = match served {
        Some(served) => {
            let etag = served.etag.map_or_else(String::new, |e| format!("ETag: \"{e}\"\r\n"));
            let length = served.body.len();
            (format!("200 OK\r\n{etag}Content-Length: {length}"), served.body)
        }
        None => ("404 Not Found\r\nContent-Length: 0".to_owned(), Vec::new()),
    };
    let _ = stream.write_all(format!("HTTP/1.1 {head}\r\nConnection: close\r\n\r\n").as_bytes());
    if method == "GET" {
        let _ = stream.write_all(&body);
    }
}
