//! A headless Chromium that draws WebGL2 in software.

use headless_chrome::protocol::cdp::Emulation;
use headless_chrome::{Browser, LaunchOptions, Tab};
use serde_json::Value;
use std::ffi::OsStr;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::Duration;

/// Columns and rows of the window.
const WINDOW: (u32, u32) = (960, 600);

/// A browser with one page open.
pub struct Chromium {
    tab: Arc<Tab>,
    // closes when dropped
    _browser: Browser,
}

/// Names under which distributions install it, and the variable that overrules them.
const NAMES: [&str; 4] = ["chromium", "chromium-browser", "google-chrome", "google-chrome-stable"];
const VARIABLE: &str = "MINUTE4D_CHROMIUM";

/// The program, if this machine has it; else says that the test did not run.
pub fn find() -> Option<PathBuf> {
    if let Some(path) = std::env::var_os(VARIABLE) {
        return Some(path.into());
    }
    let folders = std::env::var_os("PATH").unwrap_or_default();
    let found = std::env::split_paths(&folders)
        .flat_map(|folder| NAMES.map(|name| folder.join(name)))
        .find(|path| path.is_file());
    if found.is_none() {
        eprintln!(
            "SKIPPED: no Chromium on the PATH and {VARIABLE} is not set; install Debian's package `chromium` to run this"
        );
    }
    found
}

impl Chromium {
    /// Opens `url` for somebody who likes things to keep still: nothing plays by itself.
    pub fn open(program: PathBuf, url: &str) -> Self {
        let args = [
            "--use-gl=angle",
            "--use-angle=swiftshader",
            "--enable-unsafe-swiftshader",
            "--disable-quic",
            "--no-first-run",
            "--hide-scrollbars",
        ];
        let options = LaunchOptions::default_builder()
            .path(Some(program))
            // the sandbox wants a user other than root
            .sandbox(false)
            .enable_gpu(true)
            .window_size(Some(WINDOW))
            .idle_browser_timeout(Duration::from_secs(300))
            .args(args.iter().map(OsStr::new).collect())
            .build()
            .unwrap();
        let browser = Browser::new(options).unwrap();
        let tab = browser.new_tab().unwrap();
        tab.set_default_timeout(Duration::from_secs(120));
        let page = Self { tab, _browser: browser };
        page.keep_still();
        page.tab.navigate_to(url).unwrap().wait_until_navigated().unwrap();
        page
    }

    fn keep_still(&self) {
        let media = Emulation::SetEmulatedMedia {
            media: None,
            features: Some(vec![Emulation::MediaFeature {
                name: "prefers-reduced-motion".to_owned(),
                value: "reduce".to_owned(),
            }]),
        };
        self.tab.call_method(media).unwrap();
    }

    /// The value of a JavaScript expression, awaited where it is a promise; panics with the message of
    /// what it threw.
    pub fn eval(&self, expression: &str) -> Value {
        let wrapped = format!(
            "(async () => {{ try {{ return JSON.stringify({{ok: (await ({expression})) ?? null}}); }} \
             catch (e) {{ return JSON.stringify({{error: String(e && e.stack || e)}}); }} }})()"
        );
        let text = self.tab.evaluate(&wrapped, true).unwrap().value.unwrap();
        let mut value: Value = serde_json::from_str(text.as_str().unwrap()).unwrap();
        assert!(value["error"].is_null(), "{expression}\n{}", value["error"]);
        value["ok"].take()
    }
}
