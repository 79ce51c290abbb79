// Group normalisation as the ResNet uses it, forward and backward, one launch each: bfloat16 feature maps
// [rows, pixels, channels] with channels last, all arithmetic in float32, sums in a fixed order.
//
// One block works on one row's whole map. KEEP: its threads ask for all of it at once, into shared memory, so that many
// bytes are on their way while few registers are used; a thread reads what it asked for, so it need not wait for
// others. Without KEEP, for maps that shared memory cannot hold, the map is read twice, the second time from the L2
// cache. There is one barrier: between the sums of each warp and their total.
//
// A thread owns the same eight neighbouring channels (16 bytes, an octet) of every pixel it visits: threads are a
// multiple of channels / 8, which is a power of two of at most 32, and channels / groups is one of at least 2. So an
// octet holds up to four whole groups, or a group spans octets that are lanes of one warp.

// How channels, octets and groups lie for one thread.
struct Layout {
    int octets, octet, groups, per_group;
    // Octets that a group spans, at least 1, and the group of the octet's first channel.
    int span, group;
};

__device__ inline Layout layout(int channels, int groups) {
    const int octets = channels / 8, octet = threadIdx.x % octets, per_group = channels / groups;
    return {octets, octet, groups, per_group, max(per_group / 8, 1), 8 * octet / per_group};
}

// A number for each group of an octet, of which IN channels share one: 2, 4 or all 8.
template <int IN>
struct OfGroups {
    float at[8 / IN];

    // That of the octet's channel k.
    __device__ inline float of(int k) const { return at[k / IN]; }
};

// From eight channels to their groups.
template <int IN>
__device__ inline OfGroups<IN> fold(Eight x) {
    OfGroups<IN> out;
#pragma unroll
    for (int width = 1; width < IN; width *= 2) {
#pragma unroll
        for (int k = 0; k < 8; k += 2 * width) x.at[k] += x.at[k + width];
    }
#pragma unroll
    for (int j = 0; j < 8 / IN; j++) out.at[j] = x.at[j * IN];
    return out;
}

// Two sums of each group over a warp, into shared memory: `partial` [warps, groups].
template <int IN>
__device__ inline void sum_warp(OfGroups<IN> first, OfGroups<IN> second, float2* partial, const Layout& at) {
    const int lane = threadIdx.x % 32;
    float2* to = partial + threadIdx.x / 32 * at.groups + at.group;
#pragma unroll
    for (int j = 0; j < 8 / IN; j++) {
        for (int offset = 16; offset > 0; offset /= 2) {
            // Lanes of the same octet, then those of the other octets of its group.
            if (offset < at.octets && offset >= at.span) continue;
            first.at[j] += __shfl_xor_sync(0xffffffffu, first.at[j], offset);
            second.at[j] += __shfl_xor_sync(0xffffffffu, second.at[j], offset);
        }
        if (lane < at.octets && lane % at.span == 0) to[j] = make_float2(first.at[j], second.at[j]);
    }
}

// After a barrier: those sums over all warps.
template <int IN>
__device__ inline void sum_block(OfGroups<IN>& first, OfGroups<IN>& second, const float2* partial, const Layout& at) {
#pragma unroll
    for (int j = 0; j < 8 / IN; j++) {
        first.at[j] = second.at[j] = 0.0f;
        for (int warp = 0; warp < blockDim.x / 32; warp++) {
            const float2 part = partial[warp * at.groups + at.group + j];
            first.at[j] += part.x;
            second.at[j] += part.y;
        }
    }
}

// What normalisation, weight and bias do to a channel: x · scale + offset. Rounded in the same places wherever it
// stands: the backward pass asks what ReLU let through.
__device__ inline float scale_of(float rstd, float weight) {
    return __fmul_rn(rstd, weight);
}

__device__ inline float offset_of(float mean, float scale, float bias) {
    return __fmaf_rn(-mean, scale, bias);
}

__device__ inline float normed(float x, float scale, float offset) {
    return __fmaf_rn(x, scale, offset);
}

// Four of eight numbers, from the first on, as they are.
__device__ inline uint4 half_of(const Eight& x, int first) {
    const float* half = x.at + first;
    return make_uint4(__float_as_uint(half[0]), __float_as_uint(half[1]), __float_as_uint(half[2]),
                      __float_as_uint(half[3]));
}

__device__ inline void put_half(Eight& x, int first, uint4 half) {
    const u32 words[4] = {half.x, half.y, half.z, half.w};
#pragma unroll
    for (int k = 0; k < 4; k++) x.at[first + k] = __uint_as_float(words[k]);
}

// Asks for a map of so many octets; each thread for those that it owns.
template <bool KEEP>
__device__ inline const uint4* ask(const uint4* map, uint4* kept, int count) {
    if (!KEEP) return map;
#pragma unroll 4
    for (int i = threadIdx.x; i < count; i += blockDim.x) ask_for(kept + i, map + i);
    return kept;
}

// y = relu?(norm(x) + around?), and mean_rstd [rows, groups, 2]. Shared memory: x and `around`, where kept, and
// [warps, groups] sums.
template <bool KEEP, int IN>
__device__ inline void forward(const uint4* x, const uint4* around, const float* weight, const float* bias, uint4* y,
                               float* mean_rstd, int pixels, int channels, int groups, int relu) {
    extern __shared__ __align__(512) uint4 dynamic[];
    const Layout at = layout(channels, groups);
    const int count = pixels * at.octets;
    const size_t row = blockIdx.x, base = row * count;
    // Sums are of differences to the group's first number: no cancellation.
    const Eight first_pixel = unpack(x[base + at.octet / at.span * at.span]);
    uint4* room = dynamic;
    x = ask<KEEP>(x + base, room, count);
    room += KEEP ? count : 0;
    if (around) {
        around = ask<KEEP>(around + base, room, count);
        room += KEEP ? count : 0;
    }
    float2* partial = (float2*)room;
    y += base;
    OfGroups<IN> origin;
#pragma unroll
    for (int j = 0; j < 8 / IN; j++) origin.at[j] = first_pixel.at[j * IN];
    Eight sum = {}, squares = {};
    if (KEEP) await_all();
    for (int i = threadIdx.x; i < count; i += blockDim.x) {
        const Eight value = unpack(x[i]);
#pragma unroll
        for (int k = 0; k < 8; k++) {
            const float difference = value.at[k] - origin.of(k);
            sum.at[k] += difference;
            squares.at[k] += difference * difference;
        }
    }
    OfGroups<IN> first = fold<IN>(sum), second = fold<IN>(squares);
    sum_warp(first, second, partial, at);
    const Eight w = load(weight, at.octet), b = load(bias, at.octet);
    __syncthreads();
    sum_block(first, second, partial, at);
    OfGroups<IN> mean, rstd;
    const float numbers = at.per_group * pixels;
#pragma unroll
    for (int j = 0; j < 8 / IN; j++) {
        const float shift = first.at[j] / numbers;
        mean.at[j] = origin.at[j] + shift;
        rstd.at[j] = rsqrtf(fmaxf(second.at[j] - shift * first.at[j], 0.0f) / numbers + EPSILON);
        if (threadIdx.x < at.octets && at.octet % at.span == 0)
            ((float2*)mean_rstd)[row * groups + at.group + j] = make_float2(mean.at[j], rstd.at[j]);
    }
    Eight scale, offset;
#pragma unroll
    for (int k = 0; k < 8; k++) {
        scale.at[k] = scale_of(rstd.of(k), w.at[k]);
        offset.at[k] = offset_of(mean.of(k), scale.at[k], b.at[k]);
    }
    for (int i = threadIdx.x; i < count; i += blockDim.x) {
        Eight value = unpack(x[i]);
#pragma unroll
        for (int k = 0; k < 8; k++) value.at[k] = normed(value.at[k], scale.at[k], offset.at[k]);
        if (around) {
            const Eight other = unpack(around[i]);
#pragma unroll
            for (int k = 0; k < 8; k++) value.at[k] += other.at[k];
        }
        if (relu) {
#pragma unroll
            for (int k = 0; k < 8; k++) value.at[k] = fmaxf(value.at[k], 0.0f);
        }
        y[i] = pack(value);
    }
}

// Two sums of each channel over a warp, into shared memory: [warps, 8, octets + 1], the channels of an octet apart, so that
// lanes write to different banks.
__device__ inline void sum_channels(Eight first, Eight second, float2* by_channel, const Layout& at) {
    for (int lanes = 16; lanes >= at.octets; lanes /= 2) {
#pragma unroll
        for (int k = 0; k < 8; k++) {
            first.at[k] += __shfl_xor_sync(0xffffffffu, first.at[k], lanes);
            second.at[k] += __shfl_xor_sync(0xffffffffu, second.at[k], lanes);
        }
    }
    if (threadIdx.x % 32 >= at.octets) return;
    float2* to = by_channel + threadIdx.x / 32 * 8 * (at.octets + 1) + at.octet;
#pragma unroll
    for (int k = 0; k < 8; k++) to[k * (at.octets + 1)] = make_float2(first.at[k], second.at[k]);
}

// After a barrier: those sums over all warps, to [2, channels].
__device__ inline void put_channels(const float2* by_channel, float* to, int channels, const Layout& at) {
    for (int c = threadIdx.x; c < channels; c += blockDim.x) {
        float2 total = make_float2(0.0f, 0.0f);
        for (int warp = 0; warp < blockDim.x / 32; warp++) {
            const float2 part = by_channel[(warp * 8 + c % 8) * (at.octets + 1) + c / 8];
            total.x += part.x;
            total.y += part.y;
        }
        to[c] = total.x;
        to[channels + c] = total.y;
    }
}

// Mean and 1 / standard deviation of an octet's groups, as the forward pass wrote them for its row.
template <int IN>
__device__ inline void load_groups(OfGroups<IN>& mean, OfGroups<IN>& rstd, const float* mean_rstd, const Layout& at) {
#pragma unroll
    for (int j = 0; j < 8 / IN; j++) {
        const float2 statistic = ((const float2*)mean_rstd)[at.group + j];
        mean.at[j] = statistic.x;
        rstd.at[j] = statistic.y;
    }
}

// Where a ReLU follows a norm, and how the backward pass tells what it let through.
#define NO_RELU 0
// Of the norm alone: from x.
#define RELU 1
// Of the norm and what goes around it: from the output.
#define RELU_OF_SUM 2

// dx of y = relu?(norm(x) + around?) for dy (+ dy_too?). d_around, where wanted, is the gradient of `around`.
// gradients [rows, 2, channels]: a row's share of those of bias and weight. Shared memory: x, dy, and if there are such,
// dy_too and y, where kept; sums of channels, and [warps, groups].
// A thread's registers hold what all of its parts share.
template <bool KEEP, int IN>
__device__ inline void backward(const uint4* dy, const uint4* dy_too, const uint4* y, const uint4* x,
                                const float* mean_rstd, const float* weight, const float* bias, uint4* dx,
                                uint4* d_around, float* gradients, int pixels, int channels, int groups, int relu) {
    extern __shared__ __align__(512) uint4 dynamic[];
    const Layout at = layout(channels, groups);
    const int count = pixels * at.octets;
    const size_t row = blockIdx.x, base = row * count;
    uint4 *room = dynamic, *kept_dy = room;
    x = ask<KEEP>(x + base, room + (KEEP ? count : 0), count);
    dy = ask<KEEP>(dy + base, kept_dy, count);
    room += KEEP ? 2 * count : 0;
    uint4* kept_too = room;
    if (dy_too) {
        dy_too = ask<KEEP>(dy_too + base, kept_too, count);
        room += KEEP ? count : 0;
    }
    if (relu == RELU_OF_SUM) {
        y = ask<KEEP>(y + base, room, count);
        room += KEEP ? count : 0;
    }
    float2* by_channel = (float2*)room;
    float2* partial = by_channel + blockDim.x / 32 * 8 * (at.octets + 1);
    OfGroups<IN> mean, rstd;
    load_groups(mean, rstd, mean_rstd + row * groups * 2, at);
    const Eight w = load(weight, at.octet);
    Eight offset = {};
    if (relu == RELU) {
        offset = load(bias, at.octet);
#pragma unroll
        for (int k = 0; k < 8; k++)
            offset.at[k] = offset_of(mean.of(k), scale_of(rstd.of(k), w.at[k]), offset.at[k]);
    }
    // The gradient that reaches the norm.
    const auto arriving_at = [&](int i, const Eight& value) {
        Eight g = arriving(dy, dy_too, i);
        if (relu == RELU) {
#pragma unroll
            for (int k = 0; k < 8; k++) {
                const float scale = scale_of(rstd.of(k), w.at[k]);
                g.at[k] = normed(value.at[k], scale, offset.at[k]) > 0.0f ? g.at[k] : 0.0f;
            }
        } else if (relu == RELU_OF_SUM) {
            const Eight output = unpack(y[i]);
#pragma unroll
            for (int k = 0; k < 8; k++) g.at[k] = output.at[k] > 0.0f ? g.at[k] : 0.0f;
        }
        return g;
    };
    Eight sum = {}, product = {};
    if (KEEP) await_all();
    for (int i = threadIdx.x; i < count; i += blockDim.x) {
        const Eight value = unpack(x[i]), g = arriving_at(i, value);
#pragma unroll
        for (int k = 0; k < 8; k++) {
            sum.at[k] += g.at[k];
            product.at[k] += g.at[k] * (value.at[k] - mean.of(k));
        }
        if (d_around) d_around[base + i] = pack(g);
        // In the place of what it came from: eight float32 take that of both users' gradients.
        if (KEEP && dy_too) {
            kept_dy[i] = half_of(g, 0);
            kept_too[i] = half_of(g, 4);
        } else if (KEEP && relu != NO_RELU) {
            kept_dy[i] = pack(g);
        }
    }
#pragma unroll
    for (int k = 0; k < 8; k++) product.at[k] *= rstd.of(k);
    Eight weighted_sum, weighted_product;
#pragma unroll
    for (int k = 0; k < 8; k++) {
        weighted_sum.at[k] = w.at[k] * sum.at[k];
        weighted_product.at[k] = w.at[k] * product.at[k];
    }
    OfGroups<IN> first = fold<IN>(weighted_sum), second = fold<IN>(weighted_product);
    sum_warp(first, second, partial, at);
    sum_channels(sum, product, by_channel, at);
    __syncthreads();
    sum_block(first, second, partial, at);
    // dx = rstd · (w · g - mean(w · g) - x̂ · mean(w · g · x̂)), x̂ = (x - mean) · rstd.
    const float numbers = at.per_group * pixels;
#pragma unroll
    for (int j = 0; j < 8 / IN; j++) {
        first.at[j] *= rstd.at[j] / numbers;
        second.at[j] *= rstd.at[j] * rstd.at[j] / numbers;
    }
    for (int i = threadIdx.x; i < count; i += blockDim.x) {
        const Eight value = unpack(x[i]);
        Eight g;
        if (KEEP && dy_too) {
            put_half(g, 0, kept_dy[i]);
            put_half(g, 4, kept_too[i]);
        } else if (KEEP) {
            g = unpack(kept_dy[i]);
        } else {
            g = arriving_at(i, value);
        }
        Eight out;
#pragma unroll
        for (int k = 0; k < 8; k++) {
            const float centred = value.at[k] - mean.of(k);
            const float own = scale_of(rstd.of(k), w.at[k]) * g.at[k];
            out.at[k] = own - first.of(k) - centred * second.of(k);
        }
        dx[base + i] = pack(out);
    }
    put_channels(by_channel, gradients + row * 2 * channels, channels, at);
}

#define NORM(IN, KEEP, NAME)                                                                                           \
    extern "C" __global__ void norm_forward_##NAME(const uint4* x, const uint4* around, const float* weight,           \
                                                   const float* bias, uint4* y, float* mean_rstd, int pixels,          \
                                                   int channels, int groups, int relu) {                               \
        forward<KEEP, IN>(x, around, weight, bias, y, mean_rstd, pixels, channels, groups, relu);                      \
    }                                                                                                                  \
    extern "C" __global__ void norm_backward_##NAME(const uint4* dy, const uint4* dy_too, const uint4* y,              \
                                                    const uint4* x, const float* mean_rstd, const float* weight,       \
                                                    const float* bias, uint4* dx, uint4* d_around, float* gradients,   \
                                                    int pixels, int channels, int groups, int relu) {                  \
        backward<KEEP, IN>(dy, dy_too, y, x, mean_rstd, weight, bias, dx, d_around, gradients, pixels, channels,       \
                           groups, relu);                                                                              \
    }

NORM(2, true, kept_2)
NORM(4, true, kept_4)
NORM(8, true, kept_8)
NORM(2, false, reread_2)
NORM(4, false, reread_4)
NORM(8, false, reread_8)
