//! Writes the next rows, including clones and split halves.
#![expect(clippy::collapsible_if, reason = "kernels are expanded: conditions at compile time stand alone")]

use super::outcomes::{Outcomes, birth_of, stay_of};
use cubecl::prelude::*;
use m4_kernels::gpu::buffer::{Buffer, cubes, units};
use m4_kernels::gpu::splats::DeviceSplats;
use m4_kernels::gpu::splats::NOTHING;
use m4_kernels::gpu::vector::{dot, v3};
use m4_kernels::slice::gpu::shape;

/// A row is the splat that it was.
const KEPT: u32 = 0;
/// A clone, or what was cloned.
const SHARES: u32 = 1;
/// The two halves of a splat.
const HALF: u32 = 2;
const OTHER_HALF: u32 = 3;

/// Of each row of the next splats:
pub(super) struct Rows {
    /// The row that it comes from,
    pub sources: Buffer,
    /// the row whose state of the optimiser it keeps, or [`NOTHING`],
    pub states: Buffer,
    /// and what it is.
    marks: Buffer,
}

impl Rows {
    /// Of `next` rows, from `n` splats of which `n_static` are static.
    pub fn new(client: &Client, fates: &Outcomes, (n, n_static): (usize, usize), next: usize) -> Self {
        let [sources, states, marks] = [(); 3].map(|()| Buffer::empty(client, next));
        place::launch(
            client,
            cubes(n, 256),
            units(),
            fates.sizes.arg(),
            fates.places.arg(),
            sources.arg(),
            states.arg(),
            marks.arg(),
            n as u32,
            n_static as u32,
        );
        Self { sources, states, marks }
    }

    /// Makes clones and halves of the copies of their `parents` that `splats` has.
    pub fn shape(&self, client: &Client, parents: &DeviceSplats, splats: &DeviceSplats, share_opacity: bool) {
        shape_new_splats::launch(
            client,
            cubes(splats.n, 256),
            units(),
            self.marks.arg(),
            self.sources.arg(),
            parents.geometry.arg(),
            splats.geometry.arg(),
            parents.n as u32,
            splats.n as u32,
            splats.layout.isotropic,
            share_opacity,
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
) {
    let i = ABSOLUTE_POS as u32;
    if i < n {
        let stay = stay_of(i, n_static) as usize;
        let birth = birth_of(i, n, n_static) as usize;
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
    old: u32,
    n: u32,
    #[comptime] isotropic: bool,
    #[comptime] share_opacity: bool,
) {
    let i = ABSOLUTE_POS as u32;
    if i < n {
        let (mark, row) = (marks[i as usize], sources[i as usize]);
        if mark == HALF || mark == OTHER_HALF {
            let mut sign = 1.0f32;
            if mark == OTHER_HALF {
                sign = f32::new(-1.0);
            }
            halve(parents, row, old, to, i, n, sign, isotropic);
        }
        if comptime!(share_opacity) {
            if mark != KEPT {
                let column = comptime!(if isotropic { 4u32 } else { 10u32 });
                to[(column * n + i) as usize] = shared_opacity(parents[(column * old + row) as usize]);
            }
        }
    }
}

/// 0.6 standard deviations along the longest axis, 0.8 as long there: `0.6^2 + 0.8^2 = 1`.
#[cube]
fn halve(parents: &[f32], row: u32, old: u32, to: &mut [f32], i: u32, n: u32, sign: f32, #[comptime] isotropic: bool) {
    let s = shape(parents, row, old, isotropic);
    let mut axis = 0u32;
    let mut x = sign * 0.6f32 * s.scale.x;
    let mut y = 0.0f32;
    let mut z = 0.0f32;
    if comptime!(!isotropic) {
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
        // the world's axes where there is no rotation
        if s.w != 0.0f32 || s.q.x != 0.0f32 || s.q.y != 0.0f32 || s.q.z != 0.0f32 {
            let local = v3(x, y, z);
            // the vector shares its numbers with the variables it was made of: all three before any changes
            let (turned_x, turned_y, turned_z) = (dot(&s.r0, &local), dot(&s.r1, &local), dot(&s.r2, &local));
            x = turned_x;
            y = turned_y;
            z = turned_z;
        }
    }
    to[i as usize] = parents[row as usize] + x;
    to[(n + i) as usize] = parents[(old + row) as usize] + y;
    to[(2u32 * n + i) as usize] = parents[(2u32 * old + row) as usize] + z;
    let column = 3u32 + axis;
    // ln 0.8
    to[(column * n + i) as usize] = parents[(column * old + row) as usize] - 0.223_143_55f32;
}

/// The logit of `1 - sqrt(1 - o)`, given that of `o`.
#[cube]
fn shared_opacity(logit: f32) -> f32 {
    // 1 - o in a form that is exact for large logits; beyond 80 it is nothing, and no exponential is infinite
    let pass = (1.0f32 / (1.0f32 + logit.min(80.0f32).exp())).sqrt();
    let o = (1.0f32 - pass).clamp(1.0e-6f32, 0.999_999f32);
    (o / (1.0f32 - o)).ln()
}
