__device__ void copy(const unsigned char* from, unsigned char* to, int bytes) {
    const size_t all = (size_t)from | (size_t)to | bytes;
    if (all % 16 == 0) {
        for (int i = threadIdx.x; i < bytes / 16; i += blockDim.x) ((uint4*)to)[i] = ((const uint4*)from)[i];
    } else if (all % 4 == 0) {
        for (int i = threadIdx.x; i < bytes / 4; i += blockDim.x) ((unsigned*)to)[i] = ((const unsigned*)from)[i];
    } else {
        for (int i = threadIdx.x; i < bytes; i += blockDim.x) to[i] = from[i];
    }
}

// Rows of `from`, `bytes` bytes each, to rows to[…] of a table; without `to`, each to its own. One block a row.
extern "C" __global__ void scatter(const unsigned char* from, const long long* to, unsigned char* table, int bytes) {
    const size_t row = blockIdx.x, place = to ? to[row] : row;
    copy(from + row * bytes, table + place * bytes, bytes);
}

// `bytes` bytes at from[row] to byte `begin` of each row of a table whose rows have `stride` bytes. One block a row.
extern "C" __global__ void gather(const unsigned char* const* from, unsigned char* table, int stride, int begin, int bytes) {
    const size_t row = blockIdx.x;
    copy(from[row], table + row * stride + begin, bytes);
}
