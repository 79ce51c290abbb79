// Group normalisation as the ResNet uses it, forward and backward, one launch each: bfloat16 feature maps
// [rows, pixels, channels] with channels last, all arithmetic in float32, sums in a fixed order.
//
// One block works on one row's whole map, which it reads twice: once for the sums, once to write. The second reading
// comes from the L2 cache. A thread owns the same eight neighbouring channels (16 bytes) of every pixel it visits:
// threads are a multiple of channels / 8, and channels / 8 is a power of two of at most 32.
//
// Compiled at start-up by NVRTC, without headers: hence the conversions by hand.

typedef unsigned char u8;
typedef unsigned int u32;

#define EPSILON 1e-5f
#define NO_GRADIENT 255

// Largest number of channels, and of channels times warps in a block.
#define MAX_CHANNELS 256
#define MAX_PARTIAL_SUMS 2048

struct Eight {
    float at[8];
};

__device__ inline Eight unpack(uint4 bits) {
    const u32 words[4] = {bits.x, bits.y, bits.z, bits.w};
    Eight out;
#pragma unroll
    for (int i = 0; i < 4; i++) {
        out.at[2 * i] = __uint_as_float(words[i] << 16);
        out.at[2 * i + 1] = __uint_as_float(words[i] & 0xffff0000u);
    }
    return out;
}

__device__ inline u32 two_bfloat16(float low, float high) {
    u32 bits;
    asm("cvt.rn.bf16x2.f32 %0, %1, %2;" : "=r"(bits) : "f"(high), "f"(low));
    return bits;
}

__device__ inline uint4 pack(const Eight& x) {
    return make_uint4(two_bfloat16(x.at[0], x.at[1]), two_bfloat16(x.at[2], x.at[3]), two_bfloat16(x.at[4], x.at[5]),
                      two_bfloat16(x.at[6], x.at[7]));
}

__device__ inline Eight load(const float* from, int octet) {
    Eight out;
#pragma unroll
    for (int i = 0; i < 8; i++) out.at[i] = from[8 * octet + i];
    return out;
}

// Sums over a block, by channel.
struct Sums {
    float partial[MAX_PARTIAL_SUMS][2];
    float channel[MAX_CHANNELS][2];
};

// Adds up every thread's pair of sums a channel; afterwards `sums.channel` holds them for all threads.
__device__ inline void add_up(Sums& sums, Eight first, Eight second, int octets, int channels) {
    const int lane = threadIdx.x % 32, warp = threadIdx.x / 32, warps = blockDim.x / 32;
    for (int offset = 16; offset >= octets; offset /= 2) {
#pragma unroll
        for (int i = 0; i < 8; i++) {
            first.at[i] += __shfl_xor_sync(0xffffffffu, first.at[i], offset);
            second.at[i] += __shfl_xor_sync(0xffffffffu, second.at[i], offset);
        }
    }
    if (lane < octets) {
#pragma unroll
        for (int i = 0; i < 8; i++) {
            sums.partial[warp * channels + 8 * lane + i][0] = first.at[i];
            sums.partial[warp * channels + 8 * lane + i][1] = second.at[i];
        }
    }
    __syncthreads();
    for (int channel = threadIdx.x; channel < channels; channel += blockDim.x) {
        float total[2] = {0.0f, 0.0f};
        for (int w = 0; w < warps; w++) {
            total[0] += sums.partial[w * channels + channel][0];
            total[1] += sums.partial[w * channels + channel][1];
        }
        sums.channel[channel][0] = total[0];
        sums.channel[channel][1] = total[1];
    }
    __syncthreads();
}

// Mean and 1 / standard deviation of each group of one row. Sums are of differences to the channel's first pixel, and
// channels are combined by their means and squared deviations (Chan, Golub, LeVeque 1983): no cancellation.
__device__ inline void statistics(const uint4* x, float* mean_rstd, Sums& sums, float (*group)[2], int pixels,
                                  int channels, int groups) {
    const int octets = channels / 8, octet = threadIdx.x % octets, per_group = channels / groups;
    const Eight origin = unpack(x[octet]);
    Eight sum = {}, squares = {};
    for (int i = threadIdx.x; i < pixels * octets; i += blockDim.x) {
        const Eight value = unpack(x[i]);
#pragma unroll
        for (int k = 0; k < 8; k++) {
            const float difference = value.at[k] - origin.at[k];
            sum.at[k] += difference;
            squares.at[k] += difference * difference;
        }
    }
    add_up(sums, sum, squares, octets, channels);
    // From sums of differences to mean and squared deviation.
    for (int c = threadIdx.x; c < channels; c += blockDim.x) {
        const Eight first = unpack(x[c / 8]);
        const float shift = sums.channel[c][0] / pixels;
        sums.channel[c][1] -= shift * sums.channel[c][0];
        sums.channel[c][0] = first.at[c % 8] + shift;
    }
    __syncthreads();
    for (int g = threadIdx.x; g < groups; g += blockDim.x) {
        float mean = 0.0f, deviation = 0.0f;
        for (int c = g * per_group; c < (g + 1) * per_group; c++) mean += sums.channel[c][0];
        mean /= per_group;
        for (int c = g * per_group; c < (g + 1) * per_group; c++) {
            const float offset = sums.channel[c][0] - mean;
            deviation += sums.channel[c][1] + pixels * offset * offset;
        }
        const float rstd = rsqrtf(deviation / (per_group * pixels) + EPSILON);
        group[g][0] = mean;
        group[g][1] = rstd;
        mean_rstd[2 * g] = mean;
        mean_rstd[2 * g + 1] = rstd;
    }
    __syncthreads();
}

// What normalisation, weight and bias do to eight channels: x · scale + offset.
__device__ inline void affine(const float (*group)[2], const float* weight, const float* bias, int octet, int per_group,
                              Eight& scale, Eight& offset) {
#pragma unroll
    for (int k = 0; k < 8; k++) {
        const int channel = 8 * octet + k;
        const float* statistic = group[channel / per_group];
        scale.at[k] = statistic[1] * weight[channel];
        offset.at[k] = bias[channel] - statistic[0] * scale.at[k];
    }
}

// y = relu?(norm(x) + around?), and mean_rstd [rows, groups, 2].
extern "C" __global__ void norm_forward(const uint4* x, const uint4* around, const float* weight, const float* bias,
                                        uint4* y, float* mean_rstd, int pixels, int channels, int groups, int relu) {
    __shared__ Sums sums;
    __shared__ float group[MAX_CHANNELS][2];
    const int octets = channels / 8, octet = threadIdx.x % octets;
    const size_t row = blockIdx.x, base = row * pixels * octets;
    x += base;
    y += base;
    statistics(x, mean_rstd + row * groups * 2, sums, group, pixels, channels, groups);
    Eight scale, offset;
    affine(group, weight, bias, octet, channels / groups, scale, offset);
    for (int i = threadIdx.x; i < pixels * octets; i += blockDim.x) {
        Eight value = unpack(x[i]);
#pragma unroll
        for (int k = 0; k < 8; k++) value.at[k] = value.at[k] * scale.at[k] + offset.at[k];
        if (around) {
            const Eight other = unpack(around[base + i]);
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

// Mean and 1 / standard deviation of eight channels.
struct Normalisation {
    Eight mean, rstd;
};

// Of one octet, from the statistics of its row.
__device__ inline Normalisation normalisation(const float* mean_rstd, size_t row, int groups, int octet, int per_group) {
    Normalisation norm;
#pragma unroll
    for (int k = 0; k < 8; k++) {
        const float* statistic = mean_rstd + (row * groups + (8 * octet + k) / per_group) * 2;
        norm.mean.at[k] = statistic[0];
        norm.rstd.at[k] = statistic[1];
    }
    return norm;
}

// The gradient of a norm's input, from that of its output and from what the channels of a group share.
__device__ inline Eight through(const Normalisation& norm, const Eight& weight, const float (*means)[2], const Eight& g,
                                const Eight& value, int octet, int per_group) {
    Eight out;
#pragma unroll
    for (int k = 0; k < 8; k++) {
        const float* shared = means[(8 * octet + k) / per_group];
        const float normal = (value.at[k] - norm.mean.at[k]) * norm.rstd.at[k];
        out.at[k] = norm.rstd.at[k] * (weight.at[k] * g.at[k] - shared[0] - normal * shared[1]);
    }
    return out;
}

// Turns the sums Σ g and Σ g·x̂ of each channel into what all channels of a group share: the means of w·g and w·g·x̂.
// Writes the row's share of the gradients: [2, channels], bias first.
__device__ inline void group_means(Sums& sums, const float* weight, float* gradients, float (*means)[2], int pixels,
                                   int channels, int groups) {
    const int per_group = channels / groups;
    for (int c = threadIdx.x; c < channels; c += blockDim.x) {
        gradients[c] = sums.channel[c][0];
        gradients[channels + c] = sums.channel[c][1];
    }
    for (int g = threadIdx.x; g < groups; g += blockDim.x) {
        float first = 0.0f, second = 0.0f;
        for (int c = g * per_group; c < (g + 1) * per_group; c++) {
            first += weight[c] * sums.channel[c][0];
            second += weight[c] * sums.channel[c][1];
        }
        means[g][0] = first / (per_group * pixels);
        means[g][1] = second / (per_group * pixels);
    }
    __syncthreads();
}

// The gradient that reaches a norm: of one or two users of its output, and where a ReLU follows, of what it let
// through.
__device__ inline Eight arriving(const uint4* dy, const uint4* dy_too, const uint4* y, size_t i) {
    Eight g = unpack(dy[i]);
    if (dy_too) {
        const Eight more = unpack(dy_too[i]);
#pragma unroll
        for (int k = 0; k < 8; k++) g.at[k] += more.at[k];
    }
    if (y) {
        const Eight output = unpack(y[i]);
#pragma unroll
        for (int k = 0; k < 8; k++) g.at[k] = output.at[k] > 0.0f ? g.at[k] : 0.0f;
    }
    return g;
}

// dx of y = relu?(norm(x) + around?) for dy (+ dy_too?); `y` is given where a ReLU follows. d_around, where wanted, is
// the gradient of `around`. gradients [rows, 2, channels]: a row's share of those of bias and weight.
extern "C" __global__ void norm_backward(const uint4* dy, const uint4* dy_too, const uint4* y, const uint4* x,
                                         const float* mean_rstd, const float* weight, uint4* dx, uint4* d_around,
                                         float* gradients, int pixels, int channels, int groups) {
    __shared__ Sums sums;
    __shared__ float means[MAX_CHANNELS][2];
    const int octets = channels / 8, octet = threadIdx.x % octets, per_group = channels / groups;
    const size_t row = blockIdx.x, base = row * pixels * octets;
    const Normalisation norm = normalisation(mean_rstd, row, groups, octet, per_group);
    Eight sum = {}, product = {};
    for (int i = threadIdx.x; i < pixels * octets; i += blockDim.x) {
        const Eight g = arriving(dy, dy_too, y, base + i), value = unpack(x[base + i]);
#pragma unroll
        for (int k = 0; k < 8; k++) {
            sum.at[k] += g.at[k];
            product.at[k] += g.at[k] * (value.at[k] - norm.mean.at[k]) * norm.rstd.at[k];
        }
        if (d_around) d_around[base + i] = pack(g);
    }
    add_up(sums, sum, product, octets, channels);
    group_means(sums, weight, gradients + row * 2 * channels, means, pixels, channels, groups);
    const Eight w = load(weight, octet);
    for (int i = threadIdx.x; i < pixels * octets; i += blockDim.x) {
        const Eight g = arriving(dy, dy_too, y, base + i), value = unpack(x[base + i]);
        dx[base + i] = pack(through(norm, w, means, g, value, octet, per_group));
    }
}

// The stem: y = max_pool(relu(norm(x))), windows 3 × 3, stride 2, padding 1, on square maps of `side`. `winner` says
// which of a window's nine pixels (row-major) each number came from, or NO_GRADIENT where the ReLU stopped all of them.
extern "C" __global__ void stem_forward(const uint4* x, const float* weight, const float* bias, uint4* y, uint2* winner,
                                        float* mean_rstd, int side, int channels, int groups) {
    __shared__ Sums sums;
    __shared__ float group[MAX_CHANNELS][2];
    const int octets = channels / 8, octet = threadIdx.x % octets, half = (side + 1) / 2;
    const size_t row = blockIdx.x;
    x += row * side * side * octets;
    y += row * half * half * octets;
    winner += row * half * half * octets;
    statistics(x, mean_rstd + row * groups * 2, sums, group, side * side, channels, groups);
    Eight scale, offset;
    affine(group, weight, bias, octet, channels / groups, scale, offset);
    for (int i = threadIdx.x; i < half * half * octets; i += blockDim.x) {
        const int top = i / octets / half * 2 - 1, left = i / octets % half * 2 - 1;
        Eight best = {};
        u8 from[8];
#pragma unroll
        for (int k = 0; k < 8; k++) from[k] = NO_GRADIENT;
#pragma unroll
        for (int pixel = 0; pixel < 9; pixel++) {
            const int v = top + pixel / 3, u = left + pixel % 3;
            if (v < 0 || u < 0 || v >= side || u >= side) continue;
            const Eight value = unpack(x[(v * side + u) * octets + octet]);
#pragma unroll
            for (int k = 0; k < 8; k++) {
                const float normal = value.at[k] * scale.at[k] + offset.at[k];
                if (normal > best.at[k]) {
                    best.at[k] = normal;
                    from[k] = (u8)pixel;
                }
            }
        }
        y[i] = pack(best);
        winner[i] = make_uint2(from[0] | from[1] << 8 | from[2] << 16 | (u32)from[3] << 24,
                               from[4] | from[5] << 8 | from[6] << 16 | (u32)from[7] << 24);
    }
}

// Gradient at pixel (v, u) from the windows that chose it.
__device__ inline Eight through_windows(const uint4* dy, const uint4* dy_too, const uint2* winner, int v, int u, int half,
                                        int octets, int octet) {
    Eight g = {};
    // Window w covers pixels 2w - 1 .. 2w + 1.
    for (int window_v = v / 2; window_v <= (v + 1) / 2 && window_v < half; window_v++) {
        for (int window_u = u / 2; window_u <= (u + 1) / 2 && window_u < half; window_u++) {
            const u32 pixel = (v - 2 * window_v + 1) * 3 + u - 2 * window_u + 1;
            const int i = (window_v * half + window_u) * octets + octet;
            const uint2 from = winner[i];
            const Eight arrived = arriving(dy, dy_too, 0, i);
#pragma unroll
            for (int k = 0; k < 8; k++) {
                const u32 chosen = ((k < 4 ? from.x : from.y) >> (8 * (k % 4))) & 255u;
                g.at[k] += chosen == pixel ? arrived.at[k] : 0.0f;
            }
        }
    }
    return g;
}

// dx of the stem for dy (+ dy_too?); see norm_backward.
extern "C" __global__ void stem_backward(const uint4* dy, const uint4* dy_too, const uint2* winner, const uint4* x,
                                         const float* mean_rstd, const float* weight, uint4* dx, float* gradients,
                                         int side, int channels, int groups) {
    __shared__ Sums sums;
    __shared__ float means[MAX_CHANNELS][2];
    const int octets = channels / 8, octet = threadIdx.x % octets, per_group = channels / groups;
    const int half = (side + 1) / 2, pixels = side * side;
    const size_t row = blockIdx.x;
    dy += row * half * half * octets;
    if (dy_too) dy_too += row * half * half * octets;
    winner += row * half * half * octets;
    x += row * pixels * octets;
    dx += row * pixels * octets;
    const Normalisation norm = normalisation(mean_rstd, row, groups, octet, per_group);
    Eight sum = {}, product = {};
    for (int i = threadIdx.x; i < pixels * octets; i += blockDim.x) {
        const int v = i / octets / side, u = i / octets % side;
        const Eight g = through_windows(dy, dy_too, winner, v, u, half, octets, octet), value = unpack(x[i]);
#pragma unroll
        for (int k = 0; k < 8; k++) {
            sum.at[k] += g.at[k];
            product.at[k] += g.at[k] * (value.at[k] - norm.mean.at[k]) * norm.rstd.at[k];
        }
    }
    add_up(sums, sum, product, octets, channels);
    group_means(sums, weight, gradients + row * 2 * channels, means, pixels, channels, groups);
    const Eight w = load(weight, octet);
    for (int i = threadIdx.x; i < pixels * octets; i += blockDim.x) {
        const int v = i / octets / side, u = i / octets % side;
        const Eight g = through_windows(dy, dy_too, winner, v, u, half, octets, octet), value = unpack(x[i]);
        dx[i] = pack(through(norm, w, means, g, value, octet, per_group));
    }
}

// What the stem's convolution sees: kept frames [rows, side, side] in millimetres, normalised to value · scale +
// offset, as maps of half the side with eight channels: (part, v mod 2, u mod 2), where the parts are the number
// rounded to bfloat16 and what that left over. So no depth is lost, a 7 × 7 convolution of stride 2 becomes a 4 × 4 one
// of stride 1, and eight channels are what tensor cores take. The border of zeros is two pixels above and left, one
// below and right.
extern "C" __global__ void stem_input(const float* kept, uint4* y, int side, float scale, float offset) {
    const int half = side / 2, padded = half + 3;
    const float* frame = kept + (size_t)blockIdx.x * side * side;
    y += (size_t)blockIdx.x * padded * padded;
    for (int i = threadIdx.x; i < padded * padded; i += blockDim.x) {
        const int v = i / padded - 2, u = i % padded - 2;
        Eight out = {};
        if (v >= 0 && u >= 0 && v < half && u < half) {
#pragma unroll
            for (int k = 0; k < 4; k++) {
                const float value = frame[(2 * v + k / 2) * side + 2 * u + k % 2] * scale + offset;
                const float rounded = __uint_as_float(two_bfloat16(value, 0.0f) << 16);
                out.at[k] = rounded;
                out.at[4 + k] = value - rounded;
            }
        }
        y[i] = pack(out);
    }
}
