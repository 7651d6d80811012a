//! A decoder in a separate process: limited, supervised, and ended with its owner.

use super::end::{Messages, OnLine, how_it_ended};
use super::{Allowed, limits};
use crate::{DecoderEnd, Fault};
use m4_core::Progress;
use std::io::{self, Read, Write};
use std::process::{Child as Process, ChildStdin, Command, ExitStatus, Stdio};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, SyncSender, channel, sync_channel};
use std::time::{Duration, Instant};

/// How long a wish to stop may go unheard.
const POLL: Duration = Duration::from_millis(20);
/// Bytes that a pipe holds on Linux: what one read brings.
const CHUNK_BYTES: usize = 64 << 10;
/// Chunks that wait to be taken; then the child waits.
const CHUNKS: usize = 16;

/// What sort of child is started.
#[derive(Debug, Clone, Copy)]
pub struct Start {
    /// Which decoder, for people.
    pub decoder: &'static str,
    /// It is sent requests.
    pub talks: bool,
    /// It is the decoder itself, not our own program, which limits itself.
    pub bare: bool,
}

/// A running child. Dropping it ends it, with all that it started.
pub struct Child<'a> {
    decoder: &'static str,
    process: Process,
    output: Receiver<Vec<u8>>,
    /// What came and was not taken yet, from `at`.
    chunk: Vec<u8>,
    at: usize,
    input: Option<Sender<Vec<u8>>>,
    messages: Messages,
    /// What it may take.
    pub allowed: Allowed,
    progress: &'a dyn Progress,
    reaped: bool,
}

/// How a child ended by itself.
pub struct Exit {
    pub status: ExitStatus,
    /// Seconds of one core that it took, where the system reports it.
    cpu_s: Option<f64>,
}

impl<'a> Child<'a> {
    /// Starts `command` with pipes, limits and an environment that holds no secret; `on_line` sees
    /// every line of its standard error, of which `message_bytes` are read at most. With `talks`
    /// its standard input is a pipe too; `bare` says that it does not limit itself.
    pub fn start(
        command: &mut Command,
        Start {
            decoder,
            talks,
            bare,
        }: Start,
        allowed: Allowed,
        message_bytes: u64,
        on_line: OnLine,
        progress: &'a dyn Progress,
    ) -> io::Result<Self> {
        command
            .stdin(if talks { Stdio::piped() } else { Stdio::null() })
            .stdout(Stdio::piped())
            .stderr(Stdio::piped());
        super::clear_environment(command);
        // A group of its own: keys pressed in the terminal are for us, and wrappers go down with
        // what they started.
        #[cfg(unix)]
        std::os::unix::process::CommandExt::process_group(command, 0);
        let mut process = command.spawn()?;
        let limited = limits::limit_child(&process, &allowed, bare);
        let missing = || io::Error::other("a pipe is not connected");
        let (stdout, stderr) = (process.stdout.take(), process.stderr.take());
        let stdin = process.stdin.take();
        let (sender, output) = sync_channel(CHUNKS);
        let messages = Messages::read(stderr.ok_or_else(missing)?, message_bytes, on_line);
        // From here on the child is ended when something fails.
        let mut child = Self {
            decoder,
            process,
            output,
            chunk: Vec::new(),
            at: 0,
            input: None,
            messages,
            allowed,
            progress,
            reaped: false,
        };
        limited.map_err(|e| io::Error::other(format!("its limits cannot be set: {e}")))?;
        let stdout = stdout.ok_or_else(missing)?;
        std::thread::spawn(move || forward(stdout, &sender));
        if talks {
            let stdin = stdin.ok_or_else(missing)?;
            let (sender, requests) = channel();
            std::thread::spawn(move || deliver(stdin, &requests));
            child.input = Some(sender);
        }
        Ok(child)
    }

    /// The fault of a clip whose decoder failed so.
    pub fn failed(&self, how: DecoderEnd) -> Fault {
        Fault::Decoder {
            decoder: self.decoder,
            how,
        }
    }

    /// Gives bytes to the child, without waiting. A child that is gone shows in its output.
    pub fn send(&self, bytes: Vec<u8>) {
        if let Some(input) = &self.input {
            let _ = input.send(bytes);
        }
    }

    /// Waits for something that a thread makes of what the child writes; `None` when no more will
    /// come.
    pub fn wait_for<T>(&self, receiver: &Receiver<T>) -> Result<Option<T>, Fault> {
        let start = Instant::now();
        loop {
            let got = receiver.recv_timeout(POLL);
            if let Some(read_mb) = self.messages.too_many_mb() {
                return Err(self.failed(DecoderEnd::Messages { read_mb }));
            }
            match got {
                Ok(got) => return Ok(Some(got)),
                Err(RecvTimeoutError::Disconnected) => return Ok(None),
                Err(RecvTimeoutError::Timeout) => self.watch(start)?,
            }
        }
    }

    /// Fails when the caller wants to stop, or when too much time went by since `start`.
    fn watch(&self, start: Instant) -> Result<(), Fault> {
        let seconds = self.allowed.idle_s;
        if self.progress.cancelled() {
            return Err(Fault::Cancelled);
        }
        if start.elapsed() >= Duration::from_secs(seconds) {
            return Err(self.failed(DecoderEnd::Idle { seconds }));
        }
        Ok(())
    }

    /// Fills `bytes` with output; false when it ended before.
    pub fn read_exact(&mut self, bytes: &mut [u8]) -> Result<bool, Fault> {
        let mut filled = 0;
        while filled < bytes.len() {
            if self.at == self.chunk.len() {
                match self.wait_for(&self.output)? {
                    Some(chunk) => (self.chunk, self.at) = (chunk, 0),
                    None => return Ok(false),
                }
            }
            let n = (bytes.len() - filled).min(self.chunk.len() - self.at);
            bytes[filled..filled + n].copy_from_slice(&self.chunk[self.at..self.at + n]);
            (filled, self.at) = (filled + n, self.at + n);
        }
        Ok(true)
    }

    /// All output to its end, or `None` if it has more than `limit` bytes.
    pub fn read_to_end(&mut self, limit: usize) -> Result<Option<Vec<u8>>, Fault> {
        let mut bytes = Vec::new();
        while let Some(chunk) = self.wait_for(&self.output)? {
            if bytes.len() + chunk.len() > limit {
                return Ok(None);
            }
            bytes.extend_from_slice(&chunk);
        }
        Ok(Some(bytes))
    }

    /// Waits until the child ends by itself and all its messages are read.
    pub fn finish(&mut self) -> Result<Exit, Fault> {
        // A child that waits for more sees the end.
        self.input = None;
        let (start, mut nap) = (Instant::now(), Duration::from_micros(200));
        let decoder = self.decoder;
        let failed = |e: io::Error| {
            let what = format!("its end cannot be awaited: {e}");
            Fault::Decoder {
                decoder,
                how: DecoderEnd::Answer { what },
            }
        };
        while !self.has_ended().map_err(failed)? {
            self.watch(start)?;
            std::thread::sleep(nap);
            nap = (nap * 2).min(POLL);
        }
        let cpu_s = self.cpu_s();
        // What it left behind would hold the pipes open.
        self.kill_group();
        let status = self.process.wait().map_err(failed)?;
        self.reaped = true;
        self.wait_for(self.messages.end())?;
        Ok(Exit { status, cpu_s })
    }

    /// Why a child that ended by itself did so.
    pub fn why(&self, exit: &Exit) -> DecoderEnd {
        how_it_ended(
            exit.status,
            exit.cpu_s,
            &self.allowed,
            &self.messages.lines(),
        )
    }

    /// Why a child whose output ended too early did so.
    pub fn why_ended(&mut self) -> Fault {
        self.finish()
            .map_or_else(|fault| fault, |exit| self.failed(self.why(&exit)))
    }

    /// Lines of its standard error that were kept.
    pub fn message(&self) -> Vec<String> {
        self.messages.lines()
    }

    /// True when the process has ended; its number stays its own until it was waited for.
    #[cfg(target_os = "linux")]
    fn has_ended(&mut self) -> io::Result<bool> {
        use rustix::process::{Pid, WaitId, WaitIdOptions, waitid};
        let options = WaitIdOptions::EXITED | WaitIdOptions::NOHANG | WaitIdOptions::NOWAIT;
        match waitid(WaitId::Pid(Pid::from_child(&self.process)), options) {
            Ok(status) => Ok(status.is_some()),
            Err(rustix::io::Errno::INTR) => Ok(false),
            Err(e) => Err(e.into()),
        }
    }

    #[cfg(not(target_os = "linux"))]
    fn has_ended(&mut self) -> io::Result<bool> {
        let status = self.process.try_wait()?;
        self.reaped |= status.is_some();
        Ok(status.is_some())
    }

    /// Seconds of one core that the process took, all its threads together.
    #[cfg(target_os = "linux")]
    fn cpu_s(&self) -> Option<f64> {
        /// What the kernel counts in, whatever its own clock: `USER_HZ`.
        const TICKS_A_SECOND: f64 = 100.0;
        let stat = std::fs::read_to_string(format!("/proc/{}/stat", self.process.id())).ok()?;
        // The name, which may hold anything, ends with the last parenthesis; the times are fields
        // 14 and 15.
        let mut fields = stat.rsplit_once(')')?.1.split_whitespace().skip(11);
        let (user, system): (f64, f64) =
            (fields.next()?.parse().ok()?, fields.next()?.parse().ok()?);
        Some((user + system) / TICKS_A_SECOND)
    }

    #[cfg(not(target_os = "linux"))]
    fn cpu_s(&self) -> Option<f64> {
        None
    }

    /// Ends the child and what it started. Only before it was waited for: then the number may be
    /// another's.
    fn kill_group(&self) {
        #[cfg(unix)]
        if !self.reaped {
            let pid = rustix::process::Pid::from_child(&self.process);
            // Fails when nothing is left.
            let _ = rustix::process::kill_process_group(pid, rustix::process::Signal::KILL);
        }
    }
}

impl Drop for Child<'_> {
    fn drop(&mut self) {
        if !self.reaped {
            self.kill_group();
            // Both fail when the child has ended already.
            let _ = self.process.kill();
            let _ = self.process.wait();
        }
    }
}

/// Carries output to the owner; ends when one of the two is gone.
fn forward(mut stdout: impl Read, sender: &SyncSender<Vec<u8>>) {
    loop {
        let mut chunk = vec![0; CHUNK_BYTES];
        match stdout.read(&mut chunk) {
            Ok(0) => return,
            Ok(n) => {
                chunk.truncate(n);
                if sender.send(chunk).is_err() {
                    return;
                }
            }
            Err(e) if e.kind() == io::ErrorKind::Interrupted => {}
            Err(_) => return,
        }
    }
}

/// Carries requests to the child; ends when one of the two is gone.
fn deliver(mut stdin: ChildStdin, requests: &Receiver<Vec<u8>>) {
    for request in requests {
        if stdin.write_all(&request).is_err() {
            return;
        }
    }
}
