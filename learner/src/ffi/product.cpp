// Products of matrices whose last bit is the same on every processor with fused multiply-adds, and with any number of
// threads.
//
// libtorch multiplies 32-bit matrices with BLAS' `sgemm_`, and MKL's order of additions depends on the processor. A
// function of this name in the program takes the place of the one in libtorch_cpu.so, as any BLAS does that is linked
// before another.
//
// Each number of the result is one chain of fused multiply-adds over DEPTH terms in ascending order, and the sums of
// such chains, in ascending order. Lanes of a vector hold different numbers, so the width of vectors does not matter.

#include "product.h"
#include "arithmetic.h"
#include <ATen/Parallel.h>
#include <algorithm>
#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <dlfcn.h>
#include <memory>
#if defined(__x86_64__)
#include <immintrin.h>
#elif defined(__aarch64__)
#include <arm_neon.h>
#endif

namespace {
// Terms of one chain. Changing it changes results.
constexpr int64_t DEPTH = 256;
// Blocks of the two factors that stay in the caches: a multiple of every kernel's rows, and of its columns.
constexpr int64_t BLOCK_ROWS = 128;
constexpr int64_t BLOCK_COLUMNS = 480;
// What one thread is given is a multiple of this many rows or columns.
constexpr int64_t SHARE = 96;
// Products of fewer multiplications are not worth a second thread.
constexpr int64_t WORTH_A_THREAD = 1 << 17;
constexpr int64_t MOST_SUMS = 32 * 12;

// Four rows of four terms, which lie side by side in `m`, term after term.
void transpose(float *out, int64_t width, const float *m, int64_t row) {
#if defined(__SSE__)
    __m128 a = _mm_loadu_ps(m), b = _mm_loadu_ps(m + row), c = _mm_loadu_ps(m + 2 * row), d = _mm_loadu_ps(m + 3 * row);
    _MM_TRANSPOSE4_PS(a, b, c, d);
    _mm_storeu_ps(out, a);
    _mm_storeu_ps(out + width, b);
    _mm_storeu_ps(out + 2 * width, c);
    _mm_storeu_ps(out + 3 * width, d);
#else
    for (int64_t k = 0; k < 4; k++)
        for (int64_t i = 0; i < 4; i++) out[k * width + i] = m[i * row + k];
#endif
}

// Rows [begin, end) of a matrix over the terms [from, to), in strips of WIDTH rows: term after term, the strip's rows
// side by side. What the last strip lacks is zero.
template <int64_t WIDTH> void pack(float *out, Matrix m, int64_t begin, int64_t end, int64_t from, int64_t to) {
    const int64_t depth = to - from;
    for (int64_t strip = begin; strip < end; strip += WIDTH, out += WIDTH * depth) {
        const int64_t rows = std::min(WIDTH, end - strip);
        const float *data = m.data + strip * m.row + from * m.column;
        int64_t k = 0;
        if (rows < WIDTH) {
            std::fill(out, out + WIDTH * depth, 0.0f);
        } else if (m.row == 1) {
            for (; k < depth; k++)
                for (int64_t i = 0; i < WIDTH; i++) out[k * WIDTH + i] = data[k * m.column + i];
        } else if (m.column == 1 && WIDTH % 4 == 0) {
            // Few terms at a time: what is written stays in the first cache until its line is full.
            for (; k + 16 <= depth; k += 16)
                for (int64_t i = 0; i < WIDTH; i += 4)
                    for (int64_t t = k; t < k + 16; t += 4) transpose(out + t * WIDTH + i, WIDTH, data + i * m.row + t, m.row);
        }
        for (; k < depth; k++)
            for (int64_t i = 0; i < rows; i++) out[k * WIDTH + i] = data[i * m.row + k * m.column];
    }
}

// Sums of rows x columns chains, column after column: `left` holds `rows` numbers for each of `depth` terms, `right` is
// a matrix with a row for each column of sums.
using Chains = void (*)(int64_t depth, const float *left, Matrix right, float *sums);

using Pack = void (*)(float *out, Matrix m, int64_t begin, int64_t end, int64_t from, int64_t to);

struct Kernel {
    int64_t rows, columns;
    Chains chains;
    Pack pack_left, pack_right;
};

#if defined(__x86_64__)
__attribute__((target("avx2,fma"))) void chains_avx2(int64_t depth, const float *left, Matrix right, float *sums) {
    const float *first = right.data, *last = first + 3 * right.row;
    __m256 sum[6][2];
#pragma GCC unroll 6
    for (int j = 0; j < 6; j++) sum[j][0] = sum[j][1] = _mm256_setzero_ps();
    for (int64_t k = 0; k < depth; k++, left += 16, first += right.column, last += right.column) {
        const __m256 x0 = _mm256_load_ps(left), x1 = _mm256_load_ps(left + 8);
#pragma GCC unroll 6
        for (int j = 0; j < 6; j++) {
            const __m256 y = _mm256_broadcast_ss(j < 3 ? first + j * right.row : last + (j - 3) * right.row);
            sum[j][0] = _mm256_fmadd_ps(x0, y, sum[j][0]);
            sum[j][1] = _mm256_fmadd_ps(x1, y, sum[j][1]);
        }
    }
#pragma GCC unroll 6
    for (int j = 0; j < 6; j++) {
        _mm256_store_ps(sums + 16 * j, sum[j][0]);
        _mm256_store_ps(sums + 16 * j + 8, sum[j][1]);
    }
}

__attribute__((target("avx512f"))) void
chains_avx512(int64_t depth, const float *left, Matrix right, float *sums) {
    // Four pointers, so that all twelve addresses are one of them and a multiple of the stride.
    const float *y[4];
#pragma GCC unroll 4
    for (int j = 0; j < 4; j++) y[j] = right.data + 3 * j * right.row;
    __m512 sum[12][2];
#pragma GCC unroll 12
    for (int j = 0; j < 12; j++) sum[j][0] = sum[j][1] = _mm512_setzero_ps();
    for (int64_t k = 0; k < depth; k++, left += 32) {
        const __m512 x0 = _mm512_load_ps(left), x1 = _mm512_load_ps(left + 16);
#pragma GCC unroll 12
        for (int j = 0; j < 12; j++) {
            const __m512 value = _mm512_set1_ps(y[j / 3][j % 3 * right.row]);
            sum[j][0] = _mm512_fmadd_ps(x0, value, sum[j][0]);
            sum[j][1] = _mm512_fmadd_ps(x1, value, sum[j][1]);
        }
#pragma GCC unroll 4
        for (int j = 0; j < 4; j++) y[j] += right.column;
    }
#pragma GCC unroll 12
    for (int j = 0; j < 12; j++) {
        _mm512_store_ps(sums + 32 * j, sum[j][0]);
        _mm512_store_ps(sums + 32 * j + 16, sum[j][1]);
    }
}
#elif defined(__aarch64__)
void chains_neon(int64_t depth, const float *left, Matrix right, float *sums) {
    const float *y = right.data;
    float32x4_t sum[6][4] = {};
    for (int64_t k = 0; k < depth; k++, left += 16, y += right.column) {
        const float32x4x4_t x = vld1q_f32_x4(left);
#pragma GCC unroll 6
        for (int j = 0; j < 6; j++)
#pragma GCC unroll 4
            for (int i = 0; i < 4; i++) sum[j][i] = vfmaq_n_f32(sum[j][i], x.val[i], y[j * right.row]);
    }
    for (int j = 0; j < 6; j++)
        for (int i = 0; i < 4; i++) vst1q_f32(sums + 16 * j + 4 * i, sum[j][i]);
}
#endif

void chains_plain(int64_t depth, const float *left, Matrix right, float *sums) {
    const float *y = right.data;
    std::fill(sums, sums + 16 * 6, 0.0f);
    for (int64_t k = 0; k < depth; k++, left += 16, y += right.column)
        for (int j = 0; j < 6; j++)
            for (int i = 0; i < 16; i++) sums[16 * j + i] = std::fma(left[i], y[j * right.row], sums[16 * j + i]);
}

constexpr Kernel PLAIN{16, 6, chains_plain, pack<16>, pack<6>};

const Kernel &widest() {
#if defined(__x86_64__)
    static const Kernel chosen = __builtin_cpu_supports("avx512f") ? Kernel{32, 12, chains_avx512, pack<32>, pack<12>}
        : __builtin_cpu_supports("avx2") && __builtin_cpu_supports("fma") ? Kernel{16, 6, chains_avx2, pack<16>, pack<6>}
                                                                           : PLAIN;
    return chosen;
#elif defined(__aarch64__)
    static constexpr Kernel NEON{16, 6, chains_neon, pack<16>, pack<6>};
    return NEON;
#else
    return PLAIN;
#endif
}

// Aligned memory that a thread keeps for its next product.
class Room {
    std::unique_ptr<float, decltype(&std::free)> memory;

  public:
    explicit Room(int64_t floats)
        : memory(static_cast<float *>(std::aligned_alloc(64, static_cast<size_t>(floats) * sizeof(float))), std::free) {
        if (!memory) std::abort(); // half a megabyte is not there: the process is about to die anyway
    }
    float *get() { return memory.get(); }
};

// A strip's part of the result: `sums` of the terms that were just multiplied.
void add(const Product &product, const float *sums, const Kernel &kernel, int64_t i, int64_t rows, int64_t j,
         int64_t columns, bool first) {
    for (int64_t y = 0; y < columns; y++, sums += kernel.rows) {
        float *out = product.result + (j + y) * product.stride + i;
        if (!first)
            for (int64_t x = 0; x < rows; x++) out[x] += product.alpha * sums[x];
        else if (product.beta == 0.0f) // what stood there may be no number
            for (int64_t x = 0; x < rows; x++) out[x] = product.alpha * sums[x];
        else
            for (int64_t x = 0; x < rows; x++) out[x] = product.beta * out[x] + product.alpha * sums[x];
    }
}

void scale(const Product &product) {
    for (int64_t j = 0; j < product.columns; j++)
        for (int64_t i = 0; i < product.rows; i++) {
            float &out = product.result[j * product.stride + i];
            out = product.beta == 0.0f ? 0.0f : product.beta * out;
        }
}

// What of OpenMP is needed, from the library that libtorch itself has loaded: so this file needs no OpenMP compiler.
struct OpenMp {
    void (*parallel)(void (*body)(void *), void *data, unsigned threads, unsigned flags);
    int (*thread)();
    int (*threads)();

    static const OpenMp &get() {
        static const OpenMp found = {
            reinterpret_cast<decltype(parallel)>(dlsym(RTLD_DEFAULT, "GOMP_parallel")),
            reinterpret_cast<decltype(thread)>(dlsym(RTLD_DEFAULT, "omp_get_thread_num")),
            reinterpret_cast<decltype(threads)>(dlsym(RTLD_DEFAULT, "omp_get_num_threads")),
        };
        return found;
    }
    bool is_there() const { return parallel && thread && threads; }
};

// The share of one thread: of the rows, or of the columns if there are more of them.
void own_share(const Product &product, int64_t thread, int64_t threads) {
    const bool by_rows = product.rows >= product.columns;
    const int64_t size = by_rows ? product.rows : product.columns, shares = (size + SHARE - 1) / SHARE;
    const int64_t begin = shares * thread / threads * SHARE, end = std::min(size, shares * (thread + 1) / threads * SHARE);
    if (begin >= end) return;
    if (by_rows)
        product.part(begin, end, 0, product.columns);
    else
        product.part(0, product.rows, begin, end);
}

void multiply(const Product &product) {
    if (product.rows == 0 || product.columns == 0) return;
    if (product.depth == 0 || product.alpha == 0.0f) return scale(product);
    if (product.rows * product.columns * product.depth < WORTH_A_THREAD) return own_share(product, 0, 1);
    stillroom_in_parallel([&](int64_t thread, int64_t threads) { own_share(product, thread, threads); });
}

using Sgemm = void(const char *, const char *, const int *, const int *, const int *, const float *, const float *,
                   const int *, const float *, const int *, const float *, float *, const int *);
} // namespace

void Product::part(int64_t row, int64_t last_row, int64_t column, int64_t last_column) const {
    const Kernel &kernel = widest();
    thread_local Room left_room(BLOCK_ROWS * DEPTH), right_room(BLOCK_COLUMNS * DEPTH);
    float *const a = left_room.get(), *const b = right_room.get();
    alignas(64) float sums[MOST_SUMS];
    for (int64_t n = column; n < last_column; n += BLOCK_COLUMNS) {
        const int64_t n_end = std::min(last_column, n + BLOCK_COLUMNS);
        for (int64_t k = 0; k < depth; k += DEPTH) {
            const int64_t k_end = std::min(depth, k + DEPTH), terms = k_end - k;
            // Where the terms of a row lie side by side, they are read where they are, but for the last few rows.
            const int64_t packed = right.column == 1 ? n_end - (n_end - n) % kernel.columns : n;
            kernel.pack_right(b, right, packed, n_end, k, k_end);
            for (int64_t m = row; m < last_row; m += BLOCK_ROWS) {
                const int64_t m_end = std::min(last_row, m + BLOCK_ROWS);
                kernel.pack_left(a, left, m, m_end, k, k_end);
                for (int64_t j = n; j < n_end; j += kernel.columns) {
                    const Matrix strip = j < packed ? Matrix{right.data + j * right.row + k, right.row, 1}
                                                    : Matrix{b + (j - packed) * terms, 1, kernel.columns};
                    for (int64_t i = m; i < m_end; i += kernel.rows) {
                        kernel.chains(terms, a + (i - m) * terms, strip, sums);
                        const int64_t rows = std::min(kernel.rows, m_end - i), columns = std::min(kernel.columns, n_end - j);
                        add(*this, sums, kernel, i, rows, j, columns, k == 0);
                    }
                }
            }
        }
    }
}

void stillroom_in_parallel(const std::function<void(int64_t, int64_t)> &body) {
    const OpenMp &open_mp = OpenMp::get();
    if (!open_mp.is_there() || at::in_parallel_region()) return body(0, 1);
    // As many threads as libtorch has set.
    open_mp.parallel(
        [](void *data) {
            const OpenMp &open_mp = OpenMp::get();
            (*static_cast<const std::function<void(int64_t, int64_t)> *>(data))(open_mp.thread(), open_mp.threads());
        },
        const_cast<std::function<void(int64_t, int64_t)> *>(&body), 0, 0);
}

// BLAS: C = alpha * op(A) * op(B) + beta * C, matrices column after column.
extern "C" void sgemm_(const char *transpose_a, const char *transpose_b, const int *m, const int *n, const int *k,
                       const float *alpha, const float *a, const int *lda, const float *b, const int *ldb,
                       const float *beta, float *c, const int *ldc) {
    if (!stillroom_is_reproducible()) {
        static const auto library = reinterpret_cast<Sgemm *>(dlsym(RTLD_NEXT, "sgemm_"));
        if (library) return library(transpose_a, transpose_b, m, n, k, alpha, a, lda, b, ldb, beta, c, ldc);
    }
    const auto transposed = [](char letter) { return letter != 'N' && letter != 'n'; };
    const Matrix left = transposed(*transpose_a) ? Matrix{a, *lda, 1} : Matrix{a, 1, *lda};
    const Matrix right = transposed(*transpose_b) ? Matrix{b, 1, *ldb} : Matrix{b, *ldb, 1};
    multiply({*m, *n, *k, *alpha, *beta, left, right, c, *ldc});
}
