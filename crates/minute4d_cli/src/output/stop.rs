//! Ctrl-C and its kin: once to stop in good order, twice to stop at once.

use super::Output;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU8, Ordering};

/// Exit code of a program that SIGTERM stopped.
const TERM: u8 = 143;

/// What a signal asks for.
#[derive(Debug, PartialEq, Eq)]
enum Answer {
    /// To save and stop.
    Save,
    /// What was asked for before.
    Known,
    /// To stop at once.
    End,
}

/// Whether, and by which signal, the program was asked to stop.
#[derive(Debug, Clone, Default)]
pub struct StopSignal {
    code: Arc<AtomicU8>,
    /// True once a signal came; the end of standard input is none.
    signalled: Arc<AtomicBool>,
    engine: Arc<AtomicBool>,
    idle: Arc<AtomicBool>,
}

impl StopSignal {
    /// The exit code that belongs to the signal (130 SIGINT, 143 SIGTERM), once there was one.
    pub fn code(&self) -> Option<u8> {
        match self.code.load(Ordering::SeqCst) {
            0 => None,
            code => Some(code),
        }
    }

    /// From now on nothing is lost by stopping, so nothing is said about it.
    pub fn nothing_to_save(&self) {
        self.idle.store(true, Ordering::SeqCst);
    }

    /// From now on SIGTERM is no urgent wish, however often it comes: engines tell every process of a task, and a script
    /// passes on what it was told. Whoever is in a hurry has SIGKILL.
    pub fn of_an_engine(&self) {
        self.engine.store(true, Ordering::SeqCst);
    }

    /// Notes a signal; what is to be done about it.
    fn request(&self, code: u8) -> Answer {
        self.ask(code);
        let first = !self.signalled.swap(true, Ordering::SeqCst);
        match first {
            true => Answer::Save,
            false if code == TERM && self.engine.load(Ordering::SeqCst) => Answer::Known,
            false => Answer::End,
        }
    }

    /// Notes a wish that is not urgent, however often it comes.
    fn ask(&self, code: u8) {
        // The first one says how the program ends.
        let _ = self.code.compare_exchange(0, code, Ordering::SeqCst, Ordering::SeqCst);
    }
}

/// Asks to stop, as SIGTERM does, when standard input ends: whoever held its other end let go of it, or died. A signal
/// may come besides, from an engine that tells all processes, and is still the first.
pub fn stop_at_eof(output: &Arc<Output>) {
    let stop = output.stop().clone();
    std::thread::spawn(move || {
        // An input that cannot be read tells as little as one that ended.
        let _ = std::io::copy(&mut std::io::stdin().lock(), &mut std::io::sink());
        stop.ask(TERM);
    });
}

/// Starts to listen for signals. Where that is impossible, the system's default stays: the process
/// just ends.
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
                    output.note("stopping after this step, what is done will be saved; once more to stop at once");
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

/// Starts to listen for signals: here the first is noted and the second ends the process.
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
    fn the_end_of_the_input_and_a_signal_are_one_wish() {
        let stop = StopSignal::default();
        assert_eq!(stop.code(), None);
        stop.ask(143);
        stop.ask(143);
        assert_eq!(stop.request(130), Answer::Save, "the first signal");
        assert_eq!(stop.code(), Some(143));
        assert_eq!(stop.request(130), Answer::End, "the second ends the program");
    }

    #[test]
    fn an_engine_may_say_it_twice() {
        let stop = StopSignal::default();
        assert_eq!((stop.request(143), stop.request(143)), (Answer::Save, Answer::End));
        let stop = StopSignal::default();
        stop.of_an_engine();
        assert_eq!((stop.request(143), stop.request(143)), (Answer::Save, Answer::Known));
        assert_eq!(stop.request(130), Answer::End, "a person is in a hurry");
    }
}
