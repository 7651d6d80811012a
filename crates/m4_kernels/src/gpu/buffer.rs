//! Memory on the device.

use crate::gpu::GpuError;
use crate::gpu::device::failed;
use crate::launch;
use cubecl::prelude::*;
use cubecl::server::Handle;

/// Numbers of four bytes on the device. Clones share them.
#[derive(Clone, Debug)]
pub struct Buffer {
    handle: Handle,
    len: usize,
}

impl Buffer {
    /// Room for `len` numbers (at least one), which hold anything.
    pub fn empty(client: &Client, len: usize) -> Self {
        let len = len.max(1);
        Self {
            handle: client.empty(4 * len),
            len,
        }
    }

    /// A copy of `values`.
    pub fn floats(client: &Client, values: &[f32]) -> Self {
        if values.is_empty() {
            return Self::empty(client, 1);
        }
        Self {
            handle: client.create_from_slice(f32::as_bytes(values)),
            len: values.len(),
        }
    }

    /// `len` zeros.
    pub fn zeros(client: &Client, len: usize) -> Self {
        let out = Self::empty(client, len);
        out.clear(client);
        out
    }

    /// Sets every number to 0.
    pub fn clear(&self, client: &Client) {
        launch!(
            client,
            clear::launch,
            (cubes(self.len, 256), units()),
            [self]
        );
    }

    /// A copy of `values`.
    pub fn words(client: &Client, values: &[u32]) -> Self {
        if values.is_empty() {
            return Self::empty(client, 1);
        }
        Self {
            handle: client.create_from_slice(u32::as_bytes(values)),
            len: values.len(),
        }
    }

    /// Numbers.
    #[expect(clippy::len_without_is_empty, reason = "there is at least one number")]
    pub fn len(&self) -> usize {
        self.len
    }

    /// Returns the argument for a kernel.
    #[expect(unsafe_code, reason = "the runtime takes the length on trust")]
    pub fn arg(&self) -> BufferArg {
        // SAFETY: `handle` was made with room for `len` numbers of four bytes, and neither changes.
        unsafe { BufferArg::from_raw_parts(self.handle.clone(), self.len) }
    }

    /// Waits for what was asked for and copies it to the host. Fails with [`GpuError`] if the
    /// device failed.
    pub fn read_floats(&self, client: &Client, doing: &'static str) -> Result<Vec<f32>, GpuError> {
        let bytes = client
            .read_one(self.handle.clone())
            .map_err(|error| failed(doing, &error))?;
        Ok(f32::from_bytes(&bytes)[..self.len].to_vec())
    }

    /// Waits for what was asked for and copies it to the host. Fails with [`GpuError`] if the
    /// device failed.
    pub fn read_words(&self, client: &Client, doing: &'static str) -> Result<Vec<u32>, GpuError> {
        let bytes = client
            .read_one(self.handle.clone())
            .map_err(|error| failed(doing, &error))?;
        Ok(u32::from_bytes(&bytes)[..self.len].to_vec())
    }
}

/// In place of an index where there is none: of the row of splats that start from nothing.
pub const NOTHING: u32 = u32::MAX;

/// Launches a kernel: the client, the kernel, cubes and units of a cube, its [`Buffer`]s, and what
/// follows them.
#[macro_export]
macro_rules! launch {
    ($client:expr, $kernel:path, ($cubes:expr, $units:expr), [$($buffer:expr),* $(,)?] $(, [$($value:expr),* $(,)?])? $(,)?) => {
        $kernel($client, $cubes, $units, $($buffer.arg(),)* $($($value),*)?)
    };
}

/// As many cubes as `n` things take where each does `per`. One dimension ends at 65,535.
pub fn cubes(n: usize, per: usize) -> CubeCount {
    let count = u32::try_from(n.div_ceil(per).max(1)).unwrap_or(u32::MAX);
    let y = count.div_ceil(65_535);
    CubeCount::Static(count.div_ceil(y), y, 1)
}

/// Cubes of 256 units in a row.
pub fn units() -> CubeDim {
    CubeDim::new_1d(256)
}

#[cube(launch)]
fn clear(values: &mut [u32]) {
    if ABSOLUTE_POS < values.len() {
        values[ABSOLUTE_POS] = 0u32;
    }
}
