//! The command line as clap parses it: the commands, and the options that all of them have.

use crate::commands::{
    self,
    batch::Batch,
    eval::{Eval, Split},
    gallery::Gallery,
    geometry::{Enhance, Geometry},
    interchange::{Export, Import},
    manual::Manual,
    render::Render,
    run::{Run, Train},
    view::View,
    weights::Weights,
};
use crate::failure::Failure;
use crate::options::Common;
use crate::output::Output;
use crate::program::Program;
use clap::{Parser, Subcommand};

/// Turns one casual video into a 4D Gaussian splatting scene, on a plain CPU.
///
/// The result goes to stdout, progress and messages to stderr.
#[derive(Debug, Parser)]
#[command(
    name = "minute4d",
    version,
    max_term_width = 100,
    after_help = "Exit codes: 0 done; 1 internal error; 2 wrong arguments; 65 bad input; 66 no input; 69 no usable device, decoder or \
                  weights; 73 cannot write; 74 reading failed; 75 try again later; 78 bad settings; 130 and 143 stopped by a signal (run again with --resume)."
)]
pub struct Cli {
    /// The command to run.
    #[command(subcommand)]
    pub command: Command,
    /// Options of all commands.
    #[command(flatten)]
    pub common: Common,
}

/// The commands of the program.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Turn a video into a scene: geometry, training, a preview video and a viewer page
    Run(Run),
    /// Turn a video into a capture: poses, focal length, depth, motion masks
    Geometry(Geometry),
    /// Improve the masks of a capture, and track points on dynamic objects
    Enhance(Enhance),
    /// Train a scene from a capture
    Train(Train),
    /// Render images or a video of a trained scene
    Render(Render),
    /// Export a scene for other viewers, or a capture for COLMAP
    Export(Export),
    /// Import a splat file as a scene, or a clip with poses from another tool as a capture
    Import(Import),
    /// Show a scene in the browser from a local server; the page follows a training run
    View(View),
    /// Make a page with previews of all scenes in a folder, for the web or a disk
    Gallery(Gallery),
    /// Score a trained scene on the held-out views of a capture, optionally by a published protocol
    Eval(Eval),
    /// Split a capture into training and held-out frames by a protocol
    Split(Split),
    /// Process many clips on many machines: plan, run, submit to Slurm, show progress
    Batch(Batch),
    /// Describe this machine: cores, instruction sets, memory, GPUs, ffmpeg
    Doctor,
    /// Write man pages and shell completions into a folder
    #[command(hide = true)]
    Manual(Manual),
    /// List, download, add and verify pretrained network weights
    Weights(Weights),
}

impl Program for Cli {
    fn common(&self) -> &Common {
        &self.common
    }

    fn run(&self, output: &Output) -> Result<(), Failure> {
        match &self.command {
            Command::Run(args) => commands::run::run(args, output),
            Command::Geometry(args) => commands::geometry::run(args, output),
            Command::Enhance(args) => commands::geometry::enhance(args, output),
            Command::Train(args) => commands::run::train(args, output),
            Command::Render(args) => commands::render::run(args, output),
            Command::Export(args) => commands::interchange::export(args, output),
            Command::Import(args) => commands::interchange::import(args, output),
            Command::View(args) => commands::view::run(args, output),
            Command::Gallery(args) => commands::gallery::run(args, output),
            Command::Eval(args) => commands::eval::run(args, output),
            Command::Split(args) => commands::eval::split(args, output),
            Command::Batch(args) => commands::batch::run(args, &self.common, output),
            Command::Doctor => commands::doctor::run(output),
            Command::Manual(args) => commands::manual::run::<Self>(args, output),
            Command::Weights(args) => commands::weights::run(args, output),
        }
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
    fn numeric_arguments_are_validated_when_parsed() {
        let bad = [
            "run a -o b --threads 0",
            "run a -o b --fov 200",
            "run a -o b --start -1",
            "run a -o b --max-frames 1",
            "render a --fps 0 -o b",
            "export a --fps 0",
            "import a.npz -o b --fps 0",
            "view a --port 0",
            "geometry a -o b --frontend best",
            "train a -o b --port 8000",
            "enhance a -o b --tracker best",
            "eval a --data b --refine-poses",
            "eval a --data b --covisible c",
            "batch plan a -o b",
            "batch run",
            "batch run --manifest a --index 1 --stride 2",
            "batch submit --manifest a --max-parallel 0",
            "batch submit --manifest a --gres=gpu:1",
        ];
        for line in bad {
            let args = std::iter::once("minute4d").chain(line.split(' '));
            assert!(Cli::try_parse_from(args).is_err(), "{line}");
        }
        let good = [
            "import a.npz -o b --fps 24 --depth d --masks m --factor 2",
            "run a -o b --start 1.5s --end 3 --threads 2 --json",
            "train a -o b --no-track --no-density",
            "enhance a -o b --segmenter sam2 --tracker tapip3d --device gpu",
            "train a -o b --view --port 8000 --no-open --no-viewer",
            "eval a --data b --protocol rodygs --refine-poses",
            "eval a --data b --protocol dycheck --covisible c --device auto",
            "batch plan a b --recursive -o jobs.jsonl --out c --preset draft --set train.seed=1 --device cpu --no-track",
            "batch submit --manifest a --max-parallel 64 --dry-run -- --gres=gpu:1 --account=me",
            "batch status --manifest a --failed --html b --json",
        ];
        for line in good {
            let args = std::iter::once("minute4d").chain(line.split(' '));
            assert!(Cli::try_parse_from(args).is_ok(), "{line}");
        }
    }
}
