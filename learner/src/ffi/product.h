// Products of matrices in a fixed order of additions (product.cpp), for what computes by them.
#pragma once

#include <cstdint>
#include <functional>

// A matrix: element (i, j) is data[i * row + j * column].
struct Matrix {
    const float *data;
    int64_t row, column;
};

// result = alpha * left * right + beta * result.
struct Product {
    int64_t rows, columns, depth;
    float alpha, beta;
    Matrix left, right; // right is transposed: its rows are the product's columns
    float *result;      // column after column
    int64_t stride;     // between columns of the result

    // Rows [row, last_row) and columns [column, last_column) of the result, by this thread.
    void part(int64_t row, int64_t last_row, int64_t column, int64_t last_column) const;
};

// Runs body(thread, threads) in each of libtorch's threads, or once where they are busy or not to be had. What it
// computes must not depend on how many there are. It must not throw.
void stillroom_in_parallel(const std::function<void(int64_t, int64_t)> &body);
