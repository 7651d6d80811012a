//! The page in a real browser: what it draws, from a file and from the server. What its controls do
//! is tested beside its sources.

use crate::turning::turning;
use base64::Engine;
use m4_core::{
    Camera, Exposure, Intrinsics, RgbImage, Scene, Se3, SourceFrame, SplatLayout,
    nalgebra::{Matrix3, Vector3},
};
use m4_kernels::{Renderer, SimdLevel, View};
use m4_testkit::{Chromium, SceneSpec, camera_looking_at, find_chromium, random_splats};
use m4_viewer::page::{self, Compression, Parts, TEMPLATE};
use m4_viewer::payload::{decode, encode};
use m4_viewer::server::{Hub, Server};
use m4_viewer::{About, FRAME_BYTES, Manifest, encode_frames};
use serde_json::json;
use std::path::Path;
use std::sync::Arc;

const FRAMES: usize = 10;
/// Where the middle source camera looks, world units before it.
const DISTANCE: f64 = 4.0;

/// 3,000 splats that stay and 2,000 that come, move and go.
fn scene() -> Scene {
    let intrinsics = Intrinsics::centred(320, 200, 300.0);
    let look = |x: f64| camera_looking_at(intrinsics, [x, 0.0, 0.0], [0.0, 0.0, DISTANCE]);
    let spec = SceneSpec {
        layout: SplatLayout {
            isotropic: false,
            sh_degree: 1,
            time_degree: 0,
        },
        n_static: 3000,
        n_dynamic: 2000,
        time_frames: FRAMES,
        sd_px: [0.7, 5.0],
        logit: [-2.0, 4.0],
    };
    Scene {
        splats: random_splats(7, &look(0.0), &spec),
        background: [0.1, 0.2, 0.3],
        time_frames: FRAMES,
        duration_s: Some(1.0),
        mip: true,
        near: 0.2,
        source: (0..FRAMES)
            .map(|i| SourceFrame {
                camera: look(0.05 * i as f64 - 0.2),
                t: i as f64,
                exposure: Exposure::IDENTITY,
                distance_sigma: None,
            })
            .collect(),
    }
}

/// Renders with our own renderer, 8 bits per channel.
fn drawn(scene: &Scene, camera: &Camera, t: f64) -> RgbImage {
    let view = View {
        camera: *camera,
        t,
        background: scene.background,
        near: scene.near,
        mip: scene.mip,
        period: (scene.time_frames - 1) as f32,
        with_depth: false,
    };
    let mut renderer = Renderer::new(SimdLevel::detect().unwrap());
    let frame = renderer.render(&scene.splats, &view);
    RgbImage::from_fn(frame.width, frame.height, |x, y| {
        std::array::from_fn(|c| {
            (frame.rgb[c][y * frame.width + x].clamp(0.0, 1.0) * 255.0).round() as u8
        })
    })
}

fn psnr_db(a: &RgbImage, b: &RgbImage) -> f64 {
    assert_eq!((a.width(), a.height()), (b.width(), b.height()));
    let errors = a.data().iter().flatten().zip(b.data().iter().flatten());
    let sum: f64 = errors
        .map(|(a, b)| (f64::from(*a) - f64::from(*b)).powi(2))
        .sum();
    10.0 * (255.0f64.powi(2) * (3 * a.width() * a.height()) as f64 / sum).log10()
}

/// The metadata of a scene for the page, and its splats.
fn told(scene: &Scene) -> (Manifest, Vec<u8>) {
    let payload = encode(scene, DISTANCE);
    let about = About {
        title: "five thousand splats",
        median_depth: DISTANCE,
        fps: 9.0,
    };
    (Manifest::new(scene, &payload, &about), payload.bytes)
}

fn written(scene: &Scene, folder: &Path) -> String {
    let (mut manifest, payload) = told(scene);
    let images: Vec<RgbImage> = scene
        .source
        .iter()
        .map(|s| drawn(scene, &s.camera, s.t))
        .collect();
    let images: Vec<&RgbImage> = images.iter().collect();
    let frames = encode_frames(&images, 9.0, FRAME_BYTES).unwrap();
    manifest.frames = frames.as_ref().map(|f| f.index.clone());
    let parts = Parts {
        manifest: &manifest,
        payload: Some(&payload),
        frames: frames.as_ref(),
    };
    let path = folder.join("viewer.html");
    std::fs::write(
        &path,
        page::compose(TEMPLATE, &parts, Compression::default()).unwrap(),
    )
    .unwrap();
    format!("file://{}", path.display())
}

/// The settled image of the page as the browser encodes it.
fn capture(page: &mut Chromium) -> Vec<u8> {
    let url = page.eval("minute4d.capture()");
    let (_, data) = url.as_str().unwrap().split_once("base64,").unwrap();
    base64::engine::general_purpose::STANDARD
        .decode(data)
        .unwrap()
}

fn decoded(png: &[u8]) -> RgbImage {
    let image = image::load_from_memory(png).unwrap().to_rgb8();
    let (w, h) = (image.width(), image.height());
    RgbImage::from_fn(w as usize, h as usize, |x, y| {
        image.get_pixel(x as u32, y as u32).0
    })
}

fn stand(page: &mut Chromium, camera: &Camera, t: f64) {
    let (k, m) = (&camera.intrinsics, camera.c2w.matrix());
    let c2w: Vec<f64> = (0..16).map(|i| m[(i / 4, i % 4)]).collect();
    let (fx, fy, cx, cy) = (k.fx, k.fy, k.cx, k.cy);
    page.eval(&format!(
        "(minute4d.setCamera({}, {fx}, {fy}, {cx}, {cy}), minute4d.setTime({t}))",
        json!(c2w)
    ));
}

/// A camera for the window of the page, rolled, and with a principal point off the middle: nothing
/// may be taken for granted.
fn camera_for(page: &mut Chromium) -> Camera {
    let mut size = |name: &str| {
        page.eval(&format!("minute4d.state().{name}"))
            .as_u64()
            .unwrap() as usize
    };
    let (width, height) = (size("width"), size("height"));
    let mut camera = camera_looking_at(
        Intrinsics::centred(width, height, 0.9 * width as f64),
        [0.1, -0.1, 0.0],
        [0.0, 0.0, DISTANCE],
    );
    let (sin, cos) = 0.2f64.sin_cos();
    camera.c2w = camera.c2w.compose(&Se3 {
        rotation: Matrix3::new(cos, -sin, 0.0, sin, cos, 0.0, 0.0, 0.0, 1.0),
        translation: Vector3::zeros(),
    });
    camera.intrinsics.cx += 17.5;
    camera.intrinsics.cy -= 9.25;
    camera
}

/// Least agreement with our renderer, dB, given the splats that the page was given (measured:
/// 60.6).
const SAME_SPLATS_DB: f64 = 52.0;
/// The same given the splats before they were quantised for the page (measured: 49.5).
const QUANTISED_DB: f64 = 45.0;
const TIMES: [f64; 3] = [0.0, 4.25, 9.0];

#[test]
fn page_carries_bound_splats_as_the_renderer_does() {
    let Some(program) = find_chromium() else {
        return;
    };
    let scene = turning(
        SplatLayout {
            isotropic: false,
            sh_degree: 1,
            time_degree: 0,
        },
        500,
        1500,
        300,
    );
    let folder = tempfile::tempdir().unwrap();
    let mut page = Chromium::open(program.clone(), &written(&scene, folder.path()));
    page.eval("minute4d.ready");
    assert_eq!(page.eval("minute4d.state().splats"), json!(2300));
    let camera = camera_for(&mut page);
    let page_scene = Scene {
        splats: decode(&told(&scene).1).unwrap(),
        ..scene.clone()
    };
    // without them: an image that would pass without bound splats says nothing
    let rows: Vec<u32> = (0..2300)
        .filter(|&r| !scene.splats.bound().contains(&(r as usize)))
        .collect();
    let without = Scene {
        splats: scene.splats.gather(&rows).unwrap(),
        ..scene.clone()
    };
    // at keys, between them, and where one window takes over from the other
    for t in [0.0, 2.5, 4.5, 6.8, 9.0] {
        stand(&mut page, &camera, t);
        let image = decoded(&capture(&mut page));
        let same = psnr_db(&image, &drawn(&page_scene, &camera, t));
        let quantised = psnr_db(&image, &drawn(&scene, &camera, t));
        let gone = psnr_db(&image, &drawn(&without, &camera, t));
        eprintln!(
            "t = {t}: {same:.2} dB from our renderer, {quantised:.2} dB with the quantisation, {gone:.2} without"
        );
        assert!(
            same > SAME_SPLATS_DB && quantised > QUANTISED_DB && gone < 25.0,
            "t = {t}: {same:.2}, {quantised:.2}"
        );
    }
    let last = capture(&mut page);
    drop(page);

    // a live page whose first scene has none gets them with a newer scene
    let hub = Hub::waiting("a run");
    let show = |scene: &Scene| {
        let (manifest, payload) = told(scene);
        hub.show(manifest, payload);
    };
    show(&without);
    let server = Server::start(Arc::clone(&hub), 0).unwrap();
    let mut page = Chromium::open(program, server.url());
    page.eval("minute4d.ready");
    show(&scene);
    page.wait_for("minute4d.state().splats === 2300");
    stand(&mut page, &camera, 9.0);
    assert!(
        last == capture(&mut page),
        "the server's page draws another image than the file"
    );
}

#[test]
fn page_matches_the_renderer_from_file_and_server() {
    let Some(program) = find_chromium() else {
        return;
    };
    let scene = scene();
    let folder = tempfile::tempdir().unwrap();
    let mut page = Chromium::open(program.clone(), &written(&scene, folder.path()));
    page.eval("minute4d.ready");
    let camera = camera_for(&mut page);
    let look = |page: &mut Chromium| {
        TIMES.map(|t| {
            stand(page, &camera, t);
            capture(page)
        })
    };
    let first = look(&mut page);
    assert!(
        first == look(&mut page),
        "the settled image of a time is the same, bit for bit"
    );
    let images: Vec<RgbImage> = first.iter().map(|png| decoded(png)).collect();
    for i in 0..3 {
        let db = psnr_db(&images[i], &images[(i + 1) % 3]);
        assert!(
            db < 30.0,
            "times {i} and {} look alike: {db:.1} dB",
            (i + 1) % 3
        );
    }
    let page_scene = Scene {
        splats: decode(&told(&scene).1).unwrap(),
        ..scene.clone()
    };
    for (image, t) in images.iter().zip(TIMES) {
        let same = psnr_db(image, &drawn(&page_scene, &camera, t));
        let quantised = psnr_db(image, &drawn(&scene, &camera, t));
        eprintln!(
            "t = {t}: {same:.2} dB from our renderer, {quantised:.2} dB with the quantisation of the page"
        );
        assert!(
            same > SAME_SPLATS_DB && quantised > QUANTISED_DB,
            "t = {t}: {same:.2} and {quantised:.2} dB"
        );
    }
    let others = "performance.getEntriesByType('resource').map(e => e.name).filter(n => !/^(data|blob|file):/.test(n))";
    assert_eq!(page.eval(others), json!([]), "the page sends no request");
    drop(page);

    // the server starts with another scene: the page has to hear of this one and take it
    let mut earlier = scene.clone();
    earlier.splats = earlier
        .splats
        .gather(&(0..100).collect::<Vec<u32>>())
        .unwrap();
    let hub = Hub::waiting("five thousand splats");
    let show = |scene: &Scene| {
        let (manifest, payload) = told(scene);
        hub.show(manifest, payload);
    };
    show(&earlier);
    let server = Server::start(Arc::clone(&hub), 0).unwrap();
    let mut page = Chromium::open(program, server.url());
    page.eval("minute4d.ready");
    assert_eq!(page.eval("minute4d.state().splats"), json!(100));
    show(&scene);
    page.wait_for("minute4d.state().splats !== 100");
    assert!(
        first == look(&mut page),
        "the server's page draws other images than the file"
    );
}

/// Names of clips that end an element of a page, or begin what a browser does not end there.
const HOSTILE: [&str; 2] = [
    "<!--<script>",
    "</script><script>window.broken = 1</script><!--",
];

#[test]
fn a_clip_may_have_any_name() {
    let Some(program) = find_chromium() else {
        return;
    };
    let mut scene = scene();
    scene.splats = scene
        .splats
        .gather(&(0..100).collect::<Vec<u32>>())
        .unwrap();
    let (mut manifest, payload) = told(&scene);
    let folder = tempfile::tempdir().unwrap();
    for title in HOSTILE {
        manifest.title = title.to_owned();
        let parts = Parts {
            manifest: &manifest,
            payload: Some(&payload),
            frames: None,
        };
        let path = folder.path().join("viewer.html");
        std::fs::write(
            &path,
            page::compose(TEMPLATE, &parts, Compression::default()).unwrap(),
        )
        .unwrap();
        let mut page = Chromium::open(program.clone(), &format!("file://{}", path.display()));
        page.eval("minute4d.ready");
        assert_eq!(page.eval("minute4d.state().splats"), json!(100), "{title}");
        let shown = page.eval("[document.title, document.querySelector('.title h1').textContent]");
        assert_eq!(shown, json!([format!("{title} · minute4d"), title]));
        assert_eq!(page.eval("typeof window.broken"), json!("undefined"));
    }
}
