//! Refines the masks of a capture in memory, with any object tracker.

use crate::json::write_json;
use crate::layout::OBJECTS_FILE;
use crate::{Error, Refusal};
use m4_core::{Capture, CompactIds, CompactMask, Plane, Progress};
use m4_geometry::masks::{
    Coarse, InstanceError, InstanceReport, RefineSettings, RefinedFrame, VideoSession, refine,
};
use m4_io::capture::Split;
use std::path::Path;

/// Refined masks and maps of instances at the size of a capture's images, a pair per frame, and
/// what was found. The dynamic part is read from the maps of motion where every frame has one, else
/// from the masks. `open` as in [`refine()`]. Refused where a frame says nothing about the dynamic
/// part.
pub fn masks<'a>(
    capture: &Capture,
    settings: &RefineSettings,
    open: impl FnOnce((usize, usize)) -> Result<Box<dyn VideoSession + 'a>, InstanceError>,
    progress: &dyn Progress,
) -> Result<(Vec<(CompactMask, CompactIds)>, InstanceReport), Error> {
    let coarse = coarse(capture)?;
    let images: Vec<_> = capture.frames.iter().map(|frame| &frame.rgb).collect();
    let refined = refine(&images, &coarse, settings, open, progress)?;
    let frames = refined
        .frames
        .into_iter()
        .zip(images)
        .map(|(frame, image)| at_size(frame, image.size()));
    Ok((frames.collect(), refined.report))
}

/// Writes a capture, with its report if it has one, into `folder`; see [`m4_io::capture::write()`].
pub fn write(
    folder: &Path,
    capture: &Capture,
    report: Option<&InstanceReport>,
    progress: &dyn Progress,
) -> Result<(), Error> {
    m4_io::capture::write(folder, capture, Split::Train, progress)?;
    report.map_or(Ok(()), |report| {
        write_json(&folder.join(OBJECTS_FILE), report)
    })
}

fn coarse(capture: &Capture) -> Result<Coarse<'_>, Refusal> {
    if let Some(maps) = capture
        .frames
        .iter()
        .map(|frame| frame.motion.as_ref())
        .collect()
    {
        return Ok(Coarse::Motion(maps));
    }
    let masks = capture.frames.iter().enumerate().map(|(i, frame)| {
        frame.mask.as_ref().ok_or_else(|| {
            Refusal::bad_input(format!(
                "frame {i} ({:?}) has neither a motion map nor a mask, so there is nothing to refine; make the capture from the \
                 video again, or import it with masks",
                frame.name
            ))
        })
    });
    masks.collect::<Result<_, _>>().map(Coarse::Masks)
}

/// A frame at another size: each pixel that of the working size in which its middle lies.
fn at_size(refined: RefinedFrame, (width, height): (usize, usize)) -> (CompactMask, CompactIds) {
    let (w, h) = refined.mask.size();
    if (w, h) == (width, height) {
        return (refined.mask, refined.ids);
    }
    let at = |x: usize, y: usize| {
        (
            (2 * x + 1) * w / (2 * width),
            (2 * y + 1) * h / (2 * height),
        )
    };
    let ids = refined.ids.to_plane();
    let masks = refined.mask.to_mask();
    let mask = CompactMask::from_fn(width, height, |x, y| masks[at(x, y)] != 0);
    (
        mask,
        CompactIds::from(&Plane::from_fn(width, height, |x, y| ids[at(x, y)])),
    )
}

#[cfg(test)]
mod tests {
    use super::{OBJECTS_FILE, masks, write};
    use crate::{Category, Error};
    use m4_core::{Capture, CompactIds, CompactMask, Plane, Silent};
    use m4_geometry::masks::{FlowFollower, InstanceReport, RefineSettings};
    use m4_io::capture::{CaptureOptions, Split};
    use m4_testkit::clips::clip;

    const SIZE: (usize, usize) = (96, 72);

    /// A patterned square that moves by two pixels per frame in front of a static pattern.
    fn on_square(x: usize, y: usize, i: usize) -> bool {
        (10 + 2 * i..34 + 2 * i).contains(&x) && (20..44).contains(&y)
    }

    fn capture(frames: usize) -> Capture {
        let wave = |x: f32, y: f32| {
            (128.0 + 50.0 * (x * 0.6).sin() * (y * 0.5).cos() + 40.0 * (0.31 * (x + 2.0 * y)).sin())
                as u8
        };
        let colour = |x: usize, y: usize, i: usize| match on_square(x, y, i) {
            true => [wave(3.0 + 1.3 * (x - 2 * i) as f32, 0.9 * y as f32), 20, 20],
            false => [30, wave(x as f32, y as f32), 160],
        };
        let mut capture = clip(frames, |i| {
            Plane::from_fn(SIZE.0, SIZE.1, |x, y| colour(x, y, i))
        });
        for (i, frame) in capture.frames.iter_mut().enumerate() {
            frame.mask = Some(CompactMask::from_fn(SIZE.0, SIZE.1, |x, y| {
                on_square(x + 2, y + 2, i)
            }));
        }
        capture
    }

    type Refined = (Vec<(CompactMask, CompactIds)>, InstanceReport);

    fn refined(capture: &Capture, settings: &RefineSettings) -> Result<Refined, Error> {
        let images: Vec<_> = capture.frames.iter().map(|frame| &frame.rgb).collect();
        masks(
            capture,
            settings,
            |size| Ok(Box::new(FlowFollower::new(&images, size, None))),
            &Silent,
        )
    }

    #[test]
    fn a_capture_gets_numbers_that_are_written_and_read() {
        let mut capture = capture(12);
        let (frames, report) = refined(&capture, &RefineSettings::default()).unwrap();
        for (frame, (mask, ids)) in capture.frames.iter_mut().zip(frames) {
            (frame.mask, frame.instances) = (Some(mask), Some(ids));
        }
        assert_eq!(
            (report.instances.len(), report.coarse.as_str()),
            (1, "masks")
        );
        assert_eq!(
            (report.instances[0].frames, report.instances[0].id),
            (12, 1)
        );
        for (i, frame) in capture.frames.iter().enumerate() {
            let ids = frame.instances.as_ref().unwrap();
            assert_eq!(
                (ids.size(), ids.at(20 + 2 * i, 30), ids.at(90, 65)),
                (SIZE, 1, 0),
                "frame {i}"
            );
            assert!(frame.mask.as_ref().unwrap().at(20 + 2 * i, 30));
        }
        let dir = tempfile::tempdir().unwrap();
        write(dir.path(), &capture, Some(&report), &Silent).unwrap();
        let again = m4_io::capture::read(
            dir.path(),
            Split::Train,
            &CaptureOptions::default(),
            &Silent,
        )
        .unwrap();
        for (a, b) in again.frames.iter().zip(&capture.frames) {
            assert_eq!((&a.instances, &a.mask), (&b.instances, &b.mask));
        }
        let text = std::fs::read(dir.path().join(OBJECTS_FILE)).unwrap();
        assert_eq!(
            serde_json::from_slice::<InstanceReport>(&text).unwrap(),
            report
        );
    }

    #[test]
    fn a_frame_that_says_nothing_is_named() {
        let mut incomplete = capture(4);
        incomplete.frames[2].mask = None;
        let error = refined(&incomplete, &RefineSettings::default()).unwrap_err();
        assert!(
            matches!(error, Error::Refused(_)) && error.to_string().contains("00002"),
            "{error}"
        );
        assert_eq!(error.category(), Category::BadInput);
        let wrong = RefineSettings {
            every_frames: 0,
            ..RefineSettings::default()
        };
        let error = refined(&capture(4), &wrong).unwrap_err();
        assert_eq!(error.category(), Category::BadSettings);
    }
}
