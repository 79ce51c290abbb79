/* What the C++ of a newer compiler calls, and glibc 2.28 and the libstdc++ of its time (GCC 8) do not have. Linked into
 * the learner of a release. Nothing of it is visible to libraries. */
#pragma GCC visibility push(hidden)

/* glibc 2.32: whether the process has one thread, so that counters need not be atomic. 0: they are. */
char __libc_single_threaded = 0;

/* GCC 12: std::__throw_bad_array_new_length(). Before it, the same function was the C++ ABI's alone. */
__attribute__((visibility("default"))) void __cxa_throw_bad_array_new_length(void);
void _ZSt28__throw_bad_array_new_lengthv(void) { __cxa_throw_bad_array_new_length(); }

/* GCC 9: std::ostringstream(). Before it, this constructor was the one with a mode, which was std::ios_base::out. */
__attribute__((visibility("default"))) void
_ZNSt7__cxx1119basic_ostringstreamIcSt11char_traitsIcESaIcEEC1ESt13_Ios_Openmode(void *self, int mode);
void _ZNSt7__cxx1119basic_ostringstreamIcSt11char_traitsIcESaIcEEC1Ev(void *self) {
    enum { OUT = 1 << 4 };
    _ZNSt7__cxx1119basic_ostringstreamIcSt11char_traitsIcESaIcEEC1ESt13_Ios_Openmode(self, OUT);
}

#pragma GCC visibility pop
