// CUDA graphs of libtorch. Their class lies in libtorch_cuda.so, which is loaded at run time and whose headers need
// CUDA's; so its functions come in as addresses. Streams are switched by libtorch's interface for all devices.

#include "guard.h"
#include <c10/core/impl/VirtualGuardImpl.h>
#include <cstdlib>
#include <new>
#include <utility>

namespace {
// at::cuda::MempoolId_t and cudaStreamCaptureMode, as at::cuda::CUDAGraph's functions take them.
using Pool = std::pair<unsigned long long, unsigned long long>;
constexpr int CAPTURE_THIS_THREAD = 1;

// Room for an at::cuda::CUDAGraph, of which 2.11 needs less than 200 bytes.
struct alignas(64) Room {
    unsigned char bytes[2048];
};

c10::Stream exchange(int64_t stream) {
    const c10::impl::VirtualGuardImpl device(c10::DeviceType::CUDA);
    return device.exchangeStream(c10::Stream(c10::Stream::UNSAFE, c10::Device(c10::DeviceType::CUDA, 0), stream));
}
} // namespace

// Members of at::cuda::CUDAGraph.
extern "C" struct GraphFunctions {
    void (*construct)(void *, bool);
    void (*destroy)(void *);
    void (*begin)(void *, Pool, int);
    void (*end)(void *);
    Pool (*pool)(void *);
    void (*replay)(void *);
};

// Makes a stream of the first device libtorch's current one; `before` gets the one that was. A stream that libtorch did
// not make is numbered by its handle.
extern "C" int stillroom_exchange_stream(int64_t stream, int64_t *before, char *message, size_t capacity) {
    return guarded(message, capacity, [&] { *before = exchange(stream).id(); });
}

// Graphs with the same `pool` share their memory; with 0 a graph has its own.
extern "C" int stillroom_graph_begin(const GraphFunctions *functions, uint64_t pool, void **graph, char *message,
                                     size_t capacity) {
    return guarded(message, capacity, [&] {
        void *room = new Room();
        functions->construct(room, false);
        *graph = room;
        functions->begin(room, Pool(0, pool), CAPTURE_THIS_THREAD);
    });
}

extern "C" int stillroom_graph_end(const GraphFunctions *functions, void *graph, char *message, size_t capacity) {
    return guarded(message, capacity, [&] { functions->end(graph); });
}

// Fails where the recording is not over: until then libtorch names no pool.
extern "C" int stillroom_graph_ended(const GraphFunctions *functions, void *graph, char *message, size_t capacity) {
    return guarded(message, capacity, [&] { functions->pool(graph); });
}

extern "C" int stillroom_graph_replay(const GraphFunctions *functions, void *graph, char *message, size_t capacity) {
    return guarded(message, capacity, [&] { functions->replay(graph); });
}

extern "C" int stillroom_graph_destroy(const GraphFunctions *functions, void *graph, char *message, size_t capacity) {
    return guarded(message, capacity, [&] {
        functions->destroy(graph);
        delete static_cast<Room *>(graph);
    });
}
