//! Names the option or the command of this program behind each advice of the library.

use m4_core::advice;

/// The option or the command for each phrase.
const OPTIONS: [(&str, &str); 20] = [
    (advice::FIELD_OF_VIEW, "--fov"),
    (advice::STATIC_CAMERA, "--static-camera"),
    (advice::MASKS, "--masks"),
    (advice::DEPTH, "--depth"),
    (advice::INTRINSICS, "--intrinsics"),
    (advice::OUTSIDE, "--allow-outside"),
    (advice::CPU, "--device cpu"),
    (advice::GPU_MEMORY, "--max-vram"),
    (advice::PORT, "--port"),
    (advice::RESUME, "--resume"),
    (advice::REPLACE, "--force"),
    (advice::TIME_LIMIT, "--time-limit"),
    (advice::CLASSICAL, "--frontend classical"),
    (advice::NO_SEGMENTER, "--segmenter none"),
    (advice::FLOW_TRACKER, "--tracker flow"),
    (advice::LICENCE, "--accept-license"),
    (
        advice::DEPTH_WEIGHTS,
        "minute4d weights fetch moge-2-s-normal",
    ),
    (advice::MASK_WEIGHTS, "minute4d weights fetch mobile-sam"),
    (advice::SHOT, "--shot"),
    (advice::FRAMES, "--max-frames"),
];

/// The message with the option or the command behind each advice.
pub fn with_options(message: &str) -> String {
    let mut text = message.to_owned();
    for (advice, option) in OPTIONS {
        if let Some(start) = text.find(advice) {
            text.insert_str(start + advice.len(), &format!(" ({option})"));
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::{OPTIONS, with_options};
    use crate::cli::Cli;
    use clap::CommandFactory;
    use m4_core::advice;
    use std::collections::BTreeSet;

    #[test]
    fn every_advice_has_an_option_of_the_program() {
        let phrases: BTreeSet<&str> = OPTIONS.iter().map(|(advice, _)| *advice).collect();
        assert_eq!(phrases, advice::ALL.into_iter().collect());
        let command = Cli::command();
        let all = |command: &clap::Command| {
            command
                .get_arguments()
                .filter_map(|arg| arg.get_long().map(str::to_owned))
                .collect::<Vec<_>>()
        };
        let mut options: BTreeSet<String> = command.get_subcommands().flat_map(all).collect();
        for inner in command.get_subcommands() {
            options.extend(inner.get_subcommands().flat_map(all));
        }
        for (_, option) in OPTIONS {
            #[cfg(feature = "nets")]
            if let Some(weights) = option.strip_prefix("minute4d weights fetch ") {
                assert!(minute4d::weights::find(weights).is_ok(), "{option}");
                continue;
            }
            let name = option.trim_start_matches("--").split(' ').next().unwrap();
            assert!(
                options.contains(name)
                    || !cfg!(feature = "nets") && matches!(name, "accept-license" | "minute4d"),
                "{option}"
            );
        }
    }

    #[test]
    fn options_stand_behind_the_advice() {
        let message = format!("out exists; {}, or {}", advice::RESUME, advice::REPLACE);
        assert_eq!(
            with_options(&message),
            "out exists; continue it (--resume), or replace it (--force)"
        );
        assert_eq!(with_options("out exists"), "out exists");
    }
}
