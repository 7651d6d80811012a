//! What times the kernels.

use crate::gpu;
use m4_kernels::SimdLevel;
use m4_kernels::bench::{Bench as Host, Kernel, SceneConfig};
use m4_train::backend::gpu::Bench;

#[test]
fn a_bench_times_every_kernel_and_lowers_the_loss() {
    let Some(gpu) = gpu("the bench") else { return };
    let config = SceneConfig { splats: 3000, width: 96, height: 72, ..SceneConfig::default() };
    let mut host = Host::new(SimdLevel::best(), &config).unwrap();
    let counts = host.count(0);
    let mut bench = Bench::new(gpu.clone(), host.into_scene()).unwrap();
    let entries = bench.entries(0).unwrap();
    assert!(entries >= counts.visible && entries <= bench.room(), "{entries} for {counts:?}");
    // larger tiles, so fewer entries, of which each is at most 16 of the CPU's
    assert!(entries < counts.pairs && 16 * entries > counts.pairs, "{entries} for {counts:?}");
    let laps = bench.laps(0).unwrap();
    for (kernel, lap) in Kernel::ALL.iter().zip(laps) {
        assert!(!lap.is_zero(), "{} took no time", kernel.name());
    }
    let first = bench.stats().unwrap();
    for _ in 0..8 {
        bench.step(0).unwrap();
    }
    let last = bench.stats().unwrap();
    assert!(last.steps == 8 && last.l1 < first.l1, "{last:?} after {first:?}");
    let mut drawing = bench.into_drawing().unwrap();
    let laps = drawing.laps(0).unwrap();
    for (kernel, lap) in Kernel::ALL.iter().zip(laps) {
        assert_eq!(lap.is_zero(), !kernel.renders(), "{}: {lap:?}", kernel.name());
    }
}
