//! Rows to rows of a table (`scatter.cu`). libtorch's operations for it wait for the GPU where it is to be deterministic,
//! and cannot be recorded then.

use super::map::{address, int, launch};
use crate::ffi::cuda::{Argument, CudaError, Kernel, Module};
use tch::{Kind, Tensor};

const THREADS: u32 = 256;
/// The kernel moves words of this, bytes.
const ALIGNMENT: usize = 16;

#[derive(Debug)]
pub struct ScatterKernel(Kernel);

impl ScatterKernel {
    /// Compiles it for the first CUDA device, where libtorch must have made a tensor before.
    pub fn compile() -> Result<Self, CudaError> {
        let module = Module::compile(include_str!("scatter.cu"), "scatter.cu")?;
        Ok(Self(module.kernel(c"scatter", 0)?))
    }

    /// Writes the rows of a tensor \[rows, …\] to the rows `to` (i64 \[rows\]) of a table \[.., …\]; several may go to a row
    /// that nobody reads.
    ///
    /// # Safety
    /// When this runs, `to` must hold rows of the table.
    pub unsafe fn rows(&self, from: &Tensor, to: &Tensor, table: &Tensor) {
        let rows = from.size()[0];
        assert!(to.kind() == Kind::Int64 && to.size() == [rows] && to.is_contiguous());
        self.launch(from, address(to), table);
    }

    /// Writes them to a tensor of the same size, which may be pinned memory of the host.
    pub fn copy(&self, from: &Tensor, to: &Tensor) {
        assert_eq!(from.size(), to.size());
        self.launch(from, Argument::Address(0), to);
    }

    fn launch(&self, from: &Tensor, to: Argument, table: &Tensor) {
        assert!(from.kind() == table.kind() && from.size()[1..] == table.size()[1..], "rows of the same kind");
        assert!([from, table].iter().all(|tensor| tensor.is_contiguous()), "a row after the other");
        assert!([from, table].iter().all(|tensor| (tensor.data_ptr() as usize).is_multiple_of(ALIGNMENT)));
        let rows = from.size()[0];
        let bytes = from.numel() / rows as usize * from.kind().elt_size_in_bytes();
        if bytes > 0 {
            launch(self.0, rows, THREADS, &[address(from), to, address(table), int(bytes as i64)]);
        }
    }
}
