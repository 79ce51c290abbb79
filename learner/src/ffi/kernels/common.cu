// What the kernels share: numbers, and sums over a block. All kernels are compiled at start-up by NVRTC as one source,
// without headers: hence the conversions by hand.

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

__device__ inline float low(u32 bits) {
    return __uint_as_float(bits << 16);
}

__device__ inline float high(u32 bits) {
    return __uint_as_float(bits & 0xffff0000u);
}

__device__ inline Eight unpack(uint4 bits) {
    const u32 words[4] = {bits.x, bits.y, bits.z, bits.w};
    Eight out;
#pragma unroll
    for (int i = 0; i < 4; i++) {
        out.at[2 * i] = low(words[i]);
        out.at[2 * i + 1] = high(words[i]);
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

