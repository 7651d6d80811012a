//! Converts the trainer's state to named arrays, and back.
//!
//! Splats and cameras travel in the scene; here is what the scene does not hold. Names:
//!
//! | name | type, shape | what |
//! |---|---|---|
//! | `train/iteration` | u32 `[1]` | steps taken |
//! | `train/first_splats` | u32 `[1]` | splats that training started from |
//! | `train/time_sd` | f32 `[1]` | median of the first standard deviations in time, frames |
//! | `train/background` | f32 `[3]` | colour behind everything |
//! | `adam/m/CC`, `adam/v/CC` | f32 `[column]` | moments of column CC; those of trends are absent without windows |
//! | `adam/step` | u32 `[n]` | steps of each splat |
//! | `adam/nodes/m`, `adam/nodes/v` | f32 `[windows x keys x nodes x 6]` | moments of the nodes of windows, one window after the other; absent without windows |
//! | `adam/nodes/step` | u32 `[windows x keys]` | steps of their keys |
//! | `refine/c2w` | f64 `[frames, 12]` | rotation row by row, then translation |
//! | `refine/exposure` | f32 `[frames, 12]` | matrix row by row, then offset |
//! | `refine/pose`, `refine/colour` | f64 `[frames, 12 / 24]` | first, then second moments |
//! | `refine/steps` | u32 `[frames, 2]` | steps of pose and exposure |
//! | `refine/focal` | f64 `[3]`, `refine/focal_step` u32 `[1]` | log factor, moments, steps |

use crate::{TrainError, refine::Refinement};
use m4_core::{Column, ShapeError, Splats, StateTensor, TrainState};
use m4_kernels::adam::{cpu::AdamState, nodes::NodeMoments};

/// Columns of [`Column::Trend`], the last.
const TRENDS: usize = 3;

/// Reads tensors of the expected type and length.
pub(crate) struct Reader<'a>(pub &'a TrainState<'a>);

impl Reader<'_> {
    pub fn f32(&self, name: &str, len: usize) -> Result<&[f32], TrainError> {
        match self.0.get(name) {
            Some(StateTensor::F32 { data, .. }) if data.len() == len => Ok(data),
            other => Err(wrong(name, len, other)),
        }
    }

    pub fn u32(&self, name: &str, len: usize) -> Result<&[u32], TrainError> {
        match self.0.get(name) {
            Some(StateTensor::U32 { data, .. }) if data.len() == len => Ok(data),
            other => Err(wrong(name, len, other)),
        }
    }

    pub fn f64(&self, name: &str, len: usize) -> Result<&[f64], TrainError> {
        match self.0.get(name) {
            Some(StateTensor::F64 { data, .. }) if data.len() == len => Ok(data),
            other => Err(wrong(name, len, other)),
        }
    }
}

fn wrong(name: &str, expected: usize, actual: Option<&StateTensor<'_>>) -> TrainError {
    match actual {
        Some(tensor) if tensor.len() != expected => TrainError::Shape(ShapeError {
            what: "tensor of the training state",
            expected,
            found: tensor.len(),
        }),
        _ => TrainError::BadState {
            name: name.to_owned(),
        },
    }
}

pub(crate) fn write_adam<'a>(state: &mut TrainState<'a>, adam: &'a AdamState) {
    for (kind, columns) in [("m", adam.m.columns()), ("v", adam.v.columns())] {
        let n_columns = if adam.nodes.is_empty() {
            columns.len() - TRENDS
        } else {
            columns.len()
        };
        for (c, column) in columns.iter().enumerate().take(n_columns) {
            state.insert(format!("adam/{kind}/{c:02}"), StateTensor::f32(column));
        }
    }
    state.insert("adam/step".to_owned(), StateTensor::u32(&adam.step));
    if !adam.nodes.is_empty() {
        let joined = |of: fn(&NodeMoments) -> &Vec<f32>| {
            adam.nodes
                .iter()
                .flat_map(of)
                .copied()
                .collect::<Vec<f32>>()
        };
        state.insert(
            "adam/nodes/m".to_owned(),
            StateTensor::f32(joined(|nodes| &nodes.m)),
        );
        state.insert(
            "adam/nodes/v".to_owned(),
            StateTensor::f32(joined(|nodes| &nodes.v)),
        );
        let steps: Vec<u32> = adam
            .nodes
            .iter()
            .flat_map(|nodes| &nodes.step)
            .copied()
            .collect();
        state.insert("adam/nodes/step".to_owned(), StateTensor::u32(steps));
    }
}

pub(crate) fn read_adam(reader: &Reader<'_>, splats: &Splats) -> Result<AdamState, TrainError> {
    let moments = |kind: &str| -> Result<Splats, TrainError> {
        let columns: Result<Vec<Vec<f32>>, TrainError> = splats
            .columns()
            .iter()
            .enumerate()
            .map(|(c, column)| {
                match splats.windows().is_empty() && c >= splats.layout().column(Column::Trend) {
                    true => Ok(vec![0.0; column.len()]),
                    false => Ok(reader
                        .f32(&format!("adam/{kind}/{c:02}"), column.len())?
                        .to_vec()),
                }
            })
            .collect();
        Ok(Splats::from_columns(
            splats.layout(),
            splats.n_static(),
            splats.n_dynamic(),
            columns?,
        )?)
    };
    let (m, v, step) = (
        moments("m")?,
        moments("v")?,
        reader.u32("adam/step", splats.n())?.to_vec(),
    );
    Ok(AdamState {
        m,
        v,
        step,
        nodes: read_nodes(reader, splats)?,
    })
}

fn read_nodes(reader: &Reader<'_>, splats: &Splats) -> Result<Vec<NodeMoments>, TrainError> {
    let mut out: Vec<NodeMoments> = splats.windows().iter().map(NodeMoments::new).collect();
    if out.is_empty() {
        return Ok(out);
    }
    let len = out.iter().map(|nodes| nodes.m.len()).sum();
    let mut m = reader.f32("adam/nodes/m", len)?;
    let mut v = reader.f32("adam/nodes/v", len)?;
    let mut step = reader.u32(
        "adam/nodes/step",
        out.iter().map(|nodes| nodes.step.len()).sum(),
    )?;
    for nodes in &mut out {
        let (moments, keys) = (nodes.m.len(), nodes.step.len());
        nodes
            .m
            .copy_from_slice(m.split_off(..moments).unwrap_or_default());
        nodes
            .v
            .copy_from_slice(v.split_off(..moments).unwrap_or_default());
        nodes
            .step
            .copy_from_slice(step.split_off(..keys).unwrap_or_default());
    }
    Ok(out)
}

pub(crate) fn write_refinement(state: &mut TrainState<'_>, fit: &Refinement) {
    let n = fit.frames.len();
    let (mut c2w, mut pose, mut colour) = (Vec::new(), Vec::new(), Vec::new());
    let (mut exposure, mut steps) = (Vec::new(), Vec::new());
    for f in &fit.frames {
        c2w.extend(f.camera.c2w.rotation.transpose().iter());
        c2w.extend(f.camera.c2w.translation.iter());
        exposure.extend(f.exposure.matrix.as_flattened());
        exposure.extend(f.exposure.offset);
        pose.extend(f.pose.m.iter().chain(&f.pose.v));
        colour.extend(f.colour.m.iter().chain(&f.colour.v));
        steps.extend([f.pose.step, f.colour.step]);
    }
    let f64s = |data: Vec<f64>, width| StateTensor::F64 {
        shape: vec![n, width],
        data: data.into(),
    };
    let (shape, data) = (vec![n, 12], exposure.into());
    state.insert(
        "refine/exposure".to_owned(),
        StateTensor::F32 { shape, data },
    );
    let (shape, data) = (vec![n, 2], steps.into());
    state.insert("refine/steps".to_owned(), StateTensor::U32 { shape, data });
    state.insert("refine/c2w".to_owned(), f64s(c2w, 12));
    state.insert("refine/pose".to_owned(), f64s(pose, 12));
    state.insert("refine/colour".to_owned(), f64s(colour, 24));
    let focal = vec![fit.log_focal, fit.focal.m[0], fit.focal.v[0]];
    state.insert("refine/focal".to_owned(), StateTensor::f64(focal));
    state.insert(
        "refine/focal_step".to_owned(),
        StateTensor::u32(vec![fit.focal.step]),
    );
}

/// Fills a fresh refinement.
pub(crate) fn read_refinement(reader: &Reader<'_>, fit: &mut Refinement) -> Result<(), TrainError> {
    let n = fit.frames.len();
    let c2w = reader.f64("refine/c2w", 12 * n)?;
    let exposure = reader.f32("refine/exposure", 12 * n)?;
    let pose = reader.f64("refine/pose", 12 * n)?;
    let colour = reader.f64("refine/colour", 24 * n)?;
    let steps = reader.u32("refine/steps", 2 * n)?;
    for (i, f) in fit.frames.iter_mut().enumerate() {
        let at = &c2w[12 * i..12 * i + 12];
        f.camera.c2w.rotation.copy_from_slice(&at[..9]);
        f.camera.c2w.rotation.transpose_mut();
        f.camera.c2w.translation.copy_from_slice(&at[9..]);
        let at = &exposure[12 * i..12 * i + 12];
        f.exposure
            .matrix
            .as_flattened_mut()
            .copy_from_slice(&at[..9]);
        f.exposure.offset.copy_from_slice(&at[9..]);
        f.pose.m.copy_from_slice(&pose[12 * i..12 * i + 6]);
        f.pose.v.copy_from_slice(&pose[12 * i + 6..12 * i + 12]);
        f.colour.m.copy_from_slice(&colour[24 * i..24 * i + 12]);
        f.colour
            .v
            .copy_from_slice(&colour[24 * i + 12..24 * i + 24]);
        (f.pose.step, f.colour.step) = (steps[2 * i], steps[2 * i + 1]);
    }
    let focal = reader.f64("refine/focal", 3)?;
    (fit.log_focal, fit.focal.m[0], fit.focal.v[0]) = (focal[0], focal[1], focal[2]);
    fit.focal.step = reader.u32("refine/focal_step", 1)?[0];
    Ok(())
}
