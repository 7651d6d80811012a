//! What the end of a run means for its job.

/// What is to be done about it.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Meaning {
    /// There is a result.
    Done,
    /// It will never work with this input and these settings.
    Poison,
    /// This machine, or this moment, cannot do it: another may.
    GiveBack,
    /// A bug, or too little memory: worth a few attempts.
    Crash,
}

/// By the exit code of the run; `None` for one that a signal ended.
pub(crate) fn meaning(code: Option<i32>) -> Meaning {
    match code {
        Some(0) => Meaning::Done,
        // usage, bad input, no input, bad settings
        Some(2 | 65 | 66 | 78) => Meaning::Poison,
        // no device, cannot write, reading failed, try again, stopped
        Some(69 | 73 | 74 | 75 | 130 | 143) => Meaning::GiveBack,
        _ => Meaning::Crash,
    }
}

#[cfg(test)]
mod tests {
    use super::{Meaning, meaning};

    #[test]
    fn every_documented_code_has_its_meaning() {
        assert_eq!(meaning(Some(0)), Meaning::Done);
        for code in [2, 65, 66, 78] {
            assert_eq!(meaning(Some(code)), Meaning::Poison, "{code}");
        }
        for code in [69, 73, 74, 75, 130, 143] {
            assert_eq!(meaning(Some(code)), Meaning::GiveBack, "{code}");
        }
        for code in [Some(1), Some(101), Some(134), None] {
            assert_eq!(meaning(code), Meaning::Crash, "{code:?}");
        }
    }
}
