//! scratch
use burn_core::tensor::{Distribution, Tensor, module::conv2d, ops::ConvOptions};
fn best(n: usize, mut f: impl FnMut()) -> f64 {
    (0..n)
        .map(|_| {
            let t = cpu_time::ProcessTime::now();
            f();
            t.elapsed().as_secs_f64()
        })
        .fold(f64::MAX, f64::min)
}
fn main() {
    for threads in [1, 2] {
        println!("threads {threads}");
        rayon::ThreadPoolBuilder::new()
            .num_threads(threads)
            .build()
            .unwrap()
            .install(run);
    }
}
fn run() {
    let mut acc = [[1.0f32; 16]; 24];
    let t = best(5, || {
        use fearless_simd::{prelude::*, *};
        let level = Level::new();
        dispatch!(level, s => peak(s, &mut acc));
    });
    println!("peak 1 core {:.1} GF/s", 2.0 * 24.0 * 16.0 * 1e6 / t / 1e9);

    let d = m4_nets::cpu();
    let r = |s: [usize; 2]| Tensor::<2>::random(s, Distribution::Default, &d);
    for (m, k, n) in [
        (256, 4032, 2993),
        (2993, 4032, 256),
        (1024, 1024, 1024),
        (2048, 2048, 2048),
    ] {
        let (a, b) = (r([m, k]), r([k, n]));
        let t = best(8, || {
            let _ = a.clone().matmul(b.clone()).into_data();
        });
        println!(
            "matmul {m} {k} {n}: {:.1} ms {:.1} GF/s",
            t * 1e3,
            2.0 * (m * k * n) as f64 / t / 1e9
        );
    }
    for (ci, co, k, e) in [
        (448, 256, 3, 1),
        (448, 256, 3, 4),
        (128, 128, 3, 1),
        (128, 128, 3, 4),
        (196, 128, 1, 4),
        (4, 128, 7, 4),
        (128, 2, 3, 4),
    ] {
        let x = Tensor::<4>::random([e, ci, 41, 73], Distribution::Default, &d);
        let w = Tensor::<4>::random([co, ci, k, k], Distribution::Default, &d);
        let o = || ConvOptions::new([1, 1], [k / 2, k / 2], [1, 1], 1);
        let t = best(8, || {
            let _ = conv2d(x.clone(), w.clone(), None, o()).into_data();
        });
        println!(
            "conv {ci}->{co} {k} x{e}: {:.1} ms {:.1} GF/s",
            t * 1e3,
            2.0 * (e * ci * co * k * k * 41 * 73) as f64 / t / 1e9
        );
    }
}

#[inline(always)]
fn peak<S: fearless_simd::Simd>(s: S, acc: &mut [[f32; 16]; 24]) {
    use fearless_simd::{prelude::*, *};
    let mut a: [f32x16<S>; 24] = std::array::from_fn(|i| f32x16::from_slice(s, &acc[i]));
    let k = f32x16::splat(s, std::hint::black_box(0.999));
    let l = f32x16::splat(s, std::hint::black_box(0.001));
    for _ in 0..1_000_000 {
        for i in 0..24 {
            a[i] = a[i].mul_add(k, l);
        }
    }
    for i in 0..24 {
        acc[i] = a[i].into();
    }
}
