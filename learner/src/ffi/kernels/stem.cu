// The stem of the ResNet: y = max_pool(relu(norm(conv(x)))), a 7 × 7 convolution of stride 2 to 32 channels, groups of
// two channels, windows of 3 × 3 with stride 2. One block works on one frame. The convolution's result, by far the
// largest map of the network, never leaves the multiprocessor: four rows of it at a time are computed, rounded to
// bfloat16, and pooled before they are normalised, because a norm followed by a ReLU keeps or turns round the order of
// a channel's numbers. The backward pass computes them again.
//
// The convolution sees the frame (kept · scale + offset) as a map of half the side with eight channels: (part, v mod 2,
// u mod 2), where the parts are the number rounded to bfloat16 and what that left over. So no depth is lost, the 7 × 7
// convolution of stride 2 becomes a 4 × 4 one of stride 1, and eight channels are the 16 bytes that a matrix's row
// takes. The border of zeros is two pixels above and left, one below and right. SIDE is the frame's side.

#define STEM_CHANNELS 32
#define STEM_GROUPS 16
#define STEM_TAPS 128
// Sides of the convolution's map, of its input with the border, of the pooled map.
#define HALF (SIDE / 2)
#define PADDED (HALF + 3)
#define POOLED (HALF / 2)
// Rows of the convolution's map that are computed together, pixels of them, and input rows that they need.
#define CHUNK 4
#define CHUNK_PIXELS (CHUNK * HALF)
#define BAND (CHUNK + 3)
// Warps that convolve; each has so many tiles of 16 pixels of a chunk.
#define STEM_WARPS 7
#define STEM_TILES (CHUNK_PIXELS / 16 / STEM_WARPS)
// Numbers from one pixel to the next in shared memory: 16 bytes more than the channels, so that eight pixels lie in
// different banks.
#define STEM_STRIDE 40
// Numbers that one thread sums for the statistics of a group.
#define STEM_SUMMED (HALF / CHUNK * STEM_TILES * 4)

// Numbers of the frame for one lane: warp w has row w of the band, of which a lane has every 32nd position.
#define BAND_STEPS ((PADDED + 31) / 32)
struct BandPart {
    float2 above[BAND_STEPS], below[BAND_STEPS];
};

// Asks for the rows of the convolution's input for the chunk whose first row is `first`.
__device__ inline BandPart ask_for_band(const float* frame, int first) {
    BandPart part;
    const int lane = threadIdx.x % 32, v = first + threadIdx.x / 32 - 2;
#pragma unroll
    for (int i = 0; i < BAND_STEPS; i++) {
        const int u = lane + 32 * i - 2;
        const bool inside = v >= 0 && v < HALF && u >= 0 && u < HALF && threadIdx.x / 32 < BAND;
        const float2* at = (const float2*)(frame + (inside ? 2 * v * SIDE + 2 * u : 0));
        // Of numbers outside the offset must not be seen.
        part.above[i] = inside ? at[0] : make_float2(__int_as_float(0x7fffffff), 0.0f);
        part.below[i] = inside ? at[SIDE / 2] : make_float2(0.0f, 0.0f);
    }
    return part;
}

// Puts them into shared memory.
__device__ inline void fill_band(uint4* band, const BandPart& part, float scale, float offset) {
    const int lane = threadIdx.x % 32, row = threadIdx.x / 32;
#pragma unroll
    for (int i = 0; i < BAND_STEPS; i++) {
        const float2 above = part.above[i], below = part.below[i];
        const bool inside = __float_as_int(above.x) != 0x7fffffff;
        const float x[4] = {above.x, above.y, below.x, below.y};
        Eight out = {};
#pragma unroll
        for (int k = 0; k < 4; k++) {
            const float value = inside ? x[k] * scale + offset : 0.0f;
            const float rounded = low(two_bfloat16(value, 0.0f));
            out.at[k] = rounded;
            out.at[4 + k] = value - rounded;
        }
        if (row < BAND && lane + 32 * i < PADDED) band[row * PADDED + lane + 32 * i] = pack(out);
    }
}

// Address of the band's row for this lane's pixel of a tile, as `load_matrices` wants the left operand.
__device__ inline u32 left_operand(const uint4* band, int tile) {
    const int lane = threadIdx.x % 32, pixel = tile * 16 + lane % 16;
    return shared_address(band + pixel / HALF * PADDED + pixel % HALF + lane / 16);
}

// Where the taps 16 · k .. 16 · k + 15 lie, from the first.
__device__ inline u32 tap_offset(int k) {
    return (k / 2 * PADDED + k % 2 * 2) * 16;
}

// A tile's convolution, rounded: pixels g and g + 8, channels 8n + 2t and 8n + 2t + 1. `weights(b, k)` gives the right
// operands for the taps 16 · k and on.
template <typename Weights>
__device__ inline void convolve_tile(u32 (&out)[4][2], u32 address, Weights weights) {
    float sum[4][4] = {};
#pragma unroll
    for (int k = 0; k < STEM_TAPS / 16; k++) {
        u32 a[4], b[8];
        load_matrices(a, address + tap_offset(k));
        weights(b, k);
#pragma unroll
        for (int n = 0; n < 4; n++) multiply(sum[n], a, b[2 * n], b[2 * n + 1]);
    }
#pragma unroll
    for (int n = 0; n < 4; n++) {
        out[n][0] = two_bfloat16(sum[n][0], sum[n][1]);
        out[n][1] = two_bfloat16(sum[n][2], sum[n][3]);
    }
}

// Sums of a thread over the numbers of four groups, as differences to the first of each: no cancellation.
struct Spread {
    float origin[4], sum[4], squares[4];
};

// Adds a tile's numbers.
__device__ inline void spread_over(Spread& spread, const u32 (&x)[4][2], bool first) {
#pragma unroll
    for (int n = 0; n < 4; n++) {
        if (first) spread.origin[n] = low(x[n][0]);
#pragma unroll
        for (int i = 0; i < 4; i++) {
            const float difference = (i % 2 ? high(x[n][i / 2]) : low(x[n][i / 2])) - spread.origin[n];
            spread.sum[n] += difference;
            spread.squares[n] += difference * difference;
        }
    }
}

// From all threads' sums to mean and 1 / standard deviation of each group, combined in a fixed order by means and
// squared deviations (Chan, Golub, LeVeque 1983).
__device__ inline void stem_statistics(const Spread& spread, float (*by_warp)[STEM_GROUPS][2], float (*group)[2],
                                       float* mean_rstd) {
    const int lane = threadIdx.x % 32, warp = threadIdx.x / 32;
#pragma unroll
    for (int n = 0; n < 4; n++) {
        const float own = spread.origin[n] + spread.sum[n] / STEM_SUMMED;
        float deviation = spread.squares[n] - spread.sum[n] * spread.sum[n] / STEM_SUMMED;
        float mean = own;
        for (int other = 16; other >= 4; other /= 2) mean += __shfl_xor_sync(0xffffffffu, mean, other);
        mean /= 8;
        deviation += STEM_SUMMED * (own - mean) * (own - mean);
        for (int other = 16; other >= 4; other /= 2) deviation += __shfl_xor_sync(0xffffffffu, deviation, other);
        if (lane < 4) {
            by_warp[warp][4 * n + lane][0] = mean;
            by_warp[warp][4 * n + lane][1] = deviation;
        }
    }
    __syncthreads();
    if (threadIdx.x < STEM_GROUPS) {
        const int g = threadIdx.x;
        float mean = 0.0f, deviation = 0.0f;
        for (int w = 0; w < STEM_WARPS; w++) mean += by_warp[w][g][0];
        mean /= STEM_WARPS;
        for (int w = 0; w < STEM_WARPS; w++) {
            const float apart = by_warp[w][g][0] - mean;
            deviation += by_warp[w][g][1] + 8 * STEM_SUMMED * apart * apart;
        }
        const float rstd = rsqrtf(deviation / (2 * HALF * HALF) + EPSILON);
        group[g][0] = mean;
        group[g][1] = rstd;
        mean_rstd[2 * g] = mean;
        mean_rstd[2 * g + 1] = rstd;
    }
    __syncthreads();
}

// Pools the windows whose last rows are in the chunk that begins with row `first`. `rows` holds the last CHUNK + 1 rows
// of the convolution's map, row v in place v mod (CHUNK + 1). `winner` says which of a window's nine pixels (row-major)
// each number came from, the first of equals. `turned` has the signs of channels whose weight is negative, which keep
// their smallest number.
__device__ inline void pool_chunk(const u32* rows, uint4 turned, uint4* raw, uint2* winner, int first) {
    const u32 signs[4] = {turned.x, turned.y, turned.z, turned.w};
    for (int i = threadIdx.x; i < CHUNK / 2 * POOLED * 4; i += blockDim.x) {
        const int octet = i % 4, wu = i / 4 % POOLED, wv = first / 2 + i / 4 / POOLED;
        float best[8];
        u32 from[8] = {};
#pragma unroll
        for (int k = 0; k < 8; k++) best[k] = __int_as_float(0xff800000);
#pragma unroll
        for (int pixel = 0; pixel < 9; pixel++) {
            const int v = 2 * wv - 1 + pixel / 3, u = 2 * wu - 1 + pixel % 3;
            if (v < 0 || u < 0) continue;
            const uint4 value = *(const uint4*)(rows + ((v % (CHUNK + 1)) * HALF + u) * (STEM_STRIDE / 2) + octet * 4);
            const u32 words[4] = {value.x ^ signs[0], value.y ^ signs[1], value.z ^ signs[2], value.w ^ signs[3]};
#pragma unroll
            for (int k = 0; k < 8; k++) {
                const float number = k % 2 ? high(words[k / 2]) : low(words[k / 2]);
                from[k] = number > best[k] ? pixel : from[k];
                best[k] = number > best[k] ? number : best[k];
            }
        }
        u32 chosen[4];
#pragma unroll
        for (int k = 0; k < 4; k++) chosen[k] = two_bfloat16(best[2 * k], best[2 * k + 1]) ^ signs[k];
        const int at = (wv * POOLED + wu) * 4 + octet;
        raw[at] = make_uint4(chosen[0], chosen[1], chosen[2], chosen[3]);
        winner[at] = make_uint2(from[0] | from[1] << 8 | from[2] << 16 | from[3] << 24,
                                from[4] | from[5] << 8 | from[6] << 16 | from[7] << 24);
    }
}

// Normalises what `pool_chunk` has chosen, by the same threads. Where the ReLU stops a number, no pixel gets a
// gradient.
__device__ inline void finish_pooling(const float (*group)[2], const float* weight, const float* bias, const uint4* raw,
                                      uint4* y, uint2* winner) {
    Eight scale, offset;
#pragma unroll
    for (int k = 0; k < 8; k++) {
        const int channel = threadIdx.x % 4 * 8 + k;
        scale.at[k] = group[channel / 2][1] * weight[channel];
        offset.at[k] = bias[channel] - group[channel / 2][0] * scale.at[k];
    }
#pragma unroll 4
    for (int first = 0; first < HALF; first += CHUNK) {
        for (int i = threadIdx.x; i < CHUNK / 2 * POOLED * 4; i += blockDim.x) {
            const int at = first / 2 * POOLED * 4 + i;
            Eight value = unpack(raw[at]);
            uint2 from = winner[at];
#pragma unroll
            for (int k = 0; k < 8; k++) {
                value.at[k] = value.at[k] * scale.at[k] + offset.at[k];
                if (!(value.at[k] > 0.0f)) {
                    value.at[k] = 0.0f;
                    (k < 4 ? from.x : from.y) |= (u32)NO_GRADIENT << (8 * (k % 4));
                }
            }
            y[at] = pack(value);
            winner[at] = from;
        }
    }
}

// kept f32 [rows, SIDE, SIDE]; taps [32, 128] bfloat16, of each channel the 4 × 4 window's numbers, channels last.
// y and raw (what was chosen, before the norm) [rows, POOLED, POOLED, 32], winner the same of bytes, mean_rstd
// [rows, 16, 2]. 32 · STEM_WARPS threads.
extern "C" __global__ void __launch_bounds__(32 * STEM_WARPS, 2)
    stem_forward(const float* kept, const u32* taps, const float* weight, const float* bias, uint4* y, uint4* raw,
                 uint2* winner, float* mean_rstd, float scale, float offset) {
    __shared__ uint4 band[BAND * PADDED];
    extern __shared__ uint4 dynamic[];
    __shared__ float by_warp[STEM_WARPS][STEM_GROUPS][2];
    __shared__ float group[STEM_GROUPS][2];
    u32* rows = (u32*)dynamic;
    const int lane = threadIdx.x % 32, warp = threadIdx.x / 32, g = lane / 4, t = lane % 4;
    const size_t row = blockIdx.x, pooled = row * POOLED * POOLED * 4;
    const float* frame = kept + row * SIDE * SIDE;
    uint2 b[4][STEM_TAPS / 16];
#pragma unroll
    for (int n = 0; n < 4; n++) {
#pragma unroll
        for (int k = 0; k < STEM_TAPS / 16; k++) {
            const u32* at = taps + ((8 * n + g) * STEM_TAPS + 16 * k) / 2 + t;
            b[n][k] = make_uint2(at[0], at[4]);
        }
    }
    u32 signs[4];
#pragma unroll
    for (int k = 0; k < 4; k++) {
        const float* pair = weight + threadIdx.x % 4 * 8 + 2 * k;
        signs[k] = (pair[0] < 0.0f ? 0x8000u : 0u) | (pair[1] < 0.0f ? 0x80000000u : 0u);
    }
    const uint4 turned = make_uint4(signs[0], signs[1], signs[2], signs[3]);
    Spread spread = {};
    BandPart part = ask_for_band(frame, 0);
    for (int first = 0; first < HALF; first += CHUNK) {
        fill_band(band, part, scale, offset);
        __syncthreads();
        if (first + CHUNK < HALF) part = ask_for_band(frame, first + CHUNK);
#pragma unroll
        for (int i = 0; i < STEM_TILES; i++) {
            const int tile = warp * STEM_TILES + i;
            u32 x[4][2];
            convolve_tile(x, left_operand(band, tile), [&](u32(&to)[8], int k) {
#pragma unroll
                for (int n = 0; n < 4; n++) {
                    to[2 * n] = b[n][k].x;
                    to[2 * n + 1] = b[n][k].y;
                }
            });
            spread_over(spread, x, first == 0 && i == 0);
#pragma unroll
            for (int j = 0; j < 2; j++) {
                const int pixel = tile * 16 + g + 8 * j, v = first + pixel / HALF, u = pixel % HALF;
                u32* to = rows + ((v % (CHUNK + 1)) * HALF + u) * (STEM_STRIDE / 2) + t;
#pragma unroll
                for (int n = 0; n < 4; n++) to[4 * n] = x[n][j];
            }
        }
        __syncthreads();
        pool_chunk(rows, turned, raw + pooled, winner + pooled, first);
        // The next chunk's band may be filled meanwhile; its rows are written after the next barrier, in the places of
        // all rows but the last, which the next windows need.
    }
    stem_statistics(spread, by_warp, group, mean_rstd + row * 2 * STEM_GROUPS);
    finish_pooling(group, weight, bias, raw + pooled, y + pooled, winner + pooled);
}

// What a frame's backward pass holds in shared memory besides its sums.
struct StemGradients {
    uint4 band[BAND * PADDED];
    // Gradients of the convolution's result, of one chunk.
    u32 dx[CHUNK_PIXELS * STEM_STRIDE / 2];
    // What reaches the chunk's pixels from the windows that chose them.
    float reached[CHUNK_PIXELS * STEM_STRIDE];
    // What arrives at the windows that touch the chunk, and their winners.
    float arrived[(CHUNK / 2 + 1) * POOLED * STEM_STRIDE];
    u8 winner[(CHUNK / 2 + 1) * POOLED * STEM_CHANNELS];
    u32 taps[STEM_CHANNELS * (STEM_TAPS / 2 + 4)];
    float group[STEM_GROUPS][4];
};

// Warps of the backward pass.
#define STEM_BACK_WARPS 8

// Pairs of sums, by channel.
struct StemSums {
    float partial[STEM_BACK_WARPS][STEM_CHANNELS][2];
    float channel[STEM_CHANNELS][2];
    float means[STEM_GROUPS][2];
};

// Σ g and Σ g · x̂ of each channel, from the windows alone: every gradient that arrives reaches one pixel. Afterwards
// `sums.channel` holds them for all threads.
__device__ inline void stem_sums(StemSums& sums, const uint4* dy, const uint4* dy_too, const uint2* winner,
                                 const uint4* raw, const float* mean_rstd) {
    const int octet = threadIdx.x % 4, lane = threadIdx.x % 32, warp = threadIdx.x / 32;
    Eight sum = {}, product = {}, mean, rstd;
#pragma unroll
    for (int k = 0; k < 8; k++) {
        const float* statistic = mean_rstd + (8 * octet + k) / 2 * 2;
        mean.at[k] = statistic[0];
        rstd.at[k] = statistic[1];
    }
    for (int i = threadIdx.x; i < POOLED * POOLED * 4; i += blockDim.x) {
        const Eight g = arriving(dy, dy_too, i), value = unpack(raw[i]);
        const uint2 from = winner[i];
#pragma unroll
        for (int k = 0; k < 8; k++) {
            const u32 chosen = (k < 4 ? from.x : from.y) >> (8 * (k % 4)) & 255u;
            const float passed = chosen == NO_GRADIENT ? 0.0f : g.at[k];
            sum.at[k] += passed;
            product.at[k] += passed * (value.at[k] - mean.at[k]) * rstd.at[k];
        }
    }
    for (int offset = 16; offset >= 4; offset /= 2) {
#pragma unroll
        for (int k = 0; k < 8; k++) {
            sum.at[k] += __shfl_xor_sync(0xffffffffu, sum.at[k], offset);
            product.at[k] += __shfl_xor_sync(0xffffffffu, product.at[k], offset);
        }
    }
    if (lane < 4) {
#pragma unroll
        for (int k = 0; k < 8; k++) {
            sums.partial[warp][8 * lane + k][0] = sum.at[k];
            sums.partial[warp][8 * lane + k][1] = product.at[k];
        }
    }
    __syncthreads();
    if (threadIdx.x < 2 * STEM_CHANNELS) {
        const int channel = threadIdx.x / 2, which = threadIdx.x % 2;
        float total = 0.0f;
        for (int w = 0; w < STEM_BACK_WARPS; w++) total += sums.partial[w][channel][which];
        sums.channel[channel][which] = total;
    }
    __syncthreads();
}

// Turns those sums into what both channels of a group share: the means of w·g and w·g·x̂. Writes the row's share of the
// gradients: [2, channels], bias first.
__device__ inline void stem_means(StemSums& sums, const float* weight, float* gradients) {
    if (threadIdx.x < STEM_CHANNELS) {
        gradients[threadIdx.x] = sums.channel[threadIdx.x][0];
        gradients[STEM_CHANNELS + threadIdx.x] = sums.channel[threadIdx.x][1];
    }
    if (threadIdx.x < 2 * STEM_GROUPS) {
        const int group = threadIdx.x / 2, which = threadIdx.x % 2;
        float total = 0.0f;
        for (int c = 2 * group; c < 2 * group + 2; c++) total += weight[c] * sums.channel[c][which];
        sums.means[group][which] = total / (2 * HALF * HALF);
    }
    __syncthreads();
}

// The windows that touch the chunk which begins with row `first`, into shared memory.
__device__ inline void fill_windows(StemGradients& s, const uint4* dy, const uint4* dy_too, const uint2* winner,
                                    int first) {
    for (int i = threadIdx.x; i < (CHUNK / 2 + 1) * POOLED * 4; i += blockDim.x) {
        const int octet = i % 4, window = i / 4;
        if (first / 2 + window / POOLED >= POOLED) break;
        const int at = first / 2 * POOLED * 4 + i;
        const Eight g = arriving(dy, dy_too, at);
        float* to = s.arrived + window * STEM_STRIDE + 8 * octet;
#pragma unroll
        for (int k = 0; k < 8; k++) to[k] = g.at[k];
        *(uint2*)(s.winner + window * STEM_CHANNELS + 8 * octet) = winner[at];
    }
}

// Hands what arrives at the windows on to the pixels that they chose. Window w covers pixels 2w - 1 .. 2w + 1, so every
// second window in either direction shares no pixel with the others: four rounds, and sums have one order.
__device__ inline void hand_on(StemGradients& s, int first) {
    const int channel = threadIdx.x % 32, warp = threadIdx.x / 32;
#pragma unroll
    for (int round = 0; round < 4; round++) {
        // Rows of windows: 0 and 2, or 1; the last lies beyond the map in the last chunk.
        const int rows = round / 2 ? 1 : first / 2 + 2 < POOLED ? 2 : 1;
        for (int i = warp; i < rows * POOLED / 2; i += blockDim.x / 32) {
            const int row = round / 2 + i / (POOLED / 2) * 2, wu = i % (POOLED / 2) * 2 + round % 2;
            const int window = row * POOLED + wu;
            const int pixel = s.winner[window * STEM_CHANNELS + channel];
            const int v = 2 * row - 1 + pixel / 3, u = 2 * wu - 1 + pixel % 3;
            if (pixel == NO_GRADIENT || v < 0 || v >= CHUNK) continue;
            s.reached[(v * HALF + u) * STEM_STRIDE + channel] += s.arrived[window * STEM_STRIDE + channel];
        }
        __syncthreads();
    }
}

// dx of one tile of the chunk, into shared memory.
__device__ inline void gradient_of_tile(StemGradients& s, const float* weight, int tile) {
    const int lane = threadIdx.x % 32, g = lane / 4, t = lane % 4;
    u32 x[4][2];
    const u32 taps = shared_address(s.taps) +
                     ((lane / 16 * 8 + lane % 8) * (STEM_TAPS + 8) + lane / 8 % 2 * 8) * (int)sizeof(short);
    convolve_tile(x, left_operand(s.band, tile), [&](u32(&to)[8], int k) {
        load_matrices((u32(&)[4])to[0], taps + k * 32);
        load_matrices((u32(&)[4])to[4], taps + k * 32 + 16 * (STEM_TAPS + 8) * (int)sizeof(short));
    });
#pragma unroll
    for (int j = 0; j < 2; j++) {
        const int pixel = tile * 16 + g + 8 * j;
#pragma unroll
        for (int n = 0; n < 4; n++) {
            const int channel = 8 * n + 2 * t;
            const float* shared = s.group[channel / 2];
            const float2 arrived = *(const float2*)(s.reached + pixel * STEM_STRIDE + channel);
            const float mean = shared[0], rstd = shared[1];
            const float one = weight[channel] * arrived.x - shared[2] - (low(x[n][j]) - mean) * rstd * shared[3];
            const float two = weight[channel + 1] * arrived.y - shared[2] - (high(x[n][j]) - mean) * rstd * shared[3];
            s.dx[pixel * (STEM_STRIDE / 2) + 4 * n + t] = two_bfloat16(rstd * one, rstd * two);
        }
    }
}

// Adds the chunk's share of the weight's gradient: 32 channels × the 16 taps of this warp.
__device__ inline void add_stem_weight_gradient(float (&sum)[2][2][4], const StemGradients& s) {
    const int lane = threadIdx.x % 32, warp = threadIdx.x / 32;
    const int position = 2 * warp + lane / 16;
    const u32 band = shared_address(s.band + position / 4 * PADDED + position % 4);
    const u32 from = shared_address(s.dx) + ((lane % 8 + lane / 16 * 8) * STEM_STRIDE + lane / 8 % 2 * 8) * 2;
    int v = lane % 16 / HALF, u = lane % 16 % HALF;
#pragma unroll 7
    for (int tile = 0; tile < CHUNK_PIXELS / 16; tile++) {
        u32 taps[4];
        load_transposed(taps, band + (v * PADDED + u) * 16);
        u += 16;
        if (u >= HALF) {
            u -= HALF;
            v++;
        }
#pragma unroll
        for (int m = 0; m < 2; m++) {
            u32 dx[4];
            load_transposed(dx, from + tile * 16 * STEM_STRIDE * 2 + m * 32);
            multiply(sum[m][0], dx, taps[0], taps[1]);
            multiply(sum[m][1], dx, taps[2], taps[3]);
        }
    }
}

// Gradients of stem_forward for dy (+ dy_too?): of the taps, [blocks, 32, 128], summed over the frames of a block; and
// each frame's share of those of bias and weight, [rows, 2, 32]. 256 threads.
extern "C" __global__ void __launch_bounds__(256, 2)
    stem_backward(const uint4* dy, const uint4* dy_too, const uint2* winner, const uint4* raw, const float* mean_rstd,
                  const float* kept, const u32* taps, const float* weight, float* d_taps, float* gradients, float scale,
                  float offset, int rows) {
    extern __shared__ uint4 dynamic[];
    StemGradients& s = *(StemGradients*)dynamic;
    __shared__ StemSums sums;
    const int lane = threadIdx.x % 32, warp = threadIdx.x / 32, g = lane / 4, t = lane % 4;
    for (int i = threadIdx.x; i < STEM_CHANNELS * STEM_TAPS / 2; i += blockDim.x)
        s.taps[i / (STEM_TAPS / 2) * (STEM_TAPS / 2 + 4) + i % (STEM_TAPS / 2)] = taps[i];
    float sum[2][2][4] = {};
    for (size_t row = blockIdx.x; row < rows; row += gridDim.x) {
        const size_t pooled = row * POOLED * POOLED * 4;
        const uint4* second = dy_too ? dy_too + pooled : 0;
        const float* statistics = mean_rstd + row * 2 * STEM_GROUPS;
        stem_sums(sums, dy + pooled, second, winner + pooled, raw + pooled, statistics);
        stem_means(sums, weight, gradients + row * 2 * STEM_CHANNELS);
        if (threadIdx.x < 4 * STEM_GROUPS) {
            const int group = threadIdx.x / 4, which = threadIdx.x % 4;
            s.group[group][which] = which < 2 ? statistics[2 * group + which] : sums.means[group][which - 2];
        }
        for (int first = 0; first < HALF; first += CHUNK) {
            fill_band(s.band, ask_for_band(kept + row * SIDE * SIDE, first), scale, offset);
            fill_windows(s, dy + pooled, second, winner + pooled, first);
            for (int i = threadIdx.x; i < CHUNK_PIXELS * STEM_STRIDE / 4; i += blockDim.x)
                ((float4*)s.reached)[i] = make_float4(0.0f, 0.0f, 0.0f, 0.0f);
            __syncthreads();
            hand_on(s, first);
            if (warp < STEM_WARPS)
                for (int i = 0; i < STEM_TILES; i++) gradient_of_tile(s, weight, warp * STEM_TILES + i);
            __syncthreads();
            add_stem_weight_gradient(sum, s);
            __syncthreads();
        }
    }
    d_taps += (size_t)blockIdx.x * STEM_CHANNELS * STEM_TAPS;
#pragma unroll
    for (int m = 0; m < 2; m++) {
#pragma unroll
        for (int n = 0; n < 2; n++) {
            float* to = d_taps + (16 * m + g) * STEM_TAPS + (2 * warp + n) * 8 + 2 * t;
            to[0] = sum[m][n][0];
            to[1] = sum[m][n][1];
            to[8 * STEM_TAPS] = sum[m][n][2];
            to[8 * STEM_TAPS + 1] = sum[m][n][3];
        }
    }
}
