//! Encodes bound splats and their windows.

use super::super::{Linear, Sinh, encode::VELOCITY_STEPS, push_planes};
use super::{
    FADE, LEAST_PRESENCE, LIFE_TOP, TURN_TOP, WEIGHT_SUM, presence, reach, step_code, turn_code,
};
use m4_core::{BINDING_NODES, Binding, Column, Pose, Scene, Splats, Window};

/// Step of a trend as a share of itself: of the change of a colour in a life.
const TREND_STEP: f64 = 0.05;
/// Keys of a window that a splat can be born at.
const MOST_KEYS: usize = 1 << 16;

/// The bound splats that a frame can show, and the windows that carry them.
pub(in super::super) struct Bound<'a> {
    splats: &'a Splats,
    /// Rows of the splats, in the order of the payload.
    pub rows: Vec<usize>,
    windows: Vec<&'a Window>,
    /// Splats of each window.
    counts: Vec<u32>,
}

impl<'a> Bound<'a> {
    /// Takes the rows that may be shown. `visible` says so of a row apart from its life: its second
    /// argument is the largest share of the row's optical depth from frame 0 to the last.
    pub fn new(scene: &'a Scene, visible: impl Fn(usize, f64) -> bool) -> Self {
        let splats = &scene.splats;
        let last = scene.time_frames.saturating_sub(1) as f64;
        let usable: Vec<bool> = splats.windows().iter().map(is_finite).collect();
        let peak = |binding: &Binding| match splats.windows().get(binding.window as usize) {
            Some(window) if usable[binding.window as usize] => peak(binding, window, last),
            _ => 0.0,
        };
        let bindings = splats.bindings();
        let shown = splats
            .bound()
            .zip(bindings)
            .filter(|(row, b)| peak(b) >= LEAST_PRESENCE && visible(*row, peak(b)));
        let mut rows: Vec<usize> = shown.map(|(row, _)| row).collect();
        let of = |row: &usize| &bindings[row - splats.n_static()];
        rows.sort_by_key(|row| (of(row).window, of(row).nodes));
        let (mut windows, mut counts) = (Vec::new(), Vec::new());
        for same in rows.chunk_by(|a, b| of(a).window == of(b).window) {
            windows.push(&splats.windows()[of(&same[0]).window as usize]);
            counts.push(same.len() as u32);
        }
        Self {
            splats,
            rows,
            windows,
            counts,
        }
    }

    pub fn is_empty(&self) -> bool {
        self.rows.is_empty()
    }

    fn binding(&self, row: usize) -> &'a Binding {
        &self.splats.bindings()[row - self.splats.n_static()]
    }

    /// Appends the part of the header behind that of version 1.
    pub fn push_header(&self, codes: &Codes, bytes: &mut Vec<u8>) {
        for count in [self.rows.len(), self.windows.len()] {
            bytes.extend_from_slice(&(count as u32).to_le_bytes());
        }
        let Codes {
            life,
            residual,
            trend,
        } = codes;
        for v in [
            life.low,
            life.step,
            residual.spread,
            residual.step,
            trend.spread,
            trend.step,
        ] {
            bytes.extend_from_slice(&v.to_le_bytes());
        }
        for (window, &count) in self.windows.iter().zip(&self.counts) {
            for v in [
                count,
                window.keys().len() as u32,
                window.anchors().len() as u32,
            ] {
                bytes.extend_from_slice(&v.to_le_bytes());
            }
        }
    }

    /// Appends what bound splats have beside what all have, and the windows. `mean` encodes
    /// coordinates.
    pub fn push(&self, scene: &Scene, codes: &Codes, mean: &[Sinh; 3], bytes: &mut Vec<u8>) {
        let first = self.splats.n_static();
        let last = scene.time_frames.saturating_sub(1) as f64;
        let mut column = |width: usize, code: &dyn Fn(usize) -> u32| {
            let values: Vec<u32> = self.rows.iter().map(|&row| code(row)).collect();
            push_planes(bytes, width, &values);
        };
        for k in 0..3 {
            let from = self.splats.column(Column::Velocity, k);
            column(2, &|row| codes.residual.code(from[row - first]));
        }
        for k in 0..3 {
            let from = self.splats.column(Column::Trend, k);
            column(1, &|row| codes.trend.code(from[row - first]));
        }
        column(2, &|row| birth(self.splats, row).0 as u32);
        let life = |row: usize| {
            clipped(
                self.binding(row),
                &self.splats.windows()[self.binding(row).window as usize],
                last,
            )
        };
        column(2, &|row| {
            if life(row)[0] == f32::NEG_INFINITY {
                0
            } else {
                codes.life.code(life(row)[0]).max(1)
            }
        });
        column(2, &|row| {
            if life(row)[1] == f32::INFINITY {
                LIFE_TOP
            } else {
                codes.life.code(life(row)[1]).min(LIFE_TOP - 1)
            }
        });
        for k in 0..BINDING_NODES {
            column(2, &|row| u32::from(self.binding(row).nodes[k]));
        }
        for k in 0..BINDING_NODES - 1 {
            column(1, &|row| weight_codes(self.binding(row).weights)[k]);
        }
        self.push_windows(mean, bytes);
    }

    fn push_windows(&self, mean: &[Sinh; 3], bytes: &mut Vec<u8>) {
        for key in self.windows.iter().flat_map(|w| w.keys()) {
            bytes.extend_from_slice(&key.to_le_bytes());
        }
        for (k, sinh) in mean.iter().enumerate() {
            let rows = |window: &Window, row: usize, node: usize| match row.checked_sub(1) {
                None => window.anchors()[node][k],
                Some(key) => window.poses(key)[node].position[k],
            };
            let values = self.steps(1, (1 << 24) - 1, |window, row, node| {
                sinh.code(rows(window, row, node))
            });
            push_planes(bytes, 3, &values);
        }
        let turn =
            |window: &Window, key: usize, node: usize| turn_code(window.poses(key)[node].rotation);
        let left_out = self
            .windows
            .iter()
            .flat_map(|w| (0..w.keys().len()).flat_map(|key| w.poses(key)));
        let left_out: Vec<u32> = left_out.map(|pose| turn_code(pose.rotation).0).collect();
        push_planes(bytes, 1, &left_out);
        for k in 0..3 {
            let values = self.steps(0, TURN_TOP, |window, key, node| {
                turn(window, key, node).1[k]
            });
            push_planes(bytes, 2, &values);
        }
    }

    /// Codes of all nodes of all windows, as differences from row to row; `more` rows than keys.
    fn steps(
        &self,
        more: usize,
        top: u32,
        code: impl Fn(&Window, usize, usize) -> u32,
    ) -> Vec<u32> {
        let mut out = Vec::new();
        for window in &self.windows {
            let mut before = vec![0u32; window.anchors().len()];
            for row in 0..window.keys().len() + more {
                for (node, before) in before.iter_mut().enumerate() {
                    let q = code(window, row, node);
                    out.push(step_code(std::mem::replace(before, q), q, top));
                }
            }
        }
        out
    }
}

/// How the numbers of bound splats become codes.
pub(in super::super) struct Codes {
    life: Linear,
    residual: Sinh,
    trend: Sinh,
}

impl Codes {
    /// `px` is the size of a pixel at the median depth, world units, `colour_step` that of a colour
    /// coefficient.
    pub fn of(bound: &Bound<'_>, scene: &Scene, px: f64, colour_step: f64) -> Self {
        let last = scene.time_frames.saturating_sub(1) as f64;
        let window = |row: usize| &bound.splats.windows()[bound.binding(row).window as usize];
        let lives: Vec<[f32; 2]> = bound
            .rows
            .iter()
            .map(|&row| clipped(bound.binding(row), window(row), last))
            .collect();
        let mut reaches: Vec<f64> = bound
            .rows
            .iter()
            .zip(&lives)
            .map(|(&row, life)| {
                let key = f64::from(birth(bound.splats, row).1);
                let [from, to] = reach(window(row));
                let begin = f64::from(life[0]).max(0.0).max(from);
                let end = f64::from(life[1]).min(last).min(to);
                (key - begin).max(end - key).max(1.0)
            })
            .collect();
        let half = reaches.len() / 2;
        let reach = if reaches.is_empty() {
            1.0
        } else {
            *reaches.select_nth_unstable_by(half, f64::total_cmp).1
        };
        let ends = lives.iter().flatten().copied().filter(|v| v.is_finite());
        // the first and the last code are for what is not finite
        let inner = Linear::over(ends, f64::from(LIFE_TOP - 2), f64::INFINITY);
        Self {
            life: Linear {
                low: inner.low - inner.step,
                step: inner.step,
                top: f64::from(LIFE_TOP),
            },
            residual: Sinh::velocity(px / reach, 1.0 / VELOCITY_STEPS),
            trend: Sinh::trend(colour_step / reach / TREND_STEP, TREND_STEP),
        }
    }
}

/// The key that a bound splat is stored at: its index, and its time, frames.
fn birth(splats: &Splats, row: usize) -> (usize, f32) {
    let i = row - splats.n_static();
    let keys = splats.windows()[splats.bindings()[i].window as usize].keys();
    let keys = &keys[..keys.len().min(MOST_KEYS)];
    let t = splats.column(Column::TimeMean, 0)[i];
    let after = keys.partition_point(|&key| key < t).min(keys.len() - 1);
    let before = after.saturating_sub(1);
    let index = if (t - keys[before]).abs() < (keys[after] - t).abs() {
        before
    } else {
        after
    };
    (index, keys[index])
}

/// Frames from the time mean of a bound splat to the key that it is stored at.
pub(in super::super) fn reborn(splats: &Splats, row: usize) -> f64 {
    f64::from(birth(splats, row).1)
        - f64::from(splats.column(Column::TimeMean, 0)[row - splats.n_static()])
}

/// A life without ends that no frame shows.
fn clipped(binding: &Binding, window: &Window, last: f64) -> [f32; 2] {
    let half = FADE * f64::from(window.gap());
    let [begin, end] = binding.life;
    [
        if f64::from(begin) + half <= 0.0 {
            f32::NEG_INFINITY
        } else {
            begin
        },
        if f64::from(end) - half >= last {
            f32::INFINITY
        } else {
            end
        },
    ]
}

/// The largest presence of a splat from frame 0 to `last`; 0 where its life or its weights are no
/// numbers.
fn peak(binding: &Binding, window: &Window, last: f64) -> f64 {
    let [from, to] = reach(window);
    let (from, to) = (from.max(0.0), to.min(last));
    let [begin, end] = clipped(binding, window, last);
    if begin.is_nan() || end.is_nan() || from > to || !weights_are_usable(binding.weights) {
        return 0.0;
    }
    let middle = match (begin.is_finite(), end.is_finite()) {
        (true, true) => 0.5 * (f64::from(begin) + f64::from(end)),
        (true, false) => to,
        _ => from,
    };
    presence(
        middle.clamp(from, to),
        [begin, end],
        FADE * f64::from(window.gap()),
    )
}

fn is_finite(window: &Window) -> bool {
    let pose = |p: &Pose| {
        p.position.iter().chain(&p.rotation).all(|v| v.is_finite())
            && p.rotation.iter().any(|v| *v != 0.0)
    };
    window
        .keys()
        .iter()
        .chain(window.anchors().iter().flatten())
        .all(|v| v.is_finite())
        && (0..window.keys().len()).all(|key| window.poses(key).iter().all(pose))
}

fn weights_are_usable(weights: [f32; BINDING_NODES]) -> bool {
    weights.iter().all(|w| w.is_finite() && *w >= 0.0) && weights.iter().any(|w| *w > 0.0)
}

/// Weights in 255ths that sum to 1: each rounded down, what is left to those that lost most.
fn weight_codes(weights: [f32; BINDING_NODES]) -> [u32; BINDING_NODES] {
    let sum: f64 = weights.iter().map(|w| f64::from(*w)).sum();
    let exact = weights.map(|w| f64::from(w) / sum * f64::from(WEIGHT_SUM));
    let mut codes = exact.map(|w| w as u32);
    let mut order = [0, 1, 2, 3];
    order.sort_by(|&a, &b| exact[b].fract().total_cmp(&exact[a].fract()));
    let left = WEIGHT_SUM.saturating_sub(codes.iter().sum());
    order
        .iter()
        .take(left as usize)
        .for_each(|&k| codes[k] += 1);
    codes
}

#[cfg(test)]
mod tests {
    use super::{WEIGHT_SUM, weight_codes};
    use m4_core::CounterRng;

    #[test]
    fn weights_sum_to_one_and_are_off_by_less_than_a_step() {
        let mut rng = CounterRng::new(3, 0, 0);
        for _ in 0..500 {
            let raw: [f32; 4] = std::array::from_fn(|_| rng.uniform().powi(4) as f32);
            let sum: f32 = raw.iter().sum();
            let codes = weight_codes(raw);
            assert_eq!(codes.iter().sum::<u32>(), WEIGHT_SUM);
            for (code, weight) in codes.iter().zip(raw) {
                assert!(
                    (f64::from(*code) - 255.0 * f64::from(weight / sum)).abs() < 1.0,
                    "{codes:?} for {raw:?}"
                );
            }
        }
        assert_eq!(weight_codes([1.0, 0.0, 0.0, 0.0]), [255, 0, 0, 0]);
        assert_eq!(weight_codes([0.25; 4]), [64, 64, 64, 63]);
    }
}
