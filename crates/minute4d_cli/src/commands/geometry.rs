//! `minute4d geometry`: turns a video into a capture.

use crate::failure::Failure;
use crate::options::{OutArgs, SettingsArgs, VideoArgs, WithoutArgs, print_config, settings};
use crate::output::Output;
use clap::Args;
use minute4d::Job;
use minute4d::device::DeviceChoice;
use minute4d::geometry::Segmenter;
use serde_json::json;
use std::path::PathBuf;

/// `minute4d geometry`
#[derive(Debug, Args)]
pub struct Geometry {
    /// A video or a folder of images
    #[arg(required_unless_present = "print_config")]
    pub input: Option<PathBuf>,
    /// Folder for the capture
    #[arg(long, short, value_name = "DIR", required_unless_present = "print_config")]
    pub out: Option<PathBuf>,
    /// The part of the video.
    #[command(flatten)]
    pub video: VideoArgs,
    /// Device for networks: `cpu`, `gpu` (the best one), `gpu:N` (`minute4d doctor` lists them), or `auto`
    #[arg(long, value_name = "DEVICE", default_value = "cpu")]
    pub device: DeviceChoice,
    /// Parts of the method to switch off.
    #[command(flatten)]
    pub without: WithoutArgs,
    /// Settings.
    #[command(flatten)]
    pub settings: SettingsArgs,
    /// What may happen to an existing folder.
    #[command(flatten)]
    pub existing: OutArgs,
}

pub fn run(args: &Geometry, output: &Output) -> Result<(), Failure> {
    let mut settings = settings(&args.settings, Some(&args.video), None)?;
    args.without.apply(&mut settings);
    let (Some(input), Some(out), false) = (&args.input, &args.out, args.settings.print_config) else {
        return print_config(&settings, output);
    };
    let asked = settings.geometry.segmenter;
    let job = Job { settings, device: args.device.into(), existing: args.existing.mode(), observer: output };
    let record = minute4d::geometry::make(input, out, &job)?;
    if let Some(found) = &record.found {
        output.note(&format!(
            "{} frames, {} x {} pixels, field of view {:.1} degrees, {:.1} % dynamic, reprojection error {:.2} px",
            found.frames,
            found.size[0],
            found.size[1],
            found.fov_deg,
            100.0 * found.moving_share,
            found.residual_px
        ));
        if let Some(confidence) = &found.confidence {
            output.note(&confidence.description());
        }
        if cfg!(feature = "nets")
            && asked == Segmenter::Auto
            && found.segmenter == Segmenter::None.name()
            && found.keyframes.is_none()
        {
            output.note("MobileSAM improves the masks of dynamic objects: `minute4d weights fetch mobile-sam`");
        }
    }
    output.result(&out.display().to_string(), json!({"path": out, "record": minute4d::plain_json(&record)?}));
    Ok(())
}
