//! Serves the page from this machine, and notifies it of newer scenes.
//!
//! It listens on 127.0.0.1 alone and answers three addresses: `/` (the page with the newest scene
//! and the frames in it), `/scene` (the newest scene) and `/events` (server-sent events). Nothing
//! that it answers comes from a path in a request, so there is no way into the file system. Every
//! request must name this machine as its host (a page of elsewhere whose name was made to point
//! here does not) and carry the token that the address of the page ends in; all others get 403 and
//! are closed. Connections are few at a time, and closed when they do nothing.
//!
//! An event is a JSON object:
//!
//! ```json
//! {"event":"metrics","iteration":50,"iterations":4000,"loss":0.03,"psnr":30.1,"splats":41210}
//! {"event":"scene","version":3}
//! {"event":"end","ok":true}
//! ```
//!
//! A page that connects late gets every `metrics` so far; of several scenes that were not fetched
//! only the newest is kept.
//!
//! The answer to `/scene` is the length of the manifest (u32, little endian), a
//! [`Manifest`](crate::Manifest) as JSON that describes this scene, and the payload without gzip.

mod guard;
mod hub;
mod limits;

pub use hub::{Hub, Metrics};

use crate::page::{self, Compression, PageError, TEMPLATE};
use axum::Router;
use axum::body::Bytes;
use axum::extract::State;
use axum::http::{StatusCode, header};
use axum::response::{IntoResponse, Response};
use axum::routing::get;
use guard::Guard;
use limits::Limited;
use m4_core::advice::PORT;
use std::io;
use std::net::{Ipv4Addr, TcpListener};
use std::sync::Arc;
use std::thread::JoinHandle;
use tokio::sync::oneshot;

/// Why there is no server.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ServeError {
    /// Something else listens there.
    #[error("port {0} of 127.0.0.1 is in use; {advice}, or none to use a free one", advice = PORT)]
    InUse(u16),
    /// The port cannot be had.
    #[error("cannot listen on port {port} of 127.0.0.1: {source}; {}", PORT)]
    Listen {
        /// The port that was asked for; 0 for any.
        port: u16,
        /// The error of the operating system.
        source: io::Error,
    },
    /// No random numbers for the token.
    #[error(
        "the system provides no random numbers, without which any user of this machine could read the scene: {0}"
    )]
    Random(String),
    /// No thread or no event loop.
    #[error("cannot start the server: {0}")]
    Start(#[source] io::Error),
}

/// A server at work; it ends when this is dropped.
#[derive(Debug)]
pub struct Server {
    url: String,
    stop: Option<oneshot::Sender<()>>,
    thread: Option<JoinHandle<()>>,
}

impl Server {
    /// Serves what `hub` holds on a port of 127.0.0.1, or on any free one for 0.
    ///
    /// # Errors
    ///
    /// [`ServeError`]: the port cannot be had, or the system gives no random numbers or no thread.
    pub fn start(hub: Arc<Hub>, port: u16) -> Result<Self, ServeError> {
        let listen = |source: io::Error| match source.kind() {
            io::ErrorKind::AddrInUse => ServeError::InUse(port),
            _ => ServeError::Listen { port, source },
        };
        let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, port)).map_err(listen)?;
        listener.set_nonblocking(true).map_err(listen)?;
        let port = listener.local_addr().map_err(listen)?.port();
        let guard = Guard::new(port)?;
        let url = format!("http://127.0.0.1:{port}/?token={}", guard.token());
        let app = router(hub, Arc::new(guard));
        let (stop, stopped) = oneshot::channel();
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_io()
            .enable_time()
            .build()
            .map_err(ServeError::Start)?;
        let thread = std::thread::Builder::new()
            .name("viewer".to_owned())
            .spawn(move || {
                runtime.block_on(async {
                    let Ok(listener) = tokio::net::TcpListener::from_std(listener) else {
                        return;
                    };
                    let serve =
                        std::pin::pin!(axum::serve(Limited::new(listener), app).into_future());
                    futures_util::future::select(serve, stopped).await;
                });
                // pages that are open would keep a graceful end waiting
                runtime.shutdown_background();
            })
            .map_err(ServeError::Start)?;
        Ok(Self {
            url,
            stop: Some(stop),
            thread: Some(thread),
        })
    }

    /// The address of the page, token included.
    pub fn url(&self) -> &str {
        &self.url
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        if let Some(stop) = self.stop.take() {
            // If the receiver is gone, the server has ended already.
            let _ = stop.send(());
        }
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

#[derive(Debug, Clone)]
struct Shared {
    hub: Arc<Hub>,
    guard: Arc<Guard>,
}

fn router(hub: Arc<Hub>, guard: Arc<Guard>) -> Router {
    let shared = Shared { hub, guard };
    Router::new()
        .route("/", get(show_page))
        .route("/scene", get(show_scene))
        .route("/events", get(hub::stream))
        .layer(axum::middleware::from_fn_with_state(
            shared.clone(),
            guard::check,
        ))
        .with_state(shared)
}

async fn show_page(State(shared): State<Shared>) -> Response {
    let page = tokio::task::spawn_blocking(move || {
        let token = shared.guard.token();
        shared.hub.with_parts(token, |parts| {
            page::compose(TEMPLATE, parts, Compression::fast())
        })
    });
    answer(page.await, "text/html; charset=utf-8")
}

async fn show_scene(State(shared): State<Shared>) -> Response {
    let task = tokio::task::spawn_blocking(move || {
        let token = shared.guard.token();
        shared
            .hub
            .with_parts(token, |parts| -> Result<_, PageError> {
                match parts.payload {
                    Some(payload) => {
                        let json = serde_json::to_vec(parts.manifest)?;
                        Ok(Some(
                            [&(json.len() as u32).to_le_bytes()[..], &json, payload].concat(),
                        ))
                    }
                    None => Ok(None),
                }
            })
    });
    let bytes = match task.await {
        Ok(Ok(Some(bytes))) => Ok(Ok(bytes)),
        Ok(Ok(None)) => return (StatusCode::NOT_FOUND, "there is no scene yet\n").into_response(),
        Ok(Err(error)) => Ok(Err(error)),
        Err(error) => Err(error),
    };
    answer(bytes, "application/octet-stream")
}

fn answer(
    result: Result<Result<Vec<u8>, PageError>, tokio::task::JoinError>,
    kind: &'static str,
) -> Response {
    let failed = |error: &dyn std::fmt::Display| {
        let text = format!("the page cannot be made: {error}\n");
        (StatusCode::INTERNAL_SERVER_ERROR, text).into_response()
    };
    match result {
        Ok(Ok(bytes)) => ([(header::CONTENT_TYPE, kind)], Bytes::from(bytes)).into_response(),
        Ok(Err(error)) => failed(&error),
        Err(error) => failed(&error),
    }
}
