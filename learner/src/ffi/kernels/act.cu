// What acting needs before and after the network: frames come straight from the actors' shared memory, and actions are
// sampled. POOL is the side of the pooling window, SIDE that of a pooled frame.

// Blocks that share a frame.
#define BANDS 4

// Added to the address of a frame's sums, to tell them from a frame.
#define SUMS 1ull

// One of the BANDS bands of a frame: see `observe`.
__device__ void observe_band(const uint4* frame, int band, size_t place, float* kept, void* store) {
    const int octets = SIDE * POOL / 8, all = SIDE * octets / BANDS, first = band * all;
    for (int i = first + threadIdx.x; i < first + all; i += blockDim.x) {
        const int v = i / octets, octet = i % octets;
        u32 sums[8 / POOL] = {};
        uint4 raw;
#pragma unroll
        for (int line = 0; line < POOL; line++) {
            raw = frame[(v * POOL + line) * octets + octet];
            const u32 words[4] = {raw.x, raw.y, raw.z, raw.w};
#pragma unroll
            for (int k = 0; k < 8; k++) sums[k / POOL] += words[k / 2] >> (16 * (k % 2)) & 0xffffu;
        }
        const int at = v * SIDE + octet * (8 / POOL);
#pragma unroll
        for (int k = 0; k < 8 / POOL; k++) {
            const float mean = (float)sums[k] * (1.0f / (POOL * POOL));
            kept[at + k] = mean;
            if (POOL > 1) ((float*)store)[place + at + k] = mean;
        }
        if (POOL == 1) ((uint4*)store)[(place + at) / 8] = raw;
    }
}

#if POOL == 2
// The same from sums over POOL × POOL pixels, which the actor has made: a quarter of the bytes.
__device__ void observe_sums(const uint4* sums, int band, size_t place, float* kept, float* store) {
    const int all = SIDE * SIDE / 8 / BANDS, first = band * all;
    for (int i = first + threadIdx.x; i < first + all; i += blockDim.x) {
        const uint4 raw = sums[i];
        const u32 words[4] = {raw.x, raw.y, raw.z, raw.w};
        float4 means[2];
#pragma unroll
        for (int k = 0; k < 8; k++)
            ((float*)means)[k] = (float)(words[k / 2] >> (16 * (k % 2)) & 0xffffu) * (1.0f / (POOL * POOL));
#pragma unroll
        for (int k = 0; k < 2; k++) {
            ((float4*)kept)[2 * i + k] = means[k];
            ((float4*)(store + place))[2 * i + k] = means[k];
        }
    }
}
#endif

// frames: addresses of raw frames, u16 [SIDE · POOL, SIDE · POOL] millimetres, in host memory that the device may read;
// or, told by SUMS, of their sums, u16 [SIDE, SIDE]. Means over POOL × POOL pixels go to `kept` f32 [rows, SIDE, SIDE] and
// to row places[i] of the rollout's store, which has the same numbers, or without pooling the raw ones. Sums of 16 numbers
// of 16 bits are exact in f32.
extern "C" __global__ void observe(const unsigned long long* frames, const long long* places, float* kept, void* store,
                                   int rows) {
    for (int band = blockIdx.x; band < rows * BANDS; band += gridDim.x) {
        const size_t row = band / BANDS, pixels = SIDE * SIDE;
#if POOL == 2
        if (frames[row] & SUMS) {
            const uint4* sums = (const uint4*)(frames[row] - SUMS);
            observe_sums(sums, band % BANDS, places[row] * pixels, kept + row * pixels, (float*)store);
            continue;
        }
#endif
        observe_band((const uint4*)frames[row], band % BANDS, places[row] * pixels, kept + row * pixels, store);
    }
}

// What was chosen, in host memory.
struct Chosen {
    float log_prob, value;
    int action;
    // 0 if a number of the row is not finite.
    int finite;
};

// log_probs and noise [rows, actions], values [rows]. The action is argmax(log-probability + noise), the first of
// equals.
extern "C" __global__ void choose(const float* log_probs, const float* values, const float* noise, Chosen* choices,
                                  int rows, int actions) {
    const int row = blockIdx.x * blockDim.x + threadIdx.x;
    if (row >= rows) return;
    float best = __int_as_float(0xff800000);
    Chosen choice = {0.0f, values[row], 0, isfinite(values[row])};
    for (int action = 0; action < actions; action++) {
        const float log_prob = log_probs[(size_t)row * actions + action];
        choice.finite = choice.finite && isfinite(log_prob);
        const float perturbed = log_prob + noise[(size_t)row * actions + action];
        if (perturbed > best) {
            best = perturbed;
            choice.action = action;
            choice.log_prob = log_prob;
        }
    }
    choices[row] = choice;
}

// Rows of beliefs f32 [rows, hidden] to the rows `to` of a table. Several may go to one row that nobody reads.
extern "C" __global__ void keep(const float* beliefs, const long long* to, float* table, int hidden) {
    beliefs += (size_t)blockIdx.x * hidden;
    table += (size_t)to[blockIdx.x] * hidden;
    for (int i = threadIdx.x; i < hidden; i += blockDim.x) table[i] = beliefs[i];
}
