// The same bits on every x86-64 processor. libtorch and its libraries choose their kernels by the processor, unless
// environment variables fix the choice. They read these variables at their first computation. So a program that links
// this file sets them before `main`; `stillroom_use_fastest` restores the old values.
//
// No variable fixes matrix products and square roots, so these are our own (product.cpp, and below).

#include "arithmetic.h"
#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <cstring>
#include <dlfcn.h>

namespace {
struct Pin {
    const char *variable, *value;
    const char *before; // a copy of what the environment held, or null
};

// ATen, oneDNN (convolutions) and MKL (exponentials, logarithms, hyperbolic tangents).
Pin pins[] = {
#if defined(__aarch64__)
    // NEON: some processors have SVE, whose vectors and so sums are others.
    {"ATEN_CPU_CAPABILITY", "default", nullptr},
    {"ONEDNN_MAX_CPU_ISA", "ADVANCED_SIMD", nullptr},
#else
    {"ATEN_CPU_CAPABILITY", "avx2", nullptr},
    {"ONEDNN_MAX_CPU_ISA", "AVX2", nullptr},
    {"MKL_CBWR", "COMPATIBLE", nullptr},
#endif
};
bool reproducible = false;

__attribute__((constructor)) void pin() {
    for (Pin &pin : pins) {
        const char *before = std::getenv(pin.variable);
        pin.before = before ? strdup(before) : nullptr;
        setenv(pin.variable, pin.value, 1);
    }
    reproducible = true;
}

// Square roots as IEEE 754 wants them. MKL's vectors of them differ between processors in the last bit.
template <typename Number, typename Library>
void square_roots(const char *name, int count, const Number *from, Number *to, int64_t mode) {
    if (!reproducible) {
        static const auto library = reinterpret_cast<Library *>(dlsym(RTLD_NEXT, name));
        if (library) return library(count, from, to, mode);
    }
    for (int i = 0; i < count; i++) to[i] = std::sqrt(from[i]);
}
} // namespace

bool stillroom_is_reproducible() { return reproducible; }

extern "C" int stillroom_reproducible() { return reproducible ? 1 : 0; }

// Gives up equal bits for speed. To be called before libtorch has computed anything.
extern "C" void stillroom_use_fastest() {
    if (!reproducible) return;
    for (const Pin &pin : pins) {
        if (pin.before)
            setenv(pin.variable, pin.before, 1);
        else
            unsetenv(pin.variable);
    }
    reproducible = false;
}

// MKL's vector functions take the place of these names' functions in libtorch_cpu.so.
extern "C" void vmsSqrt(int count, const float *from, float *to, int64_t mode) {
    square_roots<float, void(int, const float *, float *, int64_t)>("vmsSqrt", count, from, to, mode);
}

extern "C" void vmdSqrt(int count, const double *from, double *to, int64_t mode) {
    square_roots<double, void(int, const double *, double *, int64_t)>("vmdSqrt", count, from, to, mode);
}
