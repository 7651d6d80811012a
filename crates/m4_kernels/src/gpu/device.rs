//! Lists GPUs, opens one, and reports the memory that it holds.

use crate::gpu::{GpuError, inputs::Inputs};
use cubecl::Device;
use cubecl::MemoryScope;
use cubecl::device::{WgpuBackend, WgpuDevice, WgpuDeviceKind};
use cubecl::prelude::Client;
use cubecl::profile::TimingMethod;
use cubecl::wgpu::{
    AutoGraphicsApi, RuntimeOptions, try_init_setup,
    wgpu::{self, DeviceType},
};
use serde::Serialize;
use std::sync::{Mutex, OnceLock, PoisonError};

/// The kind of an adapter.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum AdapterKind {
    /// A card of its own.
    Discrete,
    /// Shares memory with the processor.
    Integrated,
    /// Passed through to a virtual machine.
    Virtual,
    /// The processor playing GPU: slower than this program's own path for processors.
    Software,
    /// The driver does not say.
    Other,
}

/// A graphics adapter of this machine.
#[derive(Debug, Clone, PartialEq, Eq, Serialize)]
pub struct Adapter {
    /// What `--device gpu:INDEX` calls it.
    pub index: usize,
    /// The name that the driver reports.
    pub name: String,
    /// The kind.
    pub kind: AdapterKind,
    /// Vulkan, Metal, DX12 or CUDA.
    pub api: String,
    /// Name and version of the driver, as it says.
    pub driver: String,
    /// Largest buffer that a kernel can be given, bytes.
    pub max_buffer_bytes: u64,
    /// Units in a cube at most.
    pub max_units: u32,
    /// Memory shared by a cube at most, bytes.
    pub max_shared_bytes: u32,
    /// Why no device is made of it, if that is so.
    pub unfit: Option<String>,
    #[serde(skip)]
    pub(crate) place: Place,
}

/// Where the runtime finds an adapter.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Place {
    /// A kind, and its number among those of that kind.
    Wgpu(u8, usize),
    /// The driver's number.
    #[cfg(feature = "cuda")]
    Cuda(usize),
}

/// What the runtime calls an adapter; everything on the same runtime shares the started device.
#[derive(Debug, Clone)]
pub enum Runtime {
    /// Through Vulkan, Metal or DX12.
    Wgpu(WgpuDevice),
    /// By CUDA: the driver's number.
    #[cfg(feature = "cuda")]
    Cuda(usize),
}

impl Adapter {
    /// Returns the runtime's name.
    pub fn runtime(&self) -> Runtime {
        let (slot, nth) = match self.place {
            Place::Wgpu(slot, nth) => (slot, nth),
            #[cfg(feature = "cuda")]
            Place::Cuda(ordinal) => return Runtime::Cuda(ordinal),
        };
        let api = match self.api.as_str() {
            "Vulkan" => WgpuBackend::Vulkan,
            "Metal" => WgpuBackend::Metal,
            _ => WgpuBackend::Dx12,
        };
        let kind = match slot {
            0 => WgpuDeviceKind::DiscreteGpu(nth),
            1 => WgpuDeviceKind::IntegratedGpu(nth),
            2 => WgpuDeviceKind::VirtualGpu(nth),
            3 => WgpuDeviceKind::Cpu,
            _ => WgpuDeviceKind::Other(nth),
        };
        Runtime::Wgpu(WgpuDevice::new(kind).on(api))
    }
}

/// Units a cube that the kernels need.
const UNITS: u32 = 256;
/// Bytes shared by a cube that the kernels need.
const SHARED_BYTES: u32 = 13_840;

/// The adapters of this machine in the order of their index, on the first of Vulkan, Metal and DX12
/// that has more than software; where none has, software on the first that has any. Before them
/// those of CUDA, in a build with the feature `cuda`: a GPU can be there twice. Empty without a
/// driver. They are looked for once per process.
pub fn adapters() -> &'static [Adapter] {
    static ALL: OnceLock<Vec<Adapter>> = OnceLock::new();
    ALL.get_or_init(find_adapters)
}

fn find_adapters() -> Vec<Adapter> {
    #[cfg(feature = "cuda")]
    let mut all = crate::gpu::cuda::adapters();
    #[cfg(not(feature = "cuda"))]
    let mut all = Vec::new();
    all.extend(graphics_adapters());
    for (index, adapter) in all.iter_mut().enumerate() {
        adapter.index = index;
    }
    all
}

/// What CUDA needs at run time and this machine does not have, and how to get it; `None` if it is
/// all there, and in builds without the feature `cuda`.
pub fn missing_for_cuda() -> Option<String> {
    #[cfg(feature = "cuda")]
    return crate::gpu::cuda::missing();
    #[cfg(not(feature = "cuda"))]
    None
}

fn graphics_adapters() -> Vec<Adapter> {
    let mut software_only = None;
    for backend in [
        wgpu::Backends::VULKAN,
        wgpu::Backends::METAL,
        wgpu::Backends::DX12,
    ] {
        let adapters = adapters_of(backend);
        if adapters.iter().any(|a| a.kind != AdapterKind::Software) {
            return adapters;
        }
        if !adapters.is_empty() {
            software_only.get_or_insert(adapters);
        }
    }
    software_only.unwrap_or_default()
}

fn adapters_of(backend: wgpu::Backends) -> Vec<Adapter> {
    let mut settings = wgpu::InstanceDescriptor::new_without_display_handle();
    settings.backends = backend;
    let instance = wgpu::Instance::new(settings);
    let adapters = block_on(instance.enumerate_adapters(backend));
    // with its last instance a driver is unloaded, and threads that used NVIDIA's crash when they
    // end
    INSTANCES
        .lock()
        .unwrap_or_else(PoisonError::into_inner)
        .push(instance);
    let mut counts = [0usize; 5];
    let mut out = Vec::new();
    for (index, adapter) in adapters.iter().enumerate() {
        let (info, limits) = (adapter.get_info(), adapter.limits());
        let (kind, slot) = match info.device_type {
            DeviceType::DiscreteGpu => (AdapterKind::Discrete, 0),
            DeviceType::IntegratedGpu => (AdapterKind::Integrated, 1),
            DeviceType::VirtualGpu => (AdapterKind::Virtual, 2),
            DeviceType::Cpu => (AdapterKind::Software, 3),
            DeviceType::Other => (AdapterKind::Other, 4),
        };
        let (max_units, max_shared_bytes) = (
            limits.max_compute_invocations_per_workgroup,
            limits.max_compute_workgroup_storage_size,
        );
        out.push(Adapter {
            index,
            name: info.name.clone(),
            kind,
            api: format!("{:?}", info.backend),
            driver: format!("{} {}", info.driver, info.driver_info)
                .trim()
                .to_owned(),
            max_buffer_bytes: limits
                .max_storage_buffer_binding_size
                .min(limits.max_buffer_size),
            max_units,
            max_shared_bytes,
            unfit: unfit(max_units, max_shared_bytes),
            place: Place::Wgpu(slot, counts[usize::from(slot)]),
        });
        counts[usize::from(slot)] += 1;
    }
    out
}

/// Why kernels cannot run with this many units and bytes per cube, if they cannot.
pub(crate) fn unfit(max_units: u32, max_shared_bytes: u32) -> Option<String> {
    if max_units < UNITS {
        Some(format!("{max_units} units a cube, {UNITS} are needed"))
    } else if max_shared_bytes < SHARED_BYTES {
        Some(format!(
            "{max_shared_bytes} bytes shared by a cube, {SHARED_BYTES} are needed"
        ))
    } else {
        None
    }
}

/// The best adapter that is fit and more than software: discrete before integrated before virtual,
/// and the first of those.
pub fn best(adapters: &[Adapter]) -> Option<&Adapter> {
    let rank = |a: &&Adapter| match a.kind {
        AdapterKind::Discrete => 0,
        AdapterKind::Integrated => 1,
        AdapterKind::Virtual => 2,
        AdapterKind::Other => 3,
        AdapterKind::Software => 4,
    };
    let of_use = |a: &&Adapter| a.kind != AdapterKind::Software && a.unfit.is_none();
    adapters.iter().filter(of_use).min_by_key(rank)
}

/// The one that is chosen where the user does not choose: the best, if it is a card of its own.
/// Others have not been measured.
pub fn automatic(adapters: &[Adapter]) -> Option<&Adapter> {
    best(adapters).filter(|a| a.kind == AdapterKind::Discrete)
}

/// The choice of a GPU.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Choice {
    /// The best that is not software.
    Best,
    /// The one of that index in [`adapters`], software or not.
    Index(usize),
    /// The first software adapter: for tests.
    Software,
}

/// A GPU that is ready for work. Clones share it.
#[derive(Clone)]
pub struct Gpu {
    /// The runtime's queue.
    pub client: Client,
    adapter: Adapter,
    pub(super) inputs: Inputs,
}

impl std::fmt::Debug for Gpu {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_tuple("Gpu").field(&self.adapter.name).finish()
    }
}

impl Gpu {
    /// Starts the adapter that `choice` names. Fails with [`GpuError::NoAdapter`] if there is none,
    /// [`GpuError::NotStarted`] if it is unfit or its driver refuses.
    pub fn open(choice: Choice) -> Result<Self, GpuError> {
        let all = adapters();
        let (wanted, adapter) = match choice {
            Choice::Best => ("that is more than software".to_owned(), best(all)),
            Choice::Index(index) => (index.to_string(), all.get(index)),
            Choice::Software => (
                "made of software".to_owned(),
                all.iter().find(|a| a.kind == AdapterKind::Software),
            ),
        };
        let Some(adapter) = adapter else {
            let names: Vec<String> = all
                .iter()
                .map(|a| format!("{}: {}", a.index, a.name))
                .collect();
            let list = if names.is_empty() {
                "none".to_owned()
            } else {
                names.join(", ")
            };
            return Err(GpuError::NoAdapter {
                wanted,
                found: list,
            });
        };
        Self::start(adapter)
    }

    /// Starts the GPU for tests: the one whose index in [`adapters`] the variable
    /// `MINUTE4D_TEST_GPU` holds, else the best, else a software driver. Fails as
    /// [`open`](Self::open).
    pub fn for_tests() -> Result<Self, GpuError> {
        let Ok(index) = std::env::var("MINUTE4D_TEST_GPU") else {
            return Self::open(Choice::Best).or_else(|_| Self::open(Choice::Software));
        };
        // what is no number is no index of an adapter
        Self::open(Choice::Index(index.parse().unwrap_or(usize::MAX)))
    }

    fn start(adapter: &Adapter) -> Result<Self, GpuError> {
        let refused = |why: String| GpuError::NotStarted {
            name: adapter.name.clone(),
            why,
        };
        if let Some(why) = &adapter.unfit {
            return Err(refused(why.clone()));
        }
        #[cfg(feature = "cuda")]
        if let Runtime::Cuda(ordinal) = adapter.runtime() {
            let client = crate::gpu::cuda::start(ordinal).map_err(refused)?;
            return Ok(Self {
                client,
                adapter: adapter.clone(),
                inputs: Inputs::default(),
            });
        }
        #[cfg_attr(
            not(feature = "cuda"),
            expect(irrefutable_let_patterns, reason = "CUDA is the other one")
        )]
        let Runtime::Wgpu(device) = adapter.runtime() else {
            return Err(refused("it belongs to no runtime of this build".to_owned()));
        };
        // a device of this process is started once; the second time it is there already
        let mut started = STARTED.lock().unwrap_or_else(PoisonError::into_inner);
        if !started.contains(&adapter.place) {
            try_init_setup::<AutoGraphicsApi>(&device, RuntimeOptions::default())
                .map_err(|error| refused(error.to_string()))?;
            started.push(adapter.place);
        }
        Ok(Self {
            client: Device::Wgpu(device).client(),
            adapter: adapter.clone(),
            inputs: Inputs::default(),
        })
    }

    /// The kind.
    pub fn adapter(&self) -> &Adapter {
        &self.adapter
    }

    /// Whether a buffer of `bytes` is allowed. Fails with [`GpuError::TooLarge`] if it is not.
    pub fn fits(&self, what: &'static str, bytes: usize) -> Result<(), GpuError> {
        let limit = self.adapter.max_buffer_bytes as usize;
        if bytes <= limit {
            return Ok(());
        }
        Err(GpuError::TooLarge {
            what,
            needed: bytes.div_ceil(1_000_000),
            limit: limit / 1_000_000,
            name: self.adapter.name.clone(),
        })
    }

    /// Waits for everything that was asked for. Fails with [`GpuError::Failed`] with what went
    /// wrong on the way.
    pub fn wait(&self, doing: &'static str) -> Result<(), GpuError> {
        block_on(self.client.sync()).map_err(|error| failed(doing, &error))
    }
}

/// Of all drivers that were asked for adapters; kept as long as the process runs.
static INSTANCES: Mutex<Vec<wgpu::Instance>> = Mutex::new(Vec::new());
static STARTED: Mutex<Vec<Place>> = Mutex::new(Vec::new());

pub(crate) fn failed(doing: &'static str, error: &impl std::fmt::Display) -> GpuError {
    GpuError::Failed {
        doing,
        why: error.to_string(),
    }
}

/// Waits for a future that needs no runtime.
fn block_on<F: Future>(future: F) -> F::Output {
    cubecl::future::block_on(future)
}

#[cfg(test)]
pub(crate) mod tests {
    use super::Gpu;

    /// A GPU, or a software Vulkan driver (lavapipe); `None`, and said so, where there is neither.
    #[track_caller]
    pub(crate) fn gpu(test: &str) -> Option<Gpu> {
        match Gpu::for_tests() {
            Ok(gpu) => Some(gpu),
            Err(error) => {
                m4_testkit::skip(m4_testkit::Need::Vulkan, &format!("{test}: {error}"));
                None
            }
        }
    }
}

/// Memory of the device that is this process's, bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub struct DeviceMemory {
    /// Of buffers that are in use now.
    pub in_use: u64,
    /// Taken from the driver: buffers, what is kept for those to come, staging. It rarely shrinks,
    /// so that it is close to the most that was ever taken.
    pub reserved: u64,
}

impl Gpu {
    /// What the runtime says that this process holds on the device.
    pub fn memory(&self) -> DeviceMemory {
        let usage = self.client.memory_report(MemoryScope::Device).usage();
        DeviceMemory {
            in_use: usage.bytes_in_use,
            reserved: usage.bytes_reserved,
        }
    }

    /// Gives what is in no buffer back to the driver, as far as the runtime does.
    /// Fails with [`GpuError::Failed`] if the device failed.
    pub fn give_back(&self) -> Result<(), GpuError> {
        let doing = "giving memory back";
        self.inputs.clear();
        self.wait(doing)?;
        self.client
            .memory_cleanup()
            .map_err(|error| failed(doing, &error))
    }

    /// Whether kernels are timed by the device's own clock.
    pub fn has_own_clock(&self) -> bool {
        self.client.properties().timing_method == TimingMethod::Device
    }
}
