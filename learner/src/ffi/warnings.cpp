// A handler for libtorch's warnings. They address authors of PyTorch programs, and some come with every call.

#include <c10/util/Exception.h>

extern "C" void stillroom_warned(const char *text);

namespace {
struct Listener : c10::WarningHandler {
    void process(const c10::Warning &warning) override { stillroom_warned(warning.msg().c_str()); }
};
} // namespace

// From now on libtorch's warnings on this thread go to `stillroom_warned`.
extern "C" void stillroom_hear_warnings() {
    static Listener listener;
    c10::WarningUtils::set_warning_handler(&listener);
}
