// Rows of `from`, `bytes` bytes each, to rows to[…] of a table; without `to`, each to its own. One block a row.
extern "C" __global__ void scatter(const unsigned char* from, const long long* to, unsigned char* table, int bytes) {
    const size_t row = blockIdx.x, place = to ? to[row] : row;
    from += row * bytes;
    table += place * bytes;
    if (bytes % 16 == 0) {
        for (int i = threadIdx.x; i < bytes / 16; i += blockDim.x) ((uint4*)table)[i] = ((const uint4*)from)[i];
    } else if (bytes % 4 == 0) {
        for (int i = threadIdx.x; i < bytes / 4; i += blockDim.x) ((unsigned*)table)[i] = ((const unsigned*)from)[i];
    } else {
        for (int i = threadIdx.x; i < bytes; i += blockDim.x) table[i] = from[i];
    }
}
