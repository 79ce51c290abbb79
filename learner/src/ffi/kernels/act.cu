// What acting needs around the encoder: frames come straight from the actors' shared memory; belief, policy and the
// choice of an action are one kernel, because the nine small ones that it replaces took longer, one after the other.
// POOL is the side of the pooling window, SIDE that of a pooled frame.

// Blocks that share a frame.
#define BANDS 4

// Of the belief, and of the policy: one lane of a warp each.
#define MAX_HIDDEN 4096
#define MAX_ACTIONS 32
// Of a policy whose actions are chosen elsewhere.
#define MAX_OUTPUTS 1024

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
// or, told by SUMS, of their sums, u16 [SIDE, SIDE]. Means over POOL × POOL pixels go to `kept` f32 [rows, SIDE, SIDE]
// and to row places[i] of the rollout's store, which has the same numbers, or without pooling the raw ones. Sums of 16
// numbers of 16 bits are exact in f32.
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

__device__ inline float logistic(float x) {
    return 1.0f / (1.0f + expf(-x));
}

__device__ inline float over_warp(float x, float (*merge)(float, float)) {
    for (int offset = 16; offset > 0; offset /= 2) x = merge(x, __shfl_xor_sync(0xffffffffu, x, offset));
    return x;
}

__device__ inline float sum_of(float a, float b) {
    return a + b;
}

// The rest of a step, one block a row: the belief's gates, actor and critic, and the choice of an action.
//
// from_input and from_before [rows, gates · hidden]: what the gates (reset, update, candidate, as PyTorch's GRU has them,
// or where the state is wider than the belief, input, forget, cell, output, as its LSTM has them) get from what was seen
// and from the belief before, without their biases [gates · hidden]. before [rows, state]: the belief, and an LSTM's cell
// behind it. The state after goes to row to[i] of the table; several may go to one row that nobody reads. actor [actions,
// hidden] and critic [hidden] have biases, too. noise [rows, actions]: the action is argmax(log-probability + noise), the
// first of equals. All sums have one order, whatever the batch.
//
// With `outputs_to` [rows, width] no action is chosen: a row gets what the actor gives, the logarithms of deviations
// [actions] if there are some, and the value.
extern "C" __global__ void decide(const float* from_input, const float* from_before, const float* before,
                                  const float* input_bias, const float* before_bias, const float* actor,
                                  const float* actor_bias, const float* critic, const float* critic_bias,
                                  const float* noise, const long long* to, float* table, Chosen* choices, int hidden,
                                  int state, int actions, float* outputs_to, const float* log_std) {
    __shared__ float belief[MAX_HIDDEN];
    __shared__ float outputs[MAX_OUTPUTS + 1];
    const size_t row = blockIdx.x;
    const bool is_lstm = state > hidden;
    const int gates_in_row = (is_lstm ? 4 : 3) * hidden;
    from_input += row * gates_in_row;
    from_before += row * gates_in_row;
    before += row * state;
    table += (size_t)to[row] * state;
    for (int i = threadIdx.x; is_lstm && i < hidden; i += blockDim.x) {
        float gates[4];
#pragma unroll
        for (int gate = 0; gate < 4; gate++) {
            const int at = gate * hidden + i;
            const float sum = from_input[at] + from_before[at] + input_bias[at] + before_bias[at];
            gates[gate] = gate == 2 ? tanhf(sum) : logistic(sum);
        }
        const float cell = gates[1] * before[hidden + i] + gates[0] * gates[2];
        const float after = gates[3] * tanhf(cell);
        belief[i] = after;
        table[i] = after;
        table[hidden + i] = cell;
    }
    for (int i = threadIdx.x; !is_lstm && i < hidden; i += blockDim.x) {
        float gates[2];
#pragma unroll
        for (int gate = 0; gate < 2; gate++) {
            const int at = gate * hidden + i;
            gates[gate] = logistic(from_input[at] + from_before[at] + input_bias[at] + before_bias[at]);
        }
        const int at = 2 * hidden + i;
        const float remembered = gates[0] * (from_before[at] + before_bias[at]);
        const float candidate = tanhf(from_input[at] + input_bias[at] + remembered);
        const float after = candidate + gates[1] * (before[i] - candidate);
        belief[i] = after;
        table[i] = after;
    }
    __syncthreads();

    const int lane = threadIdx.x % 32, warp = threadIdx.x / 32;
    for (int output = warp; output <= actions; output += blockDim.x / 32) {
        const float* weight = output < actions ? actor + (size_t)output * hidden : critic;
        float sum = 0.0f;
        for (int i = lane; i < hidden; i += 32) sum += weight[i] * belief[i];
        sum = over_warp(sum, sum_of);
        if (lane == 0) outputs[output] = sum + (output < actions ? actor_bias[output] : critic_bias[0]);
    }
    __syncthreads();
    if (outputs_to) {
        const int width = actions * (log_std ? 2 : 1) + 1;
        for (int i = threadIdx.x; i < width; i += blockDim.x)
            outputs_to[row * width + i] =
                i < actions ? outputs[i] : i + 1 == width ? outputs[actions] : log_std[i - actions];
        return;
    }
    if (warp > 0) return;

    const bool is_action = lane < actions;
    const float none = __int_as_float(0xff800000), score = is_action ? outputs[lane] : none;
    const float most = over_warp(score, fmaxf);
    const float total = over_warp(is_action ? expf(score - most) : 0.0f, sum_of);
    const float log_prob = score - most - logf(total);
    float best = is_action ? log_prob + noise[row * actions + lane] : none;
    int action = lane;
    for (int offset = 16; offset > 0; offset /= 2) {
        const float other = __shfl_xor_sync(0xffffffffu, best, offset);
        const int its_action = __shfl_xor_sync(0xffffffffu, action, offset);
        if (other > best || (other == best && its_action < action)) {
            best = other;
            action = its_action;
        }
    }
    const float value = outputs[actions];
    const int finite = __all_sync(0xffffffffu, isfinite(value) && (!is_action || isfinite(log_prob)));
    const float its_log_prob = __shfl_sync(0xffffffffu, log_prob, action);
    if (lane == 0) choices[row] = Chosen{its_log_prob, value, action, finite};
}
