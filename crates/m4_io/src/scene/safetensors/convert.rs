//! Converts between a [`m4_core::Scene`] and named arrays.

use super::tensor::Source;
use crate::{Fault, shortened};
use m4_core::{
    Camera, Column, Exposure, Intrinsics, Se3, SourceFrame, SplatLayout, Splats, StateTensor,
    nalgebra::{Matrix3, Vector3},
};
use std::collections::BTreeMap;

/// Named arrays of a file.
pub type Arrays = BTreeMap<String, StateTensor<'static>>;
/// Named arrays to write.
pub type Sources<'a> = BTreeMap<String, Source<'a>>;

/// The columns of splats, with their names in files.
const COLUMNS: [(Column, &str); 8] = [
    (Column::Mean, "splats.mean"),
    (Column::LogScale, "splats.log_scale"),
    (Column::Quat, "splats.quat"),
    (Column::Opacity, "splats.opacity"),
    (Column::Colour, "splats.colour"),
    (Column::TimeMean, "splats.time_mean"),
    (Column::LogTimeSd, "splats.log_time_sd"),
    (Column::Velocity, "splats.velocity"),
];

/// Shape of the array of a parameter with `rows` splats.
fn shape(layout: SplatLayout, column: Column, rows: usize) -> Vec<usize> {
    match column {
        Column::Opacity | Column::TimeMean | Column::LogTimeSd => vec![rows],
        Column::Colour => vec![rows, layout.time_degree + 1, layout.sh_terms(), 3],
        _ => vec![rows, layout.range(column).len()],
    }
}

/// True for the parameters that static splats do not have.
fn is_dynamic(column: Column) -> bool {
    matches!(column, Column::TimeMean | Column::LogTimeSd | Column::Velocity)
}

/// The arrays of splats: rows are splats, so the columns are woven together.
pub fn splats_to_arrays<'a>(splats: &'a Splats, arrays: &mut Sources<'a>) {
    let layout = splats.layout();
    for (column, name) in COLUMNS {
        let columns = &splats.columns()[layout.range(column)];
        if columns.is_empty() {
            continue;
        }
        let rows = if is_dynamic(column) { splats.n_dynamic() } else { splats.n() };
        let shape = shape(layout, column, rows);
        arrays.insert(name.to_owned(), Source::Woven { shape, columns });
    }
}

/// The splats of arrays, which are taken out one by one.
pub fn arrays_to_splats(
    arrays: &mut Arrays,
    layout: SplatLayout,
    n_static: usize,
    n_dynamic: usize,
) -> Result<Splats, Fault> {
    let mut columns = Vec::with_capacity(layout.columns());
    let total = n_static.saturating_add(n_dynamic);
    for (column, name) in COLUMNS {
        let width = layout.range(column).len();
        if width == 0 {
            continue;
        }
        let rows = if is_dynamic(column) { n_dynamic } else { total };
        let data = f32_array(arrays, name, &shape(layout, column, rows))?;
        columns.extend((0..width).map(|c| data.iter().skip(c).step_by(width).copied().collect::<Vec<f32>>()));
        arrays.remove(name);
    }
    // Every length was compared above, so this cannot fail.
    Splats::from_columns(layout, n_static, n_dynamic, columns)
        .map_err(|e| Fault::damaged(format!("its splats are {e}")))
}

/// The arrays of the training cameras.
pub fn source_to_arrays(source: &[SourceFrame], arrays: &mut Sources<'_>) {
    let n = source.len();
    let lens = |f: &SourceFrame| {
        let k = f.camera.intrinsics;
        [k.width as f64, k.height as f64, k.fx, k.fy, k.cx, k.cy]
    };
    let pose = |f: &SourceFrame| -> [f64; 12] {
        let Se3 { rotation, translation } = f.camera.c2w;
        std::array::from_fn(|i| if i % 4 == 3 { translation[i / 4] } else { rotation[(i / 4, i % 4)] })
    };
    let exposure = |f: &SourceFrame| -> [f32; 12] {
        let Exposure { matrix, offset } = f.exposure;
        std::array::from_fn(|i| if i % 4 == 3 { offset[i / 4] } else { matrix[i / 4][i % 4] })
    };
    let f64s = |shape: Vec<usize>, data: Vec<f64>| {
        let data = data.into();
        Source::Array(StateTensor::F64 { shape, data })
    };
    arrays.insert("source.intrinsics".into(), f64s(vec![n, 6], source.iter().flat_map(lens).collect()));
    arrays.insert("source.c2w".into(), f64s(vec![n, 3, 4], source.iter().flat_map(pose).collect()));
    arrays.insert("source.t".into(), f64s(vec![n], source.iter().map(|f| f.t).collect()));
    let data = source.iter().flat_map(exposure).collect();
    arrays.insert("source.exposure".into(), Source::Array(StateTensor::F32 { shape: vec![n, 3, 4], data }));
}

/// The training cameras of arrays.
pub fn arrays_to_source(arrays: &Arrays) -> Result<Vec<SourceFrame>, Fault> {
    let n = arrays.get("source.t").map_or(0, StateTensor::len);
    let t = f64_array(arrays, "source.t", &[n])?;
    let lens = f64_array(arrays, "source.intrinsics", &[n, 6])?.as_chunks::<6>().0;
    let pose = f64_array(arrays, "source.c2w", &[n, 3, 4])?.as_chunks::<12>().0;
    let exposure = f32_array(arrays, "source.exposure", &[n, 3, 4])?.as_chunks::<12>().0;
    let frame = |i: usize| {
        let [width, height, fx, fy, cx, cy] = lens[i];
        let (p, e) = (&pose[i], &exposure[i]);
        SourceFrame {
            camera: Camera {
                intrinsics: Intrinsics {
                    // A cast from float saturates.
                    width: width as usize,
                    height: height as usize,
                    fx,
                    fy,
                    cx,
                    cy,
                },
                c2w: Se3 {
                    rotation: Matrix3::from_fn(|r, c| p[4 * r + c]),
                    translation: Vector3::from_fn(|r, _| p[4 * r + 3]),
                },
            },
            t: t[i],
            exposure: Exposure {
                matrix: std::array::from_fn(|r| std::array::from_fn(|c| e[4 * r + c])),
                offset: std::array::from_fn(|r| e[4 * r + 3]),
            },
        }
    };
    Ok((0..n).map(frame).collect())
}

fn other(name: &str, found: &StateTensor<'_>, kind: &str, shape: &[usize]) -> Fault {
    let found = Source::Array(found.view()).describe();
    let name = shortened(format!("{name:?}"));
    Fault::damaged(format!("array {name} is {found} where {kind} {shape:?} was expected"))
}

fn missing(name: &str) -> Fault {
    Fault::damaged(format!("it has no array {}", shortened(format!("{name:?}"))))
}

/// The values of an array that must have a type and shape.
pub fn f32_array<'a>(arrays: &'a Arrays, name: &str, shape: &[usize]) -> Result<&'a [f32], Fault> {
    match arrays.get(name) {
        Some(StateTensor::F32 { shape: found, data }) if found == shape => Ok(data),
        Some(found) => Err(other(name, found, "f32", shape)),
        None => Err(missing(name)),
    }
}

fn f64_array<'a>(arrays: &'a Arrays, name: &str, shape: &[usize]) -> Result<&'a [f64], Fault> {
    match arrays.get(name) {
        Some(StateTensor::F64 { shape: found, data }) if found == shape => Ok(data),
        Some(found) => Err(other(name, found, "f64", shape)),
        None => Err(missing(name)),
    }
}
