//! `minute4d eval`: scores a scene on held-out views; `minute4d split`: splits a capture into
//! training and held-out frames.

use crate::failure::Failure;
use crate::options::{ReachArgs, unless_forced};
use crate::output::Output;
use clap::Args;
use minute4d::device::DeviceChoice;
use minute4d_eval::{Choices, EvalOptions, Protocol};
use std::fmt::Write;
use std::path::PathBuf;

#[derive(Debug, Args)]
pub struct Eval {
    /// The folder of a run; eval.json is written into it
    pub out: PathBuf,
    /// The capture whose transforms_test.json lists the held-out views
    #[arg(long, value_name = "CAPTURE")]
    pub data: PathBuf,
    /// Dilate the masks of dynamic regions by this many pixels first
    #[arg(long, value_name = "PX", default_value_t = 0)]
    pub grow_mask: usize,
    /// Evaluation protocol, which fixes frames, masks, metrics and poses: holdout, instant4d,
    /// rodygs, dycheck, nvidia, davis; eval.json then records every choice
    #[arg(long, value_name = "PROTOCOL")]
    pub protocol: Option<Protocol>,
    /// Folder of co-visibility masks, PNG files named like the images of the views [default: the
    /// capture's folder covisible, or masks computed from its poses and depth]
    #[arg(long, value_name = "DIR", requires = "protocol")]
    pub covisible: Option<PathBuf>,
    /// Optimise the poses of test images before scoring, as published methods do under this
    /// protocol
    #[arg(long, requires = "protocol")]
    pub refine_poses: bool,
    /// Device that renders the views: `cpu`, `gpu`, `gpu:N` or `auto`
    #[arg(long, value_name = "DEVICE", default_value = "cpu")]
    pub device: DeviceChoice,
    #[command(flatten)]
    pub reach: ReachArgs,
}

pub fn run(args: &Eval, output: &Output) -> Result<(), Failure> {
    let options = EvalOptions {
        grow_mask: args.grow_mask,
        device: args.device,
        protocol: args.protocol,
        covisible: args.covisible.clone(),
        refine_poses: args.refine_poses,
        reach: args.reach.reach(),
    };
    let report = minute4d_eval::views(&args.out, &args.data, &options, output)?;
    let mut text = report.table();
    if let Some(choices) = &report.choices {
        text += &describe(choices);
    }
    Ok(output.result(&text, &report)?)
}

/// Formats the choices of a protocol.
fn describe(c: &Choices) -> String {
    let mut out = String::new();
    let mut line = |name: &str, text: &str| {
        // writing to a string cannot fail
        let _ = writeln!(out, "{name:<10} {text}");
    };
    line("protocol", &format!("{}: {}", c.protocol, c.title));
    line("task", c.task.title());
    line("frames", &c.frames.words);
    line("masks", &c.mask.words);
    line("poses", &c.poses.words);
    for lpips in &c.lpips {
        if let Some(absent) = &lpips.absent {
            line("lpips", &format!("not scored: {absent}"));
        }
    }
    line("note", c.note);
    if let Some(mean) = c.headline.mean {
        line("headline", &format!("{} {mean:.3}", c.headline.name));
    }
    out
}

#[derive(Debug, Args)]
pub struct Split {
    /// A capture of the whole video: folder with transforms_train.json
    pub capture: PathBuf,
    /// Protocol that chooses the held-out frames: holdout, instant4d, rodygs or davis
    #[arg(long, value_name = "PROTOCOL")]
    pub protocol: Protocol,
    /// Folder for the new capture, with the held-out frames in its test list only
    #[arg(long, short, value_name = "DIR")]
    pub out: PathBuf,
    /// Replace an earlier split in the folder; other files are kept
    #[arg(long)]
    pub force: bool,
    #[command(flatten)]
    pub reach: ReachArgs,
}

pub fn split(args: &Split, output: &Output) -> Result<(), Failure> {
    let record = minute4d_eval::split(
        &args.capture,
        args.protocol,
        &args.out,
        unless_forced(args.force),
        args.reach.reach(),
        output,
    )?;
    output.note(&format!(
        "{} of {} frames are held out: {}",
        record.held_out.len(),
        record.frames,
        record.frame_rule.description()
    ));
    Ok(output.result(args.out.display(), &record)?)
}
