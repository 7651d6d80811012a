//! On a made-up room, and on a benchmark scene where it is present: every convention error is reported, and correct data is not.

mod room;

use super::{Cause, Verdict, check, fixed};
use crate::classical::dense::InverseSearch;
use m4_core::{Capture, CompactDepth, CompactMask, Silent};
use m4_io::capture::{self, CaptureOptions, Split};

/// The clips to judge, by name.
fn scenes() -> Vec<(&'static str, Capture)> {
    let mut all = vec![("room", room::room())];
    if let Some(path) = m4_testkit::shared("bench/quad-1") {
        let mut read = capture::read(&path, Split::Train, &CaptureOptions::default(), &Silent).unwrap();
        read.frames.truncate(32);
        all.push(("quad-1", read));
    }
    all
}

fn misread(mut capture: Capture, wrong: &dyn Fn(&mut m4_core::Camera)) -> Capture {
    capture.frames.iter_mut().for_each(|f| wrong(&mut f.camera));
    capture
}

#[test]
fn common_convention_errors_are_detected() {
    for (name, truth) in scenes() {
        println!("{name}");
        tell_all(truth);
    }
}

fn tell_all(truth: Capture) {
    let flow = InverseSearch;
    let said = |capture: &Capture| {
        let report = check(capture, &flow, &Silent).unwrap();
        println!("{report:?}");
        report
    };
    let good = said(&truth);
    assert_eq!((good.verdict, good.causes.as_slice()), (Verdict::Good, &[][..]));
    assert!(good.samples > 10_000 && good.error_px.unwrap() < 0.5 && good.error_px.unwrap() > 0.0);
    assert!(good.depth_error.unwrap() < 0.02);

    let turned = misread(truth.clone(), &|c| {
        c.c2w.rotation.column_mut(1).neg_mut();
        c.c2w.rotation.column_mut(2).neg_mut();
    });
    let report = said(&turned);
    assert_eq!(
        (report.verdict, report.causes.as_slice()),
        (Verdict::Bad, &[Cause::Axes][..])
    );
    assert!(said(&fixed(turned, &report.causes)).verdict == Verdict::Good);

    let inverted = misread(truth.clone(), &|c| c.c2w = c.c2w.inverse());
    let report = said(&inverted);
    assert_eq!(
        (report.verdict, report.causes.as_slice()),
        (Verdict::Bad, &[Cause::Inverted][..])
    );
    assert!(said(&fixed(inverted, &report.causes)).verdict == Verdict::Good);

    let both = misread(truth.clone(), &|c| {
        c.c2w.rotation.column_mut(1).neg_mut();
        c.c2w.rotation.column_mut(2).neg_mut();
        c.c2w = c.c2w.inverse();
    });
    assert_eq!(said(&both).causes, [Cause::Inverted, Cause::Axes]);

    let mut millimetres = truth.clone();
    for frame in &mut millimetres.frames {
        let depth = frame.depth.take().unwrap().to_map();
        frame.depth = Some(CompactDepth::from(depth.map(|z| 1000.0 * z)));
    }
    let report = said(&millimetres);
    assert_eq!(report.verdict, Verdict::Bad);
    assert_eq!(report.causes, [Cause::DepthUnit { factor: 1e-3 }]);
    assert!(said(&fixed(millimetres, &report.causes)).verdict == Verdict::Good);

    let mut masked = truth.clone();
    for frame in &mut masked.frames {
        let mask = frame.mask.take().unwrap().to_mask();
        frame.mask = Some(CompactMask::from(&mask.map(|m| 255 - m)));
    }
    let report = said(&masked);
    assert_eq!(
        (report.verdict, report.causes.as_slice()),
        (Verdict::Bad, &[Cause::Masks][..])
    );
    assert!(said(&fixed(masked, &report.causes)).verdict == Verdict::Good);

    for half in [-0.5, 0.5] {
        let shifted = misread(truth.clone(), &|c| {
            c.intrinsics.cx += half;
            c.intrinsics.cy += half;
        });
        let report = said(&shifted);
        assert_eq!(
            report.causes,
            [Cause::PixelCentre {
                shift_px: [-half, -half]
            }]
        );
        assert!(said(&fixed(shifted, &report.causes)).causes.is_empty());
    }
}

#[test]
fn poses_without_depth_are_checked_too() {
    for (name, truth) in scenes() {
        println!("{name}");
        tell_without_depth(truth);
    }
}

fn tell_without_depth(mut truth: Capture) {
    truth.frames.iter_mut().for_each(|f| f.depth = None);
    let flow = InverseSearch;
    let said = |capture: &Capture| check(capture, &flow, &Silent).unwrap();
    let good = said(&truth);
    println!("{good:?}");
    assert_eq!((good.verdict, good.depth_error), (Verdict::Good, None));
    let inverted = misread(truth.clone(), &|c| c.c2w = c.c2w.inverse());
    assert_eq!(said(&inverted).causes, [Cause::Inverted]);
    let turned = misread(truth, &|c| {
        c.c2w.rotation.column_mut(1).neg_mut();
        c.c2w.rotation.column_mut(2).neg_mut();
    });
    assert_eq!(said(&turned).causes, [Cause::Axes]);
}

#[test]
fn static_camera_gives_no_verdict() {
    let mut still = room::room();
    still.frames = vec![still.frames[0].clone(); 8];
    let report = check(&still, &InverseSearch, &Silent).unwrap();
    assert_eq!((report.verdict, report.causes.len()), (Verdict::Unknown, 0));
}
