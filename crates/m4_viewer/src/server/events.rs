//! Server-sent events: those that a page has not received yet.

use super::Shared;
use super::guard::query_value;
use super::hub::{Hub, Pulse};
use axum::extract::State;
use axum::http::Uri;
use axum::response::sse::{Event, KeepAlive, Sse};
use futures_util::stream::{Stream, unfold};
use std::convert::Infallible;
use std::sync::Arc;
use std::time::Duration;
use tokio::sync::watch::Receiver;

/// Interval of keep-alive messages; also the delay until a closed page is noticed.
const BREATH: Duration = Duration::from_secs(5);

/// Events that one page has received.
struct Listener {
    hub: Arc<Hub>,
    pulse: Receiver<Pulse>,
    version: u64,
    logged: usize,
    end: Option<bool>,
}

/// The events from where the page stands: `seen` in the query is the version of the scene in it.
pub(super) async fn stream(
    State(shared): State<Shared>,
    uri: Uri,
) -> Sse<impl Stream<Item = Result<Event, Infallible>>> {
    let seen = query_value(uri.query(), "seen").and_then(|v| v.parse().ok());
    let listener =
        Listener { pulse: shared.hub.subscribe(), hub: shared.hub, version: seen.unwrap_or(0), logged: 0, end: None };
    let events = unfold(listener, |mut listener| async {
        let text = listener.next().await?;
        Some((Ok(Event::default().data(text)), listener))
    });
    Sse::new(events).keep_alive(KeepAlive::new().interval(BREATH))
}

impl Listener {
    /// The next event, once there is one; `None` when the server ends.
    async fn next(&mut self) -> Option<String> {
        loop {
            let pulse = *self.pulse.borrow_and_update();
            if self.logged < pulse.logged
                && let Some(line) = self.hub.logged(self.logged)
            {
                self.logged += 1;
                return Some(line.to_string());
            }
            if self.version != pulse.version {
                self.version = pulse.version;
                return Some(format!("{{\"event\":\"scene\",\"version\":{}}}", pulse.version));
            }
            if std::mem::replace(&mut self.end, pulse.end) != pulse.end
                && let Some(ok) = pulse.end
            {
                return Some(format!("{{\"event\":\"end\",\"ok\":{ok}}}"));
            }
            self.pulse.changed().await.ok()?;
        }
    }
}
