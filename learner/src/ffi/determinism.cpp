// Which algorithms libtorch takes on a GPU.

#include <ATen/Context.h>
#include <cstdlib>

// Only those that give the same bits every time. To be called before anything is computed on a GPU. An operation that
// has none warns.
extern "C" void stillroom_use_deterministic() {
    // cuBLAS reads it when its first handle is made: with room of a fixed size it does not divide sums by what is free.
    setenv("CUBLAS_WORKSPACE_CONFIG", ":4096:8", 1);
    at::Context &context = at::globalContext();
    context.setBenchmarkCuDNN(false);
    context.setDeterministicCuDNN(true);
    context.setDeterministicAlgorithms(true, true);
    // New memory would be filled, which costs time and finds mistakes that the tests find.
    context.setDeterministicFillUninitializedMemory(false);
}
