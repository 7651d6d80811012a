//! What the front end costs: held-out views of scenes whose geometry was recovered, and of the same scenes as given.

use super::{json, number, options, program, run, stem};
use anyhow::Result;
use std::path::Path;

/// For each scene (`args`, after options of `minute4d geometry`) with truth and held-out views: recovers the geometry of its training images, trains both that and the
/// scene as given, and scores the same held-out views. One Markdown row each; the last columns are the difference.
///
/// # Errors
///
/// As [`super::held_out`].
pub fn raw(root: &Path, args: &[&str], work: &Path) -> Result<String> {
    let program = program(root)?;
    let (options, scenes) = options(args)?;
    let mut table = String::from(
        "| scene | geometry, s | PSNR from frames | moving | PSNR, given geometry | moving | cost, dB | moving |\n\
         |---|---|---|---|---|---|---|---|\n",
    );
    for scene in scenes {
        let name = stem(scene);
        let images = format!("{scene}/train");
        let text = |what: &str| work.join(format!("{name}-{what}")).to_string_lossy().into_owned();
        let capture = text("raw-capture");
        let all = ["geometry", &images, "-o", &capture, "--force", "--quiet"];
        run(&program, &[&all, options].concat())?;
        let seconds = number(&json(&Path::new(&capture).join("geometry.json"))?["seconds"]);
        let score = |input: &str, out: &str| -> Result<[f64; 2]> {
            run(&program, &["train", input, "-o", out, "--force", "--quiet", "--no-viewer"])?;
            run(&program, &["eval", out, "--data", scene, "--quiet"])?;
            let mean = json(&Path::new(out).join("eval.json"))?["mean"].take();
            Ok([number(&mean["psnr_db"]), number(&mean["masked_psnr_db"])])
        };
        let found = score(&capture, &text("raw"))?;
        let given = score(scene, &text("given"))?;
        table += &format!(
            "| {name} | {seconds:.0} | {:.2} | {:.2} | {:.2} | {:.2} | {:.2} | {:.2} |\n",
            found[0],
            found[1],
            given[0],
            given[1],
            given[0] - found[0],
            given[1] - found[1],
        );
    }
    Ok(table)
}
