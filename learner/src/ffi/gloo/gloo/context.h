// As much of Gloo's header of this name as c10d's header needs: pointers to a context, and one call that it makes
// inline.
#pragma once

#include <chrono>

namespace gloo {
class Context {
  public:
    void setTimeout(std::chrono::milliseconds timeout);
};
} // namespace gloo
