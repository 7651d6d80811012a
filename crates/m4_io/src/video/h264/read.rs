//! Reads an H.264 track as a clip.

use super::engine::{Engine, Frame};
use super::{Config, Failure};
use crate::Fault;
use crate::video::colour::{Range, YuvMatrix};
use crate::video::decoder::Work;
use crate::video::mp4::{Orientation, Sample, Track};
use crate::video::plan::{self, Collector};
use crate::video::read::{Request, no_frames};
use m4_core::{Progress, Video};
use std::collections::VecDeque;
use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom};

/// Largest coded frame that is read, bytes: raw 4K is 12 MB.
const MAX_SAMPLE_BYTES: u32 = 64 << 20;

/// Reads the frames of `track`, which lie in `file`.
pub fn read(request: Request<'_>, file: &mut File, track: &Track) -> Result<Video, Failure> {
    let Request {
        options,
        decoder,
        progress,
        ..
    } = request;
    let unsupported = |what: &str| Failure::Unsupported(what.to_owned());
    let [entry] = track.entries.as_slice() else {
        return Err(unsupported("H.264 with several decoder configurations"));
    };
    let config = Config::of(entry).map_err(Failure::Unsupported)?;
    let shown = presentation(track);
    if shown.is_empty() {
        let samples = track.samples.len();
        return Err(no_frames(&format!(
            "its video track has {samples} samples and none is shown"
        ))
        .into());
    }
    let times: Vec<f64> = shown.iter().map(|&(_, time_s)| time_s).collect();
    let indices = plan::select(&times, options)?;
    let inside = times
        .iter()
        .filter(|&&t| plan::in_range(t, options))
        .count();

    let sps = &config.sps;
    let colours = sps.colours.or(entry.colours);
    // PQ and HLG.
    if matches!(colours.transfer, 16 | 18) {
        return Err(unsupported("H.264 with high dynamic range"));
    }
    let range = if colours.full_range == Some(true) {
        Range::Full
    } else {
        Range::Limited
    };
    let Some(matrix) = YuvMatrix::from_code(colours.matrix, sps.size.1, range) else {
        return Err(unsupported(&format!(
            "H.264 with colours of an unusual kind (matrix {})",
            colours.matrix
        )));
    };
    let orientation = Orientation::from_matrix(&track.matrix);
    let swaps = orientation.is_some_and(Orientation::swaps_sides);
    let aspect = entry.pixel_aspect.or(sps.pixel_aspect).unwrap_or(1.0);
    let (width, height) = (sps.size.0 as f64 * aspect, sps.size.1 as f64);
    let (width, height) = if swaps {
        (height, width)
    } else {
        (width, height)
    };
    let size = plan::target_size(width, height, options);
    plan::check_memory(indices.len(), size, options)?;

    let work = Work {
        pixels: (sps.size.0 * sps.size.1) as u64,
        frames: track.samples.len() as u64,
        bytes: track.samples.iter().map(|s| u64::from(s.size)).sum(),
    };
    let Some(engine) = Engine::start(
        decoder,
        config.setup(),
        options.decoder.allowed(work),
        progress,
    )?
    else {
        return Err(unsupported(
            "H.264, for which the decoder cannot be set up here",
        ));
    };
    let mut run = Run {
        config: &config,
        engine,
        matrix,
        orientation,
        collector: Collector::new(size),
        damaged: Vec::new(),
    };
    run.frames(file, &track.samples, &shown, &indices, progress)?;

    let Run {
        mut collector,
        damaged,
        ..
    } = run;
    if collector.len() == 0 {
        return Err(unsupported(&format!(
            "H.264 of which none of {} frames could be decoded here",
            indices.len()
        )));
    }
    if !damaged.is_empty() {
        let first_s = damaged.iter().fold(f64::INFINITY, |a, &b| a.min(b));
        let first = format!("at {first_s:.2} s");
        collector
            .warnings
            .push(plan::damaged(damaged.len(), shown.len(), &first, options)?);
    }
    if orientation.is_none() {
        let message = "the display matrix is not a turn by a right angle; frames are as stored";
        collector.warnings.push(message.to_owned());
    }
    collector
        .warnings
        .extend(plan::thinned(indices.len(), inside, options));
    collector
        .finish(inside, None)
        .ok_or_else(|| no_frames("none was kept").into())
}

/// The frames that the edit list shows, in order of time: the index of each in decoding order, and
/// seconds from the first.
fn presentation(track: &Track) -> Vec<(usize, f64)> {
    let samples = track.samples.iter().enumerate();
    let times = samples.filter_map(|(i, sample)| Some((i, track.timeline.shown_s(sample.ticks)?)));
    let mut shown: Vec<(usize, f64)> = times.collect();
    shown.sort_by(|a, b| a.1.total_cmp(&b.1));
    let first_s = shown.first().map_or(0.0, |s| s.1);
    shown.iter_mut().for_each(|s| s.1 -= first_s);
    shown
}

struct Run<'a> {
    config: &'a Config,
    engine: Engine<'a>,
    matrix: YuvMatrix,
    orientation: Option<Orientation>,
    collector: Collector,
    /// Times of frames that did not decode, seconds.
    damaged: Vec<f64>,
}

impl Run<'_> {
    /// Decodes in the order of the file up to the last frame that is kept. The decoder itself sees
    /// to parameter sets after a frame that it finds damaged; a frame that never reaches it is
    /// reported to it with the next.
    fn frames(
        &mut self,
        file: &mut File,
        samples: &[Sample],
        shown: &[(usize, f64)],
        indices: &[usize],
        progress: &dyn Progress,
    ) -> Result<(), Fault> {
        let mut time_of = vec![None; samples.len()];
        for &(sample, time_s) in shown {
            time_of[sample] = Some(time_s);
        }
        let mut keep = vec![false; samples.len()];
        for &i in indices {
            keep[shown[i].0] = true;
        }
        let total = keep.iter().rposition(|&k| k).map_or(0, |i| i + 1);
        let (mut coded, mut annex_b) = (Vec::new(), Vec::new());
        let mut times = VecDeque::new();
        let mut fresh = true;
        for (i, sample) in samples[..total].iter().enumerate() {
            if progress.cancelled() {
                return Err(Fault::Cancelled);
            }
            progress.update("decode video", i + 1, total, "");
            let length = coded_bytes(file, sample, &mut coded)?;
            let kind = match length {
                true => self.config.annex_b(&coded, &mut annex_b),
                false => None,
            };
            let Some(kind) = kind else {
                fresh = true;
                self.damaged.extend(time_of[i]);
                continue;
            };
            if let Some(to) = kind.resizes {
                return Err(plan::size_changes(
                    self.config.sps.size,
                    to,
                    time_of[i].unwrap_or(0.0),
                ));
            }
            if kind.disposable && !keep[i] {
                continue;
            }
            self.engine.give(&annex_b, fresh, keep[i]);
            fresh = false;
            times.push_back(time_of[i]);
            if times.len() > self.engine.window() {
                self.take(times.pop_front().flatten())?;
            }
        }
        for time_s in times {
            self.take(time_s)?;
        }
        Ok(())
    }

    /// Takes what became of the frame that is shown at `time_s`.
    fn take(&mut self, time_s: Option<f64>) -> Result<(), Fault> {
        let frame = self.engine.take()?;
        let Some(time_s) = time_s else {
            return Ok(());
        };
        let image = match frame {
            Frame::Decoded => return Ok(()),
            Frame::Image(planes) => self.matrix.image_420(self.config.sps.size, &planes),
            Frame::Damaged | Frame::NoMemory => None,
        };
        match image {
            Some(image) => {
                let image = match self.orientation {
                    Some(orientation) => orientation.apply(image),
                    None => image,
                };
                self.collector.push(image, time_s);
            }
            None => self.damaged.push(time_s),
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
    let read = file
        .seek(SeekFrom::Start(sample.offset))
        .and_then(|_| file.read_exact(bytes));
    match read {
        Ok(()) => Ok(true),
        Err(e)
            if matches!(
                e.kind(),
                io::ErrorKind::UnexpectedEof | io::ErrorKind::InvalidInput
            ) =>
        {
            Ok(false)
        }
        Err(e) => Err(e),
    }
}
