//! Programs are compiled for x86-64-v3. On a processor that lacks it they would die of an illegal instruction, wherever
//! the compiler happened to use one; [`require_processor!`](crate::require_processor) ends them before that with a
//! sentence.

/// Makes this program check the processor before anything else runs.
///
/// The check uses only instructions of every x86-64 processor and calls nothing, because compiled Rust code may already
/// contain the missing instructions. Needed are AVX2, FMA and BMI2, and a system that saves AVX's registers.
#[macro_export]
macro_rules! require_processor {
    () => {
        #[cfg(all(target_arch = "x86_64", target_os = "linux"))]
        mod processor_is_looked_at {
            std::arch::global_asm!(
                ".pushsection .text.stillroom_processor, \"ax\", @progbits",
                "stillroom_processor:",
                "push rbx",
                // OSXSAVE (bit 27) and FMA (12)
                "mov eax, 1",
                "xor ecx, ecx",
                "cpuid",
                "and ecx, 0x08001000",
                "cmp ecx, 0x08001000",
                "jne 2f",
                // the system keeps xmm and ymm registers
                "xor ecx, ecx",
                "xgetbv",
                "and eax, 6",
                "cmp eax, 6",
                "jne 2f",
                // AVX2 (bit 5) and BMI2 (8); there is a leaf 7
                "xor eax, eax",
                "cpuid",
                "cmp eax, 7",
                "jb 2f",
                "mov eax, 7",
                "xor ecx, ecx",
                "cpuid",
                "and ebx, 0x120",
                "cmp ebx, 0x120",
                "jne 2f",
                "pop rbx",
                "ret",
                // write(2, sentence), exit_group(1)
                "2:",
                "mov eax, 1",
                "mov edi, 2",
                "lea rsi, [rip + 3f]",
                "lea rdx, [rip + 4f]",
                "sub rdx, rsi",
                "syscall",
                "mov eax, 231",
                "mov edi, 1",
                "syscall",
                "hlt",
                "3:",
                ".ascii \"error: this processor has no AVX2, FMA or BMI2, which Stillroom's programs are compiled for. Use \"",
                ".ascii \"a machine of 2015 or later; in a virtual machine, let the guest see the host's processor (for \"",
                ".ascii \"example QEMU's -cpu host).\\n\"",
                "4:",
                ".popsection",
                // Before Rust's own start, and before the constructors of libraries linked into the program.
                ".pushsection .preinit_array, \"aw\"",
                ".balign 8",
                ".quad stillroom_processor",
                ".popsection",
            );
        }
    };
}
