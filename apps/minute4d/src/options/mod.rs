//! Options that several commands have.

mod values;

pub use values::{choice, image_size, rate, render_size};

use crate::failure::Failure;
use crate::output::Output;
use clap::Args;
use clap::builder::TypedValueParser;
use m4_io::reach::Reach;
use minute4d::Existing;
use minute4d::device::{DeviceChoice, DeviceRequest};
use minute4d::settings::Tracker;
use minute4d::settings::{Enhancement, Layers, Preset, Profile, Settings};
use minute4d::settings::{Frontend, Segmenter};
use std::path::PathBuf;
use values::{degrees, duration, seconds};

/// Options that all commands have.
#[derive(Debug, Args)]
pub struct Common {
    /// Print one JSON object per line on stdout; the last is
    /// {"event":"end","ok":..,"code":..,"reason":..}
    #[arg(long, global = true)]
    pub json: bool,
    /// Hide progress; warnings and errors are still shown
    #[arg(long, short, global = true)]
    pub quiet: bool,
    /// Number of threads; the result does not depend on it [default: all cores]
    #[arg(long, global = true, value_name = "T", value_parser = clap::value_parser!(u16).range(1..=1024))]
    pub threads: Option<u16>,
    /// Save and stop when standard input is closed, so that a parent process can stop this one.
    #[arg(long, global = true, hide = true)]
    pub stop_at_eof: bool,
}

/// The device for training.
#[derive(Debug, Args)]
pub struct DeviceArgs {
    /// Device for training: `cpu`, `gpu` (the best one), `gpu:N` (`minute4d doctor` lists them), or
    /// `auto` (the best GPU, falling back to the CPU). Networks run on a GPU only with `gpu`
    #[arg(long, value_name = "DEVICE", default_value = "auto")]
    pub device: DeviceChoice,
    /// Limit of GPU memory for training in megabytes, of no effect on the CPU: frames that do not
    /// fit are uploaded when needed; training that does not fit without them is refused, with
    /// `auto` left to the CPU [default: unlimited]
    #[arg(long, value_name = "MB", value_parser = clap::value_parser!(u32).range(1..))]
    pub max_vram: Option<u32>,
}

impl DeviceArgs {
    /// Returns the device, refusing a limit of memory without a GPU.
    pub fn request(&self) -> Result<DeviceRequest, Failure> {
        Ok(DeviceRequest {
            choice: self.device,
            max_vram_mb: vram_limit(self.device, self.max_vram)?,
        })
    }
}

/// Checks `--max-vram`, which applies to GPUs only; returns megabytes.
pub fn vram_limit(device: DeviceChoice, max_vram: Option<u32>) -> Result<Option<usize>, Failure> {
    if device == DeviceChoice::Cpu && max_vram.is_some() {
        return Err(Failure::usage(
            "--max-vram limits a GPU's memory; choose a GPU with --device gpu, or omit --max-vram",
        ));
    }
    Ok(max_vram.map(|mb| mb as usize))
}

/// What happens to earlier results.
#[derive(Debug, Args)]
pub struct OutArgs {
    /// Continue an earlier run; finished stages are not repeated
    #[arg(long, conflicts_with = "force")]
    pub resume: bool,
    /// Replace the results of an earlier run in the folder; other files are kept
    #[arg(long)]
    pub force: bool,
}

impl OutArgs {
    /// Returns what to do with a folder that is not empty.
    pub fn mode(&self) -> Existing {
        match self.resume {
            true => Existing::Resume,
            false => unless_forced(self.force),
        }
    }
}

/// Returns what to do with a folder that is not empty where nothing can be resumed.
pub fn unless_forced(force: bool) -> Existing {
    match force {
        true => Existing::Force,
        false => Existing::Refuse,
    }
}

/// Which files a data set may name.
#[derive(Debug, Args)]
pub struct ReachArgs {
    /// Also read images, depth, masks and tracks outside the folder of the data set, by path or by
    /// link. Only for data sets that you trust: a malicious one could refer to private images on
    /// this machine
    #[arg(long)]
    pub allow_outside: bool,
}

impl ReachArgs {
    /// Returns which files may be read.
    pub fn reach(&self) -> Reach {
        if self.allow_outside {
            Reach::Anywhere
        } else {
            Reach::Inside
        }
    }
}

/// Which frames are used, and the lens.
#[derive(Debug, Args)]
pub struct VideoArgs {
    /// Maximum number of frames to train on, sampled evenly over the clip; geometry may use up to
    /// four times as many, and more for the cameras [default: all, 300 of a longer clip]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(2..))]
    pub max_frames: Option<u32>,
    /// Downscale frames so that their longest side is at most this many pixels
    #[arg(long, value_name = "PX", value_parser = clap::value_parser!(u32).range(16..=8192))]
    pub size: Option<u32>,
    /// Start time in the clip, seconds
    #[arg(long, value_name = "S", value_parser = seconds)]
    pub start: Option<f64>,
    /// End time in the clip, seconds
    #[arg(long, value_name = "S", value_parser = seconds)]
    pub end: Option<f64>,
    /// Use this shot of a clip with cuts, in order of time from 1; a warning lists the shots
    /// [default: the longest]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..))]
    pub shot: Option<u32>,
    /// Horizontal field of view of the camera in degrees, if known
    #[arg(long, value_name = "DEG", value_parser = degrees)]
    pub fov: Option<f64>,
    /// Treat the camera as static; depth is then a placeholder
    #[arg(long)]
    pub static_camera: bool,
    /// Front end, the methods for camera poses, optical flow and monocular depth: `auto`, or parts
    /// joined by `+`: `megasam` (poses, by a network), `classical`, `raft` (flow), `moge`,
    /// `unidepth`, `depth-anything` (depth); all but `classical` need weights
    /// (`minute4d weights list`) [default: auto]
    #[arg(long, value_name = "WORD+WORD")]
    pub frontend: Option<Frontend>,
    /// Segmentation method [default: auto]
    #[arg(long, value_parser = segmenters())]
    pub segmenter: Option<Segmenter>,
    /// Tracking method [default: auto]
    #[arg(long, value_parser = trackers())]
    pub tracker: Option<Tracker>,
    /// Camera intrinsics: a JSON file with fl_x, fl_y, cx, cy, w and h, and k1 to k4, p1, p2 and
    /// camera_model where the lens has distortion; or four numbers, in pixels of the frames
    #[arg(long, visible_alias = "lens", value_name = "FILE|FX,FY,CX,CY")]
    pub intrinsics: Option<String>,
    /// Camera poses, one per frame: the transforms.json of a capture or of nerfstudio
    #[arg(long, value_name = "FILE")]
    pub poses: Option<PathBuf>,
    /// Folder of masks, one image per frame, not black where the scene is dynamic
    #[arg(long, value_name = "DIR")]
    pub masks: Option<PathBuf>,
    /// Folder of depth maps, one 16-bit PNG per frame: z-depth in millimetres, 0 where unknown
    #[arg(long, value_name = "DIR")]
    pub depth: Option<PathBuf>,
    /// Refuse a video with damaged frames instead of dropping these frames
    #[arg(long)]
    pub strict_video: bool,
}

/// Parses the name of a segmentation method.
pub fn segmenters() -> impl TypedValueParser<Value = Segmenter> {
    choice([
        (
            "auto",
            "`mobilesam` if its weights are installed, then `sam2` if its weights are; otherwise `none`",
            Segmenter::Auto,
        ),
        (
            "none",
            "No network: masks from motion and colour only",
            Segmenter::None,
        ),
        (
            "mobilesam",
            "MobileSAM; `minute4d weights fetch mobile-sam` installs its weights",
            Segmenter::Mobilesam,
        ),
        (
            "sam2",
            "SAM 2.1, which tracks objects through the clip; needs the weights of one of its sizes",
            Segmenter::Sam2,
        ),
    ])
}

/// Parses the name of a tracking method.
pub fn trackers() -> impl TypedValueParser<Value = Tracker> {
    choice([
        ("auto", "`flow`", Tracker::Auto),
        ("none", "No tracking", Tracker::None),
        (
            "flow",
            "Chained optical flow, lifted to 3D with depth and continued through occlusions",
            Tracker::Flow,
        ),
        (
            "tapip3d",
            "TAPIP3D, a network whose licence forbids commercial use",
            Tracker::Tapip3d,
        ),
    ])
}

/// Settings in layers: profile, preset, file, `--set`, then dedicated options.
#[derive(Debug, Args)]
pub struct SettingsArgs {
    /// The built-in settings to start from [default: that of --config, else fast]
    #[arg(long, value_parser = profiles())]
    pub profile: Option<Profile>,
    /// A TOML file of settings that override the profile; docs/settings.md explains every key
    #[arg(long, value_name = "FILE")]
    pub config: Option<PathBuf>,
    /// Override one setting, such as train.iterations=2000; may be repeated
    #[arg(long, value_name = "KEY=VALUE")]
    pub set: Vec<String>,
    /// Seed of the random number generator
    #[arg(long, value_name = "S", value_parser = clap::value_parser!(u64).range(..=9_000_000_000_000_000_000))]
    pub seed: Option<u64>,
    /// Print the effective settings as TOML and exit
    #[arg(long)]
    pub print_config: bool,
}

fn profiles() -> impl TypedValueParser<Value = Profile> {
    choice([
        ("fast", "Minutes on a plain CPU", Profile::Fast),
        (
            "faithful",
            "The paper's settings, literally",
            Profile::Faithful,
        ),
    ])
}

/// How long training takes.
#[derive(Debug, Args)]
pub struct LengthArgs {
    /// Time budget of training on this machine, for the fast profile [default: default]
    #[arg(long, value_parser = presets())]
    pub preset: Option<Preset>,
    /// Number of training iterations (overrides the time budget)
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=10_000_000))]
    pub iterations: Option<u32>,
}

fn presets() -> impl TypedValueParser<Value = Preset> {
    choice([
        (
            "draft",
            "A quick preview: ten seconds, a third of the splats",
            Preset::Draft,
        ),
        ("default", "Sixty seconds", Preset::Default),
    ])
}

/// Switches for parts of the method (`minute4d ablate` measures each).
#[derive(Debug, Args)]
pub struct WithoutArgs {
    /// Disable segmentation networks
    #[arg(long)]
    pub no_seg: bool,
    /// Disable point tracking and the propagation of points between frames
    #[arg(long)]
    pub no_track: bool,
    /// Disable density control: no splats are added or pruned during training, as in the profile
    /// fast
    #[arg(long)]
    pub no_density: bool,
}

impl WithoutArgs {
    /// Switches off the parts of the method that were left out.
    pub fn apply(&self, settings: &mut Settings) {
        let parts = [
            (self.no_seg, Enhancement::Segmentation),
            (self.no_track, Enhancement::Tracking),
            (self.no_density, Enhancement::Density),
        ];
        for (_, part) in parts.into_iter().filter(|(off, _)| *off) {
            settings.switch_off(part);
        }
    }
}

/// How a scene is trained: `run`, `train` and the jobs of a batch have these options.
#[derive(Debug, Args)]
pub struct TrainingArgs {
    /// Length.
    #[command(flatten)]
    pub length: LengthArgs,
    /// Time limit, such as 90s, 10m or 1.5h: training is shortened to the time left and the preview
    /// may be skipped; geometry that takes longer is saved (exit code 75, continue with --resume)
    #[arg(long, value_name = "TIME", value_parser = duration)]
    pub time_limit: Option<f64>,
    /// Device.
    #[command(flatten)]
    pub device: DeviceArgs,
    /// Parts left out.
    #[command(flatten)]
    pub without: WithoutArgs,
    /// Settings.
    #[command(flatten)]
    pub settings: SettingsArgs,
    /// Do not write viewer.html
    #[arg(long)]
    pub no_viewer: bool,
    /// Files.
    #[command(flatten)]
    pub reach: ReachArgs,
}

impl TrainingArgs {
    /// Combines the layers of settings with these options, except for the permission to read
    /// outside of a capture, which no file of settings can hold.
    pub fn settings(&self, video: Option<&VideoArgs>) -> Result<Settings, Failure> {
        let mut settings = settings(&self.settings, video, Some(&self.length))?;
        self.without.apply(&mut settings);
        settings.viewer.write &= !self.no_viewer;
        if let Some(seconds) = self.time_limit {
            settings.limit.time_s = seconds;
        }
        Ok(settings)
    }
}

const PRESET_OF_FAITHFUL: &str = "--preset applies to the fast profile only; for the faithful one use --iterations N, or a time budget in seconds with \
     --set train.budget_s=60";

/// Combines the layers of settings; `length` is given for commands that train.
pub fn settings(
    args: &SettingsArgs,
    video: Option<&VideoArgs>,
    length: Option<&LengthArgs>,
) -> Result<Settings, Failure> {
    settings_over(Settings::of, args, video, length)
}

/// The same over other built-in settings of a profile.
pub fn settings_over(
    built_in: impl FnOnce(Profile) -> Settings,
    args: &SettingsArgs,
    video: Option<&VideoArgs>,
    length: Option<&LengthArgs>,
) -> Result<Settings, Failure> {
    let mut layers = Layers::default();
    if let Some(path) = &args.config {
        layers = layers.file(path)?;
    }
    for assignment in &args.set {
        layers = layers.set(assignment)?;
    }
    let profile = args.profile.or_else(|| layers.profile());
    let mut base = built_in(profile.unwrap_or_default());
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
    geometry.shot = args.shot.map(|n| n as usize).or(geometry.shot);
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
    Ok(output.result(settings.to_toml()?, settings)?)
}
