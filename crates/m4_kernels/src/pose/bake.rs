//! Bound splats at an instant, for tools that know static splats alone.

use super::{
    FADE, LEAST_PRESENCE,
    cpu::{Posed, drawn},
    reference::{self, Carried, Node, Splat},
};
use m4_core::{
    Column, Splats,
    nalgebra::{Vector3, Vector4},
};
use std::borrow::Cow;

/// The splats at `t`, frames: what is drawn then of bound splats, as static splats behind those
/// that there are; bound splats that are not drawn are left out. Free dynamic splats stay. Splats
/// without bindings are returned as they are.
#[must_use]
pub fn at(splats: &Splats, t: f32) -> Cow<'_, Splats> {
    if splats.bindings().is_empty() {
        return Cow::Borrowed(splats);
    }
    let mut posed = Posed::default();
    posed.pose(splats, t);
    let (layout, bound) = (splats.layout(), splats.bound());
    let rows: Vec<usize> = bound
        .clone()
        .filter(|row| posed.is_drawn(row - bound.start))
        .collect();
    let mut out = Splats::zeros(
        layout,
        bound.start + rows.len(),
        splats.n_dynamic() - bound.len(),
    );
    for (c, (to, from)) in out.columns_mut().zip(splats.columns()).enumerate() {
        if c >= layout.shared_columns() {
            to.copy_from_slice(&from[bound.len()..]);
            continue;
        }
        let offset = |column| {
            let range = layout.range(column);
            range.contains(&c).then(|| c - range.start)
        };
        let carried = if let Some(k) = offset(Column::Mean) {
            &posed.mean[k]
        } else if let Some(k) = offset(Column::Quat) {
            &posed.quat[k]
        } else if offset(Column::Opacity).is_some() {
            &posed.opacity
        } else if let Some(k) = offset(Column::Colour) {
            &posed.colour[k]
        } else {
            from
        };
        let (of_static, rest) = to.split_at_mut(bound.start);
        let (of_bound, of_free) = rest.split_at_mut(rows.len());
        of_static.copy_from_slice(&from[..bound.start]);
        of_bound
            .iter_mut()
            .zip(&rows)
            .for_each(|(to, &row)| *to = carried[row]);
        of_free.copy_from_slice(&from[bound.end..]);
    }
    Cow::Owned(out)
}

/// Where bound splat `i` (row `n_static + i`) is carried to at `t`, frames, whether or not it lives
/// then; its opacity is its own. Panics if there is no such bound splat.
#[must_use]
pub fn place(splats: &Splats, i: usize, t: f64) -> Carried<f64> {
    let binding = &splats.bindings()[i];
    let window = &splats.windows()[binding.window as usize];
    let wide = |v: [f32; 3]| Vector3::from(v.map(f64::from));
    let nodes: [Node<f64>; m4_core::BINDING_NODES] = std::array::from_fn(|k| {
        let node = usize::from(binding.nodes[k]);
        let pose = window.pose(node, t as f32);
        Node {
            anchor: wide(window.anchors()[node]),
            position: wide(pose.position),
            rotation: Vector4::from(pose.rotation.map(f64::from)),
            weight: f64::from(binding.weights[k]),
        }
    });
    let row = splats.n_static() + i;
    let get = |column, k, at: usize| f64::from(splats.column(column, k)[at]);
    let three = |column, at: usize| Vector3::from_fn(|k, _| get(column, k, at));
    let quat = match splats.layout().isotropic {
        true => Vector4::new(1.0, 0.0, 0.0, 0.0),
        false => Vector4::from_fn(|k, _| get(Column::Quat, k, row)),
    };
    let splat = Splat {
        mean: three(Column::Mean, row),
        velocity: three(Column::Velocity, i),
        quat,
        logit: get(Column::Opacity, 0, row),
        rgb: three(Column::Colour, row),
        trend: three(Column::Trend, i),
    };
    reference::carry(&nodes, &splat, t - get(Column::TimeMean, 0, i), 1.0)
}

/// How much of bound splat `i` is there at `t`, frames: 0 where it is not drawn, up to 1.
/// Panics if there is no such bound splat.
#[must_use]
pub fn presence(splats: &Splats, i: usize, t: f64) -> f64 {
    let binding = &splats.bindings()[i];
    let window = &splats.windows()[binding.window as usize];
    let [begin, end] = drawn(window).map(f64::from);
    let half = f64::from(FADE) * f64::from(window.gap());
    let share = reference::presence(t, binding.life.map(f64::from), half);
    if (begin..=end).contains(&t) && share >= f64::from(LEAST_PRESENCE) {
        share
    } else {
        0.0
    }
}

#[cfg(test)]
mod tests {
    use super::{at, place, presence};
    use crate::{Renderer, SimdLevel, View};
    use m4_core::{Column, SplatLayout};
    use m4_testkit::{SceneSpec, bound_scene};
    use std::borrow::Cow;

    fn scene(isotropic: bool) -> m4_core::Scene {
        let layout = SplatLayout {
            isotropic,
            sh_degree: 1,
            time_degree: 1,
        };
        bound_scene(&SceneSpec {
            layout,
            n_static: 60,
            n_dynamic: 200,
            ..SceneSpec::default()
        })
    }

    #[test]
    fn an_instant_looks_like_the_bound_splats() {
        for isotropic in [false, true] {
            let scene = scene(isotropic);
            for t in [0.0, 3.25, 4.5, 9.0f64] {
                let posed = at(&scene.splats, t as f32);
                assert!(posed.bindings().is_empty() && posed.n() < scene.splats.n());
                let view = View {
                    camera: scene.source[4].camera,
                    t,
                    background: [0.2; 3],
                    near: scene.near,
                    mip: true,
                    period: 9.0,
                    with_depth: false,
                };
                let mut renderer = Renderer::new(SimdLevel::best());
                let want = renderer.render(&scene.splats, &view).clone();
                let got = renderer.render(&posed, &view);
                for (a, b) in want.rgb.iter().flatten().zip(got.rgb.iter().flatten()) {
                    assert!((a - b).abs() < 1e-5, "{a} and {b} at {t}");
                }
            }
        }
    }

    #[test]
    fn places_are_those_that_are_drawn() {
        let scene = scene(false);
        let splats = &scene.splats;
        for t in [0.0, 3.25, 9.0f32] {
            let posed = at(splats, t);
            let mut row = splats.n_static();
            for i in 0..splats.bindings().len() {
                let share = presence(splats, i, f64::from(t));
                if share == 0.0 {
                    continue;
                }
                let want = place(splats, i, f64::from(t));
                for k in 0..3 {
                    let (mean, rgb) = (
                        posed.column(Column::Mean, k)[row],
                        posed.column(Column::Colour, k)[row],
                    );
                    assert!(
                        (f64::from(mean) - want.mean[k]).abs() < 1e-4,
                        "mean of {i}: {mean} and {}",
                        want.mean[k]
                    );
                    assert!((f64::from(rgb) - want.rgb[k]).abs() < 1e-5, "colour of {i}");
                }
                let logit = f64::from(posed.column(Column::Opacity, 0)[row]);
                assert!(if share < 1.0 {
                    logit < want.logit
                } else {
                    (logit - want.logit).abs() < 1e-5
                });
                row += 1;
            }
            assert_eq!(row, posed.n_static(), "the same splats are drawn at {t}");
        }
        let plain = m4_testkit::random_scene(&SceneSpec::default());
        assert!(matches!(at(&plain.splats, 1.0), Cow::Borrowed(_)));
    }
}
