//! A capture read another way.

use super::reading::Reading;
use super::report::Cause;
use m4_core::{Capture, CompactDepth, CompactMask, DepthMap};

/// The capture with its causes of inconsistency put right: cameras, depth and masks; images as they are.
#[must_use]
pub fn fixed(mut capture: Capture, causes: &[Cause]) -> Capture {
    let reading = causes.iter().fold(Reading::GIVEN, |reading, cause| match *cause {
        Cause::Masks => reading,
        Cause::Inverted => Reading {
            inverted: true,
            ..reading
        },
        Cause::Axes => Reading {
            flipped: true,
            ..reading
        },
        Cause::DepthUnit { factor } => Reading {
            scale: factor,
            ..reading
        },
        Cause::Focal { factor } => Reading {
            focal: factor,
            ..reading
        },
        Cause::PixelCentre { shift_px } => Reading { shift_px, ..reading },
    });
    let turned = causes.contains(&Cause::Masks);
    for frame in &mut capture.frames {
        if turned {
            frame.mask = frame
                .mask
                .take()
                .map(|mask| CompactMask::from(&mask.to_mask().map(|m| 255 - m)));
            frame.motion = frame.motion.take().map(|motion| motion.map(|m| 255 - m));
        }
        frame.camera = reading.camera(&frame.camera);
        if reading.scale != 1.0 {
            frame.depth = frame.depth.take().map(|depth| {
                let scaled: DepthMap = depth.to_map().map(|z| (f64::from(*z) * reading.scale) as f32);
                CompactDepth::from(scaled)
            });
        }
    }
    capture
}
