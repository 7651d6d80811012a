//! Settings, and the length of training.

use clap::{Args, ValueEnum};
use std::path::PathBuf;

/// Settings in layers: profile, preset, file, `--set`, then dedicated options.
#[derive(Debug, Args)]
pub struct SettingsArgs {
    /// The built-in settings to start from [default: that of --config, else fast]
    #[arg(long, value_enum)]
    pub profile: Option<Profile>,
    /// A TOML file of settings that override the profile; docs/settings.md explains every key
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Override one setting, such as train.iterations=2000; may be repeated
    #[arg(long, value_name = "KEY=VALUE")]
    pub set: Vec<String>,
    /// Seed of the random number generator
    #[arg(long, value_name = "S")]
    pub seed: Option<u64>,
    /// Print the effective settings as TOML and exit
    #[arg(long)]
    pub print_config: bool,
}

/// Built-in settings.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Profile {
    /// Minutes on a plain CPU
    Fast,
    /// The paper's settings, literally
    Faithful,
}

/// The length of training.
#[derive(Debug, Args)]
pub struct LengthArgs {
    /// Time budget of training on this machine, for the fast profile [default: default]
    #[arg(long, value_enum)]
    pub preset: Option<Preset>,
    /// Number of training iterations (overrides the time budget)
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    pub iterations: Option<u32>,
}

/// Time budgets of training.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum Preset {
    /// A quick preview: ten seconds, a third of the splats
    Draft,
    /// Sixty seconds
    Default,
}
