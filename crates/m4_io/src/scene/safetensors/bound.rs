//! Windows, bindings and trends as arrays, and back.

use super::tensor::{Arrays, Source, Sources, f32_array, u16_array, u32_array};
use crate::Fault;
use crate::range::bound::{LEAST_GAP, UNIT_WITHIN, off_unit, rises};
use m4_core::{BINDING_NODES, Binding, Column, Pose, Splats, StateTensor, Window};
use std::sync::Arc;

/// Lengths of rotations that are this close to 1 are those of 32 bits: their bits stay.
const EXACT_WITHIN: f32 = 1e-5;

fn f32s(shape: Vec<usize>, data: Vec<f32>) -> Source<'static> {
    Source::Array(StateTensor::F32 {
        shape,
        data: data.into(),
    })
}

fn u32s(shape: Vec<usize>, data: Vec<u32>) -> Source<'static> {
    Source::Array(StateTensor::U32 {
        shape,
        data: data.into(),
    })
}

/// True where there is anything that a file without bindings does not hold.
pub fn is_bound(splats: &Splats) -> bool {
    !splats.windows().is_empty() || !splats.bindings().is_empty()
}

/// The arrays of windows and of bound splats; none for splats without.
pub fn bound_to_arrays(splats: &Splats, arrays: &mut Sources<'_>) {
    if !is_bound(splats) {
        return;
    }
    let (windows, bindings) = (splats.windows(), splats.bindings());
    let poses = || {
        windows
            .iter()
            .flat_map(|w| (0..w.keys().len()).flat_map(|key| w.poses(key)))
    };
    let counts = |w: &Window| [w.keys().len() as u32, w.anchors().len() as u32];
    let (n, nodes) = (
        bindings.len(),
        windows.iter().map(|w| w.anchors().len()).sum(),
    );
    let (keys, all) = (
        windows.iter().map(|w| w.keys().len()).sum(),
        poses().count(),
    );
    let rows = splats.bindings().len();
    let trend = |i: usize| [0, 1, 2].map(|k| splats.column(Column::Trend, k)[i]);
    let nodes_of = bindings
        .iter()
        .flat_map(|b| b.nodes)
        .collect::<Vec<u16>>()
        .into();
    let mut put = |name: &str, array| arrays.insert(name.to_owned(), array);
    put(
        "windows.counts",
        u32s(
            vec![windows.len(), 2],
            windows.iter().flat_map(counts).collect(),
        ),
    );
    put(
        "windows.key",
        f32s(
            vec![keys],
            windows.iter().flat_map(|w| w.keys()).copied().collect(),
        ),
    );
    put(
        "windows.anchor",
        f32s(
            vec![nodes, 3],
            windows
                .iter()
                .flat_map(|w| w.anchors())
                .flatten()
                .copied()
                .collect(),
        ),
    );
    put(
        "windows.position",
        f32s(vec![all, 3], poses().flat_map(|p| p.position).collect()),
    );
    put(
        "windows.rotation",
        f32s(vec![all, 4], poses().flat_map(|p| p.rotation).collect()),
    );
    put(
        "bound.window",
        u32s(vec![n], bindings.iter().map(|b| b.window).collect()),
    );
    put(
        "bound.node",
        Source::Array(StateTensor::U16 {
            shape: vec![n, BINDING_NODES],
            data: nodes_of,
        }),
    );
    put(
        "bound.weight",
        f32s(
            vec![n, BINDING_NODES],
            bindings.iter().flat_map(|b| b.weights).collect(),
        ),
    );
    put(
        "bound.life",
        f32s(vec![n, 2], bindings.iter().flat_map(|b| b.life).collect()),
    );
    put(
        "bound.trend",
        f32s(vec![n, 3], (0..rows).flat_map(trend).collect()),
    );
}

/// Binds the first `n` dynamic splats as the arrays say, which are taken out.
pub fn arrays_to_bound(arrays: &mut Arrays, splats: &mut Splats, n: usize) -> Result<(), Fault> {
    if n > splats.n_dynamic() {
        let dynamic = splats.n_dynamic();
        return Err(Fault::damaged(format!(
            "{n} of its splats are bound, and {dynamic} are dynamic"
        )));
    }
    let windows = windows(arrays)?;
    let window = u32_array(arrays, "bound.window", &[n])?;
    let nodes = u16_array(arrays, "bound.node", &[n, BINDING_NODES])?
        .as_chunks::<BINDING_NODES>()
        .0;
    let weights = f32_array(arrays, "bound.weight", &[n, BINDING_NODES])?
        .as_chunks::<BINDING_NODES>()
        .0;
    let lives = f32_array(arrays, "bound.life", &[n, 2])?.as_chunks::<2>().0;
    let trends = f32_array(arrays, "bound.trend", &[n, 3])?
        .as_chunks::<3>()
        .0;
    let mut bindings = Vec::with_capacity(n);
    for (i, (((&window, &nodes), &weights), &life)) in
        window.iter().zip(nodes).zip(weights).zip(lives).enumerate()
    {
        let Some(carrier) = windows.get(window as usize) else {
            let count = windows.len();
            return Err(Fault::damaged(format!(
                "bound splat {i} is in window {window}, and there are {count}"
            )));
        };
        let count = carrier.anchors().len();
        if let Some(node) = nodes.iter().find(|&&node| usize::from(node) >= count) {
            let what = format!("bound splat {i} has node {node}, and window {window} has {count}");
            return Err(Fault::damaged(what));
        }
        bindings.push(Binding {
            window,
            nodes,
            weights,
            life,
        });
    }
    for k in 0..3 {
        for (to, trend) in splats.column_mut(Column::Trend, k).iter_mut().zip(trends) {
            *to = trend[k];
        }
    }
    // Windows and nodes were compared above, so this cannot fail.
    splats
        .bind(Arc::new(windows), bindings)
        .map_err(|e| Fault::damaged(format!("its bindings are {e}")))?;
    arrays.retain(|name, _| !name.starts_with("windows.") && !name.starts_with("bound."));
    Ok(())
}

fn windows(arrays: &Arrays) -> Result<Vec<Window>, Fault> {
    let count = arrays.get("windows.counts").map_or(0, StateTensor::len) / 2;
    let counts = u32_array(arrays, "windows.counts", &[count, 2])?
        .as_chunks::<2>()
        .0;
    let sum = |of: fn(&[u32; 2]) -> u64| {
        let all = counts
            .iter()
            .try_fold(0u64, |sum, one| sum.checked_add(of(one)));
        all.and_then(|n| usize::try_from(n).ok())
            .unwrap_or(usize::MAX)
    };
    let poses = sum(|&[keys, nodes]| u64::from(keys) * u64::from(nodes));
    let mut keys = f32_array(arrays, "windows.key", &[sum(|n| n[0].into())])?;
    let mut anchors = f32_array(arrays, "windows.anchor", &[sum(|n| n[1].into()), 3])?
        .as_chunks::<3>()
        .0;
    let mut positions = f32_array(arrays, "windows.position", &[poses, 3])?
        .as_chunks::<3>()
        .0;
    let mut rotations = f32_array(arrays, "windows.rotation", &[poses, 4])?
        .as_chunks::<4>()
        .0;
    let mut out = Vec::with_capacity(count);
    for (i, &[n_keys, n_nodes]) in counts.iter().enumerate() {
        let (n_keys, n_nodes) = (n_keys as usize, n_nodes as usize);
        if n_keys == 0 || n_nodes == 0 {
            let what = format!(
                "window {i} has {n_keys} keys and {n_nodes} nodes; at least one of each was expected"
            );
            return Err(Fault::damaged(what));
        }
        // Sums of the lengths were compared above, so no part is missing.
        let key = keys.split_off(..n_keys).unwrap_or_default();
        let anchor = anchors.split_off(..n_nodes).unwrap_or_default();
        let position = positions.split_off(..n_keys * n_nodes).unwrap_or_default();
        let rotation = rotations.split_off(..n_keys * n_nodes).unwrap_or_default();
        if let Some(at) = key.windows(2).position(|k| !rises(k)) {
            let what = format!(
                "keys {at} and {} of window {i} are {} and {}",
                at + 1,
                key[at],
                key[at + 1]
            );
            return Err(Fault::damaged(format!(
                "{what}; keys that rise by at least {LEAST_GAP} frames were expected"
            )));
        }
        let mut all = Vec::with_capacity(position.len());
        for (&position, &rotation) in position.iter().zip(rotation) {
            all.push(Pose {
                position,
                rotation: unit(rotation),
            });
        }
        let window = Window::new(key.to_vec(), anchor.to_vec(), all);
        out.push(window.map_err(|e| Fault::damaged(format!("window {i}: {e}")))?);
    }
    Ok(out)
}

/// The rotation with length 1, where it is about that; others are left for the check of the scene.
fn unit(rotation: [f32; 4]) -> [f32; 4] {
    let off = off_unit(&rotation);
    if off > EXACT_WITHIN && off <= UNIT_WITHIN {
        let length = rotation.iter().map(|v| v * v).sum::<f32>().sqrt();
        return rotation.map(|v| v / length);
    }
    rotation
}
