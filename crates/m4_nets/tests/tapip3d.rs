//! TAPIP3D: its checkpoint, clips that do not fit, and what its answers depend on.
#![expect(clippy::unwrap_used, reason = "a test that cannot go on should stop")]

use m4_core::{
    Camera, DepthMap, Intrinsics, Plane, Progress, RgbImage, Se3, Silent, nalgebra::Vector3,
};
use m4_nets::{
    ClipError, LoadError, NetError, PointQuery, PosedClip, Tapip3d, Tapip3dOptions, cpu,
};
use m4_testkit::{FormulaWeights, same_on_any_threads};
use safetensors::SafeTensors;
use std::fs::File;
use std::io::Write;
use std::path::Path;
use std::sync::atomic::{AtomicUsize, Ordering};
use tempfile::TempDir;
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipWriter};

const KEYS: &str = include_str!("../../../fixtures/tapip3d/keys.txt");
const CONFIG: &str = include_str!("../../../fixtures/tapip3d/config.json");
/// The smallest that the network takes.
const SIZE: (usize, usize) = (256, 128);

fn write(folder: &Path, keys: &str, config: Option<&str>) -> std::path::PathBuf {
    let path = folder.join("weights.safetensors");
    // the head is small, as a trained one is
    let head = "point_updater.flow_head.weight";
    let weights = FormulaWeights::of_keys(keys).scaled(head, 0.005);
    weights.write_with(config.map(|config| ("config", config)), &path);
    path
}

fn load() -> Tapip3d {
    let folder = TempDir::new().unwrap();
    Tapip3d::load(&write(folder.path(), KEYS, Some(CONFIG)), cpu()).unwrap()
}

/// A wavy wall that a camera passes by; `hole` is what its depth is on the left, and frames from
/// `blind` on have none.
struct Wall {
    frames: usize,
    hole: f32,
    blind: usize,
}

impl Wall {
    fn of(frames: usize) -> Self {
        Self {
            frames,
            hole: 2.0,
            blind: usize::MAX,
        }
    }
}

impl PosedClip for Wall {
    fn frames(&self) -> usize {
        self.frames
    }

    fn image(&self, frame: usize) -> Result<RgbImage, ClipError> {
        Ok(Plane::from_fn(144, 64, |x, y| {
            let (x, y) = (x as f32 + 1.5 * frame as f32, y as f32);
            [0.31, 0.17, 0.07]
                .map(|f: f32| (127.0 + 90.0 * (x * f).sin() * (y * f * 0.7).cos()) as u8)
        }))
    }

    fn depth(&self, frame: usize) -> Result<DepthMap, ClipError> {
        if frame >= self.blind {
            return Ok(Plane::filled(144, 64, 0.0));
        }
        Ok(Plane::from_fn(144, 64, |x, y| match x {
            0..12 => self.hole,
            _ => 3.0 + 0.4 * (x as f32 * 0.1 + frame as f32 * 0.1).sin() + 0.01 * y as f32,
        }))
    }

    fn camera(&self, frame: usize) -> Result<Camera, ClipError> {
        Ok(Camera {
            intrinsics: Intrinsics::centred(144, 64, 120.0),
            c2w: Se3 {
                translation: Vector3::new(0.03 * frame as f64, 0.0, 0.0),
                ..Se3::identity()
            },
        })
    }
}

fn queries(frames: &[usize]) -> Vec<PointQuery> {
    let query = |(i, &frame): (usize, &usize)| PointQuery {
        frame,
        world: [0.15 * i as f64 - 0.9, 0.1 * (i % 7) as f64 - 0.3, 3.2],
    };
    frames.iter().enumerate().map(query).collect()
}

fn options() -> Tapip3dOptions {
    Tapip3dOptions {
        iterations: 1,
        support_grid: 2,
        ..Tapip3dOptions::at(SIZE)
    }
}

/// The pickle of a checkpoint as it is published, by Python and OmegaConf.
const PUBLISHED: &[u8] = include_bytes!("../../../fixtures/tapip3d/published.pkl");

/// The checkpoint of the safetensors file at `path` as PyTorch writes it.
fn write_published(path: &Path, pickle: &[u8]) -> std::path::PathBuf {
    let bytes = std::fs::read(path).unwrap();
    let tensors = SafeTensors::deserialize(&bytes).unwrap();
    let published = path.with_file_name("tapip3d_final.pth");
    let mut archive = ZipWriter::new(File::create(&published).unwrap());
    let mut entry = |name: &str, bytes: &[u8]| {
        let options = SimpleFileOptions::default().compression_method(CompressionMethod::Stored);
        let name = format!("tapip3d_final/{name}");
        archive.start_file(name, options).unwrap();
        archive.write_all(bytes).unwrap();
    };
    entry("data.pkl", pickle);
    entry("byteorder", b"little");
    for (i, line) in KEYS.lines().enumerate() {
        let name = line.split_whitespace().next().unwrap();
        entry(&format!("data/{i}"), tensors.tensor(name).unwrap().data());
    }
    entry("version", b"3\n");
    archive.finish().unwrap();
    published
}

#[test]
fn the_published_checkpoint_is_read_as_it_is() {
    let folder = TempDir::new().unwrap();
    let plain = write(folder.path(), KEYS, Some(CONFIG));
    let published = write_published(&plain, PUBLISHED);
    let tracks = |path: &Path| {
        let net = Tapip3d::load(path, cpu()).unwrap();
        assert_eq!(net.published_size(), (316, 226));
        let asked = queries(&[0, 3]);
        net.track(&Wall::of(6), &asked, &options(), &Silent)
            .unwrap()
    };
    assert_eq!(tracks(&published), tracks(&plain));
    // of other things nothing is taken for it
    let without = |from: &str, to: &str| {
        let mut pickle = PUBLISHED.to_vec();
        let at = pickle
            .windows(from.len())
            .position(|w| w == from.as_bytes());
        pickle[at.unwrap()..][..to.len()].copy_from_slice(to.as_bytes());
        let error = Tapip3d::load(&write_published(&plain, &pickle), cpu()).unwrap_err();
        assert!(matches!(error, LoadError::Unreadable { .. }), "{error}");
        error.to_string()
    };
    for (from, to, said) in [
        ("cfg", "cfh", "`cfg`"),
        ("model", "modem", "section `model`"),
        ("${train_dataset", "${train_dataser", "train_dataser"),
        (
            "${train_dataset.resolution}",
            "${model.image_size}#######",
            "refers to",
        ),
    ] {
        let error = without(from, to);
        assert!(error.contains(said), "{said:?} is not in {error}");
    }
    let cut = write_published(&plain, &PUBLISHED[..PUBLISHED.len() / 2]);
    let error = Tapip3d::load(&cut, cpu()).unwrap_err().to_string();
    assert!(error.contains("cut off"), "{error}");
}

#[test]
fn a_checkpoint_without_a_fitting_configuration_is_refused() {
    let folder = TempDir::new().unwrap();
    let error = Tapip3d::load(&write(folder.path(), KEYS, None), cpu()).unwrap_err();
    let said = "neither the published checkpoint nor safetensors";
    assert!(error.to_string().contains(said), "{error}");
    let raw = folder.path().join("tapip3d_final.pth");
    std::fs::write(&raw, b"PK\x03\x04 and so on").unwrap();
    let error = Tapip3d::load(&raw, cpu()).unwrap_err();
    assert!(error.to_string().contains(said), "{error}");
    let missing = Tapip3d::load(&folder.path().join("none"), cpu()).unwrap_err();
    assert!(matches!(missing, LoadError::Missing { .. }));
    for (from, to, said) in [
        ("\"seq_len\": 16", "\"seq_len\": 15", "seq_len"),
        ("\"seq_len\": 16", "\"seq_len\": 8", "windows of 8"),
        ("\"norm_scale\": 0.1", "\"norm_scale\": 0", "norm_scale"),
        ("\"corr_levels\": 4", "\"corr_levels\": 3", "levels"),
        (
            "\"k_neighbors\": 32",
            "\"use_features\": true",
            "use_features",
        ),
        ("\"k_neighbors\": 32", "\"k\": 32", "k_neighbors"),
        ("\"num_heads\": 8", "\"num_heads\": 7", "7 heads"),
        ("isotropic", "sideways", "sideways"),
        ("{\"name\"", "\"name\"", "JSON"),
    ] {
        assert!(CONFIG.contains(from), "{from}");
        let config = CONFIG.replace(from, to);
        let error = Tapip3d::load(&write(folder.path(), KEYS, Some(&config)), cpu()).unwrap_err();
        assert!(error.to_string().contains(said), "{to}: {error}");
    }
}

#[test]
fn the_same_bits_on_any_number_of_threads() {
    let net = load();
    let queries = queries(&[0, 3, 17, 17, 9]);
    let one = same_on_any_threads(|| {
        net.track(&Wall::of(18), &queries, &options(), &Silent)
            .unwrap()
    });
    assert_eq!((one.world.len(), one.frames), (5 * 18, 18));
    let moved = one
        .world
        .iter()
        .zip(queries.iter().flat_map(|q| [q.world; 18]));
    let far = moved.map(|(p, q)| {
        (0..3)
            .map(|i| (f64::from(p[i]) - q[i]).abs())
            .fold(0.0, f64::max)
    });
    assert!(far.fold(0.0, f64::max) > 1e-4, "nothing moved");
}

/// Groups are followed as if each were asked for alone: the setting for memory decides on nothing
/// but the groups.
#[test]
fn groups_are_tracked_independently() {
    let net = load();
    let frames: Vec<usize> = (0..65).map(|i| i % 5).collect();
    let queries = queries(&frames);
    let little = Tapip3dOptions {
        memory_bytes: 0,
        backward: false,
        ..options()
    };
    let much = Tapip3dOptions {
        memory_bytes: 1 << 40,
        ..little.clone()
    };
    let clip = Wall::of(5);
    // 65 queries are one more than go together at least: two groups, dealt out one by one
    let both = net.track(&clip, &queries, &little, &Silent).unwrap();
    let even: Vec<PointQuery> = queries.iter().copied().step_by(2).collect();
    let alone = net.track(&clip, &even, &much, &Silent).unwrap();
    for (i, track) in alone.world.chunks_exact(5).enumerate() {
        let want = &both.world[2 * i * 5..][..5];
        assert_eq!(track, want, "query {}", 2 * i);
    }
    // together they see each other
    let together = net.track(&clip, &queries, &much, &Silent).unwrap();
    assert_ne!(together, both);
}

#[test]
fn frames_before_a_query_are_tracked_in_the_backward_pass() {
    let net = load();
    let queries = queries(&[6]);
    let only_forward = Tapip3dOptions {
        backward: false,
        ..options()
    };
    let clip = Wall::of(10);
    let forward = net.track(&clip, &queries, &only_forward, &Silent).unwrap();
    let both = net.track(&clip, &queries, &options(), &Silent).unwrap();
    assert_eq!(forward.world[6..], both.world[6..]);
    for frame in 0..6 {
        assert_eq!(forward.world[frame], queries[0].world.map(|x| x as f32));
        assert_eq!(forward.visibility[frame], 0.0);
        assert_ne!(both.world[frame], forward.world[frame]);
        assert!(both.visibility[frame] > 0.0);
    }
}

#[test]
fn clips_that_do_not_fit() {
    let net = load();
    let some = queries(&[0, 0]);
    let track = |clip: &Wall, queries: &[PointQuery], options: &Tapip3dOptions| {
        net.track(clip, queries, options, &Silent)
    };
    let nowhere = [PointQuery {
        frame: 0,
        world: [0.0, f64::NAN, 1.0],
    }];
    let of_size = |size| Tapip3dOptions::at(size);
    for (clip, queries, options, message) in [
        (Wall::of(0), &some[..], options(), "a clip without frames"),
        (
            Wall::of(3),
            &queries(&[0, 3])[..],
            options(),
            "point 1 cannot be tracked",
        ),
        (
            Wall::of(3),
            &nowhere[..],
            options(),
            "point 0 cannot be tracked",
        ),
        (
            Wall::of(3),
            &some[..],
            of_size((0, 0)),
            "choose a larger size",
        ),
        (
            Wall::of(3),
            &some[..],
            of_size((128, 128)),
            "choose a larger size",
        ),
        (
            Wall::of(3),
            &some[..],
            of_size((1 << 20, 1 << 20)),
            "choose a larger size",
        ),
        (
            Wall {
                blind: 0,
                ..Wall::of(3)
            },
            &some[..],
            options(),
            "no depth is known in frames 0 to 2",
        ),
        (
            Wall {
                blind: 8,
                ..Wall::of(24)
            },
            &some[..],
            options(),
            "no depth is known in frames 8 to 23",
        ),
    ] {
        let error = track(&clip, queries, &options).unwrap_err();
        assert!(error.to_string().contains(message), "{error}");
    }
    // none asked for
    let none = track(&Wall::of(3), &[], &options()).unwrap();
    assert_eq!((none.world.len(), none.frames), (0, 3));
}

/// One frame, and depth that is no number, are followed.
#[test]
fn unusual_clips_are_tracked_or_rejected() {
    let net = load();
    for (frames, hole) in [
        (1, 2.0),
        (2, f32::NAN),
        (2, f32::NEG_INFINITY),
        (2, f32::INFINITY),
        (2, -1.0),
        (2, 1e30),
    ] {
        let clip = Wall {
            hole,
            ..Wall::of(frames)
        };
        let tracks = net
            .track(&clip, &queries(&[0, frames - 1]), &options(), &Silent)
            .unwrap();
        assert_eq!(tracks.world.len(), 2 * frames);
        let numbers = tracks.world.as_flattened().iter().chain(&tracks.visibility);
        assert!(numbers.into_iter().all(|x| x.is_finite()), "{hole}");
    }
}

#[test]
fn tracking_stops_on_request() {
    /// Stops after some reports.
    struct Impatient {
        reports: AtomicUsize,
        most: usize,
    }
    impl Progress for Impatient {
        fn update(&self, phase: &str, done: usize, total: usize, _note: &str) {
            assert!(done <= total && !phase.is_empty());
            self.reports.fetch_add(1, Ordering::Relaxed);
        }
        fn warn(&self, _message: &str) {}
        fn cancelled(&self) -> bool {
            self.reports.load(Ordering::Relaxed) >= self.most
        }
    }
    let net = load();
    let run = |most: usize| {
        let impatient = Impatient {
            reports: AtomicUsize::new(0),
            most,
        };
        let result = net.track(&Wall::of(17), &queries(&[0]), &options(), &impatient);
        (result, impatient.reports.into_inner())
    };
    // at once, while depth is read, before the first window, between two
    for most in [0, 5, 17, 18] {
        let (result, reports) = run(most);
        assert!(
            matches!(result, Err(NetError::Cancelled)),
            "{most}: {result:?}"
        );
        assert_eq!(reports, most);
    }
    // 17 frames' depth and two windows
    let (result, reports) = run(1000);
    assert!(result.is_ok());
    assert_eq!(reports, 19);
}
