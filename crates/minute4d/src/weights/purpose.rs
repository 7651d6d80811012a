//! The purpose of each file of weights: how to install it, and what works without it.

use super::{Entry, Origin};

const NOTHING: &str = "nothing: no command uses it";

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

    /// The loss without it, and the alternative.
    #[must_use]
    pub fn without(&self) -> &'static str {
        match self.name {
            "mobile-sam" => "--segmenter mobilesam; --segmenter none works, with coarser masks",
            "megasam" => "the part megasam of --frontend; moge works without it, classical without any weights",
            "raft-things" => "the part raft of --frontend; classical works in its place without any weights",
            "unidepth-v2-l" => "the part unidepth of --frontend; moge works in its place",
            "depth-anything-v1-l" | "depth-anything-v1-b" | "depth-anything-v1-s" => {
                "the part depth-anything of --frontend, where no other size is here; moge works in its place"
            }
            "moge-2-l" | "moge-2-l-normal" | "moge-2-b" | "moge-2-b-normal" | "moge-2-s-normal" => {
                "the part moge of --frontend, where no other size is here; a front end without it works, in no unit of length"
            }
            "sam2.1-tiny" | "sam2.1-small" | "sam2.1-base-plus" | "sam2.1-large" => {
                "--segmenter sam2, where no other size is here; mobilesam works in its place, and none without any weights"
            }
            "lpips-alex" | "lpips-vgg" => "LPIPS of `minute4d eval --protocol`; PSNR and SSIM work without",
            "tapip3d" => "--tracker tapip3d; --tracker flow works without any weights",
            _ => NOTHING,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::NOTHING;
    use crate::weights::{all, find};

    #[test]
    fn every_file_names_its_source_and_alternative() {
        for entry in all() {
            let command = entry.command();
            assert!(command.contains(entry.name) && command.starts_with("minute4d weights "), "{command}");
            assert_eq!(command.ends_with("--accept-license"), !entry.commercial, "{command}");
            assert!(entry.without() != NOTHING, "{} has no consumer", entry.name);
        }
        // those that a front end takes name one that works without
        for name in ["mobile-sam", "megasam", "raft-things", "depth-anything-v1-l", "unidepth-v2-l", "moge-2-l"] {
            let without = find(name).unwrap().without();
            assert!(without.contains("work"), "{name}: {without}");
        }
        assert_eq!(find("megasam").unwrap().command(), "minute4d weights add megasam FILE");
    }
}
