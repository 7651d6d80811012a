//! `minute4d view`, and `--view` of the commands that train.

use crate::failure::Failure;
use crate::output::Output;
use crate::run::record::RunRecord;
use crate::run::viewer::title;
use crate::view::Broadcast;
use clap::Args;
use minute4d::{Error, Observer};
use serde_json::json;
use std::io::IsTerminal;
use std::path::{Path, PathBuf};

#[derive(Debug, Args)]
pub struct View {
    /// The folder of a run (finished, stopped or still training), or a scene file
    pub scene: PathBuf,
    /// Port of 127.0.0.1 to listen on [default: any free port]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..))]
    pub port: Option<u16>,
    /// Print the address without opening a browser
    #[arg(long)]
    pub no_open: bool,
}

#[derive(Debug, Args)]
pub struct PageArgs {
    /// Show the scene in the browser during training; on a terminal the page stays until Ctrl-C
    #[arg(long)]
    pub view: bool,
    /// Port of 127.0.0.1 for --view [default: any free port]
    #[arg(long, value_name = "N", requires = "view", value_parser = clap::value_parser!(u16).range(1..))]
    pub port: Option<u16>,
    /// With --view: print the address without opening a browser
    #[arg(long, requires = "view")]
    pub no_open: bool,
}

pub fn run(args: &View, output: &Output) -> Result<(), Failure> {
    let mut viewing = crate::view::view(&args.scene, args.port.unwrap_or(0), output)?;
    output.result(viewing.url(), &json!({"url": viewing.url()}))?;
    output.note("the page shows new scenes automatically; Ctrl-C stops the server");
    open(viewing.url(), args.no_open, output);
    output.stop().nothing_to_save();
    viewing.follow(output);
    Ok(())
}

/// Trains with `work`, which is given the observer. With `--view` the scene is also shown in the
/// browser, on a terminal until Ctrl-C; `report` prints the result before that.
pub fn while_training(
    args: &PageArgs,
    (input, out): (&Path, &Path),
    output: &Output,
    work: impl FnOnce(&dyn Observer) -> Result<RunRecord, Error>,
    report: impl FnOnce(&RunRecord) -> Result<(), Failure>,
) -> Result<(), Failure> {
    if !args.view {
        return report(&work(output)?);
    }
    let name = title(out, &input.display().to_string());
    let mut live = Broadcast::start(output, &name, args.port.unwrap_or(0))?;
    output.address(live.url());
    open(live.url(), args.no_open, output);
    let done = work(&live);
    let shown = live.finish(out, done.is_ok());
    report(&done?)?;
    // a failure to show the scene does not invalidate it
    if let Err(error) = shown {
        output.note(&format!("the page does not show the result: {error}"));
    }
    let briefly = !std::io::stdout().is_terminal() || output.is_json();
    if !briefly {
        output.note("the page stays available; Ctrl-C stops the server");
        output.stop().nothing_to_save();
    }
    live.stay(briefly);
    Ok(())
}

/// Opens the browser if the program runs on a terminal with a display.
fn open(url: &str, no_open: bool, output: &Output) {
    // without a display the system would start a browser in the terminal
    let screen = cfg!(any(windows, target_os = "macos"))
        || ["DISPLAY", "WAYLAND_DISPLAY"]
            .iter()
            .any(|name| std::env::var_os(name).is_some());
    if no_open || !screen || !std::io::stdout().is_terminal() {
        return;
    }
    if let Err(error) = open::that_detached(url) {
        output.note(&format!(
            "cannot open a browser ({error}); open the address yourself"
        ));
    }
}
