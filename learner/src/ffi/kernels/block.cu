// A basic block of the ResNet's first stage: y = relu(norm(conv(relu(norm(conv(x))))) + x), 3 × 3 convolutions of 32
// channels on maps of 28 × 28, groups of two channels. One block of threads works on one map after another, which stays
// in shared memory with everything between: device memory sees x and y alone. The backward pass computes the rest
// again. There a warp sums, over all of its block's maps, the gradients of eight input channels of three neighbouring
// taps of both weights, so that order and result depend on the number of maps alone.
//
// Results of a convolution lie in registers, in tiles of 16 pixels: lane 4g + t has pixels g and g + 8, channels
// 8n + 2t and 8n + 2t + 1.

#define CHANNELS 32
#define GROUPS 16
#define WIDE 28
#define PIXELS (WIDE * WIDE)
#define WARPS 12
// Tiles of a map, and the most that a warp has; warp w has tiles w, w + WARPS, ...
#define TILES (PIXELS / 16)
#define OWN_TILES 5
// Numbers from one output channel of a weight to the next in shared memory: eight more than 9 taps · 32 channels, so
// that eight of them lie in different banks.
#define ROW (9 * CHANNELS + 8)

typedef float Tiles[OWN_TILES][4][4];

// A map in shared memory: 64 bytes a pixel in four chunks of 16. Chunks change places so that the same chunk of eight
// neighbouring pixels lies in different banks. Maps begin on 512 bytes.
struct Map {
    uint4 chunks[PIXELS * 4];
};

__device__ inline int chunk_at(int pixel, int chunk) {
    return pixel * 4 + (chunk ^ (pixel >> 1 & 3));
}

// From the bytes of the pixels before one, to those before its chunk 0.
__device__ inline u32 first_chunk(u32 bytes) {
    return bytes ^ (bytes >> 3 & 0x30);
}

// Where channels 8n + 2t and 8n + 2t + 1 of a pixel lie, as one word.
__device__ inline u32& pair_at(Map& map, int pixel, int n, int t) {
    return ((u32*)(map.chunks + chunk_at(pixel, n)))[t];
}

// What a block of threads holds besides maps.
struct BlockRoom {
    u32 weights[2][CHANNELS * ROW / 2];
    uint4 zeros[4];
    float partial[WARPS][CHANNELS][2];
    float channel[CHANNELS][2];
};

struct ForwardRoom {
    Map x, between;
    BlockRoom room;
};

struct BackwardRoom {
    Map x, between, gradient;
    BlockRoom room;
};

// Weights [32, 9, 32] bfloat16 of both convolutions, and the zeros that lie around a map.
__device__ inline void fill_room(BlockRoom& room, const u32* first, const u32* second) {
    for (int i = threadIdx.x; i < CHANNELS * 9 * CHANNELS / 2; i += blockDim.x) {
        const int at = i / (9 * CHANNELS / 2) * (ROW / 2) + i % (9 * CHANNELS / 2);
        room.weights[0][at] = first[i];
        room.weights[1][at] = second[i];
    }
    if (threadIdx.x < 4) room.zeros[threadIdx.x] = make_uint4(0, 0, 0, 0);
}

// Asks for a map from device memory.
__device__ inline void ask_for_map(Map& map, const uint4* from) {
    for (int i = threadIdx.x; i < PIXELS * 4; i += blockDim.x) ask_for(map.chunks + chunk_at(i / 4, i % 4), from + i);
}

// Which of the nine neighbours of a pixel lie on the map: bit 3 · (down + 1) + right + 1. None of a pixel beyond it.
__device__ inline u32 neighbours_of(int pixel) {
    const int v = pixel / WIDE, u = pixel % WIDE;
    u32 rows = 0x1ff, columns = 0x1ff;
    if (v == 0) rows &= ~0x7u;
    if (v == WIDE - 1) rows &= ~0x1c0u;
    if (u == 0) columns &= ~0x49u;
    if (u == WIDE - 1) columns &= ~0x124u;
    return pixel < PIXELS ? rows & columns : 0;
}

// The convolution of a map, or BACK, the gradient of a convolution's input for that of its output.
template <bool BACK>
__device__ inline void convolve(Tiles& out, const Map& map, const BlockRoom& room, int which) {
    const int lane = threadIdx.x % 32, warp = threadIdx.x / 32;
#pragma unroll
    for (int i = 0; i < OWN_TILES; i++)
#pragma unroll
        for (int n = 0; n < 4; n++)
#pragma unroll
            for (int k = 0; k < 4; k++) out[i][n][k] = 0.0f;
    const u32 weights = shared_address(room.weights[which]), start = shared_address(map.chunks);
    const u32 zeros = shared_address(room.zeros), chunk = lane / 16 * 16;
    u32 valid[OWN_TILES];
#pragma unroll
    for (int i = 0; i < OWN_TILES; i++) valid[i] = neighbours_of((warp + i * WARPS) * 16 + lane % 16);
    const int own = (warp * 16 + lane % 16) * 64;
#pragma unroll 1
    for (int tap = 0; tap < 9; tap++) {
        const int down = BACK ? 1 - tap / 3 : tap / 3 - 1, right = BACK ? 1 - tap % 3 : tap % 3 - 1;
        const int shift = own + (down * WIDE + right) * 64, bit = BACK ? 8 - tap : tap;
        u32 b[2][2][4];
#pragma unroll
        for (int half = 0; half < 2; half++) {
#pragma unroll
            for (int pair = 0; pair < 2; pair++) {
                if (BACK) {
                    const int row = half * 16 + lane % 16, column = tap * 32 + pair * 16 + lane / 16 * 8;
                    load_transposed(b[half][pair], weights + (row * ROW + column) * 2);
                } else {
                    const int row = pair * 16 + lane / 16 * 8 + lane % 8;
                    const int column = tap * 32 + half * 16 + lane / 8 % 2 * 8;
                    load_matrices(b[half][pair], weights + (row * ROW + column) * 2);
                }
            }
        }
#pragma unroll
        for (int i = 0; i < OWN_TILES; i++) {
            const u32 inside = start + (first_chunk(shift + i * WARPS * 16 * 64) ^ chunk);
            const u32 at = valid[i] >> bit & 1 ? inside : zeros + chunk;
#pragma unroll
            for (int half = 0; half < 2; half++) {
                u32 a[4];
                load_matrices(a, at ^ half * 32);
#pragma unroll
                for (int n = 0; n < 4; n++)
                    multiply(out[i][n], a, b[half][n / 2][n % 2 * 2], b[half][n / 2][n % 2 * 2 + 1]);
            }
        }
    }
}

// Adds the gradient of this warp's share of a weight: sum[m][k] += gradientᵀ · map for the taps 3 · (warp / 4) + k and
// the input channels 8 · (warp % 4) to 8 · (warp % 4) + 7.
__device__ inline void add_weight_gradient(float (&sum)[2][3][4], const Map& gradient, const Map& map,
                                           const BlockRoom& room) {
    const int lane = threadIdx.x % 32, warp = threadIdx.x / 32, down = warp / 4 - 1;
    const u32 from = (lane / 16 * 8 + lane % 8) * 64, a_chunk = lane / 8 % 2 * 16, b_chunk = warp % 4 * 16;
    const u32 a_start = shared_address(gradient.chunks), b_start = shared_address(map.chunks);
    const u32 zeros = shared_address(room.zeros);
    const int shift = (lane % 16 + down * WIDE) * 64;
    int v = lane % 16 / WIDE + down, u = lane % 16 % WIDE;
#pragma unroll 7
    for (int tile = 0; tile < TILES; tile++) {
        u32 b[3][2];
#pragma unroll
        for (int k = 0; k < 3; k++) {
            const bool valid = (u32)v < WIDE && (u32)(u + k - 1) < WIDE;
            const u32 inside = b_start + (first_chunk(shift + tile * 1024 + (k - 1) * 64) ^ b_chunk);
            load_two_transposed(b[k], valid ? inside : zeros);
        }
        const u32 a_at = a_start + (first_chunk(from + tile * 1024) ^ a_chunk);
        u += 16;
        if (u >= WIDE) {
            u -= WIDE;
            v++;
        }
#pragma unroll
        for (int m = 0; m < 2; m++) {
            u32 a[4];
            load_transposed(a, a_at ^ m * 32);
#pragma unroll
            for (int k = 0; k < 3; k++) multiply(sum[m][k], a, b[k][0], b[k][1]);
        }
    }
}

// Calls use(i, j, n, pixel) for each pair of channels that this lane has: out[i][n][2j] and out[i][n][2j + 1].
template <typename Use> __device__ inline void for_own(Use use) {
    const int lane = threadIdx.x % 32, warp = threadIdx.x / 32;
#pragma unroll
    for (int i = 0; i < OWN_TILES; i++) {
        const int tile = warp + i * WARPS;
        if (tile >= TILES) break;
#pragma unroll
        for (int j = 0; j < 2; j++) {
#pragma unroll
            for (int n = 0; n < 4; n++) use(i, j, n, tile * 16 + lane / 4 + 8 * j);
        }
    }
}

// Every lane's sums of its groups → the sums of the groups 4n + t over the block, on every lane, in a fixed order.
__device__ inline void sum_groups(float (&sum)[4], BlockRoom& room) {
    const int lane = threadIdx.x % 32, warp = threadIdx.x / 32, t = lane % 4;
#pragma unroll
    for (int n = 0; n < 4; n++) {
        for (int other = 16; other >= 4; other /= 2) sum[n] += __shfl_xor_sync(0xffffffffu, sum[n], other);
        if (lane < 4) room.partial[warp][4 * n + t][0] = sum[n];
    }
    __syncthreads();
#pragma unroll
    for (int n = 0; n < 4; n++) {
        sum[n] = 0.0f;
        for (int w = 0; w < WARPS; w++) sum[n] += room.partial[w][4 * n + t][0];
    }
    __syncthreads();
}

// Mean and 1 / standard deviation of the groups 4n + t, and for the backward pass in mean_rstd [16, 2].
__device__ inline void normalise(const Tiles& x, float (&mean)[4], float (&rstd)[4], float* mean_rstd,
                                 BlockRoom& room) {
    const float count = 2 * PIXELS;
    float sum[4] = {}, squares[4] = {};
    for_own([&](int i, int j, int n, int) { sum[n] += x[i][n][2 * j] + x[i][n][2 * j + 1]; });
    sum_groups(sum, room);
#pragma unroll
    for (int n = 0; n < 4; n++) mean[n] = sum[n] / count;
    for_own([&](int i, int j, int n, int) {
        const float one = x[i][n][2 * j] - mean[n], two = x[i][n][2 * j + 1] - mean[n];
        squares[n] += one * one + two * two;
    });
    sum_groups(squares, room);
#pragma unroll
    for (int n = 0; n < 4; n++) {
        rstd[n] = rsqrtf(squares[n] / count + EPSILON);
        if (threadIdx.x < 4) {
            mean_rstd[2 * (4 * n + threadIdx.x)] = mean[n];
            mean_rstd[2 * (4 * n + threadIdx.x) + 1] = rstd[n];
        }
    }
}

// What the forward pass left.
__device__ inline void load_statistics(float (&mean)[4], float (&rstd)[4], const float* mean_rstd) {
#pragma unroll
    for (int n = 0; n < 4; n++) {
        mean[n] = mean_rstd[2 * (4 * n + threadIdx.x % 4)];
        rstd[n] = mean_rstd[2 * (4 * n + threadIdx.x % 4) + 1];
    }
}

// What a norm does to this lane's channels: x · scale + offset.
struct OwnAffine {
    float scale[4][2], offset[4][2];
};

__device__ inline OwnAffine own_affine(const float (&mean)[4], const float (&rstd)[4], const float* weight,
                                       const float* bias) {
    OwnAffine own;
#pragma unroll
    for (int n = 0; n < 4; n++) {
#pragma unroll
        for (int k = 0; k < 2; k++) {
            const int channel = 8 * n + 2 * (threadIdx.x % 4) + k;
            own.scale[n][k] = rstd[n] * weight[channel];
            own.offset[n][k] = bias[channel] - mean[n] * own.scale[n][k];
        }
    }
    return own;
}

// relu(norm(x)) of this lane's numbers, into a map.
__device__ inline void put_between(Map& map, const Tiles& x, const OwnAffine& own) {
    for_own([&](int i, int j, int n, int pixel) {
        const float one = x[i][n][2 * j] * own.scale[n][0] + own.offset[n][0];
        const float two = x[i][n][2 * j + 1] * own.scale[n][1] + own.offset[n][1];
        pair_at(map, pixel, n, threadIdx.x % 4) = two_bfloat16(fmaxf(one, 0.0f), fmaxf(two, 0.0f));
    });
}

// x, y [rows, 28, 28, 32] bfloat16; weights [32, 9, 32] bfloat16; norms as weight and bias; mean_rstd [rows, 2, 16, 2].
// 32 · WARPS threads.
extern "C" __global__ void __launch_bounds__(32 * WARPS, 1)
    block_forward(const uint4* x, const u32* first, const float* first_weight, const float* first_bias,
                  const u32* second, const float* second_weight, const float* second_bias, u32* y, float* mean_rstd,
                  int rows) {
    extern __shared__ __align__(512) uint4 dynamic[];
    ForwardRoom& s = *(ForwardRoom*)dynamic;
    fill_room(s.room, first, second);
    for (size_t row = blockIdx.x; row < rows; row += gridDim.x) {
        float* statistics = mean_rstd + row * 4 * GROUPS;
        ask_for_map(s.x, x + row * PIXELS * 4);
        await_all();
        __syncthreads();
        Tiles out;
        float mean[4], rstd[4];
        convolve<false>(out, s.x, s.room, 0);
        normalise(out, mean, rstd, statistics, s.room);
        put_between(s.between, out, own_affine(mean, rstd, first_weight, first_bias));
        __syncthreads();
        convolve<false>(out, s.between, s.room, 1);
        normalise(out, mean, rstd, statistics + 2 * GROUPS, s.room);
        const OwnAffine own = own_affine(mean, rstd, second_weight, second_bias);
        u32* to = y + row * PIXELS * CHANNELS / 2;
        for_own([&](int i, int j, int n, int pixel) {
            const u32 around = pair_at(s.x, pixel, n, threadIdx.x % 4);
            const float one = out[i][n][2 * j] * own.scale[n][0] + own.offset[n][0] + low(around);
            const float two = out[i][n][2 * j + 1] * own.scale[n][1] + own.offset[n][1] + high(around);
            to[pixel * 16 + 4 * n + threadIdx.x % 4] = two_bfloat16(fmaxf(one, 0.0f), fmaxf(two, 0.0f));
        });
        __syncthreads();
    }
}

// The gradient of a norm's input, x, in place of that of its output, g(pixel, n): in the map `gradient`. A row's share
// of the gradients of bias and weight goes to gradients [2, 32].
template <typename Arriving>
__device__ inline void through_norm(Map& gradient, const Tiles& x, const float* mean_rstd, const float* weight,
                                    float* gradients, BlockRoom& room, Arriving arriving) {
    const int lane = threadIdx.x % 32, warp = threadIdx.x / 32, t = lane % 4;
    float mean[4], rstd[4], sums[4][2][2] = {};
    load_statistics(mean, rstd, mean_rstd);
    for_own([&](int i, int j, int n, int pixel) {
        const u32 g = arriving(pixel, n);
        const float one = low(g), two = high(g);
        sums[n][0][0] += one;
        sums[n][0][1] += one * (x[i][n][2 * j] - mean[n]);
        sums[n][1][0] += two;
        sums[n][1][1] += two * (x[i][n][2 * j + 1] - mean[n]);
    });
#pragma unroll
    for (int n = 0; n < 4; n++) {
#pragma unroll
        for (int k = 0; k < 4; k++) {
            float& sum = sums[n][k / 2][k % 2];
            if (k % 2) sum *= rstd[n];
            for (int other = 16; other >= 4; other /= 2) sum += __shfl_xor_sync(0xffffffffu, sum, other);
            if (lane < 4) room.partial[warp][8 * n + 2 * t + k / 2][k % 2] = sum;
        }
    }
    __syncthreads();
    if (threadIdx.x < CHANNELS * 2) {
        const int channel = threadIdx.x / 2, which = threadIdx.x % 2;
        float sum = 0.0f;
        for (int w = 0; w < WARPS; w++) sum += room.partial[w][channel][which];
        gradients[which * CHANNELS + channel] = sum;
        room.channel[channel][which] = weight[channel] * sum;
    }
    __syncthreads();
    // rstd · (weight · g - means[0] - (x - mean) · rstd · means[1]), with what is the same everywhere put together.
    float scale[4][2], offset[4], slope[4];
#pragma unroll
    for (int n = 0; n < 4; n++) {
        const int channel = 8 * n + 2 * t;
        const float(*shared)[2] = room.channel + channel;
        const float first = (shared[0][0] + shared[1][0]) / (2 * PIXELS);
        const float second = (shared[0][1] + shared[1][1]) / (2 * PIXELS);
        scale[n][0] = rstd[n] * weight[channel];
        scale[n][1] = rstd[n] * weight[channel + 1];
        slope[n] = rstd[n] * rstd[n] * second;
        offset[n] = rstd[n] * first - mean[n] * slope[n];
    }
    for_own([&](int i, int j, int n, int pixel) {
        const u32 g = arriving(pixel, n);
        const float one = scale[n][0] * low(g) - offset[n] - x[i][n][2 * j] * slope[n];
        const float two = scale[n][1] * high(g) - offset[n] - x[i][n][2 * j + 1] * slope[n];
        pair_at(gradient, pixel, n, t) = two_bfloat16(one, two);
    });
    __syncthreads();
}

// The gradient that reaches the block's last norm, which is also the one that goes around, in the map `gradient`. `y`
// gets the block's output. Each thread needs only what it has asked for itself.
__device__ inline void put_arriving(Map& gradient, Map& y, const uint4* dy, const uint4* dy_too, const uint4* output) {
    ask_for_map(gradient, dy);
    ask_for_map(y, output);
    await_all();
#pragma unroll 2
    for (int i = threadIdx.x; i < PIXELS * 4; i += blockDim.x) {
        const int at = chunk_at(i / 4, i % 4);
        Eight g = unpack(gradient.chunks[at]);
        const Eight let_through = unpack(y.chunks[at]);
        if (dy_too) {
            const Eight more = unpack(dy_too[i]);
#pragma unroll
            for (int k = 0; k < 8; k++) g.at[k] += more.at[k];
        }
#pragma unroll
        for (int k = 0; k < 8; k++) g.at[k] = let_through.at[k] > 0.0f ? g.at[k] : 0.0f;
        gradient.chunks[at] = pack(g);
    }
}

// A warp's sums, into [blocks, 32, 9, 32].
__device__ inline void put_weight_gradient(float* to, const float (&sum)[2][3][4]) {
    const int lane = threadIdx.x % 32, warp = threadIdx.x / 32, g = lane / 4, t = lane % 4;
    to += (size_t)blockIdx.x * CHANNELS * 9 * CHANNELS + warp % 4 * 8 + 2 * t;
#pragma unroll
    for (int m = 0; m < 2; m++) {
#pragma unroll
        for (int k = 0; k < 3; k++) {
            float* low_row = to + ((16 * m + g) * 9 + warp / 4 * 3 + k) * CHANNELS;
            float* high_row = low_row + 8 * 9 * CHANNELS;
            low_row[0] = sum[m][k][0];
            low_row[1] = sum[m][k][1];
            high_row[0] = sum[m][k][2];
            high_row[1] = sum[m][k][3];
        }
    }
}

// Gradients of block_forward for dy (+ dy_too?): dx [rows, 28, 28, 32]; of the weights, summed over the maps of a block
// [2, blocks, 32, 9, 32]; each row's share of those of bias and weight of both norms, [rows, 2, 2, 32].
extern "C" __global__ void __launch_bounds__(32 * WARPS, 1)
    block_backward(const uint4* dy, const uint4* dy_too, const uint4* y, const uint4* x, const float* mean_rstd,
                   const u32* first, const float* first_weight, const float* first_bias, const u32* second,
                   const float* second_weight, u32* dx, float* d_weights, float* gradients, int rows) {
    extern __shared__ __align__(512) uint4 dynamic[];
    BackwardRoom& s = *(BackwardRoom*)dynamic;
    const int t = threadIdx.x % 4;
    fill_room(s.room, first, second);
    float d_first[2][3][4] = {}, d_second[2][3][4] = {};
    ask_for_map(s.x, x + (size_t)blockIdx.x * PIXELS * 4);
    for (size_t row = blockIdx.x; row < rows; row += gridDim.x) {
        const size_t base = row * PIXELS * 4;
        const uint4* dy_row = dy + base;
        const uint4* dy_too_row = dy_too ? dy_too + base : 0;
        const float* statistics = mean_rstd + row * 4 * GROUPS;
        float* shares = gradients + row * 4 * CHANNELS;
        put_arriving(s.gradient, s.between, dy_row, dy_too_row, y + base);
        __syncthreads();
        Tiles out;
        float mean[4], rstd[4];
        load_statistics(mean, rstd, statistics);
        convolve<false>(out, s.x, s.room, 0);
        put_between(s.between, out, own_affine(mean, rstd, first_weight, first_bias));
        __syncthreads();
        convolve<false>(out, s.between, s.room, 1);
        through_norm(s.gradient, out, statistics + 2 * GROUPS, second_weight, shares + 2 * CHANNELS, s.room,
                     [&](int pixel, int n) { return pair_at(s.gradient, pixel, n, t); });
        add_weight_gradient(d_second, s.gradient, s.between, s.room);
        convolve<true>(out, s.gradient, s.room, 1);
        __syncthreads();
        // What reaches the first norm takes the place of what lay between: its ReLU let through what is positive.
        for_own([&](int i, int j, int n, int pixel) {
            u32& at = pair_at(s.between, pixel, n, t);
            at = two_bfloat16(low(at) > 0.0f ? out[i][n][2 * j] : 0.0f, high(at) > 0.0f ? out[i][n][2 * j + 1] : 0.0f);
        });
        convolve<false>(out, s.x, s.room, 0);
        through_norm(s.gradient, out, statistics, first_weight, shares, s.room,
                     [&](int pixel, int n) { return pair_at(s.between, pixel, n, t); });
        add_weight_gradient(d_first, s.gradient, s.x, s.room);
        convolve<true>(out, s.gradient, s.room, 0);
        __syncthreads();
        // Nobody needs the maps any more: they take what goes around, and the next row's x.
        put_arriving(s.gradient, s.between, dy_row, dy_too_row, y + base);
        if (row + gridDim.x < rows) ask_for_map(s.x, x + base + (size_t)gridDim.x * PIXELS * 4);
        __syncthreads();
        for_own([&](int i, int j, int n, int pixel) {
            const u32 around = pair_at(s.gradient, pixel, n, t);
            dx[base * 4 + pixel * 16 + 4 * n + t] =
                two_bfloat16(out[i][n][2 * j] + low(around), out[i][n][2 * j + 1] + high(around));
        });
        __syncthreads();
    }
    put_weight_gradient(d_weights, d_second);
    put_weight_gradient(d_weights + (size_t)gridDim.x * CHANNELS * 9 * CHANNELS, d_first);
}
