//! Settings, and how long training takes.

use clap::{Args, ValueEnum};
use std::path::PathBuf;

/// Settings in layers: profile, preset, file, --set, then the options with their own name.
#[derive(Debug, Args)]
pub struct SettingsArgs {
    /// The built-in settings to start from [default: that of --config, else fast]
    #[arg(long, value_enum)]
    pub profile: Option<Profile>,
    /// A TOML file laid over the profile; docs/settings.md explains every key, --print-config shows its value
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// One setting, such as train.iterations=2000; may be given more than once
    #[arg(long, value_name = "KEY=VALUE")]
    pub set: Vec<String>,
    /// Seed of every random number
    #[arg(long, value_name = "S")]
    pub seed: Option<u64>,
    /// Print the settings that would be used, as TOML, and stop
    #[arg(long)]
    pub print_config: bool,
}

/// Built-in settings.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Profile {
    /// Minutes on a plain CPU
    Fast,
    /// The paper to the letter
    Faithful,
}

/// How long optimisation goes on.
#[derive(Debug, Args)]
pub struct LengthArgs {
    /// How long it may take on this machine, with the fast profile [default: default]
    #[arg(long, value_enum)]
    pub preset: Option<Preset>,
    /// So many iterations, however long they take
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    pub iterations: Option<u32>,
}

/// Time against quality.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Preset {
    /// A first impression: ten seconds, a third of the splats
    Draft,
    /// The best scene within sixty seconds
    Default,
}
