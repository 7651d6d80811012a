//! The memory order of splats.

use m4_core::{Column, Splats};
use rayon::prelude::*;

/// Rows in the order that makes neighbours in the image neighbours in memory: static splats first,
/// along a Morton curve; dynamic splats by coarse time (64 slots between the first and the last
/// `time_mean`), along a Morton curve within each slot. Give it to [`Splats::gather`].
pub fn morton_order(splats: &Splats) -> Vec<u32> {
    let axes: [&[f32]; 3] = std::array::from_fn(|k| splats.column(Column::Mean, k));
    let times = splats.column(Column::TimeMean, 0);
    let columns = [axes[0], axes[1], axes[2], times];
    let mut limits = [(0.0, 1.0); 4];
    limits
        .par_iter_mut()
        .zip(columns)
        .for_each(|(limits, column)| *limits = quantiles(column));
    let [frame @ .., (first, last)] = limits;
    let code = |row: usize| {
        let place = (0..3).fold(0, |sum, k| {
            let (low, high) = frame[k];
            sum | spread(cell(axes[k][row], low, high, 1023)) << k
        });
        let slot = match row.checked_sub(splats.n_static()) {
            Some(i) => 1 + u64::from(cell(times[i], first, last, 63)),
            None => 0,
        };
        let slot = match row.checked_sub(splats.n_static()) {
            Some(i) => match splats.bindings().get(i) {
                Some(binding) => 1 + u64::from(binding.window),
                None => slot + splats.windows().len() as u64,
            },
            None => slot,
        };
        (slot << 32 | u64::from(place), row as u32)
    };
    let mut keys: Vec<(u64, u32)> = (0..splats.n()).into_par_iter().map(code).collect();
    // no two keys are the same, so there is one order
    keys.par_sort_unstable();
    keys.into_iter().map(|(_, row)| row).collect()
}

/// Values below which 1% and 99% of the column lie: a few far splats must not flatten the curve.
fn quantiles(column: &[f32]) -> (f32, f32) {
    let mut values: Vec<f32> = column.iter().copied().filter(|v| v.is_finite()).collect();
    match values.len() {
        0 => (0.0, 1.0),
        n => {
            let mut at = |place: usize| *values.select_nth_unstable_by(place, f32::total_cmp).1;
            (at(n / 100), at(n - 1 - n / 100))
        }
    }
}

/// Which of `last + 1` equal steps between `low` and `high` holds `value`.
fn cell(value: f32, low: f32, high: f32, last: u32) -> u32 {
    let share = (value - low) / (high - low).max(f32::MIN_POSITIVE);
    (share.clamp(0.0, 1.0) * last as f32) as u32
}

/// Two zero bits between the bits of a 10-bit number.
fn spread(v: u32) -> u32 {
    let v = (v | v << 16) & 0x0300_00ff;
    let v = (v | v << 8) & 0x0300_f00f;
    let v = (v | v << 4) & 0x030c_30c3;
    (v | v << 2) & 0x0924_9249
}

#[cfg(test)]
mod tests {
    use super::morton_order;
    use m4_core::{Column, CounterRng, SplatLayout, Splats};

    #[test]
    fn neighbours_in_space_become_neighbours_in_memory() {
        let layout = SplatLayout {
            isotropic: true,
            sh_degree: 0,
            time_degree: 0,
        };
        let mut splats = Splats::zeros(layout, 3000, 1000);
        let mut rng = CounterRng::new(1, 0, 0);
        for k in 0..3 {
            splats
                .column_mut(Column::Mean, k)
                .fill_with(|| rng.uniform() as f32);
        }
        splats
            .column_mut(Column::TimeMean, 0)
            .fill_with(|| (40.0 * rng.uniform()) as f32);
        let order = morton_order(&splats);
        let sorted = splats.gather(&order).unwrap();
        let mut rows = order;
        rows.sort_unstable();
        assert!(rows.iter().copied().eq(0..4000), "every row once");
        let walk = |s: &Splats| -> f64 {
            let axis = |k, i: usize| f64::from(s.column(Column::Mean, k)[i]);
            (1..3000)
                .map(|i| {
                    (0..3)
                        .map(|k| (axis(k, i) - axis(k, i - 1)).powi(2))
                        .sum::<f64>()
                        .sqrt()
                })
                .sum()
        };
        assert!(
            walk(&sorted) < 0.25 * walk(&splats),
            "{} of {}",
            walk(&sorted),
            walk(&splats)
        );
        let times = sorted.column(Column::TimeMean, 0);
        assert!(
            times.windows(2).all(|t| t[1] > t[0] - 1.5),
            "dynamic splats lie in order of time"
        );
    }
}
