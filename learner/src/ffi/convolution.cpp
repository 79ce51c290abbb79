// The gradient of a convolution. libtorch's C interface, and with it tch, leaves this operation out.

#include "guard.h"
#include <ATen/core/Tensor.h>
#include <ATen/ops/convolution_backward.h>

// Gradients of a square, unbiased, ungrouped 2D convolution for its output's gradient `dy`. `dx` stays null unless it
// is wanted. The new tensors belong to the caller. Returns 0, or 1 with the reason in `message`; no exception leaves.
extern "C" int stillroom_convolution_backward(const at::Tensor *dy, const at::Tensor *x, const at::Tensor *weight,
                                              int64_t stride, int64_t padding, bool wants_dx, at::Tensor **dx,
                                              at::Tensor **dw, char *message, size_t capacity) {
    return guarded(message, capacity, [&] {
        const int64_t strides[] = {stride, stride}, paddings[] = {padding, padding}, ones[] = {1, 1}, zeros[] = {0, 0};
        auto gradients = at::convolution_backward(*dy, *x, *weight, at::OptionalIntArrayRef(), strides, paddings, ones,
                                                  false, zeros, 1, {wants_dx, true, false});
        at::Tensor *input = wants_dx ? new at::Tensor(std::move(std::get<0>(gradients))) : nullptr;
        *dw = new at::Tensor(std::move(std::get<1>(gradients)));
        *dx = input;
    });
}
