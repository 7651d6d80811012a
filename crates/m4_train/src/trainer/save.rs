//! The results of a run: the scene, and the state needed to resume.

use super::Trainer;
use crate::state::{write_adam, write_refinement};
use m4_core::{Scene, SourceFrame, Splats, StateTensor, TrainState};

impl Trainer<'_> {
    /// What a renderer needs, as a copy.
    pub fn scene(&self) -> Scene {
        self.scene_of(self.splats.clone())
    }

    /// What a renderer needs; everything else is dropped.
    #[must_use]
    pub fn into_scene(mut self) -> Scene {
        let splats = self.take_splats();
        self.scene_of(splats)
    }

    /// Shows the scene and what [`resume`](Self::resume) needs beside it to `show`, without a copy
    /// of either.
    pub fn save<R>(&mut self, show: impl FnOnce(&Scene, &TrainState<'_>) -> R) -> R {
        let splats = self.take_splats();
        let scene = self.scene_of(splats);
        let out = show(&scene, &self.state());
        self.splats = scene.splats;
        out
    }

    fn take_splats(&mut self) -> Splats {
        let nothing = Splats::zeros(self.splats.layout(), 0, 0);
        std::mem::replace(&mut self.splats, nothing)
    }

    fn scene_of(&self, splats: Splats) -> Scene {
        let source = self.times.iter().enumerate().map(|(i, &t)| SourceFrame {
            camera: self.fit.camera(i),
            t,
            exposure: self.fit.frames[i].exposure,
            distance_sigma: self.distance_sigmas[i],
        });
        Scene {
            splats,
            background: self.background,
            time_frames: self.time_frames,
            duration_s: self.duration_s,
            mip: self.config.mip,
            near: self.near(),
            source: source.collect(),
        }
    }

    /// What [`resume`](Self::resume) needs beside the scene; large arrays are borrowed.
    pub fn state(&self) -> TrainState<'_> {
        let mut state = TrainState::new();
        let mut put = |name: &str, tensor| state.insert(name.to_owned(), tensor);
        put(
            "train/iteration",
            StateTensor::u32(vec![self.iteration as u32]),
        );
        put(
            "train/iterations",
            StateTensor::u32(vec![self.config.iterations as u32]),
        );
        put(
            "train/first_splats",
            StateTensor::u32(vec![self.first_splats as u32]),
        );
        put("train/time_sd", StateTensor::f32(vec![self.basis.time_sd]));
        put(
            "train/background",
            StateTensor::f32(self.background.to_vec()),
        );
        write_adam(&mut state, &self.adam);
        write_refinement(&mut state, &self.fit);
        state
    }
}
