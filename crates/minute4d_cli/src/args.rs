//! The command line, as clap reads it.

use clap::{Args, Parser, Subcommand, ValueEnum};
use std::path::PathBuf;

/// Makes a moving 3D scene out of one casual video, on a plain CPU.
///
/// The result goes to stdout, everything else to stderr.
#[derive(Debug, Parser)]
#[command(
    name = "minute4d",
    version,
    max_term_width = 100,
    after_help = "Exit codes: 0 done; 1 a bug; 2 wrong arguments; 65 bad input; 66 no input; 69 no usable device; 73 cannot write; \
                  74 reading failed; 75 try again later; 78 bad settings; 130 and 143 stopped by a signal (run again with --resume)."
)]
pub struct Cli {
    /// What to do.
    #[command(subcommand)]
    pub command: Command,
    /// How to talk and how many threads to use.
    #[command(flatten)]
    pub common: Common,
}

/// Options of every command.
#[derive(Debug, Args)]
pub struct Common {
    /// One JSON object a line on stdout; the last is {"event":"end","ok":..,"code":..,"reason":..}
    #[arg(long, global = true)]
    pub json: bool,
    /// No progress; warnings and errors are still shown
    #[arg(long, short, global = true)]
    pub quiet: bool,
    /// Threads to compute on; the result does not depend on it [default: all cores]
    #[arg(long, global = true, value_name = "T", value_parser = clap::value_parser!(u16).range(1..=1024))]
    pub threads: Option<u16>,
}

/// What the program does.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// From a video to a scene: geometry, train and a preview
    Run(Run),
    /// From a video to a capture: poses, focal length, depth, motion masks
    Geometry(Geometry),
    /// From a capture to a scene
    Train(Train),
    /// Pictures or a video of a trained scene
    Render(Render),
    /// Compare a trained scene with the held-out views of a capture
    Eval(Eval),
    /// Compare the cameras, depth and masks of a capture with known ones
    EvalGeometry(EvalGeometry),
    /// Say what a video, a capture, a scene file or a run holds
    Inspect(Inspect),
    /// Say what this machine has: cores, instructions, memory, disk, ffmpeg
    Doctor,
    /// Time the kernels on this machine
    Bench(Bench),
}

/// Which part of a video is read, and how.
#[derive(Debug, Args)]
pub struct VideoArgs {
    /// At most this many frames, evenly spread over the clip
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(2..))]
    pub max_frames: Option<u32>,
    /// Shrink frames so that their longest side is at most this, pixels
    #[arg(long, value_name = "PX", value_parser = clap::value_parser!(u32).range(16..=8192))]
    pub size: Option<u32>,
    /// Begin here, seconds into the clip
    #[arg(long, value_name = "S", value_parser = seconds)]
    pub start: Option<f64>,
    /// Stop here, seconds into the clip
    #[arg(long, value_name = "S", value_parser = seconds)]
    pub end: Option<f64>,
    /// Horizontal field of view of the camera, degrees, where it is known
    #[arg(long, value_name = "DEG", value_parser = degrees)]
    pub fov: Option<f64>,
    /// The camera stands still: depth is made up, the picture is not
    #[arg(long)]
    pub static_camera: bool,
    /// Refuse a video with damaged frames instead of going on without them
    #[arg(long)]
    pub strict_video: bool,
}

/// Settings in layers: profile, preset, file, --set, then the options with their own name.
#[derive(Debug, Args)]
pub struct SettingsArgs {
    /// The built-in settings to start from
    #[arg(long, value_enum, default_value = "fast")]
    pub profile: Profile,
    /// A TOML file laid over the profile; --print-config shows every key
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
    /// A look: ten seconds, a third of the splats
    Draft,
    /// The best scene within sixty seconds
    Default,
    /// Five minutes
    Quality,
}

/// What may happen to a folder that is already there.
#[derive(Debug, Args)]
pub struct OutArgs {
    /// Go on where an earlier run stopped; finished stages are not repeated
    #[arg(long, conflicts_with = "force")]
    pub resume: bool,
    /// Replace what an earlier run left in the folder; other files in it stay
    #[arg(long)]
    pub force: bool,
}

/// `minute4d run`
#[derive(Debug, Args)]
pub struct Run {
    /// A video, a folder of images, or a capture folder (then geometry is taken from it)
    #[arg(required_unless_present = "print_config")]
    pub input: Option<PathBuf>,
    /// Folder for everything: scene.safetensors, preview.mp4, run.json, metrics.jsonl, capture/
    #[arg(long, short, value_name = "DIR", required_unless_present = "print_config")]
    pub out: Option<PathBuf>,
    /// How long to train.
    #[command(flatten)]
    pub length: LengthArgs,
    /// Which part of the video.
    #[command(flatten)]
    pub video: VideoArgs,
    /// Settings.
    #[command(flatten)]
    pub settings: SettingsArgs,
    /// An existing folder.
    #[command(flatten)]
    pub existing: OutArgs,
}

/// `minute4d geometry`
#[derive(Debug, Args)]
pub struct Geometry {
    /// A video or a folder of images
    #[arg(required_unless_present = "print_config")]
    pub input: Option<PathBuf>,
    /// Folder for the capture
    #[arg(long, short, value_name = "DIR", required_unless_present = "print_config")]
    pub out: Option<PathBuf>,
    /// Which part of the video.
    #[command(flatten)]
    pub video: VideoArgs,
    /// Settings.
    #[command(flatten)]
    pub settings: SettingsArgs,
    /// An existing folder.
    #[command(flatten)]
    pub existing: OutArgs,
}

/// `minute4d train`
#[derive(Debug, Args)]
pub struct Train {
    /// Folder with transforms_train.json, pictures, depth and masks
    #[arg(required_unless_present = "print_config")]
    pub capture: Option<PathBuf>,
    /// Folder for the scene and its records
    #[arg(long, short, value_name = "DIR", required_unless_present = "print_config")]
    pub out: Option<PathBuf>,
    /// How long to train.
    #[command(flatten)]
    pub length: LengthArgs,
    /// Settings.
    #[command(flatten)]
    pub settings: SettingsArgs,
    /// An existing folder.
    #[command(flatten)]
    pub existing: OutArgs,
}

/// `minute4d render`
#[derive(Debug, Args)]
pub struct Render {
    /// The folder of a run, or a scene file
    pub scene: PathBuf,
    /// Cameras: `train` (those of the video), `swing` (an arc about the middle of the scene),
    /// `test:TRANSFORMS` (a file of held-out views), or a transforms file
    #[arg(long, value_name = "PATH", default_value = "train")]
    pub path: String,
    /// Time: `source` (each camera's own), `freeze@T`, or `A..B`; T, A and B count frames, or seconds
    /// with an `s` behind, as in freeze@1.5s
    #[arg(long, value_name = "TIME", default_value = "source")]
    pub time: String,
    /// A folder for PNG pictures, or a name that ends in .mp4
    #[arg(long, short, value_name = "DIR|FILE.mp4")]
    pub out: PathBuf,
    /// Frames a second of an MP4 [default: that of the source]
    #[arg(long, value_name = "FPS", value_parser = rate)]
    pub fps: Option<f64>,
    /// Replace pictures or a video that are already there
    #[arg(long)]
    pub force: bool,
}

/// `minute4d eval`
#[derive(Debug, Args)]
pub struct Eval {
    /// The folder of a run; eval.json is written into it
    pub out: PathBuf,
    /// The capture whose transforms_test.json lists the held-out views
    #[arg(long, value_name = "CAPTURE")]
    pub data: PathBuf,
    /// Grow the masks of moving parts by this much first, pixels
    #[arg(long, value_name = "PX", default_value_t = 0)]
    pub grow_mask: usize,
}

/// `minute4d eval-geometry`
#[derive(Debug, Args)]
pub struct EvalGeometry {
    /// The capture to judge
    pub capture: PathBuf,
    /// What is true: a capture folder, a transforms file, or a JSON file of LLFF poses
    #[arg(long, value_name = "SCENE")]
    pub truth: PathBuf,
}

/// `minute4d inspect`
#[derive(Debug, Args)]
pub struct Inspect {
    /// A video, a capture folder, a scene file or the folder of a run
    pub path: PathBuf,
}

/// `minute4d bench`
#[derive(Debug, Args)]
pub struct Bench {
    /// Splats in the synthetic scenes [default: 20000,100000,300000]
    #[arg(long, value_name = "N", value_delimiter = ',', value_parser = clap::value_parser!(u32).range(1..=20_000_000))]
    pub splats: Option<Vec<u32>>,
    /// Sizes of the image, pixels [default: 480x360,960x720]
    #[arg(long, value_name = "WxH", value_delimiter = ',', value_parser = image_size)]
    pub size: Option<Vec<(u16, u16)>>,
    /// Scenes that stand still, scenes that move [default: both]
    #[arg(long, value_enum, value_delimiter = ',')]
    pub scene: Option<Vec<BenchScene>>,
    /// Times that each view is stepped; the fastest counts [default: 15]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=100_000))]
    pub steps: Option<u32>,
    /// Degree of the spherical harmonics of the colour
    #[arg(long, value_name = "D", default_value_t = 0, value_parser = clap::value_parser!(u8).range(0..=3))]
    pub sh_degree: u8,
    /// Composite the depth too, as training with a depth loss does
    #[arg(long)]
    pub depth: bool,
    /// Draw alone: frames a second
    #[arg(long)]
    pub render: bool,
    /// 100,000 splats at 480x360 and few steps, where nothing else is asked for
    #[arg(long)]
    pub quick: bool,
    /// Peak memory of training on made-up clips instead
    #[arg(long, conflicts_with_all = ["scene", "steps", "sh_degree", "depth", "render", "quick"])]
    pub memory: bool,
    /// Frames of those clips [default: 96,400]
    #[arg(long, value_name = "N", value_delimiter = ',', requires = "memory", value_parser = clap::value_parser!(u32).range(2..=10_000))]
    pub frames: Option<Vec<u32>>,
    /// Write DATE-MACHINE.json and .md into a folder [default: bench/runs]
    #[arg(long, value_name = "DIR", num_args = 0..=1, default_missing_value = "bench/runs")]
    pub save: Option<PathBuf>,
}

/// A synthetic scene.
#[derive(Debug, Clone, Copy, PartialEq, Eq, ValueEnum)]
pub enum BenchScene {
    /// Every splat is there all the time
    Static,
    /// Four of five splats live for a frame or two of 64
    #[value(name = "4d")]
    FourD,
}

fn image_size(text: &str) -> Result<(u16, u16), String> {
    let sides = text
        .split_once('x')
        .and_then(|(w, h)| Some((w.parse().ok()?, h.parse().ok()?)));
    match sides {
        Some((w, h)) if (16..=8192).contains(&w) && (16..=8192).contains(&h) => Ok((w, h)),
        _ => Err("a size is WIDTHxHEIGHT, such as 480x360, each side 16 to 8192".to_owned()),
    }
}

fn number(text: &str) -> Result<f64, String> {
    match text.parse::<f64>() {
        Ok(value) if value.is_finite() => Ok(value),
        _ => Err(format!("{text:?} is not a number")),
    }
}

fn seconds(text: &str) -> Result<f64, String> {
    let value = number(text.strip_suffix('s').unwrap_or(text))?;
    if value >= 0.0 {
        Ok(value)
    } else {
        Err("it must be at least 0".to_owned())
    }
}

fn degrees(text: &str) -> Result<f64, String> {
    let value = number(text)?;
    if (5.0..=170.0).contains(&value) {
        Ok(value)
    } else {
        Err("a field of view lies between 5 and 170 degrees".to_owned())
    }
}

fn rate(text: &str) -> Result<f64, String> {
    let value = number(text)?;
    if (0.1..=240.0).contains(&value) {
        Ok(value)
    } else {
        Err("it must lie between 0.1 and 240".to_owned())
    }
}

#[cfg(test)]
mod tests {
    use super::Cli;
    use clap::{CommandFactory, Parser};

    #[test]
    fn the_definition_is_consistent() {
        Cli::command().debug_assert();
    }

    #[test]
    fn numbers_are_checked_where_they_are_given() {
        let bad = [
            "run a -o b --iterations 0",
            "run a -o b --threads 0",
            "run a -o b --fov 200",
            "run a -o b --fov nan",
            "run a -o b --start -1",
            "run a -o b --max-frames 1",
            "run a -o b --resume --force",
            "run a -o b --profile best",
            "run a",
            "render a --fps 0 -o b",
            "bench --size 480",
            "bench --size 480x8",
            "bench --scene 5d",
            "bench --frames 96",
            "bench --memory --render",
        ];
        for line in bad {
            let args = std::iter::once("minute4d").chain(line.split(' '));
            assert!(Cli::try_parse_from(args).is_err(), "{line}");
        }
        let good = [
            "run a -o b --start 1.5s --end 3 --threads 2 --json",
            "train --print-config",
            "bench --splats 10,20 --size 480x360,96x72 --scene static,4d --quick --save",
        ];
        for line in good {
            let args = std::iter::once("minute4d").chain(line.split(' '));
            assert!(Cli::try_parse_from(args).is_ok(), "{line}");
        }
    }
}
