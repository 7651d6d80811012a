//! Measures flow alone on the benchmark scenes: run by hand, with `--ignored`. With a network, `minute4d` has the example `refine_masks`.

use crate::dense::InverseSearch;
use crate::instances::{Coarse, FlowFollower, FollowSettings, Pictures, RefineInput, RefineSettings, refine};
use m4_scene::{CompactMask, Plane, RgbImage, Silent};
use std::path::{Path, PathBuf};

fn files(dir: &Path) -> Vec<PathBuf> {
    let mut paths: Vec<PathBuf> = std::fs::read_dir(dir).unwrap().map(|e| e.unwrap().path()).collect();
    paths.sort();
    paths
}

fn masks(dir: &Path) -> Vec<CompactMask> {
    let open = |path: &PathBuf| {
        let grey = image::open(path).unwrap().into_luma8();
        let (w, h) = (grey.width() as usize, grey.height() as usize);
        CompactMask::from(Plane::from_vec(w, h, grey.into_raw()).unwrap())
    };
    files(dir).iter().map(open).collect()
}

fn line(name: &str, truth: &[CompactMask], masks: &[CompactMask]) {
    let (mut both, mut found, mut there) = (0usize, 0usize, 0usize);
    for (truth, mask) in truth.iter().zip(masks) {
        both += mask.set_pixels().filter(|&(x, y)| truth.at(x, y)).count();
        found += mask.count();
        there += truth.count();
    }
    let share = |a: usize, b: usize| a as f64 / b.max(1) as f64;
    let (iou, precision, recall) = (
        share(both, found + there - both),
        share(both, found),
        share(both, there),
    );
    println!("{name:<40} IoU {iou:.3} precision {precision:.3} recall {recall:.3}");
}

/// The share of each 8 x 8 pixels that is set, as a map of motion has it.
fn blocks(mask: &CompactMask) -> Plane<u8> {
    let (w, h) = mask.size();
    Plane::from_fn(w / 8, h / 8, |bx, by| {
        let set = (0..64).filter(|k| mask.at(8 * bx + k % 8, 8 * by + k / 8)).count();
        (255 * set / 64) as u8
    })
}

#[test]
#[ignore = "a measurement; needs the benchmark scenes, and masks to refine in REFINE_MASKS"]
fn measure_flow_alone() {
    let var = |name: &str, default: &str| std::env::var(name).unwrap_or_else(|_| default.to_owned());
    let scene = PathBuf::from(var(
        "REFINE_SCENE",
        concat!(env!("CARGO_MANIFEST_DIR"), "/../../../shared/bench/quad-1"),
    ));
    let settings: RefineSettings = serde_json::from_str(&var("REFINE_SETTINGS", "{}")).unwrap();
    let follow: FollowSettings = serde_json::from_str(&var("REFINE_FOLLOW", "{}")).unwrap();
    let open = |path: PathBuf| -> RgbImage {
        let rgb = image::open(path).unwrap().into_rgb8();
        Plane::from_vec(
            rgb.width() as usize,
            rgb.height() as usize,
            rgb.pixels().map(|p| p.0).collect(),
        )
        .unwrap()
    };
    let pictures: Vec<RgbImage> = files(&scene.join("train")).into_iter().map(open).collect();
    let clip: Vec<&RgbImage> = pictures.iter().collect();
    let (truth, given) = (masks(&scene.join("mask")), masks(Path::new(&var("REFINE_MASKS", ""))));
    assert!(truth.len() == clip.len() && given.len() == clip.len());
    line("as given", &truth, &given);
    let maps: Vec<Plane<u8>> = given.iter().map(blocks).collect();
    let flow = InverseSearch::default();
    let follower = FlowFollower::new(&flow, None, follow);
    for (name, coarse) in [
        ("masks", Coarse::Masks(given.iter().collect())),
        ("maps of an eighth", Coarse::Motion(maps.iter().collect())),
    ] {
        let input = RefineInput {
            clip: &Pictures(&clip),
            coarse: &coarse,
            flow: Some(&flow),
        };
        let found = refine(&input, &follower, &settings, &Silent).unwrap();
        let refined: Vec<CompactMask> = found.frames.iter().map(|f| f.mask.clone()).collect();
        line(&format!("refined from {name}"), &truth, &refined);
        let r = &found.report;
        println!(
            "  {} things, {} refused, unexplained {:.4}",
            r.instances.len(),
            r.rejected.len(),
            r.unexplained_share
        );
        println!("  {:?}", r.polarity);
        for i in &r.instances {
            println!(
                "  {} frames {}-{} ({}) at {}, area {:.4}, {:?}",
                i.id, i.first_frame, i.last_frame, i.frames, i.prompted_frame, i.mean_area_share, i.ending
            );
        }
    }
}
