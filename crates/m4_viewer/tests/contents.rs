//! The page with a scene in it, and what comes out of it again.

use base64::Engine;
use base64::engine::general_purpose::STANDARD;
use m4_core::{Exposure, Intrinsics, Plane, RgbImage, Scene, SourceFrame, SplatLayout};
use m4_testkit::{SceneSpec, camera_looking_at, random_splats};
use m4_viewer::page::{self, Compression, MARKER, PageError, Parts, TEMPLATE, compose};
use m4_viewer::payload::{Payload, decode, encode};
use m4_viewer::{About, FRAME_BYTES, Manifest, encode_frames};

#[test]
fn a_scene_comes_back_out_of_the_page() {
    let scene = scene(40, 30);
    let payload = encode(&scene, 4.0);
    let mut manifest = manifest_of(&scene, &payload);
    manifest.title = "</script><script>alert(1)</script> \"ä\"".to_owned();
    let images: Vec<RgbImage> = (0..scene.source.len())
        .map(|i| Plane::filled(60, 40, [20 * i as u8; 3]))
        .collect();
    let frames = encode_frames(&images.iter().collect::<Vec<_>>(), 9.0, FRAME_BYTES).unwrap();
    manifest.frames = frames.as_ref().map(|f| f.index.clone());
    let parts = Parts {
        manifest: &manifest,
        payload: Some(&payload.bytes),
        frames: frames.as_ref(),
    };
    for compression in [Compression::fast(), Compression::default()] {
        let html = String::from_utf8(compose(TEMPLATE, &parts, compression).unwrap()).unwrap();
        assert!(!html.contains(MARKER) && !html.contains("</script><script>alert"));
        // what is seen first comes before what takes long to read
        let first = frames.as_ref().map(|f| &f.poster).unwrap();
        let poster = format!(
            "style=\"--aspect:1.500000\" src=\"data:image/jpeg;base64,{}\">",
            STANDARD.encode(first)
        );
        assert!(html.find(&poster).unwrap() < html.find("<script").unwrap());
        let back = page::read(&html).unwrap();
        assert_eq!(back.manifest, manifest);
        assert_eq!(back.frames, frames);
        assert_eq!(page::read_frames(&html).unwrap(), frames);
        let bytes = back.payload.unwrap();
        assert_eq!(bytes, payload.bytes);
        assert_eq!(decode(&bytes).unwrap().n(), 70);
    }
}

/// The manifest of a small scene with that title, its payload, and the page of both.
fn small_page(title: &str) -> (Manifest, Vec<u8>, String) {
    let scene = scene(4, 3);
    let payload = encode(&scene, 4.0);
    let manifest = Manifest {
        title: title.to_owned(),
        ..manifest_of(&scene, &payload)
    };
    let parts = Parts {
        manifest: &manifest,
        payload: Some(&payload.bytes),
        frames: None,
    };
    let html = String::from_utf8(compose(MARKER, &parts, Compression::fast()).unwrap()).unwrap();
    (manifest, payload.bytes, html)
}

/// Titles that end an element of a page, or begin what a browser does not end there: a clip may
/// have any name.
const HOSTILE: [&str; 5] = [
    "<!--<script>.mp4",
    "--><!--<SCRIPT src=x></sCriPt >",
    "</script><script>window.broken = 1</script>",
    "<script type=\"text/plain\" id=\"m4-splats\">AAAA</script>",
    "<!--minute4d-data--> \u{2028} ä & \\u003c \" '",
];

#[test]
fn titles_are_escaped() {
    for title in HOSTILE {
        let (manifest, payload, html) = small_page(title);
        // the tags of two elements
        assert_eq!(html.matches('<').count(), 4, "{title}: {html}");
        let back = page::read(&html).unwrap();
        assert_eq!((back.manifest, back.payload), (manifest, Some(payload)));
    }
}

#[test]
fn pages_that_browsers_cannot_parse_are_refused() {
    let (_, _, html) = small_page("a clip");
    for title in ["<!--", "<!--<script>", "a <!-- b -->"] {
        let read = page::read(&html.replace("a clip", title));
        assert!(matches!(read, Err(PageError::Comment(_))), "{title}");
    }
    // what earlier versions wrote, and every browser reads
    assert_eq!(
        page::read(&html.replace("a clip", "a <\\/b> clip"))
            .unwrap()
            .manifest
            .title,
        "a </b> clip"
    );
}

#[test]
fn a_page_that_waits_has_no_splats() {
    let manifest = Manifest::waiting("later");
    let parts = Parts {
        manifest: &manifest,
        payload: None,
        frames: None,
    };
    let html =
        String::from_utf8(compose(TEMPLATE, &parts, Compression::default()).unwrap()).unwrap();
    assert!(!html.contains("<img"));
    let back = page::read(&html).unwrap();
    assert_eq!(
        (back.payload, back.frames, back.manifest),
        (None, None, manifest)
    );
}

#[test]
fn damaged_pages_are_errors() {
    let (manifest, payload, html) = small_page("a clip");
    let parts = Parts {
        manifest: &manifest,
        payload: Some(&payload),
        frames: None,
    };
    for template in ["<html></html>".to_owned(), MARKER.repeat(2)] {
        assert!(matches!(
            compose(&template, &parts, Compression::fast()),
            Err(PageError::Marker(_))
        ));
    }
    assert!(matches!(
        page::read("<html></html>"),
        Err(PageError::Missing(_))
    ));
    let start = html.find("m4-splats\">").unwrap() + "m4-splats\">".len();
    let with = |at: usize, text: &str| {
        let mut html = html.clone();
        html.replace_range(at..at + text.len(), text);
        html
    };
    assert!(matches!(
        page::read(&with(start + 20, "!")),
        Err(PageError::Base64 { .. })
    ));
    // half of the bytes turned around: gzip has a checksum
    assert!(matches!(
        page::read(&with(start + 40, "AAAAAAAAAAAA")),
        Err(PageError::Gzip(_))
    ));
    let mut told = manifest.clone();
    told.frames = Some(m4_viewer::FrameIndex {
        width: 4,
        height: 4,
        codec: "avc1.640015".to_owned(),
        key_every: 12,
        offsets: vec![0, 9],
    });
    let lies = Parts {
        manifest: &told,
        ..parts
    };
    let html = String::from_utf8(compose(MARKER, &lies, Compression::fast()).unwrap()).unwrap();
    assert!(matches!(page::read(&html), Err(PageError::Missing(_))));
}

#[test]
fn the_safe_radius_is_between_shares_of_the_depth() {
    let mut scene = scene(3, 0);
    let payload = encode(&scene, 4.0);
    let still = manifest_of(&scene, &payload);
    assert!(
        (still.safe.radius - 4.0 * 0.14).abs() < 1e-12,
        "the camera is static"
    );
    // the middle camera looks from z = -0.5 to z = 4: the centre lies 4 units along that
    assert!((still.centre[2] - 3.5).abs() < 0.02, "{:?}", still.centre);
    let n = scene.source.len();
    for (i, source) in scene.source.iter_mut().enumerate() {
        source.camera.c2w.translation.x += 2.4 * i as f64 / (n - 1) as f64;
    }
    assert!(
        (manifest_of(&scene, &payload).safe.radius - 1.2).abs() < 1e-9,
        "half of the path"
    );
    for source in &mut scene.source {
        source.camera.c2w.translation.x *= 100.0;
    }
    assert!(
        (manifest_of(&scene, &payload).safe.radius - 2.0).abs() < 1e-12,
        "half of the depth"
    );
}

#[test]
fn cameras_have_the_deviation_of_their_frame_where_there_is_one() {
    let mut scene = scene(3, 0);
    scene.source[1].distance_sigma = Some(0.12);
    let payload = encode(&scene, 4.0);
    let manifest = manifest_of(&scene, &payload);
    let json = serde_json::to_string(&manifest).unwrap();
    assert_eq!(json.matches("distance_sigma").count(), 1);
    assert!(json.contains(r#""distance_sigma":0.12"#), "{json}");
    let read: Manifest = serde_json::from_str(&json).unwrap();
    assert_eq!(read, manifest);
}

const FRAMES: usize = 6;

pub fn scene(n_static: usize, n_dynamic: usize) -> Scene {
    let camera = camera_looking_at(
        Intrinsics::centred(160, 120, 140.0),
        [0.3, 0.1, -0.5],
        [0.3, 0.1, 4.0],
    );
    let spec = SceneSpec {
        layout: SplatLayout {
            isotropic: false,
            sh_degree: 0,
            time_degree: 0,
        },
        n_static,
        n_dynamic,
        time_frames: FRAMES,
        ..SceneSpec::default()
    };
    let source = (0..FRAMES).map(|i| SourceFrame {
        camera,
        t: i as f64,
        exposure: Exposure::IDENTITY,
        distance_sigma: None,
    });
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
    let about = About {
        title: "a test",
        median_depth: 4.0,
        fps: 10.0,
    };
    Manifest::new(scene, payload, &about)
}
