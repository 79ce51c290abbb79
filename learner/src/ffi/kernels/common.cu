// What the kernels share: numbers, and copies into shared memory. All kernels are compiled at start-up by NVRTC as one
// source, without headers: hence the conversions by hand.

typedef unsigned char u8;
typedef unsigned int u32;

#define EPSILON 1e-5f
#define NO_GRADIENT 255

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

__device__ inline u32 shared_address(const void* pointer) {
    return (u32)__cvta_generic_to_shared(pointer);
}

// Asks for 16 bytes of device memory in shared memory; `await_all` waits for all that this thread has asked for.
__device__ inline void ask_for(uint4* to, const uint4* from) {
    asm volatile("cp.async.cg.shared.global [%0], [%1], 16;" ::"r"(shared_address(to)), "l"(from) : "memory");
}

__device__ inline void await_all() {
    asm volatile("cp.async.wait_all;" ::: "memory");
}

// The gradient that reaches a map: of its one or two users.
__device__ inline Eight arriving(const uint4* dy, const uint4* dy_too, size_t i) {
    Eight g = unpack(dy[i]);
    if (dy_too) {
        const Eight more = unpack(dy_too[i]);
#pragma unroll
        for (int k = 0; k < 8; k++) g.at[k] += more.at[k];
    }
    return g;
}
