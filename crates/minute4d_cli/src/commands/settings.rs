//! Turns options into settings: profile, preset, file, `--set`, then dedicated options.

use crate::args::{self, LengthArgs, OutArgs, SettingsArgs, VideoArgs};
use crate::failure::Failure;
use crate::output::Output;
use minute4d::device::DeviceRequest;
use minute4d::enhance::Tracker;
use minute4d::geometry::Segmenter;
use minute4d::settings::{Layers, Preset, Profile, Settings};
use minute4d::{Existing, Job, Observer};

const PRESET_OF_FAITHFUL: &str = "--preset applies to the fast profile only; for the faithful one use --iterations N, or a time budget in seconds with \
     --set train.budget_s=60";

impl From<args::Profile> for Profile {
    fn from(given: args::Profile) -> Self {
        match given {
            args::Profile::Fast => Self::Fast,
            args::Profile::Faithful => Self::Faithful,
        }
    }
}

impl From<args::Segmenter> for Segmenter {
    fn from(given: args::Segmenter) -> Self {
        match given {
            args::Segmenter::Auto => Self::Auto,
            args::Segmenter::None => Self::None,
            args::Segmenter::Mobilesam => Self::Mobilesam,
            args::Segmenter::Sam2 => Self::Sam2,
        }
    }
}

impl From<args::Tracker> for Tracker {
    fn from(given: args::Tracker) -> Self {
        match given {
            args::Tracker::Auto => Self::Auto,
            args::Tracker::None => Self::None,
            args::Tracker::Flow => Self::Flow,
            args::Tracker::Tapip3d => Self::Tapip3d,
        }
    }
}

impl args::Preset {
    fn apply(self, settings: &mut Settings) {
        let preset = match self {
            Self::Draft => Preset::Draft,
            Self::Default => Preset::Default,
        };
        preset.apply(settings);
    }
}

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
    let profile = args.profile.map(Into::into).or_else(|| layers.profile());
    let mut base = Settings::of(profile.unwrap_or_default());
    let preset = length.and_then(|l| l.preset);
    match base.profile {
        Profile::Fast => preset.unwrap_or(args::Preset::Default).apply(&mut base),
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
    let (geometry, methods) = (&mut settings.geometry, &args.methods);
    if let Some(frontend) = &methods.frontend {
        geometry.frontend.clone_from(frontend);
    }
    geometry.segmenter = methods.segmenter.map_or(geometry.segmenter, Into::into);
    geometry.tracker = methods.tracker.map_or(geometry.tracker, Into::into);
    geometry.intrinsics = methods.intrinsics.clone().or(geometry.intrinsics.take());
    geometry.poses = methods.poses.clone().or(geometry.poses.take());
    geometry.masks = methods.masks.clone().or(geometry.masks.take());
    geometry.depth = methods.depth.clone().or(geometry.depth.take());
}

/// Returns the job that the stages of a run work on.
pub fn job<'a>(device: DeviceRequest, existing: &OutArgs, settings: Settings, observer: &'a dyn Observer) -> Job<'a> {
    Job {
        settings,
        device,
        existing: match (existing.resume, existing.force) {
            (true, _) => Existing::Resume,
            (_, true) => Existing::Force,
            _ => Existing::Refuse,
        },
        observer,
    }
}

/// Prints the effective settings as a file for `--config`.
pub fn print_config(settings: &Settings, output: &Output) -> Result<(), Failure> {
    let text = settings.to_toml()?;
    let value = minute4d::plain_json(settings)?;
    output.result(&text, value);
    Ok(())
}
