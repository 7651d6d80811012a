//! A small scene and its metadata for the page.

use m4_core::{Exposure, Intrinsics, Scene, SourceFrame, SplatLayout};
use m4_testkit::{SceneSpec, camera_looking_at, random_splats};
use m4_viewer::payload::Payload;
use m4_viewer::{About, Manifest};

const FRAMES: usize = 6;

/// Splats in front of a static camera.
pub fn scene(n_static: usize, n_dynamic: usize) -> Scene {
    let camera = camera_looking_at(Intrinsics::centred(160, 120, 140.0), [0.3, 0.1, -0.5], [0.3, 0.1, 4.0]);
    let spec = SceneSpec {
        layout: SplatLayout { isotropic: false, sh_degree: 0, time_degree: 0 },
        n_static,
        n_dynamic,
        time_frames: FRAMES,
        ..SceneSpec::default()
    };
    let source = (0..FRAMES).map(|i| SourceFrame { camera, t: i as f64, exposure: Exposure::IDENTITY });
    Scene {
        splats: random_splats(5, &camera, &spec),
        background: [0.1, 0.2, 0.3],
        time_frames: FRAMES,
        duration_s: Some(0.5),
        mip: true,
        near: 0.05,
        source: source.collect(),
    }
}

/// The page's metadata of a scene with a median depth of 4.
pub fn manifest_of(scene: &Scene, payload: &Payload) -> Manifest {
    let about = About { title: "a test", median_depth: 4.0, fps: 10.0 };
    Manifest::new(scene, payload, &about)
}
