//! Rows to rows of a table, and rows of bytes from wherever they are (`rows.cu`). libtorch's operations for the first
//! wait for the GPU where it is to be deterministic, and cannot be recorded then.

use super::map::{address, int, launch};
use crate::ffi::cuda::{Argument, CudaError, Kernel, Module};
use std::ops::Range;
use tch::{Kind, Tensor};

const THREADS: u32 = 256;

#[derive(Debug)]
pub struct RowKernels {
    scatter: Kernel,
    gather: Kernel,
}

impl RowKernels {
    /// Compiles them for the first CUDA device, where libtorch must have made a tensor before.
    pub fn compile() -> Result<Self, CudaError> {
        let module = Module::compile(include_str!("rows.cu"), "rows.cu")?;
        Ok(Self { scatter: module.kernel(c"scatter", 0)?, gather: module.kernel(c"gather", 0)? })
    }

    /// Writes what lies at the addresses `from` (i64 \[rows\]) to these bytes of each row of a table u8 \[rows, bytes\].
    ///
    /// # Safety
    /// When this runs, as many bytes must be there, in memory that the device may read.
    pub unsafe fn gather(&self, from: &Tensor, bytes: Range<usize>, table: &Tensor) {
        let (rows, stride) = table.size2().expect("a row of bytes each");
        assert!(from.kind() == Kind::Int64 && from.size() == [rows] && from.is_contiguous());
        assert!(table.kind() == Kind::Uint8 && table.is_contiguous() && bytes.end as i64 <= stride);
        let numbers = [stride, bytes.start as i64, bytes.len() as i64].map(int);
        launch(self.gather, rows, THREADS, &[&[address(from), address(table)], &numbers[..]].concat());
    }

    /// Writes the rows of a tensor \[rows, …\] to the rows `to` (i64 \[rows\]) of a table \[.., …\]; several may go to a row
    /// that nobody reads.
    ///
    /// # Safety
    /// When this runs, `to` must hold rows of the table.
    pub unsafe fn scatter(&self, from: &Tensor, to: &Tensor, table: &Tensor) {
        let rows = from.size()[0];
        assert!(to.kind() == Kind::Int64 && to.size() == [rows] && to.is_contiguous());
        self.launch_scatter(from, address(to), table);
    }

    /// Writes them to a tensor of the same size, which may be pinned memory of the host.
    pub fn copy(&self, from: &Tensor, to: &Tensor) {
        assert_eq!(from.size(), to.size());
        self.launch_scatter(from, Argument::Address(0), to);
    }

    fn launch_scatter(&self, from: &Tensor, to: Argument, table: &Tensor) {
        assert!(from.kind() == table.kind() && from.size()[1..] == table.size()[1..], "rows of the same kind");
        assert!([from, table].iter().all(|tensor| tensor.is_contiguous()), "a row after the other");
        let rows = from.size()[0];
        let bytes = from.numel() / rows as usize * from.kind().elt_size_in_bytes();
        if bytes > 0 {
            launch(self.scatter, rows, THREADS, &[address(from), to, address(table), int(bytes as i64)]);
        }
    }
}
