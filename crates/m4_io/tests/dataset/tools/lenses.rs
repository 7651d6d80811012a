//! Lenses: images that OpenCV drew through one, undistorted.

use super::truth::{SIZE, Truth, beside, colour, read};
use m4_io::dataset::SourceFormat::{Colmap, Nerfstudio};

#[test]
fn images_through_lenses_are_as_a_pinhole_sees_them() {
    let truth = Truth::read();
    for (name, format) in [
        ("import/colmap_opencv", Colmap),
        ("import/colmap_fisheye", Colmap),
        ("import/nerfstudio_opencv", Nerfstudio),
        ("import/nerfstudio_fisheye", Nerfstudio),
    ] {
        let got = read(name, format, &beside()).unwrap().train;
        assert_eq!(got.frames.len(), 2);
        for (i, frame) in got.frames.iter().enumerate() {
            truth.same_pose(i, frame);
            let k = frame.camera.intrinsics;
            assert_eq!((k.width, k.height), SIZE);
            assert_eq!([k.cx, k.cy], [truth.intrinsics[2], truth.intrinsics[3]]);
            // a barrel sees further to the sides: the lens that shows all of it, and nothing beyond, is shorter
            let shorter = k.fx / truth.intrinsics[0];
            assert!(
                (0.9..0.995).contains(&shorter) && (k.fx / k.fy - 50.0 / 52.0).abs() < 1e-12,
                "{k:?}"
            );
            let mut off = Vec::new();
            for p in 0..SIZE.0 * SIZE.1 {
                let (u, v) = (p % SIZE.0, p / SIZE.0);
                let want = colour(i, (u as f64 + 0.5 - k.cx) / k.fx, (v as f64 + 0.5 - k.cy) / k.fy);
                let found = frame.rgb[(u, v)];
                off.extend((0..3).map(|c| (f64::from(found[c]) - want[c]).abs()));
            }
            let worst = off.iter().copied().fold(0.0, f64::max);
            let mean = off.iter().sum::<f64>() / off.len() as f64;
            // rounding twice and bilinear sampling; without undistortion the worst is above 10
            assert!(worst < 2.5 && mean < 0.5, "{name}, frame {i}: {worst}, {mean}");
        }
    }
}
