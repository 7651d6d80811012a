//! Stand-in for the crate of this name: the types that `cubecl-cuda` names, without LLVM. See the README.

use cubecl_core::ir::nvidia::SmArch;
use cubecl_core::prelude::KernelDefinition;
use cubecl_runtime::compiler::{CompilationError, Compiler};
use cubecl_runtime::kernel::BufferIOAttr;

/// Kernels by LLVM to the code of NVIDIA's virtual machine.
pub mod nvptx {
    /// Versions of that code.
    pub mod ptx_version {
        /// A version. There is none here.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
        pub enum PtxVersion {}

        impl PtxVersion {
            /// The newest that a driver reads: none is written here.
            pub fn for_driver(_: i32) -> Option<Self> {
                None
            }
        }

        impl core::fmt::Display for PtxVersion {
            fn fmt(&self, _: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
                match *self {}
            }
        }
    }
}

/// What all targets of LLVM share.
pub mod shared {
    /// What LLVM's path can do.
    pub mod lowered_features {
        /// A kind of GPU.
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub enum GpuTarget {
            /// NVIDIA.
            Nvptx,
        }

        /// Takes away what LLVM's path cannot do: nothing, since that path does nothing.
        pub fn restrict_features(_: &mut cubecl_core::ir::DeviceProperties, _: GpuTarget) {}
    }
}

/// What LLVM writes code for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum LlvmTarget {
    /// NVIDIA.
    #[default]
    Nvptx,
}

/// Refuses every kernel.
#[derive(Clone, Debug)]
pub struct PlironCompiler {
    /// What for.
    pub target: LlvmTarget,
}

/// A kernel's code.
#[derive(Clone, Debug)]
pub struct NvptxModule {
    /// With a 0 at the end.
    pub ptx: Vec<core::ffi::c_char>,
    /// Name of the kernel.
    pub entrypoint: String,
    /// As text.
    pub ir: String,
    /// Bytes.
    pub shared_memory_size: usize,
    /// Which buffers are read and written.
    pub io: Vec<BufferIOAttr>,
}

/// What LLVM would be told.
#[derive(Debug, Default)]
pub struct PlironOptions {
    /// An AMD device.
    pub arch: Option<cubecl_core::ir::amd::GfxArch>,
    /// An NVIDIA device.
    pub sm_arch: Option<SmArch>,
    /// For a driver.
    pub ptx_version: Option<nvptx::ptx_version::PtxVersion>,
    /// How parameters are passed.
    pub grid_constants: bool,
}

/// What LLVM would make.
#[derive(Clone)]
pub enum PlironArtifact {
    /// For NVIDIA.
    NvptxCode(NvptxModule),
    /// For others.
    Other,
}

impl core::fmt::Display for PlironArtifact {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str("nothing: this build has no LLVM")
    }
}

impl Compiler for PlironCompiler {
    type Representation = PlironArtifact;
    type CompilationOptions = PlironOptions;

    fn compile(&mut self, _: KernelDefinition, _: &PlironOptions) -> Result<PlironArtifact, CompilationError> {
        Err(CompilationError::Generic {
            reason: "this build has no LLVM: cubecl's feature cuda-cpp compiles kernels without".to_owned(),
            backtrace: cubecl_environment::backtrace::BackTrace::capture(),
        })
    }

    fn extension(&self) -> &'static str {
        "ll"
    }

    fn lang_tag(&self) -> &'static str {
        "llvm"
    }
}
