//! NVIDIA GPUs through CUDA. Driver and compiler are loaded at run time, so the build does not need
//! them.

use crate::gpu::device::{Adapter, AdapterKind, Place, unfit};
use cubecl::device::CudaDevice;
use cubecl::prelude::Client;
use cudarc::driver::sys::CUdevice_attribute as Attribute;
use cudarc::driver::{result, sys};
use cudarc::nvrtc;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::PathBuf;

/// Largest buffer that kernels can count in numbers of 32 bits, bytes.
const LARGEST: u64 = 4 << 32;

/// What CUDA needs at run time and this machine does not have, and how to get it; `None` if it is
/// all there.
pub(crate) fn missing() -> Option<String> {
    let mut missing = Vec::new();
    if !has_driver() {
        missing.push("NVIDIA's driver (libcuda)");
    }
    if !has_compiler() {
        missing.push(
            "the compiler NVRTC (libnvrtc on the library path: a CUDA toolkit, or the Python package nvidia-cuda-nvrtc)",
        );
    }
    if !has_headers() {
        missing.push(
            "CUDA's headers (CUDA_PATH or /usr/local/cuda with include/cuda_runtime.h: a toolkit, or the Python packages \
             nvidia-cuda-runtime and nvidia-cuda-cccl)",
        );
    }
    (!missing.is_empty()).then(|| format!("CUDA lacks {}", missing.join(", and ")))
}

#[expect(unsafe_code, reason = "opening a library runs its start-up code")]
fn has_driver() -> bool {
    // SAFETY: this only tries to open the driver's library by its names; its start-up code asks
    // nothing of the caller.
    unsafe { sys::is_culib_present() }
}

#[expect(unsafe_code, reason = "opening a library runs its start-up code")]
fn has_compiler() -> bool {
    // SAFETY: as for the driver.
    unsafe { nvrtc::sys::is_culib_present() }
}

/// Where the runtime looks for headers.
fn has_headers() -> bool {
    let set = std::env::var_os("CUDA_PATH").map(PathBuf::from);
    let folder = set.or_else(|| {
        let usual = ["/usr/local/cuda", "/opt/cuda"].map(PathBuf::from);
        let nvcc = PathBuf::from("/usr/bin/nvcc");
        let folder = usual.into_iter().find(|folder| folder.exists());
        folder.or_else(|| nvcc.exists().then(|| PathBuf::from("/usr")))
    });
    folder.is_some_and(|folder| folder.join("include").join("cuda_runtime.h").is_file())
}

/// The devices that the driver lists; none without a driver.
pub(crate) fn adapters() -> Vec<Adapter> {
    // without a library every call of its bindings panics
    if !has_driver() || result::init().is_err() {
        return Vec::new();
    }
    let missing = missing();
    let count = result::device::get_count().unwrap_or(0);
    (0..count)
        .filter_map(|i| adapter(i, missing.as_deref()))
        .collect()
}

#[expect(unsafe_code, reason = "the driver takes the device on trust")]
fn adapter(ordinal: i32, missing: Option<&str>) -> Option<Adapter> {
    let device = result::device::get(ordinal).ok()?;
    // SAFETY: the driver was started and gave `device` just now.
    let attribute = |which| unsafe { result::device::get_attribute(device, which) }.ok();
    let size = |which| attribute(which).and_then(|value| u32::try_from(value).ok());
    let max_units = size(Attribute::CU_DEVICE_ATTRIBUTE_MAX_THREADS_PER_BLOCK)?;
    let max_shared_bytes = size(Attribute::CU_DEVICE_ATTRIBUTE_MAX_SHARED_MEMORY_PER_BLOCK)?;
    let integrated = attribute(Attribute::CU_DEVICE_ATTRIBUTE_INTEGRATED) == Some(1);
    // SAFETY: as above.
    let bytes = unsafe { result::device::total_mem(device) }.ok()?;
    Some(Adapter {
        index: 0,
        name: result::device::get_name(device).ok()?,
        kind: if integrated {
            AdapterKind::Integrated
        } else {
            AdapterKind::Discrete
        },
        api: "CUDA".to_owned(),
        driver: version(),
        max_buffer_bytes: (bytes as u64).min(LARGEST),
        max_units,
        max_shared_bytes,
        unfit: missing
            .map(str::to_owned)
            .or_else(|| unfit(max_units, max_shared_bytes)),
        place: Place::Cuda(usize::try_from(ordinal).ok()?),
    })
}

/// The newest CUDA that the driver knows, such as `CUDA 13.0`.
#[expect(
    unsafe_code,
    reason = "the driver writes its version where it is told to"
)]
fn version() -> String {
    let mut version = 0;
    // SAFETY: `version` outlives the call.
    let answer = unsafe { sys::cuDriverGetVersion(&raw mut version) };
    match answer.result() {
        Ok(()) => format!("CUDA {}.{}", version / 1000, version % 1000 / 10),
        Err(_) => "CUDA of unknown version".to_owned(),
    }
}

/// Starts the device of that number; what its driver says if it refuses.
pub(crate) fn start(ordinal: usize) -> Result<Client, String> {
    // the runtime panics where its driver returns an error
    catch_unwind(AssertUnwindSafe(|| {
        cubecl::Device::Cuda(CudaDevice::new(ordinal)).client()
    }))
    .map_err(|panic| {
        let text = panic.downcast_ref::<String>().map(String::as_str);
        let text = text.or_else(|| panic.downcast_ref::<&str>().copied());
        text.unwrap_or("its runtime failed without a reason")
            .to_owned()
    })
}

#[cfg(test)]
mod tests {
    use super::{adapters, has_driver, missing};

    #[test]
    fn missing_cuda_libraries_are_named_and_disable_the_adapters() {
        let (missing, adapters) = (missing(), adapters());
        if !has_driver() {
            assert!(adapters.is_empty(), "{adapters:?}");
            assert!(
                missing
                    .as_ref()
                    .is_some_and(|text| text.contains("libcuda")),
                "{missing:?}"
            );
        }
        for adapter in &adapters {
            assert_eq!(adapter.api, "CUDA");
            assert!(
                !adapter.name.is_empty() && adapter.max_units >= 256,
                "{adapter:?}"
            );
            assert_eq!(adapter.unfit, missing);
        }
    }
}
