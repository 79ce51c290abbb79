// Group normalisation as the ResNet uses it, forward and backward, one launch each: bfloat16 feature maps
// [rows, pixels, channels] with channels last, all arithmetic in float32, sums in a fixed order.
//
// One block works on one row's whole map, which it reads twice: once for the sums, once to write. The second reading
// comes from the L2 cache. A thread owns the same eight neighbouring channels (16 bytes) of every pixel it visits:
// threads are a multiple of channels / 8, and channels / 8 is a power of two of at most 32.

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

