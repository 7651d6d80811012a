//! Splits a capture of a whole video into training and test frames.

use crate::error::Error;
use crate::protocol::{FrameRule, Protocol};
use m4_core::{Capture, CaptureFrame};
use m4_io::capture::Split;
use m4_io::files;
use m4_io::reach::Reach;
use m4_io::results::{Kind, ResultFolder};
use minute4d::OutputError;
use minute4d::json::{MAX_RECORD_BYTES, write_json};
use minute4d::layout::{Existing, capture_names};
use minute4d::{Observer, Refusal, Settings, hash};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// Says how a capture was split.
pub const SPLIT_FILE: &str = "split.json";

/// `split.json`.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
pub struct SplitRecord {
    /// `minute4d-split`.
    pub format: String,
    /// Its version.
    pub version: u32,
    /// Release of the program that wrote it.
    pub minute4d: String,
    /// By which protocol.
    pub protocol: Protocol,
    /// The rule of its frames.
    pub frame_rule: FrameRule,
    /// The capture that was split.
    pub source: PathBuf,
    /// BLAKE3 of what training would read of it.
    pub source_blake3: String,
    /// Frames of the whole video.
    pub frames: usize,
    /// Indices of the held-out frames in it, ascending: those of `transforms_test.json`, in order.
    pub held_out: Vec<usize>,
    /// Their names in the source.
    pub held_out_names: Vec<String>,
    /// The poses, depth and masks are those of the source: their estimation saw the held-out
    /// frames.
    pub geometry_saw_held_out: bool,
}

impl SplitRecord {
    /// That of a capture; `None` where there is none.
    ///
    /// # Errors
    ///
    /// [`minute4d::Error::Read`] if there is one that cannot be read.
    pub fn read(capture: &Path) -> Result<Option<Self>, Error> {
        let path = capture.join(SPLIT_FILE);
        match files::read(&path, MAX_RECORD_BYTES) {
            Ok(bytes) => serde_json::from_slice(&bytes).map(Some).map_err(|e| {
                minute4d::Error::Read {
                    path,
                    source: e.into(),
                }
                .into()
            }),
            Err(_) if !path.exists() => Ok(None),
            Err(source) => Err(minute4d::Error::Read { path, source }.into()),
        }
    }
}

/// The two parts of a video. Moments and `time_frames` are those of the whole video.
#[derive(Debug)]
struct Parts {
    /// Tracks lack the held-out frames.
    train: Capture,
    test: Capture,
    /// Indices of the held-out frames in the video.
    held_out: Vec<usize>,
}

/// Splits the frames of a video by a protocol. Refused for protocols whose views come with the
/// data, if fewer than two frames would train or none test, or if tracks do not match the frames.
fn parts(capture: Capture, protocol: Protocol) -> Result<Parts, Refusal> {
    let frames = capture.frames.len();
    let rule = protocol.rules().frames;
    let held_out = rule.held_out(frames).ok_or_else(|| {
        Refusal::usage(format!(
            "the protocol {protocol} uses the held-out views of the data set, so there is nothing to split; import them with the data \
             set"
        ))
    })?;
    let (train, test) = (frames - held_out.len(), held_out.len());
    if train < 2 || test == 0 {
        return Err(Refusal::bad_input(format!(
            "the protocol {protocol} leaves {train} of {frames} frames for training and {test} for evaluation; use a longer clip"
        )));
    }
    let trains: Vec<usize> = (0..frames)
        .filter(|i| held_out.binary_search(i).is_err())
        .collect();
    let tracks = capture
        .tracks
        .as_ref()
        .map(|tracks| tracks.in_order(&trains));
    let tracks = tracks.transpose().map_err(|e| {
        let hint = "compute them again with `minute4d enhance`";
        Refusal::bad_input(format!(
            "tracks of the capture do not match its frames: {e}; {hint}"
        ))
    })?;
    let frames = capture.frames.into_iter().enumerate();
    let (test, train): (Vec<_>, Vec<_>) =
        frames.partition(|(i, _)| held_out.binary_search(i).is_ok());
    let part = |frames: Vec<(usize, CaptureFrame)>, tracks| Capture {
        frames: frames.into_iter().map(|(_, frame)| frame).collect(),
        time_frames: capture.time_frames,
        duration_s: capture.duration_s,
        metric: capture.metric,
        tracks,
    };
    Ok(Parts {
        train: part(train, tracks),
        test: part(test, None),
        held_out,
    })
}

/// Splits the training frames of the capture `data` by a protocol and writes the capture `out`,
/// whose record is [`SPLIT_FILE`].
///
/// [`Existing::Resume`] keeps what is there if it is the same split of the same capture.
///
/// # Errors
///
/// [`minute4d::Error::Refused`] for a protocol or a capture that cannot be split;
/// [`minute4d::Error::Output`] for a folder that holds something; else what could not be read or
/// written.
pub fn split(
    data: &Path,
    protocol: Protocol,
    out: &Path,
    existing: Existing,
    reach: Reach,
    observer: &dyn Observer,
) -> Result<SplitRecord, Error> {
    minute4d::Error::unless_exists("capture", data)?;
    let mut settings = Settings::fast();
    settings.capture.reach = reach;
    let capture = m4_io::capture::read(data, Split::Train, &settings.capture, observer)?;
    let source_blake3 = hash::of_capture(&capture);
    let frames = capture.frames.len();
    let names: Vec<String> = capture.frames.iter().map(|f| f.name.clone()).collect();
    let parts = parts(capture, protocol)?;
    let record = SplitRecord {
        format: "minute4d-split".to_owned(),
        version: 1,
        minute4d: env!("CARGO_PKG_VERSION").to_owned(),
        protocol,
        frame_rule: protocol.rules().frames,
        source: data.to_path_buf(),
        source_blake3,
        frames,
        held_out_names: parts.held_out.iter().map(|&i| names[i].clone()).collect(),
        held_out: parts.held_out.clone(),
        geometry_saw_held_out: true,
    };
    let mut results = ResultFolder::open(out, Kind::Capture)?;
    let list = if data.is_dir() {
        data
    } else {
        data.parent().unwrap_or(data)
    };
    results.check_not_itself(&[list])?;
    let names = || capture_names().chain([SPLIT_FILE]);
    results.check_inputs(names(), &[data])?;
    if !results.is_empty() {
        match (SplitRecord::read(out)?, existing) {
            (Some(earlier), Existing::Resume) if earlier == record => return Ok(record),
            (Some(_), Existing::Resume | Existing::Force) | (None, Existing::Force) => {}
            (Some(_), Existing::Refuse) => {
                return Err(OutputError::Exists {
                    path: out.to_path_buf(),
                    what: "a split capture".to_owned(),
                }
                .into());
            }
            (None, _) => {
                return Err(OutputError::NotOurs {
                    path: out.to_path_buf(),
                    missing: SPLIT_FILE,
                }
                .into());
            }
        }
    }
    results.check_free(names())?;
    let next = results.begin()?;
    m4_io::capture::write(&next, &parts.test, Split::Test, observer)?;
    m4_io::capture::write(&next, &parts.train, Split::Train, observer)?;
    write_json(&next.join(SPLIT_FILE), &record)?;
    results.commit(None)?;
    Ok(record)
}

#[cfg(test)]
mod tests {
    use super::{Parts, parts, split};
    use crate::Protocol;
    use crate::error::Error;
    use m4_core::{Capture, Plane, Tracks};
    use m4_io::capture::{self, CaptureOptions, Split};
    use m4_io::reach::Reach;
    use m4_testkit::clips::plain_clip;
    use minute4d::{Category, Existing, OutputError, Silent};

    fn clip(n: usize) -> Capture {
        let mut clip = plain_clip(n, (16, 12));
        for (i, frame) in clip.frames.iter_mut().enumerate() {
            frame.depth = Some(Plane::filled(16, 12, 2.0 + i as f32).into());
        }
        let xyz = (0..n).map(|i| [i as f32, 0.0, 1.0]).collect();
        let tracks = Some(Tracks::new(n, 1, xyz, vec![true; n]).unwrap());
        Capture {
            duration_s: Some(3.0),
            metric: true,
            tracks,
            ..clip
        }
    }

    #[test]
    fn moments_stay_and_tracks_lose_the_held_out_frames() {
        let Parts {
            train,
            test,
            held_out,
        } = parts(clip(24), Protocol::Rodygs).unwrap();
        assert_eq!(held_out, [4, 12, 20]);
        let moments = |c: &Capture| c.frames.iter().map(|f| f.t).collect::<Vec<_>>();
        assert_eq!(moments(&test), [4.0, 12.0, 20.0]);
        assert_eq!(train.frames.len(), 21);
        assert_eq!(
            (train.time_frames, test.time_frames, train.metric),
            (24, 24, true)
        );
        assert!(
            train
                .frames
                .iter()
                .all(|f| f.t == f64::from(f.rgb[(0, 0)][0]))
        );
        let tracks = train.tracks.unwrap();
        assert_eq!(
            (tracks.frames(), tracks.place(4, 0)),
            (21, Some([5.0, 0.0, 1.0]))
        );
    }

    #[test]
    fn splits_that_leave_too_few_frames_are_refused() {
        for (frames, protocol, words) in [
            (8, Protocol::Dycheck, "nothing to split"),
            (
                3,
                Protocol::Rodygs,
                "3 of 3 frames for training and 0 for evaluation",
            ),
            (2, Protocol::Instant4d, "1 of 2 frames for training"),
        ] {
            let message = parts(clip(frames), protocol).unwrap_err().to_string();
            assert!(message.contains(words), "{message}");
        }
    }

    #[test]
    fn both_parts_are_read_at_the_times_of_the_video() {
        let dir = tempfile::tempdir().unwrap();
        let (full, out) = (dir.path().join("full"), dir.path().join("out"));
        capture::write(&full, &clip(24), Split::Train, &Silent).unwrap();
        let record = split(
            &full,
            Protocol::Instant4d,
            &out,
            Existing::Refuse,
            Reach::Inside,
            &Silent,
        )
        .unwrap();
        assert_eq!(record.held_out, [5, 11, 17, 22]);
        assert_eq!(record.held_out_names[0], "train/00005.png");
        let read = |which| capture::read(&out, which, &CaptureOptions::default(), &Silent).unwrap();
        let (train, test) = (read(Split::Train), read(Split::Test));
        assert_eq!((train.frames.len(), test.frames.len()), (20, 4));
        assert_eq!(train.time_frames, test.time_frames);
        // the moment of a frame as a share of the video, whatever its number of frames is taken to
        // be
        let last = (train.time_frames - 1) as f64;
        for frame in train.frames.iter().chain(&test.frames) {
            let i = f64::from(frame.rgb[(0, 0)][0]);
            assert!((frame.t / last - i / 23.0).abs() < 1e-12, "{} {i}", frame.t);
        }
        let again = |existing| {
            split(
                &full,
                Protocol::Instant4d,
                &out,
                existing,
                Reach::Inside,
                &Silent,
            )
        };
        assert!(matches!(
            again(Existing::Refuse),
            Err(Error::Minute4d(minute4d::Error::Output(
                OutputError::Exists { .. }
            )))
        ));
        assert_eq!(again(Existing::Resume).unwrap(), record);
        let other = split(
            &full,
            Protocol::Holdout,
            &out,
            Existing::Force,
            Reach::Inside,
            &Silent,
        )
        .unwrap();
        assert_eq!(other.held_out, [0, 8, 16]);
        assert_eq!(
            capture::read(&out, Split::Test, &CaptureOptions::default(), &Silent)
                .unwrap()
                .frames
                .len(),
            3
        );
        assert_eq!(
            std::fs::read_dir(out.join("test")).unwrap().count(),
            3,
            "nothing of the first split is left"
        );
        let foreign = split(
            &full,
            Protocol::Holdout,
            &full,
            Existing::Force,
            Reach::Inside,
            &Silent,
        );
        assert_eq!(foreign.unwrap_err().category(), Category::CannotWrite);
    }
}
