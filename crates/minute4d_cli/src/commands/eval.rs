//! `minute4d eval`: scores a scene on held-out views.

use crate::args::Eval;
use crate::failure::Failure;
use crate::output::Output;
use minute4d::evaluate::{Choices, EvalOptions};
use std::fmt::Write;

pub fn run(args: &Eval, output: &Output) -> Result<(), Failure> {
    let options = EvalOptions {
        grow_mask: args.grow_mask,
        device: args.device,
        protocol: args.protocol,
        covisible: args.covisible.clone(),
        refine_poses: args.refine_poses,
        reach: args.reach.reach(),
    };
    let report = minute4d::evaluate::views_by(&args.out, &args.data, &options, output)?;
    let mut text = report.images.table();
    if let Some(choices) = &report.choices {
        text += &describe(choices);
    }
    output.result(&text, minute4d::plain_json(&report)?);
    Ok(())
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
