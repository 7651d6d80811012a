//! What a file of weights is for: what gets it, and what goes without it.

use super::{Entry, Origin};

const ONLY_HERE: &str = "nothing that works today: no command uses it yet";

impl Entry {
    /// The command that gets it; `FILE` is what the user brings.
    #[must_use]
    pub fn command(&self) -> String {
        let agree = if self.commercial { "" } else { " --accept-license" };
        match self.origin {
            Origin::Pip(_) => format!("minute4d weights fetch {}{agree}", self.name),
            _ => format!("minute4d weights add {} FILE{agree}", self.name),
        }
    }

    /// What is lost without it, and what works all the same.
    #[must_use]
    pub fn without(&self) -> &'static str {
        match self.name {
            "gmflow" => "--frontend gmflow and moge+gmflow; --frontend classical works without any weights",
            "mobile-sam" => "--segmenter mobilesam; --segmenter none works, with coarser outlines",
            "megasam" => "--frontend megasam; moge+gmflow works without it, classical without any weights",
            "raft-things" => "--flow raft; --flow gmflow and --flow classical work in its place",
            "depth-anything-v1-l" | "unidepth-v2-l" => {
                "--mono depth-anything+unidepth, the paper's own pair; --mono moge works in its place, --mono none without any"
            }
            "moge-2-l" | "moge-2-l-normal" | "moge-2-b" | "moge-2-b-normal" | "moge-2-s-normal" => {
                "--mono moge, where no other MoGe-2 is here; --mono none works without any"
            }
            _ => ONLY_HERE,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::ONLY_HERE;
    use crate::weights::{all, find};

    #[test]
    fn every_file_says_how_to_get_it_and_what_goes_without() {
        for entry in all() {
            let command = entry.command();
            assert!(
                command.contains(entry.name) && command.starts_with("minute4d weights "),
                "{command}"
            );
            assert_eq!(command.ends_with("--accept-license"), !entry.commercial, "{command}");
            assert!(!entry.without().is_empty());
        }
        // those that a front end takes name one that works without
        for name in [
            "gmflow",
            "mobile-sam",
            "megasam",
            "raft-things",
            "depth-anything-v1-l",
            "unidepth-v2-l",
            "moge-2-l",
        ] {
            let without = find(name).unwrap().without();
            assert!(without != ONLY_HERE && without.contains("work"), "{name}: {without}");
        }
        assert_eq!(find("megasam").unwrap().command(), "minute4d weights add megasam FILE");
    }
}
