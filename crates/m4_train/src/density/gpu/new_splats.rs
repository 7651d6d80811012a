//! Writes the next rows, including clones and split halves.
#![expect(
    clippy::collapsible_if,
    reason = "kernels are expanded: conditions at compile time stand alone"
)]

use super::outcomes::{Outcomes, birth_of, stay_of};
use crate::config::{CloneOpacity, SplitPlacement};
use crate::density::DensityRound;
use crate::density::new_splats::child_purpose;
use cubecl::prelude::*;
use m4_core::CounterRng;
use m4_kernels::gpu::buffer::NOTHING;
use m4_kernels::gpu::buffer::{Buffer, cubes, units};
use m4_kernels::gpu::random::{Wide, key, normal, wide};
use m4_kernels::gpu::vector::{V3, dot, v3};
use m4_kernels::launch;
use m4_kernels::slice::gpu::{Shape, shape};
use m4_kernels::splats::DeviceSplats;

/// A clone, or what was cloned; 0 is a row that stays as it is.
const SHARES: u32 = 1;
/// The two halves of a splat.
const HALF: u32 = 2;
const OTHER_HALF: u32 = 3;

/// Of drawn children and those of spheres, whose scales are those of the parent over 1.6.
const LN_SPLIT_FACTOR: f32 = 0.470_003_63;

/// Of each row of the next splats:
pub(crate) struct Rows {
    /// The row that it comes from,
    pub sources: Buffer,
    /// the row whose state of the optimiser it keeps, or [`NOTHING`],
    pub states: Buffer,
    /// and what it is.
    marks: Buffer,
}

impl Rows {
    /// Of `next` rows, from `splats`.
    pub fn new(client: &Client, fates: &Outcomes, splats: &DeviceSplats, next: usize) -> Self {
        let n = splats.n;
        let [sources, states, marks] = [(); 3].map(|()| Buffer::empty(client, next));
        launch!(
            client,
            place::launch,
            (cubes(n, 256), units()),
            [fates.sizes, fates.places, sources, states, marks],
            [n as u32, splats.n_static as u32, splats.n_still() as u32]
        );
        Self {
            sources,
            states,
            marks,
        }
    }

    /// Makes clones and halves of the copies of their `parents` that `splats` has, whose row
    /// `first_free` is the first that is neither static nor bound.
    pub fn shape(
        &self,
        client: &Client,
        parents: &DeviceSplats,
        splats: &DeviceSplats,
        first_free: usize,
        round: &DensityRound<'_>,
    ) {
        let config = round.rules.config;
        let [first, second] =
            [0, 1].map(|child| CounterRng::base(round.seed, child_purpose(round.iteration, child)));
        let words = |base: u64| ((base >> 32) as u32, base as u32);
        launch!(
            client,
            shape_new_splats::launch,
            (cubes(splats.n, 256), units()),
            [
                self.marks,
                self.sources,
                parents.geometry,
                splats.geometry,
                splats.time
            ],
            [
                parents.n as u32,
                splats.n as u32,
                splats.n_static as u32,
                first_free as u32,
                words(first).0,
                words(first).1,
                words(second).0,
                words(second).1,
                splats.layout.isotropic,
                config.clone_opacity == CloneOpacity::Share,
                config.split_placement == SplitPlacement::Sample
            ]
        );
    }
}

#[cube(launch)]
fn place(
    sizes: &[u32],
    places: &[u32],
    sources: &mut [u32],
    states: &mut [u32],
    marks: &mut [u32],
    n: u32,
    n_static: u32,
    n_still: u32,
) {
    let i = ABSOLUTE_POS as u32;
    if i < n {
        let stay = stay_of(i, n_static, n_still) as usize;
        let birth = birth_of(i, n, n_static, n_still) as usize;
        let births = sizes[birth];
        if sizes[stay] != 0u32 {
            let at = places[stay] as usize;
            sources[at] = i;
            states[at] = i;
            // it was cloned where it bears one
            marks[at] = births;
        }
        for k in 0u32..births {
            let at = (places[birth] + k) as usize;
            sources[at] = i;
            states[at] = NOTHING;
            let mut mark = HALF + k;
            if births == 1u32 {
                mark = SHARES;
            }
            marks[at] = mark;
        }
    }
}

#[cube(launch)]
fn shape_new_splats(
    marks: &[u32],
    sources: &[u32],
    parents: &[f32],
    to: &mut [f32],
    time: &mut [f32],
    old: u32,
    n: u32,
    n_static: u32,
    first_free: u32,
    first_high: u32,
    first_low: u32,
    second_high: u32,
    second_low: u32,
    #[comptime] isotropic: bool,
    #[comptime] share_opacity: bool,
    #[comptime] drawn: bool,
) {
    let i = ABSOLUTE_POS as u32;
    if i < n {
        let (mark, row) = (marks[i as usize], sources[i as usize]);
        let is_half = mark == HALF || mark == OTHER_HALF;
        if is_half {
            if comptime!(drawn) {
                let mut high = first_high;
                let mut low = first_low;
                if mark == OTHER_HALF {
                    high = second_high;
                    low = second_low;
                }
                let key = key(&wide(high, low), row);
                draw_child(
                    parents, row, old, to, time, i, n, n_static, first_free, &key, isotropic,
                );
            } else {
                let mut sign = 1.0f32;
                if mark == OTHER_HALF {
                    sign = f32::new(-1.0);
                }
                let key = key(&wide(first_high, first_low), row);
                halve(parents, row, old, to, i, n, sign, &key, isotropic);
            }
        }
        if comptime!(share_opacity) {
            if mark == SHARES || (is_half && comptime!(!drawn)) {
                let column = comptime!(if isotropic { 4u32 } else { 10u32 });
                to[(column * n + i) as usize] =
                    shared_opacity(parents[(column * old + row) as usize]);
            }
        }
    }
}

/// A point of the splat's Gaussian, in space and time, and scales over 1.6 (3DGS).
#[cube]
fn draw_child(
    parents: &[f32],
    row: u32,
    old: u32,
    to: &mut [f32],
    time: &mut [f32],
    i: u32,
    n: u32,
    n_static: u32,
    first_free: u32,
    key: &Wide,
    #[comptime] isotropic: bool,
) {
    let s = shape(parents, row, old, isotropic);
    let local = v3(
        s.scale.x * normal(key, 0u32),
        s.scale.y * normal(key, 1u32),
        s.scale.z * normal(key, 2u32),
    );
    let shift = turned(&s, &local, isotropic);
    let mut x = shift.x;
    let mut y = shift.y;
    let mut z = shift.z;
    // a bound splat lives as its binding says
    if i >= first_free {
        let (j, dynamic) = ((i - n_static) as usize, (n - n_static) as usize);
        let log_sd = time[dynamic + j];
        let dt = log_sd.exp() * normal(key, 3u32);
        time[j] += dt;
        time[dynamic + j] = log_sd - LN_SPLIT_FACTOR;
        x += time[2 * dynamic + j] * dt;
        y += time[3 * dynamic + j] * dt;
        z += time[4 * dynamic + j] * dt;
    }
    to[i as usize] += x;
    to[(n + i) as usize] += y;
    to[(2u32 * n + i) as usize] += z;
    to[(3u32 * n + i) as usize] -= LN_SPLIT_FACTOR;
    if comptime!(!isotropic) {
        to[(4u32 * n + i) as usize] -= LN_SPLIT_FACTOR;
        to[(5u32 * n + i) as usize] -= LN_SPLIT_FACTOR;
    }
}

/// A vector of the splat's own axes, in the world; as it is where there is no rotation.
#[cube]
fn turned(s: &Shape, local: &V3, #[comptime] isotropic: bool) -> V3 {
    // all three before any changes: a vector shares its numbers with the variables that it is made
    // of
    let (turned_x, turned_y, turned_z) = (dot(&s.r0, local), dot(&s.r1, local), dot(&s.r2, local));
    let mut x = local.x;
    let mut y = local.y;
    let mut z = local.z;
    if comptime!(!isotropic) {
        if s.w != 0.0f32 || s.q.x != 0.0f32 || s.q.y != 0.0f32 || s.q.z != 0.0f32 {
            x = turned_x;
            y = turned_y;
            z = turned_z;
        }
    }
    v3(x, y, z)
}

/// 0.6 standard deviations along the longest axis, 0.8 as long there: `0.6^2 + 0.8^2 = 1`. A sphere
/// is halved along a direction that is drawn, with its scale over 1.6.
#[cube]
fn halve(
    parents: &[f32],
    row: u32,
    old: u32,
    to: &mut [f32],
    i: u32,
    n: u32,
    sign: f32,
    key: &Wide,
    #[comptime] isotropic: bool,
) {
    let s = shape(parents, row, old, isotropic);
    let mut axis = 0u32;
    let mut x = sign * 0.6f32 * s.scale.x;
    let mut y = 0.0f32;
    let mut z = 0.0f32;
    if comptime!(isotropic) {
        let drawn = v3(normal(key, 0u32), normal(key, 1u32), normal(key, 2u32));
        let length = x / dot(&drawn, &drawn).sqrt();
        x = length * drawn.x;
        y = length * drawn.y;
        z = length * drawn.z;
    } else {
        if s.scale.y > s.scale.x {
            axis = 1u32;
            x = 0.0f32;
            y = sign * 0.6f32 * s.scale.y;
        }
        if s.scale.z > s.scale.x.max(s.scale.y) {
            axis = 2u32;
            x = 0.0f32;
            y = 0.0f32;
            z = sign * 0.6f32 * s.scale.z;
        }
    }
    let shift = turned(&s, &v3(x, y, z), isotropic);
    to[i as usize] = parents[row as usize] + shift.x;
    to[(n + i) as usize] = parents[(old + row) as usize] + shift.y;
    to[(2u32 * n + i) as usize] = parents[(2u32 * old + row) as usize] + shift.z;
    let column = 3u32 + axis;
    let mut shrink = 0.223_143_55f32; // -ln 0.8
    if comptime!(isotropic) {
        shrink = LN_SPLIT_FACTOR;
    }
    to[(column * n + i) as usize] = parents[(column * old + row) as usize] - shrink;
}

/// The logit of `1 - sqrt(1 - o)`, given that of `o`.
#[cube]
fn shared_opacity(logit: f32) -> f32 {
    // 1 - o in a form that is exact for large logits; beyond 80 it is nothing, and no exponential
    // is infinite
    let pass = (1.0f32 / (1.0f32 + logit.min(80.0f32).exp())).sqrt();
    let o = (1.0f32 - pass).clamp(1.0e-6f32, 0.999_999f32);
    (o / (1.0f32 - o)).ln()
}
