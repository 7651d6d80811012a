//! Requests over HTTPS, in a thread of their own: the caller can stop waiting for the answer.

use super::registry::HUGGING_FACE;
use std::env;
use std::io::{self, Read};
use std::path::Path;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread;
use std::time::Duration;
use ureq::http::header::{
    ACCEPT_ENCODING, AUTHORIZATION, CONTENT_LENGTH, CONTENT_RANGE, ETAG, IF_RANGE, LOCATION, RANGE,
    RETRY_AFTER,
};
use ureq::http::{HeaderMap, Response, Uri};
use ureq::tls::{Certificate, RootCerts, TlsConfig};
use ureq::{Agent, Body, Proxy, RequestBuilder, typestate::WithoutBody};

/// Most redirections of a request.
const MAX_REDIRECTS: usize = 8;
/// Bytes that are handed over at once.
const PIECE_BYTES: usize = 1 << 18;

/// How weights are fetched.
#[derive(Debug, Clone)]
pub struct Network {
    /// The address of Hugging Face or of a mirror, without a slash at its end.
    pub(super) hugging_face: String,
    pub(super) token: Option<String>,
    pub(super) offline: bool,
    pub(super) proxy: Option<Proxy>,
    /// Longest time until a connection stands.
    pub(super) connect: Duration,
    /// Longest time without a byte.
    pub(super) silence: Duration,
    /// Pause before the second attempt; each further one doubles it.
    pub(super) pause: Duration,
    /// Free room of a folder's disk in bytes, where that is known.
    pub(super) free_bytes: fn(&Path) -> Option<u64>,
}

impl Network {
    /// That of this user, by the variables of the environment that Hugging Face's own programs
    /// read: `HF_ENDPOINT` (a mirror), `HF_TOKEN` and `HF_HUB_OFFLINE`; and by `HTTPS_PROXY`,
    /// `ALL_PROXY` and `NO_PROXY`.
    pub fn of_user() -> Self {
        let named = |name: &str| env::var(name).ok().filter(|value| !value.is_empty());
        let mirror = named("HF_ENDPOINT").unwrap_or_else(|| HUGGING_FACE.to_owned());
        let offline = named("HF_HUB_OFFLINE").map(|value| value.to_ascii_lowercase());
        Self {
            hugging_face: mirror.trim_end_matches('/').to_owned(),
            token: named("HF_TOKEN"),
            offline: offline
                .is_some_and(|value| matches!(value.as_str(), "1" | "on" | "yes" | "true")),
            proxy: Proxy::try_from_env(),
            connect: Duration::from_secs(30),
            silence: Duration::from_secs(60),
            pause: Duration::from_secs(1),
            free_bytes,
        }
    }

    /// Returns the address that `origin` is fetched from.
    pub fn url(&self, origin: &super::Origin) -> String {
        origin.url(&self.hugging_face)
    }

    /// Asks for `url` from byte `start` on, if it still has the ETag; the answer comes in pieces.
    pub(super) fn get(&self, url: &str, resume: Option<(u64, String)>) -> Receiver<Answer> {
        let (send, receive) = sync_channel(4);
        let (network, url) = (self.clone(), url.to_owned());
        thread::spawn(move || {
            // A receiver that is gone has stopped.
            let _ = match network.answer(&url, resume.as_ref(), &send) {
                Ok(()) => send.send(Answer::End),
                Err(failure) => send.send(Answer::Failed(failure)),
            };
        });
        receive
    }

    fn answer(
        &self,
        url: &str,
        resume: Option<&(u64, String)>,
        send: &SyncSender<Answer>,
    ) -> Result<(), Failure> {
        let agent = self.agent();
        // without it is a mirror of the user's alone
        let secure = url.starts_with("https://");
        let mut url = url.to_owned();
        let mut head = Head::default();
        for _ in 0..=MAX_REDIRECTS {
            if secure && !url.starts_with("https://") {
                return Err(Failure::lasting(format!(
                    "it leads to {url}, without HTTPS"
                )));
            }
            let mut request = agent.get(&url).header(ACCEPT_ENCODING, "identity");
            if let Some((start, etag)) = resume {
                request = request
                    .header(RANGE, format!("bytes={start}-"))
                    .header(IF_RANGE, etag);
            }
            request = self.authorised(request, &url);
            let response = request.call().map_err(Failure::from)?;
            head.add(&response);
            if !response.status().is_redirection() {
                // the other side has stopped
                let Ok(()) = send.send(Answer::Head(head)) else {
                    return Ok(());
                };
                return pieces(response.into_body(), send);
            }
            let location = text(response.headers(), LOCATION.as_str()).unwrap_or_default();
            url = resolved(&url, &location)
                .ok_or_else(|| Failure::lasting(format!("{url} leads to no address")))?;
        }
        Err(Failure::lasting(format!("{url}: too many redirections")))
    }

    /// The token is for Hugging Face or its mirror, and for no host that it leads to.
    fn authorised(
        &self,
        request: RequestBuilder<WithoutBody>,
        url: &str,
    ) -> RequestBuilder<WithoutBody> {
        match &self.token {
            Some(token) if origin_of(url) == origin_of(&self.hugging_face) => {
                request.header(AUTHORIZATION, format!("Bearer {token}"))
            }
            _ => request,
        }
    }

    fn agent(&self) -> Agent {
        // those of the system, which an organisation may have added to; Mozilla's where it has none
        let own: Vec<_> = rustls_native_certs::load_native_certs().certs;
        let own: Vec<_> = own
            .iter()
            .map(|certificate| Certificate::from_der(certificate).to_owned())
            .collect();
        let roots = match own.is_empty() {
            true => RootCerts::WebPki,
            false => RootCerts::Specific(Arc::new(own)),
        };
        Agent::config_builder()
            .tls_config(TlsConfig::builder().root_certs(roots).build())
            .proxy(self.proxy.clone())
            .user_agent(concat!("minute4d/", env!("CARGO_PKG_VERSION")))
            .http_status_as_error(false)
            .max_redirects(0)
            .max_redirects_will_error(false)
            .timeout_resolve(Some(self.connect))
            .timeout_connect(Some(self.connect))
            .timeout_recv_response(Some(self.silence))
            .timeout_per_read(Some(self.silence))
            .build()
            .into()
    }
}

#[cfg(unix)]
fn free_bytes(folder: &Path) -> Option<u64> {
    let disk = rustix::fs::statvfs(folder).ok()?;
    disk.f_bavail.checked_mul(disk.f_frsize)
}

/// What std does not tell; a full disk is found when it is written to.
#[cfg(not(unix))]
fn free_bytes(_: &Path) -> Option<u64> {
    None
}

/// A part of an answer, in this order: one head, pieces of the body, and the end or a failure.
#[derive(Debug)]
pub(super) enum Answer {
    Head(Head),
    Piece(Vec<u8>),
    End,
    Failed(Failure),
}

/// What an answer says of itself; Hugging Face says some of it before it leads to another host.
#[derive(Debug, Default)]
pub(super) struct Head {
    pub status: u16,
    /// The strong validator of these bytes.
    pub etag: Option<String>,
    /// Bytes of the body.
    pub length: Option<u64>,
    /// The first byte and the length of the whole file, of an answer in part.
    pub range: Option<(u64, u64)>,
    /// Seconds until the next attempt.
    pub retry_after_s: Option<u64>,
    /// SHA-256 of the file, of a server that keeps it in Git LFS.
    pub sha256: Option<String>,
    /// The commit that the file is of.
    pub commit: Option<String>,
}

impl Head {
    fn add(&mut self, response: &Response<Body>) {
        let headers = response.headers();
        let field = |name: &str| text(headers, name);
        let number = |name: &str| field(name)?.trim().parse().ok();
        let quoted = |name: &str| Some(field(name)?.trim_matches('"').to_ascii_lowercase());
        let hexadecimal = |text: &String| text.bytes().all(|b| b.is_ascii_hexdigit());
        let sha256 = quoted("x-linked-etag").filter(|sum| sum.len() == 64 && hexadecimal(sum));
        let commit = quoted("x-repo-commit").filter(|sum| sum.len() == 40 && hexadecimal(sum));
        *self = Self {
            status: response.status().as_u16(),
            etag: field(ETAG.as_str()).filter(|etag| etag.starts_with('"')),
            length: number(CONTENT_LENGTH.as_str()),
            range: field(CONTENT_RANGE.as_str()).and_then(|range| {
                let (bytes, total) = range.strip_prefix("bytes ")?.split_once('/')?;
                let (start, _) = bytes.split_once('-')?;
                Some((start.parse().ok()?, total.parse().ok()?))
            }),
            retry_after_s: number(RETRY_AFTER.as_str()),
            // the first host's word counts, not that of one that it leads to
            sha256: self.sha256.take().or(sha256),
            commit: self.commit.take().or(commit),
        };
    }
}

fn text(headers: &HeaderMap, name: &str) -> Option<String> {
    Some(headers.get(name)?.to_str().ok()?.to_owned())
}

/// Why no answer came.
#[derive(Debug)]
pub(super) struct Failure {
    pub reason: String,
    /// Whether another attempt may succeed.
    pub passing: bool,
}

impl Failure {
    fn lasting(reason: String) -> Self {
        Self {
            reason,
            passing: false,
        }
    }
}

/// Errors of a connection that broke.
const BROKEN: [io::ErrorKind; 7] = [
    io::ErrorKind::UnexpectedEof,
    io::ErrorKind::ConnectionReset,
    io::ErrorKind::ConnectionAborted,
    io::ErrorKind::BrokenPipe,
    io::ErrorKind::TimedOut,
    io::ErrorKind::HostUnreachable,
    io::ErrorKind::NetworkUnreachable,
];

impl From<ureq::Error> for Failure {
    fn from(error: ureq::Error) -> Self {
        let passing = match &error {
            ureq::Error::Timeout(_) => true,
            ureq::Error::Io(error) => BROKEN.contains(&error.kind()),
            _ => false,
        };
        let reason = match &error {
            ureq::Error::HostNotFound => "the host was not found".to_owned(),
            ureq::Error::Timeout(_) => "the host does not answer".to_owned(),
            other => other.to_string(),
        };
        Self { reason, passing }
    }
}

fn pieces(body: Body, send: &SyncSender<Answer>) -> Result<(), Failure> {
    let mut reader = body.into_reader();
    loop {
        let mut piece = vec![0; PIECE_BYTES];
        let n = reader
            .read(&mut piece)
            .map_err(|error| Failure::from(ureq::Error::from(error)))?;
        piece.truncate(n);
        if n == 0 || send.send(Answer::Piece(piece)).is_err() {
            return Ok(());
        }
    }
}

/// Scheme, host and port.
fn origin_of(url: &str) -> Option<(String, String)> {
    let url: Uri = url.parse().ok()?;
    let part = |text: &str| text.to_ascii_lowercase();
    Some((part(url.scheme_str()?), part(url.authority()?.as_str())))
}

/// The address `location`, which may be relative to `base`.
fn resolved(base: &str, location: &str) -> Option<String> {
    if location.starts_with("https://") || location.starts_with("http://") {
        return Some(location.to_owned());
    }
    let base: Uri = base.parse().ok()?;
    let (scheme, authority) = (base.scheme_str()?, base.authority()?);
    let path = match location {
        "" => return None,
        _ if location.starts_with("//") => return Some(format!("{scheme}:{location}")),
        _ if location.starts_with('/') => location.to_owned(),
        _ => format!("{}/{location}", base.path().rsplit_once('/')?.0),
    };
    Some(format!("{scheme}://{authority}{path}"))
}

#[cfg(test)]
mod tests {
    use super::{origin_of, resolved};

    #[test]
    fn locations_are_relative_to_the_address_that_named_them() {
        let base = "https://Host.example:8443/a/b?c=d";
        for (location, expected) in [
            ("https://other.example/x", "https://other.example/x"),
            ("//other.example/x", "https://other.example/x"),
            ("/x?y=z", "https://Host.example:8443/x?y=z"),
            ("x?y=z://", "https://Host.example:8443/a/x?y=z://"),
        ] {
            assert_eq!(resolved(base, location).as_deref(), Some(expected));
        }
        assert_eq!(resolved(base, ""), None);
        assert_eq!(
            origin_of(base),
            origin_of("https://host.example:8443/other")
        );
        for other in [
            "http://host.example:8443",
            "https://host.example",
            "https://host.example.net:8443",
            "https://host.example:8443@other.example",
        ] {
            assert_ne!(origin_of(base), origin_of(other), "{other}");
        }
    }
}
