//! A rotating disc: its splats become segments of arcs, which are better between the frames.
#![expect(clippy::unwrap_used, reason = "helpers of tests fail as tests do")]

use m4_core::{Camera, Capture, CaptureFrame, CompactMask, Intrinsics, Plane, Se3, Silent, Splats};
use m4_kernels::{Renderer, SimdLevel, View};
use m4_train::init::{InitConfig, initialise};
use m4_train::{TrainConfig, Trainer};

const SIZE: (usize, usize) = (96, 72);
const DISC: f64 = 2.0;
const WALL: f64 = 4.0;
const RADIUS: f64 = 0.55;
/// Radians per frame; every second frame is trained on.
const TURN: f64 = 0.2;
/// Frames, those between the trained ones included.
const FRAMES: usize = 15;

fn camera() -> Camera {
    Camera { intrinsics: Intrinsics::centred(SIZE.0, SIZE.1, 100.0), c2w: Se3::identity() }
}

/// True where a pixel sees the disc.
fn on_disc(x: usize, y: usize) -> bool {
    let p = camera().unproject(x as f64, y as f64, DISC);
    p.x.hypot(p.y) < RADIUS
}

/// The image at time `t`: a pattern of three periods around the centre, in front of a wall.
fn image(t: f64) -> Plane<[u8; 3]> {
    Plane::from_fn(SIZE.0, SIZE.1, |x, y| {
        if !on_disc(x, y) {
            let p = camera().unproject(x as f64, y as f64, WALL);
            return [(110.0 + 60.0 * (5.0 * p.x).sin() * (4.0 * p.y).cos()) as u8; 3];
        }
        let p = camera().unproject(x as f64, y as f64, DISC);
        let angle = p.y.atan2(p.x) - TURN * t;
        let tone = |shift: f64| (127.5 + 110.0 * (3.0 * angle + shift).sin()) as u8;
        [tone(0.0), tone(2.0), (127.5 + 110.0 * (angle + 20.0 * p.x.hypot(p.y)).sin()) as u8]
    })
}

fn capture() -> Capture {
    let frame = |i: usize| CaptureFrame {
        name: format!("{i:03}"),
        camera: camera(),
        t: i as f64,
        rgb: image(i as f64),
        depth: Some(Plane::from_fn(SIZE.0, SIZE.1, |x, y| if on_disc(x, y) { DISC } else { WALL } as f32).into()),
        mask: Some(CompactMask::from_fn(SIZE.0, SIZE.1, on_disc)),
        motion: None,
        instances: None,
        camera_index: None,
    };
    Capture {
        frames: (0..FRAMES).step_by(2).map(frame).collect(),
        time_frames: FRAMES,
        duration_s: None,
        metric: true,
        tracks: None,
    }
}

fn config(arcs: bool) -> TrainConfig {
    TrainConfig { iterations: 240, arcs, ..TrainConfig::fast() }
}

fn start(capture: &Capture, config: TrainConfig) -> Trainer<'_> {
    let init = InitConfig {
        max_static: 3000,
        max_dynamic: 40_000,
        change_threshold: 0.0,
        shell_splats: 0,
        ..InitConfig::fast()
    };
    let splats = initialise(capture, &init, &Silent).unwrap();
    Trainer::new(capture, splats, config, SimdLevel::best()).unwrap()
}

/// PSNR of the disc at time `t`, dB.
fn psnr(splats: &Splats, t: f64) -> f64 {
    let view = View {
        camera: camera(),
        t,
        background: [0.0; 3],
        near: 0.1,
        mip: true,
        period: (FRAMES - 1) as f32,
        with_depth: false,
    };
    let mut renderer = Renderer::new(SimdLevel::best());
    let (frame, truth) = (renderer.render(splats, &view), image(t));
    let (mut square, mut count) = (0.0, 0);
    for y in 0..SIZE.1 {
        for x in (0..SIZE.0).filter(|&x| on_disc(x, y)) {
            for c in 0..3 {
                let off = f64::from(frame.rgb[c][y * SIZE.0 + x]).clamp(0.0, 1.0) - f64::from(truth[(x, y)][c]) / 255.0;
                square += off * off;
                count += 1;
            }
        }
    }
    -10.0 * (square / f64::from(count)).log10()
}

#[test]
fn arcs_are_better_between_the_frames_and_no_worse_at_them() {
    let capture = capture();
    let scores = [false, true].map(|arcs| {
        let mut trainer = start(&capture, config(arcs));
        let before = trainer.splats().n();
        trainer.run(&Silent, &mut |_| {}).unwrap();
        let splats = trainer.splats();
        let mean = |times: [usize; 4]| times.map(|t| psnr(splats, t as f64)).iter().sum::<f64>() / 4.0;
        (splats.n() as f64 / before as f64, mean([3, 5, 9, 11]), mean([2, 4, 8, 10]))
    });
    let [(straight_n, straight, straight_at), (arcs_n, arcs, arcs_at)] = scores;
    assert!(straight_n < 1.1 && arcs_n > 1.3, "{scores:?}");
    assert!(arcs > straight + 0.3, "{scores:?}");
    assert!(arcs_at > straight_at - 0.1, "{scores:?}");
}

#[test]
fn a_run_resumed_before_or_after_the_split_ends_with_the_same_bits() {
    let capture = capture();
    let config = || TrainConfig { iterations: 40, ..config(true) };
    let mut whole = start(&capture, config());
    whole.run(&Silent, &mut |_| {}).unwrap();
    for at in [19, 20, 21] {
        let mut part = start(&capture, config());
        part.run_until(at, &Silent, &mut |_| {}).unwrap();
        let (splats, state) = (part.scene().splats, part.state());
        let mut rest = Trainer::resume(&capture, splats, &state, config(), SimdLevel::best()).unwrap();
        rest.run(&Silent, &mut |_| {}).unwrap();
        assert!(rest.splats() == whole.splats(), "resumed after {at} iterations");
        assert_eq!(rest.state(), whole.state());
    }
}
