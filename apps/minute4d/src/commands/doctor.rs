//! `minute4d doctor`: describes the machine, and notes what limits the program on it.

use crate::failure::Failure;
use crate::output::Output;
use serde::Serialize;
use std::process::{Command, Stdio};
use sysinfo::System;

/// Free memory below which a note is printed, bytes.
const LITTLE_MEMORY: u64 = 2 << 30;

#[derive(Debug, Serialize)]
struct Machine {
    minute4d: &'static str,
    platform: String,
    cpu: Option<String>,
    cores: Option<usize>,
    threads: usize,
    simd: String,
    simd_available: Vec<&'static str>,
    memory: Option<Memory>,
    ffmpeg: Ffmpeg,
    gpus: Vec<GpuAdapter>,
    /// The recommended weights of networks; none in a build without networks.
    weights: Vec<Weights>,
    notes: Vec<String>,
}

#[derive(Debug, Serialize)]
struct GpuAdapter {
    index: usize,
    name: String,
    kind: String,
    api: String,
    driver: String,
    max_buffer_bytes: u64,
    max_shared_bytes: u32,
    max_units: u32,
    /// Why `--device auto` does not choose it.
    not_chosen: Option<String>,
}

#[derive(Debug, Serialize)]
struct Weights {
    name: &'static str,
    megabytes: u32,
    used_for: &'static str,
    installed: bool,
}

#[derive(Debug, Serialize)]
struct Memory {
    total_bytes: u64,
    available_bytes: u64,
}

#[derive(Debug, Serialize)]
struct Ffmpeg {
    found: bool,
    version: Option<String>,
}

pub fn run(output: &Output) -> Result<(), Failure> {
    let machine = examine()?;
    Ok(output.result(describe(&machine), &machine)?)
}

fn examine() -> Result<Machine, Failure> {
    // Values that the system does not report are omitted.
    let system = System::new().ok().map(|mut system| {
        system.refresh_memory();
        system
    });
    let simd = m4_kernels::SimdLevel::detect().map_err(minute4d::Error::from)?;
    let mut machine = Machine {
        minute4d: env!("CARGO_PKG_VERSION"),
        platform: format!("{}-{}", std::env::consts::ARCH, std::env::consts::OS),
        cpu: processor(),
        cores: System::physical_core_count().ok(),
        threads: crate::run::threads(),
        simd: simd.name().to_owned(),
        simd_available: m4_kernels::SimdLevel::available()
            .iter()
            .map(|l| l.name())
            .collect(),
        memory: system.map(|s| Memory {
            total_bytes: s.total_memory(),
            available_bytes: s.available_memory(),
        }),
        ffmpeg: ffmpeg(),
        gpus: gpus(),
        weights: weights(),
        notes: Vec::new(),
    };
    machine.notes = notes(&machine);
    Ok(machine)
}

/// Returns the name of the processor, where the system says it.
pub fn processor() -> Option<String> {
    let mut system = System::new().ok()?;
    system.refresh_cpu_all();
    let brand = system.cpus().first()?.brand().trim().to_owned();
    (!brand.is_empty()).then_some(brand)
}

fn ffmpeg() -> Ffmpeg {
    let output = Command::new("ffmpeg")
        .arg("-version")
        .stdin(Stdio::null())
        .output();
    let text = output
        .ok()
        .filter(|o| o.status.success())
        .map(|o| String::from_utf8_lossy(&o.stdout).into_owned());
    let version = text.as_deref().and_then(|text| {
        let rest = text.lines().next()?.strip_prefix("ffmpeg version ")?;
        rest.split_whitespace().next().map(str::to_owned)
    });
    Ffmpeg {
        found: text.is_some(),
        version,
    }
}

#[cfg(feature = "gpu")]
fn gpus() -> Vec<GpuAdapter> {
    use m4_kernels::gpu::{AdapterKind, adapters};
    let all = adapters();
    let chosen = m4_kernels::gpu::automatic(all).map(|a| a.index);
    let why = |a: &m4_kernels::gpu::Adapter| match (&a.unfit, a.kind) {
        (Some(unfit), _) => Some(unfit.clone()),
        (None, AdapterKind::Software) => {
            Some("software rendering, slower than --device cpu".to_owned())
        }
        (None, kind) if kind != AdapterKind::Discrete => {
            Some("not measured; --device gpu uses it".to_owned())
        }
        (None, _) if chosen != Some(a.index) => Some("another GPU is better".to_owned()),
        _ => None,
    };
    all.iter()
        .map(|a| GpuAdapter {
            index: a.index,
            name: a.name.clone(),
            kind: format!("{:?}", a.kind).to_lowercase(),
            api: a.api.clone(),
            driver: a.driver.clone(),
            max_buffer_bytes: a.max_buffer_bytes,
            max_shared_bytes: a.max_shared_bytes,
            max_units: a.max_units,
            not_chosen: why(a),
        })
        .collect()
}

#[cfg(not(feature = "gpu"))]
fn gpus() -> Vec<GpuAdapter> {
    Vec::new()
}

/// The recommended weights.
#[cfg(feature = "nets")]
fn weights() -> Vec<Weights> {
    let (Ok(store), Ok(entries)) = (
        minute4d::weights::Store::of_user(),
        minute4d::weights::select("recommended"),
    ) else {
        return Vec::new();
    };
    let state = |entry: &minute4d::weights::Entry| Weights {
        name: entry.name,
        megabytes: entry.megabytes,
        used_for: entry.used_for,
        installed: store.installed(entry).is_some(),
    };
    entries.into_iter().map(state).collect()
}

#[cfg(not(feature = "nets"))]
fn weights() -> Vec<Weights> {
    Vec::new()
}

fn notes(machine: &Machine) -> Vec<String> {
    let mut notes = Vec::new();
    let parts = [
        (cfg!(feature = "gpu"), "GPU support"),
        (cfg!(feature = "nets"), "networks"),
    ];
    let missing: Vec<&str> = parts
        .iter()
        .filter(|(built, _)| !built)
        .map(|(_, part)| *part)
        .collect();
    if !missing.is_empty() {
        notes.push(format!(
            "this program was built without {}; `{}` builds it with both",
            missing.join(" and "),
            crate::BUILD_FULL
        ));
    }
    if cfg!(feature = "gpu") && machine.gpus.is_empty() {
        notes.push(
            "no GPU was found through Vulkan, Metal, DX12 or OpenGL; if there is one, its driver is missing".to_owned(),
        );
    }
    let absent: Vec<String> = machine
        .weights
        .iter()
        .filter(|weights| !weights.installed)
        .map(|w| format!("{} ({} MB) for {}", w.name, w.megabytes, w.used_for))
        .collect();
    if !absent.is_empty() {
        notes.push(format!(
            "`minute4d weights fetch recommended` gets {}",
            absent.join(", and ")
        ));
    }
    #[cfg(feature = "cuda")]
    notes.extend(m4_kernels::gpu::missing_for_cuda());
    if !machine.ffmpeg.found {
        notes.push(
            "no ffmpeg: 8-bit H.264 in MP4 or MOV works without it; HEVC, AV1, VP9 and others need it \
             (apt, brew or winget install ffmpeg)"
                .to_owned(),
        );
    }
    if machine
        .memory
        .as_ref()
        .is_some_and(|m| m.available_bytes < LITTLE_MEMORY)
    {
        notes.push("little free memory: reduce clips with --max-frames and --size".to_owned());
    }
    if machine.simd == "sse2" || machine.simd == "portable" {
        notes.push(
            "no wide vector instructions (AVX2 or better): training is several times slower"
                .to_owned(),
        );
    }
    notes
}

fn describe_gpu(gpu: &GpuAdapter) -> String {
    let limits = format!(
        "{} ({}, {}, {}); buffers up to {} MB, {} threads per workgroup with {} kB of shared memory",
        gpu.name,
        gpu.kind,
        gpu.api,
        gpu.driver,
        gpu.max_buffer_bytes / 1_000_000,
        gpu.max_units,
        gpu.max_shared_bytes / 1000
    );
    let chosen = match &gpu.not_chosen {
        Some(why) => format!("not chosen by --device auto: {why}"),
        None => "chosen by --device auto".to_owned(),
    };
    format!("{}: {limits}; {chosen}", gpu.index)
}

fn describe(machine: &Machine) -> String {
    let gib = |bytes: u64| bytes as f64 / f64::from(1u32 << 30);
    let ffmpeg = match (&machine.ffmpeg.version, machine.ffmpeg.found) {
        (Some(version), _) => version.clone(),
        (None, true) => "found, version unknown".to_owned(),
        (None, false) => "not found".to_owned(),
    };
    let unknown = || "unknown".to_owned();
    let cores = machine.cores.map_or_else(unknown, |n| n.to_string());
    let memory = machine.memory.as_ref().map_or_else(unknown, |m| {
        let (all, free) = (gib(m.total_bytes), gib(m.available_bytes));
        format!("{all:.1} GiB, {free:.1} GiB free")
    });
    let cpu = machine.cpu.clone().unwrap_or_else(unknown);
    let (simd, available) = (&machine.simd, machine.simd_available.join(", "));
    let mut rows = vec![
        (
            "minute4d",
            format!("{} on {}", machine.minute4d, machine.platform),
        ),
        (
            "processor",
            format!("{cpu}, {cores} cores, {} threads used", machine.threads),
        ),
        ("instructions", format!("{simd} (available: {available})")),
        ("memory", memory),
        ("ffmpeg", ffmpeg),
    ];
    rows.extend(machine.gpus.iter().map(|gpu| ("gpu", describe_gpu(gpu))));
    rows.extend(machine.weights.iter().map(|weights| {
        let state = if weights.installed {
            "installed"
        } else {
            "not installed"
        };
        ("weights", format!("{}: {state}", weights.name))
    }));
    rows.extend(machine.notes.iter().map(|note| ("note", note.clone())));
    let lines = rows
        .iter()
        .map(|(name, text)| format!("{name:<13} {text}\n"));
    lines.collect()
}
