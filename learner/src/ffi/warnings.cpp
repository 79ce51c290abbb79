// Whom libtorch warns. Its warnings speak to those who write PyTorch programs, and some come with every call.

#include <c10/util/Exception.h>

extern "C" void stillroom_warned(const char *text);

namespace {
struct Listener : c10::WarningHandler {
    void process(const c10::Warning &warning) override { stillroom_warned(warning.msg().c_str()); }
};
} // namespace

// From now on what libtorch warns of on this thread is told to `stillroom_warned`.
extern "C" void stillroom_hear_warnings() {
    static Listener listener;
    c10::WarningUtils::set_warning_handler(&listener);
}
