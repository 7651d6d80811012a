//! The optimiser's state follows its splats.

use crate::gpu;
use crate::step::{LAMBDA, LAYOUT, columns, picture, start};
use m4_core::Splats;
use m4_kernels::adam::cpu::{AdamConfig, AdamState};
use m4_kernels::gpu::{DensifyPlan, GpuError, StepSettings, Trainer};
use m4_kernels::{View, morton_order};

fn trainer(gpu: m4_kernels::gpu::Gpu) -> (Trainer, View) {
    let (splats, view) = start();
    let mut trainer = Trainer::new(gpu, &splats, &AdamState::new(&splats), [picture(0)], usize::MAX).unwrap();
    let rates = vec![1e-3; LAYOUT.columns()];
    for _ in 0..2 {
        trainer.step(0, &view, &settings(&rates)).unwrap();
    }
    (trainer, view)
}

fn settings(rates: &[f32]) -> StepSettings<'_> {
    StepSettings {
        lambda_ssim: LAMBDA,
        rates,
        adam: AdamConfig::default(),
    }
}

#[test]
fn survivors_keep_their_state_and_new_splats_start_from_nothing() {
    let Some(gpu) = gpu("rearranging") else { return };
    let (mut trainer, view) = trainer(gpu);
    let (splats, adam) = trainer.download().unwrap();
    assert_eq!(trainer.download_splats().unwrap(), splats);
    let (n, n_static) = (splats.n() as u32, splats.n_static() as u32);
    // backwards, every third gone, every seventh twice: the second time as a new splat
    let mut rows = Vec::new();
    for range in [0..n_static, n_static..n] {
        rows.extend(range.clone().rev().filter(|r| r % 3 != 0).map(|r| (r, false)));
        rows.extend(range.filter(|r| r % 7 == 0).map(|r| (r, true)));
    }
    let (rows, is_new): (Vec<u32>, Vec<bool>) = rows.into_iter().unzip();
    let next = splats.gather(&rows).unwrap();
    let mut want = AdamState {
        m: adam.m.gather(&rows).unwrap(),
        v: adam.v.gather(&rows).unwrap(),
        step: rows.iter().map(|&r| adam.step[r as usize]).collect(),
    };
    (0..rows.len()).filter(|&i| is_new[i]).for_each(|i| want.forget(i));
    assert!(want.step.contains(&2) && columns(&want.m).iter().any(|&v| v != 0.0));

    // new splats differ from their parents, and so does one that stays
    let mut next = next;
    let changed: Vec<u32> = (0..rows.len())
        .filter(|&i| is_new[i] || i == 5)
        .map(|i| i as u32)
        .collect();
    for column in next.columns_mut() {
        let first = if column.len() == rows.len() {
            0
        } else {
            rows.len() - column.len()
        };
        for &row in changed.iter().filter(|&&row| row as usize >= first) {
            column[row as usize - first] += 0.5;
        }
    }
    let values = next.gather(&changed).unwrap();
    let regrowth = DensifyPlan {
        rows: &rows,
        n_static: next.n_static(),
        is_new: &is_new,
        changed: &changed,
        values: &values,
    };
    trainer.regrow(&regrowth).unwrap();
    assert_eq!(trainer.download().unwrap(), (next.clone(), want.clone()));
    // and steps continue from there
    trainer.found().unwrap();
    let rates = vec![1e-3; LAYOUT.columns()];
    trainer.step(0, &view, &settings(&rates)).unwrap();
    let (moved, after) = trainer.download().unwrap();
    assert_ne!(moved, next);
    let counted = after.step.iter().zip(&want.step).filter(|(a, b)| a > b).count();
    assert_eq!(counted as f64, trainer.found().unwrap().touched);
}

#[test]
fn rows_that_do_not_fit_are_refused_and_nothing_changes() {
    let Some(gpu) = gpu("rows that do not fit") else { return };
    let (mut trainer, _) = trainer(gpu);
    let before = trainer.download().unwrap();
    let (splats, n) = (&before.0, before.0.n() as u32);
    let rows: Vec<u32> = (0..n).collect();
    let is_new = vec![false; n as usize];
    let mut outside = rows.clone();
    outside[n as usize - 1] = n;
    let mut swapped = rows.clone();
    swapped.swap(0, n as usize - 1);
    let one = splats.gather(&[0]).unwrap();
    let wide = Splats::zeros(m4_core::SplatLayout { sh_degree: 2, ..LAYOUT }, 1, 0);
    let good = DensifyPlan {
        rows: &rows,
        n_static: splats.n_static(),
        is_new: &is_new,
        changed: &[0],
        values: &one,
    };
    for bad in [
        DensifyPlan {
            is_new: &is_new[1..],
            ..good
        },
        DensifyPlan { rows: &outside, ..good },
        DensifyPlan { rows: &swapped, ..good },
        DensifyPlan { values: &wide, ..good },
        DensifyPlan { changed: &[], ..good },
        DensifyPlan {
            changed: &[n - 1],
            ..good
        },
        DensifyPlan { changed: &[n], ..good },
    ] {
        assert!(matches!(trainer.regrow(&bad), Err(GpuError::Shape(_))), "{bad:?}");
    }
    assert_eq!(trainer.download().unwrap(), before);
    trainer.regrow(&good).unwrap();
    assert_eq!(trainer.download().unwrap(), before);
}

#[test]
fn the_order_in_memory_is_that_of_the_processor() {
    let Some(gpu) = gpu("ordering") else { return };
    let (mut trainer, view) = trainer(gpu);
    let (splats, adam) = trainer.download().unwrap();
    let order = morton_order(&splats);
    let want = AdamState {
        m: adam.m.gather(&order).unwrap(),
        v: adam.v.gather(&order).unwrap(),
        step: order.iter().map(|&r| adam.step[r as usize]).collect(),
    };
    trainer.reorder().unwrap();
    let got = trainer.download().unwrap();
    // a division that rounds another way may put a splat into the next cell: none does here
    assert!(got == (splats.gather(&order).unwrap(), want));
    assert_ne!(got.0, splats);
    let rates = vec![1e-3; LAYOUT.columns()];
    trainer.step(0, &view, &settings(&rates)).unwrap();
    assert!(trainer.found().unwrap().touched > 0.0);
}
