//! A capture read another way.

use super::reading::Reading;
use super::report::Cause;
use m4_scene::{Capture, CompactDepth, DepthMap};

/// The capture with its causes of inconsistency put right: cameras and depth changed, pictures and masks as they are.
#[must_use]
pub fn fixed(mut capture: Capture, causes: &[Cause]) -> Capture {
    let reading = causes.iter().fold(Reading::GIVEN, |reading, cause| match *cause {
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
    for frame in &mut capture.frames {
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
