//! Encodes splats as bytes.

use super::bound::{self, Bound};
use super::{
    LIFE_SDS, MAGIC, MARGINAL_MIN, MIDDLE_16, VERSION, VERSION_BOUND, bytes_per_splat, push_planes,
};
use super::{Linear, Sinh, rotation_code};
use m4_core::{Column, Scene, SplatLayout, Splats};

/// The splats of a scene as bytes, and what is in them.
#[derive(Debug, Clone, PartialEq)]
pub struct Payload {
    /// As described in [`crate::payload`].
    pub bytes: Vec<u8>,
    /// Splats without time parameters.
    pub n_static: usize,
    /// Splats with them.
    pub n_dynamic: usize,
    /// Those of them that are bound.
    pub n_bound: usize,
    /// Which columns.
    pub layout: SplatLayout,
}

/// `Y_0` of the spherical harmonics: colours are `1/2 + Y_0 K + ...`.
const SH_C0: f64 = 0.282_094_791_773_878_14;
/// Steps of a position to a pixel of the source video at the median depth: at 16 the loss is first
/// seen beside that of the scales.
const POSITION_STEPS_PER_PX: f64 = 32.0;
/// Steps of a colour from black to white: that of the source video.
const COLOUR_STEPS: f64 = 255.0;
/// Steps of a small displacement in a splat's life to a pixel, and of a large one to its size over
/// e.
pub(super) const VELOCITY_STEPS: f64 = 64.0;
/// Coarsest step of the logarithm of a scale: from the largest splat down to a millionth of it.
const SCALE_STEP: f64 = 0.055;
/// Positions are spaced evenly within this share of the median depth about the cameras.
const EVEN_SHARE: f64 = 0.1;
/// The least opacity that is drawn (docs/spec/optimiser.md 1.7).
const ALPHA_MIN: f64 = 1.0 / 255.0;

/// The splats that can be seen. Those whose opacity never exceeds 1/255 in the time of the scene,
/// or that have a NaN or infinite parameter, are left out. `median_depth` is that of what the
/// source cameras see, world units: it sets the size of a pixel.
pub fn encode(scene: &Scene, median_depth: f64) -> Payload {
    let splats = &scene.splats;
    let Shown { fixed, bound, free } = Shown::of(scene);
    let rows = [fixed.as_slice(), &bound.rows, &free].concat();
    let (n_static, n_bound) = (fixed.len(), bound.rows.len());
    let (layout, n, n_dynamic) = (splats.layout(), rows.len(), rows.len() - n_static);
    let codes = Codes::of(scene, &rows, &free, median_depth);
    let of_bound = bound::Codes::of(&bound, scene, codes.px, codes.colour_step);

    let (a, b) = bytes_per_splat(layout);
    let mut bytes = Vec::with_capacity(super::HEADER_BYTES + n_static * a + n_dynamic * b);
    bytes.extend_from_slice(MAGIC);
    let version = if bound.is_empty() {
        VERSION
    } else {
        VERSION_BOUND
    };
    for v in [version, n_static as u32, n_dynamic as u32] {
        bytes.extend_from_slice(&v.to_le_bytes());
    }
    let kinds = [
        layout.sh_degree as u8,
        layout.time_degree as u8,
        u8::from(layout.isotropic),
    ];
    bytes.extend_from_slice(&kinds);
    bytes.extend_from_slice(&[0; 5]);
    for v in codes.numbers() {
        bytes.extend_from_slice(&v.to_le_bytes());
    }
    if !bound.is_empty() {
        bound.push_header(&of_bound, &mut bytes);
    }

    let mut values = vec![0u32; n];
    let mut column = |width: usize, rows: &[usize], code: &dyn Fn(usize) -> u32| {
        values.resize(rows.len(), 0);
        for (value, &row) in values.iter_mut().zip(rows) {
            *value = code(row);
        }
        push_planes(&mut bytes, width, &values);
    };
    // a bound splat is stored as it is at a key
    let moved = |r: usize, from: f32, rate: Column, k: usize| match splats.bound().contains(&r) {
        true => {
            let rate = f64::from(splats.column(rate, k)[r - splats.n_static()]);
            (f64::from(from) + rate * bound::reborn(splats, r)) as f32
        }
        false => from,
    };
    for (k, sinh) in codes.mean.iter().enumerate() {
        let from = splats.column(Column::Mean, k);
        column(3, &rows, &|r| {
            sinh.code(moved(r, from[r], Column::Velocity, k))
        });
    }
    for k in 0..layout.range(Column::LogScale).len() {
        let from = splats.column(Column::LogScale, k);
        column(1, &rows, &|r| codes.scale.code(from[r]));
    }
    if !layout.isotropic {
        let quat: [&[f32]; 4] = std::array::from_fn(|k| splats.column(Column::Quat, k));
        column(4, &rows, &|r| rotation_code(quat.map(|c| c[r])));
    }
    let logit = splats.column(Column::Opacity, 0);
    column(1, &rows, &|r| (sigmoid(logit[r]) * 255.0).round() as u32);
    for k in 0..layout.range(Column::Colour).len() {
        let from = splats.column(Column::Colour, k);
        let value = |r: usize| {
            if k < 3 {
                moved(r, from[r], Column::Trend, k)
            } else {
                from[r]
            }
        };
        column(2, &rows, &|r| {
            (f64::from(value(r)) / codes.colour_step + MIDDLE_16)
                .round()
                .clamp(0.0, 65535.0) as u32
        });
    }
    let late: Vec<usize> = free.iter().map(|r| r - splats.n_static()).collect();
    let (time, sd) = (
        splats.column(Column::TimeMean, 0),
        splats.column(Column::LogTimeSd, 0),
    );
    column(2, &late, &|r| codes.time.code(time[r]));
    column(1, &late, &|r| codes.sd.code(sd[r]));
    for k in 0..3 {
        let from = splats.column(Column::Velocity, k);
        column(2, &late, &|r| codes.velocity.code(from[r]));
    }
    bound.push(scene, &of_bound, &codes.mean, &mut bytes);
    Payload {
        bytes,
        n_static,
        n_dynamic,
        n_bound,
        layout,
    }
}

struct Codes {
    /// Size of a pixel at the median depth, world units.
    px: f64,
    mean: [Sinh; 3],
    scale: Linear,
    colour_step: f64,
    time: Linear,
    sd: Linear,
    velocity: Sinh,
}

impl Codes {
    fn of(scene: &Scene, rows: &[usize], free: &[usize], median_depth: f64) -> Self {
        let splats = &scene.splats;
        let depth = if median_depth.is_finite() && median_depth > 0.0 {
            median_depth
        } else {
            1.0
        };
        let middle = scene.source.get(scene.source.len() / 2).map(|s| s.camera);
        let centre = middle.map_or([0.0; 3], |c| c.centre().into());
        // without a camera, the pixel of a phone's video at 480 pixels
        let focal_px = middle.map_or(400.0, |c| c.intrinsics.fx).max(1.0);
        let step = 1.0 / (focal_px * POSITION_STEPS_PER_PX);
        let scales = splats.layout().range(Column::LogScale).len();
        let late = || free.iter().map(|r| r - splats.n_static());
        let (time, sd) = (
            splats.column(Column::TimeMean, 0),
            splats.column(Column::LogTimeSd, 0),
        );
        let mut lives: Vec<f64> = late()
            .map(|r| (LIFE_SDS * f64::from(sd[r]).exp()).min(scene.time_frames.max(1) as f64))
            .collect();
        let half = lives.len() / 2;
        let life = if lives.is_empty() {
            1.0
        } else {
            *lives.select_nth_unstable_by(half, f64::total_cmp).1
        };
        Self {
            px: depth / focal_px,
            mean: std::array::from_fn(|k| Sinh::mean(centre[k], EVEN_SHARE * depth, step)),
            scale: Linear::over(
                (0..scales).flat_map(|k| {
                    rows.iter()
                        .map(move |&r| splats.column(Column::LogScale, k)[r])
                }),
                255.0,
                SCALE_STEP,
            ),
            colour_step: 1.0 / (SH_C0 * COLOUR_STEPS),
            time: Linear::over(late().map(|r| time[r]), 65535.0, f64::INFINITY),
            sd: Linear::over(late().map(|r| sd[r]), 255.0, f64::INFINITY),
            velocity: Sinh::velocity(depth / focal_px / life.max(1e-3), 1.0 / VELOCITY_STEPS),
        }
    }

    fn numbers(&self) -> [f64; 14] {
        let [x, y, z] = &self.mean;
        [
            x.centre,
            y.centre,
            z.centre,
            x.spread,
            x.step,
            self.scale.low,
            self.scale.step,
            self.colour_step,
            self.time.low,
            self.time.step,
            self.sd.low,
            self.sd.step,
            self.velocity.spread,
            self.velocity.step,
        ]
    }
}

fn sigmoid(logit: f32) -> f64 {
    1.0 / (1.0 + (-f64::from(logit)).exp())
}

/// The rows of the splats that a frame can show, in the order of the payload.
struct Shown<'a> {
    fixed: Vec<usize>,
    bound: Bound<'a>,
    free: Vec<usize>,
}

impl<'a> Shown<'a> {
    fn of(scene: &'a Scene) -> Self {
        let splats = &scene.splats;
        let (n, n_static, bound) = (splats.n(), splats.n_static(), splats.bound());
        let mut finite = vec![true; n];
        let shared = splats.layout().shared_columns();
        for (c, column) in splats.columns().iter().enumerate() {
            // bound splats have a life instead of a duration
            let first = match c {
                _ if c < shared => 0,
                _ if c == splats.layout().column(Column::LogTimeSd) => bound.end,
                _ => n_static,
            };
            for (ok, v) in finite[first..]
                .iter_mut()
                .zip(&column[column.len() - (n - first)..])
            {
                *ok &= v.is_finite();
            }
        }
        let logit = splats.column(Column::Opacity, 0);
        let last = scene.time_frames.saturating_sub(1) as f64;
        let visible =
            |row: usize| finite[row] && sigmoid(logit[row]) * peak(splats, row, last) > ALPHA_MIN;
        let seen_by = |row: usize, depth: f64| {
            finite[row] && 1.0 - (1.0 - sigmoid(logit[row])).powf(depth) > ALPHA_MIN
        };
        Self {
            fixed: (0..n_static).filter(|&row| visible(row)).collect(),
            bound: Bound::new(scene, seen_by),
            free: (bound.end..n).filter(|&row| visible(row)).collect(),
        }
    }
}

/// The largest temporal marginal of a splat from frame 0 to `last`; 0 where it is not drawn.
fn peak(splats: &Splats, row: usize, last: f64) -> f64 {
    let Some(i) = row.checked_sub(splats.n_static()) else {
        return 1.0;
    };
    let mean = f64::from(splats.column(Column::TimeMean, 0)[i]);
    let sd = f64::from(splats.column(Column::LogTimeSd, 0)[i]).exp();
    let away = (mean.clamp(0.0, last) - mean) / sd;
    let marginal = (-0.5 * away * away).exp();
    if marginal > MARGINAL_MIN {
        marginal
    } else {
        0.0
    }
}
