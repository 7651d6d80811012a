//! How solid the dynamic layer of a trained run is, and how well the run re-renders its own frames.

use crate::lifetimes::dynamic;
use m4_core::{Scene, Silent};
use m4_io::capture::{self, CaptureOptions, Split};
use m4_io::scene::safetensors;
use m4_kernels::SimdLevel;
use minute4d::render::Painter;
use std::path::PathBuf;

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
        let dynamic = Scene {
            splats: dynamic(&scene.splats),
            ..scene.clone()
        };
        let level = SimdLevel::best();
        let (mut all, mut alone) = (Painter::new(&scene, level), Painter::new(&dynamic, level));
        let (mut whole, mut inside, mut opacity, mut solid) =
            (Mean::default(), Mean::default(), Mean::default(), Mean::default());
        for (frame, source) in capture.frames.iter().zip(&scene.source) {
            let (w, h) = frame.rgb.size();
            let image = all.image(&source.camera, source.t, &source.exposure);
            let behind = alone.frame(&source.camera, source.t, false).transmittance.clone();
            let masked: Vec<bool> = (0..w * h)
                .map(|p| frame.mask.as_ref().is_some_and(|m| m.at(p % w, p / w)))
                .collect();
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
                let opacities = (0..w * h).filter(|&p| masked[p]).map(|p| 1.0 - f64::from(behind[p]));
                let (sum, full) = opacities.fold((0.0, 0.0), |(s, n), o| (s + o, n + f64::from(u8::from(o > 0.9))));
                opacity.add(sum / count as f64);
                solid.add(full / count as f64);
            }
        }
        println!(
            "{}: whole {:.2} dB, inside the masks {:.2} dB, opacity of the dynamic layer there {:.4}, above 0.9 in {:.1} % of the pixels",
            run.display(),
            whole.get(),
            inside.get(),
            opacity.get(),
            100.0 * solid.get()
        );
        assert!(whole.get().is_finite());
    }
}
