//! Signals: the first asks the program to save and stop, the second ends it at once.

use super::Output;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU8, Ordering};

/// Exit code of a program that SIGTERM stopped.
const TERM: u8 = 143;

#[derive(Debug, PartialEq, Eq)]
enum Answer {
    /// Save and stop.
    Save,
    /// Nothing: the stop was requested before.
    Known,
    /// Stop at once.
    End,
}

/// Whether the program was asked to stop, and by which signal.
#[derive(Debug, Clone, Default)]
pub struct StopSignal {
    code: Arc<AtomicU8>,
    /// True after the first signal; the end of standard input does not count as one.
    signalled: Arc<AtomicBool>,
    engine: Arc<AtomicBool>,
    idle: Arc<AtomicBool>,
}

impl StopSignal {
    /// Returns the exit code of the first stop request (130 SIGINT, 143 SIGTERM), if there was one.
    pub fn code(&self) -> Option<u8> {
        match self.code.load(Ordering::SeqCst) {
            0 => None,
            code => Some(code),
        }
    }

    /// Marks that there is nothing left to save, so that stopping needs no message.
    pub fn nothing_to_save(&self) {
        self.idle.store(true, Ordering::SeqCst);
    }

    /// From now on a repeated SIGTERM does not end the program at once: batch engines send it to
    /// every process of a task, and scripts forward it. SIGKILL still ends the program.
    pub fn of_an_engine(&self) {
        self.engine.store(true, Ordering::SeqCst);
    }

    /// Records a signal and returns how to respond.
    fn request(&self, code: u8) -> Answer {
        self.ask(code);
        let first = !self.signalled.swap(true, Ordering::SeqCst);
        match first {
            true => Answer::Save,
            false if code == TERM && self.engine.load(Ordering::SeqCst) => Answer::Known,
            false => Answer::End,
        }
    }

    /// Records a request to stop that is never urgent.
    fn ask(&self, code: u8) {
        // The first request determines the exit code.
        let _ = self
            .code
            .compare_exchange(0, code, Ordering::SeqCst, Ordering::SeqCst);
    }
}

/// Asks to stop, as SIGTERM does, when standard input ends, which means that the parent process
/// closed it or died. A signal that an engine sends in addition still counts as the first one.
pub fn stop_at_eof(output: &Arc<Output>) {
    let stop = output.stop().clone();
    std::thread::spawn(move || {
        // An input that cannot be read is treated like one that ended.
        let _ = std::io::copy(&mut std::io::stdin().lock(), &mut std::io::sink());
        stop.ask(TERM);
    });
}

/// Starts to listen for signals. If that is impossible, the system's default remains: the process
/// ends.
#[cfg(unix)]
pub fn watch_signals(output: &Arc<Output>) {
    use signal_hook::consts::{SIGINT, SIGTERM};
    let Ok(mut signals) = signal_hook::iterator::Signals::new([SIGINT, SIGTERM]) else {
        return;
    };
    let output = Arc::clone(output);
    std::thread::spawn(move || {
        for signal in signals.forever() {
            let code = if signal == SIGINT { 130 } else { TERM };
            match output.stop().request(code) {
                Answer::Save if !output.stop().idle.load(Ordering::SeqCst) => {
                    output
                        .note("stopping after this step and saving; press Ctrl-C again to stop at once without saving");
                }
                Answer::Save | Answer::Known => {}
                Answer::End => {
                    output.end(code, "stopped at once, without saving");
                    std::process::exit(i32::from(code));
                }
            }
        }
    });
}

/// Starts to listen for signals: the first is recorded, the second ends the process.
#[cfg(not(unix))]
pub fn watch_signals(output: &Arc<Output>) {
    use signal_hook::consts::{SIGINT, SIGTERM};
    let again = Arc::new(AtomicBool::new(false));
    let stop = output.stop().clone();
    for (signal, code) in [(SIGINT, 130), (SIGTERM, 143)] {
        let _ = signal_hook::flag::register_conditional_shutdown(signal, code, Arc::clone(&again));
        let _ = signal_hook::flag::register(signal, Arc::clone(&again));
    }
    std::thread::spawn(move || {
        while !again.load(Ordering::SeqCst) {
            std::thread::sleep(std::time::Duration::from_millis(50));
        }
        stop.request(130);
    });
}

#[cfg(test)]
mod tests {
    use super::{Answer, StopSignal};

    #[test]
    fn end_of_input_and_a_signal_count_once() {
        let stop = StopSignal::default();
        assert_eq!(stop.code(), None);
        stop.ask(143);
        stop.ask(143);
        assert_eq!(stop.request(130), Answer::Save, "the first signal");
        assert_eq!(stop.code(), Some(143));
        assert_eq!(
            stop.request(130),
            Answer::End,
            "the second ends the program"
        );
    }

    #[test]
    fn second_sigterm_of_an_engine_is_ignored() {
        let stop = StopSignal::default();
        assert_eq!(
            (stop.request(143), stop.request(143)),
            (Answer::Save, Answer::End)
        );
        let stop = StopSignal::default();
        stop.of_an_engine();
        assert_eq!(
            (stop.request(143), stop.request(143)),
            (Answer::Save, Answer::Known)
        );
        assert_eq!(stop.request(130), Answer::End, "Ctrl-C is always urgent");
    }
}
