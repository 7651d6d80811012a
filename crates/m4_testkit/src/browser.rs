//! Controls a headless Chromium with software WebGL2 through the DevTools protocol.

#![expect(clippy::unwrap_used, reason = "a test that cannot go on should stop")]

use crate::{Need, skip};
use serde_json::{Value, json};
use std::io::{BufRead, BufReader};
use std::net::TcpStream;
use std::path::PathBuf;
use std::process::{Child, Command, Stdio};
use std::time::Duration;
use tungstenite::{Message, WebSocket};

const WINDOW: (u32, u32) = (960, 600);
/// Names under which distributions install it, and the variable that overrules them.
const NAMES: [&str; 4] = [
    "chromium",
    "chromium-browser",
    "google-chrome",
    "google-chrome-stable",
];
const VARIABLE: &str = "MINUTE4D_CHROMIUM";
/// An answer that takes longer than this does not come.
const PATIENCE: Duration = Duration::from_secs(300);

const FLAGS: [&str; 14] = [
    "--headless",
    // the sandbox wants a user other than root
    "--no-sandbox",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    // reduced motion: nothing plays automatically
    "--force-prefers-reduced-motion",
    "--hide-scrollbars",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-dev-shm-usage",
    "--disable-quic",
    "--disable-sync",
    "--remote-debugging-port=0",
];

/// The program, if this machine has it; else the test is listed as skipped.
#[track_caller]
pub fn find_chromium() -> Option<PathBuf> {
    if let Some(path) = std::env::var_os(VARIABLE) {
        return Some(path.into());
    }
    let folders = std::env::var_os("PATH").unwrap_or_default();
    let program = std::env::split_paths(&folders)
        .flat_map(|folder| NAMES.map(|name| folder.join(name)))
        .find(|path| path.is_file());
    if program.is_none() {
        skip(
            Need::Chromium,
            &format!("no Chromium is on the PATH, and {VARIABLE} is not set"),
        );
    }
    program
}

/// A browser with one page of the viewer open; closes when dropped.
#[derive(Debug)]
pub struct Chromium {
    process: Child,
    socket: WebSocket<TcpStream>,
    session: String,
    next: u64,
    _profile: tempfile::TempDir,
}

impl Chromium {
    /// Opens `url` and waits until its script has run, not until a scene is there.
    pub fn open(program: PathBuf, url: &str) -> Self {
        let profile = tempfile::tempdir().unwrap();
        let mut process = Command::new(program)
            .args(FLAGS)
            .arg(format!("--window-size={},{}", WINDOW.0, WINDOW.1))
            .arg(format!("--user-data-dir={}", profile.path().display()))
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let mut lines = BufReader::new(process.stderr.take().unwrap()).lines();
        let address = lines
            .by_ref()
            .map_while(Result::ok)
            .find_map(|line| {
                line.strip_prefix("DevTools listening on ")
                    .map(str::to_owned)
            })
            .expect("Chromium says where it listens");
        // a full pipe would stop it
        std::thread::spawn(move || lines.map_while(Result::ok).for_each(drop));

        let host = address
            .strip_prefix("ws://")
            .unwrap()
            .split('/')
            .next()
            .unwrap();
        let stream = TcpStream::connect(host).unwrap();
        stream.set_read_timeout(Some(PATIENCE)).unwrap();
        let (socket, _) = tungstenite::client(address.as_str(), stream).unwrap();
        let mut page = Self {
            process,
            socket,
            session: String::new(),
            next: 0,
            _profile: profile,
        };
        let target = page.call("Target.createTarget", json!({"url": "about:blank"}));
        let attach = json!({"targetId": target["targetId"], "flatten": true});
        let session = page.call("Target.attachToTarget", attach)["sessionId"].take();
        page.session = session.as_str().unwrap().to_owned();
        page.call("Page.enable", json!({}));
        page.call("Page.navigate", json!({ "url": url }));
        page.wait_for("window.minute4d");
        page
    }

    /// The result of a method; panics with the message of an error.
    fn call(&mut self, method: &str, params: Value) -> Value {
        self.next += 1;
        let mut request = json!({"id": self.next, "method": method, "params": params});
        if !self.session.is_empty() {
            request["sessionId"] = json!(self.session);
        }
        self.socket
            .send(Message::text(request.to_string()))
            .unwrap();
        loop {
            let Message::Text(text) = self.socket.read().unwrap() else {
                continue;
            };
            let mut answer: Value = serde_json::from_str(&text).unwrap();
            if answer["id"] == json!(self.next) {
                assert!(answer["error"].is_null(), "{method}: {}", answer["error"]);
                return answer["result"].take();
            }
        }
    }

    /// Gives the page another size, pixels of the window and of the device alike.
    pub fn resize(&mut self, width: usize, height: usize) {
        self.call(
            "Emulation.setDeviceMetricsOverride",
            json!({"width": width, "height": height, "deviceScaleFactor": 1, "mobile": false}),
        );
        self.wait_for(&format!(
            "innerWidth === {width} && innerHeight === {height}"
        ));
    }

    /// Waits until a JavaScript expression is true.
    pub fn wait_for(&mut self, condition: &str) {
        self.eval(&format!("(async () => {{ while (!({condition})) await new Promise(r => setTimeout(r, 50)); }})()"));
    }

    /// The value of a JavaScript expression, awaited where it is a promise; panics with what it
    /// threw.
    pub fn eval(&mut self, expression: &str) -> Value {
        let params = json!({"expression": expression, "awaitPromise": true, "returnByValue": true});
        let mut answer = self.call("Runtime.evaluate", params);
        assert!(
            answer["exceptionDetails"].is_null(),
            "{expression}\n{}",
            answer["exceptionDetails"]
        );
        answer["result"]["value"].take()
    }
}

impl Drop for Chromium {
    fn drop(&mut self) {
        // nothing can be done if it has gone already
        let _gone = self.process.kill();
        let _ended = self.process.wait();
    }
}
