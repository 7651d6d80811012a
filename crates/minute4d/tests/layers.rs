//! How solid the dynamic layer of a trained run is, and how well the run re-renders its own frames.

use crate::dynamic;
use m4_core::{Scene, Silent};
use m4_io::capture::{self, CaptureOptions, Split};
use m4_io::scene::safetensors;
use m4_kernels::SimdLevel;
use minute4d::render::Painter;
use std::path::PathBuf;

/// Pixels this close to the edge of a mask are shared by object and background.
const EDGE_PX: usize = 2;

/// Mean over the frames that have something dynamic.
#[derive(Debug, Default)]
struct Mean {
    sum: f64,
    count: f64,
}

impl Mean {
    fn add(&mut self, value: f64) {
        self.sum += value;
        self.count += 1.0;
    }

    fn get(&self) -> f64 {
        self.sum / self.count
    }
}

/// `MINUTE4D_RUN=out cargo test --release -p minute4d --test it layers:: -- --ignored --nocapture`: figures of the run in the folder `out`
/// (several: separated by colons) at its own frames and with its own masks.
#[test]
#[ignore = "measures a run that a person names"]
fn own_frames_of_a_run() {
    let runs = std::env::var("MINUTE4D_RUN").expect("MINUTE4D_RUN names the folder of a run");
    for run in runs.split(':').map(PathBuf::from) {
        let scene = safetensors::read(&run.join("scene.safetensors")).unwrap().scene;
        let capture = capture::read(&run.join("capture"), Split::Train, &CaptureOptions::default(), &Silent).unwrap();
        let dynamic = Scene { splats: dynamic(&scene.splats), ..scene.clone() };
        let level = SimdLevel::best();
        let (mut all, mut alone) = (Painter::new(&scene, level), Painter::new(&dynamic, level));
        let (mut whole, mut inside, mut opacity, mut interior) =
            (Mean::default(), Mean::default(), Mean::default(), Mean::default());
        for (frame, source) in capture.frames.iter().zip(&scene.source) {
            let (w, h) = frame.rgb.size();
            let image = all.image(&source.camera, source.t, &source.exposure);
            let behind = alone.frame(&source.camera, source.t, false).transmittance.clone();
            let masked: Vec<bool> =
                (0..w * h).map(|p| frame.mask.as_ref().is_some_and(|m| m.at(p % w, p / w))).collect();
            let square = |p: usize| {
                let pairs = image.data()[p].into_iter().zip(frame.rgb.data()[p]);
                pairs.map(|(a, b)| (f64::from(a) - f64::from(b)).powi(2)).sum::<f64>() / 3.0
            };
            let psnr = |of: &dyn Fn(usize) -> bool| {
                let chosen: Vec<f64> = (0..w * h).filter(|&p| of(p)).map(square).collect();
                -10.0 * (chosen.iter().sum::<f64>() / chosen.len() as f64 / 255.0f64.powi(2)).log10()
            };
            whole.add(psnr(&|_| true));
            let count = masked.iter().filter(|m| **m).count();
            if count > 0 {
                inside.add(psnr(&|p| masked[p]));
                let mean = |of: &dyn Fn(usize) -> bool| {
                    let opacities: Vec<f64> =
                        (0..w * h).filter(|&p| of(p)).map(|p| 1.0 - f64::from(behind[p])).collect();
                    opacities.iter().sum::<f64>() / opacities.len() as f64
                };
                opacity.add(mean(&|p| masked[p]));
                let outside: Vec<u8> = masked.iter().map(|m| u8::from(!m)).collect();
                let edge = m4_core::dilated(&outside, w, h, EDGE_PX);
                if edge.contains(&0) {
                    interior.add(mean(&|p| edge[p] == 0));
                }
            }
        }
        println!(
            "{}: whole {:.2} dB, inside the masks {:.2} dB, opacity of the dynamic layer there {:.4}, {EDGE_PX} pixels and more from the edge {:.4}",
            run.display(),
            whole.get(),
            inside.get(),
            opacity.get(),
            interior.get()
        );
        assert!(whole.get().is_finite());
    }
}
