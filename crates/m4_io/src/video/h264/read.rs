//! Reads an H.264 track as a clip.

use super::engine::{Engine, Frame, H264, Refusal};
use super::{Config, Unsupported};
use crate::video::VideoOptions;
use crate::video::colour::{Hdr, Range, ToneMap, YuvMatrix};
use crate::video::decoder::{DecoderProgram, Work};
use crate::video::mp4::{Orientation, Sample, SampleEntry, Track};
use crate::video::plan::{self, Collector};
use crate::video::read::no_frames;
use crate::{ErrorKind, Fault};
use m4_core::{Progress, Video};
use std::collections::VecDeque;
use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom};

/// The decoder, for messages.
const DECODER: &str = "the H.264 decoder";
/// Largest coded frame that is read, bytes: raw 4K is 12 MB.
const MAX_SAMPLE_BYTES: u32 = 64 << 20;

/// A frame that is shown.
struct Shown {
    /// Index in decoding order.
    sample: usize,
    /// Seconds from the first frame.
    time_s: f64,
}

/// Reads the frames of `track`, which lie in `file`; `decoder` decodes, or this process itself. [`Unsupported`] is left to another
/// decoder.
pub fn read(
    file: &mut File,
    track: &Track,
    options: &VideoOptions,
    decoder: Option<&DecoderProgram>,
    progress: &dyn Progress,
) -> Result<Result<Video, Unsupported>, Fault> {
    let (entry, config) = match track.entries.as_slice() {
        [entry] => match configure(entry) {
            Ok(config) => (entry, config),
            Err(unsupported) => return Ok(Err(unsupported)),
        },
        _ => {
            let what = "H.264 with several decoder configurations";
            return Ok(Err(Unsupported(what.into())));
        }
    };
    let shown = presentation(track);
    if shown.is_empty() {
        let samples = track.samples.len();
        return Err(no_frames(&format!("its video track has {samples} samples and none is shown")));
    }
    let times: Vec<f64> = shown.iter().map(|s| s.time_s).collect();
    let kept = plan::select(&times, options)?;
    let inside = times.iter().filter(|&&t| plan::in_range(t, options)).count();

    let sps = &config.sps;
    let colours = entry.colours;
    let matrix = if sps.matrix == 2 { colours.map_or(2, |c| c.matrix) } else { sps.matrix };
    let transfer = if sps.transfer == 2 { colours.map_or(2, |c| c.transfer) } else { sps.transfer };
    let full_range = sps.full_range.or(colours.and_then(|c| c.full_range)).unwrap_or(false);
    let range = if full_range { Range::Full } else { Range::Limited };
    let Some(matrix) = YuvMatrix::from_code(matrix, sps.height, range) else {
        return Ok(Err(Unsupported(format!("H.264 with colours of an unusual kind (matrix {matrix})"))));
    };
    let orientation = Orientation::from_matrix(track.matrix);
    let swaps = orientation.is_some_and(Orientation::swaps_sides);
    let aspect = entry.pixel_aspect.or(sps.pixel_aspect).unwrap_or(1.0);
    let (width, height) = (sps.width as f64 * aspect, sps.height as f64);
    let (width, height) = if swaps { (height, width) } else { (width, height) };
    let size = plan::target_size(width, height, options);
    plan::check_memory(kept.len(), size, options)?;

    let Some(engine) = engine(&config, matrix, track, options, decoder, progress)? else {
        let what = "H.264, for which the decoder cannot be set up here";
        return Ok(Err(Unsupported(what.into())));
    };
    let hdr = Hdr::from_code(transfer);
    let mut run = Run {
        config: &config,
        engine,
        orientation,
        tone_map: hdr.map(ToneMap::new),
        collector: Collector::new(size),
        damaged: Vec::new(),
    };
    run.frames(file, &track.samples, &shown, &kept, progress)?;

    let Run { mut collector, damaged, .. } = run;
    if collector.len() == 0 {
        return Ok(Err(Unsupported(format!("H.264 of which none of {} frames could be decoded here", kept.len()))));
    }
    if !damaged.is_empty() {
        let first_s = damaged.iter().fold(f64::INFINITY, |a, &b| a.min(b));
        if options.strict {
            let (n, of) = (damaged.len(), shown.len());
            let what = format!("{n} of {of} frames are damaged (the first at {first_s:.2} s)");
            return Err(Fault::bad(what, "without --strict-video they are dropped"));
        }
        collector.warnings.push(format!(
            "{} of {} frames are damaged or missing and were left out, the first at {first_s:.2} s",
            damaged.len(),
            shown.len()
        ));
    }
    if orientation.is_none() {
        let message = "the display matrix is not a turn by a right angle; frames are as stored";
        collector.warnings.push(message.to_owned());
    }
    if let Some(hdr) = hdr {
        let name = hdr.name();
        collector.warnings.push(format!("high dynamic range ({name}) was tone-mapped to sRGB"));
    }
    collector.warnings.extend(plan::thinned(kept.len(), inside));
    collector.finish(None).map(Ok).ok_or_else(|| no_frames("none was kept"))
}

/// Starts the decoder; `None` when OpenH264 cannot be set up.
fn engine<'a>(
    config: &Config,
    matrix: YuvMatrix,
    track: &Track,
    options: &VideoOptions,
    decoder: Option<&DecoderProgram>,
    progress: &'a dyn Progress,
) -> Result<Option<Engine<'a>>, Fault> {
    let Some(program) = decoder else {
        return Ok(Engine::here(config.setup(), matrix));
    };
    let work = Work {
        pixels: (config.sps.width * config.sps.height) as u64,
        frames: track.samples.len() as u64,
        bytes: track.samples.iter().map(|s| u64::from(s.size)).sum(),
    };
    match Engine::there(program, &config.setup(), matrix, options.decoder.allowed(work), progress) {
        Ok(engine) => Ok(Some(engine)),
        Err(Refusal::Setup) => Ok(None),
        Err(Refusal::Halt(halt)) => Err(halt.fault(DECODER)),
        Err(Refusal::Start(e)) => {
            let what = format!("the decoder program {} cannot be started ({e})", program.program.display());
            Err(Fault::Content { kind: ErrorKind::Io, what, hint: "install the program again".into() })
        }
    }
}

fn configure(entry: &SampleEntry) -> Result<Config, Unsupported> {
    let avcc = entry.avcc.as_deref();
    let config = Config::parse(avcc.ok_or_else(|| Unsupported("H.264 without a decoder configuration".into()))?)?;
    config.check()?;
    Ok(config)
}

/// The frames that the edit list shows, in order of time; the first is at 0 s.
fn presentation(track: &Track) -> Vec<Shown> {
    let mut shown: Vec<Shown> = track
        .samples
        .iter()
        .enumerate()
        .filter_map(|(sample, s)| {
            let time_s = track.timeline.shown_s(s.ticks)?;
            Some(Shown { sample, time_s })
        })
        .collect();
    shown.sort_by(|a, b| a.time_s.total_cmp(&b.time_s));
    let first = shown.first().map_or(0.0, |s| s.time_s);
    shown.iter_mut().for_each(|s| s.time_s -= first);
    shown
}

struct Run<'a> {
    config: &'a Config,
    engine: Engine<'a>,
    orientation: Option<Orientation>,
    tone_map: Option<ToneMap>,
    collector: Collector,
    /// Times of frames that did not decode, seconds.
    damaged: Vec<f64>,
}

impl Run<'_> {
    /// Decodes in the order of the file up to the last frame that is kept. The decoder itself sees to parameter sets
    /// after a frame that it finds damaged; a frame that never reaches it is reported to it with the next.
    fn frames(
        &mut self,
        file: &mut File,
        samples: &[Sample],
        shown: &[Shown],
        kept: &[usize],
        progress: &dyn Progress,
    ) -> Result<(), Fault> {
        let mut time_of = vec![None; samples.len()];
        for s in shown {
            time_of[s.sample] = Some(s.time_s);
        }
        let mut keep = vec![false; samples.len()];
        for &i in kept {
            keep[shown[i].sample] = true;
        }
        let total = keep.iter().rposition(|&k| k).map_or(0, |i| i + 1);
        let (mut coded, mut annex_b) = (Vec::new(), Vec::new());
        let mut given = VecDeque::new();
        let mut fresh = true;
        for (i, sample) in samples[..total].iter().enumerate() {
            if progress.cancelled() {
                return Err(Fault::Cancelled);
            }
            progress.update("decode video", i + 1, total, "");
            let there = coded_bytes(file, sample, &mut coded)?;
            let kind = match there {
                true => self.config.annex_b(&coded, &mut annex_b),
                false => None,
            };
            let Some(kind) = kind else {
                fresh = true;
                self.damaged.extend(time_of[i]);
                continue;
            };
            if let Some(to) = kind.resizes {
                let from = (self.config.sps.width, self.config.sps.height);
                return Err(plan::size_changes(from, to, time_of[i].unwrap_or(0.0)));
            }
            if kind.disposable && !keep[i] {
                continue;
            }
            self.engine.give(&annex_b, fresh, keep[i]);
            fresh = false;
            given.push_back(time_of[i]);
            if given.len() > self.engine.window() {
                self.take(given.pop_front().flatten())?;
            }
        }
        for time_s in given {
            self.take(time_s)?;
        }
        Ok(())
    }

    /// Takes what became of the frame that is shown at `time_s`.
    fn take(&mut self, time_s: Option<f64>) -> Result<(), Fault> {
        let decoded = self.engine.take().map_err(|halt| halt.fault(DECODER))?;
        match (decoded, time_s) {
            (Some(Some(image)), Some(time_s)) => {
                let image = match &self.tone_map {
                    Some(map) => map.image_8(&image),
                    None => image,
                };
                let image = match self.orientation {
                    Some(orientation) => orientation.apply(image),
                    None => image,
                };
                self.collector.push(image, time_s);
            }
            (None, Some(time_s)) => self.damaged.push(time_s),
            _ => {}
        }
        Ok(())
    }
}

/// Reads the bytes of a sample; false when the file does not have them.
fn coded_bytes(file: &mut File, sample: &Sample, bytes: &mut Vec<u8>) -> io::Result<bool> {
    if sample.size == 0 || sample.size > MAX_SAMPLE_BYTES {
        return Ok(false);
    }
    bytes.resize(sample.size as usize, 0);
    let read = file.seek(SeekFrom::Start(sample.offset)).and_then(|_| file.read_exact(bytes));
    match read {
        Ok(()) => Ok(true),
        Err(e) if matches!(e.kind(), io::ErrorKind::UnexpectedEof | io::ErrorKind::InvalidInput) => Ok(false),
        Err(e) => Err(e),
    }
}

/// Size of the images of a track and how many of them decode in this process, or why none does: for files of our own.
pub fn count(file: &mut File, track: &Track) -> Result<((usize, usize), usize), String> {
    let entry = track.entries.first().ok_or("its track has no decoder configuration")?;
    let config = configure(entry).map_err(|Unsupported(what)| format!("it is {what}"))?;
    let sps = &config.sps;
    let mut decoder = H264::new(config.setup()).ok_or("the decoder cannot be set up")?;
    let (mut coded, mut annex_b, mut decoded) = (Vec::new(), Vec::new(), 0);
    for sample in &track.samples {
        let there = coded_bytes(file, sample, &mut coded).map_err(|e| e.to_string())?;
        if there && config.annex_b(&coded, &mut annex_b).is_some() {
            let whole = matches!(decoder.decode(&annex_b, false), Frame::Whole(_));
            decoded += usize::from(whole);
        }
    }
    Ok(((sps.width, sps.height), decoded))
}
