//! Limits of connections: any user of this machine can open them, and they must not take the files
//! that training needs.

use axum::serve::Listener;
use std::io::{self, ErrorKind, IoSlice};
use std::net::SocketAddr;
use std::pin::Pin;
use std::sync::Arc;
use std::task::{Context, Poll};
use std::time::Duration;
use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
use tokio::net::{TcpListener, TcpStream};
use tokio::sync::{OwnedSemaphorePermit, Semaphore};
use tokio::time::{Instant, Sleep, sleep};

/// Most connections at a time: a browser opens six, and a few browsers are enough. Others wait with
/// the system.
pub(super) const MOST_CONNECTIONS: usize = 64;
/// A connection to which nothing was written for this long is closed: one that sends no request or
/// half of one, one that reads no answer, one that is kept alive without use. Events are written
/// more often, and no page takes so long to make.
const LONGEST_SILENCE: Duration = Duration::from_secs(30);
/// Pause after a connection that could not be accepted, as where the process has no file left.
const PAUSE: Duration = Duration::from_secs(1);

/// Accepts a limited number of connections at a time, and goes on whatever happens to one.
#[derive(Debug)]
pub(super) struct Limited {
    listener: TcpListener,
    free: Arc<Semaphore>,
}

impl Limited {
    pub fn new(listener: TcpListener) -> Self {
        Self {
            listener,
            free: Arc::new(Semaphore::new(MOST_CONNECTIONS)),
        }
    }
}

impl Listener for Limited {
    type Io = Connection;
    type Addr = SocketAddr;

    async fn accept(&mut self) -> (Connection, SocketAddr) {
        loop {
            // It is never closed.
            let Ok(place) = Arc::clone(&self.free).acquire_owned().await else {
                std::future::pending().await
            };
            match self.listener.accept().await {
                Ok((stream, address)) => {
                    return (
                        Connection::new(stream, LONGEST_SILENCE, Some(place)),
                        address,
                    );
                }
                Err(_) => sleep(PAUSE).await,
            }
        }
    }

    fn local_addr(&self) -> io::Result<SocketAddr> {
        self.listener.local_addr()
    }
}

/// A connection that fails after a silence.
#[derive(Debug)]
pub(super) struct Connection {
    stream: TcpStream,
    silence: Duration,
    end: Pin<Box<Sleep>>,
    _place: Option<OwnedSemaphorePermit>,
}

impl Connection {
    fn new(stream: TcpStream, silence: Duration, place: Option<OwnedSemaphorePermit>) -> Self {
        Self {
            stream,
            silence,
            end: Box::pin(sleep(silence)),
            _place: place,
        }
    }

    /// Fails once the silence is too long; the caller is woken then.
    fn poll_silence(&mut self, cx: &mut Context<'_>) -> Poll<io::Error> {
        self.end
            .as_mut()
            .poll(cx)
            .map(|()| ErrorKind::TimedOut.into())
    }

    /// Takes the outcome of a write.
    fn written(
        &mut self,
        cx: &mut Context<'_>,
        outcome: Poll<io::Result<usize>>,
    ) -> Poll<io::Result<usize>> {
        match outcome {
            Poll::Pending => self.poll_silence(cx).map(Err),
            Poll::Ready(outcome) => {
                self.end.as_mut().reset(Instant::now() + self.silence);
                Poll::Ready(outcome)
            }
        }
    }
}

impl AsyncRead for Connection {
    fn poll_read(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        buffer: &mut ReadBuf<'_>,
    ) -> Poll<io::Result<()>> {
        match self.poll_silence(cx) {
            Poll::Ready(error) => Poll::Ready(Err(error)),
            Poll::Pending => Pin::new(&mut self.stream).poll_read(cx, buffer),
        }
    }
}

impl AsyncWrite for Connection {
    fn poll_write(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        bytes: &[u8],
    ) -> Poll<io::Result<usize>> {
        let outcome = Pin::new(&mut self.stream).poll_write(cx, bytes);
        self.written(cx, outcome)
    }

    fn poll_write_vectored(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
        parts: &[IoSlice<'_>],
    ) -> Poll<io::Result<usize>> {
        let outcome = Pin::new(&mut self.stream).poll_write_vectored(cx, parts);
        self.written(cx, outcome)
    }

    fn is_write_vectored(&self) -> bool {
        self.stream.is_write_vectored()
    }

    fn poll_flush(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_flush(cx)
    }

    fn poll_shutdown(mut self: Pin<&mut Self>, cx: &mut Context<'_>) -> Poll<io::Result<()>> {
        Pin::new(&mut self.stream).poll_shutdown(cx)
    }
}

#[cfg(test)]
mod tests {
    use super::Connection;
    use std::future::poll_fn;
    use std::io::ErrorKind;
    use std::net::Ipv4Addr;
    use std::pin::Pin;
    use std::time::{Duration, Instant};
    use tokio::io::{AsyncRead, AsyncWrite, ReadBuf};
    use tokio::net::{TcpListener, TcpStream};

    #[test]
    fn a_silent_connection_fails_and_a_write_prolongs_it() {
        let runtime = tokio::runtime::Builder::new_current_thread()
            .enable_io()
            .enable_time()
            .build()
            .unwrap();
        runtime.block_on(async {
            let listener = TcpListener::bind((Ipv4Addr::LOCALHOST, 0)).await.unwrap();
            let client = TcpStream::connect(listener.local_addr().unwrap())
                .await
                .unwrap();
            let silence = Duration::from_millis(200);
            let (stream, _) = listener.accept().await.unwrap();
            let started = Instant::now();
            let mut connection = Connection::new(stream, silence, None);
            tokio::time::sleep(silence / 2).await;
            poll_fn(|cx| Pin::new(&mut connection).poll_write(cx, b"x"))
                .await
                .unwrap();
            let mut bytes = [0; 8];
            let read = poll_fn(|cx| {
                Pin::new(&mut connection).poll_read(cx, &mut ReadBuf::new(&mut bytes))
            })
            .await;
            assert_eq!(read.unwrap_err().kind(), ErrorKind::TimedOut);
            assert!(
                started.elapsed() >= silence + silence / 2,
                "{:?}",
                started.elapsed()
            );
            drop(client);
        });
    }
}
