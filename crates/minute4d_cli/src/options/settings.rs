//! Turns options into settings: profile, preset, file, `--set`, then dedicated options.

use super::{LengthArgs, SettingsArgs, VideoArgs};
use crate::failure::Failure;
use crate::output::Output;
use minute4d::settings::{Layers, Profile, Settings};

const PRESET_OF_FAITHFUL: &str = "--preset applies to the fast profile only; for the faithful one use --iterations N, or a time budget in seconds with \
     --set train.budget_s=60";

/// Combines the layers of settings; `length` is given for commands that train.
pub fn settings(
    args: &SettingsArgs,
    video: Option<&VideoArgs>,
    length: Option<&LengthArgs>,
) -> Result<Settings, Failure> {
    let mut layers = Layers::default();
    if let Some(path) = &args.config {
        layers = layers.file(path)?;
    }
    for given in &args.set {
        layers = layers.set(given)?;
    }
    let profile = args.profile.or_else(|| layers.profile());
    let mut base = Settings::of(profile.unwrap_or_default());
    let preset = length.and_then(|l| l.preset);
    match base.profile {
        Profile::Fast => preset.unwrap_or_default().apply(&mut base),
        Profile::Faithful if preset.is_some() => return Err(Failure::usage(PRESET_OF_FAITHFUL)),
        Profile::Faithful => {}
    }
    let mut settings = layers.over(&base)?;
    // a number of iterations without a time budget switches the budget off
    let iterations_only = layers.named("train.iterations") && !layers.named("train.budget_s");
    let iterations = length.and_then(|l| l.iterations);
    if let Some(n) = iterations {
        settings.train.iterations = n as usize;
    }
    if iterations_only || iterations.is_some() {
        settings.train.budget_s = 0.0;
    }
    if let Some(seed) = args.seed {
        settings.set_seed(seed);
    }
    if let Some(video) = video {
        apply_video(&mut settings, video);
    }
    Ok(settings)
}

fn apply_video(settings: &mut Settings, args: &VideoArgs) {
    let video = &mut settings.video;
    video.max_frames = args.max_frames.map(|n| n as usize).or(video.max_frames);
    video.size = args.size.map(|px| px as usize).or(video.size);
    video.start_s = args.start.or(video.start_s);
    video.end_s = args.end.or(video.end_s);
    video.strict |= args.strict_video;
    settings.sparse.fov_deg = args.fov.or(settings.sparse.fov_deg);
    settings.sparse.static_camera |= args.static_camera;
    let geometry = &mut settings.geometry;
    if let Some(frontend) = &args.frontend {
        geometry.frontend.clone_from(frontend);
    }
    geometry.segmenter = args.segmenter.unwrap_or(geometry.segmenter);
    geometry.tracker = args.tracker.unwrap_or(geometry.tracker);
    geometry.intrinsics = args.intrinsics.clone().or(geometry.intrinsics.take());
    geometry.poses = args.poses.clone().or(geometry.poses.take());
    geometry.masks = args.masks.clone().or(geometry.masks.take());
    geometry.depth = args.depth.clone().or(geometry.depth.take());
}

/// Prints the effective settings as a file for `--config`.
pub fn print_config(settings: &Settings, output: &Output) -> Result<(), Failure> {
    let text = settings.to_toml()?;
    let value = minute4d::plain_json(settings)?;
    output.result(&text, value);
    Ok(())
}
