//! `minute4d export`: writes a scene for other viewers, or a capture for COLMAP or nerfstudio.

use crate::args::{Export, PrecisionArg};
use crate::failure::Failure;
use crate::output::Output;
use minute4d::export::{ExportJob, Format};
use minute4d::io::scene::fourdgs::{FourdgsConfig, Precision};
use minute4d::render::Moment;

pub fn run(args: &Export, output: &Output) -> Result<(), Failure> {
    let named = args.out.as_deref().and_then(Format::of_path);
    let time = args.time.as_deref().map(str::parse::<Moment>).transpose();
    let time = time.map_err(minute4d::Error::from)?;
    let job = ExportJob {
        out: args.out.clone(),
        time,
        fps: args.fps,
        replace: args.force,
        compare: !args.no_compare,
        keep_mip: args.keep_mip,
        reach: args.reach.reach(),
        fourdgs: FourdgsConfig {
            precision: match args.precision {
                PrecisionArg::Fine => Precision::Fine,
                PrecisionArg::Normal => Precision::Normal,
                PrecisionArg::Coarse => Precision::Coarse,
            },
            ..FourdgsConfig::default()
        },
        ..ExportJob::new(args.format.or(named).unwrap_or(Format::Fourdgs))
    };
    let report = minute4d::export::make(&args.scene, &job, output)?;
    output.note(&report.to_string());
    output.result(&report.path.display().to_string(), minute4d::plain_json(&report)?);
    Ok(())
}
