// Convolutions on the CPU as products: the same bits on every processor and with any number of threads, forward and
// backward. oneDNN's with AVX2, which are reproducible, too, take up to three times as long.
//
// Maps are kept with channels last. A patch holds the inputs of one output pixel, in the order (y, x, channel). The
// patches of some images form a matrix; the output and the gradients of input and weight are products with it.

#include "guard.h"
#include "product.h"
#include <ATen/ATen.h>
#include <algorithm>
#include <cstring>
#include <memory>
#include <torch/csrc/autograd/custom_function.h>


namespace {
// Patches of so many bytes are in memory at once, at least one image's. It decides where chains of the weight's
// gradient end: changing it changes results.
constexpr int64_t CHUNK_BYTES = 8 << 20;
// Rows of patches that a thread takes at once.
constexpr int64_t TILE_ROWS = 192;

struct Geometry {
    int64_t images, height, width, channels;
    int64_t outputs, size, stride, padding;

    int64_t out_height() const { return (height + 2 * padding - size) / stride + 1; }
    int64_t out_width() const { return (width + 2 * padding - size) / stride + 1; }
    int64_t pixels() const { return out_height() * out_width(); }
    int64_t patch() const { return size * size * channels; }
    int64_t map() const { return height * width * channels; }
    int64_t tile() const { return std::max<int64_t>(1, TILE_ROWS / pixels()); }
    int64_t chunk() const { return std::max<int64_t>(1, CHUNK_BYTES / (pixels() * patch() * int64_t(sizeof(float)))); }

    // Calls run(from the map's start, from the patch's start, count) for every run of a patch's numbers that lie side
    // by side in the map.
    template <typename Run> void runs(int64_t y, int64_t x, Run run) const {
        const int64_t left = x * stride - padding, first = std::max<int64_t>(0, -left), last = std::min(size, width - left);
        for (int64_t ky = 0; ky < size; ky++) {
            const int64_t row = y * stride - padding + ky;
            if (row < 0 || row >= height || first >= last) continue;
            run((row * width + left + first) * channels, (ky * size + first) * channels, (last - first) * channels);
        }
    }
};

// Runs are short where there are few channels, too short to call a function for each.
void copy(const float *from, int64_t count, float *to) {
    int64_t i = 0;
    for (; i + 8 <= count; i += 8) std::memcpy(to + i, from + i, 8 * sizeof(float));
    for (; i < count; i++) to[i] = from[i];
}

// All patches of an image, one after another.
void gather(const Geometry &g, const float *map, float *patches) {
    for (int64_t y = 0; y < g.out_height(); y++)
        for (int64_t x = 0; x < g.out_width(); x++, patches += g.patch()) {
            if (g.padding > 0) std::fill(patches, patches + g.patch(), 0.0f);
            g.runs(y, x, [&](int64_t from, int64_t to, int64_t count) { copy(map + from, count, patches + to); });
        }
}

// Adds all patches of an image to where they came from.
void scatter(const Geometry &g, const float *patches, float *map) {
    std::fill(map, map + g.map(), 0.0f);
    for (int64_t y = 0; y < g.out_height(); y++)
        for (int64_t x = 0; x < g.out_width(); x++, patches += g.patch())
            g.runs(y, x, [&](int64_t to, int64_t from, int64_t count) {
                for (int64_t i = 0; i < count; i++) map[to + i] += patches[from + i];
            });
}

// Some images at a time, divided among threads.
template <typename Body> void by_images(const Geometry &g, int64_t images, Body body) {
    const int64_t tile = g.tile(), tiles = (images + tile - 1) / tile;
    stillroom_in_parallel([&](int64_t thread, int64_t threads) {
        // Not a vector: that would write zeros first.
        const std::unique_ptr<float[]> patches(new float[tile * g.pixels() * g.patch()]);
        for (int64_t i = tiles * thread / threads; i < tiles * (thread + 1) / threads; i++)
            body(i * tile, std::min(images, (i + 1) * tile), patches.get());
    });
}

at::Tensor channels_last(const at::Tensor &x) { return x.contiguous(at::MemoryFormat::ChannelsLast); }

// [outputs, channels, size, size] -> [outputs, size, size, channels], contiguous.
at::Tensor by_patches(const at::Tensor &weight) { return weight.permute({0, 2, 3, 1}).contiguous(); }

Geometry geometry(const at::Tensor &x, const at::Tensor &weight, int64_t stride, int64_t padding) {
    TORCH_CHECK(x.dim() == 4 && weight.dim() == 4 && weight.size(2) == weight.size(3) && weight.size(1) == x.size(1),
                "a map of ", x.sizes(), " cannot be convolved with a weight of ", weight.sizes());
    TORCH_CHECK(x.scalar_type() == at::kFloat && weight.scalar_type() == at::kFloat && x.is_cpu() && weight.is_cpu());
    const Geometry g{x.size(0), x.size(2), x.size(3), x.size(1), weight.size(0), weight.size(2), stride, padding};
    TORCH_CHECK(g.height + 2 * padding >= g.size && g.width + 2 * padding >= g.size, "the map is smaller than a patch");
    return g;
}

at::Tensor forward_of(const Geometry &g, const at::Tensor &x, const at::Tensor &weight, const at::Tensor &bias) {
    auto y = at::empty({g.images, g.outputs, g.out_height(), g.out_width()}, x.options(), at::MemoryFormat::ChannelsLast);
    // [size, size, channels, outputs]: side by side for each term, as the product reads them.
    const at::Tensor maps = channels_last(x), terms = weight.permute({2, 3, 1, 0}).contiguous();
    const float *const from = maps.const_data_ptr<float>(), *const w = terms.const_data_ptr<float>();
    const float *const b = bias.numel() > 0 ? bias.const_data_ptr<float>() : nullptr;
    float *const to = y.mutable_data_ptr<float>();
    by_images(g, g.images, [&](int64_t begin, int64_t end, float *patches) {
        for (int64_t n = begin; n < end; n++) gather(g, from + n * g.map(), patches + (n - begin) * g.pixels() * g.patch());
        const int64_t columns = (end - begin) * g.pixels();
        float *const out = to + begin * g.pixels() * g.outputs;
        if (b)
            for (int64_t i = 0; i < columns; i++) copy(b, g.outputs, out + i * g.outputs);
        Product{g.outputs, columns, g.patch(), 1.0f, b ? 1.0f : 0.0f, {w, 1, g.outputs}, {patches, g.patch(), 1}, out, g.outputs}
            .part(0, g.outputs, 0, columns);
    });
    return y;
}

at::Tensor input_gradient(const Geometry &g, const at::Tensor &dy, const at::Tensor &weight) {
    auto dx = at::empty({g.images, g.channels, g.height, g.width}, dy.options(), at::MemoryFormat::ChannelsLast);
    const at::Tensor rows = by_patches(weight);
    const float *const from = dy.const_data_ptr<float>(), *const w = rows.const_data_ptr<float>();
    float *const to = dx.mutable_data_ptr<float>();
    by_images(g, g.images, [&](int64_t begin, int64_t end, float *patches) {
        const int64_t columns = (end - begin) * g.pixels();
        const float *const d = from + begin * g.pixels() * g.outputs;
        Product{g.patch(), columns, g.outputs, 1.0f, 0.0f, {w, 1, g.patch()}, {d, g.outputs, 1}, patches, g.patch()}
            .part(0, g.patch(), 0, columns);
        for (int64_t n = begin; n < end; n++) scatter(g, patches + (n - begin) * g.pixels() * g.patch(), to + n * g.map());
    });
    return dx;
}

at::Tensor weight_gradient(const Geometry &g, const at::Tensor &dy, const at::Tensor &x) {
    const at::Tensor maps = channels_last(x);
    const float *const from = maps.const_data_ptr<float>(), *const d = dy.const_data_ptr<float>();
    auto rows = at::zeros({g.outputs, g.size, g.size, g.channels}, x.options());
    float *const to = rows.mutable_data_ptr<float>();
    const std::unique_ptr<float[]> patches(new float[std::min(g.chunk(), g.images) * g.pixels() * g.patch()]);
    for (int64_t begin = 0; begin < g.images; begin += g.chunk()) {
        const int64_t images = std::min(g.chunk(), g.images - begin), depth = images * g.pixels();
        stillroom_in_parallel([&](int64_t thread, int64_t threads) {
            for (int64_t n = images * thread / threads; n < images * (thread + 1) / threads; n++)
                gather(g, from + (begin + n) * g.map(), patches.get() + n * g.pixels() * g.patch());
        });
        const Product product{g.patch(), g.outputs, depth, 1.0f, 1.0f, {patches.get(), 1, g.patch()},
                              {d + begin * g.pixels() * g.outputs, 1, g.outputs}, to, g.patch()};
        stillroom_in_parallel([&](int64_t thread, int64_t threads) {
            product.part(g.patch() * thread / threads, g.patch() * (thread + 1) / threads, 0, g.outputs);
        });
    }
    return rows.permute({0, 3, 1, 2}).contiguous();
}

struct Convolution : torch::autograd::Function<Convolution> {
    static at::Tensor forward(torch::autograd::AutogradContext *context, const at::Tensor &x, const at::Tensor &weight,
                              const at::Tensor &bias, int64_t stride, int64_t padding) {
        const Geometry g = geometry(x, weight, stride, padding);
        context->save_for_backward({x, weight});
        context->saved_data["stride"] = stride;
        context->saved_data["padding"] = padding;
        return forward_of(g, x, weight, bias);
    }

    static torch::autograd::variable_list backward(torch::autograd::AutogradContext *context,
                                                   torch::autograd::variable_list gradients) {
        const auto saved = context->get_saved_variables();
        const at::Tensor &x = saved[0], &weight = saved[1];
        const Geometry g = geometry(x, weight, context->saved_data["stride"].toInt(), context->saved_data["padding"].toInt());
        const at::Tensor dy = channels_last(gradients[0]);
        const auto wanted = [&](size_t input) { return context->needs_input_grad(input); };
        return {
            wanted(0) ? input_gradient(g, dy, weight) : at::Tensor(),
            wanted(1) ? weight_gradient(g, dy, x) : at::Tensor(),
            wanted(2) ? dy.permute({0, 2, 3, 1}).reshape({-1, g.outputs}).sum(0) : at::Tensor(),
            at::Tensor(),
            at::Tensor(),
        };
    }
};
} // namespace

// A square, ungrouped 2D convolution of 32-bit maps on the CPU that autograd knows; `bias` may be null. The new tensor
// belongs to the caller. Returns 0, or 1 with the reason in `message`; no exception leaves.
extern "C" int stillroom_convolution(const at::Tensor *x, const at::Tensor *weight, const at::Tensor *bias, int64_t stride,
                                     int64_t padding, at::Tensor **y, char *message, size_t capacity) {
    return guarded(message, capacity, [&] {
        *y = new at::Tensor(Convolution::apply(*x, *weight, bias ? *bias : at::empty({0}), stride, padding));
    });
}
